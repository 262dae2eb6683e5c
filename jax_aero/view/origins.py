"""Connections that the page accepts: from its own browser tab and from programs other than browsers."""

from __future__ import annotations

import http
import inspect
import re
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import websockets.asyncio.server

ADDRESS = r"\d+\.\d+\.\d+\.\d+|\[[0-9a-fA-F:.]+\]"
"""An address instead of a name; only the site at that address can use it."""


def allowed_origins(host: str) -> list[Any]:
    """Return the accepted values of a connection's header `Origin`, for a page that listens on `host`.

    A browser sends the origin of the script. Scripts of other sites, which could otherwise read and control the page,
    are thus recognised, also under foreign names that resolve to this machine.
    """
    return [None, re.compile(rf"https?://{_host(host)}")]


def _host(host: str) -> str:
    """Return a pattern of a page's own host, with or without port."""
    names = "|".join(re.escape(name) for name in {"localhost", host, socket.gethostname()})
    return rf"({names}|{ADDRESS})(:\d+)?"


def _check_host(host: str, answer: Any) -> Any:
    """Wrap `answer`, which serves files, to answer requests to other host names with 403.

    Another name may belong to a site that resolves it to this machine, whose scripts would then have the same origin as
    the page (DNS rebinding).
    """
    own = re.compile(_host(host))

    async def check(connection: Any, request: Any) -> Any:
        if not own.fullmatch(request.headers.get("Host", "")):
            return connection.respond(http.HTTPStatus.FORBIDDEN, "this page is served to its own host alone\n")
        given = answer(connection, request) if answer else None
        return await given if inspect.isawaitable(given) else given

    return check


@contextmanager
def own_origins(host: str) -> Iterator[None]:
    """Make servers that are started inside the block accept connections from their own page only."""
    module: Any = websockets.asyncio.server
    serve = module.serve

    def serve_own(*words: Any, process_request: Any = None, **options: Any) -> Any:
        return serve(
            *words, process_request=_check_host(host, process_request), origins=allowed_origins(host), **options
        )

    module.serve = serve_own
    try:
        yield
    finally:
        module.serve = serve

"""Connections that the page accepts: those of its own tab, and of programs that are not browsers."""

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
"""An address instead of a name: no other site can stand behind it that is not at that address."""


def allowed(host: str) -> list[Any]:
    """Return what the header `Origin` of a connection may be, for a page that listens on `host`.

    A browser sends the site that a script came from. Scripts of other sites, which could otherwise read and steer the
    page, name themselves there; so do foreign names that resolve to this machine.
    """
    return [None, re.compile(rf"https?://{_host(host)}")]


def _host(host: str) -> str:
    """Pattern of a page's own host, with or without port."""
    names = "|".join(re.escape(name) for name in {"localhost", host, socket.gethostname()})
    return rf"({names}|{ADDRESS})(:\d+)?"


def _of_own_host(host: str, answer: Any) -> Any:
    """Wrap `answer`, which serves files: a request to another name gets 403.

    That name may belong to a site that lets it point to this machine, and whose scripts would then be of one origin
    with the page (DNS rebinding).
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
    """Let a server that is started inside accept connections of its own page alone."""
    module: Any = websockets.asyncio.server
    serve = module.serve

    def serve_own(*words: Any, process_request: Any = None, **options: Any) -> Any:
        return serve(*words, process_request=_of_own_host(host, process_request), origins=allowed(host), **options)

    module.serve = serve_own
    try:
        yield
    finally:
        module.serve = serve

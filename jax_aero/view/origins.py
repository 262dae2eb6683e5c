"""Requests that the page accepts: from its own browser tab, to its own host."""

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


def is_own(host: str, headers: Any) -> bool:
    """Return whether a request comes from the page that listens on `host`.

    A browser sends the origin of the script, which for the page's own scripts is the `Host` that they connect to; a
    connection, other than the request of a file, always has it. `Host` itself must be a name of this machine or an
    address: another name may belong to a site that resolves it to this machine, whose scripts would then have the same
    origin as the page (DNS rebinding).
    """
    names = "|".join(re.escape(name) for name in {"localhost", host, socket.gethostname()})
    hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
    if len(hosts) != 1 or not re.fullmatch(rf"({names}|{ADDRESS})(:\d+)?", hosts[0], re.ASCII):
        return False
    return origins == [f"http://{hosts[0]}"] or not (origins or "Upgrade" in headers)


@contextmanager
def own_origins(host: str) -> Iterator[None]:
    """Make servers that are started inside the block answer other requests than those of their own page with 403."""
    module: Any = websockets.asyncio.server
    serve = module.serve

    def serve_own(*words: Any, process_request: Any = None, **options: Any) -> Any:
        async def check(connection: Any, request: Any) -> Any:
            if not is_own(host, request.headers):
                return connection.respond(http.HTTPStatus.FORBIDDEN, "this page is served to its own host alone\n")
            given = process_request(connection, request) if process_request else None
            return await given if inspect.isawaitable(given) else given

        return serve(*words, process_request=check, **options)

    module.serve = serve_own
    try:
        yield
    finally:
        module.serve = serve

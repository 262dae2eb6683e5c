"""Who may talk to the page: its own tab, and programs that are no browser."""

from __future__ import annotations

import functools
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
    page, name themselves there; so do names that somebody lets point to this machine.
    """
    names = "|".join(re.escape(name) for name in {"localhost", host, socket.gethostname()})
    return [None, re.compile(rf"https?://({names}|{ADDRESS})(:\d+)?")]


@contextmanager
def own_origins(host: str) -> Iterator[None]:
    """Let a server that is started inside accept connections of its own page alone."""
    module: Any = websockets.asyncio.server
    serve = module.serve
    module.serve = functools.partial(serve, origins=allowed(host))
    try:
        yield
    finally:
        module.serve = serve

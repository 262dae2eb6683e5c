"""Sizes in memory of what files of others hold, bounded before they are decoded, for every reader of them."""

from __future__ import annotations

from jax_aero.base.terminal import Refused

MAX_NUMBERS = 2 << 30
"""Greatest size of the numbers of a file in memory [bytes]; the crate logs no more."""

MAX_TABLE = 1 << 30
"""Greatest size of a table of a sweep [bytes]: a million flights; and of a record that a file holds as it is."""

MAX_PART = 64 << 20
"""Greatest size of what is decoded as a whole: texts, a chunk of messages, a compressed variable [bytes]."""

MAX_OBJECTS = 4_000_000
"""Greatest number of values that become Python objects, of some 100 bytes each: of a document, of a table of cells."""


def expect(what: str, count: int, greatest: int) -> None:
    """Refuse a count of bytes, letters or values above the greatest one."""
    if count > greatest:
        raise Refused(f"it holds {count} {what} or more; expected at most {greatest}")

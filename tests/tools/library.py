"""What a dynamic library exports and needs, read from its file: ELF, PE (Windows) or Mach-O (macOS), 64 bits each."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple


class Library(NamedTuple):
    """A dynamic library.

    Attributes
    ----------
    platform
        End of the tags of wheels that hold it, e.g. `win_amd64`.
    exports
        Names of its symbols, without the underscore of macOS.
    needs
        Names of the libraries that it needs.
    """

    platform: str
    exports: set[str]
    needs: set[str]


def read(content: bytes) -> Library:
    """Read a library.

    Raises
    ------
    ValueError
        For other formats and processors.
    """
    for magic, reader in ((b"\x7fELF\x02\x01", _read_elf), (b"MZ", _read_pe), (b"\xcf\xfa\xed\xfe", _read_macho)):
        if content.startswith(magic):
            return reader(content)
    raise ValueError(f"a library begins with {content[:4].hex()}; expected ELF, PE or Mach-O")


def _text(content: bytes, start: int) -> str:
    return content[start : content.index(0, start)].decode()


def _read_elf(content: bytes) -> Library:
    platform = {0x3E: "x86_64", 0xB7: "aarch64"}[struct.unpack_from("<H", content, 18)[0]]
    (table,), (size, count) = struct.unpack_from("<Q", content, 40), struct.unpack_from("<HH", content, 58)
    # Offset, size, linked section and size of an entry of every section, by its type.
    sections = [struct.unpack_from("<4xI16xQQI12xQ", content, table + size * place) for place in range(count)]
    found: dict[int, list[tuple[int, ...]]] = {6: [], 11: []}  # dynamic section, dynamic symbols
    for kind, start, length, link, entry in sections:
        if kind in found:
            found[kind] += [(at, sections[link][1]) for at in range(start, start + length, entry)]
    exports = set()
    for at, names in found[11]:
        name, section = struct.unpack_from("<I2xH", content, at)
        if section:  # it is defined here
            exports.add(_text(content, names + name))
    dynamic = [(*struct.unpack_from("<QQ", content, at), names) for at, names in found[6]]
    return Library(platform, exports, {_text(content, names + value) for tag, value, names in dynamic if tag == 1})


def _read_pe(content: bytes) -> Library:
    (head,) = struct.unpack_from("<I", content, 0x3C)
    machine, count, optional = struct.unpack_from("<HH12xH", content, head + 4)
    options = head + 24
    sections = [struct.unpack_from("<8xIIII", content, options + optional + 40 * place) for place in range(count)]

    def place_of(address: int) -> int:
        """Return the place in the file of an address in memory."""
        for size, start, stored, place in sections:
            if start <= address < start + max(size, stored):
                return address - start + place
        raise ValueError(f"address {address:#x} lies in no section")

    def text_at(address: int) -> str:
        return _text(content, place_of(address))

    def imports(at: int) -> Iterator[str]:
        while name := struct.unpack_from("<12xI", content, at)[0]:
            yield text_at(name)
            at += 20

    exported, imported = struct.unpack_from("<I4xI", content, options + 112)
    exports: tuple[int, ...] = ()
    if exported:
        number, names = struct.unpack_from("<24xI4xI", content, place_of(exported))
        exports = struct.unpack_from(f"<{number}I", content, place_of(names))
    return Library({0x8664: "win_amd64"}[machine], {*map(text_at, exports)}, {*imports(place_of(imported))})


def _read_macho(content: bytes) -> Library:
    processor, commands = struct.unpack_from("<4xI8xI", content)
    exports, needs, at = set(), set(), 32
    for _ in range(commands):
        command, size = struct.unpack_from("<II", content, at)
        if command == 0x2:  # symbols
            symbols, count, names = struct.unpack_from("<III", content, at + 8)
            for place in range(symbols, symbols + 16 * count, 16):
                name, kind = struct.unpack_from("<IB", content, place)
                if kind & 0x01 and kind & 0x0E:  # external, and defined here
                    exports.add(_text(content, names + name).removeprefix("_"))
        elif command in (0xC, 0x8000_0018, 0x8000_001F):  # libraries: needed, possibly absent, re-exported
            needs.add(_text(content, at + struct.unpack_from("<I", content, at + 8)[0]))
        at += size
    return Library({0x0100_000C: "arm64"}[processor], exports, needs)

"""What `make wheels` reads of libraries for machines that are not here."""

import struct
from pathlib import Path

import pip
import pytest

from jax_aero import _core
from tests.tools import library


def test_the_module_for_this_machine_is_one_of_python():
    found = library.read(Path(_core.__file__).read_bytes())
    assert "PyInit__core" in found.exports
    assert "PyErr_SetString" not in found.exports  # which it uses
    assert any(name.startswith("libc.") for name in found.needs)


def test_a_program_for_windows_needs_its_kernel():
    """pip brings one for scripts."""
    path = Path(pip.__file__).parent / "_vendor/distlib/w64.exe"
    if not path.is_file():
        pytest.skip("this pip has no program for Windows: make setup")
    found = library.read(path.read_bytes())
    assert (found.platform, found.exports) == ("win_amd64", set())
    assert "kernel32.dll" in {name.lower() for name in found.needs}


def test_symbols_and_needs_of_a_library_for_macos():
    """Of three symbols one is defined and external."""
    needed = b"/usr/lib/libSystem.B.dylib\0".ljust(32, b"\0")
    symbols = [(1, 0x0F), (15, 0x0E), (24, 0x01)]  # exported, local, undefined
    names = b"\0_PyInit__core\0_private\0_PyDict_New\0"
    commands = struct.pack("<IIIIII", 0xC, 24 + len(needed), 24, 0, 0, 0) + needed
    start = 32 + len(commands) + 24
    commands += struct.pack("<IIIIII", 0x2, 24, start, len(symbols), start + 16 * len(symbols), len(names))
    head = struct.pack("<IIIIIIII", 0xFEEDFACF, 0x0100000C, 0, 6, 2, len(commands), 0, 0)
    table = b"".join(struct.pack("<IBBHQ", name, kind, 0, 0, 0) for name, kind in symbols)
    found = library.read(head + commands + table + names)
    assert found == ("arm64", {"PyInit__core"}, {"/usr/lib/libSystem.B.dylib"})


def test_what_is_no_library_is_refused():
    with pytest.raises(ValueError, match="expected ELF, PE or Mach-O"):
        library.read(b"a text")

"""Write the new names of keys, values and outcomes in place of old ones.

It changes configurations (TOML, whose comments and layout stay) and results (JSON, NetCDF, Parquet), in a folder all of
them. A flight is the same as before: its digest becomes that of the new names, with the files as they are now.
A key whose new place is another file is named, for its user to move.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jax_aero import rust
from jax_aero.base import keys, places
from jax_aero.base.arguments import Parser
from jax_aero.base.files import checksums, write_bytes, write_json, write_text
from jax_aero.base.renamed import MODES, OUTCOMES, VALUES, Key, new_key
from jax_aero.base.terminal import Refused, exit_status
from jax_aero.base.typed_config import make_paths_absolute

ROOTS: dict[str, Key] = {
    "control": ("controller",),
    "law": ("controller", "mpc"),
    "simulator": ("simulator",),
    "experiments": (),
    "sweeps": (),
    "axes": (),
}
"""Place in a flight of the tables of a folder's files."""

WORDS = OUTCOMES | MODES
RESULTS = (places.MANIFEST_FILE, places.SWEEP_FILE)
KINDS = {".toml", ".json", ".parquet"}

PART = r"""(?:[\w-]+|"[^"\n]*"|'[^'\n]*')"""
KEY = rf"{PART}(?:[ \t]*\.[ \t]*{PART})*"
TOKEN = re.compile(
    rf"^[ \t]*\[\[?[ \t]*(?P<header>{KEY})[ \t]*\]\]?(?=[ \t]*(?:#|$))|(?P<key>{KEY})(?=[ \t]*=)"
    r"|#[^\n]*|\"\"\"[\s\S]*?\"\"\"|'''[\s\S]*?'''"
    r"|(?P<text>\"(?:\\.|[^\"\\\n])*\"|'[^'\n]*')|(?P<opened>[\[{])|(?P<closed>[\]}])",
    re.MULTILINE,
)
"""Parts of a TOML text that are renamed, nest, or hide such parts."""


def toml(text: str, root: Key) -> tuple[str, list[str]]:
    """Return a TOML text with the new names, and what belongs in another file."""
    table = key = root
    outer: list[tuple[Key, Key]] = []
    moved: list[str] = []

    def change(part: re.Match[str]) -> str:
        nonlocal table, key
        if (written := part["header"]) and not outer:
            table = key = _place(written, root)
            return part[0].replace(written, _new_key(written, root, moved), 1)
        if written := part["key"]:
            key = _place(written, table)
            return _new_key(written, table, moved)
        if text := part["text"]:
            return f"{text[0]}{_new_text(_new(key), text[1:-1])}{text[0]}"
        if part["opened"]:
            outer.append((table, key))
            table = key
        elif part["closed"]:
            table, key = outer.pop()
        return part[0]

    return TOKEN.sub(change, text), moved


def _place(written: str, table: Key) -> Key:
    return (*table, *re.findall(r"[^\s.\"']+", written))


def _new_key(written: str, table: Key, moved: list[str]) -> str:
    """Return the new name of a key in a table; add it to `moved` if it belongs in another one."""
    old, new = _place(written, table), _new(_place(written, table))
    above = _new(table)
    if new[: len(above)] != above:
        moved.append(f"`{'.'.join(old)}` is `{'.'.join(new)}` now; expected it in the file of that table")
    elif new[len(above) :] != old[len(table) :]:
        quote = written[0] if written[0] in "\"'" else ""
        return f"{quote}{'.'.join(new[len(above) :])}{quote}"
    return written


def _split(key: Key) -> tuple[Key, Key]:
    """Return a key's parts up to the table `set` of a sweep, and those after it, which are the key of a flight."""
    start = key.index("set") + 1 if "set" in key else 0
    return key[:start], key[start:]


def _new(key: Key) -> Key:
    before, flight = _split(key)
    return (*before, *new_key(flight))


def _new_text(key: Key, text: str) -> str:
    """Return the new name of a text: the key of a flight, a value of a key, an outcome or a mode."""
    if key[-1:] in (("key",), ("keys",)):
        return ".".join(new_key(tuple(text.split("."))))
    return VALUES.get((".".join(_split(key)[1]), text)) or WORDS.get(text, text)


def said(value: Any, name: str = "") -> Any:
    """Return what a JSON file says, in its entry `name`, with the new names."""
    if isinstance(value, dict):
        if {"controller", "simulator"} <= value.keys():
            return flight(value)
        if "versions" in value:  # a manifest
            value = {"backend" if key == "engine" else key: part for key, part in value.items()}
        return {WORDS.get(key, key): said(part, key) for key, part in value.items()}
    if isinstance(value, list):
        return [said(part, name) for part in value]
    return _new_text((name,), value) if isinstance(value, str) else value


def flight(config: dict[str, Any]) -> dict[str, Any]:
    """Return the configuration of a flight with the new names."""
    renamed: dict[str, Any] = {}
    for old, value in keys.parts(config):
        if not (isinstance(value, Mapping) and value):
            new = new_key(tuple(old.split(".")))
            keys.set_key(renamed, ".".join(new), _new_text(new, value) if isinstance(value, str) else value)
    return renamed


def _change_result(path: Path) -> None:
    """Write a result's manifest anew, with the digest of the new names and the checksums of its files."""
    old = json.loads(path.read_text(encoding="utf-8"))
    document = said(old)
    if document == old:
        return
    if {"controller", "simulator"} <= (document.get("config") or {}).keys():
        document["config_digest"] = rust.config_digest(make_paths_absolute(document["config"]))
        _change_attributes(path.with_name(places.RUN_FILE), document)
    files = checksums(path.parent)
    for listed in (document, document.get("finished", {})):
        if "files" in listed:
            listed["files"] = {file: files[file] for file in listed["files"]}
    write_json(path, document)


def _change_attributes(path: Path, document: dict[str, Any]) -> None:
    """Write the attributes of a flight's dataset that its manifest states too."""
    import h5py

    with h5py.File(path, "r+") as file:
        if "engine" in file.attrs:
            del file.attrs["engine"]
        stated = {"outcome": "outcome", "backend": "backend", "config_hash": "config_digest"}
        for name, key in stated.items():
            file.attrs[name] = document[key]


def _change_table(path: Path) -> None:
    """Write columns and outcomes of a table anew."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    old = pq.read_table(path)
    table = old.rename_columns([WORDS.get(name, name) for name in old.column_names])
    if "outcome" in table.column_names:
        place, column = table.column_names.index("outcome"), table["outcome"]
        words = pa.array([WORDS.get(word, word) for word in column.to_pylist()], column.type)
        table = table.set_column(place, "outcome", words)
    if not table.equals(old):
        stream = io.BytesIO()
        pq.write_table(table, stream, compression="zstd")
        write_bytes(path, stream.getvalue())


def _root(path: Path, text: str) -> Key:
    """Return the place in a flight of a file's table: by the schema that it names, or else by its folder."""
    schema = re.match(r"#:schema .*?(\w+)\.schema\.json", text)
    folders = [schema[1]] if schema else [*reversed(path.resolve().parent.parts)]
    return next((ROOTS[part] for part in folders if part in ROOTS), ())


def _change(path: Path) -> list[str]:
    """Write a file anew; return what its user is to move."""
    if path.name in RESULTS:
        _change_result(path)
        return []
    if path.suffix.lower() == ".parquet":
        _change_table(path)
        return []
    text = path.read_text(encoding="utf-8")
    moved: list[str] = []
    if path.suffix.lower() == ".toml":
        rust.read_toml(path)  # refuses what cannot be read
        renamed, moved = toml(text, _root(path, text))
    else:
        renamed = re.sub(r'"(\w+)"', lambda found: f'"{WORDS.get(found[1], found[1])}"', text)
    if renamed != text:
        write_text(path, renamed)
    return [f"{path}: {one}" for one in moved]


def main(arguments: Sequence[str]) -> int:
    """Change the files; return the exit status."""
    parser = Parser("rename", __doc__)
    parser.add_argument("place", nargs="+", type=Path, help="a file, or a folder of them")
    given = parser.parse_args(arguments)

    def work() -> int:
        found = [file for place in given.place for file in (place.rglob("*") if place.is_dir() else [place])]
        found.sort(key=lambda file: (file.name in RESULTS, file))  # manifests have checksums of the other files
        left = [line for file in found if file.suffix.lower() in KINDS and file.is_file() for line in _change(file)]
        if left:
            raise Refused("\n".join(left))
        return 0

    return exit_status(work)

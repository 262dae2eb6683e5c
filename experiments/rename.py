"""Write the new names of keys, values and outcomes in place of old ones: `python -m experiments.rename PLACE ...`.

It changes configurations (TOML, whose comments and layout stay) and results (JSON, NetCDF, Parquet), in a folder all of
them. A flight is the same as before: its digest becomes that of the new names, with the files as they are now.
A key whose new place is another file is named, for its user to move.
"""

from __future__ import annotations

import argparse
import io
import json
import re
import sys
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from jax_aero import rust
from jax_aero.base import places
from jax_aero.base.files import checksums, write_bytes, write_json
from jax_aero.base.renamed import MODES, OUTCOMES, VALUES, Key, new_key
from jax_aero.base.terminal import Refused, exit_status

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

_TOKEN = re.compile(
    r'(?P<space>\s+|#[^\n]*)|(?P<text>"""[\s\S]*?"""|\'\'\'[\s\S]*?\'\'\'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\')'
    r"|(?P<sign>\[\[|\]\]|[\[\]{}=,.])|(?P<bare>[^\s#\"'\[\]{}=,.]+)"
)


class Token(NamedTuple):
    """A part of a TOML text."""

    kind: str
    text: str
    start: int
    end: int


class Change(NamedTuple):
    """A new text in place of a part of a file."""

    start: int
    end: int
    text: str


class Elsewhere(NamedTuple):
    """A key whose new place is another table."""

    old: str
    new: str


class _Toml:
    """Reads the keys of a TOML text with their places."""

    def __init__(self, text: str, root: Key) -> None:
        found = (Token(match.lastgroup or "", match[0], *match.span()) for match in _TOKEN.finditer(text))
        self.tokens = [token for token in found if token.kind != "space"]
        self.place, self.root, self.text = 0, root, text
        self.found: list[Change | Elsewhere] = []

    def read(self) -> list[Change | Elsewhere]:
        """Return what is to be changed."""
        table = self.root
        while token := self.peek():
            if token.text in ("[", "[["):
                self.place += 1
                table = self.key(self.root)
                self.place += 1
            else:
                self.entry(table)
        return self.found

    def peek(self) -> Token | None:
        return self.tokens[self.place] if self.place < len(self.tokens) else None

    def next(self) -> Token:
        self.place += 1
        return self.tokens[self.place - 1]

    def key(self, table: Key) -> Key:
        """Read a dotted key, and change it where it has a new name; return its old place."""
        first, parts = self.next(), []
        last = first
        parts.append(first)
        while (token := self.peek()) and token.text == ".":
            self.place += 1
            last = self.next()
            parts.append(last)
        names = [part.text.strip("\"'") for part in parts]
        if len(names) == 1 and "." in names[0]:  # a whole key as one text, as in the table `set` of a sweep
            old = tuple(names[0].split("."))
            if (new := new_key(old)) != old:
                self.found.append(Change(first.start, last.end, f'"{".".join(new)}"'))
            return old
        if "set" in table:
            table = ()
        old = (*table, *names)
        new, above = new_key(old), new_key(table)
        if new == old:
            return old
        if new[: len(above)] == above and new[len(above) :]:
            if (text := ".".join(new[len(above) :])) != ".".join(names):
                self.found.append(Change(first.start, last.end, text))
        else:
            self.found.append(Elsewhere(".".join(old), ".".join(new)))
        return old

    def entry(self, table: Key) -> None:
        key = self.key(table)
        self.place += 1  # the sign =
        self.value(key)

    def value(self, key: Key) -> None:
        token = self.next()
        if token.text == "{":
            while (part := self.peek()) and part.text != "}":
                self.place += 1 if part.text == "," else 0
                if part.text != ",":
                    self.entry(key)
            self.place += 1
        elif token.text in ("[", "[["):
            self.list_(key, 2 if token.text == "[[" else 1)
        elif token.kind == "text":
            if (new := _new_text(new_key(key), token.text[1:-1])) != token.text[1:-1]:
                self.found.append(Change(token.start + 1, token.end - 1, new))
        else:
            while (part := self.peek()) and part.text == "." and self.tokens[self.place - 1].end == part.start:
                self.place += 2  # a number

    def list_(self, key: Key, depth: int) -> None:
        while depth:
            part = self.peek()
            if part is None:
                return
            if part.text in ("]", "]]"):
                depth -= len(part.text)
                self.place += 1
            elif part.text in ("[", "[["):
                depth += len(part.text)
                self.place += 1
            elif part.text == ",":
                self.place += 1
            else:
                self.value(key)


def _new_text(key: Key, text: str) -> str:
    """Return the new name of a text: a value of a key, an outcome or a mode, or a key of a flight."""
    if new := VALUES.get((".".join(key), text)):
        return new
    if "." in text:
        return ".".join(new_key(tuple(text.split("."))))
    return WORDS.get(text, text)


def toml(text: str, root: Key) -> tuple[str, list[Elsewhere]]:
    """Return a TOML text with the new names, and what belongs in another file."""
    found = _Toml(text, root).read()
    for change in sorted((one for one in found if isinstance(one, Change)), reverse=True):
        after = text[change.end :]
        if aligned := re.match(r"([\]}\w .\"=]*?)( +)(?=#)", after):  # a comment keeps its column, if it can
            longer = len(change.text) - (change.end - change.start)
            after = aligned[1] + " " * max(len(aligned[2]) - longer, 1) + after[aligned.end() :]
        text = text[: change.start] + change.text + after
    return text, [one for one in found if isinstance(one, Elsewhere)]


def said(value: Any) -> Any:
    """Return what a JSON file says with the new names."""
    if isinstance(value, dict):
        if {"controller", "simulator"} <= value.keys():
            return flight(value)
        if "versions" in value:  # a manifest
            value = {"backend" if name == "engine" else name: part for name, part in value.items()}
        return {WORDS.get(name, name): said(part) for name, part in value.items()}
    if isinstance(value, list):
        return [said(part) for part in value]
    return _new_text((), value) if isinstance(value, str) else value


def flight(config: dict[str, Any]) -> dict[str, Any]:
    """Return the configuration of a flight with the new names."""
    renamed: dict[str, Any] = {}
    for old, value in _leaves(config):
        *tables, name = new = new_key(old)
        place = renamed
        for part in tables:
            place = place.setdefault(part, {})
        place[name] = _new_text(new, value) if isinstance(value, str) else value
    return renamed


def _leaves(value: dict[str, Any], above: Key = ()) -> Iterator[tuple[Key, Any]]:
    for name, part in value.items():
        if isinstance(part, dict) and part:
            yield from _leaves(part, (*above, name))
        else:
            yield (*above, name), part


def _result(folder: Path, name: str) -> None:
    """Write a result's manifest anew, with the digest of the new names and the checksums of its files."""
    path = folder / name
    old = json.loads(path.read_text(encoding="utf-8"))
    document = said(old)
    if document == old:
        return
    if {"controller", "simulator"} <= (document.get("config") or {}).keys():
        document["config_digest"] = rust.config_digest(_placed(document["config"]))
        _attributes(folder / places.RUN_FILE, document)
    files = checksums(folder)
    listed = [document, document.get("finished", {})]
    for table in listed:
        if "files" in table:
            table["files"] = {file: files[file] for file in table["files"]}
    write_json(path, document)


def _attributes(path: Path, document: dict[str, Any]) -> None:
    """Write the attributes of a flight's dataset that its manifest states too."""
    import h5py

    with h5py.File(path, "r+") as file:
        if "engine" in file.attrs:
            del file.attrs["engine"]
        stated = {"outcome": "outcome", "backend": "backend", "config_hash": "config_digest"}
        for name, key in stated.items():
            file.attrs[name] = document[key]


def _placed(value: Any) -> Any:
    """Return a configuration whose files have their places on this machine."""
    if isinstance(value, dict):
        return {key: _placed(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_placed(part) for part in value]
    if isinstance(value, str) and "/" in value and (places.HOME / value).is_file():
        return str(places.HOME / value)
    return value


def _root(path: Path, text: str) -> Key:
    """Return the place in a flight of a file's table: by the schema that it names, or else by its folder."""
    schema = re.match(r"#:schema .*?(\w+)\.schema\.json", text)
    folders = [schema[1]] if schema else [*reversed(path.resolve().parent.parts)]
    return next((ROOTS[part] for part in folders if part in ROOTS), ())


def _change(path: Path) -> list[str]:
    """Write a file anew; return what its user is to move."""
    if path.name in (places.MANIFEST_FILE, places.SWEEP_FILE):
        _result(path.parent, path.name)
    elif path.suffix == ".toml":
        text = path.read_text(encoding="utf-8")
        renamed, moved = toml(text, _root(path, text))
        if renamed != text:
            tomllib.loads(renamed)  # refuses what cannot be read
            write_bytes(path, renamed.encode())
        return [f"{path}: `{one.old}` is `{one.new}` now; expected it in the file of that table" for one in moved]
    elif path.suffix == ".json":
        text = path.read_text(encoding="utf-8")
        renamed = re.sub(r'"(\w+)"', lambda found: f'"{WORDS.get(found[1], found[1])}"', text)
        if renamed != text:
            write_bytes(path, renamed.encode())
    elif path.suffix == ".parquet":
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
    return []


KINDS = {".toml", ".json", ".parquet"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Change the files; return the exit status."""
    parser = argparse.ArgumentParser("python -m experiments.rename", description=__doc__)
    parser.add_argument("place", nargs="+", type=Path, help="a file, or a folder of them")
    given = parser.parse_args(arguments)

    def work() -> int:
        found = [file for place in given.place for file in (place.rglob("*") if place.is_dir() else [place])]
        # Manifests have checksums of the other files.
        found.sort(key=lambda file: (file.name in (places.MANIFEST_FILE, places.SWEEP_FILE), file))
        left = [line for file in found if file.suffix in KINDS and file.is_file() for line in _change(file)]
        if left:
            raise Refused("\n".join(left))
        return 0

    return exit_status(work)


if __name__ == "__main__":
    sys.exit(main())

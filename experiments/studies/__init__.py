"""Studies: questions beyond single flights, each in a folder of its own, found by the folder's name.

    NAME/study.py     a `Study` (`experiments.study`), and `main`, which reads the command line: `jax-aero study NAME`
    NAME/figure.py    optional: `FIGURES`, drawn by `jax-aero figures`
    NAME/*.toml       optional: configurations by name, with `schema.json` for editors
    NAME/README.md    what it asks, and what was found: a page of the site, with its pictures beside it

Nothing else names a study, except the table of the paper, which leaves out those whose folders are not there.
"""

from __future__ import annotations

import ast
import importlib
from collections.abc import Sequence
from pathlib import Path

from jax_aero.cli import Parser, complete_with

FOLDER = Path(__file__).parent


def names() -> list[str]:
    """Return the names of all studies."""
    return sorted(path.parent.name for path in FOLDER.glob("*/study.py"))


def about(name: str) -> str:
    """Return the first line of a study's description, without an import of what it needs."""
    text = ast.get_docstring(ast.parse((FOLDER / name / "study.py").read_text(encoding="utf-8"))) or ""
    return text.split("\n", 1)[0]


def main(words: Sequence[str]) -> int:
    """Run a study, or list all."""
    if words and (name := words[0].replace("-", "_")) in names():
        return int(importlib.import_module(f"experiments.studies.{name}.study").main(words[1:]) or 0)
    width = max(map(len, names()), default=0)
    listed = "\n".join(f"  {name:<{width}}  {about(name)}" for name in names())
    parser = Parser("study", f"Answer a question beyond single flights.\n\n{listed}")
    named = parser.add_argument("name", nargs="?", choices=names(), metavar="NAME", help="jax-aero study NAME --help")
    complete_with(named, names)
    parser.parse_args(words)
    print(listed)
    return 0

"""Run a study of `experiments/studies`, or list all."""

from __future__ import annotations

import ast
from collections.abc import Sequence

from jax_aero.base import checkout, places
from jax_aero.base.arguments import Parser, complete_with

FOLDER = places.STUDIES


def names() -> list[str]:
    """Return the names of all studies."""
    return sorted(path.parent.name for path in FOLDER.glob("*/study.py"))


def about(name: str) -> str:
    """Return the first line of a study's description, without an import of what it needs."""
    text = ast.get_docstring(ast.parse((FOLDER / name / "study.py").read_text(encoding="utf-8"))) or ""
    return text.split("\n", 1)[0]


def main(words: Sequence[str]) -> int:
    """Run a study, or list all."""
    checkout.require()
    if words and (name := words[0].replace("-", "_")) in names():
        return int(checkout.load(f"experiments.studies.{name}.study").main(words[1:]) or 0)
    width = max(map(len, names()), default=0)
    listed = "\n".join(f"  {name:<{width}}  {about(name)}" for name in names())
    parser = Parser("study", f"Answer a question beyond single flights.\n\n{listed}")
    named = parser.add_argument("name", nargs="?", choices=names(), metavar="NAME", help="jax-aero study NAME --help")
    complete_with(named, names)
    parser.parse_args(words)
    print(listed)
    return 0

"""Write every committed file that follows from others: `python -m experiments.tools.generated`, or `make generated`.

Schemas and Python types follow from the types of the configuration, tables in pages from what they name.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from experiments.report import blocks
from experiments.tools import config_types, schema
from jax_aero.base import places
from jax_aero.base.terminal import REFUSED


def main(arguments: Sequence[str] | None = None) -> int:
    """Write what is outdated; return the exit status."""
    argparse.ArgumentParser("python -m experiments.tools.generated", description=__doc__).parse_args(arguments)
    if not places.IS_CHECKOUT:
        print("error: files of a checkout of the repository are generated, and this is none", file=sys.stderr)
        return REFUSED
    made = files()
    for path in outdated(made):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(made[path], encoding="utf-8")
        print(path.relative_to(places.HOME))
    return 0


def files() -> dict[Path, str]:
    """Return the text of every generated file."""
    return schema.files() | config_types.files() | blocks.files()


def outdated(made: dict[Path, str]) -> list[Path]:
    """Return the files that are not there or have another text."""
    return [path for path, text in made.items() if not path.is_file() or path.read_text(encoding="utf-8") != text]


if __name__ == "__main__":
    sys.exit(main())

"""A study whose folder has been deleted takes its tests with it."""

from pathlib import Path

from jax_aero.commands import study as studies

collect_ignore = [
    path.name
    for path in Path(__file__).parent.glob("test_*.py")
    if path.stem.removeprefix("test_") not in studies.names()
]

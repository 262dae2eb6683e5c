"""Modules of the packages use one another in one direction: there is no cycle."""

from __future__ import annotations

from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

Graph = dict[str, set[str]]


def cycle(graph: Graph) -> list[str]:
    """Return the modules of a cycle; none if there is no cycle."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def test_modules_of_the_packages_have_no_cycle():
    grimp = pytest.importorskip("grimp", reason="import-linter is not installed: make setup")
    packages = ("jax_aero", "experiments", "paper_figs")
    imports = grimp.build_graph(*packages, exclude_type_checking_imports=True, cache_dir=None)
    graph = {module: imports.find_modules_directly_imported_by(module) for module in imports.modules}
    assert len(graph) > 200
    assert cycle(graph) == []

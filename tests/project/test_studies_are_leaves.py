"""A study can be deleted: in a copy without its folder everything that names studies still works."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from experiments import studies

ROOT = Path(__file__).resolve().parents[2]

# What names studies: the list of commands, figures, the page and the claims of the paper, the schemas, the tests.
PROBE = """
import sys
from jax_aero import cli
from experiments import schema, studies
from experiments.report import index, paper
from paper_figs.figures import FIGURES

gone = sys.argv[1]
assert gone not in studies.names()
assert cli.main(["study"]) == 0
try:
    cli.main(["study", gone])
except SystemExit as ended:
    assert ended.code == cli.REFUSED
shown = {item.figure for item in paper.all_items()}
assert shown - {""} <= {*FIGURES, *paper.SWEEPS}
assert gone not in {entry.kind for entry in FIGURES.values()}
assert f"study {gone}" not in index.page()
assert not any(gone in path.parts for path in schema.files())
"""


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of what is tracked, with the compiled module."""
    folder = tmp_path_factory.mktemp("copy")
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    )
    modules = [str(path.relative_to(ROOT)) for path in (ROOT / "jax_aero").glob("_core*.so")]
    for name in [*listed.stdout.decode().split("\0"), *modules]:
        if name and (ROOT / name).exists():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name, follow_symlinks=False)
    return folder


def test_tests_of_studies_stand_where_they_go_with_their_study():
    others = [path for path in (ROOT / "tests").rglob("*.py") if path.parent != ROOT / "tests" / "studies"]
    imported = re.compile(r"^\s*(from|import) experiments\.studies\.", re.MULTILINE)
    assert [path.name for path in others if imported.search(path.read_text(encoding="utf-8"))] == []


@pytest.mark.parametrize("name", studies.names())
def test_without_a_study_nothing_is_missing(copy, name, tmp_path):
    folder = copy / "experiments" / "studies" / name
    folder.rename(tmp_path / name)
    try:
        environment = os.environ | {"PYTHONPATH": str(copy)}
        ended = subprocess.run(
            [sys.executable, "-c", PROBE, name], cwd=copy, env=environment, capture_output=True, text=True, timeout=300
        )
        assert ended.returncode == 0, ended.stderr
    finally:
        (tmp_path / name).rename(folder)

"""Programs of `docs/examples`: they run as they stand, fit on a screen, and the page lists each."""

import subprocess
import sys

import pytest

from tests.project.test_docs import DOCS, ROOT

LONG = {"air_cost"}
"""Programs that measure for minutes."""
PROGRAMS = {path.stem: path for path in sorted((DOCS / "examples").glob("*.py"))}


def test_the_page_lists_every_program():
    page = (DOCS / "examples.md").read_text(encoding="utf-8")
    assert [name for name in PROGRAMS if f"(examples/{name}.py)" not in page] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(PROGRAMS.keys() - LONG))
def test_an_example_runs_and_is_short(name):
    assert len(PROGRAMS[name].read_text(encoding="utf-8").splitlines()) <= 30
    command = [sys.executable, "-W", "error", str(PROGRAMS[name])]
    answer = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=600)
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout

"""Studies can be deleted: in a copy without the folder of one, or of all, everything that names studies still works."""

from __future__ import annotations

import ast
import importlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from experiments import studies
from paper_figs.figures import OURS

ROOT = Path(__file__).resolve().parents[2]

# In a copy, without each study and without all: what names studies is the list of commands, figures, the page and the
# claims of the paper, the schemas, and the documents. That a page names no study but its own is a test of documents.
PROGRAM = """
import importlib, sys
from pathlib import Path


def probe(missing):
    from jax_aero import cli
    from experiments import schema, studies
    from experiments.report import command, paper
    from paper_figs.figures import FIGURES

    assert missing.isdisjoint(studies.names())
    assert cli.main(["study"]) == 0
    for gone in missing:
        try:
            cli.main(["study", gone])
        except SystemExit as ended:
            assert ended.code == cli.REFUSED
    shown = {item.figure for item in paper.all_items()}
    assert shown - {""} <= {*FIGURES, *paper.SWEEPS}
    assert missing.isdisjoint(entry.kind for entry in FIGURES.values())
    page = command.index()
    assert not any(f"study {gone}" in page for gone in missing)
    assert not any(missing.intersection(path.parts) for path in schema.files())


def probe_documents():
    from tests.project import test_docs, test_recipes

    for page in test_docs.PAGES:
        test_recipes.test_shown_commands_name_what_exists(page)
    test_docs.test_links_of_generated_pages_lead_to_pages_and_pictures()


folder, aside = Path("experiments/studies"), Path(sys.argv[1])
every = {path.parent.name for path in folder.glob("*/study.py")}
for missing in [*({name} for name in sorted(every)), every]:
    print("without", *sorted(missing), file=sys.stderr)
    for name in missing:
        (folder / name).rename(aside / name)
    for name in [name for name in sys.modules if name.split(".")[0] in ("experiments", "paper_figs")]:
        del sys.modules[name]  # imported again without the study; packages of others stay
    importlib.invalidate_caches()
    probe(missing)
    if missing == every:
        probe_documents()
    for name in missing:
        (aside / name).rename(folder / name)
"""


@pytest.fixture
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


def test_results_and_figures_of_a_study_have_the_name_of_its_folder():
    """A copied folder whose name is not put in would take another study's configurations, results or figures."""
    drawn = dict(OURS)
    for name in studies.names():
        calls = [node for node in ast.walk(ast.parse(_read(name, "study.py"))) if isinstance(node, ast.Call)]
        kinds = [ast.literal_eval(call.args[0]) for call in calls if ast.unparse(call.func) == "Study"]
        assert kinds in ([], [name])
        assert _read(name, "README.md").startswith(f"# {name}\n")
        if (studies.FOLDER / name / "figure.py").is_file():
            figures = importlib.import_module(f"experiments.studies.{name}.figure").FIGURES
            assert {entry.kind for entry in figures.values()} == {name}
            assert figures.keys().isdisjoint(drawn)
            drawn |= figures


def _read(name: str, file: str) -> str:
    return (studies.FOLDER / name / file).read_text(encoding="utf-8")


def test_without_studies_nothing_is_missing(copy, tmp_path):
    environment = os.environ | {"PYTHONPATH": str(copy)}
    command = [sys.executable, "-c", PROGRAM, str(tmp_path)]
    ended = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, timeout=300)
    assert ended.returncode == 0, ended.stderr

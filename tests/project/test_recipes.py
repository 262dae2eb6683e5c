"""Recipes: the blocks of a page run as they stand, one after the other, in a copy of the repository of its own.

A comment before a block says how it is tried: `<!-- test: run -->`; `file PATH`, which later blocks use; `part` of a
program or file, `part of FOLDER` of a file in that folder of `configs`; `not run, REASON`. Rust, C and CMake are parts
of programs that the crates' tests run.
"""

import ast
import importlib.util
import itertools
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from experiments.report import blocks as tables_of_pages
from experiments.tools import schema
from jax_aero import cli, rust
from jax_aero.base import places, tables
from jax_aero.base.keys import parse_assignments
from jax_aero.commands import study as studies
from jax_aero.figures.catalogue import FIGURES
from jax_aero.sweep import spec
from jax_aero.sweep.design import Design
from tests.project.test_docs import FENCE, ROOT, name

PAGES = tables_of_pages.pages()
PROGRAM = r"rust/(sim/examples/tutorial\.rs|capi/examples/((loop|realtime)\.c|hover\.cpp|CMakeLists\.txt))"
HOW = {
    **dict.fromkeys(("rust", "c", "cpp", "cmake", "math", "text", "bibtex"), ""),
    "sh": "run|not run, .+",
    "python": "run|part|file .+|not run, .+",
    "toml": r"part( of \w+)?|file .+",
}
COPIED = ("jax_aero", "configs", "experiments", "paper_figs", "docs")
LINKED = ("rust", "target", "tests", "Cargo.toml", "Cargo.lock")
SCHEMAS = rust.schemas() | {name: tables.schema(kind) for name, kind in schema.TYPES.items()}
"""Schemas of the files of `configs`, by folder."""
SHIPPED_CARD = "configs/aero/networks/default.json"
SLOWEST = 1800
"""Longest time of a page's recipes [s]."""

RUN = """
import json, subprocess, sys
from pathlib import Path

names = {"__name__": "__main__"}
for how, language, code in json.load(sys.stdin):
    if how.startswith("file "):
        path = Path(how.removeprefix("file "))
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(code, encoding="utf-8")
    elif language == "python":
        exec(compile(code, "page", "exec"), names)
    else:
        subprocess.run(["bash", "-euo", "pipefail", "-c", code], check=True)
"""


def blocks(page: Path) -> list[tuple[str, str, str]]:
    """How it is tried, language and code of the blocks of a page."""
    found = FENCE.finditer(page.read_text(encoding="utf-8"))
    return [(block["how"] or "", block["language"], block["code"]) for block in found]


def tried(page: Path) -> list[tuple[str, str, str]]:
    return [block for block in blocks(page) if block[0] == "run" or block[0].startswith("file ")]


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_block_says_how_it_is_tried(page):
    assert 2 * len(blocks(page)) == len(re.findall("^```", page.read_text(encoding="utf-8"), re.M))
    for how, language, code in blocks(page):
        assert re.fullmatch(HOW[language], how), code
        if language in {"rust", "c", "cpp", "cmake"}:
            assert re.fullmatch(rf'--8<-- "{PROGRAM}(:\w+)?"\n', code)
        elif language == "toml" and how.startswith("part"):
            shown, folder = tomllib.loads(code), how.removeprefix("part").removeprefix(" of ")
            if folder:
                rust.check_table(shown, schema.allow_parts(SCHEMAS[folder]), places.CONFIGS / folder)
        elif language == "python":
            imports = [node for node in ast.parse(code).body if isinstance(node, ast.ImportFrom)]
            if how == "part":
                exec(compile(ast.Module(imports, []), page.name, "exec"), {})


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if tried(page)], ids=name)
def test_the_recipes_of_a_page_run(page, tmp_path):
    clone = tmp_path / "jax-aero"
    for folder in COPIED:
        shutil.copytree(ROOT / folder, clone / folder, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    (ROOT / "target").mkdir(exist_ok=True)
    for path in LINKED:
        (clone / path).symlink_to(ROOT / path)
    (cargo := tmp_path / "bin" / "cargo").parent.mkdir()
    cargo.write_text(f'#!/bin/sh\ncd {shlex.quote(str(ROOT))} && exec {shutil.which("cargo")} "$@"\n')  # builds once
    cargo.chmod(0o755)
    path = f"{cargo.parent}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    environment = {**os.environ, "PYTHONPATH": str(clone), "PATH": path}
    answer = subprocess.run(
        [sys.executable, "-W", "error", "-c", RUN],
        input=json.dumps(tried(page)), cwd=clone, env=environment, capture_output=True, text=True, check=False,
        timeout=SLOWEST,
    )  # fmt: skip
    assert answer.returncode == 0, answer.stdout + answer.stderr
    for how, _, _ in tried(page):
        path = clone / how.removeprefix("file ")
        if path.match("configs/experiments/*.toml"):
            rust.load_config(path)
        elif path.match("configs/sweeps/*.toml"):
            Design(spec.load(str(path))).check()
        elif path.name == "Cargo.toml":
            (path.parent / "src").mkdir()
            (path.parent / "src/main.rs").write_text("fn main() {}\n")
            shutil.copy(ROOT / "Cargo.lock", path.parent)
            command = ["cargo", "metadata", "--offline", "--format-version=1", f"--manifest-path={path}"]
            subprocess.run(command, check=True, capture_output=True)


def shown_commands(text: str) -> list[list[str]]:
    """Words of the commands in shell blocks and within sentences."""
    spans = re.findall(r"`((?:jax-aero|make|python) [^`]+)`", FENCE.sub("", text))
    lines = [command for span in spans for command in span.split("; ")]
    for block in FENCE.finditer(text):
        if block["language"] == "sh":
            lines += block["code"].replace("\\\n", "").splitlines()
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def check_flights(names: list[str], options: list[str], text: str) -> None:
    """Experiments exist, or the page makes them, and `--set` names keys and values that they can have.

    A shipped card stands for one that a command of the page writes to `results`.
    """
    values = [value for option, value in itertools.pairwise(options) if option == "--set"]
    changes = parse_assignments([re.sub(r"results/[\w/]+\.json", SHIPPED_CARD, value) for value in values])
    for flown in names:
        if flown in places.names("experiments"):
            rust.load_config(flown, changes)
        else:
            assert flown.endswith(".toml") or f"`configs/experiments/{flown}.toml`" in text


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_shown_commands_name_what_exists(page):
    text = page.read_text(encoding="utf-8")
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    sweeps = {*places.names("sweeps"), *re.findall(r"configs/sweeps/(\w+)\.toml", text)}
    for program, first, *words in (words for words in shown_commands(text) if len(words) > 1):
        names = list(itertools.takewhile(lambda word: word.islower() and not word.startswith("-"), words))
        options = words[len(names) :]
        if program == "make":
            assert f"\n{first}:" in makefile, words
        elif program == "python":
            assert importlib.util.find_spec(words[0]) if first == "-m" else (ROOT / first).is_file(), words
        elif program == "jax-aero":
            assert first in {*cli.COMMANDS, "--help"}, first
            if first == "fly" and options[:2] != ["NAME", "--set"]:
                check_flights(names, options, text)
            elif first == "figures":
                assert {*names} <= {*FIGURES, *sweeps, "all"}, names
            elif first == "sweep":
                assert {*names} <= sweeps, names
            elif first == "study" and words and words[0].islower():
                assert words[0] in studies.names(), words
        else:
            assert all(any(ROOT.glob(word)) for word in words if word.startswith(("rust/", "configs/"))), words


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_a_page_shows_no_command_of_another_study(page):
    """A study can be deleted with its folder: pages link its page, and the link goes with it.

    A kept result says what made it, also once its study is gone.
    """
    others = {name for name in studies.names() if studies.FOLDER / name != page.parent}
    figures = {figure for figure, entry in FIGURES.items() if entry.kind in others}
    text = page.read_text(encoding="utf-8")
    for words in shown_commands(text):
        if words[:2] in (["jax-aero", "study"], ["jax-aero", "figures"]):
            assert {*words[2:]}.isdisjoint(others | figures), words

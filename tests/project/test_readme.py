"""What the README shows, runs. A comment `<!-- test: KIND -->` before a code block says how it is tried."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from jax_aero import rust
from tests.shown import run_in_own_folder

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"<!-- test: (?P<kind>[\w-]+) -->\n```(?P<language>\w+)\n(?P<code>.*?)```", re.DOTALL)


def blocks(kind: str, language: str) -> list[str]:
    return [m["code"] for m in BLOCK.finditer(README) if (m["kind"], m["language"]) == (kind, language)]


def run(command: list[str], **variables: str) -> str:
    """Run a command in the repository, as a reader with this environment active would."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("MAKE")}
    environment |= {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}", **variables}
    answer = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=600
    )
    assert answer.returncode == 0, answer.stdout + answer.stderr
    return answer.stdout


def test_every_code_block_is_tried_somehow():
    tried = len(BLOCK.findall(README))
    assert tried == len(re.findall(r"^```\w+$", README, re.MULTILINE))
    assert tried == sum(
        len(blocks(*how)) for how in (("run", "sh"), ("run", "python"), ("dry-run", "sh"), ("config", "toml"))
    )


@pytest.mark.parametrize("code", blocks("run", "sh"))
def test_commands_run(code, tmp_path):
    run(["bash", "-euo", "pipefail", "-c", run_in_own_folder(code)], OUT=str(tmp_path))
    assert list(tmp_path.glob("*/manifest.json"))


@pytest.mark.parametrize("code", blocks("run", "python"))
def test_python_runs(code):
    run([sys.executable, "-W", "error", "-c", code])


@pytest.mark.parametrize("code", blocks("dry-run", "sh"))
def test_make_targets_exist(code):
    """Running `make test` in a test would never end, so make only says what it would do."""
    for line in code.splitlines():
        if line == "source .venv/bin/activate":
            continue
        assert line.startswith("make ")
        run(["make", "-n", *line.split()[1:]])


@pytest.mark.parametrize("code", blocks("config", "toml"))
def test_the_example_configuration_can_fly(code, tmp_path):
    path = shutil.copytree(ROOT / "configs", tmp_path / "configs") / "experiments" / "half.toml"
    path.write_text(code, encoding="utf-8")
    config = rust.load_config(path)
    assert config["title"] == tomllib.loads(code)["title"]
    assert config["disturbances"]["aero_estimate"]["scale"] == 0.5


def test_links_and_folders_exist():
    linked = re.findall(r"\]\((?!http)([^)#]+)\)", README)
    table = re.findall(r"^\| (`[^|]+`) \|", README.split("## What lies where")[1], re.MULTILINE)
    folders = [folder for row in table for folder in re.findall(r"`([^`]+)`", row)]
    assert folders
    for path in [*linked, *folders]:
        assert any(ROOT.glob(path)), path

"""What is skipped on a machine that lacks something is said at the end, with the command that brings it."""

import ast
import re
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parents[1]

COMMAND = r".+: (apt-get|make|pip|rustup|git|sudo) .+"


def reasons():
    """Every reason for which a test is skipped, if it is a text."""
    for path in TESTS.rglob("*.py"):
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            name = ast.unparse(call.func).rpartition(".")[2] if isinstance(call, ast.Call) else ""
            if name in ("importorskip", "skipif"):
                yield from (ast.unparse(word.value) for word in call.keywords if word.arg == "reason")
                assert "reason" in {word.arg for word in call.keywords}, f"{path.name}: {ast.unparse(call)}"
            elif name == "skip":
                yield ast.unparse(call.args[0])


def test_every_reason_has_a_command():
    found = [reason for reason in reasons() if reason[0] in "'\""]
    assert len(found) > 30
    assert [reason for reason in found if not re.fullmatch(COMMAND, ast.literal_eval(reason))] == []


def test_what_was_skipped_is_the_last_line(tmp_path):
    (tmp_path / "test_some.py").write_text(
        "import pytest\n\n"
        '@pytest.mark.skipif(True, reason="no wind: make wind")\n@pytest.mark.parametrize("k", [1, 2])\n'
        'def test_wind(k): ...\n\n\ndef test_rain():\n    pytest.importorskip("rain", reason="no rain: make rain")\n'
    )
    words = ["-q", "-n", "0", "-p", "tests.conftest", "-c", TESTS.parent / "pyproject.toml", "--rootdir", tmp_path]
    run = subprocess.run(
        [sys.executable, "-m", "pytest", *words, tmp_path], cwd=TESTS.parent, capture_output=True, text=True
    )
    assert run.stdout.splitlines()[-1] == "3 skipped: 2 × no wind: make wind; 1 × no rain: make rain", run.stdout

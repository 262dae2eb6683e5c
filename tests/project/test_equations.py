"""docs/equations.md names files and symbols that exist."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/equations.md").read_text()
ROWS = [line for line in PAGE.splitlines() if line.startswith("| ") and not line.startswith("| what")]


def test_every_file_and_symbol_exists():
    checked = 0
    for row in ROWS:
        file: Path | None = None
        for word in re.findall(r"`([^`]+)`", row):
            if "/" in word:
                file = ROOT / word
                assert file.is_file(), f"{word} in {row}"
                continue
            assert file is not None, row
            assert re.search(rf"\b{re.escape(word)}\b", file.read_text()), f"{word} is not in {file.name}"
            checked += 1
    assert checked > 20

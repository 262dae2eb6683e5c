"""Answers of the finished jobs of an interrupted study, one a line of a file beside its result."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

from experiments.identity import Identity


class Progress:
    """Finished jobs of one identity; others in the file are neither used nor removed."""

    def __init__(self, path: Path, identity: Identity) -> None:
        self.path, self.mark = path, str(identity)
        self.done: dict[str, Any] = {}
        """Answers by job."""
        for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
            with suppress(ValueError):  # of a line that was written in part
                mark, job, answer = json.loads(line)
                if mark == self.mark:
                    self.done[job] = answer

    def add(self, job: str, answer: Any) -> None:
        """Keep the answer of a job, as JSON."""
        self.done[job] = answer
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a", encoding="utf-8") as file:
            file.write(f"\n{json.dumps([self.mark, job, answer])}")

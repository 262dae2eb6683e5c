"""Unfinished work: answers of finished jobs, with which an interrupted command goes on where it stopped.

They are files of a folder beside the result, `.NAME.work/`, which is removed when the result is written. Each is
written completely or not at all, and sealed with the job and with what the work is of: one that is damaged, of another
job, or of another identity does not count, and is made again. Work of several identities lies side by side.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jax_aero.base import places
from jax_aero.base.files import resolve, seal, unseal, write_bytes
from jax_aero.results.identity import Identity


@dataclass(frozen=True)
class Work:
    """Answers of jobs, by name; whoever uses it holds the lock of the result (`files.lock_work`)."""

    folder: Path
    """Folder of all work on the result."""
    of: str
    """What this work is of."""

    @classmethod
    def on(cls, result: Path, identity: Identity) -> Work:
        """Return the work on the result of a folder."""
        target = resolve(result)
        return cls(target.with_name(f".{target.name}.work"), str(identity))

    def narrowed(self, identity: Identity) -> Work:
        """Return the part of the work that is of this identity too."""
        return replace(self, of=f"{self.of} {identity}")

    def path(self, job: str) -> Path:
        """Return the file of a job."""
        mark = hashlib.sha256(self.of.encode()).hexdigest()[:12]
        return self.folder / mark / f"{places.file_name(job)}.part"

    def jobs(self) -> list[str]:
        """Return the names of the jobs that have a file."""
        return sorted(path.stem for path in self.path("").parent.glob("*.part"))

    def seal_of(self, job: str) -> str:
        """Return what the file of a job is sealed with."""
        return f"{self.of} {job}"

    def read(self, job: str) -> bytes | None:
        """Return the answer of a job; `None` if it is not there or does not count."""
        path = self.path(job)
        if not path.is_file():
            return None
        answer = unseal(path.read_bytes(), self.seal_of(job))
        if answer is None:
            print(f"{path.name} is damaged, and made again", file=sys.stderr)
            path.unlink()
        return answer

    def write(self, job: str, answer: bytes) -> None:
        """Keep the answer of a job."""
        write_bytes(self.path(job), seal(answer, self.seal_of(job)))

    def read_json(self, job: str) -> Any:
        """Return an answer kept by `write_json`; `None` if it does not count."""
        answer = self.read(job)
        return None if answer is None else json.loads(answer)

    def write_json(self, job: str, answer: Any) -> None:
        """Keep an answer that is JSON, other than null; NaN and infinity are kept too."""
        self.write(job, json.dumps(answer).encode())

    def clear(self) -> None:
        """Remove all work on the result."""
        shutil.rmtree(self.folder, ignore_errors=True)

"""A job of a cluster whose process is killed at its first attempt; the nodes import it."""

from __future__ import annotations

import os
import signal
from pathlib import Path

KILLED_JOB = 3
"""Job at whose first attempt the process is killed."""


def attempt(folder: Path, job: int) -> int:
    """Add a line to the job's file, and return its square."""
    with (folder / str(job)).open("a") as file:
        file.write(f"{os.getpid()}\n")
    if job == KILLED_JOB and len((folder / str(job)).read_text().splitlines()) == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return job * job

"""OpenFOAM as an external program: detection, execution, and reading of its output."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jax_aero.aero.dataset import Floats
from jax_aero.base.terminal import Refused

PROGRAMS = ("blockMesh", "snappyHexMesh", "checkMesh", "simpleFoam")
DEBIAN = Path("/usr/share/openfoam")
"""Folder of Debian's package that corresponds to WM_PROJECT_DIR elsewhere."""
MISSING = "OpenFOAM is not here (no `{}` on the path); install it with: apt-get install openfoam"


STOPPED = (signal.SIGINT, signal.SIGKILL, signal.SIGTERM)
"""Signals by which a program is stopped from outside, which is not a result of the flow."""


TAPS = "_taps"
"""Ending of the report of a link's pressures."""


class Failed(Exception):
    """A program ended with an error; the message contains its last output."""


def environment() -> dict[str, str]:
    """Return the environment variables of OpenFOAM's programs; refuse if OpenFOAM is not installed."""
    for program in PROGRAMS:
        if shutil.which(program) is None:
            raise Refused(MISSING.format(program))
    variables = dict(os.environ)
    if "WM_PROJECT_DIR" not in variables and DEBIAN.is_dir():
        variables["WM_PROJECT_DIR"] = str(DEBIAN)
    # Without these, Open MPI refuses to run as root in a container.
    return variables | {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1", "FOAM_SIGFPE": "false"}


def run(command: list[str], folder: Path, ranks: int = 1) -> str:
    """Run one program in the folder of a case; return its output.

    Raises
    ------
    Failed
        If the program ends with an error.
    Refused
        If it is interrupted.
    """
    words = command
    if ranks > 1:
        words = ["mpirun", "--oversubscribe", "-np", str(ranks), *command, "-parallel"]
    answer = subprocess.run(
        words, cwd=folder, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False
    )
    said = answer.stdout.decode(errors="replace")
    # A negative status is a signal; a shell or MPI reports 128 plus the signal.
    if any(answer.returncode in (-number, 128 + number) for number in STOPPED):
        raise Refused(f"{command[0]} was ended by a signal; the same command goes on with this case")
    if answer.returncode:
        raise Failed(f"{command[0]} ended with status {answer.returncode}: {' '.join(said.split()[-30:])}")
    return said


class MeshFacts(NamedTuple):
    """Properties of a mesh."""

    cells: int
    regions: int
    finest_cells: int
    """Number of cells of the highest level."""
    finest_level: int
    max_non_orthogonality: float
    """Greatest non-orthogonality [deg]."""
    max_skewness: float
    seconds: float
    """Meshing time [s]."""
    release: float
    """OpenFOAM's release, such as 1912; 0 if unknown."""


def mesh_facts(mesher: str, checker: str, seconds: float) -> MeshFacts:
    """Read the output of `snappyHexMesh` and `checkMesh`."""
    tables = re.findall(r"Cells per refinement level:\s*((?:\s*\d+\s+\d+\n)+)", mesher)
    if not tables:
        raise Failed("snappyHexMesh printed no table of its refinement levels")
    levels = [tuple(map(int, line.split())) for line in tables[-1].strip().splitlines()]
    level, count = max(pair for pair in levels if pair[1] > 0)
    return MeshFacts(
        cells=int(_find_text(r"\bcells:\s*(\d+)", checker) or 0),
        regions=int(_find_text(r"Number of regions:\s*(\d+)", checker) or 0),
        finest_cells=count,
        finest_level=level,
        max_non_orthogonality=float(_find_text(r"non-orthogonality Max:\s*(\S+)", checker) or np.nan),
        max_skewness=float(_find_text(r"Max skewness = ([^\s,]+)", checker) or np.nan),
        seconds=seconds,
        release=float(_find_text(r"OPENFOAM=(\d+)", mesher) or 0.0),
    )


class History(NamedTuple):
    """Forces on one link over the iterations of the solver; S samples, base axes."""

    iteration: Floats
    """(S,)"""
    pressure: Floats
    """(S, 3) pressure force [N]."""
    viscous: Floats
    """(S, 3) friction force [N]."""
    couple: Floats
    """(S, 3) moment about the link's centre [N m]."""

    @property
    def force(self) -> Floats:
        """(S, 3) total force [N]."""
        total: Floats = self.pressure + self.viscous
        return total


def read_histories(folder: Path, links: Mapping[str, object]) -> dict[str, History]:
    """Read the forces on every link, over all restarts of the solver."""
    histories = {}
    for name in links:
        starts = sorted((folder / "postProcessing" / name).iterdir(), key=lambda path: float(path.name))
        force = np.concatenate([_numbers(start / "force.dat") for start in starts])
        moment = np.concatenate([_numbers(start / "moment.dat") for start in starts])
        # Columns: time, then total, pressure part and viscous part.
        histories[name] = History(force[:, 0], force[:, 4:7], force[:, 7:10], moment[:, 1:4])
    return histories


def _numbers(path: Path) -> Floats:
    text = path.read_text(encoding="utf-8").replace("(", " ").replace(")", " ")
    rows = [line.split() for line in text.splitlines() if line and not line.startswith("#")]
    return np.array(rows, dtype=np.float64)


def read_y_plus(folder: Path) -> tuple[float, float]:
    """Return the mean over the links and the maximum of y+ in the wall's cells."""
    path = _last(folder / "postProcessing" / "yPlus") / "yPlus.dat"
    rows = [line.split() for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    values = np.array([row[2:] for row in rows if len(row) >= 5], dtype=np.float64)
    return float(values[:, 2].mean()), float(values[:, 1].max())


def read_taps(folder: Path, link: str) -> Floats:
    """Return the mean kinematic pressures (T,) [m²/s²] of a link's taps over the last window of the solver."""
    pressures: Floats = _numbers(_last(folder / "postProcessing" / f"{link}{TAPS}") / "p")[:, 1:].mean(axis=0)
    return pressures


def _last(report: Path) -> Path:
    """Return the folder of the last restart of a report."""
    return max(report.iterdir(), key=lambda path: float(path.name))


def last_residual(solver: str, field: str) -> float:
    """Return the initial residual of a field in the last printed iteration."""
    residuals = re.findall(rf"Solving for {field}, Initial residual = ([^\s,]+)", solver)
    return float(residuals[-1]) if residuals else float("nan")


def _find_text(pattern: str, text: str) -> str | None:
    match = re.search(pattern, text)
    return match.group(1) if match else None

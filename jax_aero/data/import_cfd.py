"""Convert free-stream simulations into a dataset of this project: `jax-aero data import-cfd --table FILE`.

The public table is in the history of https://github.com/ami-iit/element_cfd-simulation, in a commit without a licence,
so it is not shipped here: get it there, as a file (`--table`) or as a clone (`--clone`). The results of the checks are
printed and stored in the dataset.
"""

from __future__ import annotations

import argparse
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jax_aero.aero.dataset import Dataset, Floats, read_postures, save
from jax_aero.base import places, tables
from jax_aero.base.arguments import Parser
from jax_aero.base.files import read_bytes
from jax_aero.base.terminal import Refused, exit_status
from jax_aero.data.cfd import read_solver_table
from jax_aero.data.ironcub import JOINTS

POSTURES = places.CONFIGS / "tables" / "postures.toml"
OUT = places.RESULTS / "datasets"

COMMIT = "0d43057"
TABLE_PATH = "simulations/ironcub-automatic-cfd/auto-cfd-sim/data/outputParameters.csv"
"""Path of the public table in the history of the public repository."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = Parser("data import-cfd", __doc__)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--table", type=Path, metavar="FILE", help="the solver's table")
    source.add_argument("--clone", type=Path, metavar="DIR", help="a local clone of element_cfd-simulation")
    parser.add_argument("--commit", default=COMMIT, help=f"commit of the clone that has the table (default {COMMIT})")
    parser.add_argument("--joints", type=Path, metavar="FILE", help="joint angles by posture (CSV: name, JOINT_deg, …)")
    out = OUT / "freestream.nc"
    about = "the dataset (default results/datasets/freestream.nc)"
    parser.add_argument("--out", type=Path, default=out, metavar="FILE", help=about)
    given = parser.parse_args(arguments)

    return exit_status(lambda: keep(_read(given), given.out))


def keep(dataset: Dataset, out: Path) -> None:
    """Write a dataset and print its description."""
    save(dataset, out)
    print(summary(dataset))
    print(f"{out}: sha256 {dataset.sha256}")


def _read(given: argparse.Namespace) -> Dataset:
    postures = read_postures(given.joints, JOINTS) if given.joints else known_postures()
    if given.clone:
        text, source = from_clone(given.clone, given.commit), f"{TABLE_PATH} at {given.commit}"
    else:
        text, source = read_table(given.table), given.table.name
    return read_solver_table(text, postures, source=source)


def read_table(path: Path) -> str:
    """Return the text of a CSV table."""
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as reason:
        raise Refused(f"{path} is not text: {reason}; expected a CSV table") from None


def known_postures(sections: Sequence[str] | None = None, path: Path = POSTURES) -> dict[str, Floats]:
    """Return the joint angles (19,) [deg] of the named postures of a table, of some or all sections."""
    table = tables.read(path)
    if (order := tuple(table.pop("joints", ()))) != JOINTS:
        raise Refused(f"joints of {path} are {list(order)}; expected {list(JOINTS)}")
    chosen = table if sections is None else {name: table[name] for name in sections}
    postures = {}
    for section in chosen.values():
        for name, angles in section.items():
            if len(angles) != len(JOINTS):
                raise Refused(f"posture `{name}` of {path} has {len(angles)} angles; expected {len(JOINTS)}")
            postures[name] = np.array(angles, dtype=np.float64)
    return postures


def from_clone(clone: Path, commit: str) -> str:
    """Return the table from the history of a clone, without checking anything out."""
    try:
        answer = subprocess.run(
            ["git", "-C", str(clone), "show", f"{commit}:{TABLE_PATH}"], capture_output=True, check=True, timeout=60
        )
    except FileNotFoundError as reason:
        raise Refused("git is not installed; give the table as a file") from reason
    except subprocess.SubprocessError as reason:
        said = getattr(reason, "stderr", b"") or b""
        words = said.decode(errors="replace").strip().splitlines()
        raise Refused(
            f"{clone} has no {TABLE_PATH} at commit {commit}: {words[-1] if words else reason}; expected a full clone "
            "of element_cfd-simulation (a shallow one lacks old commits)"
        ) from reason
    return answer.stdout.decode("utf-8")


def summary(dataset: Dataset) -> str:
    """Return a description of a dataset and the results of its checks."""
    lines = [f"{len(dataset)} rows of {len(dataset.postures)} postures: {', '.join(dataset.postures)}"]
    lines += [f"  {name:<62} {value:.4g}" for name, value in dataset.checks.items()]
    return "\n".join(lines)

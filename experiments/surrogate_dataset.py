"""Compute a full dataset with the panel model, if no free-stream CFD is available: `surrogate-dataset --out FILE`.

Postures times 19 pitch and 18 yaw angles, as in the paper's campaign, then mirrored. Every posture is stored as soon as
it is computed, so the same command resumes an interrupted run.
"""

from __future__ import annotations

import hashlib
import shutil
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from experiments import Refused, study
from experiments.import_cfd import OUT, POSTURES, keep, known_postures
from experiments.sources import code_hash
from jax_aero import places
from jax_aero.aero.cfd_import import AIR_DENSITY, SPEED, checks
from jax_aero.aero.dataset import Dataset, Floats, wind_direction
from jax_aero.aero.surrogate import batched_features, force_areas, load_surrogate
from jax_aero.cli import Parser
from jax_aero.command import exit_status
from jax_aero.files import complete_file, lock_work
from jax_aero.places import ROBOT
from jax_aero.robot import load_robot

SURROGATE = places.CONFIGS / "aero" / "panels" / "surrogate.toml"

PITCHES = np.arange(0.0, 181.0, 10.0)
YAWS = np.arange(-160.0, 181.0, 20.0)
"""Angles of the paper's campaign [deg]."""
SYMMETRIC = ("hovering", "flight30", "flight60")
COUNTS = (24, 30)
"""Numbers of postures in the paper's dataset and in its simulations."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = Parser("surrogate-dataset", __doc__)
    parser.add_argument("--out", type=Path, default=OUT / "surrogate.nc", metavar="FILE")
    parser.add_argument("--postures", type=int, choices=COUNTS, default=COUNTS[1], help="how many (default 30)")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these postures instead")
    parser.add_argument("--model", type=Path, default=SURROGATE, metavar="FILE", help="coefficients of the panel model")
    given = parser.parse_args(arguments)
    parts = given.out.with_name(f".{given.out.name}.parts")  # finished postures of an incomplete run

    def work() -> None:
        with lock_work(given.out):
            keep(compute(given.only or posture_names(given.postures), given.model, parts), given.out)
            shutil.rmtree(parts, ignore_errors=True)

    return exit_status(work, interrupted=f"go on with the same command ({parts.name} has what is done)")


def posture_names(count: int) -> list[str]:
    """Return the three symmetric postures and others up to `count`, in the order of the table."""
    free, listed = known_postures(sections=["free_stream"]), known_postures(sections=["listed"])
    others = [name for name in (*free, *listed) if name not in SYMMETRIC]
    return [*SYMMETRIC, *others[: count - len(SYMMETRIC)]]


def compute(names: Sequence[str], model: Path, parts: Path) -> Dataset:
    """Compute every posture in every wind; return the dataset with its mirror images."""
    postures = known_postures()
    if unknown := sorted(set(names) - set(postures)):
        raise Refused(f"no posture {', '.join(unknown)}; there are {', '.join(postures)}")
    if len(set(names)) < len(names):
        raise Refused(f"the postures are {', '.join(names)}; expected each once")
    robot = load_robot(ROBOT)
    surrogate = load_surrogate(model, robot)
    features = batched_features(robot, surrogate.panels, surrogate.wake)
    digest = study.digest({"code": code_hash(__name__)}, [ROBOT, model, POSTURES])
    pitch, yaw = (grid.ravel() for grid in np.meshgrid(PITCHES, YAWS, indexing="ij"))
    wind = wind_direction(pitch, yaw)
    parts.mkdir(parents=True, exist_ok=True)
    areas: list[Floats] = []
    for name in tqdm(names, desc="postures", unit="posture", file=sys.stderr, disable=None):
        part = parts / f"{name}-{digest[:16]}.npy"
        if not part.is_file():
            joints = np.tile(postures[name], (len(wind), 1))
            found = force_areas(surrogate.coefficients, features(joints, wind))
            with complete_file(part) as draft:
                np.save(draft, found)
        areas.append(np.load(part))
    n = len(names) * len(wind)
    dataset = Dataset(
        posture=np.repeat(list(names), len(wind)),
        is_mirrored=np.zeros(n, dtype=bool),
        joint_position_deg=np.repeat([postures[name] for name in names], len(wind), axis=0),
        wind_b=np.tile(wind, (len(names), 1)),
        pitch_deg=np.tile(pitch, len(names)),
        yaw_deg=np.tile(yaw, len(names)),
        force_area_b=np.concatenate(areas),
        speed=np.full(n, SPEED),
        air_density=np.full(n, AIR_DENSITY),
        provenance={
            "source": "panel model calibrated on published data (jax_aero/aero/surrogate.py); no free-stream CFD",
            "model_sha256": hashlib.sha256(model.read_bytes()).hexdigest(),
            "layout": f"{len(names)} postures, {len(PITCHES)} pitch and {len(YAWS)} yaw angles, mirrored",
        },
    ).add_mirror_images()
    return replace(dataset, checks=checks(dataset))

"""Wind that tips a standing robot over, if the measured wind is the true one and if it is zero.

`jax-aero study tip_over [NAME]` reads `NAME.toml` (default ground) and finds by bisection, for every direction of the
wind, the speed from which on the robot does not stand to the end of a trial. Trials are stored beside the result until
the study is finished, so an interrupted study can be resumed. The result goes to `results/tip_over/NAME/`;
`jax-aero figures tip_over` draws it.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from tqdm import tqdm

from experiments.identity import Identity
from experiments.progress import Progress
from experiments.study import Findings, Study
from experiments.wind_direction import wind_from
from jax_aero import rust
from jax_aero.base import tables
from jax_aero.base.terminal import terminal
from jax_aero.mujoco import ground


class TipOverConfig(tables.Table, frozen=True):
    """Winds that tip a standing robot over: conditions and resolution of the search."""

    title: str
    experiment: Path
    """Experiment with robot, ground and controller."""
    duration: tables.Positive
    """Duration of each trial [s]."""
    ramp: tables.Interval
    """Start and end of the rise of the wind [s]."""
    directions_deg: tuple[float, ...]
    """Directions that the wind comes from: 0 from ahead, 90 from the robot's left [deg]."""
    speeds: tables.Interval
    """Interval in which the limit is searched [m/s]."""
    resolution: tables.Positive
    """Resolution of the limit [m/s]."""
    friction: tuple[tables.Positive, ...]
    """Friction coefficients of the soles."""

    def __post_init__(self) -> None:
        tables.check_levels(self, "directions_deg", "friction")


FEEDBACK = ("measured wind", "no measured wind")
STILL = {"profile": "constant", "velocity": [0.0, 0.0, 0.0]}


def compute(_: str, config: TipOverConfig, under_way: Path) -> Findings:
    """Make every missing trial."""
    base = rust.load_config(config.experiment)
    trials = Progress(under_way, Identity(rust.config_digest(base), (__name__,)))
    low, high = config.speeds.lower, config.speeds.upper
    shape = (len(FEEDBACK), len(config.friction), len(config.directions_deg))
    limit, slips = np.full(shape, np.nan), np.zeros(shape, dtype=np.int8)
    force = np.full((*shape, 3), np.nan)
    cells = list(np.ndindex(shape))
    steps = int(np.ceil(np.log2((high - low) / config.resolution)))
    with tqdm(total=len(cells) * (steps + 2), unit="trial", file=terminal(), disable=None) as bar:

        def fly_cell(cell: tuple[int, ...], speed: float) -> dict[str, Any]:
            bar.update()
            feedback, friction, direction = cell
            direction_deg, mu = config.directions_deg[direction], config.friction[friction]
            asked = trial(base, config, speed, direction_deg, mu, is_measured=feedback == 0)
            job = rust.config_digest(asked)
            if job not in trials.done:
                trials.add(job, _outcome(ground.fly(asked)))
            found: dict[str, Any] = trials.done[job]
            return found

        for cell in cells:
            found = seek(partial(fly_cell, cell), low, high, config.resolution)
            limit[cell] = found["speed"]
            slips[cell] = found["slipped"]
            force[cell] = found["force"]
    dataset = to_dataset(config, limit, slips, force)
    return Findings(config.title, dataset, figures(dataset), flights={"experiment": base})


STUDY = Study(
    "tip_over",
    __doc__,
    TipOverConfig,
    compute,
    ("ground",),
    engine="mujoco",
    interrupted="the trials made so far are kept, the same command goes on",
    progress=".trials",
)
main = STUDY.main


def trial(
    base: rust.Config,
    config: TipOverConfig,
    speed: float,
    direction_deg: float,
    friction: float,
    *,
    is_measured: bool,
) -> rust.Config:
    """Return the configuration of one trial."""
    wind = {
        "profile": "ramp",
        "velocity": wind_from(speed, direction_deg),
        "ramp_start": config.ramp.lower,
        "ramp_end": config.ramp.upper,
    }
    disturbances = base["disturbances"] | {"controller_wind": wind if is_measured else STILL}
    changed = {**base, "wind": wind, "disturbances": disturbances}
    ground = {**base["simulator"]["ground"], "friction": friction}
    changed["simulator"] = {**base["simulator"], "duration": config.duration, "ground": ground}
    return changed


def _outcome(flight: rust.FlightResult) -> dict[str, Any]:
    log = flight.log
    carried = log["foot_wrench"][:, :, 2].sum(axis=1) > 1.0
    return {
        "stands": flight.outcome == "completed",
        "force": log["aero_force_sim"].sum(axis=1)[carried][-1].tolist() if carried.any() else [0.0, 0.0, 0.0],
        "slipped": bool(_slip(log) > SLIP),
    }


SLIP = 0.02
"""Displacement of a sole along the ground before the robot tips, beyond which it has slipped [m]."""


def _slip(log: Mapping[str, Any]) -> float:
    """Return the greatest displacement of a sole along the ground while both carry load [m]."""
    shift = np.linalg.norm((log["sole_position"] - log["sole_position"][0])[:, :, :2], axis=2).max(axis=1)
    both = (log["foot_wrench"][:, :, 2] > 20.0).all(axis=1)
    return float(shift[both].max(initial=0.0))


def seek(stands: Any, low: float, high: float, resolution: float) -> dict[str, Any]:
    """Return the greatest speed at which the robot stands, by bisection between one that it stands and one it does not.

    NaN if the robot tips at the lowest speed; the highest speed tried if it never tips.
    """
    lost = stands(high)
    held = stands(low)
    if lost["stands"]:
        return {**lost, "speed": high}
    if not held["stands"]:
        return {**held, "speed": np.nan}
    while high - low > resolution:
        middle = 0.5 * (low + high)
        outcome = stands(middle)
        if outcome["stands"]:
            low, held = middle, outcome
        else:
            high, lost = middle, outcome
    return {"speed": low, "slipped": lost["slipped"], "force": held["force"]}


def to_dataset(config: TipOverConfig, limit: Any, slips: Any, force: Any) -> xr.Dataset:
    """Return the limits as a labelled dataset."""
    dims = ("feedback", "friction", "direction")
    return xr.Dataset(
        {
            "speed": (dims, limit, {"units": "m s-1", "long_name": "greatest wind the robot stands in"}),
            "slips": (dims, slips, {"units": "1", "long_name": "whether it slips rather than tips beyond"}),
            "force": ((*dims, "xyz"), force, {"units": "N", "long_name": "aerodynamic force at that wind"}),
        },
        {
            "feedback": list(FEEDBACK),
            "friction": list(config.friction),
            "direction": ("direction", list(config.directions_deg), {"units": "deg", "long_name": "0 from ahead"}),
            "xyz": ["x", "y", "z"],
        },
        {"resolution": config.resolution},
    )


def figures(dataset: xr.Dataset) -> dict[str, float]:
    """Return the limits by name; NaN if the robot tips at the lowest speed."""
    limits = dataset["speed"].stack(cell=dataset["speed"].dims)
    return {
        f"{feedback}, friction {friction:g}, from {direction:g} deg [m/s]": float(value)
        for (feedback, friction, direction), value in zip(limits["cell"].values, limits.values, strict=True)
    }

"""Flights with P160 in the arms, as in the published flights, and with P100, as in the paper's text.

`jax-aero study arm_engines` changes engine and greatest thrust of the arms in a copy of the robot's file and
flies missions with both, with ideal and with identified jets. The result goes to `results/arm_engines/paper/`.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from jax_aero import rust
from jax_aero.base import tables
from jax_aero.base.places import ROBOT
from jax_aero.results.study import Findings, Study

ENGINES = {"P160": 160.0, "P100": 100.0}
"""Greatest thrust of each arm [N]: in the published flights, and in the published balancing experiments."""
QUANTITIES = {"arm_thrust_max": "N", "chest_thrust_max": "N", "rotation_error": "deg", "com_error": "m"}


class ArmEngines(tables.Table, frozen=True):
    """Missions to fly."""

    experiments: tuple[str, ...] = ("no_wind", "test1", "test2", "test4", "head_wind", "second_order_jets")

    def __post_init__(self) -> None:
        tables.check_levels(self, "experiments")


def compute(_: str, asked: ArmEngines) -> Findings:
    """Fly every mission with every engine."""
    flights = {name: rust.load_config(name) for name in asked.experiments}
    outcomes: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(ROBOT.with_suffix(".urdf"), folder)
        for engine, limit in ENGINES.items():
            path = Path(folder) / f"{engine}.toml"
            path.write_text(replace_arm_engines(ROBOT.read_text(encoding="utf-8"), engine, limit), encoding="utf-8")
            for name, config in flights.items():
                outcomes[f"{name} {engine}"] = outcome_of(rust.fly({**config, "robot": str(path)}))
    rows = [[outcomes[f"{name} {engine}"] for engine in ENGINES] for name in flights]
    units = {"outcome": {}, **{key: {"units": unit} for key, unit in QUANTITIES.items()}}
    data = xr.Dataset(
        {key: (("experiment", "engine"), [[cell[key] for cell in row] for row in rows], units[key]) for key in units},
        {"experiment": list(flights), "engine": list(ENGINES)},
    )
    inputs = {"engines": ENGINES}
    return Findings("Engines of the arms", data, outcomes, flights=flights, inputs=inputs, files=[ROBOT])


STUDY = Study("arm_engines", __doc__, ArmEngines, compute, ("paper",), backend="rust")
main = STUDY.main


def replace_arm_engines(robot: str, engine: str, limit: float) -> str:
    """Return the text of a robot's file with another engine and thrust limit [N] in both arms."""
    parts = robot.split("[[jets]]")
    for index, part in enumerate(parts):
        if "_arm_jet_turbine" in part and index > 0:
            limited = re.sub(r"^thrust_max.*", f"thrust_max = {limit}", part, flags=re.MULTILINE)
            parts[index] = re.sub(r"^engine =.*", f'engine = "{engine}"', limited, flags=re.MULTILINE)
    return "[[jets]]".join(parts)


def outcome_of(result: rust.FlightResult) -> dict[str, Any]:
    """Return the outcome of a flight and its extremes."""
    thrust = result.log["thrust"]
    return {
        "outcome": result.outcome,
        "arm_thrust_max": float(thrust[:, :2].max()),
        "chest_thrust_max": float(thrust[:, 2:].max()),
        "rotation_error": float(np.degrees(result.summary["max_rotation_error"])),
        "com_error": result.summary["max_com_error"],
    }

"""Flights with other engines in the arms: P160, as the published flights have them, and P100, as the paper's text does.

`python -m experiments arm-engines` changes engine and greatest thrust of the arms in a copy of the robot's file, and
flies missions with both, with ideal jets and with identified ones. The result goes to `results/arm_engines/paper/`.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from experiments import flight, manifest, record, study
from experiments.engine_choice import ROBOT
from jax_aero import cli, rust
from jax_aero.command import exit_status
from jax_aero.summary import SETTLING_TIME

ENGINES = {"P160": 160.0, "P100": 100.0}
"""Greatest thrust of each arm [N]: of the published flights, and of the published balancing experiments."""
EXPERIMENTS = ("no_wind", "test1", "test2", "test4", "head_wind", "second_order_jets")
QUANTITIES = {"arm_thrust_max": "N", "chest_thrust_max": "N", "rotation_error": "deg", "com_error": "m"}
KIND, NAME = "arm_engines", "paper"


def main(arguments: Sequence[str]) -> int:
    """Run the command line; return its exit status."""
    cli.Parser("arm-engines", __doc__).parse_args(arguments)

    def work() -> None:
        for name, found in run()["summary"].items():
            values = ", ".join(f"{key} {found[key]:.4g} {unit}" for key, unit in QUANTITIES.items())
            print(f"{name:<26} {found['outcome']:<10} {values}")

    return exit_status(work)


def run() -> dict[str, Any]:
    """Fly, write, return the manifest."""
    started = time.perf_counter()
    found: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(ROBOT.with_suffix(".urdf"), folder)
        for engine, limit in ENGINES.items():
            path = Path(folder) / f"{engine}.toml"
            path.write_text(with_arms(ROBOT.read_text(encoding="utf-8"), engine, limit), encoding="utf-8")
            for name in EXPERIMENTS:
                config = {**rust.load_config(flight.find(name)), "robot": str(path)}
                found[f"{name} {engine}"] = outcome_of(rust.fly(config))
    rows = [[found[f"{name} {engine}"] for engine in ENGINES] for name in EXPERIMENTS]
    dataset = xr.Dataset(
        {
            "outcome": (("experiment", "engine"), [[cell["outcome"] for cell in row] for row in rows]),
            **{
                key: (("experiment", "engine"), [[cell[key] for cell in row] for row in rows], {"units": unit})
                for key, unit in QUANTITIES.items()
            },
        },
        {"experiment": list(EXPERIMENTS), "engine": list(ENGINES)},
    )
    flights = {name: rust.config_digest(rust.load_config(flight.find(name))) for name in EXPERIMENTS}
    config = {"engines": ENGINES, "experiments": flights}
    dataset.attrs |= {"title": "Engines of the arms", "config_hash": study.digest(config, [ROBOT])}
    document = manifest.build(
        NAME,
        dataset.attrs["title"],
        config,
        dataset.attrs["config_hash"],
        summary=found,
        command=["jax-aero", "arm-engines"],
        engine="numpy",
        code=[__name__],
        timings_s={"all": time.perf_counter() - started},
    )
    record.write_run(study.RESULTS / KIND / NAME, dataset, document, replace=True)
    return document


def with_arms(robot: str, engine: str, limit: float) -> str:
    """Return the text of a robot's file with another engine and thrust limit [N] in both arms."""
    parts = robot.split("[[jets]]")
    for index, part in enumerate(parts):
        if "_arm_jet_turbine" in part and index > 0:
            lines = [
                f"thrust_max = {limit}"
                if line.startswith("thrust_max")
                else f'engine = "{engine}"'
                if line.startswith("engine =")
                else line
                for line in part.split("\n")
            ]
            parts[index] = "\n".join(lines)
    return "[[jets]]".join(parts)


def outcome_of(result: rust.FlightResult) -> dict[str, Any]:
    """Return how a flight ended, and its extremes."""
    log = result.log
    settled = log["time"] >= SETTLING_TIME
    error = np.linalg.norm(log["com_position"] - log["com_setpoint"], axis=1)
    return {
        "outcome": result.outcome,
        "arm_thrust_max": float(log["thrust"][:, :2].max()),
        "chest_thrust_max": float(log["thrust"][:, 2:].max()),
        "rotation_error": float(np.degrees(log["rotation_error"].max())),
        "com_error": float(error[settled].max()),
    }

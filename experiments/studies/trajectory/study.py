"""Optimal flights: planned, exported, flown, and compared with the paper's.

A plan is solved with the centroidal model (`jax_aero/symbolic/trajectory.py`), written as a reference that the
controllers can fly (`mission = { file = "reference.csv" }`), and flown in closed loop by the Rust engine in the wind of
the paper's flight, which is flown for comparison. Results go to `results/trajectory/NAME/`: `run.nc` holds the plan,
its flight and the paper's; `reference.csv` the reference, of which `configs/mission/` holds a copy.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from jax_aero import rust
from jax_aero.base.terminal import Refused
from jax_aero.results.study import Findings, Study
from jax_aero.robot.groups import joints_of
from jax_aero.robot.waypoints import reference_text
from jax_aero.symbolic import MomentumModel, load_robot
from jax_aero.symbolic.robot import Robot
from jax_aero.symbolic.trajectory import (
    Trajectory,
    TrajectoryConfig,
    TrajectoryProblem,
    fuel_burnt,
    fuel_lines,
    load_fuel,
)

ARRIVED = 0.05
"""Distance to the end within which a flight must stay to have arrived [m]. Ours."""


def compute(name: str, config: TrajectoryConfig) -> Findings:
    """Plan, fly and compare."""
    base = rust.load_config(config.flight)
    robot = load_robot(base["robot"])
    plan = problem_of(config, base, robot).solve()
    if not plan.success:
        raise Refused(f"{name}: no trajectory found: {plan.message}")
    text = csv_of(plan, config.start_time, f"{config.title}: jax-aero study trajectory {name}")
    flown, paper = fly(base, text, config.start_time + plan.duration + config.hold_time), rust.fly(base)
    dataset = to_dataset(plan, flown, paper, robot, config)
    summary = {
        "solver": f"{plan.message}, {plan.iterations} iterations",
        "largest constraint violation of the plan": plan.defect,
        **figures("plan", dataset, "plan"),
        **figures("flown", dataset, "flown"),
        **figures("paper", dataset, "paper"),
    }
    timings = {"build": plan.build_time, "solve": plan.solve_time}
    texts = {"reference.csv": text}
    return Findings(config.title, dataset, summary, flights={"paper": base}, texts=texts, timings=timings)


STUDY = Study("trajectory", __doc__, TrajectoryConfig, compute, ("min_time", "min_fuel"))
main = STUDY.main


def problem_of(config: TrajectoryConfig, base: Mapping[str, Any], robot: Robot) -> TrajectoryProblem:
    """Return the problem with aerodynamics, wind and posture of the flight `base`."""
    free = tuple(sorted(joints_of(base["robot"], config.free_groups)))
    wind = np.array(base["wind"]["velocity"], dtype=float)
    posture = np.array(base["simulator"]["initial"]["joint_position"], dtype=float)
    return TrajectoryProblem(MomentumModel(robot, base["simulator"]["aero"]), config, wind, posture, free)


def csv_of(plan: Trajectory, start_time: float, about: str) -> str:
    """Return the reference as CSV, including derivatives of the centre of mass, angles in rad."""
    com = plan.com
    rows = np.hstack([start_time + plan.time[:, None], com[:, 0], plan.base_rpy, com[:, 1], com[:, 2], com[:, 3]])
    return reference_text(rows, about, 7)


def fly(base: Mapping[str, Any], text: str, duration: float) -> rust.FlightResult:
    """Fly a reference in closed loop, with everything else as in the flight `base`."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "reference.csv"
        file.write_text(text, encoding="utf-8")
        step = base["controller"]["time_step"]
        simulator = {**base["simulator"], "duration": round(duration / step) * step}
        return rust.fly({**base, "simulator": simulator, "mission": {"file": str(file)}})


def to_dataset(
    plan: Trajectory,
    flown: rust.FlightResult,
    paper: rust.FlightResult,
    robot: Robot,
    config: TrajectoryConfig,
) -> xr.Dataset:
    """Return plan, flown flight and the paper's flight in one dataset, each with its own time.

    Time zero is the beginning of the motion.
    """
    quantities = {
        "com_position": ("xyz", "m", "centre of mass, inertial frame"),
        "com_velocity": ("xyz", "m s-1", "its velocity"),
        "acceleration": ("xyz", "m s-2", "acceleration"),
        "jerk": ("xyz", "m s-3", "jerk"),
        "base_rpy": ("rpy", "rad", "base attitude: planned, or the reference's"),
        "joint_position": ("joint", "rad", "joint position"),
        "thrust": ("jet", "N", "thrust of each jet"),
        "com_error": ("", "m", "distance of the centre of mass from its reference"),
        "rotation_error": ("", "rad", "angle between base and reference"),
        "fuel": ("", "l", "fuel burnt since it began to move"),
    }
    of_com = ("com_position", "com_velocity", "acceleration", "jerk")
    signals: dict[str, dict[str, Any]] = {
        "plan": {
            "time": plan.time,
            **dict(zip(of_com, np.moveaxis(plan.com, 1, 0), strict=True)),
            **{key: getattr(plan, key) for key in ("base_rpy", "joint_position", "thrust")},
        }
    }
    for name, flight in (("flown", flown), ("paper", paper)):
        log = flight.log
        signals[name] = {
            "time": log["time"] - config.start_time,
            **{key: log[key] for key in ("com_position", "com_velocity", "thrust", "rotation_error")},
            "base_rpy": log["base_rpy_setpoint"],
            "com_error": np.linalg.norm(log["com_position"] - log["com_setpoint"], axis=1),
        }
    variables: dict[str, Any] = {}
    for name, group in signals.items():
        burnt = fuel_burnt(group["time"], group["thrust"], *fuel_lines(load_fuel(config.fuel), robot))
        group["fuel"] = burnt - np.interp(0.0, group["time"], burnt)
        for key, (dim, units, text) in quantities.items():
            if key not in group:
                continue
            about = {"units": units, "long_name": f"{name}: {text}"}
            variables[f"{key}_{name}"] = (f"time_{name}", dim) if dim else f"time_{name}", group[key], about
    coords: dict[str, Any] = {
        f"time_{name}": (f"time_{name}", g["time"], {"units": "s"}) for name, g in signals.items()
    }
    coords |= {"xyz": list("xyz"), "rpy": ["roll", "pitch", "yaw"], "joint": list(robot.joint_names)}
    coords["jet"] = [jet.name for jet in robot.jets]
    facts = {
        "end": np.array(config.end, dtype=float),
        "outcome_flown": flown.outcome,
        "outcome_paper": paper.outcome,
    }
    dataset = xr.Dataset(variables, coords, facts)
    dataset.attrs |= {f"arrival_{name}": _arrival(dataset, name) for name in signals}
    return dataset


def _arrival(dataset: xr.Dataset, name: str) -> float:
    """Return when one of the three flights arrives [s]; NaN if it has not when its log ends."""
    t = dataset[f"time_{name}"].values
    away = np.linalg.norm(dataset[f"com_position_{name}"].values - dataset.attrs["end"], axis=1) > ARRIVED
    late = int(np.flatnonzero(away)[-1]) + 1 if away.any() else 0
    return float(t[late]) if late < t.size else np.nan


def figures(label: str, dataset: xr.Dataset, name: str) -> dict[str, float | str]:
    """Return duration, fuel and errors of one of the three flights; the first two are NaN if it does not arrive."""
    t = dataset[f"time_{name}"].values
    arrived = float(dataset.attrs[f"arrival_{name}"])
    moving = (t >= 0.0) & ~(t > arrived)  # if it does not arrive, to its end
    thrust = dataset[f"thrust_{name}"].values[moving]
    row: dict[str, float | str] = {
        f"{label}: arrives within {100 * ARRIVED:.0f} cm after [s]": arrived,
        f"{label}: fuel until then [l]": float(np.interp(arrived, t, dataset[f"fuel_{name}"].values)),
        f"{label}: greatest speed [m/s]": float(
            np.linalg.norm(dataset[f"com_velocity_{name}"].values[moving], axis=1).max()
        ),
        f"{label}: thrusts [N]": f"{thrust.min():.1f} to {thrust.max():.1f}",
    }
    if f"com_error_{name}" in dataset:
        row[f"{label}: outcome"] = str(dataset.attrs[f"outcome_{name}"])
        row[f"{label}: peak CoM error [m]"] = float(dataset[f"com_error_{name}"].values[t >= 0.0].max())
        rotation = dataset[f"rotation_error_{name}"].values[t >= 0.0].max()
        row[f"{label}: peak rotation error [deg]"] = float(np.degrees(rotation))
    return row

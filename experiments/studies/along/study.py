"""Quantities computed from flight logs: fuel burnt, and clearance of jets from the body.

`jax-aero study along` reads `results/flight/NAME/`, and flies experiments that are not there. Fuel consumption is
linear in the thrust of every jet (`configs/tables/fuel.toml`); the clearance is that of a trim, from the axis of an
exhaust to the surface of a link, including soles. The result goes to `results/along/flights/`; `jax-aero figures along`
draws it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import msgspec
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jax_aero.base import places, run_file, tables
from jax_aero.base.places import ROBOT
from jax_aero.base.terminal import Refused
from jax_aero.data.battery import Choice
from jax_aero.results import flight
from jax_aero.results.study import Findings, Study
from jax_aero.symbolic import load_robot
from jax_aero.symbolic.clearance import pairs
from jax_aero.symbolic.kinematics import Kinematics
from jax_aero.symbolic.trajectory import Consumption, fuel_burnt, fuel_lines, load_fuel

STEP = 0.1
"""Time between evaluated samples [s]."""

Array = NDArray[np.float64]


class Along(tables.Table, frozen=True):
    """Flights to read, and files with the parameters."""

    flights: tuple[str, ...] = (*flight.PAPER_RUNS, "no_wind", "test2_mpc")
    fuel: Path = msgspec.field(default_factory=lambda: places.CONFIGS / "tables" / "fuel.toml")
    """File with the fuel consumption of the jets."""
    plume_length: tables.Positive = 1.5
    """Length of a jet's axis from which the clearance is measured [m]. Ours."""

    def __post_init__(self) -> None:
        tables.check_levels(self, "flights")


def compute(_: str, asked: Along) -> Findings:
    """Read the flights and compute fuel and clearance."""
    runs = {name: _read(name) for name in asked.flights}
    data = fuel_and_clearance(runs, load_fuel(asked.fuel), asked.plume_length)
    summary = figures(data)
    read = {name: run.attrs["config_hash"] for name, run in runs.items()}
    files = [ROBOT, *(flight.folder_of(name) / places.RUN_FILE for name in runs)]
    return Findings("Fuel and clearance along flights", data, summary, results=read, files=files)


STUDY = Study("along", __doc__, Along, compute, ("flights",))
main = STUDY.main


def _read(name: str) -> xr.Dataset:
    with run_file.opened(flight.obtain(name)) as opened:
        return opened[["joint_position", "thrust"]].load().assign_attrs(opened.attrs)


def fuel_and_clearance(runs: dict[str, xr.Dataset], fuel: dict[str, Consumption], plume_length: float) -> xr.Dataset:
    """Return fuel burnt [l] and clearance [m] of every flight up to its loss, on common times."""
    robot = load_robot(ROBOT)
    for name, run in runs.items():
        if tuple(run["joint"].values) != tuple(robot.joint_names):
            raise Refused(f"`flights` has {name}, whose joints are not those of {robot.name}; expected flights of it")
    distances, jets = clearance_of(robot, plume_length)
    idle, slope = fuel_lines(fuel, robot)
    end = max(float(run["time"][-1]) for run in runs.values())
    times = np.arange(0.0, end + 0.5 * STEP, STEP)
    burnt = np.full((len(runs), times.size), np.nan)
    nearest = np.full((len(runs), times.size, len(jets)), np.nan)
    lost_times = [float(run.attrs["lost_time"]) for run in runs.values()]
    for index, (run, lost) in enumerate(zip(runs.values(), lost_times, strict=True)):
        until = float(run["time"][-1]) if np.isnan(lost) else lost
        flown = times <= until + 1e-9
        total = fuel_burnt(run["time"].values, run["thrust"].values, idle, slope)
        burnt[index, flown] = np.interp(times[flown], run["time"].values, total)
        posture = run["joint_position"].sel(time=times[flown], method="nearest").values
        nearest[index, flown] = np.array([distances(row).full().ravel() for row in posture])
    return xr.Dataset(
        {
            "fuel": (("flight", "time"), burnt, {"units": "l", "long_name": "fuel burnt"}),
            "clearance": (
                ("flight", "time", "jet"),
                nearest,
                {"units": "m", "long_name": "from the exhaust's axis to the nearest link"},
            ),
            "lost_time": ("flight", lost_times, {"units": "s", "long_name": "when the flight was lost; NaN if not"}),
        },
        {"flight": list(runs), "time": ("time", times, {"units": "s"}), "jet": jets},
    )


def clearance_of(robot: Any, plume_length: float) -> tuple[ca.Function, list[str]]:
    """Return the distance of every jet's exhaust to the nearest link [m] as a function of the joints, and the jets."""
    tree = Kinematics(robot)
    every = pairs(tree, plume_length)
    jets = [jet.name for jet in robot.jets]
    least = [ca.mmin(ca.vertcat(*(pair.distance for pair in every if pair.jet == jet))) for jet in jets]
    return _at_posture("clearance", tree, least), jets


def _at_posture(name: str, tree: Kinematics, values: list[ca.SX]) -> ca.Function:
    """Return values that do not depend on the pose of the base, by the joints."""
    (here,) = tree.evaluate_at_base(ca.vertcat(*values))
    origin = ca.SX(ca.DM([0.0, 0.0, 0.0, *np.eye(3).ravel(order="F")]))
    placed = ca.substitute(here, ca.vertcat(tree.base_position, ca.vec(tree.base_rotation)), origin)
    return ca.Function(name, [tree.joint_position], [placed])


def figures(dataset: xr.Dataset) -> dict[str, dict[str, float]]:
    """Return, by flight, fuel, fuel mass for five minutes at the mean rate, and the least clearance."""
    by_flight = {}
    for name in dataset["flight"].values.tolist():
        one = dataset.sel(flight=name)
        fuel = one["fuel"].dropna("time")
        litres, seconds = float(fuel[-1]), float(fuel["time"][-1])
        by_flight[name] = {
            "fuel_l": litres,
            "five_minutes_kg": litres / seconds * 300.0 * Choice().fuel_density,
            "clearance_mm": 1e3 * float(one["clearance"].min()),
        }
    return by_flight

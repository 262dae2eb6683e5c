"""Trims in wind: attitude, joint positions and thrusts in equilibrium, or the constraint that prevents it.

`jax-aero study trim [NAME] --wind X Y Z` prints the trim of a wind or flight velocity; with `--map` all winds of the
configuration are solved, and the result goes to `results/trim/NAME/`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from tqdm import tqdm

from jax_aero import rust
from jax_aero.base import tables
from jax_aero.base.arguments import Parser
from jax_aero.base.keys import parse_assignments
from jax_aero.base.terminal import Refused, exit_status, terminal
from jax_aero.base.wind_direction import wind_from
from jax_aero.results import study
from jax_aero.results.study import Findings, Study
from jax_aero.robot.groups import joints_of
from jax_aero.symbolic import MomentumModel, load_robot
from jax_aero.symbolic.trim import Objective, Trim, TrimResult, TrimSettings

OBJECTIVES: tuple[Objective, ...] = ("max_margin", "min_thrust")
STILL = [0.0, 0.0, 0.0]


class WindMap(tables.Table, frozen=True):
    """Winds of a map."""

    speeds: tuple[tables.NonNegative, ...]
    """Wind speeds [m/s]."""
    directions_deg: tuple[float, ...]
    """Directions that the wind comes from: 0 from ahead (+x), 90 from the left (+y) [deg]."""

    def __post_init__(self) -> None:
        tables.check_levels(self, "speeds", "directions_deg")


class TrimConfig(tables.Table, frozen=True):
    """A trim: free joints, limits and objective."""

    title: str
    robot: Path
    """The robot's TOML file, with limits of joints, torques and thrusts."""
    aero: Path
    """An aerodynamic model of `configs/aero/`."""
    posture: Path
    """A simulator of `configs/simulator/`, whose `initial.joint_position` is the nominal posture."""
    free_groups: tuple[str, ...]
    """Joint groups that may leave the nominal posture."""
    yaw_deg: float
    roll_limits_deg: tables.Interval
    pitch_limits_deg: tables.Interval
    margin_min: tables.Fraction
    """Least distance of a thrust from both its limits, relative to its greatest value."""
    clearance_min: tables.NonNegative
    """Least distance from the axis of a jet to the surface of a link [m]."""
    plume_length: tables.Positive
    """Length of a jet's axis for which this is required [m]."""
    posture_weight: tables.NonNegative
    """Weight of the mean square of s - s0 [1/rad²]."""
    spread_weight: tables.NonNegative
    """Weight of the sum of (T/T_max)²."""
    map: WindMap
    """Winds of `--map`."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status: 1 if there is no trim."""
    parser = Parser("study trim", __doc__)
    study.add_names(parser, "trim", "name", nargs="?", default="free_joints")
    vector: dict[str, Any] = {"nargs": 3, "type": float, "metavar": ("X", "Y", "Z")}
    parser.add_argument("--wind", help="velocity of the air [m/s, inertial axes]", **vector)
    parser.add_argument("--velocity", help="flight velocity [m/s, inertial axes]", **vector)
    parser.add_argument("--without", metavar="JET", help="a jet without thrust; roll and pitch may be up to ±90° then")
    parser.add_argument("--objective", choices=OBJECTIVES, help="(default min_thrust)")
    parser.add_argument("--map", action="store_true", help="solve all winds of the configuration, write a result")
    study.add_set(parser, STUDY.example)
    study.add_name(parser)
    study.add_overwrite(parser)
    given = parser.parse_args(arguments)

    def work() -> int:
        of_one = {name: getattr(given, name) for name in ("wind", "velocity", "without", "objective")}
        of_map = {"overwrite": given.overwrite or None, "name": given.named}
        for name, value in (of_one if given.map else of_map).items():
            if value is not None:
                raise Refused(f"--{name} is given {'beside' if given.map else 'without'} --map, where it has no effect")
        wind, velocity = (given.wind or STILL), (given.velocity or STILL)
        for name, parts in (("wind", wind), ("velocity", velocity)):
            if not all(abs(part) <= tables.LARGEST for part in parts):
                raise Refused(f"--{name} is {parts}; expected three numbers, each at most {tables.LARGEST:g}")
        changes = parse_assignments(given.set)
        if given.map:
            document = STUDY.run(given.name, changes, named=given.named, overwrite=given.overwrite)
            return 0 if document["summary"]["trims found"] else 1
        trim = build(STUDY.read(given.name, changes)[1])
        trim.lost = _jet(trim, given.without)
        result = trim.solve(wind, velocity, given.objective or "min_thrust")
        print(report(trim, result))
        return 0 if result.feasible else 1

    return exit_status(work)


def _jet(trim: Trim, name: str | None) -> int | None:
    """Return the index of a named jet."""
    names = [jet.name for jet in trim.model.robot.jets]
    if name is not None and name not in names:
        raise Refused(f"--without is `{name}`; {trim.model.robot.name} has {', '.join(names)}")
    return None if name is None else names.index(name)


def build(config: TrimConfig) -> Trim:
    """Return the problem of a configuration."""
    robot = load_robot(config.robot)
    posture = np.array(tables.read(config.posture)["initial"]["joint_position"], dtype=float)
    settings = TrimSettings(
        posture=posture,
        free_joints=joints_of(config.robot, config.free_groups),
        roll=config.roll_limits_deg.radians,
        pitch=config.pitch_limits_deg.radians,
        yaw=float(np.radians(config.yaw_deg)),
        margin_min=config.margin_min,
        torque_max=robot.joint_torque_max,
        clearance_min=config.clearance_min,
        plume_length=config.plume_length,
        posture_weight=config.posture_weight,
        spread_weight=config.spread_weight,
    )
    return Trim(MomentumModel(robot, rust.load_aero(config.aero)), settings)


def report(trim: Trim, result: TrimResult) -> str:
    """Return a description of a trim, or of the constraints that prevent it."""
    robot = trim.model.robot
    degrees = np.degrees(result.base_rpy)
    effort = f"{result.iterations} iterations, {result.solve_time:.2f} s; problem built in {trim.build_time:.1f} s"
    lines = [f"{'trim' if result.feasible else 'NO TRIM'}: {result.message} ({effort})"]
    if not result.feasible:
        lines.append("the nearest there is:")
    lines += [
        "base roll, pitch, yaw [deg]   " + "  ".join(f"{angle:8.3f}" for angle in degrees),
        *(
            f"thrust of {jet.name:<18}  {thrust:8.2f} N of {jet.thrust_max:g}"
            for jet, thrust in zip(robot.jets, result.thrust, strict=True)
        ),
        f"total thrust                  {result.total_thrust:8.2f} N, weight {robot.mass * robot.gravity:.2f} N",
        f"thrust margin                 {100 * result.margin:8.2f} % of the greatest thrust",
        "aerodynamic force [N]         " + "  ".join(f"{force:8.3f}" for force in result.aero_force),
        "aerodynamic moment [N m]      " + "  ".join(f"{moment:8.3f}" for moment in result.aero_moment),
        f"greatest joint torque         {np.abs(result.joint_torque).max(initial=0.0):8.2f} N m",
        f"jet axis nearest to the body  {1000 * result.clearance:8.1f} mm{result.closest and ', '}{result.closest}",
        f"left over                     {np.abs(result.residual).max():8.1e} N or N m",
    ]
    moved = np.degrees(result.joint_position - trim.settings.posture)
    order = [int(i) for i in np.argsort(-np.abs(moved)) if abs(moved[i]) > 0.05][:8]
    if order:
        changes = ", ".join(f"{robot.joint_names[i]} {moved[i]:+.1f}" for i in order)
        lines.append(f"joints off the posture [deg]  {changes}")
    if result.at_limit:
        lines.append(f"at a limit                    {', '.join(result.at_limit)}")
    return "\n".join(lines)


def compute(name: str, config: TrimConfig) -> Findings:
    """Solve for both objectives in every wind of a configuration."""
    trim = build(config)
    speeds, directions = config.map.speeds, config.map.directions_deg
    best: dict[tuple[str, int, int], TrimResult] = {}
    there = [(objective, d, s) for objective in OBJECTIVES for d in range(len(directions)) for s in range(len(speeds))]
    # There are many local minima: solve forwards from solved neighbours, then backwards, and keep the better solution.
    with tqdm(total=2 * len(there), desc=name, unit="wind", file=terminal(), disable=None, leave=False) as bar:
        for cells, step in ((there, -1), (there[::-1], 1)):
            for objective, d, s in cells:
                wind = wind_from(speeds[s], directions[d])
                neighbours = (best.get((objective, d, s + step)), best.get((objective, d + step, s)))
                starts: list[TrimResult | None] = [other for other in neighbours if other and other.feasible]
                if step < 0:
                    starts.append(None)
                tried = [trim.solve(wind, objective=objective, start=start) for start in starts]
                if (objective, d, s) in best:
                    tried.append(best[objective, d, s])
                best[objective, d, s] = min(tried, key=lambda result: (not result.feasible, result.cost))
                bar.update()
    dataset = _map_dataset(trim, best, speeds, directions)
    trims = [result for result in best.values() if result.feasible]
    # A map without a trim is also a valid result, without residual and time.
    summary = {
        "trims requested": len(best),
        "trims found": len(trims),
        "largest residual of a trim [N, N m]": max((np.abs(r.residual).max() for r in trims), default=None),
        "median solve time of a trim [s]": float(np.median([r.solve_time for r in trims])) if trims else None,
        "strongest wind with a trim from every direction [m/s]": _feasible_speed(dataset),
    }
    urdf = config.robot.parent / tables.read(config.robot)["urdf"]
    text = "" if trims else f"NO TRIM in any of these winds\n{study.listing(summary)}"
    return Findings(config.title, dataset, summary, files=[urdf], timings={"build": trim.build_time}, report=text)


STUDY = Study("trim", __doc__, TrimConfig, compute, ("free_joints",), options=["--map"])


def _feasible_speed(dataset: xr.Dataset) -> float:
    feasible = dataset["feasible"].sel(objective="max_margin").all("direction").values
    reached = int(np.argmin(feasible)) if not feasible.all() else feasible.size
    return float(dataset["speed"].values[reached - 1]) if reached else float("nan")


def _map_dataset(
    trim: Trim, best: dict[tuple[str, int, int], TrimResult], speeds: Sequence[float], directions: Sequence[float]
) -> xr.Dataset:
    robot, grid = trim.model.robot, ("objective", "direction", "speed")
    shape = (len(OBJECTIVES), len(directions), len(speeds))
    cells = [best[objective, d, s] for objective in OBJECTIVES for d in range(shape[1]) for s in range(shape[2])]

    def of_trim(name: str) -> list[float]:
        return [getattr(cell, name) if cell.feasible else np.nan for cell in cells]

    def of_cell(name: str) -> list[Any]:
        return [getattr(cell, name) for cell in cells]

    reserve = "least distance of a thrust from 0 and from its greatest, over its greatest"
    missed = [cell.violations[0].constraint if cell.violations else "" for cell in cells]
    quantities: dict[str, tuple[str, Any, str, str]] = {
        "feasible": ("", np.array(of_cell("feasible"), np.int8), "1", "a trim exists"),
        "margin": ("", of_trim("margin"), "1", reserve),
        "total_thrust": ("", of_trim("total_thrust"), "N", "sum of the thrusts"),
        "clearance": ("", of_cell("clearance"), "m", "least distance from the axis of a jet to the surface of a link"),
        "base_rpy": ("rpy", of_cell("base_rpy"), "rad", "base attitude"),
        "joint_position": ("joint", of_cell("joint_position"), "rad", "joint position"),
        "thrust": ("jet", of_cell("thrust"), "N", "thrust"),
        "aero_force": ("xyz", of_cell("aero_force"), "N", "total aerodynamic force, inertial axes"),
        "solve_time": ("", of_cell("solve_time"), "s", "wall time of the solver"),
        "violated": ("", missed, "", "constraint that is missed by most where there is no trim"),
    }
    variables: dict[str, Any] = {"weight": ((), robot.mass * robot.gravity, {"units": "N", "long_name": "weight"})}
    for name, (dim, rows, unit, text) in quantities.items():
        values = np.array(rows)
        about = {"long_name": text} | ({"units": unit} if unit else {})
        variables[name] = ((*grid, dim) if dim else grid, values.reshape(*shape, *values.shape[1:]), about)
    coords = {
        "objective": list(OBJECTIVES),
        "direction": (
            "direction",
            list(directions),
            {"units": "deg", "long_name": "where the wind comes from; 90 is left"},
        ),
        "speed": ("speed", list(speeds), {"units": "m s-1", "long_name": "speed of the wind"}),
        "rpy": ["roll", "pitch", "yaw"],
        "xyz": list("xyz"),
        "joint": list(robot.joint_names),
        "jet": [jet.name for jet in robot.jets],
    }
    return xr.Dataset(variables, coords)

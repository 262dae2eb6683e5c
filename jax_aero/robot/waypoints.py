"""Generate a mission of waypoints: forward, sideways, climb, turn, hold, through points; from rest to rest.

A motion in one direction is smooth to third order, one through points has the least jerk.

    jax-aero robot waypoints box
    jax-aero fly results/waypoints/box/box.toml

A file of configs/waypoints names the experiment that it changes, a speed, and steps with one motion each. The result is
a recorded reference, which every engine can follow, and an experiment that flies it.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from jax_aero import rust
from jax_aero.base import places, plain_values, tables
from jax_aero.base.arguments import Parser
from jax_aero.base.files import write_text
from jax_aero.base.tables import Positive, Table
from jax_aero.base.terminal import ConfigError, Refused, exit_status
from jax_aero.results import study

Array = NDArray[np.float64]

SAMPLE, SMOOTH_SAMPLE = 0.05, 0.25
"""Time between rows of the reference [s]; between those of a motion through points, a spline of degree five."""
PEAK = 35.0 / 16.0
"""Greatest speed of a motion relative to its mean speed."""

COLUMNS = "time,x,y,z,roll,pitch,yaw,vx,vy,vz,ax,ay,az,jx,jy,jz"
"""Header of a recorded reference, as the crate's `control/recorded.rs` reads it."""


class Step(Table, frozen=True, kw_only=True):
    """One motion; exactly one of its keys is given, besides `speed`."""

    forward: float | None = None
    """Distance along the heading, negative for backwards [m]."""
    left: float | None = None
    """Distance to the left of the heading [m]."""
    climb: float | None = None
    """Distance upwards [m]."""
    climb_to: float | None = None
    """Height of the centre of mass above that of the start [m]."""
    turn_deg: float | None = None
    """Angle to the left [deg]."""
    hold: Positive | None = None
    """Duration of a hover [s]."""
    through: Annotated[tuple[tuple[float, float, float, float], ...], msgspec.Meta(min_length=1)] | None = None
    """Points that are passed with the least jerk: time from the start of the motion [s], and distances from its place
    along the heading, to the left and upwards [m]."""
    speed: Positive | None = None
    """Greatest speed of this motion [m/s, or deg/s for a turn]; by default that of the file."""

    def __post_init__(self) -> None:
        if len(self.motions) != 1:
            raise ConfigError.of("", self.motions, "one motion")
        times = [0.0, *(point[0] for point in self.through or ())]
        if any(later <= earlier for earlier, later in itertools.pairwise(times)):
            raise ConfigError.of("through", self.through, "times > 0, each later than the one before")

    @property
    def motions(self) -> dict[str, Any]:
        """Return the motions that are given, by key."""
        given = msgspec.structs.asdict(self)
        return {name: value for name, value in given.items() if name != "speed" and value is not None}


class Waypoints(Table, frozen=True, kw_only=True):
    """A mission of waypoints; one file of `configs/waypoints`."""

    experiment: Path
    """Experiment that is flown, with its mission and duration replaced."""
    title: str
    start: Annotated[float, msgspec.Meta(ge=0.0)] = 3.0
    """Time at which the first motion begins [s]."""
    speed: Positive = 2.0
    """Greatest speed [m/s]."""
    turn_speed_deg: Positive = 30.0
    """Greatest rate of a turn [deg/s]."""
    settling: Annotated[float, msgspec.Meta(ge=0.0)] = 5.0
    """Time flown after the last motion [s]."""
    lean: bool = False
    """Whether the robot leans along its acceleration, so that thrusts stay those of a hover; if not, it is upright."""
    steps: Annotated[tuple[Step, ...], msgspec.Meta(min_length=1)]


@dataclass(frozen=True)
class Reference:
    """Samples of the motion: times (k,) [s], derivatives 0 to 3 of the centre of mass (4, k, 3), heading (k,) [rad]."""

    times: Array
    com: Array
    heading: Array


def main(arguments: Sequence[str] | None = None) -> int:
    """Write a reference and an experiment that flies it; return the exit status."""
    parser = Parser("robot waypoints", __doc__)
    study.add_names(parser, "waypoints", "name")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the result (default results/waypoints)")
    parser.add_argument("--overwrite", action="store_true", help="replace files that differ")
    given = parser.parse_args(arguments)

    def work() -> None:
        path = study.find("waypoints", given.name)
        name = path.stem if given.out else study.result_name("waypoints", path)
        folder = (given.out or places.RESULTS / "waypoints") / name
        for file in write(path, tables.load(path, Waypoints), folder, overwrite=given.overwrite):
            print(os.path.relpath(file))

    return exit_status(work)


def write(path: Path, points: Waypoints, folder: Path, *, overwrite: bool = False) -> list[Path]:
    """Write `mission.csv` and the experiment; return both. Files that differ are replaced only with `overwrite`."""
    config = rust.load_config(points.experiment)
    com, rpy, forward = start_of(config)
    duration = points.start + sum(motion.duration for motion in motions(points, com, forward)) + points.settling
    # Checked before samples of this duration use memory.
    rust.check_config({**config, "simulator": {**config["simulator"], "duration": duration}})
    course = reference(points, com, forward)
    attitude = np.tile(rpy, (len(course.times), 1))
    attitude[:, 2] += course.heading
    if points.lean:
        attitude[:, :2] += lean(course.com[2], attitude[:, 2], rust.Robot(config["robot"]).gravity)
    rows = np.column_stack([course.times, course.com[0], attitude, *course.com[1:]])
    mission, flight = folder / "mission.csv", folder / f"{path.stem}.toml"
    text = reference_text(rows, f"jax-aero robot waypoints {path.stem}", 10)
    with TemporaryDirectory() as draft:
        write_text(Path(draft) / mission.name, text)
        rust.check_config({**config, "mission": {"file": str(Path(draft) / mission.name)}})
    # Base tables are merged, so the base's commands would remain beside the reference unless they are replaced.
    without = "".join(
        f", {name} = []" for name, value in config["mission"].items() if isinstance(value, list) and value
    )
    base = os.path.relpath(points.experiment, folder.resolve())
    files = {
        mission: text,
        flight: f"# Source: ours, jax-aero robot waypoints {path.stem}\n"
        f"base = {plain_values.toml_value(base)}\ntitle = {plain_values.toml_value(points.title)}\n"
        f'mission = {{ file = "mission.csv"{without} }}\nsimulator = {{ duration = {duration:g} }}\n',
    }
    for file, content in files.items():
        if file.exists() and not overwrite and file.read_bytes() != content.encode():
            raise Refused(f"`{file}` is there already, with other content; choose another --out, or --overwrite it")
    for file, content in files.items():
        write_text(file, content)
    return list(files)


def reference_text(rows: Array, about: str, digits: int) -> str:
    """Return a recorded reference as CSV, for `mission.file`; `rows` are as `COLUMNS`."""
    lines = [f"# Source: ours, {about}", COLUMNS, *(",".join(f"{value:.{digits}g}" for value in row) for row in rows)]
    return "\n".join(lines) + "\n"


def start_of(config: rust.Config) -> tuple[Array, Array, Array]:
    """Return centre of mass [m], roll, pitch and yaw [rad], and the horizontal forward direction of the first tick."""
    simulator = {**config["simulator"], "duration": config["controller"]["time_step"]}
    flight = rust.fly({**config, "mission": {}, "simulator": simulator})
    axis = tables.read(Path(config["robot"])).get("forward_axis", [1.0, 0.0, 0.0])
    forward = rust.rotation_from_wxyz(flight["base_quaternion"][0]) @ np.asarray(axis, dtype=np.float64)
    forward[2] = 0.0
    return flight["com_setpoint"][0], flight["base_rpy_setpoint"][0], forward / np.linalg.norm(forward)


class Motion(NamedTuple):
    """A step with its initial position and heading."""

    place: Array
    """Initial position of the centre of mass (3,) [m]."""
    heading: float
    """Initial heading [rad]."""
    shift: Array
    """Displacement (3,) [m]."""
    turn: float
    """Turn to the left [rad]."""
    duration: float
    """Duration [s]."""
    points: Array | None = None
    """Times from the start [s] and displacements of points on the way (k, 4); without them the way is straight."""


def motions(points: Waypoints, com: Array, forward: Array) -> list[Motion]:
    """Return the motions of the steps from an initial state; a motion by zero takes no time."""
    made: list[Motion] = []
    place, heading = np.array(com, dtype=np.float64), 0.0
    for step in points.steps:
        made.append(_motion(points, step, place, heading, com, forward))
        place, heading = place + made[-1].shift, heading + made[-1].turn
    return made


def reference(points: Waypoints, com: Array, forward: Array) -> Reference:
    """Return the samples of the steps from an initial state."""
    at_rest = np.stack([com, *np.zeros((3, 3))])[:, None]
    times, com_rows, headings = [np.array([points.start])], [at_rest], [np.zeros(1)]
    now = points.start
    for place, heading, shift, turn, duration, through in motions(points, com, forward):
        count = int(np.ceil(duration / (SAMPLE if through is None else SMOOTH_SAMPLE)))
        if count == 0:
            continue
        s = np.arange(1, count + 1) / count
        blend = _blend(s, duration)
        rows = blend[:, :, None] * shift if through is None else _least_jerk(through, s * duration)
        rows[0] += place
        times.append(now + duration * s)
        com_rows.append(rows)
        headings.append(heading + blend[0] * turn)
        now += duration
    return Reference(np.concatenate(times), np.concatenate(com_rows, axis=1), np.concatenate(headings))


def lean(acceleration: Array, yaw: Array, gravity: float) -> Array:
    """Return roll and pitch (k, 2) [rad] with which base z points along an acceleration (k, 3) [m/s²] less gravity."""
    x, y, z = acceleration.T
    ahead, left, up = np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x, z + gravity
    return np.column_stack([-np.arctan2(left, np.hypot(ahead, up)), np.arctan2(ahead, up)])


def _motion(points: Waypoints, step: Step, place: Array, heading: float, com: Array, forward: Array) -> Motion:
    """Return one step from its initial position and heading."""
    ((kind, value),) = step.motions.items()
    if kind == "hold":
        return Motion(place, heading, np.zeros(3), 0.0, value)
    if kind == "turn_deg":
        duration = PEAK * abs(value) / (step.speed or points.turn_speed_deg)
        return Motion(place, heading, np.zeros(3), float(np.radians(value)), duration)
    cos, sin = np.cos(heading), np.sin(heading)
    ahead = np.array([cos * forward[0] - sin * forward[1], sin * forward[0] + cos * forward[1], 0.0])
    left, up = np.array([-ahead[1], ahead[0], 0.0]), np.array([0.0, 0.0, 1.0])
    if kind == "through":
        passed = np.array(value)
        passed[:, 1:] = passed[:, 1:] @ np.stack([ahead, left, up])
        return Motion(place, heading, passed[-1, 1:], 0.0, passed[-1, 0], passed)
    shift: Array = {
        "forward": value * ahead,
        "left": value * left,
        "climb": value * up,
        "climb_to": (com[2] + value - place[2]) * up,
    }[kind]
    duration = PEAK * float(np.linalg.norm(shift)) / (step.speed or points.speed)
    return Motion(place, heading, shift, 0.0, duration)


def _least_jerk(points: Array, times: Array) -> Array:
    """Return displacement and three derivatives (4, k, 3) of the motion from rest to rest with the least jerk.

    Through given points at given times this is the spline of degree five.
    """
    ends = [(order, np.zeros(3)) for order in (1, 2)]
    knots = np.concatenate([np.zeros((1, 4)), points])
    way = make_interp_spline(knots[:, 0], knots[:, 1:], k=5, bc_type=(ends, ends))
    return np.stack([way(times, order) for order in range(4)])


def _blend(s: Array, duration: float) -> Array:
    """Return a rise from 0 to 1 at s = t/T with three time derivatives, (4, k): `35 s⁴ − 84 s⁵ + 70 s⁶ − 20 s⁷`."""
    rise = np.polynomial.Polynomial([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
    return np.stack([rise.deriv(order)(s) / duration**order if order else rise(s) for order in range(4)])

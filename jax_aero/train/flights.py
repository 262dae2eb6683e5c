"""What flights record of the air: wrenches that an observer estimates from logs, and windows that train a network.

    LOG ──read──► Flight: attitude, air, joints, observed wrench ──windows──► Windows of jax_aero.train.wrench

A log whose controller had a disturbance observer and no aerodynamic model holds the wrench of the air; every other log
is replayed through its controller with both.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.aero.network import (
    LinkGeometry,
    Network,
    baseline_areas,
    features,
    geometry_from_kinematics,
    raw_output,
    to_base_axes,
    unit_wind,
)
from jax_aero.base.terminal import Refused
from jax_aero.body.kinematics import kinematics_at_rest
from jax_aero.body.robot import RobotModel
from jax_aero.identify import samples
from jax_aero.train.samples import chunks
from jax_aero.train.wrench import ObservedWrenches, Windows, windows_of, wrench
from jax_aero.types import Array

NEEDED = (*samples.NOISY, "raw_wind")
"""Signals without which a log does not determine the air."""
GAIN = 3.0
"""Gain of the observer of a log whose controller had none [1/s]; that of `configs/control/observer.toml`."""
LIMITS = {"force_max": 600.0, "moment_max": 100.0}
"""Of that observer [N, N m]."""
WIND_LEAST, WIND_MOST = 2.0, 45.0
"""Speed of the air relative to the robot in a tenth of a log at least, and in any row at most [m/s]."""
STUCK = 3.0
"""Time for which a wind that is measured does not stay the same to the last bit [s]."""
CONSTANT_MOST = 0.3
"""Share of the weight that wrong masses and thrusts explain at most."""
SCALE_MOST, ALIKE = 3.0, 0.5
"""Factor between the observed force and that of the robot's own coefficients that no coefficients explain, where both
go together, by their correlation."""
LEAST = 8.0
"""Least time of a log that counts [s]."""
SECTOR = 30.0
"""Width of the sectors of the wind's direction that flights know, or do not [deg]."""
KNOWN = 2.0
"""Time for which flights were in a sector that they know [s]."""


class Flight(NamedTuple):
    """What a log holds of the air, k ticks."""

    name: str
    step: float
    """Time between ticks [s]."""
    turn: Float[np.ndarray, "k 3 3"]
    """Rotation of the base."""
    air: Float[np.ndarray, "k 3"]
    """Velocity of the air relative to the base, base axes [m/s]."""
    joints: Float[np.ndarray, "k n"]
    """[rad]"""
    wrench: Float[np.ndarray, "k 6"]
    """Observed wrench about the centre of mass, inertial axes [N, N m]."""
    is_valid: Bool[np.ndarray, " k"]
    gain: tuple[float, float]
    """Gains of the observer for force and moment [1/s]."""
    pressure: Float[np.ndarray, " k"]
    """Dynamic pressure at the base [Pa]."""

    @property
    def seconds(self) -> float:
        """Return the time that counts [s]."""
        return float(self.is_valid.sum()) * self.step


# --- reading -----------------------------------------------------------------------------------------------------


def observing(config: rust.Config) -> rust.Config:
    """Return a configuration whose controller observes the whole wrench of the air: without a model of it."""
    observed = copy.deepcopy(dict(config))
    controller = observed["controller"]
    if controller.get("wind_observer"):
        raise Refused("the controller's wind is estimated, not measured (`controller.wind_observer`)")
    controller["aero"] = {"model": "off"}
    if not controller.get("disturbance_observer"):
        controller["disturbance_observer"] = {"gain_force": GAIN, "gain_moment": GAIN} | LIMITS
    return rust.resolve_config(observed)


def read(path: Path, mapping: Path | None, config: rust.Config, robot: RobotModel, air_density: float) -> Flight:
    """Return what a log holds of the air.

    Raises
    ------
    Refused
        For a log in still air, on the ground, too short, in a wrong unit, with a stuck anemometer or of another robot;
        the message names the log and the reason.
    """
    signals = samples.read(path, mapping, config, config["robot"], NEEDED)
    return flight_of(str(path), signals, config, robot, air_density)


def flight_of(
    name: str,
    signals: Mapping[str, NDArray[np.float64]],
    config: rust.Config,
    robot: RobotModel,
    air_density: float = 1.225,
) -> Flight:
    """Return what the signals of a log hold of the air, or refuse them."""
    crate, wind = rust.Robot(config["robot"]), signals["raw_wind"]
    step = float(config["controller"]["time_step"])
    fastest = float(np.nanmax(np.linalg.norm(wind, axis=1)))
    if fastest > WIND_MOST:
        raise Refused(f"`raw_wind` of `{name}` reaches {fastest:.3g}; expected m/s, at most {WIND_MOST:g} (km/h?)")
    watched = observing(config)
    observer = watched["controller"]["disturbance_observer"]
    is_there = watched["controller"] == rust.resolve_config(config)["controller"] and "unmodelled_wrench" in signals
    try:
        computed = signals if is_there else rust.replay(watched, signals)
    except ValueError as reason:
        raise Refused(f"`{name}`: {reason}") from None
    w, x, y, z = np.moveaxis(computed["measured_base_quaternion"], -1, 0)
    turn = rust.rotation_from_wxyz(np.stack([w, x, y, z], -1))
    relative = computed["measured_wind"] - computed["measured_base_velocity"][:, :3]
    air = np.einsum("kji,kj->ki", turn, relative)
    seen = computed["unmodelled_wrench"]
    joints = signals["raw_joint_position"]
    time = signals["time"]
    left_out = samples.left_out(signals, crate)
    stuck = _stuck(wind, step)
    if stuck.mean() > samples.LEAST_SHARE:
        what = f"`raw_wind` of `{name}` does not change in {100.0 * stuck.mean():.0f} % of its ticks"
        raise Refused(f"{what}; expected a measurement (a stuck anemometer?), or turbulence")
    if np.nanquantile(np.linalg.norm(air, axis=1), 0.9) < WIND_LEAST:
        raise Refused(f"`{name}` is flown in still air; expected wind of {WIND_LEAST:g} m/s or more")
    weight = crate.mass * crate.gravity
    speed = np.linalg.norm(computed["measured_base_velocity"][:, :3], axis=1)
    stands = left_out["feet loaded"] | ((seen[:, 2] > samples.STANDING[0] * weight) & (speed < samples.STANDING[1]))
    every = np.column_stack([air, seen, joints, turn.reshape(len(turn), 9)])
    names = ("rows lost", "engines idle", "odometry jumps", "joints beyond stops")
    wrong = {key: left_out[key] for key in names} | {
        "on the ground, or with thrusts in another unit": stands,
        "anemometer stuck": stuck,
    }
    wrong["not measured"] = ~np.isfinite(every).all(axis=1)
    is_valid = ~np.any([_spread(rows, step) for rows in wrong.values()], axis=0)
    is_valid &= (time > time[0] + samples.SETTLING) & (time < time[-1] - samples.SETTLING)
    if is_valid.sum() * step < LEAST:
        reasons = ", ".join(f"{rows.sum()} {reason}" for reason, rows in wrong.items() if rows.any())
        has = f"{is_valid.sum() * step:g} s in the air and the wind"
        of_them = f"; ticks left out: {reasons}" if reasons else ""
        raise Refused(f"`{name}` has {has}; expected at least {LEAST:g} s{of_them}")
    flight = Flight(
        Path(name).name,
        step,
        turn,
        np.nan_to_num(air),
        np.nan_to_num(joints),
        np.nan_to_num(seen),
        is_valid,
        (float(observer["gain_force"]), float(observer["gain_moment"])),
        0.5 * air_density * np.nan_to_num(air**2).sum(axis=1),
    )
    _check_size(flight, robot, weight)
    return flight


def _spread(rows: NDArray[np.bool_], step: float) -> NDArray[np.bool_]:
    """Return the ticks within `samples.REACH` of a marked one."""
    reach = int(np.ceil(samples.REACH / step))
    return np.convolve(rows, np.ones(2 * reach + 1), mode="same") > 0.0


def _stuck(wind: Float[np.ndarray, "k 3"], step: float) -> NDArray[np.bool_]:
    """Return the ticks in which the wind has had one value for `STUCK` or longer, or will have."""
    changes = np.flatnonzero(np.any(np.diff(wind, axis=0) != 0.0, axis=1)) + 1
    edges = np.concatenate([[0], changes, [len(wind)]])
    lengths = np.diff(edges)
    return np.repeat(lengths * step >= STUCK, lengths)


def _check_size(flight: Flight, robot: RobotModel, weight: float) -> None:
    """Refuse forces that have another unit, or are of another robot or of another wind."""
    force = flight.wrench[flight.is_valid, :3]
    if abs(vertical := float(np.median(force[:, 2]))) > CONSTANT_MOST * weight:
        what = f"thrusts of `{flight.name}` carry {100.0 * (1.0 - vertical / weight):.0f} % of the robot's weight"
        raise Refused(f"{what}; expected about all of it (another unit, or another robot?)")
    sets = robot.aero_links.coefficients
    if not sets:
        return
    rows = np.flatnonzero(flight.is_valid)[:: max(1, round(0.2 / flight.step))]
    geometry, arms = geometry_of(robot, flight.joints[rows])
    usual = baseline_wrench(np.asarray(next(iter(sets.values()))), flight, rows, geometry.axes, arms)[:, :3]
    usual, measured = usual - usual.mean(axis=0), flight.wrench[rows, :3] - flight.wrench[rows, :3].mean(axis=0)
    along = float(np.sum(usual * measured))
    alike = along / (np.linalg.norm(usual) * np.linalg.norm(measured) + 1e-9)
    factor = along / (float(np.sum(usual**2)) + 1e-9)
    if alike > ALIKE and not 1.0 / SCALE_MOST < factor < SCALE_MOST:
        what = f"the force in `{flight.name}` is {factor:.2g} times that of the robot's coefficients in `raw_wind`"
        raise Refused(f"{what}; expected {1.0 / SCALE_MOST:.2g} to {SCALE_MOST:g} times (wind in km/h or knots?)")


# --- windows -----------------------------------------------------------------------------------------------------


@jax.jit
def _geometries(robot: RobotModel, joints: Array) -> tuple[LinkGeometry, Array]:
    def of_row(joints: Array) -> tuple[LinkGeometry, Array]:
        kin = kinematics_at_rest(robot, joints)
        return geometry_from_kinematics(robot, kin), kin.com

    return jax.vmap(of_row)(joints)


def geometry_of(robot: RobotModel, joints: Float[np.ndarray, "k n"]) -> tuple[LinkGeometry, Float[np.ndarray, "k L 3"]]:
    """Return the geometry of the links at joint positions [rad], and their arms from the centre of mass [m]."""
    parts = []
    with jax.enable_x64(True):
        for count, (rows,) in chunks(joints):
            geometry, com = jax.tree.map(lambda leaf, count=count: np.asarray(leaf)[:count], _geometries(robot, rows))
            parts.append((geometry, geometry.centres - com[:, None]))
    whole: tuple[LinkGeometry, Any] = jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
    return whole


def baseline_wrench(
    coefficients: Float[np.ndarray, "L 6"],
    flight: Flight,
    rows: NDArray[np.int64],
    axes: Any,
    arms: Any,
) -> Float[np.ndarray, "k 6"]:
    """Return the wrench of axisymmetric coefficients [m²] in some ticks, inertial axes [N, N m].

    `axes` and `arms` (k, L, 3) are those of `geometry_of` in these ticks.
    """
    wrenches = _wrenches(coefficients, flight.air[rows], flight.pressure[rows], axes, arms, flight.turn[rows])
    return np.asarray(wrenches, np.float64)


@jax.jit
@partial(jax.vmap, in_axes=(None, 0, 0, 0, 0, 0))
def _wrenches(coefficients: Array, air: Array, pressure: Array, axes: Array, arms: Array, turn: Array) -> Array:
    return wrench(baseline_areas(coefficients, unit_wind(air), axes), arms, turn, pressure)


@dataclass(frozen=True)
class Sampling:
    """How windows are taken from flights [s]."""

    step: float
    """Time between rows."""
    window: float
    """Longest window."""
    settling: float
    """Time at the start of a window in which the observer's first state decays."""


def windows(
    flights: Sequence[Flight], network: Network, robot: RobotModel, objective: ObservedWrenches, sampling: Sampling
) -> Windows:
    """Return the windows of flights, all of one length: that of the shortest flight, or `sampling.window`."""
    every = [max(1, round(sampling.step / flight.step)) for flight in flights]
    rows = [np.arange(0, len(flight.turn), each) for flight, each in zip(flights, every, strict=True)]
    length = min(round(sampling.window / sampling.step), *map(len, rows))
    settling = round(sampling.settling / sampling.step)
    parts: list[Windows] = []
    for flight, here in zip(flights, rows, strict=True):
        # A row counts if the ticks since the last one do.
        each = max(1, round(sampling.step / flight.step))
        is_valid = np.array([flight.is_valid[max(0, k - each + 1) : k + 1].all() for k in here])
        whole = _rows(flight, here, network, robot)
        for window, weight in windows_of(len(here), length, is_valid, settling):
            blank = np.zeros(0)  # until the weights are known
            parts.append(Windows(*(part[window] for part in whole), weight, blank, blank))  # type: ignore[call-arg]
    joined = Windows(*(np.stack(leaves).astype(np.float32) for leaves in zip(*parts, strict=True)))
    return objective.with_constants(joined)


def _rows(flight: Flight, rows: NDArray[np.int64], network: Network, robot: RobotModel) -> tuple[Any, ...]:
    """Return the first eight parts of `Windows` in some ticks of a flight."""
    geometry, arms = geometry_of(robot, flight.joints[rows])
    air = flight.air[rows]
    x, unit = features_of(network, air, flight.joints[rows], geometry)
    pose = geometry.rotations, geometry.axes, arms
    return x, flight.turn[rows], flight.pressure[rows], unit, *pose, flight.wrench[rows]


def network_wrench(
    network: Network, flight: Flight, rows: NDArray[np.int64], robot: RobotModel
) -> Float[np.ndarray, "k 6"]:
    """Return the wrench that a network says in some ticks, inertial axes [N, N m]."""
    x, turn, pressure, unit, rotations, axes, arms, _ = _rows(flight, rows, network, robot)
    wrenches = _wrenches_of(network, x[:, 0], unit, rotations, axes, arms, turn, pressure)
    return np.asarray(wrenches, np.float64)


@jax.jit
@partial(jax.vmap, in_axes=(None, *[0] * 7))
def _wrenches_of(
    network: Network, x: Array, unit: Array, rotations: Array, axes: Array, arms: Array, turn: Array, pressure: Array
) -> Array:
    areas = to_base_axes(network.frame, network.layout, raw_output(network, x), rotations)
    if network.baseline is not None:
        areas = areas + baseline_areas(network.baseline, unit, axes)
    return wrench(areas, arms, turn, pressure)


def features_of(
    network: Network, air: Float[np.ndarray, "k 3"], joints: Float[np.ndarray, "k n"], geometry: LinkGeometry
) -> tuple[Float[np.ndarray, "k copies x"], Float[np.ndarray, "k 3"]]:
    """Return the features of rows, with those of their mirror images for a symmetric network, and unit winds."""
    features, unit = _features(network.blocks, air, joints[:, list(network.joints)], geometry)
    x = np.asarray(features, np.float32)
    copies = [x] if network.mirror is None else [x, x @ np.asarray(network.mirror.features, np.float32).T]
    return np.stack(copies, axis=1), np.asarray(unit)


@partial(jax.jit, static_argnums=0)
@partial(jax.vmap, in_axes=(None, 0, 0, 0))
def _features(blocks: tuple[str, ...], air: Array, joints: Array, geometry: LinkGeometry) -> tuple[Array, Array]:
    wind = unit_wind(air)
    return features(blocks, wind, joints, geometry), wind


# --- what flights know -------------------------------------------------------------------------------------------


def known(flights: Sequence[Flight], robot: RobotModel) -> dict[str, Any]:
    """Return what flights know: seconds by sector of where the air comes from about the base, speeds, joints [deg].

    A sector is named by the angle of its middle, 0 from ahead, 90 from the left.
    """
    air = np.concatenate([flight.air[flight.is_valid] for flight in flights])
    step = np.concatenate([np.full(flight.is_valid.sum(), flight.step) for flight in flights])
    joints = np.degrees(np.concatenate([flight.joints[flight.is_valid] for flight in flights]))
    low, high = np.quantile(joints, (0.005, 0.995), axis=0)
    middles = np.arange(0.0, 360.0, SECTOR)
    seconds = np.bincount(sector_of(air, robot), step, minlength=len(middles))
    speed = np.linalg.norm(air, axis=1)
    of_sectors = {f"{middle:g}": round(float(of), 1) for middle, of in zip(middles, seconds, strict=True)}
    ends = zip(robot.joint_names, np.round(low, 2).tolist(), np.round(high, 2).tolist(), strict=True)
    return {
        "seconds by direction of the wind [deg]": of_sectors,
        "speed of the air [m/s]": [round(float(part), 2) for part in np.quantile(speed, (0.005, 0.995))],
        "joints [deg]": {name: [least, most] for name, least, most in ends},
    }


def sector_of(air: Float[np.ndarray, "k 3"], robot: RobotModel) -> NDArray[np.int64]:
    """Return the sector from which the air comes in each row, by its number from ahead to the left."""
    forward = np.asarray(robot.forward_axis)
    left = np.cross([0.0, 0.0, 1.0], forward)
    angle = np.degrees(np.arctan2(-air @ left, -air @ forward))
    return np.asarray(np.round(angle / SECTOR).astype(np.int64) % round(360.0 / SECTOR))


def unknown(facts: Mapping[str, Any]) -> list[str]:
    """Return the sectors in which flights hardly were."""
    of = facts["seconds by direction of the wind [deg]"]
    return [f"{middle} deg" for middle, seconds in of.items() if seconds < KNOWN]

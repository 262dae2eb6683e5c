"""Greatest growth of a moment with the attitude before the robot turns over: predicted and flown.

`jax-aero study observer_limit` applies a moment M = k_a θ about one axis of the hovering robot, with θ its
rotation about that axis, without wind or aerodynamic model. The greatest k_a that is held is determined in two ways for
every gain of the observer: from the eigenvalues of the linearised loop, whose Jacobian CasADi derives, and by flights
with the crate's plant and controller. The result goes to `results/observer_limit/hover/`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal

import casadi as ca
import msgspec
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from experiments.study import Findings, Study
from jax_aero import rust
from jax_aero.base import tables

AXES = {"roll": 0, "yaw": 2}
"""Indices of the axes in base axes."""
EXPERIMENT = "test1_observer"
STILL = {"profile": "constant", "velocity": [0.0, 0.0, 0.0]}
SETTINGS = {"mission": {}, "wind": STILL, "simulator.initial.free_fall_tick": False}
PUSH, PUSHED = 0.1, 0.3
"""Initial moment and its duration [N m, s]."""
LOST = 0.5
"""Sine of the rotation beyond which the robot does not recover."""
SEARCH = (0.2, 200.0)
"""Interval of the search [N m/rad]."""


class ObserverLimit(tables.Table, frozen=True):
    """Settings of the search."""

    gains: tuple[tables.NonNegative, ...] = (0.0, 1.0, 2.0, 3.0, 5.0, 10.0)
    """K_o [1/s]; zero is the published controller."""
    axes: tuple[Literal["roll", "yaw"], ...] = ("roll", "yaw")
    duration: Annotated[float, msgspec.Meta(ge=0.03)] = 12.0
    """Duration of a flight, whose last two thirds are compared [s]."""

    def __post_init__(self) -> None:
        tables.check_levels(self, "gains", "axes")


def compute(_: str, limits: ObserverLimit) -> Findings:
    """Predict and fly."""
    gains, axes = limits.gains, limits.axes
    config = rust.load_config(EXPERIMENT, SETTINGS)
    inertia = hovering_inertia(config)
    predicted = [[predicted_limit(config, inertia[AXES[axis], AXES[axis]], gain) for gain in gains] for axis in axes]
    flown = [[flown_limit(config, AXES[axis], gain, limits.duration) for gain in gains] for axis in axes]
    what = {"predicted": "from the linearised loop", "flown": "of the crate's plant and controller"}
    data = xr.Dataset(
        {
            key: (("axis", "gain"), values, {"units": "N m rad-1", "long_name": f"greatest dM/dθ, {what[key]}"})
            for key, values in (("predicted", predicted), ("flown", flown))
        },
        {"axis": list(axes), "gain": ("gain", list(gains), {"units": "s-1", "long_name": "gain of the observer"})},
    )
    summary = {
        f"{axis}, K_o {gain:g}: {key} [N m/rad]": float(data[key].sel(axis=axis, gain=gain))
        for axis in axes
        for gain in gains
        for key in what
    }
    return Findings("Greatest destabilising moment slope", data, summary, flights={EXPERIMENT: config})


STUDY = Study("observer_limit", __doc__, ObserverLimit, compute, ("hover",))
main = STUDY.main


def loop(inertia: float, c0: float, c1: float, gain: float, slope: float) -> NDArray[np.float64]:
    """Return the Jacobian of the loop of one axis: rotation θ, rate ω, jets' moment M, observed moment ŵ."""
    x = ca.SX.sym("x", 4)
    angle, rate, moment, observed = ca.vertsplit(x)
    known = moment + observed  # k̇ as the controller estimates it, M59
    demand = -rate - (1.0 + c0 / inertia) * known - c0 / inertia * ca.sin(angle) - c1 * rate  # M60
    acting = slope * angle
    motion = ca.vertcat(rate, (moment + acting) / inertia, demand, gain * (acting - observed))  # M83
    return np.array(ca.DM(ca.Function("jacobian", [x], [ca.jacobian(motion, x)])(np.zeros(4))))


def predicted_limit(config: Mapping[str, Any], inertia: float, gain: float) -> float:
    """Return the greatest slope [N m/rad] for which no mode of the linear loop grows."""
    gains = config["controller"]["momentum"]

    def is_held(slope: float) -> bool:
        modes = np.linalg.eigvals(loop(inertia, gains["c0"], gains["c1"], gain, slope))
        return bool(modes.real.max() < 1e-9)  # an observer with zero gain is a mode at zero

    return _limit(is_held, 1e-4)


def flown_limit(config: Mapping[str, Any], axis: int, gain: float, duration: float) -> float:
    """Return the greatest slope [N m/rad] with which the robot recovers."""
    return _limit(lambda slope: comes_back(config, axis, gain, slope, duration), 0.02)


def comes_back(config: Mapping[str, Any], axis: int, gain: float, slope: float, duration: float) -> bool:
    """Return whether the robot recovers from a push about one base axis, with a moment proportional to the rotation."""
    changes = {"simulator.duration": duration, "controller.observer.gain_moment": gain}
    flight = rust.Flight(rust.load_config(EXPERIMENT, {**SETTINGS, **changes}))
    desired = np.asarray(flight.truth.state.base_rotation)
    angles = []
    for _ in range(round(duration / config["simulator"]["time_step"])):
        now = flight.truth
        rotation = np.asarray(now.state.base_rotation)
        angles.append(_rotation_about(axis, desired.T @ rotation))
        if abs(angles[-1]) > LOST:
            return False
        push = PUSH if now.time < PUSHED else 0.0
        acting = rotation[:, axis] * (slope * angles[-1] + push)
        flight.step(link_forces=couple(flight.try_tick(), acting))
    middle, end = np.array_split(np.abs(angles), 3)[1:]
    return bool(end.max() < middle.max())


def hovering_inertia(config: Mapping[str, Any]) -> NDArray[np.float64]:
    """Return the centroidal inertia of the hovering robot, base axes [kg m²]."""
    flight = rust.Flight(config)
    rotation = np.asarray(flight.truth.state.base_rotation)
    inertia: NDArray[np.float64] = rotation.T @ flight.try_tick().centroidal_inertia @ rotation
    return inertia


def couple(tick: rust.Tick, moment: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the smallest link forces with zero sum and this moment about the centre of mass [N]."""
    arms = tick.link_arm_points - tick.com_position
    rows = np.vstack([np.hstack([np.eye(3)] * len(arms)), np.concatenate(np.cross(np.eye(3), arms[:, None]), axis=1)])
    found, *_ = np.linalg.lstsq(rows, np.concatenate([np.zeros(3), moment]), rcond=None)
    return np.asarray(found, dtype=np.float64).reshape(-1, 3)


def _limit(is_held: Callable[[float], bool], accuracy: float) -> float:
    """Return the greatest slope that is held, by bisection of its logarithm."""
    low, high = SEARCH
    while high / low > 1.0 + accuracy:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if is_held(middle) else (low, middle)
    return low


def _rotation_about(axis: int, error: NDArray[np.float64]) -> float:
    """Return the sine of the rotation about one axis, as in the attitude law (M59)."""
    before, after = (axis + 1) % 3, (axis + 2) % 3
    return float(error[after, before] - error[before, after]) / 2.0

"""What a log measured, at the same moments and smooth enough to be differentiated."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments import Refused
from jax_aero import rust
from jax_aero.train.identify import Samples
from jax_aero.view import logs

Array = NDArray[np.float64]

PERIOD = 0.1
"""Time between two samples [s]."""
WIDTH = 0.05
"""Standard deviation of the Gaussian that smooths all signals alike [s]."""
SETTLING = 1.0
"""Time at the start of a log that is left out [s]: a flight begins with a step."""
MEASURED = ("raw_base_rotation", "raw_base_velocity", "raw_joint_position", "raw_thrust", "raw_wind", "joint_torque")


def read(path: Path, mapping: Path | None, config: rust.Config, robot_file: str) -> dict[str, Array]:
    """Return the signals of a log at the ticks of its controller.

    Raises
    ------
    Refused
        For a log that lacks a signal, or numbers of it.
    """
    robot, period = rust.Robot(robot_file), float(config["controller"]["time_step"])
    found = logs.at_ticks(logs.read(path, config, mapping, robot_file), robot, period, path).signals
    return check(found, str(path))


def check(signals: Mapping[str, Array], log: str) -> dict[str, Array]:
    """Return the signals of a log, of which every row is measured, or refuse it."""
    for name in MEASURED:
        if name not in signals:
            raise Refused(f"`{log}` has no `{name}`; expected measurements and commands")
        if not np.isfinite(signals[name]).all():
            raise Refused(f"`{log}` lacks numbers of `{name}`; expected every row")
    if (time := signals["time"])[-1] - time[0] < 2.0 * SETTLING + 10.0 * PERIOD:
        raise Refused(f"`{log}` has {time[-1] - time[0]:g} s; expected at least {2.0 * SETTLING + 10.0 * PERIOD:g} s")
    return dict(signals)


def sample(signals: Mapping[str, Array], config: rust.Config) -> Samples:
    """Return smoothed samples, each signal taken as late as the controller's estimator says that it is measured."""
    estimator = config["controller"].get("estimator") or {}

    def late(name: str) -> float:
        table = estimator.get(name) or {}
        return float(table.get("delay", 0.0))

    time = signals["time"]
    at = np.arange(time[0] + SETTLING, time[-1] - SETTLING, PERIOD)

    def smooth(rows: Array, delay: float, derivative: int = 0) -> Array:
        flat = rows.reshape(time.size, int(np.prod(rows.shape[1:])))
        return _smooth(time, flat, at + delay, derivative).reshape(at.size, *rows.shape[1:])

    rotation, velocity = signals["raw_base_rotation"], signals["raw_base_velocity"]
    rotation_late, linear_late = late("base_rotation"), late("base_linear_velocity")
    # The measured rotation turned the gyroscope's rates to inertial axes.
    gyro = np.einsum("kba,kb->ka", rotation, velocity[:, 3:])
    left, _, right = np.linalg.svd(smooth(rotation, rotation_late))
    # A torque reaches its joint later than its tick, a measurement its tick later than its cause.
    torque_late = -float((estimator.get("latency") or {}).get("torque", 0.0))
    joints, rates = signals["raw_joint_position"], late("base_angular_velocity")
    return Samples(
        rotation=left @ right,
        linear_velocity=smooth(velocity[:, :3], linear_late),
        linear_acceleration=smooth(velocity[:, :3], linear_late, 1),
        gyro=smooth(gyro, rates),
        gyro_rate=smooth(gyro, rates, 1),
        joint_position=smooth(joints, 0.0),
        joint_velocity=smooth(joints, 0.0, 1),
        joint_acceleration=smooth(joints, 0.0, 2),
        thrust=smooth(signals["raw_thrust"], late("thrust")),
        torque=smooth(signals["joint_torque"], torque_late),
        wind=smooth(signals["raw_wind"], 0.0),
    )


def latencies(log: Mapping[str, Array]) -> dict[str, tuple[float, float]]:
    """Return median and standard deviation of the latencies that the controller's monitor measured, if it did [s]."""
    found = {}
    for key in ("torque", "thrust"):
        rows = log.get(f"measured_{key}_latency", np.array([np.nan]))
        rows = rows[np.isfinite(rows)]
        rows = rows[rows.size // 10 :]
        if rows.size:
            found[key] = (float(np.median(rows)), float(np.std(rows)))
    return found


def _smooth(time: Array, rows: Array, at: Array, derivative: int) -> Array:
    """Return the convolution with a Gaussian, or with its first or second derivative, (times, entries)."""
    step = float(np.median(np.diff(time)))
    reach = int(6.0 * WIDTH / step)
    offsets = np.arange(-reach, reach + 1)
    near = np.rint((at - time[0]) / step).astype(int)
    found = np.empty((at.size, rows.shape[1]))
    for row, (moment, centre) in enumerate(zip(at, near, strict=True)):
        places = np.clip(centre + offsets, 0, time.size - 1)
        u = (moment - time[places]) / WIDTH
        smoothing = np.exp(-0.5 * u**2)
        kernel = smoothing / smoothing.sum()
        if derivative:
            slope = kernel * (-u / WIDTH if derivative == 1 else (u**2 - 1.0) / WIDTH**2)
            slope -= slope.sum() * kernel
            # Exact for a ramp, or a parabola.
            kernel = slope / np.sum(slope * (-WIDTH * u) ** derivative / derivative)
        found[row] = kernel @ rows[places]
    return found

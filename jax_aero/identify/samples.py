"""What a log measured, at the same moments and smooth enough to be differentiated."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from jax_aero import rust
from jax_aero.base.terminal import Refused
from jax_aero.body.spatial import nearest_rotation
from jax_aero.identify.motion import WIDTH, Samples
from jax_aero.view import logs, measured

Array = NDArray[np.float64]

PERIOD = 0.1
"""Time between two samples [s]."""
SETTLING = 1.0
"""Time at the start of a log that is left out [s]: a flight begins with a step."""
NOISY = ("raw_base_position", "raw_base_rotation", "raw_base_velocity", "raw_joint_position", "raw_thrust")
"""Signals of sensors."""
MEASURED = (*NOISY, "joint_torque")
"""Signals without which there are no samples; `raw_wind` may be missing."""
BRIDGED = (0.05, 3.0)
"""Gaps between rows that are interpolated: of that time [s], or that many steps."""
LEAST_SHARE = 0.5
"""Least share of the samples in flight that a log keeps."""
LEAST = 3.0
"""Least time of flight that a log needs [s]."""
REACH = 0.2
"""Time about a tick that is left out, in which samples are left out too [s]: what smoothing and delays spread."""
IDLE = 0.02
"""Share of the greatest thrust below which an engine idles or is off."""
MOST = 0.8
"""Share of a log in which engines do not idle: such a robot does not fly."""
LOADED = 0.02
"""Share of the weight on the feet from which the robot does not fly."""
STANDING = (0.3, 0.3)
"""Share of the weight that no thrust carries, and speed [m/s], at which a robot stands on something."""
JUMP = 8.0
"""Deviations of the odometry's own noise that no motion between two ticks makes."""
JUMPS = {"raw_base_position": 0.05, "raw_base_velocity": 0.5, "raw_base_rotation": 0.1}
"""Least change of a sensor that is a jump [m, m/s, rad]."""


def read(
    path: Path, mapping: Path | None, config: rust.Config, robot_file: str, needed: Sequence[str] = MEASURED
) -> dict[str, Array]:
    """Return the signals of a log at the ticks of its controller.

    Raises
    ------
    Refused
        For a log that lacks a signal, or is short.
    """
    config = {**config, "robot": robot_file}
    ticks = measured.of_controller(logs.read(path, config, mapping, robot_file), config, path)
    return check(ticks.signals, str(path), rust.Robot(robot_file), needed)


def check(
    signals: Mapping[str, Array], log: str, robot: rust.Robot, needed: Sequence[str] = MEASURED
) -> dict[str, Array]:
    """Return the signals of a log with all that samples need, or refuse it."""
    if not robot.joint_names:
        signals = {**signals, "joint_torque": np.zeros((signals["time"].size, 0))}
    for name in needed:
        if name not in signals or not np.isfinite(signals[name]).all(axis=tuple(range(1, signals[name].ndim))).any():
            raise Refused(f"`{log}` has no `{name}`; expected measurements and commands")
    least = 2.0 * SETTLING + 10.0 * PERIOD
    if (time := signals["time"])[-1] - time[0] < least:
        raise Refused(f"`{log}` has {time[-1] - time[0]:g} s; expected at least {least:g} s (times in ms?)")
    return dict(signals)


def left_out(signals: Mapping[str, Array], robot: rust.Robot) -> dict[str, NDArray[np.bool_]]:
    """Return the ticks that the equations of flight do not cover, by reason, (ticks,)."""
    time = signals["time"]
    flat = {name: rows.reshape(time.size, int(np.prod(rows.shape[1:]))) for name, rows in signals.items()}
    thrust, most = flat["raw_thrust"], np.array(robot.thrust_max)
    idle = np.maximum(np.array(robot.thrust_min), IDLE * most)
    torque = np.abs(flat.get("joint_torque", np.zeros((time.size, len(robot.joint_names)))))
    reasons = {
        "rows lost": ~np.all([np.isfinite(flat[name]).all(axis=1) for name in MEASURED if name in flat], axis=0),
        "feet loaded": np.zeros(time.size, dtype=np.bool_),
        "engines idle": np.any(thrust < idle, axis=1) & (np.max(thrust, axis=1, initial=0.0) > 0.0),
        "commands saturated": np.any(torque > 0.999 * robot.arrays()["joint_torque_max"], axis=1),
        "odometry jumps": _jumps(signals),
        "joints beyond stops": np.any(np.abs(flat["raw_joint_position"]) > measured.beyond(robot), axis=1),
    }
    for name, often in (("engines idle", MOST), ("joints beyond stops", measured.OFTEN)):
        if reasons[name].mean() > often:  # then it is not the engines or joints that are wrong, but the log
            reasons[name][:] = False
    if "raw_foot_wrench" in flat:
        load = np.linalg.norm(flat["raw_foot_wrench"].reshape(time.size, -1, 6)[..., :3].sum(axis=1), axis=1)
        reasons["feet loaded"] = np.nan_to_num(load) > LOADED * robot.mass * robot.gravity
    return reasons


def _jumps(signals: Mapping[str, Array]) -> NDArray[np.bool_]:
    """Return the ticks at which position, velocity or attitude change by more than their rates and noise explain."""
    time, velocity = signals["time"], signals["raw_base_velocity"]
    step, rotation = np.diff(time)[:, None], signals["raw_base_rotation"]
    turned = np.einsum("kab,kcb->kac", rotation[1:], rotation[:-1])
    jumps = np.zeros(time.size, dtype=np.bool_)
    for name, change in {
        "raw_base_position": np.diff(signals["raw_base_position"], axis=0) - step * velocity[1:, :3],
        "raw_base_velocity": np.diff(velocity[:, :3], axis=0),
        "raw_base_rotation": turn_of(turned) - step * velocity[1:, 3:],
    }.items():
        change = np.nan_to_num(change - np.nanmedian(change, axis=0))
        least = np.maximum(JUMP * 1.48 * np.median(np.abs(change), axis=0), JUMPS[name])
        jumps[1:] |= np.any(np.abs(change) > least, axis=1)
    return jumps


def sample(
    signals: Mapping[str, Array], config: rust.Config, robot: rust.Robot, with_feet: bool = False
) -> tuple[Samples, dict[str, int]]:
    """Return smoothed samples, and how many of them are left out by reason.

    Each signal is taken as late as the controller's estimator says that it is measured. `with_feet` takes the measured
    wrenches of the feet into the equations.
    """
    noise, of_velocity = noise_of(signals["raw_thrust"]), noise_of(signals["raw_base_velocity"])
    signals = even(signals)
    estimator = config["controller"].get("estimator") or {}

    def late(name: str) -> float:
        table = estimator.get(name) or {}
        return float(table.get("delay", 0.0))

    time = signals["time"]
    at = np.arange(time[0] + SETTLING, time[-1] - SETTLING, PERIOD)

    def smooth(rows: Array, delay: float, derivative: int = 0) -> Array:
        flat = _filled(time, rows.reshape(time.size, int(np.prod(rows.shape[1:]))))
        return _smooth(time, flat, at + delay, derivative).reshape(at.size, *rows.shape[1:])

    reasons = left_out(signals, robot)
    if with_feet:
        for name in ("feet loaded", "engines idle"):
            reasons[name][:] = False
    near = {name: np.interp(at, time, _spread(time, rows)) > 0.0 for name, rows in reasons.items()}
    rotation, velocity = signals["raw_base_rotation"], signals["raw_base_velocity"]
    rotation_late, linear_late = late("base_rotation"), late("base_linear_velocity")
    # The measured rotation turned the gyroscope's rates to inertial axes.
    gyro = np.einsum("kba,kb->ka", rotation, velocity[:, 3:])
    attitude = nearest_rotation(smooth(rotation, rotation_late))
    # A torque reaches its joint later than its tick and is held until the next, a measurement is later than its cause.
    torque_late = -float((estimator.get("latency") or {}).get("torque", 0.0)) - 0.5 * float(np.median(np.diff(time)))
    joints, rates = signals["raw_joint_position"], late("base_angular_velocity")
    wind = signals.get("raw_wind", np.full((time.size, 3), np.nan))
    feet = _of_feet(signals, robot) if with_feet else np.zeros((time.size, 6 + joints.shape[1]))
    turned = smooth(rotation, rotation_late, 1)
    impulse = np.cumsum(_filled(time, signals["raw_thrust"]).sum(axis=1)) * (time[1] - time[0])
    smoothed = Samples(
        weight=(~np.any(list(near.values()), axis=0)).astype(float),
        burnt=np.interp(at, time, impulse),
        turn_rate=turn_of(np.einsum("kba,kbc->kac", attitude, turned)),
        position_rate=smooth(signals["raw_base_position"], late("base_position"), 1),
        rotation=attitude,
        linear_velocity=smooth(velocity[:, :3], linear_late),
        linear_acceleration=smooth(velocity[:, :3], linear_late, 1),
        gyro=smooth(gyro, rates),
        gyro_rate=smooth(gyro, rates, 1),
        joint_position=smooth(joints, 0.0),
        joint_velocity=smooth(joints, 0.0, 1),
        joint_acceleration=smooth(joints, 0.0, 2),
        thrust=smooth(signals["raw_thrust"], late("thrust")),
        thrust_rate=smooth(signals["raw_thrust"], late("thrust"), 1),
        thrust_noise=np.tile(noise * np.sqrt((time[1] - time[0]) / PERIOD), (at.size, 1)),
        velocity_noise=np.tile(of_velocity * np.sqrt((time[1] - time[0]) / PERIOD), (at.size, 1)),
        torque=smooth(signals["joint_torque"], torque_late),
        torque_rate=smooth(signals["joint_torque"], torque_late, 1),
        wind=smooth(wind, 0.0) if is_measured(signals) else np.zeros((at.size, 3)),
        feet=smooth(feet, 0.0),
    )
    return smoothed, {name: int(rows.sum()) for name, rows in near.items() if rows.any()}


def even(signals: Mapping[str, Array]) -> dict[str, Array]:
    """Return signals at times of the log's median step, between rows that are near each other; else not a number.

    Rows without a number, and but for the first those of one time, count as lost.
    """
    time, first = np.unique(signals["time"], return_index=True)
    step = float(np.median(np.diff(time)))
    at = time[0] + step * np.arange(int((time[-1] - time[0]) / step + 1.5))
    resampled = {"time": at}
    for name, rows in signals.items():
        if len(rows) != len(signals["time"]) or name == "time":
            continue
        flat = rows[first].reshape(time.size, int(np.prod(rows.shape[1:])))
        known = np.flatnonzero(np.isfinite(flat).all(axis=1))
        if known.size < 2:
            resampled[name] = np.full((at.size, *rows.shape[1:]), np.nan)
            continue
        after = np.clip(np.searchsorted(time[known], at), 1, known.size - 1)
        begin, end = time[known[after - 1]], time[known[after]]
        share = (at - begin) / (end - begin)
        near = (np.abs(share - 0.5) <= 0.5 + 1e-6) & (end - begin <= max(BRIDGED[0], BRIDGED[1] * step) + 1e-9)
        moved = flat[known[after - 1]] + share[:, None] * (flat[known[after]] - flat[known[after - 1]])
        resampled[name] = np.where(near[:, None], moved, np.nan).reshape(at.size, *rows.shape[1:])
    return resampled


def is_measured(signals: Mapping[str, Array]) -> bool:
    """Return whether the wind was measured in most rows."""
    wind = signals.get("raw_wind")
    return wind is not None and bool(np.mean(np.isfinite(wind)) > 0.5)


def _of_feet(signals: Mapping[str, Array], robot: rust.Robot) -> Array:
    """Return the generalised forces of the measured wrenches of the feet (ticks, 6 + n)."""
    frames = [foot["frame"] for foot in tomllib.loads(robot.toml_text)["feet"]]
    forces = np.zeros((signals["time"].size, 6 + signals["raw_joint_position"].shape[1]))
    rotations = nearest_rotation(signals["raw_base_rotation"])  # between two rows they are interpolated
    poses = signals["raw_base_position"], rotations, signals["raw_joint_position"]
    for row, wrenches, position, rotation, joints in zip(forces, signals["raw_foot_wrench"], *poses, strict=True):
        if not all(np.isfinite(part).all() for part in (position, rotation, joints)):
            row[:] = np.nan  # a row that was lost
            continue
        state = rust.State(position, rotation, joints, np.zeros_like(row))
        for frame, wrench in zip(frames, wrenches.reshape(-1, 6), strict=True):
            jacobian = rust.frame_jacobian(robot, frame, state)
            row += jacobian.linear.T @ wrench[:3] + jacobian.angular.T @ wrench[3:]
    return forces


def _filled(time: Array, rows: Array) -> Array:
    """Return rows in which what is not a number is interpolated."""
    is_known = np.isfinite(rows).all(axis=1)
    if is_known.all() or not is_known.any():
        return rows
    return np.stack([np.interp(time, time[is_known], column) for column in rows[is_known].T], axis=1)


def _spread(time: Array, rows: NDArray[np.bool_]) -> Array:
    """Return 1 within `REACH` of a marked tick, else 0."""
    reach = int(np.ceil(REACH / float(np.median(np.diff(time)))))
    return np.asarray(np.convolve(rows, np.ones(2 * reach + 1), mode="same") > 0.0, dtype=float)


def latencies(log: Mapping[str, Array]) -> dict[str, tuple[float, float]]:
    """Return median and standard deviation of the latencies that the controller's monitor measured, if it did [s]."""
    by_key = {}
    for key in ("torque", "thrust"):
        rows = log.get(f"measured_{key}_latency", np.array([np.nan]))
        rows = rows[np.isfinite(rows)]
        rows = rows[rows.size // 10 :]
        if rows.size:
            by_key[key] = (float(np.median(rows)), float(np.std(rows)))
    return by_key


def _smooth(time: Array, rows: Array, at: Array, derivative: int) -> Array:
    """Return the convolution with a Gaussian, or with its first or second derivative, (times, entries)."""
    step = float(np.median(np.diff(time)))
    reach = int(6.0 * WIDTH / step)
    offsets = np.arange(-reach, reach + 1)
    near = np.rint((at - time[0]) / step).astype(int)
    places = np.clip(near[:, None] + offsets, 0, time.size - 1)
    u = (at[:, None] - time[places]) / WIDTH
    kernel = np.exp(-0.5 * u**2)
    kernel /= kernel.sum(axis=1, keepdims=True)
    if derivative:
        slope = kernel * (-u / WIDTH if derivative == 1 else (u**2 - 1.0) / WIDTH**2)
        slope -= slope.sum(axis=1, keepdims=True) * kernel
        # Exact for a ramp, or a parabola.
        kernel = slope / np.sum(slope * (-WIDTH * u) ** derivative / derivative, axis=1, keepdims=True)
    return np.asarray(np.einsum("kp,kpe->ke", kernel, rows[places]))


def with_noise_again(signals: Mapping[str, Array]) -> dict[str, Array]:
    """Return a log to which the noise of its sensors is added once more, as large as third differences show it."""
    rng, noisy = np.random.default_rng(0), dict(signals)
    for name in NOISY:
        rows = signals[name].reshape(len(signals[name]), int(np.prod(signals[name].shape[1:])))
        size = noise_of(rows)
        if name == "raw_base_rotation":
            turns = np.sqrt(np.sum(size**2) / 6.0) * rng.normal(size=(len(rows), 3))
            noisy[name] = signals[name] @ Rotation.from_rotvec(turns).as_matrix()
        else:
            noisy[name] = signals[name] + (size * rng.normal(size=rows.shape)).reshape(signals[name].shape)
    return noisy


def noise_of(rows: Array) -> Array:
    """Return the deviation of the white noise in every column, as third differences show it."""
    size: Array = np.sqrt(np.nanmean(np.diff(rows, 3, axis=0) ** 2, axis=0) / 20.0)
    return size


def turn_of(rotations: Array) -> Array:
    """Return the turns of rotations by small angles [rad], or vectors of skew matrices, (k, 3)."""
    places = ((2, 1), (0, 2), (1, 0))
    return 0.5 * np.stack([rotations[:, row, column] - rotations[:, column, row] for row, column in places], axis=1)


def grounded(load: Array, speed: Array) -> NDArray[np.bool_]:
    """Return the samples in which something carries the robot, by the share of its weight that no thrust carries.

    None where it hardly flies: then it is the log that is wrong.
    """
    stands, flies = (load > STANDING[0]) & (speed < STANDING[1]), load < STANDING[0]
    if flies.sum() * PERIOD < LEAST:
        return np.zeros_like(stands)
    least = np.median(load[flies]) + 0.25 * STANDING[0]
    edges = np.flatnonzero(np.diff(load > least, prepend=False, append=False))
    carried = np.zeros_like(stands)
    for begin, end in edges.reshape(-1, 2):
        carried[begin:end] = stands[begin:end].any()
    return carried

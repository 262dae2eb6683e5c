"""A recorded log through the tick of a controller, open loop."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base.terminal import Refused
from jax_aero.view import logs
from jax_aero.view.columns import Series

Array = NDArray[np.float64]


def replay(log: logs.Log, config: rust.Config, path: Path) -> tuple[Mapping[str, Array], Mapping[str, Array]]:
    """Return the signals of a log, and those that the controller computes from it, at the law's ticks that it holds."""
    steps = int(rust.resolve_config(config)["controller"]["torque"]["steps"])
    period = float(config["controller"]["time_step"]) / steps
    log = on_its_feet(log, config)
    needed = () if config["controller"].get("estimator") else ("raw_joint_velocity",)
    try:
        recorded, is_recorded = logs.at_ticks(log, rust.Robot(config["robot"]), period, path, also=needed)
    except Refused as reason:
        if not needed or needed[0] in log.signals:
            raise
        raise Refused(f"{reason}; a controller with an estimator needs none, e.g. --experiment test2_sensors") from None
    computed, is_there = rust.replay(config, recorded), is_recorded[::steps]
    return (
        {name: rows[::steps][is_there] for name, rows in recorded.items()},
        {name: rows[is_there] for name, rows in computed.items()},
    )


def on_its_feet(log: logs.Log, config: rust.Config) -> logs.Log:
    """Return a log with what a standing robot need not measure.

    The base follows from the joints, the first sole being flat and at rest at the origin of the inertial axes; jets
    that the controller does not use have no thrust.
    """
    controller, signals = config["controller"], dict(log.signals)
    if not controller.get("use_jets", True) and "raw_thrust" not in signals and "raw_joint_position" in signals:
        times = signals["raw_joint_position"][0].times
        signals["raw_thrust"] = [Series(times, np.zeros((times.size, len(rust.Robot(config["robot"]).jet_names))))]
    base = ("raw_base_position", "raw_base_rotation", "raw_base_velocity")
    joints = ("raw_joint_position", "raw_joint_velocity")
    if "contact" not in controller or signals.keys() & {*base, logs.QUATERNION} or not signals.keys() >= {*joints}:
        return log._replace(signals=signals)
    from jax_aero.mujoco.leg_odometry import LegOdometry

    times = signals["raw_joint_position"][0].times
    positions, rates = (np.column_stack([entry.rows for entry in signals[name]]) for name in joints)
    legs = LegOdometry.on_first_sole(config["robot"], controller["contact"]["feet"])
    still = np.zeros(6)
    states = [
        legs.measure(rust.State(still[:3], np.eye(3), position, np.concatenate([still, rate])))
        for position, rate in zip(positions, rates, strict=True)
    ]
    found = (
        [np.asarray(state.base_position) for state in states],
        [np.asarray(state.base_rotation).ravel() for state in states],
        [np.asarray(state.velocity)[:6] for state in states],
    )
    signals |= {name: [Series(times, np.array(rows))] for name, rows in zip(base, found, strict=True)}
    return log._replace(signals=signals)

"""The law alone, along a flight of the crate: for what the crate alone flies.

Before each tick the law of both languages is given what the crate estimates: estimates of state, thrusts,
their rates and wind, and the observed wrench. JAX keeps the law's memory: set-point, posture, plan, integral and last
torques. Compared up to the first tick in which fault detection changes what the law may do.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jax_aero import rust
from jax_aero.base.result import FlightResult
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.body.spatial import rpy_from_rotation
from jax_aero.control.measurement import Measurement
from jax_aero.control.preview import Preview
from jax_aero.control.state import ControllerState
from jax_aero.control.tick import MomentumController, decide, init, momentum_controller
from jax_aero.sim.model_error import controller_model
from jax_aero.sim.plant import COMPILER_OPTIONS
from jax_aero.types import Array, State, leaf
from jax_aero.verify import Row
from jax_aero.verify.flight import compare_signals, replay_rounded, states_of, ticks_unguarded


class Recorded(NamedTuple):
    """A flight of the crate with the law's estimate of the robot in every tick."""

    crate: FlightResult
    handed: Measurement
    wrench: Float[Array, "ticks 6"]
    """The observed wrench [N, N m]."""


def verify_law(config: Mapping[str, Any]) -> tuple[list[Row], float]:
    """Compare the law in every tick of a flight of the crate; return also the share of the ticks compared."""
    flown = fly_and_record(config)
    with jax.enable_x64(True):
        rows = compare_law(config, flown, follow_law(*law_of(config), flown))
    return rows, ticks_unguarded(flown.crate) / len(flown.crate["time"])


def fly_and_record(config: Mapping[str, Any]) -> Recorded:
    """Fly in the crate, and record."""
    flight, rows = rust.Flight(config), []
    while not flight.has_ended:
        flight.step()
        tick = flight.last
        known = tick.estimates
        rows.append((known.state, known.thrust, known.thrust_rate, known.wind, tick.unmodelled_wrench))
    state, thrust, thrust_rate, wind, wrench = jax.tree.map(lambda *leaves: np.stack(leaves), *rows)
    crate = flight.result()
    handed = Measurement(leaf(crate["time"]), State(*state), thrust, wind, Preview(), thrust_rate)
    return Recorded(crate, handed, wrench)


def law_of(config: Mapping[str, Any]) -> tuple[MomentumController, RobotModel]:
    """Return the controller of a configuration, of which the law is used, and its model of the robot."""
    typed = scenario_config(config)
    robot = load_robot(typed.robot)
    model = controller_model(typed, robot) or robot
    return momentum_controller(typed, model), model


def follow_law(params: MomentumController, model: RobotModel, flown: Recorded) -> dict[str, Any]:
    """Return the signals of the law along a flight."""
    measured = states_of(flown.crate.log, "raw_")
    memory = init(params, model, jax.tree.map(lambda leaf: leaf[0], measured))
    signals: dict[str, Any] = jax.device_get(_follow(params, model, memory, flown.handed, flown.wrench))
    return signals


def compare_law(config: Mapping[str, Any], flown: Recorded, signals: Mapping[str, Any]) -> list[Row]:
    """Compare the signals of the law with the crate's, in the ticks before fault detection acts."""
    crate = flown.crate
    return compare_signals("law", crate, signals, replay_rounded(config, crate, crate), ticks_unguarded(crate))


@partial(jax.jit, compiler_options=COMPILER_OPTIONS)
def _follow(
    params: MomentumController,
    robot: RobotModel,
    memory: ControllerState,
    handed: Measurement,
    wrenches: Float[Array, "ticks 6"],
) -> dict[str, Array | None]:
    """Return the signals of the law along what it is handed."""

    def tick(
        memory: ControllerState, given: tuple[Measurement, Array]
    ) -> tuple[ControllerState, dict[str, Array | None]]:
        now, wrench = given
        model = params.model(robot, now)
        model = model._replace(momentum=model.momentum.add_unmodelled(wrench))
        memory, command, terms = decide(params, robot, memory, now, model)
        setpoint = terms.setpoint
        return memory, {
            "com_setpoint": setpoint.com_position,
            "base_rpy_setpoint": rpy_from_rotation(setpoint.rotation),
            "aero_force_control": terms.link_forces.forces,
            "momentum_rate_estimate": terms.momentum.rate_estimate,
            "thrust_rate": command.thrust_rate,
            "joint_velocity_command": command.joint_velocity,
            "joint_torque": command.joint_torque,
        }

    return jax.lax.scan(tick, memory, (handed, wrenches))[1]

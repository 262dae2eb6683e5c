"""Everything that is constant in a flight."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from jax_aero.body.robot import RobotModel
from jax_aero.control import Controller
from jax_aero.sim.actuation import Actuation
from jax_aero.sim.jet_faults import FaultyJets
from jax_aero.sim.measuring import Measuring
from jax_aero.sim.outcome import FallLimits
from jax_aero.sim.plant import Plant
from jax_aero.sim.wind import Wind
from jax_aero.types import Array, pytree, static, with_dtype

T = TypeVar("T")


@pytree
class Scenario:
    """Everything that is constant in a flight. Every number is a leaf, for batches and derivatives.

    Another controller, aerodynamic model or jet dynamics is set by `prepare`, or by `dataclasses.replace`. Some leaves
    were computed from the time step, or, if noise is drawn, from the number of ticks: `replace_values` refuses changes
    of these. Limits are the controller's: torques are limited by `controller.torque_max`, a copy of
    `plant.robot.joint_torque_max`. The state holds centre of mass and inertia of the initial robot: after changing
    them, call `begin` again.
    """

    plant: Plant
    controller: Controller[Any]
    """Controller, including its mission."""
    wind: Wind
    fall: FallLimits
    controller_model: RobotModel | None
    """The controller's model of the robot; `None` if it is the robot that flies."""
    measuring: Measuring
    """What the controller is given of the robot and of the wind."""
    actuation: Actuation | None
    """Delays of commands; `None` for none."""
    n_ticks: Int[Array, ""]
    """Number of ticks after the one at time zero."""
    precision: str = static()
    """Name of the floating-point type of all numbers, so that its change cannot go unnoticed."""

    @property
    def model(self) -> RobotModel:
        """The controller's model of the robot."""
        return self.plant.robot if self.controller_model is None else self.controller_model

    @property
    def computed_from(self) -> tuple[str, ...]:
        """Return the length for which noise is drawn, if it is, and the wind whose mean is measured."""
        jets_are_noisy = isinstance(self.plant.jets, FaultyJets) and self.plant.jets.sensor_noise is not None
        measured = self.measuring
        drawn = (jets_are_noisy, measured.sensors is not None, measured.wind_estimate is not None)
        has_mean = bool(measured.computed_from) and measured.controller_wind is None
        of_length = ("n_ticks",) if any(drawn) or self.actuation is not None else ()
        return (*of_length, *(("wind",) if has_mean else ()))


def convert_precision(scenario: Scenario, state: T, dtype: Any) -> tuple[Scenario, T]:
    """Return a scenario, and a state of it, with all numbers in this floating-point type."""
    return with_dtype((replace(scenario, precision=np.dtype(dtype).name), state), dtype)


def check_precision(scenario: Scenario) -> None:
    """Refuse a scenario that is traced in another precision than it was prepared for.

    Raises
    ------
    ValueError
        If it is.
    """
    found = jnp.result_type(scenario.plant.time_step)
    if found == np.float64 and jnp.result_type(float) != np.float64:
        found = np.dtype(np.float32)
    if found != scenario.precision:
        raise ValueError(
            f"the scenario was prepared in {scenario.precision}, but its numbers are {found} here; "
            "expected a call inside `with jax.enable_x64(True):`, or `prepare(..., dtype=np.float32)`"
        )

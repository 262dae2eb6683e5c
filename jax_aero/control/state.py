"""State of a controller that is kept from tick to tick."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float

from jax_aero.control.estimate.disturbance_observer import ObserverState
from jax_aero.control.estimate.estimator import EstimatorState
from jax_aero.control.estimate.wind_observer import WindState
from jax_aero.control.law.plan import Plan
from jax_aero.control.law.setpoint import SetpointState
from jax_aero.control.qp import WarmStart
from jax_aero.types import Array


class EnginesState(NamedTuple):
    """What engines do under the last command, without an estimator of it."""

    thrust: Float[Array, " j"]
    """Measured thrusts [N]."""
    thrust_rate: Float[Array, " j"]
    """Their predicted rates [N/s]."""
    command: Float[Array, " j"]
    """Commanded rates [N/s]."""
    has_command: Bool[Array, ""]
    """Whether there is one."""


def start_engines(rest: Float[Array, " j"]) -> EnginesState:
    """Return engines without a command; `rest` are zeros."""
    return EnginesState(rest, rest, rest, jnp.array(False))


class ControllerState(NamedTuple):
    """State of the controller between two ticks."""

    setpoint: SetpointState
    posture: Float[Array, " n"]
    """Posture to return to, `s_d`: the joint positions of the first tick [rad]."""
    inertia_0: Float[Array, "3 3"]
    """Centroidal inertia in body axes at the first tick [kg m²]."""
    velocity_error_integral: Float[Array, " n"]
    """`∫(ṡ − ṡ*)` [rad]."""
    joint_torque: Float[Array, " n"]
    """Last commanded torques [N m]."""
    torque_is_known: Bool[Array, ""]
    """Whether the rate limiter has a last torque."""
    momentum_start: WarmStart
    """Starting point of the momentum QP."""
    torque_start: WarmStart
    """Starting point of the torque QP."""
    estimator: EstimatorState | None
    """State of the estimator; `None` without one."""
    engines: EnginesState | None
    """Engines under the last command; `None` without engines, and with an estimator."""
    wind: WindState | None
    """Estimated wind of the next tick; `None` without an observer of the wind."""
    observer: ObserverState | None
    """Observed wrench and what the next tick is compared with; `None` without an observer."""
    plan: Plan | None
    """Plan of the predictive law; `None` without one."""
    residual: ObserverState | None
    """Wrench that a residual observes, without that of the observer; `None` without a residual."""

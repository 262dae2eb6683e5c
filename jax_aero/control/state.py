"""State of a controller that is kept from tick to tick."""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Bool, Float

from jax_aero.control.guard.channels import ChannelsState
from jax_aero.control.guard.engines import EngineState
from jax_aero.control.guard.estimator import EstimatorState
from jax_aero.control.guard.joints import JointsState
from jax_aero.control.guard.latency import LatencyState
from jax_aero.control.guard.observer import ObserverState
from jax_aero.control.guard.wind_observer import WindState
from jax_aero.control.law.between import JointsBetween
from jax_aero.control.law.mpc.plan import Plan
from jax_aero.control.law.setpoint import SetpointState
from jax_aero.control.qp import WarmStart
from jax_aero.types import Array


class ControllerState(NamedTuple):
    """State of the controller between two ticks."""

    setpoint: SetpointState
    channels: ChannelsState
    """State of the measurement's channels."""
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
    estimator: EstimatorState | None = None
    """State of the estimator; `None` without one."""
    wind: WindState | None = None
    """Estimated wind of the next tick; `None` without a wind observer."""
    observer: ObserverState | None = None
    """Observed wrench and the measurement to compare the next one with; `None` without an observer."""
    engines: EngineState | None = None
    """State of the engines' detection; `None` without one."""
    joints: JointsState | None = None
    """State of the joints' detection; `None` without one."""
    latency: LatencyState | None = None
    """State of the measurement of latencies; `None` without one."""
    exceeded: Float[Array, ""] | None = None
    """Time for which the supervisor's limits have been exceeded [s]; `None` without one."""
    plan: Plan | None = None
    """Plan of the predictive law; `None` without one."""
    between: JointsBetween | None = None
    """Joints between two ticks of the law; `None` if each computes the torques once."""
    residual: ObserverState | None = None
    """Wrench that a residual observes, without that of the observer; `None` without a residual."""

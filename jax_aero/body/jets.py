"""Thrust of the jet engines under commanded thrust rates.

    JetsConfig, RobotModel ──jet_dynamics──► JetDynamics;   thrust rate command ──advance──► JetsState

There are two dynamics: `ideal` follows the command exactly, as in every published flight; `throttled` is the
identified engine with the throttle loop and the estimator that the real robot needs. All functions process all jets at
once. `JetDynamics` is a protocol: any pytree with its methods can be used.

Equations M31 to M35 and M173 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, assert_never

import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.body.robot import ENGINE_KEYS, RobotModel
from jax_aero.config import IdealJetsConfig, JetsConfig, MeasuredJetsConfig, ThrottledJetsConfig
from jax_aero.types import Array, pytree, static

MIN_INPUT_GAIN = 1e-9
"""Input gain below which the throttle loop holds the throttle, since the throttle has no effect [N/s² per %]."""

RATE_GAIN = 150.0
"""`k_p` of the throttle loop, of the published controller [1/s]."""

INITIAL_COVARIANCE = ((1.0, 0.1), (0.1, 1.0))
"""Covariance of the initial estimate, as published."""

Q, R = ((10.0, 1.0), (1.0, 10.0)), 1.0
"""Intensities of the noise of process and measurement in the estimator, as published."""


class Engines(NamedTuple):
    """Coefficients of every jet's engine; thrust T [N], throttle u [%].

        T̈ = f(T, Ṫ) + g(T, Ṫ) v(u)
        f = k_t T + k_tt T² + k_d Ṫ + k_dd Ṫ² + k_td T Ṫ + c
        g = b_u + b_t T + b_d Ṫ,   v(u) = u + b_uu u²

    Source: the published flight controller's jet model, which its authors identified on the test bench.
    """

    k_t: Float[Array, " j"]
    k_tt: Float[Array, " j"]
    k_d: Float[Array, " j"]
    k_dd: Float[Array, " j"]
    k_td: Float[Array, " j"]
    b_u: Float[Array, " j"]
    b_t: Float[Array, " j"]
    b_d: Float[Array, " j"]
    b_uu: Float[Array, " j"]
    c: Float[Array, " j"]
    throttle_min: Float[Array, " j"]
    throttle_max: Float[Array, " j"]


class JetsState(NamedTuple):
    """State of all jets."""

    thrust: Float[Array, " j"]
    """True thrust [N]."""
    thrust_rate: Float[Array, " j"]
    """True thrust rate [N/s]; under ideal dynamics the last command."""
    engine: Any = None
    """Additional state of the dynamics: any pytree."""


class JetDynamics(Protocol):
    """Dynamics of thrust under commands, for all jets at once: a pytree whose numbers are leaves."""

    def start(self, thrust: Float[Array, " j"]) -> JetsState:
        """Return the state at `thrust` [N] with thrust rate zero."""
        ...

    def feedback(self, state: JetsState) -> Float[Array, " j"]:
        """Return the thrust that the flight controller receives [N]."""
        ...

    def advance(
        self,
        state: JetsState,
        command: Float[Array, " j"],
        dt: Float[Array, ""] | float,
        measured: Float[Array, " j"] | None = None,
    ) -> JetsState:
        """Advance every jet by `dt` [s] under constant commanded thrust rates [N/s].

        Estimators use the thrust `measured` [N], or the true one if it is not given.
        """
        ...


@pytree
class IdealJets:
    """Thrust as the integral of the commanded rate, not below its least; upper limits are left to the controller."""

    thrust_min: Float[Array, " j"]
    """Least thrusts [N]."""

    def start(self, thrust: Float[Array, " j"]) -> JetsState:
        """Return the state at `thrust` [N] with thrust rate zero."""
        return JetsState(thrust, jnp.zeros_like(thrust))

    def feedback(self, state: JetsState) -> Float[Array, " j"]:
        """Return the true thrust [N]."""
        return state.thrust

    def advance(
        self,
        state: JetsState,
        command: Float[Array, " j"],
        dt: Float[Array, ""] | float,
        measured: Float[Array, " j"] | None = None,  # noqa: ARG002 - there is no estimator
    ) -> JetsState:
        """Return the state after `T ← max(T_min, T + Ṫ* dt)`."""
        return JetsState(*_not_below(self.thrust_min, state.thrust + dt * command, command))


class EngineState(NamedTuple):
    """State of jets with throttles in addition to thrust and thrust rate."""

    throttle: Float[Array, " j"]
    """Throttle of the last step [%]."""
    estimate: Float[Array, "j 2"]
    """Estimated thrust and thrust rate [N, N/s]."""
    covariance: Float[Array, "j 2 2"]
    """Covariance of the estimate."""


@pytree
class SecondOrderJets:
    """Identified engines with their throttle loop and their estimator."""

    engines: Engines
    thrust_min: Float[Array, " j"]
    """Least thrusts [N]."""
    feedback_is_estimated: bool = static()
    """Whether the flight controller receives the estimated instead of the true thrust."""

    def start(self, thrust: Float[Array, " j"]) -> JetsState:
        """Return the state at `thrust` [N] with thrust rate zero and the throttle in equilibrium."""
        rest = jnp.zeros_like(thrust)
        estimate = jnp.stack([thrust, rest], axis=1)
        covariance = jnp.broadcast_to(jnp.asarray(INITIAL_COVARIANCE, thrust.dtype), (*thrust.shape, 2, 2))
        throttle = steady_throttle(self.engines, thrust)
        return JetsState(thrust, rest, EngineState(throttle, estimate, covariance))

    def feedback(self, state: JetsState) -> Float[Array, " j"]:
        """Return the thrust [N], true or estimated."""
        estimate: Array = state.engine.estimate[:, 0]
        return estimate if self.feedback_is_estimated else state.thrust

    def advance(
        self,
        state: JetsState,
        command: Float[Array, " j"],
        dt: Float[Array, ""] | float,
        measured: Float[Array, " j"] | None = None,
    ) -> JetsState:
        """Advance throttles from the present estimate, then estimators and engines, by `dt` [s]."""
        throttle = _throttle_loop(self, state.engine, command)
        seen = state.thrust if measured is None else measured
        estimate, covariance = update_ekf(self, state.engine, seen, throttle, dt)
        # T̈ at the start of the step, as in the published simulator.
        acceleration = thrust_acceleration(self.engines, state.thrust, state.thrust_rate, throttle)
        thrust = state.thrust + dt * (state.thrust_rate + 0.5 * dt * acceleration)
        thrust, rate = _not_below(self.thrust_min, thrust, state.thrust_rate + dt * acceleration)
        return JetsState(thrust, rate, EngineState(throttle, estimate, covariance))


def predict_thrust(
    thrust: Float[Array, " j"],
    thrust_rate: Float[Array, " j"],
    command: Float[Array, " j"],
    dt: Float[Array, ""],
    thrust_min: Float[Array, " j"],
    engines: Engines | None,
) -> tuple[Float[Array, " j"], Float[Array, " j"]]:
    """Return thrusts [N] and their rates [N/s] after `dt` [s] under commanded rates, as a controller assumes them.

    Rates are the commanded ones (M31), or those that `engines` reach (M173). Thrusts are not below the least of each
    engine; one that is already is that of an engine that has stopped: it does not rise by itself, and never becomes
    negative.
    """
    rate = mean = command
    if engines is not None:
        least, greatest = acceleration_range(engines, thrust, thrust_rate)
        rate = thrust_rate + jnp.minimum(jnp.maximum(command - thrust_rate, dt * least), dt * greatest)
        mean = 0.5 * (thrust_rate + rate)
    return jnp.maximum(thrust + dt * mean, jnp.clip(thrust, 0.0, thrust_min)), rate


def _not_below(least: Array, thrust: Array, thrust_rate: Array) -> tuple[Array, Array]:
    is_below = thrust < least
    return jnp.where(is_below, least, thrust), jnp.where(is_below, jnp.maximum(thrust_rate, 0.0), thrust_rate)


def jet_dynamics(settings: JetsConfig, robot: RobotModel) -> JetDynamics:
    """Return the configured jet dynamics; `jax_aero.refusals` has those that JAX lacks."""
    match settings:
        case IdealJetsConfig():
            return IdealJets(robot.jets.thrust_min)
        case ThrottledJetsConfig():
            return SecondOrderJets(
                engines=engines(robot, settings.engines or robot.jets.engines),
                thrust_min=robot.jets.thrust_min,
                feedback_is_estimated=settings.feedback == "estimated",
            )
        case MeasuredJetsConfig():
            raise AssertionError("maps are refused before")
        case _:
            assert_never(settings)


def engines(robot: RobotModel, names: Sequence[str]) -> Engines:
    """Return the engines with these names, one for each jet."""
    coefficients = jnp.reshape(jnp.asarray([robot.engines[name] for name in names]), (-1, len(ENGINE_KEYS)))
    return Engines(*coefficients.T)


def drift(e: Engines, thrust: Float[Array, " j"], thrust_rate: Float[Array, " j"]) -> Float[Array, " j"]:
    """Return `f(T, Ṫ)` [N/s²], the thrust acceleration for `v = 0`."""
    along = thrust * (e.k_t + e.k_tt * thrust + e.k_td * thrust_rate)
    return along + thrust_rate * (e.k_d + e.k_dd * thrust_rate) + e.c


def input_gain(e: Engines, thrust: Float[Array, " j"], thrust_rate: Float[Array, " j"]) -> Float[Array, " j"]:
    """Return `g(T, Ṫ)` [N/s² per %], which changes sign when the thrust rises fast."""
    return e.b_u + e.b_t * thrust + e.b_d * thrust_rate


def throttle_input(e: Engines, throttle: Float[Array, " j"]) -> Float[Array, " j"]:
    """Return `v(u) = u + b_uu u²` [%] for a throttle [%]."""
    return throttle * (1.0 + e.b_uu * throttle)


def throttle_from_input(e: Engines, v: Float[Array, " j"]) -> Float[Array, " j"]:
    """Return the throttle [%] with `v(u) = v`, on the branch through zero: `u = 2 v/(1 + √(1 + 4 b_uu v))`.

    This is the published `(−1 + √…)/(2 b_uu)` in a form that is also valid for `b_uu = 0`. For a `v` that no throttle
    reaches, the throttle at the vertex of the parabola is returned, so that the function is continuous.
    """
    discriminant = 1.0 + 4.0 * e.b_uu * v
    is_past_top = discriminant <= 0.0
    root = jnp.sqrt(jnp.where(is_past_top, 1.0, discriminant))
    top = -0.5 / jnp.where(e.b_uu == 0.0, 1.0, e.b_uu)
    return jnp.where(is_past_top, top, 2.0 * v / (1.0 + root))


def steady_throttle(e: Engines, thrust: Float[Array, " j"]) -> Float[Array, " j"]:
    """Return the throttle [%] that holds a thrust [N], `f(T, 0) + g(T, 0) v(u) = 0`, within its limits."""
    rest = jnp.zeros_like(thrust)
    gain = input_gain(e, thrust, rest)
    acts = jnp.abs(gain) >= MIN_INPUT_GAIN
    v = -drift(e, thrust, rest) / jnp.where(acts, gain, 1.0)
    return jnp.where(acts, _limited_throttle(e, v), e.throttle_min)


def thrust_acceleration(
    e: Engines, thrust: Float[Array, " j"], thrust_rate: Float[Array, " j"], throttle: Float[Array, " j"]
) -> Float[Array, " j"]:
    """Return `T̈` [N/s²] at a throttle [%], limited to its range."""
    v = throttle_input(e, jnp.clip(throttle, e.throttle_min, e.throttle_max))
    return drift(e, thrust, thrust_rate) + input_gain(e, thrust, thrust_rate) * v


def acceleration_range(
    e: Engines, thrust: Float[Array, " j"], thrust_rate: Float[Array, " j"]
) -> tuple[Float[Array, " j"], Float[Array, " j"]]:
    """Return the least and the greatest `T̈` [N/s²] between the limits of the throttle."""
    ends = [thrust_acceleration(e, thrust, thrust_rate, end) for end in (e.throttle_min, e.throttle_max)]
    return jnp.minimum(*ends), jnp.maximum(*ends)


def acceleration_slopes(e: Engines, thrust: Float[Array, " j"]) -> tuple[Float[Array, " j"], Float[Array, " j"]]:
    """Return the derivatives of `T̈` by `T` [1/s²] and `Ṫ` [1/s] at rest, at the throttle that holds the thrust."""
    v = throttle_input(e, steady_throttle(e, thrust))
    return e.k_t + 2.0 * e.k_tt * thrust + e.b_t * v, e.k_d + e.k_td * thrust + e.b_d * v


def _limited_throttle(e: Engines, v: Array) -> Array:
    limited = jnp.clip(v, throttle_input(e, e.throttle_min), throttle_input(e, e.throttle_max))
    return jnp.clip(throttle_from_input(e, limited), e.throttle_min, e.throttle_max)


def _throttle_loop(model: SecondOrderJets, state: EngineState, command: Array) -> Array:
    """Linearise the engine by feedback to `T̈ = −k_p (Ṫ − Ṫ*)`; return the throttle [%].

        v = −( k_p (Ṫ − Ṫ*) + f(T, Ṫ) ) / g(T, Ṫ),   u = v⁻¹(clamp v)

    Source: the published controller. The throttle is held if `g` is zero or a number is not finite.
    """
    thrust, rate = state.estimate[:, 0], state.estimate[:, 1]
    gain = input_gain(model.engines, thrust, rate)
    acts = jnp.abs(gain) >= MIN_INPUT_GAIN
    feedback = RATE_GAIN * (rate - command) + drift(model.engines, thrust, rate)
    wanted = -feedback / jnp.where(acts, gain, 1.0)
    acts = acts & jnp.isfinite(wanted)
    throttle = _limited_throttle(model.engines, jnp.where(acts, wanted, 0.0))
    return jnp.where(acts, throttle, state.throttle)


def update_ekf(
    model: SecondOrderJets,
    state: EngineState,
    measured: Float[Array, " j"],
    throttle: Float[Array, " j"],
    dt: Float[Array, ""] | float,
) -> tuple[Float[Array, "j 2"], Float[Array, "j 2 2"]]:
    """Advance the extended Kalman filter of every engine: correction with variance `R/dt`, then prediction by `dt` [s].

    K = P Cᵀ (C P Cᵀ + R/dt)⁻¹,   x̂ ← x̂ + K (y − T̂),   P ← P − K C P,   C = (1 0)
    x̂ ← x̂ + dt ( Ṫ, T̈(x̂, u) ),   P ← Φ P Φᵀ + dt Q,   Φ = 1 + dt A,   A = ∂(Ṫ, T̈)/∂x at (x̂, u)
    """
    e, column = model.engines, state.covariance[:, :, 0]
    gain = column / (column[:, :1] + R / dt)
    estimate = state.estimate + gain * (measured - state.estimate[:, 0])[:, None]
    p = state.covariance - gain[:, :, None] * column[:, None, :]

    thrust, rate = estimate[:, 0], estimate[:, 1]
    v = throttle_input(e, jnp.clip(throttle, e.throttle_min, e.throttle_max))
    by_thrust = e.k_t + 2.0 * e.k_tt * thrust + e.k_td * rate + e.b_t * v
    by_rate = e.k_d + 2.0 * e.k_dd * rate + e.k_td * thrust + e.b_d * v
    ones, zeros = jnp.ones_like(thrust), jnp.zeros_like(thrust)
    slopes = jnp.stack([jnp.stack([zeros, ones], axis=1), jnp.stack([by_thrust, by_rate], axis=1)], axis=1)
    transition = jnp.eye(2, dtype=p.dtype)[None] + dt * slopes
    flow = jnp.stack([rate, thrust_acceleration(e, thrust, rate, throttle)], axis=1)
    return estimate + dt * flow, transition @ p @ jnp.swapaxes(transition, 1, 2) + dt * jnp.asarray(Q)[None]

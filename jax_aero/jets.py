"""Thrust of the jet engines from the commanded thrust rate.

    JetsConfig, RobotModel ──jet_dynamics──► JetDynamics;   thrust rate command ──advance──► JetsState

Two dynamics: `ideal` follows the command exactly, as in every published flight; `second_order` is the identified
engine, with the throttle loop and the estimator that the real robot needs. All functions serve all jets at once.
`JetDynamics` is a protocol: any pytree with its methods will do.

Equations M31 to M35 of `docs/model.md`.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, assert_never

import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.config import IdealJetsConfig, JetsConfig, SecondOrderJetsConfig
from jax_aero.robot import ENGINE_KEYS, RobotModel
from jax_aero.types import Array, Static, leaf, pytree

MIN_INPUT_GAIN = 1e-9
"""Input gains below this [N/s² per %] cannot steer: the throttle loop then holds."""


class Engines(NamedTuple):
    """Coefficients of the engine of every jet; thrust T [N], throttle u [%].

        T̈ = f(T, Ṫ) + g(T, Ṫ) v(u)
        f = k_t T + k_tt T² + k_d Ṫ + k_dd Ṫ² + k_td T Ṫ + c
        g = b_u + b_t T + b_d Ṫ,   v(u) = u + b_uu u²

    Source: the published flight controller's jet model, identified on the test bench by its authors.
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
    """The jets at one moment."""

    thrust: Float[Array, " j"]
    """True thrust [N]."""
    thrust_rate: Float[Array, " j"]
    """True thrust rate [N/s]; under ideal dynamics the last command."""
    engine: Any = None
    """Further state of the dynamics: a pytree of their own."""


class JetDynamics(Protocol):
    """How thrust follows the command, for all jets at once: a pytree whose numbers are leaves."""

    def start(self, thrust: Float[Array, " j"]) -> JetsState:
        """Jets at `thrust` [N] with thrust rate zero."""
        ...

    def feedback(self, state: JetsState) -> Float[Array, " j"]:
        """Thrust that the flight controller is given [N]."""
        ...

    def advance(
        self,
        state: JetsState,
        command: Float[Array, " j"],
        dt: Float[Array, ""] | float,
        measured: Float[Array, " j"] | None = None,
    ) -> JetsState:
        """Move every jet on by `dt` [s] under the commanded thrust rates [N/s], held constant.

        Estimators are given the thrust `measured` [N], the true one without it.
        """
        ...


@pytree
class IdealJets:
    """Thrust is the integral of the commanded rate, never negative; upper bounds are the controller's."""

    def start(self, thrust: Float[Array, " j"]) -> JetsState:
        """Jets at `thrust` [N] with thrust rate zero."""
        return JetsState(thrust, jnp.zeros_like(thrust))

    def feedback(self, state: JetsState) -> Float[Array, " j"]:
        """Return the true thrust [N]."""
        return state.thrust

    def advance(
        self,
        state: JetsState,
        command: Float[Array, " j"],
        dt: Float[Array, ""] | float,
        measured: Float[Array, " j"] | None = None,  # noqa: ARG002 - nothing estimates here
    ) -> JetsState:
        """`T ← max(0, T + Ṫ* dt)`."""
        thrust = state.thrust + dt * command
        return JetsState(jnp.where(thrust < 0.0, 0.0, thrust), jnp.where(thrust < 0.0, 0.0, command))


class EngineState(NamedTuple):
    """State of second-order jets besides thrust and thrust rate."""

    throttle: Float[Array, " j"]
    """Of the last step [%]."""
    integral: Float[Array, " j"]
    """`∫ (Ṫ − Ṫ*) dt` [N]."""
    estimate: Float[Array, "j 2"]
    """Estimated thrust and thrust rate [N, N/s]."""
    covariance: Float[Array, "j 2 2"]
    """Of the estimate."""


@pytree
class SecondOrderJets:
    """Identified engines, their throttle loop and the noise their estimator assumes."""

    engines: Engines
    rate_gain_p: Float[Array, ""]
    """[1/s]"""
    rate_gain_i: Float[Array, ""]
    """[1/s²]"""
    q: Float[Array, "2 2"]
    """Process noise of the estimator."""
    r: Float[Array, ""]
    """Measurement noise of the estimator."""
    feedback_is_estimated: Static[bool]
    """Whether the flight controller is given the estimated thrust, not the true one."""
    init_state: Float[Array, "2"] | None
    """First estimate of thrust and thrust rate [N, N/s]; without it (thrust, 0)."""
    init_p: Float[Array, "2 2"]
    """Covariance of the first estimate."""

    def start(self, thrust: Float[Array, " j"]) -> JetsState:
        """Jets at `thrust` [N] with thrust rate zero, their throttle in equilibrium."""
        rest = jnp.zeros_like(thrust)
        estimate = jnp.stack([thrust, rest], axis=1)
        if self.init_state is not None:
            estimate = jnp.broadcast_to(jnp.asarray(self.init_state), estimate.shape)
        covariance = jnp.broadcast_to(jnp.asarray(self.init_p), (*thrust.shape, 2, 2))
        throttle = steady_throttle(self.engines, thrust)
        return JetsState(thrust, rest, EngineState(throttle, rest, estimate, covariance))

    def feedback(self, state: JetsState) -> Float[Array, " j"]:
        """Thrust [N], true or estimated."""
        estimate: Array = state.engine.estimate[:, 0]
        return estimate if self.feedback_is_estimated else state.thrust

    def advance(
        self,
        state: JetsState,
        command: Float[Array, " j"],
        dt: Float[Array, ""] | float,
        measured: Float[Array, " j"] | None = None,
    ) -> JetsState:
        """Move throttles on from the present estimate, then estimators and engines over `dt` [s]."""
        throttle, integral = _throttle_loop(self, state.engine, command, dt)
        seen = state.thrust if measured is None else measured
        estimate, covariance = update_ekf(self, state.engine, seen, throttle, dt)
        # T̈ at the start of the step, as in the published simulator.
        acceleration = thrust_acceleration(self.engines, state.thrust, state.thrust_rate, throttle)
        thrust = state.thrust + dt * (state.thrust_rate + 0.5 * dt * acceleration)
        rate, is_out = state.thrust_rate + dt * acceleration, thrust < 0.0
        return JetsState(
            thrust=jnp.where(is_out, 0.0, thrust),
            thrust_rate=jnp.where(is_out, jnp.maximum(rate, 0.0), rate),
            engine=EngineState(throttle, integral, estimate, covariance),
        )


def jet_dynamics(settings: JetsConfig, robot: RobotModel) -> JetDynamics:
    """Build the dynamics that the configuration asks for.

    Raises
    ------
    ValueError
        For an engine that the robot's file does not have.
    """
    match settings:
        case IdealJetsConfig():
            return IdealJets()
        case SecondOrderJetsConfig():
            names = settings.engines or robot.jets.engines
            if unknown := set(names) - set(robot.engines):
                known = ", ".join(sorted(robot.engines))
                raise ValueError(f"engines {sorted(unknown)} are unknown; {robot.name} has {known}")
            coefficients = jnp.reshape(jnp.asarray([robot.engines[name] for name in names]), (-1, len(ENGINE_KEYS)))
            return SecondOrderJets(
                engines=Engines(*coefficients.T),
                rate_gain_p=leaf(settings.rate_gain_p),
                rate_gain_i=leaf(settings.rate_gain_i),
                q=leaf(settings.ekf.Q),
                r=leaf(settings.ekf.R),
                feedback_is_estimated=settings.feedback == "estimated",
                init_state=None if settings.ekf.init_state is None else leaf(settings.ekf.init_state),
                init_p=leaf(settings.ekf.init_P),
            )
        case _:
            assert_never(settings)


def drift(e: Engines, thrust: Float[Array, " j"], thrust_rate: Float[Array, " j"]) -> Float[Array, " j"]:
    """`f(T, Ṫ)` [N/s²]: thrust acceleration with `v = 0`."""
    along = thrust * (e.k_t + e.k_tt * thrust + e.k_td * thrust_rate)
    return along + thrust_rate * (e.k_d + e.k_dd * thrust_rate) + e.c


def input_gain(e: Engines, thrust: Float[Array, " j"], thrust_rate: Float[Array, " j"]) -> Float[Array, " j"]:
    """`g(T, Ṫ)` [N/s² per %]; changes sign where the thrust rises fast."""
    return e.b_u + e.b_t * thrust + e.b_d * thrust_rate


def throttle_input(e: Engines, throttle: Float[Array, " j"]) -> Float[Array, " j"]:
    """`v(u) = u + b_uu u²` [%] of a throttle [%]."""
    return throttle * (1.0 + e.b_uu * throttle)


def throttle_from_input(e: Engines, v: Float[Array, " j"]) -> Float[Array, " j"]:
    """Throttle [%] with `v(u) = v`, on the branch through zero: `u = 2 v/(1 + √(1 + 4 b_uu v))`.

    The published `(−1 + √…)/(2 b_uu)` with the root moved below: also right at `b_uu = 0`. Where no throttle reaches
    `v`, the one at the parabola's top, so that the answer stays continuous.
    """
    discriminant = 1.0 + 4.0 * e.b_uu * v
    is_past_top = discriminant <= 0.0
    root = jnp.sqrt(jnp.where(is_past_top, 1.0, discriminant))
    top = -0.5 / jnp.where(e.b_uu == 0.0, 1.0, e.b_uu)
    return jnp.where(is_past_top, top, 2.0 * v / (1.0 + root))


def steady_throttle(e: Engines, thrust: Float[Array, " j"]) -> Float[Array, " j"]:
    """Throttle [%] that holds a thrust [N]: `f(T, 0) + g(T, 0) v(u) = 0`, within the limits."""
    rest = jnp.zeros_like(thrust)
    gain = input_gain(e, thrust, rest)
    acts = jnp.abs(gain) >= MIN_INPUT_GAIN
    v = -drift(e, thrust, rest) / jnp.where(acts, gain, 1.0)
    return jnp.where(acts, _limited_throttle(e, v), e.throttle_min)


def thrust_acceleration(
    e: Engines, thrust: Float[Array, " j"], thrust_rate: Float[Array, " j"], throttle: Float[Array, " j"]
) -> Float[Array, " j"]:
    """`T̈` [N/s²] at a throttle [%], which is limited first."""
    v = throttle_input(e, jnp.clip(throttle, e.throttle_min, e.throttle_max))
    return drift(e, thrust, thrust_rate) + input_gain(e, thrust, thrust_rate) * v


def _limited_throttle(e: Engines, v: Array) -> Array:
    limited = jnp.clip(v, throttle_input(e, e.throttle_min), throttle_input(e, e.throttle_max))
    return jnp.clip(throttle_from_input(e, limited), e.throttle_min, e.throttle_max)


def _throttle_loop(
    model: SecondOrderJets, state: EngineState, command: Array, dt: Array | float
) -> tuple[Array, Array]:
    """Feedback linearisation of the engine to `T̈ = −k_p e − k_i ∫e`, `e = Ṫ − Ṫ*`: new throttle and integral.

        v = −( k_p e + f(T, Ṫ) + k_i ∫e ) / g(T, Ṫ),   u = v⁻¹(clamp v)

    Source: the published controller. Where `g` is zero or a number is not finite the throttle holds. No anti-windup,
    as published.
    """
    thrust, rate = state.estimate[:, 0], state.estimate[:, 1]
    error = rate - command
    gain = input_gain(model.engines, thrust, rate)
    acts = jnp.abs(gain) >= MIN_INPUT_GAIN
    feedback = model.rate_gain_p * error + drift(model.engines, thrust, rate) + model.rate_gain_i * state.integral
    wanted = -feedback / jnp.where(acts, gain, 1.0)
    acts = acts & jnp.isfinite(wanted)
    throttle = _limited_throttle(model.engines, jnp.where(acts, wanted, 0.0))
    return jnp.where(acts, throttle, state.throttle), state.integral + jnp.where(acts, dt * error, 0.0)


def update_ekf(
    model: SecondOrderJets,
    state: EngineState,
    measured: Float[Array, " j"],
    throttle: Float[Array, " j"],
    dt: Float[Array, ""] | float,
) -> tuple[Float[Array, "j 2"], Float[Array, "j 2 2"]]:
    """Advance the extended Kalman filter of every engine: a measurement of variance `R/dt`, then a step of `dt`.

    K = P Cᵀ (C P Cᵀ + R/dt)⁻¹,   x̂ ← x̂ + K (y − T̂),   P ← P − K C P,   C = (1 0)
    x̂ ← x̂ + dt ( Ṫ, T̈(x̂, u) ),   P ← Φ P Φᵀ + dt Q,   Φ = 1 + dt A,   A = ∂(Ṫ, T̈)/∂x at (x̂, u)
    """
    e, column = model.engines, state.covariance[:, :, 0]
    gain = column / (column[:, :1] + model.r / dt)
    estimate = state.estimate + gain * (measured - state.estimate[:, 0])[:, None]
    p = state.covariance - gain[:, :, None] * column[:, None, :]

    thrust, rate = estimate[:, 0], estimate[:, 1]
    v = throttle_input(e, jnp.clip(throttle, e.throttle_min, e.throttle_max))
    by_thrust = e.k_t + 2.0 * e.k_tt * thrust + e.k_td * rate + e.b_t * v
    by_rate = e.k_d + 2.0 * e.k_dd * rate + e.k_td * thrust + e.b_d * v
    ones, zeros = jnp.ones_like(thrust), jnp.zeros_like(thrust)
    slopes = jnp.stack([jnp.stack([zeros, ones], axis=1), jnp.stack([by_thrust, by_rate], axis=1)], axis=1)
    transition = jnp.eye(2, dtype=p.dtype) + dt * slopes
    flow = jnp.stack([rate, thrust_acceleration(e, thrust, rate, throttle)], axis=1)
    return estimate + dt * flow, transition @ p @ jnp.swapaxes(transition, 1, 2) + dt * model.q

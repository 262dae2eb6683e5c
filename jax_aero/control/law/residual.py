"""What is added to the answer of the law, or replaces it: the action of a learned policy, or a given one.

```text
x = s ∘ o                       features o of M170, the wrench observed with the gain of M84
h ← tanh( W h + b )             hidden layers of a policy, from h = x
a = tanh( W h + D x + b )       its action, between −1 and 1 (M171)
u = clip( ζ u* + S a, l, u )    thrust rates and joint velocities, in the bounds of M65; ζ = 0 replaces (M172)
```

Equations M170 to M172 of `docs/model`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.base.features import aim_of, features
from jax_aero.body.robot import RobotModel
from jax_aero.control.estimate import disturbance_observer
from jax_aero.control.estimate.disturbance_observer import ObserverGains
from jax_aero.control.law.rates import Rates
from jax_aero.control.measurement import Measurement
from jax_aero.control.state import ControllerState
from jax_aero.control.terms import Model
from jax_aero.rust import MODES
from jax_aero.types import Array, Setpoint, pytree, static, where

OBSERVER_GAIN = 3.0
"""Gain of the observed wrench [1/s]."""


class Layer(NamedTuple):
    """Weights of a layer."""

    weight: Float[Array, "y x"]
    bias: Float[Array, " y"]


@pytree
class Policy:
    """Weights of a policy: hidden layers, and a linear part beside them."""

    hidden: tuple[Layer, ...]
    output: Layer
    direct: Float[Array, "u x"]
    """`D`."""


def weigh(xp: Any, policy: Policy, x: Any) -> Any:
    """Return the weighted sums of a network of this structure; `xp` is `numpy` or `jax.numpy`."""
    units = x
    for weight, bias in policy.hidden:
        units = xp.tanh(weight @ units + bias)
    return policy.output.weight @ units + policy.direct @ x + policy.output.bias


def evaluate(xp: Any, policy: Policy, x: Any) -> Any:
    """Return the action of scaled features, between −1 and 1 (M171)."""
    return xp.tanh(weigh(xp, policy, x))


class Added(NamedTuple):
    """A residual of one tick."""

    thrust_rate: Float[Array, " j"]
    """[N/s]."""
    joint_velocity: Float[Array, " n"]
    """[rad/s]."""


@pytree
class Steering:
    """A given residual."""

    thrust_rate: Float[Array, " j"]
    """[N/s]."""
    joint_velocity: Float[Array, " n"]
    """[rad/s]."""
    replaces: bool = static(default=False)
    """Whether it replaces the answer of the law."""

    def act(self, _features: dict[str, Float[Array, "..."]]) -> Added:
        """Return the residual."""
        return Added(self.thrust_rate, self.joint_velocity)


@pytree
class PolicyResidual:
    """The residual of a learned policy."""

    policy: Policy
    features: tuple[str, ...] = static()
    """Names of what it observes."""
    scale: Float[Array, " f"]
    """`s` of each of them."""
    thrust_rate: Float[Array, ""]
    """Thrust rate of an action of 1 [N/s]."""
    joint_velocity: Float[Array, ""]
    """Joint velocity of an action of 1 [rad/s]."""
    jets: int = static()
    """Number of actions that are thrust rates, the first ones."""
    replaces: bool = static(default=False)
    """Whether it replaces the answer of the law."""

    def act(self, features: dict[str, Float[Array, "..."]]) -> Added:
        """Return the residual of what is observed."""
        seen = jnp.concatenate([scale * features[name] for name, scale in zip(self.features, self.scale, strict=True)])
        action = evaluate(jnp, self.policy, seen)
        return Added(self.thrust_rate * action[: self.jets], self.joint_velocity * action[self.jets :])


Residual = Steering | PolicyResidual


def steer(
    residual: Residual,
    robot: RobotModel,
    time_step: Float[Array, ""],
    memory: ControllerState,
    now: Measurement,
    model: Model,
    due: Setpoint,
    rates: Rates,
) -> tuple[ControllerState, Rates, Added]:
    """Add a residual to thrust rates and joint velocities, or replace them, and observe the wrench for the next.

    A residual that is not finite is not used, nor is one without an answer of the law. The modes name the former.
    """
    last = memory.residual
    assert last is not None
    seen = features(
        jnp,
        now.state.base_rotation,
        now.state.velocity,
        now.state.joint_position - memory.posture,
        now.thrust,
        model.kinematics.com,
        aim_of(due),
        last.wrench,
        jnp.asarray(robot.jets.thrust_max),
    )
    added = residual.act(seen)
    is_finite = jnp.all(jnp.isfinite(jnp.concatenate(added)))
    own = Added(rates.thrust_rate, rates.joint_velocity)
    wanted = added if residual.replaces else Added(*(a + b for a, b in zip(own, added, strict=True)))
    problem, jets = rates.momentum_qp.problem, rates.thrust_rate.shape[0]
    lower, upper = (Added(bound[:jets], bound[jets:]) for bound in (problem.lower, problem.upper))
    chosen = where(
        is_finite & (rates.modes & MODES["momentum_held"] == 0),
        Added(*(jnp.clip(*parts) for parts in zip(wanted, lower, upper, strict=True))),
        own,
    )
    modes = rates.modes | jnp.where(is_finite, 0, MODES["residual_ignored"])
    gain, most = (jnp.asarray(number, last.wrench.dtype) for number in (OBSERVER_GAIN, jnp.inf))
    gains, momentum, rate = ObserverGains(gain, gain, most, most), model.dynamics.momentum, model.momentum.rate_estimate
    observed = disturbance_observer.update(gains, time_step, last, momentum, rate)
    return memory._replace(residual=observed), rates._replace(**chosen._asdict(), modes=modes), added

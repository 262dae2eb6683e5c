"""The drives between commanded torques and joints: lag, friction, reflected inertia, elasticity.

```text
τ ──► lag ──► motor θ: inertia, friction, damping ──► spring ──► joint s        rigid: θ = s
B θ̈ = τ_a − d θ̇ − F(θ̇) − τ_s,      τ_s = K (θ − s) + D (θ̇ − ṡ)
F(θ̇) = f θ̇ / v_f,  at most ± f,   f = f_0 + μ |τ_s|
```

Everything is implicit in the velocities after the step. Which motors slip is searched without derivatives; the motion
then has those of what was found.

Equation M153 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Bool, Float

from jax_aero.body.batches import keep_answer, map_in_chunks, with_batch_rule
from jax_aero.body.linalg import cholesky, invert, solve_factored
from jax_aero.body.robot import RobotModel
from jax_aero.config import MotorsConfig
from jax_aero.types import Array, InverseMass, State, leaf, pytree

SLIP = 1e-3
"""Velocity `v_f` from which dry friction is whole [rad/s, m/s]; below, a motor creeps."""

PASSES = 8
"""Greatest number of passes in which motors are found to slip or to stick."""


@pytree
class Spring:
    """A spring between motor and joint, the same in every drive."""

    stiffness: Float[Array, ""]
    """`K` [N m/rad]."""
    damping: Float[Array, ""]
    """`D` [N m s]."""


class MotorsState(NamedTuple):
    """State of the drives between two steps."""

    torque: Float[Array, " n"]
    """`τ_a` [N m]."""
    is_commanded: Bool[Array, ""]
    """Whether torques were commanded before; the first act at once."""
    position: Float[Array, " n"]
    """`θ` [rad]."""
    velocity: Float[Array, " n"]
    """`θ̇` [rad/s]."""
    slip: Float[Array, " n"]
    """Sign of the velocity with which a motor slips; zero if it sticks."""
    friction: Float[Array, " n"]
    """Dry friction `f` with the load of the last step [N m]."""


class Reaction(NamedTuple):
    """What the drives do to the joints, by the velocities `ṡ` after the step."""

    torque: Float[Array, " n"]
    """Torque on a joint that rests [N m]."""
    slope: Float[Array, " n"]
    """Torque on a joint: `torque − slope ṡ`."""
    constant: Float[Array, " n"]
    """Velocity of a motor: `constant + gain ṡ` [rad/s]."""
    gain: Float[Array, " n"]

    def velocity(self, joint_velocity: Float[Array, " n"]) -> Float[Array, " n"]:
        """Return the velocities of the motors [rad/s]."""
        return self.constant + self.gain * joint_velocity


class Driven(NamedTuple):
    """A robot with its drives in a step."""

    inverse_mass: InverseMass
    """With the drives."""
    force: Float[Array, " N"]
    """With the drives."""
    reaction: Reaction
    slip: Float[Array, " n"]
    """Signs with which the motors slip after it."""


@pytree
class Motors:
    """Numbers of the drives of `n` joints."""

    friction: Float[Array, " n"]
    """Dry friction without load `f_0` [N m]."""
    load_friction: Float[Array, " n"]
    """Share of the load `μ`."""
    damping: Float[Array, ""]
    """`d` [N m s]."""
    inertia: Float[Array, ""]
    """`B` [kg m²]."""
    time_constant: Float[Array, ""]
    """Lag of the torque behind its command [s]; zero for none."""
    spring: Spring | None
    """`None` where motor and joint move together."""

    def start(self, state: State) -> MotorsState:
        """Return drives at rest relative to their joints, without torque."""
        rest = jnp.zeros_like(state.joint_position)
        friction = jnp.broadcast_to(jnp.asarray(self.friction), rest.shape)
        return MotorsState(rest, jnp.array(False), state.joint_position, state.velocity[6:], rest, friction)

    def lag(self, state: MotorsState, command: Float[Array, " n"], step: Float[Array, ""]) -> MotorsState:
        """Return the drives after `step` [s] in which these torques are commanded [N m]."""
        lags = (self.time_constant > 0.0) & state.is_commanded
        share = jnp.where(lags, -jnp.expm1(-step / jnp.where(lags, self.time_constant, 1.0)), 1.0)
        torque = state.torque + share * (command - state.torque)
        return state._replace(torque=torque, is_commanded=jnp.ones_like(state.is_commanded))

    def drive(
        self,
        state: MotorsState,
        torque: Float[Array, " n"],
        joints: State,
        inverse_mass: InverseMass,
        force: Float[Array, " N"],
        step: Float[Array, ""],
    ) -> Driven:
        """Add the drives to a robot in a state, under these torques of them [N m]; `force` contains `−h`."""
        velocity, still_force = joints.velocity[6:], force[6:] - force[:6] @ inverse_mass.coupling
        given = _Given(state, torque, joints.joint_position, velocity, inverse_mass.joint_inertia, still_force, step)
        motors, still = lax.stop_gradient((self, given))
        # Inverted anew whatever is added, so that nobody needs the inverse without drives.
        gain = invert(motors._inertia(still, state.slip))
        found = motors._slip_after(still, state.slip, lambda force: gain @ force)
        ended = keep_answer(_search(motors, still, _Search(state.slip, found, jnp.array(1, jnp.int32))))
        reaction, inertia = self._react(given, ended.slip), self._inertia(given, ended.slip)
        inverse = inverse_mass._replace(joint_inertia=inertia, joint_gain=invert(inertia, (ended.passes == 1, gain)))
        force = force + jnp.pad(reaction.torque - reaction.slope * velocity, (6, 0))
        return Driven(inverse, force, reaction, ended.found)

    def advance(self, state: MotorsState, driven: Driven, after: State, step: Float[Array, ""]) -> MotorsState:
        """Return the drives after a step to this state of the robot."""
        joint_velocity, reaction = after.velocity[6:], driven.reaction
        velocity, load = reaction.velocity(joint_velocity), reaction.torque - reaction.slope * joint_velocity
        return state._replace(
            position=after.joint_position if self.spring is None else state.position + step * velocity,
            velocity=velocity,
            slip=driven.slip,
            friction=self.friction + self.load_friction * jnp.abs(load),
        )

    def _react(self, of: _Given, slip: Array) -> Reaction:
        sticks, (state, torque, position, velocity) = slip == 0.0, of[:4]
        friction, creep = slip * state.friction, jnp.where(sticks, state.friction / SLIP, 0.0)
        inertia = self.inertia / of.step
        resistance = inertia + self.damping + creep
        if self.spring is None:
            rest = jnp.zeros_like(velocity)
            return Reaction(torque - friction + inertia * velocity, resistance, rest, jnp.ones_like(velocity))
        stiff = of.step * self.spring.stiffness + self.spring.damping
        twist = self.spring.stiffness * (state.position - position)
        push = inertia * state.velocity + torque - friction
        gain, constant = stiff / (resistance + stiff), (push - twist) / (resistance + stiff)
        return Reaction(twist + stiff * constant, resistance * gain, constant, gain)

    def _inertia(self, of: _Given, slip: Array) -> Array:
        """Return the inertia of the joints with the drives."""
        return of.inertia + jnp.diag(of.step * self._react(of, slip).slope)

    def _slip_after(self, of: _Given, slip: Array, solve: Callable[[Array], Array]) -> Array:
        """Return how motors slip after the step that slip as given in it; `solve` divides by the inertia."""
        reaction = self._react(of, slip)
        acceleration = solve(of.force + reaction.torque - reaction.slope * of.velocity)
        after = reaction.velocity(of.velocity + of.step * acceleration)
        return jnp.where(jnp.abs(after) > SLIP, jnp.sign(after), 0.0)


class _Search(NamedTuple):
    """The search for the motors that slip."""

    slip: Array
    """Signs for which the last pass was made."""
    found: Array
    """What it found."""
    passes: Array


class _Given(NamedTuple):
    """What the drives act on in a step."""

    state: MotorsState
    torque: Array
    position: Array
    velocity: Array
    inertia: Array
    """Inertia of the joints on a base that floats freely, without drives."""
    force: Array
    """Force on the joints there."""
    step: Array


def _is_open(of: _Given, search: _Search) -> Array:
    is_other = (of.state.friction != 0.0) & (search.slip != search.found)
    return (search.passes < PASSES) & jnp.any(is_other)


def _search_one(motors: Motors, of: _Given, search: _Search) -> _Search:
    def go_on(search: _Search) -> _Search:
        def solve(force: Array) -> Array:
            return solve_factored(cholesky(motors._inertia(of, search.found)), force[:, None])[:, 0]

        return _Search(search.found, motors._slip_after(of, search.found, solve), search.passes + 1)

    ended: _Search = lax.while_loop(partial(_is_open, of), go_on, search)
    return ended


def _search_batch(motors: Motors, of: _Given, search: _Search) -> _Search:
    """Search for a whole batch; on a CPU only where the first pass has found other signs."""

    def chunks(motors: Motors, of: _Given, search: _Search) -> _Search:
        is_open = jax.vmap(_is_open)(of, search)
        ended: _Search = map_in_chunks(_search_one, (motors, of), search, jnp.argsort(~is_open), jnp.sum(is_open))
        return ended

    found: _Search = lax.platform_dependent(motors, of, search, cpu=chunks, default=jax.vmap(_search_one))
    return found


_search = with_batch_rule(_search_one, _search_batch)


def motors_of(settings: MotorsConfig | None, robot: RobotModel) -> Motors | None:
    """Return the drives of a robot, if there are any; the crate has checked their joints."""
    if settings is None:
        return None
    names, spring = robot.joint_names, settings.elasticity
    return Motors(
        friction=leaf([settings.friction_of.get(name, settings.friction) for name in names]),
        load_friction=leaf([settings.load_friction.get(name, 0.0) for name in names]),
        damping=leaf(settings.damping),
        inertia=leaf(settings.inertia),
        time_constant=leaf(settings.time_constant),
        spring=None if spring is None else Spring(leaf(spring.stiffness), leaf(spring.damping)),
    )

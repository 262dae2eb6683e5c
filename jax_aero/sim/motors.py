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

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Bool, Float

from jax_aero.body.dynamics import accelerate
from jax_aero.body.linalg import invert
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
        velocity = joints.velocity[6:]

        def add(motors: Motors, of: _Given, slip: Array, unless: tuple[Array, Array] | None) -> Driven:
            """Add them as they slip now; return how they slip then."""
            reaction = motors._react(of, slip)
            moved = of.force + jnp.pad(reaction.torque - reaction.slope * of.velocity, (6, 0))
            # Inverted anew whatever is added, so that nobody needs the inverse without drives.
            inertia = of.inverse_mass.joint_inertia + jnp.diag(of.step * reaction.slope)
            inverse = of.inverse_mass._replace(joint_inertia=inertia, joint_gain=invert(inertia, unless))
            after = reaction.velocity(of.velocity + of.step * accelerate(inverse, moved)[6:])
            found = jnp.where(jnp.abs(after) > SLIP, jnp.sign(after), 0.0)
            return Driven(inverse, moved, reaction, lax.stop_gradient(found))

        given = _Given(state, torque, joints.joint_position, velocity, inverse_mass, force, step)
        motors, still = lax.stop_gradient((self, given))
        first = add(motors, still, state.slip, None)

        def is_open(search: _Search) -> Array:
            is_other = (still.state.friction != 0.0) & (search.slip != search.found)
            return (search.passes < PASSES) & jnp.any(is_other)

        def go_on(search: _Search) -> _Search:
            # In a batch also those whose search has ended come here, with the inverse that they have found.
            after = add(motors, still, search.found, (~is_open(search), search.joint_gain))
            return _Search(search.found, after.slip, after.inverse_mass.joint_gain, search.passes + 1)

        start = _Search(state.slip, first.slip, first.inverse_mass.joint_gain, jnp.array(1, jnp.int32))
        ended: _Search = lax.while_loop(is_open, go_on, lax.stop_gradient(start))
        return add(self, given, ended.slip, (jnp.array(True), ended.joint_gain))._replace(slip=ended.found)

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


class _Search(NamedTuple):
    """The search for the motors that slip."""

    slip: Array
    """Signs for which the last pass was made."""
    found: Array
    """What it found."""
    joint_gain: Array
    """Its inverse of the joints' inertia."""
    passes: Array


class _Given(NamedTuple):
    """What the drives act on in a step."""

    state: MotorsState
    torque: Array
    position: Array
    velocity: Array
    inverse_mass: InverseMass
    force: Array
    step: Array


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

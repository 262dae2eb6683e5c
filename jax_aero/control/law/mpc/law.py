"""The predictive law: thrust rates and joint velocities from a plan over the next second, which contains the air.

```text
model     dynamics linearised at the present state
horizon   prediction over unequal knots, QP in the inputs, with the distances that it keeps
plan      its answer, followed until the next one
```

The momentum law prepares its own problem too: its bounds are those of the first knot, and it decides where there is no
plan. Equations M116 to M126 of `docs/model`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float, Int

from jax_aero.aero import AeroModel, LinkConventions, link_forces, wrench_about
from jax_aero.control import qp
from jax_aero.control.command import DEGRADED, MOMENTUM_HELD, NOMINAL, PLAN_KEPT, PLAN_MISSING
from jax_aero.control.law import setpoint as generator
from jax_aero.control.law.limits import Limits
from jax_aero.control.law.mpc.config import Mpc
from jax_aero.control.law.mpc.horizon import Horizon, Target, horizon
from jax_aero.control.law.mpc.model import linearise
from jax_aero.control.law.mpc.plan import Plan, no_plan
from jax_aero.control.law.rates import Followed, MomentumLaw, Prepared, Rates
from jax_aero.control.measurement import UsedMeasurement
from jax_aero.control.preview import Preview, setpoints_at, wind_change
from jax_aero.control.qp import BoxQp, Dtype, QpAnswer
from jax_aero.control.state import ControllerState
from jax_aero.control.terms import Model
from jax_aero.robot import RobotModel
from jax_aero.spatial import log_so3, rotate
from jax_aero.types import Array, Setpoint, where

EXCESS_PASSES = 30
"""Limit of QPs of one plan: each has the values beyond their limits that the last answer brought there."""

PLAN_SHARE = 0.25
"""A plan is followed for at most this part of the horizon; by then the momentum QP decides."""


class _Search(NamedTuple):
    """The search for the values beyond their limits."""

    passes: Int[Array, ""]
    inputs: Float[Array, " u"]
    """Inputs at which the cost is least so far."""
    beyond: Int[Array, " m"]
    answer: QpAnswer
    is_found: Bool[Array, ""]
    """Whether the answer has just these values beyond their limits."""


@dataclass(frozen=True)
class PredictiveLaw:
    """The predictive law of one controller, a `Law`."""

    mpc: Mpc
    momentum: MomentumLaw
    aero: AeroModel
    conventions: LinkConventions
    gains: tuple[Float[Array, ""], Float[Array, ""]]
    """`K_D` [1/s] and `K_P` [1/s²] of the torque law."""
    time_step: Float[Array, ""]
    """[s]."""

    def plan(self, jets: int, dtype: Dtype) -> Plan:
        """Return the plan of a controller that starts."""
        return no_plan(self.mpc.structure.unknowns(jets), dtype)

    def follow(
        self, memory: ControllerState, used: UsedMeasurement, given: Setpoint | None, preview: Preview
    ) -> tuple[ControllerState, Followed]:
        """Choose the set-point as the momentum law does."""
        return self.momentum.follow(memory, used, given, preview)

    def solve(
        self,
        robot: RobotModel,
        memory: ControllerState,
        used: UsedMeasurement,
        model: Model,
        limits: Limits,
        followed: Followed,
    ) -> tuple[ControllerState, Rates]:
        """Compute thrust rates and joint velocities from the plan, which is made anew where that is due."""
        prepared = self.momentum.prepare(robot, memory, used, model, limits, followed)
        structure, last = self.mpc.structure, memory.plan
        if last is None:
            raise AssertionError("a controller with this law has a plan")
        may_plan = limits.holds_position | structure.flies_descent
        waits = (used.time >= last.tried) & (used.time - last.tried <= self.mpc.period - 0.5 * self.time_step)

        def make() -> Plan:
            return self._make(robot, memory, used, model, limits, prepared, last, followed)

        # Reverse mode would store some megabytes of intermediate values for every tick.
        remade = jax.checkpoint(make, prevent_cse=False)
        plan: Plan = lax.cond(may_plan & ~waits, remade, lambda: last)
        plan = plan._replace(since=jnp.where(may_plan, plan.since, -jnp.inf))
        memory = memory._replace(plan=plan)
        age = used.time - plan.since
        is_current = (age >= 0.0) & (age <= PLAN_SHARE * sum(structure.durations))

        def decide() -> tuple[ControllerState, Rates]:
            after, rates = self.momentum.decide(memory, used, prepared)
            is_missing = may_plan & (rates.status != MOMENTUM_HELD)
            return after, rates._replace(status=jnp.where(is_missing, PLAN_MISSING, rates.status))

        chosen: tuple[ControllerState, Rates] = lax.cond(
            is_current, lambda: (memory, self._follow(memory, used, prepared, plan, age)), decide
        )
        return chosen

    def _make(
        self,
        robot: RobotModel,
        memory: ControllerState,
        used: UsedMeasurement,
        model: Model,
        limits: Limits,
        prepared: Prepared,
        last: Plan,
        followed: Followed,
    ) -> Plan:
        """Make a plan; the last one remains where there is no certified answer."""
        mpc, structure = self.mpc, self.mpc.structure
        joints = structure.air, structure.joints
        linear = linearise(robot, self.aero, *joints, used.state, used.thrust, used.wind)
        weights = where(limits.holds_position, mpc.weights, mpc.descent)
        target = self._targets(memory, used, followed)
        wrenches = self._wrenches(robot, used, model, followed.preview)
        following = memory.posture, target, wrenches
        ahead = horizon(mpc, weights, self.gains, robot, linear, used, model, limits, *following)
        bounds = self._bounds(limits, prepared.shaping.problem)
        search = _find_beyond(*jax.tree.map(lax.stop_gradient, (ahead, bounds, last)))
        # Differentiated once, with the values beyond their limits that have been found.
        x = qp.solve(ahead.problem(search.beyond, *bounds), search.answer.warm_start).x
        is_unending = (search.answer.status == qp.SOLVED) & ~search.is_found
        answer = search.answer._replace(status=jnp.where(is_unending, qp.ITERATION_LIMIT, search.answer.status))
        return Plan(
            inputs=jnp.where(search.is_found, x, last.inputs),
            since=jnp.where(search.is_found, used.time, last.since),
            tried=used.time,
            answer=answer,
        )

    def _targets(self, memory: ControllerState, used: UsedMeasurement, followed: Followed) -> Target:
        """Return the motion to follow at the ends of the knots."""
        law, what = self.momentum, followed.ahead
        # The first knot begins when the command acts.
        ends = [law.lead + end for end in self.mpc.structure.ends]
        known: tuple[Array, Setpoint] | None = None
        if followed.preview.setpoints is not None:
            times, later = followed.preview.setpoints
            after = self.time_step * jnp.arange(1, ends[-1] + 1)
            is_known = (what == generator.MOTION) & (after < times[-1] + 0.5 * self.time_step)
            known = is_known, setpoints_at(times, later, followed.setpoint, after)

        def advance(
            carry: tuple[generator.SetpointState, Array], known: tuple[Array, Setpoint] | None
        ) -> tuple[tuple[generator.SetpointState, Array], Setpoint]:
            state, time = carry[0], carry[1] + self.time_step

            def move_on() -> tuple[generator.SetpointState, Setpoint]:
                return generator.ahead(law.setpoint, law.mission, what, state, time)

            def follow(given: Setpoint) -> tuple[generator.SetpointState, Setpoint]:
                return generator.follow(law.setpoint, state, generator.motion_of(given)), given

            if known is None:
                state, setpoint = move_on()
            else:
                state, setpoint = lax.cond(known[0], lambda: follow(known[1]), move_on)
            return (state, time), setpoint

        _, setpoints = lax.scan(advance, (memory.setpoint, used.time), known, length=ends[-1])
        at: Setpoint = jax.tree.map(lambda part: part[np.array(ends) - 1], setpoints)
        if law.latency:
            rest = law.latency - law.lead * self.time_step
            at = jax.vmap(generator.after, in_axes=(0, None))(at, rest)
        rotation = at.rotation
        return Target(
            at.com_position,
            at.com_velocity,
            log_so3(rotation @ used.state.base_rotation.T),
            rotate(rotation, at.angular_velocity),
            at.com_acceleration,
            rotate(rotation, at.angular_acceleration),
        )

    def _wrenches(self, robot: RobotModel, used: UsedMeasurement, model: Model, preview: Preview) -> Array:
        """Return changes of the air's wrench on the robot in its present motion, by the wind at the ends of knots."""
        ends, com = np.cumsum(self.mpc.structure.durations), model.kinematics.com
        if preview.wind is None:
            return jnp.zeros((ends.size, 6), com.dtype)

        def wrench(wind: Array) -> Array:
            return wrench_about(link_forces(self.aero, robot, model.kinematics, self.conventions, wind), com)

        winds = used.wind + wind_change(preview.wind, self.momentum.latency + jnp.asarray(ends, com.dtype))
        changes: Array = jax.vmap(wrench)(winds) - wrench_about(model.link_forces, com)
        return changes

    def _bounds(self, limits: Limits, of_tick: BoxQp) -> tuple[Array, Array]:
        """Return bounds of the inputs: in the first knot and block those of this tick, then the greatest rates."""
        structure, rate_max = self.mpc.structure, self.momentum.tasks.thrust_rate_max
        jets, moved = rate_max.shape[0], np.array(structure.joints, dtype=int)
        most = limits.joint_velocity[moved]
        knots, blocks = len(structure.durations), structure.blocks[-1] + 1

        def all_of(first: Array, sign: float) -> Array:
            thrusts = [first[:jets], sign * jnp.tile(rate_max, knots - 1)]
            return jnp.concatenate([*thrusts, first[jets + moved], sign * jnp.tile(most, blocks - 1)])

        return all_of(of_tick.lower, -1.0), all_of(of_tick.upper, 1.0)

    def _follow(
        self, memory: ControllerState, used: UsedMeasurement, prepared: Prepared, plan: Plan, age: Array
    ) -> Rates:
        """Return the inputs of the plan `age` [s] after its start, within the bounds of this tick."""
        structure, of_tick = self.mpc.structure, prepared.shaping.problem
        ends = np.cumsum(structure.durations)[:-1]
        knot = jnp.sum(age > ends - 0.5 * self.time_step)
        jets, moved = used.thrust.shape[0], np.array(structure.joints, dtype=int)
        thrusts, joints = jnp.split(plan.inputs, [jets * len(structure.durations)])
        back = -self.mpc.posture_gain * (used.state.joint_position - memory.posture)
        joint_velocity = back.at[moved].set(joints.reshape(-1, moved.size)[jnp.array(structure.blocks)[knot]])
        u = jnp.concatenate([thrusts.reshape(-1, jets)[knot], joint_velocity])
        u = jnp.clip(u, of_tick.lower, of_tick.upper)
        answer = plan.answer._replace(x=u, side=jnp.zeros(u.shape, plan.answer.side.dtype))
        usual = jnp.where(used.modes == 0, NOMINAL, DEGRADED)
        status = jnp.where(plan.answer.status == qp.SOLVED, usual, PLAN_KEPT)
        return Rates(*prepared, answer, thrust_rate=u[:jets], joint_velocity=u[jets:], status=status)


def _find_beyond(ahead: Horizon, bounds: tuple[Array, Array], last: Plan) -> _Search:
    """Find the thrusts, joints and distances that the minimiser brings beyond their limits."""

    def is_running(search: _Search) -> Array:
        is_solved = search.answer.status == qp.SOLVED
        return ~search.is_found & is_solved & (search.passes < EXCESS_PASSES)

    def one(search: _Search) -> _Search:
        answer = qp.solve(ahead.problem(search.beyond, *bounds), search.answer.warm_start)
        is_found = (answer.status == qp.SOLVED) & jnp.all(ahead.beyond(answer.x) == search.beyond)
        # The cost falls along the way; its least point has other values beyond their limits.
        share = jnp.where(search.passes == 0, 1.0, ahead.least_on_way(search.inputs, answer.x))
        inputs = search.inputs + share * (answer.x - search.inputs)
        beyond = jnp.where(is_found, search.beyond, ahead.beyond(inputs))
        return _Search(search.passes + 1, inputs, beyond, answer, is_found)

    beyond = jnp.where(jnp.isfinite(last.since), ahead.beyond(last.inputs), 0).astype(jnp.int8)
    begun = last.answer._replace(status=jnp.full_like(last.answer.status, qp.SOLVED))
    start = _Search(jnp.zeros((), jnp.int32), last.inputs, beyond, begun, jnp.array(False))
    found: _Search = lax.while_loop(is_running, one, start)
    return found

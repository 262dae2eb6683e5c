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
from jax_aero.body.batches import any_in_batch, compute_where, in_chunks, keep_answer
from jax_aero.body.jets import Engines
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import log_so3, rotate
from jax_aero.control import qp
from jax_aero.control.law import setpoint as generator
from jax_aero.control.law.plan import Plan
from jax_aero.control.law.rates import Followed, MomentumLaw, Prepared, Rates
from jax_aero.control.measurement import Measurement
from jax_aero.control.mpc.config import POSTURE_GAIN, Mpc
from jax_aero.control.mpc.horizon import Horizon, Target, horizon
from jax_aero.control.mpc.model import linearise
from jax_aero.control.preview import setpoints_at, wind_change
from jax_aero.control.qp import BoxQp, QpAnswer
from jax_aero.control.state import ControllerState
from jax_aero.control.terms import Model
from jax_aero.rust import MODES
from jax_aero.types import Array, Setpoint, where

FACTORISATIONS_MAX = 300
"""Limit of the factorisations of one plan, over all its QPs.

Each QP has the values beyond their limits that the last answer brought there. Where the factorisations do not suffice,
the last plan is followed.
"""

SEARCHED = 4
"""Number of plans that are searched for together on a CPU, until the last of them is found."""

PLAN_SHARE = 0.25
"""A plan is followed for at most this part of the horizon; by then the momentum QP decides."""


class _Search(NamedTuple):
    """The search for the values beyond their limits."""

    factorisations: Int[Array, ""]
    inputs: Float[Array, " u"]
    """Inputs at which the cost is least so far."""
    beyond: Int[Array, " m"]
    answer: QpAnswer
    is_found: Bool[Array, ""]
    """Whether the answer has just these values beyond their limits."""


@dataclass(frozen=True)
class PredictiveLaw:
    """The predictive law of one controller."""

    mpc: Mpc
    engines: Engines | None
    """Engines that follow the thrust rates; `None` if thrusts do so themselves."""
    momentum: MomentumLaw
    aero: AeroModel
    conventions: LinkConventions
    gains: tuple[Float[Array, ""], Float[Array, ""]]
    """`K_D` [1/s] and `K_P` [1/s²] of the torque law."""
    time_step: Float[Array, ""]
    """[s]."""

    def solve(
        self, robot: RobotModel, memory: ControllerState, now: Measurement, model: Model, followed: Followed
    ) -> tuple[ControllerState, Rates]:
        """Compute thrust rates and joint velocities from the plan, which is made anew where that is due."""
        prepared, last = self.momentum.prepare(robot, memory, now, model, followed), memory.plan
        if last is None:
            raise AssertionError("a controller with this law has a plan")
        waits = (now.time >= last.tried) & (now.time - last.tried <= self.mpc.period - 0.5 * self.time_step)

        is_due, limits = ~waits, prepared.shaping.problem
        targets = self._targets_where(is_due, memory, now, followed)

        def problem() -> tuple[Horizon, tuple[Array, Array]]:
            return self._problem(robot, memory, now, model, limits, targets)

        # The horizon of the search is not that of the derivatives, which are of all samples or of none.
        search = keep_answer(compute_where(is_due, lambda: _find_beyond(*problem(), last)))

        def make() -> Plan:
            return self._make(now, last, *problem(), search)

        # Reverse mode would store some megabytes of intermediate values for every tick.
        made = jax.checkpoint(make, prevent_cse=False)
        plan: Plan = lax.cond(any_in_batch(is_due), lambda: where(waits, last, made()), lambda: last)
        memory = memory._replace(plan=plan)
        age = now.time - plan.since
        is_current = (age >= 0.0) & (age <= PLAN_SHARE * sum(self.mpc.structure.durations))

        def decide() -> tuple[ControllerState, Rates]:
            after, rates = self.momentum.decide(memory, prepared)
            return after, rates._replace(modes=rates.modes | MODES["plan_missing"])

        followed_plan = memory, self._follow(memory, now, prepared, plan, age)
        chosen: tuple[ControllerState, Rates] = lax.cond(
            any_in_batch(~is_current), lambda: where(is_current, followed_plan, decide()), lambda: followed_plan
        )
        return chosen

    def _problem(
        self,
        robot: RobotModel,
        memory: ControllerState,
        now: Measurement,
        model: Model,
        of_tick: BoxQp,
        target: Target,
    ) -> tuple[Horizon, tuple[Array, Array]]:
        """Return the horizon from now, and the bounds of its inputs."""
        structure = self.mpc.structure
        linear = linearise(robot, self.aero, structure.air, structure.joints, now.state, now.thrust, now.wind)
        wrenches = self._wrenches(robot, now, model)
        ahead = horizon(self.mpc, self.engines, self.gains, robot, linear, now, model, memory.posture, target, wrenches)
        return ahead, self._bounds(of_tick, ahead)

    def _make(self, now: Measurement, last: Plan, ahead: Horizon, bounds: tuple[Array, Array], search: _Search) -> Plan:
        """Make a plan; the last one remains where there is no certified answer."""
        # Differentiated once, with the values beyond their limits that have been found.
        x = qp.minimiser(ahead.problem(search.beyond, *bounds), search.answer)
        is_unending = (search.answer.status == qp.SOLVED) & ~search.is_found
        status = jnp.where(is_unending, qp.ITERATION_LIMIT, search.answer.status)
        answer = search.answer._replace(status=status, iterations=search.factorisations)
        return Plan(
            inputs=jnp.where(search.is_found, x, last.inputs),
            since=jnp.where(search.is_found, now.time, last.since),
            tried=now.time,
            answer=answer,
            damping=last.damping if ahead.engines is None else ahead.engines.damping,
        )

    def _targets_where(
        self, is_due: Bool[Array, ""], memory: ControllerState, now: Measurement, followed: Followed
    ) -> Target:
        """Return the motion to follow if a plan is due in any sample of a batch, otherwise zeros."""

        def targets() -> Target:
            return self._targets(memory, now, followed)

        def nothing() -> Target:
            zeros: Target = jax.tree.map(lambda part: jnp.zeros(part.shape, part.dtype), jax.eval_shape(targets))
            return zeros

        found: Target = lax.cond(any_in_batch(is_due), jax.checkpoint(targets, prevent_cse=False), nothing)
        return found

    def _targets(self, memory: ControllerState, now: Measurement, followed: Followed) -> Target:
        """Return the motion to follow at the ends of the knots."""
        law = self.momentum
        # The first knot begins when the command acts.
        ends = [law.lead + end for end in self.mpc.structure.ends]
        known: tuple[Array, Setpoint] | None = None
        if followed.is_given and now.preview.setpoints is not None:
            times, later = now.preview.setpoints
            after = self.time_step * jnp.arange(1, ends[-1] + 1)
            known = after < times[-1] + 0.5 * self.time_step, setpoints_at(times, later, followed.setpoint, after)

        def advance(
            carry: tuple[generator.SetpointState, Array], known: tuple[Array, Setpoint] | None
        ) -> tuple[tuple[generator.SetpointState, Array], Setpoint]:
            state, time = carry[0], carry[1] + self.time_step

            def follow(given: Setpoint) -> tuple[generator.SetpointState, Setpoint]:
                return generator.follow(law.setpoint, state, generator.motion_of(given)), given

            if not followed.is_given:
                state, setpoint = generator.update(law.setpoint, law.mission, state, time)
            elif known is None:
                state, setpoint = generator.move_on(law.setpoint, state)
            else:
                is_known, given = known
                state, setpoint = lax.cond(
                    is_known, lambda: follow(given), lambda: generator.move_on(law.setpoint, state)
                )
            return (state, time), setpoint

        _, setpoints = lax.scan(advance, (memory.setpoint, now.time), known, length=ends[-1])
        at: Setpoint = jax.tree.map(lambda part: part[np.array(ends) - 1], setpoints)
        if law.latency:
            rest = law.latency - law.lead * self.time_step
            at = jax.vmap(generator.after, in_axes=(0, None))(at, rest)
        rotation = at.rotation
        return Target(
            at.com_position,
            at.com_velocity,
            log_so3(rotation @ now.state.base_rotation.T),
            rotate(rotation, at.angular_velocity),
            at.com_acceleration,
            rotate(rotation, at.angular_acceleration),
        )

    def _wrenches(self, robot: RobotModel, now: Measurement, model: Model) -> Array:
        """Return changes of the air's wrench on the robot in its present motion, by the wind at the ends of knots."""
        ends, com = np.cumsum(self.mpc.structure.durations), model.kinematics.com
        if now.preview.wind is None:
            return jnp.zeros((ends.size, 6), com.dtype)

        def wrench(wind: Array) -> Array:
            return wrench_about(link_forces(self.aero, robot, model.kinematics, self.conventions, wind), com)

        winds = now.wind + wind_change(now.preview.wind, self.momentum.latency + jnp.asarray(ends, com.dtype))
        changes: Array = jax.vmap(wrench)(winds) - wrench_about(model.link_forces, com)
        return changes

    def _bounds(self, of_tick: BoxQp, ahead: Horizon) -> tuple[Array, Array]:
        """Return bounds of the inputs: in the first knot and block those of this tick, then the greatest rates.

        Those of engines are what their throttles reach.
        """
        structure, tasks = self.mpc.structure, self.momentum.tasks
        jets, moved = tasks.thrust_rate.shape[0], np.array(structure.joints, dtype=int)
        rate_max, most = tasks.thrust_rate_max, tasks.joint_velocity_max[moved]
        knots, blocks = len(structure.durations), structure.blocks[-1] + 1

        def all_of(first: Array, sign: float, of_engines: Array | None) -> Array:
            thrusts = jnp.concatenate([first[:jets], sign * jnp.tile(rate_max, knots - 1)])
            thrusts = thrusts if of_engines is None else of_engines.reshape(-1)
            return jnp.concatenate([thrusts, first[jets + moved], sign * jnp.tile(most, blocks - 1)])

        least, greatest = (None, None) if ahead.engines is None else ahead.engines[1:]
        return all_of(of_tick.lower, -1.0, least), all_of(of_tick.upper, 1.0, greatest)

    def _follow(self, memory: ControllerState, now: Measurement, prepared: Prepared, plan: Plan, age: Array) -> Rates:
        """Return the inputs of the plan `age` [s] after its start, within the bounds of this tick."""
        structure, of_tick = self.mpc.structure, prepared.shaping.problem
        ends = np.cumsum(structure.durations)[:-1]
        knot = jnp.sum(age > ends - 0.5 * self.time_step)
        jets, moved = now.thrust.shape[0], np.array(structure.joints, dtype=int)
        thrusts, joints = jnp.split(plan.inputs, [jets * len(structure.durations)])
        back = -POSTURE_GAIN * (now.state.joint_position - memory.posture)
        joint_velocity = back.at[moved].set(joints.reshape(-1, moved.size)[jnp.array(structure.blocks)[knot]])
        thrust_rate = thrusts.reshape(-1, jets)[knot]
        if self.engines is not None:
            present = jnp.zeros_like(thrust_rate) if now.thrust_rate is None else now.thrust_rate
            thrust_rate = present + self.time_step * (thrust_rate + plan.damping * present)
        u = jnp.concatenate([thrust_rate, joint_velocity])
        u = jnp.clip(u, of_tick.lower, of_tick.upper)
        answer = plan.answer._replace(x=u, side=jnp.zeros(u.shape, plan.answer.side.dtype))
        modes = jnp.where(plan.answer.status == qp.SOLVED, 0, MODES["plan_kept"])
        return Rates(*prepared, answer, thrust_rate=u[:jets], joint_velocity=u[jets:], modes=modes)


def _search_one(ahead: Horizon, bounds: tuple[Array, Array], last: Plan) -> _Search:
    """Find the thrusts, joints and distances that the minimiser brings beyond their limits."""

    def is_running(search: _Search) -> Array:
        is_solved = search.answer.status == qp.SOLVED
        return ~search.is_found & is_solved & (search.factorisations < FACTORISATIONS_MAX)

    def one(search: _Search) -> _Search:
        answer = qp.solve(ahead.problem(search.beyond, *bounds), search.answer.warm_start)
        factorisations = search.factorisations + answer.iterations
        is_found = (answer.status == qp.SOLVED) & jnp.all(ahead.beyond(answer.x) == search.beyond)
        is_found &= factorisations <= FACTORISATIONS_MAX
        # The cost falls along the way; its least point has other values beyond their limits.
        share = jnp.where(search.factorisations == 0, 1.0, ahead.least_on_way(search.inputs, answer.x))
        inputs = search.inputs + share * (answer.x - search.inputs)
        beyond = jnp.where(is_found, search.beyond, ahead.beyond(inputs))
        return _Search(factorisations, inputs, beyond, answer, is_found)

    beyond = jnp.where(jnp.isfinite(last.since), ahead.beyond(last.inputs), 0).astype(jnp.int8)
    begun = last.answer._replace(status=jnp.full_like(last.answer.status, qp.SOLVED))
    start = _Search(jnp.zeros((), jnp.int32), last.inputs, beyond, begun, jnp.array(False))
    found: _Search = lax.while_loop(is_running, one, start)
    return found


_find_beyond = in_chunks(_search_one, SEARCHED)

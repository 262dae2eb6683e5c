"""The laws that a tick calls: from the set-point to thrust rates and joint velocities, here by the momentum QP."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import jax.numpy as jnp
from jaxtyping import Float, Int

from jax_aero.control import qp
from jax_aero.control.command import DEGRADED, MOMENTUM_HELD, NOMINAL
from jax_aero.control.law import setpoint as generator
from jax_aero.control.law.attitude import AttitudeDemand, attitude_demand
from jax_aero.control.law.limits import Limits
from jax_aero.control.law.mission import Mission
from jax_aero.control.law.momentum_qp import MomentumQp, Task, TaskInputs, momentum_qp
from jax_aero.control.law.mpc.plan import Plan
from jax_aero.control.law.setpoint import SetpointParams
from jax_aero.control.law.tasks import TaskParams, standard_tasks, unknown_bounds
from jax_aero.control.measurement import UsedMeasurement
from jax_aero.control.preview import Preview
from jax_aero.control.qp import Dtype, QpAnswer
from jax_aero.control.state import ControllerState
from jax_aero.control.terms import Model
from jax_aero.robot import RobotModel
from jax_aero.types import Array, Setpoint, where


class Followed(NamedTuple):
    """What the law follows."""

    setpoint: Setpoint
    due: Setpoint
    """Set-point of when the command acts, as is the state; without a latency it is `setpoint` (M151)."""
    ahead: Int[Array, ""]
    """What it follows after this tick: `MISSION`, `MOTION` or `DESCENT` of the set-point generator."""
    preview: Preview
    """What is known of the future."""


class Prepared(NamedTuple):
    """The momentum QP of a tick, not yet solved."""

    setpoint: Setpoint
    """Set-point that is followed."""
    attitude: AttitudeDemand
    shaping: MomentumQp


class Rates(NamedTuple):
    """Output of the law."""

    setpoint: Setpoint
    """Set-point that is followed."""
    attitude: AttitudeDemand
    momentum_qp: MomentumQp
    answer: QpAnswer
    """Thrust rates and joint velocities, with the certificate of the QP that decided."""
    thrust_rate: Float[Array, " j"]
    """`Ṫ*` [N/s]."""
    joint_velocity: Float[Array, " n"]
    """`ṡ*` [rad/s]."""
    status: Int[Array, ""]
    """Status of the command if the torque QP is solved."""


class Law(Protocol):
    """A law that a tick calls."""

    def plan(self, jets: int, dtype: Dtype) -> Plan | None:
        """Return the plan of a controller that starts, for a number of jets; `None` if the law does not plan."""
        ...

    def follow(
        self, memory: ControllerState, used: UsedMeasurement, given: Setpoint | None, preview: Preview
    ) -> tuple[ControllerState, Followed]:
        """Choose the set-point: during a descent that of the descent, otherwise the given one, or the mission's."""
        ...

    def solve(
        self,
        robot: RobotModel,
        memory: ControllerState,
        used: UsedMeasurement,
        model: Model,
        limits: Limits,
        followed: Followed,
    ) -> tuple[ControllerState, Rates]:
        """Compute thrust rates and joint velocities that control momentum and attitude."""
        ...


@dataclass(frozen=True)
class MomentumLaw:
    """The momentum law of one controller, a `Law`."""

    setpoint: SetpointParams
    mission: Mission
    tasks: TaskParams
    symmetric_pairs: tuple[tuple[int, int], ...]
    other_tasks: tuple[Task, ...]
    latency: float
    """Time until its torques act [s]."""
    lead: int
    """Whole ticks of that."""

    def plan(self, jets: int, dtype: Dtype) -> None:
        """Return none: the law does not plan."""
        del jets, dtype

    def follow(
        self, memory: ControllerState, used: UsedMeasurement, given: Setpoint | None, preview: Preview
    ) -> tuple[ControllerState, Followed]:
        """Choose the set-point: during a descent that of the descent, otherwise the given one, or the mission's."""
        state, is_descending = memory.setpoint, memory.channels.is_descending
        if given is None:
            moved, followed = generator.update(self.setpoint, self.mission, state, used.time, is_descending)
        else:
            along = generator.follow(self.setpoint, state, generator.motion_of(given)), given
            moved, followed = where(is_descending, generator.descend(self.setpoint, state), along)
        usual = generator.MISSION if given is None else generator.MOTION
        ahead = jnp.where(is_descending, generator.DESCENT, usual)
        due = generator.after(followed, self.latency) if self.latency else followed
        return memory._replace(setpoint=moved), Followed(followed, due, ahead, preview)

    def solve(
        self,
        robot: RobotModel,
        memory: ControllerState,
        used: UsedMeasurement,
        model: Model,
        limits: Limits,
        followed: Followed,
    ) -> tuple[ControllerState, Rates]:
        """Compute thrust rates and joint velocities that control momentum and attitude."""
        return self.decide(memory, used, self.prepare(robot, memory, used, model, limits, followed))

    def prepare(
        self,
        robot: RobotModel,
        memory: ControllerState,
        used: UsedMeasurement,
        model: Model,
        limits: Limits,
        followed: Followed,
    ) -> Prepared:
        """Build the momentum QP of this tick, with its bounds."""
        state, momentum = used.state, model.momentum
        setpoint, due = (
            where(limits.holds_position, goal, generator.without_place(goal, model.kinematics.com))
            for goal in (followed.setpoint, followed.due)
        )
        attitude = attitude_demand(
            limits.gains,
            due,
            state.base_rotation,
            state.velocity[3:6],
            momentum.rate_estimate[3:],
            memory.inertia_0,
        )
        inputs = TaskInputs(
            limits.gains,
            robot,
            state,
            used.thrust,
            model.kinematics,
            model.dynamics,
            momentum,
            due,
            attitude,
            memory.inertia_0,
            memory.posture,
        )
        tasks = standard_tasks(self.tasks, self.symmetric_pairs, inputs)
        tasks += [task.equations(inputs) for task in self.other_tasks]
        return Prepared(setpoint, attitude, momentum_qp(tasks, *unknown_bounds(self.tasks, limits, inputs)))

    def decide(
        self, memory: ControllerState, used: UsedMeasurement, prepared: Prepared
    ) -> tuple[ControllerState, Rates]:
        """Solve the momentum QP."""
        problem, jets = prepared.shaping.problem, used.thrust.shape[0]
        answer = qp.solve(problem, memory.momentum_start)
        is_solved = answer.status == qp.SOLVED
        # Zero rates, as far as the bounds allow.
        u = jnp.where(is_solved, answer.x, jnp.clip(0.0, problem.lower, problem.upper))
        status = jnp.where(is_solved, jnp.where(used.modes == 0, NOMINAL, DEGRADED), MOMENTUM_HELD)
        rates = Rates(*prepared, answer, thrust_rate=u[:jets], joint_velocity=u[jets:], status=status)
        return memory._replace(momentum_start=answer.warm_start), rates

"""The law that the tick calls: from the set-point to thrust rates and joint velocities, by the momentum QP."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.control import qp
from jax_aero.control.law import setpoint as generator
from jax_aero.control.law.attitude import AttitudeDemand, attitude_demand
from jax_aero.control.law.limits import Limits
from jax_aero.control.law.mission import Mission
from jax_aero.control.law.momentum_qp import MomentumQp, Task, TaskInputs, momentum_qp
from jax_aero.control.law.setpoint import SetpointParams
from jax_aero.control.law.tasks import TaskParams, standard_tasks, unknown_bounds
from jax_aero.control.measurement import UsedMeasurement
from jax_aero.control.qp import QpAnswer
from jax_aero.control.state import ControllerState
from jax_aero.control.terms import Model
from jax_aero.robot import RobotModel
from jax_aero.types import Array, Setpoint, where


class Rates(NamedTuple):
    """Output of the law."""

    setpoint: Setpoint
    """Set-point that is followed."""
    attitude: AttitudeDemand
    momentum_qp: MomentumQp
    answer: QpAnswer
    thrust_rate: Float[Array, " j"]
    """`Ṫ*` [N/s]."""
    joint_velocity: Float[Array, " n"]
    """`ṡ*` [rad/s]."""


@dataclass(frozen=True)
class MomentumLaw:
    """The momentum law of one controller. Another law has the functions `follow` and `solve` too."""

    setpoint: SetpointParams
    mission: Mission
    tasks: TaskParams
    symmetric_pairs: tuple[tuple[int, int], ...]
    other_tasks: tuple[Task, ...]

    def follow(
        self, memory: ControllerState, used: UsedMeasurement, given: Setpoint | None
    ) -> tuple[ControllerState, Setpoint]:
        """Choose the set-point: during a descent that of the descent, otherwise the given one, or the mission's."""
        state = memory.setpoint
        if given is None:
            along = generator.update(self.setpoint, self.mission, state, used.time)
        else:
            along = generator.follow(self.setpoint, state, generator.motion_of(given)), given
        down = generator.descend(self.setpoint, state)
        moved, followed = where(memory.channels.is_descending, down, along)
        return memory._replace(setpoint=moved), followed

    def solve(
        self,
        robot: RobotModel,
        memory: ControllerState,
        used: UsedMeasurement,
        model: Model,
        limits: Limits,
        setpoint: Setpoint,
    ) -> tuple[ControllerState, Rates]:
        """Compute thrust rates and joint velocities that control momentum and attitude."""
        state, momentum = used.state, model.momentum
        setpoint = where(limits.holds_position, setpoint, generator.without_place(setpoint, model.kinematics.com))
        attitude = attitude_demand(
            limits.gains,
            setpoint,
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
            setpoint,
            attitude,
            memory.inertia_0,
            memory.posture,
        )
        tasks = standard_tasks(self.tasks, self.symmetric_pairs, inputs)
        tasks += [task.equations(inputs) for task in self.other_tasks]
        shaping = momentum_qp(tasks, *unknown_bounds(self.tasks, limits, inputs))
        answer = qp.solve(shaping.problem, memory.momentum_start)
        # Zero rates, as far as the bounds allow.
        held = jnp.clip(0.0, shaping.problem.lower, shaping.problem.upper)
        u = jnp.where(answer.status == qp.SOLVED, answer.x, held)
        jets = used.thrust.shape[0]
        rates = Rates(setpoint, attitude, shaping, answer, thrust_rate=u[:jets], joint_velocity=u[jets:])
        return memory._replace(momentum_start=answer.warm_start), rates

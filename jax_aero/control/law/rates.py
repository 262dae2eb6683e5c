"""The momentum law: from the set-point to thrust rates and joint velocities, by the momentum QP."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float, Int

from jax_aero.body.robot import RobotModel
from jax_aero.control import qp
from jax_aero.control.law import setpoint as generator
from jax_aero.control.law.attitude import AttitudeDemand, MomentumGains, attitude_demand
from jax_aero.control.law.mission import Mission
from jax_aero.control.law.momentum_qp import MomentumQp, Task, TaskInputs, momentum_qp
from jax_aero.control.law.setpoint import SetpointParams
from jax_aero.control.law.tasks import TaskParams, standard_tasks, unknown_bounds
from jax_aero.control.measurement import Measurement
from jax_aero.control.qp import QpAnswer
from jax_aero.control.state import ControllerState
from jax_aero.control.terms import Model
from jax_aero.rust import MODES
from jax_aero.types import Array, Setpoint


class Followed(NamedTuple):
    """What the law follows."""

    setpoint: Setpoint
    due: Setpoint
    """Set-point of when the command acts, as is the state; without a latency it is `setpoint` (M151)."""
    is_given: bool
    """Whether it comes from outside, and not from the mission."""


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
    modes: Int[Array, ""]
    """A sum of the bits in `rust.MODES`."""


@dataclass(frozen=True)
class MomentumLaw:
    """The momentum law of one controller."""

    gains: MomentumGains
    setpoint: SetpointParams
    mission: Mission
    tasks: TaskParams
    symmetric_pairs: tuple[tuple[int, int], ...]
    other_tasks: tuple[Task, ...]
    latency: float
    """Time until its torques act [s]."""
    lead: int
    """Whole ticks of that."""

    def follow(
        self, memory: ControllerState, time: Float[Array, ""], given: Setpoint | None
    ) -> tuple[ControllerState, Followed]:
        """Choose the set-point of the tick at `time` [s]: the given one, or the mission's."""
        if given is None:
            state, setpoint = generator.update(self.setpoint, self.mission, memory.setpoint, time)
        else:
            state, setpoint = generator.follow(self.setpoint, memory.setpoint, generator.motion_of(given)), given
        due = generator.after(setpoint, self.latency) if self.latency else setpoint
        return memory._replace(setpoint=state), Followed(setpoint, due, given is not None)

    def solve(
        self, robot: RobotModel, memory: ControllerState, now: Measurement, model: Model, followed: Followed
    ) -> tuple[ControllerState, Rates]:
        """Compute thrust rates and joint velocities that control momentum and attitude."""
        return self.decide(memory, self.prepare(robot, memory, now, model, followed))

    def prepare(
        self, robot: RobotModel, memory: ControllerState, now: Measurement, model: Model, followed: Followed
    ) -> Prepared:
        """Build the momentum QP of this tick, with its bounds."""
        state, momentum = now.state, model.momentum
        attitude = attitude_demand(
            self.gains,
            followed.due,
            state.base_rotation,
            state.velocity[3:6],
            momentum.rate_estimate[3:],
            memory.inertia_0,
        )
        inputs = TaskInputs(
            self.gains,
            robot,
            state,
            now.thrust,
            model.kinematics,
            model.dynamics,
            momentum,
            followed.due,
            attitude,
            memory.inertia_0,
            memory.posture,
        )
        tasks = standard_tasks(self.tasks, self.symmetric_pairs, inputs)
        tasks += [task.equations(inputs) for task in self.other_tasks]
        return Prepared(followed.setpoint, attitude, momentum_qp(tasks, *unknown_bounds(self.tasks, inputs)))

    def leave_open(self, prepared: Prepared) -> Rates:
        """Return zero rates, as far as the bounds allow, where something else decides."""
        problem, jets = prepared.shaping.problem, self.tasks.thrust_rate.shape[0]
        u = jnp.clip(0.0, problem.lower, problem.upper)
        zero = jnp.zeros((), jnp.int32)
        answer = QpAnswer(u, jnp.zeros(u.shape, jnp.int8), jnp.zeros((), u.dtype), zero, zero)
        return Rates(*prepared, answer, thrust_rate=u[:jets], joint_velocity=u[jets:], modes=zero)

    def decide(self, memory: ControllerState, prepared: Prepared) -> tuple[ControllerState, Rates]:
        """Solve the momentum QP."""
        problem, jets = prepared.shaping.problem, self.tasks.thrust_rate.shape[0]
        answer = qp.solve(problem, memory.momentum_start)
        is_solved = answer.status == qp.SOLVED
        # Zero rates, as far as the bounds allow.
        u = jnp.where(is_solved, answer.x, jnp.clip(0.0, problem.lower, problem.upper))
        modes = jnp.where(is_solved, 0, MODES["momentum_held"])
        rates = Rates(*prepared, answer, thrust_rate=u[:jets], joint_velocity=u[jets:], modes=modes)
        return memory._replace(momentum_start=answer.warm_start), rates

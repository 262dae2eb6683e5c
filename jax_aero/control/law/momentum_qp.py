"""The momentum QP: a stack of tasks on the unknowns `u = (Ṫ, ṡ)`, with bounds.

```text
task k demands  A_k u + b_k = 0  with weights W_k
H = Σ A_kᵀ W_k A_k,   g = Σ A_kᵀ W_k b_k
```

Tasks with rows contribute low-rank terms to `H`; tasks whose matrix is the identity on some unknowns contribute to its
diagonal. The controller's own tasks are in `tasks`; `momentum_controller(..., tasks=...)` adds others.

Equations M64 and M65 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol, assert_never

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jax_aero.body.robot import RobotModel
from jax_aero.control.law.attitude import AttitudeDemand, MomentumGains
from jax_aero.control.law.momentum import MomentumModel
from jax_aero.control.qp import BoxQp
from jax_aero.types import Array, Dynamics, Kinematics, Setpoint, State

MOMENTUM_TASKS = 3
"""The first tasks: linear momentum, attitude and angular momentum, with three rows each."""


class MomentumQp(NamedTuple):
    """The momentum QP of one tick."""

    task: Float[Array, "9 j+n"]
    """Rows of `task · u + offset = 0`."""
    offset: Float[Array, "9"]
    problem: BoxQp


class TaskInputs(NamedTuple):
    """Inputs of the tasks of one tick."""

    gains: MomentumGains
    robot: RobotModel
    state: State
    thrust: Float[Array, " j"]
    kinematics: Kinematics
    dynamics: Dynamics
    momentum: MomentumModel
    setpoint: Setpoint
    attitude: AttitudeDemand
    inertia_0: Float[Array, "3 3"]
    """Centroidal inertia in body axes at the first tick [kg m²]."""
    posture: Float[Array, " n"]
    """Desired posture `s_d` [rad]."""

    def blocks(self, thrust_rate: Float[Array, "k j"], joint_velocity: Float[Array, "k n"]) -> Float[Array, "k j+n"]:
        """Return rows over all unknowns from those over `Ṫ` and over `ṡ`."""
        return jnp.concatenate([thrust_rate, joint_velocity], axis=1)

    @property
    def joints(self) -> int:
        """Index of the first joint velocity among the unknowns."""
        return self.thrust.shape[0]


class Rows(NamedTuple):
    """A task `matrix @ u + offset = 0`, with a weight for each row."""

    matrix: Float[Array, "r j+n"]
    offset: Float[Array, " r"]
    weights: Float[Array, " r"]


class Diagonal(NamedTuple):
    """A task `u + offset = 0` for consecutive unknowns, starting at `first`, one for each weight."""

    first: int | Int[Array, ""]
    offset: Float[Array, " k"]
    weights: Float[Array, " k"]


class Task(Protocol):
    """A user-defined objective: a pytree whose numbers are leaves.

    >>> @pytree
    ... class KeepVelocity:
    ...     joint: int = static()
    ...     velocity: Array
    ...     weight: Array
    ...
    ...     def equations(self, inputs):
    ...         return Diagonal(inputs.joints + self.joint, -self.velocity[None], self.weight[None])
    """

    def equations(self, inputs: TaskInputs) -> Rows | Diagonal:
        """Return matrix, offset and weights of this tick. Pure, and traced by JAX."""
        ...


def momentum_qp(tasks: Sequence[Rows | Diagonal], lower: Float[Array, " u"], upper: Float[Array, " u"]) -> MomentumQp:
    """Build the QP of one tick from its tasks, those of momentum first, and the bounds of the unknowns."""
    h, g = _cost(tasks, lower.shape[0])
    momentum = [task for task in tasks[:MOMENTUM_TASKS] if isinstance(task, Rows)]
    task = jnp.concatenate([rows.matrix for rows in momentum])
    return MomentumQp(task, jnp.concatenate([rows.offset for rows in momentum]), BoxQp(h, g, lower, upper))


def _cost(tasks: Sequence[Rows | Diagonal], n: int) -> tuple[Array, Array]:
    """Return `H = Σ Aᵀ W A`, `g = Σ Aᵀ W b` over n unknowns (M64), from low-rank and diagonal tasks."""
    rows = [task for task in tasks if isinstance(task, Rows)]
    matrix, offset, weights = (jnp.concatenate(parts) for parts in zip(*rows, strict=True))
    weighted = weights[:, None] * matrix
    h, g = matrix.T @ weighted, offset @ weighted
    diagonal = jnp.zeros(n, h.dtype)
    for task in tasks:
        match task:
            case Rows():
                pass
            case Diagonal(first, shift, weight):
                place = first + np.arange(weight.shape[0])
                diagonal = diagonal.at[place].add(weight)
                g = g.at[place].add(weight * shift)
            case _:
                assert_never(task)
    # The product is symmetric only up to rounding, but the QP assumes an exactly symmetric H.
    return 0.5 * (h + h.T) + jnp.diag(diagonal), g

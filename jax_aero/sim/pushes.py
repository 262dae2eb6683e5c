"""Pushes: forces and moments on bodies of the simulated robot, each for a time.

```text
w = Σ_i σ_i Jᵀ (f_i, μ_i),   σ_i = |[t, t + Δt] ∩ [t_i, t_i + d_i]| / Δt
```

Bodies are structure; wrenches and times are numbers. Equation M155 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_aero.body.kinematics import generalised_force
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import rotate
from jax_aero.config import Push
from jax_aero.types import Array, Kinematics, leaf, pytree, static


@pytree
class Pushes:
    """Pushes of a flight. Their state are the times until their starts [s], negative after them."""

    bodies: tuple[int, ...] = static()
    force: Float[Array, "p 3"]
    """At the bodies' centres of mass [N], inertial axes."""
    moment: Float[Array, "p 3"]
    """[N m], inertial axes."""
    start: Float[Array, " p"]
    """[s]."""
    duration: Float[Array, " p"]
    """[s]."""

    def act(
        self, robot: RobotModel, kin: Kinematics, left: Float[Array, " p"], step: Float[Array, ""]
    ) -> Float[Array, " N"]:
        """Return their mean generalised force over the next `step` [s]."""
        acts = jnp.maximum(jnp.minimum(left + self.duration, step) - jnp.maximum(left, 0.0), 0.0)
        share, at = (acts / step)[:, None], np.array(self.bodies, dtype=int)
        points = rotate(kin.body_rotations[at], robot.coms[at]) + kin.body_positions[at]
        return generalised_force(robot, kin, self.bodies, points, share * self.force, share * self.moment)


def pushes_of(pushes: Sequence[Push], robot: RobotModel) -> Pushes | None:
    """Return the pushes of a flight, if any; the crate has checked their bodies."""
    if not pushes:
        return None
    names = ("force", "moment", "start", "duration")
    bodies = tuple(robot.body_names.index(push.body) for push in pushes)
    return Pushes(bodies, *(leaf([getattr(push, name) for push in pushes]) for name in names))

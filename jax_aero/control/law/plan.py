"""The plan that the predictive law follows: a part of the controller's state."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_aero.control import qp
from jax_aero.control.qp import Dtype, QpAnswer
from jax_aero.types import Array


class Plan(NamedTuple):
    """The last certified plan, and the last attempt."""

    inputs: Float[Array, " u"]
    """Inputs by knot and block, in the order of the horizon's unknowns."""
    since: Float[Array, ""]
    """Time at which it began [s]; minus infinity without a plan."""
    tried: Float[Array, ""]
    """Time of the last attempt [s]."""
    answer: QpAnswer
    """Answer of the last attempt, from which the next one starts."""
    damping: Float[Array, " j"]
    """`β` of the engines at the last attempt [1/s]; zero for ideal jets."""


def no_plan(unknowns: int, jets: int, dtype: Dtype) -> Plan:
    """Return the plan before the first attempt."""
    never, start = jnp.full((), -np.inf, dtype), qp.cold_start(unknowns, dtype)
    count = jnp.zeros((), jnp.int32)
    answer = QpAnswer(*start, jnp.zeros((), dtype), count + qp.ITERATION_LIMIT, count)
    return Plan(start.x, never, never, answer, jnp.zeros(jets, dtype))

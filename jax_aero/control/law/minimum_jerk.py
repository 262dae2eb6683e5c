"""The minimum-jerk filter, which smooths references.

Equations M45 and M46 of `docs/model`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.base.arrays import namespace
from jax_aero.body.spatial import multiply
from jax_aero.types import Array

# Coefficients of the linear minimum-jerk trajectory generator of the iCub control library; the denominator has one
# real pole of multiplicity three at -5.3223/T.
_A, _B, _C = 150.765868956161, 84.9812819469538, 15.9669610709384


class FilterGains(NamedTuple):
    """A minimum-jerk filter discretised for a fixed tick."""

    transition: Float[Array, "3 3"]
    input_gain: Float[Array, "3"]


class FilterState(NamedTuple):
    """Value, first and second derivative of three axes, and the input of the previous tick."""

    derivatives: Float[Array, "3 3"]
    previous_input: Float[Array, "3"]


def filter_gains(smoothing_time: Float[Array, ""], time_step: Float[Array, ""]) -> FilterGains:
    """Discretise `H(s) = (A/T³) / (s³ + (C/T) s² + (B/T²) s + A/T³)` by the bilinear transform (Tustin).

    ```text
    ẋ = F x + e₃ (A/T³) u,   F = ((0 1 0), (0 0 1), (−A/T³ −B/T² −C/T))
    x⁺ = (1 − hF/2)⁻¹ ((1 + hF/2) x + e₃ (h/2)(A/T³) (u + u⁺))
    ```

    The inverse is written out, since T = 5 ms gives entries of 1e6, for which elimination is inaccurate in float32.
    """
    half = 0.5 * time_step
    a, b, c = _A / smoothing_time**3, _B / smoothing_time**2, _C / smoothing_time
    xp = namespace(smoothing_time, time_step)
    adjugate = xp.array(
        [
            [1.0 + half * (c + half * b), half * (1.0 + half * c), half * half],
            [-a * half * half, 1.0 + half * c, half],
            [-a * half, -half * (b + half * a), 1.0],
        ]
    )
    inverse = adjugate / (1.0 + half * (c + half * (b + half * a)))
    return FilterGains(2.0 * inverse - xp.eye(3, dtype=inverse.dtype), half * a * inverse[:, 2])


def filter_start(initial: Float[Array, "3"]) -> FilterState:
    """Return the state at rest at `initial`."""
    return FilterState(jnp.zeros((3, 3), initial.dtype).at[0].set(initial), initial)


def filter_update(gains: FilterGains, state: FilterState, value: Float[Array, "3"]) -> FilterState:
    """Process the input of this tick; the result holds the outputs of the same tick."""
    drive = gains.input_gain[:, None] * (state.previous_input + value)[None]
    return FilterState(multiply(gains.transition, state.derivatives) + drive, value)


def filter_lags(smoothing_time: Float[Array, ""]) -> Float[Array, "2"]:
    """Return `T B / A` [s] and `T² C / A` [s²], with which an input leads an output without jerk."""
    lags: Array = namespace(smoothing_time).stack([smoothing_time * (_B / _A), smoothing_time**2 * (_C / _A)])
    return lags

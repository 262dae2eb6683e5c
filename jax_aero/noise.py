"""Reproducible noise, drawn before a flight with NumPy alone.

Words and uniform numbers equal those of the Rust crate; normal ones agree to two units in the last place, since the
crate takes logarithm, sine and cosine from `libm` and this module from the platform.

PCG-XSH-RR with 64 bits of state; source: M. E. O'Neill, "PCG: A Family of Simple Fast Space-Efficient Statistically
Good Algorithms for Random Number Generation", 2014.

>>> [f"{word:08x}" for word in words(seed=42, stream=54, count=3)]
['a15c02b7', '7b47f409', 'ba1d3330']

Equation M42 of `docs/model`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

_MULTIPLIER = 6_364_136_223_846_793_005
_MASK = 2**64 - 1


def words(seed: int, stream: int, count: int) -> NDArray[np.uint32]:
    """Return the first `count` numbers of stream `stream` of a seed, uniform over 32 bits."""
    increment = (stream << 1 | 1) & _MASK
    states = np.array([((increment + seed) * _MULTIPLIER + increment) & _MASK], np.uint64)
    # n steps together are again s ← a s + c, so the number of known states doubles in every pass.
    a, c = _MULTIPLIER, increment
    while states.size < count:
        states = np.concatenate([states, states * np.uint64(a) + np.uint64(c)])
        a, c = a * a & _MASK, (a * c + c) & _MASK
    states = states[:count]
    middle = (((states >> np.uint64(18)) ^ states) >> np.uint64(27)).astype(np.uint32)
    turn = (states >> np.uint64(59)).astype(np.uint32)
    return (middle >> turn) | (middle << (-turn & np.uint32(31)))


def uniforms(seed: int, stream: int, count: int) -> NDArray[np.float64]:
    """Return `count` numbers uniform in (0, 1)."""
    return (words(seed, stream, count).astype(np.float64) + 0.5) / 4_294_967_296.0


def normals(seed: int, stream: int, count: int) -> NDArray[np.float64]:
    """Return `count` normal numbers with mean 0 and standard deviation 1 (Box and Muller)."""
    pairs = uniforms(seed, stream, count + count % 2).reshape(-1, 2)
    # One by one, since the last bit of NumPy's functions may depend on the length of the array.
    drawn = [
        part
        for first, second in pairs.tolist()
        for radius in (math.sqrt(-2.0 * math.log(first)),)
        for part in (radius * math.cos(math.tau * second), radius * math.sin(math.tau * second))
    ]
    return np.array(drawn[:count])

"""Each experiment with everything that JAX can do with it."""

import pytest

from tests.matrix import pairs


@pytest.mark.slow
@pytest.mark.parametrize("pair", [pair for pair in pairs.others() if pair.action in pairs.NIGHTLY], ids=str)
def test_every_pair_of_jax(flights, pair):
    pairs.check(flights, pair)

"""Each shipped file with everything that the crate can do with it."""

import pytest

from tests.matrix import pairs


@pytest.mark.parametrize("pair", [pair for pair in pairs.others() if pair.action not in pairs.NIGHTLY], ids=str)
def test_every_pair_of_the_crate(flights, pair):
    pairs.check(flights, pair)

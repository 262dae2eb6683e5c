"""Each file that is shipped, and each command, at least once."""

import pytest

from tests.matrix import pairs


def test_every_kind_of_file_has_an_action():
    assert sorted(kind for kind in pairs.shipped() if kind not in pairs.ACTIONS) == []


@pytest.mark.parametrize("pair", pairs.first(), ids=str)
def test_each_file_and_each_command(flights, pair):
    pairs.check(flights, pair)

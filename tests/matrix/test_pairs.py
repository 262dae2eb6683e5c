"""Every shipped file with everything that can be done with it: it works, or it is on the list of refusals."""

from __future__ import annotations

import pytest

from tests.matrix import pairs


@pytest.fixture(scope="module")
def shop(tmp_path_factory):
    return pairs.Shop(tmp_path_factory.mktemp("pairs"))


def test_every_kind_of_file_has_an_action():
    assert sorted(kind for kind in pairs.shipped() if kind not in pairs.ACTIONS) == []


@pytest.mark.parametrize("pair", [pair for pair in pairs.pairs() if pair.action not in pairs.NIGHTLY], ids=str)
def test_what_is_shipped_works(shop, pair):
    pairs.ACTIONS[pair.kind][pair.action](shop, pair.name)

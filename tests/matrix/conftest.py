"""Flights that several pairs use."""

import pytest

from tests.matrix import pairs


@pytest.fixture(scope="session")
def shop(tmp_path_factory):
    return pairs.Shop(tmp_path_factory.mktemp("pairs"))

"""Flights that several pairs use."""

import pytest

from tests.matrix import pairs


@pytest.fixture(scope="session")
def flights(tmp_path_factory):
    return pairs.Flights(tmp_path_factory.mktemp("pairs"))

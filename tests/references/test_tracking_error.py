"""The crate's findings of flights that stray are the reference's, in every tick."""

import pytest

from jax_aero import rust
from tests.references import flights, tracking_error

PUSH = {"body": "root_link", "force": [300.0, 0.0, 0.0], "start": 1.0, "duration": 0.3}
FLIGHTS = {
    "a push": {"disturbances.pushes": [PUSH], "simulator.duration": 6.0},
    "a free joint": {
        "disturbances.joints": [{"joint": "torso_pitch", "kind": "free", "start": 1.0}],
        "simulator.duration": 4.0,
    },
}


@pytest.mark.parametrize("changes", FLIGHTS)
def test_flights_stray_where_the_reference_says_so(changes):
    config = rust.load_config("robot", FLIGHTS[changes])
    agrees, found = tracking_error.follow(config, flights.fly(config))
    assert agrees
    assert any(found)
    assert not all(found)

"""Sensors of the feet in a flight: each error of the measured wrenches by its size, sign and axis, and outages."""

import numpy as np
import pytest

from jax_aero import rust
from jax_aero.rust import Seen, State

EXACT = np.array([10.0, -20.0, 300.0, 1.0, -2.0, 4.0])
"""Wrench on each foot [N, N m]."""


class Standing:
    """A robot at rest, whose feet carry more from tick to tick: (k + 1) times the same wrench in the k-th."""

    def __init__(self, config):
        initial = config["simulator"]["initial"]
        self.state = State.at_rest(rust.Robot(config["robot"]), initial["joint_position"])._replace(
            base_position=np.array(initial["base_position"]), base_rotation=np.diag([-1.0, -1.0, 1.0])
        )
        self.ticks = 0

    def observe(self):
        wrenches = np.tile((self.ticks + 1) * EXACT, (2, 1))
        return Seen(self.state, self.state, wrenches, np.zeros(23), np.zeros((2, 3)))

    def advance(self, _torque, _force):
        """Stay; a tick has several steps, of which the last row is one call."""
        self.ticks += 1


def measured(changes, ticks=1):
    """The wrenches that the controller is given, (ticks, 2, 6)."""
    exact = {"simulator.duration": 1.0, "simulator.sensors.base_rotation": {}}
    config = rust.load_config("robot_take_off", {**exact, **changes})
    flight, found = rust.Flight(config, world=Standing(config)), []
    for _ in range(ticks):
        found.append(np.array(flight.measurement.foot_wrenches))
        flight.step()
    return np.array(found)


@pytest.mark.parametrize(
    ("sensor", "expected"),
    [
        ({}, EXACT),
        ({"force_bias": [1.0, 2.0, 20.0]}, [11.0, -18.0, 320.0, 1.0, -2.0, 4.0]),
        ({"moment_bias": [0.0, 1.0, -1.0]}, [10.0, -20.0, 300.0, 1.0, -1.0, 3.0]),
        ({"cross_talk": 0.1}, [38.0, 11.0, 299.0, 1.2, -1.5, 3.9]),
        # About x by +90°: y becomes z, z becomes −y.
        ({"tilt_rpy_deg": [90.0, 0.0, 0.0]}, [10.0, -300.0, -20.0, 1.0, -4.0, -2.0]),
    ],
)
def test_feet_are_measured_with_the_errors_that_are_asked_for(sensor, expected):
    (found,) = measured({"simulator.sensors.feet": sensor})
    assert found == pytest.approx(np.tile(expected, (2, 1)), abs=1e-12)


def test_a_wrong_attitude_turns_what_the_feet_measure():
    """Bias of the attitude about an axis of the base, whose x axis points backwards here."""
    for axis, sign in ((0, -1.0), (1, -1.0), (2, 1.0)):
        bias, turned = 0.1 * np.eye(3)[axis], np.sin(0.05) * sign * np.eye(3)[axis]
        (found,) = measured({"simulator.sensors.base_rotation": {"bias": bias.tolist()}, "simulator.sensors.feet": {}})
        turn = rust.rotation_from_wxyz([np.cos(0.05), *turned])
        assert found == pytest.approx(np.tile([*turn @ EXACT[:3], *turn @ EXACT[3:]], (2, 1)), abs=1e-12)


def test_feet_are_measured_late():
    exact, late = measured({}, 6), measured({"simulator.sensors.feet": {"delay": 0.02}}, 6)
    assert late[2:] == pytest.approx(exact[:-2])
    assert late[1] == pytest.approx(exact[0])


def test_a_replay_has_the_wrenches_that_the_feet_measured():
    """Not the true ones, which the world's log has as well."""
    errors = {"force_bias": [0.0, 0.0, 20.0], "force_noise_std": 5.0, "delay": 0.02}
    changes = {"simulator.duration": 0.1, "simulator.sensors.feet": errors}
    config = rust.load_config("robot_take_off", changes)
    flown = rust.Flight(config, world=Standing(config)).run().log
    assert np.abs(flown["raw_foot_wrench"] - flown["foot_wrench"])[..., 2].max() > 20.0
    replayed = rust.replay(config, flown)
    assert {"contact_force", "unmodelled_wrench", "feet_carry"} <= replayed.keys()
    for name, signal in replayed.items():
        np.testing.assert_array_equal(signal, flown[name], err_msg=name)
    true = rust.replay(config, {**flown, "raw_foot_wrench": flown["foot_wrench"]})
    assert (true["unmodelled_wrench"] != replayed["unmodelled_wrench"]).any()


def test_noise_of_force_and_moment_have_their_sizes():
    """Of 80 ticks and two feet: a standard deviation is known to 1/√(2 · 480)."""
    noise = {"force_noise_std": 5.0, "moment_noise_std": 0.5}
    errors = measured({"simulator.sensors.feet": noise}, 80) - measured({}, 80)
    force, moment = errors[..., :3].std(), errors[..., 3:].std()
    assert (force / 5.0, moment / 0.5) == pytest.approx((1.0, 1.0), abs=4.0 / np.sqrt(2 * 480))


def test_an_outage_of_the_feet_is_one():
    outage = {"channel": "feet", "start": 0.03, "duration": 0.02, "kind": "missing"}
    found = measured({"disturbances.outages": [outage]}, 8)
    assert list(np.isnan(found).all(axis=(1, 2))) == [False] * 3 + [True] * 2 + [False] * 3


@pytest.mark.parametrize(
    "changes",
    [{"simulator.sensors.feet": {}}, {"disturbances.outages": [{"channel": "feet", "start": 1.0, "kind": "missing"}]}],
)
def test_a_controller_without_feet_has_no_sensors_of_them(changes):
    with pytest.raises(ValueError, match="the controller has no feet"):
        rust.Flight(rust.load_config("robot", changes))

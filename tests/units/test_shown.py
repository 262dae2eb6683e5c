"""Objects that a notebook shows, and that go to the workers of a cluster."""

import copy
import pickle
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest

from jax_aero import rust

CONFIG = rust.load_config("test2", {"simulator.duration": 0.1})
ROBOT = rust.Robot(CONFIG["robot"])
FLIGHT = rust.fly(CONFIG)


class Hover:
    """A controller that keeps the robot for its masses, as that of `docs/own_controller.md`."""

    def __init__(self, config):
        self.robot = rust.Robot(config["robot"])

    def __call__(self, seen):
        force = rust.dynamics(self.robot, seen.state).mass_matrix[0, 0] * self.robot.gravity
        return rust.Command(10.0 * seen.thrust * (force / seen.thrust.sum() - 1.0), [0.0] * len(self.robot.joint_names))


def fly(config, controller):
    return rust.Flight(config, controller=controller).run()


def last_tick():
    flight = rust.Flight(CONFIG)
    flight.step()
    return flight.last


@pytest.mark.parametrize(
    "thing",
    [
        CONFIG,
        rust.load_controller("baseline"),
        ROBOT,
        FLIGHT,
        last_tick(),
        rust.dynamics(ROBOT, last_tick().estimates.state),
    ],
)
def test_what_a_notebook_shows_is_a_line_or_a_small_table(thing):
    shown = repr(thing)
    assert shown.count("\n") < 60
    assert max(map(len, shown.split("\n"))) <= 120
    assert " at 0x" not in shown


@pytest.mark.parametrize("again", [lambda thing: pickle.loads(pickle.dumps(thing)), copy.deepcopy])
def test_copies_are_the_same(again):
    assert again(CONFIG) == CONFIG
    assert repr(again(FLIGHT)) == repr(FLIGHT)
    assert again(FLIGHT).log.keys() == FLIGHT.log.keys()
    twin = again(ROBOT)
    state = rust.State.at_rest(ROBOT)
    assert (twin.toml_text, twin.urdf_text, repr(twin)) == (ROBOT.toml_text, ROBOT.urdf_text, repr(ROBOT))
    assert (rust.dynamics(twin, state).mass_matrix == rust.dynamics(ROBOT, state).mass_matrix).all()


def test_a_controller_of_ones_own_flies_in_another_process():
    """As joblib, Dask and Ray send it: pickled, into a process that is started anew."""
    controller = Hover(CONFIG)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as workers:
        far = workers.submit(fly, CONFIG, controller).result()
    assert (far["thrust"] == fly(CONFIG, controller)["thrust"]).all()

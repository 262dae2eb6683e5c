"""A twin that is wrong by little is refused by some tick of a flight; the right one agrees. Four flights of 2 s."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Float

from jax_aero import rust
from jax_aero.aero import WeightedModel
from jax_aero.sim import plant, prepare
from jax_aero.sim.plant import Plant
from jax_aero.sim.scenario import Scenario
from jax_aero.sim.step import FlightState
from jax_aero.types import Array, pytree
from jax_aero.verify import law, use_double_precision
from jax_aero.verify.flight import compare_ticks, fly_sections, join, replay_rounded

pytestmark = pytest.mark.usefixtures("x64")

MOVING = [0.2, -0.1, 0.1, 0.1, 0.2, 0.1]
"""First velocity of the base [m/s, rad/s], so that everything acts from the first tick on."""


@pytree
class GyratingPlant(Plant):
    """A plant whose gyroscopic moment has a factor."""

    gyration: Float[Array, ""]


@pytest.fixture(scope="module", autouse=True)
def gyration():
    real = plant.advance

    def advance(plant, state, seen, *commands):
        spin, dynamics = state.robot.velocity[3:6], seen.dynamics
        moment = (plant.gyration - 1.0) * jnp.cross(spin, dynamics.centroidal_inertia @ spin)
        seen = seen._replace(dynamics=dynamics._replace(bias=dynamics.bias.at[3:6].add(moment)))
        return real(plant, state, seen, *commands)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plant, "advance", advance)
        yield


def changeable(config) -> tuple[Scenario, FlightState]:
    """Return JAX's flight with a leaf for every error: of plant and controller apart, of commands that may be late."""
    step = config["controller"]["time_step"]
    late = {"simulator.actuation": {"torque_delay": step, "thrust_delay": step}}
    scenario, start = prepare(rust.set_keys(config, late))
    world, robot, one = scenario.plant, scenario.plant.robot, np.ones(())
    way = scenario.actuation
    parts = {item.name: getattr(world, item.name) for item in fields(Plant)}
    parts["aero"] = WeightedModel(world.aero, *np.ones((3, robot.aero_links.count)))
    world = GyratingPlant(**parts, gyration=one)
    model = scenario.controller_model or robot
    return replace(scenario, plant=world, actuation=replace(way, lag=0 * way.lag), controller_model=model), start


def wrong_twins(scenario: Scenario) -> Iterator[tuple[str, Scenario]]:
    world, controller, model = scenario.plant, scenario.controller, scenario.controller_model
    robot, swapped, way = world.robot, [0, 1, 3, 2], scenario.actuation

    def of_plant(**parts) -> Scenario:
        return replace(scenario, plant=replace(world, **parts))

    def of_robot(**parts) -> Scenario:
        return of_plant(robot=replace(robot, **parts))

    def of_controller(**parts) -> Scenario:
        return replace(scenario, controller=replace(controller, **parts))

    yield "1 % of thrust", of_robot(jets=replace(robot.jets, axes=1.01 * robot.jets.axes))
    yield "1 % of drag", of_plant(aero=replace(world.aero, drag=1.01 * world.aero.drag))
    yield "1 % of mass", of_robot(masses=1.01 * robot.masses)
    yield "1 % of inertia", of_robot(inertias=1.01 * robot.inertias)
    yield ("a dead time of one tick", replace(scenario, actuation=replace(way, lag=way.lag + world.substeps)))
    yield "the sign of the gyroscopic moment", of_plant(gyration=jnp.array(-1.0))
    yield "swapped jets", of_robot(jets=replace(robot.jets, positions=robot.jets.positions[swapped, :]))
    yield (
        "swapped jets of the controller",
        replace(
            scenario,
            controller_model=replace(model, jets=replace(model.jets, positions=model.jets.positions[swapped, :])),
        ),
    )
    yield "1 % of the controller's mass", replace(scenario, controller_model=replace(model, masses=1.01 * model.masses))
    yield (
        "1 % of a gain of the torques",
        of_controller(torque=replace(controller.torque, kd=1.01 * controller.torque.kd)),
    )
    if controller.mpc is None:
        momentum = replace(controller.momentum, c1=1.01 * controller.momentum.c1)
        yield "1 % of a gain of the momentum", of_controller(momentum=momentum)
    else:
        weights = replace(controller.mpc.weights, attitude=1.01 * controller.mpc.weights.attitude)
        yield "1 % of a weight", of_controller(mpc=replace(controller.mpc, weights=weights))


@pytest.mark.parametrize("experiment", ["test2", "robustness", "min_fuel", "test2_mpc"])
def test_wrong_twins_are_refused(experiment):
    changes = {"simulator.duration": 1.99, "simulator.initial.base_velocity": MOVING}
    config = use_double_precision(rust.load_config(experiment, changes))
    crate, (scenario, start) = rust.fly(config), changeable(config)
    rounded = replay_rounded(config, crate, crate)

    def refused(twin: Scenario) -> list[str]:
        ticks, rows = compare_ticks(crate, join(crate, list(fly_sections(twin, start, crate))), rounded)
        assert ticks == 200
        return [row.quantity for row in rows if not row.agrees]

    assert refused(scenario) == []
    found = {name: refused(twin) for name, twin in wrong_twins(scenario)}
    assert len(found) > 10
    assert all(found.values()), found


def test_a_wrong_law_is_refused():
    """In half a second of the recommended controller, given what the crate estimates."""
    config = rust.load_config("robot", {"simulator.duration": 0.5})
    flown, (params, model) = law.fly_and_record(config), law.law_of(config)

    def refused(params, model=model, flown=flown):
        rows = law.compare_law(config, flown, law.follow_law(params, model, flown))
        return [row.quantity for row in rows if not row.agrees]

    assert refused(params) == []
    mpc = params.mpc
    engines = params.engines._replace(k_d=1.01 * params.engines.k_d)
    late = flown.handed._replace(thrust=np.roll(flown.handed.thrust, 1, axis=0))
    turned = flown.handed._replace(thrust_rate=-flown.handed.thrust_rate)
    wrong = {
        "1 % of a weight": refused(replace(params, mpc=replace(mpc, decay=1.01 * mpc.decay))),
        "1 % of a gain": refused(replace(params, torque=replace(params.torque, kp=1.01 * params.torque.kp))),
        "1 % of mass": refused(params, replace(model, masses=1.01 * model.masses)),
        "thrusts of the tick before": refused(params, flown=flown._replace(handed=late)),
        "no wrench": refused(params, flown=flown._replace(wrench=0.0 * flown.wrench)),
        "1 % of an engine's damping": refused(replace(params, engines=engines)),
        "the sign of the thrust rates": refused(params, flown=flown._replace(handed=turned)),
    }
    assert all(wrong.values()), wrong

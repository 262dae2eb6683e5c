"""The shapes that functions and structures of `jax_aero` state, checked while they are traced: `-m tests.tools.traced`.

Shapes are known as soon as a function is traced: no flight is compiled.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_type_hints

import jax
import jax.numpy as jnp
import numpy as np
from beartype.door import is_bearable
from jaxtyping import Float, jaxtyped

from tests.shapes import states_shape  # isort: skip - before the first import of jax_aero
from jax_aero import aero, rust, sim, types
from jax_aero.base import typed_config
from jax_aero.body import robot
from jax_aero.body.kinematics import kinematics
from jax_aero.control import qp
from jax_aero.control.estimate import estimator
from jax_aero.control.law import recorded
from jax_aero.control.tick import MomentumController, momentum_controller
from jax_aero.sim import sensors
from tests.aero_kinds import FILES

CONFIGS = Path(__file__).parents[2] / "configs"

EVERYTHING = {
    "simulator.duration": 0.05,
    "simulator.jets": {"dynamics": "throttled"},
    "disturbances.aero": {"drag": 1.1},
    "disturbances.model_error": {"mass_scale": 1.1},
    "controller.fault_detection.engines": False,
    "disturbances.jets": {"failure": {"jet": "chest_l_jet", "time": 1.0, "kind": "off", "decay": 0.5}},
}
"""What a flight may have beside its defaults."""

STACKED = (estimator.EstimatorState, sensors.SensorState, recorded.Recording)
"""Structures with parts that have one more axis in front."""


def agree(structure: Any, sizes: dict[str, int], place: str = "") -> None:
    """Check that the arrays of a structure, and of those within it, have the shapes of their annotations."""
    if isinstance(structure, dict):
        for name, part in structure.items():
            agree(part, sizes, f"{place}.{name}")
    if not type(structure).__module__.startswith("jax_aero"):
        return
    place = place or type(structure).__name__
    hints = get_type_hints(type(structure), include_extras=True)
    with jaxtyped("context"):
        for axis, size in sizes.items():
            assert isinstance(np.zeros(size), Float[np.ndarray, f" {axis}"])
        for name, hint in hints.items():
            part = getattr(structure, name)
            if states_shape(hint):
                assert is_bearable(part, hint), f"{place}.{name} is {part}; expected {hint}"
    if not isinstance(structure, STACKED):
        for name in hints:
            agree(getattr(structure, name), sizes, f"{place}.{name}")


def sizes_of(model: robot.RobotModel) -> dict[str, int]:
    """Sizes of the axes that mean the same everywhere."""
    n = model.n_joints
    return {"n": n, "N": 6 + n, "nb": 1 + n, "j": model.jets.count, "L": model.aero_links.count}


@types.pytree
class Checked:
    """The flight controller, whose state, measurement and command are checked."""

    inner: MomentumController

    def init(self, _model: robot.RobotModel, _state: types.State) -> Any:
        """Leave the start, which would be compiled, to the first tick."""
        return ()

    def step(self, model: robot.RobotModel, _: Any, measurement: sim.Measurement) -> tuple[Any, sim.Command]:
        """Start, and take one tick."""
        state = self.inner.init(model, measurement.state)
        after, command = self.inner.step(model, state, measurement)
        for part in (self.inner, state, measurement, after, command):
            agree(part, sizes_of(model))
        return (), command


def trace_flight() -> None:
    """Trace a tick of a batch of flights, and a gradient through a QP."""
    config = typed_config.scenario_config(rust.load_config("test2_sensors", EVERYTHING))
    model = robot.load_robot(config.robot)
    scenario, state = sim.prepare(config, model, controller=Checked(momentum_controller(config, model)))

    def fly(state: sim.FlightState) -> sim.FlightRow:
        after, row = sim.step(scenario, state, jnp.array(1))
        for part in (scenario, state, after, row):
            agree(part, sizes_of(model))
        return row

    rows = jax.eval_shape(jax.vmap(fly), jax.tree.map(lambda x: np.stack([x, x]), state))
    assert rows["com_position"].shape == (2, 3)
    problem = qp.BoxQp(jnp.eye(4), jnp.ones(4), -jnp.ones(4), jnp.ones(4))
    jax.eval_shape(jax.grad(lambda problem: qp.solve(problem).x.sum()), problem)


def trace_aerodynamics() -> None:
    """Trace the forces of every kind of aerodynamic model."""
    model = robot.load_robot(CONFIGS / "robot" / "ironcub_mk1.toml")
    state = types.State(np.zeros(3), np.eye(3), np.zeros(model.n_joints), np.ones(model.n_velocities))
    for name in FILES.values():
        chosen = aero.aero_model(typed_config.aero_config(rust.load_aero(name)), model)

        def wrench(state: types.State, chosen: aero.AeroModel = chosen) -> Any:
            kin = kinematics(model, state)
            forces = aero.link_forces(chosen, model, kin, aero.LinkConventions(), jnp.ones(3))
            for part in (chosen, kin, forces):
                agree(part, sizes_of(model))
            return aero.wrench_about(forces, kin.com)

        jax.eval_shape(wrench, state)


if __name__ == "__main__":
    trace_aerodynamics()
    trace_flight()

"""From a configuration to a scenario and its state at the first tick; what the crate alone flies is refused."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jax_aero import rust
from jax_aero.aero import AeroModel, ReadNetwork
from jax_aero.aero.network_card import load_network
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.jets import JetDynamics
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.config import ScenarioConfig
from jax_aero.control import Controller
from jax_aero.control.tick import momentum_controller
from jax_aero.refusals import refuse
from jax_aero.sim import plant as world
from jax_aero.sim.actuation import actuation
from jax_aero.sim.measuring import measuring
from jax_aero.sim.model_error import controller_model
from jax_aero.sim.outcome import FallLimits
from jax_aero.sim.programs import keep_programs
from jax_aero.sim.scenario import Scenario, convert_precision
from jax_aero.sim.step import FlightState, begin
from jax_aero.sim.wind import wind_model
from jax_aero.types import leaves

_begin_once = world.run_once(begin)


def prepare(
    config: ScenarioConfig | Mapping[str, Any],
    robot: RobotModel | None = None,
    *,
    controller: Controller[Any] | None = None,
    aero: AeroModel | None = None,
    jets: JetDynamics | None = None,
    dtype: Any = np.float64,
    read_network: ReadNetwork = load_network,
) -> tuple[Scenario, FlightState]:
    """Return a scenario and its state at the first tick. Call it outside loops, since it computes tables and noise.

    Fault detection is the crate's alone: `controller.channels`, `controller.fault_detection` and `mpc.descent` do
    nothing here, and a flight is the crate's as long as its signal `degraded_modes` has no mode but those of solvers.
    Refused by key, since the crate alone flies it (`backend = "rust"`), is what `jax_aero.refusals` lists.

    Parameters
    ----------
    config
        A configuration, as `jax_aero.load` returns it, or what `read_config` made of it.
    robot
        The robot that flies, if it is loaded already.
    controller
        Replaces the configured controller.
    aero, jets
        Aerodynamics and jets of the simulator, replacing the configured ones.
    dtype
        Precision of all numbers. The controller's QPs have condition numbers near 1e8, so use single precision only
        for throughput where it is known to suffice.
    read_network
        Function that reads the networks named in the configuration.

    Raises
    ------
    ValueError
        If the configuration does not fit the robot, or contains what the crate alone flies; or if JAX does not compute
        in this precision.
    """
    if np.dtype(dtype) == np.float64 and jnp.result_type(float) != np.float64:
        raise ValueError(
            "dtype is float64, but JAX computes in single precision here; "
            "expected a call inside `with jax.enable_x64(True):`, or dtype=np.float32"
        )
    keep_programs()
    config = read_config(config)
    if robot is None:
        robot = load_robot(config.robot)
    elif Path(robot.source) != Path(config.robot).resolve():
        raise ValueError(f"`robot` is that of {robot.source}; expected that of the configuration, {config.robot}")
    refuse(config)
    plant, state = world.start_plant(config, robot, aero, jets, read_network)
    ticks, drawn, step = world.n_ticks(config), world.n_drawn(config), config.controller.time_step
    model, wind, way = controller_model(config, robot), wind_model(config.wind), config.simulator.actuation
    scenario = Scenario(
        plant=plant,
        controller=momentum_controller(config, model or robot, read_network) if controller is None else controller,
        wind=wind,
        fall=leaves(FallLimits, config.simulator.fall),
        controller_model=model,
        measuring=measuring(config, robot, wind, ticks, drawn),
        actuation=None if way is None else actuation(way, step, config.simulator.substeps, drawn),
        n_ticks=jnp.asarray(np.int32(ticks)),
        precision="",
    )
    scenario, flight_state = jax.device_put((scenario, _begin_once(scenario, state)))
    return convert_precision(scenario, flight_state, dtype)


def read_config(config: ScenarioConfig | Mapping[str, Any]) -> ScenarioConfig:
    """Return the typed view of a configuration, which the crate checks; one that is typed has been checked."""
    if isinstance(config, ScenarioConfig):
        return config
    flown = {**config, "backend": "jax"}
    rust.check_config(flown)
    return scenario_config(flown)

"""From a configuration to a scenario and its state at the first tick; what the crate alone flies is refused."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jax_aero import rust
from jax_aero.aero import AeroModel, ReadNetwork
from jax_aero.aero.network_card import load_network
from jax_aero.base.typed import scenario_config
from jax_aero.body.jets import JetDynamics
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.config import ScenarioConfig
from jax_aero.control import Controller
from jax_aero.control.tick import momentum_controller
from jax_aero.sim import plant as world
from jax_aero.sim.actuation import actuation
from jax_aero.sim.model_error import controller_model
from jax_aero.sim.outcome import FallLimits
from jax_aero.sim.programs import keep_programs
from jax_aero.sim.scenario import Scenario, convert_precision
from jax_aero.sim.sensors import sensors
from jax_aero.sim.step import FlightState, begin
from jax_aero.sim.wind import wind_model
from jax_aero.types import leaf, leaves

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
    Refused by key, since the crate alone flies them (`backend = "rust"`), are outages, faulty joints, jets that fail or
    do not reach their thrust if the controller has `fault_detection.engines`, jets that lag or keep their thrust, fuel,
    ground, motors, pushes, errors of the measured wind, the observer of the wind and torques of a second rate.

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
    model, ticks, step = controller_model(config, robot), world.n_ticks(config), config.controller.time_step
    sensing, way = config.simulator.sensors, config.simulator.actuation
    scenario = Scenario(
        plant=plant,
        controller=momentum_controller(config, model or robot, read_network) if controller is None else controller,
        wind=wind_model(config.wind),
        fall=leaves(FallLimits, config.simulator.fall),
        controller_model=model,
        sensors=None if sensing is None else sensors(sensing, leaf(step), ticks, robot.n_joints, robot.jets.count),
        actuation=None if way is None else actuation(way, step, config.simulator.substeps, ticks),
        n_ticks=jnp.asarray(np.int32(ticks)),
        precision="",
    )
    scenario, flight_state = jax.device_put((scenario, _begin_once(scenario, state)))
    return convert_precision(scenario, flight_state, dtype)


def refuse(config: ScenarioConfig) -> None:
    """Refuse what the crate, or MuJoCo's back end, flies and JAX does not, by all its keys.

    Raises
    ------
    ValueError
        If the configuration contains any.
    """
    if found := list(_unflown(config)):
        raise ValueError("\n".join(f"`{key}` is {value}; expected {expected}" for key, value, expected in found))


FLOWN = ("aero", "aero_estimate", "jets", "model_error")
"""Keys of `disturbances` that JAX flies; it refuses every other one that is given."""


def _unflown(config: ScenarioConfig) -> Iterator[tuple[str, Any, str]]:
    """Yield key, value and expectation of all that JAX does not fly."""
    simulator, disturbances, steps = config.simulator, config.disturbances, config.controller.torque.steps
    by_crate = 'the crate flies it (`backend = "rust"`)'
    for key in ("fuel", "ground", "motors"):
        if getattr(simulator, key) is not None:
            yield f"simulator.{key}", "given", "none: JAX has neither ground, motors nor fuel"
    for name in ("base_position", "base_rotation", "base_linear_velocity", "base_angular_velocity"):
        sensor = getattr(simulator.sensors, name, None)
        for key in ("period", "gaps"):
            if sensor is not None and getattr(sensor, key):
                yield (
                    f"simulator.sensors.{name}.{key}",
                    getattr(sensor, key),
                    f"0: JAX measures in every tick; {by_crate}",
                )
    if config.own_controller is not None:
        yield (
            "own_controller",
            repr(config.own_controller["name"]),
            f"none: JAX compiles its own (`sim.Controller`); {by_crate}",
        )
    if config.controller.torque.friction:
        yield "controller.torque.friction", "given", f"none: JAX has no drives; {by_crate}"
    if config.controller.wind_observer:
        yield "controller.wind_observer", "true", f"false: JAX has no observer of the wind; {by_crate}"
    if steps > 1:
        yield "controller.torque.steps", steps, f"1: JAX has no second rate of torques; {by_crate}"
    if config.controller.jet_dynamics != "ideal":
        found = repr(config.controller.jet_dynamics)
        yield "controller.jet_dynamics", found, f'"ideal": JAX has no engines in the law; {by_crate}'
    error = disturbances.model_error
    if error.inertia_scale != 1.0 or error.thrust_axes or error.of_plant:
        yield "disturbances.model_error", error, f"no inertia_scale, thrust_axes and of_plant; {by_crate}"
    jets, has_monitor = disturbances.jets, config.controller.fault_detection.engines is not None
    limited = jets.thrust_limit_scale is not None and not jets.limit_is_known
    for key in disturbances.__struct_fields__:
        if key not in FLOWN and getattr(disturbances, key):
            yield f"disturbances.{key}", "given", f"none: JAX disturbs by {', '.join(FLOWN)}; {by_crate}"
    if jets.lag:
        yield "disturbances.jets.lag", jets.lag, f"0: JAX has no lag of thrust rates; {by_crate}"
    if jets.failure is not None and jets.failure.kind == "stuck":
        yield "disturbances.jets.failure.kind", '"stuck"', f'"off": JAX has no jet that keeps its thrust; {by_crate}'
    unanswered = {
        "jets.failure": has_monitor and jets.failure is not None,
        "jets.thrust_limit_scale": has_monitor and limited,
    }
    for key, given in unanswered.items():
        if given:
            yield f"disturbances.{key}", "given", f"none: JAX has no fault detection; {by_crate}"


def read_config(config: ScenarioConfig | Mapping[str, Any]) -> ScenarioConfig:
    """Return the typed view of a configuration, which the crate checks; one that is typed has been checked."""
    if isinstance(config, ScenarioConfig):
        return config
    flown = {**config, "backend": "jax"}
    rust.check_config(flown)
    return scenario_config(flown)

"""One tick of the closed-loop flight: the order of computation of plant and controller.

At tick k, t = k h:

    observe   kinematics and aerodynamic forces at x_k in the wind of t
    control   thrust rates and torques from (x_k, T_k, wind), held until the next tick
    record    and stop if the flight is lost
    advance   x_{k+1} from x_k, T_k and the torques;  T_{k+1} = T_k + h Ṫ*

as in the Rust crate. A lost flight keeps the state in which it was lost: its status is permanent and later rows repeat.

Equations M77 and M80 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jax_aero import rust
from jax_aero.aero import AeroModel, ReadNetwork
from jax_aero.aero.network_card import load_network
from jax_aero.base.typed import scenario_config
from jax_aero.body.jets import JetDynamics
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.body.spatial import multiply, rotation_angle, rpy_from_rotation, safe_norm, wxyz_from_rotation
from jax_aero.config import Disturbances, ModelError, ScenarioConfig
from jax_aero.control import Command, Controller, Measurement
from jax_aero.control.measurement import Reading
from jax_aero.control.preview import Preview
from jax_aero.control.tick import momentum_controller
from jax_aero.sim import plant as world
from jax_aero.sim import sensors as sensing
from jax_aero.sim.plant import Observation, Plant, PlantState
from jax_aero.sim.sensors import Sensors, SensorState
from jax_aero.sim.wind import Wind, wind_model, wind_velocity
from jax_aero.sim.wind_estimate import WindEstimate, measured_wind, wind_estimate
from jax_aero.types import Array, Static, leaf, leaves, pytree, where, with_dtype

(
    FLYING,
    BY_ROTATION,
    BY_COM,
    NOT_FINITE,
    BY_SPEED,
    BY_ANGULAR_VELOCITY,
    BY_JOINT_VELOCITY,
    BY_JOINT_POSITION,
    BY_THRUST,
) = range(9)
"""Codes of `FlightState.loss`: falls by rotation and position errors first, divergence from `NOT_FINITE` on."""

LARGEST_NUMBER = 1e9
"""Limit in SI units beyond which a state counts as not finite, since the next step may overflow."""

LIMITS = {
    BY_SPEED: 300.0,
    BY_ANGULAR_VELOCITY: 100.0,
    BY_JOINT_VELOCITY: 100.0,
    BY_JOINT_POSITION: 6.0,
    BY_THRUST: 10.0,
}
"""Limits of physically possible values, as in the crate.

Speed of base and air [m/s], angular velocity of the base [rad/s], velocity of a joint and its distance beyond its stops
[rad, m], ratio of a thrust to the jet's greatest.
"""

Tree = TypeVar("Tree")


@pytree
class FallLimits:
    """Criteria of a fall."""

    rotation_error_deg: Float[Array, ""]
    """Greatest rotation between base and set-point [deg]."""
    com_error: Float[Array, ""]
    """Greatest distance between centre of mass and set-point [m]."""


@pytree
class Scenario:
    """Everything that is constant in a flight. Every number is a leaf, for batches and derivatives.

    Another controller, aerodynamic model or jet dynamics is set by `prepare`, or by `dataclasses.replace`. Some leaves
    were computed from the time step; if noise is drawn, from the number of ticks; or, if its mean is measured, from the
    wind: `replace_values` refuses changes of these. Limits are the controller's: torques are limited by
    `controller.torque_max`, a copy of `plant.robot.joint_torque_max`. The state holds centre of mass and inertia of the
    initial robot: after changing them, call `begin` again.
    """

    plant: Plant
    controller: Controller[Any]
    """Controller, including its mission."""
    wind: Wind
    fall: FallLimits
    controller_model: RobotModel | None
    """The controller's model of the robot; `None` if it is the robot that flies."""
    controller_wind: Wind | None
    """Wind that the controller measures instead of the true one."""
    wind_estimate: WindEstimate | None
    """Errors of the measured wind; `None` if exact."""
    sensors: Sensors | None
    """Errors of the robot's sensors; `None` if exact."""
    n_ticks: Int[Array, ""]
    """Number of ticks after the one at time zero."""
    precision: Static[str]
    """Name of the floating-point type of all numbers, so that its change cannot go unnoticed."""

    @property
    def computed_from(self) -> tuple[str, ...]:
        """Return the length for which noise is drawn, and the wind whose mean is used.

        The wind is left out if its mean is known not to be used; a traced switch is not known.
        """
        faults, estimate = self.plant.jet_faults, self.wind_estimate
        drawn = (self.sensors, self.plant.actuation, estimate, None if faults is None else faults.sensor_noise)
        names: tuple[str, ...] = () if all(part is None for part in drawn) else ("n_ticks",)
        is_mean = False if estimate is None else estimate.is_mean
        if not isinstance(is_mean, jax.core.Tracer) and not np.asarray(is_mean).any():
            return names
        return (*names, "wind" if self.controller_wind is None else "controller_wind")


class FlightState(NamedTuple):
    """State of a flight between two ticks."""

    plant: PlantState
    controller: Any
    """State of the controller."""
    measured_wind: Float[Array, "3"]
    """Measured wind of the last tick [m/s]."""
    sensors: SensorState | None
    """State of the sensors; `None` if exact."""
    posture: Float[Array, " n"]
    """Joint positions measured at the first tick [rad]."""
    loss: Int[Array, ""]
    """`FLYING`, or the criterion by which the flight was lost."""
    loss_size: Float[Array, ""]
    """Error of a fall, in the criterion's unit."""
    loss_tick: Int[Array, ""]
    """Tick at which the flight was lost, −1 while it flies."""


class FlightRow(NamedTuple):
    """One tick of the log, with the signals and names of the Rust crate.

    Signals that a controller does not compute are NaN, as is everything that follows from a state that is not finite.
    Of what the crate's guard finds, the condition of joints is that of healthy ones, and latencies are not known.
    """

    time: Float[Array, ""]
    base_position: Float[Array, "3"]
    base_quaternion: Float[Array, "4"]
    base_velocity: Float[Array, "6"]
    base_rpy_setpoint: Float[Array, "3"]
    joint_position: Float[Array, " n"]
    joint_velocity: Float[Array, " n"]
    com_position: Float[Array, "3"]
    com_velocity: Float[Array, "3"]
    com_setpoint: Float[Array, "3"]
    rotation_error: Float[Array, ""]
    thrust: Float[Array, " j"]
    thrust_rate: Float[Array, " j"]
    joint_velocity_command: Float[Array, " n"]
    joint_torque: Float[Array, " n"]
    wind: Float[Array, "3"]
    aero_force_sim: Float[Array, "L 3"]
    aero_force_control: Float[Array, "L 3"]
    momentum: Float[Array, "6"]
    momentum_setpoint: Float[Array, "6"]
    momentum_rate_estimate: Float[Array, "6"]
    unmodelled_wrench: Float[Array, "6"]
    measured_base_position: Float[Array, "3"]
    measured_base_quaternion: Float[Array, "4"]
    measured_base_velocity: Float[Array, "6"]
    measured_joint_velocity: Float[Array, " n"]
    measured_thrust: Float[Array, " j"]
    measured_wind: Float[Array, "3"]
    measured_wind_std: Float[Array, "3"]
    raw_base_position: Float[Array, "3"]
    raw_base_rotation: Float[Array, "3 3"]
    raw_base_velocity: Float[Array, "6"]
    raw_joint_position: Float[Array, " n"]
    raw_joint_velocity: Float[Array, " n"]
    raw_thrust: Float[Array, " j"]
    raw_wind: Float[Array, "3"]
    qp_status: Float[Array, "2"]
    qp_kkt: Float[Array, "2"]
    qp_iterations: Float[Array, "2"]
    degraded_modes: Float[Array, ""]
    joint_condition: Float[Array, " n"]
    measured_torque_latency: Float[Array, ""]
    measured_thrust_latency: Float[Array, ""]


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

    The guard, which finds failures and answers them, is the crate's alone. Its detectors (`controller.channels`,
    `engines`, `joints`, `latency_monitor`, `supervisor`, `mpc.descent`) do nothing here: a flight is the crate's as
    long as the crate's signal `degraded_modes` is zero. Refused by key, since the crate alone flies them
    (`engine = "rust"`), are failures that a guard answers: outages, faulty joints, and jets that fail or do not reach
    their thrust if the controller has `engines`; so are fuel, ground, motors and torques of a second rate.

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
    config = read_config(config)
    if robot is None:
        robot = load_robot(config.robot)
    refuse(config)
    wind, replaced = wind_model(config.wind), config.disturbances.controller_wind
    controller_wind = None if replaced is None else wind_model(replaced)
    plant, state = world.start_plant(config.simulator, config.disturbances, robot, aero, jets, read_network)
    model, settings = controller_model(config, robot), config.simulator.sensors
    if controller is None:
        controller = momentum_controller(config, model or robot, read_network)
    estimate, ticks, errors = config.disturbances.wind_estimate, world.n_ticks(config.simulator), None
    if estimate is not None:
        errors = wind_estimate(estimate, plant.time_step, _winds(controller_wind or wind, ticks, plant.time_step))
    scenario = Scenario(
        plant=plant,
        controller=controller,
        wind=wind,
        fall=leaves(FallLimits, config.simulator.fall),
        controller_model=model,
        controller_wind=controller_wind,
        wind_estimate=errors,
        sensors=None
        if settings is None
        else sensing.sensors(settings, plant.time_step, ticks, robot.n_joints, robot.jets.count),
        n_ticks=jnp.asarray(np.int32(ticks)),
        precision="",
    )
    scenario, flight_state = jax.device_put((scenario, _begin_once(scenario, state)))
    return convert_precision(scenario, flight_state, dtype)


def refuse(config: ScenarioConfig) -> None:
    """Refuse what the crate, or MuJoCo's engine, flies and JAX does not, by all its keys.

    Raises
    ------
    ValueError
        If the configuration contains any.
    """
    if found := list(_unflown(config)):
        raise ValueError("\n".join(f"`{key}` is {value}; expected {expected}" for key, value, expected in found))


def _unflown(config: ScenarioConfig) -> Iterator[tuple[str, Any, str]]:
    """Yield key, value and expectation of all that JAX does not fly."""
    simulator, disturbances, steps = config.simulator, config.disturbances, config.controller.torque.steps
    by_crate = 'the crate flies it (`engine = "rust"`)'
    for key in ("fuel", "ground", "motors"):
        if getattr(simulator, key) is not None:
            yield f"simulator.{key}", "given", "none: JAX has neither ground, motors nor fuel"
    if steps > 1:
        yield "controller.torque.steps", steps, f"1: JAX has no second rate of torques; {by_crate}"
    if config.controller.jet_dynamics != "ideal":
        found = repr(config.controller.jet_dynamics)
        yield "controller.jet_dynamics", found, f'"ideal": JAX has no engines in the law; {by_crate}'
    error = disturbances.model_error
    if error.inertia_scale != 1.0 or error.thrust_axes:
        yield "disturbances.model_error", error, f"no inertia_scale and no thrust_axes; {by_crate}"
    for key, given in _failures(disturbances, has_monitor=config.controller.engines is not None).items():
        if given:
            yield f"disturbances.{key}", "given", f"none: JAX has no guard that answers it; {by_crate}"


def _failures(disturbances: Disturbances, *, has_monitor: bool) -> dict[str, bool]:
    """Return which failures that the crate's guard answers are given; those of engines need a monitor."""
    jets = disturbances.jets
    return {
        "outages": bool(disturbances.outages),
        "joints": bool(disturbances.joints),
        "jets.failure": has_monitor and jets.failure is not None,
        "jets.thrust_limit_scale": has_monitor and jets.thrust_limit_scale is not None and not jets.limit_is_known,
    }


def read_config(config: ScenarioConfig | Mapping[str, Any]) -> ScenarioConfig:
    """Return the typed view of a configuration, which the crate checks; one that is typed has been checked."""
    if isinstance(config, ScenarioConfig):
        return config
    flown = {**config, "engine": "jax"}
    rust.check_config(flown)
    return scenario_config(flown)


def convert_precision(scenario: Scenario, state: FlightState, dtype: Any) -> tuple[Scenario, FlightState]:
    """Return both with all numbers in this floating-point type."""
    return with_dtype((replace(scenario, precision=np.dtype(dtype).name), state), dtype)


def _winds(wind: Wind, ticks: int, time_step: Array) -> Array:
    """Return the wind at every tick of a flight (ticks + 1, 3) [m/s]."""
    times = np.arange(ticks + 1) * np.asarray(time_step)
    winds: Array = jax.jit(jax.vmap(wind_velocity, in_axes=(None, 0)))(wind, times)
    return winds


def controller_model(config: ScenarioConfig, robot: RobotModel) -> RobotModel | None:
    """Return the controller's model of the robot; `None` if it is the robot that flies."""
    error, faults = config.disturbances.model_error, config.disturbances.jets
    model = robot
    if faults.limit_is_known and faults.thrust_limit_scale is not None:
        limits = jnp.asarray(faults.thrust_limit_scale * robot.jets.thrust_max)
        model = replace(robot, jets=replace(robot.jets, thrust_max=limits))
    if error != ModelError():
        masses, inertias = error.mass_scale * robot.masses, error.mass_scale * robot.inertias
        coms = jnp.asarray(robot.coms).at[0].add(leaf(error.com_offset))
        model = replace(model, masses=masses, coms=coms, inertias=inertias)
    if config.controller.torque.rotor_inertia > 0.0:
        model = replace(model, rotor_inertia=leaf(config.controller.torque.rotor_inertia * robot.joint_turns))
    return None if model is robot else model


@jax.jit
def begin(scenario: Scenario, plant: PlantState) -> FlightState:
    """Start the controller for a plant in this state."""
    robot = scenario.plant.robot if scenario.controller_model is None else scenario.controller_model
    # A state beyond the divergence limits is lost at once, and must not make derivatives infinite before that.
    divergence = _divergence(scenario, plant, jnp.zeros_like(plant.robot.velocity[:3]))
    first = where(divergence == FLYING, plant, world.zero_state(plant))
    seen, before = Reading(first.robot, scenario.plant.jets.feedback(first.jets)), None
    if scenario.sensors is not None:
        before = sensing.start(scenario.sensors, seen)
        _, seen = sensing.read(scenario.sensors, before, seen, jnp.array(0))
    return FlightState(
        plant=plant,
        controller=scenario.controller.init(robot, seen.state),
        measured_wind=jnp.zeros_like(plant.robot.velocity[:3]),
        sensors=before,
        posture=seen.state.joint_position,
        loss=jnp.array(FLYING, jnp.int32),
        loss_size=jnp.zeros_like(plant.robot.velocity[0]),
        loss_tick=jnp.array(-1, jnp.int32),
    )


_begin_once = world.run_once(begin)


def step(scenario: Scenario, state: FlightState, tick: Int[Array, ""]) -> tuple[FlightState, FlightRow]:
    """Fly one tick, number `tick`, and record it.

    Raises
    ------
    ValueError
        When traced in another precision than the scenario was prepared for; for a command, or forces of an aerodynamic
        model, of another shape than the robot's.
    """
    _check_precision(scenario)
    plant, tick = scenario.plant, jnp.asarray(tick, jnp.int32)
    time = tick.astype(plant.time_step.dtype) * plant.time_step
    wind = wind_velocity(scenario.wind, time)
    # Both branches of `where` are differentiated, so values beyond the limits must not enter the computation.
    divergence = _divergence(scenario, state.plant, wind)
    is_sound = divergence == FLYING
    at_rest = world.zero_state(state.plant)
    now, air = where(is_sound, (state.plant, wind), (at_rest, jnp.zeros_like(wind)))

    wind_measured = air if scenario.controller_wind is None else wind_velocity(scenario.controller_wind, time)
    if scenario.wind_estimate is not None:
        source = scenario.wind if scenario.controller_wind is None else scenario.controller_wind
        wind_at = partial(wind_velocity, source)
        wind_measured = measured_wind(scenario.wind_estimate, wind_at, state.measured_wind, tick, plant.time_step)
    model = plant.robot if scenario.controller_model is None else scenario.controller_model
    said, sensors = Reading(now.robot, plant.jets.feedback(now.jets)), state.sensors
    if scenario.sensors is not None and sensors is not None:
        sensors, said = sensing.read(scenario.sensors, sensors, said, tick)
    measurement = Measurement(time, *said, wind_measured)
    if scenario.sensors is not None and scenario.sensors.wind_ahead is not None:
        ahead = scenario.sensors.wind_ahead
        winds = jax.vmap(wind_velocity, in_axes=(None, 0))(scenario.wind, time + ahead)
        preview = Preview(wind=jnp.concatenate([ahead[:, None], winds], axis=1))
        measurement = measurement._replace(preview=preview)
    memory, command = scenario.controller.step(model, state.controller, measurement)
    command.check(plant.robot)
    estimates, wind_std = measurement, jnp.zeros_like(wind)
    if command.terms is not None:
        estimates, wind_std = command.terms.estimates, command.terms.wind_std
    seen = _observe(scenario, now, command, air)

    # Without a set-point there is no error of a fall.
    fall, error = jnp.full_like(divergence, FLYING), jnp.zeros_like(time)
    rotation_error = jnp.full_like(time, jnp.nan)
    if command.setpoint is not None:
        rotation_error = rotation_angle(multiply(command.setpoint.rotation.T, now.robot.base_rotation))
        com_error = safe_norm(seen.kinematics.com - command.setpoint.com_position)
        fall, error = _judge(scenario.fall, rotation_error, com_error)
    row = _row(time, wind, now, measurement, estimates, wind_std, command, seen, rotation_error)
    row = _mask_unless(is_sound, row)
    robot = state.plant.robot
    row = row._replace(
        time=time,
        wind=wind,
        base_position=robot.base_position,
        base_velocity=robot.velocity[:6],
        joint_position=robot.joint_position,
        joint_velocity=robot.velocity[6:],
        thrust=state.plant.jets.thrust,
    )

    loss = jnp.where(is_sound, fall, divergence)
    lost_now = (state.loss == FLYING) & (loss != FLYING)
    goes_on = (state.loss == FLYING) & (loss == FLYING)
    # The next step of a lost flight may overflow.
    moved = world.advance(plant, where(goes_on, now, at_rest), seen, command.joint_torque, command.thrust_rate, air)
    after = FlightState(
        plant=where(goes_on, moved, state.plant),
        controller=where(goes_on, memory, state.controller),
        measured_wind=wind_measured,
        sensors=sensors,
        posture=state.posture,
        loss=jnp.where(lost_now, loss, state.loss),
        loss_size=jnp.where(lost_now, error, state.loss_size),
        loss_tick=jnp.where(lost_now, tick, state.loss_tick),
    )
    return after, row


def _check_precision(scenario: Scenario) -> None:
    found = jnp.result_type(scenario.plant.time_step)
    if found == np.float64 and jnp.result_type(float) != np.float64:
        found = np.dtype(np.float32)
    if found != scenario.precision:
        raise ValueError(
            f"the scenario was prepared in {scenario.precision}, but its numbers are {found} here; "
            "expected a call inside `with jax.enable_x64(True):`, or `prepare(..., dtype=np.float32)`"
        )


def _is_in_range(tree: Any) -> Array:
    """Return whether all numbers, and the products of several of them that a tick forms, are finite."""
    numbers = [leaf for leaf in jax.tree.leaves(tree) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    return jnp.all(jnp.stack([jnp.all(jnp.abs(leaf) < LARGEST_NUMBER) for leaf in numbers]))


def _mask_unless(condition: Array, tree: Tree) -> Tree:
    def choose(leaf: Array) -> Array:
        return jnp.where(condition, leaf, jnp.nan) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf

    chosen: Tree = jax.tree.map(choose, tree)
    return chosen


def _observe(scenario: Scenario, state: PlantState, command: Command, wind: Array) -> Observation:
    """Observe the plant; reuse what the controller computed for the same robot in the same state."""
    plant, terms = scenario.plant, command.terms
    # With sensors or an estimator, also within a wrapped controller, the state is another object.
    is_known = terms is not None and terms.estimates.state is state.robot and scenario.controller_model is None
    if terms is None or not is_known or plant.backend != "tree":
        return world.observe(plant, state, wind)
    return world.observe(plant, state, wind, (terms.kinematics, terms.dynamics, terms.inverse_mass))


def _divergence(scenario: Scenario, state: PlantState, wind: Array) -> Array:
    """Return the criterion by which the plant has diverged, `FLYING` if by none."""
    robot, now = scenario.plant.robot, state.robot
    lower, upper = jnp.asarray(robot.joint_stops).T
    joints, ratios = now.joint_position, state.jets.thrust / robot.jets.thrust_max
    found = {
        BY_SPEED: jnp.maximum(jnp.linalg.norm(now.velocity[:3]), jnp.linalg.norm(wind)),
        BY_ANGULAR_VELOCITY: jnp.linalg.norm(now.velocity[3:6]),
        BY_JOINT_VELOCITY: jnp.max(jnp.abs(now.velocity[6:]), initial=0.0),
        BY_JOINT_POSITION: jnp.max(jnp.maximum(lower - joints, joints - upper), initial=-jnp.inf),
        BY_THRUST: jnp.max(ratios, initial=0.0),
    }
    code = jnp.array(FLYING, jnp.int32)
    for criterion, value in reversed(found.items()):
        code = jnp.where(value > LIMITS[criterion], criterion, code)
    return jnp.where(_is_in_range((state, wind)), code, NOT_FINITE)


def _judge(limits: FallLimits, rotation_error: Array, com_error: Array) -> tuple[Array, Array]:
    """Return whether and why the robot has fallen, and the error."""
    over_rotated = rotation_error > jnp.deg2rad(limits.rotation_error_deg)
    is_far = com_error > limits.com_error
    is_finite = jnp.isfinite(rotation_error) & jnp.isfinite(com_error)
    fall = jnp.where(over_rotated, BY_ROTATION, jnp.where(is_far, BY_COM, FLYING))
    fall = jnp.where(is_finite, fall, NOT_FINITE)
    return fall.astype(jnp.int32), jnp.where(over_rotated, rotation_error, com_error)


def _row(
    time: Array,
    wind: Array,
    state: PlantState,
    raw: Measurement,
    estimates: Measurement,
    wind_std: Array,
    command: Command,
    seen: Observation,
    rotation_error: Array,
) -> FlightRow:
    robot, momentum, mass = state.robot, seen.dynamics.momentum, seen.dynamics.mass_matrix[0, 0]
    nothing = jnp.full_like(wind, jnp.nan)
    setpoint, terms = command.setpoint, command.terms
    answers = (command.momentum_qp, command.torque_qp)

    def stack_answers(name: str, dtype: Any) -> Array:
        values = [jnp.nan if answer is None else getattr(answer, name) for answer in answers]
        return jnp.stack([jnp.asarray(value, dtype) for value in values])

    return FlightRow(
        time=time,
        base_position=robot.base_position,
        base_quaternion=wxyz_from_rotation(robot.base_rotation),
        base_velocity=robot.velocity[:6],
        base_rpy_setpoint=nothing if setpoint is None else rpy_from_rotation(setpoint.rotation),
        joint_position=robot.joint_position,
        joint_velocity=robot.velocity[6:],
        com_position=seen.kinematics.com,
        com_velocity=momentum[:3] / mass,
        com_setpoint=nothing if setpoint is None else setpoint.com_position,
        rotation_error=rotation_error,
        thrust=state.jets.thrust,
        thrust_rate=command.thrust_rate,
        joint_velocity_command=(
            jnp.full_like(command.joint_torque, jnp.nan) if command.joint_velocity is None else command.joint_velocity
        ),
        joint_torque=command.joint_torque,
        wind=wind,
        aero_force_sim=seen.link_forces.forces,
        aero_force_control=(
            jnp.full_like(seen.link_forces.forces, jnp.nan) if terms is None else terms.link_forces.forces
        ),
        momentum=momentum,
        momentum_setpoint=(
            jnp.full_like(momentum, jnp.nan)
            if setpoint is None or terms is None
            else jnp.pad(terms.dynamics.mass_matrix[0, 0] * setpoint.com_velocity, (0, 3))
        ),
        momentum_rate_estimate=(jnp.full_like(momentum, jnp.nan) if terms is None else terms.momentum.rate_estimate),
        unmodelled_wrench=(jnp.full_like(momentum, jnp.nan) if terms is None else terms.momentum.unmodelled_wrench),
        measured_base_position=estimates.state.base_position,
        measured_base_quaternion=wxyz_from_rotation(estimates.state.base_rotation),
        measured_base_velocity=estimates.state.velocity[:6],
        measured_joint_velocity=estimates.state.velocity[6:],
        measured_thrust=estimates.thrust,
        measured_wind=estimates.wind,
        measured_wind_std=wind_std,
        raw_base_position=raw.state.base_position,
        raw_base_rotation=raw.state.base_rotation,
        raw_base_velocity=raw.state.velocity[:6],
        raw_joint_position=raw.state.joint_position,
        raw_joint_velocity=raw.state.velocity[6:],
        raw_thrust=raw.thrust,
        raw_wind=raw.wind,
        qp_status=stack_answers("status", time.dtype),
        qp_kkt=stack_answers("kkt", time.dtype),
        qp_iterations=stack_answers("iterations", time.dtype),
        degraded_modes=jnp.asarray(jnp.nan if command.degraded_modes is None else command.degraded_modes, time.dtype),
        joint_condition=jnp.full_like(command.joint_torque, jnp.nan if terms is None else 0.0),
        measured_torque_latency=jnp.full_like(time, jnp.nan),
        measured_thrust_latency=jnp.full_like(time, jnp.nan),
    )

"""The Rust crate as a Python library: NumPy arrays in and out, SI units and radians.

This module and `jax_aero.base.crate`, whose names it has too, import the compiled `jax_aero._core`.

Examples
--------
>>> from jax_aero import rust
>>> config = rust.load_config("test2", {"simulator.duration": 1.0})
>>> flight = rust.fly(config)
>>> flight["thrust"].shape[1]
4

One state, one tick, every intermediate value:

>>> robot = rust.Robot(config["robot"])
>>> state = rust.State.at_rest(robot)
>>> rust.dynamics(robot, state).mass_matrix.shape
(29, 29)
>>> tick = rust.Controller(config).tick(state, thrust=[100.0] * 4, wind=[0.0, -10.0, 0.0])
>>> tick.momentum_answer.status
'Solved'
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jax_aero import _core, own
from jax_aero._core import (
    BoxQpSolver,
    ControllerState,
    __version__,
    kkt_residual,
    normals,
    read_network,
    read_policy,
    uniforms,
)
from jax_aero.base.crate import (
    Config,
    Quantity,
    Robot,
    check_config,
    check_table,
    config_digest,
    figures,
    load_aero,
    load_config,
    load_controller,
    load_onboard,
    path_keys,
    read_table,
    read_toml,
    read_urdf,
    resolve_aero,
    resolve_config,
    schemas,
    set_keys,
    signals,
    to_json,
)
from jax_aero.base.result import FlightResult, brief
from jax_aero.base.terminal import Progress
from jax_aero.body import spatial

__all__ = [
    "MODES",
    "NUMERICS",
    "SETTLING_TIME",
    "BoxQpSolver",
    "Command",
    "Config",
    "ContactTick",
    "Controller",
    "ControllerState",
    "Csv",
    "Dynamics",
    "Estimates",
    "Flight",
    "FlightResult",
    "Jacobian",
    "Measurement",
    "Observed",
    "Preview",
    "Progress",
    "QpAnswer",
    "QpProblem",
    "Quantity",
    "Residual",
    "Robot",
    "RowProblem",
    "Seen",
    "Setpoint",
    "State",
    "Tick",
    "World",
    "__version__",
    "aero_forces",
    "check_config",
    "check_table",
    "config_digest",
    "dynamics",
    "figures",
    "fly",
    "fly_batch",
    "forward_dynamics",
    "frame_jacobian",
    "is_input",
    "kkt_residual",
    "link_forces",
    "load_aero",
    "load_config",
    "load_controller",
    "load_onboard",
    "normals",
    "observe_flights",
    "path_keys",
    "read_csv",
    "read_network",
    "read_policy",
    "read_table",
    "read_toml",
    "read_urdf",
    "recorded_reference",
    "recorded_wind",
    "replay",
    "resolve_aero",
    "resolve_config",
    "rotation_from_wxyz",
    "schemas",
    "set_keys",
    "setpoint_trajectory",
    "signals",
    "step_flights",
    "summarise",
    "summarised",
    "uniforms",
    "wind_velocity",
]

Array = NDArray[np.float64]

MODES: Mapping[str, int] = _core.MODES
"""Bits of the modes of a tick, by name."""
NUMERICS: int = _core.NUMERICS
"""Version of the crate's numbers: flights of another one may have other bits."""
SETTLING_TIME: float = _core.SETTLING_TIME
"""Time from which on figures of merit count the position error [s]."""


class State(NamedTuple):
    """Pose and velocity of a robot, in inertial axes; joints in the order of the robot.

    Attributes
    ----------
    base_position, base_rotation
        Origin of the base [m], (3,), and its rotation `i_from_b`, (3, 3).
    joint_position
        Joint positions [rad], (n,).
    velocity
        Mixed velocity ν = (v_B, ω_B, ṡ), (6 + n,): linear velocity of the base origin [m/s] and angular velocity of the
        base [rad/s], both in inertial axes, and joint velocities [rad/s].
    """

    base_position: ArrayLike
    base_rotation: ArrayLike
    joint_position: ArrayLike
    velocity: ArrayLike

    @classmethod
    def at_rest(cls, robot: Robot, joint_position: ArrayLike | None = None) -> State:
        """Return the state at the origin, upright and at rest; joint positions are zero unless given."""
        n = len(robot.joint_names)
        joints = np.zeros(n) if joint_position is None else joint_position
        return cls(np.zeros(3), np.eye(3), joints, np.zeros(6 + n))


@dataclass(frozen=True)
class Dynamics:
    """Kinematics and dynamics of one state, in inertial axes; n = 6 + joints, bodies base first.

    Attributes
    ----------
    body_positions, body_rotations
        Origin [m], (bodies, 3), and rotation `i_from_b`, (bodies, 3, 3), in the order of `Robot.body_names`.
    com_position
        Centre of mass [m], (3,).
    mass_matrix, bias
        M (n, n) and h (n,) of M ν̇ + h = S τ + Σ Jᵀ f; h includes gravity.
    momentum_matrix, momentum
        A_G (6, n) and L = A_G ν (6,), linear rows first, about the centre of mass [kg m/s, kg m²/s].
    centroidal_inertia
        Rotational inertia about the centre of mass [kg m²], (3, 3).
    """

    body_positions: Array
    body_rotations: Array
    com_position: Array
    mass_matrix: Array
    bias: Array
    momentum_matrix: Array
    momentum: Array
    centroidal_inertia: Array

    __repr__ = brief


class Measurement(NamedTuple):
    """Input of a controller at a tick.

    Attributes
    ----------
    time
        Time since the flight began [s].
    state
        Pose and velocity of the robot.
    thrust
        Thrust of every jet [N].
    wind
        Velocity of the air [m/s, inertial axes].
    foot_wrenches
        Wrench on each of the controller's feet about the origin of its sole, force first [N, N m, inertial axes],
        (feet, 6).
    shaft_speed
        Speed of the shaft of every jet, a share of the full speed; NaN where it is not measured.
    height
        Height of the base origin above that on the ground on which the robot is to land, in the posture in which the
        flight begins [m]; NaN where it is not measured, and of the true robot.
    setpoint
        What a controller of one's own is to follow; `None` elsewhere.
    """

    time: float
    state: State
    thrust: Array
    wind: Array
    foot_wrenches: Array
    shaft_speed: Array
    height: float = math.nan
    setpoint: Setpoint | None = None


class Jacobian(NamedTuple):
    """Velocity of a frame's origin and of the frame itself per unit of ν, each (3, n)."""

    linear: Array
    angular: Array


class QpProblem(NamedTuple):
    """Minimise ½ xᵀ H x + gᵀ x subject to lower ≤ x ≤ upper."""

    h: Array
    g: Array
    lower: Array
    upper: Array


class RowProblem(NamedTuple):
    """Minimise ½ xᵀ H x + gᵀ x subject to lower ≤ x ≤ upper and rows @ x ≤ limit."""

    h: Array
    g: Array
    lower: Array
    upper: Array
    rows: Array
    limit: Array


class QpAnswer(NamedTuple):
    """Result of a solver for x; `kkt` is `kkt_residual`, `active` the number of variables on a bound."""

    status: str
    status_code: int
    iterations: int
    kkt: float
    active: int


@dataclass(frozen=True)
class Setpoint:
    """Set-point of the controller: centre of mass in inertial axes; rotation, with derivatives in its body axes."""

    com_position: ArrayLike
    com_velocity: ArrayLike
    com_acceleration: ArrayLike
    com_jerk: ArrayLike
    rotation: ArrayLike
    angular_velocity: ArrayLike
    angular_acceleration: ArrayLike
    angular_jerk: ArrayLike


@dataclass(frozen=True)
class Preview:
    """What is known of the future at a tick, which only the predictive law reads; by default nothing.

    Times are those after the tick [s], increasing.

    Attributes
    ----------
    setpoints
        Set-points that follow a given one, with their times, above zero: interpolated between, extrapolated after the
        last one. A mission has its own.
    wind
        Time, from zero on, and velocity of the air [m/s, inertial axes], (samples, 4): linear between samples, constant
        outside. The prediction has its change from time zero.
    """

    setpoints: Sequence[tuple[float, Setpoint]] = ()
    wind: ArrayLike | None = None


@dataclass(frozen=True)
class ContactTick:
    """The feet at one tick, for a controller that can stand; wrenches are (feet, 6), force first, inertial axes.

    Attributes
    ----------
    is_active
        Whether all feet carry load.
    force, force_rate
        f_c* and its rate [N, N m; N/s, N m/s].
    force_of_torques
        f_c in the answer of the torque QP [N, N m].
    a_c, jacobian, velocity_product
        A_c (6, 6 feet), J_c (6 feet, 6 + n) and J̇_c ν (6 feet).
    """

    is_active: bool
    force: Array
    force_rate: Array
    force_of_torques: Array
    a_c: Array
    jacobian: Array
    velocity_product: Array

    __repr__ = brief


@dataclass(frozen=True)
class Estimates:
    """Estimate of the robot in a tick: measured, predicted where it is not measured, or estimated.

    Attributes
    ----------
    state
        Pose and velocity of the robot.
    thrust, thrust_rate
        Thrust of every jet [N] and its predicted rate [N/s], (jets,).
    wind, wind_std
        Velocity of the air and its standard deviation, zero without a wind observer [m/s, inertial axes], (3,).
    """

    state: State
    thrust: Array
    thrust_rate: Array
    wind: Array
    wind_std: Array

    __repr__ = brief


class Residual(NamedTuple):
    """What is added to the answer of the law for one tick, within its bounds."""

    thrust_rate: ArrayLike
    """[N/s], (jets,)."""
    joint_velocity: ArrayLike
    """[rad/s], (n,)."""
    replaces: bool = False
    """Whether it replaces the answer."""


@dataclass(frozen=True)
class Tick:
    """Every value of one controller tick, in inertial axes unless stated otherwise.

    Attributes
    ----------
    com_position, mass_matrix, bias, momentum_matrix, momentum, centroidal_inertia
        As in `Dynamics`.
    link_axes, link_v_air
        Symmetry axis of each aerodynamic link and velocity of the air relative to it [m/s], (links, 3).
    link_arm_points, link_jacobian_points
        Points about which moments are formed, and points whose Jacobians carry the forces [m], (links, 3).
    aero_force
        Estimated aerodynamic force on each link [N], (links, 3).
    jet_axes, jet_points
        Direction of each thrust and point at which it acts [m], (jets, 3).
    a_t, lambda_t, lambda_a
        A_T (6, jets), Λ_T and Λ_a (6, n).
    momentum_rate_estimate
        L̇ [N, N m], (6,).
    unmodelled_wrench
        ŵ, the observed unmodelled part of L̇; zero without an observer [N, N m], (6,).
    k_ddot_desired, sigma
        Outputs of the attitude law: k̈* in base axes, σ.
    task, task_offset
        The nine stacked task rows, `task @ u + task_offset`, of the unknowns u = (Ṫ, ṡ).
    momentum_qp, momentum_answer, thrust_rate, joint_velocity_command
        The QP in u and its answer: Ṫ* [N/s] and ṡ* [rad/s].
    residual
        What is to be added to u, or to replace it, by a policy or as given; zero without one, (jets + n,).
    residual_wrench
        Wrench that a policy observes: what of L̇ the model lacks [N, N m], (6,); zero without a residual.
    joint_acceleration_desired, joint_acceleration_free, torque_gain
        s̈*, s̈ without torque [rad/s²], and G = (M⁻¹)_ss.
    torque_qp, torque_answer, unlimited_torque, joint_torque
        The QP in τ, or in (f_c, τ) for a controller that can stand, and its answer [N m], before and after the limiter.
    is_held
        Whether thrust rates, torques or both are not those of the law.
    degraded_modes
        What in the tick is not as usual, names of `MODES`.
    joint_condition
        What is found of each joint, (n,): 0 healthy, 1 stuck, 2 weak, 3 free.
    measured_latency
        Latency of torques and thrust rates as measured [s]; NaN where it is not known.
    posture, inertia_0_b, velocity_error_integral
        Part of the controller's state after the tick, see `Controller.state`.
    setpoint
        The set-point that was followed.
    estimates
        Estimate of the robot in a tick: measured, predicted where it is not measured, or estimated.
    contact
        The feet; `None` for a controller that cannot stand. The rates of their forces are also unknowns of
        `momentum_qp`, between thrust rates and joint velocities.
    """

    com_position: Array
    mass_matrix: Array
    bias: Array
    momentum_matrix: Array
    momentum: Array
    centroidal_inertia: Array
    link_axes: Array
    link_v_air: Array
    link_arm_points: Array
    link_jacobian_points: Array
    aero_force: Array
    jet_axes: Array
    jet_points: Array
    a_t: Array
    lambda_t: Array
    lambda_a: Array
    momentum_rate_estimate: Array
    unmodelled_wrench: Array
    k_ddot_desired: Array
    sigma: Array
    task: Array
    task_offset: Array
    momentum_qp: QpProblem
    momentum_answer: QpAnswer
    thrust_rate: Array
    throttle: Array
    joint_velocity_command: Array
    residual: Array
    residual_wrench: Array
    joint_acceleration_desired: Array
    joint_acceleration_free: Array
    torque_gain: Array
    torque_qp: QpProblem | RowProblem
    torque_answer: QpAnswer
    unlimited_torque: Array
    joint_torque: Array
    is_held: bool
    degraded_modes: list[str]
    joint_condition: Array
    measured_latency: Array
    posture: Array
    inertia_0_b: Array
    velocity_error_integral: Array
    setpoint: Setpoint
    estimates: Estimates
    contact: ContactTick | None = None

    __repr__ = brief


class Controller:
    """The flight controller of an experiment, or of what `load_onboard` returns, one tick at a time.

    The first tick begins the flight: its position, attitude and posture become the ones to keep. `state` is everything
    that is carried between ticks; a controller whose state is stored and assigned later continues bit for bit.
    """

    def __init__(self, config: Mapping[str, Any]) -> None:
        self._config = to_json(config)
        self._core = _core.Controller(self._config)

    @property
    def state(self) -> ControllerState | None:
        """State after the last tick; `None` before the first."""
        return self._core.state

    @state.setter
    def state(self, state: ControllerState) -> None:
        self._core.state = state

    def start(
        self,
        state: State,
        thrust: ArrayLike,
        wind: ArrayLike,
        time: float = 0.0,
        foot_wrenches: ArrayLike | None = None,
        shaft_speed: ArrayLike | None = None,
        height: float = math.nan,
    ) -> ControllerState:
        """Begin a flight with a measurement, without computing a tick. Parameters are those of `tick`.

        Raises
        ------
        ValueError
            If the measurement is not finite or of the wrong size, or if its base rotation is not a rotation.
        """
        feet, speed = (None if given is None else _array(given) for given in (foot_wrenches, shaft_speed))
        self._core.start(time, _arrays(state), _array(thrust), _array(wind), feet, speed, height)
        started = self._core.state
        if started is None:
            raise AssertionError("a started flight has a state")
        return started

    def tick(
        self,
        state: State,
        thrust: ArrayLike,
        wind: ArrayLike,
        time: float = 0.0,
        setpoint: Setpoint | None = None,
        foot_wrenches: ArrayLike | None = None,
        preview: Preview | None = None,
        residual: Residual | None = None,
        shaft_speed: ArrayLike | None = None,
        height: float = math.nan,
    ) -> Tick:
        """Compute one tick.

        Parameters
        ----------
        state
            Pose and velocity of the robot.
        thrust
            Thrust of every jet [N].
        wind
            Velocity of the air [m/s, inertial axes].
        time
            Time since the flight began [s]; the mission's set-point advances by one tick with every call.
        setpoint
            Set-point that replaces the mission's, if given.
        foot_wrenches
            Wrench on each foot of `controller.contact.feet` [N, N m], (feet, 6): force first, about its sole's origin,
            inertial axes. Zero if not given.
        preview
            What is known of the future. Set-points or winds that are not valid are ignored, with the mode
            `preview_ignored`.
        residual
            What is added to the answer of the law, in place of a policy's residual. The mission is then followed,
            without a preview.
        shaft_speed
            Speed of the shaft of every jet, a share of the full speed, from which a controller with `shaft` has its
            thrust; NaN where it is not measured, and `thrust` is used.
        height
            Height of the base origin above that on the ground [m], as of `Measurement`.
        """
        now = None if setpoint is None else _numbers(setpoint)
        feet, speed = (None if given is None else _array(given) for given in (foot_wrenches, shaft_speed))
        known = Preview() if preview is None else preview
        later = [(after, _numbers(given)) for after, given in known.setpoints]
        winds = None if known.wind is None else _array(known.wind)
        added = None
        if residual is not None:
            added = _array(residual.thrust_rate), _array(residual.joint_velocity), residual.replaces
        return _tick(
            self._core.tick(
                time, _arrays(state), _array(thrust), _array(wind), now, feet, later, winds, added, speed, height
            )
        )

    def tick_torques(
        self, joint_position: ArrayLike, joint_velocity: ArrayLike
    ) -> tuple[NDArray[np.float64], list[str]]:
        """Compute one tick of the torques between two ticks of the law; return torques [N m, N], (n,), and modes.

        To be called `controller.torque.steps - 1` times after each tick, at equal times.

        Parameters
        ----------
        joint_position, joint_velocity
            Measured joints [rad, m; rad/s, m/s], (n,); NaN where they are not measured, and predicted.

        Raises
        ------
        ValueError
            For a wrong size, and before the first tick.
        """
        return self._core.tick_torques(_array(joint_position), _array(joint_velocity))

    def replace_command(self, thrust_rate: ArrayLike, joint_torque: ArrayLike) -> None:
        """Replace, after a tick, its command by the one that acts until the next tick, such as a safety layer's.

        The predictions of missing measurements and the model of the state estimator use it.

        Parameters
        ----------
        thrust_rate
            Thrust rates [N/s], (jets,).
        joint_torque
            Joint torques [N m], (n,).

        Raises
        ------
        ValueError
            If numbers are of the wrong size, or beyond what drives and engines can follow, and before the first tick.
        """
        self._core.replace_command(_array(thrust_rate), _array(joint_torque))

    def prediction(self, targets: ArrayLike, wrenches: ArrayLike) -> dict[str, NDArray[np.float64]]:
        """Return linearised model, H and g of the predictive law at the state of the last tick, by the crate's names.

        Parameters
        ----------
        targets
            Position, velocity, rotation vector from the present attitude, angular velocity, acceleration and angular
            acceleration at the end of every knot, inertial axes, (knots, 6, 3).
        wrenches
            Change of the wrench of the air from the tick to the end of every knot [N, N m, inertial axes], (knots, 6).

        Raises
        ------
        ValueError
            Without `controller.mpc`, before the first tick, and for arrays of the wrong size.
        """
        return self._core.prediction(self._config, _array(targets), _array(wrenches))


class Command(NamedTuple):
    """What acts until the next tick."""

    thrust_rate: ArrayLike
    """[N/s], (jets,)."""
    joint_torque: ArrayLike
    """[N m, N], (n,)."""


class Seen(NamedTuple):
    """What a world shows at a tick.

    Attributes
    ----------
    state
        Pose and velocity of the robot.
    measured
        The same as the robot finds it before the errors of its sensors, such as by its legs.
    foot_wrenches, soles
        Wrench on each foot of the robot about the origin of its sole, force first [N, N m, inertial axes], (feet, 6),
        and these origins [m], (feet, 3).
    joint_torque
        Torque that reaches each joint: of the motor, less its friction [N m, N], (n,).
    """

    state: State
    measured: State
    foot_wrenches: ArrayLike
    joint_torque: ArrayLike
    soles: ArrayLike


class World(Protocol):
    """Another simulation of the robot's bodies, such as one with ground; engines, air and sensors are the crate's."""

    def observe(self) -> Seen:
        """Return what is seen at the beginning of a tick, or of a tick of the torques."""

    def advance(self, torque: Array, force: Array) -> None:
        """Advance by one physics step under each row of joint torques [N m, N], (steps, n).

        `force` is the generalised force of jets, air and pushes throughout (6 + n,): on the base, force and moment
        about its origin in inertial axes, then on the joints [N, N m].
        """


class _World:
    """A world for the compiled module, which receives plain arrays."""

    def __init__(self, world: World) -> None:
        self._world = world
        self.advance = world.advance

    def observe(self) -> tuple[Any, ...]:
        seen = self._world.observe()
        return _arrays(seen.state), _arrays(seen.measured), *(_array(part) for part in seen[2:])


class Flight:
    """A flight of a configuration, tick by tick.

    Examples
    --------
    >>> flight = Flight(load_config("test2", {"simulator.duration": 1.0}))
    >>> while not flight.has_ended:
    ...     goes_on = flight.step()
    >>> flight.result().outcome
    'completed'

    Sensors, outages, delays, log, judgement and figures of merit are those of `fly`, whatever is handed in. With
    another controller, or a command, the configuration's ticks too: the flight is judged by its set-point, and it is
    given what acts.

    Parameters
    ----------
    config
        A resolved configuration.
    world
        What moves the robot's bodies in place of the crate.
    controller
        What commands in every tick in place of the configuration's, from the measurement that it is given and the
        set-point; by default that of the configuration's `own_controller`, if any.
    robot
        The configuration's, so that the crate's world does not read its files again.

    Raises
    ------
    ConfigError
        For a configuration that cannot be flown, in this world.
    """

    def __init__(
        self,
        config: Mapping[str, Any],
        world: World | None = None,
        controller: Callable[[Measurement], Command] | None = None,
        robot: Robot | None = None,
    ) -> None:
        text = to_json(config)
        if config.get("own_controller"):
            text = to_json({key: value for key, value in config.items() if key != "own_controller"})
        self._core = _core.Flight(text, None if world is None else _World(world), robot)
        has_own = controller is None and config.get("own_controller")
        self._controller: Callable[[Measurement], Any] | None = (
            own.Own(config, Robot(config["robot"])) if has_own else controller
        )

    @property
    def tick(self) -> int:
        """Number of the next tick; of a flight that is lost, of the tick in which it is."""
        return self._core.tick

    @property
    def n_ticks(self) -> int:
        """Number of ticks after the one at time zero."""
        return self._core.n_ticks

    @property
    def has_ended(self) -> bool:
        """Whether the last tick has been flown or the flight is lost."""
        return self._core.has_ended

    @property
    def truth(self) -> Measurement:
        """The simulated robot at the next tick; thrusts are those that the engines report (`jets.feedback`)."""
        return _measurement(self._core.truth())

    @property
    def measurement(self) -> Measurement:
        """What the controller is given in the next tick."""
        return _measurement(self._core.measurement())

    @property
    def last(self) -> Tick:
        """Every value of the controller's last tick, or of one that was tried since."""
        return _tick(self._core.last_tick())

    def try_tick(self) -> Tick:
        """Compute the next tick with a copy of the controller's state, and return every value; nothing advances."""
        return _tick(self._core.try_tick())

    @property
    def controller_state(self) -> ControllerState | None:
        """State of the controller after the last tick; `None` before the first."""
        return self._core.controller_state

    @property
    def residual_wrench(self) -> Array:
        """Wrench that a residual's policy observes (6,) [N, N m]; zero without a residual."""
        return self._core.residual_wrench()

    def step(
        self,
        *,
        setpoint: Setpoint | None = None,
        residual: Residual | None = None,
        command: Command | None = None,
        measurement: Measurement | None = None,
        link_forces: ArrayLike | None = None,
    ) -> bool:
        """Fly one tick; return whether the flight goes on.

        Parameters
        ----------
        setpoint
            What the controller follows in place of the mission.
        residual
            What is added to the answer of the law, in place of a policy's residual.
        command
            What acts in place of the controller's command.
        measurement
            What the controller is given in place of `self.measurement`; its time is not read.
        link_forces
            Aerodynamic force on every link [N], (links, 3), inertial axes, in place of that of the model in this tick.

        Raises
        ------
        ValueError
            For arrays of the wrong size, and commands or forces that are not finite; the flight then has not advanced.
            Where the flight cannot begin with its first measurement.
        """
        if self.has_ended:
            return False
        if command is None and self._controller is not None:
            given_to_it = self.measurement if measurement is None else measurement
            command = self._controller(given_to_it._replace(setpoint=Setpoint(**self._core.setpoint())))
        added = None if residual is None else (_array(residual.thrust_rate), _array(residual.joint_velocity))
        given = None
        if measurement is not None:
            _, state, thrust, wind, feet, speed, height, _ = measurement
            given = _arrays(state), _array(thrust), _array(wind), _array(feet), _array(speed), height
        return self._core.step(
            setpoint=None if setpoint is None else _numbers(setpoint),
            residual=None if residual is None or added is None else (*added, residual.replaces),
            command=None if command is None else (_array(command[0]), _array(command[1])),
            measurement=given,
            link_forces=None if link_forces is None else _array(link_forces),
        )

    def result(self) -> FlightResult:
        """Return the result; before the end, as if the flight ended now."""
        return FlightResult(**self._core.result())

    def run(self, progress: Progress | None = None) -> FlightResult:
        """Fly to the end, or until the flight is lost; return the result. Ctrl-C interrupts it."""
        while self.step():
            if progress is not None:
                progress(self.tick - 1, self.n_ticks)
        return self.result()


def rotation_from_wxyz(wxyz: ArrayLike) -> Array:
    """Return the rotation matrices (..., 3, 3) of quaternions (..., 4) of any nonzero length."""
    rotations: Array = spatial.rotation_from_wxyz(np.asarray(wxyz, dtype=np.float64))
    return rotations


class Csv(NamedTuple):
    """Columns of a table in text.

    Attributes
    ----------
    header
        Names of all its columns.
    numbers, texts
        Columns that were asked for and are there, by name.
    lines
        Line on which every row stands.
    """

    header: list[str]
    numbers: dict[str, Array]
    texts: dict[str, list[str]]
    lines: NDArray[np.uint64]


def read_csv(
    content: bytes | str, file: str, columns: Mapping[str, str], missing: Mapping[str, Collection[str]] | None = None
) -> Csv:
    """Read columns of a table in text: the one dialect of all tables, which `docs/reference.md` states.

    Parameters
    ----------
    content
        The table.
    file
        Its name in refusals.
    columns
        Kind of every column: `number`, which is finite; `reading`, which may be missing (NaN), in some cells or as a
        whole; `signal`, a reading that may be infinite; or `text`. The header has the first one, by which the separator
        is known.
    missing
        Texts by column that mean that nothing was measured, beside empty cells and NaN as loggers write it.

    Raises
    ------
    ConfigError
        Naming file, line, column, value and what was expected.
    """
    data = content.encode() if isinstance(content, str) else content
    absent = [(name, text) for name, words in (missing or {}).items() for text in words]
    header, numbers, texts, lines = _core.read_csv(data, file, next(iter(columns)), list(columns.items()), absent)
    named = [name for name, kind in columns.items() if kind == "text"]
    measured = [name for name, kind in columns.items() if kind != "text" and name in header]
    return Csv(
        header,
        dict(zip(measured, numbers.T, strict=True)),
        {name: texts[place :: len(named)] for place, name in enumerate(named)},
        lines,
    )


def fly(config: Mapping[str, Any], progress: Progress | None = None) -> FlightResult:
    """Fly one configuration to its end or until the flight is lost. Ctrl-C interrupts it.

    Raises
    ------
    ValueError
        For a flight that cannot be flown, or cannot begin with its first measurement.
    """
    text = to_json(config)
    if config.get("own_controller"):
        return Flight(config).run(progress)
    return FlightResult(**_core.fly(text, progress))


def replay(config: Mapping[str, Any], log: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """Replay a log through the tick of a configuration's controller, open loop; return the controller's signals.

    The log of a flight and its configuration give the signals of the flight again, with the same bits.

    Parameters
    ----------
    log
        Signals by name (`signals`), of which `time` and all `raw_*` are read; the first axis is time. A row is a tick,
        or, with `controller.torque.steps` > 1, a tick of the torques. NaN is not measured, as are signals that are
        absent; foot wrenches are then zero.

    Raises
    ------
    ValueError
        For signals of another shape, rows that are not as far apart as the ticks, and a first row that no flight can
        begin with.
    """
    inputs = {name: value for name, value in log.items() if is_input(name)}
    return _core.replay(to_json(config), {name: _array(value) for name, value in inputs.items()})


def summarise(log: Mapping[str, ArrayLike], joint_setpoint: ArrayLike) -> dict[str, float]:
    """Return the figures of merit (`figures`) of a log, or of one whose rows have fewer numbers with the same figures.

    `joint_setpoint` has the joints of its rows. A figure is NaN if the log lacks a signal that it is computed from.
    """
    return _core.summarise({name: _array(values) for name, values in log.items()}, _array(joint_setpoint))


def summarised() -> list[str]:
    """Return the names of the signals that figures of merit are computed from."""
    return _core.summarised()


def is_input(signal: str) -> bool:
    """Return whether `replay` reads a signal."""
    return signal == "time" or signal.startswith("raw_")


def fly_batch(
    configs: Iterable[Mapping[str, Any]],
    threads: int | None = None,
    progress: Progress | None = None,
    *,
    full_log: bool = False,
) -> list[FlightResult]:
    """Fly many configurations in parallel threads; the results do not depend on their number.

    Without `full_log` only outcome and summary are guaranteed.

    Raises
    ------
    ValueError
        For a flight that cannot be flown, naming the first one and the reason; and for `threads` below one.
    """
    if threads is not None and threads < 1:
        raise ValueError(f"`threads` is {threads}; expected at least 1, or None for one per core")
    configs = list(configs)
    texts = [to_json(config) for config in configs]
    if any(config.get("own_controller") for config in configs):
        flown = []
        with ThreadPoolExecutor(threads or os.cpu_count()) as pool:  # of processes that compute the commands
            for flight in pool.map(fly, configs):
                flown.append(flight if full_log else replace(flight, log={}))
                if progress is not None:
                    progress(len(flown), len(configs))
        return flown
    return [FlightResult(**raw) for raw in _core.fly_batch(texts, threads, progress, full_log)]


class Observed(NamedTuple):
    """The simulated robots of flights at their next ticks, inertial axes; the first axis is that of the flights."""

    base_rotation: Array
    velocity: Array
    """ν (flights, 6 + n) [m/s, rad/s]."""
    joint_position: Array
    thrust: Array
    """Those that the engines report (`jets.feedback`) [N]."""
    com_position: Array
    residual_wrench: Array
    """(flights, 6) [N, N m]."""
    com_setpoint: Array | None = None
    rotation_setpoint: Array | None = None
    com_velocity_setpoint: Array | None = None
    angular_velocity_setpoint: Array | None = None


def step_flights(flights: Sequence[Flight], residual: Residual) -> NDArray[np.bool_]:
    """Fly one tick of each flight on all cores, with its row of the residual; return whether each goes on.

    Raises
    ------
    ValueError
        For flights of several robots, or with controllers in Python, and arrays of the wrong size.
    """
    if any(flight._controller is not None for flight in flights):
        raise ValueError("a flight has an `own_controller`; expected the law, to which a residual is added")
    rates, velocities, replaces = residual
    cores = [flight._core for flight in flights]
    return np.array(_core.step_flights(cores, _array(rates), _array(velocities), replaces))


def observe_flights(flights: Sequence[Flight], *, setpoint: bool = False) -> Observed:
    """Return the robots of flights at their next ticks, and what their controllers follow if `setpoint`."""
    return Observed(**dict(_core.observe_flights([flight._core for flight in flights], setpoint)))


def dynamics(robot: Robot, state: State) -> Dynamics:
    """Return kinematics and dynamics of one state."""
    return Dynamics(**robot.dynamics(_arrays(state)))


def frame_jacobian(robot: Robot, frame: str, state: State) -> Jacobian:
    """Return the Jacobian of a frame: a body, jet, aerodynamic link or sole, given the name of its URDF link."""
    return Jacobian(*robot.frame_jacobian(frame, _arrays(state)))


def forward_dynamics(robot: Robot, state: State, force: ArrayLike) -> Array:
    """Return the acceleration ν̇ (6 + n) under a generalised force (6 + n): M ν̇ + h = force."""
    return robot.forward_dynamics(_arrays(state), _array(force))


def aero_forces(robot: Robot, aero: Mapping[str, Any], axes: ArrayLike, v_air: ArrayLike) -> Array:
    """Return the aerodynamic force on each link [N], (links, 3), inertial axes.

    Parameters
    ----------
    aero
        A table as in `configs/aero/*.toml`, of a model that evaluates each link separately.
    axes, v_air
        Unit symmetry axes and velocities of the air relative to the links [m/s], each (links, 3).
    """
    return _core.aero_forces(robot, to_json(aero), _array(axes), _array(v_air))


def link_forces(robot: Robot, aero: Mapping[str, Any], state: State, wind: ArrayLike) -> Array:
    """Return the aerodynamic force on each link [N], (links, 3), inertial axes, for a robot's state and a wind.

    Unlike `aero_forces` this supports every model, including networks.

    Parameters
    ----------
    aero
        A table as in `configs/aero/*.toml`, with its paths resolved.
    wind
        Velocity of the air (3,) [m/s, inertial axes].
    """
    return _core.link_forces(robot, to_json(aero), _arrays(state), _array(wind))


def setpoint_trajectory(config: Mapping[str, Any], com: ArrayLike, rotation: ArrayLike) -> dict[str, Array]:
    """Return the raw and smoothed set-points of a whole flight.

    `com` (3,) [m] and `rotation` (3, 3) are the centre of mass and the base rotation of the first tick. Raw roll, pitch
    and yaw are those of the heading frame: forward, left, up.
    """
    return _core.setpoint_trajectory(to_json(config), _array(com), _array(rotation))


def wind_velocity(wind: Mapping[str, Any], times: ArrayLike) -> Array:
    """Return the velocity of the air [m/s, inertial axes], (times, 3), of a wind profile at `times` [s]."""
    return _core.wind_velocity(to_json(wind), _array(times))


def recorded_wind(wind: Mapping[str, Any]) -> Array:
    """Return the samples (k, 4) of a recorded wind: times [s] and velocities [m/s, inertial axes]."""
    return _core.recorded_wind(to_json(wind))


def recorded_reference(path: str | PathLike[str]) -> Array:
    """Return the rows (k, 7, 10, 13 or 16) of the file of a recorded reference, in the order of its columns."""
    return _core.recorded_reference(path)


def _measurement(raw: _core._Measurement) -> Measurement:
    numbers = raw["thrust"], raw["wind"], raw["foot_wrenches"], raw["shaft_speed"], raw["height"]
    return Measurement(raw["time"], State(*raw["state"]), *numbers)


def _tick(raw: dict[str, Any]) -> Tick:
    contact, estimates = raw.pop("contact", None), raw.pop("estimates")
    momentum = QpProblem(raw.pop("h"), raw.pop("g"), raw.pop("lower"), raw.pop("upper"))
    kind = QpProblem if contact is None else RowProblem
    torque = kind(*(raw.pop(f"torque_{part}") for part in kind._fields))
    return Tick(
        momentum_answer=QpAnswer(**raw.pop("momentum_qp")),
        torque_answer=QpAnswer(**raw.pop("torque_qp")),
        momentum_qp=momentum,
        torque_qp=torque,
        setpoint=Setpoint(**raw.pop("setpoint")),
        estimates=Estimates(State(*estimates.pop("state")), **estimates),
        contact=None if contact is None else ContactTick(**contact),
        **raw,
    )


def _array(value: ArrayLike) -> Array:
    return np.ascontiguousarray(value, dtype=np.float64)


def _numbers(setpoint: Setpoint) -> dict[str, Array]:
    return {name: _array(value) for name, value in vars(setpoint).items()}


def _arrays(state: State) -> tuple[Array, Array, Array, Array]:
    position, rotation, joints, velocity = state
    return _array(position), _array(rotation), _array(joints), _array(velocity)

"""A flight's configuration as typed pytrees, field for field what the Rust crate reads.

Numbers are leaves, so gains, weights, coefficients or winds can be batched and differentiated; names and switches are
static. `scenario_config` builds them from what `jax_aero.rust.load_config` returns, which has checked every value;
here unknown and missing keys are refused once more, so that no setting is ever silently ignored.

>>> from jax_aero import rust
>>> config = scenario_config(rust.load_config("configs/experiments/test2.toml"))
>>> float(config.controller.momentum.c0)
50.0
"""

from __future__ import annotations

import difflib
import functools
import operator
import types
import typing
from collections.abc import Mapping
from dataclasses import MISSING, field, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypeVar, cast

import numpy as np
from scipy.spatial.transform import Rotation

from jax_aero import noise
from jax_aero.types import Array, Static, pytree

T = TypeVar("T")

LeverArm: TypeAlias = Literal["rotated", "unrotated"]
"""Where a link's force acts when its moment is formed: `p + R c`, or as published `p + c`."""
JacobianOffset: TypeAlias = Literal["link_rotation", "base_rotation"]
"""Which point's Jacobian carries a link's force: `p + R c`, or as published `p + R_B c`."""
Backend: TypeAlias = Literal["tree", "mjx"]
"""What computes mass matrix and bias: the sums of `jax_aero.dynamics`, or MuJoCo's JAX implementation."""
RateFeedback: TypeAlias = Literal["wrench", "force", "moment", "none"]
"""What of the total aerodynamic wrench about the centre of mass the estimated momentum rate holds."""
Integrator: TypeAlias = Literal["semi_implicit_euler", "explicit_euler"]
"""Whether a pose moves with the new velocity or with the old one."""
LinkVelocity: TypeAlias = Literal["at_centre", "shifted_twice"]
"""Which point's velocity makes the relative wind: the centre, or as published the Jacobian's point shifted again."""


def _default(value: Any) -> Any:
    """Field that a table may leave out: number or array of double precision."""
    return field(default_factory=lambda: _number(value))


# --- aerodynamics ------------------------------------------------------------------------------------------------


@pytree
class Off:
    """No aerodynamic force: what the baseline controller assumes."""


@pytree
class AxisymmetricConfig:
    """Fitted force areas of axisymmetric links."""

    coefficients: Static[str]
    """Name of a coefficient set that every link of the robot has."""
    air_density: Array
    """[kg/m³]"""


@pytree
class CylinderTables:
    """Measured drag coefficients of circular cylinders; see `configs/aero/sphere_cylinder.toml`."""

    reference_reynolds: Array
    reynolds: Array
    crosswind_drag: Array
    diameter_over_length: Array
    finite_length_drag: Array
    length_over_diameter: Array
    axial_drag: Array


@pytree
class SphereTables:
    """Measured drag coefficients of spheres, on the area `π d²/4`."""

    drag_below_reynolds_10: Array
    reynolds: Array
    drag: Array


@pytree
class SphereCylinderConfig:
    """Literature drag of spheres and finite cylinders."""

    air_density: Array
    """[kg/m³]"""
    dynamic_viscosity: Array
    """[Pa s]"""
    cylinder: CylinderTables
    sphere: SphereTables


@pytree
class NetworkConfig:
    """A neural network of wind and posture."""

    card: Static[str]
    """Path of the network's JSON card; the weights lie beside it."""
    air_density: Array
    """[kg/m³]"""
    precision: Static[Literal["f32", "f64"]] = "f32"
    """Of the weighted sums."""


AeroConfig: TypeAlias = Off | AxisymmetricConfig | SphereCylinderConfig | NetworkConfig
"""Which aerodynamic model, and its numbers: one file of `configs/aero/`."""


@pytree
class ForceFactorsConfig:
    """Factors on the forces of a model: coefficients that are not what they are thought to be."""

    scale: Array = _default(1.0)
    """() on all forces."""
    drag: Array = _default(1.0)
    """() on the part along the air."""
    normal: Array = _default(1.0)
    """() on the part across it."""
    links: dict[str, Array] = field(default_factory=dict)
    """() on the whole force of a link, by its name."""


# --- jets --------------------------------------------------------------------------------------------------------


@pytree
class Ideal:
    """Thrust is the integral of the commanded rate."""


@pytree
class EkfConfig:
    """Numbers of the thrust estimator, in the letters of its equations."""

    init_p: Array = _default([[1.0, 0.1], [0.1, 1.0]])
    """(2, 2) covariance of the initial state."""
    q: Array = _default([[10.0, 1.0], [1.0, 10.0]])
    """(2, 2) intensity of the process noise."""
    r: Array = _default(1.0)
    """() intensity of the measurement noise."""
    init_state: Array | None = None
    """(2,) initial (T, Ṫ) [N, N/s]; without it (initial thrust, 0)."""


@pytree
class SecondOrderConfig:
    """Identified second-order engines behind a throttle loop."""

    rate_gain_p: Array = _default(150.0)
    """[1/s]"""
    rate_gain_i: Array = _default(0.0)
    """[1/s²]"""
    ekf: EkfConfig = field(default_factory=EkfConfig)
    feedback: Static[Literal["measured", "estimated"]] = "measured"
    """Which thrust the flight controller is given."""
    engines: Static[tuple[str, ...] | None] = None
    """Engine of each jet; without it, those of the robot."""


JetsConfig: TypeAlias = Ideal | SecondOrderConfig


@pytree
class JetFailureConfig:
    """A jet that stops obeying."""

    jet: Static[str]
    time: Array
    """When it fails [s]."""
    kind: Static[Literal["off", "stuck"]]
    """Whether its thrust goes, or stays where it is."""
    decay: Array = _default(0.0)
    """Time constant with which a jet that is off loses its thrust [s]; zero for at once."""


@pytree
class MeasurementNoiseConfig:
    """White noise on the thrust that estimators of second-order jets measure."""

    std: Array
    """[N]"""
    seed: Static[int] = 0


@pytree
class JetFaultsConfig:
    """What is wrong with the jets."""

    limit_is_known: Static[bool] = False
    """Whether the controller's own limits are scaled as well."""
    lag: Array = _default(0.0)
    """Time constant with which the commanded thrust rate takes effect [s]; zero for at once."""
    thrust_limit_scale: Array | None = None
    """Thrust stays between zero and this times the robot's greatest thrust; without it nothing limits it."""
    failure: JetFailureConfig | None = None
    measurement_noise: MeasurementNoiseConfig | None = None
    force_scale: dict[str, Array] = field(default_factory=dict)
    """() force that a jet exerts over the thrust that it seems to have, by its name; the others exert their thrust."""


# --- wind --------------------------------------------------------------------------------------------------------


@pytree
class ConstantWind:
    """The same all the time."""

    velocity: Array
    """(3,) [m/s]."""


@pytree
class RampWind:
    """Still, then rising linearly to a constant: the published profile."""

    velocity: Array
    """(3,) after the ramp [m/s]."""
    ramp_start: Array
    """[s]"""
    ramp_end: Array
    """[s]"""


@pytree
class GustWind:
    """A steady wind with one "1 − cos" gust on top."""

    velocity: Array
    """(3,) [m/s]."""
    gust: Array
    """(3,) added at the peak [m/s]."""
    start: Array
    """[s]"""
    duration: Array
    """[s]"""


@pytree
class RecordedWind:
    """A recorded wind: linear between samples, constant outside."""

    times: Array
    """(k,) [s], increasing."""
    velocities: Array
    """(k, 3) [m/s]."""


@pytree
class TurbulentWind:
    """A ramp with turbulence on top, which rises with it: a sum of waves with the spectrum of a Gauss–Markov process.

    Its random numbers are drawn when the configuration is built, so that they are numbers like all others.
    """

    velocity: Array
    """(3,) mean after the ramp [m/s]."""
    ramp_start: Array
    """[s]"""
    ramp_end: Array
    """[s]"""
    std: Array
    """(3,) standard deviation of the turbulence [m/s]."""
    time_scale: Array
    """() [s]."""
    places: Array
    """(3, 24) where in the spectrum each wave stands, in bands of equal variance."""
    phases: Array
    """(3, 24) [rad]."""


WindConfig: TypeAlias = ConstantWind | RampWind | GustWind | RecordedWind | TurbulentWind


# --- controller --------------------------------------------------------------------------------------------------


@pytree
class AeroFeedback:
    """Where the estimated aerodynamic forces enter the controller; each can be left out."""

    momentum_rate: Static[RateFeedback] = "wrench"
    """What of `A_a f_a` enters the estimated momentum rate."""
    lambda_a: Static[bool] = True
    """Whether `Λ_a` enters the derivative of the momentum rate."""
    torque: Static[bool] = True
    """Whether `J_aᵀ f_a` enters the torque law."""


@pytree
class WindEstimateConfig:
    """Errors of the measured wind."""

    bias: Array = _default([0.0, 0.0, 0.0])
    """(3,) added to the wind [m/s, inertial axes]."""
    noise_std: Array = _default(0.0)
    """() standard deviation of white noise on every axis, independent in every tick [m/s]."""
    delay: Array = _default(0.0)
    """() delay of the measured wind, rounded to ticks [s]."""
    time_constant: Array = _default(0.0)
    """() of a first-order low pass behind all other errors [s]; zero for none."""
    mean_only: Array = _default(0.0)
    """() 1 or 0: whether the measured wind is its mean over the flight."""
    seed: Static[int] = 0


@pytree
class MomentumGains:
    """Gains of the momentum and attitude tasks."""

    kp_linear: Array
    """(3,) [1/s²]."""
    kd_linear: Array
    """(3,) [1/s]."""
    ko: Array
    """() [s]."""
    c0: Array
    """() [N m]."""
    c1: Array
    """() [N m s]."""


@pytree
class MomentumWeights:
    """Weights of the tasks in the momentum QP."""

    momentum: Array
    angular_momentum: Array
    posture: Array
    joint_velocity: Array
    thrust_rate: dict[str, Array]
    """By jet."""
    symmetry: Array
    symmetric_jets: Static[tuple[tuple[str, str], ...]]
    """Pairs of jets meant to act alike."""
    regularisation: Array


@pytree
class BoundsConfig:
    """Bounds of the momentum QP: rates fade out, as a tanh, where the value meets its own limit."""

    thrust_rate_max: dict[str, Array]
    """By jet [N/s]."""
    thrust_steepness: Array
    """() [1/N]."""
    joint_steepness: Array
    """() [1/rad, 1/m]."""
    joint_velocity_max_deg: Array | None = None
    """() of revolute joints, in place of the robot's own limits [deg/s]."""


@pytree
class TorqueConfig:
    """The joint torque controller, all scalars. Limits are of revolute joints, in place of the robot's own."""

    kd: Array
    """[1/s]"""
    kp: Array
    """[1/s²]"""
    weight_acceleration: Array
    weight_torque: Array
    regularisation: Array
    torque_max: Array | None = None
    """[N m]"""
    torque_rate_max: Array | None = None
    """[N m/s]"""


@pytree
class ObserverConfig:
    """How fast the observer of the unmodelled wrench follows, and what it believes at most; all scalars."""

    gain_force: Array
    """`K_o` of the force [1/s]."""
    gain_moment: Array
    """`K_o` of the moment [1/s]."""
    force_max: Array
    """Greatest observed force along each axis [N]."""
    moment_max: Array
    """Greatest observed moment about each axis [N m]."""


@pytree
class QpConfig:
    """How the Rust crate solves its QPs; JAX has one solver."""

    solver: Static[Literal["active_set", "clarabel"]] = "active_set"
    fallback: Static[Literal["clarabel", "hold"]] = "hold"


@pytree
class SetpointConfig:
    """Speeds, limits and smoothing times of the set-point generator."""

    speed: Array
    """(2,) forward and vertical speed of the raw position [m/s]."""
    attitude_rate_deg: Array
    """(2,) rates of raw pitch and yaw [deg/s]."""
    nose_down_limits_deg: Array
    """(2,) least and greatest raw pitch, positive nose down [deg]."""
    turbo_boost: Array
    """() the forward speed grows to `1 + turbo_boost` times itself."""
    turbo_rate: Array
    """() growth of the boost [1/s]."""
    position_smoothing: Array
    """() [s]."""
    acceleration_smoothing: Array
    """() [s]."""
    angular_velocity_smoothing: Array
    """() [s]."""
    attitude_gain: Array
    """() [1/s]."""


@pytree
class ModelError:
    """How the controller's robot differs from the one that flies."""

    mass_scale: Array = _default(1.0)
    """() factor on all masses and inertias."""
    com_offset: Array = _default([0.0, 0.0, 0.0])
    """(3,) added to the base body's centre of mass [m, base axes]."""


@pytree
class ControllerConfig:
    """Everything that makes a controller; one file in `configs/control/`."""

    aero: AeroConfig
    momentum: MomentumGains
    posture_gain: dict[str, Array]
    """By joint group [1/s]."""
    weights: MomentumWeights
    bounds: BoundsConfig
    torque: TorqueConfig
    setpoint: SetpointConfig
    aero_feedback: AeroFeedback = field(default_factory=AeroFeedback)
    lever_arm: Static[LeverArm] = "rotated"
    jacobian_offset: Static[JacobianOffset] = "link_rotation"
    link_velocity: Static[LinkVelocity] = "at_centre"
    observer: ObserverConfig | None = None
    """What observes the wrench that no model knows; without it there is none."""
    qp: QpConfig = field(default_factory=QpConfig)


@pytree
class RecordedReference:
    """A reference computed beforehand, sample by sample; derivatives that are missing are differences."""

    times: Array
    """(k,) [s], increasing."""
    com_position: Array
    """(k, 3) [m]."""
    rpy: Array
    """(k, 3) roll, pitch, yaw of the base [rad]."""
    com_velocity: Array | None
    """(k, 3) [m/s]."""
    com_acceleration: Array | None
    """(k, 3) [m/s²]."""
    com_jerk: Array | None
    """(k, 3) [m/s³]."""


@pytree
class MissionConfig:
    """When the autopilot commands what: for each motion open intervals (k, 2) of time [s]."""

    up: Array = _default(np.zeros((0, 2)))
    down: Array = _default(np.zeros((0, 2)))
    forward: Array = _default(np.zeros((0, 2)))
    forward_turbo: Array = _default(np.zeros((0, 2)))
    pitch_up: Array = _default(np.zeros((0, 2)))
    yaw_left: Array = _default(np.zeros((0, 2)))
    file: RecordedReference | None = None
    """A recorded reference to fly instead of any command."""


# --- simulator ---------------------------------------------------------------------------------------------------


@pytree
class InitialConfig:
    """State at the beginning of a flight."""

    base_position: Array
    """(3,) [m]."""
    base_rpy_deg: Array
    """(3,) [deg]."""
    joint_position: Array
    """(n,) [rad]."""
    thrust: Array
    """(j,) [N]."""
    base_velocity: Array = _default(np.zeros(6))
    """(6,) of the base origin and angular, inertial axes [m/s, rad/s]."""
    free_fall_tick: Static[bool] = False
    """Whether the first physics step has neither thrust nor torque."""


@pytree
class DivergenceConfig:
    """What physics excludes: a flight whose numbers go beyond has diverged."""

    speed: Array = _default(300.0)
    """() of base and air [m/s]."""
    angular_velocity: Array = _default(100.0)
    """() of the base [rad/s]."""
    joint_velocity: Array = _default(100.0)
    """() [rad/s, m/s]."""
    joint_excess: Array = _default(6.0)
    """() of a joint beyond its stops [rad, m]."""
    thrust_ratio: Array = _default(10.0)
    """() of a thrust to the jet's greatest."""


@pytree
class FallConfig:
    """When a robot counts as fallen."""

    rotation_error_deg: Array
    """() [deg]."""
    com_error: Array
    """() [m]."""


@pytree
class SimulatorConfig:
    """Simulator of the robot's surroundings."""

    duration: Static[float]
    """[s]"""
    time_step: Static[float]
    """Tick of controller and physics [s]."""
    aero: AeroConfig
    jets: JetsConfig
    initial: InitialConfig
    fall: FallConfig
    substeps: Static[int] = 1
    """Physics steps within a tick."""
    integrator: Static[Integrator] = "semi_implicit_euler"
    dynamics: Static[Backend] = "tree"
    lever_arm: Static[LeverArm] = "rotated"
    kinematics: Static[Literal["current", "frozen"]] = "current"
    """Which kinematics place the links in the wind."""
    joint_stops: Static[bool] = True
    """Whether joints meet their stops."""
    course_error: Array = _default(0.5)
    """() greatest position error after the start-up of a flight that is on course [m]."""
    divergence: DivergenceConfig = field(default_factory=DivergenceConfig)

    @property
    def n_ticks(self) -> int:
        """Number of ticks after the one at time zero."""
        return int(np.floor(self.duration / self.time_step + 0.5))


@pytree
class Disturbances:
    """What is done to robot and controller; none of it is part of the controller."""

    wind_estimate: WindEstimateConfig | None = None
    """Errors of the wind that the controller is given; without them it is the true one."""
    controller_wind: WindConfig | None = None
    """A wind that the controller is given in place of the one that blows."""
    model_error: ModelError | None = None
    """How the controller's robot differs from the one that flies."""
    aero: ForceFactorsConfig | None = None
    """Factors on the simulated aerodynamic forces."""
    aero_estimate: ForceFactorsConfig | None = None
    """Factors on the forces that the controller estimates."""
    jets: JetFaultsConfig | None = None
    """What is wrong with the jets."""


@pytree
class ScenarioConfig:
    """One flight: which robot, in which simulator and wind, under which controller, on which mission."""

    robot: Static[str]
    """Path of the robot's TOML file."""
    simulator: SimulatorConfig
    controller: ControllerConfig
    mission: MissionConfig
    wind: WindConfig
    disturbances: Disturbances = field(default_factory=Disturbances)
    title: Static[str] = ""
    description: Static[str] = ""
    engine: Static[Literal["rust", "jax"]] = "rust"
    """Engine of the experiment; JAX flies configurations of either."""


# --- from a resolved table ---------------------------------------------------------------------------------------


def scenario_config(table: Mapping[str, Any]) -> ScenarioConfig:
    """Build a flight's configuration from a resolved table, as `rust.load_config` returns it.

    Raises
    ------
    ValueError
        Naming the key that is unknown or missing.
    """
    return _build(ScenarioConfig, table, "")


def aero_config(table: Mapping[str, Any]) -> AeroConfig:
    """Build an aerodynamic model's configuration from its table."""
    return cast(AeroConfig, _build_union(AeroConfig, table, "aero"))


# Tagged tables: the key that says which kind, and the type of each kind.
_KINDS: dict[str, dict[str, type]] = {
    "model": {
        "off": Off,
        "axisymmetric": AxisymmetricConfig,
        "sphere_cylinder": SphereCylinderConfig,
        "network": NetworkConfig,
    },
    "dynamics": {"ideal": Ideal, "second_order": SecondOrderConfig},
    "profile": {
        "constant": ConstantWind,
        "ramp": RampWind,
        "gust": GustWind,
        "file": RecordedWind,
        "turbulent": TurbulentWind,
    },
}
_TAGS = {AeroConfig: "model", JetsConfig: "dynamics", WindConfig: "profile"}


# Fields whose name differs from the key.
_KEYS_IN_FILES = {
    ("AeroFeedback", "lambda_a"): "lambda",
    ("EkfConfig", "init_p"): "init_P",
    ("EkfConfig", "q"): "Q",
    ("EkfConfig", "r"): "R",
}


def _build_union(union: Any, table: Mapping[str, Any], where: str) -> Any:
    tag = _TAGS[union]
    kind = table.get(tag)
    if kind not in _KINDS[tag]:
        raise ValueError(f"`{where}.{tag}` is {kind!r}; expected one of {', '.join(_KINDS[tag])}")
    rest = {key: value for key, value in table.items() if key != tag}
    if kind == "file":
        return _recorded_wind(rest, where)
    if kind == "turbulent":
        rest |= _waves(rest.pop("seed", 0))
    return _build(_KINDS[tag][str(kind)], rest, where)


def _recorded_wind(table: Mapping[str, Any], where: str) -> RecordedWind:
    if set(table) != {"path"}:
        raise ValueError(f"`{where}` of profile file has keys {sorted(table)}; expected only `path`")
    samples = np.loadtxt(table["path"], delimiter=",", skiprows=1, ndmin=2)
    return RecordedWind(times=_number(samples[:, 0]), velocities=_number(samples[:, 1:4]))


WAVES = 24
"""Waves of turbulence per axis."""
TURBULENCE_STREAM = 2


def _waves(seed: int) -> dict[str, Any]:
    """Draw the waves of turbulence: axis by axis, a place in every band and a phase."""
    draws = noise.uniforms(seed, TURBULENCE_STREAM, 3 * WAVES * 2).reshape(3, WAVES, 2)
    # Not up to the edge of a band: the last one has none.
    places = (np.arange(WAVES) + 0.25 + 0.5 * draws[..., 0]) / WAVES
    return {"places": places, "phases": 2.0 * np.pi * draws[..., 1]}


GREATEST_TURN_DEG = 179.0
"""From one row of a recorded reference to the next [deg]: of half a turn the axis is rounding."""


def recorded_reference(path: str) -> RecordedReference:
    """Read a recorded reference: CSV, `#` begins a comment, the header names 7, 10, 13 or 16 columns.

    `rust.check_config` says what is wrong with a file that the crate refuses; here its shape and turns are checked.
    """
    text = Path(path).read_text(encoding="utf-8").splitlines()
    lines = [line for line in text if line.strip() and not line.lstrip().startswith("#")]
    rows = np.array([line.split(",") for line in lines[1:]], dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] not in (7, 10, 13, 16) or len(rows) < 2:
        raise ValueError(f"reference file {path} has shape {rows.shape}; expected 2 rows or more of 7, 10, 13 or 16")
    rotations = Rotation.from_euler("xyz", rows[:, 4:7])
    turns = np.degrees((rotations[:-1].inv() * rotations[1:]).magnitude())
    if np.any(turns > GREATEST_TURN_DEG):
        row = int(np.argmax(turns > GREATEST_TURN_DEG)) + 1
        raise ValueError(
            f"reference file {path} turns by {turns[row - 1]:.1f} deg from row {row} to row {row + 1}; "
            f"expected a turn below {GREATEST_TURN_DEG:g} deg, whose axis is certain"
        )
    columns = [_number(rows[:, first : first + 3]) for first in range(1, rows.shape[1], 3)]
    known: list[Any] = [*columns, None, None, None]
    return RecordedReference(_number(rows[:, 0]), *known[:5])


def _build(cls: type[T], table: Mapping[str, Any], where: str) -> T:
    assert is_dataclass(cls)
    hints = typing.get_type_hints(cls)
    keys = {_KEYS_IN_FILES.get((cls.__name__, item.name), item.name): item for item in fields(cls)}
    for key in table:
        if key not in keys:
            near = difflib.get_close_matches(key, keys, n=1)
            hint = f"did you mean `{near[0]}`?" if near else f"expected one of {', '.join(keys)}"
            raise ValueError(f"unknown key `{where}.{key}`; {hint}".replace("`.", "`"))
    values = {}
    for key, item in keys.items():
        if key in table:
            values[item.name] = _value(hints[item.name], table[key], f"{where}.{key}".lstrip("."))
        elif item.default is MISSING and item.default_factory is MISSING:
            raise ValueError(f"`{where}.{key}` is missing".replace("`.", "`"))
    return cls(**values)


def _value(hint: Any, value: Any, where: str) -> Any:
    if isinstance(hint, types.UnionType):  # `X | None`
        options = [option for option in typing.get_args(hint) if option is not type(None)]
        hint = functools.reduce(operator.or_, options)
    if hint in _TAGS:
        return _build_union(hint, value, where)
    if hint is RecordedReference:
        return recorded_reference(value)
    if is_dataclass(hint):
        return _build(cast(type[Any], hint), value, where)
    if typing.get_origin(hint) is Literal and value not in typing.get_args(hint):
        raise ValueError(f"`{where}` is {value!r}; expected one of {', '.join(map(str, typing.get_args(hint)))}")
    if hint is Array:
        return _number(np.reshape(value, (-1, 2)) if where.startswith("mission.") else value)
    origin = typing.get_origin(hint)
    if origin is dict:
        return {name: _number(entry) for name, entry in value.items()}
    if origin is tuple:
        return tuple(tuple(entry) if isinstance(entry, list) else entry for entry in value)
    return hint(value) if hint in (int, float) else value


def _number(value: Any) -> Array:
    """Double precision, and no weak type: a second flight must not compile again."""
    return cast(Array, np.asarray(value, dtype=np.float64))

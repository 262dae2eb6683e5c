"""A flight's configuration as typed pytrees, field for field what the Rust crate reads.

Numbers are leaves, so gains, weights, coefficients or winds can be batched and differentiated; names and switches are
static. `flight_config` builds them from what `jax_aero.reference.load_config` returns, which has checked every value;
here unknown and missing keys are refused once more, so that no setting is ever silently ignored.

>>> from jax_aero import reference
>>> config = flight_config(reference.load_config("configs/experiments/test2.toml"))
>>> float(config.controller.momentum.c0)
50.0
"""

from __future__ import annotations

import types
import typing
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, Literal, TypeAlias, TypeVar, cast

import numpy as np

from jax_aero.types import Array, Static, pytree

T = TypeVar("T")

LeverArm: TypeAlias = Literal["rotated", "unrotated"]
"""Where a link's force acts when its moment is formed: `p + R c`, or as published `p + c`."""
JacobianOffset: TypeAlias = Literal["link_rotation", "base_rotation"]
"""Which point's Jacobian carries a link's force: `p + R c`, or as published `p + R_B c`."""
LinkVelocity: TypeAlias = Literal["at_centre", "shifted_twice"]
"""Which point's velocity makes the relative wind: the centre, or as published the Jacobian's point shifted again."""


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


AeroConfig: TypeAlias = Off | AxisymmetricConfig | SphereCylinderConfig
"""Which aerodynamic model, and its numbers: one file of `configs/aero/`."""


@pytree
class ForceFactorsConfig:
    """Factors on the forces of a model: coefficients that are not what they are thought to be."""

    drag: Array
    """() on the part along the air."""
    normal: Array
    """() on the part across it."""
    links: dict[str, Array]
    """() on the whole force of a link, by its name."""


# --- jets --------------------------------------------------------------------------------------------------------


@pytree
class Ideal:
    """Thrust is the integral of the commanded rate."""


@pytree
class EkfConfig:
    """Numbers of the thrust estimator, in the letters of its equations."""

    init_p: Array
    """(2, 2) covariance of the initial state."""
    q: Array
    """(2, 2) intensity of the process noise."""
    r: Array
    """() intensity of the measurement noise."""
    init_state: Array | None = None
    """(2,) initial (T, Ṫ) [N, N/s]; without it (initial thrust, 0)."""


@pytree
class SecondOrderConfig:
    """Identified second-order engines behind a throttle loop."""

    rate_gain_p: Array
    """[1/s]"""
    rate_gain_i: Array
    """[1/s²]"""
    ekf: EkfConfig
    feedback: Static[Literal["measured", "estimated"]]
    """Which thrust the flight controller is given."""
    engines: Static[tuple[str, ...] | None] = None
    """Engine of each jet; without it, those of the robot."""


JetsConfig: TypeAlias = Ideal | SecondOrderConfig


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


WindConfig: TypeAlias = ConstantWind | RampWind | GustWind | RecordedWind


# --- controller --------------------------------------------------------------------------------------------------


@pytree
class AeroFeedback:
    """Where the estimated aerodynamic forces enter the controller; each can be left out."""

    momentum_rate: Static[bool]
    """`A_a f_a` in the estimated momentum rate."""
    lambda_a: Static[bool]
    """`Λ_a` in the derivative of the momentum rate."""
    torque: Static[bool]
    """`J_aᵀ f_a` in the torque law."""
    scale: Array
    """() factor on all estimated forces."""


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
    joint_velocity_max_deg: Array
    """() [deg/s]."""
    joint_steepness: Array
    """() [1/rad]."""


@pytree
class TorqueConfig:
    """The joint torque controller; every field is a scalar."""

    kd: Array
    """[1/s]"""
    kp: Array
    """[1/s²]"""
    weight_acceleration: Array
    weight_torque: Array
    regularisation: Array
    torque_max: Array
    """[N m]"""
    torque_rate_max: Array
    """[N m/s]"""


@pytree
class QpConfig:
    """How the Rust crate solves its QPs; this floor has one solver."""

    solver: Static[Literal["active_set", "clarabel"]]
    fallback: Static[Literal["clarabel", "hold"]]


@pytree
class ReferenceConfig:
    """Steps, limits and smoothing times of the reference generator."""

    step_position: Array
    """(2,) forward and vertical step per tick [m]."""
    step_attitude_deg: Array
    """(2,) pitch and yaw step per tick [deg]."""
    pitch_limits_deg: Array
    """(2,) [deg]."""
    turbo_boost: Array
    """() the forward step grows to `1 + turbo_boost` times itself."""
    turbo_ramp: Array
    """() growth of the boost per tick."""
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

    mass_scale: Array
    """() factor on all masses and inertias."""
    com_offset: Array
    """(3,) added to the base body's centre of mass [m, base axes]."""


@pytree
class ControllerConfig:
    """Everything that makes a controller; one file in `configs/control/`."""

    aero: AeroConfig
    aero_feedback: AeroFeedback
    lever_arm: Static[LeverArm]
    jacobian_offset: Static[JacobianOffset]
    link_velocity: Static[LinkVelocity]
    momentum: MomentumGains
    posture_gain: dict[str, Array]
    """By joint group [1/s]."""
    weights: MomentumWeights
    bounds: BoundsConfig
    torque: TorqueConfig
    qp: QpConfig
    references: ReferenceConfig
    model_error: ModelError | None = None


@pytree
class EnvelopeConfig:
    """When the autopilot commands what: for each motion open intervals (k, 2) of time [s]."""

    up: Array
    down: Array
    forward: Array
    forward_turbo: Array
    pitch_up: Array
    yaw_left: Array


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
    base_velocity: Array
    """(6,) of the base origin and angular, inertial axes [m/s, rad/s]."""
    thrust: Array
    """(j,) [N]."""
    free_fall_tick: Static[bool]
    """Whether the first physics step has neither thrust nor torque."""


@pytree
class FallConfig:
    """When a flight counts as lost."""

    rotation_error_deg: Array
    """() [deg]."""
    com_error: Array
    """() [m]."""


@pytree
class SimulatorConfig:
    """The world the robot flies in."""

    duration: Static[float]
    """[s]"""
    time_step: Static[float]
    """Tick of controller and physics [s]."""
    substeps: Static[int]
    """Physics steps within a tick."""
    integrator: Static[Literal["semi_implicit_euler", "explicit_euler"]]
    aero: AeroConfig
    lever_arm: Static[LeverArm]
    kinematics: Static[Literal["current", "frozen"]]
    """Which kinematics place the links in the wind."""
    jets: JetsConfig
    initial: InitialConfig
    fall: FallConfig
    aero_factors: ForceFactorsConfig | None = None

    @property
    def n_ticks(self) -> int:
        """Number of ticks after the one at time zero."""
        return int(np.floor(self.duration / self.time_step + 0.5))


@pytree
class FlightConfig:
    """One flight: which robot, in which simulator and wind, under which controller, on which envelope."""

    title: Static[str]
    description: Static[str]
    robot: Static[str]
    """Path of the robot's TOML file."""
    simulator: SimulatorConfig
    controller: ControllerConfig
    envelope: EnvelopeConfig
    wind: WindConfig
    engine: Static[Literal["rust", "jax"]] = "rust"
    """Which engine the experiment asks for; this one flies either."""


# --- from a resolved table ---------------------------------------------------------------------------------------


def flight_config(table: Mapping[str, Any]) -> FlightConfig:
    """Build a flight's configuration from a resolved table, as `reference.load_config` returns it.

    Raises
    ------
    ValueError
        Naming the key that is unknown or missing.
    """
    return _build(FlightConfig, table, "")


def aero_config(table: Mapping[str, Any]) -> AeroConfig:
    """Build an aerodynamic model's configuration from its table."""
    return cast(AeroConfig, _build_union(AeroConfig, table, "aero"))


# Tagged tables: the key that says which kind, and the type of each kind.
_KINDS: dict[str, dict[str, type]] = {
    "model": {"off": Off, "axisymmetric": AxisymmetricConfig, "sphere_cylinder": SphereCylinderConfig},
    "dynamics": {"ideal": Ideal, "second_order": SecondOrderConfig},
    "profile": {"constant": ConstantWind, "ramp": RampWind, "gust": GustWind, "file": RecordedWind},
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
    return _build(_KINDS[tag][str(kind)], rest, where)


def _recorded_wind(table: Mapping[str, Any], where: str) -> RecordedWind:
    if set(table) != {"path"}:
        raise ValueError(f"`{where}` of profile file has keys {sorted(table)}; expected only `path`")
    samples = np.loadtxt(table["path"], delimiter=",", skiprows=1, ndmin=2)
    return RecordedWind(times=_number(samples[:, 0]), velocities=_number(samples[:, 1:4]))


def _build(cls: type[T], table: Mapping[str, Any], where: str) -> T:
    assert is_dataclass(cls)
    hints = typing.get_type_hints(cls)
    keys = {_KEYS_IN_FILES.get((cls.__name__, item.name), item.name): item for item in fields(cls)}
    if unknown := set(table) - set(keys):
        listed = ", ".join(f"`{where}.{key}`".replace("`.", "`") for key in sorted(unknown))
        raise ValueError(f"this engine does not know {listed}")
    values = {}
    for key, item in keys.items():
        if key in table:
            values[item.name] = _value(hints[item.name], table[key], f"{where}.{key}".lstrip("."))
        elif item.default is MISSING:
            raise ValueError(f"`{where}.{key}` is missing".replace("`.", "`"))
    return cls(**values)


def _value(hint: Any, value: Any, where: str) -> Any:
    if hint in _TAGS:
        return _build_union(hint, value, where)
    if isinstance(hint, types.UnionType):  # `X | None`
        hint = next(option for option in typing.get_args(hint) if option is not type(None))
    if is_dataclass(hint):
        return _build(cast(type[Any], hint), value, where)
    if hint is Array:
        return _number(np.reshape(value, (-1, 2)) if where.startswith("envelope.") else value)
    origin = typing.get_origin(hint)
    if origin is dict:
        return {name: _number(entry) for name, entry in value.items()}
    if origin is tuple:
        return tuple(tuple(entry) if isinstance(entry, list) else entry for entry in value)
    return hint(value) if hint in (int, float) else value


def _number(value: Any) -> Array:
    """Double precision, and no weak type: a second flight must not compile again."""
    return cast(Array, np.asarray(value, dtype=np.float64))

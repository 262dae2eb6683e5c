"""Types of a flight's and a robot's configuration.

Made by `python -m experiments schema` from the crate's types: not to be edited.
"""

# ruff: noqa: D205, N815

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, TypeAlias

from msgspec import Meta, field

from jax_aero.tables import NonNegative, Positive, Table


class CylinderTables(Table, frozen=True, kw_only=True):
    """Measured drag coefficients of circular cylinders."""

    axial_drag: tuple[float, ...]
    """Drag coefficient along the axis, on the area `π d²/4`; only its ratio to its maximum counts."""
    crosswind_drag: tuple[float, ...]
    """Drag coefficient across the wind, infinite length, on the area `d l`."""
    diameter_over_length: tuple[float, ...]
    """Ratios diameter over length of `finite_length_drag`."""
    finite_length_drag: tuple[float, ...]
    """Drag coefficient across the wind of a finite cylinder; only its ratio to its maximum counts."""
    length_over_diameter: tuple[float, ...]
    """Ratios length over diameter of `axial_drag`."""
    reference_reynolds: Positive
    """Reynolds number, on the diameter, at which the axial coefficients count unscaled."""
    reynolds: tuple[float, ...]
    """Reynolds numbers of `crosswind_drag`."""


class SphereTables(Table, frozen=True, kw_only=True):
    """Measured drag coefficients of spheres, on the area `π d²/4`."""

    drag: tuple[float, ...]
    """Drag coefficient."""
    drag_below_reynolds_10: Positive
    """Drag coefficient below Reynolds number 10."""
    reynolds: tuple[float, ...]
    """Reynolds numbers of `drag`; between 10 and the first one a correlation is used."""


Precision: TypeAlias = Literal["f32", "f64"]
"""Precision of the weighted sums; everything around them is double.

f32: Single, as networks are trained.
f64: Double: the same weights widened, to compare implementations with.
"""


class OffAeroConfig(Table, frozen=True, kw_only=True, tag_field="model", tag="off"):
    """No aerodynamic force."""


class AxisymmetricAeroConfig(Table, frozen=True, kw_only=True, tag_field="model", tag="axisymmetric"):
    """Fitted force areas of axisymmetric links."""

    air_density: Positive
    """Density of the air [kg/m³]."""
    coefficients: str
    """Name of a coefficient set that every link of the robot has."""


class SphereCylinderAeroConfig(Table, frozen=True, kw_only=True, tag_field="model", tag="sphere_cylinder"):
    """Literature drag of spheres and finite cylinders."""

    air_density: Positive
    """Density of the air [kg/m³]."""
    cylinder: CylinderTables
    """Drag of circular cylinders."""
    dynamic_viscosity: Positive
    """Dynamic viscosity of the air [Pa s]."""
    sphere: SphereTables
    """Drag of spheres."""


class NetworkAeroConfig(Table, frozen=True, kw_only=True, tag_field="model", tag="network"):
    """A neural network of wind and posture."""

    air_density: Positive
    """Density of the air [kg/m³]."""
    card: Path
    """The network's JSON card; the weights lie beside it."""
    precision: Precision = "f32"
    """Precision of the weighted sums."""


AeroConfig: TypeAlias = OffAeroConfig | AxisymmetricAeroConfig | SphereCylinderAeroConfig | NetworkAeroConfig
"""Which aerodynamic model, and its numbers: one file of `configs/aero/`."""


RateFeedback: TypeAlias = Literal["wrench", "force", "moment", "none"]
"""What of the total aerodynamic wrench about the centre of mass the estimated momentum rate holds.

wrench: Force and moment.
force: The force alone.
moment: The moment alone.
none: Nothing.
"""


class AeroFeedback(Table, frozen=True, kw_only=True):
    """Where the estimated aerodynamic forces enter the controller; each can be left out for an ablation."""

    lambda_: bool = field(default=True, name="lambda")
    """Whether `Λ_a` enters the derivative of the momentum rate."""
    momentum_rate: RateFeedback = "wrench"
    """What of `A_a f_a` enters the estimated momentum rate."""
    torque: bool = True
    """Whether `J_aᵀ f_a` enters the torque law."""


AeroKinematics: TypeAlias = Literal["current", "frozen"]
"""Which kinematics place the links in the wind.

current: Those of the robot now.
frozen: Those of the first tick for the whole flight (published): axes, points and Jacobians stay, only velocities
are current.
"""


class BoundsConfig(Table, frozen=True, kw_only=True):
    """Bounds of the momentum QP: rates fade out, as a tanh, where the value meets its own limit."""

    joint_steepness: Positive
    """Steepness at the joint limits [1/rad, 1/m]."""
    joint_velocity_max_deg: Positive | None = None
    """Greatest velocity of revolute joints in place of the robot's own limits [deg/s]."""
    thrust_rate_max: dict[str, float]
    """Greatest thrust rate, by jet [N/s]."""
    thrust_steepness: Positive
    """Steepness at the thrust limits [1/N]."""


class ChannelConfig(Table, frozen=True, kw_only=True):
    """One kind of measurement."""

    delay: Annotated[float, Meta(ge=0, le=0.2)] = 0.0
    """Age of the measurement when it comes, rounded to ticks [s]."""
    time_constant: NonNegative = 0.0
    """Time in which the estimate follows it [s]; zero takes it as it comes."""


class Greatest(Table, frozen=True, kw_only=True):
    """Greatest values that are accepted; by default those of a simulated flight that has not diverged."""

    angular_velocity: Positive = 100.0
    """Angular velocity of the base [rad/s]."""
    foot_force: Positive = 100000.0
    """Force on a foot [N]."""
    foot_moment: Positive = 100000.0
    """Moment on a foot [N m]."""
    joint_position: Positive = 100.0
    """Joint position [rad, m]."""
    joint_velocity: Positive = 100.0
    """Joint velocity [rad/s, m/s]."""
    position: Positive = 1000000.0
    """Position of the base [m]."""
    thrust: Positive = 10.0
    """Thrust, as a multiple of the jet's greatest."""
    velocity: Positive = 300.0
    """Velocity of the base [m/s]."""
    wind: Positive = 300.0
    """Wind [m/s]."""


class Jumps(Table, frozen=True, kw_only=True):
    """Greatest differences to the predicted value that are accepted. Wind, thrusts and feet may jump."""

    angular_velocity: Positive = 2.0
    """Angular velocity of the base [rad/s]."""
    joint_position: Positive = 0.5
    """Joint position [rad, m]."""
    joint_velocity: Positive = 30.0
    """Joint velocity [rad/s, m/s]."""
    position: Positive = 0.3
    """Position of the base [m]."""
    rotation: Positive = 0.2
    """Entry of the rotation matrix of the base."""
    velocity: Positive = 1.0
    """Velocity of the base [m/s]."""


class ChannelsConfig(Table, frozen=True, kw_only=True):
    """Which measurements are accepted, and what happens without them."""

    descend_after: NonNegative = 3.0
    """Age of a channel of joints or base from which on the robot levels and descends, and does so to the end [s]."""
    frozen_ticks: Annotated[int, Meta(ge=1, le=100000)] = 5
    """Number of ticks with the same bits after which a value can be frozen."""
    greatest: Greatest = Greatest()
    """Greatest values that are accepted, of each component."""
    jump: Jumps | None = None
    """Greatest differences to the predicted value that are accepted, of each component; without it all of them, and no
    value counts as frozen and no time step as wrong.
    """
    velocity_gain: NonNegative = 100.0
    """Gain with which a base velocity that is not measured follows the differences of the pose [1/s]."""
    widening: NonNegative = 1.0
    """Growth of `jump` with the age of a channel, as a share of itself [1/s]."""
    wind_fade: Positive = 2.0
    """Time in which it then fades to zero [s]."""
    wind_hold: NonNegative = 1.0
    """How long the last wind is held [s]."""


class LoadTransfer(Table, frozen=True, kw_only=True):
    """How load passes between feet and jets. A robot whose feet carry takes off towards a set-point above its centre
    of mass: the feet are relieved. Otherwise, and on its way down, it stands: the jets are relieved.
    """

    gain: Positive
    """Gain with which the load of feet or jets falls [1/s]."""
    height: Positive
    """Height of the set-point above the centre of mass beyond which the robot takes off; a robot that stands has its
    set-point at most as far below [m].
    """
    hold_time: NonNegative
    """Time for which feet of a robot that stands may lose contact and still count as carrying [s]."""
    measured_gain: NonNegative
    """Gain with which `f_c*` of a robot that stands follows the measured wrenches [1/s]."""
    unmodelled_force_max: Positive | None = None
    """Greatest vertical force on the robot that the controller's model may leave unexplained [N]: beyond it measured
    wrenches of the feet are wrong, and feet in the air carry if the set-point is below the centre of mass by
    `height`. Needs `controller.observer`; without it foot sensors are believed, and feet that are not measured do
    not begin to carry.
    """


class WrenchLimits(Table, frozen=True, kw_only=True):
    """What the wrench of every foot may be, in sole axes about the sole's origin."""

    centre_of_pressure_margin: float = 0.0
    """How far the centre of pressure stays inside the extent of the sole's corners [m]; the published one may be
    outside, where it is negative.
    """
    friction: Positive
    """Friction `|f_xy| ≤ μ f_z`, as the regular polygon of twelve corners inside the circle."""
    torsional_friction: NonNegative
    """Torsion `|m_z| ≤ κ f_z` [m]."""
    vertical_force_min: NonNegative
    """Least vertical force [N]."""


class ContactConfig(Table, frozen=True, kw_only=True):
    """What a controller needs to stand; without it, it flies."""

    feet: tuple[str, ...]
    """Names of the feet to stand on; the robot's other feet are no contacts."""
    force_rate_dead_zone: NonNegative
    """Rates below this are not integrated [N/s, N m/s]."""
    force_rate_max: Positive
    """Greatest rate of every component of `f_c*` [N/s, N m/s]."""
    load_transfer: LoadTransfer | None = None
    """How the robot takes off and lands; without it, it stays where it is."""
    start_with_moment: bool
    """Whether `f_c*` starts with the measured moment about y besides the vertical force."""
    vertical_force_min: Positive
    """Vertical force beyond which a foot carries [N]; all of `feet` have to."""
    weight_foot_acceleration: NonNegative
    """Weight of `J_c ν̇ + J̇_c ν = 0` in the torque QP."""
    weight_foot_velocity: NonNegative
    """Weight of `J_c ν = 0` in the momentum QP."""
    weight_force: NonNegative
    """Weight of `f_c → f_c*` in the torque QP."""
    weight_force_rate: NonNegative
    """Weight of `ḟ_c → 0` in the momentum QP."""
    wrench: WrenchLimits
    """What the wrench of a foot may be."""


class MomentumGains(Table, frozen=True, kw_only=True):
    """Gains of the momentum task (M57 of `docs/model.md`) and the attitude task (M60)."""

    c0: NonNegative
    """`c₀` of the attitude task [N m]."""
    c1: NonNegative
    """`c₁` of the attitude task [N m s]."""
    kd_linear: tuple[NonNegative, NonNegative, NonNegative]
    """`K_D` on the linear momentum error, per axis [1/s]."""
    ko: Positive
    """`K_O`; its inverse is added to `K_P + K_D` [s]."""
    kp_linear: tuple[NonNegative, NonNegative, NonNegative]
    """`K_P` on the integral of the linear momentum error, per axis [1/s²]."""


class DescentConfig(Table, frozen=True, kw_only=True):
    """The law of a robot that has lost an engine: the attitude first, no place to hold, and fast joints."""

    joint_velocity_max_deg: Positive
    """Greatest joint velocity, of revolute joints whose own is less [deg/s]."""
    momentum: MomentumGains
    """Gains in place of `controller.momentum`."""
    range_share_min: Positive
    """An engine is lost whose least and greatest thrust are closer together than this share of the jet's greatest."""
    torque_rate_max: Positive
    """Greatest rate of a joint torque, of revolute joints whose own is less [N m/s]."""


class EnginesConfig(Table, frozen=True, kw_only=True):
    """When an engine does not reach its thrust, and when it counts as lost."""

    confirmation: NonNegative
    """How long it has to be exceeded [s]."""
    descent: DescentConfig | None = None
    """How the robot levels and descends when an engine is lost; without it the mission goes on."""
    deviation_max: Positive
    """Greatest deviation of a thrust from the commanded one [N]."""
    time_constant: Positive
    """Time constant with which deviations of the thrust are forgotten [s]."""


class EstimatorConfig(Table, frozen=True, kw_only=True):
    """How old the measurements are, and how much they count."""

    base_angular_velocity: ChannelConfig = ChannelConfig()
    """Gyroscopes."""
    base_linear_velocity: ChannelConfig = ChannelConfig()
    """Velocity of the base origin."""
    base_position: ChannelConfig = ChannelConfig()
    """Position of the base origin."""
    base_rotation: ChannelConfig = ChannelConfig()
    """Rotation of the base."""
    joint_observer: Positive | None = None
    """Time constant of an observer that finds velocities of the joints, and accelerations that the model does not
    explain, from their positions alone [s], in place of `joint_velocity` and the time constant of `joint_position`.
    Joint velocities then need not be measured.
    """
    joint_position: ChannelConfig = ChannelConfig()
    """Joint positions."""
    joint_velocity: ChannelConfig = ChannelConfig()
    """Joint velocities."""
    thrust: ChannelConfig = ChannelConfig()
    """Thrusts."""


JacobianOffset: TypeAlias = Literal["link_rotation", "base_rotation"]
"""Which point's Jacobian carries a link's force in the controller's `Λ_a` and torque law.

link_rotation: The aerodynamic centre, `p + R c`.
base_rotation: `p + R_B c`: the offset is turned with the base instead of the link (published).
"""


LeverArm: TypeAlias = Literal["rotated", "unrotated"]
"""Where a link's force acts when its moment is formed.

rotated: At the aerodynamic centre, `p + R c`.
unrotated: At `p + c`: the offset is added without turning it into inertial axes (published).
"""


LinkVelocity: TypeAlias = Literal["at_centre", "shifted_twice"]
"""Which point's velocity the controller takes for the link's own motion through the air.

at_centre: The aerodynamic centre.
shifted_twice: The point of `JacobianOffset` shifted once more by the unrotated offset (published).
"""


class ObserverConfig(Table, frozen=True, kw_only=True):
    """How fast the observer follows, and the greatest wrench that it estimates."""

    force_max: NonNegative
    """Greatest observed force along each axis [N]."""
    gain_force: NonNegative
    """`K_o` of the force [1/s]."""
    gain_moment: NonNegative
    """`K_o` of the moment [1/s]."""
    moment_max: NonNegative
    """Greatest observed moment about each axis [N m]."""


Fallback: TypeAlias = Literal["hold", "clarabel"]
"""What happens when the first solver gives no certified answer.

hold: Thrusts and joints stop, torques stay. Nothing allocates.
clarabel: Clarabel (allocates); hold if it fails too.
"""


Solver: TypeAlias = Literal["active_set", "clarabel"]
"""Which solver answers first.

active_set: The active-set methods: no allocation, a few microseconds.
clarabel: Clarabel: allocates, hundreds of microseconds.
"""


class QpConfig(Table, frozen=True, kw_only=True):
    """How QPs are solved."""

    fallback: Fallback = "hold"
    """What to do without an answer."""
    solver: Solver = "active_set"
    """The solver of every tick."""


class SetpointConfig(Table, frozen=True, kw_only=True):
    """Speeds, limits and smoothing times of the set-point generator."""

    acceleration_smoothing: Positive
    """Smoothing time of the filter whose rate output is the jerk [s]."""
    angular_velocity_smoothing: Positive
    """Smoothing time of the angular velocity [s]."""
    attitude_gain: NonNegative
    """Gain with which the smoothed attitude follows the raw one [1/s]."""
    attitude_rate_deg: tuple[NonNegative, NonNegative]
    """Rates of raw pitch and yaw [deg/s]."""
    deceleration: Positive = 1.5
    """Deceleration with which the velocity becomes that of the descent, or zero without a valid set-point [m/s²]."""
    descent_speed: NonNegative = 0.5
    """Speed of the descent where the mission cannot be followed any more [m/s]."""
    nose_down_limits_deg: tuple[float, float]
    """Least and greatest raw pitch, positive nose down [deg]."""
    position_smoothing: Positive
    """Smoothing time of the position [s]."""
    speed: tuple[NonNegative, NonNegative]
    """Forward and vertical speed of the raw position [m/s]."""
    turbo_boost: NonNegative
    """The forward speed grows to `1 + turbo_boost` times itself."""
    turbo_rate: Positive
    """Growth of the boost [1/s]."""


class TorqueConfig(Table, frozen=True, kw_only=True):
    """The joint torque controller."""

    kd: NonNegative
    """`K_Ds` on the joint velocity error [1/s]."""
    kp: NonNegative
    """`K_Ps` on the integral of the joint velocity error [1/s²]."""
    regularisation: Positive
    """Added to the diagonal of the Hessian."""
    torque_max: Positive | None = None
    """Greatest torque of revolute joints in place of the robot's own limits [N m]."""
    torque_rate_max: Positive | None = None
    """Greatest rate of the torque of revolute joints in place of the robot's own limits [N m/s]."""
    weight_acceleration: NonNegative
    """Weight of the joint acceleration task."""
    weight_torque: NonNegative
    """Weight of the torques."""


class MomentumWeights(Table, frozen=True, kw_only=True):
    """Weights of the tasks in the momentum QP."""

    angular_momentum: NonNegative
    """Angular-momentum constraint task."""
    joint_velocity: NonNegative
    """Joint velocities towards zero."""
    momentum: NonNegative
    """Momentum and attitude tasks."""
    posture: NonNegative
    """Posture task."""
    regularisation: Positive
    """Added to the diagonal of the Hessian."""
    symmetric_jets: tuple[tuple[str, str], ...]
    """Pairs of jets meant to act alike."""
    symmetry: NonNegative
    """Equal thrust rates within each pair of `symmetric_jets`."""
    thrust_rate: dict[str, float]
    """Thrust rates towards zero, by jet."""


class WindObserverConfig(Table, frozen=True, kw_only=True):
    """How the wind is estimated."""

    force_noise: tuple[Positive, Positive, Positive] = (0.3, 0.3, 4.0)
    """Standard deviation of the noise of the observed force, by axis [N]."""
    force_std: NonNegative = 0.1
    """Standard deviation of errors of the force that last: of mass, thrusts and attitude [N]."""
    gain: Positive = 10.0
    """How fast the acting force is observed, `K_o` [1/s]."""
    moment_arm: Positive = 0.25
    """Lever arm of the model's errors: over it the moment that the model does not explain is a force that it does not
    explain either [m].
    """
    relative_std: NonNegative = 0.045
    """The same of the model's force, as a fraction of the observed one."""
    vertical_std: Positive = 1.0
    """Standard deviation of vertical winds [m/s]."""
    vertical_time: Positive = 2.0
    """Time over which vertical winds are like themselves [s]."""
    walk: Positive = 0.6
    """How fast a horizontal wind changes: standard deviation after one second [m/s]."""


class ControllerSection(Table, frozen=True, kw_only=True):
    """One file of `configs/control/`."""

    aero: AeroConfig
    """The controller's own aerodynamic model; `off` is the baseline controller."""
    aero_feedback: AeroFeedback = AeroFeedback()
    """Where the aerodynamic estimate enters."""
    bounds: BoundsConfig
    """Bounds of the momentum QP."""
    channels: ChannelsConfig = ChannelsConfig()
    """Which measurements are accepted, and what happens without them."""
    contact: ContactConfig | None = None
    """What it takes to stand on the ground; without it the controller has no feet."""
    engines: EnginesConfig | None = None
    """When an engine counts as lost; without it, never."""
    estimator: EstimatorConfig | None = None
    """Estimates the state from what is measured; without it the law is given the measurements."""
    jacobian_offset: JacobianOffset = "link_rotation"
    """Point whose Jacobian carries link forces (in `Λ_a` and the torque law)."""
    lever_arm: LeverArm = "rotated"
    """Point at which moments of link forces are formed (in `A_a`)."""
    link_velocity: LinkVelocity = "at_centre"
    """Point whose velocity makes the relative wind."""
    momentum: MomentumGains
    """Gains of the momentum and attitude tasks."""
    observer: ObserverConfig | None = None
    """What observes the wrench that is in no model; without it there is none."""
    posture_gain: dict[str, float]
    """Posture gain `K_s` by joint group [1/s]."""
    qp: QpConfig = QpConfig()
    """How QPs are solved."""
    setpoint: SetpointConfig
    """Set-point generation."""
    torque: TorqueConfig
    """The joint torque controller."""
    use_jets: bool = True
    """Whether thrusts are known of and asked for."""
    weights: MomentumWeights
    """Weights of the momentum QP."""
    wind_observer: WindObserverConfig | None = None
    """Estimates the wind from the force that acts on the robot; without it the law is given the measured wind."""


class ForceFactorsConfig(Table, frozen=True, kw_only=True):
    """Factors on the force of every link; all one unless said otherwise."""

    drag: float = 1.0
    """Factor on the part along the air's velocity relative to the link."""
    links: dict[str, float] = field(default_factory=dict)
    """Factor on the whole force of a link, by its name; links that are not named keep theirs."""
    normal: float = 1.0
    """Factor on the part across it."""
    scale: float = 1.0
    """Factor on all forces."""


class ConstantWindConfig(Table, frozen=True, kw_only=True, tag_field="profile", tag="constant"):
    """The same all the time."""

    velocity: tuple[float, float, float]
    """Velocity of the air [m/s]."""


class RampWindConfig(Table, frozen=True, kw_only=True, tag_field="profile", tag="ramp"):
    """Still, then rising linearly to a constant: the published profile."""

    ramp_end: float
    """When it has risen [s]."""
    ramp_start: float
    """When the wind starts to rise [s]."""
    velocity: tuple[float, float, float]
    """Velocity after the ramp [m/s]."""


class GustWindConfig(Table, frozen=True, kw_only=True, tag_field="profile", tag="gust"):
    """A steady wind with one "1 − cos" gust on top."""

    duration: Positive
    """How long it lasts [s]."""
    gust: tuple[float, float, float]
    """Velocity added at the peak of the gust [m/s]."""
    start: float
    """When the gust begins [s]."""
    velocity: tuple[float, float, float]
    """Steady velocity [m/s]."""


class TurbulentWindConfig(Table, frozen=True, kw_only=True, tag_field="profile", tag="turbulent"):
    """The published profile with turbulence on top, which rises with it."""

    ramp_end: float
    """When it has risen [s]."""
    ramp_start: float
    """When the wind starts to rise [s]."""
    seed: Annotated[int, Meta(ge=0)] = 0
    """Seed of the turbulence."""
    std: tuple[NonNegative, NonNegative, NonNegative]
    """Standard deviation of the turbulence on each axis [m/s]."""
    time_scale: Positive
    """Time scale of the turbulence [s]."""
    velocity: tuple[float, float, float]
    """Mean velocity after the ramp [m/s]."""


class FileWindConfig(Table, frozen=True, kw_only=True, tag_field="profile", tag="file"):
    """A recorded wind: a CSV file with header `time,x,y,z`, linear in between, constant outside."""

    path: Path
    """The file; relative paths start at the configuration file."""


class SamplesWindConfig(Table, frozen=True, kw_only=True, tag_field="profile", tag="samples"):
    """A recorded wind that stands here: linear in between, constant outside."""

    samples: tuple[tuple[float, float, float, float], ...]
    """Time [s], increasing, and velocity along x, y and z [m/s]."""


WindConfig: TypeAlias = (
    ConstantWindConfig | RampWindConfig | GustWindConfig | TurbulentWindConfig | FileWindConfig | SamplesWindConfig
)
"""A wind profile; all velocities in m/s, inertial axes, all times in s."""


FailureKind: TypeAlias = Literal["off", "stuck"]
"""What a failed jet does.

off: Its thrust goes.
stuck: Its thrust stays where it is.
"""


class JetFailure(Table, frozen=True, kw_only=True):
    """A jet that no longer follows its command."""

    decay: NonNegative = 0.0
    """Time constant with which a jet that is off loses its thrust [s]; zero for at once."""
    jet: str
    """Name of the jet."""
    kind: FailureKind
    """How."""
    time: NonNegative
    """When it fails [s]."""


class MeasurementNoise(Table, frozen=True, kw_only=True):
    """White noise on measured thrusts."""

    seed: Annotated[int, Meta(ge=0)] = 0
    """Seed."""
    std: NonNegative
    """Standard deviation [N]."""


class JetFaultsConfig(Table, frozen=True, kw_only=True):
    """Faults of the jets; none by default."""

    failure: JetFailure | None = None
    """One jet that fails."""
    force_scale: dict[str, float] = field(default_factory=dict)
    """Force that a jet exerts, over the thrust that it seems to have, by its name; jets that are not named exert their
    thrust.
    """
    lag: NonNegative = 0.0
    """Time constant with which the commanded thrust rate takes effect [s]; zero for at once."""
    limit_is_known: bool = False
    """Whether the controller's own limits are scaled as well, by `thrust_limit_scale`."""
    measurement_noise: MeasurementNoise | None = None
    """Noise on the thrust that the estimators of second-order jets measure."""
    thrust_limit_scale: Positive | None = None
    """Thrust stays below this times the robot's greatest thrust; without it nothing but the controller limits it, as
    published.
    """


class ModelError(Table, frozen=True, kw_only=True):
    """How the controller's robot differs from the one that flies; not at all by default."""

    com_offset: tuple[
        Annotated[float, Meta(ge=-10, le=10)],
        Annotated[float, Meta(ge=-10, le=10)],
        Annotated[float, Meta(ge=-10, le=10)],
    ] = (0.0, 0.0, 0.0)
    """Added to the base body's centre of mass in the controller's robot [m, base axes]."""
    mass_scale: Annotated[float, Meta(ge=0.01, le=100)] = 1.0
    """Factor on all masses and inertias of the controller's robot."""


OutageChannel: TypeAlias = Literal["wind", "thrust", "joints", "base_position", "base_rotation", "base_velocity"]
"""What is not measured.

wind: Velocity of the air.
thrust: Thrust of one jet or of all.
joints: Positions and velocities of all joints.
base_position: Position of the base.
base_rotation: Rotation of the base.
base_velocity: Velocity of the base, linear and angular.
"""


OutageKind: TypeAlias = Literal["missing", "nan", "frozen", "wrong"]
"""What is measured instead.

missing: Nothing: every component is NaN.
nan: The first component is NaN.
frozen: What was measured when it began.
wrong: Something else, by `error`.
"""


class Outage(Table, frozen=True, kw_only=True):
    """A channel that fails for a while."""

    channel: OutageChannel
    """What is not measured."""
    duration: Positive | None = None
    """How long it lasts [s]; without it, for ever."""
    error: float = 1.0
    """Of a wrong value: added to every component, or the angle by which a rotation is turned about inertial x [the
    channel's units].
    """
    jet: str | None = None
    """Name of the jet whose thrust it is; without it, of all jets."""
    kind: OutageKind
    """What is measured instead."""
    start: Positive
    """When it begins [s]; a flight begins with everything measured."""


class WindEstimateConfig(Table, frozen=True, kw_only=True):
    """Errors of the wind estimate; none by default."""

    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Added to the wind [m/s, inertial axes]."""
    delay: Annotated[float, Meta(ge=0, le=1000)] = 0.0
    """Age of the wind that is given, rounded to ticks [s]."""
    mean_only: bool = False
    """Whether only the mean over the flight is given."""
    noise_std: NonNegative = 0.0
    """Standard deviation of white noise on every axis, drawn anew each tick [m/s]."""
    seed: Annotated[int, Meta(ge=0)] = 0
    """Seed of the noise."""
    time_constant: NonNegative = 0.0
    """Time constant of a first-order low pass behind all other errors [s]; zero for none."""


class Disturbances(Table, frozen=True, kw_only=True):
    """Disturbances of a flight; none by default."""

    aero: ForceFactorsConfig = ForceFactorsConfig()
    """Factors on the simulated aerodynamic forces: coefficients that are not what they are thought to be."""
    aero_estimate: ForceFactorsConfig = ForceFactorsConfig()
    """Factors on the forces that the controller estimates: information that is wrong or left out."""
    controller_wind: WindConfig | None = None
    """A wind that the controller is given in place of the one that blows."""
    jets: JetFaultsConfig = JetFaultsConfig()
    """What is wrong with the jets."""
    model_error: ModelError = ModelError()
    """How the controller's robot differs from the one that flies."""
    outages: tuple[Outage, ...] = ()
    """Measurements that fail to reach the controller, or reach it wrong."""
    wind_estimate: WindEstimateConfig | None = None
    """Errors of the wind that the controller is given; without them it is the true one."""


class DivergenceConfig(Table, frozen=True, kw_only=True):
    """What physics excludes: a flight whose numbers go beyond has diverged. A state that is not finite always has."""

    angular_velocity: Positive = 100.0
    """Angular velocity of the base [rad/s]; by default 16 turns a second."""
    joint_excess: Positive = 6.0
    """How far a joint is beyond its stops [rad, m]; by default about a turn."""
    joint_velocity: Positive = 100.0
    """Velocity of a joint [rad/s, m/s]; by default ten times what motors of such robots do."""
    speed: Positive = 300.0
    """Speed of base and air [m/s]; by default near that of sound, where no aerodynamic model here holds."""
    thrust_ratio: Positive = 10.0
    """Thrust as a multiple of the jet's greatest."""


DynamicsBackend: TypeAlias = Literal["tree", "mjx"]
"""What computes mass matrix and bias.

tree: The tree of bodies of this project.
mjx: MuJoCo's JAX implementation, for `engine = "jax"` alone.
"""


class EkfConfig(Table, frozen=True, kw_only=True):
    """Numbers of the estimator, in the letters of its equations; the defaults are the published ones, but for the
    initial state.
    """

    Q: tuple[tuple[float, float], tuple[float, float]] = ((10.0, 1.0), (1.0, 10.0))
    """`Q`: intensity of the process noise."""
    R: Positive = 1.0
    """`R`: intensity of the measurement noise."""
    init_P: tuple[tuple[float, float], tuple[float, float]] = ((1.0, 0.1), (0.1, 1.0))
    """`P(0)`: covariance of the initial state."""
    init_state: tuple[float, float] | None = None
    """`x̂(0) = (T, Ṫ)` [N, N/s]; without it `(initial thrust, 0)`. The published value is (0, 0), which makes the
    throttle loop act on too small a thrust for the first two seconds.
    """


class EncoderConfig(Table, frozen=True, kw_only=True):
    """Encoders of the joints."""

    delay: Annotated[float, Meta(ge=0, le=1)] = 0.0
    """Age of what is measured, rounded to ticks [s]."""
    resolution: NonNegative = 0.0
    """Step of the positions [rad, m]; zero for none."""
    velocity_time_constant: NonNegative | None = None
    """Velocities are differences of positions behind a first-order low pass of this time constant [s]; without it they
    are measured as such.
    """


Engine: TypeAlias = Literal["rust", "jax", "mujoco"]
"""The program that simulates a configuration.

rust: This crate.
jax: The batched, differentiable simulation in Python.
mujoco: MuJoCo, in Python: the one with a ground.
"""


class FallConfig(Table, frozen=True, kw_only=True):
    """When a robot counts as fallen."""

    com_error: Positive
    """Greatest distance between centre of mass and set-point [m]."""
    rotation_error_deg: Annotated[float, Meta(gt=0, le=180)]
    """Greatest rotation between base and set-point [deg]."""


class LegOdometryConfig(Table, frozen=True, kw_only=True):
    """The state of a standing robot as its legs measure it: the pose of the base from the first of the controller's
    feet, its velocity from all of them, as if they stayed where they are.
    """

    velocity_time_constant: NonNegative
    """Time constant of the first-order low pass of the joint velocities that the controller gets [s]."""


class GroundConfig(Table, frozen=True, kw_only=True):
    """The plane z = 0 under the robot's feet. Only engines that simulate contact fly a world that has it."""

    contact_time: Positive
    """Time in which a touching corner comes to rest [s]: softer with a longer one."""
    friction: Positive
    """Coulomb friction of soles on the ground."""
    leg_odometry: LegOdometryConfig | None = None
    """How the robot measures its own state while it stands; without it the state is measured as it is."""
    settling: NonNegative
    """How long stiff joints hold the initial posture before the controller takes over at time zero [s]."""


class InitialConfig(Table, frozen=True, kw_only=True):
    """State at the beginning of a flight."""

    base_position: tuple[float, float, float]
    """Position of the base origin [m]."""
    base_rpy_deg: tuple[float, float, float]
    """Roll, pitch, yaw of the base [deg]."""
    base_velocity: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """Velocity of the base origin, then angular velocity, inertial axes [m/s, rad/s]."""
    free_fall_tick: bool = False
    """Whether the first physics step has neither thrust nor torque, as the delays of the published model make it: the
    controller first gets a robot that has fallen for one tick.
    """
    joint_position: tuple[float, ...]
    """Joint positions in the robot's order [rad]."""
    thrust: tuple[NonNegative, ...]
    """Thrusts in the robot's order, each at most the jet's greatest [N]."""


Integrator: TypeAlias = Literal["semi_implicit_euler", "explicit_euler"]
"""How a physics step is taken.

semi_implicit_euler: Velocity first, pose with the new velocity: feeds no energy into fast joint motion.
explicit_euler: Pose and velocity both advance with the old velocity and acceleration (published).
"""


ThrustFeedback: TypeAlias = Literal["measured", "estimated"]
"""Which thrust the flight controller gets.

measured: The true thrust, without noise.
estimated: The estimate of the `ThrustEkf`.
"""


class IdealJetsConfig(Table, frozen=True, kw_only=True, tag_field="dynamics", tag="ideal"):
    """Thrust is the integral of the command."""


class SecondOrderJetsConfig(Table, frozen=True, kw_only=True, tag_field="dynamics", tag="second_order"):
    """Identified second-order engines behind a throttle loop."""

    ekf: EkfConfig = EkfConfig()
    """The thrust estimator."""
    engines: tuple[str, ...] | None = None
    """Engine of each jet, by name; without it, those of the robot."""
    feedback: ThrustFeedback = "measured"
    """What the flight controller is given as thrust; the throttle loop always uses the estimate."""
    rate_gain_i: NonNegative = 0.0
    """Integral gain of the thrust-rate loop [1/s²]."""
    rate_gain_p: NonNegative = 150.0
    """Proportional gain of the thrust-rate loop [1/s]."""


JetsConfig: TypeAlias = IdealJetsConfig | SecondOrderJetsConfig
"""How thrust follows the commanded thrust rate."""


class MissionConfig(Table, frozen=True, kw_only=True):
    """One file of `configs/mission/`: commands, or the file of a recorded reference."""

    down: tuple[tuple[float, float], ...] = ()
    """Descend [s]."""
    file: Path | None = None
    """A recorded reference to fly instead of any command. Relative paths start at the configuration file."""
    forward: tuple[tuple[float, float], ...] = ()
    """Fly forwards at the plain speed [s]."""
    forward_turbo: tuple[tuple[float, float], ...] = ()
    """Fly forwards with boosted speed, nose down [s]."""
    pitch_up: tuple[tuple[float, float], ...] = ()
    """Raise the nose [s]."""
    up: tuple[tuple[float, float], ...] = ()
    """Climb [s]."""
    yaw_left: tuple[tuple[float, float], ...] = ()
    """Turn left [s]."""


class MotorsConfig(Table, frozen=True, kw_only=True):
    """What stands between a motor's torque and its joint."""

    damping: NonNegative
    """Viscous friction of every joint [N m s]."""
    friction: NonNegative
    """Dry friction of every joint [N m]."""
    friction_of: dict[str, float] = field(default_factory=dict)
    """Dry friction of joints that have another, by name [N m]."""
    inertia: NonNegative
    """Rotor inertia seen at every joint [kg m²]."""
    stiffness: NonNegative = 0.0
    """Stiffness with which every drive holds the posture that the robot starts in [N m/rad]."""


class SensorConfig(Table, frozen=True, kw_only=True):
    """A sensor with three axes, in the unit of what it measures."""

    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Added to every measurement."""
    delay: Annotated[float, Meta(ge=0, le=1)] = 0.0
    """Age of what is measured, rounded to ticks [s]."""
    noise_std: NonNegative = 0.0
    """Standard deviation of white noise on every axis, drawn anew each tick."""


class ThrustSensorConfig(Table, frozen=True, kw_only=True):
    """Thrust sensors, all alike."""

    bias: float = 0.0
    """Added to every measurement [N]."""
    delay: Annotated[float, Meta(ge=0, le=1)] = 0.0
    """Age of what is measured, rounded to ticks [s]."""
    noise_std: NonNegative = 0.0
    """Standard deviation of white noise on every jet, drawn anew each tick [N]."""


class SensorsConfig(Table, frozen=True, kw_only=True):
    """Sensors of the robot's own state; those without settings are exact."""

    base_angular_velocity: SensorConfig = SensorConfig()
    """Gyroscopes [rad/s, base axes]; the measured rotation turns them into inertial axes."""
    base_linear_velocity: SensorConfig = SensorConfig()
    """Velocity of the base origin [m/s, inertial axes]."""
    base_position: SensorConfig = SensorConfig()
    """Position of the base origin [m, inertial axes]."""
    base_rotation: SensorConfig = SensorConfig()
    """Rotation of the base; bias and noise turn it about its own axes [rad]."""
    joints: EncoderConfig = EncoderConfig()
    """Joints."""
    seed: Annotated[int, Meta(ge=0)] = 0
    """Seed of all their noise."""
    thrust: ThrustSensorConfig = ThrustSensorConfig()
    """Thrust of every jet."""


class SimulatorConfig(Table, frozen=True, kw_only=True):
    """The world the robot flies in."""

    aero: AeroConfig
    """Aerodynamics of the world."""
    course_error: Positive = 0.5
    """Greatest distance of the centre of mass from its set-point, after the start-up, of a flight that is not
    `off_course` [m].
    """
    divergence: DivergenceConfig = DivergenceConfig()
    """What physics excludes."""
    duration: Positive
    """Length of the flight [s]."""
    dynamics: DynamicsBackend = "tree"
    """What computes mass matrix and bias."""
    fall: FallConfig
    """When a robot counts as fallen."""
    ground: GroundConfig | None = None
    """The ground, where there is one."""
    initial: InitialConfig
    """State at the beginning."""
    integrator: Integrator = "semi_implicit_euler"
    """How a physics step is taken."""
    jets: JetsConfig
    """How thrust follows the command."""
    joint_stops: bool = True
    """Whether joints meet the stops of the robot's URDF, widened to the range of the controller."""
    kinematics: AeroKinematics = "current"
    """Which kinematics place the links in the wind."""
    lever_arm: LeverArm = "rotated"
    """Point at which link forces act."""
    motors: MotorsConfig | None = None
    """Friction and inertia of the motors; without them, ideal torques."""
    sensors: SensorsConfig | None = None
    """Sensors of the robot's own state; without them the controller is given the state itself."""
    substeps: Annotated[int, Meta(ge=1, le=1000)] = 1
    """Physics steps within a tick; forces that depend on the state follow it, commands are held."""
    time_step: Annotated[float, Meta(ge=0.0002, le=1)]
    """Tick of controller and physics [s]."""


class ScenarioConfig(Table, frozen=True, kw_only=True):
    """One flight: which robot, in which simulator and wind, under which controller, on which mission."""

    controller: ControllerSection
    """The controller."""
    description: str = ""
    """What the flight is for."""
    disturbances: Disturbances = Disturbances()
    """What is done to robot and controller."""
    engine: Engine = "rust"
    """Which engine flies it. This crate is one of them and reads the files of all."""
    mission: MissionConfig
    """What the autopilot demands, and when."""
    robot: Path
    """The robot's TOML file."""
    simulator: SimulatorConfig
    """The world."""
    title: str = ""
    """What people read in tables and figures."""
    wind: WindConfig
    """The wind that blows; the controller is given it too, unless `disturbances` say otherwise."""


class AeroEntry(Table, frozen=True, kw_only=True):
    """A link on which aerodynamic force acts."""

    axis: tuple[float, float, float]
    """Axis of symmetry in link axes, a unit vector."""
    centre: tuple[float, float, float]
    """Where the force acts, in link axes [m]."""
    diameter: Positive
    """Diameter [m]."""
    family: str
    """Name of its coefficients in every coefficient set."""
    frame: str
    """Link of the URDF."""
    is_sphere: bool = False
    """Whether the link is a sphere to the sphere/cylinder model."""
    length: Positive
    """Length along the axis [m]."""
    name: str
    """Name of the link in tables and plots."""


class AxisymmetricCoefficients(Table, frozen=True, kw_only=True):
    """Coefficients of one axisymmetric link, all force areas [m²]."""

    cda: tuple[float, float, float, float, float]
    """`C_D A = w₀ + w₁ cos α + w₂ sin² α + w₃ sin³ α + w₄ cos³ α`."""
    cna: float
    """`C_N A = w₅ sin² α cos α`."""


class EngineCoefficients(Table, frozen=True, kw_only=True):
    """Second-order model of an engine: thrust `T` [N] under throttle `u` in percent."""

    b_d: float
    """Gain that grows with the thrust rate [1/s per percent]."""
    b_t: float
    """Gain that grows with thrust [1/s² per percent]."""
    b_u: float
    """Gain of the throttle [N/s² per percent]."""
    b_uu: float
    """Curvature of the throttle [1/percent]."""
    c: float
    """Constant drift [N/s²]."""
    k_d: float
    """Damping [1/s]."""
    k_dd: float
    """Quadratic damping [1/N]."""
    k_t: float
    """Stiffness [1/s²]."""
    k_td: float
    """Damping that grows with thrust [1/(N s)]."""
    k_tt: float
    """Quadratic stiffness [1/(N s²)]."""
    throttle_max: float
    """Greatest throttle [percent]."""
    throttle_min: float
    """Least throttle [percent]."""


class FootEntry(Table, frozen=True, kw_only=True):
    """A foot: a sole and the corners that can touch the ground."""

    frame: str
    """Link of the URDF: the sole."""
    name: str
    """Name of the foot."""
    vertices: tuple[tuple[float, float, float], ...]
    """Corners that can touch the ground, in sole axes [m]."""


class JointEntry(Table, frozen=True, kw_only=True):
    """A joint that moves."""

    limits: tuple[float, float] | None = None
    """Of a prismatic joint [m]; without them, the limits of the URDF hold."""
    limits_deg: tuple[float, float] | None = None
    """Of a revolute joint [deg]; without them, the limits of the URDF hold."""
    name: str
    """Name of the joint in the URDF."""
    torque_max: Positive | None = None
    """In place of the URDF's effort [N m, N]."""
    torque_rate_max: Positive | None = None
    """Without it, nothing limits the rate [N m/s, N/s]."""
    velocity_max: Positive | None = None
    """Of a prismatic joint, in place of the URDF's velocity [m/s]."""
    velocity_max_deg: Positive | None = None
    """Of a revolute joint, in place of the URDF's velocity [deg/s]."""


class GroupEntry(Table, frozen=True, kw_only=True):
    """Joints that are treated and plotted together."""

    joints: tuple[JointEntry, ...]
    """Its joints."""
    name: str
    """Name of the group, as posture gains and plots name it."""


class JetEntry(Table, frozen=True, kw_only=True):
    """A jet engine: a force along a fixed axis of a frame."""

    axis: tuple[float, float, float]
    """Direction of the force on the robot in frame axes, a unit vector."""
    engine: str
    """Name of its engine."""
    frame: str
    """Link of the URDF; the thrust acts at its origin."""
    name: str
    """Name of the jet."""
    thrust_max: Positive
    """Greatest thrust [N]."""


class RobotFile(Table, frozen=True, kw_only=True):
    """A robot's TOML file."""

    aero_links: tuple[AeroEntry, ...] = ()
    """Links on which aerodynamic force acts."""
    base_link: str
    """Link of the URDF whose body floats."""
    coefficients: dict[str, dict[str, AxisymmetricCoefficients]] = field(default_factory=dict)
    """Coefficients by set, then by link family."""
    engines: dict[str, EngineCoefficients] = field(default_factory=dict)
    """Second-order engines, by name."""
    feet: tuple[FootEntry, ...] = ()
    """Feet that can touch the ground."""
    forward_axis: tuple[float, float, float] = (1.0, 0.0, 0.0)
    """Forward direction in base axes, a unit vector orthogonal to z."""
    gravity: Positive = 9.81
    """Gravity [m/s²]."""
    jets: tuple[JetEntry, ...] = ()
    """Jet engines on the robot."""
    joint_groups: tuple[GroupEntry, ...] = ()
    """Joints that move, in groups; their order is that of every joint vector."""
    locked: dict[str, float] = field(default_factory=dict)
    """Joints held at a position [rad, m]."""
    name: str
    """Name of the robot."""
    urdf: Path
    """URDF file, relative to this one."""

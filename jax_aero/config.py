"""Types of a flight's and a robot's configuration.

Made by `python -m experiments.schema` from the crate's types: not to be edited.
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
    """Axial drag coefficient, on the area `π d²/4`; only its ratio to its maximum is used."""
    crosswind_drag: tuple[float, ...]
    """Crosswind drag coefficient of a cylinder of infinite length, on the area `d l`."""
    diameter_over_length: tuple[float, ...]
    """Ratios of diameter to length for `finite_length_drag`."""
    finite_length_drag: tuple[float, ...]
    """Crosswind drag coefficient of a finite cylinder; only its ratio to its maximum is used."""
    length_over_diameter: tuple[float, ...]
    """Ratios of length to diameter for `axial_drag`."""
    reference_reynolds: Positive
    """Reynolds number, on the diameter, at which the axial coefficients apply without scaling."""
    reynolds: tuple[float, ...]
    """Reynolds numbers of `crosswind_drag`."""


class SphereTables(Table, frozen=True, kw_only=True):
    """Measured drag coefficients of spheres, on the area `π d²/4`."""

    drag: tuple[float, ...]
    """Drag coefficient at each of `reynolds`."""
    drag_below_reynolds_10: Positive
    """Drag coefficient below Reynolds number 10."""
    reynolds: tuple[float, ...]
    """Reynolds numbers of `drag`; a correlation is used between 10 and the first of them."""


Precision: TypeAlias = Literal["f32", "f64"]
"""Precision of the weighted sums; all other computations are in double precision.

f32: Single precision, as networks are trained.
f64: Double precision with the same weights, for comparison of implementations.
"""


class OffAeroConfig(Table, frozen=True, kw_only=True, tag_field="model", tag="off"):
    """No aerodynamic force."""


class AxisymmetricAeroConfig(Table, frozen=True, kw_only=True, tag_field="model", tag="axisymmetric"):
    """Axisymmetric links with fitted force areas."""

    air_density: Positive
    """Density of the air [kg/m³]."""
    coefficients: str
    """Name of the coefficient set; every link of the robot needs a set of this name."""


class SphereCylinderAeroConfig(Table, frozen=True, kw_only=True, tag_field="model", tag="sphere_cylinder"):
    """Spheres and finite cylinders with drag coefficients from the literature."""

    air_density: Positive
    """Density of the air [kg/m³]."""
    cylinder: CylinderTables
    """Drag of circular cylinders."""
    dynamic_viscosity: Positive
    """Dynamic viscosity of the air [Pa s]."""
    sphere: SphereTables
    """Drag of spheres."""


class NetworkAeroConfig(Table, frozen=True, kw_only=True, tag_field="model", tag="network"):
    """A neural network whose inputs are wind and posture."""

    air_density: Positive
    """Density of the air [kg/m³]."""
    card: Path
    """The network's JSON card; the weights are in the same folder."""
    precision: Precision = "f32"
    """Precision of the weighted sums."""


AeroConfig: TypeAlias = OffAeroConfig | AxisymmetricAeroConfig | SphereCylinderAeroConfig | NetworkAeroConfig
"""Selection and parameters of an aerodynamic model: one file of `configs/aero/`."""


RateFeedback: TypeAlias = Literal["wrench", "force", "moment", "none"]
"""Part of the total aerodynamic wrench about the centre of mass in the estimated momentum rate.

wrench: Force and moment.
force: The force only.
moment: The moment only.
none: Nothing.
"""


class AeroFeedback(Table, frozen=True, kw_only=True):
    """Where the estimated aerodynamic forces enter the controller; each place can be switched off for an ablation."""

    lambda_: bool = field(default=True, name="lambda")
    """Whether `Λ_a` enters the derivative of the momentum rate."""
    momentum_rate: RateFeedback = "wrench"
    """Part of `A_a f_a` in the estimated momentum rate."""
    torque: bool = True
    """Whether `J_aᵀ f_a` enters the torque law."""


AeroKinematics: TypeAlias = Literal["current", "frozen"]
"""Kinematics used for the aerodynamic forces.

current: Those of the present state.
frozen: Those of the first tick for the whole flight (published): axes, points and Jacobians are constant, only
velocities are current.
"""


class BoundsConfig(Table, frozen=True, kw_only=True):
    """Bounds of the momentum QP: the bound on a rate decreases as a tanh where the value approaches its limit."""

    joint_steepness: Positive
    """Steepness at the joint limits [1/rad, 1/m]."""
    joint_velocity_max_deg: Positive | None = None
    """Greatest velocity of revolute joints [deg/s], in place of the robot's own limits."""
    thrust_rate_max: dict[str, float]
    """Greatest thrust rate, by jet [N/s]."""
    thrust_steepness: Positive
    """Steepness at the thrust limits [1/N]."""


class ChannelConfig(Table, frozen=True, kw_only=True):
    """One kind of measurement."""

    delay: Annotated[float, Meta(ge=0, le=0.2)] = 0.0
    """Age of the measurement on arrival, rounded to ticks [s]."""
    time_constant: NonNegative = 0.0
    """Time constant with which the estimate follows the measurement [s]; zero uses the measurement unchanged."""


class Greatest(Table, frozen=True, kw_only=True):
    """Greatest accepted magnitudes; by default those of a simulated flight that has not diverged."""

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
    """Greatest accepted differences from the prediction. Wind, thrusts and feet have no limit."""

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
    """Which measurements are accepted, and what replaces the others."""

    descend_after: NonNegative = 3.0
    """Age of a channel of joints or base above which the robot levels and descends, to the end of the flight [s]."""
    frozen_ticks: Annotated[int, Meta(ge=1, le=100000)] = 5
    """Number of ticks with the same bits after which a value may count as frozen."""
    greatest: Greatest = Greatest()
    """Greatest accepted magnitude of each component."""
    jump: Jumps | None = None
    """Greatest accepted difference of each component from the prediction. Without it all differences are accepted, no
    value counts as frozen and no time step as wrong.
    """
    velocity_gain: NonNegative = 100.0
    """Gain with which a base velocity that is not measured follows the differences of the pose [1/s]."""
    widening: NonNegative = 1.0
    """Relative growth of `jump` with the age of a channel [1/s]."""
    wind_fade: Positive = 2.0
    """Time in which the wind fades to zero after `wind_hold` [s]."""
    wind_hold: NonNegative = 1.0
    """Time for which the last wind is held [s]."""


class LoadTransfer(Table, frozen=True, kw_only=True):
    """Transfer of the load between feet and jets. A robot whose feet carry load takes off if its set-point is above
    its centre of mass: the feet are unloaded. Otherwise, and during a descent, it stands: the jets are unloaded.
    """

    gain: Positive
    """Gain with which the load of the unloaded side (feet or jets) decreases [1/s]."""
    height: Positive
    """Height of the set-point over the centre of mass beyond which the robot takes off [m]; the set-point of a
    standing robot is limited to the same distance below the centre of mass.
    """
    hold_time: NonNegative
    """Time for which the feet of a standing robot may lose contact and still count as carrying load [s]."""
    measured_gain: NonNegative
    """Gain with which `f_c*` of a standing robot follows the measured wrenches [1/s]."""
    unmodelled_force_max: Positive | None = None
    """Greatest vertical force on the robot that the controller's model may leave unexplained [N]. Above it, measured
    foot wrenches are judged wrong, and feet in the air count as carrying load if the set-point is below the centre
    of mass by `height`. Needs `controller.observer`; without it foot sensors are trusted, and feet that are not
    measured do not start to carry load.
    """


class WrenchLimits(Table, frozen=True, kw_only=True):
    """Limits of the wrench of every foot, in sole axes about the sole's origin."""

    centre_of_pressure_margin: float = 0.0
    """Least distance of the centre of pressure from the edges of the rectangle around the sole's corners [m], positive
    inside. A negative value allows it outside, as published.
    """
    friction: Positive
    """Friction coefficient of `|f_xy| ≤ μ f_z`, approximated by the regular twelve-sided polygon inside the circle."""
    torsional_friction: NonNegative
    """Torsional friction coefficient of `|m_z| ≤ κ f_z` [m]."""
    vertical_force_min: NonNegative
    """Least vertical force [N]."""


class ContactConfig(Table, frozen=True, kw_only=True):
    """Configuration of standing on the ground; without it the controller only flies."""

    feet: tuple[str, ...]
    """Names of the feet to stand on; other feet of the robot are ignored."""
    force_rate_dead_zone: NonNegative
    """Rates below this are not integrated [N/s, N m/s]."""
    force_rate_max: Positive
    """Greatest rate of every component of `f_c*` [N/s, N m/s]."""
    load_transfer: LoadTransfer | None = None
    """Take-off and landing; without it the robot does neither."""
    start_with_moment: bool
    """Whether `f_c*` starts with the measured moment about y in addition to the vertical force."""
    vertical_force_min: Positive
    """Vertical force above which a foot carries load [N]; all of `feet` have to exceed it."""
    weight_foot_acceleration: NonNegative
    """Weight of `J_c ν̇ + J̇_c ν = 0` in the torque QP."""
    weight_foot_velocity: NonNegative
    """Weight of `J_c ν = 0` in the momentum QP."""
    weight_force: NonNegative
    """Weight of `f_c → f_c*` in the torque QP."""
    weight_force_rate: NonNegative
    """Weight of `ḟ_c → 0` in the momentum QP."""
    wrench: WrenchLimits
    """Limits of the wrench of a foot."""


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
    """Descent without an engine: attitude has priority, the position is not held, and joints are fast."""

    joint_velocity_max_deg: Positive
    """Greatest joint velocity during the descent [deg/s], for revolute joints whose own limit is lower."""
    momentum: MomentumGains
    """Gains in place of `controller.momentum`."""
    range_share_min: Positive
    """An engine is lost if its least and greatest thrust differ by less than this fraction of the jet's greatest
    thrust.
    """
    torque_rate_max: Positive
    """Greatest rate of a joint torque during the descent [N m/s], for revolute joints whose own limit is lower."""


class EnginesConfig(Table, frozen=True, kw_only=True):
    """When an engine counts as not reaching its thrust, and when as lost."""

    confirmation: NonNegative
    """Time for which `deviation_max` has to be exceeded [s]."""
    descent: DescentConfig | None = None
    """Levelling and descent after the loss of an engine; without it the mission continues."""
    deviation_max: Positive
    """Greatest deviation of a thrust from the commanded one [N]."""
    time_constant: Positive
    """Time constant with which deviations of the thrust decay [s]."""


class EstimatorConfig(Table, frozen=True, kw_only=True):
    """Delay and time constant of each kind of measurement."""

    base_angular_velocity: ChannelConfig = ChannelConfig()
    """Gyroscopes."""
    base_linear_velocity: ChannelConfig = ChannelConfig()
    """Velocity of the base origin."""
    base_position: ChannelConfig = ChannelConfig()
    """Position of the base origin."""
    base_rotation: ChannelConfig = ChannelConfig()
    """Rotation of the base."""
    joint_observer: Positive | None = None
    """Time constant [s] of an observer that estimates joint velocities, and joint accelerations that the model does
    not explain, from the joint positions alone. It replaces `joint_velocity` and the time constant of
    `joint_position`; joint velocities then need not be measured.
    """
    joint_position: ChannelConfig = ChannelConfig()
    """Joint positions."""
    joint_velocity: ChannelConfig = ChannelConfig()
    """Joint velocities."""
    thrust: ChannelConfig = ChannelConfig()
    """Thrusts."""


JacobianOffset: TypeAlias = Literal["link_rotation", "base_rotation"]
"""Point whose Jacobian maps a link's force in the controller's `Λ_a` and torque law.

link_rotation: The aerodynamic centre, `p + R c`.
base_rotation: `p + R_B c`: the offset is rotated with the base instead of the link (published).
"""


LeverArm: TypeAlias = Literal["rotated", "unrotated"]
"""Point at which a link's force acts when its moment is formed.

rotated: At the aerodynamic centre, `p + R c`.
unrotated: At `p + c`: the offset is added without rotation into inertial axes (published).
"""


LinkVelocity: TypeAlias = Literal["at_centre", "shifted_twice"]
"""Point whose velocity the controller subtracts from the wind to get a link's relative wind.

at_centre: The aerodynamic centre.
shifted_twice: The point of `JacobianOffset` shifted once more by the unrotated offset (published).
"""


class ObserverConfig(Table, frozen=True, kw_only=True):
    """Gains of the observer, and the greatest wrench that it estimates."""

    force_max: NonNegative
    """Greatest observed force along each axis [N]."""
    gain_force: NonNegative
    """`K_o` of the force [1/s]."""
    gain_moment: NonNegative
    """`K_o` of the moment [1/s]."""
    moment_max: NonNegative
    """Greatest observed moment about each axis [N m]."""


Fallback: TypeAlias = Literal["hold", "clarabel"]
"""Action when the first solver returns no certified answer.

hold: Thrust rates and joint velocities are zero, torques keep their values. No allocation.
clarabel: Clarabel (allocates); as `hold` if it fails too.
"""


Solver: TypeAlias = Literal["active_set", "clarabel"]
"""Solver that is tried first.

active_set: Active-set methods: no allocation, a few microseconds.
clarabel: Clarabel: allocates, hundreds of microseconds.
"""


class QpConfig(Table, frozen=True, kw_only=True):
    """Solution of the QPs."""

    fallback: Fallback = "hold"
    """Action without a certified answer."""
    solver: Solver = "active_set"
    """Solver of every tick."""


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
    """Deceleration to the velocity of the descent, or to rest without a valid set-point [m/s²]."""
    descent_speed: NonNegative = 0.5
    """Speed of the descent after the mission has been abandoned [m/s]."""
    nose_down_limits_deg: tuple[float, float]
    """Least and greatest raw pitch, positive nose down [deg]."""
    position_smoothing: Positive
    """Smoothing time of the position [s]."""
    speed: tuple[NonNegative, NonNegative]
    """Forward and vertical speed of the raw position [m/s]."""
    turbo_boost: NonNegative
    """Relative increase of the forward speed by the turbo command: it grows to `1 + turbo_boost` times the speed."""
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
    """Greatest torque of revolute joints [N m], in place of the robot's own limits."""
    torque_rate_max: Positive | None = None
    """Greatest torque rate of revolute joints [N m/s], in place of the robot's own limits."""
    weight_acceleration: NonNegative
    """Weight of the joint acceleration task."""
    weight_torque: NonNegative
    """Weight of the torques."""


class MomentumWeights(Table, frozen=True, kw_only=True):
    """Weights of the tasks in the momentum QP."""

    angular_momentum: NonNegative
    """Angular-momentum constraint task."""
    joint_velocity: NonNegative
    """Minimisation of joint velocities."""
    momentum: NonNegative
    """Momentum and attitude tasks."""
    posture: NonNegative
    """Posture task."""
    regularisation: Positive
    """Added to the diagonal of the Hessian."""
    symmetric_jets: tuple[tuple[str, str], ...]
    """Pairs of jets with equal thrust rates."""
    symmetry: NonNegative
    """Equal thrust rates within each pair of `symmetric_jets`."""
    thrust_rate: dict[str, float]
    """Minimisation of thrust rates, by jet."""


class WindObserverConfig(Table, frozen=True, kw_only=True):
    """Parameters of the wind estimation."""

    force_noise: tuple[Positive, Positive, Positive] = (0.3, 0.3, 4.0)
    """Standard deviation of the noise of the observed force, by axis [N]."""
    force_std: NonNegative = 0.1
    """Standard deviation of lasting errors of the force: of mass, thrusts and attitude [N]."""
    gain: Positive = 10.0
    """Gain `K_o` with which the acting force is observed [1/s]."""
    moment_arm: Positive = 0.25
    """Lever arm that converts an unexplained moment to an unexplained force of the model [m]."""
    relative_std: NonNegative = 0.045
    """Standard deviation of lasting errors of the aerodynamic model, as a fraction of the observed force."""
    vertical_std: Positive = 1.0
    """Standard deviation of vertical winds [m/s]."""
    vertical_time: Positive = 2.0
    """Correlation time of vertical winds [s]."""
    walk: Positive = 0.6
    """Rate of change of a horizontal wind: standard deviation after one second [m/s]."""


class ControllerSection(Table, frozen=True, kw_only=True):
    """One file of `configs/control/`."""

    aero: AeroConfig
    """The controller's own aerodynamic model; `off` is the baseline controller."""
    aero_feedback: AeroFeedback = AeroFeedback()
    """Terms of the controller that contain the estimated aerodynamic forces."""
    bounds: BoundsConfig
    """Bounds of the momentum QP."""
    channels: ChannelsConfig = ChannelsConfig()
    """Which measurements are accepted, and what replaces the others."""
    contact: ContactConfig | None = None
    """Standing on the ground; without it the controller has no feet."""
    engines: EnginesConfig | None = None
    """When an engine counts as lost; without it, never."""
    estimator: EstimatorConfig | None = None
    """State estimator; without it the control law uses the measurements."""
    jacobian_offset: JacobianOffset = "link_rotation"
    """Point whose Jacobian maps link forces (in `Λ_a` and the torque law)."""
    lever_arm: LeverArm = "rotated"
    """Point at which moments of link forces are formed (in `A_a`)."""
    link_velocity: LinkVelocity = "at_centre"
    """Point whose velocity enters the relative wind."""
    momentum: MomentumGains
    """Gains of the momentum and attitude tasks."""
    observer: ObserverConfig | None = None
    """Observer of the wrench that no model of the controller contains; without it this wrench is taken as zero."""
    posture_gain: dict[str, float]
    """Posture gain `K_s` by joint group [1/s]."""
    qp: QpConfig = QpConfig()
    """How QPs are solved."""
    setpoint: SetpointConfig
    """Set-point generation."""
    torque: TorqueConfig
    """The joint torque controller."""
    use_jets: bool = True
    """Whether the controller uses the jets; without them it neither reads thrusts nor commands thrust rates."""
    weights: MomentumWeights
    """Weights of the momentum QP."""
    wind_observer: WindObserverConfig | None = None
    """Wind observer, which estimates the wind from the force on the robot; without it the control law uses the
    measured wind.
    """


class ForceFactorsConfig(Table, frozen=True, kw_only=True):
    """Factors on the force of every link; the default is 1."""

    drag: float = 1.0
    """Factor on the part along the air's velocity relative to the link."""
    links: dict[str, float] = field(default_factory=dict)
    """Factor on the whole force of a link, by its name; links that are not named keep theirs."""
    normal: float = 1.0
    """Factor on the part across the air's velocity relative to the link."""
    scale: float = 1.0
    """Factor on all forces."""


class ConstantWindConfig(Table, frozen=True, kw_only=True, tag_field="profile", tag="constant"):
    """Constant velocity."""

    velocity: tuple[float, float, float]
    """Velocity of the air [m/s]."""


class RampWindConfig(Table, frozen=True, kw_only=True, tag_field="profile", tag="ramp"):
    """Zero, then a linear rise to a constant: the published profile."""

    ramp_end: float
    """End of the rise [s]."""
    ramp_start: float
    """Start of the rise [s]."""
    velocity: tuple[float, float, float]
    """Velocity after the ramp [m/s]."""


class GustWindConfig(Table, frozen=True, kw_only=True, tag_field="profile", tag="gust"):
    """A steady wind with one "1 − cos" gust."""

    duration: Positive
    """Duration of the gust [s]."""
    gust: tuple[float, float, float]
    """Velocity added at the peak of the gust [m/s]."""
    start: float
    """Start of the gust [s]."""
    velocity: tuple[float, float, float]
    """Steady velocity [m/s]."""


class TurbulentWindConfig(Table, frozen=True, kw_only=True, tag_field="profile", tag="turbulent"):
    """The published profile with turbulence that rises in proportion."""

    ramp_end: float
    """End of the rise [s]."""
    ramp_start: float
    """Start of the rise [s]."""
    seed: Annotated[int, Meta(ge=0)] = 0
    """Seed of the turbulence."""
    std: tuple[NonNegative, NonNegative, NonNegative]
    """Standard deviation of the turbulence on each axis [m/s]."""
    time_scale: Positive
    """Time scale of the turbulence [s]."""
    velocity: tuple[float, float, float]
    """Mean velocity after the ramp [m/s]."""


class FileWindConfig(Table, frozen=True, kw_only=True, tag_field="profile", tag="file"):
    """A recorded wind: a CSV file with header `time,x,y,z`; linear between samples, constant outside."""

    path: Path
    """The file; relative paths start at the configuration file."""


class SamplesWindConfig(Table, frozen=True, kw_only=True, tag_field="profile", tag="samples"):
    """A recorded wind, given here; linear between samples, constant outside."""

    samples: tuple[tuple[float, float, float, float], ...]
    """Time [s], increasing, and velocity along x, y and z [m/s]."""


WindConfig: TypeAlias = (
    ConstantWindConfig | RampWindConfig | GustWindConfig | TurbulentWindConfig | FileWindConfig | SamplesWindConfig
)
"""A wind profile; velocities in m/s, inertial axes, times in s."""


FailureKind: TypeAlias = Literal["off", "stuck"]
"""Kind of a jet failure.

off: The thrust decays to zero.
stuck: The thrust stays constant.
"""


class JetFailure(Table, frozen=True, kw_only=True):
    """A jet that no longer follows its command."""

    decay: NonNegative = 0.0
    """Time constant with which the thrust of a jet that is off decays [s]; zero for at once."""
    jet: str
    """Name of the jet."""
    kind: FailureKind
    """Kind of the failure."""
    time: NonNegative
    """Time of the failure [s]."""


class MeasurementNoise(Table, frozen=True, kw_only=True):
    """White noise of measured thrusts."""

    seed: Annotated[int, Meta(ge=0)] = 0
    """Seed."""
    std: NonNegative
    """Standard deviation [N]."""


class JetFaultsConfig(Table, frozen=True, kw_only=True):
    """Faults of the jets; none by default."""

    failure: JetFailure | None = None
    """One jet that fails."""
    force_scale: dict[str, float] = field(default_factory=dict)
    """Ratio of the force that a jet exerts to its thrust, by name; it is 1 for jets that are not named."""
    lag: NonNegative = 0.0
    """Time constant of a first-order lag of the commanded thrust rate [s]; zero for none."""
    limit_is_known: bool = False
    """Whether the controller's own limits are scaled as well, by `thrust_limit_scale`."""
    measurement_noise: MeasurementNoise | None = None
    """Noise of the measured thrust, which only the estimators of second-order jets use."""
    thrust_limit_scale: Positive | None = None
    """Limit of the thrust as a fraction of the robot's greatest thrust; without it only the controller limits the
    thrust, as published.
    """


class ModelError(Table, frozen=True, kw_only=True):
    """Differences between the controller's robot and the simulated one; none by default."""

    com_offset: tuple[
        Annotated[float, Meta(ge=-10, le=10)],
        Annotated[float, Meta(ge=-10, le=10)],
        Annotated[float, Meta(ge=-10, le=10)],
    ] = (0.0, 0.0, 0.0)
    """Offset of the base body's centre of mass in the controller's robot [m, base axes]."""
    mass_scale: Annotated[float, Meta(ge=0.01, le=100)] = 1.0
    """Factor on all masses and inertias of the controller's robot."""


OutageChannel: TypeAlias = Literal["wind", "thrust", "joints", "base_position", "base_rotation", "base_velocity"]
"""Channel that fails.

wind: Velocity of the air.
thrust: Thrust of one jet or of all.
joints: Positions and velocities of all joints.
base_position: Position of the base.
base_rotation: Rotation of the base.
base_velocity: Velocity of the base, linear and angular.
"""


OutageKind: TypeAlias = Literal["missing", "nan", "frozen", "wrong"]
"""What is measured during an outage.

missing: Nothing: every component is NaN.
nan: The first component is NaN.
frozen: The value at the start of the outage.
wrong: A value with the error `error`.
"""


class Outage(Table, frozen=True, kw_only=True):
    """A temporary failure of one channel."""

    channel: OutageChannel
    """Channel that fails."""
    duration: Positive | None = None
    """Duration of the outage [s]; without it, to the end of the flight."""
    error: float = 1.0
    """Error of a wrong value [unit of the channel]: added to every component; for a rotation, an angle about inertial
    x.
    """
    jet: str | None = None
    """Name of the jet whose thrust fails; without it, all jets."""
    kind: OutageKind
    """What is measured instead."""
    start: Positive
    """Start of the outage [s]; the first measurement of a flight is complete."""


class WindEstimateConfig(Table, frozen=True, kw_only=True):
    """Errors of the measured wind; none by default."""

    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Bias of the wind [m/s, inertial axes]."""
    delay: Annotated[float, Meta(ge=0, le=1000)] = 0.0
    """Age of the wind, rounded to ticks [s]."""
    mean_only: bool = False
    """Whether the controller receives the mean over the flight only."""
    noise_std: NonNegative = 0.0
    """Standard deviation of white noise on every axis, drawn in every tick [m/s]."""
    seed: Annotated[int, Meta(ge=0)] = 0
    """Seed of the noise."""
    time_constant: NonNegative = 0.0
    """Time constant of a first-order low pass after all other errors [s]; zero for none."""


class Disturbances(Table, frozen=True, kw_only=True):
    """Disturbances of a flight; none by default."""

    aero: ForceFactorsConfig = ForceFactorsConfig()
    """Factors on the simulated aerodynamic forces, for errors of the coefficients."""
    aero_estimate: ForceFactorsConfig = ForceFactorsConfig()
    """Factors on the forces that the controller estimates, for parts that are wrong or omitted."""
    controller_wind: WindConfig | None = None
    """A wind that the controller receives in place of the simulated one."""
    jets: JetFaultsConfig = JetFaultsConfig()
    """Faults of the jets."""
    model_error: ModelError = ModelError()
    """Differences between the controller's robot and the simulated one."""
    outages: tuple[Outage, ...] = ()
    """Measurements that are lost or corrupted on the way to the controller."""
    wind_estimate: WindEstimateConfig | None = None
    """Errors of the controller's measured wind; without them it is the true wind."""


class DivergenceConfig(Table, frozen=True, kw_only=True):
    """Limits of physically possible values; a flight that exceeds them, or has a state that is not finite, has
    diverged.
    """

    angular_velocity: Positive = 100.0
    """Angular velocity of the base [rad/s]; by default 16 turns per second."""
    joint_excess: Positive = 6.0
    """Distance of a joint beyond its stops [rad, m]; by default about one turn."""
    joint_velocity: Positive = 100.0
    """Velocity of a joint [rad/s, m/s]; by default ten times that of motors of such robots."""
    speed: Positive = 300.0
    """Speed of base and air [m/s]; by default near the speed of sound, where no aerodynamic model here is valid."""
    thrust_ratio: Positive = 10.0
    """Ratio of a thrust to the jet's greatest."""


DynamicsBackend: TypeAlias = Literal["tree", "mjx"]
"""Implementation that computes mass matrix and bias.

tree: The tree of bodies of this project.
mjx: MuJoCo's JAX implementation, for `engine = "jax"` only.
"""


class EkfConfig(Table, frozen=True, kw_only=True):
    """Parameters of the filter, with the symbols of its equations. Except for the initial state, the defaults are the
    published values.
    """

    Q: tuple[tuple[float, float], tuple[float, float]] = ((10.0, 1.0), (1.0, 10.0))
    """`Q`: intensity of the process noise."""
    R: Positive = 1.0
    """`R`: intensity of the measurement noise."""
    init_P: tuple[tuple[float, float], tuple[float, float]] = ((1.0, 0.1), (0.1, 1.0))
    """`P(0)`: covariance of the initial state."""
    init_state: tuple[float, float] | None = None
    """`x̂(0) = (T, Ṫ)` [N, N/s]; without it `(initial thrust, 0)`. The published value is (0, 0), with which the
    throttle loop uses too small a thrust for the first two seconds.
    """


class EncoderConfig(Table, frozen=True, kw_only=True):
    """Encoders of the joints."""

    delay: Annotated[float, Meta(ge=0, le=1)] = 0.0
    """Age of the measurement, rounded to ticks [s]."""
    resolution: NonNegative = 0.0
    """Quantisation step of the positions [rad, m]; zero for none."""
    velocity_time_constant: NonNegative | None = None
    """Time constant [s] of a first-order low pass of position differences, from which velocities are measured; without
    it velocities are measured directly.
    """


Engine: TypeAlias = Literal["rust", "jax", "mujoco"]
"""The program that simulates a configuration.

rust: This crate.
jax: The batched, differentiable simulation in Python.
mujoco: MuJoCo, in Python; the only engine with ground.
"""


class FallConfig(Table, frozen=True, kw_only=True):
    """Limits beyond which a robot counts as fallen."""

    com_error: Positive
    """Greatest distance between centre of mass and set-point [m]."""
    rotation_error_deg: Annotated[float, Meta(gt=0, le=180)]
    """Greatest rotation between base and set-point [deg]."""


class LegOdometryConfig(Table, frozen=True, kw_only=True):
    """State measurement by the legs: pose of the base from the first of the controller's feet, velocity from all of
    them, assuming that the feet rest.
    """

    velocity_time_constant: NonNegative
    """Time constant of the first-order low pass of the joint velocities for the controller [s]."""


class GroundConfig(Table, frozen=True, kw_only=True):
    """The ground, plane z = 0. Only engines that simulate contact can fly a configuration with ground."""

    contact_time: Positive
    """Time constant of the contact: time in which a touching corner comes to rest [s]; longer is softer."""
    friction: Positive
    """Coulomb friction coefficient of soles on the ground."""
    leg_odometry: LegOdometryConfig | None = None
    """State measurement of the standing robot by its legs; without it the true state is measured."""
    settling: NonNegative
    """Time for which stiff joints hold the initial posture before the controller starts at time zero [s]."""


class InitialConfig(Table, frozen=True, kw_only=True):
    """Initial state of a flight."""

    base_position: tuple[float, float, float]
    """Position of the base origin [m]."""
    base_rpy_deg: tuple[float, float, float]
    """Roll, pitch, yaw of the base [deg]."""
    base_velocity: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """Velocity of the base origin, then angular velocity, inertial axes [m/s, rad/s]."""
    free_fall_tick: bool = False
    """Whether the first physics step has neither thrust nor torque, as with the delays of the published model: the
    controller starts with a robot that has fallen for one tick.
    """
    joint_position: tuple[float, ...]
    """Joint positions in the robot's order [rad]."""
    thrust: tuple[NonNegative, ...]
    """Thrusts in the robot's order, each at most the jet's greatest [N]."""


Integrator: TypeAlias = Literal["semi_implicit_euler", "explicit_euler"]
"""Integrator of a physics step.

semi_implicit_euler: Velocity first, then the pose with the new velocity: adds no energy to fast joint motion.
explicit_euler: Pose and velocity both advance with the velocity and acceleration at the start of the step
(published).
"""


ThrustFeedback: TypeAlias = Literal["measured", "estimated"]
"""Thrust that the flight controller receives.

measured: The true thrust, without noise.
estimated: The estimate of the `ThrustEkf`.
"""


class IdealJetsConfig(Table, frozen=True, kw_only=True, tag_field="dynamics", tag="ideal"):
    """Thrust is the integral of the command."""


class SecondOrderJetsConfig(Table, frozen=True, kw_only=True, tag_field="dynamics", tag="second_order"):
    """Identified second-order engines with a throttle loop."""

    ekf: EkfConfig = EkfConfig()
    """The thrust estimator."""
    engines: tuple[str, ...] | None = None
    """Engine of each jet, by name; by default those of the robot."""
    feedback: ThrustFeedback = "measured"
    """Thrust that the flight controller receives; the throttle loop always uses the estimate."""
    rate_gain_i: NonNegative = 0.0
    """Integral gain of the thrust-rate loop [1/s²]."""
    rate_gain_p: NonNegative = 150.0
    """Proportional gain of the thrust-rate loop [1/s]."""


JetsConfig: TypeAlias = IdealJetsConfig | SecondOrderJetsConfig
"""Dynamics of the thrust under a commanded thrust rate."""


class MissionConfig(Table, frozen=True, kw_only=True):
    """One file of `configs/mission/`: commands, or the file of a recorded reference."""

    down: tuple[tuple[float, float], ...] = ()
    """Descend [s]."""
    file: Path | None = None
    """CSV file of a recorded reference, in place of commands. Relative paths start at the configuration file."""
    forward: tuple[tuple[float, float], ...] = ()
    """Fly forwards at normal speed [s]."""
    forward_turbo: tuple[tuple[float, float], ...] = ()
    """Fly forwards at increased speed, nose down [s]."""
    pitch_up: tuple[tuple[float, float], ...] = ()
    """Raise the nose [s]."""
    up: tuple[tuple[float, float], ...] = ()
    """Climb [s]."""
    yaw_left: tuple[tuple[float, float], ...] = ()
    """Turn left [s]."""


class MotorsConfig(Table, frozen=True, kw_only=True):
    """Friction, stiffness and inertia between a motor's torque and its joint."""

    damping: NonNegative
    """Viscous friction of every joint [N m s]."""
    friction: NonNegative
    """Dry friction of every joint [N m]."""
    friction_of: dict[str, float] = field(default_factory=dict)
    """Dry friction of joints that differ from `friction`, by name [N m]."""
    inertia: NonNegative
    """Rotor inertia reflected to every joint [kg m²]."""
    stiffness: NonNegative = 0.0
    """Stiffness with which every drive holds the initial posture [N m/rad]."""


class SensorConfig(Table, frozen=True, kw_only=True):
    """A three-axis sensor; values are in the unit of its measurement."""

    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Bias of every measurement."""
    delay: Annotated[float, Meta(ge=0, le=1)] = 0.0
    """Age of the measurement, rounded to ticks [s]."""
    noise_std: NonNegative = 0.0
    """Standard deviation of white noise on every axis, drawn in every tick."""


class ThrustSensorConfig(Table, frozen=True, kw_only=True):
    """Thrust sensors, equal for all jets."""

    bias: float = 0.0
    """Bias of every measurement [N]."""
    delay: Annotated[float, Meta(ge=0, le=1)] = 0.0
    """Age of the measurement, rounded to ticks [s]."""
    noise_std: NonNegative = 0.0
    """Standard deviation of white noise on every jet, drawn in every tick [N]."""


class SensorsConfig(Table, frozen=True, kw_only=True):
    """Sensors of the robot's own state; those without settings are exact."""

    base_angular_velocity: SensorConfig = SensorConfig()
    """Gyroscopes [rad/s, base axes]; the measured rotation transforms them to inertial axes."""
    base_linear_velocity: SensorConfig = SensorConfig()
    """Velocity of the base origin [m/s, inertial axes]."""
    base_position: SensorConfig = SensorConfig()
    """Position of the base origin [m, inertial axes]."""
    base_rotation: SensorConfig = SensorConfig()
    """Rotation of the base; bias and noise rotate it about its own axes [rad]."""
    joints: EncoderConfig = EncoderConfig()
    """Joints."""
    seed: Annotated[int, Meta(ge=0)] = 0
    """Seed of the noise of all sensors."""
    thrust: ThrustSensorConfig = ThrustSensorConfig()
    """Thrust of every jet."""


class SimulatorConfig(Table, frozen=True, kw_only=True):
    """Configuration of the simulated robot and its environment."""

    aero: AeroConfig
    """Simulated aerodynamic model."""
    course_error: Positive = 0.5
    """Greatest distance of the centre of mass from its set-point after the start-up; a flight that exceeds it is
    `off_course` [m].
    """
    divergence: DivergenceConfig = DivergenceConfig()
    """Limits beyond which a flight counts as diverged."""
    duration: Positive
    """Length of the flight [s]."""
    dynamics: DynamicsBackend = "tree"
    """Implementation that computes mass matrix and bias."""
    fall: FallConfig
    """Limits beyond which a robot counts as fallen."""
    ground: GroundConfig | None = None
    """The ground, if there is one."""
    initial: InitialConfig
    """Initial state."""
    integrator: Integrator = "semi_implicit_euler"
    """Integrator of a physics step."""
    jets: JetsConfig
    """Dynamics of the thrust under a commanded thrust rate."""
    joint_stops: bool = True
    """Whether joints have the stops of the URDF, widened to the range of the controller."""
    kinematics: AeroKinematics = "current"
    """Kinematics used for the aerodynamic forces."""
    lever_arm: LeverArm = "rotated"
    """Point at which link forces act."""
    motors: MotorsConfig | None = None
    """Friction and inertia of the motors; without them torques are ideal."""
    sensors: SensorsConfig | None = None
    """Sensors of the robot's own state; without them the controller receives the true state."""
    substeps: Annotated[int, Meta(ge=1, le=1000)] = 1
    """Physics steps in a tick; state-dependent forces are evaluated in each, commands are constant."""
    time_step: Annotated[float, Meta(ge=0.0002, le=1)]
    """Tick of controller and physics [s]."""


class ScenarioConfig(Table, frozen=True, kw_only=True):
    """One flight: robot, simulator, controller, mission, wind and disturbances."""

    controller: ControllerSection
    """The controller."""
    description: str = ""
    """Purpose of the flight."""
    disturbances: Disturbances = Disturbances()
    """Disturbances of robot and controller."""
    engine: Engine = "rust"
    """Engine that simulates the flight. This crate is one of them and reads the files of all."""
    mission: MissionConfig
    """Commands of the autopilot, or a recorded reference."""
    robot: Path
    """The robot's TOML file."""
    simulator: SimulatorConfig
    """The simulated robot and its environment."""
    title: str = ""
    """Title in tables and figures."""
    wind: WindConfig
    """The simulated wind; the controller also receives it, unless `disturbances` states otherwise."""


class AeroEntry(Table, frozen=True, kw_only=True):
    """A link on which aerodynamic force acts."""

    axis: tuple[float, float, float]
    """Axis of symmetry in link axes, a unit vector."""
    centre: tuple[float, float, float]
    """Point where the force acts, in link axes [m]."""
    diameter: Positive
    """Diameter [m]."""
    family: str
    """Name of its coefficients in every coefficient set."""
    frame: str
    """Link of the URDF."""
    is_sphere: bool = False
    """Whether the sphere and cylinder model treats the link as a sphere."""
    length: Positive
    """Length along the axis [m]."""
    name: str
    """Name of the link in tables and figures."""


class AxisymmetricCoefficients(Table, frozen=True, kw_only=True):
    """Coefficients of one axisymmetric link, all force areas [m²]."""

    cda: tuple[float, float, float, float, float]
    """`C_D A = w₀ + w₁ cos α + w₂ sin² α + w₃ sin³ α + w₄ cos³ α`."""
    cna: float
    """`C_N A = w₅ sin² α cos α`."""


class EngineCoefficients(Table, frozen=True, kw_only=True):
    """Second-order model of an engine with thrust `T` [N] and throttle `u` in percent."""

    b_d: float
    """Gain proportional to the thrust rate [1/s per percent]."""
    b_t: float
    """Gain proportional to thrust [1/s² per percent]."""
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
    """Damping proportional to thrust [1/(N s)]."""
    k_tt: float
    """Quadratic stiffness [1/(N s²)]."""
    throttle_max: float
    """Greatest throttle [percent]."""
    throttle_min: float
    """Least throttle [percent]."""


class FootEntry(Table, frozen=True, kw_only=True):
    """A foot: a sole and the corners that can touch the ground."""

    frame: str
    """Link of the URDF that is the sole."""
    name: str
    """Name of the foot."""
    vertices: tuple[tuple[float, float, float], ...]
    """Corners that can touch the ground, in sole axes [m]."""


class JointEntry(Table, frozen=True, kw_only=True):
    """A joint that moves."""

    limits: tuple[float, float] | None = None
    """Limits of a prismatic joint [m]; by default those of the URDF."""
    limits_deg: tuple[float, float] | None = None
    """Limits of a revolute joint [deg]; by default those of the URDF."""
    name: str
    """Name of the joint in the URDF."""
    torque_max: Positive | None = None
    """Greatest torque or force [N m, N]; by default the URDF's effort."""
    torque_rate_max: Positive | None = None
    """Greatest rate of the torque or force [N m/s, N/s]; unlimited by default."""
    velocity_max: Positive | None = None
    """Greatest velocity of a prismatic joint [m/s]; by default that of the URDF."""
    velocity_max_deg: Positive | None = None
    """Greatest velocity of a revolute joint [deg/s]; by default that of the URDF."""


class GroupEntry(Table, frozen=True, kw_only=True):
    """Joints that share a posture gain and a figure."""

    joints: tuple[JointEntry, ...]
    """Its joints."""
    name: str
    """Name of the group in posture gains and figures."""


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
    """Link of the URDF that is the floating base."""
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
    """Joints that move, in groups; every joint vector has their order."""
    locked: dict[str, float] = field(default_factory=dict)
    """Joints that are fixed at a position [rad, m]."""
    name: str
    """Name of the robot."""
    urdf: Path
    """URDF file, relative to this one."""

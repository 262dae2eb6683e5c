"""Types of a flight's configuration, as `make generated` writes them; `configs/schema` describes every key.

A list is a tuple, and a table of several kinds the union of a type for each: `AeroConfig` with `model = "off"` is an
`OffAeroConfig`. Tables that the crate alone reads are plain. `jax_aero.base.typed_config` fills them.

>>> FilterConfig(delay=0.02)
FilterConfig(delay=0.02, time_constant=0.0)
"""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

from msgspec import Struct, field

Backend: TypeAlias = Literal["rust", "jax", "mujoco"]


class CylinderTables(Struct, frozen=True, kw_only=True):
    axial_drag: tuple[float, ...]
    crosswind_drag: tuple[float, ...]
    diameter_over_length: tuple[float, ...]
    finite_length_drag: tuple[float, ...]
    length_over_diameter: tuple[float, ...]
    reference_reynolds: float
    reynolds: tuple[float, ...]


class SphereTables(Struct, frozen=True, kw_only=True):
    drag: tuple[float, ...]
    drag_below_reynolds_10: float
    reynolds: tuple[float, ...]

Precision: TypeAlias = Literal["f32", "f64"]


class OffAeroConfig(Struct, frozen=True, kw_only=True, tag_field="model", tag="off"):
    pass


class AxisymmetricAeroConfig(Struct, frozen=True, kw_only=True, tag_field="model", tag="axisymmetric"):
    air_density: float
    coefficients: str


class SphereCylinderAeroConfig(Struct, frozen=True, kw_only=True, tag_field="model", tag="sphere_cylinder"):
    air_density: float
    cylinder: CylinderTables
    dynamic_viscosity: float
    sphere: SphereTables


class NetworkAeroConfig(Struct, frozen=True, kw_only=True, tag_field="model", tag="network"):
    air_density: float
    card: str
    precision: Precision = "f32"


AeroConfig: TypeAlias = OffAeroConfig | AxisymmetricAeroConfig | SphereCylinderAeroConfig | NetworkAeroConfig

RateFeedback: TypeAlias = Literal["wrench", "force", "moment", "none"]


class AeroFeedback(Struct, frozen=True, kw_only=True):
    lambda_: bool = field(name="lambda", default=True)
    momentum_rate: RateFeedback = "wrench"
    torque: bool = True


class BoundsConfig(Struct, frozen=True, kw_only=True):
    joint_steepness: float
    joint_velocity_max_deg: float | None = None
    thrust_rate_max: dict[str, float]
    thrust_steepness: float


class DisturbanceObserverConfig(Struct, frozen=True, kw_only=True):
    force_max: float
    gain_force: float
    gain_moment: float
    moment_max: float


class FilterConfig(Struct, frozen=True, kw_only=True):
    delay: float = 0.0
    time_constant: float = 0.0


class LatencyConfig(Struct, frozen=True, kw_only=True):
    thrust: float = 0.0
    torque: float = 0.0


class EstimatorConfig(Struct, frozen=True, kw_only=True):
    base_angular_velocity: FilterConfig = FilterConfig()
    base_linear_velocity: FilterConfig = FilterConfig()
    base_position: FilterConfig = FilterConfig()
    base_rotation: FilterConfig = FilterConfig()
    gyro_bias: float | None = None
    joint_observer: float | None = None
    joint_position: FilterConfig = FilterConfig()
    joint_velocity: FilterConfig = FilterConfig()
    latency: LatencyConfig = LatencyConfig()
    thrust: FilterConfig = FilterConfig()


class UnmeasuredEnginesConfig(Struct, frozen=True, kw_only=True):
    force_min: float


class FaultDetectionConfig(Struct, frozen=True, kw_only=True):
    engines: dict[str, Any] | None = None
    joints: dict[str, Any] | None = None
    latency: dict[str, Any] | None = None
    tracking_error: dict[str, Any] | None = None
    unmeasured_engines: UnmeasuredEnginesConfig | None = None

JacobianOffset: TypeAlias = Literal["link_rotation", "base_rotation"]

JetDynamics: TypeAlias = Literal["ideal", "throttled"]

LeverArm: TypeAlias = Literal["rotated", "unrotated"]

LinkVelocity: TypeAlias = Literal["at_centre", "shifted_twice"]


class MomentumGains(Struct, frozen=True, kw_only=True):
    c0: float
    c1: float
    kd_linear: tuple[float, float, float]
    ko: float
    kp_linear: tuple[float, float, float]

Air: TypeAlias = Literal["linear", "constant"]


class ClearanceConfig(Struct, frozen=True, kw_only=True):
    apart_from: tuple[str, ...]
    exhaust: float
    links: tuple[str, ...]


class MpcWeights(Struct, frozen=True, kw_only=True):
    acceleration: float
    angular_acceleration: float
    angular_velocity: float
    attitude: tuple[float, float, float]
    clearance: float | None = None
    joint_command: float
    joint_velocity: float
    position: tuple[float, float, float]
    posture: dict[str, float]
    tail: tuple[float, float]
    thrust_rate: float
    velocity: tuple[float, float, float]


class MpcConfig(Struct, frozen=True, kw_only=True):
    air: Air = "linear"
    clearance: ClearanceConfig | None = None
    descent: MpcWeights | None = None
    joint_groups: tuple[str, ...]
    joint_knots: tuple[int, ...]
    knots: tuple[float, ...]
    nonlinear_descent: bool = False
    period: float
    thrust_excess: float
    weights: MpcWeights


class PolicyConfig(Struct, frozen=True, kw_only=True):
    card: str


class SetpointConfig(Struct, frozen=True, kw_only=True):
    attitude_rate_deg: tuple[float, float]
    deceleration: float = 1.5
    descent_speed: float = 0.5
    nose_down_limits_deg: tuple[float, float]
    speed: tuple[float, float]


class TorqueConfig(Struct, frozen=True, kw_only=True):
    friction: dict[str, float] | None = None
    kd: float
    kp: float
    rotor_inertia: float = 0.0
    steps: int = 1
    torque_max: float | None = None
    torque_rate_max: float | None = None
    weight_acceleration: float


class MomentumWeights(Struct, frozen=True, kw_only=True):
    angular_momentum: float
    joint_velocity: float
    momentum: float
    posture: float
    symmetric_jets: tuple[tuple[str, str], ...]
    symmetry: float
    thrust_rate: dict[str, float]


class ControllerSection(Struct, frozen=True, kw_only=True):
    aero: AeroConfig
    aero_feedback: AeroFeedback = AeroFeedback()
    axes_of: str | None = None
    bounds: BoundsConfig
    channels: dict[str, Any] = {}
    contact: dict[str, Any] | None = None
    disturbance_observer: DisturbanceObserverConfig | None = None
    estimator: EstimatorConfig | None = None
    fault_detection: FaultDetectionConfig = FaultDetectionConfig()
    jacobian_offset: JacobianOffset = "link_rotation"
    jet_dynamics: JetDynamics = "ideal"
    lever_arm: LeverArm = "rotated"
    link_velocity: LinkVelocity = "at_centre"
    momentum: MomentumGains
    mpc: MpcConfig | None = None
    policy: PolicyConfig | None = None
    posture_gain: dict[str, float]
    qp: dict[str, Any] = {}
    setpoint: SetpointConfig
    shaft: dict[str, Any] | None = None
    time_step: float
    torque: TorqueConfig
    use_jets: bool = True
    weights: MomentumWeights
    wind_observer: bool = False


class ForceFactorsConfig(Struct, frozen=True, kw_only=True):
    drag: float = 1.0
    drag_of: dict[str, float] | None = None
    links: dict[str, float] = {}
    normal: float = 1.0
    normal_of: dict[str, float] | None = None
    scale: float = 1.0


class ConstantWindConfig(Struct, frozen=True, kw_only=True, tag_field="profile", tag="constant"):
    velocity: tuple[float, float, float]


class RampWindConfig(Struct, frozen=True, kw_only=True, tag_field="profile", tag="ramp"):
    ramp_end: float
    ramp_start: float
    velocity: tuple[float, float, float]


class GustWindConfig(Struct, frozen=True, kw_only=True, tag_field="profile", tag="gust"):
    duration: float
    gust: tuple[float, float, float]
    start: float
    velocity: tuple[float, float, float]


class TurbulentWindConfig(Struct, frozen=True, kw_only=True, tag_field="profile", tag="turbulent"):
    ramp_end: float
    ramp_start: float
    seed: int = 0
    std: tuple[float, float, float]
    time_scale: float
    velocity: tuple[float, float, float]


class FileWindConfig(Struct, frozen=True, kw_only=True, tag_field="profile", tag="file"):
    path: str


class SamplesWindConfig(Struct, frozen=True, kw_only=True, tag_field="profile", tag="samples"):
    samples: tuple[tuple[float, float, float, float], ...]


WindConfig: TypeAlias = ConstantWindConfig | RampWindConfig | GustWindConfig | TurbulentWindConfig | FileWindConfig | SamplesWindConfig

FailureKind: TypeAlias = Literal["off", "stuck"]


class JetFailure(Struct, frozen=True, kw_only=True):
    decay: float = 0.0
    jet: str
    kind: FailureKind
    time: float


class MeasurementNoise(Struct, frozen=True, kw_only=True):
    seed: int = 0
    std: float


class JetFaultsConfig(Struct, frozen=True, kw_only=True):
    failure: JetFailure | None = None
    force_scale: dict[str, float] = {}
    lag: float = 0.0
    limit_is_known: bool = False
    measurement_noise: MeasurementNoise | None = None
    thrust_limit_scale: float | None = None

JointFaultKind: TypeAlias = Literal["stuck", "weak", "free"]


class JointFault(Struct, frozen=True, kw_only=True):
    joint: str
    kind: JointFaultKind
    start: float


class ModelError(Struct, frozen=True, kw_only=True):
    com_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    inertia_scale: float = 1.0
    mass_scale: float = 1.0
    of_plant: bool | None = None
    thrust_axes: tuple[tuple[float, float, float], ...] = ()

OutageChannel: TypeAlias = Literal["wind", "thrust", "joints", "base_position", "base_rotation", "base_velocity", "height", "feet"]

OutageKind: TypeAlias = Literal["missing", "nan", "frozen", "wrong"]


class Outage(Struct, frozen=True, kw_only=True):
    channel: OutageChannel
    duration: float | None = None
    error: float = 1.0
    jet: str | None = None
    kind: OutageKind
    start: float


class Push(Struct, frozen=True, kw_only=True):
    body: str
    duration: float
    force: tuple[float, float, float] = (0.0, 0.0, 0.0)
    moment: tuple[float, float, float] = (0.0, 0.0, 0.0)
    start: float


class WindEstimateConfig(Struct, frozen=True, kw_only=True):
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    delay: float = 0.0
    mean_only: bool = False
    noise_std: float = 0.0
    seed: int = 0
    time_constant: float = 0.0


class Disturbances(Struct, frozen=True, kw_only=True):
    aero: ForceFactorsConfig = ForceFactorsConfig()
    aero_estimate: ForceFactorsConfig = ForceFactorsConfig()
    controller_wind: WindConfig | None = None
    jets: JetFaultsConfig = JetFaultsConfig()
    joints: tuple[JointFault, ...] = ()
    model_error: ModelError = ModelError()
    outages: tuple[Outage, ...] = ()
    pushes: tuple[Push, ...] = ()
    wind_estimate: WindEstimateConfig | None = None


class MissionConfig(Struct, frozen=True, kw_only=True):
    down: tuple[tuple[float, float], ...] = ()
    file: str | None = None
    forward: tuple[tuple[float, float], ...] = ()
    forward_turbo: tuple[tuple[float, float], ...] = ()
    land: tuple[tuple[float, float], ...] | None = None
    pitch_up: tuple[tuple[float, float], ...] = ()
    up: tuple[tuple[float, float], ...] = ()
    yaw_left: tuple[tuple[float, float], ...] = ()


class ActuationConfig(Struct, frozen=True, kw_only=True):
    drop: float = 0.0
    jitter: float = 0.0
    seed: int = 0
    thrust_delay: float = 0.0
    torque_delay: float = 0.0

DynamicsBackend: TypeAlias = Literal["tree", "mjx"]


class FallConfig(Struct, frozen=True, kw_only=True):
    com_error: float
    rotation_error_deg: float


class InitialConfig(Struct, frozen=True, kw_only=True):
    base_position: tuple[float, float, float]
    base_rpy_deg: tuple[float, float, float]
    base_velocity: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    free_fall_tick: bool = False
    joint_position: tuple[float, ...]
    thrust: tuple[float, ...]

Integrator: TypeAlias = Literal["semi_implicit_euler", "explicit_euler"]

ThrustFeedback: TypeAlias = Literal["measured", "estimated", "speed"]


class IdealJetsConfig(Struct, frozen=True, kw_only=True, tag_field="dynamics", tag="ideal"):
    pass


class ThrottledJetsConfig(Struct, frozen=True, kw_only=True, tag_field="dynamics", tag="throttled"):
    engines: tuple[str, ...] | None = None
    feedback: ThrustFeedback = "measured"
    shaft: dict[str, Any] | None = None


class MeasuredJetsConfig(Struct, frozen=True, kw_only=True, tag_field="dynamics", tag="measured"):
    rate: tuple[tuple[float, ...], ...]
    throttle: tuple[float, ...]
    thrust: tuple[float, ...]


JetsConfig: TypeAlias = IdealJetsConfig | ThrottledJetsConfig | MeasuredJetsConfig

AeroKinematics: TypeAlias = Literal["current", "frozen"]


class ElasticityConfig(Struct, frozen=True, kw_only=True):
    damping: float
    stiffness: float


class MotorsConfig(Struct, frozen=True, kw_only=True):
    damping: float
    elasticity: ElasticityConfig | None = None
    friction: float
    friction_of: dict[str, float] = {}
    inertia: float
    load_friction: dict[str, float] = {}
    time_constant: float = 0.0


class SensorConfig(Struct, frozen=True, kw_only=True):
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    delay: float = 0.0
    drift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gaps: float = 0.0
    noise_std: float = 0.0
    period: float = 0.0


class FootSensorConfig(Struct, frozen=True, kw_only=True):
    cross_talk: float = 0.0
    delay: float = 0.0
    force_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    force_noise_std: float = 0.0
    moment_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    moment_noise_std: float = 0.0
    tilt_rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)


class HeightSensorConfig(Struct, frozen=True, kw_only=True):
    bias: float = 0.0
    delay: float = 0.0
    gaps: float = 0.0
    noise_std: float = 0.0
    period: float = 0.0


class TrembleConfig(Struct, frozen=True, kw_only=True):
    amplitude: float
    frequency: float


class EncoderConfig(Struct, frozen=True, kw_only=True):
    bias: tuple[float, ...] = ()
    delay: float = 0.0
    resolution: float = 0.0
    tremble: TrembleConfig | None = None
    velocity_time_constant: float | None = None


class ThrustSensorConfig(Struct, frozen=True, kw_only=True):
    bias: float = 0.0
    delay: float = 0.0
    noise_std: float = 0.0
    resolution: float = 0.0


class SensorsConfig(Struct, frozen=True, kw_only=True):
    base_angular_velocity: SensorConfig = SensorConfig()
    base_linear_velocity: SensorConfig = SensorConfig()
    base_position: SensorConfig = SensorConfig()
    base_rotation: SensorConfig = SensorConfig()
    feet: FootSensorConfig | None = None
    height: HeightSensorConfig | None = None
    joints: EncoderConfig = EncoderConfig()
    seed: int = 0
    thrust: ThrustSensorConfig = ThrustSensorConfig()
    wind_preview: float = 0.0


class SimulatorConfig(Struct, frozen=True, kw_only=True):
    actuation: ActuationConfig | None = None
    aero: AeroConfig
    duration: float
    dynamics: DynamicsBackend = "tree"
    fall: FallConfig
    fuel: dict[str, Any] | None = None
    ground: dict[str, Any] | None = None
    ground_height: float | None = None
    initial: InitialConfig
    integrator: Integrator = "semi_implicit_euler"
    jets: JetsConfig
    joint_stops: bool = True
    kinematics: AeroKinematics = "current"
    lever_arm: LeverArm = "rotated"
    motors: MotorsConfig | None = None
    sensors: SensorsConfig | None = None
    substeps: int = 1


class ScenarioConfig(Struct, frozen=True, kw_only=True):
    backend: Backend = "rust"
    controller: ControllerSection
    description: str = ""
    disturbances: Disturbances = Disturbances()
    mission: MissionConfig
    own_controller: dict[str, Any] | None = None
    robot: str
    simulator: SimulatorConfig
    title: str = ""
    wind: WindConfig

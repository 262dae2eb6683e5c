//! Greatest accepted magnitudes of the measured numbers, which a flight that has not diverged does not exceed, and greatest
//! differences from their predictions.

/// Thrust, as a multiple of the jet's greatest.
pub const THRUST: f64 = 10.0;

/// Force on a foot \[N\]: a hundred times the weight of such robots.
pub const FOOT_FORCE: f64 = 1e5;

/// Torque that acts in place of a commanded one, as a multiple of the joint's greatest.
pub const TORQUE: f64 = 2.0;

/// Thrust rate that does so, as a multiple of the greatest accepted thrust \[1/s\].
pub const THRUST_RATE: f64 = 10.0;

/// Moment on a foot \[N m\].
pub const FOOT_MOMENT: f64 = 1e5;

/// The others.
pub const MAGNITUDES: Jumps = Jumps {
    // Near the speed of sound, where no aerodynamic model here is valid.
    wind: 300.0,
    joint_position: 100.0,
    // Ten times that of the motors of such robots.
    joint_velocity: 100.0,
    // Beyond, a micrometre is lost to rounding.
    position: 1e6,
    rotation: 2.0,
    // As of the wind.
    velocity: 300.0,
    // 16 turns a second.
    angular_velocity: 100.0,
    height: 1e6,
};

/// Greatest differences from the prediction. Thrusts and feet have no limit.
#[derive(Debug, Clone, PartialEq)]
pub struct Jumps {
    /// Wind \[m/s\].
    pub wind: f64,
    /// Joint position \[rad, m\].
    pub joint_position: f64,
    /// Joint velocity \[rad/s, m/s\].
    pub joint_velocity: f64,
    /// Position of the base \[m\].
    pub position: f64,
    /// Entry of the rotation matrix of the base.
    pub rotation: f64,
    /// Velocity of the base \[m/s\].
    pub velocity: f64,
    /// Angular velocity of the base \[rad/s\].
    pub angular_velocity: f64,
    /// Height above the ground \[m\].
    pub height: f64,
}

impl Jumps {
    /// Greatest accepted ones; what a tick can change is far less: gusts, noise and pushes pass.
    pub const GREATEST: Self = Self {
        // Six times what turbulence of 8 m/s changes. A wind that is beyond for as long as it is held is not used any more.
        wind: 5.0,
        joint_position: 0.5,
        joint_velocity: 30.0,
        position: 0.3,
        rotation: 0.2,
        velocity: 1.0,
        // Without a model the prediction is off by 2 in winds of 32 m/s.
        angular_velocity: 4.0,
        // A step of the ground of 0.5 m is accepted when 0.3 (1 + age) has grown to it, after 0.67 s; of heights with noise of
        // 0.02 m the first that is near enough is accepted, after 0.5 s.
        height: 0.3,
    };

    /// No limits.
    pub(super) const NONE: Self = Self {
        wind: f64::INFINITY,
        joint_position: f64::INFINITY,
        joint_velocity: f64::INFINITY,
        position: f64::INFINITY,
        rotation: f64::INFINITY,
        velocity: f64::INFINITY,
        angular_velocity: f64::INFINITY,
        height: f64::INFINITY,
    };
}

//! Greatest accepted magnitudes of the measured numbers, which a flight that has not diverged does not exceed.

use super::channels::Jumps;

/// Thrust, as a multiple of the jet's greatest.
pub const THRUST: f64 = 10.0;

/// Force on a foot \[N\]: a hundred times the weight of such robots.
pub const FOOT_FORCE: f64 = 1e5;

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
};

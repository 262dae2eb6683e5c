//! Greatest accepted magnitudes of the measured numbers, which a flight that has not diverged does not exceed.

/// Wind \[m/s\]: near the speed of sound, where no aerodynamic model here is valid.
pub const WIND: f64 = 300.0;

/// Thrust, as a multiple of the jet's greatest.
pub const THRUST: f64 = 10.0;

/// Joint position \[rad, m\].
pub const JOINT_POSITION: f64 = 100.0;

/// Joint velocity \[rad/s, m/s\]: ten times that of the motors of such robots.
pub const JOINT_VELOCITY: f64 = 100.0;

/// Position of the base \[m\]: beyond, a micrometre is lost to rounding.
pub const POSITION: f64 = 1e6;

/// Velocity of the base \[m/s\], as of the wind.
pub const VELOCITY: f64 = 300.0;

/// Angular velocity of the base \[rad/s\]: 16 turns a second.
pub const ANGULAR_VELOCITY: f64 = 100.0;

/// Force on a foot \[N\]: a hundred times the weight of such robots.
pub const FOOT_FORCE: f64 = 1e5;

/// Moment on a foot \[N m\].
pub const FOOT_MOMENT: f64 = 1e5;

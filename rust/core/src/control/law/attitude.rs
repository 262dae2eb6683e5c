//! The attitude task: demand on the angular momentum that rotates the base towards its set-point.
//!
//! All quantities are in body axes. With the base rotation `R`, `w = Rᵀ ω_B`, the centroidal inertia in body
//! axes `I₀` *at the first tick* (held constant) and `I_b` now:
//!
//! ```text
//! k = I₀ w,   k̇ = Rᵀ L̇_ang − w × k,   E = R_dᵀ R,   e = sk(E)^∨,   ė = sk(E S(w) − S(ω_d) E)^∨
//! k̈* = I₀ ω̈_d − ė − (1 + c₀ I₀⁻¹)(k̇ − I₀ ω̇_d) − c₀ I₀⁻¹ e − c₁ I₀⁻¹ (k − I₀ ω_d)
//! σ  = R ( w × (w × k) + 2 w × k̇ + (I₀⁻¹ k̇) × k )
//! ```
//!
//! The task demands `Rᵀ (L̈_ang − σ) = k̈*`. It has no integral action: a constant moment `d` that is not in
//! the controller's model causes the steady-state error `e = (1 + I₀/c₀) d`.
//!
//! Equations M59 to M61 and, for the last sentence, M67 of `docs/model`.

use super::setpoint::Setpoint;
use crate::spatial::{skew, vee_of_skew_part};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// Gains of the momentum task (M57 of `docs/model`) and the attitude task (M60).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MomentumGains {
    /// `K_P` on the integral of the linear momentum error, per axis \[1/s²\].
    #[schemars(inner(range(min = 0)))]
    pub kp_linear: [f64; 3],
    /// `K_D` on the linear momentum error, per axis \[1/s\].
    #[schemars(inner(range(min = 0)))]
    pub kd_linear: [f64; 3],
    /// `K_O`; its inverse is added to `K_P + K_D` \[s\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub ko: f64,
    /// `c₀` of the attitude task \[N m\].
    #[schemars(range(min = 0))]
    pub c0: f64,
    /// `c₁` of the attitude task \[N m s\].
    #[schemars(range(min = 0))]
    pub c1: f64,
}

/// Demand of the attitude task.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AttitudeDemand {
    /// Desired second derivative of the body angular momentum, `k̈*` \[N m/s, body axes\].
    pub k_ddot_desired_b: Vector3<f64>,
    /// Gyroscopic terms between `L̈` and `k̈`, `σ` \[N m/s, inertial axes\].
    pub sigma_i: Vector3<f64>,
}

/// Evaluates the attitude law. `inertia_0_b` must be invertible, which is checked when it is recorded.
#[must_use]
pub fn attitude_demand(
    gains: &MomentumGains,
    setpoint: &Setpoint,
    rotation: &Matrix3<f64>,
    angular_velocity_i: &Vector3<f64>,
    moment_estimate_i: &Vector3<f64>,
    inertia_0_b: &Matrix3<f64>,
    inverse_inertia_0_b: &Matrix3<f64>,
) -> AttitudeDemand {
    let (c0, c1) = (gains.c0, gains.c1);
    let (i0, i0_inv) = (inertia_0_b, inverse_inertia_0_b);
    let w = rotation.transpose() * angular_velocity_i;
    let w_d = &setpoint.angular_velocity_b;

    let k = i0 * w;
    let k_dot = rotation.transpose() * moment_estimate_i - w.cross(&k);
    let error = setpoint.rotation.transpose() * rotation;
    let e = vee_of_skew_part(&error);
    let e_dot = vee_of_skew_part(&(error * skew(&w) - skew(w_d) * error));

    let k_dot_error = k_dot - i0 * setpoint.angular_acceleration_b;
    let k_ddot_desired_b = i0 * setpoint.angular_jerk_b
        - e_dot
        - (k_dot_error + i0_inv * k_dot_error * c0)
        - i0_inv * e * c0
        - i0_inv * (k - i0 * w_d) * c1;
    let sigma_b = w.cross(&w.cross(&k)) + w.cross(&k_dot) * 2.0 + (i0_inv * k_dot).cross(&k);
    AttitudeDemand { k_ddot_desired_b, sigma_i: rotation * sigma_b }
}

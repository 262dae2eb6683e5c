//! The joint torque controller: torques whose accelerations follow the commanded joint velocities.
//!
//! ```text
//! s̈* = −K_D (ṡ − ṡ*) − K_P ∫(ṡ − ṡ*)
//! s̈(τ) = G τ + s̈_free,   G = (M⁻¹)_ss,   s̈_free = [M⁻¹ (Σ Jᵀ T a + J_aᵀ f_a − h)]_s
//! min ½ w_a |s̈(τ) − s̈*|² + ½ (w_τ + ε) |τ|²   subject to |τ| ≤ τ_max
//! ```
//!
//! followed by a rate limiter. The robot floats: `G` is the joint block of the inverse mass matrix,
//! not the inverse of the joint block. Equations M68 to M72 of `docs/model.md` (the paper prints
//! `τ = b̄ − M̄⁻¹ s̈**`, which contradicts its own `M̄ s̈ + b̄ = τ`; see `docs/deviations.md`).

use super::config::TorqueConfig;
use crate::dynamics::MassFactor;
use crate::linalg;
use crate::qp::QpProblem;
use crate::robot::RobotModel;
use nalgebra::{DMatrix, DVector};

/// The torque QP of one tick; preallocated.
#[derive(Debug, Clone)]
pub struct TorqueQp {
    /// Desired joint accelerations `s̈*` \[rad/s²\].
    pub acceleration_desired: DVector<f64>,
    /// Joint accelerations without torque, `s̈_free` \[rad/s²\].
    pub acceleration_free: DVector<f64>,
    /// `G`, joint acceleration per unit of torque \[1/(kg m²)\].
    pub gain: DMatrix<f64>,
    /// The QP handed to the solver.
    pub problem: QpProblem,
    inverse_factor: DMatrix<f64>,
}

impl TorqueQp {
    /// Space for `robot`, whose torque limits do not change in flight.
    #[must_use]
    pub fn new(robot: &RobotModel) -> Self {
        let joints = robot.joints.len();
        let mut problem = QpProblem::new(joints, 0);
        for (index, joint) in robot.joints.iter().enumerate() {
            (problem.lower[index], problem.upper[index]) = (-joint.torque_max, joint.torque_max);
        }
        Self {
            acceleration_desired: DVector::zeros(joints),
            acceleration_free: DVector::zeros(joints),
            gain: DMatrix::zeros(joints, joints),
            problem,
            inverse_factor: DMatrix::zeros(joints, joints),
        }
    }

    /// Builds the QP. `force` holds `Σ Jᵀ T a + J_aᵀ f_a − h` and is overwritten with the free
    /// accelerations of base and joints.
    pub fn update(
        &mut self,
        config: &TorqueConfig,
        mass_factor: &MassFactor,
        force: &mut DVector<f64>,
        velocity_error: &DVector<f64>,
        velocity_error_integral: &DVector<f64>,
    ) {
        let joints = self.gain.nrows();
        mass_factor.solve_in_place(force);
        self.acceleration_free.copy_from(&force.rows(6, joints));
        self.acceleration_desired.copy_from(velocity_error);
        self.acceleration_desired.axpy(-config.kp, velocity_error_integral, -config.kd);

        // M = K Kᵀ with the base first, so (M⁻¹)_ss = Wᵀ W with W the inverse of K's joint block.
        let n = 6 + joints;
        let work = self.inverse_factor.as_mut_slice();
        linalg::invert_symmetric(mass_factor.joint_block(), joints, n, work, self.gain.as_mut_slice());

        // H = w_a G² + (w_τ + ε) 1 and g = w_a G (s̈_free − s̈*), G symmetric.
        let QpProblem { h, g, .. } = &mut self.problem;
        linalg::square_symmetric(self.gain.as_slice(), joints, h.as_mut_slice());
        *h *= config.weight_acceleration;
        for joint in 0..joints {
            h[(joint, joint)] += config.weight_torque + config.regularisation;
        }
        self.acceleration_free -= &self.acceleration_desired;
        g.gemv(config.weight_acceleration, &self.gain, &self.acceleration_free, 0.0);
        self.acceleration_free += &self.acceleration_desired;
    }
}

/// Moves every torque towards its target by at most its `rate_max · time_step`.
pub fn limit_rate(
    torque: &mut DVector<f64>,
    target: &[f64],
    rate_max: impl IntoIterator<Item = f64>,
    time_step: f64,
) {
    for ((torque, target), rate_max) in torque.iter_mut().zip(target).zip(rate_max) {
        let step = rate_max * time_step;
        *torque += (target - *torque).clamp(-step, step);
    }
}

//! The generalised force of a tick that the model does not explain, which the detection judges.

use super::JointSample;
use crate::control::guard::channels::ChannelsState;
use crate::control::terms::Terms;
use crate::robot::RobotModel;
use crate::spatial::parts;
use nalgebra::DVector;

/// Workspace of `r`.
#[derive(Debug, Clone)]
pub(crate) struct JointResidual {
    /// Stops of the joints, lower and upper \[rad, m\].
    stops: Vec<(f64, f64)>,
    unexplained: DVector<f64>,
    residual: DVector<f64>,
}

impl JointResidual {
    /// Allocates for the joints of `robot`.
    #[must_use]
    pub(crate) fn new(robot: &RobotModel) -> Self {
        let stops: Vec<_> = robot.joints.iter().map(|joint| joint.stops).collect();
        let rows = DVector::zeros(6 + stops.len());
        Self { stops, unexplained: rows.clone(), residual: rows }
    }

    /// What a tick shows of the joints, after the `last` one.
    pub(crate) fn sample<'a>(&'a mut self, terms: &Terms, last: &'a ChannelsState) -> JointSample<'a> {
        let Terms { measurement: used, dynamics, kinematics, momentum, .. } = terms;
        let velocities = used.state.velocity.iter().zip(&last.commanded_in.velocity);
        for ((to, (now, before)), predicted) in
            self.unexplained.iter_mut().zip(velocities).zip(&last.acceleration)
        {
            *to = (now - before) / used.elapsed - predicted;
        }
        self.residual.gemv(1.0, &dynamics.mass_matrix, &self.unexplained, 0.0);
        let (force, moment) = parts(&momentum.unmodelled_wrench);
        let arm = kinematics.com - kinematics.bodies[0].i_from_b.position;
        let mut rows = self.residual.fixed_rows_mut::<3>(0);
        rows += force;
        let mut rows = self.residual.fixed_rows_mut::<3>(3);
        rows += moment + arm.cross(&force);
        JointSample {
            dt: used.elapsed,
            residual: &self.residual,
            torque: &last.joint_torque,
            stops: &self.stops,
        }
    }
}

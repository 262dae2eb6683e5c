//! Forces at points of bodies, summed over the subtree of each joint.
//!
//! One pass from the tips to the base replaces a Jacobian for each point. With `r` from the base origin, `F = Σ f`,
//! `E = Σ r fᵀ` and `M = Σ (r × f + c)` are sums over a subtree; `M` is held as the antisymmetric part of `E`, to which
//! a couple `c` adds `−S(c)/2`. A unit rate of the subtree's joint moves it with the angular velocity `ω` and, at the
//! base origin, the velocity `v_o`; then
//!
//! ```text
//! Σ f · v + c · ω               = F · v_o + M · ω            Jᵀ (f, c)
//! Σ f × v                       = F × v_o + tr(E) ω − E ω    moving forces of constant direction, no couples
//! Σ f × v + r × (f × ω) + c × ω = F × v_o + M × ω            moving forces and couples that turn with their bodies
//! ```
//!
//! Equations M27, M51 and M52 of `docs/model`.

use crate::kinematics::Kinematics;
use crate::robot::RobotModel;
use crate::spatial::{skew, vee_of_skew_part};
use nalgebra::{DVector, Matrix3, Vector3};

/// Forces on one subtree; none by default.
#[derive(Debug, Clone, Copy, Default)]
pub struct Load {
    /// `F = Σ f` \[N\].
    pub force: Vector3<f64>,
    /// `E = Σ (r fᵀ − S(c)/2)` about the base origin \[N m\].
    pub dyad: Matrix3<f64>,
}

impl Load {
    /// `M = Σ (r × f + c)` about the base origin \[N m\].
    #[must_use]
    pub fn moment(&self) -> Vector3<f64> {
        -2.0 * vee_of_skew_part(&self.dyad)
    }
}

/// The loads of all subtrees; preallocated, recomputed by [`SubtreeLoads::update`].
#[derive(Debug, Clone)]
pub struct SubtreeLoads {
    /// Indexed by the first body of the subtree.
    loads: Vec<Load>,
}

impl SubtreeLoads {
    /// Allocates for the subtrees of `robot`.
    #[must_use]
    pub fn new(robot: &RobotModel) -> Self {
        Self { loads: vec![Load::default(); robot.bodies.len()] }
    }

    /// Sums forces and couples `(body, point_i, force_i, couple_i)`, each on a body at a point \[m, N, N m, inertial axes\].
    pub fn update(
        &mut self,
        robot: &RobotModel,
        kinematics: &Kinematics,
        forces: impl Iterator<Item = (usize, Vector3<f64>, Vector3<f64>, Vector3<f64>)>,
    ) {
        let origin = kinematics.bodies[0].i_from_b.position;
        self.loads.fill(Load::default());
        for (body, point, force, couple) in forces {
            let load = &mut self.loads[body];
            load.force += force;
            load.dyad += (point - origin) * force.transpose() - skew(&(0.5 * couple));
        }
        for index in (1..self.loads.len()).rev() {
            let load = self.loads[index];
            let parent = &mut self.loads[robot.bodies[index].parent.unwrap_or(0)];
            parent.force += load.force;
            parent.dyad += load.dyad;
        }
    }

    /// Load of the whole robot.
    #[must_use]
    pub fn total(&self) -> &Load {
        &self.loads[0]
    }

    /// Visits every entry of ν with the load that it moves: `visit(column, load, v_o, ω)`.
    #[inline]
    pub fn visit(
        &self,
        kinematics: &Kinematics,
        mut visit: impl FnMut(usize, &Load, Vector3<f64>, Vector3<f64>),
    ) {
        let (zero, identity) = (Vector3::zeros(), Matrix3::identity());
        for column in 0..kinematics.n_velocities() {
            let (body, v_o, omega) = match column {
                0..3 => (0, identity.column(column).into(), zero),
                3..6 => (0, zero, identity.column(column - 3).into()),
                _ => {
                    let motion = &kinematics.bodies[column - 5];
                    (column - 5, motion.joint_linear_at_base_i, motion.joint_angular_i)
                }
            };
            visit(column, &self.loads[body], v_o, omega);
        }
    }

    /// Adds `Σ Jᵀ f`.
    pub fn add_generalised_force(&self, kinematics: &Kinematics, generalised: &mut DVector<f64>) {
        self.visit(kinematics, |column, load, v_o, omega| {
            generalised[column] += load.force.dot(&v_o) + load.moment().dot(&omega);
        });
    }
}

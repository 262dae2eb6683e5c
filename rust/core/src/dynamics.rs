//! Mass matrix, bias forces and centroidal momentum of the floating tree.
//!
//! ```text
//! M(q) ν̇ + h(q, ν) = S τ + Σ Jᵀ f        h contains gravity
//! L = A_G(q) ν                             L = (l, k), momentum about the centre of mass
//! ```
//!
//! All quantities are in inertial axes about the base origin, so that one set of composite inertias, summed
//! from the tips to the base, gives `M`, `A_G`, the centre-of-mass Jacobian `l / m` and the centroidal
//! inertia.
//!
//! Equations M11 to M17 of `docs/model`.

use crate::kinematics::{Kinematics, RobotState};
use crate::linalg;
use crate::robot::RobotModel;
use crate::spatial::{parts, skew};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix6xX, Vector3, Vector6};

/// Mass, first moment and inertia of a set of bodies about the base origin, inertial axes.
#[derive(Debug, Clone, Copy)]
struct Composite {
    mass: f64,
    /// `Σ m r` \[kg m\].
    first_moment: Vector3<f64>,
    /// `Σ (I + m (|r|² − r rᵀ))` \[kg m²\].
    inertia: Matrix3<f64>,
}

impl std::ops::AddAssign for Composite {
    fn add_assign(&mut self, rhs: Self) {
        self.mass += rhs.mass;
        self.first_moment += rhs.first_moment;
        self.inertia += rhs.inertia;
    }
}

/// Rigid-body dynamics of one state; preallocated, recomputed by [`Dynamics::update`].
#[derive(Debug, Clone)]
pub struct Dynamics {
    /// Mass matrix `M` (n × n, n = 6 + joints), symmetric, both triangles filled.
    pub mass_matrix: DMatrix<f64>,
    /// Bias `h`: Coriolis, centrifugal and gravity forces (n).
    pub bias: DVector<f64>,
    /// Centroidal momentum matrix `A_G` (6 × n), linear rows first.
    pub momentum_matrix: Matrix6xX<f64>,
    /// Centroidal momentum `L = A_G ν` \[kg m/s, kg m²/s\].
    pub momentum: Vector6<f64>,
    /// Centroidal rotational inertia `I_G` \[kg m², inertial axes\].
    pub centroidal_inertia: Matrix3<f64>,
    composites: Vec<Composite>,
    inertias_i: Vec<Matrix3<f64>>,
    wrenches: Vec<(Vector3<f64>, Vector3<f64>)>,
    accelerations: Vec<(Vector3<f64>, Vector3<f64>)>,
}

impl Dynamics {
    /// Allocates for the dynamics of `robot`.
    #[must_use]
    pub fn new(robot: &RobotModel) -> Self {
        let n = 6 + robot.joints.len();
        let n_bodies = robot.bodies.len();
        let nothing = Composite { mass: 0.0, first_moment: Vector3::zeros(), inertia: Matrix3::zeros() };
        Self {
            mass_matrix: DMatrix::zeros(n, n),
            bias: DVector::zeros(n),
            momentum_matrix: Matrix6xX::zeros(n),
            momentum: Vector6::zeros(),
            centroidal_inertia: Matrix3::zeros(),
            composites: vec![nothing; n_bodies],
            inertias_i: vec![Matrix3::zeros(); n_bodies],
            wrenches: vec![(Vector3::zeros(), Vector3::zeros()); n_bodies],
            accelerations: vec![(Vector3::zeros(), Vector3::zeros()); n_bodies],
        }
    }

    /// Recomputes all quantities; `kinematics` must belong to `state`.
    pub fn update(&mut self, robot: &RobotModel, state: &RobotState, kinematics: &Kinematics) {
        self.update_momentum(robot, state, kinematics);
        for (index, joint) in robot.joints.iter().enumerate() {
            self.mass_matrix[(6 + index, 6 + index)] += joint.rotor_inertia;
        }
        self.update_bias(robot, state, kinematics);
    }

    /// Recomputes momentum and inertias only.
    pub(crate) fn update_momentum(
        &mut self,
        robot: &RobotModel,
        state: &RobotState,
        kinematics: &Kinematics,
    ) {
        self.update_composites(robot, kinematics);
        self.update_mass_and_momentum_matrix(kinematics);
        self.momentum.gemv(1.0, &self.momentum_matrix, &state.velocity, 0.0);
    }

    /// Adds the acceleration of the robot as one body under a wrench about its centre of mass \[N, N m\], whose joints keep
    /// theirs; none where the inertia is not positive definite.
    ///
    /// ```text
    /// ( f/m − α × (p_G − p_B), α, 0 ),   α = I_G⁻¹ μ
    /// ```
    pub fn add_whole_acceleration(
        &self,
        kinematics: &Kinematics,
        wrench: &Vector6<f64>,
        acceleration: &mut DVector<f64>,
    ) {
        let Some(inertia) = self.centroidal_inertia.cholesky() else { return };
        let (force, moment) = parts(wrench);
        let angular = inertia.solve(&moment);
        let arm = kinematics.com - kinematics.bodies[0].i_from_b.position;
        let linear = force / kinematics.mass() - angular.cross(&arm);
        for axis in 0..3 {
            acceleration[axis] += linear[axis];
            acceleration[3 + axis] += angular[axis];
        }
    }

    /// `J̇ ν` of the point of `body` that is now at `point_i`: its linear and angular acceleration for ν̇ = 0
    /// \[m/s², rad/s²\]. Refers to the state of the last [`Dynamics::update`].
    #[must_use]
    pub fn velocity_product(
        &self,
        kinematics: &Kinematics,
        body: usize,
        point_i: &Vector3<f64>,
    ) -> (Vector3<f64>, Vector3<f64>) {
        let motion = &kinematics.bodies[body];
        let arm = point_i - motion.i_from_b.position;
        let omega = motion.angular_velocity;
        let (linear, angular) = self.accelerations[body];
        (linear + angular.cross(&arm) + omega.cross(&omega.cross(&arm)), angular)
    }

    /// Writes the momentum of every subtree, linear and about the base origin \[kg m/s, kg m²/s\]; `momenta` has one
    /// entry for each body.
    pub fn subtree_momenta(
        &self,
        robot: &RobotModel,
        kinematics: &Kinematics,
        momenta: &mut [(Vector3<f64>, Vector3<f64>)],
    ) {
        let origin = kinematics.bodies[0].i_from_b.position;
        for (index, (body, motion)) in robot.bodies.iter().zip(&kinematics.bodies).enumerate() {
            let com = motion.i_from_b.transform_point(&body.com_b);
            let linear = motion.velocity_at(&com) * body.mass;
            let spin = self.inertias_i[index] * motion.angular_velocity;
            momenta[index] = (linear, spin + (com - origin).cross(&linear));
        }
        for index in (1..robot.bodies.len()).rev() {
            let (linear, angular) = momenta[index];
            let parent = &mut momenta[robot.bodies[index].parent.unwrap_or(0)];
            parent.0 += linear;
            parent.1 += angular;
        }
    }

    /// Derivative of the momentum, linear and about the centre of mass, by the position of `joint` at constant ν, from
    /// [`Dynamics::subtree_momenta`].
    ///
    /// ```text
    /// ∂h = a ×* h_sub − I_sub (a × V_P)      a motion of the joint, V_P that of the body that carries it
    /// ∂k = ∂k_O − J_G,j × l − (p − O) × ∂l
    /// ```
    ///
    /// Equation M117 of `docs/model`.
    #[must_use]
    pub fn momentum_by_joint(
        &self,
        robot: &RobotModel,
        kinematics: &Kinematics,
        momenta: &[(Vector3<f64>, Vector3<f64>)],
        joint: usize,
    ) -> (Vector3<f64>, Vector3<f64>) {
        let origin = kinematics.bodies[0].i_from_b.position;
        let (motion, subtree) = (&kinematics.bodies[joint + 1], &self.composites[joint + 1]);
        let parent = &kinematics.bodies[robot.bodies[joint + 1].parent.unwrap_or(0)];
        let (axis, v_o) = (motion.joint_angular_i, motion.joint_linear_at_base_i);
        let (omega_p, v_p) = (parent.angular_velocity, parent.velocity_at(&origin));
        let (linear, angular) = momenta[joint + 1];
        let (turned, moved) = (axis.cross(&omega_p), axis.cross(&v_p) + v_o.cross(&omega_p));
        let by_l = axis.cross(&linear) - (moved * subtree.mass + turned.cross(&subtree.first_moment));
        let by_k = axis.cross(&angular) + v_o.cross(&linear)
            - (subtree.inertia * turned + subtree.first_moment.cross(&moved));
        let j_g: Vector3<f64> =
            self.momentum_matrix.fixed_view::<3, 1>(0, 6 + joint) / self.composites[0].mass;
        let total: Vector3<f64> = self.momentum.fixed_rows::<3>(0).into();
        (by_l, by_k - j_g.cross(&total) - (kinematics.com - origin).cross(&by_l))
    }

    /// Inertia of every body and of every subtree about the base origin.
    fn update_composites(&mut self, robot: &RobotModel, kinematics: &Kinematics) {
        let origin = kinematics.bodies[0].i_from_b.position;
        for (index, (body, motion)) in robot.bodies.iter().zip(&kinematics.bodies).enumerate() {
            let rotation = &motion.i_from_b.rotation;
            let inertia = rotation * body.inertia_b * rotation.transpose();
            let r = motion.i_from_b.transform_point(&body.com_b) - origin;
            let parallel_axis = Matrix3::from_diagonal_element(r.norm_squared()) - r * r.transpose();
            self.inertias_i[index] = inertia;
            self.composites[index] = Composite {
                mass: body.mass,
                first_moment: r * body.mass,
                inertia: inertia + parallel_axis * body.mass,
            };
        }
        for index in (1..robot.bodies.len()).rev() {
            let subtree = self.composites[index];
            self.composites[robot.bodies[index].parent.unwrap_or(0)] += subtree;
        }
    }

    /// Composite rigid-body algorithm (M12).
    ///
    /// A unit velocity of joint j moves its subtree with the angular velocity `ω` and, at the base origin o,
    /// the velocity `v_o` (revolute: `a` and `(p − o) × a`; prismatic: zero and `a`). The momentum of the
    /// subtree about o is `l = m v_o + ω × s`, `k = I ω + s × v_o` with the first moment s. Then
    /// `M_ij = ω_i·k_j + v_o,i·l_j` for every joint i between j and the base.
    fn update_mass_and_momentum_matrix(&mut self, kinematics: &Kinematics) {
        let whole = self.composites[0];
        let com = whole.first_moment / whole.mass;
        let m = &mut self.mass_matrix;
        let a_g = &mut self.momentum_matrix;

        let base_coupling = -skew(&whole.first_moment);
        let centroidal = whole.inertia
            - (Matrix3::from_diagonal_element(com.norm_squared()) - com * com.transpose()) * whole.mass;
        let mass_i3 = Matrix3::from_diagonal_element(whole.mass);
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(&mass_i3);
        m.fixed_view_mut::<3, 3>(0, 3).copy_from(&base_coupling);
        m.fixed_view_mut::<3, 3>(3, 0).copy_from(&base_coupling.transpose());
        m.fixed_view_mut::<3, 3>(3, 3).copy_from(&whole.inertia);
        a_g.fixed_view_mut::<3, 3>(0, 0).copy_from(&mass_i3);
        a_g.fixed_view_mut::<3, 3>(3, 0).fill(0.0);
        a_g.fixed_view_mut::<3, 3>(0, 3).copy_from(&base_coupling);
        a_g.fixed_view_mut::<3, 3>(3, 3).copy_from(&centroidal);
        self.centroidal_inertia = centroidal;

        for joint in 0..kinematics.bodies.len() - 1 {
            let subtree = &self.composites[joint + 1];
            let axis = kinematics.bodies[joint + 1].joint_angular_i;
            let v_o = kinematics.bodies[joint + 1].joint_linear_at_base_i;
            let l = v_o * subtree.mass + axis.cross(&subtree.first_moment);
            let k = subtree.inertia * axis + subtree.first_moment.cross(&v_o);

            let column = 6 + joint;
            for row in 0..3 {
                m[(row, column)] = l[row];
                m[(column, row)] = l[row];
                m[(3 + row, column)] = k[row];
                m[(column, 3 + row)] = k[row];
            }
            for &other in kinematics.chain(joint + 1) {
                let motion = &kinematics.bodies[other + 1];
                let entry = motion.joint_angular_i.dot(&k) + motion.joint_linear_at_base_i.dot(&l);
                m[(6 + other, column)] = entry;
                m[(column, 6 + other)] = entry;
            }
            let k_com = k - com.cross(&l);
            for row in 0..3 {
                a_g[(row, column)] = l[row];
                a_g[(3 + row, column)] = k_com[row];
            }
        }
    }

    /// Recursive Newton–Euler algorithm with ν̇ = 0: `h = C(q, ν) ν + g(q)`.
    fn update_bias(&mut self, robot: &RobotModel, state: &RobotState, kinematics: &Kinematics) {
        let gravity = Vector3::new(0.0, 0.0, -robot.gravity);
        let joint_velocity = state.joint_velocity();
        // (linear acceleration of the body origin, angular acceleration), from the base outwards.
        self.accelerations[0] = (Vector3::zeros(), Vector3::zeros());
        for index in 1..robot.bodies.len() {
            let parent = robot.bodies[index].parent.unwrap_or(0);
            let (a_parent, alpha_parent) = self.accelerations[parent];
            let motion_parent = &kinematics.bodies[parent];
            let motion = &kinematics.bodies[index];
            let arm = motion.i_from_b.position - motion_parent.i_from_b.position;
            let omega = motion_parent.angular_velocity;
            let rate = joint_velocity[index - 1];
            self.accelerations[index] = (
                a_parent
                    + alpha_parent.cross(&arm)
                    + omega.cross(&omega.cross(&arm))
                    + omega.cross(&motion.joint_linear_i) * (2.0 * rate),
                alpha_parent + omega.cross(&motion.joint_angular_i) * rate,
            );
        }
        // (force, moment about the base origin) that each body requires, summed from the tips to the base.
        let origin = kinematics.bodies[0].i_from_b.position;
        for (index, body) in robot.bodies.iter().enumerate() {
            let motion = &kinematics.bodies[index];
            let (a_origin, alpha) = self.accelerations[index];
            let omega = motion.angular_velocity;
            let inertia = &self.inertias_i[index];
            let arm = motion.i_from_b.rotation * body.com_b;
            let a_com = a_origin + alpha.cross(&arm) + omega.cross(&omega.cross(&arm));
            let force = (a_com - gravity) * body.mass;
            let moment_com = inertia * alpha + omega.cross(&(inertia * omega));
            let com = motion.i_from_b.position + arm - origin;
            self.wrenches[index] = (force, moment_com + com.cross(&force));
        }
        for index in (1..robot.bodies.len()).rev() {
            let motion = &kinematics.bodies[index];
            let (force, moment) = self.wrenches[index];
            let arm = motion.i_from_b.position - origin;
            self.bias[5 + index] =
                motion.joint_angular_i.dot(&(moment - arm.cross(&force))) + motion.joint_linear_i.dot(&force);
            let parent = &mut self.wrenches[robot.bodies[index].parent.unwrap_or(0)];
            parent.0 += force;
            parent.1 += moment;
        }
        let (force, moment) = self.wrenches[0];
        self.bias.fixed_rows_mut::<3>(0).copy_from(&force);
        self.bias.fixed_rows_mut::<3>(3).copy_from(&moment);
    }
}

/// Cholesky factor of a mass matrix, `M = K Kᵀ`; preallocated.
///
/// The base comes first in `ν`, so the trailing block `K_s` of the factor belongs to the joints on a freely
/// floating base: `(M⁻¹)_ss = K_s⁻ᵀ K_s⁻¹`.
#[derive(Debug, Clone)]
pub struct MassFactor {
    /// Lower triangle of `K`; the upper triangle is undefined.
    pub factor: DMatrix<f64>,
}

impl MassFactor {
    /// Allocates for a matrix of order `n`.
    #[must_use]
    pub fn new(n: usize) -> Self {
        Self { factor: DMatrix::zeros(n, n) }
    }

    /// Factorises `mass_matrix`; `false` if it is not positive definite, which cannot happen for a finite
    /// state of a checked robot.
    #[must_use]
    pub fn factorise(&mut self, mass_matrix: &DMatrix<f64>) -> bool {
        self.factor.as_mut_slice().copy_from_slice(mass_matrix.as_slice());
        let n = self.factor.nrows();
        linalg::cholesky_in_place(self.factor.as_mut_slice(), n, n, n)
    }

    /// Solves `M x = b` in place: for `b = Σ generalised forces − h`, x is the forward dynamics ν̇.
    pub fn solve_in_place(&self, b: &mut DVector<f64>) {
        let n = self.factor.nrows();
        linalg::solve_lower_in_place(self.factor.as_slice(), n, n, b.as_mut_slice());
        linalg::solve_lower_transposed_in_place(self.factor.as_slice(), n, n, b.as_mut_slice());
    }
}

/// Inverse of a mass matrix, with its joint block `G` as a matrix; preallocated.
///
/// ```text
/// M = K Kᵀ,   K = [K_b 0; C K_s],   (M⁻¹)_ss = G = K_s⁻ᵀ K_s⁻¹
/// ```
#[derive(Debug, Clone)]
pub struct InverseMass {
    /// `K`.
    pub factor: MassFactor,
    /// `K_s⁻ᵀ`.
    pub joint_factor: DMatrix<f64>,
    /// `G`: joint acceleration per unit of torque \[1/(kg m²)\].
    pub joint_gain: DMatrix<f64>,
    /// Whether the last mass matrix was inverted, as for [`MassFactor::factorise`].
    pub is_known: bool,
    forces: DVector<f64>,
}

impl InverseMass {
    /// Allocates for a robot with `joints` joints.
    #[must_use]
    pub fn new(joints: usize) -> Self {
        Self {
            factor: MassFactor::new(6 + joints),
            joint_factor: DMatrix::zeros(joints, joints),
            joint_gain: DMatrix::zeros(joints, joints),
            is_known: false,
            forces: DVector::zeros(joints),
        }
    }

    /// Inverts `mass_matrix` if it is positive definite.
    pub fn update(&mut self, mass_matrix: &DMatrix<f64>) {
        self.is_known = self.factor.factorise(mass_matrix);
        if !self.is_known {
            return;
        }
        let (n, joints) = (mass_matrix.nrows(), self.forces.len());
        let joint_block = self.factor.factor.as_slice().get(6 * n + 6..).unwrap_or_default();
        let (inverse, gain) = (self.joint_factor.as_mut_slice(), self.joint_gain.as_mut_slice());
        linalg::invert_symmetric(joint_block, joints, n, inverse, gain);
    }

    /// [`MassFactor::solve_in_place`] without its long substitutions, in which each entry depends on the one
    /// before:
    ///
    /// ```text
    /// y = K_b⁻¹ b_b,   x_s = G (b_s − C y),   x_b = K_b⁻ᵀ (y − Cᵀ x_s)
    /// ```
    pub fn multiply_in_place(&mut self, b: &mut DVector<f64>) {
        let (n, k) = (b.len(), self.factor.factor.as_slice());
        let (base, joints) = b.as_mut_slice().split_at_mut(6);
        linalg::solve_lower_in_place(k, 6, n, base);
        self.forces.copy_from_slice(joints);
        for (column, y) in k.chunks_exact(n).zip(&*base) {
            linalg::add_scaled(self.forces.as_mut_slice(), -y, &column[6..]);
        }
        joints.fill(0.0);
        linalg::add_mat_vec(joints, self.joint_gain.as_slice(), joints.len(), self.forces.as_slice());
        for (column, y) in k.chunks_exact(n).zip(&mut *base) {
            *y -= linalg::dot(&column[6..], joints);
        }
        linalg::solve_lower_transposed_in_place(k, 6, n, base);
    }
}

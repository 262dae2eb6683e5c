//! Laws of floating-base kinematics and dynamics, on random states of two robots.
//!
//! What the crate computes by recursion over composites is compared with sums over single bodies
//! and with differences along the motion.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use crate::common::{assert_within, both_robots, random_state, random_vector, rng};
use flight_core::dynamics::{Dynamics, InverseMass, MassFactor};
use flight_core::kinematics::{Kinematics, RobotState};
use flight_core::robot::{Frame, JointKind, RobotModel};
use flight_core::spatial::{Pose, exp_so3, skew, vee_of_skew_part};
use flight_core::subtree::SubtreeLoads;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use rand::RngExt;

const STATES: usize = 200;

/// Kinematics and dynamics of one state.
struct Sample {
    state: RobotState,
    kinematics: Kinematics,
    dynamics: Dynamics,
}

impl Sample {
    fn new(robot: &RobotModel, state: RobotState) -> Self {
        let mut kinematics = Kinematics::new(robot);
        let mut dynamics = Dynamics::new(robot);
        kinematics.update(robot, &state);
        dynamics.update(robot, &state, &kinematics);
        Self { state, kinematics, dynamics }
    }

    /// Position and velocity of the centre of mass of a body, and its inertia in inertial axes.
    fn body(&self, robot: &RobotModel, index: usize) -> (Vector3<f64>, Vector3<f64>, Matrix3<f64>) {
        let motion = &self.kinematics.bodies[index];
        let com = motion.i_from_b.transform_point(&robot.bodies[index].com_b);
        let rotation = &motion.i_from_b.rotation;
        (com, motion.velocity_at(&com), rotation * robot.bodies[index].inertia_b * rotation.transpose())
    }

    fn kinetic_energy(&self) -> f64 {
        0.5 * self.state.velocity.dot(&(&self.dynamics.mass_matrix * &self.state.velocity))
    }
}

/// Both robots and one of which every third joint slides, every state of a seeded sequence.
fn check_on_random_states(seed: u64, mut law: impl FnMut(&RobotModel, Sample)) {
    let [first, second] = both_robots();
    let mut sliding = first.clone();
    for joint in sliding.joints.iter_mut().step_by(3) {
        joint.kind = JointKind::Prismatic;
    }
    for robot in [first, second, sliding] {
        let mut rng = rng(seed);
        for _ in 0..STATES {
            let state = random_state(&mut rng, &robot);
            law(&robot, Sample::new(&robot, state));
        }
    }
}

/// The state after moving for a time with constant `velocity`, mixed representation.
fn move_state(state: &RobotState, velocity: &DVector<f64>, time: f64) -> RobotState {
    let mut moved = state.clone();
    let omega: Vector3<f64> = velocity.fixed_rows::<3>(3).into();
    moved.base = Pose {
        rotation: exp_so3(&(omega * time)) * state.base.rotation,
        position: state.base.position + velocity.fixed_rows::<3>(0) * time,
    };
    moved.joint_position.axpy(time, &velocity.rows(6, state.n_joints()), 1.0);
    moved
}

/// Central difference of `f` along the motion with the state's own velocity.
fn rate<T>(robot: &RobotModel, state: &RobotState, f: impl Fn(&Sample) -> T) -> T
where
    T: std::ops::Sub<Output = T> + std::ops::Div<f64, Output = T>,
{
    const STEP: f64 = 1e-5;
    let at = |time| f(&Sample::new(robot, move_state(state, &state.velocity, time)));
    (at(STEP) - at(-STEP)) / (2.0 * STEP)
}

#[track_caller]
fn assert_small(what: &str, error: f64, scale: f64, tolerance: f64) {
    assert_within!(error, tolerance * scale, because "the error of a quotient of differences, or of sums over all bodies", "{what}: error {error:e} against {scale:e}");
}

fn frames(robot: &RobotModel) -> Vec<&Frame> {
    let jets = robot.jets.iter().map(|jet| &jet.frame);
    let links = robot.aero_links.iter().map(|link| &link.frame);
    jets.chain(links).chain(robot.feet.iter().map(|foot| &foot.frame)).collect()
}

/// Velocities of bodies are the rates of change of their poses.
#[test]
fn body_velocities_are_rates_of_poses() {
    check_on_random_states(1, |robot, sample| {
        for (index, motion) in sample.kinematics.bodies.iter().enumerate() {
            let position = rate(robot, &sample.state, |s| s.kinematics.bodies[index].i_from_b.position);
            let rotation = rate(robot, &sample.state, |s| s.kinematics.bodies[index].i_from_b.rotation);
            let omega = vee_of_skew_part(&(rotation * motion.i_from_b.rotation.transpose()));
            assert_small("linear", (position - motion.linear_velocity).amax(), 10.0, 1e-8);
            assert_small("angular", (omega - motion.angular_velocity).amax(), 10.0, 1e-8);
        }
    });
}

/// The Jacobian of every frame, times ν, is the rate of change of its pose.
#[test]
fn frame_jacobians_are_differences_of_poses() {
    check_on_random_states(2, |robot, sample| {
        for frame in frames(robot) {
            let pose = sample.kinematics.frame_pose(frame);
            let (linear, angular) = sample.kinematics.jacobian(frame.body, &pose.position);
            let position = rate(robot, &sample.state, |s| s.kinematics.frame_pose(frame).position);
            let rotation = rate(robot, &sample.state, |s| s.kinematics.frame_pose(frame).rotation);
            let omega = vee_of_skew_part(&(rotation * pose.rotation.transpose()));
            let found = &linear * &sample.state.velocity;
            assert_small(&frame.name, (position - found).amax(), 10.0, 1e-8);
            assert_small(&frame.name, (omega - angular * &sample.state.velocity).amax(), 10.0, 1e-8);
        }
    });
}

/// A rotor turns with its joint, and does not change what acts on the whole robot.
#[test]
fn rotors_add_to_the_inertia_of_their_joints_alone() {
    let [_, mut robot] = both_robots();
    let state = random_state(&mut rng(5), &robot);
    let without = Sample::new(&robot, state.clone()).dynamics;
    robot.joints[2].rotor_inertia = 0.07;
    let mut with = Sample::new(&robot, state).dynamics;
    with.mass_matrix[(8, 8)] -= 0.07;
    assert_within!((&with.mass_matrix - &without.mass_matrix).amax(), 1e-15);
    assert_eq!((with.momentum, with.bias), (without.momentum, without.bias));
}

/// `½ νᵀ M ν` is the sum of the kinetic energies of the bodies.
#[test]
fn kinetic_energy_is_that_of_the_bodies() {
    check_on_random_states(5, |robot, sample| {
        let bodies: f64 = (0..robot.bodies.len())
            .map(|index| {
                let (_, velocity, inertia) = sample.body(robot, index);
                let omega = sample.kinematics.bodies[index].angular_velocity;
                0.5 * (robot.bodies[index].mass * velocity.norm_squared() + omega.dot(&(inertia * omega)))
            })
            .sum();
        assert_small("energy", (sample.kinetic_energy() - bodies).abs(), bodies, 1e-13);
    });
}

/// `A_G ν` is the momentum of the bodies, linear and about their common centre of mass.
#[test]
fn centroidal_momentum_is_that_of_the_bodies() {
    check_on_random_states(6, |robot, sample| {
        let mut linear = Vector3::zeros();
        let mut angular = Vector3::zeros();
        let mut scale = 0.0;
        for (index, body) in robot.bodies.iter().enumerate() {
            let (com, velocity, inertia) = sample.body(robot, index);
            let p = velocity * body.mass;
            let spin = inertia * sample.kinematics.bodies[index].angular_velocity;
            linear += p;
            angular += (com - sample.kinematics.com).cross(&p) + spin;
            scale += p.norm() + spin.norm();
        }
        let momentum = &sample.dynamics.momentum;
        assert_small("linear", (momentum.fixed_rows::<3>(0) - linear).amax(), scale, 1e-13);
        assert_small("angular", (momentum.fixed_rows::<3>(3) - angular).amax(), scale, 1e-13);
        let product = &sample.dynamics.momentum_matrix * &sample.state.velocity;
        assert_small("A_G ν", (product - momentum).amax(), scale, 1e-14);
    });
}

/// The centroidal inertia is that of the bodies about the common centre of mass; it is what a rigid
/// turn of the whole robot meets.
#[test]
fn centroidal_inertia_is_that_of_the_bodies() {
    check_on_random_states(7, |robot, sample| {
        let mut inertia = Matrix3::zeros();
        for (index, body) in robot.bodies.iter().enumerate() {
            let (com, _, own) = sample.body(robot, index);
            let arm = skew(&(com - sample.kinematics.com));
            inertia += own - arm * arm * body.mass;
        }
        let found = &sample.dynamics.centroidal_inertia;
        assert_small("inertia", (found - inertia).amax(), inertia.amax(), 1e-13);
        let turn = sample.dynamics.momentum_matrix.fixed_view::<3, 3>(3, 3);
        assert_small("A_G", (turn - inertia).amax(), inertia.amax(), 1e-13);
    });
}

/// d'Alembert: with ν constant the bias is what the bodies' momenta need to change as they do, and
/// what their weights need to be carried, through each body's Jacobian.
#[test]
fn bias_is_the_rate_of_the_bodies_momenta() {
    check_on_random_states(9, |robot, sample| {
        let mut bias = DVector::zeros(sample.state.velocity.len());
        for (index, body) in robot.bodies.iter().enumerate() {
            let force = rate(robot, &sample.state, |s| s.body(robot, index).1) * body.mass
                + Vector3::new(0.0, 0.0, body.mass * robot.gravity);
            let moment = rate(robot, &sample.state, |s| {
                s.body(robot, index).2 * s.kinematics.bodies[index].angular_velocity
            });
            let com = sample.body(robot, index).0;
            let (linear, angular) = sample.kinematics.jacobian(index, &com);
            bias += linear.tr_mul(&force) + angular.tr_mul(&moment);
        }
        assert_small("bias", (&sample.dynamics.bias - &bias).amax(), bias.amax(), 1e-8);
    });
}

/// Forward dynamics undo inverse dynamics: `M ν̇ + h` of the solution gives back the forces.
#[test]
fn forward_dynamics_invert_inverse_dynamics() {
    let mut draw = rng(13);
    check_on_random_states(13, |robot, sample| {
        let n = sample.state.velocity.len();
        let acceleration = DVector::from_fn(n, |_, _| draw.random_range(-10.0..10.0));
        let forces = &sample.dynamics.mass_matrix * &acceleration + &sample.dynamics.bias;
        let mut factor = MassFactor::new(n);
        assert!(factor.factorise(&sample.dynamics.mass_matrix), "{}", robot.name);
        let mut solved = forces - &sample.dynamics.bias;
        let mut multiplied = solved.clone();
        factor.solve_in_place(&mut solved);
        assert_small("acceleration", (solved - &acceleration).amax(), 10.0, 1e-10);
        let mut inverse = InverseMass::new(n - 6);
        inverse.update(&sample.dynamics.mass_matrix);
        assert!(inverse.is_known, "{}", robot.name);
        inverse.multiply_in_place(&mut multiplied);
        assert_small("acceleration by the inverse", (multiplied - acceleration).amax(), 10.0, 1e-10);
    });
}

/// With the base first, the trailing block of the Cholesky factor is that of `((M⁻¹)_ss)⁻¹`: the
/// joints of a floating robot.
#[test]
fn trailing_block_of_the_mass_factor_belongs_to_the_joints() {
    check_on_random_states(14, |_, sample| {
        let m = &sample.dynamics.mass_matrix;
        let (n, joints) = (m.nrows(), m.nrows() - 6);
        let mut factor = MassFactor::new(n);
        assert!(factor.factorise(m));
        // The diagonal holds reciprocals.
        let k_s = DMatrix::from_fn(joints, joints, |i, j| match i.cmp(&j) {
            std::cmp::Ordering::Less => 0.0,
            std::cmp::Ordering::Equal => 1.0 / factor.factor[(6 + i, 6 + i)],
            std::cmp::Ordering::Greater => factor.factor[(6 + i, 6 + j)],
        });
        let inverse = m.clone().try_inverse().unwrap();
        let joint_block = inverse.view((6, 6), (joints, joints));
        let product = (&k_s * k_s.transpose()) * joint_block;
        assert_small("K_s K_sᵀ (M⁻¹)_ss", (product - DMatrix::identity(joints, joints)).amax(), 1.0, 1e-9);
        let mut found = InverseMass::new(joints);
        found.update(m);
        assert!(found.is_known);
        let product = (&k_s * k_s.transpose()) * &found.joint_gain;
        assert_small("K_s K_sᵀ G", (product - DMatrix::identity(joints, joints)).amax(), 1.0, 1e-9);
        let product = k_s.transpose() * &found.joint_factor;
        assert_small("K_sᵀ K_s⁻ᵀ", (product - DMatrix::identity(joints, joints)).amax(), 1.0, 1e-9);
    });
}

/// A matrix that is not positive definite is refused, not factored.
#[test]
fn mass_factor_refuses_what_is_not_positive_definite() {
    let mut factor = MassFactor::new(2);
    assert!(factor.factorise(&DMatrix::from_row_slice(2, 2, &[2.0, 1.0, 1.0, 2.0])));
    assert!(!factor.factorise(&DMatrix::from_row_slice(2, 2, &[1.0, 2.0, 2.0, 1.0])));
    assert!(!factor.factorise(&DMatrix::from_row_slice(2, 2, &[1.0, 1.0, 1.0, 1.0])));
    assert!(!factor.factorise(&DMatrix::from_row_slice(2, 2, &[f64::NAN, 0.0, 0.0, 1.0])));
    let mut indefinite = DMatrix::identity(8, 8);
    indefinite[(7, 7)] = -1.0;
    let mut inverse = InverseMass::new(2);
    inverse.update(&DMatrix::identity(8, 8));
    inverse.update(&indefinite);
    assert!(!inverse.is_known);
}

/// `νᵀ Jᵀ f = fᵀ v`: a generalised force does the work of the force at its point.
#[test]
fn generalised_force_does_the_work_of_the_force() {
    let mut draw = rng(15);
    check_on_random_states(15, |_, sample| {
        for body in 0..sample.kinematics.bodies.len() {
            let (point, force) = (random_vector(&mut draw, 2.0), random_vector(&mut draw, 100.0));
            let mut generalised = DVector::zeros(sample.state.velocity.len());
            sample.kinematics.add_generalised_force(body, &point, &force, &mut generalised);
            let velocity = sample.kinematics.bodies[body].velocity_at(&point);
            let power = generalised.dot(&sample.state.velocity);
            assert_small("power", (power - force.dot(&velocity)).abs(), 1e3, 1e-13);
            let (linear, _) = sample.kinematics.jacobian(body, &point);
            assert_small("Jᵀ f", (linear.tr_mul(&force) - &generalised).amax(), 100.0, 1e-14);
            // Added to what is there.
            sample.kinematics.add_generalised_force(body, &point, &(-force), &mut generalised);
            assert_small("sum", generalised.amax(), 100.0, 1e-14);
        }
    });
}

/// Forces on all bodies, summed over subtrees, act as through the Jacobians of their points.
#[test]
fn loads_of_subtrees_act_through_jacobians() {
    let mut draw = rng(16);
    check_on_random_states(16, |robot, sample| {
        let forces: Vec<_> = (0..robot.bodies.len())
            .map(|body| {
                let [point, force, couple] = [2.0, 100.0, 50.0].map(|size| random_vector(&mut draw, size));
                (body, point, force, couple)
            })
            .collect();
        let mut loads = SubtreeLoads::new(robot);
        loads.update(robot, &sample.kinematics, forces.iter().copied());
        let mut found = DVector::zeros(sample.state.velocity.len());
        loads.add_generalised_force(&sample.kinematics, &mut found);
        let mut expected = found.clone() * 0.0;
        let (mut moved, mut turned) =
            (vec![Vector3::zeros(); found.len()], vec![Vector3::zeros(); found.len()]);
        let origin = sample.kinematics.bodies[0].i_from_b.position;
        for (body, point, force, couple) in &forces {
            let (linear, angular) = sample.kinematics.jacobian(*body, point);
            expected += linear.tr_mul(force) + angular.tr_mul(couple);
            for (column, (v, w)) in linear.column_iter().zip(angular.column_iter()).enumerate() {
                moved[column] += force.cross(&v);
                turned[column] +=
                    force.cross(&v) + (point - origin).cross(&force.cross(&w)) + couple.cross(&w);
            }
        }
        // Sums of some 30 forces at arms of some 2 m, in another order.
        let scale = 100.0 * 2.0 * forces.len() as f64;
        assert_small("Jᵀ f", (found - expected).amax(), scale, 1e-15);
        loads.visit(&sample.kinematics, |column, load, v_o, omega| {
            let found = load.force.cross(&v_o) + load.moment().cross(&omega);
            assert_small("f × v + r × (f × ω) + c × ω", (found - turned[column]).amax(), scale, 1e-15);
        });
        let without = forces.iter().map(|(body, point, force, _)| (*body, *point, *force, Vector3::zeros()));
        loads.update(robot, &sample.kinematics, without);
        loads.visit(&sample.kinematics, |column, load, v_o, omega| {
            let found = load.force.cross(&v_o) + omega * load.dyad.trace() - load.dyad * omega;
            assert_small("f × v", (found - moved[column]).amax(), scale, 1e-15);
        });
    });
}

/// External forces change the momentum as Newton and Euler say: `L̇ = (Σ f − m g e₃, Σ (p − c) × f)`.
#[test]
fn momentum_changes_by_the_external_wrench() {
    const STEP: f64 = 2e-7;
    let mut draw = rng(18);
    check_on_random_states(18, |robot, sample| {
        let n = sample.state.velocity.len();
        let body = draw.random_range(0..robot.bodies.len());
        let (point, force) = (random_vector(&mut draw, 1.0), random_vector(&mut draw, 50.0));
        let mut acceleration = -&sample.dynamics.bias;
        sample.kinematics.add_generalised_force(body, &point, &force, &mut acceleration);
        let mut factor = MassFactor::new(n);
        assert!(factor.factorise(&sample.dynamics.mass_matrix));
        factor.solve_in_place(&mut acceleration);

        let momentum_at = |time: f64| {
            let mean = &sample.state.velocity + &acceleration * (0.5 * time);
            let mut state = move_state(&sample.state, &mean, time);
            state.velocity.axpy(time, &acceleration, 1.0);
            Sample::new(robot, state).dynamics.momentum
        };
        let rate = (momentum_at(STEP) - momentum_at(-STEP)) / (2.0 * STEP);
        let weight = Vector3::new(0.0, 0.0, robot.mass() * robot.gravity);
        let moment = (point - sample.kinematics.com).cross(&force);
        let scale = weight.z + force.norm() + moment.norm() + sample.kinetic_energy();
        assert_small("force", (rate.fixed_rows::<3>(0) - (force - weight)).amax(), scale, 1e-7);
        assert_small("moment", (rate.fixed_rows::<3>(3) - moment).amax(), scale, 1e-7);
    });
}

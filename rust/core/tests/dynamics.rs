//! Factors of the mass matrix and forces on subtrees, on random states of two robots. All terms of the dynamics:
//! `tests/parity/test_dynamics_pinocchio.py`.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use crate::common::{assert_within, both_robots, random_state, random_vector, rng};
use flight_core::dynamics::{Dynamics, InverseMass, MassFactor};
use flight_core::kinematics::{Kinematics, RobotState};
use flight_core::robot::{JointKind, RobotModel};
use flight_core::subtree::SubtreeLoads;
use nalgebra::{DMatrix, DVector, Vector3};
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

#[track_caller]
fn assert_small(what: &str, error: f64, scale: f64, tolerance: f64) {
    assert_within!(error, tolerance * scale, because "the error of sums over all bodies", "{what}: error {error:e} against {scale:e}");
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

//! iRonCub-Mk3's files hold the figures of the public model.
//!
//! What `MuJoCo` computes from the public URDF (ami-iit/ironcub-models, iRonCub-Mk3) with the neck locked at zero: centre of
//! mass, inertia about it and frames, all joints at zero, root axes.

use super::robot_file;
use crate::common::assert_within;
use flight_core::robot::RobotModel;
use flight_core::spatial::Pose;
use flight_io::load_robot;
use nalgebra::{Matrix3, Vector3};

fn mk3() -> RobotModel {
    load_robot(&robot_file("ironcub_mk3.toml")).unwrap()
}

/// Poses of the bodies in root axes, all joints at zero.
fn at_zero(robot: &RobotModel) -> Vec<Pose> {
    let mut poses = vec![Pose { rotation: Matrix3::identity(), position: Vector3::zeros() }];
    for (joint, body) in robot.joints.iter().zip(&robot.bodies[1..]) {
        poses.push(poses[body.parent.unwrap()] * joint.parent_from_child);
    }
    poses
}

#[test]
fn the_centre_of_mass_and_the_inertia_about_it_are_those_of_the_public_model() {
    let robot = mk3();
    let poses = at_zero(&robot);
    let bodies = || robot.bodies.iter().zip(&poses);
    let moment: Vector3<f64> =
        bodies().map(|(body, pose)| body.mass * pose.transform_point(&body.com_b)).sum();
    let com = moment / robot.mass();
    assert_within!((com - Vector3::new(-0.012_420_99, -0.000_118_41, 0.003_490_77)).amax(), 1e-8, because "the figures have eight digits");
    let inertia: Matrix3<f64> = bodies()
        .map(|(body, pose)| {
            let arm = pose.transform_point(&body.com_b) - com;
            let parallel = Matrix3::from_diagonal_element(arm.norm_squared()) - arm * arm.transpose();
            pose.rotation * body.inertia_b * pose.rotation.transpose() + body.mass * parallel
        })
        .sum();
    let expected = Matrix3::new(
        7.209_253_92,
        0.000_434_106,
        0.617_672_731, //
        0.000_434_106,
        6.534_110_25,
        0.000_865_202, //
        0.617_672_731,
        0.000_865_202,
        1.287_202_57,
    );
    assert_within!((inertia - expected).amax(), 1e-8, because "the figures have eight digits");
}

#[test]
fn jets_push_where_and_along_what_the_public_model_has() {
    let robot = mk3();
    let poses = at_zero(&robot);
    let expected = [
        (
            "l_arm_jet",
            [0.063_584_67, 0.263_571_07, -0.172_706_85],
            [-0.071_366_17, -0.061_930_3, 0.995_525_74],
        ),
        (
            "r_arm_jet",
            [0.063_808_62, -0.264_097_31, -0.172_658_06],
            [-0.071_366_17, 0.061_930_3, 0.995_525_74],
        ),
        ("chest_l_jet", [-0.129_710_52, 0.299_701_15, 0.162_933_29], [0.0, -0.258_819_045, 0.965_925_826]),
        ("chest_r_jet", [-0.129_710_52, -0.300_184_06, 0.163_062_69], [0.0, 0.258_819_045, 0.965_925_826]),
    ];
    for (jet, (name, position, axis)) in robot.jets.iter().zip(expected) {
        assert_eq!(jet.name, name);
        let pose = poses[jet.frame.body] * jet.frame.body_from_frame;
        assert_within!((pose.position - Vector3::from(position)).amax(), 1e-8, because "the figures have eight digits", "position of {name}");
        assert_within!(
            (pose.rotation * jet.axis_f.into_inner() - Vector3::from(axis)).amax(),
            1e-8,
            "axis of {name}"
        );
    }
}

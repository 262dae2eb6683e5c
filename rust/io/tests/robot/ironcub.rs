//! iRonCub-Mk1's files hold the published figures.

use super::{assert_close, robot_file};
use crate::common::assert_within;
use crate::common::engines::engines;
use flight_core::jets::EngineModel;
use flight_core::robot::RobotModel;
use flight_core::spatial::{Pose, axis_angle};
use flight_io::{RobotFiles, hold, load_robot};
use nalgebra::{Matrix3, Vector3};
use std::path::PathBuf;

fn ironcub() -> RobotModel {
    load_robot(&robot_file("ironcub_mk1.toml")).unwrap()
}

#[test]
fn has_its_bodies_and_mass() {
    let robot = ironcub();
    assert_eq!(robot.name, "iRonCub-Mk1");
    assert_eq!(robot.bodies.len(), 24);
    assert_eq!(robot.joints.len(), 23);
    assert_close("mass", robot.mass(), 43.321_631, 1e-12);
    assert_close("gravity", robot.gravity, 9.81, 0.0);
    assert_eq!(robot.bodies[0].name, "root_link");
    assert_eq!(robot.bodies[0].parent, None);
    let files = RobotFiles::read(&robot_file("ironcub_mk1.toml")).unwrap();
    assert!(files.toml.contains("iRonCub-Mk1") && files.urdf.contains("<robot"));
}

/// What it states is laid over the other file, whose URDF stays that beside it.
#[test]
fn a_robot_may_build_on_the_file_of_another() {
    let based = PathBuf::from("based/robot.toml");
    hold(&based, format!("base = {:?}\ngravity = 9.8\n", robot_file("ironcub_mk1.toml")).into());
    let found = load_robot(&based).unwrap();
    let mut expected = ironcub();
    expected.gravity = 9.8;
    assert_eq!(format!("{found:?}"), format!("{expected:?}"));
    hold(&based, "base = \"none.toml\"\n".into());
    assert!(load_robot(&based).unwrap_err().to_string().contains("none.toml"));
}

#[test]
fn joints_stand_in_the_order_of_the_published_controller() {
    let robot = ironcub();
    let arm = ["shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow"];
    let leg = ["hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll"];
    let mut expected: Vec<String> = ["torso_pitch", "torso_roll", "torso_yaw"].map(String::from).into();
    for side in ["l", "r"] {
        expected.extend(arm.iter().map(|joint| format!("{side}_{joint}")));
    }
    for side in ["l", "r"] {
        expected.extend(leg.iter().map(|joint| format!("{side}_{joint}")));
    }
    let names: Vec<&str> = robot.joints.iter().map(|joint| joint.name.as_str()).collect();
    assert_eq!(names, expected);
    assert_eq!(robot.joint_index("l_knee"), Some(14));
    assert_eq!(robot.joint_index("neck_pitch"), None);

    let groups: Vec<(&str, usize)> =
        robot.groups.iter().map(|group| (group.name.as_str(), group.joints.len())).collect();
    let sizes = [("torso", 3), ("left_arm", 4), ("right_arm", 4), ("left_leg", 6), ("right_leg", 6)];
    assert_eq!(groups, sizes);
    let in_groups: Vec<usize> = robot.groups.iter().flat_map(|group| group.joints.clone()).collect();
    assert_eq!(in_groups, (0..23).collect::<Vec<_>>());
}

/// Limits typed from the published controller: raw limits times 0.7, 0.8 and 0.5.
#[test]
fn controller_limits() {
    let robot = ironcub();
    let torso = [(-20.0, 70.0), (-30.0, 30.0), (-50.0, 50.0)];
    let arm = [(-90.0, 10.0), (0.0, 160.0), (-35.0, 80.0), (15.0, 105.0)];
    let leg = [(-35.0, 80.0), (-15.0, 90.0), (-70.0, 70.0), (-100.0, 0.0), (-30.0, 30.0), (-20.0, 20.0)];
    let scaled = |raw: &[(f64, f64)], scale: f64| -> Vec<(f64, f64)> {
        raw.iter().map(|(lower, upper)| (lower * scale, upper * scale)).collect()
    };
    let expected =
        [scaled(&torso, 0.7), scaled(&arm, 0.8), scaled(&arm, 0.8), scaled(&leg, 0.5), scaled(&leg, 0.5)]
            .concat();
    for (joint, (lower, upper)) in robot.joints.iter().zip(expected) {
        assert_close(&joint.name, joint.limits.0.to_degrees(), lower, 1e-12);
        assert_close(&joint.name, joint.limits.1.to_degrees(), upper, 1e-12);
    }
}

#[test]
fn jets_and_feet() {
    let robot = ironcub();
    let jets: Vec<(&str, &str, f64, &str)> = robot
        .jets
        .iter()
        .map(|jet| (jet.name.as_str(), jet.frame.name.as_str(), jet.thrust_max, jet.engine_name.as_str()))
        .collect();
    let expected = [
        ("l_arm_jet", "l_arm_jet_turbine", 160.0, "P160"),
        ("r_arm_jet", "r_arm_jet_turbine", 160.0, "P160"),
        ("chest_l_jet", "chest_l_jet_turbine", 220.0, "P220"),
        ("chest_r_jet", "chest_r_jet_turbine", 220.0, "P220"),
    ];
    assert_eq!(jets, expected);
    assert!(robot.jets.iter().all(|jet| jet.axis_f.into_inner() == Vector3::new(0.0, 0.0, -1.0)));

    let corners = [[-0.06, 0.04, 0.0], [0.11, 0.04, 0.0], [0.11, -0.035, 0.0], [-0.06, -0.035, 0.0]];
    for (foot, (sole, body)) in robot.feet.iter().zip([("l_sole", "l_ankle_2"), ("r_sole", "r_ankle_2")]) {
        assert_eq!(foot.frame.name, sole);
        assert_eq!(robot.bodies[foot.frame.body].name, body);
        assert_eq!(foot.vertices_f, corners.map(Vector3::from));
    }
    assert_eq!(robot.feet.len(), 2);
}

#[test]
fn engines_are_the_published_ones() {
    let robot = ironcub();
    assert_eq!(robot.engines, engines());
    for jet in robot.jets {
        assert_eq!(jet.engine, EngineModel::from(robot.engines[&jet.engine_name]), "{}", jet.name);
    }
}

/// At the first tick of the published flight the centre of mass is where the authors' model has it,
/// which involves every mass, every offset and every joint axis.
#[test]
fn centre_of_mass_in_the_initial_posture() {
    let robot = ironcub();
    #[rustfmt::skip]
    let joint_pos = [
        0.1744, 0.0007, 0.0001,
        -0.1745, 0.4363, 0.6981, 0.2618,
        -0.1745, 0.4363, 0.6981, 0.2618,
        0.0003, 0.0, -0.0001, 0.0004, -0.0004, 0.0003,
        0.0002, 0.0001, -0.0002, 0.0004, -0.0005, 0.0003,
    ];
    let rotation = Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0));
    let mut i_from_body = vec![Pose { rotation, position: Vector3::new(0.0, 0.0, 0.8) }];
    for (joint, (body, angle)) in robot.joints.iter().zip(robot.bodies[1..].iter().zip(joint_pos)) {
        let turned = Pose { rotation: axis_angle(&joint.axis_b, angle), position: Vector3::zeros() };
        i_from_body.push(i_from_body[body.parent.unwrap()] * joint.parent_from_child * turned);
    }
    let moment: Vector3<f64> =
        robot.bodies.iter().zip(&i_from_body).map(|(b, pose)| b.mass * pose.transform_point(&b.com_b)).sum();
    let com = moment / robot.mass();
    for (axis, expected) in [-0.003_650, 0.000_410, 0.751_881].into_iter().enumerate() {
        assert_close("centre of mass", com[axis], expected, 5e-7);
    }
    let sole = &robot.feet[0].frame;
    let height = (i_from_body[sole.body] * sole.body_from_frame).position.z;
    assert_close("height of the sole", height, 0.180_562, 5e-7);
}

/// The first tag of this name in another.
fn tag<'a, 'i>(node: roxmltree::Node<'a, 'i>, name: &str) -> roxmltree::Node<'a, 'i> {
    node.children().find(|child| child.has_tag_name(name)).unwrap()
}

/// The drawn shapes are those that the sphere/cylinder model computes with.
#[test]
fn visuals_show_the_published_link_sizes() {
    let robot = ironcub();
    let text = RobotFiles::read(&robot_file("ironcub_mk1.toml")).unwrap().urdf;
    let urdf = roxmltree::Document::parse(&text).unwrap();
    let numbers = |node: roxmltree::Node<'_, '_>, key| -> Vec<f64> {
        node.attribute(key).unwrap_or("0 0 0").split(' ').map(|word| word.parse().unwrap()).collect()
    };
    for aero in &robot.aero_links {
        let links = &mut urdf.root_element().children().filter(|node| node.has_tag_name("link"));
        let link = links.find(|link| link.attribute("name") == Some(&aero.frame.name)).unwrap();
        assert_eq!(link.children().filter(|node| node.has_tag_name("visual")).count(), 1, "{}", aero.name);
        let visual = tag(link, "visual");
        let (geometry, origin) = (tag(visual, "geometry"), tag(visual, "origin"));
        if aero.is_sphere {
            let radius = numbers(tag(geometry, "sphere"), "radius")[0];
            assert_close(&aero.name, 2.0 * radius, aero.diameter, 1e-15);
        } else {
            let cylinder = tag(geometry, "cylinder");
            assert_close(&aero.name, 2.0 * numbers(cylinder, "radius")[0], aero.diameter, 1e-15);
            assert_close(&aero.name, numbers(cylinder, "length")[0], aero.length, 0.0);
            // A URDF cylinder stands along its own z axis.
            let r = flight_core::spatial::rotation_from_rpy(&Vector3::from_vec(numbers(origin, "rpy")));
            assert_within!((r * Vector3::z()).cross(&aero.axis_l).norm(), 1e-15, "axis of {}", aero.name);
        }
        let position = Vector3::from_vec(numbers(origin, "xyz"));
        assert_within!((position - aero.centre_l).norm(), 1e-15, "{}", aero.name);
    }
}

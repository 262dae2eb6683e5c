//! The robot's files load into what they say.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]
#![allow(clippy::float_cmp, reason = "limits are copied, not computed")]

use crate::common::assert_within;
#[path = "robot/ironcub.rs"]
mod ironcub;
#[path = "robot/mk3.rs"]
mod mk3;
#[path = "robot/refusals.rs"]
mod refusals;
#[path = "robot/urdf.rs"]
mod urdf;

use flight_core::robot::{JointKind, RobotModel};
use flight_core::spatial::orthonormality_error;
use flight_io::{load_robot, robot_from_text};
use nalgebra::{Matrix3, Vector3};
use std::path::PathBuf;

fn robot_file(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../configs/robot").join(name)
}

fn sparrow_texts() -> (String, String) {
    let read = |name| std::fs::read_to_string(robot_file(name)).unwrap();
    (read("sparrow.toml"), read("sparrow.urdf"))
}

#[track_caller]
fn assert_close(what: &str, value: f64, expected: f64, tolerance: f64) {
    assert_within!((value - expected).abs(), tolerance, because "the published figure is rounded to the digits it has", "{what}: {value}, expected {expected}");
}

#[test]
fn sparrow_loads() {
    let robot = load_robot(&robot_file("sparrow.toml")).unwrap();
    let names: Vec<&str> = robot.bodies.iter().map(|body| body.name.as_str()).collect();
    assert_eq!(names, ["pelvis", "l_leg", "r_leg", "torso", "l_arm", "r_arm"]);
    assert_close("mass", robot.mass(), 13.6, 1e-12);
    assert_close("default gravity", robot.gravity, 9.81, 0.0);
    assert_eq!((robot.jets.len(), robot.aero_links.len(), robot.feet.len()), (3, 4, 2));
    assert_eq!(robot.joints[3].limits, (-1.2, 1.5), "limits of the URDF where the TOML has none");
    assert_close("waist", robot.joints[2].limits.1, 60_f64.to_radians(), 1e-15);
    for link in &robot.aero_links {
        assert!(orthonormality_error(&link.frame.body_from_frame.rotation) < 1e-15);
    }
}

/// A locked joint is a fixed joint at that angle.
#[test]
fn locked_joint_equals_fixed_joint() {
    let (toml, urdf) = sparrow_texts();
    let locked = robot_from_text(&toml, &urdf, "locked").unwrap();
    let fixed = robot_from_text(
        &toml.replace("locked = { neck = 0.2 }", ""),
        &urdf
            .replace(r#"<joint name="neck" type="revolute">"#, r#"<joint name="neck" type="fixed">"#)
            .replace(r#"<origin xyz="0.01 0 0.33"/>"#, r#"<origin xyz="0.01 0 0.33" rpy="0 0.2 0"/>"#),
        "fixed",
    )
    .unwrap();
    let free = robot_from_text(&toml.replace("0.2 }", "0.0 }"), &urdf, "locked at zero").unwrap();
    let torso = |robot: &RobotModel| robot.bodies[robot.body_index("torso").unwrap()].clone();
    let head = |robot: &RobotModel| robot.aero_links[0].frame.body_from_frame;
    assert_within!((torso(&locked).com_b - torso(&fixed).com_b).amax(), 1e-15);
    assert_within!((torso(&locked).inertia_b - torso(&fixed).inertia_b).amax(), 1e-15);
    assert_within!((head(&locked).rotation - head(&fixed).rotation).amax(), 1e-15);
    assert!((torso(&locked).com_b - torso(&free).com_b).amax() > 1e-5, "the angle matters");
}

const TWO_PARTS: &str = r#"<robot name="two_parts">
  <link name="base">
    <inertial>
      <mass value="2"/>
      <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.25"/>
    </inertial>
  </link>
  <joint name="mount" type="fixed">
    <parent link="base"/>
    <child link="load"/>
    <origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/>
  </joint>
  <link name="load">
    <inertial>
      <origin xyz="0.5 0 0"/>
      <mass value="1"/>
      <inertia ixx="0.3" ixy="0" ixz="0" iyy="0.4" iyz="0" izz="0.5"/>
    </inertial>
  </link>
</robot>"#;

const NO_JOINTS: &str = "name = 'two parts'\nurdf = 'two.urdf'\nbase_link = 'base'\njoint_groups = []";

/// By hand: the load's centre of mass is at (0, 0.5, 1) of the base, its first two moments swap. With
/// the reduced mass 2·1/3 and d = (0, 0.5, 1), `I = Σ I_k + μ (d² 1 − d dᵀ)`.
#[test]
fn fixed_joint_merges_by_the_parallel_axis_theorem() {
    let robot = robot_from_text(NO_JOINTS, TWO_PARTS, "by hand").unwrap();
    let [body] = robot.bodies.as_slice() else { panic!("one body expected") };
    assert_close("mass", body.mass, 3.0, 0.0);
    assert_within!((body.com_b - Vector3::new(0.0, 1.0 / 6.0, 1.0 / 3.0)).amax(), 1e-15);
    let mu = 2.0 / 3.0;
    let expected = Matrix3::new(
        0.1 + 0.4 + mu * 1.25,
        0.0,
        0.0,
        0.0,
        0.2 + 0.3 + mu,
        -mu * 0.5,
        0.0,
        -mu * 0.5,
        0.25 + 0.5 + mu * 0.25,
    );
    assert_within!((body.inertia_b - expected).amax(), 1e-15, because "a few units in the last place of numbers of order one", "{}", body.inertia_b);
}

/// A locked sliding joint is a fixed one that far along its axis.
#[test]
fn locked_sliding_joint_is_moved_along_its_axis() {
    let toml = NO_JOINTS.to_owned() + "\nlocked = { mount = 0.4 }";
    let sliding = TWO_PARTS
        .replace(r#"type="fixed">"#, r#"type="prismatic"><axis xyz="0 1 0"/><limit lower="-1" upper="1"/>"#);
    let locked = robot_from_text(&toml, &sliding, "locked").unwrap();
    // The joint's y is −x of the base.
    let fixed = TWO_PARTS.replace(r#"xyz="0 0 1""#, r#"xyz="-0.4 0 1""#);
    let fixed = robot_from_text(NO_JOINTS, &fixed, "fixed").unwrap();
    assert_within!((locked.bodies[0].com_b - fixed.bodies[0].com_b).amax(), 1e-15);
    assert_within!((locked.bodies[0].inertia_b - fixed.bodies[0].inertia_b).amax(), 1e-15);
    assert!(locked.bodies[0].com_b.x < -0.1);
}

/// The axes in which an inertia is written are its own: turning them is turning the tensor.
#[test]
fn inertia_is_read_in_the_axes_of_its_origin() {
    let turned = TWO_PARTS
        .replace(r#"<origin xyz="0.5 0 0"/>"#, r#"<origin xyz="0.5 0 0" rpy="0 0 1.5707963267948966"/>"#)
        .replace(r#"ixx="0.3" ixy="0" ixz="0" iyy="0.4""#, r#"ixx="0.4" ixy="0" ixz="0" iyy="0.3""#);
    let a = robot_from_text(NO_JOINTS, TWO_PARTS, "as is").unwrap();
    let b = robot_from_text(NO_JOINTS, &turned, "turned").unwrap();
    assert_within!((a.bodies[0].inertia_b - b.bodies[0].inertia_b).amax(), 1e-15);
}

/// A thruster acts at a point of its frame, and turns the robot about its axis.
#[test]
fn thrusters_have_points_and_moments() {
    let slider = load_robot(&robot_file("slider.toml")).unwrap();
    let [front, _, piston] = &slider.jets[..] else { panic!("three jets") };
    assert_eq!([front.torque_to_thrust, piston.torque_to_thrust], [0.0, -0.04]);
    let [toml, urdf] =
        ["toml", "urdf"].map(|kind| std::fs::read_to_string(robot_file(&format!("slider.{kind}"))).unwrap());
    let toml = toml.replace("position = [0.01, -0.02, 0.03]", "");
    let origin = robot_from_text(&toml, &urdf, "slider.toml").unwrap();
    let moved = front.frame.body_from_frame.position - origin.jets[0].frame.body_from_frame.position;
    let expected = front.frame.body_from_frame.rotation * Vector3::new(0.01, -0.02, 0.03);
    assert!((moved - expected).norm() < 1e-16);
}

/// Torque and velocity limits are the URDF's unless the TOML file says otherwise; nothing limits a torque rate
/// that neither names. A prismatic joint's are in m and N.
#[test]
fn joints_have_their_own_limits() {
    let sparrow = load_robot(&robot_file("sparrow.toml")).unwrap();
    let torques: Vec<f64> = sparrow.joints.iter().map(|joint| joint.torque_max).collect();
    assert_eq!(torques, [60.0, 60.0, 40.0, 40.0, 40.0]);
    assert!(sparrow.joints.iter().all(|joint| joint.velocity_max == 4.0));
    assert!(sparrow.joints.iter().all(|joint| joint.torque_rate_max.is_infinite()));

    let slider = load_robot(&robot_file("slider.toml")).unwrap();
    let kinds: Vec<JointKind> = slider.joints.iter().map(|joint| joint.kind).collect();
    assert_eq!(kinds, [JointKind::Prismatic, JointKind::Revolute, JointKind::Prismatic]);
    let rail = &slider.joints[0];
    assert_eq!((rail.limits, rail.torque_max), ((-0.12, 0.15), 100.0));
    assert_eq!((rail.torque_rate_max, rail.velocity_max), (900.0, 0.4));
    assert_eq!(slider.joints[1].velocity_max, 90_f64.to_radians());
}

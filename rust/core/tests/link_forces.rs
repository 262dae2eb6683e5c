//! Where link forces act: right by default, and each published quirk misplaces exactly the point it says.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use crate::common::{Loop, assert_within, both_robots, experiment, random_state, random_vector, rng, robot};
use flight_core::aero::{AeroModel, JacobianOffset, LeverArm, LinkConventions, LinkForces, LinkVelocity};
use flight_core::kinematics::Kinematics;
use flight_core::spatial::rotation_from_rpy;
use flight_core::{RobotModel, RobotState};
use flight_io::robot_from_text;
use flight_io::{AeroConfig, load_aero, load_robot};
use flight_sim::config::AeroKinematics;
use flight_sim::{Disturbances, Plant};
use nalgebra::{DVector, Matrix3xX, Vector3};

fn axisymmetric(robot: &RobotModel, set: &str) -> AeroModel {
    let text = format!(r#"{{"model": "axisymmetric", "coefficients": "{set}", "air_density": 1.225}}"#);
    let config: AeroConfig = serde_json::from_str(&text).unwrap();
    load_aero(&config, robot).unwrap()
}

fn forces_of(
    robot: &RobotModel,
    state: &RobotState,
    conventions: LinkConventions,
    model: &AeroModel,
    wind: &Vector3<f64>,
) -> (Kinematics, LinkForces) {
    let mut kinematics = Kinematics::new(robot);
    kinematics.update(robot, state);
    let mut forces = LinkForces::new(robot);
    forces.update(robot, &kinematics, conventions, &mut model.clone(), wind);
    (kinematics, forces)
}

const ONE_ARM_URDF: &str = r#"<robot name="one_arm">
  <link name="base">
    <inertial><mass value="2"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
  </link>
  <joint name="elbow" type="revolute">
    <parent link="base"/><child link="arm"/>
    <origin xyz="1 0 0"/><axis xyz="1 0 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/>
  </joint>
  <link name="arm">
    <inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
  </link>
</robot>"#;

const ONE_ARM_TOML: &str = r#"name = "one arm"
urdf = "one_arm.urdf"
base_link = "base"
joint_groups = [{ name = "arm", joints = [{ name = "elbow" }] }]
[[aero_links]]
name = "arm"
frame = "arm"
family = "arm"
axis = [0.0, 1.0, 0.0]
centre = [0.1, 0.2, 0.3]
diameter = 0.1
length = 0.2
[coefficients.round]
arm = { cda = [0.02, 0.0, 0.0, 0.0, 0.0], cna = 0.0 }
"#;

/// Base at (10, 20, 30), turned a quarter about z; the elbow, 1 m along base x, bent a quarter about x.
/// So `R_B x = y, R_B y = −x, R_B z = z` and, for the arm, `R x = y, R y = z, R z = x`.
fn one_arm() -> (RobotModel, RobotState) {
    let robot = robot_from_text(ONE_ARM_TOML, ONE_ARM_URDF, "one arm").unwrap();
    let mut state = RobotState::zero(1);
    state.base.position = Vector3::new(10.0, 20.0, 30.0);
    state.base.rotation = rotation_from_rpy(&Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2));
    state.joint_position[0] = std::f64::consts::FRAC_PI_2;
    state.velocity = DVector::from_column_slice(&[1.0, 2.0, 3.0, 0.0, 0.0, 5.0, 7.0]);
    (robot, state)
}

#[track_caller]
fn assert_is(what: &str, found: &Vector3<f64>, expected: [f64; 3]) {
    assert_within!(
        (found - Vector3::from(expected)).amax(),
        1e-13,
        because "a few units in the last place of positions of 30 m",
        "{what}: {found} instead of {expected:?}"
    );
}

/// The default is what physics says: all three points are the aerodynamic centre.
#[test]
fn points_are_right_by_default() {
    let default = LinkConventions::default();
    assert_eq!(default.lever_arm, LeverArm::Rotated);
    assert_eq!(default.jacobian_offset, JacobianOffset::LinkRotation);
    assert_eq!(default.link_velocity, LinkVelocity::AtCentre);

    let (robot, state) = one_arm();
    let model = axisymmetric(&robot, "round");
    let wind = Vector3::new(-4.0, 0.0, 0.0);
    let (_, found) = forces_of(&robot, &state, default, &model, &wind);
    // Link origin (10, 21, 30); R c = (0.3, 0.1, 0.2).
    assert_is("arm point", &found.arm_points_i[0], [10.3, 21.1, 30.2]);
    assert_is("Jacobian point", &found.jacobian_points_i[0], [10.3, 21.1, 30.2]);
    assert_is("axis", &found.axes_i[0], [0.0, 0.0, 1.0]);
    // v_B + 5 z × (0.3, 1.1, 0.2) + 7 y × (0.3, 0.1, 0.2), the elbow's axis being y.
    let velocity = Vector3::new(1.0 - 5.5 + 1.4, 2.0 + 1.5, 3.0 - 2.1);
    assert_is("air", &found.v_air_i[0], (wind - velocity).into());
    let v = wind - velocity;
    assert_is("drag", &found.forces_i[0], (v * (0.5 * 1.225 * 0.02 * v.norm())).into());
}

/// As flown: the rotation of one link turns the axes of all, and moves no point.
#[test]
fn one_link_may_turn_the_axes_of_all() {
    let (mut robot, state) = one_arm();
    let mut on_base = robot.aero_links[0].clone();
    on_base.frame.body = 0;
    robot.aero_links.insert(0, on_base);
    let (model, wind) = (axisymmetric(&robot, "round"), Vector3::new(-4.0, 0.0, 0.0));
    let axes_of = |axes_of| {
        forces_of(&robot, &state, LinkConventions { axes_of, ..LinkConventions::default() }, &model, &wind).1
    };
    let (own, of_base, of_arm) = (axes_of(None), axes_of(Some(0)), axes_of(Some(1)));
    // R_B y = −x, and R y = z for the arm.
    let (base_axis, arm_axis) = ([-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
    for (found, expected) in
        [(&own, [base_axis, arm_axis]), (&of_base, [base_axis; 2]), (&of_arm, [arm_axis; 2])]
    {
        for (axis, expected) in found.axes_i.iter().zip(expected) {
            assert_is("axis", axis, expected);
        }
        assert_eq!((&found.arm_points_i, &found.v_air_i), (&own.arm_points_i, &own.v_air_i));
        assert_eq!(found.jacobian_points_i, own.jacobian_points_i);
    }
}

/// Each quirk moves its own point and nothing else.
#[test]
fn each_quirk_moves_its_own_point() {
    let (robot, state) = one_arm();
    let model = axisymmetric(&robot, "round");
    let wind = Vector3::new(-4.0, 0.0, 0.0);
    let find = |conventions| forces_of(&robot, &state, conventions, &model, &wind).1;
    let right = find(LinkConventions::default());
    // v_B + 5 z × r + 7 y × r', with r from the base and r' from the elbow.
    let air_at = |r: [f64; 3]| {
        let velocity =
            Vector3::new(1.0 - 5.0 * (1.0 + r[1]) + 7.0 * r[2], 2.0 + 5.0 * r[0], 3.0 - 7.0 * r[0]);
        wind - velocity
    };
    assert_is("air", &right.v_air_i[0], air_at([0.3, 0.1, 0.2]).into());

    // p + c
    let arm = find(LinkConventions { lever_arm: LeverArm::Unrotated, ..LinkConventions::default() });
    assert_is("arm point", &arm.arm_points_i[0], [10.1, 21.2, 30.3]);
    assert_eq!(arm.jacobian_points_i, right.jacobian_points_i);
    assert_eq!((&arm.v_air_i, &arm.forces_i), (&right.v_air_i, &right.forces_i));

    // p + R_B c, R_B c = (−0.2, 0.1, 0.3)
    let jacobian =
        find(LinkConventions { jacobian_offset: JacobianOffset::BaseRotation, ..LinkConventions::default() });
    assert_is("Jacobian point", &jacobian.jacobian_points_i[0], [9.8, 21.1, 30.3]);
    assert_eq!(jacobian.arm_points_i, right.arm_points_i);
    assert_eq!((&jacobian.v_air_i, &jacobian.forces_i), (&right.v_air_i, &right.forces_i));

    // velocity at p + R c + c
    let velocity =
        find(LinkConventions { link_velocity: LinkVelocity::ShiftedTwice, ..LinkConventions::default() });
    assert_is("air", &velocity.v_air_i[0], air_at([0.4, 0.3, 0.5]).into());
    assert_eq!(velocity.arm_points_i, right.arm_points_i);
    assert_eq!(velocity.jacobian_points_i, right.jacobian_points_i);

    // The published controller has all three: the velocity is that at p + R_B c + c.
    let published = find(LinkConventions {
        lever_arm: LeverArm::Unrotated,
        jacobian_offset: JacobianOffset::BaseRotation,
        link_velocity: LinkVelocity::ShiftedTwice,
        ..LinkConventions::default()
    });
    assert_is("arm point", &published.arm_points_i[0], [10.1, 21.2, 30.3]);
    assert_is("Jacobian point", &published.jacobian_points_i[0], [9.8, 21.1, 30.3]);
    assert_is("air", &published.v_air_i[0], air_at([-0.1, 0.3, 0.6]).into());
    assert_eq!(published.axes_i, right.axes_i);
}

/// The chest jets' centres stand 0.194 m above the CoM; unrotated they come to lie 0.126 m below it.
#[test]
fn unrotated_arms_turn_the_chest_jets_upside_down() {
    let robot = robot("ironcub_mk1");
    let state = experiment("test2").simulator.initial.state();
    for (lever_arm, height) in [(LeverArm::Rotated, 0.194), (LeverArm::Unrotated, -0.126)] {
        let conventions = LinkConventions { lever_arm, ..LinkConventions::default() };
        let (kinematics, found) = forces_of(&robot, &state, conventions, &AeroModel::Off, &Vector3::zeros());
        for link in [2, 3] {
            let z = found.arm_points_i[link].z - kinematics.com.z;
            assert_within!((z - height).abs(), 1e-3, because "the published figure is rounded to the digits it has", "{}: {z} m", robot.aero_links[link].name);
        }
    }
}

/// Force on the hovering robot and moment about its CoM in side wind and head wind, as tabled, with right
/// and with published arms.
#[test]
fn hover_wrenches_are_those_of_the_table() {
    let robot = robot("ironcub_mk1");
    let model = axisymmetric(&robot, "published");
    let state = experiment("test2").simulator.initial.state();
    let side = ([0.0, -10.0, 0.0], [0.0, -12.95, 0.01]);
    let head = ([-10.0, 0.0, 0.0], [-13.36, 0.0, 0.94]);
    for ((wind, force), lever_arm, moment) in [
        (side, LeverArm::Rotated, [-0.64, 0.0, -0.21]),
        (side, LeverArm::Unrotated, [-1.88, 0.0, -0.37]),
        (head, LeverArm::Rotated, [0.0, 0.57, 0.0]),
        (head, LeverArm::Unrotated, [0.08, 1.85, 0.28]),
    ] {
        let conventions = LinkConventions { lever_arm, ..LinkConventions::default() };
        let (kinematics, found) = forces_of(&robot, &state, conventions, &model, &Vector3::from(wind));
        let (f, m) = found.wrench_about(&kinematics.com);
        assert_within!((f - Vector3::from(force)).amax(), 0.0051, because "the published figure is rounded to the digits it has", "{wind:?}: force {f}");
        assert_within!((m - Vector3::from(moment)).amax(), 0.0051, because "the published figure is rounded to the digits it has", "{wind:?}, {lever_arm:?}: moment {m}");
    }
    let strong = Vector3::new(-17.5, 0.0, 0.0);
    let (_, found) = forces_of(&robot, &state, LinkConventions::default(), &model, &strong);
    let (f, _) = found.wrench_about(&Vector3::zeros());
    assert_within!((f - Vector3::new(-40.9, 0.0, 2.9)).amax(), 0.051, because "the published figure is rounded to the digits it has", "force {f}");
}

/// A wrench is the sum of forces and of moments; about another point the moment changes by `d × f`.
#[test]
fn wrench_is_force_and_moment_about_a_point() {
    let mut rng = rng(1);
    for robot in both_robots() {
        let mut forces = LinkForces::new(&robot);
        let mut force = Vector3::zeros();
        let mut moment_about_origin = Vector3::zeros();
        for link in 0..robot.aero_links.len() {
            let (f, p) = (random_vector(&mut rng, 10.0), random_vector(&mut rng, 2.0));
            forces.forces_i[link] = f;
            forces.arm_points_i[link] = p;
            // Moments belong to the arm points, Jacobians to the others.
            forces.jacobian_points_i[link] = random_vector(&mut rng, 2.0);
            force += f;
            moment_about_origin += p.cross(&f);
        }
        let point = random_vector(&mut rng, 5.0);
        let (f, m) = forces.wrench_about(&point);
        assert_within!((f - force).amax(), 1e-13);
        assert_within!((m - (moment_about_origin - point.cross(&force))).amax(), 1e-12);
    }
}

/// The generalised force is `Σ J_jᵀ f_j` with the Jacobians of the Jacobian points.
#[test]
fn generalised_force_uses_the_jacobian_points() {
    let mut rng = rng(2);
    for robot in both_robots() {
        let set = robot.aero_links[0].coefficients.keys().next().unwrap().clone();
        let model = axisymmetric(&robot, &set);
        for jacobian_offset in [JacobianOffset::LinkRotation, JacobianOffset::BaseRotation] {
            let conventions = LinkConventions { jacobian_offset, ..LinkConventions::default() };
            let state = random_state(&mut rng, &robot);
            let wind = random_vector(&mut rng, 10.0);
            let (kinematics, found) = forces_of(&robot, &state, conventions, &model, &wind);
            let mut expected = DVector::zeros(kinematics.n_velocities());
            for (index, link) in robot.aero_links.iter().enumerate() {
                let point = &found.jacobian_points_i[index];
                let (jacobian, _): (Matrix3xX<f64>, _) = kinematics.jacobian(link.frame.body, point);
                expected += jacobian.tr_mul(&found.forces_i[index]);
            }
            let mut generalised = DVector::zeros(kinematics.n_velocities());
            found.add_generalised_force(&robot, &kinematics, &mut generalised);
            assert_within!((generalised - &expected).amax(), 1e-12 * expected.amax());
            assert!(expected.amax() > 0.01);
        }
    }
}

/// Frozen kinematics: axes and points stay those of the first tick, link velocities are `J(q₀) ν`.
#[test]
fn frozen_kinematics_keep_axes_and_points_of_the_first_tick() {
    let mut config = experiment("test2");
    config.simulator.kinematics = AeroKinematics::Frozen;
    // The first tick is the state after the free fall.
    let robot = load_robot(&config.robot).unwrap();
    let first = Plant::new(robot.clone(), &config.simulator, &config.disturbances, &config.controller.law)
        .unwrap()
        .state()
        .clone();
    let wind = Vector3::new(3.0, -6.0, 1.0);
    let mut flight = Loop::new(&config);
    flight.run(2.0, |_| wind);

    let state = flight.plant.state();
    assert!((state.base.position - first.base.position).norm() > 0.01, "the robot has moved");
    let model = axisymmetric(&robot, "corrected");
    let mut there = first;
    there.velocity.copy_from(&state.velocity);
    let (kinematics, expected) = forces_of(&robot, &there, LinkConventions::default(), &model, &wind);
    let found = flight.plant.link_forces();
    assert_eq!(found.axes_i, expected.axes_i);
    assert_eq!(found.arm_points_i, expected.arm_points_i);
    assert_eq!(found.forces_i, expected.forces_i);
    for (index, link) in robot.aero_links.iter().enumerate() {
        let (jacobian, _) = kinematics.jacobian(link.frame.body, &found.arm_points_i[index]);
        let v_air = wind - jacobian * &state.velocity;
        assert_within!((found.v_air_i[index] - v_air).amax(), 1e-13);
    }
    // Rigid bodies are where they are.
    let mut now = Kinematics::new(&robot);
    now.update(&robot, state);
    assert_eq!(flight.plant.kinematics().com, now.com);
}

/// Frozen or not, the first tick is the same; right and published simulators differ by the moment alone.
#[test]
fn simulator_quirks_leave_the_forces_of_the_first_tick() {
    let wind = Vector3::new(0.0, -10.0, 0.0);
    let first = |lever_arm: &str, kinematics: &str| {
        let config = experiment("test2");
        let mut value = serde_json::to_value(&config.simulator).unwrap();
        value["lever_arm"] = lever_arm.into();
        value["kinematics"] = kinematics.into();
        let robot = load_robot(&config.robot).unwrap();
        let (simulator, law) = (serde_json::from_value(value).unwrap(), &config.controller.law);
        let mut plant = Plant::new(robot, &simulator, &Disturbances::default(), law).unwrap();
        plant.observe(&wind);
        (plant.link_forces().forces_i.clone(), plant.link_forces().wrench_about(&plant.kinematics().com))
    };
    let (forces, wrench) = first("rotated", "current");
    assert_eq!(first("rotated", "frozen"), (forces.clone(), wrench));
    let (quirky_forces, quirky_wrench) = first("unrotated", "current");
    assert_eq!(quirky_forces, forces);
    assert!((quirky_wrench.1 - wrench.1).norm() > 1.0, "{} and {}", quirky_wrench.1, wrench.1);
}

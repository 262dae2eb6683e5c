//! Agreement with two complete states of a tick that `tests/golden/states.py` computed without this crate.

#![allow(clippy::unwrap_used)] // a test stops at the first thing that is not there

use crate::common::assert_within;
use flight_core::aero::{LinkConventions, LinkForces};
use flight_core::control::Terms;
use flight_core::control::setpoint::Setpoint;
use flight_core::control::tasks::MOMENTUM_ROWS;
use flight_core::kinematics::RobotState;
use flight_core::spatial::Pose;
use flight_core::{Controller, Measurement};
use flight_io::{AeroConfig, load_aero, load_robot};
use flight_sim::{ScenarioConfig, load_scenario};
use nalgebra::{DVector, Matrix3, Vector3};
use serde_json::Value;
use std::path::{Path, PathBuf};

const TOLERANCE: f64 = 1e-9;

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn golden_cases() -> Vec<Case> {
    let text = std::fs::read_to_string(repository().join("tests/golden/states.json")).unwrap();
    let value: Value = serde_json::from_str(&text).unwrap();
    let cases: Vec<Case> = value["states"].as_array().unwrap().iter().cloned().map(Case::new).collect();
    assert_eq!(cases.len(), 2);
    cases
}

/// Numbers of a nested array, row after row.
fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(items) => items.iter().flat_map(numbers).collect(),
        number => vec![number.as_f64().unwrap()],
    }
}

fn vector3(value: &Value) -> Vector3<f64> {
    Vector3::from_column_slice(&numbers(value))
}

fn matrix3(value: &Value) -> Matrix3<f64> {
    Matrix3::from_row_slice(&numbers(value))
}

/// Compares against the largest golden entry: entries that are zero by symmetry carry rounding.
#[track_caller]
fn agree(name: &str, ours: &[f64], golden: &Value) {
    let golden = numbers(golden);
    assert_eq!(ours.len(), golden.len(), "{name}: number of entries");
    let scale = golden.iter().fold(1e-12_f64, |scale, x| scale.max(x.abs()));
    let worst = ours.iter().zip(&golden).fold(0.0_f64, |worst, (a, b)| worst.max((a - b).abs()));
    assert_within!(worst / scale, TOLERANCE, "{name}");
}

fn rows<R: nalgebra::Dim, C: nalgebra::Dim, S: nalgebra::RawStorage<f64, R, C>>(
    m: &nalgebra::Matrix<f64, R, C, S>,
) -> Vec<f64> {
    m.row_iter().flat_map(|row| row.iter().copied().collect::<Vec<f64>>()).collect()
}

struct Case {
    golden: Value,
    state: RobotState,
    thrust: Vec<f64>,
    wind: Vector3<f64>,
    setpoint: Setpoint,
    posture: DVector<f64>,
    inertia_0_b: Matrix3<f64>,
    integral: DVector<f64>,
}

impl Case {
    fn new(golden: Value) -> Self {
        let given = &golden["given"];
        let joints = numbers(&given["joint_position"]);
        let mut state = RobotState::zero(joints.len());
        state.base =
            Pose { rotation: matrix3(&given["base_rotation"]), position: vector3(&given["base_position"]) };
        state.joint_position = DVector::from_vec(joints);
        state.velocity = DVector::from_vec(numbers(&given["velocity"]));
        let setpoint = |key: &str| vector3(&given[format!("setpoint.{key}")]);
        Self {
            setpoint: Setpoint {
                com_position: setpoint("com_position"),
                com_velocity: setpoint("com_velocity"),
                com_acceleration: setpoint("com_acceleration"),
                com_jerk: setpoint("com_jerk"),
                rotation: matrix3(&given["setpoint.rotation"]),
                angular_velocity_b: setpoint("angular_velocity"),
                angular_acceleration_b: setpoint("angular_acceleration"),
                angular_jerk_b: setpoint("angular_jerk"),
            },
            posture: DVector::from_vec(numbers(&given["memory.posture"])),
            inertia_0_b: matrix3(&given["memory.inertia_0_b"]),
            integral: DVector::from_vec(numbers(&given["memory.velocity_error_integral"])),
            thrust: numbers(&given["thrust"]),
            wind: vector3(&given["wind"]),
            state,
            golden,
        }
    }

    /// A controller with `configs/control/<control>.toml` and published coefficients, after one tick.
    fn tick(&self, control: &str) -> Controller {
        let config = scenario_config(control);
        let robot = load_robot(&config.robot).unwrap();
        let mut controller = config.controller(robot).unwrap();
        let measurement = Measurement {
            time: 0.0,
            state: &self.state,
            thrust: &self.thrust,
            wind: self.wind,
            foot_wrenches: &[],
        };
        let state = controller.start(&measurement).unwrap();
        let (posture, inertia) = (self.posture.clone(), self.inertia_0_b);
        let mut state = state.with_posture_control(posture, inertia, self.integral.clone()).unwrap();
        controller.tick_towards(&mut state, &measurement, &self.setpoint);
        controller
    }
}

/// The golden states use physically right points, the printed coefficients and the published torque limit.
fn scenario_config(control: &str) -> ScenarioConfig {
    let mut config = load_scenario(&repository().join("configs/experiments/test2.toml")).unwrap();
    let path = repository().join(format!("configs/control/{control}.toml"));
    config.controller = flight_io::load(&path).unwrap();
    config.controller.law.torque.torque_max = Some(50.0);
    if let AeroConfig::Axisymmetric(aero) = &mut config.controller.aero {
        aero.coefficients = "published".into();
    }
    config
}

#[test]
fn every_intermediate_of_the_aware_controller_agrees() {
    for case in golden_cases() {
        let controller = case.tick("aero_aware");
        let golden = |key: &str| &case.golden["aero_aware"][key];
        let Terms { kinematics, dynamics, link_forces, momentum, momentum_qp, torque_qp, .. } =
            controller.terms();

        agree("com_position", kinematics.com.as_slice(), golden("com_position"));
        agree("mass_matrix", &rows(&dynamics.mass_matrix), golden("mass_matrix"));
        agree("bias", dynamics.bias.as_slice(), golden("bias"));
        agree("momentum_matrix", &rows(&dynamics.momentum_matrix), golden("momentum_matrix"));
        agree("momentum", dynamics.momentum.as_slice(), golden("momentum"));
        agree("centroidal_inertia", &rows(&dynamics.centroidal_inertia), golden("centroidal_inertia"));

        let flat = |vectors: &[Vector3<f64>]| -> Vec<f64> { vectors.iter().flatten().copied().collect() };
        agree("link_arm_points", &flat(&link_forces.arm_points_i), golden("link_arm_points"));
        agree("link_axes", &flat(&link_forces.axes_i), golden("link_axes"));
        agree("aero_force", &flat(&link_forces.forces_i), golden("aero_force"));
        let jacobians: Vec<f64> = (controller.model().aero_links.iter().zip(&link_forces.jacobian_points_i))
            .flat_map(|(link, point)| rows(&kinematics.jacobian(link.frame.body, point).0))
            .collect();
        agree("link_jacobians", &jacobians, golden("link_jacobians"));

        agree("jet_axes", &flat(&momentum.jet_axes_i), golden("jet_axes"));
        agree("jet_points", &flat(&momentum.jet_points_i), golden("jet_points"));
        agree("a_t", &rows(&momentum.a_t), golden("a_t"));
        agree("lambda_t", &rows(&momentum.lambda_t), golden("lambda_t"));
        agree("lambda_a", &rows(&momentum.lambda_a), golden("lambda_a"));
        agree("momentum_rate_estimate", momentum.rate_estimate.as_slice(), golden("momentum_rate_estimate"));

        let nine_rows = &momentum_qp.matrix.as_slice()[..MOMENTUM_ROWS * momentum_qp.problem.len()];
        agree("task", nine_rows, golden("task"));
        agree("task_offset", &momentum_qp.offset.as_slice()[..MOMENTUM_ROWS], golden("task_offset"));
        agree("momentum_qp.h", &rows(&momentum_qp.problem.h), golden("momentum_qp.h"));
        agree("momentum_qp.g", momentum_qp.problem.g.as_slice(), golden("momentum_qp.g"));
        agree("momentum_qp.lower", momentum_qp.problem.lower.as_slice(), golden("momentum_qp.lower"));
        agree("momentum_qp.upper", momentum_qp.problem.upper.as_slice(), golden("momentum_qp.upper"));
        agree("torque_qp.h", &rows(&torque_qp.problem.h), golden("torque_qp.h"));
        agree("torque_qp.g", torque_qp.problem.g.as_slice(), golden("torque_qp.g"));
        commands_agree(&controller, &case.golden["aero_aware"]);
    }
}

#[test]
fn the_baseline_controller_agrees() {
    for case in golden_cases() {
        let controller = case.tick("baseline");
        let golden = &case.golden["baseline"];
        let problem = &controller.terms().momentum_qp.problem;
        agree("momentum_qp.h", &rows(&problem.h), &golden["momentum_qp.h"]);
        agree("momentum_qp.g", problem.g.as_slice(), &golden["momentum_qp.g"]);
        commands_agree(&controller, golden);
    }
}

#[track_caller]
fn commands_agree(controller: &Controller, golden: &Value) {
    let command = controller.command();
    agree("thrust_rate", command.thrust_rate.as_slice(), &golden["thrust_rate"]);
    agree("joint_velocity_command", command.joint_velocity.as_slice(), &golden["joint_velocity_command"]);
    agree("unlimited_torque", controller.terms().unlimited_torque.as_slice(), &golden["unlimited_torque"]);
}

#[test]
fn the_sphere_cylinder_forces_agree() {
    for case in golden_cases() {
        let controller = case.tick("aero_aware");
        let robot = controller.model();
        let config = flight_io::load(&repository().join("configs/aero/sphere_cylinder.toml")).unwrap();
        let mut model = load_aero(&config, robot).unwrap();
        let mut forces = LinkForces::new(robot);
        forces.update(
            robot,
            &controller.terms().kinematics,
            LinkConventions::default(),
            &mut model,
            &case.wind,
        );
        let flat: Vec<f64> = forces.forces_i.iter().flatten().copied().collect();
        agree("aero_force", &flat, &case.golden["sphere_cylinder"]["aero_force"]);
    }
}

//! Agreement with two complete states of a tick from an independent prototype.
//!
//! The file lives beside the project, not in it; without it this test says so and passes.

#![allow(clippy::unwrap_used)] // a test stops at the first thing that is not there

use flight_core::aero::{LinkConventions, LinkForces};
use flight_core::control::references::Reference;
use flight_core::control::{Memory, Terms};
use flight_core::kinematics::RobotState;
use flight_core::spatial::Pose;
use flight_core::{Controller, Measurement};
use flight_io::{load_aero, load_controller, load_robot};
use flight_sim::{FlightConfig, load_flight};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use serde_json::Value;
use std::path::{Path, PathBuf};

const TOLERANCE: f64 = 1e-9;

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn golden_states() -> Option<Vec<Value>> {
    let path = repository().join("../shared/golden/states.json");
    let Ok(text) = std::fs::read_to_string(&path) else {
        eprintln!("skipped: {} is absent", path.display());
        return None;
    };
    let value: Value = serde_json::from_str(&text).unwrap();
    Some(value["states"].as_array().unwrap().clone())
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
    assert!(worst <= TOLERANCE * scale, "{name}: differs by {worst:e} of {scale:e}");
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
    reference: Reference,
    memory: Memory,
}

impl Case {
    fn new(golden: Value) -> Self {
        let joints = numbers(&golden["s"]);
        let mut state = RobotState::zero(joints.len());
        state.base = Pose { rotation: matrix3(&golden["R"]), position: vector3(&golden["p"]) };
        state.joint_position = DVector::from_vec(joints);
        state.velocity = DVector::from_vec(numbers(&golden["nu"]));
        let reference = &golden["ref"];
        Self {
            reference: Reference {
                com_position: vector3(&reference["x"]),
                com_velocity: vector3(&reference["v"]),
                com_acceleration: vector3(&reference["a"]),
                com_jerk: vector3(&reference["j"]),
                rotation: matrix3(&reference["R"]),
                angular_velocity_b: vector3(&reference["w"]),
                angular_acceleration_b: vector3(&reference["wd"]),
                angular_jerk_b: vector3(&reference["wdd"]),
            },
            memory: Memory {
                posture: DVector::from_vec(numbers(&golden["s_des"])),
                inertia_0_b: matrix3(&golden["Ic0"]),
                velocity_error_integral: DVector::zeros(23),
                torque_is_known: false,
            },
            thrust: numbers(&golden["T"]),
            wind: vector3(&golden["wind"]),
            state,
            golden,
        }
    }

    /// A controller with `configs/control/<control>.toml` and published coefficients, after one tick.
    fn tick(&self, control: &str) -> Controller {
        let config = flight_config(control);
        let robot = load_robot(&config.robot).unwrap();
        let mut controller = load_controller(robot, &config.controller, &config.envelope, 0.01).unwrap();
        controller.set_memory(self.memory.clone()).unwrap();
        let measurement =
            Measurement { time: 0.0, state: &self.state, thrust: &self.thrust, wind: self.wind };
        controller.tick_with_reference(&measurement, &self.reference);
        controller
    }
}

/// The golden states use physically right points and the printed coefficients.
fn flight_config(control: &str) -> FlightConfig {
    let mut config = load_flight(&repository().join("configs/experiments/test2.toml")).unwrap();
    let mut value =
        flight_io::resolve(&repository().join(format!("configs/control/{control}.toml"))).unwrap();
    if value["aero"]["model"] == "axisymmetric" {
        value["aero"]["coefficients"] = "published".into();
    }
    config.controller = serde_json::from_value(value).unwrap();
    config
}

#[test]
fn every_intermediate_of_the_aware_controller_agrees() {
    let Some(states) = golden_states() else { return };
    assert_eq!(states.len(), 2);
    for case in states.into_iter().map(Case::new) {
        let controller = case.tick("aero_aware");
        let golden = &case.golden;
        let Terms { kinematics, dynamics, link_forces, momentum, momentum_qp, torque_qp, .. } =
            controller.terms();

        agree("mass", &[kinematics.mass()], &golden["mass"]);
        agree("com", kinematics.com.as_slice(), &golden["com"]);
        agree("M", &rows(&dynamics.mass_matrix), &golden["M"]);
        agree("h", dynamics.bias.as_slice(), &golden["h"]);
        agree("CMM", &rows(&dynamics.momentum_matrix), &golden["CMM"]);
        agree("L", dynamics.momentum.as_slice(), &golden["L"]);
        let com_jacobian: Vec<Vector3<f64>> =
            (0..29).map(|column| dynamics.com_jacobian_column(column)).collect();
        let com_jacobian = DMatrix::from_fn(3, 29, |row, column| com_jacobian[column][row]);
        agree("J_com", &rows(&com_jacobian), &golden["J_com"]);

        let flat = |vectors: &[Vector3<f64>]| -> Vec<f64> { vectors.iter().flatten().copied().collect() };
        agree("aero_pos", &flat(&link_forces.arm_points_i), &golden["aero_pos"]);
        agree("aero_axes", &flat(&link_forces.axes_i), &golden["aero_axes"]);
        agree("f_aero_flight", &flat(&link_forces.forces_i), &golden["f_aero_flight"]);
        agree(
            "aero_moment_com",
            link_forces.wrench_about(&kinematics.com).1.as_slice(),
            &golden["aero_moment_com"],
        );
        let jacobians: Vec<f64> = (controller.robot().aero_links.iter().zip(&link_forces.jacobian_points_i))
            .flat_map(|(link, point)| rows(&kinematics.jacobian(link.frame.body, point).0))
            .collect();
        agree("J_aero", &jacobians, &golden["J_aero"]);

        agree("jet_axes", &flat(&momentum.jet_axes_i), &golden["jet_axes"]);
        let arms: Vec<Vector3<f64>> =
            momentum.jet_points_i.iter().map(|point| point - kinematics.com).collect();
        agree("jet_arms", &flat(&arms), &golden["jet_arms"]);
        agree("A_T", &rows(&momentum.a_t), &golden["A_T"]);
        agree("Lambda_T", &rows(&momentum.lambda_t), &golden["Lambda_T"]);
        agree("Lambda_a", &rows(&momentum.lambda_a), &golden["Lambda_a"]);
        agree("LDot", momentum.rate_estimate.as_slice(), &golden["LDot"]);

        agree("task_AB", &rows(&momentum_qp.task.fixed_rows::<6>(0)), &golden["task_AB"]);
        agree("task_delta", momentum_qp.offset.fixed_rows::<6>(0).as_slice(), &golden["task_delta"]);
        agree("H", &rows(&momentum_qp.problem.h), &golden["H"]);
        agree("g", momentum_qp.problem.g.as_slice(), &golden["g"]);
        agree("lb", momentum_qp.problem.lower.as_slice(), &golden["lb"]);
        agree("ub", momentum_qp.problem.upper.as_slice(), &golden["ub"]);
        let command = controller.command();
        let u: Vec<f64> = command.thrust_rate.iter().chain(&command.joint_velocity).copied().collect();
        agree("u_aware", &u, &golden["u_aware"]);
        assert_eq!(u64::from(command.momentum_qp.active), golden["n_active"].as_u64().unwrap());

        agree("tau_H", &rows(&torque_qp.problem.h), &golden["tau_H"]);
        agree("tau_g", torque_qp.problem.g.as_slice(), &golden["tau_g"]);
        agree("tau_aware", controller.terms().unlimited_torque.as_slice(), &golden["tau_aware"]);
    }
}

#[test]
fn the_baseline_controller_agrees() {
    let Some(states) = golden_states() else { return };
    for case in states.into_iter().map(Case::new) {
        let controller = case.tick("baseline");
        let problem = &controller.terms().momentum_qp.problem;
        agree("H_baseline", &rows(&problem.h), &case.golden["H_baseline"]);
        agree("g_baseline", problem.g.as_slice(), &case.golden["g_baseline"]);
        let command = controller.command();
        let u: Vec<f64> = command.thrust_rate.iter().chain(&command.joint_velocity).copied().collect();
        agree("u_baseline", &u, &case.golden["u_baseline"]);
    }
}

#[test]
fn the_sphere_cylinder_forces_agree() {
    let Some(states) = golden_states() else { return };
    for case in states.into_iter().map(Case::new) {
        let controller = case.tick("aero_aware");
        let robot = controller.robot();
        let value = flight_io::resolve(&repository().join("configs/aero/sphere_cylinder.toml")).unwrap();
        let mut model = load_aero(&serde_json::from_value(value).unwrap(), robot).unwrap();
        let mut forces = LinkForces::new(robot);
        forces.update(
            robot,
            &controller.terms().kinematics,
            LinkConventions::default(),
            &mut model,
            &case.wind,
        );
        let flat: Vec<f64> = forces.forces_i.iter().flatten().copied().collect();
        agree("f_aero_cyl", &flat, &case.golden["f_aero_cyl"]);
    }
}

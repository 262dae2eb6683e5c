//! The controller, one tick at a time, with every intermediate value by name.

use crate::arrays::{Input, array, entries, matrix, matrix3, value_error, vector, vector3, vectors};
use crate::flight::parse;
use crate::qp::answer;
use crate::robot::state;
use flight_core::Measurement;
use flight_core::control::Memory;
use flight_core::control::contact::Contact;
use flight_core::control::references::{Reference, ReferenceGenerator};
use flight_core::control::standing::StandingQp;
use flight_io::{load_controller, load_mission, load_robot};
use nalgebra::{DMatrix, DVector, Vector3, Vector6};
use pyo3::exceptions::{PyKeyError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The flight controller of a configuration.
#[pyclass(module = "jax_aero._core")]
pub struct Controller {
    controller: flight_core::Controller,
}

#[pymethods]
impl Controller {
    #[new]
    fn new(config_json: &str) -> PyResult<Self> {
        let config = parse(config_json)?;
        let robot = load_robot(&config.robot).map_err(value_error)?;
        load_controller(robot, &config.controller, &config.envelope, config.simulator.time_step)
            .map(|controller| Self { controller })
            .map_err(value_error)
    }

    /// Replace what the controller remembers between ticks: posture (n), inertia_0_b (3, 3) and the
    /// integral of the joint velocity error (n). The rate limiter starts anew.
    fn set_memory(
        &mut self,
        posture: Input<'_>,
        inertia_0_b: Input<'_>,
        velocity_error_integral: Input<'_>,
    ) -> PyResult<()> {
        let joints = self.controller.robot().n_joints();
        let memory = Memory {
            posture: DVector::from_vec(entries("posture", &posture, &[joints])?),
            inertia_0_b: matrix3("inertia_0_b", &inertia_0_b)?,
            velocity_error_integral: DVector::from_vec(entries(
                "velocity_error_integral",
                &velocity_error_integral,
                &[joints],
            )?),
            torque_is_known: false,
        };
        self.controller.set_memory(memory).map_err(value_error)
    }

    /// One tick; returns every intermediate value and the command by name. With `reference` (a dict with
    /// the keys of the result's `reference`) the envelope is not asked.
    /// `foot_wrenches` (feet, 6) is what each foot feels, force first, about the origin of its sole.
    #[pyo3(signature = (time, base_position, base_rotation, joint_position, velocity, thrust, wind, reference = None, foot_wrenches = None))]
    #[allow(clippy::too_many_arguments)]
    fn tick<'py>(
        &mut self,
        py: Python<'py>,
        time: f64,
        base_position: Input<'py>,
        base_rotation: Input<'py>,
        joint_position: Input<'py>,
        velocity: Input<'py>,
        thrust: Input<'py>,
        wind: Input<'py>,
        reference: Option<&Bound<'py, PyDict>>,
        foot_wrenches: Option<Input<'py>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (joints, jets) = (self.controller.robot().n_joints(), self.controller.robot().jets.len());
        let state = state(joints, &base_position, &base_rotation, &joint_position, &velocity)?;
        let thrust = entries("thrust", &thrust, &[jets])?;
        let measurement = Measurement { time, state: &state, thrust: &thrust, wind: vector3("wind", &wind)? };
        if let Some(wrenches) = foot_wrenches {
            let feet = self.controller.robot().feet.len();
            let wrenches = entries("foot_wrenches", &wrenches, &[feet, 6])?;
            let wrenches: Vec<_> = wrenches.chunks_exact(6).map(Vector6::from_column_slice).collect();
            self.controller.feel(&wrenches);
        }
        match reference {
            None => self.controller.tick(&measurement),
            Some(given) => {
                let reference = reference_from_dict(given)?;
                self.controller.tick_with_reference(&measurement, &reference)
            }
        };
        self.last_tick(py)
    }
}

impl Controller {
    fn last_tick<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (terms, command, memory) =
            (self.controller.terms(), self.controller.command(), self.controller.memory());
        let out = PyDict::new(py);
        let kinematics = &terms.kinematics;
        out.set_item("com_position", vector(py, kinematics.com.as_slice())?)?;
        out.set_item("mass_matrix", matrix(py, &terms.dynamics.mass_matrix)?)?;
        out.set_item("bias", vector(py, terms.dynamics.bias.as_slice())?)?;
        out.set_item("momentum_matrix", matrix(py, &terms.dynamics.momentum_matrix)?)?;
        out.set_item("momentum", vector(py, terms.dynamics.momentum.as_slice())?)?;
        out.set_item("centroidal_inertia", matrix(py, &terms.dynamics.centroidal_inertia)?)?;

        out.set_item("link_axes", vectors(py, &terms.link_forces.axes_i)?)?;
        out.set_item("link_v_air", vectors(py, &terms.link_forces.v_air_i)?)?;
        out.set_item("link_arm_points", vectors(py, &terms.link_forces.arm_points_i)?)?;
        out.set_item("link_jacobian_points", vectors(py, &terms.link_forces.jacobian_points_i)?)?;
        out.set_item("aero_force", vectors(py, &terms.link_forces.forces_i)?)?;

        out.set_item("jet_axes", vectors(py, &terms.momentum.jet_axes_i)?)?;
        out.set_item("jet_points", vectors(py, &terms.momentum.jet_points_i)?)?;
        out.set_item("a_t", matrix(py, &terms.momentum.a_t)?)?;
        out.set_item("lambda_t", matrix(py, &terms.momentum.lambda_t)?)?;
        out.set_item("lambda_a", matrix(py, &terms.momentum.lambda_a)?)?;
        out.set_item("momentum_rate_estimate", vector(py, terms.momentum.rate_estimate.as_slice())?)?;

        out.set_item("k_ddot_desired", vector(py, terms.attitude.k_ddot_desired_b.as_slice())?)?;
        out.set_item("sigma", vector(py, terms.attitude.sigma_i.as_slice())?)?;
        out.set_item("task", matrix(py, &terms.momentum_qp.task)?)?;
        out.set_item("task_offset", vector(py, terms.momentum_qp.offset.as_slice())?)?;
        out.set_item("h", matrix(py, &terms.momentum_qp.problem.h)?)?;
        out.set_item("g", vector(py, terms.momentum_qp.problem.g.as_slice())?)?;
        out.set_item("lower", vector(py, terms.momentum_qp.problem.lower.as_slice())?)?;
        out.set_item("upper", vector(py, terms.momentum_qp.problem.upper.as_slice())?)?;
        out.set_item("thrust_rate", vector(py, command.thrust_rate.as_slice())?)?;
        out.set_item("joint_velocity_command", vector(py, command.joint_velocity.as_slice())?)?;
        out.set_item("momentum_qp", answer(py, &command.momentum_qp)?)?;

        out.set_item(
            "joint_acceleration_desired",
            vector(py, terms.torque_qp.acceleration_desired.as_slice())?,
        )?;
        out.set_item("joint_acceleration_free", vector(py, terms.torque_qp.acceleration_free.as_slice())?)?;
        out.set_item("torque_gain", matrix(py, &terms.torque_qp.gain)?)?;
        out.set_item("torque_h", matrix(py, &terms.torque_qp.problem.h)?)?;
        out.set_item("torque_g", vector(py, terms.torque_qp.problem.g.as_slice())?)?;
        out.set_item("unlimited_torque", vector(py, terms.unlimited_torque.as_slice())?)?;
        out.set_item("joint_torque", vector(py, command.joint_torque.as_slice())?)?;
        out.set_item("torque_qp", answer(py, &command.torque_qp)?)?;

        if let (Some(contact), Some(qp)) = (&terms.contact, &terms.standing_qp) {
            out.set_item("contact", contact_dict(py, contact, qp)?)?;
        }
        out.set_item("status", format!("{:?}", command.status))?;
        out.set_item("posture", vector(py, memory.posture.as_slice())?)?;
        out.set_item("inertia_0_b", matrix(py, &memory.inertia_0_b)?)?;
        out.set_item("velocity_error_integral", vector(py, memory.velocity_error_integral.as_slice())?)?;
        out.set_item("reference", reference_to_dict(py, &terms.reference)?)?;
        Ok(out)
    }
}

/// The feet and the torque QP of a robot that stands; without the keys of the QP while it does not.
fn contact_dict<'py>(py: Python<'py>, contact: &Contact, qp: &StandingQp) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let feet = contact.soles.len();
    let wrenches = |forces: &DVector<f64>| array(py, &[feet, 6], forces.as_slice().to_vec());
    out.set_item("is_active", contact.is_active)?;
    out.set_item("force", wrenches(&contact.force)?)?;
    out.set_item("force_rate", wrenches(&contact.force_rate)?)?;
    out.set_item("force_of_torques", wrenches(&contact.force_of_torques)?)?;
    out.set_item("a_c", matrix(py, &contact.a_c)?)?;
    out.set_item("jacobian", matrix(py, &contact.jacobian_transposed.transpose())?)?;
    out.set_item("velocity_product", vector(py, contact.velocity_product.as_slice())?)?;
    if contact.is_active {
        out.set_item("h", matrix(py, &qp.problem.h)?)?;
        out.set_item("g", vector(py, qp.problem.g.as_slice())?)?;
        out.set_item("lower", vector(py, qp.problem.lower.as_slice())?)?;
        out.set_item("upper", vector(py, qp.problem.upper.as_slice())?)?;
        out.set_item("rows", matrix(py, &qp.problem.normals.transpose())?)?;
        out.set_item("limit", vector(py, qp.problem.limit.as_slice())?)?;
    }
    Ok(out)
}

fn reference_to_dict<'py>(py: Python<'py>, reference: &Reference) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    out.set_item("com_position", vector(py, reference.com_position.as_slice())?)?;
    out.set_item("com_velocity", vector(py, reference.com_velocity.as_slice())?)?;
    out.set_item("com_acceleration", vector(py, reference.com_acceleration.as_slice())?)?;
    out.set_item("com_jerk", vector(py, reference.com_jerk.as_slice())?)?;
    out.set_item("rotation", matrix(py, &reference.rotation)?)?;
    out.set_item("angular_velocity", vector(py, reference.angular_velocity_b.as_slice())?)?;
    out.set_item("angular_acceleration", vector(py, reference.angular_acceleration_b.as_slice())?)?;
    out.set_item("angular_jerk", vector(py, reference.angular_jerk_b.as_slice())?)?;
    Ok(out)
}

fn reference_from_dict(given: &Bound<'_, PyDict>) -> PyResult<Reference> {
    let item = |key: &str| -> PyResult<Input<'_>> {
        let value =
            given.get_item(key)?.ok_or_else(|| PyKeyError::new_err(format!("`reference` lacks `{key}`")))?;
        value
            .extract()
            .map_err(|_| PyValueError::new_err(format!("`reference[{key:?}]` is not a float64 array")))
    };
    let vector = |key: &str| -> PyResult<Vector3<f64>> { vector3(key, &item(key)?) };
    Ok(Reference {
        com_position: vector("com_position")?,
        com_velocity: vector("com_velocity")?,
        com_acceleration: vector("com_acceleration")?,
        com_jerk: vector("com_jerk")?,
        rotation: matrix3("rotation", &item("rotation")?)?,
        angular_velocity_b: vector("angular_velocity")?,
        angular_acceleration_b: vector("angular_acceleration")?,
        angular_jerk_b: vector("angular_jerk")?,
    })
}

/// The references of a whole flight as arrays, for a robot that starts at `com` and `rpy`: raw and
/// smoothed signals at every tick from 0 to duration.
#[pyfunction]
pub fn reference_trajectory<'py>(
    py: Python<'py>,
    config_json: &str,
    com: Input<'py>,
    rpy: Input<'py>,
) -> PyResult<Bound<'py, PyDict>> {
    let config = parse(config_json)?;
    config.controller.law.references.check().map_err(value_error)?;
    let mission = load_mission(&config.envelope).map_err(value_error)?;
    let dt = config.simulator.time_step;
    let ticks = config.simulator.n_ticks() + 1;
    let mut generator = ReferenceGenerator::new(
        &config.controller.law.references,
        dt,
        vector3("com", &com)?,
        vector3("rpy", &rpy)?,
    );
    let mut signals: [(&str, DMatrix<f64>); 9] = [
        "raw_position",
        "raw_rpy",
        "com_position",
        "com_velocity",
        "com_acceleration",
        "com_jerk",
        "angular_velocity",
        "angular_acceleration",
        "angular_jerk",
    ]
    .map(|name| (name, DMatrix::zeros(ticks, 3)));
    let mut rotations = Vec::with_capacity(9 * ticks);
    for tick in 0..ticks {
        let reference = generator.update(&mission, tick as f64 * dt);
        let raw = generator.raw();
        let values = [
            raw.position,
            raw.rpy,
            reference.com_position,
            reference.com_velocity,
            reference.com_acceleration,
            reference.com_jerk,
            reference.angular_velocity_b,
            reference.angular_acceleration_b,
            reference.angular_jerk_b,
        ];
        for ((_, signal), value) in signals.iter_mut().zip(values) {
            signal.set_row(tick, &value.transpose());
        }
        rotations.extend(reference.rotation.transpose().iter());
    }
    let out = PyDict::new(py);
    for (name, signal) in &signals {
        out.set_item(name, matrix(py, signal)?)?;
    }
    out.set_item("rotation", array(py, &[ticks, 3, 3], rotations)?)?;
    Ok(out)
}

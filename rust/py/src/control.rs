//! The controller, one tick at a time, with all intermediate values by name.

use crate::arrays::{
    Input, Output, array, entries, finite_entries, matrix, matrix3, plain_error, value_error, vector,
    vector3, vectors,
};
use crate::flight::{parse, parse_table};
use crate::qp::answer;
use crate::robot::{StateInput, measured_state, rotation as checked_rotation, state_arrays};
use flight_core::control::Present;
use flight_core::control::detect::engines::EngineMonitor;
use flight_core::control::engine_condition::EngineCondition;
use flight_core::control::estimate::joint_tracker::JointMeasurement;
use flight_core::control::law::contact::ContactState;
use flight_core::control::law::residual::Residual;
use flight_core::control::law::setpoint::{Setpoint, SetpointGenerator};
use flight_core::control::law::tasks::MOMENTUM_ROWS;
use flight_core::control::mpc::horizon::{Horizon, Target};
use flight_core::control::mpc::model::Linearised;
use flight_core::control::mpc::nonlinear::NonlinearPlan;
use flight_core::control::{ControllerState as State, Estimate, Given, Measurement, Preview, Terms};
use flight_io::{load_aero, load_mission, load_robot};
use flight_sim::onboard;
use nalgebra::{DVector, Vector3, Vector6};
use pyo3::exceptions::{PyKeyError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Python's names of [`Setpoint::vectors`].
const SETPOINT_VECTORS: [&str; 7] = [
    "com_position",
    "com_velocity",
    "com_acceleration",
    "com_jerk",
    "angular_velocity",
    "angular_acceleration",
    "angular_jerk",
];

/// The flight controller of a configuration, with the state of its flight.
#[pyclass(module = "jax_aero._core")]
pub struct Controller {
    controller: flight_core::Controller,
    state: Option<State>,
}

/// State of a controller that is kept from tick to tick.
#[pyclass(module = "jax_aero._core", frozen)]
#[derive(Clone)]
pub struct ControllerState {
    state: State,
}

impl From<State> for ControllerState {
    fn from(state: State) -> Self {
        Self { state }
    }
}

#[pymethods]
impl ControllerState {
    /// Returns this state with another posture (n), inertia_0_b (3, 3) and integral of the joint velocity error (n).
    fn with_posture_control(
        &self,
        posture: Input<'_>,
        inertia_0_b: Input<'_>,
        velocity_error_integral: Input<'_>,
    ) -> PyResult<Self> {
        let joints = self.state.posture().len();
        let posture = DVector::from_vec(entries("posture", &posture, &[joints])?);
        let integral = entries("velocity_error_integral", &velocity_error_integral, &[joints])?;
        let inertia = matrix3("inertia_0_b", &inertia_0_b)?;
        let state = self.state.clone().with_posture_control(posture, inertia, DVector::from_vec(integral));
        state.map(|state| Self { state }).map_err(value_error)
    }

    /// Cost of a descent's plan, and its inputs (knots × inputs), in one row; `None` without a plan.
    fn descent_plan<'py>(&self, py: Python<'py>) -> PyResult<Option<(f64, Output<'py>)>> {
        let plan = self.state.descent_plan().and_then(NonlinearPlan::motion);
        plan.map(|(cost, inputs)| Ok((cost, vector(py, inputs)?))).transpose()
    }

    /// Conditions of the engines after the last tick, and the evidence for them, by name, of every jet.
    ///
    /// `state` (0 works, 1 limited, 2 unconfirmed, 3 stopped), `reaches` (jets, 2) [N], `is_sensor_used`, `since` [s], `taken` [N],
    /// `evidence`, the name of the finding, and `reading` of its sensor [N]. With a disturbance observer `observed` (6) and
    /// `residual` (6) [N, N m], and `covered` [s], NaN where no momentum was measured. With `fault_detection.engines`
    /// `deviation`, `lag`, `outside` and `late` (jets, 2), d, l, d′ and d̄ of force and moment [N], and `monitored` (jets, 4), for
    /// how long d̄ has exceeded its limit, the sensor has said that most of the thrust is missing, and the momentum has shown
    /// what was taken away, and has not [s]. With `fault_detection.unmeasured_engines` `before` (6), w̄ [N, N m], and
    /// `unmeasured` (jets, 3), for how long the sensor has been silent, thrust has been missing or given, and sensor and
    /// momentum have agreed [s].
    fn engines<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (out, engines) = (PyDict::new(py), self.state.engines());
        let rows = |width: usize, numbers: Vec<f64>| array(py, &[numbers.len() / width, width], numbers);
        let of = |number: fn(&EngineCondition) -> f64| engines.iter().map(number).collect::<Vec<_>>();
        out.set_item("state", vector(py, &of(|engine| f64::from(engine.state.code())))?)?;
        let reaches = engines.iter().flat_map(|engine| <[f64; 2]>::from(engine.reaches)).collect();
        out.set_item("reaches", rows(2, reaches)?)?;
        out.set_item(
            "is_sensor_used",
            vector(py, &of(|engine| f64::from(u8::from(engine.is_sensor_used))))?,
        )?;
        out.set_item("since", vector(py, &of(|engine| engine.since))?)?;
        out.set_item("taken", vector(py, &of(|engine| engine.taken.thrust))?)?;
        out.set_item("evidence", engines.iter().map(|engine| engine.evidence.name()).collect::<Vec<_>>())?;
        out.set_item("reading", vector(py, &self.state.estimate().thrust_reading)?)?;
        if let Some(observer) = self.state.disturbance() {
            out.set_item("observed", vector(py, observer.wrench().as_slice())?)?;
            out.set_item("residual", vector(py, observer.residual.as_slice())?)?;
            out.set_item("covered", observer.covered.unwrap_or(f64::NAN))?;
        }
        if let Some(monitors) = self.state.engine_monitors() {
            let of = |number: fn(&EngineMonitor) -> f64| monitors.iter().map(number).collect::<Vec<_>>();
            out.set_item("deviation", vector(py, &of(|monitor| monitor.deviation))?)?;
            out.set_item("lag", vector(py, &of(|monitor| monitor.lag))?)?;
            out.set_item("outside", vector(py, &of(|monitor| monitor.outside))?)?;
            out.set_item("late", rows(2, monitors.iter().flat_map(EngineMonitor::late).collect())?)?;
            out.set_item("monitored", rows(4, monitors.iter().flat_map(EngineMonitor::times).collect())?)?;
        }
        if let Some(unmeasured) = self.state.unmeasured_engines() {
            out.set_item("before", vector(py, unmeasured.before().as_slice())?)?;
            out.set_item("unmeasured", rows(3, unmeasured.times().flatten().collect())?)?;
        }
        Ok(out)
    }

    /// Whether all numbers are equal; a NaN, such as that of a missing measurement, is not equal to itself.
    fn __eq__(&self, other: &Self) -> bool {
        self.state == other.state
    }
}

#[pymethods]
impl Controller {
    #[new]
    fn new(config_json: &str) -> PyResult<Self> {
        let table = parse_table(config_json)?;
        let controller = if table.get("simulator").is_some() {
            let config = parse(config_json)?; // which may be at hand
            load_robot(&config.robot).and_then(|robot| config.controller(robot))
        } else {
            onboard(table, "onboard").map(|(_, _, controller)| controller)
        };
        Ok(Self { controller: controller.map_err(value_error)?, state: None })
    }

    /// The state after the last tick; `None` before the first.
    #[getter]
    fn state(&self) -> Option<ControllerState> {
        self.state.clone().map(|state| ControllerState { state })
    }

    /// Continues from a recorded state; with the state of another robot the next tick holds.
    #[setter]
    fn set_state(&mut self, state: &ControllerState) {
        self.state = Some(state.state.clone());
    }

    /// Start a flight: position, attitude and posture of this measurement become the reference.
    #[pyo3(signature = (time, state, thrust, wind, foot_wrenches = None, shaft_speed = None, height = f64::NAN))]
    #[allow(clippy::too_many_arguments)]
    fn start(
        &mut self,
        time: f64,
        state: StateInput<'_>,
        thrust: Input<'_>,
        wind: Input<'_>,
        foot_wrenches: Option<Input<'_>>,
        shaft_speed: Option<Input<'_>>,
        height: f64,
    ) -> PyResult<()> {
        let measured =
            self.read_measurement(time, &state, (&thrust, shaft_speed), &wind, foot_wrenches, height)?;
        self.state = Some(self.controller.start(&measured).map_err(plain_error)?);
        Ok(())
    }

    /// Compute one tick; returns every intermediate value and the command by name. The first tick starts the flight.
    /// `setpoint` (a dict with the keys of the result's `setpoint`) replaces that of the mission. `foot_wrenches`
    /// (feet, 6) is the wrench on each foot, force first, about the origin of its sole. `setpoints_ahead` are pairs of a
    /// time after the tick and a set-point, `wind_ahead` (samples, 4) times after it and velocities. `residual` are thrust
    /// rates, joint velocities, and whether they replace the answer of the law; then the mission is followed.
    #[pyo3(signature = (
        time, state, thrust, wind, setpoint = None, foot_wrenches = None, setpoints_ahead = vec![], wind_ahead = None,
        residual = None, shaft_speed = None, height = f64::NAN
    ))]
    #[allow(clippy::too_many_arguments)]
    fn tick<'py>(
        &mut self,
        py: Python<'py>,
        time: f64,
        state: StateInput<'py>,
        thrust: Input<'py>,
        wind: Input<'py>,
        setpoint: Option<&Bound<'py, PyDict>>,
        foot_wrenches: Option<Input<'py>>,
        setpoints_ahead: Vec<(f64, Bound<'py, PyDict>)>,
        wind_ahead: Option<Input<'py>>,
        residual: Option<(Input<'py>, Input<'py>, bool)>,
        shaft_speed: Option<Input<'py>>,
        height: f64,
    ) -> PyResult<Bound<'py, PyDict>> {
        let setpoint = setpoint.map(setpoint_from_dict).transpose()?;
        let later = |(time, given): &(f64, Bound<'py, PyDict>)| Ok((*time, setpoint_from_dict(given)?));
        let setpoints = setpoints_ahead.iter().map(later).collect::<PyResult<Vec<_>>>()?;
        let winds = wind_ahead.map_or(Ok(Vec::new()), |winds| {
            let count = winds.as_array().shape().first().copied().unwrap_or(0);
            entries("preview.wind", &winds, &[count, 4])
        })?;
        let winds: Vec<_> =
            winds.chunks_exact(4).map(|row| (row[0], Vector3::from_column_slice(&row[1..]))).collect();
        let preview = Preview { setpoints: &setpoints, wind: &winds };
        let measured =
            self.read_measurement(time, &state, (&thrust, shaft_speed), &wind, foot_wrenches, height)?;
        let state = match &mut self.state {
            Some(state) => state,
            none => none.insert(self.controller.start(&measured).map_err(plain_error)?),
        };
        let (jets, joints) = (self.controller.n_jets(), self.controller.model().joints.len());
        let residual = residual.map(|(thrust_rate, joint_velocity, replaces)| -> PyResult<_> {
            let thrust_rate = entries("residual.thrust_rate", &thrust_rate, &[jets])?;
            Ok((thrust_rate, entries("residual.joint_velocity", &joint_velocity, &[joints])?, replaces))
        });
        let residual = residual.transpose()?;
        let residual = residual.as_ref().map(|(thrust_rate, joint_velocity, replaces)| Residual {
            thrust_rate,
            joint_velocity,
            replaces: *replaces,
        });
        let given = Given { setpoint: setpoint.as_ref(), preview, residual: residual.as_ref() };
        self.controller.tick_with(state, &measured, &given);
        tick_dict(py, &self.controller, self.state.as_ref())
    }

    /// Compute one tick of the torques between two ticks of the law; returns torques and modes.
    fn tick_torques<'py>(
        &mut self,
        py: Python<'py>,
        joint_position: Input<'_>,
        joint_velocity: Input<'_>,
    ) -> PyResult<(Output<'py>, Vec<&'static str>)> {
        let joints = self.controller.model().joints.len();
        let position = entries("joint_position", &joint_position, &[joints])?;
        let velocity = entries("joint_velocity", &joint_velocity, &[joints])?;
        let Some(state) = &mut self.state else {
            return Err(PyValueError::new_err(
                "no flight has begun; expected a tick before one of the torques",
            ));
        };
        let measured = JointMeasurement { position: &position, velocity: &velocity };
        let command = self.controller.tick_torques(state, &measured);
        let torque = vector(py, command.joint_torque.as_slice())?;
        Ok((torque, command.modes.names().collect()))
    }

    /// Report after a tick that other thrust rates (jets) [N/s] and joint torques (n) [N m] act until the next one.
    fn replace_command(&mut self, thrust_rate: Input<'_>, joint_torque: Input<'_>) -> PyResult<()> {
        let rates = entries("thrust_rate", &thrust_rate, &[self.controller.n_jets()])?;
        let torques = entries("joint_torque", &joint_torque, &[self.controller.model().joints.len()])?;
        let Some(state) = &mut self.state else {
            return Err(PyValueError::new_err(
                "no flight has begun; expected a tick before its command is replaced",
            ));
        };
        self.controller.replace_command(state, &rates, &torques).map_err(plain_error)
    }

    /// Linearised model and QP of the predictive law at the state of the last tick, by name, from targets (knots, 6, 3) for
    /// the end of every knot: p, v, rotation vector, angular velocity, a, angular acceleration; and changes of the air's
    /// wrench (knots, 6).
    fn prediction<'py>(
        &self,
        py: Python<'py>,
        config_json: &str,
        targets: Input<'py>,
        wrenches: Input<'py>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let config = parse(config_json)?;
        let section = &config.controller;
        let (Some(mpc), Some(state)) = (&section.law.mpc, &self.state) else {
            return Err(PyValueError::new_err(
                "there is no prediction; expected `controller.mpc` and a tick",
            ));
        };
        let (robot, terms) = (self.controller.model(), self.controller.terms());
        let factors = &config.disturbances.aero_estimate;
        let aero = load_aero(&section.aero, robot)
            .and_then(|aero| aero.weight_forces(factors, robot, "disturbances.aero_estimate"))
            .map_err(value_error)?;
        let mut model = Linearised::new(robot, mpc.joints(robot).map_err(value_error)?);
        let now = Present { terms, estimate: state.estimate() };
        if !model.update(robot, &aero, mpc.air, now) {
            return Err(PyValueError::new_err("the centroidal inertia cannot be inverted"));
        }
        let gains = (section.law.torque.kd, section.law.torque.kp);
        let jets = robot.jet_models(section.law.jet_dynamics);
        let mut horizon = Horizon::new(mpc, gains, robot, jets, &model.joints).map_err(value_error)?;
        let targets = entries("targets", &targets, &[horizon.knots(), 6, 3])?;
        let target = |target: &[f64]| {
            let [p, v, rotation, omega, a, alpha] =
                std::array::from_fn(|index| Vector3::from_column_slice(&target[3 * index..3 * index + 3]));
            Target { com: [p, v, a], rotation, angular: [omega, alpha] }
        };
        let targets: Vec<Target> = targets.chunks_exact(18).map(target).collect();
        let wrenches = entries("wrenches", &wrenches, &[horizon.knots(), 6])?;
        let wrenches: Vec<_> = wrenches.chunks_exact(6).map(Vector6::from_column_slice).collect();
        horizon.update(&model, now, state.posture(), (&targets, &wrenches), !terms.limits.holds_position);
        let out = PyDict::new(py);
        out.set_item("rate_v", matrix(py, &model.rate_v)?)?;
        out.set_item("rate_theta", matrix(py, &model.rate_theta)?)?;
        out.set_item("rate_k", matrix(py, &model.rate_k)?)?;
        out.set_item("rate_t", matrix(py, &model.rate_t)?)?;
        out.set_item("rate_s", matrix(py, &model.rate_s)?)?;
        out.set_item("rate_sigma", matrix(py, &model.rate_sigma)?)?;
        out.set_item("omega_theta", matrix(py, &model.omega_theta)?)?;
        out.set_item("omega_k", matrix(py, &model.omega_k)?)?;
        out.set_item("omega_s", matrix(py, &model.omega_s)?)?;
        out.set_item("omega_sigma", matrix(py, &model.omega_sigma)?)?;
        out.set_item("h", matrix(py, &horizon.problem.h)?)?;
        out.set_item("g", vector(py, horizon.problem.g.as_slice())?)?;
        out.set_item("distance", vector(py, &horizon.clearance.distance)?)?;
        out.set_item("distance_by_joint", matrix(py, &horizon.clearance.by_joint.transpose())?)?;
        Ok(out)
    }
}

impl Controller {
    /// Builds a measurement from arrays.
    fn read_measurement(
        &self,
        time: f64,
        state: &StateInput<'_>,
        (thrust, shaft_speed): (&Input<'_>, Option<Input<'_>>),
        wind: &Input<'_>,
        foot_wrenches: Option<Input<'_>>,
        height: f64,
    ) -> PyResult<Measurement> {
        let jets = [self.controller.n_jets()];
        let shaft_speed = shaft_speed.map(|speed| entries("shaft_speed", &speed, &jets)).transpose()?;
        Ok(Measurement {
            time,
            state: measured_state(self.controller.model().joints.len(), state)?,
            thrust: entries("thrust", thrust, &jets)?,
            shaft_speed: shaft_speed.unwrap_or_default(),
            wind: vector3("wind", wind)?,
            foot_wrenches: self.foot_wrenches(foot_wrenches)?,
            height,
        })
    }

    /// Wrenches of the feet; zero by default.
    fn foot_wrenches(&self, given: Option<Input<'_>>) -> PyResult<DVector<f64>> {
        let feet = self.controller.model().feet.len();
        let Some(wrenches) = given else { return Ok(DVector::zeros(6 * feet)) };
        entries("foot_wrenches", &wrenches, &[feet, 6]).map(DVector::from_vec)
    }
}

/// Every value of the last tick of a controller, by name.
pub fn tick_dict<'py>(
    py: Python<'py>,
    controller: &flight_core::Controller,
    state: Option<&State>,
) -> PyResult<Bound<'py, PyDict>> {
    let (terms, command) = (controller.terms(), controller.command());
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
    out.set_item("unmodelled_wrench", vector(py, terms.momentum.unmodelled_wrench.as_slice())?)?;

    out.set_item("k_ddot_desired", vector(py, terms.attitude.k_ddot_desired_b.as_slice())?)?;
    out.set_item("sigma", vector(py, terms.attitude.sigma_i.as_slice())?)?;
    let tasks = &terms.momentum_qp;
    out.set_item("task", matrix(py, &tasks.matrix.columns(0, MOMENTUM_ROWS).transpose())?)?;
    out.set_item("task_offset", vector(py, &tasks.offset.as_slice()[..MOMENTUM_ROWS])?)?;
    out.set_item("h", matrix(py, &terms.momentum_qp.problem.h)?)?;
    out.set_item("g", vector(py, terms.momentum_qp.problem.g.as_slice())?)?;
    out.set_item("lower", vector(py, terms.momentum_qp.problem.lower.as_slice())?)?;
    out.set_item("upper", vector(py, terms.momentum_qp.problem.upper.as_slice())?)?;
    out.set_item("thrust_rate", vector(py, command.thrust_rate.as_slice())?)?;
    out.set_item("throttle", vector(py, command.throttle.as_slice())?)?;
    out.set_item("joint_velocity_command", vector(py, command.joint_velocity.as_slice())?)?;
    out.set_item("momentum_qp", answer(py, &command.rates_qp)?)?;
    out.set_item("residual", vector(py, terms.residual.as_slice())?)?;

    out.set_item("joint_acceleration_desired", vector(py, terms.torque_qp.acceleration_desired.as_slice())?)?;
    let free = &terms.torque_qp.acceleration_free.as_slice()[terms.torque_qp.joint_torque.clone()];
    out.set_item("joint_acceleration_free", vector(py, free)?)?;
    out.set_item("torque_gain", matrix(py, &terms.inverse_mass.joint_gain)?)?;
    out.set_item("torque_h", matrix(py, &terms.torque_qp.problem.h)?)?;
    out.set_item("torque_g", vector(py, terms.torque_qp.problem.g.as_slice())?)?;
    out.set_item("torque_lower", vector(py, terms.torque_qp.problem.lower.as_slice())?)?;
    out.set_item("torque_upper", vector(py, terms.torque_qp.problem.upper.as_slice())?)?;
    out.set_item("unlimited_torque", vector(py, terms.unlimited_torque.as_slice())?)?;
    out.set_item("joint_torque", vector(py, command.joint_torque.as_slice())?)?;
    out.set_item("torque_qp", answer(py, &command.torque_qp)?)?;

    if !terms.contact.soles.is_empty() {
        out.set_item("torque_rows", matrix(py, &terms.torque_qp.problem.normals.transpose())?)?;
        out.set_item("torque_limit", vector(py, terms.torque_qp.problem.limit.as_slice())?)?;
    }
    out.set_item("is_held", command.modes.is_held())?;
    out.set_item("degraded_modes", command.modes.names().collect::<Vec<_>>())?;
    let conditions: Vec<f64> = terms.limits.joints.iter().map(|found| f64::from(found.code())).collect();
    out.set_item("joint_condition", vector(py, &conditions)?)?;
    let latency = terms.findings.latency.map(|delay| delay.unwrap_or(f64::NAN));
    out.set_item("measured_latency", vector(py, &latency)?)?;
    if let Some(state) = state {
        out.set_item("estimates", estimate_to_dict(py, state.estimate())?)?;
        out.set_item("residual_wrench", vector(py, state.residual_wrench().as_slice())?)?;
        out.set_item("posture", vector(py, state.posture().as_slice())?)?;
        out.set_item("inertia_0_b", matrix(py, state.inertia_0_b())?)?;
        let integral = state.velocity_error_integral().as_slice();
        out.set_item("velocity_error_integral", vector(py, integral)?)?;
        if !terms.contact.soles.is_empty() {
            out.set_item("contact", contact_dict(py, terms, state.contact())?)?;
        }
    }
    out.set_item("setpoint", setpoint_to_dict(py, &terms.setpoint)?)?;
    Ok(out)
}

/// Contact quantities of a controller that can stand.
fn contact_dict<'py>(py: Python<'py>, terms: &Terms, state: &ContactState) -> PyResult<Bound<'py, PyDict>> {
    let (out, contact) = (PyDict::new(py), &terms.contact);
    let wrenches = |forces: &DVector<f64>| array(py, &[forces.len() / 6, 6], forces.as_slice().to_vec());
    out.set_item("is_active", state.is_active)?;
    out.set_item("force", wrenches(&state.force)?)?;
    out.set_item("force_rate", wrenches(&state.force_rate)?)?;
    out.set_item("force_of_torques", wrenches(&contact.force_of_torques)?)?;
    out.set_item("a_c", matrix(py, &terms.momentum.a_c)?)?;
    out.set_item("jacobian", matrix(py, &contact.jacobian_transposed.transpose())?)?;
    out.set_item("velocity_product", vector(py, contact.velocity_product.as_slice())?)?;
    Ok(out)
}

pub fn setpoint_to_dict<'py>(py: Python<'py>, setpoint: &Setpoint) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    for (name, numbers) in SETPOINT_VECTORS.into_iter().zip(setpoint.vectors()) {
        out.set_item(name, vector(py, numbers.as_slice())?)?;
    }
    out.set_item("rotation", matrix(py, &setpoint.rotation)?)?;
    Ok(out)
}

/// The robot as the law computes with it.
fn estimate_to_dict<'py>(py: Python<'py>, estimate: &Estimate) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    out.set_item("state", state_arrays(py, &estimate.robot.state)?)?;
    out.set_item("thrust", vector(py, &estimate.robot.thrust)?)?;
    out.set_item("thrust_rate", vector(py, &estimate.thrust_rate)?)?;
    out.set_item("wind", vector(py, estimate.robot.wind.as_slice())?)?;
    out.set_item("wind_std", vector(py, estimate.wind_std.as_slice())?)?;
    Ok(out)
}

/// A set-point from Python's names.
pub fn setpoint_from_dict(given: &Bound<'_, PyDict>) -> PyResult<Setpoint> {
    let item = |key: &str| -> PyResult<Input<'_>> {
        let value =
            given.get_item(key)?.ok_or_else(|| PyKeyError::new_err(format!("`setpoint` lacks `{key}`")))?;
        value
            .extract()
            .map_err(|_| PyValueError::new_err(format!("`setpoint[{key:?}]` is not a float64 array")))
    };
    let vector = |key: &str| -> PyResult<Vector3<f64>> { vector3(key, &item(key)?) };
    Ok(Setpoint {
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

/// Set-points of a whole flight as arrays, for a robot that starts with its centre of mass at `com` and its base
/// rotation `rotation`: raw and smoothed signals at every tick from 0 to `duration`.
#[pyfunction]
pub fn setpoint_trajectory<'py>(
    py: Python<'py>,
    config_json: &str,
    com: Input<'py>,
    rotation: Input<'py>,
) -> PyResult<Bound<'py, PyDict>> {
    let config = parse(config_json)?;
    let mission = load_mission(&config.mission).map_err(value_error)?;
    let robot = load_robot(&config.robot).map_err(value_error)?;
    config.simulator.check(&robot, config.controller.law.time_step).map_err(value_error)?;
    let dt = config.controller.law.time_step;
    let ticks = config.n_ticks() + 1;
    let generator =
        SetpointGenerator::new(&config.controller.law.setpoint, mission, &robot.forward_axis_b, dt)
            .map_err(value_error)?;
    let com = Vector3::from_vec(finite_entries("com", &com, &[3])?);
    let mut state = generator.start(com, &checked_rotation("rotation", &rotation)?);
    let mut signals: [Vec<Vector3<f64>>; 2 + SETPOINT_VECTORS.len()] = Default::default();
    let mut rotations = Vec::<f64>::with_capacity(9 * ticks);
    for tick in 0..ticks {
        let setpoint = generator.update(&mut state, tick as f64 * dt);
        let raw = state.raw();
        let values = [&raw.position, &raw.rpy].into_iter().chain(setpoint.vectors());
        for (signal, value) in signals.iter_mut().zip(values) {
            signal.push(*value);
        }
        rotations.extend(setpoint.rotation.transpose().iter());
    }
    let out = PyDict::new(py);
    for (name, signal) in ["raw_position", "raw_rpy"].into_iter().chain(SETPOINT_VECTORS).zip(&signals) {
        out.set_item(name, vectors(py, signal)?)?;
    }
    out.set_item("rotation", array(py, &[ticks, 3, 3], rotations)?)?;
    Ok(out)
}

//! A flight tick by tick, in the crate's world or in one that Python simulates.

use crate::arrays::{Input, Output, entries, finite_entries, plain_error, value_error, vector, vector3};
use crate::control::{ControllerState, setpoint_from_dict, setpoint_to_dict, tick_dict};
use crate::flight::{flight_dict, parse};
use crate::robot::{Robot, StateInput, measured_state, state_arrays};
use flight_core::control::law::residual::Residual;
use flight_core::control::{Given, Measurement};
use flight_core::robot::RobotModel;
use flight_sim::{FlightResult, Scenario, Seen, World};
use nalgebra::{DVector, Vector3, Vector6};
use numpy::IntoPyArray;
use numpy::ndarray::Array2;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::{Arc, Mutex, PoisonError};

/// The exception that a world raised, if it did.
type Raised = Arc<Mutex<Option<PyErr>>>;

/// State, state as measured, wrenches on the feet (feet, 6), joint torques (n), origins of the soles (feet, 3).
type SeenInput<'py> = (StateInput<'py>, StateInput<'py>, Input<'py>, Input<'py>, Input<'py>);

/// An object with the methods `observe` and `advance`.
#[derive(Debug)]
struct PyWorld {
    object: Py<PyAny>,
    raised: Raised,
}

impl PyWorld {
    fn keep(&self, error: PyErr) {
        self.raised.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
    }

    fn read(&self, seen: &mut Seen) -> PyResult<()> {
        Python::attach(|py| {
            let found = self.object.call_method0(py, "observe")?;
            let (state, measured, wrenches, torque, soles): SeenInput<'_> = found.extract(py)?;
            let (joints, feet) = (seen.joint_torque.len(), seen.soles.len());
            seen.state.copy_from(&measured_state(joints, &state)?);
            seen.measured.copy_from(&measured_state(joints, &measured)?);
            seen.joint_torque.copy_from_slice(&entries("joint_torque", &torque, &[joints])?);
            let wrenches = entries("foot_wrenches", &wrenches, &[feet, 6])?;
            for (to, wrench) in seen.foot_wrenches.iter_mut().zip(wrenches.chunks_exact(6)) {
                *to = Vector6::from_column_slice(wrench);
            }
            let soles = entries("soles", &soles, &[feet, 3])?;
            for (to, sole) in seen.soles.iter_mut().zip(soles.chunks_exact(3)) {
                *to = Vector3::from_column_slice(sole);
            }
            Ok(())
        })
    }
}

impl World for PyWorld {
    fn observe(&mut self, seen: &mut Seen) {
        if let Err(error) = self.read(seen) {
            seen.state.velocity.fill(f64::NAN);
            self.keep(error);
        }
    }

    fn advance(&mut self, steps: u32, torque: &[f64], force: &[f64]) {
        let advanced = Python::attach(|py| {
            let rows = steps as usize;
            let torque = Array2::from_shape_vec((rows, torque.len() / rows), torque.to_vec());
            let torque = torque.map_err(plain_error)?.into_pyarray(py);
            self.object.call_method1(py, "advance", (torque, vector(py, force)?))
        });
        if let Err(error) = advanced {
            self.keep(error);
        }
    }
}

/// A flight, tick by tick.
#[pyclass(module = "jax_aero._core")]
pub struct Flight {
    pub(crate) flight: flight_sim::Flight,
    raised: Raised,
}

#[pymethods]
impl Flight {
    #[new]
    #[pyo3(signature = (config_json, world = None, robot = None))]
    fn new(config_json: &str, world: Option<Py<PyAny>>, robot: Option<&Robot>) -> PyResult<Self> {
        let (config, raised) = (parse(config_json)?, Raised::default());
        let scenario = match (world, robot) {
            (None, None) => Scenario::new(&config),
            (None, Some(robot)) => Scenario::with_robot(&config, robot.model().clone()),
            (Some(object), _) => {
                let raised = raised.clone();
                Scenario::in_world(&config, Box::new(PyWorld { object, raised }))
            }
        };
        Ok(Self { flight: scenario.map_err(value_error)?.begin(), raised })
    }

    /// Index of the next tick; of a flight that is lost, of the tick in which it is.
    #[getter]
    fn tick(&self) -> usize {
        self.flight.tick()
    }

    /// Number of ticks after the one at time zero.
    #[getter]
    fn n_ticks(&self) -> usize {
        self.flight.n_ticks()
    }

    /// Whether the last tick has been flown or the flight is lost.
    #[getter]
    fn has_ended(&self) -> bool {
        self.flight.has_ended()
    }

    /// The simulated robot at the next tick, by name.
    fn truth<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let mut truth = self.flight.measurement().clone();
        let (plant, wind) = self.flight.truth();
        (truth.state, truth.wind) = (plant.state().clone(), *wind);
        truth.thrust.copy_from_slice(plant.jets().thrust_feedback());
        truth.shaft_speed.fill(f64::NAN);
        truth.height = f64::NAN;
        let out = measurement_dict(py, &truth)?;
        self.check_world()?;
        Ok(out)
    }

    /// What the controller is given in the next tick, by name.
    fn measurement<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let out = measurement_dict(py, self.flight.measurement())?;
        self.check_world()?;
        Ok(out)
    }

    /// Compute the next tick with a copy of the controller's state, without advancing; return every value by name.
    fn try_tick<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let state = self.flight.try_tick();
        self.check_world()?;
        let state = state.map_err(plain_error)?;
        tick_dict(py, self.flight.controller(), Some(&state))
    }

    /// What the controller follows in the next tick, by name.
    fn setpoint<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.flight.try_tick().map_err(plain_error)?;
        setpoint_to_dict(py, &self.flight.controller().terms().setpoint)
    }

    /// Fly one tick; return whether the flight goes on. `setpoint` (a dict) replaces that of the mission; `residual` are
    /// thrust rates, joint velocities, and whether they replace the answer of the law; `command` thrust rates and torques in
    /// place of the controller's; `measurement` state, thrusts, wind, wrenches of the controller's feet, speeds of shafts and
    /// height in place of the measured ones; `link_forces` (links, 3) those in place of the air's.
    #[pyo3(signature = (setpoint = None, residual = None, command = None, measurement = None, link_forces = None))]
    fn step(
        &mut self,
        setpoint: Option<&Bound<'_, PyDict>>,
        residual: Option<(Input<'_>, Input<'_>, bool)>,
        command: Option<(Input<'_>, Input<'_>)>,
        measurement: Option<(StateInput<'_>, Input<'_>, Input<'_>, Input<'_>, Input<'_>, f64)>,
        link_forces: Option<Input<'_>>,
    ) -> PyResult<bool> {
        let RobotModel { joints, jets, aero_links, .. } = self.flight.robot();
        let (joints, jets, links) = (joints.len(), jets.len(), aero_links.len());
        let residual = residual.map(|(rate, velocity, replaces)| {
            let rate = entries("residual.thrust_rate", &rate, &[jets])?;
            PyResult::Ok((rate, entries("residual.joint_velocity", &velocity, &[joints])?, replaces))
        });
        let residual = residual.transpose()?;
        let residual = residual.as_ref().map(|(thrust_rate, joint_velocity, replaces)| Residual {
            thrust_rate,
            joint_velocity,
            replaces: *replaces,
        });
        let setpoint = setpoint.map(setpoint_from_dict).transpose()?;
        let command = command.map(|(rate, torque)| {
            let rate = finite_entries("thrust_rate", &rate, &[jets])?;
            PyResult::Ok((rate, finite_entries("joint_torque", &torque, &[joints])?))
        });
        let command = command.transpose()?;
        let link_forces =
            link_forces.map(|forces| finite_entries("link_forces", &forces, &[links, 3])).transpose()?;
        if let Some((rate, torque)) = &command {
            self.flight.controller().check_command(rate, torque).map_err(plain_error)?;
        }
        // All that is given is read and checked before any of it is taken: a refused call changes nothing.
        if let Some((state, thrust, wind, feet, speed, height)) = measurement {
            let sample = self.flight.sample_mut();
            let read = Measurement {
                time: sample.time,
                state: measured_state(joints, &state)?,
                thrust: entries("thrust", &thrust, &[jets])?,
                shaft_speed: entries("shaft_speed", &speed, &[jets])?,
                wind: vector3("wind", &wind)?,
                foot_wrenches: DVector::from_vec(entries(
                    "foot_wrenches",
                    &feet,
                    &[sample.foot_wrenches.len() / 6, 6],
                )?),
                height,
            };
            *sample = read;
        }
        if let Some(forces) = link_forces {
            let forces = forces.chunks_exact(3).map(Vector3::from_column_slice).collect();
            self.flight.truth();
            self.flight.replace_link_forces(Some(forces)).map_err(value_error)?;
        }
        let given = Given { setpoint: setpoint.as_ref(), residual: residual.as_ref(), ..Given::default() };
        let command = command.as_ref().map(|(rate, torque)| (&rate[..], &torque[..]));
        let goes_on = self.flight.step_with(&given, command);
        self.flight.replace_link_forces(None).map_err(value_error)?;
        self.check_world()?;
        self.flight.refusal().map_or(Ok(()), |why| Err(plain_error(why)))?;
        goes_on.map_err(plain_error)
    }

    /// Every value of the last tick, by name, as of `Controller.tick`.
    fn last_tick<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        tick_dict(py, self.flight.controller(), self.flight.controller_state())
    }

    /// State of the controller after the last tick; `None` before the first.
    #[getter]
    fn controller_state(&self) -> Option<ControllerState> {
        self.flight.controller_state().cloned().map(ControllerState::from)
    }

    /// Wrench that a residual's policy observes (6) [N, N m].
    fn residual_wrench<'py>(&self, py: Python<'py>) -> PyResult<Output<'py>> {
        let state = self.flight.controller_state();
        let wrench =
            state.map_or_else(Vector6::zeros, flight_core::control::ControllerState::residual_wrench);
        vector(py, wrench.as_slice())
    }

    /// The result; before the end, as if the flight ended now.
    fn result<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (summary, log) = (self.flight.summary(), self.flight.log().clone());
        let (outcome, loss) = (self.flight.outcome(&summary), self.flight.loss());
        flight_dict(py, FlightResult { outcome, loss, log, summary }, true)
    }
}

impl Flight {
    /// Raises what the world raised.
    pub(crate) fn check_world(&self) -> PyResult<()> {
        self.raised.lock().unwrap_or_else(PoisonError::into_inner).take().map_or(Ok(()), Err)
    }
}

fn measurement_dict<'py>(py: Python<'py>, measurement: &Measurement) -> PyResult<Bound<'py, PyDict>> {
    let Measurement { time, state, thrust, shaft_speed, wind, foot_wrenches, height } = measurement;
    let out = PyDict::new(py);
    out.set_item("time", *time)?;
    out.set_item("state", state_arrays(py, state)?)?;
    out.set_item("thrust", vector(py, thrust)?)?;
    out.set_item("shaft_speed", vector(py, shaft_speed)?)?;
    out.set_item("wind", vector(py, wind.as_slice())?)?;
    out.set_item("height", *height)?;
    let wrenches = foot_wrenches.as_slice().to_vec();
    out.set_item("foot_wrenches", crate::arrays::array(py, &[wrenches.len() / 6, 6], wrenches)?)?;
    Ok(out)
}

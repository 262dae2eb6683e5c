//! The simulated robot, one tick at a time, for control loops written in Python.

use crate::arrays::{Input, Output, finite_entries, value_error, vector, vectors};
use crate::flight::parse;
use crate::robot::state_arrays;
use flight_io::load_robot;
use flight_sim::Wind;
use nalgebra::Vector3;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The robot, its jets and the wind of a configuration.
#[pyclass(module = "jax_aero._core")]
pub struct Plant {
    current: flight_sim::Plant,
    /// Its initial state.
    start: flight_sim::Plant,
    wind: Wind,
    time_step: f64,
    tick: usize,
}

#[pymethods]
impl Plant {
    #[new]
    fn new(config_json: &str) -> PyResult<Self> {
        let config = parse(config_json)?;
        let robot = load_robot(&config.robot).map_err(value_error)?;
        let start =
            flight_sim::Plant::new(robot, &config.simulator, &config.disturbances).map_err(value_error)?;
        let wind = Wind::new(&config.wind).map_err(value_error)?;
        let time_step = config.simulator.time_step;
        Ok(Self { current: start.clone(), start, wind, time_step, tick: 0 })
    }

    /// Return to the initial state.
    fn reset(&mut self) {
        self.current = self.start.clone();
        self.tick = 0;
    }

    /// Time [s], state, thrusts [N] and wind [m/s] at this tick, by name.
    fn measure<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (state, time) = (self.current.state(), self.time());
        let out = PyDict::new(py);
        out.set_item("time", time)?;
        out.set_item("state", state_arrays(py, state)?)?;
        out.set_item("thrust", vector(py, self.current.jets().thrust_feedback())?)?;
        out.set_item("wind", vector(py, self.wind.velocity(time).as_slice())?)?;
        Ok(out)
    }

    /// Advance by one tick with constant torques (n) [N m] and commanded thrust rates (jets) [N/s];
    /// return the aerodynamic forces (links, 3) [N, inertial axes] at the start of the tick.
    /// `link_forces` replaces these forces.
    fn step<'py>(
        &mut self,
        py: Python<'py>,
        thrust_rate: Input<'py>,
        joint_torque: Input<'py>,
        link_forces: Option<Input<'py>>,
    ) -> PyResult<Output<'py>> {
        let robot = self.current.robot();
        let thrust_rate = finite_entries("thrust_rate", &thrust_rate, &[robot.jets.len()])?;
        let torque = finite_entries("joint_torque", &joint_torque, &[robot.joints.len()])?;
        let links = robot.aero_links.len();
        let forces =
            link_forces.map(|forces| finite_entries("link_forces", &forces, &[links, 3])).transpose()?;
        let forces =
            forces.map(|values| values.chunks_exact(3).map(Vector3::from_column_slice).collect::<Vec<_>>());
        self.current.replace_link_forces(forces).map_err(value_error)?;
        let wind = self.wind.velocity(self.time());
        self.current.observe(&wind);
        let acting = vectors(py, &self.current.link_forces().forces_i)?;
        self.current.advance(&torque, &thrust_rate, &wind, self.time_step);
        self.tick += 1;
        Ok(acting)
    }
}

impl Plant {
    fn time(&self) -> f64 {
        self.tick as f64 * self.time_step
    }
}

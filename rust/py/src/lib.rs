//! Python bindings of the crates, compiled as `jax_aero._core`.
//!
//! Bindings compute nothing: they check and convert arguments, call the crate, and convert results.
//! Files have the names of the crate's. Long calls release the interpreter lock.

// PyO3 passes arguments from Python by value.
#![allow(clippy::needless_pass_by_value)]
// Comments on exported items are docstrings, in which Python names are not links.
#![allow(clippy::doc_markdown)]

mod arrays;
mod batch;
mod cards;
mod control;
mod flight;
mod noise;
mod qp;
mod robot;
mod robot_files;
mod stepwise;
mod tables;

use pyo3::prelude::*;

#[pymodule]
mod _core {
    #[pymodule_export]
    use super::batch::{observe_flights, step_flights};
    #[pymodule_export]
    use super::cards::{read_network, read_policy};
    #[pymodule_export]
    use super::control::{Controller, ControllerState, setpoint_trajectory};
    #[pymodule_export]
    use super::flight::{
        check_config, config_digest, figures, fly, fly_batch, load_config, load_table, path_keys,
        recorded_reference, recorded_wind, replay, resolve_aero, resolve_config, schemas, set_keys, signals,
        summarise, summarised, wind_velocity,
    };
    #[pymodule_export]
    use super::noise::{normals, uniforms};
    #[pymodule_export]
    use super::qp::{BoxQpSolver, kkt_residual};
    #[pymodule_export]
    use super::robot::{Robot, aero_forces, link_forces};
    #[pymodule_export]
    use super::robot_files::read_urdf;
    #[pymodule_export]
    use super::stepwise::Flight;
    #[pymodule_export]
    use super::tables::{check_table, read_csv, read_table, read_toml};
    use flight_core::control::Modes;
    use pyo3::prelude::*;

    use pyo3::exceptions::PyRuntimeError;
    use pyo3::panic::PanicException;
    use pyo3::types::IntoPyDict;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        // A panic is an error of this program, not a request to exit, so `except Exception` must
        // catch it.
        let panic = module.py().get_type::<PanicException>();
        panic.setattr("__bases__", (module.py().get_type::<PyRuntimeError>(),))?;
        module.add("PanicException", panic)?;
        let modes = Modes::NAMES.map(|(mode, name, _)| (name, mode.bits()));
        module.add("MODES", modes.into_py_dict(module.py())?)?;
        module.add("SETTLING_TIME", flight_sim::summary::SETTLING_TIME)?;
        module.add("NUMERICS", flight_sim::NUMERICS)?;
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}

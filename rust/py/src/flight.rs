//! Configurations and whole flights.

use crate::arrays::{Input, Output, array, finite_entries, value_error, vector, vectors};
use flight_io::{AeroConfig, NetworkConfig, RobotFiles, from_json, read_bytes};
use flight_sim::{BatchError, FlightResult, Scenario, ScenarioConfig, Wind, WindConfig, load_scenario};
use pyo3::exceptions::{PyKeyboardInterrupt, PyRuntimeError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sha2::{Digest, Sha256};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Interval of the progress reports to Python, at which it can interrupt.
const REPORT_INTERVAL: Duration = Duration::from_millis(50);

/// Parses a flight configuration from JSON.
pub fn parse(config_json: &str) -> PyResult<ScenarioConfig> {
    from_json(config_json, "configuration").map_err(value_error)
}

fn to_value(config: &ScenarioConfig) -> PyResult<serde_json::Value> {
    serde_json::to_value(config).map_err(|error| PyRuntimeError::new_err(error.to_string()))
}

/// Read a flight configuration with its base files; return JSON that states every default.
#[pyfunction]
pub fn resolve_config(path: PathBuf) -> PyResult<String> {
    let config = load_scenario(&path).map_err(value_error)?;
    Ok(to_value(&config)?.to_string())
}

/// JSON Schemas of all configuration files, as one JSON object by folder of `configs/`.
#[pyfunction]
pub fn schemas() -> String {
    let schemas = flight_sim::schemas();
    let table = schemas.into_iter().map(|(name, schema)| (name.to_owned(), schema.json().clone()));
    serde_json::Value::Object(table.collect()).to_string()
}

/// Declarations of all signals of a log, as a JSON list.
#[pyfunction]
pub fn signals() -> String {
    serde_json::json!(flight_sim::SIGNALS[..]).to_string()
}

/// Declarations of all figures of merit of a flight, as a JSON list.
#[pyfunction]
pub fn figures() -> String {
    serde_json::json!(flight_sim::figures()).to_string()
}

/// Raise ValueError if this configuration cannot be flown.
#[pyfunction]
pub fn check_config(config_json: &str) -> PyResult<()> {
    Scenario::check(&parse(config_json)?).map_err(value_error)
}

/// SHA-256 over the configuration and the files it names; the same on every machine.
#[pyfunction]
pub fn config_digest(config_json: &str) -> PyResult<String> {
    let config = parse(config_json)?;
    let robot = RobotFiles::read(&config.robot).map_err(value_error)?;
    let mut value = to_value(&config)?;
    // The location of the files does not affect the flight, their content does.
    value["robot"] = file_name(&config.robot).into();
    let mut hash = Sha256::new();
    let controller_wind = config.disturbances.controller_wind.as_ref();
    for (pointer, wind) in
        [("/wind/path", Some(&config.wind)), ("/disturbances/controller_wind/path", controller_wind)]
    {
        if let (Some(WindConfig::File { path }), Some(written)) = (wind, value.pointer_mut(pointer)) {
            *written = file_name(path).into();
            hash.update(read_bytes(path).map_err(value_error)?);
        }
    }
    if let Some(path) = &config.mission.file {
        value["mission"]["file"] = file_name(path).into();
        hash.update(read_bytes(path).map_err(value_error)?);
    }
    for (part, aero) in [("simulator", &config.simulator.aero), ("controller", &config.controller.aero)] {
        if let AeroConfig::Network(NetworkConfig { card, .. }) = aero {
            value[part]["aero"]["card"] = file_name(card).into();
            hash.update(read_bytes(card).map_err(value_error)?); // the card contains the hash of the weights
        }
    }
    hash.update(value.to_string());
    hash.update(&robot.toml);
    hash.update(&robot.urdf);
    let digest = hash.finalize();
    Ok(digest.iter().fold(String::new(), |text, byte| text + &format!("{byte:02x}")))
}

/// Velocity (times, 3) [m/s, inertial axes] of the wind of a profile in JSON, at times [s].
#[pyfunction]
pub fn wind_velocity<'py>(py: Python<'py>, wind_json: &str, times: Input<'py>) -> PyResult<Output<'py>> {
    let wind = from_json(wind_json, "wind").and_then(|config| Wind::new(&config)).map_err(value_error)?;
    let times = finite_entries("times", &times, &[times.as_array().len()])?;
    let velocities: Vec<_> = times.iter().map(|time| wind.velocity(*time)).collect();
    vectors(py, &velocities)
}

fn file_name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Fly one configuration until it ends or is lost. `progress(tick, n_ticks)` is called about 20 times a
/// second; an exception in it ends the flight.
#[pyfunction]
#[pyo3(signature = (config_json, progress = None))]
pub fn fly<'py>(
    py: Python<'py>,
    config_json: &str,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let flight = Scenario::new(&parse(config_json)?).map_err(value_error)?;
    let mut reporter = Reporter::new(progress);
    let n_ticks = flight.n_ticks();
    let result = py.detach(|| flight.run(|tick, n_ticks| reporter.report(tick, n_ticks)));
    if let (Ok(_), None) = (&result, &reporter.raised) {
        let _ = reporter.force(n_ticks, n_ticks);
    }
    match (result, reporter.raised) {
        (_, Some(error)) => Err(error),
        (Ok(result), None) => flight_dict(py, result, true),
        (Err(_), None) => Err(PyKeyboardInterrupt::new_err("flight interrupted")),
    }
}

/// Fly many configurations on several threads. Results are in the order of the configurations and do not
/// depend on the number of threads. `progress(done, total)` is called as flights end. Without `full_log` the
/// logs are empty.
#[pyfunction]
#[pyo3(signature = (config_jsons, threads = None, progress = None, full_log = false))]
pub fn fly_batch(
    py: Python<'_>,
    config_jsons: Vec<String>,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
    full_log: bool,
) -> PyResult<Vec<Bound<'_, PyDict>>> {
    let parse_one = |(index, text): (usize, &String)| {
        py.check_signals()?;
        from_json(text, "configuration").map_err(|reason| value_error(BatchError::Refused(index, reason)))
    };
    let configs =
        config_jsons.iter().enumerate().map(parse_one).collect::<PyResult<Vec<ScenarioConfig>>>()?;
    let mut reporter = Reporter::new(progress);
    let (done, stop) = (AtomicUsize::new(0), AtomicBool::new(false));
    let go_on =
        || if stop.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
    let reduce = |mut result: FlightResult| {
        if !full_log {
            result.log.series.clear();
        }
        done.fetch_add(1, Ordering::Relaxed);
        result
    };
    // Python handles signals only in the thread that called this function. This thread therefore waits and
    // checks for them while others fly.
    let results = py
        .detach(|| {
            std::thread::scope(|scope| {
                let batch = scope.spawn(|| flight_sim::fly_batch(&configs, threads, go_on, reduce));
                while !batch.is_finished() {
                    std::thread::sleep(REPORT_INTERVAL / 10);
                    if reporter.report(done.load(Ordering::Relaxed), configs.len()).is_break() {
                        stop.store(true, Ordering::Relaxed);
                        break;
                    }
                }
                batch.join()
            })
        })
        .map_err(|_| PyRuntimeError::new_err("a flight panicked: please report this configuration"))?;
    if reporter.raised.is_none() && results.is_ok() {
        let _ = reporter.force(configs.len(), configs.len());
    }
    if let Some(error) = reporter.raised {
        return Err(error);
    }
    let results = results.map_err(|error| match error {
        BatchError::Refused(..) => value_error(error),
        BatchError::Interrupted => PyKeyboardInterrupt::new_err("batch interrupted"),
        BatchError::NoThreads(_) => PyRuntimeError::new_err(error.to_string()),
    })?;
    results.into_iter().map(|result| flight_dict(py, result, full_log)).collect()
}

/// Calls Python's progress callback at intervals, and stores its exception.
struct Reporter {
    progress: Option<Py<PyAny>>,
    last: Instant,
    raised: Option<PyErr>,
}

impl Reporter {
    fn new(progress: Option<Py<PyAny>>) -> Self {
        Self { progress, last: Instant::now(), raised: None }
    }

    /// Reports if the interval has passed.
    fn report(&mut self, done: usize, total: usize) -> ControlFlow<()> {
        if self.last.elapsed() < REPORT_INTERVAL {
            ControlFlow::Continue(())
        } else {
            self.force(done, total)
        }
    }

    /// Reports immediately.
    fn force(&mut self, done: usize, total: usize) -> ControlFlow<()> {
        self.last = Instant::now();
        let outcome = Python::attach(|py| {
            py.check_signals()?;
            self.progress.as_ref().map_or(Ok(()), |progress| progress.call1(py, (done, total)).map(|_| ()))
        });
        match outcome {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                self.raised = Some(error);
                ControlFlow::Break(())
            }
        }
    }
}

fn flight_dict(py: Python<'_>, result: FlightResult, full_log: bool) -> PyResult<Bound<'_, PyDict>> {
    let FlightResult { outcome, loss, log, summary } = result;
    let out = PyDict::new(py);
    let ticks = log.len();
    let signals = PyDict::new(py);
    if full_log {
        for series in log.series {
            let shape: Vec<usize> = std::iter::once(ticks).chain(series.row_shape.iter().copied()).collect();
            let signal: Output<'_> = array(py, &shape, series.data)?;
            signals.set_item(series.signal.name, signal)?;
        }
    }
    out.set_item("log", signals)?;
    out.set_item("joint_setpoint", vector(py, &log.joint_setpoint)?)?;
    out.set_item("outcome", outcome.name())?;
    out.set_item("lost_time", loss.map(|loss| loss.time))?;
    out.set_item("lost_reason", loss.map(|loss| loss.reason.to_string()))?;

    let figures = PyDict::new(py);
    for (figure, value) in flight_sim::figures().iter().zip(summary.values()) {
        figures.set_item(figure.name, value)?;
    }
    out.set_item("summary", figures)?;
    Ok(out)
}

//! Configurations and whole flights.

use crate::arrays::{
    Input, Output, array, entries, finite_entries, plain_error, value_error, vector, vectors,
};
use flight_core::BuildError;
use flight_io::{
    AeroConfig, ControllerSection, OnboardConfig, RobotFiles, Schema, from_json, load, load_robot,
    read_bytes, read_recording, typed,
};
use flight_sim::log::Series;
use flight_sim::signals::Signal;
use flight_sim::{
    BatchError, FIGURES, FlightLog, FlightResult, NoResult, SIGNALS, Scenario, ScenarioConfig, Summary, Wind,
    load_flyable,
};
use pyo3::exceptions::{PyKeyboardInterrupt, PyRuntimeError, PyUserWarning, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::ffi::CString;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Interval of the progress reports to Python, at which it can interrupt.
const REPORT_INTERVAL: Duration = Duration::from_millis(50);

static SCHEMA: LazyLock<Schema> = LazyLock::new(Schema::of_type::<ScenarioConfig>);

/// The configuration that was handed over last. On its way from a file to a flight the same one is handed over several
/// times, but read and checked once.
static LAST: Mutex<Option<Last>> = Mutex::new(None);

struct Last {
    table: Value,
    config: Arc<ScenarioConfig>,
    is_checked: bool,
}

impl Last {
    /// The configuration in a table, and whether it has been checked, if it is the last one.
    fn of(table: &Value) -> Option<(Arc<ScenarioConfig>, bool)> {
        let last = LAST.lock().unwrap_or_else(PoisonError::into_inner);
        last.as_ref().filter(|last| last.table == *table).map(|last| (last.config.clone(), last.is_checked))
    }

    fn keep(table: Value, config: Arc<ScenarioConfig>, is_checked: bool) {
        *LAST.lock().unwrap_or_else(PoisonError::into_inner) = Some(Self { table, config, is_checked });
    }
}

/// Reads a flight configuration from JSON.
pub fn parse(config_json: &str) -> PyResult<Arc<ScenarioConfig>> {
    read(parse_table(config_json)?)
}

fn read(table: Value) -> PyResult<Arc<ScenarioConfig>> {
    if let Some((config, _)) = Last::of(&table) {
        return Ok(config);
    }
    let config: ScenarioConfig =
        typed(table.clone()).map_err(|error| value_error(error.in_context("configuration")))?;
    let config = Arc::new(config);
    Last::keep(table, config.clone(), false);
    Ok(config)
}

fn to_value(config: &ScenarioConfig) -> PyResult<Value> {
    serde_json::to_value(config).map_err(|error| PyRuntimeError::new_err(error.to_string()))
}

/// Parses changes of a configuration: a JSON list of dotted keys and values.
fn parse_changes(changes_json: &str) -> PyResult<Vec<(String, Value)>> {
    serde_json::from_str(changes_json).map_err(|error| PyValueError::new_err(error.to_string()))
}

/// Read a flight configuration with its base files, also of those that the package ships; set dotted keys (a list of
/// pairs) and check it; return JSON that states every default. Warns of what can be flown but is probably not meant.
#[pyfunction]
pub fn load_config(py: Python<'_>, path: PathBuf, changes_json: &str) -> PyResult<String> {
    let configs: PathBuf = py.import("jax_aero.base.places")?.getattr("CONFIGS")?.extract()?;
    let (shipped, changes) = (configs.join("experiments"), parse_changes(changes_json)?);
    let (config, warnings) = load_flyable(&path, Some(shipped.as_path()), &changes).map_err(value_error)?;
    warn(py, warnings)?;
    let table = to_value(&config)?;
    let text = table.to_string();
    Last::keep(table, Arc::new(config), true);
    Ok(text)
}

/// Raises warnings of the user's files.
pub fn warn(py: Python<'_>, warnings: Vec<String>) -> PyResult<()> {
    for warning in warnings {
        PyErr::warn(py, &py.get_type::<PyUserWarning>(), &CString::new(warning)?, 1)?;
    }
    Ok(())
}

/// Read a file of `configs/KIND/` with its base files; return JSON that states every default.
#[pyfunction]
pub fn load_table(kind: &str, path: PathBuf) -> PyResult<String> {
    let table = match kind {
        "aero" => load::<AeroConfig>(&path).map(|config| json!(config)),
        "control" => load::<ControllerSection>(&path).map(|config| json!(config)),
        "onboard" => load::<OnboardConfig>(&path).map(|config| json!(config)),
        _ => Err(BuildError::unknown_name("kind", kind, ["aero", "control", "onboard"])),
    };
    Ok(table.map_err(value_error)?.to_string())
}

/// Return a flight configuration in JSON with every default.
#[pyfunction]
pub fn resolve_config(config_json: &str) -> PyResult<String> {
    Ok(to_value(&*parse(config_json)?)?.to_string())
}

/// Return an aerodynamic model's configuration in JSON with every default.
#[pyfunction]
pub fn resolve_aero(aero_json: &str) -> PyResult<String> {
    let config: AeroConfig = from_json(aero_json, "aerodynamic model").map_err(value_error)?;
    Ok(json!(config).to_string())
}

/// Set dotted keys (a list of pairs) of a flight configuration in JSON, without checking it.
#[pyfunction]
pub fn set_keys(config_json: &str, changes_json: &str) -> PyResult<String> {
    let (table, changes) = (parse_table(config_json)?, parse_changes(changes_json)?);
    let changed = flight_io::set_keys(table, changes, Path::new(""), &SCHEMA).map_err(value_error)?;
    Ok(changed.to_string())
}

/// Dotted keys of the paths in a flight configuration in JSON, which need not be valid.
#[pyfunction]
pub fn path_keys(config_json: &str) -> PyResult<Vec<String>> {
    Ok(flight_io::path_keys(&parse_table(config_json)?, &SCHEMA))
}

/// A table in JSON, unchecked.
pub fn parse_table(config_json: &str) -> PyResult<Value> {
    serde_json::from_str(config_json)
        .map_err(|error| value_error(BuildError::malformed("configuration", error)))
}

/// JSON Schemas of all configuration files, as one JSON object by folder of `configs/`.
#[pyfunction]
pub fn schemas() -> String {
    let schemas = flight_sim::schemas();
    let table = schemas.into_iter().map(|(name, schema)| (name.to_owned(), schema.json().clone()));
    Value::Object(table.collect()).to_string()
}

/// Declarations of all signals of a log, as a JSON list.
#[pyfunction]
pub fn signals() -> String {
    serde_json::json!(SIGNALS).to_string()
}

/// Declarations of all figures of merit of a flight, as a JSON list.
#[pyfunction]
pub fn figures() -> String {
    serde_json::json!(FIGURES).to_string()
}

/// Raise ValueError if this configuration cannot be flown.
#[pyfunction]
pub fn check_config(config_json: &str) -> PyResult<()> {
    let table = parse_table(config_json)?;
    if !Last::of(&table).is_some_and(|(_, is_checked)| is_checked) {
        let config = read(table.clone())?;
        Scenario::check(&config).map_err(value_error)?;
        Last::keep(table, config, true);
    }
    Ok(())
}

/// SHA-256 over the configuration and the files it names, without comments and layout of TOML and JSON; the same on every
/// machine.
#[pyfunction]
pub fn config_digest(config_json: &str) -> PyResult<String> {
    let config = parse(config_json)?;
    let robot = RobotFiles::read(&config.robot).map_err(value_error)?;
    let mut value = to_value(&config)?;
    // The location of the files does not affect the flight, their content does.
    value["robot"] = file_name(&config.robot).into();
    let mut hash = Sha256::new();
    for key in flight_io::path_keys(&value, &SCHEMA) {
        // The card of a network contains the hash of its weights.
        if let Some(written) = value.pointer_mut(&format!("/{}", key.replace('.', "/")))
            && let Some(path) = written.as_str().map(PathBuf::from)
            && key != "robot"
        {
            *written = file_name(&path).into();
            hash.update(content(&path, read_bytes(&path).map_err(value_error)?.to_vec()));
        }
    }
    hash.update(value.to_string());
    hash.update(content(&config.robot, robot.toml.into_bytes()));
    hash.update(&robot.urdf);
    let digest = hash.finalize();
    Ok(digest.iter().fold(String::new(), |text, byte| text + &format!("{byte:02x}")))
}

/// What a TOML or JSON file says, as JSON; the bytes of any other file.
fn content(path: &Path, bytes: Vec<u8>) -> Vec<u8> {
    let text = std::str::from_utf8(&bytes).unwrap_or_default();
    let extension = path.extension().and_then(|extension| extension.to_str()).map(str::to_ascii_lowercase);
    let said = match extension.as_deref() {
        Some("toml") => flight_io::toml::to_json(text, "").ok(),
        Some("json") => serde_json::from_str::<Value>(text).ok().map(|value| value.to_string()),
        _ => None,
    };
    said.map_or(bytes, String::into_bytes)
}

/// Velocity (times, 3) [m/s, inertial axes] of the wind of a profile in JSON, at times [s].
#[pyfunction]
pub fn wind_velocity<'py>(py: Python<'py>, wind_json: &str, times: Input<'py>) -> PyResult<Output<'py>> {
    let wind = from_json(wind_json, "wind").and_then(|config| Wind::new(&config)).map_err(value_error)?;
    let times = finite_entries("times", &times, &[times.as_array().len()])?;
    let velocities: Vec<_> = times.iter().map(|time| wind.velocity(*time)).collect();
    vectors(py, &velocities)
}

/// Samples (k, 4) of a recorded wind in JSON: times [s] and velocities [m/s, inertial axes].
#[pyfunction]
pub fn recorded_wind<'py>(py: Python<'py>, wind_json: &str) -> PyResult<Output<'py>> {
    let wind = from_json(wind_json, "wind").and_then(|config| Wind::new(&config)).map_err(value_error)?;
    let samples = wind.samples();
    if samples.is_empty() {
        return Err(PyValueError::new_err("the wind is a function; expected a recorded one"));
    }
    let numbers = samples.iter().flat_map(|(time, velocity)| [*time, velocity.x, velocity.y, velocity.z]);
    array(py, &[samples.len(), 4], numbers.collect())
}

/// Rows (k, 7, 10, 13 or 16) of the file of a recorded reference, in the order of its columns.
#[pyfunction]
pub fn recorded_reference(py: Python<'_>, path: PathBuf) -> PyResult<Output<'_>> {
    let (rows, _) = read_recording(&path).map_err(value_error)?;
    array(py, &[rows.len(), rows[0].len()], rows.concat())
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
    let flight = Scenario::new(&*parse(config_json)?).map_err(value_error)?;
    let mut reporter = Reporter::new(progress);
    let n_ticks = flight.n_ticks();
    let result = py.detach(|| flight.run(|tick, n_ticks| reporter.report(tick, n_ticks)));
    if let (Ok(_), None) = (&result, &reporter.raised) {
        let _ = reporter.force(n_ticks, n_ticks);
    }
    match (result, reporter.raised) {
        (_, Some(error)) => Err(error),
        (Ok(result), None) => flight_dict(py, result, true),
        (Err(NoResult::Refused(why)), None) => Err(plain_error(why)),
        (Err(NoResult::Interrupted), None) => Err(PyKeyboardInterrupt::new_err("flight interrupted")),
    }
}

/// Replay the measurements of a log (arrays by signal, the first axis is time) through the controller of a configuration;
/// returns the controller's signals.
#[pyfunction]
pub fn replay<'py>(
    py: Python<'py>,
    config_json: &str,
    log: BTreeMap<String, Input<'py>>,
) -> PyResult<Bound<'py, PyDict>> {
    let config = parse(config_json)?;
    let robot = load_robot(&config.robot).map_err(value_error)?;
    let log = read_log(&log, Vec::new(), |signal, _| signal.row_shape(&robot).collect())?;
    let replayed = py.detach(|| flight_sim::replay(&config, &log)).map_err(value_error)?;
    signals_dict(py, replayed)
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
        from_json(text, "configuration").map_err(|reason| refused(index, reason))
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
        BatchError::Refused(index, reason) => refused(index, reason),
        BatchError::Interrupted => PyKeyboardInterrupt::new_err("batch interrupted"),
        BatchError::NoThreads(_) => PyRuntimeError::new_err(error.to_string()),
    })?;
    results.into_iter().map(|result| flight_dict(py, result, full_log)).collect()
}

/// The error of a flight of a batch.
fn refused(index: usize, reason: BuildError) -> PyErr {
    value_error(reason.in_context(format!("flight {index} of the batch")))
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

/// Result of a flight, by Python's names; without `full_log` its log is empty.
pub fn flight_dict(py: Python<'_>, result: FlightResult, full_log: bool) -> PyResult<Bound<'_, PyDict>> {
    let FlightResult { outcome, loss, log, summary } = result;
    let out = PyDict::new(py);
    out.set_item("summary", figures_dict(py, &summary, log.has_ground())?)?;
    out.set_item("joint_setpoint", vector(py, &log.joint_setpoint)?)?;
    out.set_item("log", if full_log { signals_dict(py, log)? } else { PyDict::new(py) })?;
    out.set_item("outcome", outcome.name())?;
    out.set_item("lost_time", loss.map(|loss| loss.time))?;
    out.set_item("lost_reason", loss.map(|loss| loss.reason.to_string()))?;
    Ok(out)
}

fn figures_dict<'py>(py: Python<'py>, summary: &Summary, has_ground: bool) -> PyResult<Bound<'py, PyDict>> {
    let figures = PyDict::new(py);
    for (figure, value) in summary.figures(has_ground) {
        figures.set_item(figure.name, value)?;
    }
    Ok(figures)
}

/// Names of the signals that figures of merit are computed from.
#[pyfunction]
pub fn summarised() -> Vec<&'static str> {
    Summary::signals().into_iter().collect()
}

/// Figures of merit of a log (arrays by signal, the first axis is time), whose rows may have fewer numbers with the same
/// figures; `joint_setpoint` has the joints of its rows.
#[pyfunction]
pub fn summarise<'py>(
    py: Python<'py>,
    log: BTreeMap<String, Input<'py>>,
    joint_setpoint: Input<'py>,
) -> PyResult<Bound<'py, PyDict>> {
    let joints = joint_setpoint.as_array().len();
    let joint_setpoint = entries("joint_setpoint", &joint_setpoint, &[joints])?;
    let of_array =
        |_: &Signal, values: &Input<'py>| values.as_array().shape().iter().skip(1).copied().collect();
    let log = read_log(&log, joint_setpoint, of_array)?;
    figures_dict(py, &Summary::new(&log, log.len()), log.has_ground())
}

/// A log from arrays by signal, each with as many rows as there are times.
fn read_log<'py>(
    log: &BTreeMap<String, Input<'py>>,
    joint_setpoint: Vec<f64>,
    row_shape: impl Fn(&Signal, &Input<'py>) -> Vec<usize>,
) -> PyResult<FlightLog> {
    let rows = log.get("time").and_then(|time| time.as_array().shape().first().copied()).unwrap_or_default();
    let read = |(name, values): (&String, &Input<'py>)| {
        let Some(signal) = SIGNALS.iter().find(|signal| signal.name == name) else {
            let known = SIGNALS.iter().map(|signal| signal.name);
            return Err(value_error(BuildError::unknown_name("the log", name, known)));
        };
        let row_shape = row_shape(signal, values);
        let shape: Vec<usize> = std::iter::once(rows).chain(row_shape.iter().copied()).collect();
        Ok(Series { signal, row_shape, data: entries(name, values, &shape)? })
    };
    Ok(FlightLog { series: log.iter().map(read).collect::<PyResult<_>>()?, joint_setpoint })
}

/// The signals of a log as arrays by name.
fn signals_dict(py: Python<'_>, log: FlightLog) -> PyResult<Bound<'_, PyDict>> {
    let signals = PyDict::new(py);
    let ticks = log.len();
    for series in log.series {
        let shape: Vec<usize> = std::iter::once(ticks).chain(series.row_shape.iter().copied()).collect();
        let signal: Output<'_> = array(py, &shape, series.data)?;
        signals.set_item(series.signal.name, signal)?;
    }
    Ok(signals)
}

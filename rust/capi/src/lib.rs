//! The controller for C and C++: create it from the simulated configuration, start it, tick it; and the simulated robot,
//! for a loop that has no other yet.
//!
//! `include/flight.h` is generated from this file by cbindgen. Of the controller `flight_controller_create`,
//! `flight_controller_free` and `flight_start` allocate, and, where `controller.qp` selects Clarabel, its ticks. A panic does not leave the library: the call returns
//! `FLIGHT_PANICKED`, and so does every later call for that controller or robot.

// Exporting symbols and using C pointers is unsafe; each block states its assumptions.
#![allow(unsafe_code, reason = "C has pointers")]

use flight_core::control::estimate::joint_tracker::JointMeasurement;
use flight_core::control::law::setpoint::Setpoint;
use flight_core::control::modes::Modes;
use flight_core::control::{BadCommand, ControllerState, Given, Preview};
use flight_core::spatial::Pose;
use flight_core::{BuildError, Controller, Measurement};
use flight_io::{Schema, load_robot};
use flight_sim::{Plant, ScenarioConfig, Wind, load_scenario, onboard};
use nalgebra::{Matrix3, Vector3};
use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::ptr::{null, null_mut};
use std::slice;
use std::sync::LazyLock;

/// Version of the library to which this header belongs: 10000 major + 100 minor + patch.
pub const FLIGHT_VERSION: u32 = 200;

/// Greatest thrust rate and torque that a simulated robot accepts \[N/s, N m\].
pub const FLIGHT_COMMAND_MAX: f64 = 1e6;

/// Of the set-points and of the winds of a `FlightPreview` so many are read, the first ones.
pub const FLIGHT_PREVIEW_MAX: usize = 128;

/// Version and sizes with which a program was compiled, from `flight_header`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FlightHeader {
    /// `FLIGHT_VERSION`
    pub version: u32,
    /// `sizeof(FlightMeasurement)`
    pub measurement_size: usize,
    /// `sizeof(FlightSetpoint)`
    pub setpoint_size: usize,
    /// `sizeof(FlightPreview)`
    pub preview_size: usize,
    /// `sizeof(FlightCommand)`
    pub command_size: usize,
}

impl FlightHeader {
    /// Those of this library.
    #[must_use]
    pub fn of_library() -> Self {
        Self {
            version: FLIGHT_VERSION,
            measurement_size: size_of::<FlightMeasurement>(),
            setpoint_size: size_of::<FlightSetpoint>(),
            preview_size: size_of::<FlightPreview>(),
            command_size: size_of::<FlightCommand>(),
        }
    }

    /// Refuses a program that was compiled with the header of another library. Patches do not change the interface.
    fn check(self) -> Result<(), String> {
        let ours = Self { version: self.version, ..Self::of_library() };
        if self == ours && self.version / 100 == FLIGHT_VERSION / 100 {
            return Ok(());
        }
        let text = |header: Self| {
            let Self { version, measurement_size, setpoint_size, preview_size, command_size } = header;
            let (major, minor, patch) = (version / 10_000, version / 100 % 100, version % 100);
            format!(
                "{major}.{minor}.{patch} with structures of {measurement_size}, {setpoint_size}, \
                 {preview_size} and {command_size} bytes"
            )
        };
        let (theirs, ours) = (text(self), text(Self::of_library()));
        Err(format!("the program was compiled with flight.h {theirs}; expected that of the library, {ours}"))
    }
}

/// Outcome of a call; below zero an error.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FlightStatus {
    /// Done; of a tick `flight_modes` says what is not as usual.
    FlightOk = 0,
    /// No flight has been started, or none can start with this measurement. No command is written.
    FlightNotStarted = -1,
    /// A required pointer is null. Nothing is written.
    FlightNullPointer = -2,
    /// Internal error of the library. Thrust rates and joint velocities are zero; the torques in the command are
    /// unchanged.
    FlightPanicked = -3,
    /// A replaced command has a number beyond what drives and engines can follow, or one for a simulated robot a number
    /// that is not finite or exceeds `FLIGHT_COMMAND_MAX`. Nothing changes.
    FlightBadCommand = -4,
    /// The motion of the simulated robot has no meaning any more: its numbers are not finite, or beyond any robot's.
    FlightDiverged = -5,
}

/// Names of the modes, by bit.
static MODE_NAMES: LazyLock<Vec<CString>> =
    LazyLock::new(|| Modes::NAMES.iter().filter_map(|(_, name, _)| CString::new(*name).ok()).collect());

/// Measurement of a tick.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct FlightMeasurement {
    /// Time since the start of the flight [s].
    pub time: f64,
    /// Position of the base origin [m, inertial axes].
    pub base_position: [f64; 3],
    /// Rotation from base to inertial axes, by rows.
    pub base_rotation: [f64; 9],
    /// Velocity of the base origin [m/s, inertial axes].
    pub base_linear_velocity: [f64; 3],
    /// Angular velocity of the base [rad/s, inertial axes].
    pub base_angular_velocity: [f64; 3],
    /// Joint positions [rad], one per joint.
    pub joint_position: *const f64,
    /// Joint velocities [rad/s], one per joint; NaN where they are not measured, which requires
    /// `controller.estimator.joint_observer`.
    pub joint_velocity: *const f64,
    /// Thrusts [N], one per jet.
    pub thrust: *const f64,
    /// Velocity of the air [m/s, inertial axes]; NaN if it is not measured. Zero means measured still air: without a
    /// wind sensor use `controller.wind_observer`, or a controller without aerodynamic model.
    pub wind: [f64; 3],
    /// Wrench on each foot about the origin of its sole, force first [N, N m, inertial axes], six per foot, in the
    /// order of `controller.contact.feet`. NaN where it is not measured; null means that no load is measured on any
    /// foot.
    pub foot_wrenches: *const f64,
    /// Speeds of the shafts, shares of the full speed, one per jet; NaN where they are not measured, null for none. Only a
    /// controller with `controller.shaft` reads them: the thrust follows from the speed.
    pub shaft_speed: *const f64,
    /// Height of the base origin above that on the ground on which the robot is to land, in the posture in which the flight
    /// begins [m]; NaN where it is not measured.
    pub height: f64,
}

/// Set-point of a tick, for programs with their own planner.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct FlightSetpoint {
    /// Centre of mass [m].
    pub com_position: [f64; 3],
    /// Its velocity [m/s].
    pub com_velocity: [f64; 3],
    /// Its acceleration [m/s²].
    pub com_acceleration: [f64; 3],
    /// Its jerk [m/s³].
    pub com_jerk: [f64; 3],
    /// Rotation from base to inertial axes, by rows.
    pub rotation: [f64; 9],
    /// Angular velocity of the base [rad/s, body axes].
    pub angular_velocity: [f64; 3],
    /// Angular acceleration of the base [rad/s², body axes].
    pub angular_acceleration: [f64; 3],
    /// Angular jerk of the base [rad/s³, body axes].
    pub angular_jerk: [f64; 3],
}

/// What is known of the future at a tick, for `flight_tick_ahead`; only the predictive law (`controller.mpc`) reads it.
/// Times are those after the tick [s], increasing.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct FlightPreview {
    /// Number of set-points that follow the given one; zero for none.
    pub setpoint_count: usize,
    /// Their times, above zero.
    pub setpoint_time: *const f64,
    /// The set-points: interpolated between, extrapolated after the last one.
    pub setpoint: *const FlightSetpoint,
    /// Number of winds; zero for none.
    pub wind_count: usize,
    /// Their times, from zero on.
    pub wind_time: *const f64,
    /// Velocities of the air [m/s, inertial axes], three per time: linear between, constant outside. The prediction has
    /// their change from time zero.
    pub wind: *const f64,
}

/// Arrays of the caller to which a tick writes its command, which is valid until the next tick.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct FlightCommand {
    /// Thrust rates [N/s], one per jet.
    pub thrust_rate: *mut f64,
    /// Joint velocities [rad/s], one per joint.
    pub joint_velocity: *mut f64,
    /// Joint torques [N m], one per joint.
    pub joint_torque: *mut f64,
}

/// A controller with its flight, for one thread at a time; several threads may read it (functions that take a pointer
/// to const) while none changes it.
#[derive(Debug)]
pub struct FlightController {
    controller: Controller,
    flight: Option<ControllerState>,
    time_step: f64,
    torque_steps: u32,
    joint_names: Vec<CString>,
    jet_names: Vec<CString>,
    /// The measurement in the types of the crate.
    measured: Measurement,
    /// The preview in the types of the crate.
    setpoints: Vec<(f64, Setpoint)>,
    winds: Vec<(f64, Vector3<f64>)>,
    has_panicked: bool,
}

impl FlightController {
    fn load(path: &Path) -> Result<Self, BuildError> {
        let table = flight_io::resolve(path, &Schema::of_type::<ScenarioConfig>())?;
        let (robot, law, controller) = onboard(table, &path.display().to_string())?;
        let c_name = |name: &String| {
            CString::new(name.as_str()).map_err(|_| {
                BuildError::bad_value("name of a joint or jet", format!("{name:?}"), "no zero byte")
            })
        };
        let joint_names = robot.joints.iter().map(|joint| c_name(&joint.name)).collect::<Result<_, _>>()?;
        let jet_names = robot.jets.iter().map(|jet| c_name(&jet.name)).collect::<Result<_, _>>()?;
        let (joints, feet) = (controller.model().joints.len(), controller.model().feet.len());
        Ok(Self {
            flight: None,
            time_step: law.time_step,
            torque_steps: law.torque.steps,
            joint_names,
            jet_names,
            measured: Measurement::zero(joints, controller.n_jets(), feet),
            setpoints: Vec::with_capacity(FLIGHT_PREVIEW_MAX),
            winds: Vec::with_capacity(FLIGHT_PREVIEW_MAX),
            has_panicked: false,
            controller,
        })
    }

    /// Converts a measurement to the types of the crate; fails with the name of an array that is null.
    ///
    /// # Safety
    /// The arrays of `given` have the documented lengths.
    unsafe fn read(&mut self, given: &FlightMeasurement) -> Result<(), &'static str> {
        let Measurement { time, state, thrust, shaft_speed, wind, foot_wrenches, height } =
            &mut self.measured;
        let joints = state.n_joints();
        let arrays = [
            ("joint_position", given.joint_position, joints),
            ("joint_velocity", given.joint_velocity, joints),
            ("thrust", given.thrust, thrust.len()),
        ];
        let missing = arrays.into_iter().find(|(_, pointer, length)| pointer.is_null() && *length > 0);
        if let Some((name, ..)) = missing {
            return Err(name);
        }
        state.base = Pose {
            rotation: Matrix3::from_row_slice(&given.base_rotation),
            position: Vector3::from(given.base_position),
        };
        let velocity = state.velocity.as_mut_slice();
        velocity[..3].copy_from_slice(&given.base_linear_velocity);
        velocity[3..6].copy_from_slice(&given.base_angular_velocity);
        // SAFETY: not null unless empty, and of these lengths by this function's contract.
        unsafe {
            copy_in(given.joint_position, state.joint_position.as_mut_slice());
            copy_in(given.joint_velocity, &mut velocity[6..]);
            copy_in(given.thrust, thrust);
        }
        (*time, *wind, *height) = (given.time, Vector3::from(given.wind), given.height);
        if given.shaft_speed.is_null() {
            shaft_speed.fill(f64::NAN);
        } else {
            // SAFETY: one per jet by this function's contract.
            unsafe { copy_in(given.shaft_speed, shaft_speed) };
        }
        if given.foot_wrenches.is_null() {
            foot_wrenches.fill(0.0);
        } else {
            // SAFETY: six numbers per foot by this function's contract.
            unsafe { copy_in(given.foot_wrenches, foot_wrenches.as_mut_slice()) };
        }
        Ok(())
    }

    /// Converts a preview to the types of the crate, by default an empty one; `false` if an array is null.
    ///
    /// # Safety
    /// The arrays of `given` have the documented lengths.
    unsafe fn read_preview(&mut self, given: Option<&FlightPreview>) -> bool {
        self.setpoints.clear();
        self.winds.clear();
        let Some(given) = given else { return true };
        let FlightPreview { setpoint_count, setpoint_time, setpoint, wind_count, wind_time, wind } = *given;
        let lacks_setpoints = setpoint_count > 0 && (setpoint_time.is_null() || setpoint.is_null());
        if lacks_setpoints || (wind_count > 0 && (wind_time.is_null() || wind.is_null())) {
            return false;
        }
        for index in 0..setpoint_count.min(FLIGHT_PREVIEW_MAX) {
            // SAFETY: not null, and of this length by this function's contract.
            let (time, setpoint) = unsafe { (*setpoint_time.add(index), &*setpoint.add(index)) };
            self.setpoints.push((time, setpoint_of(setpoint)));
        }
        for index in 0..wind_count.min(FLIGHT_PREVIEW_MAX) {
            let mut velocity = Vector3::zeros();
            // SAFETY: not null, and of this length by this function's contract.
            let time = unsafe {
                copy_in(wind.add(3 * index), velocity.as_mut_slice());
                *wind_time.add(index)
            };
            self.winds.push((time, velocity));
        }
        true
    }

    /// The controller, its flight, and the last measurement.
    fn parts(&mut self) -> (&mut Controller, &mut Option<ControllerState>, &Measurement, Preview<'_>) {
        let preview = Preview { setpoints: &self.setpoints, wind: &self.winds };
        (&mut self.controller, &mut self.flight, &self.measured, preview)
    }
}

/// A controller or a robot, which is not used any more after a panic.
trait Guarded {
    fn has_panicked(&mut self) -> &mut bool;

    /// Runs `work`, unless it panics or an earlier call has panicked.
    fn guard(&mut self, work: impl FnOnce(&mut Self) -> FlightStatus) -> FlightStatus {
        if !*self.has_panicked() {
            if let Ok(status) = catch_unwind(AssertUnwindSafe(|| work(self))) {
                return status;
            }
            *self.has_panicked() = true;
        }
        FlightStatus::FlightPanicked
    }
}

impl Guarded for FlightController {
    fn has_panicked(&mut self) -> &mut bool {
        &mut self.has_panicked
    }
}

/// Torques of a part of a tick, for `flight_robot_advance_in_steps`: receives the number of the part, from one, positions
/// and velocities of the joints then [rad, m; rad/s, m/s], and what was given with the function; writes the torques
/// [N m, N], which are those of the part before.
pub type FlightTorques = Option<
    unsafe extern "C" fn(
        part: u32,
        joint_position: *const f64,
        joint_velocity: *const f64,
        joint_torque: *mut f64,
        context: *mut c_void,
    ),
>;

/// A simulated robot in the wind of its configuration, for one thread at a time. Its measurements are exact: neither
/// `simulator.sensors` nor errors and outages of `disturbances` apply. Commands are delayed by `simulator.actuation`.
#[derive(Debug)]
pub struct FlightRobot {
    plant: Plant,
    wind: Wind,
    time_step: f64,
    ticks: u64,
    has_panicked: bool,
}

impl FlightRobot {
    fn load(path: &Path) -> Result<Self, BuildError> {
        let scenario = load_scenario(path)?;
        let robot = load_robot(&scenario.robot)?;
        let (simulator, disturbances) = (&scenario.simulator, &scenario.disturbances);
        Ok(Self {
            plant: Plant::new(robot, simulator, disturbances, &scenario.controller.law)?,
            wind: Wind::new(&scenario.wind)?,
            time_step: scenario.controller.law.time_step,
            ticks: 0,
            has_panicked: false,
        })
    }

    fn time(&self) -> f64 {
        self.ticks as f64 * self.time_step
    }
}

/// Velocity beyond which the motion of a simulated robot has no meaning \[m/s, rad/s\].
const GREATEST_VELOCITY: f64 = 1e6;

impl Guarded for FlightRobot {
    fn has_panicked(&mut self) -> &mut bool {
        &mut self.has_panicked
    }
}

/// View of a C array.
///
/// # Safety
/// `source` holds `length` numbers for as long as the slice is used, or is null and `length` is zero.
unsafe fn view<'a>(source: *const f64, length: usize) -> &'a [f64] {
    // SAFETY: by this function's contract.
    if length > 0 { unsafe { slice::from_raw_parts(source, length) } } else { &[] }
}

/// Fills `values` from a C array.
///
/// # Safety
/// `source` holds as many numbers as `values`, or is null and `values` is empty.
unsafe fn copy_in(source: *const f64, values: &mut [f64]) {
    // SAFETY: by this function's contract.
    values.copy_from_slice(unsafe { view(source, values.len()) });
}

/// Writes `values` to a C array.
///
/// # Safety
/// `target` has space for as many numbers as `values`, or is null and `values` is empty.
unsafe fn copy_out(values: &[f64], target: *mut f64) {
    if !values.is_empty() {
        // SAFETY: by this function's contract.
        unsafe { slice::from_raw_parts_mut(target, values.len()) }.copy_from_slice(values);
    }
}

/// Message of a panic.
const INTERNAL_ERROR: &str = "internal error of the library";

/// Writes the reason of a failure to the caller's buffer, as much of it as fits.
///
/// # Safety
/// `message` is null or has space for `size` bytes.
unsafe fn report(reason: &str, message: *mut c_char, size: usize) {
    if !message.is_null() && size > 0 {
        let mut length = reason.len().min(size - 1);
        while !reason.is_char_boundary(length) {
            length -= 1;
        }
        // SAFETY: `length + 1 <= size` bytes, by this function's contract.
        unsafe {
            message.copy_from_nonoverlapping(reason.as_ptr().cast(), length);
            *message.add(length) = 0;
        }
    }
}

/// Loads what a configuration describes; null and a message if that fails.
///
/// # Safety
/// As for `flight_controller_create`.
unsafe fn create<T>(
    header: FlightHeader,
    path: *const c_char,
    message: *mut c_char,
    message_size: usize,
    load: fn(&Path) -> Result<T, BuildError>,
) -> *mut T {
    let made = catch_unwind(|| {
        header.check()?;
        if path.is_null() {
            return Err("the path is null; expected that of a TOML file".to_owned());
        }
        // SAFETY: not null, and zero-terminated by this function's contract.
        let path = unsafe { CStr::from_ptr(path) };
        let path = path.to_str().map_err(|_| "the path is not UTF-8".to_owned())?;
        load(Path::new(path)).map_err(|reason| reason.to_string())
    });
    let reason = match made {
        Ok(Ok(made)) => return Box::into_raw(Box::new(made)),
        Ok(Err(reason)) => reason,
        Err(_) => INTERNAL_ERROR.to_owned(),
    };
    // SAFETY: by this function's contract.
    unsafe { report(&reason, message, message_size) };
    null_mut()
}

/// Version of this library, as `FLIGHT_VERSION`.
#[unsafe(no_mangle)]
pub extern "C" fn flight_version() -> u32 {
    FLIGHT_VERSION
}

/// Name of a `FlightStatus`, such as `null_pointer`; null for other numbers.
#[unsafe(no_mangle)]
pub extern "C" fn flight_status_name(status: c_int) -> *const c_char {
    let name = match status {
        0 => c"ok",
        -1 => c"not_started",
        -2 => c"null_pointer",
        -3 => c"panicked",
        -4 => c"bad_command",
        -5 => c"diverged",
        _ => return null(),
    };
    name.as_ptr()
}

/// Name of a `FlightMode`, such as `wind_held`; null for other numbers.
#[unsafe(no_mangle)]
pub extern "C" fn flight_mode_name(mode: u32) -> *const c_char {
    let index = Modes::NAMES.iter().position(|(named, ..)| named.bits() == mode);
    index.and_then(|index| MODE_NAMES.get(index)).map_or(null(), |name| name.as_ptr())
}

/// Creates the controller of a file as in `configs/onboard/`, which names no simulator, or as in `configs/experiments/`, with
/// the errors that its `disturbances` give the controller's models. Allocates.
///
/// `header` is `flight_header()`. Returns null on failure, also if the program was compiled with the header of another
/// library; `message`, unless null, then contains the reason in at most `message_size` bytes, the last of which is zero.
///
/// # Safety
/// `path` is a zero-terminated string, or null; `message` is null or has space for `message_size` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_controller_create(
    header: FlightHeader,
    path: *const c_char,
    message: *mut c_char,
    message_size: usize,
) -> *mut FlightController {
    LazyLock::force(&MODE_NAMES); // so that a name does not allocate later
    // SAFETY: by this function's contract.
    unsafe { create(header, path, message, message_size, FlightController::load) }
}

/// Frees a controller; null is allowed. No thread may use it then or later, nor free it again: it is not guarded against.
///
/// # Safety
/// `controller` comes from `flight_controller_create` and is not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_controller_free(controller: *mut FlightController) {
    if !controller.is_null() {
        // SAFETY: by this function's contract.
        drop(unsafe { Box::from_raw(controller) });
    }
}

/// Number of joints; zero for null.
///
/// # Safety
/// `controller` comes from `flight_controller_create`, or is null. The same holds for every function below.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_joint_count(controller: *const FlightController) -> usize {
    // SAFETY: by this function's contract.
    unsafe { controller.as_ref() }.map_or(0, |controller| controller.joint_names.len())
}

/// Number of jets; zero for null.
///
/// # Safety
/// As for `flight_joint_count`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_jet_count(controller: *const FlightController) -> usize {
    // SAFETY: by this function's contract.
    unsafe { controller.as_ref() }.map_or(0, |controller| controller.jet_names.len())
}

/// Number of feet on which the controller stands, `controller.contact.feet`; zero for null.
///
/// # Safety
/// As for `flight_joint_count`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_foot_count(controller: *const FlightController) -> usize {
    // SAFETY: by this function's contract.
    unsafe { controller.as_ref() }.map_or(0, |controller| controller.measured.foot_wrenches.len() / 6)
}

/// Name of a joint, valid as long as the controller exists; null beyond the last joint.
///
/// # Safety
/// As for `flight_joint_count`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_joint_name(
    controller: *const FlightController,
    index: usize,
) -> *const c_char {
    // SAFETY: by this function's contract.
    let controller = unsafe { controller.as_ref() };
    controller.and_then(|controller| controller.joint_names.get(index)).map_or(null(), |name| name.as_ptr())
}

/// Name of a jet, valid as long as the controller exists; null beyond the last jet.
///
/// # Safety
/// As for `flight_joint_count`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_jet_name(controller: *const FlightController, index: usize) -> *const c_char {
    // SAFETY: by this function's contract.
    let controller = unsafe { controller.as_ref() };
    controller.and_then(|controller| controller.jet_names.get(index)).map_or(null(), |name| name.as_ptr())
}

/// Time between two ticks [s]; zero for null.
///
/// # Safety
/// As for `flight_joint_count`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_time_step(controller: *const FlightController) -> f64 {
    // SAFETY: by this function's contract.
    unsafe { controller.as_ref() }.map_or(0.0, |controller| controller.time_step)
}

/// Times that torques are computed in a tick, `controller.torque.steps`; zero for null.
///
/// # Safety
/// As for `flight_joint_count`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_torque_steps(controller: *const FlightController) -> u32 {
    // SAFETY: by this function's contract.
    unsafe { controller.as_ref() }.map_or(0, |controller| controller.torque_steps)
}

/// What in the last tick was not as usual, a sum of `FlightMode`; zero for null.
///
/// # Safety
/// As for `flight_joint_count`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_modes(controller: *const FlightController) -> u32 {
    // SAFETY: by this function's contract.
    unsafe { controller.as_ref() }.map_or(0, |controller| controller.controller.command().modes.bits())
}

/// Whether thrust rates, torques or both of the last tick are not those of the control law; true for null.
///
/// # Safety
/// As for `flight_joint_count`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_is_held(controller: *const FlightController) -> bool {
    // SAFETY: by this function's contract.
    unsafe { controller.as_ref() }.is_none_or(|controller| controller.controller.command().modes.is_held())
}

/// Throttle \[%\] with which a jet's engine follows the thrust rate of the last tick, for robots whose engines take no
/// rates. Zero with `controller.jet_dynamics = "ideal"`, which has no engines, for null or an index outside of the range.
///
/// # Safety
/// As for `flight_joint_count`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_throttle(controller: *const FlightController, index: usize) -> f64 {
    // SAFETY: by this function's contract.
    let controller = unsafe { controller.as_ref() };
    controller.and_then(|c| c.controller.command().throttle.as_slice().get(index).copied()).unwrap_or(0.0)
}

/// Starts a flight, in place of the present one if any: position, attitude and posture of this measurement become the
/// reference. Only wind, height and speeds of shafts may be NaN, thrusts of jets whose speed is measured, and joint
/// velocities that need not be measured; in later ticks any number may be, where it is not measured. If no flight can start with it,
/// the present one continues, and `message`, unless null, contains the reason in at most `message_size` bytes, the last
/// of which is zero. Allocates, so call it before the control loop.
///
/// # Safety
/// `measurement` is null or points to one whose arrays have the documented lengths; `message` is null or has space for
/// `message_size` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_start(
    controller: *mut FlightController,
    measurement: *const FlightMeasurement,
    message: *mut c_char,
    message_size: usize,
) -> FlightStatus {
    // SAFETY: by this function's contract.
    let (Some(controller), Some(given)) = (unsafe { (controller.as_mut(), measurement.as_ref()) }) else {
        // SAFETY: by this function's contract.
        unsafe { report("controller or measurement is null; expected both", message, message_size) };
        return FlightStatus::FlightNullPointer;
    };
    let mut reason = INTERNAL_ERROR.to_owned();
    let status = controller.guard(|controller| {
        // SAFETY: by this function's contract.
        if let Err(name) = unsafe { controller.read(given) } {
            reason = format!("`{name}` of the measurement is null; expected an array");
            return FlightStatus::FlightNullPointer;
        }
        let (controller, flight, measurement, _) = controller.parts();
        match controller.start(measurement) {
            Ok(started) => {
                *flight = Some(started);
                FlightStatus::FlightOk
            }
            Err(bad) => {
                reason = bad.to_string();
                FlightStatus::FlightNotStarted
            }
        }
    });
    if status != FlightStatus::FlightOk {
        // SAFETY: by this function's contract.
        unsafe { report(&reason, message, message_size) };
    }
    status
}

/// Computes one tick, which follows the mission of the configuration, or `setpoint` unless it is null. Allocates only where
/// `controller.qp` selects Clarabel.
///
/// # Safety
/// The pointers are null or point to objects of their types; the arrays of `measurement` and `command` have the
/// documented lengths.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_tick(
    controller: *mut FlightController,
    measurement: *const FlightMeasurement,
    setpoint: *const FlightSetpoint,
    command: *const FlightCommand,
) -> FlightStatus {
    // SAFETY: by this function's contract.
    unsafe { flight_tick_ahead(controller, measurement, setpoint, null(), command) }
}

/// As `flight_tick`, with what is known of the future, unless `preview` is null.
///
/// # Safety
/// As for `flight_tick`; `preview` is null or points to one whose arrays have the documented lengths.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_tick_ahead(
    controller: *mut FlightController,
    measurement: *const FlightMeasurement,
    setpoint: *const FlightSetpoint,
    preview: *const FlightPreview,
    command: *const FlightCommand,
) -> FlightStatus {
    // SAFETY: by this function's contract.
    let (Some(controller), Some(given), Some(command)) =
        (unsafe { (controller.as_mut(), measurement.as_ref(), command.as_ref()) })
    else {
        return FlightStatus::FlightNullPointer;
    };
    // SAFETY: by this function's contract.
    let (setpoint, preview) = unsafe { (setpoint.as_ref(), preview.as_ref()) };
    let (joints, jets) = (controller.joint_names.len(), controller.jet_names.len());
    if (jets > 0 && command.thrust_rate.is_null())
        || (joints > 0 && (command.joint_velocity.is_null() || command.joint_torque.is_null()))
    {
        return FlightStatus::FlightNullPointer;
    }
    let status = controller.guard(|controller| {
        // SAFETY: by this function's contract.
        if unsafe { controller.read(given).is_err() || !controller.read_preview(preview) } {
            return FlightStatus::FlightNullPointer;
        }
        let (controller, flight, measurement, preview) = controller.parts();
        let Some(flight) = flight else { return FlightStatus::FlightNotStarted };
        let setpoint = setpoint.map(setpoint_of);
        let answer = controller.tick_with(
            flight,
            measurement,
            &Given { setpoint: setpoint.as_ref(), preview, ..Given::default() },
        );
        // SAFETY: not null, and of these lengths by this function's contract.
        unsafe {
            copy_out(answer.thrust_rate.as_slice(), command.thrust_rate);
            copy_out(answer.joint_velocity.as_slice(), command.joint_velocity);
            copy_out(answer.joint_torque.as_slice(), command.joint_torque);
        }
        FlightStatus::FlightOk
    });
    if status == FlightStatus::FlightPanicked {
        // SAFETY: not null, and of these lengths by this function's contract.
        unsafe {
            command.thrust_rate.write_bytes(0, jets);
            command.joint_velocity.write_bytes(0, joints);
        }
    }
    status
}

/// Reports after a tick that other thrust rates and joint torques act until the next one, such as those of a safety
/// layer or of a motor at its limit. The controller's predictions use them; joint velocities are not read.
///
/// # Safety
/// The pointers are null or point to objects of their types; the arrays of `command` have the documented lengths.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_replace_command(
    controller: *mut FlightController,
    command: *const FlightCommand,
) -> FlightStatus {
    // SAFETY: by this function's contract.
    let (Some(controller), Some(command)) = (unsafe { (controller.as_mut(), command.as_ref()) }) else {
        return FlightStatus::FlightNullPointer;
    };
    let (joints, jets) = (controller.joint_names.len(), controller.jet_names.len());
    if (jets > 0 && command.thrust_rate.is_null()) || (joints > 0 && command.joint_torque.is_null()) {
        return FlightStatus::FlightNullPointer;
    }
    controller.guard(|controller| {
        let Some(flight) = &mut controller.flight else { return FlightStatus::FlightNotStarted };
        // SAFETY: not null unless empty, and of these lengths by this function's contract.
        let (rates, torques) =
            unsafe { (view(command.thrust_rate, jets), view(command.joint_torque, joints)) };
        match controller.controller.replace_command(flight, rates, torques) {
            Ok(()) => FlightStatus::FlightOk,
            Err(BadCommand) => FlightStatus::FlightBadCommand,
        }
    })
}

/// One tick of the torques between two ticks of the law: writes `joint_torque` of `command` for new measurements of the
/// joints \[rad, m; rad/s, m/s\], NaN where there is none; the other arrays are not touched. To be called
/// `controller.torque.steps` − 1 times after each `flight_tick`, at equal times. Where the torques are kept
/// `flight_is_held` says so.
///
/// # Safety
/// The pointers are null or point to objects of their types, positions and velocities to as many numbers as joints.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_tick_torques(
    controller: *mut FlightController,
    joint_position: *const f64,
    joint_velocity: *const f64,
    command: *const FlightCommand,
) -> FlightStatus {
    // SAFETY: by this function's contract.
    let (Some(controller), Some(command)) = (unsafe { (controller.as_mut(), command.as_ref()) }) else {
        return FlightStatus::FlightNullPointer;
    };
    let joints = controller.joint_names.len();
    let is_null = joint_position.is_null() || joint_velocity.is_null() || command.joint_torque.is_null();
    if joints > 0 && is_null {
        return FlightStatus::FlightNullPointer;
    }
    controller.guard(|controller| {
        let Some(flight) = &mut controller.flight else { return FlightStatus::FlightNotStarted };
        // SAFETY: not null unless empty, and of these lengths by this function's contract.
        let (position, velocity) = unsafe { (view(joint_position, joints), view(joint_velocity, joints)) };
        let answer = controller.controller.tick_torques(flight, &JointMeasurement { position, velocity });
        // SAFETY: not null, and of this length by this function's contract.
        unsafe { copy_out(answer.joint_torque.as_slice(), command.joint_torque) };
        FlightStatus::FlightOk
    })
}

/// Creates the simulated robot of a flight configuration, in its initial state. Allocates, as does nothing below but
/// `flight_robot_free`. Arguments and failure as for `flight_controller_create`.
///
/// # Safety
/// As for `flight_controller_create`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_robot_create(
    header: FlightHeader,
    path: *const c_char,
    message: *mut c_char,
    message_size: usize,
) -> *mut FlightRobot {
    // SAFETY: by this function's contract.
    unsafe { create(header, path, message, message_size, FlightRobot::load) }
}

/// Frees a simulated robot; null is allowed. No thread may use it then or later, nor free it again.
///
/// # Safety
/// `robot` comes from `flight_robot_create` and is not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_robot_free(robot: *mut FlightRobot) {
    if !robot.is_null() {
        // SAFETY: by this function's contract.
        drop(unsafe { Box::from_raw(robot) });
    }
}

/// Measures a simulated robot exactly: time, pose and velocity of the base, joints, thrusts and wind, with arrays of the
/// robot, which are valid until the next call for it. It has no other sensors: `foot_wrenches` and `shaft_speed` are null,
/// `height` is NaN.
///
/// # Safety
/// `robot` comes from `flight_robot_create`, or is null; `measurement` has space for one, or is null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_robot_measure(
    robot: *mut FlightRobot,
    measurement: *mut FlightMeasurement,
) -> FlightStatus {
    // SAFETY: by this function's contract.
    let Some(robot) = (unsafe { robot.as_mut() }) else { return FlightStatus::FlightNullPointer };
    if measurement.is_null() {
        return FlightStatus::FlightNullPointer;
    }
    robot.guard(|robot| {
        let (time, state) = (robot.time(), robot.plant.state());
        let rotation = &state.base.rotation;
        let measured = FlightMeasurement {
            time,
            base_position: state.base.position.into(),
            base_rotation: std::array::from_fn(|entry| rotation[(entry / 3, entry % 3)]),
            base_linear_velocity: state.base_linear_velocity().into(),
            base_angular_velocity: state.base_angular_velocity().into(),
            joint_position: state.joint_position.as_ptr(),
            joint_velocity: state.joint_velocity().as_ptr(),
            thrust: robot.plant.jets().thrust_feedback().as_ptr(),
            wind: robot.wind.velocity(time).into(),
            foot_wrenches: null(),
            shaft_speed: null(),
            height: f64::NAN,
        };
        // SAFETY: space for a measurement, by this function's contract.
        unsafe { measurement.write(measured) };
        FlightStatus::FlightOk
    })
}

/// Advances a simulated robot by one tick, in which thrust rates and joint torques of `command` act.
///
/// # Safety
/// `robot` comes from `flight_robot_create`, or is null; `command` is null or its arrays have the documented lengths.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_robot_advance(
    robot: *mut FlightRobot,
    command: *const FlightCommand,
) -> FlightStatus {
    // SAFETY: by this function's contract.
    unsafe { flight_robot_advance_in_steps(robot, command, None, null_mut()) }
}

/// As `flight_robot_advance`, for torques that are computed `controller.torque.steps` times in a tick: those of `command`
/// act in the first of as many equal parts, and what `torques` writes, which is called at the beginning of each other
/// part with `context`; of that, numbers that no command may have act as zero. Null stands for torques that do not change.
///
/// # Safety
/// As for `flight_robot_advance`; `torques` is null or a function that keeps to the lengths of its arrays and does not
/// use `robot`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_robot_advance_in_steps(
    robot: *mut FlightRobot,
    command: *const FlightCommand,
    torques: FlightTorques,
    context: *mut c_void,
) -> FlightStatus {
    // SAFETY: by this function's contract.
    let (Some(robot), Some(command)) = (unsafe { (robot.as_mut(), command.as_ref()) }) else {
        return FlightStatus::FlightNullPointer;
    };
    let (joints, jets) = (robot.plant.robot().joints.len(), robot.plant.robot().jets.len());
    if (jets > 0 && command.thrust_rate.is_null()) || (joints > 0 && command.joint_torque.is_null()) {
        return FlightStatus::FlightNullPointer;
    }
    robot.guard(|robot| {
        let wind = robot.wind.velocity(robot.time());
        // SAFETY: not null unless empty, and of these lengths by this function's contract.
        let (rates, first) = unsafe { (view(command.thrust_rate, jets), view(command.joint_torque, joints)) };
        let is_possible = |number: &f64| number.abs() <= FLIGHT_COMMAND_MAX; // false for NaN
        if !rates.iter().chain(first).all(is_possible) {
            return FlightStatus::FlightBadCommand;
        }
        robot.plant.observe(&wind);
        robot.plant.advance_in_steps(rates, &wind, robot.time_step, |part, state, torque| {
            if part == 0 {
                torque.copy_from_slice(first);
            } else if let Some(torques) = torques {
                let (position, velocity) = (state.joint_position.as_ptr(), state.joint_velocity().as_ptr());
                // SAFETY: by this function's contract.
                unsafe { torques(part, position, velocity, torque.as_mut_ptr(), context) };
                torque.iter_mut().filter(|number| !is_possible(number)).for_each(|number| *number = 0.0);
            }
        });
        robot.ticks += 1;
        let state = robot.plant.state();
        let is_possible = state.is_finite() && state.velocity.amax() < GREATEST_VELOCITY;
        if is_possible { FlightStatus::FlightOk } else { FlightStatus::FlightDiverged }
    })
}

fn setpoint_of(given: &FlightSetpoint) -> Setpoint {
    Setpoint {
        com_position: Vector3::from(given.com_position),
        com_velocity: Vector3::from(given.com_velocity),
        com_acceleration: Vector3::from(given.com_acceleration),
        com_jerk: Vector3::from(given.com_jerk),
        rotation: Matrix3::from_row_slice(&given.rotation),
        angular_velocity_b: Vector3::from(given.angular_velocity),
        angular_acceleration_b: Vector3::from(given.angular_acceleration),
        angular_jerk_b: Vector3::from(given.angular_jerk),
    }
}

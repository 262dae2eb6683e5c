//! The controller for C and C++: create it from the simulated configuration, start it, tick it.
//!
//! `include/flight.h` is generated from this file by cbindgen. Only `flight_controller_create`,
//! `flight_controller_free` and `flight_start` allocate. A panic does not leave the library: the call returns
//! `FLIGHT_PANICKED`, and so does every later call for that controller.

// Exporting symbols and using C pointers is unsafe; each block states its assumptions.
#![allow(unsafe_code, reason = "C has pointers")]

use flight_core::control::setpoint::Setpoint;
use flight_core::control::{BadCommand, Command, CommandStatus, ControllerState};
use flight_core::spatial::Pose;
use flight_core::{BuildError, Controller, Measurement, RobotState};
use flight_io::load_robot;
use flight_sim::load_scenario;
use nalgebra::{Matrix3, Vector3, Vector6};
use std::ffi::{CStr, CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::ptr::null;
use std::slice;

/// Outcome of a call.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FlightStatus {
    /// The command is that of the control law: both QPs are solved and certified.
    FlightNominal = 0,
    /// The measurement is not of this robot: thrust rates and joint velocities are zero, torques keep their values.
    FlightBadMeasurement = 1,
    /// The set-point exceeds the accepted range (`channels.greatest`), or its matrix is not a rotation: the robot brakes
    /// from the motion of the last valid one.
    FlightBadSetpoint = 2,
    /// The momentum QP has no answer: thrust rates and joint velocities are as near to zero as their bounds allow.
    FlightMomentumHeld = 3,
    /// The torque QP has no answer: torques keep their values.
    FlightTorqueHeld = 4,
    /// Neither QP has an answer.
    FlightBothHeld = 5,
    /// The command is that of the control law, but part of the measurement is predicted (NaN marks what is not
    /// measured) or the robot descends.
    FlightDegraded = 6,
    /// No flight has been started, or none can start with this measurement. No command is written.
    FlightNotStarted = -1,
    /// A required pointer is null. No command is written.
    FlightNullPointer = -2,
    /// Internal error of the library. Thrust rates and joint velocities are zero; the torques in the command are
    /// unchanged.
    FlightPanicked = -3,
    /// A replaced command contains a number that is not finite. Nothing changes.
    FlightBadCommand = -4,
}

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

/// A controller with its flight. Not to be used by several threads at the same time.
#[derive(Debug)]
pub struct FlightController {
    controller: Controller,
    flight: Option<ControllerState>,
    time_step: f64,
    joint_names: Vec<CString>,
    jet_names: Vec<CString>,
    /// The measurement in the types of the crate.
    robot_state: RobotState,
    thrust: Vec<f64>,
    foot_wrenches: Vec<Vector6<f64>>,
    has_panicked: bool,
}

impl FlightController {
    fn load(path: &Path) -> Result<Self, BuildError> {
        let scenario = load_scenario(path)?;
        let robot = load_robot(&scenario.robot)?;
        let c_name = |name: &String| {
            CString::new(name.as_str()).map_err(|_| {
                BuildError::bad_value("name of a joint or jet", format!("{name:?}"), "no zero byte")
            })
        };
        let joint_names = robot.joints.iter().map(|joint| c_name(&joint.name)).collect::<Result<_, _>>()?;
        let jet_names = robot.jets.iter().map(|jet| c_name(&jet.name)).collect::<Result<_, _>>()?;
        let controller = scenario.controller(robot)?;
        let (joints, feet) = (controller.model().joints.len(), controller.model().feet.len());
        Ok(Self {
            flight: None,
            time_step: scenario.simulator.time_step,
            joint_names,
            jet_names,
            robot_state: RobotState::zero(joints),
            thrust: vec![0.0; controller.n_jets()],
            foot_wrenches: vec![Vector6::zeros(); feet],
            has_panicked: false,
            controller,
        })
    }

    /// Converts a measurement to the types of the crate; `None` if one of its arrays is null.
    ///
    /// # Safety
    /// The arrays of `given` have the documented lengths.
    unsafe fn read(&mut self, given: &FlightMeasurement) -> Option<()> {
        let joints = self.robot_state.n_joints();
        let missing = |pointer: *const f64, length: usize| pointer.is_null() && length > 0;
        if missing(given.joint_position, joints)
            || missing(given.joint_velocity, joints)
            || missing(given.thrust, self.thrust.len())
        {
            return None;
        }
        let state = &mut self.robot_state;
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
            copy_in(given.thrust, &mut self.thrust);
        }
        if given.foot_wrenches.is_null() {
            self.foot_wrenches.fill(Vector6::zeros());
        } else {
            for (foot, wrench) in self.foot_wrenches.iter_mut().enumerate() {
                // SAFETY: six numbers per foot by this function's contract.
                unsafe { copy_in(given.foot_wrenches.add(6 * foot), wrench.as_mut_slice()) };
            }
        }
        Some(())
    }

    /// The controller, its flight, and the last measurement.
    fn parts(
        &mut self,
        given: &FlightMeasurement,
    ) -> (&mut Controller, &mut Option<ControllerState>, Measurement<'_>) {
        let measurement = Measurement {
            time: given.time,
            state: &self.robot_state,
            thrust: &self.thrust,
            wind: Vector3::from(given.wind),
            foot_wrenches: &self.foot_wrenches,
        };
        (&mut self.controller, &mut self.flight, measurement)
    }

    /// Runs `work`, unless it panics or an earlier call has panicked.
    fn guard(&mut self, work: impl FnOnce(&mut Self) -> FlightStatus) -> FlightStatus {
        if !self.has_panicked {
            // After a panic no data of this controller are used again.
            if let Ok(status) = catch_unwind(AssertUnwindSafe(|| work(self))) {
                return status;
            }
            self.has_panicked = true;
        }
        FlightStatus::FlightPanicked
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

fn status_of(command: &Command) -> FlightStatus {
    match command.status {
        CommandStatus::Nominal => FlightStatus::FlightNominal,
        CommandStatus::Degraded => FlightStatus::FlightDegraded,
        CommandStatus::BadMeasurement => FlightStatus::FlightBadMeasurement,
        // Cannot occur, because a caller cannot pass the state of another controller.
        CommandStatus::BadState => FlightStatus::FlightNotStarted,
        CommandStatus::BadSetpoint => FlightStatus::FlightBadSetpoint,
        CommandStatus::MomentumHeld => FlightStatus::FlightMomentumHeld,
        CommandStatus::TorqueHeld => FlightStatus::FlightTorqueHeld,
        CommandStatus::BothHeld => FlightStatus::FlightBothHeld,
    }
}

/// Creates the controller of a flight configuration, a file as in `configs/experiments/`.
///
/// Returns null on failure; `message`, unless null, then contains the reason in at most `message_size` bytes, the last
/// of which is zero. Allocates.
///
/// # Safety
/// `path` is a zero-terminated string, or null; `message` has space for `message_size` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_controller_create(
    path: *const c_char,
    message: *mut c_char,
    message_size: usize,
) -> *mut FlightController {
    let made = catch_unwind(|| {
        if path.is_null() {
            return Err("the path is null; expected that of a TOML file".to_owned());
        }
        // SAFETY: not null, and zero-terminated by this function's contract.
        let path = unsafe { CStr::from_ptr(path) };
        let path = path.to_str().map_err(|_| "the path is not UTF-8".to_owned())?;
        FlightController::load(Path::new(path)).map_err(|reason| reason.to_string())
    });
    let reason = match made {
        Ok(Ok(controller)) => return Box::into_raw(Box::new(controller)),
        Ok(Err(reason)) => reason,
        Err(_) => "an error of the library".to_owned(),
    };
    if !message.is_null() && message_size > 0 {
        let mut length = reason.len().min(message_size - 1);
        while !reason.is_char_boundary(length) {
            length -= 1;
        }
        // SAFETY: `length + 1 <= message_size` bytes, by this function's contract.
        unsafe {
            message.copy_from_nonoverlapping(reason.as_ptr().cast(), length);
            *message.add(length) = 0;
        }
    }
    std::ptr::null_mut()
}

/// Frees a controller; null is allowed.
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
    unsafe { controller.as_ref() }.map_or(0, |controller| controller.foot_wrenches.len())
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

/// Ways in which the last tick differs from one with complete measurements, as a sum: wind held 1 or lost 2; predicted
/// thrust 4, joints 8, base position 16, base rotation 32, base velocity 64, foot wrenches 128, clock 256; descent 512;
/// an engine does not reach its thrust 1024. Zero for null.
///
/// # Safety
/// As for `flight_joint_count`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_modes(controller: *const FlightController) -> u32 {
    // SAFETY: by this function's contract.
    unsafe { controller.as_ref() }.map_or(0, |controller| controller.controller.command().modes.bits())
}

/// Starts a flight, in place of the present one if any: position, attitude and posture of this measurement become the
/// reference. Only the wind may be NaN, and joint velocities that need not be measured. If no flight can start with it,
/// the present one continues. Allocates, so call it before the control loop.
///
/// # Safety
/// `measurement` is null or points to one whose arrays have the documented lengths.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn flight_start(
    controller: *mut FlightController,
    measurement: *const FlightMeasurement,
) -> FlightStatus {
    // SAFETY: by this function's contract.
    let (Some(controller), Some(given)) = (unsafe { controller.as_mut() }, unsafe { measurement.as_ref() })
    else {
        return FlightStatus::FlightNullPointer;
    };
    controller.guard(|controller| {
        // SAFETY: by this function's contract.
        if unsafe { controller.read(given) }.is_none() {
            return FlightStatus::FlightNullPointer;
        }
        let (controller, flight, measurement) = controller.parts(given);
        let Ok(started) = controller.start(&measurement) else { return FlightStatus::FlightNotStarted };
        *flight = Some(started);
        FlightStatus::FlightNominal
    })
}

/// Computes one tick, which follows the mission of the configuration, or `setpoint` unless it is null.
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
    let (Some(controller), Some(given), Some(command), setpoint) =
        (unsafe { (controller.as_mut(), measurement.as_ref(), command.as_ref(), setpoint.as_ref()) })
    else {
        return FlightStatus::FlightNullPointer;
    };
    let (joints, jets) = (controller.joint_names.len(), controller.jet_names.len());
    if (jets > 0 && command.thrust_rate.is_null())
        || (joints > 0 && (command.joint_velocity.is_null() || command.joint_torque.is_null()))
    {
        return FlightStatus::FlightNullPointer;
    }
    let status = controller.guard(|controller| {
        // SAFETY: by this function's contract.
        if unsafe { controller.read(given) }.is_none() {
            return FlightStatus::FlightNullPointer;
        }
        let (controller, flight, measurement) = controller.parts(given);
        let Some(flight) = flight else { return FlightStatus::FlightNotStarted };
        let answer = match setpoint {
            None => controller.tick(flight, &measurement),
            Some(given) => controller.tick_towards(flight, &measurement, &setpoint_of(given)),
        };
        // SAFETY: not null, and of these lengths by this function's contract.
        unsafe {
            copy_out(answer.thrust_rate.as_slice(), command.thrust_rate);
            copy_out(answer.joint_velocity.as_slice(), command.joint_velocity);
            copy_out(answer.joint_torque.as_slice(), command.joint_torque);
        }
        status_of(answer)
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
            Ok(()) => FlightStatus::FlightNominal,
            Err(BadCommand) => FlightStatus::FlightBadCommand,
        }
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

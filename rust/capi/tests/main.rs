//! The interface to C: what it answers, that its header is up to date, and that its examples compile and run.

#![allow(unsafe_code, reason = "the interface is C's")]
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

#[path = "../../sim/tests/common/counting.rs"]
mod counting;

use counting::{Counting, allocations};
use flight::{
    FLIGHT_VERSION, FlightCommand, FlightController, FlightHeader, FlightMeasurement, FlightPreview,
    FlightRobot, FlightSetpoint, FlightStatus, flight_controller_create, flight_controller_free,
    flight_foot_count, flight_is_held, flight_jet_count, flight_jet_name, flight_joint_count,
    flight_joint_name, flight_mode_name, flight_modes, flight_replace_command, flight_robot_advance,
    flight_robot_advance_in_steps, flight_robot_create, flight_robot_free, flight_robot_measure,
    flight_start, flight_status_name, flight_throttle, flight_tick, flight_tick_ahead, flight_tick_torques,
    flight_time_step, flight_torque_steps, flight_version,
};
use flight_core::Measurement;
use flight_core::control::estimate::joint_tracker::JointMeasurement;
use flight_core::control::law::setpoint::Setpoint;
use flight_core::control::modes::Modes;
use flight_core::control::{Given, Preview};
use flight_io::load_robot;
use flight_sim::{Plant, load_scenario};
use nalgebra::{DVector, Matrix3, Vector3};
use std::ffi::{CStr, CString, c_char, c_void};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::ptr::{null, null_mut};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const HERE: &str = env!("CARGO_MANIFEST_DIR");

/// A set-point that does not move; its rotation is none yet.
const AT_REST: FlightSetpoint = FlightSetpoint {
    com_position: [0.0; 3],
    com_velocity: [0.0; 3],
    com_acceleration: [0.0; 3],
    com_jerk: [0.0; 3],
    rotation: [0.0; 9],
    angular_velocity: [0.0; 3],
    angular_acceleration: [0.0; 3],
    angular_jerk: [0.0; 3],
};

fn config(name: &str) -> PathBuf {
    Path::new(HERE).join("../../configs/experiments").join(name).with_extension("toml")
}

/// A controller of C that is freed with the test.
struct Handle(*mut FlightController);

impl Drop for Handle {
    fn drop(&mut self) {
        unsafe { flight_controller_free(self.0) };
    }
}

fn create(path: &Path) -> Result<Handle, String> {
    create_with(FlightHeader::of_library(), path)
}

fn create_with(header: FlightHeader, path: &Path) -> Result<Handle, String> {
    let path = CString::new(path.to_str().unwrap()).unwrap();
    let mut message = [0; 400];
    let made =
        unsafe { flight_controller_create(header, path.as_ptr(), message.as_mut_ptr(), message.len()) };
    if made.is_null() { Err(text(message.as_ptr()).unwrap()) } else { Ok(Handle(made)) }
}

/// A string of C; `None` for null.
fn text(string: *const c_char) -> Option<String> {
    (!string.is_null()).then(|| unsafe { CStr::from_ptr(string) }.to_str().unwrap().to_owned())
}

/// Starts a flight; the status, and the message of a refusal.
fn start(c: &Handle, given: &FlightMeasurement) -> (FlightStatus, String) {
    let mut message = [0; 400];
    let status = unsafe { flight_start(c.0, &raw const *given, message.as_mut_ptr(), message.len()) };
    (status, text(message.as_ptr()).unwrap())
}

/// Arrays of a measurement and a command, and the structs that point to them.
struct Arrays {
    joint_position: Vec<f64>,
    joint_velocity: Vec<f64>,
    thrust: Vec<f64>,
    thrust_rate: Vec<f64>,
    velocity_command: Vec<f64>,
    torque: Vec<f64>,
}

impl Arrays {
    fn new(joints: usize, jets: usize) -> Self {
        let (per_joint, per_jet) = (vec![0.0; joints], vec![100.0; jets]);
        Self {
            joint_position: per_joint.clone(),
            joint_velocity: per_joint.clone(),
            thrust: per_jet.clone(),
            thrust_rate: per_jet,
            velocity_command: per_joint.clone(),
            torque: per_joint,
        }
    }

    fn measurement(&self) -> FlightMeasurement {
        FlightMeasurement {
            time: 0.0,
            base_position: [0.0; 3],
            base_rotation: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            base_linear_velocity: [0.0; 3],
            base_angular_velocity: [0.0; 3],
            joint_position: self.joint_position.as_ptr(),
            joint_velocity: self.joint_velocity.as_ptr(),
            thrust: self.thrust.as_ptr(),
            wind: [0.0; 3],
            foot_wrenches: null(),
            shaft_speed: null(),
            height: f64::NAN,
        }
    }

    fn command(&mut self) -> FlightCommand {
        FlightCommand {
            thrust_rate: self.thrust_rate.as_mut_ptr(),
            joint_velocity: self.velocity_command.as_mut_ptr(),
            joint_torque: self.torque.as_mut_ptr(),
        }
    }
}

/// A second of flight through C and through the crate, each measurement with every field different from zero: the
/// same bits in every tick. A field that is copied to a wrong place or by columns would differ. With the future of
/// set-points and wind, with a state estimator, with throttles in the realistic simulation, and with a learned policy too;
/// that of `robot` is of a file that names no simulator.
#[test]
fn flights_through_c_are_those_of_the_crate() {
    for name in ["test2", "test2_mpc", "test2_sensors", "robot", "test1_policy"] {
        fly_both(name);
    }
}

fn fly_both(name: &str) {
    let scenario = load_scenario(&config(name)).unwrap();
    let robot = load_robot(&scenario.robot).unwrap();
    let (joints, jets) = (robot.joints.len(), robot.jets.len());
    let mut plant =
        Plant::new(robot.clone(), &scenario.simulator, &scenario.disturbances, &scenario.controller.law)
            .unwrap();
    let mut controller = scenario.controller(robot).unwrap();
    let onboard = Path::new(HERE).join("../../configs/onboard/robot.toml");
    let c = create(&if name == "robot" { onboard } else { config(name) }).unwrap();
    let mut arrays = Arrays::new(joints, jets);
    let wind = Vector3::new(3.0, -4.0, 0.5);
    let mut flight = None;
    for tick in 0..100 {
        let time = f64::from(tick) * scenario.controller.law.time_step;
        plant.observe(&wind);
        let (state, thrust) = (plant.state(), plant.jets().thrust_feedback());
        let measurement = Measurement {
            time,
            state: state.clone(),
            thrust: thrust.to_vec(),
            wind,
            ..Measurement::zero(0, 0, 0)
        };
        arrays.joint_position.copy_from_slice(state.joint_position.as_slice());
        arrays.joint_velocity.copy_from_slice(state.joint_velocity());
        arrays.thrust.copy_from_slice(thrust);
        let given = FlightMeasurement {
            time,
            base_position: state.base.position.into(),
            base_rotation: state.base.rotation.transpose().as_slice().try_into().unwrap(),
            base_linear_velocity: state.base_linear_velocity().into(),
            base_angular_velocity: state.base_angular_velocity().into(),
            wind: wind.into(),
            ..arrays.measurement()
        };
        if tick == 0 {
            flight = Some(controller.start(&measurement).unwrap());
            assert_eq!(start(&c, &given), (FlightStatus::FlightOk, String::new()));
        }
        // Half of the ticks follow the mission, the others a set-point whose numbers all differ.
        let near = |offset: f64| Vector3::new(0.1, 0.2, 0.3) * (1.0 + offset);
        let setpoint = Setpoint {
            com_velocity: near(1.0),
            com_acceleration: near(2.0),
            com_jerk: near(3.0),
            angular_velocity_b: near(4.0),
            angular_acceleration_b: near(5.0),
            angular_jerk_b: near(6.0),
            ..Setpoint::at_rest(plant.kinematics().com + near(0.0) * 0.1, state.base.rotation)
        };
        let c_setpoint = FlightSetpoint {
            com_position: setpoint.com_position.into(),
            com_velocity: setpoint.com_velocity.into(),
            com_acceleration: setpoint.com_acceleration.into(),
            com_jerk: setpoint.com_jerk.into(),
            rotation: setpoint.rotation.transpose().as_slice().try_into().unwrap(),
            angular_velocity: setpoint.angular_velocity_b.into(),
            angular_acceleration: setpoint.angular_acceleration_b.into(),
            angular_jerk: setpoint.angular_jerk_b.into(),
        };
        let towards = tick % 2 == 1;
        let ours = flight.as_mut().unwrap();
        let c_command = arrays.command();
        let mut status = FlightStatus::FlightNotStarted;
        let (expected, allocated) = if towards {
            let setpoints =
                [(0.1, setpoint), (0.3, Setpoint::at_rest(setpoint.com_position, setpoint.rotation))];
            let winds = [(0.0, wind), (0.2, wind * 1.2), (0.5, wind * 0.5)];
            let FlightSetpoint { com_position, rotation, .. } = c_setpoint;
            let held = FlightSetpoint { com_position, rotation, ..AT_REST };
            let (c_times, c_setpoints) = (setpoints.map(|(time, _)| time), [c_setpoint, held]);
            let (c_wind_times, c_winds) =
                (winds.map(|(time, _)| time), winds.map(|(_, wind)| <[f64; 3]>::from(wind)));
            let c_preview = FlightPreview {
                setpoint_count: setpoints.len(),
                setpoint_time: c_times.as_ptr(),
                setpoint: c_setpoints.as_ptr(),
                wind_count: winds.len(),
                wind_time: c_wind_times.as_ptr(),
                wind: c_winds.as_flattened().as_ptr(),
            };
            let (measured, followed) = (&raw const given, &raw const c_setpoint);
            let allocated = allocations(|| {
                status = unsafe {
                    flight_tick_ahead(c.0, measured, followed, &raw const c_preview, &raw const c_command)
                };
            });
            let preview = Preview { setpoints: &setpoints, wind: &winds };
            (
                controller.tick_with(
                    ours,
                    &measurement,
                    &Given { setpoint: Some(&setpoint), preview, ..Given::default() },
                ),
                allocated,
            )
        } else {
            let allocated = allocations(|| {
                status = unsafe { flight_tick(c.0, &raw const given, null(), &raw const c_command) };
            });
            (controller.tick(ours, &measurement), allocated)
        };
        assert_eq!(allocated, 0, "a tick allocates");
        assert_eq!(status, FlightStatus::FlightOk, "tick {tick}");
        assert_eq!(unsafe { flight_modes(c.0) }, expected.modes.bits(), "tick {tick}");
        assert_eq!(arrays.thrust_rate, expected.thrust_rate.as_slice(), "tick {tick}");
        assert_eq!(arrays.velocity_command, expected.joint_velocity.as_slice(), "tick {tick}");
        assert_eq!(arrays.torque, expected.joint_torque.as_slice(), "tick {tick}");
        for (jet, throttle) in expected.throttle.iter().enumerate() {
            assert_eq!(unsafe { flight_throttle(c.0, jet) }.to_bits(), throttle.to_bits(), "tick {tick}");
        }
        if tick % 5 == 2 {
            // A tick of the torques, of which every other joint is measured.
            let mut position = plant.state().joint_position.as_slice().to_vec();
            position.iter_mut().step_by(2).for_each(|number| *number = f64::NAN);
            let velocity = plant.state().joint_velocity().to_vec();
            let measured = JointMeasurement { position: &position, velocity: &velocity };
            let expected = controller.tick_torques(ours, &measured);
            let c_command = arrays.command();
            let allocated = allocations(|| {
                let (position, velocity) = (position.as_ptr(), velocity.as_ptr());
                status = unsafe { flight_tick_torques(c.0, position, velocity, &raw const c_command) };
            });
            assert_eq!((allocated, status), (0, FlightStatus::FlightOk));
            assert_eq!(arrays.torque, expected.joint_torque.as_slice(), "tick {tick}");
        }
        if tick % 3 == 0 {
            // A safety layer halves what acts.
            arrays.torque.iter_mut().chain(&mut arrays.thrust_rate).for_each(|number| *number *= 0.5);
            controller.replace_command(ours, &arrays.thrust_rate, &arrays.torque).unwrap();
            let c_command = arrays.command();
            let allocated = allocations(|| {
                status = unsafe { flight_replace_command(c.0, &raw const c_command) };
            });
            assert_eq!((allocated, status), (0, FlightStatus::FlightOk));
        }
        plant.advance(&arrays.torque, &arrays.thrust_rate, &wind, scenario.controller.law.time_step);
    }
    assert!(plant.state().base.rotation != Matrix3::identity(), "the rotation was never looked at");
}

#[test]
fn names_and_counts_are_those_of_the_robot() {
    let scenario = load_scenario(&config("test2")).unwrap();
    let robot = load_robot(&scenario.robot).unwrap();
    let c = create(&config("test2")).unwrap();
    unsafe {
        assert_eq!(flight_joint_count(c.0), robot.joints.len());
        assert_eq!(flight_jet_count(c.0), robot.jets.len());
        assert_eq!(flight_foot_count(c.0), 0, "this controller stands on no foot");
        assert_eq!(flight_foot_count(create(&config("balancing_front")).unwrap().0), robot.feet.len());
        assert!((flight_time_step(c.0) - scenario.controller.law.time_step).abs() == 0.0);
        for (index, joint) in robot.joints.iter().enumerate() {
            assert_eq!(text(flight_joint_name(c.0, index)).as_ref(), Some(&joint.name));
        }
        for (index, jet) in robot.jets.iter().enumerate() {
            assert_eq!(text(flight_jet_name(c.0, index)).as_ref(), Some(&jet.name));
        }
        assert!(flight_joint_name(c.0, robot.joints.len()).is_null());
        assert_eq!(flight_joint_count(null()), 0);
        flight_controller_free(null_mut());
    }
}

#[test]
fn what_cannot_be_used_is_refused() {
    let refused = |path: &str| create(Path::new(path)).err().unwrap();
    assert!(refused("no/such.toml").contains("no/such.toml"));
    let mut short = [1; 8];
    unsafe {
        let path = c"no/such.toml";
        let header = FlightHeader::of_library();
        assert!(flight_controller_create(header, path.as_ptr(), short.as_mut_ptr(), short.len()).is_null());
        assert_eq!(short[7], 0, "the message ends within its space");
        assert!(flight_controller_create(header, null(), null_mut(), 0).is_null());
    }
    let c = create(&config("test2")).unwrap();
    let mut arrays = Arrays::new(unsafe { flight_joint_count(c.0) }, unsafe { flight_jet_count(c.0) });
    let (measurement, command) = (arrays.measurement(), arrays.command());
    let start = |given: &FlightMeasurement| start(&c, given);
    let tick = |given: &FlightMeasurement| unsafe { flight_tick(c.0, given, null(), &raw const command) };
    let lacking = FlightMeasurement { thrust: null(), ..measurement };
    let wrong = FlightMeasurement { base_position: [f64::NAN; 3], ..measurement };
    assert_eq!(tick(&measurement), FlightStatus::FlightNotStarted);
    let replace = |given: &FlightCommand| unsafe { flight_replace_command(c.0, given) };
    assert_eq!(replace(&command), FlightStatus::FlightNotStarted);
    let again = |joints: *const f64| unsafe { flight_tick_torques(c.0, joints, joints, &raw const command) };
    assert_eq!(again(null()), FlightStatus::FlightNullPointer);
    assert_eq!(again(measurement.joint_position), FlightStatus::FlightNotStarted);
    let (status, reason) = start(&lacking);
    assert_eq!(status, FlightStatus::FlightNullPointer);
    assert!(reason.contains("`thrust`"), "{reason}");
    let (status, reason) = start(&wrong);
    assert_eq!(status, FlightStatus::FlightNotStarted);
    assert!(reason.contains("`base_position`") && reason.contains("NaN"), "{reason}");
    assert_eq!(start(&measurement).0, FlightStatus::FlightOk);
    assert_eq!(tick(&lacking), FlightStatus::FlightNullPointer);
    assert_eq!(start(&wrong).0, FlightStatus::FlightNotStarted);
    assert_eq!(tick(&wrong), FlightStatus::FlightOk);
    assert_eq!(unsafe { flight_modes(c.0) }, Modes::POSITION_PREDICTED.bits());
    assert!(!unsafe { flight_is_held(c.0) } && unsafe { flight_is_held(null()) });
    assert_eq!(tick(&measurement), FlightStatus::FlightOk);
    assert_eq!(unsafe { flight_modes(c.0) }, 0);
    assert_eq!(unsafe { flight_modes(null()) }, 0);
    let setpoint = AT_REST;
    unsafe {
        let status = flight_tick(c.0, &raw const measurement, &raw const setpoint, &raw const command);
        assert_eq!(status, FlightStatus::FlightOk);
        assert_eq!(flight_modes(c.0), Modes::SETPOINT_IGNORED.bits());
        let no_torque = FlightCommand { joint_torque: null_mut(), ..command };
        let status = flight_tick(c.0, &raw const measurement, null(), &raw const no_torque);
        assert_eq!(status, FlightStatus::FlightNullPointer);
        assert_eq!(replace(&no_torque), FlightStatus::FlightNullPointer);
        let status = flight_start(null_mut(), &raw const measurement, null_mut(), 0);
        assert_eq!(status, FlightStatus::FlightNullPointer);
    }
    assert_eq!(replace(&command), FlightStatus::FlightOk);
    arrays.torque[3] = f64::NAN;
    assert_eq!(replace(&arrays.command()), FlightStatus::FlightBadCommand);
}

/// A program with another header is refused before anything of it is read.
#[test]
fn a_program_with_another_header_is_refused() {
    let ours = FlightHeader::of_library();
    let other = FlightHeader { version: ours.version + 100, ..ours };
    let larger = FlightHeader { measurement_size: ours.measurement_size + 8, ..ours };
    let without = FlightHeader { preview_size: 0, ..ours };
    for header in [other, larger, without, FlightHeader { setpoint_size: 0, ..ours }] {
        let reason = create_with(header, &config("test2")).err().unwrap();
        assert!(reason.contains("flight.h"), "{reason}");
    }
    let patched = FlightHeader { version: ours.version + 1, ..ours };
    assert!(create_with(patched, &config("test2")).is_ok());
    let part = |name: &str| name.parse::<u32>().unwrap();
    let (major, minor) = (part(env!("CARGO_PKG_VERSION_MAJOR")), part(env!("CARGO_PKG_VERSION_MINOR")));
    assert_eq!(FLIGHT_VERSION, 10_000 * major + 100 * minor + part(env!("CARGO_PKG_VERSION_PATCH")));
    assert_eq!(flight_version(), FLIGHT_VERSION);
}

/// C has the names and numbers of the crate.
#[test]
fn names_of_modes_and_statuses_are_those_of_the_crate() {
    let header = std::fs::read_to_string(Path::new(HERE).join("include/flight.h")).unwrap();
    for (mode, name, _) in Modes::NAMES {
        let line = format!("  FLIGHT_{} = {},\n", name.to_uppercase(), mode.bits());
        assert!(header.contains(&line), "{line}");
        assert_eq!(text(flight_mode_name(mode.bits())).unwrap(), name);
    }
    assert!(flight_mode_name(0).is_null() && flight_mode_name(3).is_null());
    let mut modes = Modes::default();
    assert_eq!(modes.to_string(), "none");
    modes.insert(Modes::DESCENDING);
    modes.insert(Modes::WIND_HELD);
    assert_eq!(modes.to_string(), "wind_held, descending");
    let mut statuses = 0;
    for number in -100..100 {
        if let Some(name) = text(flight_status_name(number)) {
            let line = format!("  FLIGHT_{} = {number},\n", name.to_uppercase());
            assert!(header.contains(&line), "{line}");
            statuses += 1;
        }
    }
    let (_, listed) = header.split_once("enum FlightStatus {").unwrap();
    assert_eq!(statuses, listed.split_once("} FlightStatus").unwrap().0.matches(",\n").count());
}

/// What the documentation says of threads.
#[test]
fn controllers_and_robots_may_change_threads() {
    fn assert_shared<T: Send + Sync>() {}
    assert_shared::<FlightController>();
    assert_shared::<FlightRobot>();
}

/// The simulated robot flies as that of the crate, in wind, and allocates nothing.
#[test]
fn a_flight_of_the_robot_in_c_is_that_of_the_crate() {
    let folder = tempfile::tempdir().unwrap();
    let windy = folder.path().join("windy.toml");
    let wind = "wind = { profile = \"ramp\", velocity = [0.0, -5.0, 0.0], ramp_start = 0.1, ramp_end = 1.0 }";
    let heavier = "disturbances.model_error = { mass_scale = 1.02, of_plant = true }";
    std::fs::write(&windy, format!("base = {:?}\n{wind}\n{heavier}\n", config("test2_observer"))).unwrap();
    let mut expected = flight_sim::Scenario::new(&load_scenario(&windy).unwrap()).unwrap().begin();
    let c = create(&windy).unwrap();
    let path = CString::new(windy.to_str().unwrap()).unwrap();
    let header = FlightHeader::of_library();
    let robot = unsafe { flight_robot_create(header, path.as_ptr(), null_mut(), 0) };
    assert!(unsafe { flight_robot_create(header, c"no/such.toml".as_ptr(), null_mut(), 0) }.is_null());
    let mut arrays = Arrays::new(unsafe { flight_joint_count(c.0) }, unsafe { flight_jet_count(c.0) });
    let command = arrays.command();
    let mut given = arrays.measurement();
    let done = FlightStatus::FlightOk;
    for tick in 0..100 {
        assert!(expected.step());
        assert_eq!(unsafe { flight_robot_measure(robot, &raw mut given) }, done);
        let log = |name| expected.log().series(name).unwrap().row(tick);
        assert_eq!(given.base_position[..], *log("base_position"), "tick {tick}");
        assert_eq!(given.wind[..], *log("wind"), "tick {tick}");
        if tick == 0 {
            assert_eq!(start(&c, &given).0, done);
        }
        let mut statuses = (done, done);
        let allocated = allocations(|| unsafe {
            statuses.0 = flight_tick(c.0, &raw const given, null(), &raw const command);
            statuses.1 = flight_robot_advance(robot, &raw const command);
        });
        assert_eq!((allocated, statuses), (0, (done, done)), "tick {tick}");
    }
    assert!(given.wind[1] < -4.0, "there was no wind");
    unsafe {
        let null_pointer = FlightStatus::FlightNullPointer;
        assert_eq!(flight_robot_measure(robot, null_mut()), null_pointer);
        assert_eq!(flight_robot_advance(robot, null()), null_pointer);
        let no_torque = FlightCommand { joint_torque: null_mut(), ..command };
        assert_eq!(flight_robot_advance(robot, &raw const no_torque), null_pointer);
        let before = given.time;
        for wrong in [f64::NAN, f64::INFINITY, 1e308, -2e6] {
            *command.joint_torque = wrong;
            assert_eq!(flight_robot_advance(robot, &raw const command), FlightStatus::FlightBadCommand);
        }
        *command.joint_torque = 0.0;
        *command.thrust_rate = f64::NAN;
        assert_eq!(flight_robot_advance(robot, &raw const command), FlightStatus::FlightBadCommand);
        assert_eq!(flight_robot_measure(robot, &raw mut given), done);
        assert_eq!(
            given.time.to_bits(),
            (before + 0.01).to_bits(),
            "a command that is refused changes nothing"
        );
        // What may be commanded, but no joint can bear.
        *command.thrust_rate = 0.0;
        *command.joint_torque = 1e6;
        let advance = || flight_robot_advance(robot, &raw const command);
        assert!((0..100).any(|_| advance() == FlightStatus::FlightDiverged));
        flight_robot_free(robot);
        flight_robot_free(null_mut());
    }
}

/// `include/flight.h` is what cbindgen makes of the source, with the modes of the crate; with `UPDATE=1` it is written.
#[test]
fn the_header_is_that_of_the_source() {
    let target = Path::new(HERE).join("include/flight.h");
    let mut config = cbindgen::Config::from_file(Path::new(HERE).join("cbindgen.toml")).unwrap();
    let modes = Modes::NAMES.map(|(mode, name, meaning)| {
        format!("  //{meaning}\n  FLIGHT_{} = {},\n", name.to_uppercase(), mode.bits())
    });
    config.after_includes = Some(format!(
        "\n// What in a tick is not as usual; `flight_modes` is a sum of them.\n\
         typedef enum FlightMode {{\n{}}} FlightMode;",
        modes.concat()
    ));
    let mut made = Vec::new();
    cbindgen::Builder::new()
        .with_src(Path::new(HERE).join("src/lib.rs"))
        .with_config(config)
        .generate()
        .unwrap()
        .write(&mut made);
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(&target, &made).unwrap();
    }
    let there = std::fs::read(&target).unwrap();
    assert!(there == made, "run UPDATE=1 cargo test -p flight-capi");
}

/// Folder of the library that this test was built with.
fn library_folder() -> PathBuf {
    std::env::current_exe().unwrap().parent().unwrap().to_owned()
}

fn run(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    text
}

/// Compiles an example against the library that this test was built with, and runs it.
fn run_example(compiler: &str, source: &str, arguments: &[&str]) -> Output {
    run_example_with(&[], compiler, source, arguments)
}

/// As [`run_example`], with `flags` of the compiler besides.
fn run_example_with(flags: &[&str], compiler: &str, source: &str, arguments: &[&str]) -> Output {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("program");
    let libraries = library_folder();
    run(Command::new(compiler)
        .args(["-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror"])
        .args(flags)
        .arg("-I")
        .arg(Path::new(HERE).join("include"))
        .arg(Path::new(HERE).join("examples").join(source))
        .arg("-o")
        .arg(&program)
        .arg("-L")
        .arg(&libraries)
        .arg(format!("-Wl,-rpath,{}", libraries.display()))
        .arg("-lflight"));
    Command::new(&program).args(arguments).output().unwrap()
}

fn numbers(line: &str) -> Vec<f64> {
    line.split_whitespace().filter_map(|word| word.parse().ok()).collect()
}

/// The command of the documentation, which shows what it prints. Times differ between machines.
#[test]
fn the_loop_in_c_prints_what_the_documentation_shows() {
    let page = std::fs::read_to_string(Path::new(HERE).join("../../docs/embedding.md")).unwrap();
    let (_, ticks) = page.split_once("target/loop configs/experiments/test2_observer.toml ").unwrap();
    let (ticks, _) = ticks.split_once('\n').unwrap();
    let path = config("test2_observer");
    let ran = run_example("cc", "loop.c", &[path.to_str().unwrap(), ticks]);
    let text = String::from_utf8(ran.stdout).unwrap();
    assert!(ran.status.success(), "{text}{}", String::from_utf8_lossy(&ran.stderr));
    for line in text.lines().filter(|line| !["loop", "tick", "late"].contains(&&line[..4])) {
        assert!(page.contains(&format!("\n{line}\n")), "the page does not show: {line}");
    }
    let refused = run_example("cc", "loop.c", &["no/such.toml"]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("no/such.toml"));
}

/// The controller in another process, with torques of their own rate: the same flight as in one process.
#[test]
fn the_controller_in_another_process_flies_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let fast = folder.path().join("fast.toml");
    let keys = "controller.torque.steps = 5\nsimulator.substeps = 5";
    std::fs::write(&fast, format!("base = {:?}\n{keys}\n", config("test2"))).unwrap();
    let ran = run_example("cc", "realtime.c", &[fast.to_str().unwrap(), "50", "0"]);
    let text = String::from_utf8(ran.stdout).unwrap();
    assert!(ran.status.success(), "{text}{}", String::from_utf8_lossy(&ran.stderr));
    for line in ["lost             0 of 250", "in one process   the same flight, bit by bit"] {
        assert!(text.lines().any(|printed| printed == line), "{text}");
    }
    assert_eq!(run_example("cc", "realtime.c", &["no/such.toml"]).status.code(), Some(1));
}

/// Torques of every part of a tick are those of the crate's own flight.
#[test]
fn torques_between_two_ticks_through_c_are_those_of_the_crate() {
    struct Context {
        controller: *mut FlightController,
        command: FlightCommand,
        parts: Vec<u32>,
    }
    unsafe extern "C" fn torques(
        part: u32,
        position: *const f64,
        velocity: *const f64,
        torque: *mut f64,
        context: *mut c_void,
    ) {
        let context = unsafe { &mut *context.cast::<Context>() };
        context.parts.push(part);
        unsafe {
            flight_tick_torques(context.controller, position, velocity, &raw const context.command);
            torque.copy_from(context.command.joint_torque, flight_joint_count(context.controller));
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let fast = folder.path().join("fast.toml");
    let keys = "controller.torque.steps = 5\nsimulator.substeps = 5";
    std::fs::write(&fast, format!("base = {:?}\n{keys}\n", config("test2_observer"))).unwrap();
    let mut expected = flight_sim::Scenario::new(&load_scenario(&fast).unwrap()).unwrap().begin();
    let c = create(&fast).unwrap();
    assert_eq!(unsafe { (flight_torque_steps(c.0), flight_torque_steps(null())) }, (5, 0));
    let path = CString::new(fast.to_str().unwrap()).unwrap();
    let robot = unsafe { flight_robot_create(FlightHeader::of_library(), path.as_ptr(), null_mut(), 0) };
    let mut arrays = Arrays::new(unsafe { flight_joint_count(c.0) }, unsafe { flight_jet_count(c.0) });
    let mut given = arrays.measurement();
    let mut context = Context { controller: c.0, command: arrays.command(), parts: Vec::new() };
    for tick in 0..100 {
        assert!(expected.step());
        unsafe { flight_robot_measure(robot, &raw mut given) };
        let log = |name| expected.log().series(name).unwrap().row(tick);
        assert_eq!(given.base_position[..], *log("base_position"), "tick {tick}");
        if tick == 0 {
            assert_eq!(start(&c, &given).0, FlightStatus::FlightOk);
        }
        let command = arrays.command();
        unsafe {
            flight_tick(c.0, &raw const given, null(), &raw const command);
            let whole = (&raw mut context).cast::<c_void>();
            flight_robot_advance_in_steps(robot, &raw const command, Some(torques), whole);
        }
    }
    assert_eq!(context.parts[..8], [1, 2, 3, 4, 1, 2, 3, 4]);
    unsafe { flight_robot_free(robot) };
}

/// `make install-capi` installs what a program is built with.
#[test]
fn a_program_finds_what_is_installed() {
    let folder = tempfile::tempdir().unwrap();
    let (prefix, built) = (folder.path().join("a prefix"), folder.path().join("built"));
    let set = |name: &str, value: &Path| format!("{name}={}", value.display());
    run(Command::new("make")
        .env_remove("MAKEFLAGS")
        .args(["--directory", &Path::new(HERE).join("../..").display().to_string(), "install-capi"])
        .args([set("PREFIX", &prefix), set("LIBFLIGHT", &library_folder())]));
    let is_there = |tool: &str| {
        let found = Command::new(tool).arg("--version").output().is_ok();
        if !found {
            eprintln!("{tool} is missing; programs are not built with it");
        }
        found
    };
    let path = config("test2");
    let path = path.to_str().unwrap();
    if is_there("cmake") {
        let source = Path::new(HERE).join("examples");
        run(Command::new("cmake")
            .args([Path::new("-S"), &source, Path::new("-B"), &built])
            .arg(set("-DCMAKE_PREFIX_PATH", &prefix)));
        run(Command::new("cmake").arg("--build").arg(&built));
        for (program, arguments) in
            [("loop", &[path, "2"] as &[&str]), ("hover", &[path]), ("realtime", &[path, "2", "0"])]
        {
            run(Command::new(built.join(program)).args(arguments));
        }
    }
    let program = folder.path().join("program");
    let runs = || run(Command::new(&program).env_remove("LD_LIBRARY_PATH").args([path, "2"]));
    // As the page says, for a prefix with a blank: shared, with the archive's own libraries, and fully static.
    let build = |words: &str| {
        let loop_c = Path::new(HERE).join("examples/loop.c");
        let command = format!("eval cc {} -o {} {words}", loop_c.display(), program.display());
        run(Command::new("sh")
            .args(["-c", &command])
            .current_dir(&prefix)
            .env("PKG_CONFIG_PATH", prefix.join("lib/pkgconfig")));
        runs();
    };
    if is_there("pkg-config") {
        let required = format!("flight = {}", env!("CARGO_PKG_VERSION"));
        run(Command::new("pkg-config").arg(required).env("PKG_CONFIG_PATH", prefix.join("lib/pkgconfig")));
        build("$(pkg-config --cflags --libs flight) -Wl,-rpath,$(pkg-config --variable=libdir flight)");
        build(
            "$(pkg-config --static --cflags --libs flight) -Wl,-rpath,$(pkg-config --variable=libdir flight)",
        );
        let libc = run(Command::new("cc").arg("-print-file-name=libc.a"));
        if libc.starts_with('/') {
            build("-static $(pkg-config --static --cflags --libs flight)");
        }
    }
    // Linked by its path, the library is still needed by its name.
    build("-I include lib/libflight.so -Wl,-rpath,'\"$PWD/lib\"'");
}

#[test]
fn the_example_in_cpp_gives_the_command_of_the_crate() {
    let path = config("test2");
    let ran = run_example("c++", "hover.cpp", &[path.to_str().unwrap()]);
    let text = String::from_utf8(ran.stdout).unwrap();
    assert!(ran.status.success(), "{text}{}", String::from_utf8_lossy(&ran.stderr));

    let scenario = load_scenario(&path).unwrap();
    let robot = load_robot(&scenario.robot).unwrap();
    let state = flight_core::RobotState::zero(robot.joints.len());
    let thrust = vec![100.0; robot.jets.len()];
    let feet = vec![nalgebra::Vector6::zeros(); robot.feet.len()];
    let mut controller = scenario.controller(robot).unwrap();
    let measurement = Measurement {
        time: 0.0,
        state: state.clone(),
        thrust: thrust.clone(),
        foot_wrenches: DVector::from_iterator(6 * feet.len(), feet.iter().flatten().copied()),
        ..Measurement::zero(0, 0, 0)
    };
    let mut flight = controller.start(&measurement).unwrap();
    let setpoint = Setpoint::at_rest(Vector3::new(0.0, 0.0, 1.0), Matrix3::identity());
    let command = controller.tick_with(
        &mut flight,
        &measurement,
        &Given { setpoint: Some(&setpoint), ..Given::default() },
    );
    assert_eq!(numbers(&text)[0..], *command.thrust_rate.as_slice(), "{text}");
}

const SANITIZERS: [&str; 4] =
    ["-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer"];

/// Whether this machine's compiler has the sanitizers.
fn has_sanitizers() -> bool {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("empty.c");
    std::fs::write(&source, "int main(void) { return 0; }\n").unwrap();
    let program = folder.path().join("empty");
    let built = Command::new("cc").args(SANITIZERS).arg(&source).arg("-o").arg(&program).output();
    built.is_ok_and(|output| output.status.success())
        && Command::new(&program).status().is_ok_and(|status| status.success())
}

/// No access beyond what is theirs, no undefined behaviour, and all memory is given back, of refused files too.
#[test]
fn the_examples_are_clean_under_sanitizers() {
    if !has_sanitizers() {
        eprintln!("not run: `cc` has no sanitizers here");
        return;
    }
    let path = config("test2");
    let path = path.to_str().unwrap();
    for (compiler, source, arguments) in [
        ("cc", "loop.c", &[path, "20"][..]),
        ("cc", "realtime.c", &[path, "5", "0"]),
        ("c++", "hover.cpp", &[path]),
    ] {
        for (arguments, code) in [(arguments, 0), (&["no/such.toml"], 1)] {
            let ran = run_example_with(&SANITIZERS, compiler, source, arguments);
            let said = String::from_utf8_lossy(&ran.stderr);
            assert!(ran.status.code() == Some(code) && !said.contains("Sanitizer"), "{source}: {said}");
        }
    }
    let leak = "#include \"flight.h\"\nint main(int argc, char **argv) { char m[400]; (void)argc;\n\
                return flight_controller_create(flight_header(), argv[1], m, sizeof m) == 0; }\n";
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("leak.c");
    std::fs::write(&source, leak).unwrap();
    let ran = run_example_with(&SANITIZERS, "cc", source.to_str().unwrap(), &[path]);
    assert!(!ran.status.success(), "a controller that is not freed goes unnoticed");
}

#[test]
fn the_example_in_cpp_needs_no_exceptions() {
    let path = config("test2");
    for (path, code) in [(path.to_str().unwrap(), 0), ("no/such.toml", 1)] {
        let ran = run_example_with(&["-fno-exceptions", "-fno-rtti"], "c++", "hover.cpp", &[path]);
        let said = String::from_utf8_lossy(&ran.stderr);
        assert_eq!(ran.status.code(), Some(code), "{said}");
        assert_eq!(said.contains("no/such.toml"), code == 1, "{said}");
    }
}

/// A thread that flushes subnormal numbers, or rounds in another way, cannot begin a flight.
#[cfg(target_arch = "x86_64")]
#[test]
fn unusual_floating_point_modes_are_refused() {
    use std::arch::asm;
    let c = create(&config("test2")).unwrap();
    let arrays = Arrays::new(unsafe { flight_joint_count(c.0) }, unsafe { flight_jet_count(c.0) });
    let mut usual = 0_u32;
    unsafe { asm!("stmxcsr [{}]", in(reg) &raw mut usual) };
    for (bits, expected) in
        [(1 << 15, "subnormal"), (1 << 13, "rounding"), (2 << 13, "rounding"), (3 << 13, "rounding")]
    {
        let unusual = usual | bits;
        unsafe { asm!("ldmxcsr [{}]", in(reg) &raw const unusual) };
        let (status, reason) = start(&c, &arrays.measurement());
        unsafe { asm!("ldmxcsr [{}]", in(reg) &raw const usual) };
        assert_eq!(status, FlightStatus::FlightNotStarted, "{bits:x}");
        assert!(reason.contains(expected), "{reason}");
    }
    assert_eq!(start(&c, &arrays.measurement()).0, FlightStatus::FlightOk);
}

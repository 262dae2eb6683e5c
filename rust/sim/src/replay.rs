//! A recorded log through the tick of any controller, open loop: its commands act on nothing.

use crate::config::ScenarioConfig;
use crate::log::FlightLog;
use crate::sensors::Sensors;
use crate::signals::{TickRow, feet_of};
use crate::wind::Wind;
use flight_core::control::{Given, JointMeasurement, Measurement, Preview};
use flight_core::error::BuildError;
use flight_core::kinematics::RobotState;
use flight_core::spatial::Pose;
use flight_io::load_robot;
use nalgebra::{DVector, Matrix3, Vector3};

/// Greatest relative difference between the median period of a log and that of its ticks.
const PERIOD_TOLERANCE: f64 = 0.01;

/// Greatest number of rows over which periods are taken: jitter of single times has less effect on longer ones, and a
/// pause of the controller is in more of them.
const LONGEST_SPAN: usize = 50;

/// Replays the measurements of a log, its `time` and `raw_*` signals, through the controller of a configuration.
/// Returns what it computes: the signals of [`Read::Tick`](crate::signals::Read::Tick).
///
/// A row is a tick; with `controller.torque.steps` > 1 a row is a tick of the torques, of which the first and every
/// `steps`-th is one of the law too, with a row in the result. A signal that is absent is not measured; foot wrenches
/// are then zero. A tick whose row was lost is one of NaN, except for its time; a longer step between two rows is a pause
/// of the controller. The future wind that the controller is given is computed from the configuration.
///
/// With the log of a flight and the configuration that it flew, the result has the same bits.
///
/// # Errors
/// [`BuildError`] for a configuration without a controller, for a log of another period or with a time that does not
/// follow that of the row before, and where the controller cannot start with its first row.
pub fn replay(config: &ScenarioConfig, log: &FlightLog) -> Result<FlightLog, BuildError> {
    let robot = load_robot(&config.robot)?;
    let (joints, jets) = (robot.joints.len(), robot.jets.len());
    let time_step = config.controller.law.time_step;
    let steps = config.controller.law.torque.steps;
    check_period(log, time_step, steps)?;
    let sensors = config.simulator.sensors.as_ref();
    let mut sensors = sensors.map(|sensors| Sensors::new(sensors, time_step, joints, jets)).transpose()?;
    let wind = Wind::new(&config.wind)?;
    let mut controller = config.controller(robot.clone())?;
    let mut replayed = FlightLog::of_ticks(&robot, !controller.model().feet.is_empty(), log.len());
    let feet = feet_of(&robot, &controller.model().feet);
    let mut measurement = Measurement::zero(joints, jets, controller.model().feet.len());
    let mut state = None;
    for row in 0..log.len() {
        let numbers = |name: &str| log.series(name).map_or(&[][..], |series| series.row(row));
        let read = |name: &str, width: usize| {
            let found = numbers(name);
            if found.is_empty() { vec![f64::NAN; width] } else { found.to_vec() }
        };
        let (position, velocity) = (read("raw_joint_position", joints), read("raw_joint_velocity", joints));
        if let Some(state) = state.as_mut().filter(|_| !row.is_multiple_of(steps as usize)) {
            let measured = JointMeasurement { position: &position, velocity: &velocity };
            controller.tick_torques(state, &measured);
            continue;
        }
        measurement.state = RobotState {
            base: Pose {
                rotation: Matrix3::from_row_slice(&read("raw_base_rotation", 9)),
                position: Vector3::from_column_slice(&read("raw_base_position", 3)),
            },
            joint_position: DVector::from_vec(position),
            velocity: DVector::from_vec([read("raw_base_velocity", 6), velocity].concat()),
        };
        for (foot, wrench) in feet.iter().zip(numbers("raw_foot_wrench").chunks_exact(6)) {
            if let Some(foot) = foot {
                measurement.foot_wrenches.as_mut_slice()[6 * foot..6 * foot + 6].copy_from_slice(wrench);
            }
        }
        measurement.time = read("time", 1)[0];
        (measurement.thrust, measurement.shaft_speed) =
            (read("raw_thrust", jets), read("raw_shaft_speed", jets));
        measurement.wind = Vector3::from_column_slice(&read("raw_wind", 3));
        measurement.height = numbers("raw_height").first().copied().unwrap_or(f64::NAN);
        let state = match &mut state {
            Some(state) => state,
            none => {
                let started = controller.start(&measurement);
                none.insert(started.map_err(|reason| BuildError::malformed("first row of the log", reason))?)
            }
        };
        let ahead = sensors.as_mut().map_or(&[][..], |sensors| sensors.look_ahead(&wind, measurement.time));
        let preview = Preview { wind: ahead, ..Preview::default() };
        controller.tick_with(state, &measurement, &Given { preview, ..Given::default() });
        let (terms, command) = (controller.terms(), controller.command());
        let row = TickRow { measurement: &measurement, state, terms, command, feet: &feet };
        replayed.push(&row, None);
    }
    Ok(replayed)
}

/// Refuses a log whose rows are not as far apart as the ticks.
fn check_period(log: &FlightLog, time_step: f64, steps: u32) -> Result<(), BuildError> {
    let time = log.series("time").map_or(&[][..], |series| &series.data);
    if time.is_empty() {
        return Err(BuildError::bad_value("number of rows of the log", 0, "one or more"));
    }
    if let Some(row) =
        time.windows(2).position(|pair| pair[1] - pair[0] <= 0.0 || (pair[1] - pair[0]).is_nan())
    {
        let expected = format!("a time after that of row {}, {} s", row + 1, time[row]);
        let item = format!("time of row {} of the log", row + 2);
        return Err(BuildError::bad_value(item, format!("{} s", time[row + 1]), expected));
    }
    let expected = time_step / f64::from(steps);
    let span = ((time.len() - 1) / 4).clamp(1, LONGEST_SPAN);
    let mut periods: Vec<f64> =
        time.windows(span + 1).map(|rows| (rows[span] - rows[0]) / span as f64).collect();
    let middle = periods.len() / 2;
    let period = match periods.is_empty() {
        true if steps == 1 => expected,
        true => f64::NAN,
        false => *periods.select_nth_unstable_by(middle, f64::total_cmp).1,
    };
    if (period / expected - 1.0).abs() <= PERIOD_TOLERANCE {
        return Ok(());
    }
    let why = if steps > 1 {
        format!(
            "controller.time_step over controller.torque.steps, {steps}, whose ticks need the joints in between"
        )
    } else {
        "controller.time_step, of which controller.mpc.period and knots are whole numbers".to_owned()
    };
    Err(BuildError::bad_value("period of the log", format!("{period} s"), format!("{expected} s, {why}")))
}

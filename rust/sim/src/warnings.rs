//! What of a configuration can be flown but is probably not meant: key, value and what was expected.

use crate::config::ScenarioConfig;
use crate::jets::JetsConfig;
use crate::outcome::SPEED;
use crate::wind::{Wind, WindConfig};
use flight_core::error::BuildError;
use flight_core::jets::JetDynamics;
use flight_core::kinematics::Kinematics;
use flight_core::robot::{JointKind, RobotModel};

/// Depth below the ground that is rounding \[m\].
const ROUNDING_OF_HEIGHTS: f64 = 0.01;

/// Excess beyond a joint's stop that is rounding \[rad, m\].
const ROUNDING_OF_JOINTS: f64 = 1e-6;

/// Warnings of a configuration whose parts have been checked.
pub(crate) fn warnings(config: &ScenarioConfig, robot: &RobotModel) -> Result<Vec<String>, BuildError> {
    let found = [
        too_late(config),
        without_effect(config),
        outside_stops(config, robot),
        below_ground(config, robot),
        lacking(config),
    ];
    Ok(found.into_iter().flatten().chain(never_met(config)?).chain(too_strong(config)?).collect())
}

/// What begins when the flight has ended.
fn too_late(config: &ScenarioConfig) -> Vec<String> {
    let disturbances = &config.disturbances;
    let of = |key: &str, start: f64| (format!("disturbances.{key}"), start);
    let failure = disturbances.jets.failure.iter().map(|failure| of("jets.failure.time", failure.time));
    let joints = disturbances.joints.iter().enumerate();
    let joints = joints.map(|(index, fault)| of(&format!("joints[{index}].start"), fault.start));
    let outages = disturbances.outages.iter().enumerate();
    let outages = outages.map(|(index, outage)| of(&format!("outages[{index}].start"), outage.start));
    let pushes = disturbances.pushes.iter().enumerate();
    let pushes = pushes.map(|(index, push)| of(&format!("pushes[{index}].start"), push.start));
    let gust = if let WindConfig::Gust { start, .. } = config.wind { Some(start) } else { None };
    let gust = gust.map(|start| ("wind.start".to_owned(), start));
    let end = config.simulator.duration;
    let all = failure.chain(joints).chain(outages).chain(pushes).chain(gust);
    let warning = |(key, start)| {
        format!("{key} is {start} s; expected less than simulator.duration, {end} s, to see it")
    };
    all.filter(|(_, start)| *start >= end).map(warning).collect()
}

/// Pushes without force and moment.
fn without_effect(config: &ScenarioConfig) -> Vec<String> {
    let pushes = config.disturbances.pushes.iter().enumerate();
    let idle = pushes.filter(|(_, push)| push.force.iter().chain(&push.moment).all(|part| *part == 0.0));
    idle.map(|(index, _)| format!("disturbances.pushes[{index}] has neither force nor moment; expected one"))
        .collect()
}

/// Joints that start beyond their stops.
fn outside_stops(config: &ScenarioConfig, robot: &RobotModel) -> Vec<String> {
    let joints = robot.joints.iter().zip(&config.simulator.initial.joint_position);
    let beyond = joints.filter(|(joint, position)| {
        joint.stops.0 - **position > ROUNDING_OF_JOINTS || **position - joint.stops.1 > ROUNDING_OF_JOINTS
    });
    let warning = |(joint, position): (&flight_core::robot::Joint, &f64)| {
        let unit = if joint.kind == JointKind::Revolute { "rad" } else { "m" };
        let (name, (lower, upper)) = (&joint.name, joint.stops);
        format!(
            "simulator.initial.joint_position of `{name}` is {position} {unit}; expected {lower:.4} to {upper:.4} {unit}, \
             within its stops"
        )
    };
    beyond.map(warning).collect()
}

/// The lowest of the base and the soles, if it starts below the ground, which is at height zero.
fn below_ground(config: &ScenarioConfig, robot: &RobotModel) -> Vec<String> {
    let state = config.simulator.initial.state();
    let mut kinematics = Kinematics::new(robot);
    kinematics.update(robot, &state);
    let soles = robot.soles.iter().flat_map(|sole| {
        let pose = kinematics.bodies[sole.frame.body].i_from_b * sole.frame.body_from_frame;
        let height = move |vertex| pose.transform_point(vertex).z;
        sole.vertices_f.iter().map(height).map(|height| (format!("foot `{}`", sole.name), height))
    });
    let base = ("the base".to_owned(), state.base.position.z);
    let lowest = soles.chain([base]).min_by(|a, b| a.1.total_cmp(&b.1));
    let warning = |(what, height): (String, f64)| {
        let place = format!("simulator.initial.base_position puts {what} at a height of {height:.3} m");
        format!("{place}; expected 0 or more: the ground is at 0")
    };
    lowest.filter(|(_, height)| *height < -ROUNDING_OF_HEIGHTS).map(warning).into_iter().collect()
}

/// What the controller's model has and the simulated robot lacks, but is flown without loss: friction of drives that
/// have rotors, engines that lag. What is not flown is [refused](ScenarioConfig::check_drives).
fn lacking(config: &ScenarioConfig) -> Vec<String> {
    let (law, simulator) = (&config.controller.law, &config.simulator);
    let dry =
        simulator.motors.as_ref().filter(|motors| motors.friction == 0.0 && motors.friction_of.is_empty());
    let frictions =
        law.torque.friction.iter().flatten().filter(|(_, friction)| dry.is_some() && **friction > 0.0);
    let friction = frictions.map(|(group, friction)| {
        format!(
            "controller.torque.friction.{group} is {friction} N m; expected 0, as the simulated drives have no friction \
             (simulator.motors.friction)"
        )
    });
    let lags = matches!(law.jet_dynamics, JetDynamics::Throttled)
        && matches!(simulator.jets, JetsConfig::Ideal { .. });
    let engines = lags.then(|| {
        "controller.jet_dynamics is throttled; expected ideal, as the simulated engines are (simulator.jets.dynamics)"
            .to_owned()
    });
    friction.chain(engines).collect()
}

/// A recorded wind of another time than the flight's, which is flown in its first or last sample.
fn never_met(config: &ScenarioConfig) -> Result<Option<String>, BuildError> {
    let (wind, end) = (Wind::new(&config.wind)?, config.simulator.duration);
    let (Some((first, _)), Some((last, _))) = (wind.samples().first(), wind.samples().last()) else {
        return Ok(None);
    };
    let what = match &config.wind {
        WindConfig::File { path } => path.display().to_string(),
        _ => "wind.samples".to_owned(),
    };
    Ok((*first > end || *last < 0.0).then(|| {
        format!(
            "{what} has samples from {first} to {last} s, none within the flight; expected 0 to {end} s: times are seconds \
             since its start"
        )
    }))
}

/// A wind in which every flight diverges.
fn too_strong(config: &ScenarioConfig) -> Result<Option<String>, BuildError> {
    let (wind, step) = (Wind::new(&config.wind)?, config.controller.law.time_step);
    let speed = |tick| wind.velocity(f64::from(tick) * step).norm();
    let ticks = u32::try_from(config.n_ticks()).unwrap_or(u32::MAX);
    let greatest = (0..=ticks).map(speed).fold(0.0, f64::max);
    Ok((greatest > SPEED).then(|| {
        format!(
            "wind reaches {greatest:.0} m/s; expected at most {SPEED} m/s, above which a flight ends as diverged"
        )
    }))
}

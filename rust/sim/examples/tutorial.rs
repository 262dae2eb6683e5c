//! The tutorial of the documentation, `docs/tutorial.md`, as a program.
//!
//! ```text
//! cargo run --release --example tutorial
//! ```

use flight_core::Measurement;
use flight_core::control::law::momentum_qp::{Equations, Layout, Task, TaskInputs};
use flight_io::{MissionConfig, load_controller, load_robot};
use flight_sim::{Plant, Scenario, ScenarioConfig, WindConfig, fly_batch, load_scenario};
use nalgebra::Vector3;
use std::error::Error;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Path of a file or folder in `configs/`.
fn configs(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs").join(name)
}

// --8<-- [start:hover]
fn hover() -> Result<ScenarioConfig, Box<dyn Error>> {
    let mut config = load_scenario(&configs("experiments/test2.toml"))?;
    config.mission = MissionConfig::default(); // no commands: hold the initial position
    config.wind = WindConfig::Constant { velocity: [0.0, 0.0, 0.0] };
    config.simulator.duration = 10.0;

    let result = Scenario::new(&config)?.run(|_, _| ControlFlow::Continue(()))?;
    let (low, high) = (result.summary.thrust_min, result.summary.thrust_max);
    println!("{}; thrusts from {low:.0} to {high:.0} N", result.outcome.name());
    Ok(config)
}
// --8<-- [end:hover]

// --8<-- [start:wind]
fn wind(mut aware: ScenarioConfig) -> Result<(), Box<dyn Error>> {
    aware.wind = WindConfig::Ramp { velocity: [0.0, -12.0, 0.0], ramp_start: 1.0, ramp_end: 4.0 };
    aware.simulator.duration = 20.0;
    let mut baseline = aware.clone();
    baseline.controller = load_scenario(&configs("experiments/test1.toml"))?.controller;

    let lean = |result: flight_sim::FlightResult| result.summary.max_rotation_error.to_degrees();
    let leans = fly_batch(&[aware, baseline], None, || ControlFlow::Continue(()), lean)?;
    for (name, lean) in ["aware", "baseline"].iter().zip(leans) {
        println!("{name}: {lean:.1} deg at most");
    }
    Ok(())
}
// --8<-- [end:wind]

// --8<-- [start:own_loop]
fn measure(plant: &Plant, measurement: &mut Measurement) {
    measurement.state.copy_from(plant.state());
    measurement.thrust.copy_from_slice(plant.jets().thrust_feedback());
}

fn own_loop(config: &ScenarioConfig) -> Result<(), Box<dyn Error>> {
    let robot = load_robot(&config.robot)?;
    let time_step = config.controller.law.time_step;
    let robot_joints = robot.joints.len();
    let mut plant =
        Plant::new(robot.clone(), &config.simulator, &config.disturbances, &config.controller.law)?; // replace by your robot
    let mut controller = load_controller(robot, &config.controller, &config.mission)?;
    let wind = Vector3::new(0.0, -5.0, 0.0);
    let mut measurement = Measurement::zero(robot_joints, controller.n_jets(), 0);
    measurement.wind = wind;
    measure(&plant, &mut measurement);
    let mut state = controller.start(&measurement)?; // position, attitude and posture become the reference

    for tick in 0..200 {
        plant.observe(&wind);
        measurement.time = f64::from(tick) * time_step;
        measure(&plant, &mut measurement);
        if tick == 100 {
            measurement.state.base.position.fill(f64::NAN); // not measured
        }
        let command = controller.tick(&mut state, &measurement);
        if !command.modes.is_empty() {
            println!("{:.2} s: {}", measurement.time, command.modes);
        }
        plant.advance(command.joint_torque.as_slice(), command.thrust_rate.as_slice(), &wind, time_step);
    }
    println!("after 2 s: height {:.3} m", plant.kinematics().com.z);
    Ok(())
}
// --8<-- [end:own_loop]

// --8<-- [start:own_task]
/// Demands a velocity of one joint: `ṡ_j − v = 0`, an equation with one unknown.
#[derive(Debug)]
struct KeepVelocity {
    unknown: usize,
    velocity: f64,
    weight: f64,
}

impl Task for KeepVelocity {
    fn name(&self) -> &'static str {
        "keep velocity"
    }

    fn layout(&self) -> Layout {
        Layout::Diagonal { first: self.unknown, weights: vec![self.weight] }
    }

    fn update(&self, _: &TaskInputs, equations: &mut Equations) {
        equations.offset[0] = -self.velocity;
    }
}

fn own_task(config: &ScenarioConfig) -> Result<(), Box<dyn Error>> {
    let robot = load_robot(&config.robot)?;
    let plant = Plant::new(robot.clone(), &config.simulator, &config.disturbances, &config.controller.law)?;
    let mut controller = load_controller(robot, &config.controller, &config.mission)?;
    let joints = controller.terms().momentum_qp.unknowns.joint_velocity.clone();
    controller.add_task(Arc::new(KeepVelocity { unknown: joints.start, velocity: 0.1, weight: 1e6 }))?;

    let mut measurement = Measurement::zero(plant.robot().joints.len(), controller.n_jets(), 0);
    measure(&plant, &mut measurement);
    let mut state = controller.start(&measurement)?;
    let command = controller.tick(&mut state, &measurement);
    println!("first joint asked to turn at {:.3} rad/s", command.joint_velocity[0]);
    Ok(())
}
// --8<-- [end:own_task]

// --8<-- [start:own_aero]
/// Flat plates perpendicular to the wind: `0.5 ρ A |v| v` on every link.
fn own_aero(config: &ScenarioConfig) -> Result<(), Box<dyn Error>> {
    let mut plant = Plant::new(
        load_robot(&config.robot)?,
        &config.simulator,
        &config.disturbances,
        &config.controller.law,
    )?;
    let (wind, area) = (Vector3::new(0.0, -5.0, 0.0), 0.05);
    let (no_torque, no_rate) = ([0.0; 23], [0.0; 4]);
    for _ in 0..10 {
        plant.observe(&wind);
        let plate = |v: &Vector3<f64>| 0.6 * area * v.norm() * v;
        let forces = plant.link_forces().v_air_i.iter().map(plate).collect();
        plant.replace_link_forces(Some(forces))?;
        plant.advance(&no_torque, &no_rate, &wind, config.controller.law.time_step);
    }
    println!("pushed to y = {:.4} m", plant.kinematics().com.y);
    Ok(())
}
// --8<-- [end:own_aero]

// --8<-- [start:own_robot]
fn own_robot() -> Result<(), Box<dyn Error>> {
    let robot = load_robot(&configs("robot/sparrow.toml"))?;
    println!("{}: {} joints, {} jets", robot.name, robot.joints.len(), robot.jets.len());

    // A controller is tuned for a robot: its gains refer to joint groups and jets by name.
    let config = load_scenario(&configs("experiments/test2.toml"))?;
    match load_controller(robot, &config.controller, &config.mission) {
        Ok(_) => Err("gains of another robot were accepted".into()),
        Err(refusal) => {
            println!("{refusal}");
            Ok(())
        }
    }
}
// --8<-- [end:own_robot]

pub(crate) fn main() -> Result<(), Box<dyn Error>> {
    let config = hover()?;
    wind(config.clone())?;
    own_loop(&config)?;
    own_task(&config)?;
    own_aero(&config)?;
    own_robot()
}

//! A state that is restored continues to the same bits: whatever flies, whatever fails, and whatever else its controller has
//! ticked before.

#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]

use crate::common::{at, every_controller, loaded, outage};
use flight_core::control::estimate::joint_tracker::JointMeasurement;
use flight_core::robot::Joint;
use flight_core::{Controller, Measurement, RobotModel};
use flight_io::load_robot;
use flight_sim::disturbances::{
    FailureKind, JetFailure, JointFault, JointFaultKind, OutageChannel, OutageKind, Outages,
};
use flight_sim::{Plant, ScenarioConfig};
use nalgebra::Vector3;

/// When faults begin, and how long a flight is \[s\].
const FAULT: f64 = 0.15;
const DURATION: f64 = 0.65;
/// Of how many ticks one is restored.
const EVERY: usize = 5;

type Spoil = fn(&RobotModel, &mut ScenarioConfig);

fn lose(kind: FailureKind, robot: &RobotModel, config: &mut ScenarioConfig) {
    let decay = 0.0;
    config.disturbances.jets.failure =
        robot.jets.first().map(|jet| JetFailure { jet: jet.name.clone(), time: FAULT, kind, decay });
}

fn spoil(channel: OutageChannel, kind: OutageKind, config: &mut ScenarioConfig) {
    config.disturbances.outages = vec![outage(channel, kind, FAULT, Some(0.3))];
}

/// Faults of engines and joints, and measurements that are missing, frozen and wrong.
const FAULTS: [(&str, Spoil); 9] = [
    ("none", |_, _| ()),
    ("an engine stops", |robot, config| lose(FailureKind::Off, robot, config)),
    ("an engine is stuck", |robot, config| lose(FailureKind::Stuck, robot, config)),
    ("a joint does not act", |robot, config| {
        let fault = |joint: &Joint| {
            let joint = joint.name.clone();
            JointFault { joint, kind: JointFaultKind::Free, start: FAULT }
        };
        config.disturbances.joints = robot.joints.first().map(fault).into_iter().collect();
    }),
    ("no thrusts", |_, config| spoil(OutageChannel::Thrust, OutageKind::Missing, config)),
    ("frozen joints", |_, config| spoil(OutageChannel::Joints, OutageKind::Frozen, config)),
    ("no wind", |_, config| spoil(OutageChannel::Wind, OutageKind::Nan, config)),
    ("no velocity", |_, config| spoil(OutageChannel::BaseVelocity, OutageKind::Missing, config)),
    ("a wrong attitude", |_, config| spoil(OutageChannel::BaseRotation, OutageKind::Wrong, config)),
];

/// The commands of a tick and of the ticks of the torques after it, as bits, and the state.
fn ticked(
    controller: &mut Controller,
    state: &mut flight_core::control::ControllerState,
    sample: &Measurement,
    torque_steps: u32,
) -> Vec<u64> {
    let mut bits = Vec::new();
    let mut keep = |command: &flight_core::Command| {
        let numbers = command.thrust_rate.iter().chain(&command.joint_velocity).chain(&command.joint_torque);
        bits.extend(numbers.map(|number| number.to_bits()));
        bits.extend([u64::from(command.modes.bits()), command.rates_qp.kkt.to_bits()]);
    };
    keep(controller.tick(state, sample));
    let (position, velocity) = (sample.state.joint_position.as_slice(), sample.state.joint_velocity());
    for _ in 1..torque_steps {
        keep(controller.tick_torques(state, &JointMeasurement { position, velocity }));
    }
    bits
}

/// At ten ticks of flights with each kind of fault a clone gives the same commands and the same state: in a controller that
/// ticked something else before, in one that has not ticked, and in the same one twice.
#[test]
fn a_restored_state_continues_to_the_same_bits() {
    for (name, mut config) in every_controller() {
        config.simulator.ground = None; // the wrenches of the feet are made up
        let robot = load_robot(&config.robot).unwrap();
        let (steps, time_step) = (config.controller.law.torque.steps, config.controller.law.time_step);
        let mut used = config.controller(robot.clone()).unwrap();
        for (fault, spoil) in FAULTS {
            let mut config = config.clone();
            spoil(&robot, &mut config);
            let law = &config.controller.law;
            let mut plant = Plant::new(robot.clone(), &config.simulator, &config.disturbances, law).unwrap();
            let mut outages = Outages::new(&config.disturbances.outages, &robot.jets).unwrap();
            let mut controller = config.controller(robot.clone()).unwrap();
            let feet = loaded(controller.model().feet.len());
            let (mut tick, mut restored, mut state) = (0_usize, 0, None);
            while (tick as f64) * time_step < DURATION {
                let time = tick as f64 * time_step;
                let wind = Vector3::new(1.0, -6.0 + (5.0 * time).sin(), 0.3);
                plant.observe(&wind);
                let mut sample = Measurement {
                    wind,
                    foot_wrenches: feet.clone(),
                    ..at(time, plant.state(), plant.jets().thrust_feedback())
                };
                outages.spoil(time, &mut sample);
                let state = state.get_or_insert_with(|| controller.start(&sample).unwrap());
                let before = state.clone();
                let bits = ticked(&mut controller, state, &sample, steps);
                if time >= FAULT && tick.is_multiple_of(EVERY) {
                    restored += 1;
                    let mut fresh = (restored % 5 == 0).then(|| config.controller(robot.clone()).unwrap());
                    for controller in [&mut used, &mut controller].into_iter().chain(&mut fresh) {
                        let mut again = before.clone();
                        assert_eq!(
                            ticked(controller, &mut again, &sample, steps),
                            bits,
                            "{name}, {fault}: commands at {time} s"
                        );
                        // Text too, since what is missing is NaN.
                        let is_same = again == *state || format!("{again:?}") == format!("{state:?}");
                        assert!(is_same, "{name}, {fault}: the state at {time} s");
                    }
                }
                let command = controller.command();
                plant.advance(
                    command.joint_torque.as_slice(),
                    command.thrust_rate.as_slice(),
                    &wind,
                    time_step,
                );
                tick += 1;
            }
            assert!(restored >= 10, "{name}: {restored}");
        }
    }
}

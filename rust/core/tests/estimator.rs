//! The state estimator: with the world's own model it is ahead of any delay; each channel is corrected by its share.

#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]

use crate::common::{Loop, assert_within, at, experiment, read, robot, uniform_estimator};
use flight_core::control::acting::Acting;
use flight_core::control::estimate::estimator::{
    EstimatorConfig, EstimatorState, FilterConfig, LatencyConfig,
};
use flight_core::control::{Command, Modes};
use flight_core::jets::JetDynamics;
use flight_core::{Estimator, Measurement, RobotModel, RobotState};
use flight_io::{load_aero, load_robot};
use flight_sim::sensors::{EncoderConfig, SensorConfig, ThrustSensorConfig};
use flight_sim::{ScenarioConfig, Sensors, SensorsConfig};
use nalgebra::{DVector, Vector3, Vector6};

const STEP: f64 = 0.01;
const WIND: Vector3<f64> = Vector3::new(1.0, -6.0, 0.5);

fn late(delay: f64) -> FilterConfig {
    FilterConfig { delay, ..FilterConfig::default() }
}

/// Every channel has its own age.
fn ages() -> (SensorsConfig, EstimatorConfig) {
    let sensor = |delay| SensorConfig { delay, ..SensorConfig::default() };
    let sensors = SensorsConfig {
        base_position: sensor(0.05),
        base_rotation: sensor(0.04),
        base_linear_velocity: sensor(0.03),
        base_angular_velocity: sensor(0.0),
        joints: EncoderConfig { delay: 0.01, ..EncoderConfig::default() },
        thrust: ThrustSensorConfig { delay: 0.02, ..ThrustSensorConfig::default() },
        ..SensorsConfig::default()
    };
    let estimator = EstimatorConfig {
        base_position: late(0.05),
        base_rotation: late(0.04),
        base_linear_velocity: late(0.03),
        base_angular_velocity: late(0.0),
        joint_position: late(0.01),
        joint_velocity: late(0.01),
        thrust: late(0.02),
        ..EstimatorConfig::default()
    };
    (sensors, estimator)
}

fn flight(estimator: EstimatorConfig) -> ScenarioConfig {
    let mut config = experiment("test2_observer");
    config.simulator.joint_stops = false;
    config.controller.law.estimator = Some(estimator);
    config
}

/// The world of this flight, whose controller is given the truth.
fn world(config: &ScenarioConfig) -> Loop {
    let mut config = config.clone();
    config.controller.law.estimator = None;
    Loop::new(&config)
}

/// An estimator and its state.
struct Estimating {
    estimator: Estimator,
    state: EstimatorState,
    /// Time since the last measurement \[s\].
    elapsed: f64,
}

impl Estimating {
    fn update(&mut self, state: &RobotState, thrust: &[f64]) -> Measurement {
        let mut innovation = vec![0.0; thrust.len()];
        let mut rates = innovation.clone();
        let next = self.state.next_measurement();
        (next.state, next.thrust) = (state.clone(), thrust.to_vec());
        self.estimator.update(&mut self.state, self.elapsed, &mut innovation, &mut rates).clone()
    }

    fn command(&mut self, command: &Command, unmodelled: &Vector6<f64>) {
        let mut acting = Acting::new(command.joint_torque.len(), command.thrust_rate.len(), 2);
        acting.thrust_rate.copy_from(&command.thrust_rate);
        acting.torque.copy_from(&command.joint_torque);
        self.state.command(&acting, unmodelled, &WIND);
    }
}

fn estimator(config: &ScenarioConfig) -> Estimating {
    let robot = load_robot(&config.robot).unwrap();
    let aero = load_aero(&config.controller.aero, &robot).unwrap();
    let settings = config.controller.law.estimator.as_ref().unwrap();
    let estimator = Estimator::new(settings, robot, JetDynamics::Ideal, aero, STEP).unwrap();
    let initial = &config.simulator.initial;
    Estimating {
        state: estimator.start(&reading(&initial.state(), &initial.thrust)),
        estimator,
        elapsed: STEP,
    }
}

/// State and thrusts of a robot with two feet.
fn reading(state: &RobotState, thrust: &[f64]) -> Measurement {
    Measurement {
        state: state.clone(),
        thrust: thrust.to_vec(),
        ..Measurement::zero(state.n_joints(), thrust.len(), 2)
    }
}

/// Largest difference of everything in two readings.
fn distance(a: &Measurement, b: &Measurement) -> f64 {
    let thrusts = a.thrust.iter().zip(&b.thrust).map(|(a, b)| (a - b).abs());
    [
        (a.state.base.position - b.state.base.position).amax(),
        (a.state.base.rotation - b.state.base.rotation).amax(),
        (&a.state.joint_position - &b.state.joint_position).amax(),
        (&a.state.velocity - &b.state.velocity).amax(),
    ]
    .into_iter()
    .chain(thrusts)
    .fold(0.0, f64::max)
}

/// The controller flies on the truth; the estimator, whose measurements are late, finds it all the same.
#[test]
fn with_the_worlds_own_model_it_is_ahead_of_every_delay() {
    let (late, settings) = ages();
    let config = flight(settings);
    let mut estimator = estimator(&config);
    let mut world = world(&config);
    let (joints, jets) = (23, 4);
    let mut sensors = Sensors::new(&late, STEP, joints, jets).unwrap();
    for tick in 0..60 {
        world.observe(&WIND);
        let (state, thrust) = (world.plant.state(), world.plant.jets().thrust());
        let truth = reading(state, thrust);
        let mut said = truth.clone();
        sensors.read(&mut said);
        let found = estimator.update(&said.state, &said.thrust);
        assert_within!(distance(&found, &truth), 1e-9, because "measured exactly, predicted over five ticks by the same equations in another order", "tick {tick}");
        estimator.command(world.controller.command(), &Vector6::zeros());
        world.advance(&WIND);
    }
}

/// Thrusts that fall by 10 N in a tick end at their least; that of an engine that has stopped stays.
#[test]
fn a_predicted_thrust_ends_at_its_least() {
    let config = flight(EstimatorConfig { thrust: late(0.02), ..EstimatorConfig::default() });
    let robot = load_robot(&config.robot).unwrap();
    let aero = load_aero(&config.controller.aero, &robot).unwrap();
    let settings = config.controller.law.estimator.as_ref().unwrap();
    let mut running = robot.clone();
    running.jets.iter_mut().for_each(|jet| jet.thrust_min = 11.0);
    let state = config.simulator.initial.state();
    let after = |robot: RobotModel| {
        let estimator = Estimator::new(settings, robot, JetDynamics::Ideal, aero.clone(), STEP).unwrap();
        let start = estimator.start(&reading(&state, &[90.0, 18.0, 13.0, 2.0]));
        let mut estimating = Estimating { state: start, estimator, elapsed: STEP };
        let command = Command {
            thrust_rate: DVector::from_element(4, -1000.0),
            ..Loop::new(&config).controller.command().clone()
        };
        for _ in 0..2 {
            estimating.command(&command, &Vector6::zeros());
            estimating.update(&state, &[f64::NAN; 4]);
        }
        estimating.update(&state, &[f64::NAN; 4]).thrust
    };
    assert_eq!(
        (after(running)[1..].to_vec(), after(robot)[1..].to_vec()),
        (vec![11.0, 11.0, 2.0], vec![8.0, 3.0, 0.0])
    );
}

/// Torques act two ticks late and thrust rates five: the estimate is the state in which the torques of this tick begin
/// to act, with the thrusts of then, from exact measurements and from those that are late as well; also
/// where the latency of the torques is found during the flight.
#[test]
fn with_late_commands_it_is_the_state_in_which_they_act() {
    const TORQUE: usize = 2;
    const THRUST: usize = 5;
    const FOUND: usize = 10;
    let worlds = || [(SensorsConfig::default(), EstimatorConfig::default()), ages()];
    let known = [(0.02, 0), (0.0, FOUND), (0.05, FOUND)].into_iter();
    for ((sensors, settings), (torque, start)) in known.flat_map(|known| worlds().map(|world| (world, known)))
    {
        let latency = LatencyConfig { torque, thrust: 0.05 };
        let config = flight(EstimatorConfig { latency, ..settings });
        let mut estimator = estimator(&config);
        let mut world = world(&config);
        let mut sensors = Sensors::new(&sensors, STEP, 23, 4).unwrap();
        let (mut sent, mut found): (Vec<Command>, Vec<Measurement>) = (Vec::new(), Vec::new());
        for tick in 0..40 {
            world.observe(&WIND);
            let (state, thrust) = (world.plant.state(), world.plant.jets().thrust());
            let truth = reading(state, thrust);
            if tick == FOUND {
                estimator.state.use_torque_latency(0.02);
            }
            if tick > TORQUE + start {
                assert_within!(distance(&found[tick - TORQUE], &truth), 1e-9, because "two steps of the same equations in another order", "tick {tick}");
            }
            let mut said = truth.clone();
            sensors.read(&mut said);
            found.push(estimator.update(&said.state, &said.thrust));
            sent.push(world.controller.command().clone());
            estimator.command(&sent[tick], &Vector6::zeros());
            let torque = sent[tick.saturating_sub(TORQUE)].joint_torque.as_slice();
            let rate = sent[tick.saturating_sub(THRUST)].thrust_rate.as_slice();
            world.plant.advance(torque, rate, &WIND, STEP);
            world.tick += 1;
        }
    }
}

/// Torques act two and a half ticks late, thrust rates five: the estimate is the state within the tick in which the torques
/// begin to act, under those of the tick before until then; a step has the mean of the torques that act in it.
#[test]
fn with_a_part_of_a_tick_it_is_a_state_within_one() {
    const TORQUE: usize = 2;
    const THRUST: usize = 5;
    let latency = LatencyConfig { torque: 0.025, thrust: 0.05 };
    let config = flight(EstimatorConfig { latency, ..EstimatorConfig::default() });
    let (mut estimator, mut world) = (estimator(&config), world(&config));
    let (mut sent, mut found): (Vec<Command>, Vec<Measurement>) = (Vec::new(), Vec::new());
    for tick in 0..20 {
        world.observe(&WIND);
        let (state, thrust) = (world.plant.state(), world.plant.jets().thrust());
        found.push(estimator.update(state, thrust));
        sent.push(world.controller.command().clone());
        estimator.command(&sent[tick], &Vector6::zeros());
        let before = |ticks: usize| &sent[tick.saturating_sub(ticks)];
        let (first, then) = (&before(TORQUE + 1).joint_torque, &before(TORQUE).joint_torque);
        let rate = before(THRUST).thrust_rate.as_slice();
        let mut within = world.plant.clone();
        within.advance(first.as_slice(), rate, &WIND, 0.5 * STEP);
        if tick > TORQUE {
            let truth = reading(within.state(), within.jets().thrust());
            assert_within!(distance(&found[tick - TORQUE], &truth), 1e-9, because "three steps of the same equations in another order", "tick {tick}");
        }
        let mean = 0.5 * (first + then);
        world.plant.advance(mean.as_slice(), rate, &WIND, STEP);
        world.tick += 1;
    }
}

/// Ticks that come late are as long as they are: commands act, and joints move, for all of that time.
#[test]
fn a_longer_tick_is_predicted_as_long_as_it_is() {
    let slow = uniform_estimator(FilterConfig { delay: 0.0, time_constant: 1e9 });
    let observed = EstimatorConfig { joint_observer: Some(0.05), ..EstimatorConfig::default() };
    for settings in [slow, observed] {
        let config = flight(settings);
        let mut estimator = estimator(&config);
        let mut world = world(&config);
        for tick in 0..12_i32 {
            world.observe(&WIND);
            let (state, thrust) = (world.plant.state(), world.plant.jets().thrust());
            let truth = reading(state, thrust);
            let found = estimator.update(state, thrust);
            assert_within!(distance(&found, &truth), 1e-9, because "one step of the same equations in another order", "tick {tick}");
            let command = world.controller.command();
            estimator.command(command, &Vector6::zeros());
            estimator.elapsed = STEP * f64::from(1 + tick % 3);
            let (torque, rate) = (command.joint_torque.as_slice(), command.thrust_rate.as_slice());
            world.plant.advance(torque, rate, &WIND, estimator.elapsed);
            world.tick += 1;
        }
    }
}

/// Two estimators with the same measurements but for one channel at one tick differ there, by its share.
#[test]
fn every_channel_is_corrected_by_its_share() {
    type Change = fn(&mut Measurement);
    type Read = fn(&Measurement) -> f64;
    let gyro = |r: &Measurement| (r.state.base.rotation.transpose() * r.state.base_angular_velocity()).y;
    let cases: [(usize, Change, Read); 7] = [
        (0, |r| r.state.base.position.z += 0.1, |r| r.state.base.position.z),
        (
            1,
            |r| r.state.base.rotation *= flight_core::spatial::exp_so3(&Vector3::new(0.0, 0.1, 0.0)),
            |r| flight_core::spatial::log_so3(&r.state.base.rotation).y,
        ),
        (2, |r| r.state.velocity[2] += 0.1, |r| r.state.velocity[2]),
        (3, |r| r.state.velocity[4] += 0.1, gyro),
        (4, |r| r.state.joint_position[3] += 0.1, |r| r.state.joint_position[3]),
        (5, |r| r.state.velocity[6 + 3] += 0.1, |r| r.state.velocity[6 + 3]),
        (6, |r| r.thrust[2] += 0.1, |r| r.thrust[2]),
    ];
    let mut settings = EstimatorConfig::default();
    let [a, b, c, d, e, f, g] = [0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07]
        .map(|time_constant| FilterConfig { delay: 0.0, time_constant });
    (settings.base_position, settings.base_rotation, settings.base_linear_velocity) = (a, b, c);
    (settings.base_angular_velocity, settings.joint_position, settings.joint_velocity, settings.thrust) =
        (d, e, f, g);
    let time_constants = [0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07];
    let config = flight(settings);
    let world = world(&config);
    let mut still = reading(world.plant.state(), world.plant.jets().thrust());
    still.state.base.rotation = nalgebra::Matrix3::identity();
    still.state.velocity.fill(0.0);
    for (channel, change, read) in cases {
        let found = [false, true].map(|is_changed| {
            let mut estimator = estimator(&config);
            estimator.update(&still.state, &still.thrust);
            let mut said = still.clone();
            if is_changed {
                change(&mut said);
            }
            estimator.update(&said.state, &said.thrust)
        });
        let share = 1.0 - (-STEP / time_constants[channel]).exp();
        let moved = read(&found[1]) - read(&found[0]);
        // A rotation that is corrected turns what the gyroscopes say, which is next to nothing here.
        assert_within!((moved - 0.1 * share).abs(), 1e-3 * share, because "the estimate has fallen for a tick: turns and differences of second order", "channel {channel}: {moved}");
        let others = (0..7).filter(|other| *other != channel && !(channel == 1 && *other == 3));
        for other in others {
            let moved = cases[other].2(&found[1]) - cases[other].2(&found[0]);
            assert_within!(moved.abs(), 1e-3 * share, because "as above", "channel {channel} moves {other}");
        }
    }
}

/// What the base measures in every fourth tick alone corrects as much as in four ticks, also while it is on its way.
#[test]
fn a_measurement_after_a_gap_corrects_for_all_of_it() {
    for delay in [0.0, 0.02] {
        let channel = FilterConfig { delay, time_constant: 0.05 };
        let config = flight(EstimatorConfig { base_position: channel, ..EstimatorConfig::default() });
        let mut still = world(&config).plant.state().clone();
        still.velocity.fill(0.0);
        let thrust = config.simulator.initial.thrust.clone();
        let found = [(0, 1), (1, 1), (0, 4), (1, 4)].map(|(has_moved, period)| {
            let mut estimator = estimator(&config);
            let ticks = (0..=24).map(|tick| {
                let mut state = still.clone();
                state.base.position.z += if tick == 0 { 0.0 } else { 0.1 * f64::from(has_moved) };
                if tick % period != 0 {
                    state.base.position.fill(f64::NAN);
                }
                estimator.update(&state, &thrust).state.base.position.z
            });
            ticks.collect::<Vec<_>>()
        });
        for tick in (8..=24).step_by(4) {
            let [every, fourth] = [0, 2].map(|first| found[first + 1][tick] - found[first][tick]);
            assert!(every > 0.01);
            assert_within!((every - fourth).abs(), 1e-12, because "the same factors in another order", "tick {tick}");
        }
    }
}

/// Force and moment of the momentum are estimated as late as velocity and gyroscopes are, age and time constant together.
#[test]
fn the_momentum_is_known_as_late_as_the_velocities() {
    let shares = |config| estimator(&flight(config)).estimator.momentum_fractions;
    let old = EstimatorConfig {
        base_linear_velocity: FilterConfig { delay: 0.03, time_constant: 0.04 },
        base_angular_velocity: FilterConfig { delay: 0.0, time_constant: 0.02 },
        ..ages().1
    };
    for (share, time) in shares(old).into_iter().zip([0.07_f64, 0.02]) {
        assert_within!((share + (-STEP / time).exp_m1()).abs(), 1e-15);
    }
    assert!(shares(EstimatorConfig::default()).iter().all(|share| share.total_cmp(&1.0).is_eq()));
}

/// What is measured at once is not predicted from what is as old as the oldest: encoders that say something else than the
/// model are followed in the same tick.
#[test]
fn a_late_channel_delays_no_other() {
    let config = flight(EstimatorConfig { base_position: late(0.05), ..EstimatorConfig::default() });
    let mut estimator = estimator(&config);
    let mut world = world(&config);
    for tick in 0..20 {
        world.observe(&WIND);
        let (mut state, thrust) = (world.plant.state().clone(), world.plant.jets().thrust());
        state.joint_position.add_scalar_mut(0.02 * f64::from(tick).sin());
        let found = estimator.update(&state, thrust).state.joint_position;
        assert_within!((found - &state.joint_position).amax(), 1e-14, because "one rounding of a correction", "tick {tick}");
        estimator.command(world.controller.command(), &Vector6::zeros());
        world.advance(&WIND);
    }
}

/// The bias of the gyroscopes is what turns the estimate away from the measured rotation, and is held without one.
#[test]
fn the_bias_of_the_gyroscopes_is_estimated_from_the_rotation() {
    let bias = [0.03, -0.02, 0.01];
    let biased = SensorsConfig {
        base_angular_velocity: SensorConfig { bias, ..SensorConfig::default() },
        ..SensorsConfig::default()
    };
    let filtered = |time_constant| FilterConfig { delay: 0.0, time_constant };
    for (gyro_bias, share) in [(None, 1.0), (Some(0.2), 0.0)] {
        let config = flight(EstimatorConfig {
            base_rotation: filtered(0.05),
            base_angular_velocity: filtered(0.02),
            gyro_bias,
            ..EstimatorConfig::default()
        });
        let mut estimator = estimator(&config);
        let mut world = world(&config);
        let mut sensors = Sensors::new(&biased, STEP, 23, 4).unwrap();
        for tick in 0..240 {
            world.observe(&WIND);
            let (state, thrust) = (world.plant.state(), world.plant.jets().thrust());
            let mut said = read(&mut sensors, state, thrust);
            if tick > 200 {
                said.state.base.rotation.fill(f64::NAN);
            }
            let found = estimator.update(&said.state, &said.thrust).state;
            let error = found.base.rotation.transpose() * found.base_angular_velocity()
                - state.base.rotation.transpose() * state.base_angular_velocity();
            if tick > 150 {
                let off = (error - share * Vector3::from(bias)).amax();
                assert_within!(off, 1e-3, because "a thirtieth of the bias", "tick {tick}: {error}");
            }
            estimator.command(world.controller.command(), &Vector6::zeros());
            world.advance(&WIND);
        }
    }
}

/// A wrench that is in no model moves the whole robot: its momentum as it says, no joint.
#[test]
fn an_unmodelled_wrench_moves_the_whole_robot() {
    let config = flight(uniform_estimator(FilterConfig { delay: 0.0, time_constant: 1e9 }));
    let mut world = world(&config);
    world.observe(&WIND);
    let wrench = Vector6::new(30.0, -20.0, 10.0, 2.0, -3.0, 1.5);
    let model = robot("ironcub_mk1");
    let mut dynamics = flight_core::dynamics::Dynamics::new(&model);
    let mut kinematics = flight_core::kinematics::Kinematics::new(&model);
    let found = [Vector6::zeros(), wrench].map(|unmodelled| {
        let mut estimator = estimator(&config);
        let (state, thrust) = (world.plant.state(), world.plant.jets().thrust());
        estimator.update(state, thrust);
        estimator.command(world.controller.command(), &unmodelled);
        estimator.update(state, thrust)
    });
    // The momentum matrix of the state before the step, with which the step was taken.
    kinematics.update(&model, world.plant.state());
    dynamics.update(&model, world.plant.state(), &kinematics);
    let difference = &found[1].state.velocity - &found[0].state.velocity;
    let gained = &dynamics.momentum_matrix * &difference;
    let error = (gained - STEP * wrench).amax();
    assert_within!(error, 1e-9, because "a step of 10 ms, and corrections by 1e-11 of what differs", "{gained}");
    assert_within!(difference.rows(6, 23).amax(), 1e-9, because "corrections by 1e-11 of what differs");
}

/// After a restart the last inputs stand for all before: what came earlier changes nothing.
#[test]
fn a_restart_forgets_all_but_the_last_inputs() {
    let (_, settings) = ages();
    let late = LatencyConfig { torque: 0.03, thrust: 0.05 };
    let config = flight(EstimatorConfig { latency: late, ..settings });
    let robot = load_robot(&config.robot).unwrap();
    let aero = load_aero(&config.controller.aero, &robot).unwrap();
    let settings = config.controller.law.estimator.as_ref().unwrap();
    let mut law = Estimator::new(settings, robot, JetDynamics::Ideal, aero, STEP).unwrap();
    let first = reading(&config.simulator.initial.state(), &config.simulator.initial.thrust);
    let mut restarted = |ticks: u8, earlier: f64| {
        let mut state = law.start(&first);
        let (mut innovation, mut rates) = (vec![0.0; 4], vec![0.0; 4]);
        let mut acting = Acting::new(first.state.n_joints(), 4, 2);
        for tick in 0..=ticks {
            if tick == ticks {
                state.restart();
            }
            state.next_measurement().clone_from(&first);
            law.update(&mut state, STEP, &mut innovation, &mut rates);
            acting.thrust_rate.fill(if tick + 1 == ticks { 20.0 } else { earlier });
            state.command(&acting, &Vector6::zeros(), &WIND);
        }
        (rates, innovation)
    };
    // More ticks than inputs are stored, and fewer.
    for ticks in [3, 25, 26] {
        let found = restarted(ticks, 0.0);
        assert_eq!(found, restarted(ticks, -50.0));
        assert_eq!(found.0, [20.0; 4]);
    }
}

/// Thrusts that are not what they seem push the arms: without learning that, the joints' velocities are wrong all the time.
/// The observer finds both from positions alone, its velocities are those of no sensor.
#[test]
fn what_the_model_does_not_explain_of_the_joints_is_learnt() {
    let follow = FilterConfig { delay: 0.0, time_constant: 0.04 };
    let found = [None, Some(0.02)].map(|joint_observer| {
        let config =
            flight(EstimatorConfig { joint_velocity: follow, joint_observer, ..EstimatorConfig::default() });
        let (mut world, mut estimator) = (world(&config), estimator(&config));
        let (mut error, mut momentum_error) = (0.0_f64, 0.0_f64);
        for tick in 0..150 {
            world.observe(&WIND);
            let state = world.plant.state();
            let seeming: Vec<f64> = world.plant.jets().thrust().iter().map(|thrust| thrust + 2.0).collect();
            let mut said = state.clone();
            if joint_observer.is_some() {
                said.velocity.rows_mut(6, 23).fill(0.0);
            }
            let found = estimator.update(&said, &seeming);
            if tick >= 100 {
                let difference = &found.state.velocity - &state.velocity;
                error = error.max(difference.rows(6, 23).amax());
                momentum_error = momentum_error.max(difference.rows(0, 6).amax());
            }
            estimator.command(world.controller.command(), &Vector6::zeros());
            world.advance(&WIND);
        }
        (error, momentum_error)
    });
    assert!(found[0].0 > 0.2, "{found:?}");
    assert!(found[1].0 < 0.1 * found[0].0, "{found:?}");
    // The base is measured as it is: its velocities are taken as they come.
    assert!(found[1].1 < 1e-9, "{found:?}");
}

#[test]
fn a_measurement_that_is_no_number_corrects_nothing() {
    let config = flight(EstimatorConfig::default());
    let world = world(&config);
    let (state, thrust) = (world.plant.state(), world.plant.jets().thrust());
    let mut estimator = estimator(&config);
    estimator.update(state, thrust);
    let mut wrong = state.clone();
    wrong.velocity[7] = f64::NAN;
    let coasting = estimator.update(&wrong, thrust);
    // What is missing is the model's, everything else is taken as it comes.
    assert!(coasting.state.velocity[7].is_finite());
    let (mut found, mut given) = (coasting.state.velocity.clone(), state.velocity.clone());
    (found[7], given[7]) = (0.0, 0.0);
    assert_within!((found - given).amax(), 1e-15, because "taken as it comes");
    let back = estimator.update(state, thrust);
    assert!(distance(&back, &reading(state, thrust)) < 1e-14);
}

/// One thrust sensor that is lost for good is modelled; every other channel is corrected as if nothing had happened. So
/// it is where the sensor is lost from the first tick on.
#[test]
fn a_lost_channel_leaves_the_others_corrected() {
    for lost_at in [0, 10] {
        let slow = || FilterConfig { delay: 0.02, time_constant: 0.05 };
        let config = flight(EstimatorConfig {
            joint_position: slow(),
            base_position: slow(),
            ..EstimatorConfig::default()
        });
        let mut world = world(&config);
        let [mut whole, mut half] = [estimator(&config), estimator(&config)];
        for tick in 0..60 {
            world.observe(&WIND);
            let (state, thrust) = (world.plant.state().clone(), world.plant.jets().thrust().to_vec());
            let mut measured = thrust.clone();
            if tick >= lost_at {
                measured[2] = f64::NAN;
            }
            let expected = whole.update(&state, &thrust);
            let mut found = half.update(&state, &measured);
            assert_within!((found.thrust[2] - expected.thrust[2]).abs(), 1e-6, because "it begins as it was");
            found.thrust[2] = expected.thrust[2];
            // Jets are ideal here: they do what is commanded, as the model has it.
            assert_within!(distance(&found, &expected), 1e-6, because "rounding, in a flight that magnifies it");
            for estimator in [&mut whole, &mut half] {
                estimator.command(world.controller.command(), &Vector6::zeros());
            }
            world.advance(&WIND);
        }
    }
}

/// An absurd number spoils nothing for good, also where it is the first.
#[test]
fn absurd_numbers_pass() {
    let config = flight(EstimatorConfig::default());
    let world = world(&config);
    let (state, thrust) = (world.plant.state(), world.plant.jets().thrust());
    for absurd in [1e5, 1e300, f64::INFINITY, f64::NAN] {
        let mut estimator = estimator(&config);
        let mut wrong = state.clone();
        wrong.velocity[7] = absurd;
        for said in [&wrong, state, &wrong, state, state] {
            estimator.update(said, thrust);
        }
        let back = estimator.update(state, thrust);
        assert!(distance(&back, &reading(state, thrust)) < 1e-14, "{absurd}");
    }
}

/// A sensor that is found to be wrong is not used any more, and what it added to the estimate before is taken out: the
/// estimate comes to the true thrust, though it was wrong by as much.
#[test]
fn the_estimate_loses_what_a_wrong_sensor_put_into_it() {
    // Thrusts wait for positions.
    let slow = FilterConfig { delay: 0.02, time_constant: 0.05 };
    let settings = EstimatorConfig { thrust: slow, base_position: late(0.05), ..EstimatorConfig::default() };
    let mut world = Loop::new(&flight(settings));
    let (mut before, mut after) = (vec![], vec![]);
    for tick in 0..200 {
        world.plant.observe(&WIND);
        let truth = world.plant.jets().thrust().to_vec();
        let mut thrust = truth.clone();
        if tick >= 100 {
            thrust[2] += 40.0;
        }
        let (time, state) = (f64::from(tick) * STEP, world.plant.state());
        world.controller.tick(&Measurement { wind: WIND, ..at(time, state, &thrust) });
        let is_found = world.controller.command().modes.contains(Modes::THRUST_MODELLED);
        let errors = if is_found { &mut after } else { &mut before };
        errors.push(world.controller.state().estimate().robot.thrust[2] - truth[2]);
        world.advance(&WIND);
    }
    assert!((5..20).contains(&(before.len() - 100)), "found after {} ticks", before.len() - 100);
    assert!(before[before.len() - 1] > 25.0 && after[0].abs() < 5.0, "{before:?} {after:?}");
    // Jets are ideal here, and nothing corrects the estimate any more.
    assert_within!(after.iter().map(|error| (error - after[0]).abs()).fold(0.0, f64::max), 1e-9);
}

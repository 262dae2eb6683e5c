//! What a tick makes of measurements that are missing, frozen or wrong: each law by itself, without a controller.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::{assert_within, at, experiment, random_state, rng};
use flight_core::Measurement;
use flight_core::control::acting::Acting;
use flight_core::control::limits::Descent;
use flight_core::control::measure::channels::{Channels, ChannelsConfig, ChannelsState};
use flight_core::control::measure::greatest::MAGNITUDES;
use flight_core::control::measure::measurement::Sampling;
use flight_core::control::{BadStart, Estimate, Modes};
use flight_core::jets::JetDynamics;
use flight_core::robot::RobotModel;
use flight_core::spatial::exp_so3;
use flight_io::load_robot;
use nalgebra::{DVector, Matrix3, Vector3};
use rand::RngExt;

const STEP: f64 = 0.01;

/// A tick later.
fn next(sample: &Measurement) -> Measurement {
    Measurement { time: sample.time + STEP, ..sample.clone() }
}

/// After ticks that were left out the difference of two poses is not the velocity times one tick.
#[test]
fn a_lost_velocity_does_not_follow_a_pose_over_a_gap() {
    let mut rig = Rig::new(ChannelsConfig::default());
    rig.acting.acceleration.fill(0.0);
    let before = rig.sample.state.velocity.clone();
    let place = rig.sample.state.base.position;
    let used = rig.tick(|sample| {
        sample.time += 12.0 * STEP;
        sample.state.base.position = place + Vector3::repeat(13.0 * STEP);
        sample.state.velocity.rows_mut(0, 6).fill(f64::NAN);
    });
    assert_eq!(used.robot.state.velocity.rows(0, 6), before.rows(0, 6));
}

/// A height that is measured is used; without one that can be right the last one moves with the base, and after 0.15 s a mode says
/// so. A step of the ground is accepted when predictions have been contradicted for long enough.
#[test]
fn a_height_is_measured_predicted_or_stepped() {
    let mut rig = Rig::new(with_jumps());
    rig.acting.acceleration.fill(0.0);
    let climb = rig.sample.state.velocity[2];
    let tick = |rig: &mut Rig, height: f64| {
        let used = rig.tick(|sample| sample.height = height);
        let (found, is_held) = (used.robot.height, used.modes.contains(Modes::GROUND_HELD));
        ((!found.is_nan()).then_some(found), rig.channels.new_height(&rig.state, &rig.used), is_held)
    };
    for none in [f64::NAN, f64::INFINITY, 2e6] {
        assert_eq!(tick(&mut rig, none), (None, None, false), "a robot need not measure it");
    }
    let mut height = 4.0;
    for _ in 0..6 {
        height += STEP * climb;
        assert_eq!(tick(&mut rig, height), (Some(height), Some(height), false));
    }
    for (spoilt, held) in [(f64::NAN, false), (f64::INFINITY, false), (height + 5.0, false)] {
        let (found, new, is_held) = tick(&mut rig, spoilt);
        height += STEP * climb;
        assert_within!((found.unwrap() - height).abs(), 1e-12);
        assert_eq!((new, is_held), (None, held));
    }
    height += STEP * climb;
    assert_eq!(tick(&mut rig, height).1, Some(height), "it is measured again");
    assert_eq!(tick(&mut rig, height), (Some(height), None, false), "the same bits are not new");
    let ticks = (0..40).find(|_| {
        height += STEP * climb;
        tick(&mut rig, height + 0.5 + STEP * climb).1.is_some()
    });
    assert_eq!(ticks, Some(7), "of seven measurements before");
    for tick_without in 1..20 {
        let (_, new, is_held) = tick(&mut rig, f64::NAN);
        assert_eq!(new, None);
        assert_eq!(is_held, tick_without > 15, "{tick_without}");
    }
}

/// A height that keeps its bits while the base moves is frozen: it is not used until they change.
#[test]
fn a_frozen_height_is_not_used() {
    let mut rig = Rig::new(with_jumps());
    rig.acting.acceleration.fill(0.0);
    let climb = rig.sample.state.velocity[2];
    rig.sample.state.velocity[2] += 0.15_f64.copysign(climb);
    let mut is_used = Vec::new();
    for _ in 0..10 {
        is_used.push(rig.tick(|sample| sample.height = 2.0).robot.height == 2.0);
    }
    assert!(is_used[..5].iter().all(|is_used| *is_used) && !is_used[9], "{is_used:?}");
    let moved = rig.used.robot.height + 0.01;
    rig.tick(|sample| sample.height = moved);
    assert_eq!(rig.channels.new_height(&rig.state, &rig.used), Some(moved));
}

/// What makes a measurement unusable.
type Spoil = fn(&mut Measurement);

/// Channels after their first tick.
struct Rig {
    channels: Channels,
    state: ChannelsState,
    acting: Acting,
    descent: Descent,
    sample: Measurement,
    used: Estimate,
}

impl Rig {
    fn new(config: ChannelsConfig) -> Self {
        let mut robot: RobotModel = load_robot(&experiment("test2").robot).unwrap();
        robot.feet.clear();
        robot.jets[1].thrust_min = 89.5;
        robot.joints.iter_mut().for_each(|joint| joint.stops = (-1.5, 1.5));
        let mut rng = rng(3);
        let state = random_state(&mut rng, &robot);
        let wind = Vector3::new(6.0, -8.0, 1.0);
        let sample = Measurement { wind, ..at(0.0, &state, &[80.0, 90.0, 5.0, 110.0]) };
        let jets = robot.jet_models(JetDynamics::Ideal);
        let channels = Channels::new(config, &robot, jets, STEP, true);
        let (state, used) = channels.start(&sample, Estimate::new(&robot, 4, STEP)).unwrap();
        let mut acting = Acting::new(23, 4, 0);
        acting.acceleration = DVector::from_fn(29, |_, _| rng.random_range(-2.0..2.0));
        acting.thrust_rate = DVector::from_vec(vec![30.0, -40.0, -600.0, 10.0]);
        let mut rig = Self { channels, state, acting, descent: Descent::default(), sample, used };
        rig.update(&rig.sample.clone());
        rig
    }

    fn start(&self) -> Result<(ChannelsState, Estimate), BadStart> {
        self.channels.start(&self.sample, self.used.clone())
    }

    fn update(&mut self, sample: &Measurement) {
        let Self { channels, state, acting, descent, used, .. } = self;
        channels.update(state, sample, sample.wind, acting, descent, used);
    }

    /// A tick later, with something changed.
    fn tick(&mut self, change: impl Fn(&mut Measurement)) -> &Estimate {
        self.sample = next(&self.sample);
        let mut sample = self.sample.clone();
        change(&mut sample);
        self.update(&sample);
        &self.used
    }
}

/// Whether the momentum is measured, and the time since the last tick is known.
fn measures_momentum(used: &Estimate) -> bool {
    matches!(used.momentum, Sampling::Measured | Sampling::First)
}

fn with_jumps() -> ChannelsConfig {
    ChannelsConfig { jump: true }
}

fn lose_everything(sample: &mut Measurement) {
    sample.state.base.position.fill(f64::NAN);
    sample.state.base.rotation.fill(f64::NAN);
    sample.state.joint_position.fill(f64::NAN);
    sample.state.velocity.fill(f64::NAN);
    sample.thrust.fill(f64::NAN);
    sample.wind.fill(f64::NAN);
}

/// An estimator follows what is measured; of what is missing or has jumped it is given no number.
#[test]
fn an_estimator_follows_what_is_accepted() {
    let mut rig = Rig::new(with_jumps());
    let jump = Vector3::new(9.0, 0.0, 0.0);
    rig.tick(|sample| {
        sample.state.base.position += jump;
        sample.state.velocity.rows_mut(0, 6).fill(f64::NAN);
        sample.thrust[2] = f64::NAN;
    });
    let mut reading = rig.sample.clone();
    rig.channels.select_accepted(&rig.state, &rig.used, &mut reading);
    let Measurement { state, thrust, .. } = &rig.sample;
    assert!(reading.state.base.position.iter().all(|number| number.is_nan()));
    assert_eq!(reading.state.base.rotation, state.base.rotation);
    assert_eq!(reading.state.joint_position, state.joint_position);
    assert!(reading.state.velocity.rows(0, 6).iter().all(|number| number.is_nan()));
    assert_eq!(reading.state.velocity.rows(6, 23), state.velocity.rows(6, 23));
    assert!(reading.thrust[2].is_nan());
    for jet in [0, 1, 3] {
        assert_eq!(reading.thrust[jet], thrust[jet]);
    }
}

/// Everything measured: used to the bit, and nothing is degraded.
#[test]
fn what_is_measured_is_used() {
    let mut rig = Rig::new(with_jumps());
    let expected = next(&rig.sample);
    let used = rig.tick(|_| ()).clone();
    assert_eq!(
        (&used.robot.state, &used.robot.thrust, used.robot.wind),
        (&expected.state, &expected.thrust, expected.wind)
    );
    assert!(used.modes.is_empty());
    assert_eq!(used.robot.time, expected.time);
}

/// A number without meaning is none, not the greatest one that is accepted.
#[test]
fn a_prediction_without_meaning_is_no_limit() {
    let mut rig = Rig::new(ChannelsConfig::default());
    rig.acting.acceleration[6] = f64::NAN;
    let used = rig.tick(|sample| sample.state.velocity.fill(f64::NAN));
    assert!(used.robot.state.velocity[6].is_nan(), "{}", used.robot.state.velocity[6]);
}

/// Without any measurement joints and base move by the step of M78, thrusts by M31, each by hand.
#[test]
fn what_is_missing_is_predicted() {
    let mut rig = Rig::new(ChannelsConfig::default());
    let Measurement { state: mut expected, mut thrust, wind, .. } = rig.sample.clone();
    let (acceleration, rate) = (rig.acting.acceleration.clone(), rig.acting.thrust_rate.clone());
    for tick in 1..=3 {
        expected.velocity += STEP * &acceleration;
        let (v, w) = (expected.base_linear_velocity(), expected.base_angular_velocity());
        expected.base.position += STEP * v;
        expected.base.rotation = exp_so3(&(w * STEP)) * expected.base.rotation;
        let joints = expected.velocity.rows(6, 23).into_owned();
        expected.joint_position += STEP * joints;
        for ((thrust, rate), least) in thrust.iter_mut().zip(&rate).zip([0.0, 89.5, 0.0, 0.0]) {
            *thrust = (*thrust + STEP * rate).max(least);
        }
        let used = rig.tick(lose_everything);
        for (found, expected) in [
            (used.robot.state.velocity.as_slice(), expected.velocity.as_slice()),
            (used.robot.state.joint_position.as_slice(), expected.joint_position.as_slice()),
            (used.robot.state.base.position.as_slice(), expected.base.position.as_slice()),
            (used.robot.state.base.rotation.as_slice(), expected.base.rotation.as_slice()),
            (&used.robot.thrust, &thrust),
        ] {
            let worst = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert_within!(worst, 1e-12, because "the same sums in the same order, of numbers below 1e3", "tick {tick}");
        }
        assert_eq!(used.robot.wind, wind);
        let names: Vec<_> = used.modes.names().collect();
        assert_eq!(
            names,
            [
                "wind_held",
                "thrust_modelled",
                "joints_predicted",
                "position_predicted",
                "rotation_predicted",
                "velocity_predicted"
            ]
        );
    }
    assert_eq!(thrust[1..3], [89.5, 0.0], "no engine pulls, or runs below its least thrust");
}

/// One number that is none, or that cannot be, loses its channel and no other.
#[test]
fn each_channel_is_lost_alone() {
    let cases: [(Spoil, Modes); 9] = [
        (|sample| sample.wind.y = f64::NAN, Modes::WIND_HELD),
        (|sample| sample.wind.y = 301.0, Modes::WIND_HELD),
        (|sample| sample.thrust[1] = f64::INFINITY, Modes::THRUST_MODELLED),
        (|sample| sample.thrust[1] = -2201.0, Modes::THRUST_MODELLED),
        (|sample| sample.state.joint_position[4] = 101.0, Modes::JOINTS_PREDICTED),
        (|sample| sample.state.velocity[28] = f64::NAN, Modes::JOINTS_PREDICTED),
        (|sample| sample.state.base.position.z = f64::NAN, Modes::POSITION_PREDICTED),
        (|sample| sample.state.base.rotation *= 1.01, Modes::ROTATION_PREDICTED),
        (|sample| sample.state.velocity[3] = 101.0, Modes::VELOCITY_PREDICTED),
    ];
    for (spoil, mode) in cases {
        let mut rig = Rig::new(ChannelsConfig::default());
        let used = rig.tick(spoil);
        assert_eq!(used.modes, mode);
        let moves = [Modes::JOINTS_PREDICTED, Modes::ROTATION_PREDICTED, Modes::VELOCITY_PREDICTED];
        assert_eq!(measures_momentum(used), !moves.contains(&mode), "{:?}", mode.names().next());
        assert!(rig.tick(|_| ()).modes.is_empty(), "and comes back");
    }
}

/// The last wind for 1 s, half of it 1 s later, none after 3 s.
#[test]
fn a_lost_wind_is_held_and_fades() {
    let mut rig = Rig::new(ChannelsConfig::default());
    let last = rig.sample.wind;
    for tick in 1..=400 {
        let used = rig.tick(|sample| sample.wind.fill(f64::NAN));
        let age = f64::from(tick) * STEP;
        let share = (1.0 - (age - 1.0) / 2.0).clamp(0.0, 1.0);
        assert_within!((used.robot.wind - last * share).amax(), 1e-12, "at {age} s");
        assert_eq!(used.modes.contains(Modes::WIND_LOST), tick > 300, "at {age} s");
    }
}

/// A value is accepted up to its jump, and up to twice the jump after a second without any.
#[test]
fn a_jump_is_accepted_when_the_channel_is_old_enough() {
    // Not the same bits, which would count as frozen.
    let off_by = |jump: f64, tick: u32| {
        move |sample: &mut Measurement| sample.state.velocity[1] += jump + 1e-6 * f64::from(tick)
    };
    let confirmed = || {
        let mut rig = Rig::new(with_jumps());
        rig.acting.acceleration.fill(0.0);
        for tick in 1..=100 {
            assert!(!rig.tick(off_by(0.0, tick)).modes.contains(Modes::VELOCITY_PREDICTED));
        }
        rig
    };
    assert!(!confirmed().tick(off_by(0.99, 1)).modes.contains(Modes::VELOCITY_PREDICTED));
    let mut rig = confirmed();
    for tick in 1..=150 {
        let found = rig.tick(off_by(1.5, 200 + tick)).modes;
        let is_accepted = !found.contains(Modes::VELOCITY_PREDICTED);
        // 1.5 = 1 + age: from the tick on that begins with an age of 0.5 s.
        assert_eq!(is_accepted, tick > 51, "tick {tick}");
        if is_accepted {
            break;
        }
    }
}

/// Errors of the base position \[m\], tick by tick from the first on, in a robot at rest with other bits in every tick:
/// whether each is used, and the ticks in which the flight begins again.
fn judged(errors: &[f64]) -> (Vec<bool>, Vec<usize>) {
    let mut rig = Rig::new(with_jumps());
    rig.sample.state.velocity.fill(0.0);
    rig.sample.state.base.position.x += errors[0];
    (rig.state, rig.used) = rig.start().unwrap();
    let before = rig.sample.state.base.position.x - errors[0];
    let (mut used, mut again) = (Vec::new(), Vec::new());
    for (tick, error) in errors.iter().enumerate() {
        rig.sample.state.base.position.x = before + error + 1e-6 * tick as f64;
        let modes = rig.tick(|_| ()).modes;
        used.push(!modes.contains(Modes::POSITION_PREDICTED));
        if modes.contains(Modes::BEGUN_AGAIN) {
            again.push(tick);
        }
    }
    (used, again)
}

/// More measurements that agree with each other than those before: by one, whichever was first.
#[test]
fn the_first_measurements_are_outvoted_by_more_that_agree() {
    let (yes, no) = (true, false);
    assert_eq!(judged(&[5.0, 0.0, 0.0, 0.0]), (vec![yes, no, yes, yes], vec![2]));
    assert_eq!(judged(&[0.0, 5.0, 0.0, 0.0]), (vec![yes, no, yes, yes], vec![]));
    assert_eq!(judged(&[5.0, 9.0, 0.0, 0.0]), (vec![yes, no, no, yes], vec![3]));
    assert_eq!(judged(&[5.0, 5.0, 0.0, 0.0, 0.0]), (vec![yes, yes, no, no, yes], vec![4]));
    assert_eq!(judged(&[0.0, 0.0, 5.0, 5.0, 0.0]), (vec![yes, yes, no, no, yes], vec![]));
    let scattered = [0.0, 5.0, -5.0, 6.0, -6.0, 7.0, 0.0];
    assert_eq!(judged(&scattered), (vec![yes, no, no, no, no, no, yes], vec![]));
}

/// However long a flight is, a prediction that all measurements contradict is outvoted after 3 s.
#[test]
fn no_prediction_outlasts_three_seconds_of_measurements() {
    for before in [400, 1000] {
        let errors: Vec<f64> = (0..before + 303).map(|tick| if tick < before { 0.0 } else { 9.0 }).collect();
        let (used, again) = judged(&errors);
        assert_eq!(again, [before + 300]);
        assert!((0..errors.len()).all(|tick| used[tick] != (before..before + 300).contains(&tick)));
    }
}

/// A fifth of the jump of 0.3 m is too much between the first two, and accepted later.
#[test]
fn the_second_measurement_has_to_confirm_the_first() {
    assert!(judged(&[0.05, 0.0, 0.0]).1.is_empty());
    assert_eq!(judged(&[0.07, 0.0, 0.0]).1, [2]);
    assert_eq!(judged(&[0.0, 0.0, 0.25, 0.0]).0, [true; 4]);
    // What is missing is no vote.
    assert_eq!(judged(&[0.07, f64::NAN, 0.0, 0.0]), (vec![true, false, false, true], vec![3]));
}

/// Beyond what is accepted later, or beyond the stops of a joint, by name and number.
#[test]
fn a_flight_cannot_begin_with_what_cannot_be() {
    let cases: [(Spoil, &str); 6] = [
        (
            |sample| sample.state.base.position.z = 1e16,
            "`base_position` holds 10000000000000000; expected at most",
        ),
        (|sample| sample.state.velocity[2] = -301.0, "`base_linear_velocity` holds -301; expected at most"),
        (|sample| sample.state.velocity[3] = 101.0, "`base_angular_velocity` holds 101; expected at most"),
        (|sample| sample.state.velocity[7] = 101.0, "`joint_velocity` holds 101; expected at most"),
        (|sample| sample.state.joint_position[4] = 101.0, "`joint_position` holds 101; expected at most"),
        (
            |sample| sample.state.joint_position[4] = 1.61,
            "`joint_position[4]` holds 1.61; expected its range, -1.6 to 1.6",
        ),
    ];
    for (spoil, expected) in cases {
        let mut rig = Rig::new(with_jumps());
        spoil(&mut rig.sample);
        let refusal = rig.start().unwrap_err().to_string();
        assert!(refusal.contains(expected), "{refusal}");
    }
    let mut rig = Rig::new(with_jumps());
    rig.sample.state.joint_position[4] = 1.59;
    assert!(rig.start().is_ok());
}

/// The same bits for five ticks while the model moves away by a fiftieth of a jump; until the bits change.
#[test]
fn a_frozen_velocity_is_recognised() {
    let mut rig = Rig::new(with_jumps());
    rig.acting.acceleration.fill(0.0);
    rig.acting.acceleration[0] = 0.25; // 2.5 mm/s a tick: 20 mm/s after the eighth
    for tick in 1..=20 {
        let used = rig.tick(|sample| {
            // All but the velocity moves on.
            sample.state.joint_position[0] += 1e-3 * sample.time;
            sample.state.base.position.x += 1e-3 * sample.time;
        });
        let is_known = used.modes.contains(Modes::VELOCITY_PREDICTED);
        assert_eq!(is_known, tick > 8, "tick {tick}: {:?}", used.modes.names().collect::<Vec<_>>());
    }
    assert!(!rig.tick(|sample| sample.state.velocity[0] += 0.1).modes.contains(Modes::VELOCITY_PREDICTED));
}

/// A wind that jumps by more than gusts do is held, and used again where it has become plausible: within a jump, or as
/// far as it may have changed since; one that is beyond for as long as a wind is held is a wrong sensor, to the end.
#[test]
fn a_wind_that_jumps_is_not_used() {
    for (jump, back, accepted) in
        [(50.0, 0.5, Some(0.5)), (50.0, 2.0, None), (8.0, 9.0, Some(0.6)), (4.0, 9.0, Some(0.0))]
    {
        let mut rig = Rig::new(with_jumps());
        for _ in 0..100 {
            assert!(!rig.tick(|_| ()).modes.contains(Modes::WIND_HELD));
        }
        let mut first = None;
        for tick in 0..900_i32 {
            let age = f64::from(tick) * STEP;
            let used = rig.tick(|sample| sample.wind.x += if age < back { jump } else { 0.0 });
            let is_used = !used.modes.contains(Modes::WIND_HELD);
            assert!(!used.modes.contains(Modes::BEGUN_AGAIN));
            if is_used && first.is_none() {
                first = Some(age);
            }
        }
        let later = first.zip(accepted).is_none_or(|(found, expected)| (found - expected).abs() < 1.5 * STEP);
        assert!(first.is_some() == accepted.is_some() && later, "{jump} m/s: {first:?}");
    }
}

/// A robot that stands still is not frozen, and a wind that does not change is not either.
#[test]
fn standing_still_is_not_frozen() {
    let mut rig = Rig::new(with_jumps());
    rig.sample.state.velocity.fill(0.0);
    rig.acting.acceleration.fill(0.0);
    rig.acting.thrust_rate.fill(0.0);
    rig.tick(|sample| sample.state.base.position.x += 1e-9);
    for _ in 0..50 {
        assert!(!rig.tick(|_| ()).modes.contains(Modes::WIND_HELD));
    }
}

/// Linear and angular velocity are missing each by itself; between two measurements, up to 0.15 s, none follows the pose.
#[test]
fn velocities_have_rates_of_their_own() {
    let mut rig = Rig::new(ChannelsConfig::default());
    rig.acting.acceleration.fill(0.0);
    let (before, gyro) = (rig.sample.state.velocity.clone(), Vector3::new(0.3, -0.2, 0.1));
    let start = rig.sample.state.base.position;
    for tick in 1..=15 {
        let used = rig.tick(|sample| {
            sample.state.base.position = start + Vector3::repeat(f64::from(tick) * STEP);
            sample.state.velocity.rows_mut(0, 3).fill(f64::NAN);
            sample.state.velocity.rows_mut(3, 3).copy_from(&gyro);
        });
        assert_eq!(used.robot.state.velocity.rows(0, 3), before.rows(0, 3), "tick {tick}");
        assert_eq!(used.robot.state.base_angular_velocity(), gyro, "tick {tick}");
        assert!(!measures_momentum(used) && (used.momentum == Sampling::Between), "tick {tick}");
        assert_within!((used.gap - f64::from(tick) * STEP).abs(), 1e-12);
    }
    let used = rig.tick(|sample| sample.state.velocity.rows_mut(0, 3).fill(f64::NAN));
    assert!(used.momentum != Sampling::Between);
    let used = rig.tick(|_| ());
    assert!(measures_momentum(used) && used.momentum != Sampling::Between);
}

/// Fifteen ticks of 10 ms are 0.15 s, a hundred a second and 300 three, whatever the sum of their times is rounded to.
#[test]
fn rounding_decides_on_no_tick() {
    for start in [0.0, 0.37, 1.23, 7.77, 100.01, 2e3] {
        let rig = |config| {
            let mut rig = Rig::new(config);
            rig.acting.acceleration.fill(0.0);
            rig.sample.time = start;
            rig.tick(|_| ());
            rig.tick(|sample| sample.height = 4.0);
            rig
        };
        let mut without = rig(ChannelsConfig::default());
        for tick in 1..=302 {
            let used = without.tick(|sample| sample.state.velocity.rows_mut(0, 3).fill(f64::NAN));
            assert_eq!(used.momentum == Sampling::Between, tick <= 15, "tick {tick} from {start} s");
            assert_eq!(used.modes.contains(Modes::GROUND_HELD), tick > 15, "tick {tick} from {start} s");
            assert_eq!(used.modes.contains(Modes::DESCENDING), tick > 300, "tick {tick} from {start} s");
        }
        for (ticks, is_rejected) in [(100, false), (101, true)] {
            let mut windless = rig(with_jumps());
            for _ in 0..ticks {
                windless.tick(|sample| sample.wind.fill(f64::NAN));
            }
            windless.tick(|sample| sample.wind.x += 40.0);
            let used = windless.tick(|_| ());
            assert_eq!(used.modes.contains(Modes::WIND_HELD), is_rejected, "{ticks} ticks from {start} s");
        }
    }
}

/// A linear velocity that jumps takes the angular one with it, which is within its own range.
#[test]
fn what_contradicts_one_velocity_contradicts_both() {
    let mut rig = Rig::new(with_jumps());
    rig.tick(|_| ());
    let predicted =
        rig.tick(|sample| sample.state.velocity.rows_mut(0, 6).fill(f64::NAN)).robot.state.clone();
    assert!((predicted.base_angular_velocity() - rig.sample.state.base_angular_velocity()).amax() < 0.5);
    for jumping in [0, 3] {
        let mut rig = Rig::new(with_jumps());
        rig.tick(|_| ());
        let used = rig.tick(|sample| {
            sample.state.velocity[jumping] += 9.0;
            sample.state.velocity[3 - jumping] += 0.1;
        });
        assert_eq!(used.robot.state.velocity.rows(0, 6), predicted.velocity.rows(0, 6), "number {jumping}");
        assert!(used.momentum != Sampling::Between, "what is wrong is not between two measurements");
    }
}

/// A base velocity that has not been measured for 0.15 s follows the differences of the pose by `1 − e^{−K Δt}` a tick.
#[test]
fn a_lost_velocity_follows_the_pose() {
    let mut rig = Rig::new(ChannelsConfig::default());
    rig.acting.acceleration.fill(0.0);
    let before = rig.sample.state.velocity.clone();
    let (v, w) = (Vector3::new(0.7, -0.4, 0.2), Vector3::new(0.05, 0.02, -0.03));
    let (start, rotation) = (rig.sample.state.base.position, rig.sample.state.base.rotation);
    for tick in 1..=60 {
        let time = f64::from(tick) * STEP;
        let used = rig.tick(|sample| {
            sample.state.base.position = start + v * time;
            sample.state.base.rotation = exp_so3(&(w * time)) * rotation;
            sample.state.velocity.rows_mut(0, 6).fill(f64::NAN);
        });
        let left = (-100.0 * (time - 0.15).max(0.0)).exp();
        for axis in 0..3 {
            let expected = v[axis] + (before[axis] - v[axis]) * left;
            assert_within!((used.robot.state.velocity[axis] - expected).abs(), 1e-11, "tick {tick}");
            let expected = w[axis] + (before[3 + axis] - w[axis]) * left;
            let error = (used.robot.state.velocity[3 + axis] - expected).abs();
            assert_within!(error, 1e-8, because "the sine of a turn of 6e-4 rad is taken for the turn: 6e-8 of it");
        }
    }
}

/// A pose that is new in every other tick alone moved for two of them: its difference is not the velocity times one tick.
#[test]
fn a_lost_velocity_does_not_follow_a_pose_that_was_held() {
    let mut rig = Rig::new(ChannelsConfig::default());
    rig.acting.acceleration.fill(0.0);
    let (v, start) = (rig.sample.state.base_linear_velocity(), rig.sample.state.base.position);
    let (w, rotation) = (rig.sample.state.base_angular_velocity(), rig.sample.state.base.rotation);
    for tick in 1..=50 {
        let time = f64::from(tick - tick % 2) * STEP;
        let used = rig.tick(|sample| {
            sample.state.base.position = start + v * time;
            sample.state.base.rotation = exp_so3(&(w * time)) * rotation;
            sample.state.velocity.rows_mut(0, 6).fill(f64::NAN);
        });
        assert_eq!(used.robot.state.base_linear_velocity(), v, "tick {tick}");
        assert_eq!(used.robot.state.base_angular_velocity(), w, "tick {tick}");
    }
}

/// The clock runs on where the time is none; a step that repeats, runs back or leaps is none either, and from then on
/// the clock counts from there. Momentum is measured where the time that passed is known.
#[test]
fn a_time_that_is_none_is_predicted() {
    for (measured, time, has_momentum) in [
        (f64::NAN, STEP, true),
        (-1.0, STEP, true),
        (2e9, STEP, true),
        (0.02, 0.02, true),
        (0.5, STEP, false),
        (0.0, STEP, false),
    ] {
        let mut rig = Rig::new(with_jumps());
        // At rest, so that no value moves away from the first one.
        rig.sample.state.velocity.fill(0.0);
        (rig.state, rig.used) = rig.start().unwrap();
        rig.update(&rig.sample.clone());
        assert_eq!(rig.used.momentum, Sampling::First);
        let used = rig.tick(|sample| sample.time = measured);
        assert_eq!((used.robot.time, measures_momentum(used)), (time, has_momentum), "{measured}");
        assert_eq!(used.modes.contains(Modes::CLOCK_PREDICTED), measured != 0.02, "{measured}");
        // Half a tick later by the same clock, or by the one of before where it was none.
        let (later, elapsed) = if has_momentum { (0.025, 0.025 - time) } else { (measured + 0.005, 0.005) };
        let used = rig.tick(|sample| sample.time = later);
        assert_within!((used.elapsed - elapsed).abs(), 1e-15, "{measured}");
        assert_within!((used.robot.time - time - elapsed).abs(), 1e-15, "{measured}");
        assert!(measures_momentum(used) && used.modes.is_empty(), "{measured}");
    }
}

/// After a pause of the controller values may have moved by a jump in every tick that it missed, and thrusts say nothing;
/// a clock that runs back or far ahead has jumped, and excuses no other value.
#[test]
fn what_happened_in_a_pause_is_no_jump() {
    // 1 + gap / 10 ms
    for (gap, most) in [(0.09, 1.0), (0.3, 31.0), (0.99, 100.0), (1.01, 1.0), (-0.3, 1.0)] {
        for (off, is_accepted) in [(0.99 * most, true), (1.01 * most, false)] {
            let mut rig = Rig::new(with_jumps());
            rig.acting.acceleration.fill(0.0);
            rig.sample.time = 5.0;
            rig.tick(|sample| sample.state.velocity[1] += 1e-9); // other bits confirm the first
            let used = rig.tick(|sample| {
                sample.time += gap - STEP;
                sample.state.velocity[1] += off;
                sample.thrust[0] += 50.0;
            });
            assert_eq!(!used.modes.contains(Modes::VELOCITY_PREDICTED), is_accepted, "{gap} s, {off} m/s");
            let is_step = gap == 0.09;
            assert_eq!(used.thrust_innovation[0] != 0.0, is_step, "{gap} s");
            assert_eq!(used.pause > 0.0, most > 1.0, "{gap} s");
        }
    }
}

/// The first measurement is what it is compared with, whatever the controller was started from.
#[test]
fn the_first_measurement_is_accepted() {
    let mut rig = Rig::new(with_jumps());
    (rig.state, rig.used) = rig.start().unwrap();
    let used = rig.tick(|sample| {
        sample.state.base.position.x += 5.0;
        sample.thrust[0] += 50.0;
    });
    assert!(used.modes.is_empty());
    assert_eq!(used.thrust_innovation[0], 0.0);
}

/// Without jumps in the configuration every time is followed, as published.
#[test]
fn without_jumps_every_time_is_followed() {
    for time in [0.5, 0.0] {
        let mut rig = Rig::new(ChannelsConfig::default());
        let used = rig.tick(|sample| sample.time = time);
        assert_eq!((used.robot.time, used.elapsed, measures_momentum(used)), (time, STEP, false));
        assert!(used.modes.is_empty());
    }
}

/// Without a channel of joints or base the robot descends from 3 s on, and goes on when it is back; without a wind not.
#[test]
fn a_robot_that_is_blind_for_long_descends_for_good() {
    let cases: [(Spoil, bool); 6] = [
        (|sample| sample.wind.fill(f64::NAN), false),
        (|sample| sample.thrust.fill(f64::NAN), false),
        (|sample| sample.state.joint_position.fill(f64::NAN), true),
        (|sample| sample.state.base.position.fill(f64::NAN), true),
        (|sample| sample.state.base.rotation = Matrix3::repeat(f64::NAN), true),
        (|sample| sample.state.velocity.rows_mut(0, 6).fill(f64::NAN), true),
    ];
    for (spoil, descends) in cases {
        let mut rig = Rig::new(ChannelsConfig::default());
        for _ in 1..=299 {
            assert!(!rig.tick(spoil).modes.contains(Modes::DESCENDING));
        }
        rig.tick(spoil);
        rig.tick(spoil);
        assert_eq!(rig.tick(|_| ()).modes.contains(Modes::DESCENDING), descends);
    }
}

/// However long nothing is measured, predictions stay within what is accepted: numbers from which a flight can go on.
#[test]
fn predictions_stay_within_what_is_accepted() {
    let mut rig = Rig::new(ChannelsConfig::default());
    rig.acting.acceleration.fill(1e6);
    rig.acting.thrust_rate.fill(1e6);
    for _ in 0..20_000 {
        rig.tick(lose_everything);
    }
    let Measurement { state, thrust, .. } = rig.tick(lose_everything).robot.clone();
    let bounds = [MAGNITUDES.velocity; 3].into_iter().chain([MAGNITUDES.angular_velocity; 3]);
    assert!(state.velocity.iter().zip(bounds).all(|(velocity, most)| *velocity == most));
    assert!(state.velocity.rows(6, 23).iter().all(|velocity| *velocity == MAGNITUDES.joint_velocity));
    assert!(state.joint_position.iter().all(|position| *position == MAGNITUDES.joint_position));
    assert!(state.base.position.iter().all(|position| *position > 1e4 && *position <= MAGNITUDES.position));
    assert!(thrust.iter().all(|thrust| thrust.is_finite() && *thrust > 1000.0));
    assert!(rig.tick(|_| ()).modes.contains(Modes::DESCENDING));
}

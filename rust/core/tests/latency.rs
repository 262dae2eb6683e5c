//! Latencies that are measured from responses that are written here.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::assert_within;
use flight_core::control::detect::latency::{
    LatencyDetectorConfig, LatencyMonitor, LatencySample, LatencyState,
};
use flight_core::control::estimate::estimator::EstimatorConfig;
use nalgebra::{DMatrix, DVector};

const STEP: f64 = 0.01;
const CONFIG: LatencyDetectorConfig =
    LatencyDetectorConfig { torque_max: 0.007, thrust_max: 0.04, confirmation: 1.0 };

/// Two joints, each of which moves the other, and two jets.
struct Robot {
    monitor: LatencyMonitor,
    state: LatencyState,
    gain: DMatrix<f64>,
    position: DVector<f64>,
    velocity: DVector<f64>,
    thrust: DVector<f64>,
    tick: i32,
    /// Ticks after which torques and thrust rates act.
    late: [i32; 2],
    /// Whether a torque that is held for a tick moves a joint by `h² s̈ / 2` in it, and not by `h² s̈`.
    holds: bool,
    /// Ticks by which accelerations are predicted.
    lead: f64,
    /// Factor of what accelerates the joints besides torques.
    free: f64,
}

fn torque(tick: i32) -> DVector<f64> {
    let t = f64::from(tick) * STEP;
    DVector::from_vec(vec![0.4 * (11.0 * t).sin() + 0.2 * (31.0 * t).sin(), 0.1 * (17.0 * t).cos()])
}

/// What accelerates the joints besides, against which torques act.
fn free(tick: f64) -> DVector<f64> {
    let t = tick * STEP;
    DVector::from_vec(vec![30.0 * (5.0 * t).sin(), -20.0 * (7.0 * t).cos()])
}

fn rate(tick: i32) -> DVector<f64> {
    let t = f64::from(tick) * STEP;
    DVector::from_vec(vec![30.0 * (3.0 * t).sin(), 20.0 * (5.0 * t).cos()])
}

impl Robot {
    fn new(late: [i32; 2], estimator: Option<&EstimatorConfig>) -> Self {
        let monitor = LatencyMonitor::new(CONFIG, estimator, 1, 2, 2, STEP);
        let position = DVector::from_vec(vec![0.1, 0.2]);
        Self {
            state: monitor.start_of(2, 2),
            monitor,
            gain: DMatrix::from_row_slice(2, 2, &[40.0, -8.0, -8.0, 60.0]),
            velocity: DVector::zeros(2),
            position,
            thrust: DVector::from_element(2, 100.0),
            tick: 0,
            late,
            holds: false,
            lead: 0.0,
            free: 1.0,
        }
    }

    /// A tick; returns whether commands are late.
    fn fly(&mut self, is_measured: bool) -> bool {
        self.fly_after(STEP, is_measured)
    }

    /// A tick that comes this time after the last one by its clock \[s\].
    fn fly_after(&mut self, elapsed: f64, is_measured: bool) -> bool {
        let position = is_measured.then(|| self.position.as_slice());
        let thrust = is_measured.then(|| self.thrust.as_slice());
        self.monitor.take_in(&mut self.state, position, thrust, elapsed);
        let last = self.tick - 1;
        let acceleration = self.free * free(f64::from(last) + self.lead) + &self.gain * torque(last);
        let (torques, rates) = (torque(last), rate(last));
        let sample = LatencySample {
            acceleration: acceleration.as_slice(),
            gain: &self.gain,
            torque: &torques,
            thrust_rate: rates.as_slice(),
        };
        self.monitor.compare(&mut self.state, &sample, true);
        let measured = self.monitor.measured(&self.state);
        let is_late = self.monitor.are_late(&mut self.state, measured, STEP).contains(&true);

        let accelerated =
            self.free * free(f64::from(self.tick)) + &self.gain * torque(self.tick - self.late[0]);
        if self.holds {
            // The free acceleration is that of the middle of two ticks, as in the difference of positions.
            let held = &self.gain * torque(self.tick - self.late[0]);
            self.position.axpy(-0.5 * STEP * STEP, &held, 1.0);
        }
        self.velocity.axpy(STEP, &accelerated, 1.0);
        self.position.axpy(STEP, &self.velocity, 1.0);
        self.thrust.axpy(STEP, &rate(self.tick - self.late[1]), 1.0);
        self.tick += 1;
        is_late
    }

    fn measured(&self) -> [f64; 2] {
        self.monitor.measured(&self.state).map(Option::unwrap)
    }
}

#[test]
fn whole_ticks_are_measured() {
    for late in [[0, 0], [1, 2], [2, 5], [5, 20]] {
        let mut robot = Robot::new(late, None);
        for _ in 0..1000 {
            robot.fly(true);
        }
        for (measured, ticks) in robot.measured().into_iter().zip(late) {
            // Mean squares of before and after the best delay differ by the forgetting.
            assert_within!((measured - f64::from(ticks) * STEP).abs(), 2e-4, "{late:?}: {measured} s");
        }
    }
}

/// A torque that is held for a tick acts half a tick later.
#[test]
fn half_a_tick_is_measured() {
    let mut robot = Robot { holds: true, ..Robot::new([1, 0], None) };
    for _ in 0..1000 {
        robot.fly(true);
    }
    assert_within!((robot.measured()[0] - 0.015).abs(), 2e-4, "{} s", robot.measured()[0]);
}

/// An acceleration that is predicted by a part of a tick lies between those of two ticks, the nearer one counting more.
#[test]
fn parts_of_a_tick_are_interpolated() {
    let mut config = EstimatorConfig::default();
    config.latency.torque = 0.0125;
    // Of the greater acceleration half a tick would hide the torques.
    let mut robot = Robot { lead: 1.25, free: 20.0, ..Robot::new([1, 0], Some(&config)) };
    for _ in 0..1000 {
        robot.fly(true);
    }
    assert_within!((robot.measured()[0] - 0.01).abs(), 2e-4, "{} s", robot.measured()[0]);
}

/// Accelerations are predicted for when the command acts, and measurements of sensors that are late are older.
#[test]
fn known_latencies_and_ages_are_allowed_for() {
    let mut config = EstimatorConfig::default();
    (config.latency.torque, config.latency.thrust) = (0.02, 0.02);
    let mut robot = Robot { lead: 2.0, ..Robot::new([2, 2], Some(&config)) };
    for _ in 0..1000 {
        assert!(!robot.fly(true));
    }
    for measured in robot.measured() {
        assert_within!((measured - 0.02).abs(), 2e-4, "{measured} s");
    }
    (config.joint_position.delay, config.thrust.delay) = (0.01, 0.01);
    let mut robot = Robot { lead: 3.0, ..Robot::new([3, 3], Some(&config)) };
    for _ in 0..1000 {
        robot.fly(true);
    }
    for measured in robot.measured() {
        assert_within!((measured - 0.02).abs(), 2e-4, "{measured} s");
    }
}

/// The mean of several torques in a tick is given after it.
#[test]
fn torques_within_a_tick_are_given_after_it() {
    for (steps, after) in [(1, 0.0), (2, 0.25), (10, 0.45)] {
        let mut robot = Robot::new([2, 2], None);
        robot.monitor = LatencyMonitor::new(CONFIG, None, steps, 2, 2, STEP);
        for _ in 0..1000 {
            robot.fly(true);
        }
        assert_within!((robot.measured()[0] - (2.0 - after) * STEP).abs(), 2e-4, "{steps} steps");
        assert_within!((robot.measured()[1] - 2.0 * STEP).abs(), 2e-4, "{steps} steps");
    }
}

/// While torques are late an estimator uses what was measured, in time again what is known; nothing measured says nothing.
#[test]
fn a_measured_latency_is_used_while_torques_are_late() {
    let mut config = EstimatorConfig::default();
    config.latency.torque = 0.02;
    let monitor = LatencyMonitor::new(CONFIG, Some(&config), 1, 2, 2, STEP);
    assert_eq!(monitor.to_use(Some(0.03), true), Some(0.03));
    assert_eq!(monitor.to_use(Some(0.021), false), Some(0.02));
    assert_eq!(monitor.to_use(None, false), None);
}

#[test]
fn late_commands_are_reported_after_their_confirmation() {
    for (late, expected) in [([0, 4], false), ([1, 0], true), ([0, 5], true)] {
        let mut robot = Robot::new(late, None);
        let said = (0..1000).filter(|_| robot.fly(true)).count();
        assert_eq!(said > 0, expected, "{late:?}: {said} ticks");
        assert!(said < 1000 - 100, "{late:?}: {said} ticks");
    }
}

/// Commands that act in time again are not late any more, once those before are forgotten.
#[test]
fn commands_in_time_again_are_not_late() {
    let mut robot = Robot::new([1, 0], None);
    for tick in 0..600 {
        let is_late = robot.fly(true);
        assert!(tick < 500 || is_late, "after {tick} ticks");
    }
    robot.late = [0, 0];
    for tick in 0..2000 {
        let is_late = robot.fly(true);
        assert!(tick < 1500 || !is_late, "after {tick} ticks");
    }
    assert_within!(
        robot.measured()[0].abs(),
        1e-3,
        "e^-6 of squares of before are left: {:?} s",
        robot.measured()
    );
}

/// After a gap nothing is compared until commands of before have acted and are out of the filters; what was measured
/// stays.
#[test]
fn a_gap_changes_nothing() {
    let mut robot = Robot::new([2, 5], None);
    for _ in 0..600 {
        robot.fly(true);
    }
    let before = robot.measured();
    robot.fly(false);
    assert_eq!(robot.measured(), before);
    let mut first = [0; 2];
    for tick in 1..=150 {
        robot.fly(true);
        for (first, (now, before)) in first.iter_mut().zip(robot.measured().into_iter().zip(before)) {
            if *first == 0 && now != before {
                *first = tick;
            }
        }
    }
    // Two ticks and one are differences; 27 are delays; nine filter times of 25 ms are 23, three of 0.3 s are 90.
    assert_eq!(first, [2 + 27 + 23 + 1, 1 + 27 + 90 + 1]);
    for _ in 0..600 {
        robot.fly(true);
    }
    for (measured, ticks) in robot.measured().into_iter().zip([2.0, 5.0]) {
        assert_within!((measured - ticks * STEP).abs(), 2e-4, "{measured} s");
    }
}

/// A tick that comes by more than a tenth late or early is a gap.
#[test]
fn a_late_tick_is_a_gap() {
    for (late, is_gap) in [(0.5, true), (0.15, true), (-0.15, true), (0.08, false), (-0.08, false)] {
        let mut robot = Robot::new([2, 5], None);
        for _ in 0..600 {
            robot.fly(true);
        }
        let before = robot.measured();
        robot.fly_after((1.0 + late) * STEP, true);
        robot.fly(true);
        assert_eq!(robot.measured() == before, is_gap, "{late}");
    }
}

/// Without excitation nothing is known.
#[test]
fn commands_that_do_not_change_tell_nothing() {
    let mut robot = Robot::new([0, 0], None);
    robot.gain.fill(0.0);
    for _ in 0..1000 {
        robot.fly(true);
    }
    assert_eq!(robot.monitor.measured(&robot.state)[0], None);
}

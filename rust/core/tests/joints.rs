//! Joints that do not follow their torques, judged from residuals and positions that are written here.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::assert_within;
use flight_core::control::detect::joints::{JointSample, JointsConfig, JointsState};
use flight_core::control::limits::JointCondition::{self, Free, Healthy, Stuck, Weak};
use nalgebra::DVector;

const STEP: f64 = 0.01;
const CONFIG: JointsConfig = JointsConfig { torque_min: 0.5, confirmation: 0.05, effectiveness_max: 0.7 };

const STOPS: [(f64, f64); 3] = [(-1.0, 1.0), (-1.5, 1.5), (-2.0, 2.0)];

struct Robot {
    state: JointsState,
    torque: DVector<f64>,
    position: DVector<f64>,
    stops: [(f64, f64); 3],
}

impl Robot {
    fn new() -> Self {
        let position = DVector::from_vec(vec![0.1, 0.2, 0.3]);
        let torque = DVector::from_vec(vec![4.0, -3.0, 2.0]);
        Self { state: JointsState::new(&position), torque, position, stops: STOPS }
    }

    /// One that has been flying for long enough to be judged.
    fn settled() -> Self {
        let mut robot = Self::new();
        for _ in 0..250 {
            robot.tick(&[0.0; 3], &[0.0; 3], &[0.0; 3]);
        }
        robot
    }

    /// A tick with these unexplained torques \[N m\], in which the joints move so far while they are commanded these
    /// velocities.
    fn tick(&mut self, unexplained: &[f64], moved: &[f64], commanded: &[f64]) {
        self.touch([0.0; 6], unexplained, moved, commanded);
    }

    /// A tick in which also the rows of the base are not explained \[N, N m\].
    fn touch(&mut self, base: [f64; 6], unexplained: &[f64], moved: &[f64], commanded: &[f64]) {
        self.position += DVector::from_column_slice(moved);
        self.state.measure(&self.position, true, STEP);
        let residual = DVector::from_iterator(9, base.into_iter().chain(unexplained.iter().copied()));
        let (torque, stops) = (&self.torque, &self.stops[..]);
        self.state.update(&CONFIG, &JointSample { dt: STEP, residual: &residual, torque, stops });
        self.state.command(&DVector::from_column_slice(commanded), STEP);
    }

    /// What is lost of the torque of a joint at which `share` acts, beyond what is found.
    fn lost(&self, joint: usize, share: f64) -> f64 {
        (share - self.state.found[joint].effectiveness()) * self.torque[joint]
    }

    fn found(&self) -> [JointCondition; 3] {
        self.state.found.clone().try_into().unwrap()
    }
}

#[test]
fn a_weak_or_free_joint_is_found_with_its_share() {
    for (joint, share) in [(0, 0.5), (1, 0.4), (2, 0.5), (0, 0.0), (2, 0.05)] {
        let mut robot = Robot::settled();
        let (mut unexplained, mut moved) = ([0.0; 3], [0.0; 3]);
        unexplained[joint] = robot.lost(joint, share);
        moved[joint] = 0.01;
        let ticks = (1..=20).find(|_| {
            robot.tick(&unexplained, &moved, &[0.0; 3]);
            robot.found()[joint] != Healthy
        });
        assert!(ticks.unwrap() <= 12, "joint {joint} with {share}: {ticks:?} ticks of 10 ms");
        match robot.found()[joint] {
            Weak(found) => {
                assert_within!((found - share).abs(), 0.06, because "the mean follows at 1 1/s until the residual, at 20 1/s, is suspected", "joint {joint}: {found}");
            }
            found => assert!(found == Free && share < 0.15, "joint {joint}: {found:?}"),
        }
        assert_eq!(robot.found().iter().filter(|found| **found != Healthy).count(), 1);
    }
}

/// Nothing is judged for two seconds after the start, and for a fifth after nothing could be compared or a joint was found.
#[test]
fn judgement_waits() {
    let first = |robot: &mut Robot, joint: usize, after: usize| {
        let mut unexplained = [0.0; 3];
        unexplained[joint] = robot.lost(joint, 0.0);
        let found = |robot: &mut Robot| {
            robot.tick(&unexplained, &[0.01; 3], &[0.0; 3]);
            robot.found()[joint] != Healthy
        };
        (after..1000).find(|_| found(robot)).unwrap()
    };
    let mut robot = Robot::new();
    for _ in 0..150 {
        robot.tick(&[0.0; 3], &[0.0; 3], &[0.0; 3]);
    }
    let ticks = first(&mut robot, 0, 150);
    assert!((200..210).contains(&ticks), "{ticks} ticks after the start");
    let mut robot = Robot::settled();
    robot.state.interrupt();
    let ticks = first(&mut robot, 0, 0);
    assert!((20..30).contains(&ticks), "{ticks} ticks after an interruption");
    let ticks = first(&mut robot, 1, 0);
    assert!((20..30).contains(&ticks), "{ticks} ticks after a finding");
}

/// A suspicion that ends, or is interrupted, begins anew.
#[test]
fn suspicions_do_not_add_up() {
    let mut robot = Robot::settled();
    for tick in 0..400 {
        let lost = if tick % 40 == 0 { robot.lost(0, 0.0) } else { 0.0 };
        robot.tick(&[lost, 0.0, 0.0], &[0.01, 0.0, 0.0], &[0.0; 3]);
        assert_eq!(robot.found(), [Healthy; 3], "tick {tick}");
    }
    let ticks = [0, 4].map(|before| {
        let mut robot = Robot::settled();
        let is_found = |robot: &mut Robot| {
            let lost = robot.lost(0, 0.0);
            robot.tick(&[lost, 0.0, 0.0], &[0.01, 0.0, 0.0], &[0.0; 3]);
            robot.found()[0] != Healthy
        };
        for _ in 0..before {
            assert!(!is_found(&mut robot));
        }
        robot.state.interrupt();
        (1..100).find(|_| is_found(&mut robot))
    });
    assert!(ticks[0].is_some());
    assert_eq!(ticks[0], ticks[1]);
}

/// A joint that gets its torque back is as good as before; one that loses the rest becomes free.
#[test]
fn a_share_that_changes_is_revised() {
    for (then, expected) in [(1.0, Healthy), (0.0, Free)] {
        let mut robot = Robot::settled();
        for tick in 0..200 {
            let lost = robot.lost(2, if tick < 60 { 0.5 } else { then });
            robot.tick(&[0.0, 0.0, lost], &[0.0, 0.0, 0.004], &[0.0; 3]);
            if tick == 59 {
                assert!(matches!(robot.found()[2], Weak(_)));
            }
        }
        assert_eq!(robot.found(), [Healthy, Healthy, expected]);
    }
}

/// What is found later is found in the same tick and with the same share as if nothing had been taken back.
#[test]
fn nothing_remains_of_what_is_taken_back() {
    let mut robots = [Robot::settled(), Robot::settled()];
    let mut was_weak = false;
    let tick = |robot: &mut Robot, tick: i32, acting: f64| {
        let moved = 0.004 * (0.05 * f64::from(tick)).cos();
        let lost = robot.lost(2, acting);
        robot.tick(&[0.0, 0.0, lost], &[0.0, 0.0, moved], &[0.0; 3]);
        robot.found()
    };
    // The mean forgets in a second.
    for time in 0..1500 {
        let found = tick(&mut robots[0], time, if time < 60 { 0.5 } else { 1.0 });
        was_weak |= matches!(found[2], Weak(_));
        assert_eq!(tick(&mut robots[1], time, 1.0), [Healthy; 3]);
    }
    assert!(was_weak);
    assert_eq!(robots[0].found(), [Healthy; 3]);
    let [(then, found), (expected_then, expected)] = robots.map(|mut robot| {
        let then = (1500..1600).find(|time| tick(&mut robot, *time, 0.4)[2] != Healthy).unwrap();
        (then, robot.found()[2].effectiveness())
    });
    assert_eq!(then, expected_then);
    assert_within!((found - expected).abs(), 1e-4, because "e^-14 of a mean of 1 N m, and its square");
}

/// Errors of the model are there from the start, are small, or act on a joint in the direction of its torque.
#[test]
fn errors_of_the_model_are_no_faults() {
    let mut robot = Robot::new();
    for _ in 0..500 {
        robot.tick(&[0.0, 0.0, -1.0], &[0.01; 3], &[0.0; 3]);
    }
    assert_eq!(robot.found(), [Healthy; 3], "constant");
    for unexplained in [[-0.45, 0.0, 0.0], [4.0, 0.0, 0.0], [-20.0, 0.0, 0.0]] {
        let mut robot = Robot::settled();
        for _ in 0..500 {
            robot.tick(&unexplained, &[0.01, 0.0, 0.0], &[0.0; 3]);
        }
        assert_eq!(robot.found(), [Healthy; 3], "{unexplained:?}");
    }
}

/// What a touch does to a joint is at most its force times a metre and its moment, which the rows of the base show; half of the
/// torque is no touch where the base shows less.
#[test]
fn a_touch_is_no_fault_of_a_joint() {
    for (base, expected) in [
        ([0.0, 1.6, 0.0, 0.0, 0.0, 0.0], true),
        ([0.0, 0.0, 0.0, 0.9, 0.0, 1.2], true),
        ([0.0, 0.3, 0.0, 0.0, 0.0, 0.4], false),
    ] {
        let mut robot = Robot::settled();
        for _ in 0..20 {
            robot.touch(base, &[-2.0, 0.0, 0.0], &[0.01, 0.0, 0.0], &[0.0; 3]);
        }
        assert_eq!(robot.found()[0] == Healthy, expected, "{base:?}");
    }
}

/// A joint that stands still while it is commanded to move, with a torque that the model does not explain against the
/// command, is stuck; it is taken up again when it has moved by 0.02 rad.
#[test]
fn a_stuck_joint_is_found_and_taken_up_again() {
    let mut robot = Robot::settled();
    let mut pushed = 0.0;
    let ticks = (1..=30).find(|_| {
        pushed -= 0.08;
        robot.tick(&[0.0, 0.0, pushed], &[0.0; 3], &[0.0, 0.0, 0.2]);
        robot.found()[2] == Stuck
    });
    assert!(ticks.unwrap() <= 20, "{ticks:?} ticks of 10 ms");
    assert_eq!(robot.found(), [Healthy, Healthy, Stuck]);
    for _ in 0..300 {
        robot.tick(&[0.0; 3], &[0.0; 3], &[0.0, 0.0, 0.02]);
    }
    assert_eq!(robot.found(), [Healthy, Healthy, Stuck]);
    for _ in 0..13 {
        robot.tick(&[0.0; 3], &[0.0, 0.0, 0.0015], &[0.0, 0.0, 0.02]);
        assert_eq!(robot.found()[2], Stuck);
    }
    robot.tick(&[0.0; 3], &[0.0, 0.0, 0.0015], &[0.0, 0.0, 0.02]);
    assert_eq!(robot.found(), [Healthy; 3]);
}

/// Without resistance, in motion, or not commanded to move, a joint is not stuck.
#[test]
fn a_joint_that_stands_where_it_should_is_not_stuck() {
    for (unexplained, moved, commanded) in
        [(0.0, 0.0, 0.2), (-0.08, 0.001, 0.2), (-0.08, 0.0, 0.001), (0.08, 0.0, 0.2)]
    {
        let mut robot = Robot::settled();
        for tick in 0..60 {
            robot.tick(
                &[0.0, 0.0, unexplained * f64::from(tick)],
                &[0.0, 0.0, moved],
                &[0.0, 0.0, commanded],
            );
            assert_ne!(robot.found()[2], Stuck, "{unexplained} N m, {moved} rad, {commanded} rad/s");
        }
    }
}

/// A joint that is commanded towards a stop may stand at it, by 5° of its encoder's offset; away from it, it is stuck, after
/// a longer time.
#[test]
fn a_joint_at_its_stop_is_not_stuck() {
    for (distance, towards, expected) in
        [(0.05, 1.0, Healthy), (-0.05, 1.0, Healthy), (0.12, 1.0, Stuck), (0.05, -1.0, Stuck)]
    {
        for side in [1.0, -1.0] {
            let mut robot = Robot::settled();
            let stop = robot.position[2] + side * distance;
            robot.stops[2] = if side > 0.0 { (-2.0, stop) } else { (stop, 2.0) };
            let (mut pushed, towards) = (0.0, side * towards);
            for _ in 0..50 {
                pushed -= 0.08 * towards;
                robot.tick(&[0.0, 0.0, pushed], &[0.0; 3], &[0.0, 0.0, 0.2 * towards]);
            }
            assert_eq!(robot.found(), [Healthy, Healthy, expected], "{distance} rad from {stop}");
        }
    }
}

/// What a stop carries is in the mean. Where it carries less, because the joint is commanded away, nothing holds the joint.
#[test]
fn a_joint_that_leaves_its_stop_is_not_stuck() {
    for (distance, expected) in [(0.05, Healthy), (0.12, Stuck)] {
        let mut robot = Robot::settled();
        robot.stops[2] = (robot.position[2] - distance, 2.0);
        for _ in 0..200 {
            robot.tick(&[0.0, 0.0, 4.0], &[0.0; 3], &[0.0; 3]);
        }
        for tick in 0..45 {
            robot.tick(&[0.0, 0.0, 4.0 - 0.08 * f64::from(tick)], &[0.0; 3], &[0.0, 0.0, 0.2]);
        }
        assert_eq!(robot.found(), [Healthy, Healthy, expected], "{distance} rad");
    }
}

/// What its torque does not carry, a stop does: a free joint that rests at one keeps its position, until it leaves it.
#[test]
fn a_free_joint_is_held_by_a_stop() {
    for (distance, expected) in [(0.05, Stuck), (0.12, Free)] {
        let mut robot = Robot::settled();
        for _ in 0..20 {
            let lost = robot.lost(2, 0.0);
            robot.tick(&[0.0, 0.0, lost], &[0.0, 0.0, 0.01], &[0.0; 3]);
        }
        robot.stops[2] = (-2.0, robot.position[2] + distance);
        assert_eq!(robot.found(), [Healthy, Healthy, Free]);
        for _ in 0..150 {
            robot.tick(&[0.0; 3], &[0.0; 3], &[0.0; 3]);
        }
        assert_eq!(robot.found(), [Healthy, Healthy, expected], "{distance} rad");
        robot.tick(&[0.0; 3], &[0.0, 0.0, -0.03], &[0.0; 3]);
        assert_ne!(robot.found()[2], Stuck);
    }
}

/// Nothing is judged while nothing can be compared and a while after, and what was found stays.
#[test]
fn nothing_is_judged_without_measurements() {
    let mut robot = Robot::settled();
    for _ in 0..100 {
        robot.state.interrupt();
    }
    assert_eq!(robot.found(), [Healthy; 3]);
    for _ in 0..20 {
        robot.tick(&[0.0; 3], &[0.0; 3], &[0.0; 3]); // the pause after that
    }
    for _ in 0..20 {
        robot.tick(&[-2.0, 0.0, 0.0], &[0.01, 0.0, 0.0], &[0.0; 3]);
    }
    let found = robot.found();
    assert_ne!(found[0], Healthy);
    robot.state.interrupt();
    robot.state.begin_again(&robot.position);
    assert_eq!(robot.found(), found);
}

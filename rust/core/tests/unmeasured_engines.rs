//! Engines that stop while their thrusts are not measured, each term by itself.

#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use flight_core::control::detect::unmeasured_engines::{
    Changed, UnmeasuredEngines, UnmeasuredEnginesConfig, UnmeasuredState,
};
use flight_core::control::engine_condition::{EngineCondition, EngineFinding, EngineState};
use nalgebra::{Matrix6xX, Vector6};

const STEP: f64 = 0.01;
const THRUST: f64 = 100.0;

/// Three jets upwards, on arms of 0.3 m to the left, to the right and to the back, of which the first is not measured.
struct Robot {
    state: UnmeasuredState,
    conditions: [EngineCondition; 3],
    step: f64,
    a_t: Matrix6xX<f64>,
    thrust: [f64; 3],
    missing: [bool; 3],
    tick: u32,
}

/// What a tick finds: the errors of the thrusts, and the observed wrench in place of the present one.
type Found = ([Option<f64>; 3], Option<Vector6<f64>>);

impl Robot {
    fn new() -> Self {
        let arms = [[0.3, 0.0], [-0.3, 0.0], [0.0, 0.3]];
        let column = |[about_x, about_y]: [f64; 2]| Vector6::new(0.0, 0.0, 1.0, about_x, about_y, 0.0);
        Self {
            state: UnmeasuredState::new(3),
            conditions: [EngineCondition::default(); 3],
            step: STEP,
            a_t: Matrix6xX::from_columns(&arms.map(column)),
            thrust: [THRUST; 3],
            missing: [true, false, false],
            tick: 0,
        }
    }

    /// A tick with this unmodelled wrench, of which nothing is observed yet.
    fn tick(&mut self, unmodelled: Vector6<f64>) -> Found {
        self.observe(Vector6::zeros(), unmodelled)
    }

    fn observe(&mut self, observed: Vector6<f64>, residual: Vector6<f64>) -> Found {
        self.tick += 1;
        for jet in 0..3 {
            let reading = self.thrust[jet] + 0.1 * f64::from(self.tick % 7);
            self.state.take_in(jet, if self.missing[jet] { f64::NAN } else { reading }, STEP);
        }
        self.judge(observed, residual)
    }

    fn judge(&mut self, observed: Vector6<f64>, residual: Vector6<f64>) -> Found {
        let detector = UnmeasuredEngines(UnmeasuredEnginesConfig { force_min: 12.0 });
        let mut findings = [EngineFinding::Nothing; 3];
        let shown = Changed {
            observed: &observed,
            residual: &residual,
            a_t: &self.a_t,
            thrust: &self.thrust,
            covered: self.step,
            elapsed: STEP,
        };
        let wrench = detector.judge(&mut self.state, &self.conditions, &shown, &mut findings);
        let mut errors = [None; 3];
        for (jet, (engine, finding)) in self.conditions.iter_mut().zip(findings).enumerate() {
            errors[jet] = engine.advance(finding, self.thrust[jet], self.step);
            self.thrust[jet] -= errors[jet].unwrap_or(0.0);
        }
        (errors, wrench)
    }

    fn is_stopped(&self, jet: usize) -> bool {
        self.conditions[jet].state == EngineState::Stopped
    }

    /// So many ticks with one wrench; the number of the one that first finds something.
    fn first(&mut self, ticks: usize, unmodelled: Vector6<f64>) -> Option<usize> {
        (1..=ticks).find(|_| self.tick(unmodelled).1.is_some())
    }

    /// The wrench that a jet lacks without `force` \[N\].
    fn without(&self, jet: usize, force: f64) -> Vector6<f64> {
        -force * self.a_t.column(jet)
    }
}

const CALM: Vector6<f64> = Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0);

/// Two ticks make a suspect, three confirm; the thrust, and only this one, is then its error.
#[test]
fn an_engine_that_stops_with_its_sensor_is_found_in_three_ticks() {
    let mut robot = Robot::new();
    assert_eq!(robot.first(5, CALM), None);
    let lost = robot.without(0, THRUST);
    assert_eq!(robot.tick(lost), ([None; 3], None));
    assert_eq!(robot.tick(lost), ([None; 3], None));
    assert_eq!(robot.tick(lost), ([Some(THRUST), None, None], Some(CALM)));
    assert!(robot.is_stopped(0) && !robot.is_stopped(1));
    assert_eq!(robot.thrust, [0.0, THRUST, THRUST]);
}

/// 40 % of the thrust has to be missing, and more than 12 N; the same force too much says nothing.
#[test]
fn a_stopped_engine_lacks_its_thrust() {
    for (thrust, lacked, found) in [
        (THRUST, 41.0, Some(3)),
        (THRUST, 39.0, None),
        (THRUST, -100.0, None),
        (20.0, 12.1, Some(3)),
        (20.0, 11.9, None),
        (11.9, 100.0, None),
    ] {
        let mut robot = Robot::new();
        robot.thrust[0] = thrust;
        assert_eq!(robot.first(5, CALM), None);
        let wrench = robot.without(0, lacked);
        assert_eq!(robot.first(9, wrench), found, "{lacked} of {thrust} N");
    }
}

/// The lack of a jet whose thrust is measured, and a push that has another direction, are no lack of a suspect.
#[test]
fn the_direction_of_the_change_decides() {
    for (wrench, found) in [
        (Robot::new().without(1, THRUST), None),
        (Vector6::new(0.0, 0.0, -100.0, 0.0, 0.0, 0.0), None),
        (Vector6::new(0.0, 0.0, 0.0, 0.0, -30.0, 0.0), None),
        // Of (4 N m)² + (30 N m)² + p² all but p² is explained: nine tenths up to 10.1 N m.
        (Vector6::new(0.0, 0.0, -100.0, -30.0, 10.0, 0.0), Some(3)),
        (Vector6::new(0.0, 0.0, -100.0, -30.0, 10.2, 0.0), None),
    ] {
        let mut robot = Robot::new();
        assert_eq!(robot.first(5, CALM), None);
        assert_eq!(robot.first(9, wrench), found, "{wrench:?}");
    }
}

/// Of several suspects the one whose loss explains the change is found: all thrusts are missing, or frozen.
#[test]
fn the_best_explanation_is_found() {
    for stopped in 0..3 {
        let mut robot = Robot::new();
        robot.missing = [true; 3];
        assert_eq!(robot.first(5, CALM), None);
        let wrench = robot.without(stopped, THRUST);
        assert_eq!(robot.first(9, wrench), Some(3));
        assert_eq!([0, 1, 2].map(|jet| robot.is_stopped(jet)), [0, 1, 2].map(|jet| jet == stopped));
    }
}

/// Bits that repeat for two ticks make a suspect, whatever the innovation is; a new thrust ends it.
#[test]
fn a_frozen_thrust_is_not_a_measured_one() {
    for (frozen, found) in [(0, None), (1, None), (2, Some(3)), (9, Some(3))] {
        let mut robot = Robot::new();
        robot.missing = [false; 3];
        assert_eq!(robot.first(5, CALM), None);
        let lost = robot.without(0, THRUST);
        for _ in 0..=frozen {
            robot.state.take_in(0, 1.0, STEP);
        }
        assert_eq!((1..=4).find(|_| robot.judge(CALM, lost).1.is_some()), found, "{frozen} ticks");
    }
}

/// An engine whose sensor was found to be wrong is a suspect like one without a sensor, whatever it says, after more than 0.1 s.
#[test]
fn a_sensor_that_is_not_used_is_none() {
    for (is_sensor_used, since, found) in [(true, 1.0, None), (false, 1.0, Some(3)), (false, 0.045, Some(8))]
    {
        let mut robot = Robot::new();
        robot.missing = [false; 3];
        assert_eq!(robot.first(5, CALM), None);
        (robot.conditions[0].is_sensor_used, robot.conditions[0].since) = (is_sensor_used, since);
        let lost = robot.without(0, THRUST);
        assert_eq!(robot.first(9, lost), found);
    }
}

/// Times are those that the momentum covers: 0.02 s are three ticks, two measurements every 0.02 s, or one of 0.05 s and more.
#[test]
fn a_confirmation_is_a_time_of_measured_momentum() {
    for (covered, found) in [(0.01, 3), (0.02, 2), (0.05, 1), (0.1, 1)] {
        let mut robot = Robot::new();
        assert_eq!(robot.first(5, CALM), None);
        robot.step = covered;
        let lost = robot.without(0, THRUST);
        assert_eq!(robot.first(9, lost), Some(found), "{covered} s");
        assert_eq!(robot.conditions[0].since, 0.0);
        robot.tick(CALM);
        assert_eq!(robot.conditions[0].since, covered);
    }
}

/// A sensor that measures again, and agrees with the momentum, is used after 0.5 s, and the engine works; one that says
/// nothing, or what the momentum does not show, is not.
#[test]
fn a_stopped_engine_works_if_sensor_and_momentum_agree() {
    for (reading, shown, agreed) in [
        (80.0, 80.0, Some(51)),
        (80.0, 45.0, Some(51)),
        (80.0, 35.0, None),
        (80.0, 0.0, None),
        (11.0, 11.0, None),
    ] {
        let mut robot = Robot::new();
        assert_eq!(robot.first(5, CALM), None);
        let lost = robot.without(0, THRUST);
        assert_eq!(robot.first(3, lost), Some(3));
        assert_eq!(robot.first(60, CALM), None, "too late to revoke it");
        let wrench = robot.without(0, -shown);
        let first = (1..80).find(|tick| {
            let noise = 1e-3 * f64::from(*tick);
            robot.state.take_in(0, reading + noise, STEP);
            robot.judge(wrench, CALM);
            !robot.is_stopped(0)
        });
        assert_eq!(first, agreed, "{reading} N said, {shown} N shown");
        if agreed.is_some() {
            assert!(robot.conditions[0].works() && robot.conditions[0].is_sensor_used);
            assert!((robot.thrust[0] - reading).abs() < 0.1);
        }
    }
}

/// An engine that works gives what was taken away: within half a second that revokes the finding, later nothing does.
#[test]
fn a_finding_is_revoked_by_the_thrust_that_is_given() {
    for (wait, given, revoked) in
        [(1, 51.0, Some(3)), (1, 49.0, None), (1, -100.0, None), (45, 100.0, Some(3)), (48, 100.0, None)]
    {
        let mut robot = Robot::new();
        assert_eq!(robot.first(5, CALM), None);
        let lost = robot.without(0, THRUST);
        assert_eq!(robot.first(3, lost), Some(3));
        assert_eq!(robot.first(wait, CALM), None);
        let back = robot.without(0, -given);
        assert_eq!(robot.first(9, back), revoked, "{given} N after {wait} ticks");
        assert_eq!(robot.is_stopped(0), revoked.is_none());
        assert_eq!(robot.thrust[0], if revoked.is_some() { THRUST } else { 0.0 });
    }
}

/// A stopped engine keeps no thrust, whatever its model says.
#[test]
fn a_stopped_engine_has_no_thrust() {
    let mut robot = Robot::new();
    assert_eq!(robot.first(5, CALM), None);
    let lost = robot.without(0, THRUST);
    assert_eq!(robot.first(3, lost), Some(3));
    robot.thrust[0] = 0.3;
    assert_eq!(robot.tick(CALM).0[0], Some(0.3));
    assert_eq!(robot.thrust[0], 0.0);
}

/// After the first a second engine is found in the same way.
#[test]
fn a_second_engine_is_found_too() {
    let mut robot = Robot::new();
    robot.missing = [true; 3];
    assert_eq!(robot.first(5, CALM), None);
    let (first, second) = (robot.without(0, THRUST), robot.without(2, THRUST));
    assert_eq!(robot.first(3, first), Some(3));
    assert_eq!(robot.first(20, CALM), None);
    assert_eq!(robot.first(3, second), Some(3));
    assert_eq!([0, 1, 2].map(|jet| robot.is_stopped(jet)), [true, false, true]);
}

/// A wrench that lasts is no change: it is compared with the observed one of about a second before, `1 − e^{−t/τ}` of it.
#[test]
fn a_lasting_wrench_is_no_lack() {
    let mut robot = Robot::new();
    let wind = robot.without(0, 39.0);
    for _ in 0..300 {
        assert_eq!(robot.observe(wind, CALM).1, None);
    }
    // Of 39 N 37 are those of before: 76 N are needed, 42 of them in addition.
    let (more, less) = (robot.without(0, 40.0), robot.without(0, 34.0));
    assert_eq!((1..9).find(|_| robot.observe(wind, less).1.is_some()), None);
    assert_eq!((1..9).find(|_| robot.observe(wind, more).1.is_some()), Some(3));
}

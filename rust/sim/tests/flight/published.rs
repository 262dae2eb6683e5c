//! The published numbers: start-up, TEST1, TEST2, ablations, robustness, quirks.

use super::{NO_AIR, STILL, as_published, com_offset, data, ramp_to, rotation_error_at, with};
use crate::common::{assert_within, experiment, fly};
use flight_core::aero::LeverArm;
use flight_sim::config::{AeroKinematics, Integrator};
use flight_sim::{FlightResult, LossReason, ScenarioConfig};

#[track_caller]
fn assert_close(what: &str, found: f64, expected: f64, tolerance: f64) {
    assert_within!(
        (found - expected).abs(),
        tolerance,
        because "the published figure is rounded to the digits it has",
        "{what}: {found}, expected {expected}"
    );
}

#[track_caller]
fn assert_completed(result: &FlightResult, config: &ScenarioConfig) {
    assert!(result.loss.is_none(), "{}: {:?}", config.title, result.loss);
    assert_eq!(result.log.len(), config.n_ticks() + 1, "{}", config.title);
}

/// The flight, and three whose first thrust differs in its last bits.
fn with_last_bits(config: &ScenarioConfig) -> Vec<FlightResult> {
    let nudged = |bits| {
        with(config.clone(), |config| {
            config.simulator.initial.thrust[0] *= 1.0 + f64::from(bits) * f64::EPSILON;
        })
    };
    fly(&[0, 1, 2, 3].map(nudged))
}

/// Flights that differ in last bits all fall or all complete: else the outcome would be no claim.
#[track_caller]
fn assert_outcome_is_certain(flights: &[FlightResult]) {
    let lost: Vec<bool> = flights.iter().map(|flight| flight.loss.is_some()).collect();
    assert!(lost.iter().all(|one| *one == lost[0]), "last bits decide who is lost: {lost:?}");
}

/// The robot is lost by turning over, in a window of time widened by what last bits change of it.
#[track_caller]
fn assert_turned_over(flights: &[FlightResult], from: f64, to: f64) {
    assert_outcome_is_certain(flights);
    let times: Vec<f64> = flights.iter().map(|flight| flight.loss.unwrap().time).collect();
    let (first, last) = times.iter().fold((f64::MAX, f64::MIN), |(a, b), t| (a.min(*t), b.max(*t)));
    let spread = last - first;
    assert!((from - spread..=to + spread).contains(&times[0]), "fell at {times:?} s");
    for flight in flights {
        // Once beyond 60 deg it may also drift off before it has turned by 90.
        assert!(flight.summary.max_rotation_error > 60_f64.to_radians(), "{:?}", flight.loss);
    }
}

/// Every tick of every flight has certified answers, torques within 50 N m that move by at most 3 N m,
/// thrust rates within 100 N/s, joint velocities within 45 deg/s; thrusts follow their rates and stay
/// within what one tick can carry them past a limit.
#[track_caller]
fn assert_sound(result: &FlightResult) {
    let summary = &result.summary;
    assert_eq!(summary.ticks_without_solution, 0.0);
    assert!(data(result, "qp_kkt").iter().all(|kkt| *kkt <= 1e-9), "{}", summary.max_kkt);
    assert!(data(result, "qp_status").iter().all(|status| *status == 0.0));

    let torques: Vec<&[f64]> = data(result, "joint_torque").chunks(23).collect();
    assert!(torques.iter().copied().flatten().all(|torque| torque.abs() <= 50.0));
    for pair in torques.windows(2) {
        let step = pair[0].iter().zip(pair[1]).map(|(a, b)| (b - a).abs()).fold(0.0, f64::max);
        assert_within!(step - 3.0, 1e-12, "torque moved by {step} N m in a tick");
    }
    assert!(data(result, "thrust_rate").iter().all(|rate| rate.abs() <= 100.0));
    let fastest = 45_f64.to_radians();
    assert!(data(result, "joint_velocity_command").iter().all(|velocity| velocity.abs() <= fastest));

    let thrusts: Vec<&[f64]> = data(result, "thrust").chunks(4).collect();
    for (pair, rate) in thrusts.windows(2).zip(data(result, "thrust_rate").chunks(4)) {
        for jet in 0..4 {
            assert_within!((pair[1][jet] - pair[0][jet] - 0.01 * rate[jet]).abs(), 1e-12);
        }
    }
    // max over x of 100 tanh(2 x) 0.01 − x: one tick from x below the limit.
    let overshoot = 0.5_f64.sqrt() - 0.5 * 0.5_f64.sqrt().atanh();
    assert_within!((overshoot - 0.266_42).abs(), 1e-5);
    for (jet, limit) in [(0, 160.0), (1, 160.0), (2, 220.0), (3, 220.0)] {
        let range = thrusts.iter().map(|row| row[jet]);
        assert!(range.clone().fold(f64::MIN, f64::max) <= limit + overshoot);
        assert!(range.fold(f64::MAX, f64::min) >= -overshoot);
    }
}

/// The start-up minimum of the centre of mass is the recorded one; each thing that makes it so matters.
#[test]
fn start_up_minimum_is_the_recorded_one() {
    let start = |change: &dyn Fn(&mut ScenarioConfig)| {
        with(experiment("test1_published"), |config| {
            config.simulator.duration = 5.0;
            change(config);
        })
    };
    let flights = fly(&[
        start(&|_| ()),
        start(&|config| config.simulator.integrator = Integrator::SemiImplicitEuler),
        start(&|config| config.simulator.initial.free_fall_tick = false),
        start(&|config| config.controller = experiment("test2_published").controller),
    ]);
    let [published, semi_implicit, no_free_fall, aware] = flights.as_slice() else { panic!() };
    for flight in [published, aware] {
        let (z, x) = (flight.summary.min_com_height, flight.summary.min_com_x_settling);
        assert_close("z", z, 0.70307, 2e-5);
        assert_close("x", x, -0.01852, 2e-5);
        // Recorded by the authors, read from the limits of a plot.
        assert_close("recorded z", z, 0.70309, 5e-5);
        assert_close("recorded x", x, -0.0185, 5e-5);
    }
    assert_close("semi-implicit", semi_implicit.summary.min_com_height, 0.70320, 1e-5);
    assert_close("no free fall", no_free_fall.summary.min_com_height, 0.7350, 2e-4);
}

/// Greatest joint-error sum per group \[deg\]: torso, arms, legs.
fn joint_error_sums(result: &FlightResult) -> [f64; 5] {
    let mut greatest = [0.0_f64; 5];
    for row in data(result, "joint_position").chunks(23) {
        let mut errors = row.iter().zip(&result.log.joint_setpoint).map(|(s, s_d)| (s - s_d).abs());
        for (group, size) in [3, 4, 4, 6, 6].into_iter().enumerate() {
            let sum: f64 = errors.by_ref().take(size).sum();
            greatest[group] = greatest[group].max(sum.to_degrees());
        }
    }
    greatest
}

/// Without wind: completes, with the tabled errors, thrusts, torques and joint motion.
#[test]
fn without_wind_the_flight_is_the_tabled_one() {
    let config = with(as_published("test2"), |config| config.wind = STILL);
    let vacuum = with(as_published("test1"), |config| {
        config.wind = STILL;
        config.simulator.aero = NO_AIR;
    });
    for (config, flight) in [&config, &vacuum].into_iter().zip(fly(&[config.clone(), vacuum.clone()])) {
        assert_completed(&flight, config);
        assert_sound(&flight);
        assert_within!(com_offset(&flight, 0).abs(), 0.017, because "the published figure is rounded to the digits it has", "x {}", com_offset(&flight, 0));
        assert_within!(com_offset(&flight, 1).abs(), 0.006, "y {}", com_offset(&flight, 1));
        let (least, most) = (flight.summary.thrust_min, flight.summary.thrust_max);
        assert_close("least thrust", least, 61.0, 0.5);
        assert_close("greatest thrust", most, 176.0, 0.5);
        assert_close("torque", flight.summary.max_torque, 31.0, 0.5);
        let printed = [24.0, 77.0, 77.0, 8.6, 8.6];
        for (sum, printed) in joint_error_sums(&flight).into_iter().zip(printed) {
            assert_close("joint errors", sum, printed, 0.5);
        }
    }
}

/// TEST2 with right and with published arms: completes, with the tabled errors and thrusts.
#[test]
fn test2_is_the_tabled_flight() {
    let configs = [as_published("test2"), experiment("test2_published")];
    let flights = fly(&configs);
    let tabled = [(57.9, 179.2), (58.1, 180.9)];
    for ((config, flight), (least, most)) in configs.iter().zip(&flights).zip(tabled) {
        assert_completed(flight, config);
        assert_sound(flight);
        for (axis, limit) in [(0, 0.0175), (1, 0.006), (2, 0.008)] {
            let offset = com_offset(flight, axis);
            assert_within!(offset.abs(), limit, because "the published figure is rounded to the digits it has", "{}: axis {axis} off by {offset} m", config.title);
        }
        assert_close("rotation error", flight.summary.max_rotation_error.to_degrees(), 3.1, 0.05);
        let (found_least, found_most) = (flight.summary.thrust_min, flight.summary.thrust_max);
        assert_close("least thrust", found_least, least, 0.1);
        assert_close("greatest thrust", found_most, most, 0.1);
    }
    let published = &flights[1];
    for (sum, printed) in joint_error_sums(published).into_iter().zip([27.0, 77.0, 77.0, 9.0, 9.0]) {
        assert_close("joint errors", sum, printed, 1.0);
    }
    // The CoM error, 17 mm along x, occurs where the fast leg ends.
    let rows = data(published, "com_position").chunks(3).zip(data(published, "com_setpoint").chunks(3));
    let errors = rows.zip(data(published, "time")).filter(|(_, time)| **time > 3.0);
    let (error, time) = errors
        .map(|((com, desired), time)| ((com[0] - desired[0]).abs(), *time))
        .fold((0.0, 0.0), |worst, here| if here.0 > worst.0 { here } else { worst });
    assert_close("x error", error, 0.017, 0.0005);
    assert_close("time", time, 34.9, 0.05);
}

/// TEST1 with right arms completes, degraded: 33 deg, 0.23 m to the side, thrusts up to 212 N.
///
/// So it does for every start that differs by rounding. With explicit Euler an arc of the legs at 21 s is
/// chaotic, though: of starts that differ by 1e-5 rad one in five falls there.
#[test]
fn test1_with_right_arms_is_degraded() {
    let config = as_published("test1");
    let flights = with_last_bits(&config);
    assert_outcome_is_certain(&flights);
    let flight = &flights[0];
    assert_completed(flight, &config);
    assert_sound(flight);
    assert_close("rotation error", flight.summary.max_rotation_error.to_degrees(), 33.0, 1.0);
    assert_close("y offset", com_offset(flight, 1), -0.23, 0.005);
    assert_close("thrust", flight.summary.thrust_max, 212.0, 2.0);
}

/// TEST1 with published arms turns over: 19.5 deg at 10 s, 39.4 at 12 s, 61 at 15 s, 83 at 20 s, lost
/// between 20 and 28 s.
#[test]
fn test1_with_published_arms_falls() {
    let config = experiment("test1_published");
    let finer = with(config.clone(), |config| config.simulator.substeps = 4);
    let ensembles = [with_last_bits(&config), with_last_bits(&finer)];
    assert_turned_over(&ensembles[0], 20.0, 28.0);
    // 19.5 to 34.1 s among 80 flights of this one whose start differed by 1e-14 or 1e-9 rad.
    assert_turned_over(&ensembles[1], 19.0, 36.0);
    let flights = ensembles.map(|mut ensemble| ensemble.swap_remove(0));
    for flight in &flights {
        assert_sound(flight);
        assert_close("10 s", rotation_error_at(flight, 10.0), 19.5, 0.15);
        assert_close("12 s", rotation_error_at(flight, 12.0), 39.4, 0.3);
        assert_close("15 s", rotation_error_at(flight, 15.0), 61.0, 0.5);
    }
    assert_close("20 s", rotation_error_at(&flights[0], 20.0), 83.0, 1.0);
    // Of the finer step 24 flights from starts 1e-13 rad apart agree to 0.01 deg at 19 s, and are at 30 to 75 deg at 20 s.
    assert_close("19 s", rotation_error_at(&flights[1], 19.0), 80.0, 1.0);
}

/// Without `A_a f_a` the aware controller falls as the baseline does; without `Λ_a` or `J_aᵀ f_a`
/// nothing changes but, without the latter, 4 mm to the side.
#[test]
fn only_the_momentum_feedback_matters() {
    let flights = fly(&[
        experiment("test2_published"),
        experiment("test2_without_lambda_a"),
        experiment("test2_without_torque_feedforward"),
        experiment("test2_without_aero_momentum"),
    ]);
    let [full, no_lambda, no_torque, no_momentum] = flights.as_slice() else { panic!() };
    for flight in [no_lambda, no_torque] {
        assert!(flight.loss.is_none());
        assert_sound(flight);
        let (a, b) = (&flight.summary, &full.summary);
        assert_close("rotation", a.max_rotation_error.to_degrees(), b.max_rotation_error.to_degrees(), 1.0);
        assert_close("least thrust", a.thrust_min, b.thrust_min, 1.0);
        assert_close("greatest thrust", a.thrust_max, b.thrust_max, 1.0);
        // Not only at their worst moment:
        let rotation = data(flight, "rotation_error").iter().zip(data(full, "rotation_error"));
        let apart = rotation.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max).to_degrees();
        assert!(apart < 2.0, "rotation errors up to {apart} deg apart");
    }
    assert_close("y without Λ_a", com_offset(no_lambda, 1).abs(), com_offset(full, 1).abs(), 1e-4);
    assert_close("y without J_aᵀ f_a", com_offset(no_torque, 1), 0.010, 0.0005);
    assert_turned_over(&with_last_bits(&experiment("test2_without_aero_momentum")), 20.0, 33.0);
    assert_close("like the baseline", rotation_error_at(no_momentum, 12.0), 39.4, 0.3);
}

/// Aerodynamics frozen at the first tick: the baseline falls at 16 s, the aware controller in the fast
/// leg.
#[test]
fn frozen_kinematics_fell_both_controllers() {
    let freeze = |config: &mut ScenarioConfig| config.simulator.kinematics = AeroKinematics::Frozen;
    let test1 = with_last_bits(&with(experiment("test1_published"), freeze));
    assert_turned_over(&test1, 16.1, 16.5);
    assert_turned_over(&with_last_bits(&with(experiment("test2_published"), freeze)), 27.0, 28.0);
    assert_turned_over(&with_last_bits(&with(as_published("test2"), freeze)), 25.0, 28.0);
    assert!(matches!(test1[0].loss.unwrap().reason, LossReason::RotationError(_)));
}

/// The wrong arm on one side only is worse than on both: the aware controller falls as well.
#[test]
fn the_lever_arm_quirk_on_one_side_fells_the_aware_controller() {
    let simulator = with(as_published("test2"), |c| c.simulator.lever_arm = LeverArm::Unrotated);
    let controller = with(as_published("test2"), |c| c.controller.law.lever_arm = LeverArm::Unrotated);
    let all_of_controller =
        with(experiment("test2_published"), |c| c.simulator.lever_arm = LeverArm::Rotated);
    // The document says 25 to 27 s. With starts that differ by 1e-9 rad we find 25.9 to 28.3 s, 22.1 to 29.3 s
    // and 23.0 to 23.3 s.
    assert_turned_over(&with_last_bits(&simulator), 25.0, 29.0);
    assert_turned_over(&with_last_bits(&controller), 21.0, 31.0);
    assert_turned_over(&with_last_bits(&all_of_controller), 22.5, 24.0);
}

/// The baseline's rotation error grows with the side wind as tabled, and it survives all of them.
#[test]
fn the_baseline_degrades_with_the_wind() {
    let speeds = [6.0, 8.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0];
    let tabled = [17.0, 23.0, 33.0, 42.0, 51.0, 58.0, 64.0, 72.0];
    let side = |speed: f64| with(as_published("test1"), |config| config.wind = ramp_to([0.0, -speed, 0.0]));
    for (speed, tabled) in speeds.into_iter().zip(tabled) {
        let flights = with_last_bits(&side(speed));
        assert_outcome_is_certain(&flights);
        let flight = &flights[0];
        assert!(flight.loss.is_none(), "{speed} m/s: {:?}", flight.loss);
        let error = flight.summary.max_rotation_error.to_degrees();
        assert_close(&format!("{speed} m/s"), error, tabled, 0.6);
    }
}

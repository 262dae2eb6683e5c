//! Laws of the closed loop, whatever the numbers: where it settles, and what a finer step tends to.

use super::{as_published, data, ramp_to, with};
use crate::common::{Loop, assert_within, experiment, fly};
use flight_core::RobotState;
use flight_core::aero::LeverArm;
use flight_core::control::mpc::clearance::Clearance;
use flight_core::kinematics::Kinematics;
use flight_core::spatial::vee_of_skew_part;
use flight_io::load_robot;
use flight_sim::config::Integrator;
use flight_sim::disturbances::{FailureKind, JetFailure};
use flight_sim::{FlightLog, Outcome, ScenarioConfig, SensorsConfig, WindConfig};
use nalgebra::Vector3;

/// A gust of which the wind ahead is measured turns the robot by less than half as much as one that is not.
#[test]
fn a_gust_that_is_measured_ahead_turns_the_robot_less() {
    for velocity in [[0.0, -15.0, 0.0], [-15.0, 0.0, 0.0]] {
        let gust = with(experiment("test2_mpc"), |config| {
            config.simulator.duration = 4.5;
            config.wind = WindConfig::Ramp { velocity, ramp_start: 3.0, ramp_end: 3.5 };
        });
        let ahead = Some(SensorsConfig { wind_preview: 0.8, ..SensorsConfig::default() });
        let seen = with(gust.clone(), |config| config.simulator.sensors = ahead);
        let [unseen, seen] = [gust, seen].map(|config| {
            let log = fly(&[config]).remove(0).log;
            let errors = log.series("rotation_error").unwrap();
            (250..450).fold(0.0_f64, |most, tick| most.max(errors.row(tick)[0]))
        });
        assert!(seen < 0.5 * unseen, "{velocity:?}: {seen} rad instead of {unseen}");
    }
}

/// Least distance along a flight of exhausts and turbines from what the plan keeps them apart from \[m\].
fn least_distance(config: &ScenarioConfig, log: &FlightLog) -> f64 {
    let robot = load_robot(&config.robot).unwrap();
    let clearance = config.controller.law.mpc.as_ref().unwrap().clearance.as_ref();
    let mut clearance = Clearance::new(clearance, &robot, 0).unwrap();
    let (mut kinematics, mut state) = (Kinematics::new(&robot), RobotState::zero(robot.joints.len()));
    let joints = log.series("joint_position").unwrap();
    let mut least = f64::INFINITY;
    for row in (0..log.len()).step_by(5) {
        state.joint_position.copy_from_slice(joints.row(row));
        kinematics.update(&robot, &state);
        clearance.update(&kinematics, &[]);
        least = clearance.distance.iter().fold(least, |least, distance| least.min(*distance));
    }
    least
}

/// Without the clearance the left arm's turbine enters the leg by 6 cm on the mission, the other one the pelvis in the
/// descent.
#[test]
fn plans_keep_exhausts_and_turbines_off_the_body() {
    let mission = with(experiment("min_time"), |config| {
        config.controller = experiment("test2_mpc").controller;
    });
    let descent = with(experiment("test2_mpc"), |config| {
        config.simulator.duration = 24.0;
        config.disturbances.jets.failure =
            Some(JetFailure { jet: "r_arm_jet".into(), time: 18.0, kind: FailureKind::Off, decay: 0.0 });
    });
    for (config, end, expected) in [(mission, Outcome::Completed, 0.02), (descent, Outcome::Landed, 0.005)] {
        let result = fly(std::slice::from_ref(&config)).remove(0);
        assert_eq!(result.outcome, end);
        let least = least_distance(&config, &result.log);
        assert!(least > expected, "{}: {least} m", config.title);
    }
}

/// What the model does not contain changes the integral of the joints' velocity errors for good; a plan that expected it
/// to act on the joints would hold the robot 20 cm beside its set-point.
#[test]
fn a_wrong_centre_of_mass_leaves_no_offset() {
    let config = with(experiment("test2_mpc"), |config| {
        config.simulator.duration = 5.0;
        config.wind = WindConfig::Ramp { velocity: [0.0; 3], ramp_start: 0.0, ramp_end: 1.0 };
        config.disturbances.model_error.com_offset = [0.04, 0.0, 0.0];
    });
    let log = fly(&[config]).remove(0).log;
    let (com, setpoint) = (log.series("com_position").unwrap(), log.series("com_setpoint").unwrap());
    let last = log.len() - 1;
    let error = Vector3::from_column_slice(com.row(last)) - Vector3::from_column_slice(setpoint.row(last));
    // The model's centre of mass is 0.5 cm off.
    assert!(error.norm() < 0.01, "{error}");
}

/// A constant force and moment that the controller does not know of: the attitude settles at
/// `e = (1 + I₀/c₀) d`, d the moment in body axes, and the CoM at `(K_D + 1)/(K_P m)` metres per newton.
#[test]
fn an_unknown_wrench_is_held_with_an_error() {
    let cases = [
        ([0.0, -4.0, 0.0], LeverArm::Rotated),
        ([0.0, -8.0, 0.0], LeverArm::Rotated),
        ([0.0, -6.0, 0.0], LeverArm::Unrotated),
        ([-6.0, 0.0, 0.0], LeverArm::Rotated),
        ([5.0, 4.0, 0.0], LeverArm::Rotated),
    ];
    for (wind, lever_arm) in cases {
        let config = with(as_published("test1"), |config| {
            config.simulator.lever_arm = lever_arm;
            config.mission = experiment_mission("hover");
        });
        let mut flight = Loop::new(&config);
        let blow = |time: f64| Vector3::from(wind) * ((time - 5.0) / 5.0).clamp(0.0, 1.0);
        flight.run(80.0, blow);
        assert_within!(flight.plant.state().velocity.amax(), 1e-3, because "the law is the limit of a smooth transient that has not quite died out", "settled");

        let terms = flight.controller.terms();
        let rotation = flight.plant.state().base.rotation;
        let (force, moment) = flight.plant.link_forces().wrench_about(&flight.plant.kinematics().com);
        let gains = &config.controller.law.momentum;

        let error = vee_of_skew_part(&(terms.setpoint.rotation.transpose() * rotation));
        let d = rotation.transpose() * moment;
        let law = d + flight.controller.state().inertia_0_b() * d / gains.c0;
        assert_within!((error - law).norm(), 0.01 * law.norm(), because "the law is the limit of a smooth transient that has not quite died out", "{wind:?}: e = {error}, law {law}");
        assert!(law.norm() > 0.1, "{wind:?} tips the robot");

        let offset = flight.plant.kinematics().com - terms.setpoint.com_position;
        let per_newton = (gains.kd_linear[0] + 1.0) / (gains.kp_linear[0] * flight.plant.kinematics().mass());
        assert_within!((per_newton - 0.0135).abs(), 5e-5, because "the law is the limit of a smooth transient that has not quite died out", "{per_newton} m/N");
        let law = force * per_newton;
        assert_within!((offset - law).norm(), 0.005 * law.norm(), because "the law is the limit of a smooth transient that has not quite died out", "{wind:?}: CoM off by {offset}, law {law}");
    }
}

fn experiment_mission(name: &str) -> flight_io::MissionConfig {
    let file = crate::common::configs("mission").join(name).with_extension("toml");
    flight_io::load(&file).unwrap()
}

/// The aware controller whose model has the wrench holds it without an error.
#[test]
fn a_known_wrench_is_held_without_an_error() {
    let config = with(as_published("test2"), |config| config.mission = experiment_mission("hover"));
    let mut flight = Loop::new(&config);
    flight.run(60.0, |time| Vector3::new(0.0, -10.0, 0.0) * ((time - 5.0) / 5.0).clamp(0.0, 1.0));
    let terms = flight.controller.terms();
    let error = terms.setpoint.rotation.transpose() * flight.plant.state().base.rotation;
    assert_within!(vee_of_skew_part(&error).norm(), 2e-3);
    assert_within!((flight.plant.kinematics().com - terms.setpoint.com_position).norm(), 2e-4);
}

/// Pose and posture after three seconds in a rising wind.
fn end(config: &ScenarioConfig) -> Vec<f64> {
    let result = &fly(std::slice::from_ref(config))[0];
    let last = |name: &str| {
        let series = result.log.series(name).unwrap();
        series.row(result.log.len() - 1).to_vec()
    };
    [last("base_position"), last("base_quaternion"), last("joint_position"), last("thrust")].concat()
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// Both integrators are of first order and have the same limit: halving the sub-step halves the
/// distance to it.
#[test]
fn substeps_agree_in_the_limit() {
    let flight = |integrator: Integrator, substeps: u32| {
        end(&with(experiment("test1"), |config| {
            config.simulator.duration = 3.0;
            config.simulator.substeps = substeps;
            config.simulator.integrator = integrator;
            config.wind = WindConfig::Ramp { velocity: [4.0, -8.0, 0.0], ramp_start: 0.0, ramp_end: 3.0 };
        }))
    };
    // Richardson: from two first-order answers to one of second order.
    let fine = flight(Integrator::SemiImplicitEuler, 64);
    let coarse = flight(Integrator::SemiImplicitEuler, 32);
    let limit: Vec<f64> = fine.iter().zip(&coarse).map(|(fine, coarse)| 2.0 * fine - coarse).collect();
    for integrator in [Integrator::SemiImplicitEuler, Integrator::ExplicitEuler] {
        let errors = [4, 8, 16].map(|substeps| distance(&flight(integrator, substeps), &limit));
        for pair in errors.windows(2) {
            let ratio = pair[0] / pair[1];
            assert!((1.8..2.2).contains(&ratio), "{integrator:?}: errors {errors:?}");
        }
    }
}

/// Mirror: a wind from the other side tips the baseline to the other side by about as much.
#[test]
fn left_and_right_wind_are_mirror_images() {
    let side = |y: f64| {
        with(as_published("test1"), |config| {
            config.wind = ramp_to([0.0, y, 0.0]);
            config.simulator.duration = 15.0;
        })
    };
    let flights = fly(&[side(-6.0), side(6.0)]);
    let y_at_end = |k: usize| {
        let com = data(&flights[k], "com_position");
        com[com.len() - 2] - 0.000_41
    };
    assert_within!(
        (y_at_end(0) + y_at_end(1)).abs(),
        0.02 * y_at_end(1).abs(),
        "{} {}",
        y_at_end(0),
        y_at_end(1)
    );
}

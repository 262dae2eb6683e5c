//! The wind from the wrench: where the model is the world's, the estimate goes to the wind, and says how sure it is.

#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]

use crate::common::{Loop, Running, assert_within, at, difference, experiment};
use flight_core::WindObserver;
use flight_core::aero::{LinkConventions, LinkForces};
use flight_core::control::estimate::disturbance_observer::{
    DisturbanceObserverConfig, MomentumSample, ObserverState,
};
use flight_core::control::estimate::wind_observer::{
    FORCE_NOISE, FORCE_STD, GAIN, MOMENT_ARM, RELATIVE_STD, VERTICAL_STD, VERTICAL_TIME, WALK, WindState,
};
use flight_core::control::measure::measurement::Sampling;
use flight_core::control::{Estimate, Terms};
use flight_core::kinematics::Kinematics;
use flight_io::{load_aero, load_robot};
use flight_sim::ScenarioConfig;
use nalgebra::{DVector, Matrix3, Vector3};

const STEP: f64 = 0.01;

fn flight() -> ScenarioConfig {
    let mut config = experiment("test2_observer");
    config.controller.law.wind_observer = true;
    config
}

/// The world of this flight, whose controller is given the wind.
fn world() -> Loop {
    Loop::new(&experiment("test2_observer"))
}

fn observer(config: &ScenarioConfig) -> (WindObserver, WindState) {
    let robot = load_robot(&config.robot).unwrap();
    let aero = load_aero(&config.controller.aero, &robot).unwrap();
    let observer = WindObserver::new(robot, aero).unwrap();
    let state = observer.start();
    (observer, state)
}

fn update(observer: &mut WindObserver, state: &mut WindState, controller: &Running) {
    let (terms, estimate) = (controller.terms(), controller.state().estimate());
    let Terms { kinematics, dynamics, momentum, contact, .. } = terms;
    observer.update(state, estimate, kinematics, &dynamics.momentum, &momentum.a_t, &contact.soles);
}

/// Hovers in a wind that blows from the first tick on, given to the controller; what the observer makes of it.
fn estimate(wind: Vector3<f64>, seconds: f64) -> WindState {
    let (mut world, (mut observer, mut state)) = (world(), observer(&flight()));
    for _ in 0..flight_ticks(seconds) {
        world.observe(&wind);
        update(&mut observer, &mut state, &world.controller);
        world.advance(&wind);
    }
    state
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few hundred")]
fn flight_ticks(seconds: f64) -> usize {
    (seconds / STEP).round() as usize
}

/// With the world's own model a horizontal wind is found.
#[test]
fn the_estimate_goes_to_the_wind() {
    for wind in [Vector3::new(6.0, -8.0, 0.0), Vector3::new(-9.0, 3.0, 0.0)] {
        let found = estimate(wind, 10.0).wind();
        assert_within!((found - wind).norm(), 0.1, because "what a step adds to the momentum (M85) is a vertical force until the robot rests", "{found} of {wind}");
    }
}

/// A base that is measured more slowly than ticks follow each other shows the same wind; what the jets did between two
/// measurements counts.
#[test]
fn a_slowly_measured_base_shows_the_same_wind() {
    let wind = Vector3::new(6.0, -8.0, 0.0);
    for every in [2, 5] {
        let (mut world, (mut observer, mut state)) = (world(), observer(&flight()));
        for tick in 0..flight_ticks(10.0) {
            world.observe(&wind);
            let Terms { kinematics, dynamics, momentum, contact, .. } = world.controller.terms();
            let sampling = if tick % every == 0 { Sampling::Measured } else { Sampling::Between };
            let used = Estimate { momentum: sampling, ..world.controller.state().estimate().clone() };
            let (l, a_t) = (&dynamics.momentum, &momentum.a_t);
            observer.update(&mut state, &used, kinematics, l, a_t, &contact.soles);
            world.advance(&wind);
        }
        let error = (state.wind() - wind).norm();
        assert_within!(error, 0.2, because "the vertical force of M85, as in every tick", "every {every}: {}", state.wind());
    }
}

/// Before anything is measured its uncertainty is that of its prior; a measured force takes some of it away.
#[test]
fn it_says_how_sure_it_is() {
    let (_, first) = observer(&flight());
    assert_eq!(first.wind(), Vector3::zeros());
    assert_within!((first.std() - Vector3::new(WALK, WALK, VERTICAL_STD)).amax(), 1e-12);
    let sure = estimate(Vector3::new(0.0, -10.0, 0.0), 3.0).std();
    println!("{sure}");
    // Along the wind the force determines most; the walk alone would double in three seconds.
    assert!(sure.y < sure.x && sure.x < 2.0 * WALK && sure.z <= VERTICAL_STD, "{sure}");
}

/// The filter of M94 and M110 in its information form: `P⁻¹ = (A P Aᵀ + Q)⁻¹ + Hᵀ R⁻¹ H`, `K = P Hᵀ R⁻¹`.
#[test]
fn each_tick_is_the_equations_of_the_filter() {
    let config = flight();
    let (mut world, (mut observer, mut state)) = (world(), observer(&config));
    let robot = load_robot(&config.robot).unwrap();
    let mut aero = load_aero(&config.controller.aero, &robot).unwrap();
    let mut forces = LinkForces::new(&robot);
    let mut wrench_in = |kinematics: &Kinematics, wind: Vector3<f64>| {
        forces.update(&robot, kinematics, LinkConventions::default(), &mut aero, &wind);
        forces.wrench_about(&kinematics.com)
    };
    let wide =
        DisturbanceObserverConfig { gain_force: GAIN, gain_moment: GAIN, force_max: 1e4, moment_max: 1e4 };
    let mut acting = ObserverState::default();
    let kept = (-STEP / VERTICAL_TIME).exp();
    let (walk, vertical) = (WALK.powi(2), VERTICAL_STD.powi(2));
    let a = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, kept));
    let q = Matrix3::from_diagonal(&Vector3::new(walk * STEP, walk * STEP, vertical * (1.0 - kept * kept)));
    let information = Matrix3::from_diagonal(&FORCE_NOISE.map(|r| GAIN * STEP / (r * r)));
    let mut wind = Vector3::zeros();
    let mut p = Matrix3::from_diagonal(&Vector3::new(walk, walk, vertical));
    let (mut c, mut unexplained) = (Matrix3::zeros(), 0.0);
    let blowing = Vector3::new(6.0, -8.0, 1.0);
    for tick in 0..5 {
        world.observe(&blowing);
        let (terms, thrust) = (world.controller.terms(), world.plant.jets().thrust());
        update(&mut observer, &mut state, &world.controller);

        let mut rate = &terms.momentum.a_t * DVector::from_column_slice(thrust);
        rate[2] -= terms.kinematics.mass() * robot.gravity;
        let rate = rate.fixed_rows::<6>(0).into_owned();
        let sample = MomentumSample { momentum: terms.dynamics.momentum, rate };
        acting.observe(&wide, Sampling::Measured, STEP, sample);
        let observed = *acting.wrench();
        wind = a * wind;
        let (force, moment) = wrench_in(&terms.kinematics, wind);
        let h = Matrix3::from_columns(&[0, 1, 2].map(|axis| {
            let mut shifted = wind;
            shifted[axis] += 0.1;
            (wrench_in(&terms.kinematics, shifted).0 - force) / 0.1
        }));
        p = ((a * p * a + q).try_inverse().unwrap() + h.transpose() * information * h).try_inverse().unwrap();
        let k = p * h.transpose() * information;
        wind += k * (observed.fixed_rows::<3>(0) - force);
        c = (Matrix3::identity() - k * h) * a * c + k;
        let (force, moment) = (observed.fixed_rows::<3>(0), observed.fixed_rows::<3>(3) - moment);
        unexplained += (1.0 - (-STEP / 2.0).exp()) * (moment.norm_squared() - unexplained);
        let lasting = FORCE_STD.powi(2)
            + RELATIVE_STD.powi(2) * force.norm_squared()
            + unexplained / MOMENT_ARM.powi(2);
        let std = (p + lasting * c * c.transpose()).diagonal().map(f64::sqrt);
        assert_within!(difference(state.wind(), wind), 1e-10, because "two forms of one filter, matrices with condition numbers below 1e4", "tick {tick}");
        assert_within!(difference(state.std(), std), 1e-10, because "as above", "tick {tick}");
        world.advance(&blowing);
    }
    assert!(wind.norm() > 0.1, "{wind}");
}

/// What happened in more than 0.15 s of refused measurements is no wind: here a metre per second of velocity.
#[test]
fn over_refused_measurements_nothing_is_compared() {
    let mut world = Loop::new(&flight());
    world.run(2.0, |_| Vector3::new(0.0, -8.0, 0.0));
    let before = world.controller.state().wind().unwrap().wind();
    let (mut state, thrust) = (world.plant.state().clone(), world.plant.jets().thrust_feedback().to_vec());
    let time = world.controller.state().time();
    state.velocity[0] += 1.0;
    for tick in 1..=17 {
        let time = time + f64::from(tick) * STEP;
        let thrust = if tick < 17 { &[][..] } else { &thrust };
        world.controller.tick(&at(time, &state, thrust));
    }
    let change = (world.controller.state().wind().unwrap().wind() - before).norm();
    assert!(change < 0.5, "{change} m/s");
}

#[test]
fn without_a_model_of_the_air_it_is_refused() {
    let mut config = flight();
    config.controller.aero = flight_io::AeroConfig::Off {};
    let text = config.controller(load_robot(&config.robot).unwrap()).unwrap_err().to_string();
    assert!(text.contains("controller.aero.model is off"), "{text}");
}

//! The wind from the wrench: where the model is the world's, the estimate goes to the wind, and says how sure it is.

#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]

use crate::common::{Loop, assert_within, difference, experiment};
use flight_core::aero::{LinkConventions, LinkForces};
use flight_core::control::Terms;
use flight_core::control::guard::observer::{ObserverConfig, ObserverState, Sample};
use flight_core::control::guard::wind_observer::{WindObserverConfig, WindState};
use flight_core::kinematics::Kinematics;
use flight_core::{Measurement, WindObserver};
use flight_io::{load_aero, load_robot};
use flight_sim::ScenarioConfig;
use nalgebra::{DVector, Matrix3, Vector3};

const STEP: f64 = 0.01;

fn flight(settings: WindObserverConfig) -> ScenarioConfig {
    let mut config = experiment("test2_observer");
    config.controller.law.wind_observer = Some(settings);
    config
}

/// The world of this flight, whose controller is given the wind.
fn world(config: &ScenarioConfig) -> Loop {
    let mut config = config.clone();
    config.controller.law.wind_observer = None;
    Loop::new(&config)
}

fn observer(config: &ScenarioConfig) -> (WindObserver, WindState) {
    let robot = load_robot(&config.robot).unwrap();
    let aero = load_aero(&config.controller.aero, &robot).unwrap();
    let settings = config.controller.law.wind_observer.as_ref().unwrap();
    let observer = WindObserver::new(settings, robot, aero, STEP).unwrap();
    let state = observer.start();
    (observer, state)
}

fn update(observer: &mut WindObserver, state: &mut WindState, terms: &Terms) {
    let Terms { measurement, kinematics, dynamics, momentum, contact, .. } = terms;
    observer.update(state, measurement, kinematics, &dynamics.momentum, &momentum.a_t, &contact.soles);
}

/// Hovers in a wind that blows from the first tick on, given to the controller; what the observer makes of it.
fn estimate(settings: WindObserverConfig, wind: Vector3<f64>, seconds: f64) -> WindState {
    let config = flight(settings);
    let (mut world, (mut observer, mut state)) = (world(&config), observer(&config));
    for _ in 0..flight_ticks(seconds) {
        world.observe(&wind);
        update(&mut observer, &mut state, world.controller.terms());
        world.advance(&wind);
    }
    state
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few hundred")]
fn flight_ticks(seconds: f64) -> usize {
    (seconds / STEP).round() as usize
}

/// With the world's own model and vertical winds as uncertain as the others, every component is found.
#[test]
fn the_estimate_goes_to_the_wind() {
    let settings = WindObserverConfig {
        walk: 10.0,
        vertical_std: 10.0,
        vertical_time: 1e6,
        force_noise: [0.01; 3],
        ..WindObserverConfig::default()
    };
    for wind in [Vector3::new(6.0, -8.0, 1.0), Vector3::new(-9.0, 3.0, -0.5)] {
        let found = estimate(settings, wind, 5.0).wind();
        assert_within!((found - wind).norm(), 0.05, because "fifteen time constants of the observed force, and what a step adds to the momentum (M85)", "{found} of {wind}");
    }
}

/// Before anything is measured its uncertainty is that of the configuration; a measured force takes some of it away.
#[test]
fn it_says_how_sure_it_is() {
    let settings = WindObserverConfig::default();
    let (_, first) = observer(&flight(settings));
    assert_eq!(first.wind(), Vector3::zeros());
    assert_within!(
        (first.std() - Vector3::new(settings.walk, settings.walk, settings.vertical_std)).amax(),
        1e-12
    );
    let sure = estimate(settings, Vector3::new(0.0, -10.0, 0.0), 3.0).std();
    let unsure = WindObserverConfig { relative_std: 0.5, ..settings };
    let unsure = estimate(unsure, Vector3::new(0.0, -10.0, 0.0), 3.0).std();
    assert!(sure.y < unsure.y && sure.x < unsure.x, "{sure} {unsure}");
    assert!(sure.y < 1.0, "{sure}");
    assert!(sure.z <= settings.vertical_std, "{sure}");
}

/// The filter of M94 and M110 in its information form: `P⁻¹ = (A P Aᵀ + Q)⁻¹ + Hᵀ R⁻¹ H`, `K = P Hᵀ R⁻¹`.
#[test]
fn each_tick_is_the_equations_of_the_filter() {
    let settings = WindObserverConfig {
        vertical_time: 0.1,
        force_noise: [0.3, 0.4, 0.5],
        force_std: 0.7,
        ..WindObserverConfig::default()
    };
    let config = flight(settings);
    let (mut world, (mut observer, mut state)) = (world(&config), observer(&config));
    let robot = load_robot(&config.robot).unwrap();
    let mut aero = load_aero(&config.controller.aero, &robot).unwrap();
    let mut forces = LinkForces::new(&robot);
    let mut wrench_in = |kinematics: &Kinematics, wind: Vector3<f64>| {
        forces.update(&robot, kinematics, LinkConventions::default(), &mut aero, &wind);
        forces.wrench_about(&kinematics.com)
    };
    let gain = settings.gain;
    let wide = ObserverConfig { gain_force: gain, gain_moment: gain, force_max: 1e4, moment_max: 1e4 };
    let mut acting = ObserverState::default();
    let kept = (-STEP / settings.vertical_time).exp();
    let (walk, vertical) = (settings.walk.powi(2), settings.vertical_std.powi(2));
    let a = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, kept));
    let q = Matrix3::from_diagonal(&Vector3::new(walk * STEP, walk * STEP, vertical * (1.0 - kept * kept)));
    let information =
        Matrix3::from_diagonal(&Vector3::from(settings.force_noise).map(|r| gain * STEP / (r * r)));
    let mut wind = Vector3::zeros();
    let mut p = Matrix3::from_diagonal(&Vector3::new(walk, walk, vertical));
    let (mut c, mut unexplained) = (Matrix3::zeros(), 0.0);
    let blowing = Vector3::new(6.0, -8.0, 1.0);
    for tick in 0..5 {
        world.observe(&blowing);
        let (terms, thrust) = (world.controller.terms(), world.plant.jets().thrust());
        update(&mut observer, &mut state, terms);

        let mut rate = &terms.momentum.a_t * DVector::from_column_slice(thrust);
        rate[2] -= terms.kinematics.mass() * robot.gravity;
        let rate = rate.fixed_rows::<6>(0).into_owned();
        let observed = acting.update(&wide, STEP, Sample { momentum: terms.dynamics.momentum, rate });
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
        let lasting = settings.force_std.powi(2)
            + settings.relative_std.powi(2) * force.norm_squared()
            + unexplained / settings.moment_arm.powi(2);
        let std = (p + lasting * c * c.transpose()).diagonal().map(f64::sqrt);
        assert_within!(difference(state.wind(), wind), 1e-10, because "two forms of one filter, matrices with condition numbers below 1e4", "tick {tick}");
        assert_within!(difference(state.std(), std), 1e-10, because "as above", "tick {tick}");
        world.advance(&blowing);
    }
    assert!(wind.norm() > 0.1, "{wind}");
}

/// What happened over a measurement of another robot is no wind: here a metre per second of velocity.
#[test]
fn over_a_refused_measurement_nothing_is_compared() {
    let config = flight(WindObserverConfig::default());
    let mut world = Loop::new(&config);
    world.run(2.0, |_| Vector3::new(0.0, -8.0, 0.0));
    let before = world.controller.state().wind().unwrap().wind();
    let (mut state, thrust) = (world.plant.state().clone(), world.plant.jets().thrust_feedback().to_vec());
    let time = world.controller.state().time();
    for (tick, thrust) in [(1.0, [].as_slice()), (2.0, &thrust)] {
        let time = time + tick * STEP;
        state.velocity[0] += 0.5;
        let (wind, foot_wrenches) = (Vector3::zeros(), &[] as &[_]);
        world.controller.tick(&Measurement { time, state: &state, thrust, wind, foot_wrenches });
    }
    let change = (world.controller.state().wind().unwrap().wind() - before).norm();
    assert!(change < 0.5, "{change} m/s");
}

#[test]
fn bad_wind_observers_are_refused_by_name() {
    type Change = fn(&mut ScenarioConfig);
    let refusals: [(&str, Change); 7] = [
        ("controller.wind_observer.gain is 0", |c| {
            c.controller.law.wind_observer.as_mut().unwrap().gain = 0.0;
        }),
        ("controller.wind_observer.gain is 101", |c| {
            c.controller.law.wind_observer.as_mut().unwrap().gain = 101.0;
        }),
        ("controller.wind_observer.walk is NaN", |c| {
            c.controller.law.wind_observer.as_mut().unwrap().walk = f64::NAN;
        }),
        ("controller.wind_observer.force_noise is -1", |c| {
            c.controller.law.wind_observer.as_mut().unwrap().force_noise[1] = -1.0;
        }),
        ("controller.wind_observer.moment_arm is 0", |c| {
            c.controller.law.wind_observer.as_mut().unwrap().moment_arm = 0.0;
        }),
        ("controller.wind_observer.relative_std is -1", |c| {
            c.controller.law.wind_observer.as_mut().unwrap().relative_std = -1.0;
        }),
        ("controller.aero.model is off", |c| c.controller.aero = flight_io::AeroConfig::Off {}),
    ];
    for (expected, change) in refusals {
        let mut config = flight(WindObserverConfig::default());
        change(&mut config);
        let text = config.controller(load_robot(&config.robot).unwrap()).unwrap_err().to_string();
        assert!(text.contains(expected), "{text}");
    }
    let config = flight(WindObserverConfig { gain: 100.0, ..WindObserverConfig::default() });
    assert!(config.controller(load_robot(&config.robot).unwrap()).is_ok(), "1 / time step is the greatest");
}

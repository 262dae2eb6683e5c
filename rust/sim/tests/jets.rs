//! Claims about the jets: the engine's equations, the throttle loop, the estimator, and what is
//! refused.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]
#![allow(clippy::unreadable_literal, reason = "coefficients stand as they were published")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::{assert_within, relative};
use flight_core::jets::{
    EkfConfig, EngineDynamics, EngineModel, ThrustEkf, ThrustRateController, thrust_force, thrust_wrench,
};
use flight_core::robot::{EngineCoefficients, Frame, Jet};
use flight_core::spatial::Pose;
use flight_sim::jets::{Jets, JetsConfig, SecondOrderConfig, ThrustFeedback};
use nalgebra::{Vector3, Vector6};
use std::collections::BTreeMap;

const DT: f64 = 0.01;

/// The published sets, in the order `K_T K_TT K_D K_DD K_TD B_U B_T B_D B_UU c`.
#[rustfmt::skip]
const ENGINES: [(&str, [f64; 10]); 6] = [
    ("P100", [-1.497225, -0.059093, -2.429288, 0.107146, 0.124828, 0.520267, 0.018470, -0.046559, 0.014813, -19.928301]),
    ("P160", [0.306530, -0.024867, -0.973422, 0.055786, 0.022618, 0.688710, 0.038025, -0.089879, -0.001393, -0.958953]),
    ("P160_diesel", [-1.496760, -0.045206, -2.433030, 0.020352, 0.064188, 0.589177, 0.016715, -0.021258, 0.013878, -19.926756]),
    ("P220", [0.237755, -0.012799, -0.860374, 0.023606, 0.008599, 1.139026, 0.019914, -0.050257, 0.000302, -0.692913]),
    ("P220_balancing", [-1.953561, -0.045804, 1.781593, 0.023776, -0.006976, 0.277460, 0.079341, -0.071026, 0.003995, -5.844843]),
    ("P220_diesel", [-0.482993, -0.013562, 1.292093, 0.055923, 0.006887, 0.130662, 0.022564, -0.052168, 0.004485, -5.436267]),
];

fn coefficients(k: [f64; 10]) -> EngineCoefficients {
    let [k_t, k_tt, k_d, k_dd, k_td, b_u, b_t, b_d, b_uu, c] = k;
    EngineCoefficients {
        k_t,
        k_tt,
        k_d,
        k_dd,
        k_td,
        b_u,
        b_t,
        b_d,
        b_uu,
        c,
        throttle_min: 0.0,
        throttle_max: 120.0,
    }
}

fn engines() -> BTreeMap<String, EngineCoefficients> {
    ENGINES.iter().map(|(name, k)| ((*name).to_owned(), coefficients(*k))).collect()
}

fn models() -> impl Iterator<Item = (&'static str, EngineModel)> {
    ENGINES.iter().map(|(name, k)| (*name, EngineModel::new(name, coefficients(*k)).unwrap()))
}

fn model(name: &str) -> EngineModel {
    models().find(|(n, _)| *n == name).unwrap().1
}

fn jets() -> Vec<Jet> {
    [
        ("l_arm", 160.0, "P160"),
        ("r_arm", 160.0, "P160"),
        ("chest_l", 220.0, "P220"),
        ("chest_r", 220.0, "P220"),
    ]
    .map(|(name, thrust_max, engine)| Jet {
        name: name.to_owned(),
        frame: Frame { name: name.to_owned(), body: 0, body_from_frame: Pose::identity() },
        axis_f: -Vector3::z_axis(),
        thrust_max,
        engine: engine.to_owned(),
    })
    .to_vec()
}

const HOVER: [f64; 4] = [98.0, 98.0, 113.0, 113.0];

fn second_order(change: impl FnOnce(&mut SecondOrderConfig)) -> JetsConfig {
    let mut config = SecondOrderConfig::default();
    change(&mut config);
    JetsConfig::SecondOrder(config)
}

fn build(config: &JetsConfig) -> Jets {
    Jets::new(config, &jets(), &engines(), &HOVER).unwrap()
}

// ------------------------------------------------------------------------------------- the engine

/// P160 at T = 100 N, Ṫ = 10 N/s, u = 50 %, term by term on paper:
/// f = 30.653 − 248.67 − 9.73422 + 5.5786 + 22.618 − 0.958953, g = 0.68871 + 3.8025 − 0.89879,
/// v = 50 − 3.4825.
#[test]
fn engine_equations_equal_a_calculation_by_hand() {
    let model = model("P160");
    assert_within!(relative(model.drift(100.0, 10.0), -200.513_573), 1e-12);
    assert_within!(relative(model.input_gain(100.0, 10.0), 3.592_42), 1e-12);
    assert_within!(relative(model.input(50.0), 46.5175), 1e-12);
    let acceleration = -200.513_573 + 3.592_42 * 46.5175;
    assert_within!(relative(model.thrust_acceleration(100.0, 10.0, 50.0), acceleration), 1e-12);
    let mut engine = EngineDynamics::new(model, 100.0, 10.0);
    engine.step(50.0, DT);
    assert_within!(relative(engine.thrust, 100.1 + 0.5e-4 * acceleration), 1e-14);
    assert_within!(relative(engine.thrust_rate, 10.0 + 0.01 * acceleration), 1e-14);
}

#[test]
fn throttle_is_limited() {
    for (name, model) in models() {
        let after = |throttle| {
            let mut engine = EngineDynamics::new(model, 90.0, 0.0);
            engine.step(throttle, DT);
            engine
        };
        assert_eq!(after(-30.0), after(0.0), "{name}");
        assert_eq!(after(500.0), after(120.0), "{name}");
    }
}

#[test]
fn throttle_inverts_input_for_every_engine() {
    for (name, model) in models() {
        for i in 0..=240 {
            let throttle = 0.5 * f64::from(i);
            let again = model.throttle_from_input(model.input(throttle));
            assert_within!((again - throttle).abs(), 1e-10, "{name} at {throttle} %");
        }
    }
}

/// The published formula divides by `2 B_UU`; ours has the same value and the right limit.
#[test]
fn input_inverse_is_continuous_at_zero_curvature_and_beyond_the_top() {
    let with =
        |b_uu| EngineModel::new("test", EngineCoefficients { b_uu, ..coefficients(ENGINES[1].1) }).unwrap();
    for b_uu in [0.0, 1e-300, 1e-14, -1e-14] {
        assert_within!(relative(with(b_uu).throttle_from_input(80.0), 80.0), 1e-11);
    }
    let b_uu: f64 = -0.001_393;
    let published = |v: f64| (-1.0 + (1.0 + 4.0 * b_uu * v).max(0.0).sqrt()) / (2.0 * b_uu);
    for v in [0.0, 10.0, 99.9, 170.0, 179.4, 179.6, 400.0] {
        assert_within!(relative(with(b_uu).throttle_from_input(v), published(v)), 1e-9);
    }
}

/// The throttle that holds a thrust holds it: exactly as an equilibrium, and in time from nearby.
#[test]
fn steady_throttle_reproduces_the_thrust() {
    for (name, thrust) in [("P100", 90.0), ("P160", 98.0), ("P220", 113.0), ("P220", 190.0)] {
        let model = model(name);
        let throttle = model.steady_throttle(thrust);
        assert!((1.0..119.0).contains(&throttle), "{name} at {throttle} %");
        assert_within!(model.thrust_acceleration(thrust, 0.0, throttle).abs(), 1e-9, "{name}");
        let mut engine = EngineDynamics::new(model, thrust - 5.0, 0.0);
        for _ in 0..2000 {
            engine.step(throttle, DT);
        }
        assert_within!((engine.thrust - thrust).abs(), 1e-6, "{name}: {}", engine.thrust);
    }
}

/// What no throttle can hold is held as nearly as the limits allow.
#[test]
fn steady_throttle_saturates() {
    for (_, model) in models() {
        assert_within!(relative(model.steady_throttle(1e4), 120.0), 1e-14);
    }
}

// ---------------------------------------------------------------------------------- throttle loop

/// Inside the limits the loop makes `T̈ = −k_p (Ṫ − Ṫ*)`, whatever the engine.
#[test]
fn throttle_loop_linearises_the_engine() {
    for name in ["P100", "P160", "P220"] {
        let model = model(name);
        let mut controller = ThrustRateController::new(150.0, 0.0, 50.0).unwrap();
        let throttle = controller.update(&model, 90.0, 0.3, 0.2, DT);
        assert!((0.1..119.9).contains(&throttle), "{name}");
        let acceleration = model.thrust_acceleration(90.0, 0.3, throttle);
        assert_within!(relative(acceleration, -150.0 * 0.1), 1e-9);
        assert_eq!(controller.throttle(), throttle);
    }
}

#[test]
fn integral_term_accumulates_the_error() {
    let model = model("P220");
    let mut controller = ThrustRateController::new(10.0, 4.0, 50.0).unwrap();
    controller.update(&model, 100.0, 1.0, 0.0, DT);
    let throttle = controller.update(&model, 100.0, 1.0, 0.0, DT);
    // The second call sees the integral of the first: 1 N/s over 0.01 s.
    let expected = -(10.0 + 4.0 * 0.01);
    assert_within!(relative(model.thrust_acceleration(100.0, 1.0, throttle), expected), 1e-9);
}

#[test]
fn throttle_holds_where_it_cannot_steer() {
    let model = model("P160");
    let mut controller = ThrustRateController::new(150.0, 0.0, 61.0).unwrap();
    // g = 0 on the line Ṫ = (B_U + B_T T)/|B_D|.
    let thrust_rate = 0.688_710 / 0.089_879;
    assert_within!(model.input_gain(0.0, thrust_rate).abs(), 1e-12);
    assert_eq!(controller.update(&model, 0.0, thrust_rate, 0.0, DT), 61.0);
    assert_eq!(controller.update(&model, 90.0, 0.0, f64::NAN, DT), 61.0);
    assert_eq!(controller.update(&model, f64::INFINITY, 0.0, 0.0, DT), 61.0);
    assert_ne!(controller.update(&model, 90.0, 0.0, 0.0, DT), 61.0);
}

/// From hover, up at 10 N/s for 2 s, down at 10 N/s for 2 s, with the published gains and tick. A
/// reversal saturates the throttle for a tenth of a second, and what thrust is missed meanwhile stays
/// missed: the loop feeds back the rate alone.
#[test]
fn second_order_jets_track_a_thrust_ramp() {
    let mut jets = build(&second_order(|_| {}));
    let mut expected = HOVER;
    for tick in 0..400 {
        let rate = if tick < 200 { 10.0 } else { -10.0 };
        jets.advance(&[rate; 4], DT);
        for (i, expected) in expected.iter_mut().enumerate() {
            *expected += rate * DT;
            assert_within!(
                (jets.thrust()[i] - *expected).abs(),
                1.5, because "what a tracking law still misses after that time",
                "jet {i}, tick {tick}: {}",
                jets.thrust()[i]
            );
            if !(0..30).contains(&(tick % 200)) {
                assert_within!((jets.thrust_rate()[i] - rate).abs(), 0.2, because "what a tracking law still misses after that time", "jet {i}, tick {tick}");
            }
            assert!((0.0..=120.0).contains(&jets.throttle()[i]));
        }
    }
}

#[test]
fn second_order_jets_hold_their_thrust_at_zero_command() {
    let mut jets = build(&second_order(|_| {}));
    let throttle = jets.throttle().to_vec();
    for _ in 0..500 {
        jets.advance(&[0.0; 4], DT);
    }
    for i in 0..4 {
        assert_within!((jets.thrust()[i] - HOVER[i]).abs(), 1e-6);
        assert_within!((jets.throttle()[i] - throttle[i]).abs(), 1e-6);
    }
}

// -------------------------------------------------------------------------------------- estimator

#[test]
fn estimator_jacobian_equals_finite_differences() {
    for (name, model) in models() {
        let (thrust, rate, throttle) = (87.0, -13.0, 64.0);
        let config = EkfConfig { init_state: Some([thrust, rate]), ..EkfConfig::default() };
        let a = ThrustEkf::new(&config, model, 0.0).unwrap().jacobian(throttle);
        let h = 1e-4;
        let acceleration = |t, r| model.thrust_acceleration(t, r, throttle);
        let by_thrust = (acceleration(thrust + h, rate) - acceleration(thrust - h, rate)) / (2.0 * h);
        let by_rate = (acceleration(thrust, rate + h) - acceleration(thrust, rate - h)) / (2.0 * h);
        assert_eq!((a.m11, a.m12), (0.0, 1.0));
        assert_within!((a.m21 - by_thrust).abs(), 1e-6, "{name}: {} {by_thrust}", a.m21);
        assert_within!((a.m22 - by_rate).abs(), 1e-6, "{name}: {} {by_rate}", a.m22);
    }
}

/// One step by hand: P220 from x̂ = (100, 0) with y = 106 at the throttle that holds 100 N, R = 2.
#[test]
fn estimator_step_equals_its_equations() {
    let model = model("P220");
    let throttle = model.steady_throttle(100.0);
    let config = EkfConfig { r: 2.0, ..EkfConfig::default() };
    let mut ekf = ThrustEkf::new(&config, model, 100.0).unwrap();
    ekf.update(106.0, throttle, DT);
    // Gain P Cᵀ/(P₁₁ + R/dt) = (1, 0.1)/201; innovation 6 N.
    let (thrust, rate) = (100.0 + 6.0 / 201.0, 0.6 / 201.0);
    let acceleration = model.thrust_acceleration(thrust, rate, throttle);
    assert_within!(relative(ekf.thrust(), thrust + DT * rate), 1e-14);
    assert_within!(relative(ekf.thrust_rate(), rate + DT * acceleration), 1e-12);
    // P − K C P, then Φ P Φᵀ + dt Q with Φ = ((1, dt), (dt a₂₁, 1 + dt a₂₂)) at the new estimate.
    let (p11, p12, p22) = (1.0 - 1.0 / 201.0, 0.1 - 0.1 / 201.0, 1.0 - 0.01 / 201.0);
    let (a21, a22) = model.acceleration_slopes(thrust, rate, throttle);
    let (f21, f22) = (DT * a21, 1.0 + DT * a22);
    let p = ekf.covariance();
    assert_within!(relative(p.m11, p11 + 2.0 * DT * p12 + DT * DT * p22 + DT * 10.0), 1e-14);
    let off_diagonal = f21 * (p11 + DT * p12) + f22 * (p12 + DT * p22) + DT;
    assert_within!(relative(p.m12, off_diagonal), 1e-12);
    assert_within!(relative(p.m21, off_diagonal), 1e-12);
    let last = f21 * f21 * p11 + 2.0 * f21 * f22 * p12 + f22 * f22 * p22 + DT * 10.0;
    assert_within!(relative(p.m22, last), 1e-12);
}

/// However well the thrust is measured, the covariance stays one and the estimate stays at the thrust.
#[test]
fn estimators_are_stable_for_every_measurement_noise() {
    for r in [1e-12, 4e-3, 1.0, 1e6] {
        let model = model("P220");
        let throttle = model.steady_throttle(100.0);
        let config = EkfConfig { r, init_state: Some([90.0, 0.0]), ..EkfConfig::default() };
        let mut ekf = ThrustEkf::new(&config, model, 100.0).unwrap();
        for tick in 0..1000 {
            ekf.update(100.0, throttle, DT);
            let p = ekf.covariance();
            assert!(p.m11 >= 0.0 && p.m22 >= 0.0 && p.m11 < 1e3, "R = {r}, tick {tick}: {p}");
            assert!((ekf.thrust() - 100.0).abs() < 11.0, "R = {r}, tick {tick}: {}", ekf.thrust());
        }
    }
}

/// A jet without thrust does not pull, and its thrust rate is not negative; a NaN stays one.
#[test]
fn thrust_is_never_negative() {
    for config in [JetsConfig::Ideal {}, JetsConfig::SecondOrder(SecondOrderConfig::default())] {
        let mut jets = Jets::new(&config, &jets(), &engines(), &[0.5; 4]).unwrap();
        for _ in 0..100 {
            jets.advance(&[-90.0; 4], DT);
            assert!(jets.thrust().iter().all(|thrust| *thrust >= 0.0), "{:?}", jets.thrust());
        }
    }
    let mut jets = Jets::new(&JetsConfig::Ideal {}, &jets(), &engines(), &[0.5, 0.5, 2.0, 0.0]).unwrap();
    jets.advance(&[-100.0, f64::NAN, -100.0, 50.0], DT);
    assert_eq!(jets.thrust()[0], 0.0);
    assert!(jets.thrust()[1].is_nan());
    assert_eq!(jets.thrust()[2..], [1.0, 0.5]);
    assert_eq!((jets.thrust_rate()[0], jets.thrust_rate()[2]), (0.0, -100.0));
    let mut engine = EngineDynamics::new(model("P220"), 0.1, -200.0);
    engine.step(0.0, DT);
    assert_eq!((engine.thrust, engine.thrust_rate), (0.0, 0.0));
}

/// Started wrong, the estimate finds thrust and thrust rate of an engine that follows a throttle.
#[test]
fn estimate_converges_to_the_truth() {
    for (name, thrust) in [("P100", 60.0), ("P160", 80.0), ("P220", 113.0)] {
        let model = model(name);
        let throttle = model.steady_throttle(thrust);
        let mut engine = EngineDynamics::new(model, thrust, 0.0);
        let config = EkfConfig { init_state: Some([thrust - 20.0, 10.0]), ..EkfConfig::default() };
        let mut ekf = ThrustEkf::new(&config, model, thrust).unwrap();
        for tick in 0..1500 {
            let throttle = throttle + 5.0 * (0.01 * f64::from(tick)).sin();
            ekf.update(engine.thrust, throttle, DT);
            engine.step(throttle, DT);
            let p = ekf.covariance();
            assert!(p.m11 > 0.0 && p.determinant() > 0.0, "{name}, tick {tick}");
            if tick > 500 {
                assert_within!((ekf.thrust() - engine.thrust).abs(), 0.1, because "what an estimate still misses after that time", "{name}, tick {tick}");
                assert_within!((ekf.thrust_rate() - engine.thrust_rate).abs(), 0.3, "{name}, tick {tick}");
            }
        }
    }
}

/// The published filter starts at zero, whatever the engine does; ours at the initial thrust.
#[test]
fn published_estimator_start_is_available() {
    let published: JetsConfig = toml::from_str(
        "dynamics = 'second_order'\nfeedback = 'estimated'\n[ekf]\ninit_state = [0.0, 0.0]\n\
         init_P = [[1.0, 0.1], [0.1, 1.0]]\nQ = [[10.0, 1.0], [1.0, 10.0]]\nR = 1.0",
    )
    .unwrap();
    let jets = build(&published);
    assert_eq!(jets.thrust_feedback(), [0.0; 4]);
    assert_eq!(jets.thrust(), HOVER);
    assert_eq!(build(&second_order(|c| c.feedback = ThrustFeedback::Estimated)).thrust_feedback(), HOVER);
}

// ------------------------------------------------------------------------------------------- jets

#[test]
fn ideal_thrust_is_the_integral_of_the_command() {
    let mut jets = build(&toml::from_str("dynamics = 'ideal'").unwrap());
    for _ in 0..100 {
        jets.advance(&[1.0, -50.0, 0.0, 50.0], DT);
    }
    for (thrust, expected) in jets.thrust().iter().zip([99.0, 48.0, 113.0, 163.0]) {
        assert_within!(relative(*thrust, expected), 1e-12);
    }
    assert_eq!(jets.thrust_feedback(), jets.thrust());
    assert_eq!(jets.thrust_rate(), [1.0, -50.0, 0.0, 50.0]);
    assert!(jets.throttle().is_empty());
}

#[test]
fn feedback_is_what_was_asked_for() {
    for (feedback, is_true) in [(ThrustFeedback::Measured, true), (ThrustFeedback::Estimated, false)] {
        let mut jets = build(&second_order(|c| {
            c.feedback = feedback;
            c.ekf.init_state = Some([90.0, 0.0]);
        }));
        jets.advance(&[5.0; 4], DT);
        assert_eq!(jets.thrust_feedback() == jets.thrust(), is_true);
    }
}

#[test]
fn a_jet_without_a_command_stays() {
    for config in [JetsConfig::Ideal {}, second_order(|_| {})] {
        let mut jets = build(&config);
        jets.advance(&[10.0, 10.0], DT);
        assert_eq!(jets.thrust()[2..], HOVER[2..]);
        jets.advance(&[10.0; 9], DT);
    }
}

#[test]
fn engines_can_be_chosen_per_jet() {
    let names = |n: [&str; 4]| Some(n.map(str::to_owned).to_vec());
    let own = build(&second_order(|_| {}));
    let same = build(&second_order(|c| c.engines = names(["P160", "P160", "P220", "P220"])));
    let other = build(&second_order(|c| c.engines = names(["P100", "P160", "P220", "P220"])));
    assert_eq!(own.throttle(), same.throttle());
    assert_ne!(own.throttle()[0], other.throttle()[0]);
    assert_eq!(own.throttle()[1..], other.throttle()[1..]);
}

/// Commands at the bounds of the momentum QP, reversed every half second.
#[test]
fn throttle_stays_within_limits_under_hard_commands() {
    let mut jets = build(&second_order(|_| {}));
    for tick in 0..1000 {
        jets.advance(&[if tick % 100 < 50 { 100.0 } else { -100.0 }; 4], DT);
        assert!(jets.throttle().iter().all(|u| (0.0..=120.0).contains(u)));
        assert!(jets.thrust().iter().all(|t| t.is_finite()), "tick {tick}");
    }
}

#[test]
fn wrench_is_force_and_moment_of_force() {
    let (axis_i, arm_i) = (Vector3::new(0.0, 0.6, 0.8), Vector3::new(0.2, 0.0, -0.1));
    assert_eq!(thrust_force(&axis_i, 50.0), Vector3::new(0.0, 30.0, 40.0));
    let expected = Vector6::new(0.0, 30.0, 40.0, 3.0, -8.0, 6.0);
    assert_within!(relative(thrust_wrench(&axis_i, &arm_i, 50.0), expected), 1e-14);
}

// --------------------------------------------------------------------------------------- refusals

fn assert_refused(config: &JetsConfig, parts: &[&str]) {
    let message = Jets::new(config, &jets(), &engines(), &HOVER).unwrap_err().to_string();
    assert_says(&message, parts);
}

fn assert_says(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "`{message}` does not mention `{part}`");
    }
}

#[test]
fn every_jet_needs_a_finite_initial_thrust() {
    for config in [JetsConfig::Ideal {}, second_order(|_| {})] {
        let error = |thrust: &[f64]| Jets::new(&config, &jets(), &engines(), thrust).unwrap_err().to_string();
        assert_says(&error(&[1.0; 3]), &["initial_thrust", "3 entries", "4 entries", "chest_l"]);
        assert_says(&error(&[1.0, f64::NAN, 1.0, 1.0]), &["`r_arm`", "NaN"]);
    }
}

#[test]
fn engines_must_exist_and_be_as_many_as_jets() {
    let with = |names: &[&str]| {
        second_order(|c| c.engines = Some(names.iter().map(|name| (*name).to_owned()).collect()))
    };
    assert_refused(&with(&["P160", "P160", "P550", "P220"]), &["`chest_l`", "`P550`", "P100, P160"]);
    assert_refused(&with(&["P160"]), &["engines", "1 entries", "4 entries"]);
}

#[test]
fn gains_and_noise_must_be_meaningful() {
    assert_refused(&second_order(|c| c.rate_gain_p = -1.0), &["rate_gain_p is -1"]);
    assert_refused(&second_order(|c| c.rate_gain_i = f64::NAN), &["rate_gain_i is NaN"]);
    assert_refused(&second_order(|c| c.ekf.r = 0.0), &["ekf.R is 0"]);
    assert_refused(&second_order(|c| c.ekf.q = [[1.0, 0.0], [0.5, 1.0]]), &["ekf.Q", "symmetric"]);
    assert_refused(&second_order(|c| c.ekf.q = [[1.0, 2.0], [2.0, 1.0]]), &["ekf.Q", "semidefinite"]);
    assert_refused(&second_order(|c| c.ekf.init_p[0][1] = f64::NAN), &["ekf.init_P[0][1] is NaN"]);
    assert_refused(
        &second_order(|c| c.ekf.init_state = Some([0.0, f64::INFINITY])),
        &["ekf.init_state[1] is inf"],
    );
}

#[test]
fn engine_coefficients_must_be_invertible() {
    let error = |change: fn(&mut EngineCoefficients)| {
        let mut k = coefficients(ENGINES[0].1);
        change(&mut k);
        EngineModel::new("P100", k).unwrap_err().to_string()
    };
    assert_says(&error(|k| k.k_td = f64::NAN), &["k_td of engine `P100`", "NaN"]);
    assert_says(&error(|k| k.throttle_max = 0.0), &["throttle_max of engine `P100` is 0"]);
    assert_says(&error(|k| k.b_uu = -0.005), &["b_uu of engine `P100` is -0.005", "increases"]);
}

#[test]
fn unknown_keys_are_refused() {
    for (text, mentions) in [
        ("dynamics = 'ideal'\nrate_gain_p = 1.0", "rate_gain_p"),
        ("dynamics = 'second_order'\ngain = 1.0", "gain"),
        ("dynamics = 'second_order'\n[ekf]\nP = 1.0", "P"),
        ("dynamics = 'second_order'\nfeedback = 'guessed'", "guessed"),
        ("dynamics = 'third_order'", "third_order"),
    ] {
        assert_says(&toml::from_str::<JetsConfig>(text).unwrap_err().to_string(), &[mentions]);
    }
    let config: JetsConfig = toml::from_str("dynamics = 'second_order'").unwrap();
    assert_eq!(config, second_order(|_| {}));
}

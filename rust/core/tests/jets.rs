//! The engine's equations, the throttle loop, the thrust estimator.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::engines::{ENGINES, coefficients, model, models};
use crate::common::{assert_within, relative};
use flight_core::jets::{
    EngineCoefficients, EngineDynamics, JetModel, SecondOrder, ThrustEkf, ThrustRateController,
};

const DT: f64 = 0.01;

/// P160 at T = 100 N, Ṫ = 10 N/s, u = 50 %, term by term on paper:
/// f = 30.653 − 248.67 − 9.73422 + 5.5786 + 22.618 − 0.958953, g = 0.68871 + 3.8025 − 0.89879,
/// v = 50 − 3.4825.
#[test]
fn engine_equations_equal_a_calculation_by_hand() {
    let model = model("P160");
    assert_within!(relative(model.thrust_acceleration(100.0, 10.0, 0.0), -200.513_573), 1e-12);
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
fn the_throttle_of_an_acceleration_has_it_for_every_engine() {
    for (name, model) in models() {
        for i in 0..=240 {
            let throttle = 0.5 * f64::from(i);
            let again =
                model.throttle_for(60.0, 1.0, model.thrust_acceleration(60.0, 1.0, throttle)).unwrap();
            assert_within!((again - throttle).abs(), 1e-10, "{name} at {throttle} %");
        }
    }
}

/// The published formula divides by `2 B_UU`; ours has the same value and the right limit. `T̈ = v(u)` here.
#[test]
fn input_inverse_is_continuous_at_zero_curvature_and_limited() {
    let (k, throttle_max) = (coefficients([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]), 358.0);
    let with = |b_uu| SecondOrder::new("test", EngineCoefficients { b_uu, throttle_max, ..k }).unwrap();
    let inverse = |b_uu, v| with(b_uu).throttle_for(0.0, 0.0, v).unwrap();
    for b_uu in [0.0, 1e-300, 1e-14, -1e-14] {
        assert_within!(relative(inverse(b_uu, 80.0), 80.0), 1e-11);
    }
    let b_uu: f64 = -0.001_393;
    let published = |v: f64| (-1.0 + (1.0 + 4.0 * b_uu * v).sqrt()) / (2.0 * b_uu);
    for v in [0.0, 10.0, 99.9, 170.0, 179.4] {
        assert_within!(relative(inverse(b_uu, v), published(v)), 1e-9);
    }
    assert_eq!((inverse(b_uu, 179.6), inverse(b_uu, 400.0), inverse(b_uu, -1.0)), (358.0, 358.0, 0.0));
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

/// Inside the limits the loop makes `T̈ = −k_p (Ṫ − Ṫ*)`, whatever the engine.
#[test]
fn throttle_loop_linearises_the_engine() {
    for name in ["P100", "P160", "P220"] {
        let model = model(name);
        let mut controller = ThrustRateController::new(50.0);
        let throttle = controller.update(&model.into(), 90.0, 0.3, 0.2);
        assert!((0.1..119.9).contains(&throttle), "{name}");
        let acceleration = model.thrust_acceleration(90.0, 0.3, throttle);
        assert_within!(relative(acceleration, -150.0 * 0.1), 1e-9);
        assert_eq!(controller.throttle(), throttle);
    }
}

#[test]
fn throttle_holds_where_it_cannot_steer() {
    let model = model("P160");
    let mut controller = ThrustRateController::new(61.0);
    // g = 0 on the line Ṫ = (B_U + B_T T)/|B_D|.
    let thrust_rate = 0.688_710 / 0.089_879;
    let by_throttle = |throttle| model.thrust_acceleration(0.0, thrust_rate, throttle);
    assert_within!((by_throttle(90.0) - by_throttle(0.0)).abs(), 1e-9);
    assert_eq!(
        JetModel { thrust_min: 0.0, engine: Some(model.into()) }.throttle(0.0, thrust_rate, 0.0, DT),
        model.steady_throttle(0.0)
    );
    assert_eq!(controller.update(&model.into(), 0.0, thrust_rate, 0.0), 61.0);
    assert_eq!(controller.update(&model.into(), 90.0, 0.0, f64::NAN), 61.0);
    assert_eq!(controller.update(&model.into(), f64::INFINITY, 0.0, 0.0), 61.0);
    assert_ne!(controller.update(&model.into(), 90.0, 0.0, 0.0), 61.0);
}

#[test]
fn estimator_jacobian_equals_finite_differences() {
    for (name, model) in models() {
        let throttle = 64.0;
        let mut ekf = ThrustEkf::new(model, 80.0);
        ekf.update(60.0, throttle, DT);
        let (thrust, rate, a) = (ekf.thrust(), ekf.thrust_rate(), ekf.jacobian(throttle));
        assert!(rate.abs() > 0.1, "{name}: {rate}");
        let h = 1e-4;
        let acceleration = |t, r| model.thrust_acceleration(t, r, throttle);
        let by_thrust = (acceleration(thrust + h, rate) - acceleration(thrust - h, rate)) / (2.0 * h);
        let by_rate = (acceleration(thrust, rate + h) - acceleration(thrust, rate - h)) / (2.0 * h);
        assert_eq!((a.m11, a.m12), (0.0, 1.0));
        assert_within!((a.m21 - by_thrust).abs(), 1e-6, "{name}: {} {by_thrust}", a.m21);
        assert_within!((a.m22 - by_rate).abs(), 1e-6, "{name}: {} {by_rate}", a.m22);
    }
}

/// One step by hand: P220 from x̂ = (100, 0) with y = 106 at the throttle that holds 100 N.
#[test]
fn estimator_step_equals_its_equations() {
    let model = model("P220");
    let throttle = model.steady_throttle(100.0);
    let mut ekf = ThrustEkf::new(model, 100.0);
    ekf.update(106.0, throttle, DT);
    // Gain P Cᵀ/(P₁₁ + R/dt) = (1, 0.1)/101; innovation 6 N.
    let (thrust, rate) = (100.0 + 6.0 / 101.0, 0.6 / 101.0);
    let acceleration = model.thrust_acceleration(thrust, rate, throttle);
    assert_within!(relative(ekf.thrust(), thrust + DT * rate), 1e-14);
    assert_within!(relative(ekf.thrust_rate(), rate + DT * acceleration), 1e-12);
    // P − K C P, then Φ P Φᵀ + dt Q with Φ = ((1, dt), (dt a₂₁, 1 + dt a₂₂)) at the new estimate.
    let (p11, p12, p22) = (1.0 - 1.0 / 101.0, 0.1 - 0.1 / 101.0, 1.0 - 0.01 / 101.0);
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

/// The covariance stays one and the estimate stays at the thrust.
#[test]
fn estimators_are_stable() {
    let model = model("P220");
    let throttle = model.steady_throttle(100.0);
    let mut ekf = ThrustEkf::new(model, 90.0);
    for tick in 0..1000 {
        ekf.update(100.0, throttle, DT);
        let p = ekf.covariance();
        assert!(p.m11 >= 0.0 && p.m22 >= 0.0 && p.m11 < 1e3, "tick {tick}: {p}");
        assert!((ekf.thrust() - 100.0).abs() < 11.0, "tick {tick}: {}", ekf.thrust());
    }
}

/// Above its least, at it, and of an engine that has stopped or whose sensor is wrong.
#[test]
fn a_predicted_thrust_stays_above_its_least() {
    let predict =
        |thrust, rate, thrust_min| JetModel { thrust_min, engine: None }.advance(thrust, 0.0, rate, 0.5).0;
    let at = |thrust, rate| predict(thrust, rate, 11.0);
    assert_eq!((at(20.0, -10.0), at(20.0, -30.0), at(11.0, -30.0), at(11.0, 4.0)), (15.0, 11.0, 11.0, 13.0));
    assert_eq!((at(4.0, -2.0), at(4.0, 2.0), at(0.0, -2.0), at(-3.0, -2.0)), (4.0, 5.0, 0.0, 0.0));
    assert_eq!((predict(1.0, -4.0, 0.0), predict(-1.0, 0.0, 0.0)), (0.0, 0.0));
}

/// The throttle of a command brings the engine to the predicted rate and thrust; beyond its limits, as near as they allow.
#[test]
fn an_engine_follows_its_predicted_rate() {
    for (name, k) in ENGINES {
        let engine = SecondOrder::new(name, coefficients(k)).unwrap();
        let jet = JetModel { thrust_min: 0.0, engine: Some(engine.into()) };
        for (thrust, rate, command) in
            [(60.0, 0.0, 0.5), (60.0, -3.0, -3.4), (40.0, 5.0, 100.0), (70.0, 4.0, -100.0)]
        {
            let mut real = EngineDynamics::new(engine, thrust, rate);
            real.step(jet.throttle(thrust, rate, command, DT), DT);
            let (after, reached) = jet.advance(thrust, rate, command, DT);
            assert_within!((real.thrust_rate - reached).abs(), 1e-9, because "rounding of the inverted throttle", "{name}");
            assert_within!((real.thrust - after).abs(), 1e-11, because "the same, times a tick", "{name}");
            let (least, greatest) = engine.acceleration_range(thrust, rate);
            assert_eq!(reached, command.clamp(rate + DT * least, rate + DT * greatest), "{name}");
        }
        assert_eq!(JetModel { thrust_min: 0.0, engine: None }.throttle(60.0, 0.0, 5.0, DT), 0.0);
    }
}

#[test]
fn engine_coefficients_must_be_invertible() {
    let assert_says = |change: fn(&mut EngineCoefficients), parts: &[&str]| {
        let mut k = coefficients(ENGINES[0].1);
        change(&mut k);
        let message = SecondOrder::new("P100", k).unwrap_err().to_string();
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
    };
    assert_says(|k| k.k_td = f64::NAN, &["`engines.P100.k_td` is not finite"]);
    assert_says(|k| k.throttle_max = 0.0, &["throttle_max of engine `P100` is 0"]);
    assert_says(|k| k.b_uu = -0.005, &["b_uu of engine `P100` is -0.005", "increases"]);
}

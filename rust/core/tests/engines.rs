//! Engines that fail and sensors that are wrong, each law by itself.

use crate::common::assert_within;
use flight_core::control::engines::{EngineState, EnginesConfig, Finding};
use nalgebra::Vector6;

const STEP: f64 = 0.01;
const CONFIG: EnginesConfig =
    EnginesConfig { time_constant: 0.5, deviation_max: 15.0, confirmation: 0.05, descend: true };

fn column() -> Vector6<f64> {
    Vector6::new(0.1, -0.2, 0.97, 0.05, 0.3, -0.1)
}

/// A deviation of `a` newtons per tick: `a (1 − e^{−kΔt/τ}) / (1 − e^{−Δt/τ})` after k ticks.
#[test]
fn deviations_are_summed_and_forgotten() {
    let mut engine = EngineState::default();
    for tick in 1..=40 {
        let _ = engine.update(&CONFIG, STEP, 0.3, &column(), &Vector6::zeros());
        let expected = 0.3 * (-f64::from(tick) * STEP / 0.5).exp_m1() / (-STEP / 0.5).exp_m1();
        assert_within!((engine.deviation - expected).abs(), 1e-12, "tick {tick}");
    }
}

/// 20 N at once are suspect for five ticks and are then a loss, of either sign; 14 N never are.
#[test]
fn an_engine_is_lost_after_its_confirmation() {
    for (size, found) in [(20.0, Some(6)), (-20.0, Some(6)), (14.0, None), (-14.0, None)] {
        let mut engine = EngineState::default();
        let mut lost = None;
        for tick in 1..=20 {
            let innovation = if tick == 1 { size } else { 0.0 };
            if engine.update(&CONFIG, STEP, innovation, &column(), &Vector6::zeros()) == Finding::Lost {
                lost = Some(tick);
            }
        }
        assert_eq!(lost, found, "{size} N");
        assert_eq!(engine.is_lost, found.is_some());
    }
}

/// A sensor that says too much by `d` puts `−a d` into the momentum: from half of that on it is the sensor.
#[test]
fn the_momentum_tells_a_wrong_sensor() {
    for deviation in [30.0, -30.0] {
        for (share, expected) in [(0.45, Finding::Lost), (0.55, Finding::WrongSensor), (-0.9, Finding::Lost)]
        {
            let mut engine = EngineState::default();
            let mut found = Finding::Nothing;
            for tick in 1..=6 {
                let innovation = if tick == 1 { deviation } else { 0.0 };
                let residual = column() * (-share * deviation * (-f64::from(tick - 1) * STEP / 0.5).exp());
                found = engine.update(&CONFIG, STEP, innovation, &column(), &residual);
            }
            assert_eq!(found, expected, "{deviation} N, {share}");
        }
    }
}

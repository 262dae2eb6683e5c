//! The published engines.

#![allow(clippy::unreadable_literal, reason = "coefficients stand as they were published")]

use flight_core::jets::{EngineCoefficients, SecondOrder};
use std::collections::BTreeMap;

/// The published sets, in the order `K_T K_TT K_D K_DD K_TD B_U B_T B_D B_UU c`.
#[rustfmt::skip]
pub const ENGINES: [(&str, [f64; 10]); 6] = [
    ("P100", [-1.497225, -0.059093, -2.429288, 0.107146, 0.124828, 0.520267, 0.018470, -0.046559, 0.014813, -19.928301]),
    ("P160", [0.306530, -0.024867, -0.973422, 0.055786, 0.022618, 0.688710, 0.038025, -0.089879, -0.001393, -0.958953]),
    ("P160_diesel", [-1.496760, -0.045206, -2.433030, 0.020352, 0.064188, 0.589177, 0.016715, -0.021258, 0.013878, -19.926756]),
    ("P220", [0.237755, -0.012799, -0.860374, 0.023606, 0.008599, 1.139026, 0.019914, -0.050257, 0.000302, -0.692913]),
    ("P220_balancing", [-1.953561, -0.045804, 1.781593, 0.023776, -0.006976, 0.277460, 0.079341, -0.071026, 0.003995, -5.844843]),
    ("P220_diesel", [-0.482993, -0.013562, 1.292093, 0.055923, 0.006887, 0.130662, 0.022564, -0.052168, 0.004485, -5.436267]),
];

/// Those of a row of [`ENGINES`].
pub fn coefficients(k: [f64; 10]) -> EngineCoefficients {
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

pub fn engines() -> BTreeMap<String, SecondOrder> {
    models().map(|(name, model)| (name.to_owned(), model)).collect()
}

pub fn models() -> impl Iterator<Item = (&'static str, SecondOrder)> {
    ENGINES.iter().map(|(name, k)| (*name, SecondOrder::new(name, coefficients(*k)).unwrap()))
}

pub fn model(name: &str) -> SecondOrder {
    models().find(|(n, _)| *n == name).unwrap().1
}

//! Angle between a link and the air that flows past it.
//!
//! Equation M19 of `docs/model`.

use nalgebra::Vector3;

/// Added to the speed in the cosine of the angle of attack \[m/s\]; the published value.
pub(super) const SPEED_EPSILON: f64 = 1e-9;

/// Angle of attack of a link, between its axis and the *upstream* direction, as cosine and sine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Attack {
    /// Speed of the air relative to the link \[m/s\].
    pub speed: f64,
    /// `cos α`; 1 when the air comes from the direction of the axis.
    pub cos: f64,
    /// `sin α ≥ 0`.
    pub sin: f64,
}

impl Attack {
    /// Cosine and sine of the angle of attack, without `acos`.
    ///
    /// ```text
    /// cos α = −k̂·v / (|v| + ε),   sin α = √(|v × k̂|² + ε (2|v| + ε)) / (|v| + ε),   ε = 1e-9 m/s
    /// ```
    ///
    /// Source: the published controller, `α = acos(k̂·(−v)/(|v| + ε))`. The sine is that of the same angle
    /// without the cancellation of `1 − cos²`: by Lagrange's identity the root is `√((|v| + ε)² − (k̂·v)²)`.
    /// ε keeps the quotient finite at rest and the argument of the root positive, so both are smooth for wind
    /// along the axis; at rest α = 90°.
    #[must_use]
    pub fn new(axis_i: &Vector3<f64>, v_air_i: &Vector3<f64>) -> Self {
        let speed = v_air_i.norm();
        let regular = speed + SPEED_EPSILON;
        let across = v_air_i.cross(axis_i).norm_squared() + SPEED_EPSILON * (speed + regular);
        Self {
            speed,
            cos: (-axis_i.dot(v_air_i) / regular).clamp(-1.0, 1.0),
            // The axis has unit length up to rounding, so either value can exceed one by an ulp.
            sin: (across.sqrt() / regular).min(1.0),
        }
    }
}

/// `(v × k̂) × v = |v|² k̂ − (v·k̂) v`: perpendicular to the wind, towards the axis, of length `|v|² sin α`.
pub(super) fn normal_direction(axis_i: &Vector3<f64>, v_air_i: &Vector3<f64>) -> Vector3<f64> {
    // Unlike the difference, the double cross product has no cancellation when wind and axis are parallel.
    v_air_i.cross(axis_i).cross(v_air_i)
}

//! The paper's axisymmetric model: drag and normal force areas fitted per link to CFD.
//!
//! Equation M20 of `docs/model`.

use super::attack::{Attack, normal_direction};
use super::links::check_air_density;
use crate::error::{BuildError, check};
use crate::robot::{AeroLink, AxisymmetricCoefficients};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Parameters of the axisymmetric model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AxisymmetricConfig {
    /// Name of the coefficient set; every link of the robot needs a set of this name.
    pub coefficients: String,
    /// Density of the air \[kg/m³\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub air_density: f64,
}

/// The axisymmetric model after its checks.
#[derive(Debug, Clone)]
pub struct Axisymmetric {
    /// `k_a = ρ/2` \[kg/m³\].
    pub(super) k_a: f64,
    /// One set for each link, in the order of the links.
    pub(super) coefficients: Vec<AxisymmetricCoefficients>,
}

impl Axisymmetric {
    /// Selects the configured coefficient set of every link.
    ///
    /// # Errors
    /// A link without this set, a coefficient that is not finite, a density that is not positive.
    pub fn new(config: &AxisymmetricConfig, links: &[AeroLink]) -> Result<Self, BuildError> {
        let air_density = check_air_density(config.air_density)?;
        let coefficients =
            links.iter().map(|link| coefficients_of(link, &config.coefficients)).collect::<Result<_, _>>()?;
        Ok(Self { k_a: 0.5 * air_density, coefficients })
    }

    /// Force on the link with index `link` \[N\], inertial axes; zero if there is no such link.
    #[must_use]
    pub fn link_force(&self, link: usize, axis_i: &Vector3<f64>, v_air_i: &Vector3<f64>) -> Vector3<f64> {
        self.coefficients
            .get(link)
            .map_or_else(Vector3::zeros, |areas| axisymmetric_force(areas, axis_i, v_air_i, self.k_a))
    }
}

/// Aerodynamic force on an axisymmetric link \[N\], inertial axes.
///
/// ```text
/// C_D A = w₀ + w₁ cos α + w₂ sin² α + w₃ sin³ α + w₄ cos³ α
/// F = k_a ( |v| C_D A v + w₅ sin α cos α (v × k̂) × v ),   k_a = ρ/2,   v = v_air_i
/// ```
///
/// Source: paper, Methods, eq. `aero-force-model`, with `C_N A = w₅ sin² α cos α`. The printed division by
/// sin α is carried out, so the force is finite for wind along the axis and zero at rest. The paper's `v_a`
/// is `−v`; the drag term changes sign with it, the normal term does not. The triple product is
/// `(v × k̂) × v`, as the published controller computes it.
#[must_use]
pub fn axisymmetric_force(
    areas: &AxisymmetricCoefficients,
    axis_i: &Vector3<f64>,
    v_air_i: &Vector3<f64>,
    k_a: f64,
) -> Vector3<f64> {
    let Attack { speed, cos, sin } = Attack::new(axis_i, v_air_i);
    let [w0, w1, w2, w3, w4] = areas.cda;
    let drag_area = w0 + cos * (w1 + w4 * cos * cos) + sin * sin * (w2 + w3 * sin);
    let normal = normal_direction(axis_i, v_air_i);
    k_a * (speed * drag_area * v_air_i + areas.cna * sin * cos * normal)
}

/// Looks up the set `name` of one link and checks that every number is finite.
fn coefficients_of(link: &AeroLink, name: &str) -> Result<AxisymmetricCoefficients, BuildError> {
    let set = link.coefficients.get(name).ok_or_else(|| {
        BuildError::unknown_name(
            format!("coefficients of link `{}`", link.name),
            name,
            link.coefficients.keys(),
        )
    })?;
    for (index, w) in set.cda.iter().chain([&set.cna]).enumerate() {
        let item = format!("coefficient w{index} of set `{name}` of link `{}`", link.name);
        check(&item, *w, |_| true, "a finite area in m²")?;
    }
    Ok(*set)
}

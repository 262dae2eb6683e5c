//! Factors on the aerodynamic forces of a model: parallel to the relative wind, perpendicular to it, and by
//! link.
//!
//! In the simulator they represent errors of the coefficients; in the controller they remove parts of the
//! estimated forces.
//!
//! Equation M40 of `docs/model`.

use crate::error::{BuildError, check, place_of};
use crate::robot::AeroLink;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Factors on the force of every link; the default is 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ForceFactorsConfig {
    /// Factor on all forces.
    pub scale: f64,
    /// Factor on the part along the air's velocity relative to the link.
    pub drag: f64,
    /// Factor on the part across the air's velocity relative to the link.
    pub normal: f64,
    /// Factor on the whole force of a link, by its name; links that are not named keep theirs.
    pub links: BTreeMap<String, f64>,
}

impl Default for ForceFactorsConfig {
    fn default() -> Self {
        Self { scale: 1.0, drag: 1.0, normal: 1.0, links: BTreeMap::new() }
    }
}

impl ForceFactorsConfig {
    /// Whether this changes nothing.
    #[must_use]
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// Factors after their checks, in the order of the links.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceFactors {
    pub(super) drag: f64,
    pub(super) normal: f64,
    /// Factor of each link times the factor on all forces.
    pub(super) links: Vec<f64>,
}

impl ForceFactors {
    /// Builds the factors for `links`; `table` is named in errors.
    ///
    /// # Errors
    /// A factor that is not finite, a link that does not exist.
    pub fn new(config: &ForceFactorsConfig, links: &[AeroLink], table: &str) -> Result<Self, BuildError> {
        let factor = |key: &str, value| check(&format!("{table}.{key}"), value, |_| true, "a finite factor");
        let scale = factor("scale", config.scale)?;
        let mut by_link = vec![scale; links.len()];
        for (name, value) in &config.links {
            let index = place_of(format!("{table}.links"), name, links.iter().map(|link| &link.name))?;
            by_link[index] = scale * factor(&format!("links.{name}"), *value)?;
        }
        Ok(Self {
            drag: factor("drag", config.drag)?,
            normal: factor("normal", config.normal)?,
            links: by_link,
        })
    }

    /// Multiplies every force by its factors, in place.
    ///
    /// ```text
    /// F ← w w_link ( w_drag F_∥ + w_normal (F − F_∥) ),   F_∥ = (F · v̂) v̂,   v̂ = v_air / |v_air|
    /// ```
    pub fn apply(&self, v_air_i: &[Vector3<f64>], forces_i: &mut [Vector3<f64>]) {
        for ((force, v_air), factor) in forces_i.iter_mut().zip(v_air_i).zip(&self.links) {
            let along = v_air.try_normalize(0.0).map_or(Vector3::zeros(), |v| v * force.dot(&v));
            let across = *force - along;
            *force = (along * self.drag + across * self.normal) * *factor;
        }
    }
}

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
    /// Factor on the part along the air's velocity of a link, by its name, beside the others.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub drag_of: BTreeMap<String, f64>,
    /// Factor on the part across the air's velocity of a link, by its name, beside the others.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub normal_of: BTreeMap<String, f64>,
}

impl Default for ForceFactorsConfig {
    fn default() -> Self {
        Self {
            scale: 1.0,
            drag: 1.0,
            normal: 1.0,
            links: BTreeMap::new(),
            drag_of: BTreeMap::new(),
            normal_of: BTreeMap::new(),
        }
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
    pub(super) links: Vec<LinkFactors>,
}

/// Factors on the force of one link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LinkFactors {
    pub(super) drag: f64,
    pub(super) normal: f64,
    /// Factor of the link times the factor on all forces.
    pub(super) whole: f64,
}

impl ForceFactors {
    /// Builds the factors for `links`; `table` is named in errors.
    ///
    /// # Errors
    /// A factor that is not finite, a link that does not exist.
    pub fn new(config: &ForceFactorsConfig, links: &[AeroLink], table: &str) -> Result<Self, BuildError> {
        let factor = |key: &str, value| check(&format!("{table}.{key}"), value, |_| true, "a finite factor");
        let by_link = |key: &str, all: f64, named: &BTreeMap<String, f64>| {
            let mut found = vec![all; links.len()];
            for (name, value) in named {
                let index = place_of(format!("{table}.{key}"), name, links.iter().map(|link| &link.name))?;
                found[index] = all * factor(&format!("{key}.{name}"), *value)?;
            }
            Ok::<_, BuildError>(found)
        };
        let whole = by_link("links", factor("scale", config.scale)?, &config.links)?;
        let drag = by_link("drag_of", factor("drag", config.drag)?, &config.drag_of)?;
        let normal = by_link("normal_of", factor("normal", config.normal)?, &config.normal_of)?;
        let parts = whole.into_iter().zip(drag).zip(normal);
        Ok(Self { links: parts.map(|((whole, drag), normal)| LinkFactors { drag, normal, whole }).collect() })
    }

    /// Multiplies every force by its factors, in place.
    ///
    /// ```text
    /// F ← w w_link ( w_drag w_drag,link F_∥ + w_normal w_normal,link (F − F_∥) ),
    /// F_∥ = (F · v̂) v̂,   v̂ = v_air / |v_air|
    /// ```
    pub fn apply(&self, v_air_i: &[Vector3<f64>], forces_i: &mut [Vector3<f64>]) {
        for ((force, v_air), factors) in forces_i.iter_mut().zip(v_air_i).zip(&self.links) {
            let along = v_air.try_normalize(0.0).map_or(Vector3::zeros(), |v| v * force.dot(&v));
            let across = *force - along;
            *force = (along * factors.drag + across * factors.normal) * factors.whole;
        }
    }
}

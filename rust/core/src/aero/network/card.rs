//! The card of a network: inputs, outputs and architecture of its weights.

use crate::error::{BuildError, check, place_of};
use crate::robot::{AxisymmetricCoefficients, RobotModel};
use serde::Deserialize;
use std::collections::BTreeMap;

/// Upper limit of layer width and of the number of layers or members, far above any practical network.
const MAX_SIZE: usize = 1 << 16;

/// Description of the weights of a network.
#[derive(Debug, Clone, PartialEq)]
pub struct Card {
    /// File or source of the card; named in errors.
    pub origin: String,
    /// Inputs.
    pub inputs: Inputs,
    /// Outputs.
    pub output: Output,
    /// Layers and ensemble.
    pub architecture: Architecture,
}

/// Inputs of a network.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Inputs {
    /// Blocks of features, in the order of the input vector.
    pub features: Vec<Feature>,
    /// Joints that are inputs of the network, in the robot's order.
    pub joints: Vec<String>,
    /// Aerodynamic links, in the robot's order.
    pub links: Vec<String>,
}

/// One block of the input vector. `û` is the unit vector of the air's velocity relative to the base origin;
/// in still air it is the x axis of the base.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Feature {
    /// `û` in base axes.
    Wind,
    /// Joint angles in degrees, divided by 180.
    Joints,
    /// `û` in the axes of every link, link by link.
    LinkWind,
    /// Aerodynamic centre of every link relative to the base origin \[m, base axes\], link by link.
    LinkPosition,
    /// Shadow of the other links on every link (M24), one number each.
    LinkShadow,
}

/// Output of a network: a force area for each link.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Output {
    /// Axes of the areas.
    pub frame: OutputFrame,
    /// Order of the numbers.
    pub layout: Layout,
    /// Unit of the areas; always `m^2`.
    pub unit: String,
}

/// Axes of the force areas.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OutputFrame {
    /// Axes of the base.
    Base,
    /// Axes of the link.
    Link,
    /// Axes of the wind tunnel: along the air, sideways, up.
    Wind,
}

/// Order of the numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Layout {
    /// All `C_D A`, then all `C_L A`, then all `C_S A`: x, z and y, as published.
    Component,
    /// x, y, z, link by link.
    Link,
}

/// Architecture of a network.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Architecture {
    /// Widths of the hidden layers.
    pub hidden: Vec<usize>,
    /// Activation after every hidden layer.
    pub activation: Activation,
    /// Number of networks of this shape whose outputs are averaged.
    pub members: usize,
    /// Whether the output of the mirrored input is mirrored and averaged with the output.
    pub mirror: bool,
    /// Model to whose force areas the output is added.
    pub baseline: Option<Baseline>,
}

/// Activation after every hidden layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Activation {
    /// `max(x, 0)`
    Relu,
    /// `tanh x`
    Tanh,
    /// `x / (1 + e⁻ˣ)`
    Silu,
}

/// Model to whose force areas the network's output is added.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Baseline {
    /// The axisymmetric model, evaluated with the network's wind.
    Axisymmetric {
        /// Coefficients of each link.
        links: BTreeMap<String, AxisymmetricCoefficients>,
    },
}

impl Card {
    /// Length of the input vector.
    #[must_use]
    pub fn n_inputs(&self) -> usize {
        let (joints, links) = (self.inputs.joints.len(), self.inputs.links.len());
        let features = self.inputs.features.iter();
        features
            .map(|feature| match feature {
                Feature::Wind => 3,
                Feature::Joints => joints,
                Feature::LinkWind | Feature::LinkPosition => 3 * links,
                Feature::LinkShadow => links,
            })
            .sum()
    }

    /// Coefficients of the baseline in the order of the links.
    #[must_use]
    pub fn baseline_coefficients(&self) -> Option<Vec<AxisymmetricCoefficients>> {
        let Baseline::Axisymmetric { links } = self.architecture.baseline.as_ref()?;
        // `check` has ensured that every link is present.
        Some(self.inputs.links.iter().filter_map(|link| links.get(link).copied()).collect())
    }

    /// Checks that the card is consistent and matches `robot`.
    ///
    /// # Errors
    /// [`BuildError`] naming the card, the key, its value and what was expected.
    pub(super) fn check(&self, robot: &RobotModel) -> Result<(), BuildError> {
        let origin = self.origin.as_str();
        let refuse = |key: &str, value: String, expected: &str| {
            Err(BuildError::bad_value(format!("`{key}` in {origin}"), value, expected))
        };
        if self.output.unit != "m^2" {
            return refuse("output.unit", self.output.unit.clone(), "m^2");
        }
        let Output { frame, layout, .. } = self.output;
        if (frame, layout) == (OutputFrame::Link, Layout::Component)
            || (frame, layout) == (OutputFrame::Wind, Layout::Link)
        {
            let expected = "base with either layout, link with link, wind with component";
            return refuse("output", format!("frame {frame:?} with layout {layout:?}"), expected);
        }
        self.check_inputs(origin, robot)?;
        let Architecture { hidden, members, .. } = &self.architecture;
        if *members == 0 || *members > MAX_SIZE {
            return refuse("architecture.members", members.to_string(), "at least one network");
        }
        if hidden.len() > MAX_SIZE {
            return refuse("architecture.hidden", format!("{} layers", hidden.len()), "fewer layers");
        }
        if let Some(width) = hidden.iter().find(|width| !(1..=MAX_SIZE).contains(*width)) {
            return refuse("architecture.hidden", width.to_string(), "widths from 1 to 65536");
        }
        self.check_baseline(origin)
    }

    fn check_inputs(&self, origin: &str, robot: &RobotModel) -> Result<(), BuildError> {
        let Inputs { features, joints, links } = &self.inputs;
        if features.is_empty() {
            let item = format!("`inputs.features` in {origin}");
            return Err(BuildError::bad_value(item, "empty", "at least one block of features"));
        }
        for (index, feature) in features.iter().enumerate() {
            if features[..index].contains(feature) {
                let item = format!("`inputs.features` in {origin}");
                return Err(BuildError::bad_value(item, format!("{feature:?} twice"), "each block once"));
            }
        }
        let robot_links = robot.aero_links.iter().map(|link| link.name.as_str());
        if !robot_links.clone().eq(links.iter().map(String::as_str)) {
            let item = format!("`inputs.links` in {origin}");
            let expected: Vec<&str> = robot_links.collect();
            return Err(BuildError::bad_value(item, links.join(", "), expected.join(", ")));
        }
        let mut last = None;
        for name in joints {
            let known = robot.joints.iter().map(|joint| &joint.name);
            let index = place_of(format!("`inputs.joints` in {origin}"), name, known)?;
            if last.is_some_and(|last| index <= last) {
                let item = format!("order of `inputs.joints` in {origin}");
                return Err(BuildError::bad_value(item, joints.join(", "), "joints in the robot's order"));
            }
            last = Some(index);
        }
        Ok(())
    }

    fn check_baseline(&self, origin: &str) -> Result<(), BuildError> {
        let Some(Baseline::Axisymmetric { links }) = &self.architecture.baseline else { return Ok(()) };
        let item = || format!("`architecture.baseline.links` in {origin}");
        for name in links.keys() {
            place_of(item(), name, &self.inputs.links)?;
        }
        for name in &self.inputs.links {
            let Some(set) = links.get(name) else {
                return Err(BuildError::bad_value(item(), format!("without `{name}`"), "all links"));
            };
            for (index, w) in set.cda.iter().chain([&set.cna]).enumerate() {
                let coefficient = format!("coefficient w{index} of link `{name}` in {origin}");
                check(&coefficient, *w, |_| true, "a finite area in m²")?;
            }
        }
        Ok(())
    }
}

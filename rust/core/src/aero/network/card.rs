//! The card of a network: inputs, outputs and architecture of its weights.

use super::tensors::Tensors;
use crate::error::{BuildError, check, place_of};
use crate::robot::AxisymmetricCoefficients;
use serde::{Deserialize, Serialize};
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
#[derive(Debug, Clone, PartialEq, Deserialize, schemars::JsonSchema)]
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
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
#[derive(Debug, Clone, PartialEq, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Output {
    /// Axes of the areas.
    pub frame: OutputFrame,
    /// Order of the numbers.
    pub layout: Layout,
    /// Unit of the areas.
    pub unit: Unit,
}

/// Unit of the force areas.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
pub enum Unit {
    /// m²
    #[serde(rename = "m^2")]
    SquareMetre,
}

/// Axes of the force areas.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OutputFrame {
    /// Axes of the base.
    Base,
    /// Axes of the link.
    Link,
}

/// Order of the numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Layout {
    /// All `C_D A`, then all `C_L A`, then all `C_S A`: x, z and y, as published.
    Component,
    /// x, y, z, link by link.
    Link,
}

/// Architecture of a network.
#[derive(Debug, Clone, PartialEq, Deserialize, schemars::JsonSchema)]
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
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
#[derive(Debug, Clone, PartialEq, Deserialize, schemars::JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Baseline {
    /// The axisymmetric model, evaluated with the network's wind.
    Axisymmetric {
        /// Coefficients of each link.
        links: BTreeMap<String, AxisymmetricCoefficients>,
    },
}

/// Weights of a network.
#[derive(Debug, Clone)]
pub struct Weights {
    /// Layers of every member: weights by row, then biases.
    pub members: Vec<Vec<(Vec<f32>, Vec<f32>)>>,
    /// Factor of every output \[m²\].
    pub scale: Vec<f32>,
    /// Offset of every output \[m²\].
    pub offset: Vec<f32>,
}

impl Card {
    /// Lengths of the input vector, of the hidden layers and of the output.
    #[must_use]
    pub fn widths(&self) -> Vec<usize> {
        let (joints, links) = (self.inputs.joints.len(), self.inputs.links.len());
        let of_feature = |feature: &Feature| match feature {
            Feature::Wind => 3,
            Feature::Joints => joints,
            Feature::LinkWind | Feature::LinkPosition => 3 * links,
            Feature::LinkShadow => links,
        };
        let inputs = self.inputs.features.iter().map(of_feature).sum();
        [inputs].into_iter().chain(self.architecture.hidden.iter().copied()).chain([3 * links]).collect()
    }

    /// Coefficients of the baseline in the order of the links.
    #[must_use]
    pub fn baseline_coefficients(&self) -> Option<Vec<AxisymmetricCoefficients>> {
        let Baseline::Axisymmetric { links } = self.architecture.baseline.as_ref()?;
        // `check` has ensured that every link is present.
        Some(self.inputs.links.iter().filter_map(|link| links.get(link).copied()).collect())
    }

    /// Checks the card, then reads `tensors` as its weights: the card of another robot gives the clearer error.
    /// `joints` and `links` are the robot's.
    ///
    /// # Errors
    /// [`BuildError`] naming the file, and key or tensor, its value and what was expected.
    pub fn weights(
        &self,
        tensors: impl FnOnce() -> Result<Tensors, BuildError>,
        joints: &[&str],
        links: &[&str],
    ) -> Result<Weights, BuildError> {
        self.check(joints, links).map_err(|error| error.in_file(&self.origin))?;
        let (mut tensors, widths) = (tensors()?, self.widths());
        let members = (0..self.architecture.members).map(|member| {
            let layers = widths.windows(2).enumerate().map(|(index, width)| {
                let name = format!("member.{member}.layer.{index}");
                let weights = tensors.take(&format!("{name}.weight"), &[width[1], width[0]])?;
                Ok((weights, tensors.take(&format!("{name}.bias"), &[width[1]])?))
            });
            layers.collect::<Result<Vec<_>, BuildError>>()
        });
        let members = members.collect::<Result<_, _>>()?;
        let outputs = [3 * links.len()];
        let (scale, offset) =
            (tensors.take("output.scale", &outputs)?, tensors.take("output.offset", &outputs)?);
        tensors.finish()?;
        Ok(Weights { members, scale, offset })
    }

    fn check(&self, joints: &[&str], links: &[&str]) -> Result<(), BuildError> {
        let Output { frame, layout, .. } = self.output;
        if (frame, layout) == (OutputFrame::Link, Layout::Component) {
            let expected = "base with either layout, link with link";
            let found = format!("frame {frame:?} with layout {layout:?}");
            return Err(BuildError::bad_entry("output", found, expected));
        }
        self.check_inputs(joints, links)?;
        let Architecture { hidden, members, .. } = &self.architecture;
        if !(1..=MAX_SIZE).contains(members) {
            return Err(BuildError::bad_entry("architecture.members", members, "1 to 65536 networks"));
        }
        if hidden.len() > MAX_SIZE {
            let found = format!("{} layers", hidden.len());
            return Err(BuildError::bad_entry("architecture.hidden", found, "fewer layers"));
        }
        if let Some(width) = hidden.iter().find(|width| !(1..=MAX_SIZE).contains(*width)) {
            return Err(BuildError::bad_entry("architecture.hidden", width, "widths from 1 to 65536"));
        }
        self.check_baseline()
    }

    fn check_inputs(&self, robot_joints: &[&str], robot_links: &[&str]) -> Result<(), BuildError> {
        let Inputs { features, joints, links } = &self.inputs;
        if features.is_empty() {
            return Err(BuildError::bad_entry("inputs.features", "empty", "at least one block of features"));
        }
        for (index, feature) in features.iter().enumerate() {
            if features[..index].contains(feature) {
                let found = format!("{feature:?} twice");
                return Err(BuildError::bad_entry("inputs.features", found, "each block once"));
            }
        }
        if links != robot_links {
            return Err(BuildError::bad_entry("inputs.links", links.join(", "), robot_links.join(", ")));
        }
        let mut last = None;
        for name in joints {
            let index = place_of("`inputs.joints`", name, robot_joints)?;
            if last.is_some_and(|last| index <= last) {
                let expected = "joints in the robot's order";
                return Err(BuildError::bad_entry("inputs.joints", joints.join(", "), expected));
            }
            last = Some(index);
        }
        Ok(())
    }

    fn check_baseline(&self) -> Result<(), BuildError> {
        let Some(Baseline::Axisymmetric { links }) = &self.architecture.baseline else { return Ok(()) };
        let key = "architecture.baseline.links";
        for name in links.keys() {
            place_of(format!("`{key}`"), name, &self.inputs.links)?;
        }
        for name in &self.inputs.links {
            let Some(set) = links.get(name) else {
                return Err(BuildError::bad_entry(key, format!("without `{name}`"), "all links"));
            };
            for (index, w) in set.cda.iter().chain([&set.cna]).enumerate() {
                check(
                    &format!("coefficient w{index} of link `{name}`"),
                    *w,
                    |_| true,
                    "a finite area in m²",
                )?;
            }
        }
        Ok(())
    }
}

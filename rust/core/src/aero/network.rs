//! Force areas of all links at once, from a neural network of wind and posture.
//!
//! ```text
//! card + weights, RobotModel ──new──► Network;   Kinematics, wind ──link_forces──► forces_i
//! features ► Evaluator (mlp) ► scale, offset ► mean with the mirrored sample ► base axes ► + baseline
//! ```
//!
//! `card` describes inputs and outputs of the weights, `tensors` holds the weights, `mirror` the robot's symmetry;
//! `mlp` evaluates. Card and weights are checked once, when the network is built; the evaluation neither panics nor
//! allocates.
//!
//! Equations M23 and M24 of `docs/model`.

mod card;
mod mirror;
mod mlp;
mod tensors;

pub use card::{Architecture, Baseline, Card, Inputs, Layout, Output, Unit, Weights};
use card::{Feature, OutputFrame};
pub(crate) use mlp::Layer;
pub use tensors::{Tensor, Tensors};

use super::links::check_air_density;
use super::{LinksInAir, axisymmetric_force};
use crate::error::BuildError;
use crate::exponential::exp_f64;
use crate::kinematics::Kinematics;
use crate::linalg::dispatch_plain;
use crate::robot::{AxisymmetricCoefficients, RobotModel};
use mirror::{Mirror, reflect};
use mlp::{Evaluator, Pair};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// `ℓ` \[m\]: distance over which a link passes from upstream of another link to its wake.
const SHADOW_LENGTH: f64 = 0.05;
/// `w` \[m\]: standard deviation of a link's shadow across the wind.
const SHADOW_RADIUS: f64 = 0.10;

/// Precision of the weighted sums; all other computations are in double precision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Precision {
    /// Single precision, as networks are trained.
    #[default]
    F32,
    /// Double precision with the same weights, for comparison of implementations.
    F64,
}

/// A network for one robot after its checks, with its workspace.
#[derive(Debug, Clone)]
pub struct Network {
    /// `k_a = ρ/2` \[kg/m³\].
    k_a: f64,
    features: Vec<Feature>,
    frame: OutputFrame,
    layout: Layout,
    /// Indices of the robot's joints that are inputs.
    joints: Vec<usize>,
    mirror: Option<Mirror>,
    baseline: Option<Vec<AxisymmetricCoefficients>>,
    scale: Vec<f32>,
    offset: Vec<f32>,
    evaluator: Evaluator,
    inputs: Vec<Pair>,
    outputs: Vec<Pair>,
    links: Vec<PlacedLink>,
    /// One entry for each pair of links.
    pairs: Vec<[f64; 2]>,
}

/// Pose of one link in the base frame, and the network's output for it.
#[derive(Debug, Clone, Copy)]
struct PlacedLink {
    /// Rotation, base from link.
    b_from_l: Matrix3<f64>,
    /// Aerodynamic centre relative to the base origin \[m, base axes\].
    centre_b: Vector3<f64>,
    /// Shadow of the other links on this one (M24); computed only if it is an input.
    shadow: f64,
    /// Force area \[m², base axes\].
    area_b: Vector3<f64>,
}

impl Network {
    /// Checks card and weights against each other and against the robot. The weights are read after the card has
    /// been checked, because the card of another robot gives the clearer error.
    ///
    /// # Errors
    /// [`BuildError`] naming key or tensor, the value found and what was expected.
    pub fn new(
        card: Card,
        tensors: impl FnOnce() -> Result<Tensors, BuildError>,
        precision: Precision,
        air_density: f64,
        robot: &RobotModel,
    ) -> Result<Self, BuildError> {
        let air_density = check_air_density(air_density)?;
        let joints: Vec<_> = robot.joints.iter().map(|joint| joint.name.as_str()).collect();
        let links: Vec<_> = robot.aero_links.iter().map(|link| link.name.as_str()).collect();
        let weights = card.weights(tensors, &joints, &links)?;
        let evaluator = Evaluator::new(&card, &weights, precision == Precision::F64);
        let Weights { scale, offset, .. } = weights;
        let joints: Vec<usize> =
            card.inputs.joints.iter().filter_map(|name| robot.joint_index(name)).collect();
        let inputs = card.widths()[0];
        let at_base = PlacedLink {
            b_from_l: Matrix3::identity(),
            centre_b: Vector3::zeros(),
            shadow: 0.0,
            area_b: Vector3::zeros(),
        };
        Ok(Self {
            k_a: 0.5 * air_density,
            mirror: card.architecture.mirror.then(|| Mirror::new(robot, &joints)).transpose()?,
            baseline: card.baseline_coefficients(),
            features: card.inputs.features,
            frame: card.output.frame,
            layout: card.output.layout,
            joints,
            scale,
            offset,
            evaluator,
            inputs: vec![[0.0; 2]; inputs],
            outputs: vec![[0.0; 2]; 3 * robot.aero_links.len()],
            links: vec![at_base; robot.aero_links.len()],
            pairs: vec![[0.0; 2]; robot.aero_links.len() * robot.aero_links.len().saturating_sub(1) / 2],
        })
    }

    /// Writes the force on every link \[N, inertial axes\]; zero in still air.
    ///
    /// ```text
    /// F_j = k_a |v|² R_B c_j(û, s),   v = v_wind − v_B,   û = R_Bᵀ v / |v|
    /// ```
    ///
    /// The velocity is that of the *base origin* for all links, because the network was trained with one wind for
    /// the whole robot. Source: the published simulator and training, see `docs/deviations.md`.
    pub fn link_forces(&mut self, links: &LinksInAir, forces_i: &mut [Vector3<f64>]) {
        let LinksInAir { robot, kinematics, wind_i, .. } = *links;
        let base = &kinematics.bodies[0];
        let i_from_b = base.i_from_b.rotation;
        let v_i = wind_i - base.linear_velocity;
        let wind_b = (i_from_b.transpose() * v_i).try_normalize(0.0).unwrap_or_else(Vector3::x);
        self.place_links(robot, kinematics);
        self.fill_inputs(&wind_b, &kinematics.joint_position);
        self.evaluator.evaluate(&self.inputs, &mut self.outputs);
        self.read_areas();
        self.add_baseline(robot, &wind_b);
        let pressure = self.k_a * v_i.norm_squared();
        forces_i.fill(Vector3::zeros());
        for (force_i, link) in forces_i.iter_mut().zip(&self.links) {
            *force_i = i_from_b * link.area_b * pressure;
        }
    }

    fn place_links(&mut self, robot: &RobotModel, kinematics: &Kinematics) {
        let base = kinematics.bodies[0].i_from_b;
        let b_from_i = base.rotation.transpose();
        for (placed, link) in self.links.iter_mut().zip(&robot.aero_links) {
            let pose = kinematics.frame_pose(&link.frame);
            placed.b_from_l = b_from_i * pose.rotation;
            placed.centre_b = b_from_i * (pose.transform_point(&link.centre_l) - base.position);
        }
    }

    /// Writes the input vector and, as second sample, the mirrored input.
    fn fill_inputs(&mut self, wind_b: &Vector3<f64>, joint_position: &[f64]) {
        let mut first = 0;
        for feature in &self.features {
            let block = &mut self.inputs[first..];
            let mirror = self.mirror.as_ref();
            first += match feature {
                Feature::Wind => {
                    write(block, 0, 0, wind_b);
                    write(block, 1, 0, &reflect(wind_b));
                    3
                }
                Feature::Joints => {
                    for (place, &joint) in self.joints.iter().enumerate() {
                        let angle = joint_position[joint].to_degrees() / 180.0;
                        block[place][0] = angle;
                        if let Some((image, sign)) = mirror.map(|mirror| mirror.joints[place]) {
                            block[image][1] = sign * angle;
                        }
                    }
                    self.joints.len()
                }
                Feature::LinkWind => {
                    for (index, link) in self.links.iter().enumerate() {
                        let wind_l = link.b_from_l.tr_mul(wind_b);
                        write(block, 0, index, &wind_l);
                        if let Some((image, image_from_l)) = mirror.map(|mirror| mirror.links[index]) {
                            write(block, 1, image, &(image_from_l * wind_l));
                        }
                    }
                    3 * self.links.len()
                }
                Feature::LinkPosition => {
                    for (index, link) in self.links.iter().enumerate() {
                        write(block, 0, index, &link.centre_b);
                        if let Some((image, _)) = mirror.map(|mirror| mirror.links[index]) {
                            write(block, 1, image, &reflect(&link.centre_b));
                        }
                    }
                    3 * self.links.len()
                }
                Feature::LinkShadow => {
                    shade(&mut self.links, wind_b, &mut self.pairs);
                    for (index, link) in self.links.iter().enumerate() {
                        block[index][0] = link.shadow;
                        if let Some((image, _)) = mirror.map(|mirror| mirror.links[index]) {
                            block[image][1] = link.shadow;
                        }
                    }
                    self.links.len()
                }
            };
        }
    }

    /// Converts the outputs of the input and of its mirror image to force areas in base axes (M25).
    fn read_areas(&mut self) {
        for ((output, scale), offset) in self.outputs.iter_mut().zip(&self.scale).zip(&self.offset) {
            for y in output {
                *y = f64::from(*scale) * *y + f64::from(*offset);
            }
        }
        let n = self.links.len();
        let (frame, layout, outputs) = (self.frame, self.layout, &self.outputs);
        let read = |sample: usize, link: usize| match layout {
            Layout::Component => {
                Vector3::new(outputs[link][sample], outputs[2 * n + link][sample], outputs[n + link][sample])
            }
            Layout::Link => Vector3::from_fn(|axis, _| outputs[3 * link + axis][sample]),
        };
        for (index, link) in self.links.iter_mut().enumerate() {
            let mut area = read(0, index);
            if let Some(mirror) = &self.mirror {
                let (image, _) = mirror.links[index];
                let of_image = read(1, image);
                area += match frame {
                    OutputFrame::Link => mirror.links[image].1 * of_image,
                    OutputFrame::Base => reflect(&of_image),
                };
                area *= 0.5;
            }
            link.area_b = match frame {
                OutputFrame::Base => area,
                OutputFrame::Link => link.b_from_l * area,
            };
        }
    }

    fn add_baseline(&mut self, robot: &RobotModel, wind_b: &Vector3<f64>) {
        let Some(baseline) = &self.baseline else { return };
        for ((link, aero_link), areas) in self.links.iter_mut().zip(&robot.aero_links).zip(baseline) {
            let axis_b = link.b_from_l * aero_link.axis_l.into_inner();
            link.area_b += axisymmetric_force(areas, &axis_b, wind_b, 1.0);
        }
    }
}

/// Writes a vector of one sample to position `index` of a block of vectors.
fn write(block: &mut [Pair], sample: usize, index: usize, v: &Vector3<f64>) {
    for (slot, x) in block[3 * index..].iter_mut().zip(v.iter()) {
        slot[sample] = *x;
    }
}

/// Computes the shadow of the other links on every link: how far the link is in their wake (M24).
///
/// ```text
/// S_j = Σ_k≠j exp(−r² / 2w²) / (1 + exp(−d·û / ℓ)),   d = x_j − x_k,   r² = |d|² − (d·û)²
/// ```
///
/// Scratch space `pairs` receives `exp(−d·û / ℓ)` and `exp(−r² / 2w²)` for link j and each link before it.
fn shade(links: &mut [PlacedLink], wind_b: &Vector3<f64>, pairs: &mut [[f64; 2]]) {
    let mut exponents = pairs.iter_mut();
    for (index, link) in links.iter().enumerate() {
        for (other, exponents) in links[..index].iter().zip(&mut exponents) {
            let d = link.centre_b - other.centre_b;
            let along = d.dot(wind_b);
            let across_squared = d.norm_squared() - along * along;
            *exponents = [-along / SHADOW_LENGTH, -across_squared / (2.0 * SHADOW_RADIUS * SHADOW_RADIUS)];
        }
    }
    dispatch_plain(
        #[inline(always)]
        || {
            for x in pairs.as_flattened_mut() {
                *x = exp_f64(*x);
            }
        },
    );
    for link in &mut *links {
        link.shadow = 0.0;
    }
    let mut pairs = pairs.iter();
    for index in 1..links.len() {
        let (before, rest) = links.split_at_mut(index);
        let link = &mut rest[0];
        for (other, [ahead, overlap]) in before.iter_mut().zip(&mut pairs) {
            let behind = 1.0 / (1.0 + ahead);
            link.shadow += behind * overlap;
            other.shadow += (1.0 - behind) * overlap;
        }
    }
}

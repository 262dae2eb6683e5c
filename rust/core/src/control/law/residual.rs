//! What is added to the answer of the law, or replaces it: the action of a learned policy, or a given one.
//!
//! ```text
//! x = s ∘ o                       features o of M170, the wrench observed as in M84
//! h ← tanh( W h + b )             hidden layers of a policy, from h = x
//! a = tanh( W h + D x + b )       action of a policy, between −1 and 1 (M171)
//! u = clip( ζ u* + S a, l, u )    thrust rates and joint velocities, in the bounds of M65; ζ = 0 replaces (M172)
//! ```
//!
//! The torques follow the joint velocities that result. A residual that is not finite is not used
//! ([`Modes::RESIDUAL_IGNORED`]), nor is one without an answer of the law. Equations M170 to M172 of `docs/model`.

use super::setpoint::Setpoint;
use crate::aero::network::{Layer, Tensors};
use crate::error::{BuildError, check};
use crate::exponential::tanh_f64;
use crate::kinematics::{Kinematics, RobotState};
use crate::robot::RobotModel;
use crate::spatial::parts;
use nalgebra::{DVector, Matrix3, Vector3, Vector6};
use serde::{Deserialize, Serialize};

/// Greatest number of hidden layers, and of the units of one.
const MAX_LAYERS: usize = 8;
const MAX_HIDDEN: usize = 4096;

/// Vectors of 64 bytes in a panel of weights: 32 rows.
const PANEL: usize = 4;

/// A residual given for one tick.
#[derive(Debug, Clone, Copy)]
pub struct Residual<'a> {
    /// Thrust rates \[N/s\].
    pub thrust_rate: &'a [f64],
    /// Joint velocities \[rad/s, m/s\].
    pub joint_velocity: &'a [f64],
    /// Whether it replaces the answer of the law instead of being added.
    pub replaces: bool,
}

/// Numbers that a policy observes: three in base axes, or one for each joint or jet (M170).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Feature {
    /// Direction of gravity.
    Gravity,
    /// Half the skew part of the rotation from the set-point.
    Rotation,
    /// Centre of mass from its set-point \[m\].
    Position,
    /// Velocity of the base from that of the set-point \[m/s\].
    Velocity,
    /// Angular velocity of the base from that of the set-point \[rad/s\].
    AngularVelocity,
    /// Joint positions from the posture of the first tick \[rad, m\].
    JointPosition,
    /// A tenth of the joint velocities \[rad/s, m/s\].
    JointVelocity,
    /// Thrusts over their greatest.
    Thrust,
    /// Observed force over a tenth of the sum of the greatest thrusts.
    Force,
    /// Observed moment over a hundredth of that sum \[1/m\].
    Moment,
}

/// Description of the weights of a policy.
#[derive(Debug, Clone, PartialEq)]
pub struct PolicyCard {
    /// File or source of the card; named in errors.
    pub origin: String,
    /// What it observes.
    pub inputs: PolicyInputs,
    /// What it acts on.
    pub output: PolicyOutput,
    /// Its layers.
    pub architecture: PolicyArchitecture,
}

/// What a policy observes.
#[derive(Debug, Clone, PartialEq, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PolicyInputs {
    /// Features, in the order of the input vector.
    pub features: Vec<Feature>,
    /// Factor `s` of each of them.
    pub scale: Vec<f64>,
}

/// What a policy acts on: every jet and joint of the robot.
#[derive(Debug, Clone, PartialEq, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PolicyOutput {
    /// Jets, in the robot's order.
    pub jets: Vec<String>,
    /// Joints, in the robot's order.
    pub joints: Vec<String>,
    /// Thrust rate of an action of 1 \[N/s\].
    pub thrust_rate: f64,
    /// Joint velocity of an action of 1 \[rad/s, m/s\].
    pub joint_velocity: f64,
    /// Whether it replaces the answer of the law instead of being added.
    pub replaces: bool,
}

/// Layers of a policy.
#[derive(Debug, Clone, PartialEq, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PolicyArchitecture {
    /// Numbers of units of the hidden layers.
    pub hidden: Vec<usize>,
}

/// Weights of a policy, matrices by row.
#[derive(Debug, Clone)]
pub struct PolicyWeights {
    /// Matrix and bias of each hidden layer.
    pub hidden: Vec<(Vec<f32>, Vec<f32>)>,
    /// Matrix and bias of the last layer.
    pub output: (Vec<f32>, Vec<f32>),
    /// `D`.
    pub direct: Vec<f32>,
}

impl PolicyCard {
    /// Numbers of inputs, of the units of each hidden layer, and of actions.
    #[must_use]
    pub fn widths(&self) -> Vec<usize> {
        let PolicyOutput { jets, joints, .. } = &self.output;
        let size = |feature: &Feature| match feature {
            Feature::JointPosition | Feature::JointVelocity => joints.len(),
            Feature::Thrust => jets.len(),
            Feature::Gravity
            | Feature::Rotation
            | Feature::Position
            | Feature::Velocity
            | Feature::AngularVelocity
            | Feature::Force
            | Feature::Moment => 3,
        };
        let inputs = self.inputs.features.iter().map(size).sum();
        [&[inputs], &*self.architecture.hidden, &[jets.len() + joints.len()]].concat()
    }

    /// Checks the card, then reads `tensors` as its weights: the card of another robot gives the clearer error.
    /// `jets` and `joints` are the robot's.
    ///
    /// # Errors
    /// [`BuildError`] naming the file, and key or tensor, its value and what was expected.
    pub fn weights(
        &self,
        tensors: impl FnOnce() -> Result<Tensors, BuildError>,
        jets: &[&str],
        joints: &[&str],
    ) -> Result<PolicyWeights, BuildError> {
        self.check(jets, joints).map_err(|error| error.in_file(&self.origin))?;
        let (mut tensors, widths, layers) = (tensors()?, self.widths(), self.architecture.hidden.len());
        let mut layer = |name: &str, from: usize, to: usize| {
            let weights = tensors.take(&format!("{name}.weight"), &[to, from])?;
            Ok::<_, BuildError>((weights, tensors.take(&format!("{name}.bias"), &[to])?))
        };
        let (inputs, last, actions) = (widths[0], widths[layers], widths[layers + 1]);
        let hidden = widths[..=layers].windows(2).enumerate();
        let weights = PolicyWeights {
            hidden: hidden
                .map(|(number, width)| layer(&format!("hidden.{number}"), width[0], width[1]))
                .collect::<Result<_, _>>()?,
            output: layer("output", last, actions)?,
            direct: tensors.take("direct.weight", &[actions, inputs])?,
        };
        tensors.finish()?;
        Ok(weights)
    }

    fn check(&self, robot_jets: &[&str], robot_joints: &[&str]) -> Result<(), BuildError> {
        let PolicyInputs { features, scale } = &self.inputs;
        for (index, feature) in features.iter().enumerate() {
            if features[..index].contains(feature) {
                return Err(BuildError::bad_entry(
                    "inputs.features",
                    format!("{feature:?} twice"),
                    "each once",
                ));
            }
        }
        if features.is_empty() {
            return Err(BuildError::bad_entry("inputs.features", "empty", "at least one"));
        }
        if scale.len() != features.len() {
            let expected = format!("{}, one for each feature", features.len());
            return Err(BuildError::bad_entry("inputs.scale", format!("{} numbers", scale.len()), expected));
        }
        for factor in scale {
            check("`inputs.scale`", *factor, |_| true, "finite numbers")?;
        }
        let PolicyOutput { jets, joints, thrust_rate, joint_velocity, .. } = &self.output;
        for (key, names, expected) in
            [("output.jets", jets, robot_jets), ("output.joints", joints, robot_joints)]
        {
            if names != expected {
                let expected = format!("{}, as of the robot", expected.join(", "));
                return Err(BuildError::bad_entry(key, names.join(", "), expected));
            }
        }
        for (key, value) in [("thrust_rate", thrust_rate), ("joint_velocity", joint_velocity)] {
            check(&format!("`output.{key}`"), *value, |x| x >= 0.0, "a number ≥ 0")?;
        }
        let hidden = &self.architecture.hidden;
        let is_sound = hidden.iter().all(|units| (1..=MAX_HIDDEN).contains(units));
        if !is_sound || !(1..=MAX_LAYERS).contains(&hidden.len()) {
            let expected = format!("1 to {MAX_LAYERS} layers of 1 to {MAX_HIDDEN} units");
            return Err(BuildError::bad_entry("architecture.hidden", format!("{hidden:?}"), expected));
        }
        Ok(())
    }
}

/// A policy for one robot after its checks, with its workspace.
#[derive(Debug, Clone)]
pub struct Policy {
    features: Vec<Feature>,
    scale: Vec<f64>,
    output: PolicyOutput,
    /// Greatest thrusts \[N\].
    thrust_max: Vec<f64>,
    /// A tenth of their sum \[N\].
    force: f64,
    hidden: Vec<Layer<f64>>,
    /// `(W, D), b`.
    last: Layer<f64>,
    /// `x`.
    inputs: [Vec<f64>; 1],
    /// Units of each hidden layer, to complete panels.
    units: Vec<[Vec<f64>; 1]>,
    /// The last units, then `x`.
    joined: [Vec<f64>; 1],
    /// `a`, to complete panels.
    action: [Vec<f64>; 1],
}

/// Inputs of a policy in a tick.
#[derive(Debug, Clone, Copy)]
pub struct Sight<'a> {
    /// The robot.
    pub robot: &'a RobotState,
    /// Its thrusts \[N\].
    pub thrust: &'a [f64],
    /// Its kinematics.
    pub kinematics: &'a Kinematics,
    /// Set-point.
    pub due: &'a Setpoint,
    /// Joint positions of the first tick.
    pub posture: &'a DVector<f64>,
    /// Observed wrench \[N, N m\].
    pub wrench: &'a Vector6<f64>,
}

impl Policy {
    /// Checks card and weights against each other and against the robot. The weights are read after the card has been
    /// checked, because the card of another robot gives the clearer error.
    ///
    /// # Errors
    /// [`BuildError`] naming key or tensor, the value found and what was expected.
    pub fn new(
        card: PolicyCard,
        tensors: impl FnOnce() -> Result<Tensors, BuildError>,
        robot: &RobotModel,
    ) -> Result<Self, BuildError> {
        let (jets, joints): (Vec<_>, Vec<_>) =
            (robot.jet_names().collect(), robot.joints.iter().map(|joint| joint.name.as_str()).collect());
        let PolicyWeights { hidden, output: (output, bias), direct } =
            card.weights(tensors, &jets, &joints)?;
        let widths = card.widths();
        let (inputs, last, actions) = (widths[0], widths[hidden.len()], bias.len());
        let rows = output.chunks_exact(last).zip(direct.chunks_exact(inputs));
        let joined: Vec<f32> = rows.flat_map(|(units, inputs)| [units, inputs].concat()).collect();
        let PolicyCard { inputs: PolicyInputs { features, scale }, output, .. } = card;
        let padded = |count: usize| [vec![0.0; count.next_multiple_of(8 * PANEL)]];
        let thrust_max: Vec<f64> = robot.jets.iter().map(|jet| jet.thrust_max).collect();
        Ok(Self {
            force: 0.1 * thrust_max.iter().sum::<f64>(),
            thrust_max,
            units: hidden.iter().map(|(_, bias)| padded(bias.len())).collect(),
            hidden: hidden
                .iter()
                .zip(&widths)
                .map(|((weights, bias), inputs)| Layer::new::<PANEL>(weights, bias, *inputs))
                .collect(),
            last: Layer::new::<PANEL>(&joined, &bias, last + inputs),
            inputs: [vec![0.0; inputs]],
            joined: [vec![0.0; last + inputs]],
            action: padded(actions),
            features,
            scale,
            output,
        })
    }

    /// Whether it replaces the answer of the law.
    #[must_use]
    pub fn replaces(&self) -> bool {
        self.output.replaces
    }

    /// Writes its residual of what is seen to `residual`, thrust rates first \[N/s, rad/s\].
    pub fn act(&mut self, seen: &Sight, residual: &mut DVector<f64>) {
        self.observe(seen);
        let Self { hidden, last, inputs, units, joined, action, output, .. } = self;
        let first = joined[0].len() - inputs[0].len();
        for (number, layer) in hidden.iter().enumerate() {
            let (before, after) = units.split_at_mut(number);
            if let Some(to) = after.first_mut() {
                layer.apply::<PANEL, 1>(before.last().unwrap_or(inputs), to, tanh_f64);
            }
        }
        if let Some(units) = units.last() {
            joined[0][..first].copy_from_slice(&units[0][..first]);
        }
        joined[0][first..].copy_from_slice(&inputs[0]);
        last.apply::<PANEL, 1>(joined, action, tanh_f64);
        let jets = output.jets.len();
        for (index, (to, action)) in residual.iter_mut().zip(&action[0]).enumerate() {
            *to = action * if index < jets { output.thrust_rate } else { output.joint_velocity };
        }
    }

    /// `s ∘ o` (M170).
    fn observe(&mut self, seen: &Sight) {
        let Sight { robot, thrust, kinematics, due, posture, wrench } = *seen;
        let rotation = &robot.base.rotation;
        let turned = due.rotation.tr_mul(rotation);
        let velocity: Vector3<f64> = robot.velocity.fixed_rows::<3>(0).into();
        let angular_velocity = robot.base_angular_velocity() - due.rotation * due.angular_velocity_b;
        let (force, moment) = parts(wrench);
        let mut left = &mut self.inputs[0][..];
        for (feature, scale) in self.features.iter().zip(&self.scale) {
            let vector = |to, vector: Vector3<f64>| write(to, *scale, vector.iter().copied());
            left = match feature {
                Feature::Gravity => vector(left, -rotation.row(2).transpose()),
                Feature::Rotation => vector(left, skew_part(&turned)),
                Feature::Position => vector(left, rotation.tr_mul(&(kinematics.com - due.com_position))),
                Feature::Velocity => vector(left, rotation.tr_mul(&(velocity - due.com_velocity))),
                Feature::AngularVelocity => vector(left, rotation.tr_mul(&angular_velocity)),
                Feature::Force => vector(left, rotation.tr_mul(&force) / self.force),
                Feature::Moment => vector(left, rotation.tr_mul(&moment) / (0.1 * self.force)),
                Feature::JointPosition => {
                    let joints = robot.joint_position.iter().zip(posture);
                    write(left, *scale, joints.map(|(now, first)| now - first))
                }
                Feature::JointVelocity => {
                    write(left, *scale, robot.joint_velocity().iter().map(|velocity| 0.1 * velocity))
                }
                Feature::Thrust => {
                    let thrusts = thrust.iter().zip(&self.thrust_max);
                    write(left, *scale, thrusts.map(|(now, most)| now / most))
                }
            };
        }
    }
}

/// Writes scaled numbers to the beginning of a slice; returns what is left of it.
fn write(to: &mut [f64], scale: f64, numbers: impl ExactSizeIterator<Item = f64>) -> &mut [f64] {
    let (to, left) = to.split_at_mut(numbers.len().min(to.len()));
    for (to, number) in to.iter_mut().zip(numbers) {
        *to = scale * number;
    }
    left
}

/// Vector of the skew-symmetric part of a matrix.
fn skew_part(m: &Matrix3<f64>) -> Vector3<f64> {
    0.5 * Vector3::new(m[(2, 1)] - m[(1, 2)], m[(0, 2)] - m[(2, 0)], m[(1, 0)] - m[(0, 1)])
}

impl Residual<'_> {
    /// Writes it as one vector; NaN if its sizes are those of another robot.
    pub(in crate::control) fn write(&self, jets: usize, joints: usize, to: &mut DVector<f64>) {
        if (self.thrust_rate.len(), self.joint_velocity.len()) != (jets, joints) {
            return to.fill(f64::NAN);
        }
        for (to, from) in to.iter_mut().zip(self.thrust_rate.iter().chain(self.joint_velocity)) {
            *to = *from;
        }
    }
}

//! What is added to the answer of the law: the action of a learned policy, or a given one.
//!
//! ```text
//! x = s ∘ o                                      features o of M170, the wrench observed as in M84
//! a = tanh( W₂ tanh( W₁ x + b₁ ) + W₃ x + b₂ )   action of a policy, between −1 and 1 (M171)
//! u = clip( u* + S a, l, u )                     thrust rates and joint velocities, in the bounds of M65 (M172)
//! ```
//!
//! The torques follow the joint velocities that result. A residual that is not finite is not used
//! ([`Modes::RESIDUAL_IGNORED`]), nor is one without an answer of the law. Equations M170 to M172 of `docs/model`.

use crate::aero::network::{Layer, Tensors};
use crate::control::command::Command;
use crate::control::guard::observer::{MomentumSample, ObserverConfig};
use crate::control::modes::Modes;
use crate::control::state::ControllerState;
use crate::control::terms::Terms;
use crate::error::{BuildError, check};
use crate::exponential::tanh_f64;
use crate::robot::RobotModel;
use crate::spatial::parts;
use nalgebra::{DVector, Matrix3, Vector3, Vector6};
use serde::{Deserialize, Serialize};

/// Observer of the wrench that a policy sees.
const OBSERVER: ObserverConfig =
    ObserverConfig { gain_force: 3.0, gain_moment: 3.0, force_max: f64::INFINITY, moment_max: f64::INFINITY };

/// Greatest number of units.
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

/// Three numbers that a policy observes, in base axes (M170).
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
}

/// Layers of a policy.
#[derive(Debug, Clone, PartialEq, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PolicyArchitecture {
    /// Number of hidden units.
    pub hidden: usize,
}

/// Weights of a policy, matrices by row.
#[derive(Debug, Clone)]
pub struct PolicyWeights {
    /// `W₁`.
    pub hidden: Vec<f32>,
    /// `b₁`.
    pub hidden_bias: Vec<f32>,
    /// `W₂`.
    pub output: Vec<f32>,
    /// `W₃`.
    pub direct: Vec<f32>,
    /// `b₂`.
    pub output_bias: Vec<f32>,
}

impl PolicyCard {
    /// Numbers of inputs, hidden units and actions.
    #[must_use]
    pub fn sizes(&self) -> [usize; 3] {
        let PolicyOutput { jets, joints, .. } = &self.output;
        [3 * self.inputs.features.len(), self.architecture.hidden, jets.len() + joints.len()]
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
        let (mut tensors, [inputs, hidden, actions]) = (tensors()?, self.sizes());
        let weights = PolicyWeights {
            hidden: tensors.take("hidden.weight", &[hidden, inputs])?,
            hidden_bias: tensors.take("hidden.bias", &[hidden])?,
            output: tensors.take("output.weight", &[actions, hidden])?,
            direct: tensors.take("direct.weight", &[actions, inputs])?,
            output_bias: tensors.take("output.bias", &[actions])?,
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
        let PolicyOutput { jets, joints, thrust_rate, joint_velocity } = &self.output;
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
        let hidden = self.architecture.hidden;
        if !(1..=MAX_HIDDEN).contains(&hidden) {
            let expected = format!("1 to {MAX_HIDDEN} units");
            return Err(BuildError::bad_entry("architecture.hidden", hidden, expected));
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
    /// A tenth of the sum of the greatest thrusts \[N\].
    force: f64,
    /// `W₁, b₁`.
    first: Layer<f64>,
    /// `(W₂, W₃), b₂`.
    second: Layer<f64>,
    /// `x`.
    inputs: [Vec<f64>; 1],
    /// `tanh(W₁ x + b₁)`, to complete panels.
    units: [Vec<f64>; 1],
    /// The units, then `x`.
    joined: [Vec<f64>; 1],
    /// `a`, to complete panels.
    action: [Vec<f64>; 1],
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
        let weights = card.weights(tensors, &jets, &joints)?;
        let [inputs, hidden, actions] = card.sizes();
        let rows = weights.output.chunks_exact(hidden).zip(weights.direct.chunks_exact(inputs));
        let joined: Vec<f32> = rows.flat_map(|(units, inputs)| [units, inputs].concat()).collect();
        let PolicyCard { inputs: PolicyInputs { features, scale }, output, .. } = card;
        let padded = |count: usize| [vec![0.0; count.next_multiple_of(8 * PANEL)]];
        Ok(Self {
            force: 0.1 * robot.jets.iter().map(|jet| jet.thrust_max).sum::<f64>(),
            first: Layer::new::<PANEL>(&weights.hidden, &weights.hidden_bias, inputs),
            second: Layer::new::<PANEL>(&joined, &weights.output_bias, hidden + inputs),
            inputs: [vec![0.0; inputs]],
            units: padded(hidden),
            joined: [vec![0.0; hidden + inputs]],
            action: padded(actions),
            features,
            scale,
            output,
        })
    }

    /// Writes its residual to `terms.residual`, thrust rates first \[N/s, rad/s\]. `wrench` is the observed one \[N, N m\].
    pub fn act(&mut self, wrench: &Vector6<f64>, terms: &mut Terms) {
        self.observe(wrench, terms);
        let Self { first, second, inputs, units, joined, action, output, .. } = self;
        first.apply::<PANEL, 1>(inputs, units, tanh_f64);
        let hidden = joined[0].len() - inputs[0].len();
        joined[0][..hidden].copy_from_slice(&units[0][..hidden]);
        joined[0][hidden..].copy_from_slice(&inputs[0]);
        second.apply::<PANEL, 1>(joined, action, tanh_f64);
        let jets = output.jets.len();
        for (index, (to, action)) in terms.residual.iter_mut().zip(&action[0]).enumerate() {
            *to = action * if index < jets { output.thrust_rate } else { output.joint_velocity };
        }
    }

    /// `s ∘ o` (M170).
    fn observe(&mut self, wrench: &Vector6<f64>, terms: &Terms) {
        let Terms { measurement, due, kinematics, .. } = terms;
        let state = &measurement.state;
        let rotation = &state.base.rotation;
        let turned = due.rotation.tr_mul(rotation);
        let velocity: Vector3<f64> = state.velocity.fixed_rows::<3>(0).into();
        let angular_velocity = state.base_angular_velocity() - due.rotation * due.angular_velocity_b;
        let (force, moment) = parts(wrench);
        for ((feature, scale), to) in
            self.features.iter().zip(&self.scale).zip(self.inputs[0].chunks_exact_mut(3))
        {
            let seen = match feature {
                Feature::Gravity => -rotation.row(2).transpose(),
                Feature::Rotation => skew_part(&turned),
                Feature::Position => rotation.tr_mul(&(kinematics.com - due.com_position)),
                Feature::Velocity => rotation.tr_mul(&(velocity - due.com_velocity)),
                Feature::AngularVelocity => rotation.tr_mul(&angular_velocity),
                Feature::Force => rotation.tr_mul(&force) / self.force,
                Feature::Moment => rotation.tr_mul(&moment) / (0.1 * self.force),
            };
            for (to, seen) in to.iter_mut().zip(&seen) {
                *to = scale * seen;
            }
        }
    }
}

/// Vector of the skew-symmetric part of a matrix.
fn skew_part(m: &Matrix3<f64>) -> Vector3<f64> {
    0.5 * Vector3::new(m[(2, 1)] - m[(1, 2)], m[(0, 2)] - m[(2, 0)], m[(1, 0)] - m[(0, 1)])
}

/// Adds the residual of a tick to the answer of the law (M172), and, from the first one on, observes the wrench for the
/// next tick. A given residual takes the place of the policy's.
pub fn steer(
    policy: Option<&mut Policy>,
    given: Option<&Residual>,
    state: &mut ControllerState,
    terms: &mut Terms,
    command: &mut Command,
) {
    let wrench = state.residual_wrench();
    let has_residual = given.is_some() || policy.is_some();
    match (given, policy) {
        (Some(given), _) => given.write(command, &mut terms.residual),
        (None, Some(policy)) => policy.act(&wrench, terms),
        (None, None) => {}
    }
    if has_residual {
        add(given.is_some_and(|given| given.replaces), terms, command);
    } else if state.residual_observer.is_none() {
        return;
    }
    let Terms { measurement, dynamics, momentum, .. } = terms;
    let sample = MomentumSample { momentum: dynamics.momentum, rate: momentum.rate_estimate };
    let observer = state.residual_observer.get_or_insert_default();
    observer.observe(&OBSERVER, measurement.sampling(), measurement.elapsed, sample);
}

impl Residual<'_> {
    /// Writes it as one vector; NaN if its sizes are those of another robot.
    fn write(&self, command: &Command, to: &mut DVector<f64>) {
        let sizes = (self.thrust_rate.len(), self.joint_velocity.len());
        if sizes != (command.thrust_rate.len(), command.joint_velocity.len()) {
            return to.fill(f64::NAN);
        }
        for (to, from) in to.iter_mut().zip(self.thrust_rate.iter().chain(self.joint_velocity)) {
            *to = *from;
        }
    }
}

/// `u = clip( u* + r, l, u )`.
fn add(replaces: bool, terms: &Terms, command: &mut Command) {
    let Terms { residual, momentum_qp, .. } = terms;
    if !residual.iter().all(|number| number.is_finite()) {
        command.modes.insert(Modes::RESIDUAL_IGNORED);
        return;
    }
    if command.modes.is_held() {
        return;
    }
    let (unknowns, problem) = (&momentum_qp.unknowns, &momentum_qp.problem);
    let (rates, velocities) = residual.as_slice().split_at(command.thrust_rate.len());
    for (to, added, range) in [
        (&mut command.thrust_rate, rates, unknowns.thrust_rate.clone()),
        (&mut command.joint_velocity, velocities, unknowns.joint_velocity.clone()),
    ] {
        for ((to, added), unknown) in to.iter_mut().zip(added).zip(range) {
            let own = if replaces { 0.0 } else { *to };
            *to = (own + added).max(problem.lower[unknown]).min(problem.upper[unknown]);
        }
    }
}

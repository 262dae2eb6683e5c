//! The drives between commanded torques and joints: lag, friction, reflected inertia, elasticity.
//!
//! ```text
//! τ ──► lag ──► motor θ: inertia, friction, damping ──► spring ──► joint s        rigid: θ = s
//! B θ̈ = τ_a − d θ̇ − F(θ̇) − τ_s,      τ_s = K (θ − s) + D (θ̇ − ṡ)
//! F(θ̇) = f θ̇ / v_f,  at most ± f,   f = f_0 + μ |τ_s|
//! ```
//!
//! Everything is implicit in the velocities after the step, so that drives are stable at every step. Equation M153 of
//! `docs/model`.

use flight_core::error::{BuildError, check, place_of};
use flight_core::robot::RobotModel;
use flight_core::schema::{self, NonNegative};
use flight_core::timing::share;
use nalgebra::{DMatrix, DVector};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Velocity `v_f` from which dry friction is whole \[rad/s, m/s\]; below, a motor creeps under a torque that friction holds.
const SLIP: f64 = 1e-3;

/// Greatest number of passes in which motors are found to slip or to stick.
const PASSES: u32 = 8;

/// Friction, inertia, lag and elasticity between a commanded torque and its joint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MotorsConfig {
    /// Dry friction of every drive \[N m\].
    #[schemars(range(min = 0))]
    pub friction: f64,
    /// Dry friction of joints that differ from `friction`, by name \[N m\].
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, NonNegative>")]
    pub friction_of: BTreeMap<String, f64>,
    /// Dry friction in addition, as a share of the torque that reaches the joint, by joint: that of a gear under load.
    #[serde(default)]
    pub load_friction: BTreeMap<String, f64>,
    /// Viscous friction of every drive \[N m s\].
    #[schemars(range(min = 0))]
    pub damping: f64,
    /// Rotor inertia reflected to every joint \[kg m²\].
    #[schemars(range(min = 0))]
    pub inertia: f64,
    /// Lag of the torque behind its command \[s\].
    #[serde(default)]
    #[schemars(range(min = 0))]
    pub time_constant: f64,
    /// Spring between motor and joint, such as cables; without it both move together.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub elasticity: Option<ElasticityConfig>,
}

/// A spring between motor and joint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ElasticityConfig {
    /// `K` \[N m/rad\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub stiffness: f64,
    /// `D` \[N m s\].
    #[schemars(range(min = 0))]
    pub damping: f64,
}

impl MotorsConfig {
    /// Checks that every value is in its range and that `robot` has the joints.
    ///
    /// # Errors
    /// [`BuildError`] naming the key.
    pub fn check(&self, robot: &RobotModel) -> Result<(), BuildError> {
        schema::check(self, "simulator.motors")?;
        for joint in self.friction_of.keys() {
            place_of("simulator.motors.friction_of", joint, robot.joints.iter().map(|joint| &joint.name))?;
        }
        for (joint, share) in &self.load_friction {
            place_of("simulator.motors.load_friction", joint, robot.joints.iter().map(|joint| &joint.name))?;
            let key = format!("simulator.motors.load_friction.{joint}");
            check(&key, *share, |share| (0.0..=1.0).contains(&share), "a share from 0 to 1")?;
        }
        if self.elasticity.is_some() {
            let expected = "more than 0 kg m²: a motor on a spring";
            check("simulator.motors.inertia", self.inertia, |inertia| inertia > 0.0, expected)?;
        }
        Ok(())
    }
}

/// One drive.
#[derive(Debug, Clone)]
struct Drive {
    /// Dry friction without load `f_0` \[N m\].
    dry: f64,
    /// Share of the load `μ`.
    share: f64,
    /// Dry friction with the load of the last step `f` \[N m\].
    friction: f64,
    /// Torque of this step, after faults \[N m\].
    acting: f64,
    /// `θ` \[rad\] and `θ̇` \[rad/s\].
    position: f64,
    velocity: f64,
    /// Sign of the velocity with which it slips; zero if it sticks.
    slip: f64,
    /// Force and inertia of the joint before the drive acts.
    force: f64,
    inertia: f64,
    /// Torque on the joint: `torque − slope ṡ` with the velocity after the step.
    on_joint: (f64, f64),
    /// `θ̇` after the step is `constant + gain ṡ`.
    constant: f64,
    gain: f64,
}

/// The drives of a robot.
#[derive(Debug, Clone)]
pub struct Motors {
    config: MotorsConfig,
    drives: Vec<Drive>,
    /// `τ_a` \[N m\].
    torque: Vec<f64>,
    /// Whether torques were commanded before; the first act at once.
    is_commanded: bool,
}

impl Motors {
    /// The drives of `robot` that starts with these positions and velocities of its joints \[rad, rad/s\]. `config` is
    /// checked.
    #[must_use]
    pub fn new(config: &MotorsConfig, robot: &RobotModel, position: &[f64], velocity: &[f64]) -> Self {
        let dry =
            |joint: usize| *config.friction_of.get(&robot.joints[joint].name).unwrap_or(&config.friction);
        let drive = |joint: usize| Drive {
            dry: dry(joint),
            share: *config.load_friction.get(&robot.joints[joint].name).unwrap_or(&0.0),
            friction: dry(joint),
            acting: 0.0,
            position: position[joint],
            velocity: velocity[joint],
            slip: 0.0,
            force: 0.0,
            inertia: 0.0,
            on_joint: (0.0, 0.0),
            constant: 0.0,
            gain: 1.0,
        };
        let drives: Vec<_> = (0..robot.joints.len()).map(drive).collect();
        Self { config: config.clone(), torque: vec![0.0; drives.len()], drives, is_commanded: false }
    }

    /// `τ_a` after `step` \[s\] in which these torques are commanded \[N m\].
    pub fn lag(&mut self, command: &[f64], step: f64) -> &[f64] {
        let share = if self.is_commanded { share(step / self.config.time_constant) } else { 1.0 };
        for (torque, command) in self.torque.iter_mut().zip(command) {
            *torque += share * (command - *torque);
        }
        self.is_commanded = true;
        &self.torque
    }

    /// Takes in the torques of this step \[N m\].
    pub fn receive(&mut self, torque: &[f64]) {
        for (drive, torque) in self.drives.iter_mut().zip(torque) {
            drive.acting = *torque;
        }
    }

    /// Finds the acceleration of a robot with these drives: `accelerate` solves `M ν̇ = force` for the force and mass
    /// matrix that it is given. Both then contain the drives.
    pub fn accelerate(
        &mut self,
        force: &mut DVector<f64>,
        mass_matrix: &mut DMatrix<f64>,
        acceleration: &mut DVector<f64>,
        (position, velocity): (&[f64], &[f64]),
        step: f64,
        mut accelerate: impl FnMut(&DVector<f64>, &DMatrix<f64>, &mut DVector<f64>),
    ) {
        for (joint, drive) in self.drives.iter_mut().enumerate() {
            let place = 6 + joint;
            (drive.force, drive.inertia) = (force[place], mass_matrix[(place, place)]);
        }
        for _ in 0..PASSES {
            for (joint, drive) in self.drives.iter_mut().enumerate() {
                let place = 6 + joint;
                let (torque, slope) = drive.act(&self.config, position[joint], velocity[joint], step);
                drive.on_joint = (torque, slope);
                force[place] = drive.force + torque - slope * velocity[joint];
                mass_matrix[(place, place)] = drive.inertia + step * slope;
            }
            accelerate(force, mass_matrix, acceleration);
            let mut is_found = true;
            for (joint, drive) in self.drives.iter_mut().enumerate() {
                let after = drive.velocity_after(velocity[joint] + step * acceleration[6 + joint]);
                let slip = if after.abs() > SLIP { after.signum() } else { 0.0 };
                is_found &= drive.friction == 0.0 || slip.total_cmp(&drive.slip).is_eq();
                drive.slip = slip;
            }
            if is_found {
                break;
            }
        }
    }

    /// Takes a step with these velocities of the joints after it \[rad/s\].
    pub fn advance(&mut self, position: &[f64], velocity: &[f64], step: f64) {
        for ((drive, position), velocity) in self.drives.iter_mut().zip(position).zip(velocity) {
            drive.velocity = drive.velocity_after(*velocity);
            let (torque, slope) = drive.on_joint;
            drive.friction = drive.dry + drive.share * (torque - slope * velocity).abs();
            drive.position = match self.config.elasticity {
                Some(_) => drive.position + step * drive.velocity,
                None => *position,
            };
        }
    }
}

impl Drive {
    fn velocity_after(&self, joint_velocity: f64) -> f64 {
        self.constant + self.gain * joint_velocity
    }

    /// Torque on a joint in this position with this velocity: `torque − slope ṡ` with the velocity after the step.
    fn act(&mut self, config: &MotorsConfig, position: f64, velocity: f64, step: f64) -> (f64, f64) {
        let (friction, creep) =
            if self.slip == 0.0 { (0.0, self.friction / SLIP) } else { (self.slip * self.friction, 0.0) };
        let inertia = config.inertia / step;
        let resistance = inertia + config.damping + creep;
        let Some(spring) = &config.elasticity else {
            (self.constant, self.gain) = (0.0, 1.0);
            return (self.acting - friction + inertia * velocity, resistance);
        };
        let stiff = step * spring.stiffness + spring.damping;
        let twist = spring.stiffness * (self.position - position);
        let push = inertia * self.velocity + self.acting - friction;
        self.gain = stiff / (resistance + stiff);
        self.constant = (push - twist) / (resistance + stiff);
        (twist + stiff * self.constant, resistance * self.gain)
    }
}

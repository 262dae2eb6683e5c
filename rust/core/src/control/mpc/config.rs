//! Configuration of the predictive law.

use super::clearance::{Clearance, ClearanceConfig};
use crate::aero::{AeroModel, LinkConventions};
use crate::error::{BuildError, Table, check_values_by_name, place_of};
use crate::robot::RobotModel;
use crate::schema::NonNegative;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

const MPC: Table = Table("controller.mpc");

/// Gain with which joints that the law does not move return to the posture \[1/s\].
pub(super) const POSTURE_GAIN: f64 = 5.0;

/// `λ`: rate at which errors decay after the horizon \[1/s\].
pub(super) const DECAY: f64 = 3.0;

/// Weight of a joint position beyond its limits \[1/rad²\].
pub(super) const JOINT_EXCESS: f64 = 1e3;

/// Greatest number of knots, and of ticks that the horizon lasts.
const KNOTS_MAX: usize = 16;
const TICKS_MAX: f64 = 1000.0;

/// How the prediction contains the air.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Air {
    /// The wrench of the air changes with velocity, attitude and posture.
    #[default]
    Linear,
    /// It stays what it is.
    Constant,
}

/// Weights of the errors along the horizon, per second; those of rates and inputs too.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MpcWeights {
    /// Position of the centre of mass, along x, y and z \[1/m²\].
    #[schemars(inner(range(min = 0)))]
    pub position: [f64; 3],
    /// Its velocity \[s²/m²\].
    #[schemars(inner(range(min = 0)))]
    pub velocity: [f64; 3],
    /// Its acceleration \[s⁴/m²\].
    #[schemars(range(min = 0))]
    pub acceleration: f64,
    /// Attitude, about x, y and z \[1/rad²\].
    #[schemars(inner(range(min = 0)))]
    pub attitude: [f64; 3],
    /// Angular velocity \[s²/rad²\].
    #[schemars(range(min = 0))]
    pub angular_velocity: f64,
    /// Angular acceleration \[s⁴/rad²\].
    #[schemars(range(min = 0))]
    pub angular_acceleration: f64,
    /// Joint positions about the posture of the first tick, by group of the moved joints \[1/rad²\].
    #[schemars(with = "BTreeMap<String, NonNegative>")]
    pub posture: BTreeMap<String, f64>,
    /// Joint velocities \[s²/rad²\].
    #[schemars(range(min = 0))]
    pub joint_velocity: f64,
    /// Commanded joint velocities \[s²/rad²\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub joint_command: f64,
    /// Thrust rates \[s²/N²\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub thrust_rate: f64,
    /// What is left at the end of the horizon, `a + 2 λ v + λ² p` of the centre of mass and its like of the attitude, not
    /// per second; `a + λ v` along an axis whose position has no weight \[s⁴/m², s⁴/rad²\].
    #[schemars(inner(range(min = 0)))]
    pub tail: [f64; 2],
    /// Distances below the least one, in place of the usual weight of 5000 \[1/m²\].
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0))]
    pub clearance: Option<f64>,
}

/// The predictive law, which decides thrust rates and joint velocities in place of the momentum QP.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MpcConfig {
    /// How the prediction contains the air.
    #[serde(default)]
    pub air: Air,
    /// Time between two plans \[s\], in whole ticks.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub period: f64,
    /// Durations of the knots \[s\]: the first is a whole number of ticks, each the last one times a power of two.
    pub knots: Vec<f64>,
    /// Number of knots over which the commanded joint velocities are constant; together all knots.
    pub joint_knots: Vec<usize>,
    /// Groups of joints that the law moves; the others return to the posture.
    pub joint_groups: Vec<String>,
    /// Weight of a thrust beyond its range \[1/N²\].
    #[schemars(range(min = 0))]
    pub thrust_excess: f64,
    /// What the plan keeps apart; without it nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clearance: Option<ClearanceConfig>,
    /// Weights while all engines work.
    pub weights: MpcWeights,
    /// Weights of the descent after the loss of an engine; without them the momentum QP flies the descent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub descent: Option<MpcWeights>,
    /// Whether a nonlinear plan flies the descent; otherwise, and where it finds none, the linear plan does.
    #[serde(default)]
    pub nonlinear_descent: bool,
}

impl MpcConfig {
    /// Checks values and names; `time_step` is that of the ticks \[s\].
    ///
    /// # Errors
    /// [`BuildError`] naming the key.
    pub fn check(&self, robot: &RobotModel, time_step: f64) -> Result<(), BuildError> {
        for (table, weights) in [("weights", Some(&self.weights)), ("descent", self.descent.as_ref())] {
            let posture = weights.map(|weights| &weights.posture);
            let groups = self.joint_groups.iter().map(String::as_str);
            posture.map_or(Ok(()), |of| {
                check_values_by_name(&format!("controller.mpc.{table}.posture"), of, groups)
            })?;
        }
        let is_whole = |value: f64| (value / time_step - (value / time_step).round()).abs() < 1e-6;
        let expected = format!("a whole number of ticks of {time_step} s, controller.time_step");
        MPC.check("period", self.period, |x| x > 0.0 && is_whole(x), &expected)?;
        let count = self.knots.len();
        if count == 0 || count > KNOTS_MAX {
            let expected = format!("1 to {KNOTS_MAX} durations");
            return Err(BuildError::bad_value("length of controller.mpc.knots", count, expected));
        }
        MPC.check("knots", self.knots[0], |x| x > 0.0 && is_whole(x), &expected)?;
        for pair in self.knots.windows(2) {
            let power = libm::log2(pair[1] / pair[0]);
            let is_power = |_| power >= -1e-9 && (power - power.round()).abs() < 1e-9;
            MPC.check("knots", pair[1], is_power, "the knot before it times a power of two")?;
        }
        let (length, longest) = (self.knots.iter().sum::<f64>(), TICKS_MAX * time_step);
        MPC.check("knots", length, |x| x <= longest, &format!("at most {longest} s together"))?;
        MPC.check("period", self.period, |x| x <= length, "at most the length of the horizon")?;
        let joint_knots: usize = self.joint_knots.iter().sum();
        if joint_knots != count || self.joint_knots.contains(&0) {
            let expected = format!("positive numbers that sum to {count}, the number of knots");
            return Err(BuildError::bad_value(
                "controller.mpc.joint_knots",
                format!("{:?}", self.joint_knots),
                expected,
            ));
        }
        if self.nonlinear_descent && self.descent.is_none() {
            let expected = "false without controller.mpc.descent, whose plan flies where it finds none";
            return Err(BuildError::bad_value("controller.mpc.nonlinear_descent", true, expected));
        }
        let joints = self.joints(robot)?.len();
        Clearance::new(self.clearance.as_ref(), robot, joints).map(|_| ())
    }

    /// Refuses a linear prediction of a model without derivatives, or of forces at other points than the links' centres.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check_air(&self, aero: &AeroModel, conventions: LinkConventions) -> Result<(), BuildError> {
        if self.air == Air::Constant {
            return Ok(());
        }
        let refused = |expected| Err(BuildError::bad_value("controller.mpc.air", "linear", expected));
        if !aero.has_derivatives() {
            return refused("constant: only the axisymmetric model has derivatives");
        }
        if conventions != LinkConventions::default() {
            return refused(
                "constant: the prediction has forces at the links' centres, not at the published points",
            );
        }
        Ok(())
    }

    /// Weights of the posture by moved joint, while all engines work and in the descent \[1/rad²\].
    #[must_use]
    pub fn posture_weights(&self, robot: &RobotModel, joints: &[usize]) -> [Vec<f64>; 2] {
        [&self.weights, self.descent.as_ref().unwrap_or(&self.weights)].map(|weights| {
            let of_joint = |joint: &usize| {
                let group = robot.groups.iter().find(|group| group.joints.contains(joint));
                group.and_then(|group| weights.posture.get(&group.name)).copied().unwrap_or(0.0)
            };
            joints.iter().map(of_joint).collect()
        })
    }

    /// Indices of the joints that the law moves, in the robot's order.
    ///
    /// # Errors
    /// [`BuildError::UnknownName`] for a group that the robot does not have.
    pub fn joints(&self, robot: &RobotModel) -> Result<Vec<usize>, BuildError> {
        let mut joints = Vec::new();
        for name in &self.joint_groups {
            let names = robot.groups.iter().map(|group| group.name.as_str());
            let group = place_of("controller.mpc.joint_groups", name, names)?;
            joints.extend(&robot.groups[group].joints);
        }
        joints.sort_unstable();
        joints.dedup();
        Ok(joints)
    }
}

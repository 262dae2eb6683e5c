//! Configuration of the controller, checked against the robot when the controller is built.

use super::detect::FaultDetectionConfig;
use super::estimate::disturbance_observer::DisturbanceObserverConfig;
use super::estimate::estimator::EstimatorConfig;
use super::law::attitude::MomentumGains;
use super::law::bounds::BoundsConfig;
use super::law::contact::ContactConfig;
use super::law::momentum::AeroFeedback;
use super::law::setpoint::SetpointConfig;
use super::law::tasks::MomentumWeights;
use super::law::torque::TorqueConfig;
use super::measure::channels::ChannelsConfig;
use super::mpc::config::MpcConfig;
use crate::aero::{JacobianOffset, LeverArm, LinkConventions, LinkVelocity};
use crate::error::{BuildError, Table, check_values_by_name, place_of};
use crate::jets::{JetDynamics, ShaftConfig};
#[cfg(feature = "clarabel")]
use crate::qp::ClarabelSolver;
use crate::qp::{DualActiveSet, PrimalActiveSet, QpChain, QpSolver};
use crate::robot::{JointKind, RobotModel};
use crate::schema::{self, NonNegative};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

const CONTROLLER: Table = Table("controller");

/// Configuration of the control law: the complete controller except robot, aerodynamic model and mission.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ControllerConfig {
    /// Time between two ticks \[s\].
    #[schemars(range(min = 0.0002, max = 1))]
    pub time_step: f64,
    /// Terms of the controller that contain the estimated aerodynamic forces.
    #[serde(default)]
    pub aero_feedback: AeroFeedback,
    /// Point at which moments of link forces are formed (in `A_a`).
    #[serde(default)]
    pub lever_arm: LeverArm,
    /// Point whose Jacobian maps link forces (in `Λ_a` and the torque law).
    #[serde(default)]
    pub jacobian_offset: JacobianOffset,
    /// Point whose velocity enters the relative wind.
    #[serde(default)]
    pub link_velocity: LinkVelocity,
    /// Aerodynamic link whose rotation turns the axes of all links, as on the robot of the paper's ground experiments;
    /// without it each link has its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub axes_of: Option<String>,
    /// Gains of the momentum and attitude tasks.
    pub momentum: MomentumGains,
    /// Posture gain `K_s` by joint group \[1/s\].
    #[schemars(with = "BTreeMap<String, NonNegative>")]
    pub posture_gain: BTreeMap<String, f64>,
    /// Weights of the momentum QP.
    pub weights: MomentumWeights,
    /// The predictive law; without it the momentum QP decides.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mpc: Option<MpcConfig>,
    /// Bounds of the momentum QP.
    pub bounds: BoundsConfig,
    /// The joint torque controller.
    pub torque: TorqueConfig,
    /// Standing on the ground; without it the controller has no feet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub contact: Option<ContactConfig>,
    /// State estimator; without it the control law uses the measurements.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub estimator: Option<EstimatorConfig>,
    /// Wind observer, which estimates the wind from the force on the robot; without it the control law uses the
    /// measured wind.
    #[serde(default)]
    pub wind_observer: bool,
    /// Observer of the wrench that no model of the controller contains; without it this wrench is taken as zero.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub disturbance_observer: Option<DisturbanceObserverConfig>,
    /// Which measurements are accepted, and what replaces the others.
    #[serde(default)]
    pub channels: ChannelsConfig,
    /// Detectors of faults; without it nothing is looked for.
    #[serde(default)]
    pub fault_detection: FaultDetectionConfig,
    /// How thrusts follow their commanded rates in the controller's model, as `simulator.jets.dynamics` in the plant.
    #[serde(default)]
    pub jet_dynamics: JetDynamics,
    /// Engines of the shaft's speed in place of the robot's: at full speed they give the greatest thrusts of the jets.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shaft: Option<ShaftConfig>,
    /// Whether the controller uses the jets; without them it neither reads thrusts nor commands thrust rates.
    #[serde(default = "default_true")]
    pub use_jets: bool,
    /// How QPs are solved.
    #[serde(default)]
    pub qp: QpConfig,
    /// Set-point generation.
    pub setpoint: SetpointConfig,
}

fn default_true() -> bool {
    true
}

/// Solver that is tried first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Solver {
    /// Active-set methods: no allocation, a few microseconds.
    #[default]
    ActiveSet,
    /// Clarabel: allocates, hundreds of microseconds.
    Clarabel,
}

/// Solution of the QPs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct QpConfig {
    /// Solver of every tick.
    pub solver: Solver,
}

impl QpConfig {
    /// Checks that this build contains the solver.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check(&self) -> Result<(), BuildError> {
        if self.solver == Solver::Clarabel && !cfg!(feature = "clarabel") {
            let expected = "active_set: this build lacks the feature `clarabel`";
            return Err(BuildError::bad_value("controller.qp.solver", "clarabel", expected));
        }
        Ok(())
    }

    /// Returns the solvers for `n` variables and `rows` rows in their order: the primal active-set method, for boxes, then
    /// the dual one, which starts from scratch; or Clarabel.
    #[must_use]
    pub fn chain(&self, n: usize, rows: usize) -> QpChain {
        let methods: Vec<Box<dyn QpSolver>> = match self.solver {
            #[cfg(feature = "clarabel")]
            Solver::Clarabel => vec![Box::new(ClarabelSolver::new(n, rows))],
            _ => vec![Box::new(PrimalActiveSet::new(n)), Box::new(DualActiveSet::new(n, rows))],
        };
        QpChain::new(methods)
    }
}

impl ControllerConfig {
    /// Time from a tick until its torques act \[s\].
    #[must_use]
    pub fn latency(&self) -> f64 {
        self.estimator.as_ref().map_or(0.0, |estimator| estimator.latency.torque)
    }

    /// Checks that the configuration is valid for `robot`.
    ///
    /// # Errors
    /// [`BuildError`] naming the key, its value and what was expected.
    pub fn check(&self, robot: &RobotModel) -> Result<(), BuildError> {
        schema::check(self, "controller")?;
        if let Some(estimator) = self.estimator.as_ref().filter(|_| self.torque.steps > 1) {
            let delays = [estimator.joint_position.delay, estimator.joint_velocity.delay];
            if delays.iter().any(|delay| *delay > 0.0) {
                let expected = "1 where controller.estimator has a delay of the joints: between two ticks they are \
                                measured now";
                return Err(BuildError::bad_value("controller.torque.steps", self.torque.steps, expected));
            }
        }
        self.qp.check()?;
        if self.fault_detection.engines.is_some() && self.disturbance_observer.is_none() {
            let expected = "none without controller.disturbance_observer: the momentum distinguishes an engine from its sensor";
            return Err(BuildError::bad_value("controller.fault_detection.engines", "given", expected));
        }
        if let Some(unmeasured) = &self.fault_detection.unmeasured_engines {
            if self.fault_detection.engines.is_none() {
                let expected = "none without controller.fault_detection.engines, which says what follows";
                let key = "controller.fault_detection.unmeasured_engines";
                return Err(BuildError::bad_value(key, "given", expected));
            }
            unmeasured.check(robot)?;
        }
        if let Some(contact) = &self.contact {
            contact.check(robot)?;
            let force_max = contact.load_transfer.as_ref().and_then(|transfer| transfer.unmodelled_force_max);
            if let Some(force) = force_max.filter(|_| self.disturbance_observer.is_none()) {
                let (key, expected) = (
                    "controller.contact.load_transfer.unmodelled_force_max",
                    "none without controller.disturbance_observer",
                );
                return Err(BuildError::bad_value(key, force, expected));
            }
            if contact.load_transfer.is_some() && !self.use_jets {
                let expected = "true: a robot takes off with its jets (controller.contact.load_transfer)";
                return Err(BuildError::bad_value("controller.use_jets", false, expected));
            }
        }

        check_values_by_name(
            "controller.posture_gain",
            &self.posture_gain,
            robot.groups.iter().map(|group| group.name.as_str()),
        )?;
        for (group, _) in self.torque.friction.iter().flatten() {
            let groups = robot.groups.iter().map(|of| &of.name);
            place_of("controller.torque.friction", group, groups)?;
        }
        check_values_by_name("controller.weights.thrust_rate", &self.weights.thrust_rate, robot.jet_names())?;
        check_values_by_name(
            "controller.bounds.thrust_rate_max",
            &self.bounds.thrust_rate_max,
            robot.jet_names(),
        )?;
        self.weights.symmetric_pairs(robot)?;
        if let Some([jet, _]) = self.weights.symmetric_jets.iter().find(|[one, other]| one == other) {
            let key = "controller.weights.symmetric_jets";
            return Err(BuildError::bad_value(key, format!("a pair of `{jet}` and itself"), "two jets"));
        }
        Ok(())
    }

    /// Checks that the rate bounds do not make thrusts or joints oscillate from tick to tick. At a limit the bound of
    /// the rate is `r ε` per unit of distance, so each tick multiplies the distance by `1 − h r ε`.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check_rate_bounds(&self, robot: &RobotModel) -> Result<(), BuildError> {
        let time_step = self.time_step;
        // The published values are at the limit: 1 − 0.01 · 100 · 2 = −1.
        let stable = |key: &str, rate_max: f64, steepness: f64| {
            let greatest = 2.0 / (rate_max * time_step);
            let expected = format!("at most {greatest}, 2 / (greatest rate · time step of {time_step} s)");
            CONTROLLER.check(key, steepness, |x| x <= greatest * (1.0 + 1e-9), &expected)
        };
        for jet in &robot.jets {
            if let Some(rate_max) = self.bounds.thrust_rate_max.get(&jet.name) {
                stable("bounds.thrust_steepness", *rate_max, self.bounds.thrust_steepness)?;
            }
        }
        let descent = self.fault_detection.engines.as_ref().and_then(|engines| engines.descent);
        for joint in &robot.joints {
            let rate_max = descent.map_or(joint.velocity_max, |descent| descent.velocity_max(joint));
            stable("bounds.joint_steepness", rate_max, self.bounds.joint_steepness)?;
        }
        Ok(())
    }

    /// Returns the robot as this controller uses it: with the configured limits of revolute joints and only the
    /// configured feet, in the configured order.
    #[must_use]
    pub fn restrict(&self, mut robot: RobotModel) -> RobotModel {
        let named = self.contact.iter().flat_map(|contact| &contact.feet);
        robot.feet =
            named.filter_map(|name| robot.feet.iter().find(|foot| foot.name == *name)).cloned().collect();
        let velocity_max = self.bounds.joint_velocity_max_deg.map(f64::to_radians);
        for joint in robot.joints.iter_mut().filter(|joint| joint.kind == JointKind::Revolute) {
            joint.velocity_max = velocity_max.unwrap_or(joint.velocity_max);
            joint.torque_max = self.torque.torque_max.unwrap_or(joint.torque_max);
            joint.torque_rate_max = self.torque.torque_rate_max.unwrap_or(joint.torque_rate_max);
            joint.rotor_inertia = self.torque.rotor_inertia;
        }
        robot
    }

    /// Dry friction of the drive of every joint that the torques compensate \[N m\].
    #[must_use]
    pub fn frictions(&self, robot: &RobotModel) -> Vec<f64> {
        let mut frictions = vec![0.0; robot.joints.len()];
        for (group, friction) in self.torque.friction.iter().flatten() {
            for &joint in robot.groups.iter().filter(|of| of.name == *group).flat_map(|of| &of.joints) {
                frictions[joint] =
                    if robot.joints[joint].kind == JointKind::Revolute { *friction } else { 0.0 };
            }
        }
        frictions
    }

    /// Posture gain `K_s` of every joint \[1/s\]; zero for joints in no group.
    #[must_use]
    pub fn posture_gains(&self, robot: &RobotModel) -> Vec<f64> {
        let mut gains = vec![0.0; robot.joints.len()];
        for group in &robot.groups {
            for &joint in &group.joints {
                gains[joint] = self.posture_gain.get(&group.name).copied().unwrap_or(0.0);
            }
        }
        gains
    }

    /// Points at which the controller's link forces act, and what turns the axes of its links.
    ///
    /// # Errors
    /// [`BuildError`] if the robot has no link `axes_of`.
    pub fn conventions(&self, robot: &RobotModel) -> Result<LinkConventions, BuildError> {
        let links = robot.aero_links.iter().map(|link| &link.name);
        let axes_of = self.axes_of.as_ref().map(|name| place_of("controller.axes_of", name, links));
        Ok(LinkConventions {
            lever_arm: self.lever_arm,
            jacobian_offset: self.jacobian_offset,
            link_velocity: self.link_velocity,
            axes_of: axes_of.transpose()?,
        })
    }
}

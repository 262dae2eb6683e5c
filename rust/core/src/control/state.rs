//! State of a controller that is kept from tick to tick.

use super::acting::Acting;
use super::detect::engines::EngineMonitor;
use super::detect::joints::JointsState;
use super::detect::unmeasured_engines::UnmeasuredState;
use super::detect::{DetectorSizes, DetectorStates};
use super::engine_condition::EngineCondition;
use super::estimate::disturbance_observer::ObserverState;
use super::estimate::estimator::EstimatorState;
use super::estimate::joint_tracker::InnerLoop;
use super::estimate::wind_observer::WindState;
use super::law::contact::ContactState;
use super::law::setpoint::SetpointState;
use super::limits::Descent;
use super::measure::channels::ChannelsState;
use super::measure::measurement::Estimate;
use super::mpc::nonlinear::NonlinearPlan;
use super::mpc::plan::Plan;
use crate::error::{BuildError, check};
use crate::qp::WarmStart;
use nalgebra::{DVector, Matrix3, Vector6};
use std::sync::atomic::{AtomicUsize, Ordering};

/// What a state consists of: sizes, and stages with a part in it. Controllers of the same sizes can continue each other's
/// states.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Sizes {
    pub(super) joints: usize,
    pub(super) jets: usize,
    pub(super) foot_forces: usize,
    /// Unknowns of the momentum QP.
    pub(super) unknowns: usize,
    /// Unknowns of the linear plan, and inputs of the nonlinear one.
    pub(super) plan: Option<[usize; 2]>,
    /// Measurements and inputs that wait.
    pub(super) estimator: Option<[usize; 2]>,
    /// Whether the disturbance and the wind are observed.
    pub(super) observes: [bool; 2],
    pub(super) detectors: DetectorSizes,
}

/// State of a controller, created by [`super::Controller::start`] and changed by every tick.
///
/// A tick reads nothing else that changes: a clone that is restored later continues with the same bits.
#[derive(Debug, Clone, PartialEq)]
pub struct ControllerState {
    pub(super) sizes: Sizes,
    /// Estimate of the robot in the last tick.
    pub(super) estimate: Estimate,
    /// Predictions and acceptance of the measurement's channels.
    pub(super) channels: ChannelsState,
    /// The command that acts, and what it lets expect.
    pub(super) acting: Acting,
    /// State estimator, where there is one.
    pub(super) estimator: Option<EstimatorState>,
    /// The observed wrench, its residual and the last sample, where it is observed.
    pub(super) disturbance: Option<ObserverState>,
    /// Wind estimate, where the wind is estimated.
    pub(super) wind: Option<WindState>,
    /// What detectors keep.
    pub(super) detectors: DetectorStates,
    /// Conditions of the engines.
    pub(super) engines: Vec<EngineCondition>,
    /// Whether, and why, the robot descends instead of following its mission.
    pub(super) descent: Descent,
    /// State of the set-point generator.
    pub(super) setpoint: SetpointState,
    /// Reference posture `s_d`: the joint positions of the first tick \[rad\].
    pub(super) posture: DVector<f64>,
    /// By how much the ground may rise with the next height that is measured \[m\].
    pub(super) ground_rise: f64,
    /// Height of the centre of mass above the base origin in the posture of the first tick, upright \[m\].
    pub(super) stance: f64,
    /// Centroidal inertia in body axes at the first tick \[kg m²\].
    pub(super) inertia_0_b: Matrix3<f64>,
    /// `∫(ṡ − ṡ*)` \[rad\].
    pub(super) velocity_error_integral: DVector<f64>,
    /// Torques of the last command \[N m\].
    pub(super) joint_torque: DVector<f64>,
    /// Whether the rate limiter has a previous torque.
    pub(super) torque_is_known: bool,
    /// Joints between two ticks of the law.
    pub(super) inner_loop: InnerLoop,
    /// Whether the feet carry load, and their desired wrenches.
    pub(super) contact: ContactState,
    /// Observer of the wrench that a residual is given, without that of the disturbance observer; from the first residual on.
    pub(super) residual_observer: Option<ObserverState>,
    /// Plan of the predictive law; empty without one.
    pub(super) plan: Plan,
    /// Warm start of the momentum QP.
    pub(super) momentum_start: WarmStart,
    /// Warm start of the torque QP.
    pub(super) torque_start: WarmStart,
}

impl ControllerState {
    /// Time of the last tick \[s\].
    #[must_use]
    pub fn time(&self) -> f64 {
        self.estimate.robot.time
    }

    /// Estimate of the robot in the last tick, which the law used.
    #[must_use]
    pub fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    /// Wind estimate; `None` if the control law uses the measured wind.
    #[must_use]
    pub fn wind(&self) -> Option<&WindState> {
        self.wind.as_ref()
    }

    /// Conditions of the engines.
    #[must_use]
    pub fn engines(&self) -> &[EngineCondition] {
        &self.engines
    }

    /// The observed wrench and its residual, where it is observed.
    #[must_use]
    pub fn disturbance(&self) -> Option<&ObserverState> {
        self.disturbance.as_ref()
    }

    /// Monitors of the engines, where they are looked at.
    #[must_use]
    pub fn engine_monitors(&self) -> Option<&[EngineMonitor]> {
        self.detectors.engines.as_deref()
    }

    /// What is kept of engines without measured thrusts, where they are looked at.
    #[must_use]
    pub fn unmeasured_engines(&self) -> Option<&UnmeasuredState> {
        self.detectors.unmeasured_engines.as_ref()
    }

    /// What is kept of the joints, where they are looked at.
    #[must_use]
    pub fn joints(&self) -> Option<&JointsState> {
        self.detectors.joints.as_ref()
    }

    /// Whether, and why, the robot descends instead of following its mission.
    #[must_use]
    pub fn descent(&self) -> Descent {
        self.descent
    }

    /// State of the set-point generator.
    #[must_use]
    pub fn setpoint(&self) -> &SetpointState {
        &self.setpoint
    }

    /// Whether the feet carry load, and their desired wrenches.
    #[must_use]
    pub fn contact(&self) -> &ContactState {
        &self.contact
    }

    /// Reference posture `s_d` \[rad\].
    #[must_use]
    pub fn posture(&self) -> &DVector<f64> {
        &self.posture
    }

    /// Height of the centre of mass at touch-down \[m\]; `−∞` where it is not known.
    #[must_use]
    pub fn touch_down(&self) -> f64 {
        self.setpoint.ground
    }

    /// Centroidal inertia in body axes at the first tick \[kg m²\].
    #[must_use]
    pub fn inertia_0_b(&self) -> &Matrix3<f64> {
        &self.inertia_0_b
    }

    /// `∫(ṡ − ṡ*)` \[rad\].
    #[must_use]
    pub fn velocity_error_integral(&self) -> &DVector<f64> {
        &self.velocity_error_integral
    }

    /// The nonlinear plan of a descent, where it is configured.
    #[must_use]
    pub fn descent_plan(&self) -> Option<&NonlinearPlan> {
        self.plan.nonlinear.as_ref()
    }

    /// Wrench that a residual is given \[N, N m\]; zero without a residual.
    #[must_use]
    pub fn residual_wrench(&self) -> Vector6<f64> {
        self.residual_observer.map_or_else(Vector6::zeros, |observer| observer.wrench)
    }

    /// Whether the rate limiter has a previous torque.
    #[must_use]
    pub fn torque_is_known(&self) -> bool {
        self.torque_is_known
    }

    /// Returns this state with another posture, inertia and integral, to reproduce a tick recorded elsewhere.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] for a length that does not match, a number that is not finite, or an inertia
    /// that is not symmetric positive definite.
    pub fn with_posture_control(
        self,
        posture: DVector<f64>,
        inertia_0_b: Matrix3<f64>,
        velocity_error_integral: DVector<f64>,
    ) -> Result<Self, BuildError> {
        let joints = self.posture.len();
        for (item, values) in [("posture", &posture), ("velocity_error_integral", &velocity_error_integral)] {
            if values.len() != joints {
                return Err(BuildError::bad_value(
                    format!("length of controller state {item}"),
                    values.len(),
                    format!("{joints}, one entry per joint"),
                ));
            }
            for value in values {
                check(&format!("controller state {item}"), *value, |_| true, "finite numbers")?;
            }
        }
        let asymmetry = (inertia_0_b - inertia_0_b.transpose()).amax();
        if asymmetry.is_nan() || asymmetry > 1e-9 * inertia_0_b.amax() || inertia_0_b.cholesky().is_none() {
            return Err(BuildError::bad_value(
                "controller state inertia_0_b",
                inertia_0_b,
                "a symmetric positive definite inertia",
            ));
        }
        Ok(Self { posture, inertia_0_b, velocity_error_integral, ..self })
    }
}

/// A tick of the law of one controller, or none; no part of a state's value.
#[derive(Clone, Copy, Default)]
pub struct Origin {
    controller: usize,
    tick: u64,
}

impl PartialEq for Origin {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl std::fmt::Debug for Origin {
    fn fmt(&self, to: &mut std::fmt::Formatter) -> std::fmt::Result {
        to.write_str("Origin")
    }
}

impl Origin {
    /// That of a new controller, before its first tick.
    #[must_use]
    pub fn of_controller() -> Self {
        static CONTROLLERS: AtomicUsize = AtomicUsize::new(1);
        Self { controller: CONTROLLERS.fetch_add(1, Ordering::Relaxed), tick: 0 }
    }

    /// Becomes the next one.
    pub fn advance(&mut self) {
        self.tick += 1;
    }

    /// Whether it is the same.
    #[must_use]
    pub fn is(self, other: Self) -> bool {
        (self.controller, self.tick) == (other.controller, other.tick)
    }
}

//! Wind estimate from the wrench that acts on the robot, by inverting an aerodynamic model.
//!
//! ```text
//! dẑ/dt = K_o (L̇ − A_T T − A_c f_c + m g e₃ − ẑ)         wrench without jets, feet and weight
//! ẑ_f = Σ f_j(v_w) + noise + e,  dv_w = random walk       an extended Kalman filter, e constant
//! ```
//!
//! The lasting errors `e` do not average out. They are not estimated, but the uncertainty of the estimate includes
//! their effect on it (Schmidt's filter). The magnitude of the model's errors follows from the part of the moment that
//! the estimated wind does not explain.
//!
//! The observer reads the results of a tick, and the next tick uses its wind. On an upright robot a vertical wind
//! causes little force; the vertical component is therefore held near zero by the prior of vertical winds.
//!
//! Equations M94 and M110 of `docs/model`.

use super::disturbance_observer::{DisturbanceObserverConfig, MomentumSample, ObserverState};
use crate::aero::{AeroModel, LinkConventions, LinkForces};
use crate::control::law::contact::add_wrenches;
use crate::control::measure::measurement::Estimate;
use crate::error::BuildError;
use crate::kinematics::Kinematics;
use crate::robot::RobotModel;
use crate::spatial::{Pose, parts};
use crate::timing::share;
use nalgebra::{Matrix3, Matrix6xX, Vector3, Vector6};

/// Step of the differences for the Jacobian \[m/s\]: large compared with the rounding of a network, small compared with
/// relevant winds.
const DIFFERENCE: f64 = 0.1;

/// Time over which the unexplained moment is averaged \[s\].
const MEMORY: f64 = 2.0;

/// Greatest magnitude of the observed wrench \[N, N m\].
const GREATEST: f64 = 1e4;

/// Gain `K_o` with which the acting force is observed \[1/s\]: over 0.1 s the noise of ten ticks averages out.
pub const GAIN: f64 = 10.0;

/// Rate of change of a horizontal wind: standard deviation after one second \[m/s\].
pub const WALK: f64 = 0.6;

/// Standard deviation of vertical winds \[m/s\]: the force says little of them.
pub const VERTICAL_STD: f64 = 1.0;

/// Correlation time of vertical winds \[s\].
pub const VERTICAL_TIME: f64 = 2.0;

/// Standard deviation of the noise of the observed force, by axis \[N\]: thrusts, whose noise it contains, are mostly
/// vertical.
pub const FORCE_NOISE: Vector3<f64> = Vector3::new(0.3, 0.3, 4.0);

/// Standard deviation of lasting errors of the force: of mass, thrusts and attitude \[N\].
pub const FORCE_STD: f64 = 0.1;

/// Standard deviation of lasting errors of the aerodynamic model, as a fraction of the observed force.
pub const RELATIVE_STD: f64 = 0.045;

/// Lever arm that converts an unexplained moment to an unexplained force of the model \[m\].
pub const MOMENT_ARM: f64 = 0.25;

/// Observer of the wind, with its workspace; its state is a [`WindState`].
#[derive(Debug, Clone)]
pub struct WindObserver {
    robot: RobotModel,
    aero: AeroModel,
    link_forces: LinkForces,
}

/// State of the wind estimate, kept from tick to tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WindState {
    wrench: ObserverState,
    wind: Vector3<f64>,
    /// Covariance of the estimate, without lasting errors.
    covariance: Matrix3<f64>,
    /// Sensitivity of the estimate to a lasting force \[m/s/N\].
    sensitivity: Matrix3<f64>,
    /// Variance of the lasting errors \[N²\].
    lasting: f64,
    /// Mean square of the unexplained moment \[N² m²\].
    unexplained: f64,
}

impl WindObserver {
    /// Builds an observer with models of the robot and of its aerodynamics.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] for an aerodynamic model without forces.
    pub fn new(robot: RobotModel, aero: AeroModel) -> Result<Self, BuildError> {
        if aero.is_off() {
            let expected = "a model of the air: without one no force says anything of the wind";
            return Err(BuildError::bad_value("controller.aero.model", "off", expected));
        }
        Ok(Self { link_forces: LinkForces::new(&robot), robot, aero })
    }

    /// State before the first tick: zero wind, with the covariance of one second of the random walk and of the vertical
    /// winds.
    #[must_use]
    pub fn start(&self) -> WindState {
        let std = Vector3::new(WALK, WALK, VERTICAL_STD);
        WindState {
            wrench: ObserverState::default(),
            wind: Vector3::zeros(),
            covariance: Matrix3::from_diagonal(&std.component_mul(&std)),
            sensitivity: Matrix3::zeros(),
            lasting: 0.0,
            unexplained: 0.0,
        }
    }

    /// Updates the wind with the results of a tick: the estimate of the robot, its kinematics, the centroidal `momentum`
    /// \[kg m/s, kg m²/s\], `A_T` and the soles. There is no correction in a tick whose momentum is not measured.
    pub fn update(
        &mut self,
        state: &mut WindState,
        estimate: &Estimate,
        kinematics: &Kinematics,
        momentum: &Vector6<f64>,
        a_t: &Matrix6xX<f64>,
        soles: &[Pose],
    ) {
        state.drift(estimate.elapsed);
        let mut rate = Vector6::zeros();
        for (column, thrust) in a_t.column_iter().zip(&estimate.robot.thrust) {
            rate += column * *thrust;
        }
        rate[2] -= kinematics.mass() * self.robot.gravity;
        add_wrenches(soles, &estimate.robot.foot_wrenches, &kinematics.com, &mut rate);
        let gains = DisturbanceObserverConfig {
            gain_force: GAIN,
            gain_moment: GAIN,
            force_max: GREATEST,
            moment_max: GREATEST,
        };
        let sample = MomentumSample { momentum: *momentum, rate };
        if let Some(step) = state.wrench.observe(&gains, estimate.momentum, estimate.elapsed, sample) {
            self.correct(state, kinematics, step);
        }
    }

    /// Corrects the estimate by the observed wrench, `step` \[s\] after the last correction.
    fn correct(&mut self, state: &mut WindState, kinematics: &Kinematics, step: f64) {
        let observed = parts(state.wrench.wrench());
        let modelled = self.wrench_in(kinematics, &state.wind);
        let mut jacobian = Matrix3::zeros();
        for axis in 0..3 {
            let mut shifted = state.wind;
            shifted[axis] += DIFFERENCE;
            jacobian.set_column(axis, &((self.wrench_in(kinematics, &shifted).0 - modelled.0) / DIFFERENCE));
        }
        let unexplained = state.unexplained
            + share(step / MEMORY) * ((observed.1 - modelled.1).norm_squared() - state.unexplained);
        let lasting = FORCE_STD * FORCE_STD
            + RELATIVE_STD * RELATIVE_STD * observed.0.norm_squared()
            + unexplained / (MOMENT_ARM * MOMENT_ARM);
        // The ticks of one time constant of the observer count as one measurement.
        let together = (1.0 / (GAIN * step)).max(1.0);
        let error = FORCE_NOISE.map(|std| together * std * std);
        let innovation = jacobian * state.covariance * jacobian.transpose() + Matrix3::from_diagonal(&error);
        let Some(inverse) = innovation.try_inverse() else {
            return;
        };
        let gain = state.covariance * jacobian.transpose() * inverse;
        let wind = state.wind + gain * (observed.0 - modelled.0);
        let kept = Matrix3::identity() - gain * jacobian;
        // Joseph's form remains symmetric and positive semidefinite under rounding.
        let covariance = kept * state.covariance * kept.transpose()
            + gain * Matrix3::from_diagonal(&error) * gain.transpose();
        let sensitivity = kept * state.sensitivity + gain;
        let numbers = wind.iter().chain(covariance.iter()).chain(sensitivity.iter());
        if numbers.chain([&lasting, &unexplained]).all(|x| x.is_finite()) {
            (state.wind, state.covariance, state.sensitivity) = (wind, covariance, sensitivity);
            (state.lasting, state.unexplained) = (lasting, unexplained);
        }
    }

    /// Aerodynamic force and moment about the centre of mass in a wind.
    fn wrench_in(&mut self, kinematics: &Kinematics, wind_i: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let Self { robot, aero, link_forces, .. } = self;
        link_forces.update(robot, kinematics, LinkConventions::default(), aero, wind_i);
        link_forces.wrench_about(&kinematics.com)
    }
}

impl WindState {
    /// Prediction: random walk of the horizontal wind, decay of the vertical wind.
    fn drift(&mut self, step: f64) {
        let kept = libm::exp(-step / VERTICAL_TIME);
        self.wind.z *= kept;
        let keep = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, kept));
        let walk = WALK * WALK * step;
        let noise = Vector3::new(walk, walk, VERTICAL_STD * VERTICAL_STD * (1.0 - kept * kept));
        self.covariance = keep * self.covariance * keep + Matrix3::from_diagonal(&noise);
        self.sensitivity = keep * self.sensitivity;
    }

    /// Estimated wind \[m/s, inertial axes\].
    #[must_use]
    pub fn wind(&self) -> Vector3<f64> {
        self.wind
    }

    /// Standard deviation of the estimate along each axis \[m/s\].
    #[must_use]
    pub fn std(&self) -> Vector3<f64> {
        let considered = self.covariance + self.lasting * self.sensitivity * self.sensitivity.transpose();
        considered.diagonal().map(f64::sqrt)
    }
}

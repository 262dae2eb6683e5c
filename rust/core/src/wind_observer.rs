//! Wind estimate from the wrench that acts on the robot, by inverting an aerodynamic model.
//!
//! ```text
//! dẑ/dt = K_o (L̇ − A_T T − A_c f_c + m g e₃ − ẑ)         the wrench of everything but jets, feet and weight
//! ẑ_f = Σ f_j(v_w) + noise + e,  dv_w = random walk       an extended Kalman filter, e constant
//! ```
//!
//! Errors `e` that last do not average out: they are no unknowns of the filter, but considered in what it says of its
//! uncertainty, as far as the estimate depends on them (Schmidt's filter). How large those of the model are is seen in
//! the moment, which no wind of the estimate explains.
//!
//! It reads what a tick computed, and the next tick is given its wind. A robot that
//! stands upright gets little force from a vertical wind, which is therefore held near zero by what is known of winds.
//!
//! Equations M94 and M110 of `docs/model.md`.

use crate::aero::{AeroModel, LinkConventions, LinkForces};
use crate::control::Terms;
use crate::control::observer::{ObserverConfig, ObserverState, Sample};
use crate::error::{BuildError, Table};
use crate::robot::RobotModel;
use crate::spatial::parts;
use nalgebra::{Matrix3, Vector3, Vector6};
use serde::{Deserialize, Serialize};

/// Step of the differences that make the Jacobian \[m/s\]: large against the rounding of a network, small against winds
/// that matter.
const DIFFERENCE: f64 = 0.1;

/// Time over which the unexplained moment is averaged \[s\].
const MEMORY: f64 = 2.0;

/// Greatest wrench that is estimated from \[N, N m\].
const GREATEST: f64 = 1e4;

/// How the wind is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct WindObserverConfig {
    /// How fast the acting force is observed, `K_o` \[1/s\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub gain: f64,
    /// How fast a horizontal wind changes: standard deviation after one second \[m/s\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub walk: f64,
    /// Standard deviation of vertical winds \[m/s\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub vertical_std: f64,
    /// Time over which vertical winds are like themselves \[s\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub vertical_time: f64,
    /// Standard deviation of the noise of the observed force, by axis \[N\].
    #[cfg_attr(feature = "schema", schemars(extend("items" = { "type": "number", "format": "double", "exclusiveMinimum": 0 })))]
    pub force_noise: [f64; 3],
    /// Standard deviation of errors of the force that last: of mass, thrusts and attitude \[N\].
    #[cfg_attr(feature = "schema", schemars(range(min = 0)))]
    pub force_std: f64,
    /// The same of the model's force, as a fraction of the observed one.
    #[cfg_attr(feature = "schema", schemars(range(min = 0)))]
    pub relative_std: f64,
    /// Lever arm of the model's errors: over it the moment that the model does not explain is a force that it does not
    /// explain either \[m\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub moment_arm: f64,
}

impl Default for WindObserverConfig {
    fn default() -> Self {
        Self {
            gain: 10.0,
            walk: 0.6,
            vertical_std: 1.0,
            vertical_time: 2.0,
            force_noise: [0.3, 0.3, 4.0],
            force_std: 0.1,
            relative_std: 0.045,
            moment_arm: 0.25,
        }
    }
}

impl WindObserverConfig {
    /// Refuses numbers that mean nothing.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check(&self, time_step: f64) -> Result<(), BuildError> {
        let table = Table("controller.wind_observer");
        table.positive("gain", self.gain)?;
        table.gain("gain", self.gain, time_step)?;
        table.positive("walk", self.walk)?;
        table.positive("vertical_std", self.vertical_std)?;
        table.positive("vertical_time", self.vertical_time)?;
        table.positive("moment_arm", self.moment_arm)?;
        self.force_noise.into_iter().try_for_each(|std| table.positive("force_noise", std))?;
        table.non_negative("force_std", self.force_std)?;
        table.non_negative("relative_std", self.relative_std)
    }
}

/// Estimates the wind, in the space it works in; its state is a [`WindState`].
#[derive(Debug, Clone)]
pub struct WindObserver {
    config: WindObserverConfig,
    robot: RobotModel,
    aero: AeroModel,
    link_forces: LinkForces,
}

/// The estimate from one tick to the next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WindState {
    wrench: ObserverState,
    wind: Vector3<f64>,
    /// Of the estimate, without errors that last.
    covariance: Matrix3<f64>,
    /// What a newton of force that lasts does to the estimate \[m/s/N\].
    sensitivity: Matrix3<f64>,
    /// Variance of the errors that last \[N²\].
    lasting: f64,
    /// Mean square of the moment that the model does not explain \[N² m²\].
    unexplained: f64,
}

impl WindObserver {
    /// An estimator with a model of the robot and of the air, updated about every `time_step` \[s\].
    ///
    /// # Errors
    /// As [`WindObserverConfig::check`]; also for a model of the air without forces.
    pub fn new(
        config: &WindObserverConfig,
        robot: RobotModel,
        aero: AeroModel,
        time_step: f64,
    ) -> Result<Self, BuildError> {
        config.check(time_step)?;
        if aero.is_off() {
            let expected = "a model of the air: without one no force says anything of the wind";
            return Err(BuildError::bad_value("controller.aero.model", "off", expected));
        }
        Ok(Self { config: *config, link_forces: LinkForces::new(&robot), robot, aero })
    }

    /// The state before the first tick: no wind, give or take what a second of the random walk and the vertical winds
    /// make of it.
    #[must_use]
    pub fn start(&self) -> WindState {
        let Self { config, .. } = self;
        let std = Vector3::new(config.walk, config.walk, config.vertical_std);
        WindState {
            wrench: ObserverState::default(),
            wind: Vector3::zeros(),
            covariance: Matrix3::from_diagonal(&std.component_mul(&std)),
            sensitivity: Matrix3::zeros(),
            lasting: 0.0,
            unexplained: 0.0,
        }
    }

    /// Takes in what a tick of the controller computed. Where the momentum was not measured nothing is corrected.
    pub fn update(&mut self, state: &mut WindState, terms: &Terms) {
        let step = terms.seen.elapsed;
        self.predict(state, step);
        if !terms.seen.has_momentum {
            state.hold();
            return;
        }
        let mut rate = Vector6::zeros();
        for (column, thrust) in terms.momentum.a_t.column_iter().zip(&terms.seen.thrust) {
            rate += column * *thrust;
        }
        rate[2] -= terms.kinematics.mass() * self.robot.gravity;
        terms.contact.add_measured(&terms.seen.foot_wrenches, &terms.kinematics.com, &mut rate);
        let gain = self.config.gain;
        let gains =
            ObserverConfig { gain_force: gain, gain_moment: gain, force_max: GREATEST, moment_max: GREATEST };
        let sample = Sample { momentum: terms.dynamics.momentum, rate };
        let observed = state.wrench.update(&gains, step, sample);
        self.correct(state, terms, &observed, step);
    }

    /// Horizontal winds wander, vertical ones return.
    fn predict(&self, state: &mut WindState, step: f64) {
        let config = &self.config;
        let kept = libm::exp(-step / config.vertical_time);
        state.wind.z *= kept;
        let keep = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, kept));
        let walk = config.walk * config.walk * step;
        let noise = Vector3::new(walk, walk, config.vertical_std * config.vertical_std * (1.0 - kept * kept));
        state.covariance = keep * state.covariance * keep + Matrix3::from_diagonal(&noise);
        state.sensitivity = keep * state.sensitivity;
    }

    fn correct(&mut self, state: &mut WindState, terms: &Terms, observed: &Vector6<f64>, step: f64) {
        let observed = parts(observed);
        let modelled = self.wrench_in(terms, &state.wind);
        let mut jacobian = Matrix3::zeros();
        for axis in 0..3 {
            let mut shifted = state.wind;
            shifted[axis] += DIFFERENCE;
            jacobian.set_column(axis, &((self.wrench_in(terms, &shifted).0 - modelled.0) / DIFFERENCE));
        }
        let config = &self.config;
        let share = -libm::expm1(-step / MEMORY);
        let unexplained =
            state.unexplained + share * ((observed.1 - modelled.1).norm_squared() - state.unexplained);
        let lasting = config.force_std * config.force_std
            + config.relative_std * config.relative_std * observed.0.norm_squared()
            + unexplained / (config.moment_arm * config.moment_arm);
        // So many measurements as a time constant of the observer are one.
        let together = (1.0 / (config.gain * step)).max(1.0);
        let error = Vector3::from(config.force_noise).map(|std| together * std * std);
        let innovation = jacobian * state.covariance * jacobian.transpose() + Matrix3::from_diagonal(&error);
        let Some(inverse) = innovation.try_inverse() else {
            return;
        };
        let gain = state.covariance * jacobian.transpose() * inverse;
        let wind = state.wind + gain * (observed.0 - modelled.0);
        let kept = Matrix3::identity() - gain * jacobian;
        // Joseph's form: symmetric and positive whatever rounding does.
        let covariance = kept * state.covariance * kept.transpose()
            + gain * Matrix3::from_diagonal(&error) * gain.transpose();
        let sensitivity = kept * state.sensitivity + gain;
        let numbers = wind.iter().chain(covariance.iter()).chain(sensitivity.iter());
        if numbers.chain([&lasting, &unexplained]).all(|x| x.is_finite()) {
            (state.wind, state.covariance, state.sensitivity) = (wind, covariance, sensitivity);
            (state.lasting, state.unexplained) = (lasting, unexplained);
        }
    }

    /// Force and moment about the centre of mass of the air in a wind.
    fn wrench_in(&mut self, terms: &Terms, wind_i: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let Self { robot, aero, link_forces, .. } = self;
        link_forces.update(robot, &terms.kinematics, LinkConventions::default(), aero, wind_i);
        link_forces.wrench_about(&terms.kinematics.com)
    }
}

impl WindState {
    /// A tick whose momentum is not measured: there is nothing to compare the next one with.
    pub(crate) fn hold(&mut self) {
        self.wrench.hold();
    }

    /// The wind \[m/s, inertial axes\].
    #[must_use]
    pub fn wind(&self) -> Vector3<f64> {
        self.wind
    }

    /// Its standard deviation along each axis \[m/s\].
    #[must_use]
    pub fn std(&self) -> Vector3<f64> {
        let considered = self.covariance + self.lasting * self.sensitivity * self.sensitivity.transpose();
        considered.diagonal().map(f64::sqrt)
    }
}

//! Observer of the wrench that the controller's model does not contain, from the centroidal momentum alone.
//!
//! ```text
//! w    = L̇ − r,   r = A_T T + A_a f_a + A_c f_c − m g e₃           the unmodelled wrench
//! dŵ/dt = K_o (w − ŵ)                                               the observed wrench
//! ŵ   += (1 − exp(−K_o Δt)) ((L_k − L_{k−1})/Δt − r_{k−1} − ŵ)      per measurement, then clamped
//! ```
//!
//! Between measurements that are several ticks apart the modelled rate is its mean. `f_c` is the wrench that the feet measure, whether they carry load or not, so the ground is part of the model and
//! the law is the same in flight and standing. `Δt` is the time between the two measurements. Inertial axes, about the
//! centre of mass, force first. Equations M82 to M84 and M106 of `docs/model`.

use crate::control::measure::measurement::Sampling;
use crate::error::{BuildError, Table};
use crate::timing::share;
use nalgebra::Vector6;
use serde::{Deserialize, Serialize};

/// Time constant of the residual \[s\].
const RESIDUAL_TIME: f64 = 0.02;

/// Gains of the observer, and the greatest wrench that it estimates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DisturbanceObserverConfig {
    /// `K_o` of the force \[1/s\].
    #[schemars(range(min = 0))]
    pub gain_force: f64,
    /// `K_o` of the moment \[1/s\].
    #[schemars(range(min = 0))]
    pub gain_moment: f64,
    /// Greatest observed force along each axis \[N\].
    #[schemars(range(min = 0))]
    pub force_max: f64,
    /// Greatest observed moment about each axis \[N m\].
    #[schemars(range(min = 0))]
    pub moment_max: f64,
}

impl DisturbanceObserverConfig {
    /// Checks that a gain is at most 1 / time step.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check(&self, time_step: f64) -> Result<(), BuildError> {
        let table = Table("controller.disturbance_observer");
        let greatest = 1.0 / time_step;
        let expected = format!("a number from 0 to {greatest}, 1 / time step of {time_step} s");
        let is_slow = |gain| (0.0..=greatest * (1.0 + 1e-9)).contains(&gain);
        table.check("gain_force", self.gain_force, is_slow, &expected)?;
        table.check("gain_moment", self.gain_moment, is_slow, &expected)
    }
}

/// Measured momentum and its modelled rate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MomentumSample {
    /// Centroidal momentum `L` \[kg m/s, kg m²/s\].
    pub momentum: Vector6<f64>,
    /// Modelled momentum rate `r` \[N, N m\].
    pub rate: Vector6<f64>,
}

/// State of the observer, kept from tick to tick; initially the observed wrench is zero.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ObserverState {
    /// `ŵ` \[N, N m\].
    pub(in crate::control) wrench: Vector6<f64>,
    /// Residual: unmodelled wrench of the last hundredths of a second that `ŵ` does not yet contain, `n` of M106 \[N, N
    /// m\].
    pub residual: Vector6<f64>,
    /// Time that the measured momentum of the last tick covers, since the one before \[s\]; `None` where none was measured.
    pub covered: Option<f64>,
    /// The last measured momentum, and the modelled rate of the last tick.
    last: Option<MomentumSample>,
    /// Time \[s\] and modelled impulse \[N s, N m s\] from that momentum to the last tick.
    pending: (f64, Vector6<f64>),
}

impl ObserverState {
    /// `ŵ` \[N, N m\].
    #[must_use]
    pub fn wrench(&self) -> &Vector6<f64> {
        &self.wrench
    }

    /// Takes in a tick, `elapsed` \[s\] after the last one. `ŵ` changes where the momentum is measured and numbers do not
    /// overflow; between two measurements the modelled rate is summed, and after a gap the observer starts anew.
    ///
    /// Returns the time that a measured tick covers \[s\]: that since the last sample, or since the last tick.
    pub fn observe(
        &mut self,
        config: &DisturbanceObserverConfig,
        sampling: Sampling,
        elapsed: f64,
        sample: MomentumSample,
    ) -> Option<f64> {
        if matches!(sampling, Sampling::First | Sampling::Unknown) {
            (self.last, self.pending) = (None, <_>::default());
            self.residual.fill(0.0);
        }
        self.covered = match sampling {
            Sampling::Measured | Sampling::First => Some(self.update(config, elapsed, sample)),
            Sampling::Between => {
                self.wait(elapsed, sample.rate);
                None
            }
            Sampling::Unknown => None,
        };
        self.covered
    }

    /// Moves `ŵ` by a sample, and returns the time that it covers \[s\].
    fn update(&mut self, config: &DisturbanceObserverConfig, elapsed: f64, sample: MomentumSample) -> f64 {
        let (waited, impulse) = std::mem::take(&mut self.pending);
        let Some(last) = self.last.replace(sample) else { return elapsed };
        let rate =
            if waited > 0.0 { (impulse + elapsed * last.rate) / (waited + elapsed) } else { last.rate };
        let elapsed = waited + elapsed;
        let (force, moment) = (share(config.gain_force * elapsed), share(config.gain_moment * elapsed));
        let shares = Vector6::new(force, force, force, moment, moment, moment);
        let innovation = (sample.momentum - last.momentum) / elapsed - rate - self.wrench;
        let moved = self.wrench + shares.component_mul(&innovation);
        if moved.iter().all(|x| x.is_finite()) {
            let (force, moment) = (config.force_max, config.moment_max);
            let limits = Vector6::new(force, force, force, moment, moment, moment);
            self.residual += (innovation - self.residual) * residual_share(elapsed);
            self.wrench = moved.zip_map(&limits, |x, limit| x.clamp(-limit, limit));
        }
        elapsed
    }

    /// Sums the modelled momentum rate of a tick between two measurements.
    fn wait(&mut self, elapsed: f64, rate: Vector6<f64>) {
        if let Some(last) = &mut self.last {
            self.pending.0 += elapsed;
            self.pending.1 += elapsed * last.rate;
            last.rate = rate;
        }
    }
}

/// Fraction of an innovation that the residual receives after `elapsed` \[s\].
pub(in crate::control) fn residual_share(elapsed: f64) -> f64 {
    share(elapsed / RESIDUAL_TIME)
}

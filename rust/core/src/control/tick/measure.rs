//! From a measurement to the estimate of the robot: channels, then the estimator.

use super::Controller;
use crate::control::estimate::wind_observer::WindState;
use crate::control::measure::measurement::Measurement;
use crate::control::modes::Modes;
use crate::control::state::ControllerState;
use nalgebra::Vector3;

/// Greatest rate at which the estimated ground rises \[m/s\]; it sinks at once. A robot brakes too late over a ground that is
/// nearer than it seems, but above one that is farther it stops, and falls.
const RISE: f64 = 0.5;

impl Controller {
    /// Updates the estimate of the robot by a measurement; returns whether the measurement has the sizes of this robot.
    pub(super) fn measure(&mut self, measurement: &Measurement, state: &mut ControllerState) -> bool {
        let Self { channels, estimator, detectors, .. } = self;
        let ControllerState { estimate, channels: memory, acting, wind, descent, .. } = state;
        let is_usable = channels.fit(measurement);
        if is_usable {
            estimate.wind_std = wind.as_ref().map_or_else(Vector3::zeros, WindState::std);
        }
        let wind = wind.as_ref().map_or(measurement.wind, WindState::wind);
        channels.update(memory, measurement, wind, acting, descent, estimate);
        detectors.measure(&mut state.detectors, estimate);
        if let Some((estimator, of_estimator)) = estimator.as_mut().zip(state.estimator.as_mut()) {
            if estimate.pause > 0.0 || estimate.modes.contains(Modes::BEGUN_AGAIN) {
                of_estimator.restart();
            }
            channels.select_accepted(memory, estimate, of_estimator.next_measurement());
            let (innovation, rate) = (&mut estimate.thrust_innovation, &mut estimate.thrust_rate);
            let found = estimator.update(of_estimator, estimate.elapsed, innovation, rate);
            if channels.accept_estimate(found) {
                estimate.robot.state.copy_from(&found.state);
                estimate.robot.thrust.copy_from_slice(&found.thrust);
            }
        }
        is_usable
    }

    /// Takes the ground from a height that is measured anew; after a beginning again, by its stance (M183).
    pub(super) fn find_ground(&self, state: &mut ControllerState) {
        let ControllerState { channels, estimate, setpoint, stance, ground_rise, .. } = state;
        *ground_rise += RISE * estimate.elapsed;
        if let Some(height) = self.channels.new_height(channels, estimate) {
            let found = estimate.robot.state.base.position.z - height + *stance;
            let is_known = setpoint.ground.is_finite();
            setpoint.ground = if is_known { found.min(setpoint.ground + *ground_rise) } else { found };
            *ground_rise = 0.0;
        }
    }
}

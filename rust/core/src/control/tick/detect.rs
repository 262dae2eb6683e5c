//! What measurement and model together tell: whether the feet carry load (M114), the unmodelled wrench, and faults.

use super::Controller;
use crate::control::detect::detector::Evidence;
use crate::control::engine_condition::modes_of;
use crate::control::estimate::disturbance_observer::{MomentumSample, ObserverState};
use crate::control::law::contact::add_wrenches;
use crate::control::measure::channels::Channels;
use crate::control::measure::measurement::Sampling;
use crate::control::modes::Modes;
use crate::control::state::ControllerState;
use crate::control::terms::Terms;

impl Controller {
    /// Compares the model of this tick with its measurement.
    pub(super) fn detect(&mut self, state: &mut ControllerState) {
        self.terms.limits.copy_from(&self.usual);
        if self.has_feet {
            self.place_feet(state);
        }
        let Terms { due, kinematics, dynamics, inverse_mass, momentum, limits, findings, .. } =
            &mut self.terms;
        let ControllerState { estimate, disturbance, engines, channels, estimator, .. } = state;
        if let Some((config, observer)) = self.observer.as_ref().zip(disturbance.as_mut()) {
            let sample = MomentumSample { momentum: dynamics.momentum, rate: momentum.measured_rate };
            observer.observe(config, estimate.momentum, estimate.elapsed, sample);
            momentum.add_unmodelled(observer.wrench);
        }
        let evidence = Evidence {
            estimate,
            acting: &state.acting,
            kinematics,
            dynamics,
            inverse_mass,
            momentum,
            disturbance: disturbance.as_ref(),
            setpoint: due,
            covered: disturbance.and_then(|of| of.covered),
            engines: &*engines,
            is_standing: state.contact.is_active,
        };
        self.detectors.detect(&mut state.detectors, &evidence, limits, findings);
        let covered = evidence.covered.unwrap_or(0.0);
        let found = engines.iter_mut().zip(&findings.engines);
        for (jet, ((engine, finding), thrust)) in found.zip(&estimate.robot.thrust).enumerate() {
            let error = engine.advance(*finding, *thrust, covered);
            Channels::use_sensor(channels, jet, engine.is_sensor_used);
            let Some(error) = error else { continue };
            Channels::correct_thrust(channels, jet, error);
            if let Some(memory) = estimator {
                memory.correct_thrust(jet, error);
            }
        }
        state.descent.is_without_engine = self.engines.limit(engines, state.contact.is_active, limits);
        limits.slow_joints();
        estimate.modes.insert(findings.modes);
        estimate.modes.insert(modes_of(engines));
        if let Some((observer, wrench)) = disturbance.as_mut().zip(findings.unmodelled) {
            observer.wrench = wrench;
        }
        if let Some((memory, latency)) = estimator.as_mut().zip(findings.torque_latency) {
            memory.use_torque_latency(latency);
        }
    }

    /// Decides whether the feet carry load, and adds them to the momentum.
    fn place_feet(&mut self, state: &mut ControllerState) {
        let Self { model, channels, time_step, terms, .. } = self;
        let Terms { setpoint, kinematics, dynamics, momentum, contact, .. } = terms;
        let ControllerState { estimate, disturbance, acting, contact: feet, .. } = state;
        let climb = setpoint.com_position.z - kinematics.com.z;
        // During a descent the robot must not take off.
        let climb = if state.descent.is_active() { climb.min(0.0) } else { climb };
        let are_measured = !estimate.modes.contains(Modes::FEET_PREDICTED);
        let unmodelled = disturbance.map_or(0.0, |of| of.wrench[2] + of.residual[2]);
        let carry_unknown = contact.carry_unknown(feet, are_measured, climb, unmodelled, estimate.elapsed);
        if carry_unknown {
            // The observed wrench is the load of the feet.
            *disturbance = disturbance.map(|_| ObserverState::default());
            if are_measured {
                channels.reject_feet(&mut state.channels, acting, estimate);
            }
        }
        contact.update(
            feet,
            model,
            kinematics,
            dynamics,
            &estimate.robot.foot_wrenches,
            climb,
            -momentum.rate_estimate[2],
            carry_unknown,
            *time_step,
        );
        contact.force_of_torques.copy_from(&feet.force);
        // Predicted wrenches of loaded feet are not a measurement of the acting forces.
        if feet.is_active && estimate.modes.contains(Modes::FEET_PREDICTED) {
            estimate.momentum = Sampling::Unknown;
        }
        let (wrenches, com) = (&estimate.robot.foot_wrenches, &kinematics.com);
        add_wrenches(&contact.soles, wrenches, com, &mut momentum.measured_rate);
        if feet.is_active {
            momentum.add_contact(model, kinematics, dynamics, &contact.soles, &feet.force);
            if let Some(height) = contact.stand_height() {
                state.setpoint.keep_above(kinematics.com.z - height);
            }
        }
    }
}

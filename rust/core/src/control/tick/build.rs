//! Construction of a controller: everything that can be refused is refused here.

use super::Controller;
use super::act::Torques;
use super::decide::Law;
use crate::aero::AeroModel;
use crate::control::command::Command;
use crate::control::config::ControllerConfig;
use crate::control::detect::Detectors;
use crate::control::detect::detector::Setup;
use crate::control::engine_condition::EngineLimits;
use crate::control::estimate::estimator::Estimator;
use crate::control::estimate::joint_tracker::JointTracker;
use crate::control::estimate::wind_observer::WindObserver;
use crate::control::law::contact::Contact;
use crate::control::law::mission::Mission;
use crate::control::law::momentum_qp::MomentumQp;
use crate::control::law::setpoint::SetpointGenerator;
use crate::control::law::tasks::standard_tasks;
use crate::control::law::torque::TorqueQp;
use crate::control::limits::Limits;
use crate::control::measure::channels::Channels;
use crate::control::mpc::PredictiveLaw;
use crate::control::state::Origin;
use crate::control::terms::Terms;
use crate::error::BuildError;
use crate::robot::RobotModel;
use nalgebra::DVector;

impl Controller {
    /// Builds a controller for `robot`. `aero` builds its aerodynamic model after
    /// `config` has been checked, so that gains for another robot are reported before missing coefficients.
    ///
    /// # Errors
    /// [`BuildError`] naming the part of the configuration that does not match the robot.
    pub fn new(
        robot: RobotModel,
        aero: impl FnOnce(&RobotModel) -> Result<AeroModel, BuildError>,
        mission: Mission,
        config: &ControllerConfig,
    ) -> Result<Self, BuildError> {
        config.check(&robot)?;
        let time_step = config.time_step;
        let aero = aero(&robot)?;
        let mut robot = config.restrict(robot);
        if let Some(shaft) = &config.shaft {
            robot = robot.with_shafts("controller.shaft", shaft)?;
        }
        let mut model = robot.clone();
        if !config.use_jets {
            model.jets.clear();
        }
        let limits = Limits::new(config.momentum, &model);
        config.check_rate_bounds(&robot)?;
        let (of_estimator, dynamics) = (config.estimator.as_ref(), config.jet_dynamics);
        let estimator = |config| Estimator::new(config, robot.clone(), dynamics, aero.clone(), time_step);
        let estimator = of_estimator.map(estimator).transpose()?;
        let observes_wind = config.wind_observer.then(|| WindObserver::new(robot.clone(), aero.clone()));
        let wind = observes_wind.transpose()?;
        config.disturbance_observer.map_or(Ok(()), |observer| observer.check(time_step))?;
        let momentum_fractions =
            estimator.as_ref().map_or([1.0; 2], |estimator| estimator.momentum_fractions);
        let torque_steps = config.torque.steps;
        let setup = Setup {
            robot: &robot,
            jet_dynamics: dynamics,
            estimator: of_estimator,
            momentum_fractions,
            usual: &limits,
            time_step,
            torque_steps,
        };
        let detectors = Detectors::new(&config.fault_detection, &setup);
        let descent = config.fault_detection.engines.and_then(|engines| engines.descent);
        let measures_joint_velocity = of_estimator.is_none_or(|config| config.joint_observer.is_none());
        let jets = robot.jet_models(dynamics);
        let channels =
            Channels::new(config.channels, &robot, jets.clone(), time_step, measures_joint_velocity);
        let contact = config.contact.clone().unwrap_or_default();
        let torque_qp = TorqueQp::new(&config.torque, &contact, &model);
        let mut momentum_qp = MomentumQp::new(&config.bounds, contact.force_rate_max, &model);
        let (weights, gains) = (&config.weights, config.posture_gains(&model));
        for task in standard_tasks(weights, gains, config.contact.as_ref(), &model, &momentum_qp.unknowns)? {
            momentum_qp.add(task)?;
        }
        let (unknowns, joints) = (momentum_qp.problem.len(), model.joints.len());
        let generator = SetpointGenerator::new(&config.setpoint, mission, &model.forward_axis_b, time_step)?;
        let solver = |n, rows| config.qp.chain(n, rows);
        let predictive = build_predictive(config, &model, &aero, time_step)?;
        let law = Law::new(generator, solver(unknowns, 0), unknowns, config.latency(), predictive);
        let torques = solver(torque_qp.problem.len(), torque_qp.problem.rows());
        let period = time_step / f64::from(torque_steps);
        let command = Command::zero(jets.len(), joints);
        let contact = Contact::new(&contact, &model);
        Ok(Self {
            conventions: config.conventions(&robot)?,
            feedback: config.aero_feedback,
            channels,
            estimator,
            wind,
            observer: config.disturbance_observer,
            has_feet: config.contact.is_some(),
            detectors,
            engines: EngineLimits::new(descent, &limits, &robot),
            usual: limits.clone(),
            law,
            policy: None,
            torques: Torques::new(torques, config.frictions(&model), period),
            joints: JointTracker::new(config.estimator.as_ref(), config.channels, period),
            torque_steps,
            origin: Origin::of_controller(),
            terms: Terms::new(&model, jets.len(), limits, contact, momentum_qp, torque_qp),
            command,
            change: DVector::zeros(6 + joints),
            jets,
            time_step,
            model,
            aero,
        })
    }
}

/// Builds the predictive law, where it is configured.
fn build_predictive(
    config: &ControllerConfig,
    robot: &RobotModel,
    aero: &AeroModel,
    time_step: f64,
) -> Result<Option<PredictiveLaw>, BuildError> {
    let Some(mpc) = &config.mpc else { return Ok(None) };
    mpc.check(robot, time_step)?;
    let conventions = config.conventions(robot)?;
    mpc.check_air(aero, conventions)?;
    let gains = (config.torque.kd, config.torque.kp);
    let thrust_rate_max = robot.by_jet(&config.bounds.thrust_rate_max);
    let joints = mpc.joints(robot)?;
    let jets = robot.jet_models(config.jet_dynamics);
    let law = PredictiveLaw::new(
        mpc,
        conventions,
        config.latency(),
        robot,
        jets,
        joints,
        gains,
        thrust_rate_max,
        time_step,
    )?;
    Ok(Some(law))
}

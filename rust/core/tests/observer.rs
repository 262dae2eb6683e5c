//! The observer of the unmodelled wrench: its law, what it does without measurements, and where it stands in a tick.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::{self, Running, TIME_STEP, assert_within, experiment};
use flight_core::control::Modes;
use flight_core::control::estimate::disturbance_observer::{
    DisturbanceObserverConfig, MomentumSample, ObserverState,
};
use flight_core::control::measure::measurement::Sampling;
use flight_core::dynamics::Dynamics;
use flight_core::kinematics::Kinematics;
use flight_core::spatial::exp_so3;
use flight_core::{Measurement, RobotModel, RobotState};
use flight_io::load_robot;
use flight_sim::{Plant, ScenarioConfig};
use nalgebra::{DVector, Matrix6, Matrix6xX, Vector3, Vector6};

/// Six numbers that are all different, so that exchanged axes show.
const WRENCH: Vector6<f64> = Vector6::new(30.0, -50.0, 70.0, 3.0, -5.0, 7.0);
const RATE: Vector6<f64> = Vector6::new(-11.0, 13.0, 17.0, -1.9, 2.3, 2.9);
const MOMENTUM: Vector6<f64> = Vector6::new(4.0, -6.0, 8.0, 0.3, 0.5, -0.7);

const WIDE: DisturbanceObserverConfig =
    DisturbanceObserverConfig { gain_force: 2.0, gain_moment: 5.0, force_max: 600.0, moment_max: 100.0 };

/// A momentum under a constant modelled rate and a constant wrench that the model does not know.
fn at(time: f64) -> MomentumSample {
    MomentumSample { momentum: MOMENTUM + (RATE + WRENCH) * time, rate: RATE }
}

/// The wrench after a measured tick.
fn observe(
    state: &mut ObserverState,
    config: &DisturbanceObserverConfig,
    elapsed: f64,
    sample: MomentumSample,
) -> Vector6<f64> {
    state.observe(config, Sampling::Measured, elapsed, sample);
    *state.wrench()
}

fn update(state: &mut ObserverState, sample: MomentumSample) -> Vector6<f64> {
    observe(state, &WIDE, TIME_STEP, sample)
}

/// The wrench after a tick that measures no momentum.
fn miss(state: &mut ObserverState, sampling: Sampling, rate: Vector6<f64>) -> Vector6<f64> {
    let sample = MomentumSample { momentum: Vector6::repeat(f64::NAN), rate };
    assert_eq!(state.observe(&WIDE, sampling, TIME_STEP, sample), None);
    *state.wrench()
}

/// `w (1 − exp(−K_o t))`, force and moment with their own gains.
fn law(wrench: &Vector6<f64>, time: f64) -> Vector6<f64> {
    let share = |gain: f64| 1.0 - (-gain * time).exp();
    let (force, moment) = (share(WIDE.gain_force), share(WIDE.gain_moment));
    wrench.component_mul(&Vector6::new(force, force, force, moment, moment, moment))
}

/// A constant wrench is approached as `1 − exp(−K_o t)` on every axis, at any step.
#[test]
fn a_constant_wrench_is_approached_at_the_stated_rate() {
    for step in [0.0025, 0.01, 0.03] {
        let mut state = ObserverState::default();
        for tick in 0..400 {
            let time = f64::from(tick) * step;
            let error = observe(&mut state, &WIDE, step, at(time)) - law(&WRENCH, time);
            // A difference of momenta near 100 N s rounds by 1e-14 N s, a thousandth of a step by 4e-12 N.
            assert_within!(error.amax(), 1e-11, "{step} s, tick {tick}");
        }
    }
}

/// The rate is that of the tick before: it is what acted between the two measurements.
#[test]
fn the_rate_that_acted_is_subtracted() {
    let mut state = ObserverState::default();
    let mut momentum = MOMENTUM;
    for tick in 0..100 {
        let rate = RATE * f64::from(tick % 7);
        update(&mut state, MomentumSample { momentum, rate });
        momentum += rate * TIME_STEP;
    }
    assert_within!(state.wrench().amax(), 1e-12);
}

/// Each axis stops at its own limit, on both sides, and comes back at once.
#[test]
fn the_estimate_stays_within_its_limits() {
    let config = DisturbanceObserverConfig { force_max: 20.0, moment_max: 4.0, ..WIDE };
    let limits = Vector6::new(20.0, 20.0, 20.0, 4.0, 4.0, 4.0);
    for sign in [1.0, -1.0] {
        let (mut state, mut momentum, mut found) = (ObserverState::default(), MOMENTUM, Vector6::zeros());
        for _ in 0..1000 {
            let sample = MomentumSample { momentum, rate: RATE };
            found = observe(&mut state, &config, TIME_STEP, sample);
            momentum += (RATE + WRENCH * sign) * TIME_STEP;
        }
        let expected = (WRENCH * sign).zip_map(&limits, |x, limit| x.clamp(-limit, limit));
        assert_within!((found - expected).amax(), 1e-6, "10 s are 20 time constants");
        momentum -= WRENCH * sign * TIME_STEP;
        let back = observe(&mut state, &config, TIME_STEP, MomentumSample { momentum, rate: RATE });
        assert!(back.iter().zip(&found).all(|(back, found)| back.abs() < found.abs()), "{back}");
    }
}

/// The quotient is over the time that passed; after a tick that holds, the estimate stays and the comparison starts anew.
#[test]
fn missing_measurements_are_bridged_or_held() {
    for missed in [1, 4, 9] {
        let mut state = ObserverState::default();
        for tick in (0..200).filter(|tick| tick % (missed + 1) == 0) {
            let time = f64::from(tick) * TIME_STEP;
            let found = observe(&mut state, &WIDE, f64::from(missed + 1) * TIME_STEP, at(time));
            assert_within!((found - law(&WRENCH, time)).amax(), 1e-11, "{missed} missed");
        }
    }
    let mut state = ObserverState::default();
    update(&mut state, at(1.0));
    let before = update(&mut state, at(1.01));
    assert!(before.amax() > 1.0);
    assert_eq!(miss(&mut state, Sampling::Unknown, RATE), before);
    // What happened meanwhile would be a wrench of any size.
    let sample = MomentumSample { momentum: MOMENTUM * 1e3, ..at(1.02) };
    assert_eq!(update(&mut state, sample), before);
    let next = MomentumSample { momentum: MOMENTUM * 1e3 + RATE * TIME_STEP, rate: RATE };
    let decayed = WRENCH - law(&WRENCH, TIME_STEP);
    let expected = before.component_mul(&decayed.component_div(&WRENCH));
    assert_within!((update(&mut state, next) - expected).amax(), 1e-9);
}

/// A momentum that is measured in some ticks only is compared with the mean of the rates that acted since.
#[test]
fn rates_between_two_measurements_act_together() {
    for (every, missed) in [(2, 1), (5, 4), (10, 9)] {
        let (mut state, mut momentum) = (ObserverState::default(), MOMENTUM);
        for tick in 0..200 {
            let rate = RATE * f64::from(tick % 7);
            if tick % every == 0 {
                let found = update(&mut state, MomentumSample { momentum, rate });
                let error = found - law(&WRENCH, f64::from(tick) * TIME_STEP);
                assert_within!(error.amax(), 1e-11, because "momenta near 100 N s over a step", "{missed} missed");
            } else {
                let before = *state.wrench();
                assert_eq!(miss(&mut state, Sampling::Between, rate), before);
            }
            momentum += (rate + WRENCH) * TIME_STEP;
        }
    }
}

/// Where the estimate stays, the residual is `w (1 − exp(−t / 0.02 s))`; without a measurement it is forgotten.
#[test]
fn the_residual_follows_what_is_found_beside_the_estimate() {
    let config = DisturbanceObserverConfig { gain_force: 0.0, gain_moment: 0.0, ..WIDE };
    let mut state = ObserverState::default();
    for tick in 0..20 {
        let time = f64::from(tick) * TIME_STEP;
        observe(&mut state, &config, TIME_STEP, at(time));
        let error = state.residual + WRENCH * (-time / 0.02).exp_m1();
        // As for the estimate: momenta of 100 N s over a step.
        assert_within!(error.amax(), 1e-11, "tick {tick}");
    }
    miss(&mut state, Sampling::Unknown, RATE);
    assert_eq!(state.residual, Vector6::zeros());
}

/// Numbers that overflow leave the estimate as it is.
#[test]
fn an_overflow_is_not_observed() {
    let mut state = ObserverState::default();
    update(&mut state, at(0.0));
    let before = update(&mut state, at(0.01));
    for momentum in [f64::MAX, f64::INFINITY, f64::NAN] {
        let sample = MomentumSample { momentum: Vector6::repeat(momentum), ..at(0.02) };
        assert_eq!(update(&mut state, sample), before);
    }
    let after = update(&mut state, at(0.03));
    assert!(after.iter().all(|x| x.is_finite()), "{after}");
}

#[test]
fn gains_beyond_the_rate_of_ticks_are_refused() {
    for (is_force, gain, is_refused) in
        [(true, 100.0, false), (true, 101.0, true), (false, 100.0, false), (false, 101.0, true)]
    {
        let mut config = experiment("test2_observer");
        (config.controller.law.channels.jump, config.controller.law.fault_detection.engines) = (false, None);
        let observer = config.controller.law.disturbance_observer.as_mut().unwrap();
        *(if is_force { &mut observer.gain_force } else { &mut observer.gain_moment }) = gain;
        match config.controller(load_robot(&config.robot).unwrap()) {
            Ok(_) => assert!(!is_refused),
            Err(error) => {
                let message = error.to_string();
                assert!(
                    is_refused && message.contains("from 0 to 100, 1 / time step of 0.01 s"),
                    "{message}"
                );
            }
        }
    }
}

/// A robot that moves all its joints in the wind, with exactly the momentum that a constant unmodelled wrench gives it.
struct Prescribed {
    state: RobotState,
    momentum: Vector6<f64>,
    thrust: Vec<f64>,
    tick: u32,
}

impl Prescribed {
    fn new(config: &ScenarioConfig) -> Self {
        let mut state = config.simulator.initial.state();
        state.velocity[3] = 0.4;
        Self { momentum: MOMENTUM, thrust: config.simulator.initial.thrust.clone(), tick: 0, state }
    }

    fn measurement(&self) -> Measurement {
        let wind = Vector3::new(3.0, -9.0, 1.0);
        Measurement { wind, ..common::at(f64::from(self.tick) * TIME_STEP, &self.state, &self.thrust) }
    }

    /// Solves `A_G ν = L` for the velocity of the base, with the momentum matrix of a controller's last tick.
    fn set_velocity(&mut self, momentum_matrix: &Matrix6xX<f64>) {
        let joints = self.state.n_joints();
        let base: Matrix6<f64> = momentum_matrix.fixed_columns::<6>(0).into();
        let of_joints = momentum_matrix.columns(6, joints) * self.state.velocity.rows(6, joints);
        let nu = base.try_inverse().unwrap() * (self.momentum - of_joints);
        self.state.velocity.rows_mut(0, 6).copy_from(&nu);
    }

    /// Moves on by a tick: momentum by what acts, pose and posture somehow.
    fn advance(&mut self, rate: &Vector6<f64>) {
        self.momentum += (rate + WRENCH) * TIME_STEP;
        let (v, w) = (self.state.velocity.fixed_rows::<3>(0), self.state.velocity.fixed_rows::<3>(3));
        self.state.base.position += v * TIME_STEP;
        self.state.base.rotation = exp_so3(&(w * TIME_STEP)) * self.state.base.rotation;
        self.tick += 1;
        let phase = f64::from(self.tick) * 0.05;
        let moved = DVector::from_fn(self.state.n_joints(), |joint, _| (phase + joint as f64).sin());
        self.state.velocity.rows_mut(6, moved.len()).copy_from(&(&moved * 0.2));
        self.state.joint_position += moved * (0.2 * TIME_STEP);
        for (jet, thrust) in self.thrust.iter_mut().enumerate() {
            *thrust += 0.1 * (phase + jet as f64).cos();
        }
    }
}

fn controller(config: &ScenarioConfig) -> Running {
    Running::new(config.controller(load_robot(&config.robot).unwrap()).unwrap())
}

/// TEST2 for a body that moves as it likes: what guards against motions that no robot makes is off.
fn unguarded(observer: Option<DisturbanceObserverConfig>) -> ScenarioConfig {
    let mut config = experiment("test2_observer");
    let law = &mut config.controller.law;
    (law.channels.jump, law.fault_detection.engines, law.fault_detection.tracking_error) =
        (false, None, None);
    law.disturbance_observer = observer;
    config
}

/// In whole ticks of the humanoid: the wrench is observed at the stated rate, and it is the only thing that is added
/// to the momentum rate of the same controller without an observer.
#[test]
fn a_tick_observes_what_its_model_leaves_out() {
    let config = unguarded(Some(WIDE));
    let (mut observing, mut plain) = (controller(&config), controller(&unguarded(None)));
    let mut body = Prescribed::new(&config);
    for tick in 0..60 {
        // The momentum matrix belongs to the pose, so a first tick at this pose finds it.
        plain.tick(&body.measurement());
        let matrix = plain.terms().dynamics.momentum_matrix.clone();
        body.set_velocity(&matrix);
        plain.tick(&body.measurement());
        observing.tick(&body.measurement());
        assert_eq!(observing.command().modes, Modes::default());
        let (momentum, without) = (&observing.terms().momentum, &plain.terms().momentum);
        assert_eq!(without.unmodelled_wrench, Vector6::zeros());
        assert_eq!(momentum.rate_estimate, without.rate_estimate + momentum.unmodelled_wrench);
        let error = momentum.unmodelled_wrench - law(&WRENCH, f64::from(tick) * TIME_STEP);
        // The velocity that has this momentum is found to 1e-13, a tick divides by 0.01 s.
        assert_within!(error.amax(), 1e-9, "tick {tick}: {error}");
        body.advance(&without.rate_estimate);
    }
}

/// Over more than 0.15 s of refused measurements nothing is compared, and a state that is restored continues to the same bits.
#[test]
fn a_refused_tick_is_held_and_a_state_is_restored() {
    let config = unguarded(Some(WIDE));
    let mut flying = controller(&config);
    let mut sample = Prescribed::new(&config);
    let wrench_after = |flying: &mut Running, sample: &Prescribed| {
        flying.tick(&sample.measurement());
        flying.terms().momentum.unmodelled_wrench
    };
    for _ in 0..5 {
        wrench_after(&mut flying, &sample);
        sample.tick += 1;
    }
    let known = flying.terms().momentum.rate_estimate - flying.terms().momentum.unmodelled_wrench;
    let before = flying.terms().momentum.unmodelled_wrench;
    for _ in 0..16 {
        let bad = Measurement { thrust: vec![], ..sample.measurement() };
        assert!(flying.tick(&bad).modes.contains(Modes::MEASUREMENT_IGNORED));
        sample.tick += 1;
    }
    assert_eq!(wrench_after(&mut flying, &sample), before);
    sample.tick += 1;
    // Nothing moved in this tick, so that what is not known is all that acts: −r.
    let decay = |gain: f64| (-gain * TIME_STEP).exp();
    let (force, moment) = (decay(WIDE.gain_force), decay(WIDE.gain_moment));
    let decays = Vector6::new(force, force, force, moment, moment, moment);
    let expected = -known + (before + known).component_mul(&decays);
    let state = flying.state().clone();
    let found = wrench_after(&mut flying, &sample);
    assert_within!((found - expected).amax(), 1e-9, "{found}");
    flying.state = Some(state);
    assert_eq!(wrench_after(&mut flying, &sample), found);
}

/// What is observed counts in the prediction of a lost velocity, as in the estimator: it moves the robot as one body. Beside a
/// controller that observes nothing, `Δν̇ = M⁻¹ S Δτ + a` where `a` moves no joint and `A_G a = ŵ`.
#[test]
fn the_prediction_of_a_velocity_has_the_observed_wrench() {
    let config = unguarded(Some(WIDE));
    let (mut observing, mut unaware) = (controller(&config), controller(&unguarded(None)));
    let mut sample = Prescribed::new(&config);
    for _ in 0..3 {
        observing.tick(&sample.measurement());
        unaware.tick(&sample.measurement());
        // What is measured twice alike may be frozen.
        sample.set_velocity(&unaware.terms().dynamics.momentum_matrix);
        sample.advance(&RATE);
    }
    let terms = observing.terms();
    let wrench = terms.momentum.unmodelled_wrench;
    let arm = terms.kinematics.com - terms.kinematics.bodies[0].i_from_b.position;
    let force: Vector3<f64> = wrench.fixed_rows::<3>(0).into();
    assert!(arm.cross(&force).norm() > 0.01, "the arm does not count: {arm}, {wrench}");
    let mut expected = DVector::zeros(terms.dynamics.bias.len());
    let torques = &observing.command().joint_torque - &unaware.command().joint_torque;
    expected.rows_mut(6, torques.len()).copy_from(&torques);
    let expected = terms.dynamics.mass_matrix.clone().cholesky().unwrap().solve(&expected);
    let of_base: Matrix6<f64> = terms.dynamics.momentum_matrix.fixed_columns::<6>(0).into();
    let expected = expected.fixed_rows::<6>(0) + of_base.try_inverse().unwrap() * wrench;

    // A lost velocity follows the pose, if there is one.
    sample.state.velocity.fill(f64::NAN);
    sample.state.base.position.fill(f64::NAN);
    sample.state.base.rotation.fill(f64::NAN);
    let predicted = [&mut observing, &mut unaware].map(|controller| {
        controller.tick(&sample.measurement());
        let base = &controller.terms().kinematics.bodies[0];
        DVector::from_iterator(6, base.linear_velocity.iter().chain(&base.angular_velocity).copied())
    });
    let found = (&predicted[0] - &predicted[1]) / TIME_STEP;
    // Velocities near 1 m/s round by 1e-16, a hundredth of a second makes of it 1e-14; M has a condition of 1e4.
    assert_within!((found - expected).amax(), 1e-9);
}

/// On the ground the measured wrenches of the feet are known, whether they carry or hardly touch: what is observed is
/// what else would have to act on a robot that stands still.
#[test]
fn the_ground_is_part_of_the_model() {
    let mut config = experiment("balancing_front");
    config.controller.law.disturbance_observer = Some(WIDE);
    let state = config.simulator.initial.state();
    for (vertical, carries) in [(212.5, true), (2.0, false)] {
        let mut standing = controller(&config);
        let foot = |x: f64| Vector6::new(x, -4.0, vertical, 0.4, -1.2, 0.3);
        let foot_wrenches = [foot(5.0), foot(-2.0)];
        for tick in 0..50 {
            let time = f64::from(tick) * TIME_STEP;
            let wind = Vector3::new(-6.0, 2.0, 0.0);
            let feet = DVector::from_iterator(12, foot_wrenches.iter().flatten().copied());
            let measurement =
                Measurement { wind, foot_wrenches: feet, ..common::at(time, &state, &[0.0; 4]) };
            standing.tick(&measurement);
            let terms = standing.terms();
            assert_eq!(standing.state().contact().is_active, carries);
            let com = terms.kinematics.com;
            let (mut force, mut moment) = terms.link_forces.wrench_about(&com);
            force.z -= terms.kinematics.mass() * 9.81;
            for (sole, wrench) in terms.contact.soles.iter().zip(&foot_wrenches) {
                let pushed: Vector3<f64> = wrench.fixed_rows::<3>(0).into();
                force += pushed;
                moment += (sole.position - com).cross(&pushed) + wrench.fixed_rows::<3>(3);
            }
            let acting = Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
            let error = terms.momentum.unmodelled_wrench - law(&-acting, time);
            assert_within!(error.amax(), 1e-9, "{vertical} N, tick {tick}: {error}");
        }
    }
}

/// `A_G` a while after a state, had it kept this velocity.
fn momentum_matrix(
    robot: &RobotModel,
    state: &RobotState,
    velocity: &DVector<f64>,
    time: f64,
) -> Matrix6xX<f64> {
    let mut moved = state.clone();
    moved.base.position += velocity.fixed_rows::<3>(0) * time;
    moved.base.rotation = exp_so3(&(velocity.fixed_rows::<3>(3) * time)) * state.base.rotation;
    let (mut kinematics, mut dynamics) = (Kinematics::new(robot), Dynamics::new(robot));
    kinematics.update(robot, &moved);
    dynamics.update(robot, &moved, &kinematics);
    dynamics.momentum_matrix
}

/// A plant that is the model: what is observed is what the step of the integrator adds, as M85 has it. What that
/// leaves out falls with the square of the tick.
#[test]
fn the_integrator_is_observed_as_stated() {
    let beyond = |time_step: f64| {
        let mut config = experiment("platform_hover");
        config.controller.law.disturbance_observer = Some(WIDE);
        config.controller.law.time_step = time_step;
        config.simulator.initial.base_velocity = [0.5, -0.3, 0.2, 0.4, -0.6, 0.9];
        let mut robot = load_robot(&config.robot).unwrap();
        robot.bodies[0].com_b += Vector3::new(0.01, -0.02, 0.015);
        let mut plant =
            Plant::new(robot.clone(), &config.simulator, &config.disturbances, &config.controller.law)
                .unwrap();
        let mut flying = Running::new(config.controller(robot.clone()).unwrap());
        let wind = Vector3::new(1.0, -4.0, 0.5);
        let mut states = Vec::new();
        for time in [0.0, time_step] {
            plant.observe(&wind);
            let (state, thrust) = (plant.state(), plant.jets().thrust_feedback());
            states.push(state.clone());
            flying.tick(&Measurement { wind, ..common::at(time, state, thrust) });
            plant.advance(&[], &[0.0; 6], &wind, time_step);
        }
        let share = |gain: f64| -(-gain * time_step).exp_m1();
        let (force, moment) = (share(WIDE.gain_force), share(WIDE.gain_moment));
        let shares = Vector6::new(force, force, force, moment, moment, moment);
        let observed = flying.terms().momentum.unmodelled_wrench.component_div(&shares);

        let (nu, step) = (&states[0].velocity, 1e-3);
        let acceleration = (&states[1].velocity - nu) / time_step;
        let at = |velocity, time| momentum_matrix(&robot, &states[0], velocity, time);
        let slope = |velocity| (at(velocity, step) - at(velocity, -step)) / (2.0 * step);
        let curvature = (at(nu, step) - at(nu, 0.0) * 2.0 + at(nu, -step)) / (step * step);
        let stated = slope(nu) * &acceleration + slope(&acceleration) * nu + curvature * nu * 0.5;
        let stated = stated * time_step;
        assert!(stated.norm() > 10.0 * (observed - stated).norm(), "{observed} {stated}");
        (observed - stated).norm()
    };
    let errors = [0.01, 0.005, 0.0025].map(beyond);
    for pair in errors.windows(2) {
        let ratio = pair[0] / pair[1];
        assert!((3.8..4.2).contains(&ratio), "{errors:?}");
    }
}

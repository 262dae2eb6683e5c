//! The drives between torques and joints: lag, friction, inertia, elasticity.

#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]

use crate::common::{assert_says, assert_within, experiment, fly, robot};
use flight_core::robot::RobotModel;
use flight_sim::config::Integrator;
use flight_sim::motors::{ElasticityConfig, Motors, MotorsConfig};
use flight_sim::{Disturbances, Plant, Scenario, SimulatorConfig};
use nalgebra::{DMatrix, DVector, Vector3};

const STEP: f64 = 1e-3;
/// Inertia of a limb \[kg m²\].
const LIMB: f64 = 0.3;

fn motors(friction: f64, damping: f64, inertia: f64) -> MotorsConfig {
    MotorsConfig {
        friction,
        friction_of: [].into(),
        load_friction: [].into(),
        damping,
        inertia,
        time_constant: 0.0,
        elasticity: None,
    }
}

/// The first joint of a robot whose limbs do not move each other.
struct Limb {
    motors: Motors,
    position: Vec<f64>,
    velocity: Vec<f64>,
}

impl Limb {
    fn new(config: &MotorsConfig, robot: &RobotModel, velocity: f64) -> Self {
        let n = robot.joints.len();
        let (position, velocity) = (vec![0.1; n], vec![velocity; n]);
        Self { motors: Motors::new(config, robot, &position, &velocity), position, velocity }
    }

    /// One step with this torque; returns the acceleration.
    fn step(&mut self, torque: f64, step: f64) -> f64 {
        let n = self.position.len();
        let mut acceleration = DVector::zeros(6 + n);
        let torques = self.motors.lag(&vec![torque; n], step).to_vec();
        self.motors.receive(&torques);
        let (mut force, mut mass) =
            (DVector::zeros(6 + n), DMatrix::from_diagonal_element(6 + n, 6 + n, LIMB));
        self.motors.accelerate(
            &mut force,
            &mut mass,
            &mut acceleration,
            (&self.position, &self.velocity),
            step,
            |force, mass, to| to.copy_from(&force.component_div(&mass.diagonal())),
        );
        for joint in 0..n {
            self.velocity[joint] += step * acceleration[6 + joint];
            self.position[joint] += step * self.velocity[joint];
        }
        self.motors.advance(&self.position, &self.velocity, step);
        acceleration[6]
    }
}

/// `(J + B) a = τ − d ṡ₊` with the velocity after the step.
#[test]
fn inertia_and_damping_act_after_the_step() {
    let robot = robot("sparrow");
    let (damping, inertia) = (1.7, 0.05);
    let mut limb = Limb::new(&motors(0.0, damping, inertia), &robot, 0.4);
    for step in [0.01, 0.002] {
        let acceleration = limb.step(2.0, step);
        let expected = 2.0 - damping * limb.velocity[0];
        assert_within!(((LIMB + inertia) * acceleration - expected).abs(), 1e-14, "force");
    }
}

/// Friction holds a motor against less torque than its own, and takes its own from more.
#[test]
fn friction_holds_and_then_slips() {
    let robot = robot("sparrow");
    let mut config = motors(9.0, 0.0, 0.05);
    config.friction_of = [(robot.joints[0].name.clone(), 2.0)].into();
    let mut limb = Limb::new(&config, &robot, 0.0);
    for _ in 0..1000 {
        limb.step(1.5, STEP);
    }
    assert!((limb.position[0] - 0.1).abs() < 1e-3, "creeps to {}", limb.position[0]);
    assert_within!((limb.velocity[0] - 1.5 / 2.0 * 1e-3).abs(), 1e-9, "creep");
    let acceleration = (0..3).map(|_| limb.step(5.0, STEP)).last().unwrap();
    assert_within!((acceleration - 3.0 / (LIMB + 0.05)).abs(), 1e-12, "slips");
    assert!(limb.velocity[1].abs() < 1e-3, "another joint has the friction of all");
    let mut limb = Limb::new(&config, &robot, -0.5);
    assert_within!((limb.step(0.0, STEP) - 2.0 / (LIMB + 0.05)).abs(), 1e-12, "against the motion");
}

/// A gear under load has `f = f₀ + μ |τ_s|`: of 5 N m a limb that slips gets `τ_s = 5 − 1 − 0.25 τ_s`, with what the
/// rotor takes of it.
#[test]
fn friction_grows_with_the_load() {
    let robot = robot("sparrow");
    let mut config = motors(1.0, 0.0, 0.05);
    config.load_friction = [(robot.joints[0].name.clone(), 0.25)].into();
    let mut limb = Limb::new(&config, &robot, 0.5);
    let acceleration = (0..40).map(|_| limb.step(5.0, STEP)).last().unwrap();
    assert_within!((LIMB * acceleration * 1.25 + 0.05 * acceleration - 4.0).abs(), 1e-12, "slips");
    let mut limb = Limb::new(&config, &robot, -0.5);
    let last = (0..40).map(|_| limb.step(-5.0, STEP)).last().unwrap();
    assert_within!((last + acceleration).abs(), 1e-12, "the other way");
}

/// A limb that slides comes to rest, at no step with more energy than before.
#[test]
fn friction_ends_a_motion() {
    let robot = robot("sparrow");
    for step in [0.01, 0.001] {
        let mut limb = Limb::new(&motors(0.7, 0.0, 0.05), &robot, 0.5);
        let mut last = limb.velocity[0];
        for _ in 0..100 {
            limb.step(0.0, step);
            assert!((0.0..=last).contains(&limb.velocity[0]), "from {last} to {} rad/s", limb.velocity[0]);
            last = limb.velocity[0];
        }
    }
}

/// `1 − e^{−t/T}` of a step.
#[test]
fn the_torque_lags() {
    let robot = robot("sparrow");
    let mut config = motors(0.0, 0.0, 0.0);
    config.time_constant = 0.02;
    let mut limb = Limb::new(&config, &robot, 0.0);
    assert_within!((LIMB * limb.step(1.0, STEP) - 1.0).abs(), 1e-15, "first");
    for tick in 1..50 {
        let torque = LIMB * limb.step(3.0, STEP);
        let expected = 1.0 + 2.0 * (1.0 - (-f64::from(tick) * STEP / 0.02).exp());
        assert_within!((torque - expected).abs(), 1e-12, "torque");
    }
}

/// Two inertias on a spring oscillate with `ω² = K (1/J + 1/B)`, and their damping is `D (1/J + 1/B) / 2`.
#[test]
fn a_limb_on_a_spring_oscillates() {
    let robot = robot("sparrow");
    let (inertia, stiffness, damping, step) = (0.1, 300.0, 0.05, 2e-6);
    let config = MotorsConfig {
        elasticity: Some(ElasticityConfig { stiffness, damping }),
        ..motors(0.0, 0.0, inertia)
    };
    let mut limb = Limb::new(&config, &robot, 0.0);
    limb.velocity.fill(0.4); // the motor is at rest
    let mean = 0.4 * LIMB / (LIMB + inertia);
    let (mut crossings, mut time, mut last) = (Vec::new(), 0.0, limb.velocity[0] - mean);
    let mut greatest = Vec::new();
    let mut peak: f64 = 0.0;
    while crossings.len() < 5 {
        limb.step(0.0, step);
        time += step;
        let now = limb.velocity[0] - mean;
        peak = peak.max(now.abs());
        if now * last < 0.0 {
            crossings.push(time);
            greatest.push(std::mem::take(&mut peak));
        }
        last = now;
    }
    let both = 1.0 / LIMB + 1.0 / inertia;
    let decay = damping * both / 2.0;
    let half = std::f64::consts::PI / (stiffness * both - decay * decay).sqrt();
    assert_within!(((crossings[4] - crossings[0]) / 4.0 / half - 1.0).abs(), 2e-4, "half period, relative");
    // A step of δ damps by ω² δ / 2 more.
    let measured = (greatest[1] / greatest[4]).ln() / (3.0 * half);
    assert_within!((measured / (decay + stiffness * both * step / 2.0) - 1.0).abs(), 0.02, "decay, relative");
}

/// What is very stiff is rigid: inertia, damping, friction and torque as without a spring.
#[test]
fn a_stiff_spring_is_rigid() {
    let robot = robot("sparrow");
    let rigid = motors(0.5, 0.3, 0.05);
    let stiff = MotorsConfig {
        elasticity: Some(ElasticityConfig { stiffness: 1e10, damping: 0.0 }),
        ..rigid.clone()
    };
    let (mut rigid, mut stiff) = (Limb::new(&rigid, &robot, 0.4), Limb::new(&stiff, &robot, 0.4));
    for tick in 0..50 {
        let torque = if tick < 25 { 3.0 } else { -2.0 };
        let (rigid, stiff) = (rigid.step(torque, STEP), stiff.step(torque, STEP));
        assert_within!((rigid - stiff).abs(), 1e-4, "acceleration");
    }
}

/// Drives act between bodies: the wrench on the whole robot is that of a robot without them, with and without a joint at
/// its stop.
#[test]
fn drives_do_not_change_the_momentum() {
    let mut config = experiment("test2");
    let robot = robot("ironcub_mk1");
    let law = config.controller.law.clone();
    let wrench = |config: &SimulatorConfig| {
        let mut plant = Plant::new(robot.clone(), config, &Disturbances::default(), &law).unwrap();
        plant.observe(&Vector3::zeros());
        let (mass, before) = (plant.dynamics().mass_matrix.clone(), plant.state().velocity.clone());
        plant.advance(&[4.0; 23], &[0.0; 4], &Vector3::zeros(), law.time_step);
        let change = &plant.state().velocity - before;
        (mass * &change / law.time_step, change)
    };
    let (ideal, without) = wrench(&config.simulator);
    config.simulator.motors = Some(MotorsConfig {
        time_constant: 0.01,
        elasticity: Some(ElasticityConfig { stiffness: 500.0, damping: 0.2 }),
        ..motors(1.0, 0.3, 0.05)
    });
    let (driven, with) = wrench(&config.simulator);
    assert_within!(
        ((ideal.rows(0, 6) - driven.rows(0, 6)).norm() / ideal.rows(0, 6).norm()).abs(),
        1e-12,
        "wrench"
    );
    assert!((without - with).norm() > 1.0, "the joints move otherwise");
}

/// With the rotors in the mass matrix of the controller, joints follow as if there were none.
#[test]
fn a_controller_with_the_rotors_in_its_model_flies_as_without_any() {
    let flight = |rotors: f64, in_the_model: f64| {
        let mut config = experiment("test2_observer");
        config.simulator.duration = 2.0;
        config.simulator.motors = Some(motors(0.0, 0.0, rotors));
        config.controller.law.torque.rotor_inertia = in_the_model;
        config
    };
    let flights = fly(&[flight(0.0, 0.0), flight(0.05, 0.05), flight(0.05, 0.0)]);
    let series = |flight: usize| &flights[flight].log.series("joint_position").unwrap().data;
    let apart = |flight: usize| {
        series(0).iter().zip(series(flight)).fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()))
    };
    let (known, unknown) = (apart(1), apart(2));
    assert!(known < 0.1 * unknown, "{known} rad with the rotors in the model, {unknown} without");
}

#[test]
fn bad_drives_are_refused_by_name() {
    let refused = |change: fn(&mut SimulatorConfig), expected: &[&str]| {
        let mut config = experiment("test2");
        config.simulator.motors = Some(motors(0.5, 0.1, 0.05));
        assert!(Scenario::new(&config).is_ok());
        change(&mut config.simulator);
        assert_says(&Scenario::new(&config).unwrap_err(), expected);
    };
    refused(|simulator| simulator.integrator = Integrator::ExplicitEuler, &["integrator", "semi_implicit"]);
    refused(
        |simulator| {
            let motors = simulator.motors.as_mut().unwrap();
            motors.inertia = 0.0;
            motors.elasticity = Some(ElasticityConfig { stiffness: 100.0, damping: 0.0 });
        },
        &["simulator.motors.inertia", "more than 0"],
    );
}

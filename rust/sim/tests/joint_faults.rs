//! Joints that are stuck, weak or free in the simulated robot.

#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]
#![allow(clippy::float_cmp, reason = "shares of torques are exact")]

use crate::common::{assert_says, experiment, robot};
use flight_sim::config::Integrator;
use flight_sim::disturbances::{JointFault, JointFaultKind, JointFaults};
use flight_sim::{Disturbances, Plant, Scenario};
use nalgebra::Vector3;

const ELBOW: usize = 6;
const STEP: f64 = 0.01;

fn fault(kind: JointFaultKind, start: f64) -> JointFault {
    JointFault { joint: "l_elbow".into(), kind, start }
}

#[test]
fn a_share_of_the_torque_acts_from_the_onset_on() {
    let joints = robot("ironcub_mk1").joints;
    for (kind, share) in
        [(JointFaultKind::Stuck, 1.0), (JointFaultKind::Weak, 0.5), (JointFaultKind::Free, 0.0)]
    {
        let mut faults = JointFaults::new(&[fault(kind, 0.05)], &joints).unwrap();
        for tick in 0..10 {
            let position = vec![f64::from(tick); joints.len()];
            faults.begin_tick(STEP, &position);
            let torque = faults.reduce(&vec![3.0; joints.len()]).to_vec();
            assert_eq!(torque[ELBOW], if tick < 5 { 3.0 } else { 3.0 * share }, "{kind:?} in tick {tick}");
            assert!(torque.iter().enumerate().all(|(joint, torque)| joint == ELBOW || *torque == 3.0));
            let stuck: Vec<_> = faults.stuck().collect();
            let expected = (kind == JointFaultKind::Stuck && tick >= 5).then_some((ELBOW, 5.0));
            assert_eq!(stuck, Vec::from_iter(expected));
        }
    }
}

/// A stuck joint keeps its position to a milliradian under a torque of 50 N m, with both integrators.
#[test]
fn a_stuck_joint_keeps_its_position() {
    for integrator in [Integrator::SemiImplicitEuler, Integrator::ExplicitEuler] {
        for substeps in [1, 4] {
            let mut config = experiment("test2");
            config.simulator.integrator = integrator;
            config.simulator.substeps = substeps;
            let disturbances =
                Disturbances { joints: vec![fault(JointFaultKind::Stuck, 0.1)], ..Disturbances::default() };
            let law = &config.controller.law;
            let mut plant = Plant::new(robot("ironcub_mk1"), &config.simulator, &disturbances, law).unwrap();
            let mut torque = [0.0; 23];
            torque[ELBOW] = 5.0;
            let mut held = None;
            for tick in 0..60 {
                if tick == 10 {
                    held = Some(plant.state().joint_position[ELBOW]);
                    torque[ELBOW] = -50.0;
                }
                plant.observe(&Vector3::zeros());
                plant.advance(&torque, &[0.0; 4], &Vector3::zeros(), STEP);
                if let (Some(held), true) = (held, tick > 14) {
                    let moved = (plant.state().joint_position[ELBOW] - held).abs();
                    assert!(moved < 1.5e-3, "{integrator:?}, {substeps}: {moved} rad in tick {tick}");
                }
            }
        }
    }
}

#[test]
fn bad_faults_are_refused_by_name() {
    let mut config = experiment("test2");
    config.disturbances.joints =
        vec![JointFault { joint: "l_elbo".into(), ..fault(JointFaultKind::Free, 1.0) }];
    assert_says(&Scenario::new(&config).unwrap_err(), &["disturbances.joints[0].joint", "l_elbo"]);
    config.disturbances.joints = vec![fault(JointFaultKind::Weak, 1.0), fault(JointFaultKind::Free, 2.0)];
    let refusal = Scenario::new(&config).unwrap_err();
    assert_says(&refusal, &["disturbances.joints[1].joint is l_elbow", "without another fault"]);
}

//! Each term of kinematics, dynamics and momentum of a tick, at states of the hovering robot; output as by
//! `common::report`.

mod common;

use common::report;
use flight_core::BuildError;
use flight_core::aero::LinkForces;
use flight_core::control::law::momentum::{AeroFeedback, MomentumModel};
use flight_core::dynamics::{Dynamics, MassFactor};
use flight_core::kinematics::Kinematics;
use nalgebra::DVector;
use std::hint::black_box;

const ROUNDS: usize = 300;

fn main() -> Result<(), BuildError> {
    let ticks = common::calm_ticks()?;
    let controller = common::controller(&common::configuration("test2")?)?;
    let robot = controller.model();
    let mut kinematics = Kinematics::new(robot);
    let mut dynamics = Dynamics::new(robot);
    report("kinematics", ROUNDS, &ticks, |tick| kinematics.update(robot, &tick.measurement.state));
    // The others at the last of these states.
    report("mass matrix, bias, momentum", ROUNDS, &ticks, |_| {
        dynamics.update(robot, &ticks[ticks.len() - 1].measurement.state, &kinematics);
    });
    let mut factor = MassFactor::new(kinematics.n_velocities());
    report("factor of the mass matrix", ROUNDS, &ticks, |_| {
        factor.factorise(black_box(&dynamics.mass_matrix))
    });
    let mut acceleration = DVector::zeros(kinematics.n_velocities());
    report("forward dynamics, given the factor", ROUNDS, &ticks, |_| {
        acceleration.fill(1.0);
        factor.solve_in_place(&mut acceleration);
    });
    let links = robot.aero_links.iter().map(|link| &link.frame);
    let frames: Vec<_> = links.chain(robot.jets.iter().map(|jet| &jet.frame)).collect();
    report("17 frame Jacobians, columns visited", ROUNDS, &ticks, |_| {
        let (mut sum, kinematics) = (0.0, black_box(&kinematics));
        for frame in &frames {
            let point = kinematics.frame_pose(frame).position;
            kinematics.visit_jacobian_columns(frame.body, &point, |_, linear, angular| {
                sum += linear.x + angular.x;
            });
        }
        sum
    });
    let (mut momentum, forces) = (MomentumModel::new(robot), LinkForces::new(robot));
    let feedback = AeroFeedback::default();
    report("A_T, Λ_T, Λ_a, momentum rate", ROUNDS, &ticks, |tick| {
        momentum.update(robot, &kinematics, &dynamics, &tick.measurement.thrust, &forces, &feedback);
    });
    Ok(())
}

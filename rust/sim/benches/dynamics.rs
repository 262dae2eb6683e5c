//! Each term of kinematics, dynamics and momentum of a tick, at states of the hovering robot.

mod common;

use criterion::Criterion;
use flight_core::BuildError;
use flight_core::aero::LinkForces;
use flight_core::control::config::AeroFeedback;
use flight_core::control::momentum::MomentumModel;
use flight_core::dynamics::{Dynamics, MassFactor};
use flight_core::kinematics::Kinematics;
use nalgebra::DVector;
use std::hint::black_box;
use std::time::Duration;

fn main() -> Result<(), BuildError> {
    let ticks = common::calm_ticks()?;
    let controller = common::controller(&common::configuration("test2")?)?;
    let robot = controller.model();
    let mut states = ticks.iter().cycle();
    let mut kinematics = Kinematics::new(robot);
    let mut dynamics = Dynamics::new(robot);

    let mut criterion = Criterion::default()
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1))
        .configure_from_args();
    let mut group = criterion.benchmark_group("dynamics");
    group.bench_function("kinematics", |b| {
        b.iter(|| states.next().map(|tick| kinematics.update(robot, black_box(&tick.state))));
    });
    let state = &ticks[0].state;
    kinematics.update(robot, state);
    group.bench_function("mass matrix, bias, momentum", |b| {
        b.iter(|| dynamics.update(robot, black_box(state), &kinematics));
    });
    let mut factor = MassFactor::new(state.velocity.len());
    group.bench_function("factor of the mass matrix", |b| {
        b.iter(|| factor.factorise(black_box(&dynamics.mass_matrix)));
    });
    let mut acceleration = DVector::from_element(state.velocity.len(), 1.0);
    group.bench_function("forward dynamics, given the factor", |b| {
        b.iter(|| {
            acceleration.fill(1.0);
            factor.solve_in_place(black_box(&mut acceleration));
        });
    });
    let frames =
        || robot.aero_links.iter().map(|link| &link.frame).chain(robot.jets.iter().map(|jet| &jet.frame));
    group.bench_function("17 frame Jacobians, columns visited", |b| {
        b.iter(|| {
            let mut sum = 0.0;
            for frame in frames() {
                let point = kinematics.frame_pose(frame).position;
                kinematics.visit_jacobian_columns(frame.body, &point, |_, linear, angular| {
                    sum += linear.x + angular.x;
                });
            }
            sum
        });
    });
    let mut momentum = MomentumModel::new(robot);
    let forces = LinkForces::new(robot);
    group.bench_function("A_T, Λ_T, Λ_a, momentum rate", |b| {
        b.iter(|| {
            momentum.update(
                robot,
                &kinematics,
                &dynamics,
                &ticks[0].thrust,
                &forces,
                &AeroFeedback::default(),
            );
        });
    });
    group.finish();
    criterion.final_summary();
    Ok(())
}

//! Aerodynamic forces on the 13 links: both models alone, and with the placing of the links.

mod common;

use criterion::Criterion;
use flight_core::BuildError;
use flight_core::aero::{AeroModel, LinkConventions, LinkForces};
use flight_core::kinematics::Kinematics;
use std::hint::black_box;
use std::time::Duration;

fn main() -> Result<(), BuildError> {
    let ticks = common::calm()?;
    let tick = &ticks[0];
    let config = common::configuration("robustness_axisymmetric_vs_sphere_cylinder")?;
    let controller = common::controller(&config)?;
    let robot = controller.robot();
    let mut kinematics = Kinematics::new(robot);
    kinematics.update(robot, &tick.state);
    let mut links = LinkForces::new(robot);

    let mut criterion = Criterion::default()
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1))
        .configure_from_args();
    let mut group = criterion.benchmark_group("aero");
    // That flight simulates one model and compensates the other.
    let models = [("axisymmetric", &config.simulator.aero), ("sphere and cylinder", &config.controller.aero)];
    for (name, config) in models {
        let model = AeroModel::new(config, &robot.aero_links)?;
        let conventions = LinkConventions::default();
        group.bench_function(format!("{name}, links placed"), |b| {
            b.iter(|| links.update(robot, &kinematics, conventions, &model, black_box(&tick.wind)));
        });
        let (axes, v_air) = (links.axes_i.clone(), links.v_air_i.clone());
        group.bench_function(name, |b| {
            b.iter(|| model.link_forces(black_box(&axes), black_box(&v_air), &mut links.forces_i));
        });
    }
    group.finish();
    criterion.final_summary();
    Ok(())
}

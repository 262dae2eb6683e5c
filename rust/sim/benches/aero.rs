//! Aerodynamic forces on the 13 links: analytic models alone and with the kinematics of the links,
//! networks with these kinematics.

mod common;
#[path = "../tests/common/network.rs"]
mod network;

use criterion::Criterion;
use flight_core::aero::{LinkConventions, LinkForces, LinksInAir, Precision};
use flight_core::kinematics::Kinematics;
use flight_io::{AeroConfig, load_aero};
use std::hint::black_box;
use std::time::Duration;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let ticks = common::calm_ticks()?;
    let tick = &ticks[0];
    let config = common::configuration("robustness_axisymmetric_vs_sphere_cylinder")?;
    let controller = common::controller(&config)?;
    let robot = controller.model();
    let mut kinematics = Kinematics::new(robot);
    kinematics.update(robot, &tick.state);
    let mut links = LinkForces::new(robot);
    let conventions = LinkConventions::default();

    let mut criterion = Criterion::default()
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1))
        .configure_from_args();
    let mut group = criterion.benchmark_group("aero");
    // This flight simulates one model and controls with the other.
    let models = [("axisymmetric", &config.simulator.aero), ("sphere and cylinder", &config.controller.aero)];
    for (name, config) in models {
        let mut model = load_aero(config, robot)?;
        group.bench_function(format!("{name}, links placed"), |b| {
            b.iter(|| links.update(robot, &kinematics, conventions, &mut model, black_box(&tick.wind)));
        });
        let (axes, v_air) = (links.axes_i.clone(), links.v_air_i.clone());
        group.bench_function(name, |b| {
            let placed = LinksInAir {
                robot,
                kinematics: &kinematics,
                axes_i: &axes,
                v_air_i: &v_air,
                wind_i: &tick.wind,
            };
            b.iter(|| model.link_forces(black_box(&placed), &mut links.forces_i));
        });
    }
    let shipped = common::configuration("test4")?.simulator.aero;
    // The cost of a network depends on its shape, not on its weights, so the other networks have
    // random weights.
    let folder = tempfile::tempdir()?;
    let random = |name, hidden, precision| {
        network::random_network(folder.path(), robot, &network::paper(hidden), name, precision)
    };
    for precision in [Precision::F32, Precision::F64] {
        let mut shipped = shipped.clone();
        if let AeroConfig::Network(network) = &mut shipped {
            network.precision = precision;
        }
        let networks = [
            ("shipped", shipped),
            ("256 x 3", random("256 x 3", &[256; 3], precision)),
            ("1024 x 10 (paper)", random("1024 x 10 (paper)", &[1024; 10], precision)),
        ];
        for (name, config) in networks {
            let mut model = load_aero(&config, robot)?;
            group.bench_function(format!("network {name}, {precision:?}, links placed"), |b| {
                b.iter(|| links.update(robot, &kinematics, conventions, &mut model, black_box(&tick.wind)));
            });
        }
    }
    group.finish();
    criterion.final_summary();
    Ok(())
}

//! Aerodynamic forces on the 13 links: analytic models alone and with the kinematics of the links,
//! networks with these kinematics; output as by `common::report`.

mod common;
#[path = "../tests/common/network.rs"]
mod network;

use common::report;
use flight_core::aero::{LinkConventions, LinkForces, LinksInAir, Precision};
use flight_core::kinematics::Kinematics;
use flight_io::{AeroConfig, load_aero};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let ticks = common::calm_ticks()?;
    let config = common::configuration("robustness_axisymmetric_vs_sphere_cylinder")?;
    let controller = common::controller(&config)?;
    let robot = controller.model();
    let mut kinematics = Kinematics::new(robot);
    kinematics.update(robot, &ticks[0].measurement.state);
    let mut links = LinkForces::new(robot);
    let conventions = LinkConventions::default();

    // This flight simulates one model and controls with the other.
    let models = [("axisymmetric", &config.simulator.aero), ("sphere and cylinder", &config.controller.aero)];
    for (name, config) in models {
        let mut model = load_aero(config, robot)?;
        report(&format!("{name}, links placed"), 300, &ticks, |tick| {
            links.update(robot, &kinematics, conventions, &mut model, &tick.measurement.wind);
        });
        let (axes_i, v_air_i) = (&links.axes_i.clone(), &links.v_air_i.clone());
        report(name, 300, &ticks, |tick| {
            let placed = LinksInAir {
                robot,
                kinematics: &kinematics,
                axes_i,
                v_air_i,
                wind_i: &tick.measurement.wind,
            };
            model.link_forces(&placed, &mut links.forces_i);
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
            ("shipped", 200, shipped),
            ("256 x 3", 200, random("256 x 3", &[256; 3], precision)),
            ("1024 x 10 (paper)", 5, random("1024 x 10 (paper)", &[1024; 10], precision)),
        ];
        for (name, rounds, config) in networks {
            let mut model = load_aero(&config, robot)?;
            report(&format!("network {name}, {precision:?}, links placed"), rounds, &ticks, |tick| {
                links.update(robot, &kinematics, conventions, &mut model, &tick.measurement.wind);
            });
        }
    }
    Ok(())
}

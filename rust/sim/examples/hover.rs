//! The controller in a loop of your own: hovers for five seconds beside its own simulated robot.
//!
//! On a real robot `Plant` is replaced by sensors and actuators; `Controller::tick` stays as it is.
//!
//! ```text
//! cargo run --release --example hover
//! ```

use flight_core::Measurement;
use flight_io::{load_controller, load_robot};
use flight_sim::{Plant, load_scenario};
use nalgebra::Vector3;
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/experiments/test2.toml");
    let config = load_scenario(&file)?;
    let robot = load_robot(&config.robot)?;
    let time_step = config.simulator.time_step;
    let mut plant = Plant::new(robot.clone(), &config.simulator, &config.disturbances)?;
    let mut controller = load_controller(robot, &config.controller, &config.mission, time_step)?;
    let still_air = Vector3::zeros();
    let mut state = {
        let thrust = plant.jets().thrust_feedback();
        let wind = still_air;
        controller.start(&Measurement {
            time: 0.0,
            state: plant.state(),
            thrust,
            wind,
            foot_wrenches: &[],
        })?
    };

    for tick in 0..=500 {
        let time = f64::from(tick) * time_step;
        plant.observe(&still_air);
        let thrust = plant.jets().thrust_feedback();
        let wind = still_air;
        let measurement = Measurement { time, state: plant.state(), thrust, wind, foot_wrenches: &[] };
        let command = controller.tick(&mut state, &measurement);
        if tick % 50 == 0 {
            println!("{time:.1} s: height {:.3} m, thrust {thrust:6.1?} N", plant.kinematics().com.z);
        }
        // The command holds until the next tick.
        let (torque, thrust_rate) = (command.joint_torque.as_slice(), command.thrust_rate.as_slice());
        plant.advance(torque, thrust_rate, &still_air, time_step);
    }
    Ok(())
}

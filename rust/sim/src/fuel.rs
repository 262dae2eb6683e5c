//! Fuel that leaves the robot as its jets burn it: mass, centre of mass and inertia of a body change along a flight.
//!
//! ```text
//! ṁ_f = −Σ_i (c_0 + c_1 T_i)        a body loses a point mass in its tank
//! ```
//!
//! Equation M154 of `docs/model`.

use flight_core::error::{BuildError, check, place_of};
use flight_core::robot::{Body, RobotModel};
use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Fuel of the simulated robot; the robot's file has the mass at the start.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FuelConfig {
    /// Fuel at the start \[kg\]; when it is burned the mass stays, and the jets go on.
    #[schemars(range(min = 0))]
    pub mass: f64,
    /// Name of the body that has the tank.
    pub body: String,
    /// Position of the tank in its axes \[m\].
    #[schemars(inner(range(min = -10, max = 10)))]
    pub position: [f64; 3],
    /// Consumption of a jet without thrust, `c_0` \[kg/s\].
    #[schemars(range(min = 0))]
    pub idle: f64,
    /// Consumption by thrust, `c_1` \[kg/(N s)\].
    #[schemars(range(min = 0))]
    pub by_thrust: f64,
}

impl FuelConfig {
    /// Checks that every value is in its range and that the body of `robot` has an inertia without the fuel.
    ///
    /// # Errors
    /// [`BuildError`] naming the key.
    pub fn check(&self, robot: &RobotModel) -> Result<(), BuildError> {
        flight_core::schema::check(self, "simulator.fuel")?;
        let full = &robot.bodies[self.place(robot)?];
        let expected =
            format!("0 kg to less than the {:.3} kg of the body, with an inertia without it", full.mass);
        let is_held = |mass: f64| {
            (0.0..full.mass).contains(&mass) && {
                let inertia = without(full, mass, &Vector3::from(self.position)).2;
                let least = inertia.symmetric_eigenvalues().min();
                least > 0.0 && inertia.trace() > 2.0 * inertia.symmetric_eigenvalues().max()
            }
        };
        check("simulator.fuel.mass", self.mass, is_held, &expected).map(|_| ())
    }

    fn place(&self, robot: &RobotModel) -> Result<usize, BuildError> {
        place_of("simulator.fuel.body", &self.body, robot.bodies.iter().map(|body| &body.name))
    }
}

/// Mass \[kg\], centre of mass \[m\] and inertia about it \[kg m²\] of a full body without a point mass at `at_b`.
fn without(full: &Body, burned: f64, at_b: &Vector3<f64>) -> (f64, Vector3<f64>, Matrix3<f64>) {
    let mass = full.mass - burned;
    let com = (full.com_b * full.mass - at_b * burned) / mass;
    // I_c = Σ m (|r|² 1 − r rᵀ) about the body's origin, less that of the mass at c.
    let about =
        |mass: f64, r: &Vector3<f64>| mass * (Matrix3::identity() * r.norm_squared() - r * r.transpose());
    let inertia = full.inertia_b + about(full.mass, &full.com_b) - about(burned, at_b) - about(mass, &com);
    (mass, com, inertia)
}

/// Fuel of a flight.
#[derive(Debug, Clone)]
pub struct Fuel {
    config: FuelConfig,
    /// Index of the body that has the tank.
    place: usize,
    /// This body with a full tank.
    full: Body,
    /// \[kg\].
    burned: f64,
}

impl Fuel {
    /// A full tank in `robot`; the numbers of `config` are checked.
    ///
    /// # Errors
    /// [`BuildError`] if the robot has no such body.
    pub fn new(config: &FuelConfig, robot: &RobotModel) -> Result<Self, BuildError> {
        let place = config.place(robot)?;
        Ok(Self { config: config.clone(), place, full: robot.bodies[place].clone(), burned: 0.0 })
    }

    /// Burns what jets with these thrusts \[N\] take in `dt` \[s\], and takes it from `robot`.
    pub fn burn(&mut self, thrust: &[f64], dt: f64, robot: &mut RobotModel) {
        let rate: f64 = thrust.iter().map(|thrust| self.config.idle + self.config.by_thrust * thrust).sum();
        self.burned = (self.burned + dt * rate).min(self.config.mass);
        let body = &mut robot.bodies[self.place];
        (body.mass, body.com_b, body.inertia_b) =
            without(&self.full, self.burned, &Vector3::from(self.config.position));
    }
}

//! Errors of the controller's model of the robot.

use flight_core::BuildError;
use flight_core::robot::RobotModel;
use flight_core::spatial::exp_so3;
use nalgebra::{Rotation3, Vector3};
use serde::{Deserialize, Serialize};

/// Differences between the controller's robot and the simulated one; none by default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ModelError {
    /// Factor on all masses and inertias of the controller's robot.
    #[schemars(range(min = 0.01, max = 100))]
    pub mass_scale: f64,
    /// Factor on all inertias about the bodies' own centres of mass, beside that of the masses.
    #[schemars(range(min = 0.01, max = 100))]
    pub inertia_scale: f64,
    /// Rotation of each jet's axis in the controller's robot, in the robot's order \[rad, axes of the jet's frame\]; none if
    /// empty.
    #[schemars(inner(inner(range(min = -1, max = 1))))]
    pub thrust_axes: Vec<[f64; 3]>,
    /// Offset of the base body's centre of mass in the controller's robot \[m, base axes\].
    #[schemars(inner(range(min = -10, max = 10)))]
    pub com_offset: [f64; 3],
    /// Whether the simulated robot has these errors, and the controller's is that of the file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub of_plant: Option<bool>,
}

impl Default for ModelError {
    fn default() -> Self {
        Self {
            mass_scale: 1.0,
            inertia_scale: 1.0,
            thrust_axes: Vec::new(),
            com_offset: [0.0; 3],
            of_plant: None,
        }
    }
}

impl ModelError {
    /// Checks that every value is in its range.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check(&self, jets: usize) -> Result<(), BuildError> {
        flight_core::schema::check(self, "disturbances.model_error")?;
        if !self.thrust_axes.is_empty() && self.thrust_axes.len() != jets {
            return Err(BuildError::bad_value(
                "length of disturbances.model_error.thrust_axes",
                self.thrust_axes.len(),
                format!("{jets}, one rotation for each jet, or none"),
            ));
        }
        Ok(())
    }

    /// Returns the robot with these errors.
    #[must_use]
    pub fn apply(&self, mut robot: RobotModel) -> RobotModel {
        for body in &mut robot.bodies {
            body.mass *= self.mass_scale;
            body.inertia_b *= self.mass_scale * self.inertia_scale;
        }
        for (jet, turn) in robot.jets.iter_mut().zip(&self.thrust_axes) {
            jet.axis_f = Rotation3::from_matrix_unchecked(exp_so3(&Vector3::from(*turn))) * jet.axis_f;
        }
        if let Some(base) = robot.bodies.first_mut() {
            base.com_b += Vector3::from(self.com_offset);
        }
        robot
    }
}

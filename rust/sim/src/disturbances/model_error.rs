//! Errors of the controller's model of the robot.

use flight_core::error::{BuildError, check};
use flight_core::robot::RobotModel;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Differences between the controller's robot and the simulated one; none by default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ModelError {
    /// Factor on all masses and inertias of the controller's robot.
    #[schemars(range(min = 0.01, max = 100))]
    pub mass_scale: f64,
    /// Offset of the base body's centre of mass in the controller's robot \[m, base axes\].
    #[schemars(inner(range(min = -10, max = 10)))]
    pub com_offset: [f64; 3],
}

impl Default for ModelError {
    fn default() -> Self {
        Self { mass_scale: 1.0, com_offset: [0.0; 3] }
    }
}

impl ModelError {
    /// Checks that every value is in its range.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check(&self) -> Result<(), BuildError> {
        let expected = "a factor from 0.01 to 100";
        check(
            "disturbances.model_error.mass_scale",
            self.mass_scale,
            |x| (0.01..=100.0).contains(&x),
            expected,
        )?;
        for offset in self.com_offset {
            check(
                "disturbances.model_error.com_offset",
                offset,
                |x| x.abs() <= 10.0,
                "three numbers up to 10 m",
            )?;
        }
        Ok(())
    }

    /// Returns the robot with these errors.
    #[must_use]
    pub fn apply(&self, mut robot: RobotModel) -> RobotModel {
        for body in &mut robot.bodies {
            body.mass *= self.mass_scale;
            body.inertia_b *= self.mass_scale;
        }
        if let Some(base) = robot.bodies.first_mut() {
            base.com_b += Vector3::from(self.com_offset);
        }
        robot
    }
}

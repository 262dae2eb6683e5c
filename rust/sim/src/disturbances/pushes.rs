//! Pushes: forces and moments on bodies of the simulated robot, each for a time.
//!
//! ```text
//! w = Σ_i σ_i Jᵀ (f_i, μ_i),   σ_i = |[t, t + Δt] ∩ [t_i, t_i + d_i]| / Δt
//! ```
//!
//! Equation M155 of `docs/model`.

use flight_core::error::{BuildError, place_of};
use flight_core::kinematics::Kinematics;
use flight_core::robot::RobotModel;
use flight_core::spatial::stack;
use nalgebra::{DVector, Vector6};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A force and a moment that act on a body for a time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Push {
    /// Name of the body.
    pub body: String,
    /// Force at the body's centre of mass \[N, inertial axes\].
    #[serde(default)]
    pub force: [f64; 3],
    /// Moment \[N m, inertial axes\].
    #[serde(default)]
    pub moment: [f64; 3],
    /// Time from which it acts \[s\], also between two ticks.
    #[schemars(range(min = 0))]
    pub start: f64,
    /// Time for which it acts \[s\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub duration: f64,
}

impl Push {
    /// Checks the values of the push at `index` of the list, and returns the index of its body.
    ///
    /// # Errors
    /// [`BuildError`] naming the key, its value and what was expected.
    fn check(&self, index: usize, robot: &RobotModel) -> Result<usize, BuildError> {
        let table = format!("disturbances.pushes[{index}]");
        flight_core::schema::check(self, &table)?;
        place_of(format!("{table}.body"), &self.body, robot.bodies.iter().map(|body| &body.name))
    }
}

#[derive(Debug, Clone)]
struct Acting {
    body: usize,
    /// Force and moment \[N, N m, inertial axes\].
    wrench: Vector6<f64>,
    /// Time until the start \[s\]; negative after it.
    left: f64,
    duration: f64,
}

/// State of the pushes.
#[derive(Debug, Clone)]
pub struct Pushes(Vec<Acting>);

impl Pushes {
    /// Checks the pushes and prepares them for `robot`.
    ///
    /// # Errors
    /// [`BuildError`] naming the key, its value and what was expected.
    pub fn new(pushes: &[Push], robot: &RobotModel) -> Result<Self, BuildError> {
        let acting = |(index, push): (usize, &Push)| {
            let wrench = stack(&push.force.into(), &push.moment.into());
            Ok(Acting { body: push.check(index, robot)?, wrench, left: push.start, duration: push.duration })
        };
        Ok(Self(pushes.iter().enumerate().map(acting).collect::<Result<_, _>>()?))
    }

    /// Adds their mean generalised force over the next `step` \[s\], after which the next one begins.
    pub fn add(
        &mut self,
        robot: &RobotModel,
        kinematics: &Kinematics,
        step: f64,
        generalised: &mut DVector<f64>,
    ) {
        for push in &mut self.0 {
            let acts = (push.left + push.duration).min(step) - push.left.max(0.0);
            push.left -= step;
            if acts > 0.0 {
                let centre = robot.bodies[push.body].com_b;
                let point = kinematics.bodies[push.body].i_from_b.transform_point(&centre);
                let mean = push.wrench * (acts / step);
                kinematics.add_generalised_wrench(push.body, &point, &mean, generalised);
            }
        }
    }
}

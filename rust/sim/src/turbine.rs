//! A network's table of a turbine: thrust rates by thrust and throttle, M175 of `docs/model`.

use flight_core::error::BuildError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Thrust rates at thrusts and throttles, of which some are extrapolated; linear between them, constant beyond.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TurbineConfig {
    /// Thrusts \[N\], ascending.
    pub thrust: Vec<f64>,
    /// Throttles \[%\], ascending.
    pub throttle: Vec<f64>,
    /// Thrust rates \[N/s\], a row for each throttle with an entry for each thrust.
    pub rate: Vec<Vec<f64>>,
}

impl TurbineConfig {
    /// Checks the sizes of the map and the order of its thrusts and throttles.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check(&self) -> Result<(), BuildError> {
        flight_core::schema::check(self, "simulator.jets")?;
        let refuse = |key: &str, value: String, expected: String| {
            Err(BuildError::bad_value(format!("simulator.jets.{key}"), value, expected))
        };
        for (key, values) in [("thrust", &self.thrust), ("throttle", &self.throttle)] {
            let ascends = values.windows(2).all(|pair| pair[0] < pair[1]);
            if values.len() < 2 || !ascends {
                return refuse(key, format!("{values:?}"), "two ascending numbers or more".to_owned());
            }
        }
        let is_of_thrusts = |row: &Vec<f64>| row.len() == self.thrust.len();
        if self.rate.len() != self.throttle.len() || !self.rate.iter().all(is_of_thrusts) {
            let expected =
                format!("{} rows, one per throttle, of {} numbers", self.throttle.len(), self.thrust.len());
            return refuse("rate", format!("{} rows", self.rate.len()), expected);
        }
        Ok(())
    }

    /// Throttle \[%\] and thrust rate \[N/s\] nearest to a commanded rate at a thrust \[N\]; of several throttles, the
    /// greatest.
    #[must_use]
    pub fn nearest(&self, thrust: f64, command: f64) -> (f64, f64) {
        let above = self.thrust.partition_point(|known| *known <= thrust).clamp(1, self.thrust.len() - 1);
        let (low, high) = (self.thrust[above - 1], self.thrust[above]);
        let share = ((thrust - low) / (high - low)).clamp(0.0, 1.0);
        let rate = |row: usize| {
            self.rate[row][above - 1] + share * (self.rate[row][above] - self.rate[row][above - 1])
        };
        let mut best = (self.throttle[0], rate(0));
        for row in 1..self.throttle.len() {
            let (from, to) = (rate(row - 1), rate(row));
            let rise = to - from;
            let part = if rise.abs() > 0.0 { ((command - from) / rise).clamp(0.0, 1.0) } else { 1.0 };
            let found = from + part * rise;
            if (found - command).abs() <= (best.1 - command).abs() {
                let throttle = self.throttle[row - 1] + part * (self.throttle[row] - self.throttle[row - 1]);
                best = (throttle, found);
            }
        }
        best
    }
}

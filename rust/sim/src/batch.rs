//! Batches of flights on several threads.

use crate::config::ScenarioConfig;
use crate::flight::Flight;
use crate::outcome::FlightResult;
use crate::scenario::{NoResult, Scenario};
use flight_core::error::BuildError;
use flight_core::robot::RobotModel;
use flight_io::load_robot;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;
use std::path::Path;

/// Reason why a batch has no results.
#[derive(Debug, thiserror::Error)]
pub enum BatchError {
    /// The configuration with this index could not be built, or its flight cannot begin.
    #[error("flight {0} of the batch: {1}")]
    Refused(usize, BuildError),
    /// The batch was stopped.
    #[error("interrupted")]
    Interrupted,
    /// No threads could be started.
    #[error("cannot start threads: {0}")]
    NoThreads(String),
}

/// Flies every configuration, `threads` at a time (`None`: one per core), and returns what `reduce` makes of the
/// results. They are in the order of the configurations and do not depend on the number of threads, because flights
/// share no data.
///
/// Every robot is read once, and every flight built once: all of them before the first flies, so that an invalid one
/// costs no flight. `go_on` is called before each is built and in every tick, and can stop the batch.
///
/// # Errors
/// [`BatchError::Refused`] for the first configuration that cannot be built or whose flight cannot begin, [`BatchError::Interrupted`] if `go_on`
/// breaks, [`BatchError::NoThreads`].
pub fn fly_batch<T: Send>(
    configs: &[ScenarioConfig],
    threads: Option<usize>,
    go_on: impl Fn() -> ControlFlow<()> + Sync,
    reduce: impl Fn(FlightResult) -> T + Sync,
) -> Result<Vec<T>, BatchError> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0)).build();
    let pool = pool.map_err(|error| BatchError::NoThreads(error.to_string()))?;
    let robots = read_robots(configs);
    let build = |(index, config): (usize, &ScenarioConfig)| {
        if go_on().is_break() {
            return Err(BatchError::Interrupted);
        }
        let robot = robots.get(config.robot.as_path());
        robot
            .map_or_else(|| Scenario::new(config), |robot| Scenario::with_robot(config, robot.clone()))
            .map_err(|reason| BatchError::Refused(index, reason))
    };
    let fly = |(index, scenario): (usize, Scenario)| {
        let result = scenario.run(|_, _| go_on()).map_err(|reason| match reason {
            NoResult::Interrupted => BatchError::Interrupted,
            NoResult::Refused(why) => {
                BatchError::Refused(index, BuildError::malformed("first measurement", why))
            }
        })?;
        Ok(reduce(result))
    };
    pool.install(|| {
        let built: Vec<_> = configs.par_iter().enumerate().map(build).collect();
        let built: Vec<Scenario> = built.into_iter().collect::<Result<_, _>>()?; // the first that is refused
        built.into_par_iter().enumerate().map(fly).collect()
    })
}

/// Reads each robot of a batch once. One that cannot be read is left out: the first of its flights says why.
fn read_robots(configs: &[ScenarioConfig]) -> BTreeMap<&Path, RobotModel> {
    let paths: BTreeSet<&Path> = configs.iter().map(|config| config.robot.as_path()).collect();
    paths.into_iter().filter_map(|path| Some((path, load_robot(path).ok()?))).collect()
}

/// Does something with each flight, on as many threads as there are cores; the answers are in the order of the flights.
pub fn with_each<T: Send>(
    flights: &mut [&mut Flight],
    act: impl Fn(usize, &mut Flight) -> T + Sync,
) -> Vec<T> {
    flights.par_iter_mut().enumerate().map(|(index, flight)| act(index, flight)).collect()
}

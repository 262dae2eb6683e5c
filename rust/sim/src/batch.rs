//! Batches of flights on several threads.

use crate::config::ScenarioConfig;
use crate::flight::Flight;
use crate::outcome::FlightResult;
use crate::scenario::{NoResult, Scenario};
use flight_core::error::BuildError;
use rayon::prelude::*;
use std::ops::ControlFlow;

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
/// All configurations are built before the first flies, so that an invalid one costs no flight. `go_on` is called in
/// every tick of every flight and can stop the batch.
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
    let build = |(index, config)| {
        if go_on().is_break() {
            return Err(BatchError::Interrupted);
        }
        Scenario::new(config).map_err(|reason| BatchError::Refused(index, reason))
    };
    let fly = |item: (usize, _)| {
        let result = build(item)?.run(|_, _| go_on()).map_err(|reason| match reason {
            NoResult::Interrupted => BatchError::Interrupted,
            NoResult::Refused(why) => {
                BatchError::Refused(item.0, BuildError::malformed("first measurement", why))
            }
        })?;
        Ok(reduce(result))
    };
    pool.install(|| {
        let numbered = || configs.par_iter().enumerate();
        numbered().find_map_first(|item| build(item).err()).map_or(Ok(()), Err)?;
        numbered().map(fly).collect()
    })
}

/// Does something with each flight, on as many threads as there are cores; the answers are in the order of the flights.
pub fn with_each<T: Send>(
    flights: &mut [&mut Flight],
    act: impl Fn(usize, &mut Flight) -> T + Sync,
) -> Vec<T> {
    flights.par_iter_mut().enumerate().map(|(index, flight)| act(index, flight)).collect()
}

//! Batches of flights on several threads.

use crate::config::ScenarioConfig;
use crate::log::FlightResult;
use crate::scenario::{Interrupted, Scenario};
use flight_core::error::BuildError;
use rayon::prelude::*;
use std::ops::ControlFlow;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Reason why a flight of a batch has no result.
#[derive(Debug, thiserror::Error)]
pub enum BatchError {
    /// Its configuration could not be built.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// The configuration with this index could not be built.
    #[error("flight {0} of the batch: {1}")]
    Refused(usize, BuildError),
    /// The batch was stopped.
    #[error("interrupted")]
    Interrupted,
    /// No threads could be started.
    #[error("cannot start threads: {0}")]
    NoThreads(String),
}

/// Builds every configuration without flying it, `threads` at a time, for a batch of which every flight is needed.
///
/// # Errors
/// [`BatchError::Refused`] for the first that cannot be built, [`BatchError::Interrupted`] if `go_on` breaks.
pub fn check_batch(
    configs: &[ScenarioConfig],
    threads: Option<usize>,
    go_on: impl Fn() -> ControlFlow<()> + Sync,
) -> Result<(), BatchError> {
    let check = |(index, config): (usize, &ScenarioConfig)| {
        if go_on().is_break() {
            return Some(BatchError::Interrupted);
        }
        Scenario::new(config).err().map(|reason| BatchError::Refused(index, reason))
    };
    let found = pool(threads)?.install(|| configs.par_iter().enumerate().find_map_first(check));
    found.map_or(Ok(()), Err)
}

/// Flies every configuration, `threads` at a time (`None`: one per core). Results are in the order of the
/// configurations and do not depend on the number of threads, because flights share no data.
///
/// `progress(done, total)` is called as flights end, in the thread of the flight and never concurrently; it can stop
/// the batch.
///
/// # Errors
/// [`BatchError::NoThreads`] for the whole batch; every flight has its own result.
pub fn fly_batch<T: Send>(
    configs: &[ScenarioConfig],
    threads: Option<usize>,
    reduce: impl Fn(FlightResult) -> T + Sync,
    progress: impl FnMut(usize, usize) -> ControlFlow<()> + Send,
) -> Result<Vec<Result<T, BatchError>>, BatchError> {
    let pool = pool(threads)?;
    let (done, stop) = (AtomicUsize::new(0), AtomicBool::new(false));
    let progress = Mutex::new(progress);
    let go_on =
        || if stop.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
    let fly = |config: &ScenarioConfig| {
        if go_on().is_break() {
            return Err(BatchError::Interrupted);
        }
        let flight = Scenario::new(config).map_err(BatchError::Build)?;
        let result = flight.run(|_, _| go_on()).map_err(|Interrupted| BatchError::Interrupted)?;
        let result = reduce(result);
        let count = done.fetch_add(1, Ordering::Relaxed) + 1;
        if let Ok(mut progress) = progress.lock()
            && progress(count, configs.len()).is_break()
        {
            stop.store(true, Ordering::Relaxed);
        }
        Ok(result)
    };
    Ok(pool.install(|| configs.par_iter().map(fly).collect()))
}

fn pool(threads: Option<usize>) -> Result<rayon::ThreadPool, BatchError> {
    let builder = rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0));
    builder.build().map_err(|error| BatchError::NoThreads(error.to_string()))
}

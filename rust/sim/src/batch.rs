//! Batches of flights on several threads.

use crate::config::ScenarioConfig;
use crate::outcome::FlightResult;
use crate::scenario::{NoResult, Scenario};
use flight_core::error::BuildError;
use std::num::NonZero;
use std::ops::ControlFlow;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::{Builder, available_parallelism, scope};

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
    NoThreads(#[from] std::io::Error),
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
    let threads = threads.map_or_else(|| available_parallelism().map(NonZero::get), Ok)?.max(1);
    let build = |index: usize| {
        if go_on().is_break() {
            return Err(BatchError::Interrupted);
        }
        Scenario::new(&configs[index]).map_err(|reason| BatchError::Refused(index, reason))
    };
    let fly = |index| {
        let result = build(index)?.run(|_, _| go_on()).map_err(|reason| match reason {
            NoResult::Interrupted => BatchError::Interrupted,
            NoResult::Refused(why) => {
                BatchError::Refused(index, BuildError::malformed("first measurement", why))
            }
        })?;
        Ok(reduce(result))
    };
    in_parallel(configs.len(), threads, |index| build(index).map(|_| ()))?;
    in_parallel(configs.len(), threads, fly)
}

/// What `work` makes of the numbers below `count`, in their order, or the first error: after one no other number is begun.
fn in_parallel<T: Send>(
    count: usize,
    threads: usize,
    work: impl Fn(usize) -> Result<T, BatchError> + Sync,
) -> Result<Vec<T>, BatchError> {
    let next = AtomicUsize::new(0);
    let work_on = || {
        let mut done = Vec::new();
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= count {
                return done;
            }
            let made = work(index);
            if made.is_err() {
                next.store(count, Ordering::Relaxed);
            }
            done.push((index, made));
        }
    };
    let mut done = scope(|scope| {
        let start = |_| Builder::new().spawn_scoped(scope, work_on);
        let workers = (0..threads.min(count)).map(start).collect::<Result<Vec<_>, _>>();
        let workers = workers.inspect_err(|_| next.store(count, Ordering::Relaxed))?;
        let found =
            workers.into_iter().flat_map(|worker| worker.join().unwrap_or_else(|why| resume_unwind(why)));
        Ok::<_, BatchError>(found.collect::<Vec<_>>())
    })?;
    done.sort_unstable_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, made)| made).collect()
}

//! Ticks the controller through random flights and counts violations of its guarantees.
//!
//! ```text
//! cargo run --release --example soak -- --ticks 100000000                  # resumes where it was stopped
//! cargo run --release --example soak -- --ticks 1000000 --real-time        # SCHED_FIFO and locked memory, if allowed
//! cargo run --release --example soak -- --episode 4711                     # repeats one flight, tick by tick
//! ```
//!
//! Each flight depends on the seed and its number only. The state file is replaced as a whole every few seconds.

#![allow(unsafe_code, reason = "an allocator and the scheduler of the system")]
#![allow(clippy::unwrap_used, reason = "a measurement that cannot go on ends")]

#[path = "../tests/common/mod.rs"]
mod common;
#[path = "../tests/common/episode.rs"]
mod episode;

use common::counting::Counting;
use episode::{Episodes, Ticked};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::error::Error;
use std::fs::File;
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Ticks per flight.
const TICKS: u64 = 1000;

/// Greatest number of findings that are stored individually; the others are only counted.
const KEPT: usize = 1000;

/// Interval of writing the state file.
const PERIOD: Duration = Duration::from_secs(10);

/// Message of the last panic, for the report of its flight.
static PANIC: Mutex<String> = Mutex::new(String::new());

/// Histogram of tick durations with bins of a 32nd of an octave, 2 %.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Histogram {
    counts: BTreeMap<u32, u64>,
    worst_ns: u64,
    /// Flight and tick of the longest duration.
    worst_at: (u64, u64),
}

impl Histogram {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most 32 · 64")]
    fn add(&mut self, duration: Duration, at: (u64, u64)) {
        let ns = u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX);
        *self.counts.entry((32.0 * (ns.max(1) as f64).log2()) as u32).or_default() += 1;
        if ns > self.worst_ns {
            (self.worst_ns, self.worst_at) = (ns, at);
        }
    }

    fn ticks(&self) -> u64 {
        self.counts.values().sum()
    }

    /// Duration that the fraction `share` of the ticks does not exceed \[µs\].
    fn quantile(&self, share: f64) -> f64 {
        let mut left = share * self.ticks() as f64;
        for (step, count) in &self.counts {
            left -= *count as f64;
            if left <= 0.0 {
                return f64::from(step + 1).exp2().powf(1.0 / 32.0) / 1e3;
            }
        }
        self.worst_ns as f64 / 1e3
    }
}

/// A violation, with its flight and tick.
#[derive(Debug, Serialize, Deserialize)]
struct Event {
    episode: u64,
    tick: u64,
    what: String,
}

/// State of a run, stored in the file from which it resumes.
#[derive(Debug, Serialize, Deserialize)]
struct State {
    seed: u64,
    /// Flights started, and those whose configuration or first measurement was refused.
    episodes: u64,
    refused: u64,
    ticks: u64,
    /// Ticks by mode.
    modes: BTreeMap<String, u64>,
    /// Number of events by kind.
    found: BTreeMap<String, u64>,
    events: Vec<Event>,
    /// By the conditions of the measurement.
    durations: BTreeMap<String, Histogram>,
}

impl State {
    fn load(path: &Path, seed: u64) -> Result<Self, Box<dyn Error>> {
        if !path.exists() {
            let (episodes, refused, ticks) = (0, 0, 0);
            let (modes, found, events, durations) = Default::default();
            return Ok(Self { seed, episodes, refused, ticks, modes, found, events, durations });
        }
        let state: Self = serde_json::from_reader(File::open(path)?)?;
        if state.seed != seed {
            return Err(format!("{} is of seed {}, not {seed}", path.display(), state.seed).into());
        }
        Ok(state)
    }

    fn save(&self, path: &Path) -> Result<(), Box<dyn Error>> {
        let part = path.with_extension("part");
        let mut file = File::create(&part)?;
        file.write_all(serde_json::to_string_pretty(self)?.as_bytes())?;
        file.sync_all()?;
        std::fs::rename(&part, path)?;
        Ok(())
    }

    fn record_event(&mut self, episode: u64, tick: u64, kind: &str, detail: &str) {
        *self.found.entry(kind.to_owned()).or_default() += 1;
        if self.events.len() < KEPT {
            self.events.push(Event { episode, tick, what: format!("{kind}{detail}") });
        }
    }

    /// Flies one flight.
    fn fly(&mut self, episodes: &Episodes, conditions: &str, mut look: impl FnMut(u64, &Ticked)) {
        let number = self.episodes;
        self.episodes += 1;
        let mut tick = 0;
        let flown = catch_unwind(AssertUnwindSafe(|| {
            let Ok(mut episode) = episodes.draw(number) else {
                self.refused += 1;
                return;
            };
            // Added to the totals at the end of the flight.
            let mut modes = BTreeMap::<&str, u64>::new();
            while tick < TICKS {
                let ticked = episode.tick();
                look(tick, &ticked);
                for mode in ticked.modes.names() {
                    *modes.entry(mode).or_default() += 1;
                }
                if let Some(finding) = ticked.finding {
                    self.record_event(number, tick, &format!("{finding:?}"), "");
                }
                let durations = self.durations.get_mut(conditions).unwrap();
                durations.add(ticked.duration, (number, tick));
                tick += 1;
            }
            for (mode, count) in modes {
                *self.modes.entry(mode.to_owned()).or_default() += count;
            }
        }));
        self.ticks += tick;
        if flown.is_err() {
            let message = PANIC.lock().unwrap().clone();
            self.record_event(number, tick, "Panic", &format!(": {message}"));
        }
    }

    fn report(&self) {
        println!("ticks        {} in {} flights, {} refused", self.ticks, self.episodes, self.refused);
        for kind in ["Panic", "Allocation", "Uncertified", "NonFinite"] {
            println!("{kind:<12} {}", self.found.get(kind).unwrap_or(&0));
        }
        println!("modes        {:?}", self.modes);
        for (conditions, durations) in &self.durations {
            let (worst, (episode, tick)) = (durations.worst_ns as f64 / 1e3, durations.worst_at);
            println!(
                "{conditions}: {} ticks, p50 {:.1} µs, p99.9 {:.1} µs, worst {worst:.1} µs (flight {episode}, tick {tick})",
                durations.ticks(),
                durations.quantile(0.5),
                durations.quantile(0.999),
            );
        }
        for Event { episode, tick, what } in self.events.iter().take(20) {
            println!("flight {episode}, tick {tick}: {what}");
        }
    }
}

/// Requests locked memory and real-time priority; returns a description of what was granted.
fn request_real_time() -> String {
    // SAFETY: the calls access only the struct that is passed.
    let (locked, fifo) = unsafe {
        let priority = libc::sched_param { sched_priority: 80 };
        (
            libc::mlockall(libc::MCL_CURRENT | libc::MCL_FUTURE) == 0,
            libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const priority) == 0,
        )
    };
    let granted = |is_granted| if is_granted { "granted" } else { "refused" };
    format!("SCHED_FIFO {}, locked memory {}", granted(fifo), granted(locked))
}

fn main() -> Result<(), Box<dyn Error>> {
    let (mut seed, mut ticks, mut is_real_time, mut only) = (1, 1_000_000, false, None);
    let mut path = PathBuf::from("target/soak.json");
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{argument} needs a value"));
        match argument.as_str() {
            "--seed" => seed = value()?.parse()?,
            "--ticks" => ticks = value()?.parse()?,
            "--state" => path = value()?.into(),
            "--episode" => only = Some(value()?.parse()?),
            "--real-time" => is_real_time = true,
            _ => {
                return Err(format!(
                    "{argument} is none of --seed, --ticks, --state, --episode, --real-time"
                )
                .into());
            }
        }
    }
    set_hook(Box::new(|panic| *PANIC.lock().unwrap() = panic.to_string()));
    let episodes = Episodes::new(seed);
    let conditions = if is_real_time { request_real_time() } else { "ordinary priority".to_owned() };
    if let Some(number) = only {
        let mut state = State::load(Path::new(""), seed)?;
        (state.episodes, state.durations) = (number, [(conditions.clone(), Histogram::default())].into());
        state.fly(&episodes, &conditions, |tick, ticked| println!("{tick}: {ticked:?}"));
        state.report();
        return Ok(());
    }
    let mut state = State::load(&path, seed)?;
    state.durations.entry(conditions.clone()).or_default();
    let end = state.ticks + ticks;
    let mut saved = Instant::now();
    while state.ticks < end {
        state.fly(&episodes, &conditions, |_, _| ());
        if saved.elapsed() > PERIOD {
            state.save(&path)?;
            saved = Instant::now();
        }
    }
    state.save(&path)?;
    state.report();
    Ok(())
}

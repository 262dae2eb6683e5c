//! The way from a command to what executes it: delay, jitter, lost commands.
//!
//! ```text
//! command of a tick ──► lost? ──► delay + jitter ──► held until a later command arrives
//! ```
//!
//! Times are whole physics steps, so that a command acts from the beginning of a step. Equation M140 of `docs/model`.

use crate::noise::Noise;
use flight_core::error::{BuildError, Table};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Stream of the jitter and the losses.
const STREAM: u64 = 3;

/// Delay and loss of commands; all of them are whole physics steps, `time_step / substeps`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ActuationConfig {
    /// Time from a tick until its thrust rates act \[s\].
    #[schemars(range(min = 0, max = 1))]
    pub thrust_delay: f64,
    /// Time from a tick until its torques act \[s\].
    #[schemars(range(min = 0, max = 1))]
    pub torque_delay: f64,
    /// Greatest additional delay of both \[s\]; the one of a tick is drawn uniformly from zero to this.
    #[schemars(range(min = 0, max = 1))]
    pub jitter: f64,
    /// Share of the ticks whose command is lost; the last one that arrived is held.
    #[schemars(range(min = 0, max = 1))]
    pub drop: f64,
    /// Seed of jitter and losses.
    pub seed: u64,
}

impl ActuationConfig {
    /// Checks that every value is in its range, and every time a multiple of the physics step \[s\].
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check(&self, step: f64) -> Result<(), BuildError> {
        flight_core::schema::check(self, "simulator.actuation")?;
        let table = Table("simulator.actuation");
        for (key, time) in [
            ("thrust_delay", self.thrust_delay),
            ("torque_delay", self.torque_delay),
            ("jitter", self.jitter),
        ] {
            let expected =
                format!("a multiple of {step} s, the physics step controller.time_step / simulator.substeps");
            // Decimal fractions are not exact.
            let is_whole = |time: f64| (time / step - (time / step).round()).abs() <= 1e-6;
            table.check(key, time, is_whole, &expected)?;
        }
        Ok(())
    }
}

/// Commands of a robot on their way.
#[derive(Debug, Clone)]
pub struct Actuation {
    thrust_rate: Line,
    torque: Line,
    /// Greatest additional delay in steps.
    jitter: u32,
    drop: f64,
    noise: Noise,
    mean: Vec<f64>,
}

impl Actuation {
    /// Prepares the way to `jets` jets and `joints` joints, with ticks of `substeps` physics steps of `step` \[s\], in each
    /// of which torques are commanded `torque_steps` times.
    ///
    /// # Errors
    /// As [`ActuationConfig::check`].
    pub fn new(
        config: &ActuationConfig,
        step: f64,
        substeps: u32,
        torque_steps: u32,
        joints: usize,
        jets: usize,
    ) -> Result<Self, BuildError> {
        config.check(step)?;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // checked: 0 to 1 s
        let steps = |time: f64| (time / step).round() as u32;
        let jitter = steps(config.jitter);
        let line = |delay, every, size| Line::new(steps(delay), jitter, every, size);
        Ok(Self {
            thrust_rate: line(config.thrust_delay, substeps, jets),
            torque: line(config.torque_delay, substeps / torque_steps, joints),
            jitter,
            drop: config.drop,
            noise: Noise::new(config.seed, STREAM),
            mean: vec![0.0; jets],
        })
    }

    /// Sends the command of a tick. The first one acts at once and until another arrives. Does not allocate.
    pub fn send(&mut self, torque: &[f64], thrust_rate: &[f64]) {
        let late = self.draw();
        self.torque.send(torque, late);
        self.thrust_rate.send(thrust_rate, late);
    }

    /// Sends torques that are commanded between two ticks. Does not allocate.
    pub fn send_torque(&mut self, torque: &[f64]) {
        let late = self.draw();
        self.torque.send(torque, late);
    }

    /// Additional delay of a command in steps; `None` if it is lost.
    fn draw(&mut self) -> Option<u32> {
        let (loss, late) = (self.noise.uniform(), self.noise.uniform());
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // at most `jitter`
        let late = (late * (f64::from(self.jitter) + 1.0)) as u32;
        (loss >= self.drop).then_some(late)
    }

    /// Torques in sub-step number `substep` after they were commanded last, from zero.
    pub fn torque(&mut self, substep: u32) -> &[f64] {
        self.torque.acting(substep)
    }

    /// Mean of the thrust rates over the sub-steps of this tick: thrusts are integrated once per tick.
    pub fn thrust_rate(&mut self) -> &[f64] {
        let substeps = self.thrust_rate.substeps;
        self.mean.fill(0.0);
        for substep in 0..substeps {
            for (mean, rate) in self.mean.iter_mut().zip(self.thrust_rate.acting(substep)) {
                *mean += rate / f64::from(substeps);
            }
        }
        &self.mean
    }
}

/// Commands of one kind.
#[derive(Debug, Clone)]
struct Line {
    delay: u32,
    substeps: u32,
    /// Commands of the last ticks, the latest first, each with its delay in steps; `None` if it was lost. Long enough
    /// that every command arrives before it leaves.
    sent: Vec<(Option<u32>, Vec<f64>)>,
    /// The latest command that has arrived.
    held: Vec<f64>,
    is_begun: bool,
}

impl Line {
    fn new(delay: u32, jitter: u32, substeps: u32, size: usize) -> Self {
        let ticks = (delay + jitter) / substeps + 1;
        let sent = (0..ticks).map(|_| (None, vec![0.0; size])).collect();
        Self { delay, substeps, sent, held: vec![0.0; size], is_begun: false }
    }

    fn send(&mut self, command: &[f64], late: Option<u32>) {
        if !self.is_begun {
            self.held.copy_from_slice(command);
            self.is_begun = true;
        }
        self.sent.rotate_right(1);
        let (lag, latest) = &mut self.sent[0];
        *lag = late.map(|late| self.delay + late);
        latest.copy_from_slice(command);
    }

    /// The latest command that has arrived at sub-step `substep` of this tick.
    fn acting(&mut self, substep: u32) -> &[f64] {
        let ages = (substep..).step_by(self.substeps as usize);
        let arrived = ages.zip(&self.sent).find(|(age, (lag, _))| lag.is_some_and(|lag| lag <= *age));
        if let Some((_, (_, command))) = arrived {
            self.held.copy_from_slice(command);
        }
        &self.held
    }
}

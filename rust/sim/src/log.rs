//! The log of a flight: every signal at every tick.

use crate::signals::{Read, SIGNALS, Signal, TickRow, WorldRow};
use flight_core::error::{BuildError, Table};
use flight_core::robot::RobotModel;

/// Greatest size of a log in memory \[bytes\].
const MAX_LOG: usize = 2 << 30;

/// Values of one signal: one row of `width` numbers for each tick, contiguous.
#[derive(Debug, Clone)]
pub struct Series {
    /// Declaration of the signal.
    pub signal: &'static Signal,
    /// Shape of one row.
    pub row_shape: Vec<usize>,
    /// All rows.
    pub data: Vec<f64>,
}

impl PartialEq for Series {
    fn eq(&self, other: &Self) -> bool {
        // What is not known is NaN in either.
        let is_equal = |(a, b): (&f64, &f64)| a == b || (a.is_nan() && b.is_nan());
        self.signal.name == other.signal.name
            && self.row_shape == other.row_shape
            && self.data.len() == other.data.len()
            && self.data.iter().zip(&other.data).all(is_equal)
    }
}

impl Series {
    /// Reserves memory for `n_ticks` rows.
    fn new(signal: &'static Signal, robot: &RobotModel, n_ticks: usize) -> Self {
        let row_shape = signal.row_shape(robot).collect();
        Self { signal, row_shape, data: Vec::with_capacity(signal.row_len(robot) * n_ticks) }
    }

    /// Numbers in one row.
    #[must_use]
    pub fn width(&self) -> usize {
        self.row_shape.iter().product()
    }

    /// Row of tick `tick`; empty if there is none.
    #[must_use]
    pub fn row(&self, tick: usize) -> &[f64] {
        let width = self.width();
        self.data.get(tick * width..(tick + 1) * width).unwrap_or(&[])
    }
}

/// The log of one flight: those signals of [`SIGNALS`] that have a row per tick here. SI units,
/// inertial axes, quaternions `wxyz`.
#[derive(Debug, Clone, PartialEq)]
pub struct FlightLog {
    /// All signals, in the order of [`SIGNALS`].
    pub series: Vec<Series>,
    /// Reference posture for joint errors \[rad\].
    pub joint_setpoint: Vec<f64>,
}

impl FlightLog {
    /// Checks that the log of a flight fits into memory; `duration` and `time_step` are in s.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the duration.
    pub fn check(robot: &RobotModel, duration: f64, time_step: f64) -> Result<(), BuildError> {
        let logged = SIGNALS.iter().filter(|signal| signal.read.is_some());
        let row: usize = logged.map(|signal| signal.row_len(robot) * size_of::<f64>()).sum();
        let most = (MAX_LOG / row) as f64 * time_step;
        let expected = format!("at most {most} s: the log of a longer flight exceeds 2 GiB");
        Table("simulator").check("duration", duration, |x| x <= most, &expected)
    }

    /// Reserves memory for `n_ticks` rows of a robot's signals in flight.
    #[must_use]
    pub fn new(robot: &RobotModel, n_ticks: usize) -> Self {
        Self::of(robot, n_ticks, |signal| !signal.is_of_ground)
    }

    /// As [`Self::new`], with those of the ground.
    #[must_use]
    pub fn with_ground(robot: &RobotModel, n_ticks: usize) -> Self {
        Self::of(robot, n_ticks, |_| true)
    }

    /// As [`Self::new`], for the signals of the controller alone; those of the ground only of one with feet.
    #[must_use]
    pub fn of_ticks(robot: &RobotModel, has_feet: bool, n_ticks: usize) -> Self {
        let is_logged = |signal: &Signal| {
            matches!(signal.read, Some(Read::Tick(_))) && (has_feet || !signal.is_of_ground)
        };
        Self::of(robot, n_ticks, is_logged)
    }

    fn of(robot: &RobotModel, n_ticks: usize, is_logged: impl Fn(&Signal) -> bool) -> Self {
        let logged = SIGNALS.iter().filter(|signal| signal.read.is_some() && is_logged(signal));
        let series = logged.map(|signal| Series::new(signal, robot, n_ticks)).collect();
        Self { series, joint_setpoint: Vec::new() }
    }

    /// Whether it has the signals of the ground.
    #[must_use]
    pub fn has_ground(&self) -> bool {
        self.series.iter().any(|series| series.signal.is_of_ground)
    }

    /// Number of rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.series("time").map_or(0, |time| time.data.len())
    }

    /// Whether there are no rows.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The signal of this name.
    #[must_use]
    pub fn series(&self, name: &str) -> Option<&Series> {
        self.series.iter().find(|series| series.signal.name == name)
    }

    /// Appends one row of every signal, or, without a world, of those of the controller.
    pub fn push(&mut self, tick: &TickRow, world: Option<&WorldRow>) {
        for series in &mut self.series {
            match (series.signal.read, world) {
                (Some(Read::Tick(read)), _) => read(tick, &mut series.data),
                (Some(Read::World(read)), Some(world)) => read(world, &mut series.data),
                _ => {}
            }
        }
    }
}

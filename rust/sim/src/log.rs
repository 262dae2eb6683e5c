//! The log of a flight: every signal at every tick.

use crate::plant::Plant;
use crate::scenario::{Loss, Outcome};
use crate::signals::{SIGNALS, Signal};
use crate::summary::Summary;
use flight_core::control::setpoint::Setpoint;
use flight_core::control::{Command, Terms};
use flight_core::qp::QpAnswer;
use flight_core::robot::RobotModel;
use nalgebra::Vector3;

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
        self.signal.name == other.signal.name && self.row_shape == other.row_shape && self.data == other.data
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

/// Values from which all signals of one tick are read.
pub struct LogRow<'a> {
    /// Time \[s\].
    pub time: f64,
    /// Velocity of the air \[m/s\].
    pub wind: Vector3<f64>,
    /// The simulated robot and its environment.
    pub plant: &'a Plant,
    /// The controller's intermediate values.
    pub terms: &'a Terms,
    /// The controller's command.
    pub command: &'a Command,
    /// Errors with respect to the set-point.
    pub errors: TrackingErrors,
}

impl LogRow<'_> {
    /// Answers of momentum QP and torque QP.
    pub(crate) fn qps(&self) -> [&QpAnswer; 2] {
        [&self.command.momentum_qp, &self.command.torque_qp]
    }
}

/// Errors of the robot with respect to its set-point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackingErrors {
    /// Angle between base and desired base \[rad\].
    pub rotation: f64,
    /// Distance of the centre of mass from its set-point \[m\].
    pub com: f64,
}

impl TrackingErrors {
    /// Errors of a plant with respect to a set-point.
    #[must_use]
    pub fn new(plant: &Plant, setpoint: &Setpoint) -> Self {
        let error = setpoint.rotation.transpose() * plant.state().base.rotation;
        Self {
            rotation: flight_core::spatial::rotation_angle(&error),
            com: (plant.kinematics().com - setpoint.com_position).norm(),
        }
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
    /// Reserves memory for `n_ticks` rows of a robot's signals.
    #[must_use]
    pub fn new(robot: &RobotModel, n_ticks: usize) -> Self {
        let logged = SIGNALS.iter().filter(|signal| signal.read.is_some());
        let series = logged.map(|signal| Series::new(signal, robot, n_ticks)).collect();
        Self { series, joint_setpoint: Vec::new() }
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

    /// Appends one row of every signal.
    pub fn push(&mut self, row: &LogRow) {
        for series in &mut self.series {
            if let Some(read) = series.signal.read {
                read(row, &mut series.data);
            }
        }
    }
}

/// A finished flight.
#[derive(Debug, Clone)]
pub struct FlightResult {
    /// Outcome of the flight.
    pub outcome: Outcome,
    /// Time and reason of an early end, if any.
    pub loss: Option<Loss>,
    /// All signals.
    pub log: FlightLog,
    /// Figures of merit, without the row in which a flight diverged.
    pub summary: Summary,
}

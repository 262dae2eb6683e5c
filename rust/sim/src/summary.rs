//! Figures of merit of a flight, each declared once: name, label, unit, meaning, and how it is computed.
//!
//! Equation M81 of `docs/model`.

use crate::log::{FlightLog, Series};
use crate::quantity::Quantity;
use crate::signals::{MODES, SIGNALS};
use flight_core::control::Modes;
use nalgebra::Vector3;
use std::cell::RefCell;
use std::collections::BTreeSet;

/// The declaration of a figure of merit.
pub type Figure = Quantity<fn(&Flown) -> f64>;

macro_rules! figures {
    ($($name:ident: $declared:expr;)*) => {
        /// Figures of merit of a flight. Each is NaN if a number from which it is computed is NaN, if a signal that it
        /// is computed from is not in the log, or if there is no tick to compute it from; for figures after settling,
        /// if the flight ended before.
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub struct Summary {
            $(#[doc = concat!("`", stringify!($name), "` of [`FIGURES`].")] pub $name: f64,)*
        }

        /// All figures of merit.
        pub const FIGURES: &[Figure] = &[$(Quantity { name: stringify!($name), ..$declared }),*];

        impl Summary {
            /// Figures of merit of the first `ticks` rows of a log.
            #[must_use]
            pub fn new(log: &FlightLog, ticks: usize) -> Self {
                let Some(flown) = Flown::new(log, ticks) else { return Self { $($name: f64::NAN),* } };
                let mut figures = FIGURES.iter();
                let mut next = || figures.next().map_or(f64::NAN, |figure| flown.figure(figure));
                Self { $($name: next()),* }
            }

            /// The figures, in the order of [`FIGURES`].
            fn values(&self) -> Vec<f64> {
                vec![$(self.$name),*]
            }
        }
    };
}

const fn figure(
    label: &'static str,
    unit: &'static str,
    meaning: &'static str,
    read: fn(&Flown) -> f64,
) -> Figure {
    Quantity::new("", &[], unit, meaning, read).label(label)
}

figures! {
    max_com_error: figure(
        "max CoM error", "m",
        "greatest distance of the centre of mass from its set-point after settling, until the robot descends",
        |of| greatest_of(of.com_distances()),
    ).shown("cm").tabled().error();
    max_com_error_x: figure(
        "max CoM error along x", "m", "greatest distance from the set-point along x after settling", |of| of.along(0),
    ).shown("cm").error();
    max_com_error_y: figure(
        "max CoM error along y", "m", "greatest distance from the set-point along y after settling", |of| of.along(1),
    ).shown("cm").error();
    max_com_error_z: figure(
        "max CoM error along z", "m", "greatest distance from the set-point along z after settling", |of| of.along(2),
    ).shown("cm").error();
    max_rotation_error: figure(
        "max rotation error", "rad", "greatest angle between the base and its set-point",
        |of| greatest(of.data("rotation_error").iter().copied()),
    ).tabled().error();
    thrust_min: figure(
        "least thrust", "N", "least thrust of any jet",
        |of| of.data("thrust").iter().copied().reduce(lesser).unwrap_or_default(),
    ).tabled();
    thrust_max: figure(
        "greatest thrust", "N", "greatest thrust of any jet",
        |of| of.data("thrust").iter().copied().reduce(greater).unwrap_or_default(),
    ).tabled();
    max_torque: figure(
        "greatest torque", "N m", "greatest commanded joint torque",
        |of| greatest(of.data("joint_torque").iter().map(|torque| torque.abs())),
    );
    min_com_height: figure(
        "least height", "m", "least height of the centre of mass", |of| least(of.rows("com_position").map(|com| com.z)),
    );
    min_com_x_settling: figure(
        "least x while settling", "m", "least x of the centre of mass while settling",
        |of| least(of.rows("com_position").take(of.settling).map(|com| com.x)),
    );
    ticks_without_solution: figure(
        "ticks without solution", "1", "ticks at which a QP gave no certified answer",
        |of| ticks_above(of.of_qps("qp_status"), 0.0),
    );
    rms_com_error: figure(
        "RMS CoM error", "m", "root mean square of the distance from the set-point after settling",
        |of| root_mean_square(of.com_distances()),
    ).shown("cm").error();
    rms_rotation_error: figure(
        "RMS rotation error", "rad", "root mean square of the rotation error after settling",
        |of| root_mean_square(of.data("rotation_error").iter().skip(of.settling).copied()),
    ).error();
    time_above_45_deg: figure(
        "time above 45°", "s", "time with a rotation error above 45 degrees",
        |of| of.tick * ticks_above(of.data("rotation_error").iter().copied(), LEANING),
    ).error();
    max_joint_error_sum: figure(
        "max sum of joint errors", "rad", "greatest sum of absolute joint errors", |of| greatest(of.joint_errors()),
    ).error();
    max_aero_force: figure(
        "max aerodynamic force", "N", "greatest total aerodynamic force in the simulator",
        |of| greatest(of.forces("aero_force_sim").map(|force| force.norm())),
    );
    max_aero_force_difference: figure(
        "max force difference", "N", "greatest difference of the total aerodynamic force to the controller's",
        |of| {
            let pairs = of.forces("aero_force_sim").zip(of.forces("aero_force_control"));
            greatest(pairs.map(|(simulated, estimated)| (simulated - estimated).norm()))
        },
    );
    max_kkt: figure(
        "max KKT residual", "1", "greatest KKT residual of an answer; NaN if one that counts as solved has none",
        |of| {
            let answers = of.data("qp_kkt").iter().zip(of.data("qp_status"));
            let counts = |(kkt, status): &(&f64, &f64)| **status <= 0.0 || kkt.is_finite();
            greatest_of(answers.filter(counts).map(|(kkt, _)| *kkt))
        },
    );
    max_qp_iterations: figure(
        "most QP iterations", "1", "most iterations of a QP in one tick", |of| greatest(of.of_qps("qp_iterations")),
    );
    degraded_time: figure(
        "degraded time", "s", "time in which a tick has a mode other than those of solvers",
        |of| of.tick * ticks_above(of.modes().iter().copied().map(without_solvers), 0.0),
    );
    nominal_until: figure(
        "nominal until", "s", "time of the first such tick, without one of the last tick",
        |of| of.of_modes(of.degraded().next().unwrap_or(of.end)),
    );
    all_modes: figure(
        "modes", "1", "modes that any tick has, a sum of bits", |of| of.of_modes(all_modes(of.modes())),
    ).bits(MODES);
    end_com_x: figure("x at the end", "m", "x of the centre of mass at the end", |of| of.end_com().x);
    end_com_y: figure("y at the end", "m", "y of the centre of mass at the end", |of| of.end_com().y);
    end_com_z: figure("height at the end", "m", "height of the centre of mass at the end", |of| of.end_com().z);
    end_speed: figure(
        "speed at the end", "m s-1", "speed of the centre of mass at the end",
        |of| of.rows("com_velocity").next_back().map_or(f64::NAN, |velocity| velocity.norm()),
    );
    warning_time: figure(
        "warning time", "s", "time before the end since which it was degraded, but for gaps of at most a second",
        |of| of.of_modes(warning_time(of.end, of.degraded().rev())),
    );
    time_off_the_ground: figure(
        "time off the ground", "s", "time in which the feet do not carry",
        |of| of.tick * ticks_above(of.data("feet_carry").iter().map(|carry| 1.0 - carry), 0.0),
    ).of_ground();
    touchdown_speed: figure(
        "touch-down speed", "m s-1", "greatest speed downwards with which feet that carried nothing touch the ground",
        |of| greatest(of.touchdowns()),
    ).of_ground();
}

/// Rotation error above which a robot in flight counts as leaning \[rad\].
pub const LEANING: f64 = std::f64::consts::FRAC_PI_4;

/// Time that a flight needs to settle after its start out of equilibrium \[s\].
pub const SETTLING_TIME: f64 = 3.0;

/// Longest time without a degraded tick that does not interrupt a warning \[s\].
pub const WARNING_GAP: f64 = 1.0;

/// The rows of a log that are judged, of which there are some.
#[derive(Debug)]
pub struct Flown<'a> {
    log: &'a FlightLog,
    ticks: usize,
    time: &'a [f64],
    /// Signals that the present figure is computed from.
    asked: RefCell<BTreeSet<&'static str>>,
    /// Number of ticks while settling.
    settling: usize,
    /// Duration of a tick, and time of the last one \[s\].
    tick: f64,
    end: f64,
}

impl<'a> Flown<'a> {
    fn new(log: &'a FlightLog, ticks: usize) -> Option<Self> {
        let mut flown =
            Self { log, ticks, time: &[], asked: RefCell::default(), settling: 0, tick: 0.0, end: 0.0 };
        flown.time = flown.data("time");
        flown.end = *flown.time.last()?;
        flown.tick = flown.time.get(1).copied().unwrap_or_default();
        flown.settling = flown.time.iter().take_while(|time| **time < SETTLING_TIME).count();
        Some(flown)
    }

    /// A figure of merit; NaN if a signal that it is computed from is not in the log.
    fn figure(&self, figure: &Figure) -> f64 {
        self.asked.take();
        let value = (figure.read)(self);
        if self.asked.borrow().iter().all(|name| self.has(name)) { value } else { f64::NAN }
    }

    /// Whether a signal is in the log with all its rows.
    fn has(&self, name: &str) -> bool {
        let rows = self.time.len();
        self.log.series(name).is_some_and(|series| series.data.len() >= rows * series.width())
    }

    /// Numbers of a signal; none if it is not in the log.
    fn data(&self, name: &'static str) -> &'a [f64] {
        self.asked.borrow_mut().insert(name);
        let series = self.log.series(name);
        series.map_or(&[], |series| &series.data[..series.data.len().min(self.ticks * series.width())])
    }

    fn modes(&self) -> &'a [f64] {
        self.data("degraded_modes")
    }

    fn rows(&self, name: &'static str) -> impl DoubleEndedIterator<Item = Vector3<f64>> + use<'a> {
        self.data(name).chunks_exact(3).map(Vector3::from_column_slice)
    }

    /// Sum of the forces on all links at every tick \[N\].
    fn forces(&self, name: &'static str) -> impl Iterator<Item = Vector3<f64>> + use<'a> {
        let width = self.log.series(name).map_or(0, Series::width).max(1);
        let total = |row: &[f64]| row.chunks_exact(3).map(Vector3::from_column_slice).sum();
        self.data(name).chunks_exact(width).map(total)
    }

    /// Offsets of the centre of mass from its set-point after settling, while the robot does not descend \[m\].
    fn com_errors(&self) -> impl Iterator<Item = Vector3<f64>> + use<'a> {
        let pairs = self.rows("com_position").zip(self.rows("com_setpoint")).zip(self.modes());
        let followed = pairs.skip(self.settling).filter(|(_, modes)| !is_descending(**modes));
        followed.map(|((com, desired), _)| com - desired)
    }

    fn com_distances(&self) -> impl Iterator<Item = f64> {
        self.com_errors().map(|error| error.norm())
    }

    fn along(&self, axis: usize) -> f64 {
        greatest_of(self.com_errors().map(|error| error[axis].abs()))
    }

    /// The greater number of both QPs, or of the one that there is.
    fn of_qps(&self, name: &'static str) -> impl Iterator<Item = f64> + use<'a> {
        self.data(name).chunks_exact(2).map(|both| both[0].max(both[1]))
    }

    fn joint_errors(&self) -> impl Iterator<Item = f64> {
        let desired = &self.log.joint_setpoint;
        let error = move |s: &[f64]| s.iter().zip(desired).map(|(s, s_d)| (s - s_d).abs()).sum::<f64>();
        self.data("joint_position").chunks_exact(desired.len().max(1)).map(error)
    }

    /// Times of degraded ticks.
    fn degraded(&self) -> impl DoubleEndedIterator<Item = f64> {
        let degraded = self.time.iter().zip(self.modes()).filter(|(_, modes)| without_solvers(**modes) > 0.0);
        degraded.map(|(time, _)| *time)
    }

    /// A figure of the modes; NaN unless all are known.
    fn of_modes(&self, value: f64) -> f64 {
        if self.modes().iter().any(|modes| modes.is_nan()) { f64::NAN } else { value }
    }

    fn end_com(&self) -> Vector3<f64> {
        self.rows("com_position").next_back().unwrap_or(Vector3::repeat(f64::NAN))
    }

    /// Speeds downwards at which feet that carried nothing touch the ground \[m/s\].
    fn touchdowns(&self) -> impl Iterator<Item = f64> {
        let feet = self.log.series("foot_wrench").map_or(0, Series::width).max(1);
        let load = |wrenches: &[f64]| wrenches.chunks_exact(6).map(|wrench| wrench[2]).sum::<f64>();
        let loads: Vec<f64> = self.data("foot_wrench").chunks_exact(feet).map(load).collect();
        let touch: Vec<bool> = loads.windows(2).map(|load| load[0] == 0.0 && load[1] > 0.0).collect();
        let at = self.rows("com_velocity").zip(touch).filter(|(_, touches)| *touches);
        at.map(|(velocity, _)| (-velocity.z).max(0.0))
    }
}

impl Summary {
    /// The figures that a flight has, with or without ground.
    pub fn figures(&self, has_ground: bool) -> impl Iterator<Item = (&'static Figure, f64)> {
        let every = FIGURES.iter().zip(self.values());
        every.filter(move |(figure, _)| has_ground || !figure.is_of_ground)
    }

    /// Names of the signals that figures are computed from.
    #[must_use]
    pub fn signals() -> BTreeSet<&'static str> {
        // Figures of one row of times name what they ask for, without numbers of it.
        let time = SIGNALS.iter().filter(|signal| signal.name == "time");
        let time = time.map(|signal| Series { signal, row_shape: Vec::new(), data: vec![0.0] });
        let log = FlightLog { series: time.collect(), joint_setpoint: Vec::new() };
        let flown = Flown::new(&log, 1);
        let asked_by = |figure: &Figure| {
            let asked = flown.as_ref().map(|flown| {
                flown.figure(figure);
                flown.asked.take()
            });
            asked.unwrap_or_default()
        };
        FIGURES.iter().flat_map(asked_by).chain(["time"]).collect()
    }
}

/// Number of values above a limit; NaN if one is NaN.
fn ticks_above(mut values: impl Iterator<Item = f64>, limit: f64) -> f64 {
    values
        .try_fold(0.0, |count, value| (!value.is_nan()).then_some(count + f64::from(u8::from(value > limit))))
        .unwrap_or(f64::NAN)
}

/// Whether the robot descends in this tick instead of following its mission.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // bits of `Modes`, which are 32
fn is_descending(modes: f64) -> bool {
    modes as u32 & Modes::DESCENDING.bits() != 0
}

/// A set of modes without those of solvers; NaN if it is not known.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // bits of `Modes`, which are 32
fn without_solvers(modes: f64) -> f64 {
    if modes.is_nan() { modes } else { f64::from(modes as u32 & !Modes::OF_SOLVERS.bits()) }
}

/// Union of sets of modes.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // bits of `Modes`, which are 32
fn all_modes(modes: &[f64]) -> f64 {
    f64::from(modes.iter().fold(0, |all, modes| all | *modes as u32))
}

/// Time from the first degraded tick of the last warning to the end of a flight, from the times of its degraded ticks,
/// the latest first; zero if the last second is not degraded.
fn warning_time(end: f64, degraded: impl Iterator<Item = f64>) -> f64 {
    let start = degraded.scan(end, |later, time| {
        // A billionth absorbs the rounding of times.
        let is_of_warning = *later - time <= WARNING_GAP + 1e-9;
        *later = time;
        is_of_warning.then_some(time)
    });
    end - start.last().unwrap_or(end)
}

/// The greater number, or NaN if one is NaN, which `f64::max` would hide.
fn greater(a: f64, b: f64) -> f64 {
    if a.is_nan() || a > b { a } else { b }
}

/// The lesser number, or NaN if one is NaN.
fn lesser(a: f64, b: f64) -> f64 {
    if a.is_nan() || a < b { a } else { b }
}

/// Greatest of non-negative values; zero if there are none.
fn greatest(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(0.0, greater)
}

/// Greatest of non-negative values; NaN if there are none.
fn greatest_of(values: impl Iterator<Item = f64>) -> f64 {
    values.reduce(greater).unwrap_or(f64::NAN)
}

/// Least value; infinite if there are none.
fn least(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(f64::INFINITY, lesser)
}

/// Root mean square; NaN if there are no values.
fn root_mean_square(values: impl Iterator<Item = f64>) -> f64 {
    let (count, sum) = values.fold((0.0_f64, 0.0), |(count, sum), x| (count + 1.0, sum + x * x));
    (sum / count).sqrt()
}

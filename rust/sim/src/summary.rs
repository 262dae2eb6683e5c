//! Figures of merit of a flight, each declared once: name, unit, meaning.
//!
//! Equation M81 of `docs/model`.

use crate::log::{FlightLog, Series};
use flight_core::control::Modes;
use nalgebra::Vector3;
use serde::Serialize;

/// The declaration of a figure of merit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Figure {
    /// Name in result files.
    pub name: &'static str,
    /// Unit in UDUNITS notation.
    pub unit: &'static str,
    /// Meaning.
    pub meaning: &'static str,
    /// Whether only engines with ground have it.
    pub is_of_ground: bool,
}

macro_rules! is_of_ground {
    () => {
        false
    };
    (ground) => {
        true
    };
}

macro_rules! figures {
    ($($name:ident [$unit:literal] $meaning:literal $(of $ground:ident)?;)*) => {
        /// Figures of merit of a flight. Each is NaN if a number from which it is computed is NaN, or if there is no
        /// tick to compute it from; for figures after settling, if the flight ended before.
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub struct Summary {
            $(#[doc = concat!($meaning, " \\[", $unit, "\\]")] pub $name: f64,)*
        }

        /// All figures of merit.
        pub const FIGURES: &[Figure] = &[$(Figure {
            name: stringify!($name),
            unit: $unit,
            meaning: $meaning,
            is_of_ground: is_of_ground!($($ground)?),
        }),*];

        impl Summary {
            /// Figures without any tick.
            const NONE: Self = Self { $($name: f64::NAN),* };

            /// The figures, in the order of [`FIGURES`].
            fn values(&self) -> Vec<f64> {
                vec![$(self.$name),*]
            }
        }
    };
}

figures! {
    max_com_error ["m"] "greatest distance of the centre of mass from its set-point after settling, until the robot descends";
    max_com_error_x ["m"] "greatest distance from the set-point along x after settling";
    max_com_error_y ["m"] "greatest distance from the set-point along y after settling";
    max_com_error_z ["m"] "greatest distance from the set-point along z after settling";
    max_rotation_error ["rad"] "greatest angle between the base and its set-point";
    thrust_min ["N"] "least thrust of any jet";
    thrust_max ["N"] "greatest thrust of any jet";
    max_torque ["N m"] "greatest commanded joint torque";
    min_com_height ["m"] "least height of the centre of mass";
    min_com_x_settling ["m"] "least x of the centre of mass while settling";
    ticks_without_solution ["1"] "ticks at which a QP gave no certified answer";
    rms_com_error ["m"] "root mean square of the distance from the set-point after settling";
    rms_rotation_error ["rad"] "root mean square of the rotation error after settling";
    time_above_45_deg ["s"] "time with a rotation error above 45 degrees";
    max_joint_error_sum ["rad"] "greatest sum of absolute joint errors";
    max_aero_force ["N"] "greatest total aerodynamic force in the simulator";
    max_aero_force_difference ["N"] "greatest difference of the total aerodynamic force to the controller's";
    max_kkt ["1"] "greatest finite KKT residual of an answer";
    max_qp_iterations ["1"] "most iterations of a QP in one tick";
    degraded_time ["s"] "time in which a tick has a mode other than those of solvers";
    nominal_until ["s"] "time of the first such tick, without one of the last tick";
    all_modes ["1"] "modes that any tick has, a sum of bits";
    end_com_x ["m"] "x of the centre of mass at the end";
    end_com_y ["m"] "y of the centre of mass at the end";
    end_com_z ["m"] "height of the centre of mass at the end";
    end_speed ["m/s"] "speed of the centre of mass at the end";
    warning_time ["s"] "time before the end since which it was degraded, but for gaps of at most a second";
    time_off_the_ground ["s"] "time in which the feet do not carry" of ground;
    touchdown_speed ["m/s"] "greatest speed downwards with which feet that carried nothing touch the ground" of ground;
}

/// Rotation error above which a robot in flight counts as leaning \[rad\].
pub const LEANING: f64 = std::f64::consts::FRAC_PI_4;

/// Time that a flight needs to settle after its start out of equilibrium \[s\].
pub const SETTLING_TIME: f64 = 3.0;

/// Longest time without a degraded tick that does not interrupt a warning \[s\].
pub const WARNING_GAP: f64 = 1.0;

impl Summary {
    /// Figures of merit of the first `ticks` rows of a log.
    #[must_use]
    pub fn new(log: &FlightLog, ticks: usize) -> Self {
        let data = |name: &str| {
            log.series(name)
                .map_or(&[][..], |series| &series.data[..series.data.len().min(ticks * series.width())])
        };
        let rows = |name: &str| data(name).chunks_exact(3).map(Vector3::from_column_slice);
        let (time, rotation) = (data("time"), data("rotation_error"));
        let Some(&end) = time.last() else { return Self::NONE };
        let is_settled = |time: &&f64| **time >= SETTLING_TIME;
        let settling = time.iter().take_while(|time| !is_settled(time)).count();
        let modes = data("degraded_modes");
        let flown = time.len() - modes.iter().filter(|modes| is_descending(**modes)).count();
        let com_errors: Vec<Vector3<f64>> = rows("com_position")
            .zip(rows("com_setpoint"))
            .take(flown)
            .skip(settling)
            .map(|(com, desired)| com - desired)
            .collect();
        let distances = || com_errors.iter().map(Vector3::norm);
        let along = |axis: usize| greatest_of(com_errors.iter().map(|error| error[axis].abs()));
        let tick = time.get(1).copied().unwrap_or_default();
        let other: Vec<f64> = modes.iter().copied().map(without_solvers).collect();
        let degraded = || time.iter().zip(&other).filter(|(_, modes)| **modes > 0.0).map(|(time, _)| *time);
        let are_known = !modes.iter().any(|modes| modes.is_nan());
        let of_modes = |value: f64| if are_known { value } else { f64::NAN };
        let joints = log.joint_setpoint.len().max(1);
        let joint_errors = data("joint_position").chunks_exact(joints).map(|positions| {
            positions.iter().zip(&log.joint_setpoint).map(|(s, s_d)| (s - s_d).abs()).sum::<f64>()
        });
        let simulated = total_forces(log, "aero_force_sim", ticks);
        let estimated = total_forces(log, "aero_force_control", ticks);
        // The greater number of both QPs, or of the one that there is.
        let of_qps = |name: &str| data(name).chunks_exact(2).map(|both| both[0].max(both[1]));
        let thrust = || data("thrust").iter().copied();
        let end_com = rows("com_position").next_back().unwrap_or(Vector3::repeat(f64::NAN));
        let feet = log.series("foot_wrench").map_or(0, Series::width).max(1);
        let loads = data("foot_wrench")
            .chunks_exact(feet)
            .map(|wrenches| wrenches.chunks_exact(6).map(|wrench| wrench[2]).sum::<f64>());
        let loads: Vec<f64> = loads.collect();
        let touchdowns =
            rows("com_velocity").zip(loads.windows(2)).filter(|(_, load)| load[0] == 0.0 && load[1] > 0.0);
        Self {
            max_com_error: greatest_of(distances()),
            max_com_error_x: along(0),
            max_com_error_y: along(1),
            max_com_error_z: along(2),
            max_rotation_error: greatest(rotation.iter().copied()),
            thrust_min: thrust().reduce(lesser).unwrap_or_default(),
            thrust_max: thrust().reduce(greater).unwrap_or_default(),
            max_torque: greatest(data("joint_torque").iter().map(|torque| torque.abs())),
            min_com_height: least(rows("com_position").map(|com| com.z)),
            min_com_x_settling: least(rows("com_position").take(settling).map(|com| com.x)),
            ticks_without_solution: ticks_above(of_qps("qp_status"), 0.0),
            rms_com_error: root_mean_square(distances()),
            rms_rotation_error: root_mean_square(rotation.iter().skip(settling).copied()),
            time_above_45_deg: tick * ticks_above(rotation.iter().copied(), LEANING),
            max_joint_error_sum: greatest(joint_errors),
            max_aero_force: greatest(simulated.iter().map(Vector3::norm)),
            max_aero_force_difference: greatest(
                simulated.iter().zip(&estimated).map(|(simulated, estimated)| (simulated - estimated).norm()),
            ),
            max_kkt: greatest_of(data("qp_kkt").iter().copied().filter(|kkt| kkt.is_finite())),
            max_qp_iterations: greatest(of_qps("qp_iterations")),
            degraded_time: tick * ticks_above(other.iter().copied(), 0.0),
            nominal_until: of_modes(degraded().next().unwrap_or(end)),
            all_modes: of_modes(all_modes(modes)),
            end_com_x: end_com.x,
            end_com_y: end_com.y,
            end_com_z: end_com.z,
            end_speed: rows("com_velocity").next_back().map_or(f64::NAN, |velocity| velocity.norm()),
            warning_time: of_modes(warning_time(end, degraded().rev())),
            time_off_the_ground: tick * ticks_above(data("feet_carry").iter().map(|carry| 1.0 - carry), 0.0),
            touchdown_speed: greatest(touchdowns.map(|(velocity, _)| (-velocity.z).max(0.0))),
        }
    }

    /// The figures that a flight has, with or without ground.
    pub fn figures(&self, has_ground: bool) -> impl Iterator<Item = (&'static Figure, f64)> {
        let every = FIGURES.iter().zip(self.values());
        every.filter(move |(figure, _)| has_ground || !figure.is_of_ground)
    }
}

/// Number of values above a limit; NaN if one is NaN.
fn ticks_above(mut values: impl Iterator<Item = f64>, limit: f64) -> f64 {
    values
        .try_fold(0.0, |count, value| (!value.is_nan()).then_some(count + f64::from(u8::from(value > limit))))
        .unwrap_or(f64::NAN)
}

/// Whether the robot follows its mission no longer; a descent lasts to the end.
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

/// Sum of the forces on all links at every tick \[N\].
fn total_forces(log: &FlightLog, name: &str, ticks: usize) -> Vec<Vector3<f64>> {
    let Some(series) = log.series(name) else { return Vec::new() };
    let total = |row: &[f64]| row.chunks_exact(3).map(Vector3::from_column_slice).sum();
    (0..log.len().min(ticks)).map(|tick| total(series.row(tick))).collect()
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

//! What a flight leaves behind: every plotted signal, tick by tick.
//!
//! Equation M81 of `docs/model.md`.

use crate::plant::Plant;
use crate::scenario::Fall;
use flight_core::control::setpoint::Setpoint;
use flight_core::control::{Command, Terms};
use flight_core::robot::RobotModel;
use flight_core::spatial::{rpy_from_rotation, wxyz_from_rotation};
use nalgebra::Vector3;

/// One signal: a row of `width` numbers for each tick, rows one after the other.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Name, as in result files.
    pub name: &'static str,
    /// Shape of one row.
    pub row_shape: Vec<usize>,
    /// All rows.
    pub data: Vec<f64>,
}

impl Series {
    fn new(name: &'static str, row_shape: &[usize], n_ticks: usize) -> Self {
        let width: usize = row_shape.iter().product();
        Self { name, row_shape: row_shape.to_vec(), data: Vec::with_capacity(width * n_ticks) }
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

/// Everything the log can be asked for at one tick.
pub struct LogRow<'a> {
    /// Time \[s\].
    pub time: f64,
    /// Velocity of the air \[m/s\].
    pub wind: Vector3<f64>,
    /// The world.
    pub plant: &'a Plant,
    /// The controller's intermediate values.
    pub terms: &'a Terms,
    /// The controller's command.
    pub command: &'a Command,
    /// Errors against the reference.
    pub errors: TrackingErrors,
}

/// How far the robot is from its reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackingErrors {
    /// Angle between base and desired base \[rad\].
    pub rotation: f64,
    /// Distance of the centre of mass from its reference \[m\].
    pub com: f64,
}

impl TrackingErrors {
    /// Errors of a plant against a reference.
    #[must_use]
    pub fn new(plant: &Plant, setpoint: &Setpoint) -> Self {
        let error = setpoint.rotation.transpose() * plant.state().base.rotation;
        Self {
            rotation: flight_core::spatial::rotation_angle(&error),
            com: (plant.kinematics().com - setpoint.com_position).norm(),
        }
    }
}

/// The log of one flight. SI units, inertial axes, quaternions `wxyz`.
#[derive(Debug, Clone, PartialEq)]
pub struct FlightLog {
    /// All signals; the order is part of nothing, names are.
    pub series: Vec<Series>,
    /// Posture that joint errors are measured against \[rad\].
    pub joint_setpoint: Vec<f64>,
}

impl FlightLog {
    /// Space for `n_ticks` rows of a robot's signals.
    #[must_use]
    pub fn new(robot: &RobotModel, n_ticks: usize) -> Self {
        let (joints, jets, links) = (robot.joints.len(), robot.jets.len(), robot.aero_links.len());
        let shapes: [(&'static str, &[usize]); 24] = [
            ("time", &[]),
            ("base_position", &[3]),
            ("base_quaternion", &[4]),
            ("base_velocity", &[6]),
            ("base_rpy_setpoint", &[3]),
            ("joint_position", &[joints]),
            ("joint_velocity", &[joints]),
            ("com_position", &[3]),
            ("com_velocity", &[3]),
            ("com_setpoint", &[3]),
            ("rotation_error", &[]),
            ("thrust", &[jets]),
            ("thrust_rate", &[jets]),
            ("joint_velocity_command", &[joints]),
            ("joint_torque", &[joints]),
            ("wind", &[3]),
            ("aero_force_sim", &[links, 3]),
            ("aero_force_control", &[links, 3]),
            ("momentum", &[6]),
            ("momentum_setpoint", &[6]),
            ("momentum_rate_estimate", &[6]),
            ("qp_status", &[2]),
            ("qp_kkt", &[2]),
            ("qp_iterations", &[2]),
        ];
        let series = shapes.iter().map(|(name, shape)| Series::new(name, shape, n_ticks)).collect();
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

    /// A signal by name.
    #[must_use]
    pub fn series(&self, name: &str) -> Option<&Series> {
        self.series.iter().find(|series| series.name == name)
    }

    /// Appends one row of every signal.
    pub fn push(&mut self, row: &LogRow) {
        let state = row.plant.state();
        let setpoint = &row.terms.setpoint;
        let com_velocity: Vector3<f64> =
            row.plant.dynamics().momentum.fixed_rows::<3>(0) / row.plant.kinematics().mass();
        let momentum_setpoint = setpoint.com_velocity * row.terms.kinematics.mass();
        let (momentum_qp, torque_qp) = (&row.command.momentum_qp, &row.command.torque_qp);
        for series in &mut self.series {
            let data = &mut series.data;
            match series.name {
                "time" => data.push(row.time),
                "base_position" => data.extend(&state.base.position),
                "base_quaternion" => data.extend(wxyz_from_rotation(&state.base.rotation)),
                "base_velocity" => data.extend(&state.velocity.as_slice()[..6]),
                "base_rpy_setpoint" => data.extend(&rpy_from_rotation(&setpoint.rotation)),
                "joint_position" => data.extend(&state.joint_position),
                "joint_velocity" => data.extend(state.joint_velocity()),
                "com_position" => data.extend(&row.plant.kinematics().com),
                "com_velocity" => data.extend(&com_velocity),
                "com_setpoint" => data.extend(&setpoint.com_position),
                "rotation_error" => data.push(row.errors.rotation),
                "thrust" => data.extend(row.plant.jets().thrust()),
                "thrust_rate" => data.extend(&row.command.thrust_rate),
                "joint_velocity_command" => data.extend(&row.command.joint_velocity),
                "joint_torque" => data.extend(&row.command.joint_torque),
                "wind" => data.extend(&row.wind),
                "aero_force_sim" => data.extend(row.plant.link_forces().forces_i.iter().flatten()),
                "aero_force_control" => data.extend(row.terms.link_forces.forces_i.iter().flatten()),
                "momentum" => data.extend(&row.plant.dynamics().momentum),
                "momentum_setpoint" => data.extend(momentum_setpoint.iter().chain(&[0.0; 3])),
                "momentum_rate_estimate" => data.extend(&row.terms.momentum.rate_estimate),
                "qp_status" => {
                    data.extend([momentum_qp.status.code(), torque_qp.status.code()].map(f64::from));
                }
                "qp_kkt" => data.extend([momentum_qp.kkt, torque_qp.kkt]),
                "qp_iterations" => data.extend([momentum_qp.iterations, torque_qp.iterations].map(f64::from)),
                // `new` lists the names; a test keeps the two in step.
                _ => {}
            }
        }
    }
}

/// Figures of merit of a flight; the first three seconds, in which it settles, are left out where
/// said.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summary {
    /// Greatest distance of the centre of mass from its reference after settling \[m\].
    pub max_com_error: f64,
    /// The same along each axis \[m\].
    pub max_com_error_xyz: [f64; 3],
    /// Greatest angle between base and desired base \[rad\].
    pub max_rotation_error: f64,
    /// Least and greatest thrust of any jet \[N\].
    pub thrust_range: (f64, f64),
    /// Greatest joint torque \[N m\].
    pub max_torque: f64,
    /// Least height of the centre of mass \[m\].
    pub min_com_height: f64,
    /// Least forward position of the centre of mass while settling \[m\].
    pub min_com_x_settling: f64,
    /// Ticks at which one of the QPs gave no certified answer.
    pub ticks_without_solution: usize,
    /// Root mean square of the CoM error after settling \[m\].
    pub rms_com_error: f64,
    /// Root mean square of the rotation error after settling \[rad\].
    pub rms_rotation_error: f64,
    /// Time with a rotation error above 45° \[s\].
    pub time_above_45_deg: f64,
    /// Greatest sum of absolute joint errors \[rad\].
    pub max_joint_error: f64,
    /// Greatest total aerodynamic force of the simulator \[N\].
    pub max_aero_force: f64,
    /// Greatest difference between the simulator's and the controller's total aerodynamic force \[N\].
    pub max_aero_force_difference: f64,
    /// Greatest KKT residual of a certified answer.
    pub max_kkt: f64,
    /// Most solver iterations in one tick.
    pub max_qp_iterations: f64,
}

/// Rotation error beyond which a robot that still flies counts as leaning.
pub const LEANING: f64 = std::f64::consts::FRAC_PI_4;

/// Time that a flight takes to settle after it starts out of equilibrium \[s\].
pub const SETTLING_TIME: f64 = 3.0;

impl Summary {
    /// Figures of merit of a log.
    #[must_use]
    pub fn new(log: &FlightLog) -> Self {
        let data = |name: &str| log.series(name).map_or(&[][..], |series| &series.data[..]);
        let largest = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
        let rows = |name: &str| data(name).chunks_exact(3);
        let mut max_com_error = 0.0_f64;
        let mut max_com_error_xyz = [0.0_f64; 3];
        let mut min_com_x_settling = f64::INFINITY;
        let (mut settled, mut sum_com_error, mut sum_rotation_error) = (0.0_f64, 0.0, 0.0);
        let mut above = 0.0;
        for (time, angle) in data("time").iter().zip(data("rotation_error")) {
            sum_rotation_error += if *time < SETTLING_TIME { 0.0 } else { angle * angle };
            above += if *angle > LEANING { 1.0 } else { 0.0 };
        }
        let tick = data("time").get(1).copied().unwrap_or(0.0);
        let aero =
            aero_force_extremes(data("aero_force_sim"), data("aero_force_control"), data("time").len());
        let joints = log.joint_setpoint.len().max(1);
        let joint_errors = data("joint_position")
            .chunks_exact(joints)
            .map(|positions| positions.iter().zip(&log.joint_setpoint).map(|(s, s_d)| (s - s_d).abs()).sum());
        for ((time, com), desired) in data("time").iter().zip(rows("com_position")).zip(rows("com_setpoint"))
        {
            if *time < SETTLING_TIME {
                min_com_x_settling = min_com_x_settling.min(com[0]);
                continue;
            }
            settled += 1.0;
            let error = Vector3::from_column_slice(com) - Vector3::from_column_slice(desired);
            max_com_error = max_com_error.max(error.norm());
            sum_com_error += error.norm_squared();
            for axis in 0..3 {
                max_com_error_xyz[axis] = max_com_error_xyz[axis].max(error[axis].abs());
            }
        }
        let thrust = data("thrust");
        let solved = |status: &[f64]| status.iter().all(|code| *code == 0.0);
        Self {
            max_com_error,
            max_com_error_xyz,
            max_rotation_error: largest(&mut data("rotation_error").iter().copied()),
            thrust_range: (
                thrust.iter().copied().reduce(f64::min).unwrap_or_default(),
                thrust.iter().copied().reduce(f64::max).unwrap_or_default(),
            ),
            max_torque: largest(&mut data("joint_torque").iter().map(|torque| torque.abs())),
            min_com_height: rows("com_position").map(|com| com[2]).fold(f64::INFINITY, f64::min),
            min_com_x_settling,
            ticks_without_solution: data("qp_status")
                .chunks_exact(2)
                .filter(|status| !solved(status))
                .count(),
            rms_com_error: (sum_com_error / settled.max(1.0)).sqrt(),
            rms_rotation_error: (sum_rotation_error / settled.max(1.0)).sqrt(),
            time_above_45_deg: above * tick,
            max_joint_error: largest(&mut { joint_errors }),
            max_aero_force: aero.0,
            max_aero_force_difference: aero.1,
            max_kkt: largest(&mut data("qp_kkt").iter().copied().filter(|kkt| kkt.is_finite())),
            max_qp_iterations: largest(&mut data("qp_iterations").iter().copied()),
        }
    }
}

/// Greatest total force of the simulator, and greatest difference to the controller's \[N\].
fn aero_force_extremes(simulator: &[f64], controller: &[f64], ticks: usize) -> (f64, f64) {
    let width = simulator.len() / ticks.max(1);
    if width == 0 {
        return (0.0, 0.0);
    }
    let total = |forces: &[f64]| forces.chunks_exact(3).map(Vector3::from_column_slice).sum::<Vector3<f64>>();
    let rows = simulator.chunks_exact(width).zip(controller.chunks_exact(width));
    rows.fold((0.0, 0.0), |(force, difference), (simulated, estimated)| {
        let (simulated, estimated) = (total(simulated), total(estimated));
        (simulated.norm().max(force), (simulated - estimated).norm().max(difference))
    })
}

/// A finished flight.
#[derive(Debug, Clone)]
pub struct FlightResult {
    /// When and why it was lost, if it was.
    pub fall: Option<Fall>,
    /// All signals.
    pub log: FlightLog,
    /// Figures of merit.
    pub summary: Summary,
}

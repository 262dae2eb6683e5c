//! The signals of a flight's log, each declared once: name, label, dimensions, unit, meaning, and how it is read.

use crate::plant::Plant;
use crate::quantity::{Codes, Dimension, Quantity};
use crate::world::Seen;
use flight_core::control::law::setpoint::Setpoint;
use flight_core::control::limits::JointCondition;
use flight_core::control::{Command, ControllerState, Measurement, Modes, Terms};
use flight_core::qp::{QpAnswer, QpStatus};
use flight_core::robot::{Foot, RobotModel};
use flight_core::spatial::{rotation_angle, rpy_from_rotation, wxyz_from_rotation};
use nalgebra::{DVector, Vector3};

/// A tick of the controller.
pub struct TickRow<'a> {
    /// Measurement that it is given.
    pub measurement: &'a Measurement,
    /// State of the controller after the tick.
    pub state: &'a ControllerState,
    /// The controller's intermediate values.
    pub terms: &'a Terms,
    /// The controller's command.
    pub command: &'a Command,
    /// Number of each foot of the robot among the controller's; `None` for one that it does not use.
    pub feet: &'a [Option<usize>],
}

/// The simulated side of a tick.
pub struct WorldRow<'a> {
    /// Velocity of the air \[m/s\].
    pub wind: Vector3<f64>,
    /// The simulated robot and its environment.
    pub plant: &'a Plant,
    /// Errors with respect to the set-point.
    pub errors: TrackingErrors,
    /// What is seen in a world with ground.
    pub seen: Option<&'a Seen>,
}

impl WorldRow<'_> {
    /// Numbers that only a world with ground shows.
    fn seen<'a, T: IntoIterator<Item = &'a f64>>(&'a self, read: fn(&'a Seen) -> T, out: &mut Vec<f64>) {
        out.extend(self.seen.into_iter().flat_map(read));
    }
}

/// Number of each foot of a robot among those that a controller uses.
#[must_use]
pub fn feet_of(robot: &RobotModel, used: &[Foot]) -> Vec<Option<usize>> {
    robot.feet.iter().map(|foot| used.iter().position(|other| other.name == foot.name)).collect()
}

impl TickRow<'_> {
    /// Wrenches of the controller's feet, as those of all feet of the robot.
    fn every_foot(&self, of_controller: &DVector<f64>, out: &mut Vec<f64>) {
        for foot in self.feet {
            match foot {
                Some(foot) => out.extend(&of_controller.as_slice()[6 * foot..6 * foot + 6]),
                None => out.extend([0.0; 6]),
            }
        }
    }

    /// Answers of momentum QP and torque QP.
    fn qps(&self) -> [&QpAnswer; 2] {
        [&self.command.rates_qp, &self.command.torque_qp]
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
            rotation: rotation_angle(&error),
            com: (plant.kinematics().com - setpoint.com_position).norm(),
        }
    }
}

/// How one row of a signal is appended to the data.
#[derive(Debug, Clone, Copy)]
pub enum Read {
    /// Of the controller, in a flight or a [replay](mod@crate::replay).
    Tick(fn(&TickRow, &mut Vec<f64>)),
    /// Of the simulated robot, in a flight only.
    World(fn(&WorldRow, &mut Vec<f64>)),
}

/// The declaration of a signal; nothing reads those that others log, and those without rows.
pub type Signal = Quantity<Option<Read>>;

/// A signal of the controller, which every engine logs.
const fn tick(
    name: &'static str,
    dims: &'static [Dimension],
    unit: &'static str,
    meaning: &'static str,
    read: fn(&TickRow, &mut Vec<f64>),
) -> Signal {
    Quantity::new(name, dims, unit, meaning, Some(Read::Tick(read)))
}

/// A signal of the simulated robot, which every engine logs.
const fn world(
    name: &'static str,
    dims: &'static [Dimension],
    unit: &'static str,
    meaning: &'static str,
    read: fn(&WorldRow, &mut Vec<f64>),
) -> Signal {
    Quantity::new(name, dims, unit, meaning, Some(Read::World(read)))
}

const TIME: &[Dimension] = &[Dimension::Time];
const XYZ: &[Dimension] = &[Dimension::Time, Dimension::Xyz];
const WXYZ: &[Dimension] = &[Dimension::Time, Dimension::Wxyz];
const RPY: &[Dimension] = &[Dimension::Time, Dimension::Rpy];
const SIX: &[Dimension] = &[Dimension::Time, Dimension::Six];
const JOINT: &[Dimension] = &[Dimension::Time, Dimension::Joint];
const JET: &[Dimension] = &[Dimension::Time, Dimension::Jet];
const LINK: &[Dimension] = &[Dimension::Time, Dimension::Link, Dimension::Xyz];
const QP: &[Dimension] = &[Dimension::Time, Dimension::Qp];
const ROTATION: &[Dimension] = &[Dimension::Time, Dimension::Xyz, Dimension::BaseAxis];
const FOOT_XYZ: &[Dimension] = &[Dimension::Time, Dimension::Foot, Dimension::Xyz];
const FOOT_SIX: &[Dimension] = &[Dimension::Time, Dimension::Foot, Dimension::Six];

const MOMENTUM: &str = "kg m s-1 (linear), kg m2 s-1 (angular)";
const MOMENTUM_RATE: &str = "N (linear), N m (angular)";
const WRENCH: &str = "N (force), N m (moment)";

/// Codes of `qp_status`.
const QP_STATUS: Codes = &[
    (QpStatus::Solved as u32, "solved"),
    (QpStatus::IterationLimit as u32, "iteration_limit"),
    (QpStatus::NotPositiveDefinite as u32, "not_positive_definite"),
    (QpStatus::InfeasibleBounds as u32, "infeasible_bounds"),
    (QpStatus::NonFinite as u32, "non_finite"),
    (QpStatus::Inaccurate as u32, "inaccurate"),
    (QpStatus::SizeMismatch as u32, "size_mismatch"),
    (QpStatus::Breakdown as u32, "breakdown"),
];

/// Codes of `joint_condition`.
const JOINT_CONDITION: Codes = &[
    (JointCondition::Healthy.code() as u32, "healthy"),
    (JointCondition::Stuck.code() as u32, "stuck"),
    (JointCondition::Weak(0.0).code() as u32, "weak"),
    (JointCondition::Free.code() as u32, "free"),
];

/// Bits of a tick's modes.
pub(crate) const MODES: Codes = &{
    let mut codes = [(0, ""); Modes::NAMES.len()];
    let mut number = 0;
    while number < codes.len() {
        let (mode, name, _) = Modes::NAMES[number];
        codes[number] = (mode.bits(), name);
        number += 1;
    }
    codes
};

/// All signals. Joint quantities are in the units of revolute joints; for prismatic ones replace rad by m
/// and N m by N.
pub static SIGNALS: &[Signal] = &[
    tick("time", TIME, "s", "time", |row, out| out.push(row.measurement.time)),
    world("base_position", XYZ, "m", "position of the base origin, inertial frame", |row, out| {
        out.extend(&row.plant.state().base.position);
    }),
    world("base_quaternion", WXYZ, "1", "rotation from base to inertial frame", |row, out| {
        out.extend(wxyz_from_rotation(&row.plant.state().base.rotation));
    }),
    world(
        "base_velocity",
        SIX,
        "m s-1 (linear), rad s-1 (angular)",
        "base velocity, mixed: both parts in inertial axes",
        |row, out| out.extend(&row.plant.state().velocity.as_slice()[..6]),
    ),
    tick("base_rpy_setpoint", RPY, "rad", "set-point of the base: roll, pitch, yaw", |row, out| {
        out.extend(&rpy_from_rotation(&row.terms.setpoint.rotation));
    }),
    world("joint_position", JOINT, "rad", "joint position", |row, out| {
        out.extend(&row.plant.state().joint_position);
    }),
    world("joint_velocity", JOINT, "rad s-1", "joint velocity", |row, out| {
        out.extend(row.plant.state().joint_velocity());
    }),
    world("com_position", XYZ, "m", "centre of mass, inertial frame", |row, out| {
        out.extend(&row.plant.kinematics().com);
    })
    .label("CoM"),
    world("com_velocity", XYZ, "m s-1", "velocity of the centre of mass, inertial frame", |row, out| {
        let mass = row.plant.kinematics().mass();
        out.extend(row.plant.dynamics().momentum.fixed_rows::<3>(0).iter().map(|momentum| momentum / mass));
    })
    .label("CoM velocity"),
    tick("com_setpoint", XYZ, "m", "set-point of the centre of mass, inertial frame", |row, out| {
        out.extend(&row.terms.setpoint.com_position);
    })
    .label("CoM reference"),
    world("rotation_error", TIME, "rad", "angle between the base and its set-point", |row, out| {
        out.push(row.errors.rotation);
    }),
    world("thrust", JET, "N", "thrust of each jet", |row, out| out.extend(row.plant.jets().thrust())),
    tick("thrust_rate", JET, "N s-1", "commanded thrust rate", |row, out| {
        out.extend(&row.command.thrust_rate);
    }),
    tick(
        "joint_velocity_command",
        JOINT,
        "rad s-1",
        "joint velocity command of the momentum QP",
        |row, out| out.extend(&row.command.joint_velocity),
    ),
    tick("joint_torque", JOINT, "N m", "commanded joint torque, after the rate limiter", |row, out| {
        out.extend(&row.command.joint_torque);
    })
    .label("desired joint torque"),
    world("wind", XYZ, "m s-1", "wind velocity, inertial frame", |row, out| out.extend(&row.wind)),
    world("aero_force_sim", LINK, "N", "aerodynamic force in the simulator, inertial frame", |row, out| {
        out.extend(row.plant.link_forces().forces_i.iter().flatten());
    })
    .label("aerodynamic force"),
    tick(
        "aero_force_control",
        LINK,
        "N",
        "aerodynamic force the controller compensates, inertial frame",
        |row, out| out.extend(row.terms.link_forces.forces_i.iter().flatten()),
    )
    .label("compensated force"),
    world("momentum", SIX, MOMENTUM, "centroidal momentum, inertial axes", |row, out| {
        out.extend(&row.plant.dynamics().momentum);
    }),
    tick("momentum_setpoint", SIX, MOMENTUM, "set-point of the centroidal momentum", |row, out| {
        let mass = row.terms.kinematics.mass();
        out.extend(row.terms.setpoint.com_velocity.iter().map(|velocity| velocity * mass));
        out.extend([0.0; 3]);
    }),
    tick(
        "momentum_rate_estimate",
        SIX,
        MOMENTUM_RATE,
        "momentum rate the controller estimates",
        |row, out| out.extend(&row.terms.momentum.rate_estimate),
    ),
    tick(
        "unmodelled_wrench",
        SIX,
        MOMENTUM_RATE,
        "observed part of it that is in no model of the controller",
        |row, out| out.extend(&row.terms.momentum.unmodelled_wrench),
    ),
    tick("measured_base_position", XYZ, "m", "base position that the controller is given", |row, out| {
        out.extend(&row.state.estimate().robot.state.base.position);
    }),
    tick("measured_base_quaternion", WXYZ, "1", "base rotation that the controller is given", |row, out| {
        out.extend(wxyz_from_rotation(&row.state.estimate().robot.state.base.rotation));
    }),
    tick(
        "measured_base_velocity",
        SIX,
        "m s-1 (linear), rad s-1 (angular)",
        "base velocity that the controller is given, mixed",
        |row, out| out.extend(&row.state.estimate().robot.state.velocity.as_slice()[..6]),
    ),
    tick(
        "measured_joint_velocity",
        JOINT,
        "rad s-1",
        "joint velocity that the controller is given",
        |row, out| out.extend(row.state.estimate().robot.state.joint_velocity()),
    ),
    tick("measured_thrust", JET, "N", "thrust of each jet that the controller is given", |row, out| {
        out.extend(&row.state.estimate().robot.thrust);
    }),
    tick(
        "measured_wind",
        XYZ,
        "m s-1",
        "wind velocity that the controller is given, inertial frame",
        |row, out| out.extend(&row.state.estimate().robot.wind),
    ),
    tick(
        "measured_wind_std",
        XYZ,
        "m s-1",
        "standard deviation of that wind where it is estimated from the robot's motion, else zero",
        |row, out| out.extend(&row.state.estimate().wind_std),
    ),
    tick(
        "raw_base_position",
        XYZ,
        "m",
        "base position in the measurement of the tick, before estimators; NaN where it is not measured, as in all raw signals",
        |row, out| out.extend(&row.measurement.state.base.position),
    ),
    tick(
        "raw_base_rotation",
        ROTATION,
        "1",
        "base rotation in that measurement: the axes of the base as columns, inertial frame",
        |row, out| out.extend(row.measurement.state.base.rotation.transpose().iter()),
    ),
    tick(
        "raw_base_velocity",
        SIX,
        "m s-1 (linear), rad s-1 (angular)",
        "base velocity in that measurement, mixed",
        |row, out| out.extend(&row.measurement.state.velocity.as_slice()[..6]),
    ),
    tick("raw_joint_position", JOINT, "rad", "joint position in that measurement", |row, out| {
        out.extend(&row.measurement.state.joint_position);
    }),
    tick("raw_joint_velocity", JOINT, "rad s-1", "joint velocity in that measurement", |row, out| {
        out.extend(row.measurement.state.joint_velocity());
    }),
    tick("raw_thrust", JET, "N", "thrust of each jet in that measurement", |row, out| {
        out.extend(&row.measurement.thrust);
    }),
    tick(
        "raw_shaft_speed",
        JET,
        "1",
        "speed of the shaft of each jet in that measurement, a share of the full speed",
        |row, out| {
            let Measurement { thrust, shaft_speed, .. } = row.measurement;
            out.extend((0..thrust.len()).map(|jet| shaft_speed.get(jet).unwrap_or(&f64::NAN)));
        },
    ),
    tick("raw_wind", XYZ, "m s-1", "wind velocity in that measurement, inertial frame", |row, out| {
        out.extend(&row.measurement.wind);
    }),
    tick(
        "raw_height",
        TIME,
        "m",
        "height of the base origin in that measurement, above that on the ground",
        |row, out| out.push(row.measurement.height),
    ),
    tick(
        "raw_foot_wrench",
        FOOT_SIX,
        WRENCH,
        "wrench on each sole about its origin in that measurement, inertial axes; zero for a foot that the controller does not use",
        |row, out| row.every_foot(&row.measurement.foot_wrenches, out),
    )
    .of_ground(),
    tick("qp_status", QP, "1", "outcome of each QP", |row, out| {
        out.extend(row.qps().map(|answer| f64::from(answer.status.code())));
    })
    .coded(QP_STATUS),
    tick("qp_kkt", QP, "1", "scaled KKT residual of each QP's answer", |row, out| {
        out.extend(row.qps().map(|answer| answer.kkt));
    }),
    tick("qp_iterations", QP, "1", "active-set iterations of each QP", |row, out| {
        out.extend(row.qps().map(|answer| f64::from(answer.iterations)));
    })
    .integer(),
    tick("degraded_modes", TIME, "1", "what in the tick is not as usual, a sum of bits", |row, out| {
        out.push(f64::from(row.command.modes.bits()));
    })
    .bits(MODES),
    tick("joint_condition", JOINT, "1", "what the controller finds of each joint", |row, out| {
        out.extend(row.terms.limits.joints.iter().map(|found| f64::from(found.code())));
    })
    .coded(JOINT_CONDITION),
    tick(
        "measured_torque_latency",
        TIME,
        "s",
        "time from a tick until its torques act, as measured; NaN while it is not known",
        |row, out| out.push(row.terms.findings.latency[0].unwrap_or(f64::NAN)),
    ),
    tick(
        "measured_thrust_latency",
        TIME,
        "s",
        "time from a tick until its thrust rates act, as measured, with the lag of the engines",
        |row, out| out.push(row.terms.findings.latency[1].unwrap_or(f64::NAN)),
    ),
    Quantity::new(
        "joint_setpoint",
        &[Dimension::Joint],
        "rad",
        "posture of the first tick, which the controller holds",
        None,
    ),
    world(
        "joint_torque_measured",
        JOINT,
        "N m",
        "torque that reaches the joint: of the motor, less its friction",
        |row, out| row.seen(|seen| &seen.joint_torque, out),
    )
    .label("joint torque")
    .of_ground(),
    world(
        "foot_wrench",
        FOOT_SIX,
        WRENCH,
        "wrench on each sole about its origin, inertial axes",
        |row, out| row.seen(|seen| seen.foot_wrenches.iter().flatten(), out),
    )
    .of_ground(),
    world("sole_position", FOOT_XYZ, "m", "origin of each sole, inertial frame", |row, out| {
        row.seen(|seen| seen.soles.iter().flatten(), out);
    })
    .of_ground(),
    tick("feet_carry", TIME, "1", "whether the controller takes the feet to carry", |row, out| {
        out.push(f64::from(u8::from(row.state.contact().is_active)));
    })
    .coded(&[(0, "no"), (1, "yes")])
    .of_ground(),
    tick(
        "contact_force",
        FOOT_SIX,
        WRENCH,
        "foot wrenches f_c* that the controller integrates",
        |row, out| row.every_foot(&row.state.contact().force, out),
    )
    .of_ground(),
    tick(
        "contact_force_rate",
        FOOT_SIX,
        "N s-1 (force), N m s-1 (moment)",
        "rate of f_c* commanded by the momentum QP",
        |row, out| row.every_foot(&row.state.contact().force_rate, out),
    )
    .of_ground(),
    tick("contact_force_torque", FOOT_SIX, WRENCH, "foot wrenches that come with the torques", |row, out| {
        row.every_foot(&row.terms.contact.force_of_torques, out);
    })
    .of_ground(),
];

//! Feet on the ground: when they carry load, their wrenches, and the limits of these wrenches.
//!
//! ```text
//! carrying        the vertical force on every foot exceeds a threshold
//! feet stay       J_c ν = 0,   J_c ν̇ + J̇_c ν = 0
//! f_c*            ∫ ḟ_c* dt, from the measured wrenches when they began to carry
//! ```
//!
//! `f_c*` is the integral of the momentum QP's own answer, not a measurement: it is the estimate in the
//! momentum rate and the reference of the torque QP alike. Wrenches are about the sole's origin, force
//! first, inertial axes. Equations M54, M74, M75, M82, M111, M112 and M114 of `docs/model.md`.

use crate::dynamics::Dynamics;
use crate::error::{BuildError, Table, place_of};
use crate::kinematics::Kinematics;
use crate::robot::{Foot, RobotModel, check::unique};
use crate::spatial::Pose;
use nalgebra::{DMatrix, DVector, Vector3, Vector6};
use serde::{Deserialize, Serialize};

/// Numbers of a wrench: force and moment.
pub const WRENCH: usize = 6;

/// Corners of the friction polygon, four to a quadrant with its ends.
const FRICTION_SIDES: usize = 12;

/// Time after which an unexplained force is none of an impact \[s\]. For half of it what the feet measure at one time is not
/// what they exert during a tick (`take_off`, winds up to 10 m/s).
const IMPACT_TIME: f64 = 0.1;

/// Inequalities on the wrench of one foot: friction, torsion, unilateral, centre of pressure.
pub const WRENCH_ROWS: usize = FRICTION_SIDES + 2 + 1 + 4;

/// What a controller needs to stand; without it, it flies.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ContactConfig {
    /// Names of the feet to stand on; the robot's other feet are no contacts.
    pub feet: Vec<String>,
    /// Vertical force beyond which a foot carries \[N\]; all of `feet` have to.
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub vertical_force_min: f64,
    /// Whether `f_c*` starts with the measured moment about y besides the vertical force.
    pub start_with_moment: bool,
    /// Greatest rate of every component of `f_c*` \[N/s, N m/s\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub force_rate_max: f64,
    /// Rates below this are not integrated \[N/s, N m/s\].
    #[cfg_attr(feature = "schema", schemars(range(min = 0)))]
    pub force_rate_dead_zone: f64,
    /// Weight of `ḟ_c → 0` in the momentum QP.
    #[cfg_attr(feature = "schema", schemars(range(min = 0)))]
    pub weight_force_rate: f64,
    /// Weight of `J_c ν = 0` in the momentum QP.
    #[cfg_attr(feature = "schema", schemars(range(min = 0)))]
    pub weight_foot_velocity: f64,
    /// Weight of `J_c ν̇ + J̇_c ν = 0` in the torque QP.
    #[cfg_attr(feature = "schema", schemars(range(min = 0)))]
    pub weight_foot_acceleration: f64,
    /// Weight of `f_c → f_c*` in the torque QP.
    #[cfg_attr(feature = "schema", schemars(range(min = 0)))]
    pub weight_force: f64,
    /// What the wrench of a foot may be.
    pub wrench: WrenchLimits,
    /// How the robot takes off and lands; without it, it stays where it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub load_transfer: Option<LoadTransfer>,
}

/// How load passes between feet and jets. A robot whose feet carry takes off towards a set-point above its centre of
/// mass: the feet are relieved. Otherwise, and on its way down, it stands: the jets are relieved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LoadTransfer {
    /// Gain with which the load of feet or jets falls \[1/s\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub gain: f64,
    /// Gain with which `f_c*` of a robot that stands follows the measured wrenches \[1/s\].
    #[cfg_attr(feature = "schema", schemars(range(min = 0)))]
    pub measured_gain: f64,
    /// Height of the set-point above the centre of mass beyond which the robot takes off; a robot that stands has its
    /// set-point at most as far below \[m\].
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub height: f64,
    /// Time for which feet of a robot that stands may lose contact and still count as carrying \[s\].
    #[cfg_attr(feature = "schema", schemars(range(min = 0)))]
    pub hold_time: f64,
    /// Greatest vertical force on the robot that the controller's model may leave unexplained \[N\]: beyond it measured
    /// wrenches of the feet are wrong, and feet in the air carry if the set-point is below the centre of mass by `height`.
    /// Needs `controller.observer`; without it foot sensors are believed, and feet that are not measured do not begin to
    /// carry.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub unmodelled_force_max: Option<f64>,
}

/// What the wrench of every foot may be, in sole axes about the sole's origin.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct WrenchLimits {
    /// Friction `|f_xy| ≤ μ f_z`, as the regular polygon of twelve corners inside the circle.
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    pub friction: f64,
    /// Torsion `|m_z| ≤ κ f_z` \[m\].
    #[cfg_attr(feature = "schema", schemars(range(min = 0)))]
    pub torsional_friction: f64,
    /// Least vertical force \[N\].
    #[cfg_attr(feature = "schema", schemars(range(min = 0)))]
    pub vertical_force_min: f64,
    /// How far the centre of pressure stays inside the extent of the sole's corners \[m\]; the published one may be
    /// outside, where it is negative.
    #[serde(default)]
    pub centre_of_pressure_margin: f64,
}

impl ContactConfig {
    /// Refuses numbers that mean nothing, and a robot without feet.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] naming the key.
    pub fn check(&self, robot: &RobotModel) -> Result<(), BuildError> {
        let table = Table("controller.contact");
        if self.feet.is_empty() {
            return Err(BuildError::bad_value("controller.contact.feet", "[]", "at least one foot"));
        }
        unique("controller.contact.feet: foot", self.feet.iter().map(String::as_str))?;
        for name in &self.feet {
            place_of("controller.contact.feet", name, robot.feet.iter().map(|foot| &foot.name))?;
        }
        table.positive("vertical_force_min", self.vertical_force_min)?;
        table.positive("force_rate_max", self.force_rate_max)?;
        table.non_negative("force_rate_dead_zone", self.force_rate_dead_zone)?;
        table.non_negative("weight_force_rate", self.weight_force_rate)?;
        table.non_negative("weight_foot_velocity", self.weight_foot_velocity)?;
        table.non_negative("weight_foot_acceleration", self.weight_foot_acceleration)?;
        table.non_negative("weight_force", self.weight_force)?;
        if let Some(transfer) = &self.load_transfer {
            table.positive("load_transfer.gain", transfer.gain)?;
            table.non_negative("load_transfer.measured_gain", transfer.measured_gain)?;
            table.positive("load_transfer.height", transfer.height)?;
            table.non_negative("load_transfer.hold_time", transfer.hold_time)?;
            if let Some(force) = transfer.unmodelled_force_max {
                table.positive("load_transfer.unmodelled_force_max", force)?;
            }
        }
        let limits = &self.wrench;
        table.positive("wrench.friction", limits.friction)?;
        table.non_negative("wrench.torsional_friction", limits.torsional_friction)?;
        table.non_negative("wrench.vertical_force_min", limits.vertical_force_min)?;
        for foot in robot.feet.iter().filter(|foot| self.feet.contains(&foot.name)) {
            let [length, width] = foot.extent().map(|[least, greatest]| greatest - least);
            let half = 0.5 * length.min(width);
            let (key, margin) = ("wrench.centre_of_pressure_margin", limits.centre_of_pressure_margin);
            let expected = format!("at most half of the length and width of foot `{}`", foot.name);
            table.check(key, margin, |margin| margin <= half, &expected)?;
        }
        Ok(())
    }
}

impl WrenchLimits {
    /// The inequalities `row · (f, m) ≤ bound` on the wrench of a foot, in sole axes. The centre of pressure
    /// is at `(−m_y, m_x) / f_z`.
    #[must_use]
    pub fn rows(&self, foot: &Foot) -> [(Vector6<f64>, f64); WRENCH_ROWS] {
        let mut rows = [(Vector6::zeros(), 0.0); WRENCH_ROWS];
        let half_side = std::f64::consts::PI / FRICTION_SIDES as f64;
        // A side lies between two corners of the circle, so cos(half side) nearer than they.
        let reach = self.friction * libm::cos(half_side);
        for (side, (row, _)) in rows.iter_mut().take(FRICTION_SIDES).enumerate() {
            let (sin, cos) = libm::sincos(half_side * (2 * side + 1) as f64);
            *row = Vector6::new(cos, sin, -reach, 0.0, 0.0, 0.0);
        }
        let torsion = self.torsional_friction;
        let margin = self.centre_of_pressure_margin;
        let [[x_min, x_max], [y_min, y_max]] =
            foot.extent().map(|[least, greatest]| [least + margin, greatest - margin]);
        rows[12].0 = Vector6::new(0.0, 0.0, -torsion, 0.0, 0.0, 1.0);
        rows[13].0 = Vector6::new(0.0, 0.0, -torsion, 0.0, 0.0, -1.0);
        rows[14] = (Vector6::new(0.0, 0.0, -1.0, 0.0, 0.0, 0.0), -self.vertical_force_min);
        rows[15].0 = Vector6::new(0.0, 0.0, -x_max, 0.0, -1.0, 0.0);
        rows[16].0 = Vector6::new(0.0, 0.0, x_min, 0.0, 1.0, 0.0);
        rows[17].0 = Vector6::new(0.0, 0.0, -y_max, 1.0, 0.0, 0.0);
        rows[18].0 = Vector6::new(0.0, 0.0, y_min, -1.0, 0.0, 0.0);
        rows
    }
}

/// Whether the feet carry, and their desired wrenches, from one tick to the next.
#[derive(Debug, Clone, PartialEq)]
pub struct ContactState {
    /// Whether all feet carry.
    pub is_active: bool,
    /// `f_c*`, foot after foot; zero while the feet do not carry.
    pub force: DVector<f64>,
    /// `ḟ_c*` of the last tick, integrated when the next one begins; zero while the feet do not carry.
    pub force_rate: DVector<f64>,
    /// For how long one of the feet has not carried \[s\].
    unloaded_time: f64,
    /// For how long the model has not explained the vertical force \[s\].
    unknown_time: f64,
}

impl ContactState {
    /// Feet that carry nothing.
    #[must_use]
    pub fn new(feet: usize) -> Self {
        let nothing = DVector::zeros(WRENCH * feet);
        Self {
            is_active: false,
            force: nothing.clone(),
            force_rate: nothing,
            unloaded_time: f64::INFINITY,
            unknown_time: 0.0,
        }
    }
}

/// What a tick computes of the feet, none for a controller that only flies; preallocated.
#[derive(Debug, Clone)]
pub struct Contact {
    /// Whether feet that carry are to be relieved.
    pub takes_off: bool,
    /// `f_c` of the torque QP's answer, or `f_c*` where it has none; zero while the feet do not carry.
    pub force_of_torques: DVector<f64>,
    /// Poses of the soles.
    pub soles: Vec<Pose>,
    /// `J_cᵀ` (n × 6 feet): linear rows of each foot first; zero while the feet do not carry.
    pub jacobian_transposed: DMatrix<f64>,
    /// `J̇_c ν` (6 feet); zero while the feet do not carry.
    pub velocity_product: DVector<f64>,
    config: ContactConfig,
}

impl Contact {
    /// Space for the feet of `robot`, which carry nothing yet.
    #[must_use]
    pub fn new(config: &ContactConfig, robot: &RobotModel) -> Self {
        let feet = robot.feet.len();
        let nothing = DVector::zeros(WRENCH * feet);
        Self {
            takes_off: false,
            force_of_torques: nothing.clone(),
            soles: vec![Pose::identity(); feet],
            jacobian_transposed: DMatrix::zeros(6 + robot.joints.len(), WRENCH * feet),
            velocity_product: nothing,
            config: config.clone(),
        }
    }

    /// Advances `f_c*` of `state` by the last tick's rate, decides from the `measured` wrench of each foot whether the
    /// feet carry (when that changes, `f_c*` starts anew), and recomputes what depends on the state. The set-point is
    /// `climb` \[m\] above the centre of mass; jets and air leave the vertical force `left` \[N\] to the feet. They
    /// carry as well, and `f_c*` starts anew, where that `is_found`.
    #[allow(clippy::too_many_arguments)] // each is computed elsewhere in the tick
    pub fn update(
        &mut self,
        state: &mut ContactState,
        robot: &RobotModel,
        kinematics: &Kinematics,
        dynamics: &Dynamics,
        measured: &[Vector6<f64>],
        climb: f64,
        left: f64,
        is_found: bool,
        time_step: f64,
    ) {
        // Forward Euler: a rate is used in its own tick and integrated into the next.
        state.force.axpy(time_step, &state.force_rate, 1.0);
        state.force_rate.fill(0.0);
        let threshold = self.config.vertical_force_min;
        let is_loaded = !measured.is_empty() && measured.iter().all(|wrench| wrench[2] > threshold);
        let mut carries = is_loaded || is_found;
        if let Some(transfer) = &self.config.load_transfer {
            self.takes_off = climb > transfer.height;
            state.unloaded_time = if carries { 0.0 } else { state.unloaded_time + time_step };
            carries |= state.is_active && !self.takes_off && state.unloaded_time <= transfer.hold_time;
        }
        if carries != state.is_active || is_found {
            state.is_active = carries;
            self.restart(state, measured, left);
        }
        if !is_found {
            self.follow(state, measured, time_step);
        }
        for (sole, foot) in self.soles.iter_mut().zip(&robot.feet) {
            *sole = kinematics.frame_pose(&foot.frame);
        }
        if !state.is_active {
            self.jacobian_transposed.fill(0.0);
            self.velocity_product.fill(0.0);
            return;
        }
        for (index, foot) in robot.feet.iter().enumerate() {
            let (sole, first) = (&self.soles[index], WRENCH * index);
            let jacobian = &mut self.jacobian_transposed;
            kinematics.visit_jacobian_columns(foot.frame.body, &sole.position, |column, v, w| {
                for axis in 0..3 {
                    jacobian[(column, first + axis)] = v[axis];
                    jacobian[(column, first + 3 + axis)] = w[axis];
                }
            });
            let (linear, angular) = dynamics.velocity_product(kinematics, foot.frame.body, &sole.position);
            self.velocity_product.fixed_rows_mut::<3>(first).copy_from(&linear);
            self.velocity_product.fixed_rows_mut::<3>(first + 3).copy_from(&angular);
        }
    }

    /// Whether the feet carry something else than is known of them (M114): the set-point is `climb` \[m\] above the centre
    /// of mass, and the model does not explain the vertical force `unmodelled` \[N\], `elapsed` \[s\] after the last tick.
    pub fn carry_unknown(
        &self,
        state: &mut ContactState,
        are_measured: bool,
        climb: f64,
        unmodelled: f64,
        elapsed: f64,
    ) -> bool {
        let Some(transfer) = &self.config.load_transfer else { return false };
        let Some(greatest) = transfer.unmodelled_force_max else { return false };
        let is_unknown = if state.is_active {
            are_measured && unmodelled.abs() > greatest
        } else {
            let carried_just_now = are_measured && state.unloaded_time <= transfer.hold_time;
            unmodelled > greatest && (climb < -transfer.height || carried_just_now)
        };
        state.unknown_time = if is_unknown { state.unknown_time + elapsed } else { 0.0 };
        // Half a tick is for rounding.
        is_unknown && (!are_measured || state.unknown_time > IMPACT_TIME + 0.5 * elapsed)
    }

    /// Whether the feet carry a robot that can neither take off nor land.
    #[must_use]
    pub fn stays(&self, state: &ContactState) -> bool {
        state.is_active && self.config.load_transfer.is_none()
    }

    /// How far below the centre of mass the set-point of a robot that stands may be \[m\].
    #[must_use]
    pub fn stand_height(&self) -> Option<f64> {
        self.config.load_transfer.as_ref().map(|transfer| transfer.height)
    }

    /// Adds `A_c f_c` of the `measured` wrenches to a momentum rate.
    pub fn add_measured(&self, measured: &[Vector6<f64>], com: &Vector3<f64>, rate: &mut Vector6<f64>) {
        for (sole, wrench) in self.soles.iter().zip(measured) {
            *rate += wrench;
            let mut moment = rate.fixed_rows_mut::<3>(3);
            moment += (sole.position - com).cross(&wrench.fixed_rows::<3>(0));
        }
    }

    /// `f_c*` of a robot that takes off is what is measured; while it stands, what is measured draws it.
    fn follow(&self, state: &mut ContactState, measured: &[Vector6<f64>], time_step: f64) {
        let Some(transfer) = self.config.load_transfer.as_ref().filter(|_| state.is_active) else { return };
        let part = if self.takes_off { 1.0 } else { (transfer.measured_gain * time_step).min(1.0) };
        let wrenches = state.force.as_mut_slice().chunks_exact_mut(WRENCH);
        for (force, measured) in
            wrenches.zip(measured).flat_map(|(force, measured)| force.iter_mut().zip(measured))
        {
            *force += part * (measured - *force);
        }
    }

    /// Without load transfer vertical force and, where configured, moment about y, of each foot as measured; with it
    /// equal parts of the vertical force that jets and air leave, for a measurement would be that of the impact.
    fn restart(&self, state: &mut ContactState, measured: &[Vector6<f64>], left: f64) {
        state.force.fill(0.0);
        if !state.is_active {
            return;
        }
        if self.config.load_transfer.is_some() {
            for wrench in state.force.as_mut_slice().chunks_exact_mut(WRENCH) {
                wrench[2] = left.max(0.0) / measured.len() as f64;
            }
            return;
        }
        for (foot, wrench) in measured.iter().enumerate() {
            state.force[WRENCH * foot + 2] = wrench[2];
            if self.config.start_with_moment {
                state.force[WRENCH * foot + 4] = wrench[4];
            }
        }
    }

    /// Stores the rate of the momentum QP's answer; feet that carry nothing have none.
    pub fn store_rate(&self, state: &mut ContactState, rate: &[f64]) {
        if state.is_active {
            for (to, rate) in state.force_rate.iter_mut().zip(rate) {
                *to = if rate.abs() < self.config.force_rate_dead_zone { 0.0 } else { *rate };
            }
        }
    }
}

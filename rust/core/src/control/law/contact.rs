//! Contact of the feet with the ground: whether they carry load, their wrenches, and the limits of these wrenches.
//!
//! ```text
//! carrying        the vertical force on every foot exceeds a threshold
//! feet stay       J_c ν = 0,   J_c ν̇ + J̇_c ν = 0
//! f_c*            ∫ ḟ_c* dt, from the measured wrenches when they began to carry
//! ```
//!
//! `f_c*` is the integral of the momentum QP's own answer, not a measurement; the estimated momentum rate and the
//! torque QP both use it. Wrenches are about the sole's origin, force first, inertial axes. Equations M54, M74, M75,
//! M82, M111, M112 and M114 of `docs/model`.

use crate::dynamics::Dynamics;
use crate::error::{BuildError, Table, place_of};
use crate::kinematics::Kinematics;
use crate::robot::{Foot, RobotModel, check::unique};
use crate::spatial::Pose;
use crate::timing::Exceeded;
use nalgebra::{DMatrix, DVector, Vector3, Vector6};
use serde::{Deserialize, Serialize};

/// Entries of a wrench: force and moment.
pub const WRENCH: usize = 6;

/// Sides of the friction polygon.
const FRICTION_SIDES: usize = 12;

/// Time after which an unexplained force cannot be that of an impact \[s\]. For half of this time after an impact, the
/// wrenches measured at one instant are not those exerted during a tick (`take_off`, winds up to 10 m/s).
const IMPACT_TIME: f64 = 0.1;

/// Rates of `f_c*` below this are not integrated on a robot that only stands \[N/s, N m/s\], as published.
const DEAD_ZONE: f64 = 1e-5;

/// Torsional friction coefficient of `|m_z| ≤ κ f_z` \[m\], as published.
const TORSIONAL_FRICTION: f64 = 1.0 / 75.0;

/// Gain with which `f_c*` of a standing robot follows the measured wrenches \[1/s\].
const MEASURED_GAIN: f64 = 1.0;

/// Height of the set-point over the centre of mass beyond which the robot takes off \[m\]; the set-point of a standing
/// robot is limited to the same distance below the centre of mass.
const HEIGHT: f64 = 0.01;

/// Time for which the feet of a standing robot may lose contact and still count as carrying load \[s\].
const HOLD_TIME: f64 = 0.2;

/// Inequalities on the wrench of one foot: friction, torsion, unilateral, centre of pressure.
pub const WRENCH_ROWS: usize = FRICTION_SIDES + 2 + 1 + 4;

/// Configuration of standing on the ground; without it the controller only flies.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ContactConfig {
    /// Names of the feet to stand on; other feet of the robot are ignored.
    pub feet: Vec<String>,
    /// Vertical force above which a foot carries load \[N\]; all of `feet` have to exceed it.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub vertical_force_min: f64,
    /// Greatest rate of every component of `f_c*` \[N/s, N m/s\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub force_rate_max: f64,
    /// Weight of `ḟ_c → 0` in the momentum QP.
    #[schemars(range(min = 0))]
    pub weight_force_rate: f64,
    /// Limits of the wrench of a foot.
    pub wrench: WrenchLimits,
    /// Take-off and landing; without it the robot does neither.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub load_transfer: Option<LoadTransfer>,
}

/// Transfer of the load between feet and jets. A robot whose feet carry load takes off if its set-point is above its
/// centre of mass: the feet are unloaded. Otherwise, and during a descent, it stands: the jets are unloaded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LoadTransfer {
    /// Gain with which the load of the unloaded side (feet or jets) decreases \[1/s\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub gain: f64,
    /// Greatest vertical force on the robot that the controller's model may leave unexplained \[N\]. Above it, measured
    /// foot wrenches are judged wrong, and feet in the air count as carrying load if the set-point is below the centre
    /// of mass by the height of take-off. Needs `controller.disturbance_observer`; without it foot sensors are trusted, and feet that are not
    /// measured do not start to carry load.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub unmodelled_force_max: Option<f64>,
}

/// Limits of the wrench of every foot, in sole axes about the sole's origin.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WrenchLimits {
    /// Friction coefficient of `|f_xy| ≤ μ f_z`, approximated by the regular twelve-sided polygon inside the circle.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub friction: f64,
    /// Least vertical force \[N\].
    #[schemars(range(min = 0))]
    pub vertical_force_min: f64,
    /// Least distance of the centre of pressure from the edges of the rectangle around the sole's corners \[m\],
    /// positive inside. A negative value allows it outside, as published.
    #[serde(default)]
    pub centre_of_pressure_margin: f64,
}

impl ContactConfig {
    /// Checks that every value is in its range and that the robot has the feet.
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
        let limits = &self.wrench;
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
        // Sides of the polygon are nearer to its centre than its corners by the factor cos(half side).
        let reach = self.friction * libm::cos(half_side);
        for (side, (row, _)) in rows.iter_mut().take(FRICTION_SIDES).enumerate() {
            let (sin, cos) = libm::sincos(half_side * (2 * side + 1) as f64);
            *row = Vector6::new(cos, sin, -reach, 0.0, 0.0, 0.0);
        }
        let torsion = TORSIONAL_FRICTION;
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

/// Contact state: whether the feet carry load, and their desired wrenches; kept from tick to tick.
#[derive(Debug, Clone, PartialEq)]
pub struct ContactState {
    /// Whether all feet carry load.
    pub is_active: bool,
    /// `f_c*`, foot after foot; zero while the feet do not carry load.
    pub force: DVector<f64>,
    /// `ḟ_c*` of the last tick, integrated at the start of the next; zero while the feet do not carry load.
    pub force_rate: DVector<f64>,
    /// Time since all feet last carried load \[s\].
    unloaded_time: f64,
    /// For how long the model has not explained the vertical force.
    unknown: Exceeded,
}

impl ContactState {
    /// Feet that do not carry load.
    #[must_use]
    pub fn new(feet: usize) -> Self {
        let nothing = DVector::zeros(WRENCH * feet);
        Self {
            is_active: false,
            force: nothing.clone(),
            force_rate: nothing,
            unloaded_time: f64::INFINITY,
            unknown: Exceeded::default(),
        }
    }
}

/// Contact quantities computed in a tick; without feet they are empty. Preallocated.
#[derive(Debug, Clone)]
pub struct Contact {
    /// Whether feet that carry load are to be unloaded.
    pub takes_off: bool,
    /// `f_c` of the torque QP's answer, or `f_c*` if it has none; zero while the feet do not carry load.
    pub force_of_torques: DVector<f64>,
    /// Poses of the soles.
    pub soles: Vec<Pose>,
    /// `J_cᵀ` (n × 6 feet), linear columns of each foot first; zero while the feet do not carry load.
    pub jacobian_transposed: DMatrix<f64>,
    /// `J̇_c ν` (6 feet); zero while the feet do not carry load.
    pub velocity_product: DVector<f64>,
    config: ContactConfig,
}

impl Contact {
    /// Allocates for the feet of `robot`, which carry no load yet.
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

    /// Advances `f_c*` of `state` by the last tick's rate, decides from the `measured` foot wrenches whether the feet
    /// carry load, and recomputes all quantities that depend on the robot's state.
    ///
    /// The set-point is `climb` \[m\] above the centre of mass; jets and aerodynamic forces leave the vertical force
    /// `left` \[N\] to the feet. `is_found` is the result of [`Self::carry_unknown`]: the feet then carry load whatever
    /// is measured. `f_c*` restarts if it is true, and whenever the contact changes.
    #[allow(clippy::too_many_arguments)] // all are computed elsewhere in the tick
    pub fn update(
        &mut self,
        state: &mut ContactState,
        robot: &RobotModel,
        kinematics: &Kinematics,
        dynamics: &Dynamics,
        measured: &DVector<f64>,
        climb: f64,
        left: f64,
        is_found: bool,
        time_step: f64,
    ) {
        // Forward Euler: a rate is used in its own tick and integrated in the next.
        state.force.axpy(time_step, &state.force_rate, 1.0);
        state.force_rate.fill(0.0);
        let threshold = self.config.vertical_force_min;
        let mut vertical = measured.as_slice().chunks_exact(WRENCH).map(|wrench| wrench[2]);
        let is_loaded = !measured.is_empty() && vertical.all(|force| force > threshold);
        let mut carries = is_loaded || is_found;
        if self.config.load_transfer.is_some() {
            self.takes_off = climb > HEIGHT;
            state.unloaded_time = if carries { 0.0 } else { state.unloaded_time + time_step };
            carries |= state.is_active && !self.takes_off && state.unloaded_time <= HOLD_TIME;
        }
        if carries != state.is_active || is_found {
            state.is_active = carries;
            self.restart(state, measured, left);
        }
        if !is_found {
            self.follow_measured(state, measured, time_step);
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

    /// Whether the feet carry a load that the measurement does not show, or a load other than the measured one (M114).
    /// The set-point is `climb` \[m\] above the centre of mass, the model does not explain the vertical force
    /// `unmodelled` \[N\], and the last tick was `elapsed` \[s\] ago.
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
            let carried_just_now = are_measured && state.unloaded_time <= HOLD_TIME;
            unmodelled > greatest && (climb < -HEIGHT || carried_just_now)
        };
        state.unknown.update(is_unknown, elapsed);
        is_unknown && (!are_measured || state.unknown.has_lasted(IMPACT_TIME, elapsed))
    }

    /// Whether the feet carry load and the controller can neither take off nor land.
    #[must_use]
    pub fn stays(&self, state: &ContactState) -> bool {
        state.is_active && self.config.load_transfer.is_none()
    }

    /// Greatest distance of a standing robot's set-point below its centre of mass \[m\].
    #[must_use]
    pub fn stand_height(&self) -> Option<f64> {
        self.config.load_transfer.as_ref().map(|_| HEIGHT)
    }

    /// Sets `f_c*` to the measured wrenches during take-off; while the robot stands, `f_c*` follows them with a gain
    /// (M112).
    fn follow_measured(&self, state: &mut ContactState, measured: &DVector<f64>, time_step: f64) {
        if self.config.load_transfer.is_none() || !state.is_active {
            return;
        }
        let part = if self.takes_off { 1.0 } else { MEASURED_GAIN * time_step };
        for (force, measured) in state.force.iter_mut().zip(measured) {
            *force += part * (measured - *force);
        }
    }

    /// Restarts `f_c*`. Without load transfer: measured vertical force and moment about y of each foot, as published. With
    /// load transfer: equal parts of the vertical force that jets and aerodynamic forces leave (M112), because a measured
    /// wrench would be that of the impact.
    fn restart(&self, state: &mut ContactState, measured: &DVector<f64>, left: f64) {
        state.force.fill(0.0);
        if !state.is_active {
            return;
        }
        if self.config.load_transfer.is_some() {
            let feet = (measured.len() / WRENCH) as f64;
            for wrench in state.force.as_mut_slice().chunks_exact_mut(WRENCH) {
                wrench[2] = left.max(0.0) / feet;
            }
            return;
        }
        let wrenches = state.force.as_mut_slice().chunks_exact_mut(WRENCH);
        for (force, measured) in wrenches.zip(measured.as_slice().chunks_exact(WRENCH)) {
            (force[2], force[4]) = (measured[2], measured[4]);
        }
    }

    /// Stores the rate of the momentum QP's answer; without load on the feet there is none.
    pub fn store_rate(&self, state: &mut ContactState, rate: &[f64]) {
        if state.is_active {
            let dead_zone = if self.config.load_transfer.is_none() { DEAD_ZONE } else { 0.0 };
            for (to, rate) in state.force_rate.iter_mut().zip(rate) {
                *to = if rate.abs() < dead_zone { 0.0 } else { *rate };
            }
        }
    }
}

/// Adds `A_c f_c` of the `measured` wrenches on soles to a momentum rate, about the centre of mass `com`.
pub fn add_wrenches(soles: &[Pose], measured: &DVector<f64>, com: &Vector3<f64>, rate: &mut Vector6<f64>) {
    for (sole, wrench) in soles.iter().zip(measured.as_slice().chunks_exact(WRENCH)) {
        let wrench = Vector6::from_column_slice(wrench);
        *rate += wrench;
        let mut moment = rate.fixed_rows_mut::<3>(3);
        moment += (sole.position - com).cross(&wrench.fixed_rows::<3>(0));
    }
}

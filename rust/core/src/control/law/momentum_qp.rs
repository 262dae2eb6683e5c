//! The momentum QP: a stack of tasks on named blocks of unknowns, with bounds.
//!
//! ```text
//! u = (Ṫ, ḟ_c, ṡ),   task k demands  A_k u + b_k = 0  with weights W_k
//! H = Σ A_kᵀ W_k A_k,   g = Σ A_kᵀ W_k b_k
//! ```
//!
//! Tasks with rows contribute low-rank terms to `H`; tasks whose matrix is the identity on some unknowns contribute to
//! its diagonal. The controller's own tasks are in [`super::tasks`];
//! [`Controller::add_task`](crate::Controller::add_task) adds another:
//!
//! ```
//! use flight_core::control::law::momentum_qp::{Equations, Layout, Task, TaskInputs};
//!
//! /// Demands a velocity of one joint: `ṡ_j − v = 0`.
//! #[derive(Debug)]
//! struct KeepVelocity {
//!     /// Index of its velocity among the unknowns, `momentum_qp.unknowns.joint_velocity.start + joint`.
//!     unknown: usize,
//!     velocity: f64,
//!     weight: f64,
//! }
//!
//! impl Task for KeepVelocity {
//!     fn name(&self) -> &'static str {
//!         "keep velocity"
//!     }
//!     fn layout(&self) -> Layout {
//!         Layout::Diagonal { first: self.unknown, weights: vec![self.weight] }
//!     }
//!     fn update(&self, _: &TaskInputs, equations: &mut Equations) {
//!         equations.offset[0] = -self.velocity;
//!     }
//! }
//! ```
//!
//! Equations M64 and M65 of `docs/model`.

use super::attitude::{AttitudeDemand, MomentumGains};
use super::bounds::{BoundsConfig, LimitedValues};
use super::contact::{Contact, ContactState, WRENCH};
use super::momentum::MomentumModel;
use super::setpoint::Setpoint;
use crate::dynamics::Dynamics;
use crate::error::{BuildError, check};
use crate::kinematics::{Kinematics, RobotState};
use crate::linalg;
use crate::qp::QpProblem;
use crate::robot::RobotModel;
use nalgebra::{DMatrix, DVector, DVectorViewMut, Dyn, Matrix3, MatrixViewMut, U1};
use std::fmt::Debug;
use std::ops::Range;
use std::sync::Arc;

/// The blocks of unknowns as ranges of columns; a block may be empty.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unknowns {
    /// `Ṫ`, thrust rates of the jets \[N/s\].
    pub thrust_rate: Range<usize>,
    /// `ḟ_c`, rates of the wrenches of the feet \[N/s, N m/s\].
    pub force_rate: Range<usize>,
    /// `ṡ`, joint velocities \[rad/s, m/s\].
    pub joint_velocity: Range<usize>,
}

impl Unknowns {
    /// Blocks for the jets, feet and joints of `robot`.
    #[must_use]
    pub fn new(robot: &RobotModel) -> Self {
        let jets = robot.jets.len();
        let forces = jets + WRENCH * robot.feet.len();
        let all = forces + robot.joints.len();
        Self { thrust_rate: 0..jets, force_rate: jets..forces, joint_velocity: forces..all }
    }

    /// Number of unknowns.
    #[must_use]
    pub fn len(&self) -> usize {
        self.joint_velocity.end
    }

    /// Whether there are no unknowns.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Inputs of the tasks in one tick.
#[derive(Debug)]
pub struct TaskInputs<'a> {
    /// State of the robot.
    pub state: &'a RobotState,
    /// Thrusts \[N\].
    pub thrust: &'a [f64],
    /// Kinematics of the state.
    pub kinematics: &'a Kinematics,
    /// Dynamics of the state.
    pub dynamics: &'a Dynamics,
    /// Effect of thrusts and joint motion on the momentum.
    pub momentum: &'a MomentumModel,
    /// Set-point.
    pub setpoint: &'a Setpoint,
    /// Demand of the attitude law.
    pub attitude: &'a AttitudeDemand,
    /// Centroidal inertia in body axes at the first tick \[kg m²\].
    pub inertia_0_b: &'a Matrix3<f64>,
    /// Desired posture `s_d` \[rad\].
    pub posture: &'a DVector<f64>,
    /// Contact quantities of this tick.
    pub contact: &'a Contact,
    /// Whether the feet carry load, and their desired wrenches.
    pub contact_state: &'a ContactState,
    /// Gains of the momentum and attitude tasks.
    pub gains: &'a MomentumGains,
}

/// Shape and weights of a task; constant over time.
#[derive(Debug, Clone, PartialEq)]
pub enum Layout {
    /// One row over all unknowns for each of these weights.
    Rows(Vec<f64>),
    /// The identity on as many consecutive unknowns as there are weights.
    Diagonal {
        /// Index of the first of them.
        first: usize,
        /// Weight of each unknown.
        weights: Vec<f64>,
    },
}

/// Matrix and offset of a task, `matrixᵀ u + offset = 0`. Before `update` they hold the values of the tick before,
/// zeros at first.
#[derive(Debug)]
pub struct Equations<'a> {
    /// The *transposed* matrix: each row of the task is a column. It has no columns for [`Layout::Diagonal`].
    pub matrix: MatrixViewMut<'a, f64, Dyn, Dyn, U1, Dyn>,
    /// One entry for each weight.
    pub offset: DVectorViewMut<'a, f64>,
    /// Blocks of unknowns.
    pub unknowns: &'a Unknowns,
}

/// An objective of the momentum QP. `update` runs in every tick: it must not allocate and must not keep state.
pub trait Task: Debug + Send + Sync {
    /// Name of the task, unique within a controller.
    fn name(&self) -> &'static str;
    /// Shape and weights; queried once.
    fn layout(&self) -> Layout;
    /// Writes the equations of this tick.
    fn update(&self, inputs: &TaskInputs, equations: &mut Equations);
}

/// A task and the location of its equations.
#[derive(Debug, Clone)]
struct Entry {
    task: Arc<dyn Task>,
    /// Its rows among those of all tasks; empty for a diagonal task.
    rows: Range<usize>,
    /// Its entries in the offsets of all tasks.
    offsets: Range<usize>,
    /// Index of the first unknown of a diagonal task.
    first: usize,
}

/// The momentum QP of one tick; preallocated.
#[derive(Debug, Clone)]
pub struct MomentumQp {
    /// The QP handed to the solver.
    pub problem: QpProblem,
    /// Blocks of unknowns.
    pub unknowns: Unknowns,
    stack: Vec<Entry>,
    /// Rows of all tasks, stored as columns; those of [`super::tasks::MOMENTUM_ROWS`] come first.
    pub matrix: DMatrix<f64>,
    /// Offsets of all tasks, in the order of the tasks.
    pub offset: DVector<f64>,
    weights: DVector<f64>,
    /// `√W`.
    roots: DVector<f64>,
    /// `√W A` of the rows.
    weighted: DMatrix<f64>,
    /// Contribution of the diagonal tasks to `H`.
    diagonal: DVector<f64>,
    limited: LimitedValues,
    /// Greatest rate of the wrenches of feet that carry load \[N/s, N m/s\].
    force_rate_max: f64,
}

impl MomentumQp {
    /// The QP of `robot` without tasks; `force_rate_max` is the greatest rate of the wrenches of feet that carry load
    /// \[N/s, N m/s\].
    #[must_use]
    pub fn new(bounds: &BoundsConfig, force_rate_max: f64, robot: &RobotModel) -> Self {
        let unknowns = Unknowns::new(robot);
        let n = unknowns.len();
        let mut qp = Self {
            problem: QpProblem::new(n, 0),
            stack: Vec::new(),
            matrix: DMatrix::zeros(n, 0),
            offset: DVector::zeros(0),
            weights: DVector::zeros(0),
            roots: DVector::zeros(0),
            weighted: DMatrix::zeros(n, 0),
            diagonal: DVector::zeros(n),
            limited: LimitedValues::new(n),
            force_rate_max,
            unknowns,
        };
        let Unknowns { thrust_rate, joint_velocity, .. } = qp.unknowns.clone();
        let limited = &mut qp.limited;
        limited.rate_max[thrust_rate.clone()].copy_from_slice(&robot.by_jet(&bounds.thrust_rate_max));
        limited.steepness[thrust_rate].fill(bounds.thrust_steepness);
        limited.steepness[joint_velocity.clone()].fill(bounds.joint_steepness);
        for (joint, unknown) in robot.joints.iter().zip(joint_velocity) {
            (limited.least[unknown], limited.greatest[unknown]) = joint.limits;
        }
        qp
    }

    /// Adds a task; not to be called in a tick.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] for a name that is in use, unknowns that do not exist, and invalid weights.
    pub fn add(&mut self, task: Arc<dyn Task>) -> Result<(), BuildError> {
        let (item, n) = (format!("task `{}`", task.name()), self.unknowns.len());
        if self.stack.iter().any(|entry| entry.task.name() == task.name()) {
            return Err(BuildError::bad_value("name of a task", task.name(), "one that no other task has"));
        }
        let (rows, first, weights) = match task.layout() {
            Layout::Rows(weights) => (weights.len(), 0, weights),
            Layout::Diagonal { first, weights } => (0, first, weights),
        };
        if rows == 0 && first + weights.len() > n {
            let end = first + weights.len();
            return Err(BuildError::bad_value(
                format!("end of {item}"),
                end,
                format!("at most {n} unknowns"),
            ));
        }
        for &weight in &weights {
            check(&format!("weight of {item}"), weight, |w| w >= 0.0, "a number ≥ 0")?;
        }
        if rows == 0 {
            for (entry, weight) in self.diagonal.rows_mut(first, weights.len()).iter_mut().zip(&weights) {
                *entry += weight;
            }
        }
        let (old_rows, old) = (self.matrix.ncols(), self.offset.len());
        let (rows, offsets) = (old_rows..old_rows + rows, old..old + weights.len());
        self.matrix.resize_horizontally_mut(rows.end, 0.0);
        self.weighted.resize_horizontally_mut(rows.end, 0.0);
        self.offset.resize_vertically_mut(offsets.end, 0.0);
        self.weights.resize_vertically_mut(offsets.end, 0.0);
        self.weights.rows_mut(old, weights.len()).copy_from_slice(&weights);
        self.roots = self.weights.map(f64::sqrt);
        self.stack.push(Entry { task, rows, offsets, first });
        Ok(())
    }

    /// Matrix (one column for each unknown), offset and weights of a task; `None` if there is none of this name.
    /// Allocates, so only for tests and reports.
    #[must_use]
    pub fn task(&self, name: &str) -> Option<(DMatrix<f64>, DVector<f64>, DVector<f64>)> {
        let entry = self.stack.iter().find(|entry| entry.task.name() == name)?;
        let (first, count) = (entry.offsets.start, entry.offsets.len());
        let mut matrix = DMatrix::zeros(count, self.unknowns.len());
        if entry.rows.is_empty() {
            matrix.view_mut((0, entry.first), (count, count)).fill_with_identity();
        } else {
            matrix.tr_copy_from(&self.matrix.columns(entry.rows.start, count));
        }
        Some((matrix, self.offset.rows(first, count).into(), self.weights.rows(first, count).into()))
    }

    /// Updates tasks and cost for this tick.
    pub fn update(&mut self, inputs: &TaskInputs) {
        for Entry { task, rows, offsets, .. } in &self.stack {
            let mut equations = Equations {
                matrix: self.matrix.columns_mut(rows.start, rows.len()),
                offset: self.offset.rows_mut(offsets.start, offsets.len()),
                unknowns: &self.unknowns,
            };
            task.update(inputs, &mut equations);
        }
        self.update_cost();
    }

    /// `H = Σ Aᵀ W A`, `g = Σ Aᵀ W b`.
    fn update_cost(&mut self) {
        let QpProblem { h, g, .. } = &mut self.problem;
        g.fill(0.0);
        for Entry { rows, offsets, first, .. } in &self.stack {
            for (row, entry) in rows.clone().zip(offsets.clone()) {
                let root = self.roots[entry];
                let from = self.matrix.column(row);
                self.weighted.column_mut(row).zip_apply(&from, |to, from| *to = root * from);
                g.axpy(self.weights[entry] * self.offset[entry], &from, 1.0);
            }
            if rows.is_empty() {
                for (unknown, entry) in (*first..).zip(offsets.clone()) {
                    g[unknown] += self.weights[entry] * self.offset[entry];
                }
            }
        }
        linalg::times_transpose(self.weighted.as_slice(), g.len(), h.as_mut_slice());
        for (unknown, weight) in self.diagonal.iter().enumerate() {
            h[(unknown, unknown)] += weight;
        }
    }

    /// Fixes the velocity of a joint that follows none at the one that it has \[rad/s, m/s\].
    pub fn fix_velocity(&mut self, joint: usize, velocity: f64) {
        let unknown = self.unknowns.joint_velocity.start + joint;
        (self.problem.lower[unknown], self.problem.upper[unknown]) = (velocity, velocity);
    }

    /// Updates the bounds for this tick. They keep thrusts within the given ranges \[N\], and joints within their
    /// position limits and the given greatest velocities \[rad/s, m/s\]. Wrench rates of feet without load are fixed at
    /// zero, which removes them from the solver's free variables.
    pub fn update_bounds(
        &mut self,
        inputs: &TaskInputs,
        thrust_ranges: impl IntoIterator<Item = (f64, f64)>,
        velocity_max: impl IntoIterator<Item = f64>,
    ) {
        let Unknowns { thrust_rate, force_rate, joint_velocity } = &self.unknowns;
        let limited = &mut self.limited;
        let force_rate_max = if inputs.contact_state.is_active { self.force_rate_max } else { 0.0 };
        limited.rate_max[force_rate.clone()].fill(force_rate_max);
        limited.value[thrust_rate.clone()].copy_from_slice(inputs.thrust);
        for (unknown, range) in thrust_rate.clone().zip(thrust_ranges) {
            (limited.least[unknown], limited.greatest[unknown]) = range;
        }
        limited.value[joint_velocity.clone()].copy_from_slice(inputs.state.joint_position.as_slice());
        for (unknown, velocity_max) in joint_velocity.clone().zip(velocity_max) {
            limited.rate_max[unknown] = velocity_max;
        }
        limited.write_bounds(self.problem.lower.as_mut_slice(), self.problem.upper.as_mut_slice());
    }
}

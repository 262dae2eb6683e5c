//! The momentum QP: a stack of tasks over named blocks of unknowns, with bounds.
//!
//! ```text
//! u = (Ṫ, ḟ_c, ṡ),   task k asks  A_k u + b_k = 0  with weights W_k
//! H = Σ A_kᵀ W_k A_k,   g = Σ A_kᵀ W_k b_k
//! ```
//!
//! Tasks with rows make `H` of low rank, those without, whose matrix is the identity on some unknowns, make it
//! diagonal. The controller's own tasks are in [`super::tasks`]; [`super::Controller::add_task`] adds another one:
//!
//! ```
//! use flight_core::control::momentum_qp::{Equations, Layout, Task, TaskInputs};
//!
//! /// Asks one joint to turn at a velocity: `ṡ_j − v = 0`.
//! #[derive(Debug)]
//! struct KeepVelocity {
//!     /// Its place among the unknowns, `momentum_qp.unknowns.joint_velocity.start + joint`.
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
//! Equations M64 and M65 of `docs/model.md`.

use super::attitude::AttitudeDemand;
use super::bounds::LimitedValues;
use super::config::{ControllerConfig, MomentumGains, per_jet};
use super::contact::{Contact, ContactState, WRENCH};
use super::momentum::MomentumModel;
use super::setpoint::Setpoint;
use super::tasks::standard_tasks;
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

/// The blocks of unknowns, as ranges of columns; a block may be empty.
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
    /// Those of a robot with its jets, feet and joints.
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

    /// Whether there is nothing to decide.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// What the tasks of a tick are made from.
#[derive(Debug)]
pub struct TaskInputs<'a> {
    /// The measured state.
    pub state: &'a RobotState,
    /// The measured thrusts \[N\].
    pub thrust: &'a [f64],
    /// Its kinematics.
    pub kinematics: &'a Kinematics,
    /// Its dynamics.
    pub dynamics: &'a Dynamics,
    /// How forces change the momentum.
    pub momentum: &'a MomentumModel,
    /// What to follow.
    pub setpoint: &'a Setpoint,
    /// What the attitude law asks for.
    pub attitude: &'a AttitudeDemand,
    /// Centroidal inertia in body axes at the first tick \[kg m²\].
    pub inertia_0_b: &'a Matrix3<f64>,
    /// Desired posture `s_d` \[rad\].
    pub posture: &'a DVector<f64>,
    /// What the tick computed of the feet.
    pub contact: &'a Contact,
    /// Whether the feet carry, and their desired wrenches.
    pub contact_state: &'a ContactState,
    /// Gains of momentum and attitude.
    pub gains: &'a MomentumGains,
}

/// Shape and weights of a task; they do not change from tick to tick.
#[derive(Debug, Clone, PartialEq)]
pub enum Layout {
    /// One row over all unknowns for each of these weights.
    Rows(Vec<f64>),
    /// The identity on as many unknowns as there are weights.
    Diagonal {
        /// The first of them.
        first: usize,
        /// Weight of each.
        weights: Vec<f64>,
    },
}

/// Matrix and offset of a task: it asks `matrixᵀ u + offset = 0`. They hold what the tick before wrote, zeros at first.
#[derive(Debug)]
pub struct Equations<'a> {
    /// The *transposed* matrix: each row of the task is a column. Without columns for [`Layout::Diagonal`].
    pub matrix: MatrixViewMut<'a, f64, Dyn, Dyn, U1, Dyn>,
    /// An entry for each weight.
    pub offset: DVectorViewMut<'a, f64>,
    /// Where the blocks of unknowns are.
    pub unknowns: &'a Unknowns,
}

/// An objective of the momentum QP. `update` runs in the tick: it must not allocate, and has no state.
pub trait Task: Debug + Send + Sync {
    /// What it is called; no two tasks of a controller are called the same.
    fn name(&self) -> &'static str;
    /// Its shape and weights; asked for once.
    fn layout(&self) -> Layout;
    /// Writes its equations of this tick.
    fn update(&self, inputs: &TaskInputs, equations: &mut Equations);
}

/// A task and where its equations are.
#[derive(Debug, Clone)]
struct Entry {
    task: Arc<dyn Task>,
    /// Its rows among those of all tasks; empty for a diagonal one.
    rows: Range<usize>,
    /// Its entries among the offsets of all tasks.
    offsets: Range<usize>,
    /// First unknown of a diagonal task.
    first: usize,
}

/// The momentum QP of one tick; preallocated.
#[derive(Debug, Clone)]
pub struct MomentumQp {
    /// The QP handed to the solver.
    pub problem: QpProblem,
    /// Where the blocks of unknowns are.
    pub unknowns: Unknowns,
    stack: Vec<Entry>,
    /// Rows of all tasks, each a column; first those of [`super::tasks::MOMENTUM_ROWS`].
    pub matrix: DMatrix<f64>,
    /// Offsets of all tasks, in their order.
    pub offset: DVector<f64>,
    weights: DVector<f64>,
    /// `√W`.
    roots: DVector<f64>,
    /// `√W A` of the rows.
    weighted: DMatrix<f64>,
    /// The diagonal part of `H`.
    diagonal: DVector<f64>,
    limited: LimitedValues,
    /// Greatest rate of the wrenches of feet that carry \[N/s, N m/s\].
    force_rate_max: f64,
}

impl MomentumQp {
    /// The QP of `robot` with the controller's own tasks; `config` has been checked against it.
    ///
    /// # Errors
    /// [`BuildError`] for names the robot does not have.
    pub fn new(config: &ControllerConfig, robot: &RobotModel) -> Result<Self, BuildError> {
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
            force_rate_max: config.contact.as_ref().map_or(0.0, |contact| contact.force_rate_max),
            unknowns,
        };
        let Unknowns { thrust_rate, joint_velocity, .. } = qp.unknowns.clone();
        let limited = &mut qp.limited;
        limited.rate_max[thrust_rate.clone()]
            .copy_from_slice(&per_jet(&config.bounds.thrust_rate_max, robot));
        limited.steepness[thrust_rate].fill(config.bounds.thrust_steepness);
        limited.steepness[joint_velocity.clone()].fill(config.bounds.joint_steepness);
        for (joint, unknown) in robot.joints.iter().zip(joint_velocity) {
            (limited.least[unknown], limited.greatest[unknown]) = joint.limits;
        }
        for task in standard_tasks(config, robot, &qp.unknowns)? {
            qp.add(task)?;
        }
        Ok(qp)
    }

    /// Adds a task; not in a tick.
    ///
    /// # Errors
    /// [`BuildError::BadValue`] for a name that is taken, unknowns that do not exist, and weights that are no weights.
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

    /// Matrix (an unknown a column), offset and weights of a task; `None` if there is none of this name. Allocates:
    /// for tests and reports.
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

    /// Builds tasks and cost of one tick.
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

    /// Builds the bounds of one tick: thrusts stay within these ranges \[N\], joints within their limits by these
    /// greatest velocities \[rad/s, m/s\]. Wrenches of feet that do not carry are fixed, so that the solver leaves them out.
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

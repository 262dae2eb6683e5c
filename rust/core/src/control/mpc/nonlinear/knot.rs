//! The dynamics at a knot, the motion to the next one, and the cost, both expanded.
//!
//! Equations M178 to M180 of `docs/model`.

use crate::aero::{AeroModel, LinkConventions, LinkForces};
use crate::control::law::momentum::{AeroFeedback, MomentumModel, RateFeedback};
use crate::control::measure::measurement::Measurement;
use crate::control::mpc::clearance::{self, Clearance};
use crate::control::mpc::config::{Air, JOINT_EXCESS, MpcConfig};
use crate::control::mpc::model::{self, Linearised};
use crate::control::terms::{Present, Terms};
use crate::dynamics::Dynamics;
use crate::jets::JetModel;
use crate::kinematics::Kinematics;
use crate::linalg;
use crate::robot::RobotModel;
use crate::spatial::{exp_so3, log_so3, skew};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3, Vector6};

/// What does not change along a plan.
#[derive(Debug, Clone, Copy)]
pub struct World<'a> {
    /// The controller's model.
    pub robot: &'a RobotModel,
    /// Points at which its links' forces act.
    pub conventions: LinkConventions,
    /// Whether the wrench of the air changes along the plan.
    pub air: Air,
    /// Where the plan begins.
    pub now: Present<'a>,
    /// The posture \[rad\].
    pub posture: &'a DVector<f64>,
    /// Height of the centre of mass at touch-down \[m\].
    pub ground: f64,
    /// Speed of the descent \[m/s\].
    pub speed: f64,
}

impl Air {
    /// Part of the air that the momentum rate of a knot computes.
    fn in_rate(self) -> RateFeedback {
        match self {
            Self::Linear => RateFeedback::Wrench,
            Self::Constant => RateFeedback::None,
        }
    }
}

/// Places in the state: velocity, rotation, angular momentum, thrusts.
const V: usize = 1;
const THETA: usize = 4;
const K: usize = 7;
const T: usize = 10;
/// Differences of a thrust and a thrust rate for derivatives of its acceleration \[N, N/s\].
const SMALL: f64 = 1e-4;
/// Weights of squares, per second; the sweep `robot_descent` judges them. Velocity of the centre of mass, along x, y and z
/// \[s²/m²\]; beyond this speed its horizontal cost grows linearly (pseudo-Huber) \[m/s\]: a fast robot that brakes at
/// once turns over.
const VELOCITY: [f64; 3] = [80.0, 80.0, 300.0];
const LINEAR_BEYOND: f64 = 0.25;
/// Lean, of which `2 (1 − cos)` is the square \[1/rad²\], and angular velocity \[s²/rad²\].
const LEAN: f64 = 400.0;
const ANGULAR_VELOCITY: f64 = 5.0;
/// Joint positions about the posture of the first tick \[1/rad²\], and joint velocities \[s²/rad²\].
const POSTURE: f64 = 0.05;
const JOINT_VELOCITY: f64 = 1.0;
/// Thrust rates \[s²/N²\].
const THRUST_RATE: f64 = 1e-6;
/// Distances below the least one, not per second \[1/m²\].
const CLEARANCE: f64 = 300.0;
/// Weight of an engine's input about the middle of its range, per second: it selects one of equal descents.
const ENGINE_INPUT: f64 = 0.01;

/// State of the robot at a knot.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Height of the centre of mass \[m\].
    pub height: f64,
    /// Its velocity \[m/s\].
    pub velocity: Vector3<f64>,
    /// Rotation of the base.
    pub rotation: Matrix3<f64>,
    /// Angular momentum about the centre of mass \[kg m²/s\].
    pub momentum: Vector3<f64>,
    /// Thrusts \[N\].
    pub thrust: Vec<f64>,
    /// Their rates \[N/s\].
    pub rate: Vec<f64>,
    /// Positions of the joints that the law moves \[rad\].
    pub joints: Vec<f64>,
}

impl State {
    /// Returns a state at zero, of a number of jets and of planned joints.
    #[must_use]
    pub fn new(jets: usize, joints: usize) -> Self {
        Self {
            height: 0.0,
            velocity: Vector3::zeros(),
            rotation: Matrix3::identity(),
            momentum: Vector3::zeros(),
            thrust: vec![0.0; jets],
            rate: vec![0.0; jets],
            joints: vec![0.0; joints],
        }
    }

    /// Number of its differences from another one.
    #[must_use]
    pub fn size(&self) -> usize {
        T + 2 * self.thrust.len() + self.joints.len()
    }

    /// Writes the difference from another state.
    pub fn minus(&self, other: &Self, to: &mut DVector<f64>) {
        to[0] = self.height - other.height;
        to.fixed_rows_mut::<3>(V).copy_from(&(self.velocity - other.velocity));
        to.fixed_rows_mut::<3>(THETA).copy_from(&log_so3(&(self.rotation * other.rotation.transpose())));
        to.fixed_rows_mut::<3>(K).copy_from(&(self.momentum - other.momentum));
        let own = self.thrust.iter().chain(&self.rate).chain(&self.joints);
        let others = other.thrust.iter().chain(&other.rate).chain(&other.joints);
        for (to, (own, other)) in to.as_mut_slice()[T..].iter_mut().zip(own.zip(others)) {
            *to = own - other;
        }
    }

    /// Takes the values of the present; `joints` are the places of the planned ones.
    pub fn set_from(&mut self, now: &Present, joints: &[usize]) {
        let (terms, robot) = (now.terms, &now.estimate.robot);
        let momentum = &terms.dynamics.momentum;
        self.height = terms.kinematics.com.z;
        self.velocity = momentum.fixed_rows::<3>(0) / terms.kinematics.mass();
        self.rotation = robot.state.base.rotation;
        self.momentum = momentum.fixed_rows::<3>(3).into();
        let jets = self.thrust.len();
        self.thrust.copy_from_slice(&robot.thrust[..jets]);
        self.rate.copy_from_slice(&now.estimate.thrust_rate[..jets]);
        for (to, joint) in self.joints.iter_mut().zip(joints) {
            *to = robot.state.joint_position[*joint];
        }
    }
}

/// Dynamics and cost of a knot, expanded about its state and input.
#[derive(Debug, Clone)]
pub struct Expansion {
    /// `(A B)`, n × (n + m).
    pub dynamics: Vec<f64>,
    /// The same, transposed.
    pub transposed: Vec<f64>,
    /// Cost of the knot.
    pub cost: f64,
    /// Its derivative by state and inputs.
    pub gradient: Vec<f64>,
    /// (n + m) × (n + m).
    pub hessian: Vec<f64>,
}

impl Expansion {
    /// Returns one of `n` states and `m` inputs at zero.
    #[must_use]
    pub fn new(n: usize, m: usize) -> Self {
        let w = n + m;
        Self {
            dynamics: vec![0.0; n * w],
            transposed: vec![0.0; n * w],
            cost: 0.0,
            gradient: vec![0.0; w],
            hessian: vec![0.0; w * w],
        }
    }

    /// Adds `½ weight r²`, where r changes by `row`.
    fn add_square(&mut self, weight: f64, residual: f64, row: &[f64]) {
        let w = self.gradient.len();
        self.cost += 0.5 * weight * residual * residual;
        linalg::add_scaled(&mut self.gradient, weight * residual, row);
        for (column, by) in row.iter().enumerate() {
            if *by != 0.0 {
                linalg::add_scaled(&mut self.hessian[column * w..(column + 1) * w], weight * by, row);
            }
        }
    }

    fn add_single(&mut self, weight: f64, residual: f64, place: usize) {
        let w = self.gradient.len();
        self.cost += 0.5 * weight * residual * residual;
        self.gradient[place] += weight * residual;
        self.hessian[place * (w + 1)] += weight;
    }
}

/// The dynamics at one state; preallocated.
#[derive(Debug)]
pub struct Knot {
    /// Weight of a thrust beyond its range \[1/N²\].
    thrust_excess: f64,
    /// Places of the planned joints.
    pub joints: Vec<usize>,
    jets: Vec<JetModel>,
    works: Vec<bool>,
    /// What the law's momentum rate has at the beginning beside that of the knots: observed, or the air as it stays \[N, N m\].
    beyond: Vector6<f64>,
    /// Limits of the inputs.
    pub bounds: Vec<(f64, f64)>,
    robot: Measurement,
    kinematics: Kinematics,
    dynamics: Dynamics,
    link_forces: LinkForces,
    momentum: MomentumModel,
    model: Linearised,
    clearance: Clearance,
    /// ∂ẋ/∂(x, u), and ẋ.
    by: DMatrix<f64>,
    x_dot: DVector<f64>,
    x_ddot: DVector<f64>,
    row: Vec<f64>,
}

impl Knot {
    /// Returns the knots' dynamics and cost, with their workspace.
    #[must_use]
    pub fn new(
        mpc: &MpcConfig,
        robot: &RobotModel,
        jets: Vec<JetModel>,
        joints: Vec<usize>,
        clearance: Clearance,
    ) -> Self {
        let (n, m) = (T + 2 * jets.len() + joints.len(), jets.len() + joints.len());
        Self {
            works: vec![true; jets.len()],
            beyond: Vector6::zeros(),
            bounds: vec![(0.0, 1.0); m],
            robot: Measurement::zero(robot.joints.len(), jets.len(), 0),
            kinematics: Kinematics::new(robot),
            dynamics: Dynamics::new(robot),
            link_forces: LinkForces::new(robot),
            momentum: MomentumModel::new(robot),
            model: Linearised::new(robot, joints.clone()),
            clearance,
            thrust_excess: mpc.thrust_excess,
            by: DMatrix::zeros(n, n + m),
            x_dot: DVector::zeros(n),
            x_ddot: DVector::zeros(n),
            row: vec![0.0; n + m],
            jets,
            joints,
        }
    }

    /// Takes what is constant along the plan.
    pub fn begin(&mut self, world: &World) {
        let Present { terms, estimate } = world.now;
        self.robot.state.copy_from(&estimate.robot.state);
        self.robot.state.velocity.fill(0.0);
        self.robot.wind = estimate.robot.wind;
        let Terms { kinematics, link_forces, momentum, .. } = terms;
        let thrust = &estimate.robot.thrust;
        self.beyond = momentum.rate_estimate
            - momentum.rate(world.robot, kinematics, thrust, link_forces, world.air.in_rate());
        let jets = self.jets.len();
        self.works.copy_from_slice(&terms.limits.works);
        for (bound, works) in self.bounds.iter_mut().zip(&self.works) {
            *bound = (0.0, f64::from(u8::from(*works)));
        }
        for (bound, joint) in self.bounds[jets..].iter_mut().zip(&self.joints) {
            let most = terms.limits.joint_velocity[*joint];
            *bound = (-most, most);
        }
    }

    /// Inputs that hold the thrusts and the joints.
    pub fn hold(&self, world: &World, inputs: &mut [f64]) {
        inputs.fill(0.0);
        for (jet, input) in inputs.iter_mut().enumerate().take(self.jets.len()) {
            let (least, greatest) = self.range(jet, world.now.estimate.robot.thrust[jet], 0.0);
            if self.works[jet] {
                *input = (-least / (greatest - least)).clamp(0.0, 1.0);
            }
        }
    }

    fn range(&self, jet: usize, thrust: f64, rate: f64) -> (f64, f64) {
        match &self.jets[jet].engine {
            Some(engine) if self.works[jet] => engine.lasting_range(thrust, rate),
            _ => (0.0, 0.0),
        }
    }

    /// Second derivative of a thrust \[N/s²\].
    #[must_use]
    pub fn acceleration(&self, jet: usize, thrust: f64, rate: f64, input: f64) -> f64 {
        let (least, greatest) = self.range(jet, thrust, rate);
        least + input * (greatest - least)
    }

    /// Goes on from a state under inputs, and expands dynamics and cost; `None` where the inertia cannot be inverted. The
    /// durations \[s\] are those of the motion and of the cost.
    pub fn advance(
        &mut self,
        aero: &mut AeroModel,
        world: &World,
        (state, inputs): (&State, &[f64]),
        (step, duration): (f64, f64),
        next: &mut State,
        expansion: &mut Expansion,
    ) -> Option<()> {
        let rate = self.update(aero, world, state, inputs)?;
        self.write_dynamics(state, inputs, &rate);
        self.write_cost(world, state, inputs, duration, expansion);
        self.step(state, step, next);
        self.write_step(step, expansion);
        Some(())
    }

    /// Kinematics and dynamics at a state; returns the rate of the momentum.
    fn update(
        &mut self,
        aero: &mut AeroModel,
        world: &World,
        state: &State,
        inputs: &[f64],
    ) -> Option<Vector6<f64>> {
        let robot = world.robot;
        let jets = self.jets.len();
        let of = &mut self.robot;
        of.state.base.rotation = state.rotation;
        of.state.velocity.fill(0.0);
        of.thrust.copy_from_slice(&state.thrust);
        for ((joint, position), velocity) in self.joints.iter().zip(&state.joints).zip(&inputs[jets..]) {
            of.state.joint_position[*joint] = *position;
            of.state.velocity[6 + joint] = *velocity;
        }
        self.kinematics.update(robot, &of.state);
        self.dynamics.update_momentum(robot, &of.state, &self.kinematics);
        let Dynamics { centroidal_inertia, momentum, .. } = &mut self.dynamics;
        let mass = self.kinematics.mass();
        let (l, k): (Vector3<f64>, Vector3<f64>) =
            (momentum.fixed_rows::<3>(0).into(), momentum.fixed_rows::<3>(3).into());
        let omega = centroidal_inertia.try_inverse()? * (state.momentum - k);
        let arm = self.kinematics.com - of.state.base.position;
        let base = state.velocity - l / mass - omega.cross(&arm);
        of.state.velocity.fixed_rows_mut::<3>(0).copy_from(&base);
        of.state.velocity.fixed_rows_mut::<3>(3).copy_from(&omega);
        momentum.fixed_rows_mut::<3>(0).copy_from(&(state.velocity * mass));
        momentum.fixed_rows_mut::<3>(3).copy_from(&state.momentum);
        self.kinematics.update(robot, &of.state);
        self.link_forces.update(robot, &self.kinematics, world.conventions, aero, &of.wind);
        let feedback =
            AeroFeedback { momentum_rate: world.air.in_rate(), lambda: false, ..AeroFeedback::default() };
        self.momentum.update(
            robot,
            &self.kinematics,
            &self.dynamics,
            &of.thrust,
            &self.link_forces,
            &feedback,
        );
        let point = model::Point {
            robot: of,
            kinematics: &self.kinematics,
            dynamics: &self.dynamics,
            momentum: &self.momentum,
            link_forces: &self.link_forces,
        };
        self.model.update_at(robot, aero, world.air, point).then(|| self.momentum.rate_estimate + self.beyond)
    }

    /// `ẋ` and its derivatives.
    fn write_dynamics(&mut self, state: &State, inputs: &[f64], rate: &Vector6<f64>) {
        let (jets, joints) = (self.jets.len(), self.joints.len());
        let (r, s) = (T + jets, T + 2 * jets);
        let n = s + joints;
        let mass = self.kinematics.mass();
        let Self { by, x_dot, model, .. } = self;
        let omega = self.robot.state.base_angular_velocity();
        by.fill(0.0);
        by[(0, 3)] = 1.0;
        x_dot[0] = state.velocity.z;
        for (row, first, scale) in [(V, 0, mass.recip()), (K, 3, 1.0)] {
            x_dot.fixed_rows_mut::<3>(row).copy_from(&(rate.fixed_rows::<3>(first) * scale));
            for (column, of) in [(V, &model.rate_v), (THETA, &model.rate_theta), (K, &model.rate_k)] {
                by.fixed_view_mut::<3, 3>(row, column).copy_from(&(of.fixed_rows::<3>(first) * scale));
            }
            let of_inputs = [(T, &model.rate_t), (s, &model.rate_s), (n + jets, &model.rate_sigma)];
            for (column, of) in of_inputs {
                for (place, of) in of.column_iter().enumerate() {
                    by.fixed_view_mut::<3, 1>(row, column + place)
                        .copy_from(&(of.fixed_rows::<3>(first) * scale));
                }
            }
        }
        x_dot.fixed_rows_mut::<3>(THETA).copy_from(&omega);
        by.fixed_view_mut::<3, 3>(THETA, THETA).copy_from(&(skew(&omega) + model.omega_theta));
        by.fixed_view_mut::<3, 3>(THETA, K).copy_from(&model.omega_k);
        by.view_mut((THETA, s), (3, joints)).copy_from(&model.omega_s);
        by.view_mut((THETA, n + jets), (3, joints)).copy_from(&model.omega_sigma);
        for (jet, input) in inputs.iter().enumerate().take(jets) {
            let (thrust, rate) = (state.thrust[jet], if self.works[jet] { state.rate[jet] } else { 0.0 });
            let (least, greatest) = self.range(jet, thrust, rate);
            let acceleration = |thrust, rate| self.acceleration(jet, thrust, rate, *input);
            let now = acceleration(thrust, rate);
            let by_thrust = (acceleration(thrust + SMALL, rate) - now) / SMALL;
            let by_rate = (acceleration(thrust, rate + SMALL) - now) / SMALL;
            self.x_dot[T + jet] = rate;
            self.x_dot[r + jet] = now;
            self.by[(T + jet, r + jet)] = f64::from(u8::from(self.works[jet]));
            self.by[(r + jet, T + jet)] = by_thrust;
            self.by[(r + jet, r + jet)] = by_rate;
            self.by[(r + jet, n + jet)] = greatest - least;
        }
        for joint in 0..joints {
            self.x_dot[s + joint] = inputs[jets + joint];
            self.by[(s + joint, n + jets + joint)] = 1.0;
        }
    }

    /// The state at the end of a knot.
    fn step(&mut self, state: &State, h: f64, next: &mut State) {
        let (jets, n) = (self.jets.len(), self.x_dot.len());
        self.x_ddot.fill(0.0);
        linalg::add_mat_vec(self.x_ddot.as_mut_slice(), self.by.as_slice(), n, self.x_dot.as_slice());
        let (x, y) = (&self.x_dot, &self.x_ddot);
        let half = 0.5 * h * h;
        let by = |row: usize| h * x[row] + half * y[row];
        let vector = |row: usize| Vector3::new(by(row), by(row + 1), by(row + 2));
        next.height = state.height + by(0);
        next.velocity = state.velocity + vector(V);
        next.rotation = exp_so3(&vector(THETA)) * state.rotation;
        next.momentum = state.momentum + vector(K);
        for jet in 0..jets {
            next.thrust[jet] = (state.thrust[jet] + by(T + jet)).max(0.0);
            next.rate[jet] = state.rate[jet] + by(T + jets + jet);
        }
        for (joint, to) in next.joints.iter_mut().enumerate() {
            *to = state.joints[joint] + by(T + 2 * jets + joint);
        }
    }

    /// `(A B) = (1 0) + h (F G) + h²/2 F (F G)`.
    fn write_step(&self, h: f64, expansion: &mut Expansion) {
        let (n, w) = (self.x_dot.len(), self.row.len());
        let (by, Expansion { dynamics, transposed, .. }) = (self.by.as_slice(), expansion);
        dynamics.fill(0.0);
        linalg::add_mat_mat(dynamics, by, n, by, w);
        for (place, (to, by)) in dynamics.iter_mut().zip(by).enumerate() {
            let (row, column) = (place % n, place / n);
            let identity = if row == column { 1.0 } else { 0.0 };
            *to = identity + h * by + 0.5 * h * h * *to;
            transposed[column + row * w] = *to;
        }
    }

    fn write_cost(
        &mut self,
        world: &World,
        state: &State,
        inputs: &[f64],
        duration: f64,
        to: &mut Expansion,
    ) {
        let (jets, joints) = (self.jets.len(), self.joints.len());
        let (r, s) = (T + jets, T + 2 * jets);
        let n = s + joints;
        let Self { row, thrust_excess, .. } = self;
        to.cost = 0.0;
        to.gradient.fill(0.0);
        to.hessian.fill(0.0);
        // s² (√(1 + v²/s²) − 1) along x and y
        for (axis, weight) in VELOCITY.iter().enumerate().take(2) {
            let (speed, weight) = (state.velocity[axis], duration * weight);
            let square = LINEAR_BEYOND * LINEAR_BEYOND;
            let root = (1.0 + speed * speed / square).sqrt();
            to.cost += weight * square * (root - 1.0);
            to.gradient[V + axis] += weight * speed / root;
            to.hessian[(V + axis) * (n + jets + joints + 1)] += weight / root;
        }
        to.add_single(duration * VELOCITY[2], state.velocity.z + world.speed, V + 2);
        // |R e₃ − e₃|² = 2 (1 − cos)
        let up: Vector3<f64> = state.rotation.column(2).into();
        let (turned, away) = (-skew(&up), up - Vector3::z());
        let omega = self.robot.state.base_angular_velocity();
        for axis in 0..3 {
            row.fill(0.0);
            for column in 0..3 {
                row[THETA + column] = turned[(axis, column)];
            }
            to.add_square(duration * LEAN, away[axis], row);
            for column in 0..3 {
                row[THETA + column] = self.model.omega_theta[(axis, column)];
                row[K + column] = self.model.omega_k[(axis, column)];
            }
            for joint in 0..joints {
                row[s + joint] = self.model.omega_s[(axis, joint)];
                row[n + jets + joint] = self.model.omega_sigma[(axis, joint)];
            }
            to.add_square(duration * ANGULAR_VELOCITY, omega[axis], row);
        }
        for (jet, input) in inputs.iter().enumerate().take(jets) {
            to.add_single(duration * THRUST_RATE, state.rate[jet], r + jet);
            to.add_single(duration * ENGINE_INPUT, input - 0.5, n + jet);
            let (least, greatest) = world.now.terms.limits.thrust[jet];
            let excess = state.thrust[jet] - state.thrust[jet].max(least).min(greatest);
            if self.works[jet] && excess != 0.0 {
                to.add_single(*thrust_excess, excess, T + jet);
            }
        }
        for (place, joint) in self.joints.iter().enumerate() {
            let position = state.joints[place];
            to.add_single(duration * POSTURE, position - world.posture[*joint], s + place);
            let (least, greatest) = world.robot.joints[*joint].limits;
            let excess = position - position.max(least).min(greatest);
            if excess != 0.0 {
                to.add_single(JOINT_EXCESS, excess, s + place);
            }
            to.add_single(duration * JOINT_VELOCITY, inputs[jets + place], n + jets + place);
        }
        self.clearance.update_below(clearance::LEAST, &self.kinematics, &self.joints);
        for pair in 0..self.clearance.len() {
            let short = self.clearance.distance[pair] - clearance::LEAST;
            if short < 0.0 {
                self.row.fill(0.0);
                self.row[s..s + joints].copy_from_slice(self.clearance.by_joint.column(pair).as_slice());
                to.add_square(CLEARANCE, short, &self.row);
            }
        }
    }
}

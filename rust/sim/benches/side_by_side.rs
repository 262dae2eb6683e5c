//! Our part of the comparison with Pinocchio, DAQP and Clarabel, run by `python -m experiments.tools.bench`.
//!
//! The output is that of `common::report`, over rounds of 201 states or problems. With `--dump DIR` these are
//! written there as input of the other programs, and nothing is timed. Each file is a list of f64: count, size, then row by row
//!
//! ```text
//! states.f64      base position (3), rotation (9, row-major), joints, velocity (6 + joints)
//! NAME.f64        H, g, lower, upper, our x; then rows, their least and greatest values and weights
//! ```
//!
//! The rows, whose number follows the size in `NAME.f64`, are soft: the cost of an excess `x` is `½ weight x²`. Only the
//! plans have them. A *plan QP* is the last of a plan's search, without rows.
//!
//! `joints.txt` and `frames.txt` hold names; `check.f64` holds the results with which those of the dynamics are
//! compared.

mod common;

use clarabel::algebra::CscMatrix;
use clarabel::solver::SupportedConeT::NonnegativeConeT;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver};
use common::{PlannedTick, Search, Tick, report};
use flight_core::RobotModel;
use flight_core::aero::{LinkConventions, LinkForces};
use flight_core::control::Present;
use flight_core::dynamics::Dynamics;
use flight_core::kinematics::Kinematics;
use flight_core::qp::{ClarabelSolver, PrimalActiveSet, QpProblem, QpSolver};
use flight_io::load_aero;
use flight_sim::Scenario;
use nalgebra::Matrix6xX;
use std::error::Error;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// Time in which the plans of a flight are recorded \[s\].
const PLANS_SPAN: f64 = 2.0;

fn main() -> Result<(), Box<dyn Error>> {
    let (calm, saturated) = (common::calm_ticks()?, common::saturated_ticks()?);
    let controller = common::controller(&common::configuration("test2")?)?;
    let robot = controller.model();
    let mut plans = Vec::new();
    for (case, config, from) in common::planned_flights()? {
        plans.push((case, common::record_plans(&config, &(from..=from + PLANS_SPAN))?));
    }
    let mut problems: Vec<(String, Vec<QpProblem>)> = Vec::new();
    for (case, ticks) in [("calm", &calm), ("saturated", &saturated)] {
        let momentum = ticks.iter().map(|tick| tick.momentum_qp.clone()).collect();
        let torque = ticks.iter().map(|tick| tick.torque_qp.clone()).collect();
        problems.extend([(format!("momentum QP, {case}"), momentum), (format!("torque QP, {case}"), torque)]);
    }
    for (case, plans) in &plans {
        let last = plans.iter().map(|plan| plan.horizon.problem.clone()).collect();
        problems.push((format!("plan QP, {case}"), last));
    }
    let mut arguments = std::env::args().skip_while(|argument| argument != "--dump").skip(1);
    if let Some(folder) = arguments.next().map(PathBuf::from) {
        write_states(&folder, robot, &calm)?;
        for (name, problems) in &problems {
            write_problems(&folder.join(format!("{name}.f64")), problems)?;
        }
        for (case, plans) in &mut plans {
            write_plans(&folder.join(format!("plan, {case}.f64")), plans)?;
        }
        return Ok(());
    }
    let mut bundle = Bundle::new(robot);
    report("dynamics, without Jacobians", 300, &calm, |tick| bundle.update_dynamics(robot, tick));
    report("dynamics, with 17 frame Jacobians", 300, &calm, |tick| {
        bundle.update_dynamics(robot, tick);
        bundle.update_jacobians(robot);
    });
    for (name, problems) in &problems {
        time_solvers(name, problems);
    }
    for (case, plans) in &mut plans {
        let mut search = Search::new(plans[0].horizon.problem.len());
        let places: Vec<usize> = (0..plans.len()).collect();
        report(&format!("plan, {case}, warm"), 50, &places, |place| {
            search.solve(&mut plans[*place]).is_some()
        });
    }
    let mut network = load_aero(&common::configuration("test4")?.simulator.aero, robot)?;
    let mut links = LinkForces::new(robot);
    let conventions = LinkConventions::default();
    report("shipped network, links placed", 200, &calm, |tick| {
        links.update(robot, &bundle.kinematics, conventions, &mut network, &tick.measurement.wind);
    });
    report("flight of 50 s", 5, &[common::configuration("test2")?], |config| {
        Scenario::new(config).map(|flight| flight.run(|_, _| ControlFlow::Continue(()))).is_ok()
    });
    Ok(())
}

/// Kinematics, mass matrix, bias, momentum matrix, centroidal inertia, and one dense Jacobian per frame.
struct Bundle {
    kinematics: Kinematics,
    dynamics: Dynamics,
    jacobians: Vec<Matrix6xX<f64>>,
}

impl Bundle {
    fn new(robot: &RobotModel) -> Self {
        let kinematics = Kinematics::new(robot);
        let frames = robot.aero_links.len() + robot.jets.len();
        let jacobians = vec![Matrix6xX::zeros(kinematics.n_velocities()); frames];
        Self { kinematics, dynamics: Dynamics::new(robot), jacobians }
    }

    fn update_dynamics(&mut self, robot: &RobotModel, tick: &Tick) {
        self.kinematics.update(robot, &tick.measurement.state);
        self.dynamics.update(robot, &tick.measurement.state, &self.kinematics);
    }

    fn update_jacobians(&mut self, robot: &RobotModel) {
        let links = robot.aero_links.iter().map(|link| &link.frame);
        for (frame, out) in links.chain(robot.jets.iter().map(|jet| &jet.frame)).zip(&mut self.jacobians) {
            let point = self.kinematics.frame_pose(frame).position;
            // Columns that are zero for this frame remain zero.
            self.kinematics.visit_jacobian_columns(frame.body, &point, |column, linear, angular| {
                let mut out = out.column_mut(column);
                out.fixed_rows_mut::<3>(0).copy_from(&linear);
                out.fixed_rows_mut::<3>(3).copy_from(&angular);
            });
        }
    }

    /// Squares of Frobenius norms, which are equal in every velocity convention.
    fn check(&self) -> [f64; 3] {
        let jacobians = self.jacobians.iter().map(Matrix6xX::norm_squared).sum();
        [self.dynamics.mass_matrix.norm_squared(), self.dynamics.momentum_matrix.norm_squared(), jacobians]
    }
}

fn time_solvers(name: &str, problems: &[QpProblem]) {
    let n = problems[0].len();
    let (rounds, of_clarabel) = if n < 64 { (200, 5) } else { (50, 1) };
    let mut solver = PrimalActiveSet::new(n);
    report(&format!("{name}, warm"), rounds, problems, |qp| solver.solve(qp));
    report(&format!("{name}, cold"), rounds, problems, |qp| {
        solver.reset();
        solver.solve(qp)
    });
    let mut reference = ClarabelSolver::new(n, 0);
    report(&format!("{name}, Clarabel at 1e-12 and polished"), of_clarabel, problems, |qp| {
        reference.solve(qp)
    });
    report(&format!("{name}, Clarabel as it comes"), of_clarabel, problems, solve_with_clarabel);
}

/// Clarabel with its default settings, bounds as inequalities.
fn solve_with_clarabel(qp: &QpProblem) -> Option<f64> {
    let n = qp.len();
    let upper_triangle = || (0..n).flat_map(|j| (0..=j).map(move |i| (i, j)));
    let p = CscMatrix::new_from_triplets(
        n,
        n,
        upper_triangle().map(|(i, _)| i).collect(),
        upper_triangle().map(|(_, j)| j).collect(),
        upper_triangle().map(|index| qp.h[index]).collect(),
    );
    let signs: Vec<f64> = [1.0, -1.0].iter().flat_map(|sign| std::iter::repeat_n(*sign, n)).collect();
    let a = CscMatrix::new_from_triplets(2 * n, n, (0..2 * n).collect(), (0..n).chain(0..n).collect(), signs);
    let b: Vec<f64> = qp.upper.iter().copied().chain(qp.lower.iter().map(|lower| -lower)).collect();
    let settings = DefaultSettings { verbose: false, ..DefaultSettings::default() };
    let mut solver =
        DefaultSolver::new(&p, qp.g.as_slice(), &a, &b, &[NonnegativeConeT(2 * n)], settings).ok()?;
    solver.solve();
    Some(solver.solution.obj_val)
}

// --- files -----------------------------------------------------------------------------------------------------

fn write_states(folder: &Path, robot: &RobotModel, ticks: &[Tick]) -> std::io::Result<()> {
    let mut data = vec![ticks.len() as f64, robot.joints.len() as f64];
    let mut check = Vec::new();
    let mut bundle = Bundle::new(robot);
    for tick in ticks {
        let base = &tick.measurement.state.base;
        data.extend(base.position.iter());
        data.extend(base.rotation.transpose().iter());
        data.extend(tick.measurement.state.joint_position.iter());
        data.extend(tick.measurement.state.velocity.iter());
        bundle.update_dynamics(robot, tick);
        bundle.update_jacobians(robot);
        check.extend(bundle.check());
    }
    let joints: Vec<&str> = robot.joints.iter().map(|joint| joint.name.as_str()).collect();
    let links = robot.aero_links.iter().map(|link| link.frame.name.as_str());
    let frames: Vec<&str> = links.chain(robot.jets.iter().map(|jet| jet.frame.name.as_str())).collect();
    std::fs::write(folder.join("joints.txt"), joints.join("\n"))?;
    std::fs::write(folder.join("frames.txt"), frames.join("\n"))?;
    write(&folder.join("check.f64"), &check)?;
    write(&folder.join("states.f64"), &data)
}

fn write_problems(path: &Path, problems: &[QpProblem]) -> std::io::Result<()> {
    let mut solver = PrimalActiveSet::new(problems[0].len());
    let mut data = vec![problems.len() as f64, problems[0].len() as f64, 0.0];
    for qp in problems {
        solver.solve(qp);
        data.extend(qp.h.iter().chain(&qp.g).chain(&qp.lower).chain(&qp.upper).chain(solver.x()));
    }
    write(path, &data)
}

fn write_plans(path: &Path, plans: &mut [PlannedTick]) -> Result<(), Box<dyn Error>> {
    let n = plans[0].horizon.problem.len();
    let mut search = Search::new(n);
    let mut data = vec![plans.len() as f64, n as f64];
    for tick in plans {
        let x = search.solve(tick).ok_or("a plan without an answer")?.to_vec();
        let PlannedTick { model, horizon, terms, estimate, joint_limits } = tick;
        let now = Present { terms, estimate };
        let (lower, upper) = (horizon.problem.lower.clone(), horizon.problem.upper.clone());
        let (h, g, rows) = horizon.soft_problem(model, now, joint_limits);
        if data.len() == 2 {
            data.push(rows.len() as f64);
        }
        data.extend(h.iter().chain(g).chain(&lower).chain(&upper).chain(&x));
        data.extend(rows.iter().flat_map(|row| &row.by_input));
        data.extend(rows.iter().map(|row| row.range.0));
        data.extend(rows.iter().map(|row| row.range.1));
        data.extend(rows.iter().map(|row| row.weight));
    }
    Ok(write(path, &data)?)
}

fn write(path: &Path, data: &[f64]) -> std::io::Result<()> {
    std::fs::write(path, data.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>())
}

//! Which tasks the momentum QP has, and that one of one's own does what it asks. What each of the law's is:
//! `tests/parity/test_symbolic_law.py`.

#![allow(clippy::unwrap_used, reason = "a test that cannot start has failed")]
#![allow(clippy::float_cmp, reason = "entries that are written as they are have their bits")]

use crate::common::{Running, assert_within, at, experiment};
use flight_core::control::law::momentum_qp::{Equations, Layout, Task, TaskInputs};
use flight_core::qp::QpStatus;
use flight_io::load_robot;
use nalgebra::{DMatrix, DVector};
use std::sync::Arc;

/// Tasks are there when they apply.
#[test]
fn tasks_are_added_where_they_apply() {
    let has = |name: &str, task: &str| {
        let config = experiment(name);
        let controller = Running::new(config.controller(load_robot(&config.robot).unwrap()).unwrap());
        controller.terms().momentum_qp.task(task).is_some()
    };
    for task in ["feet", "force rate"] {
        assert!(has("balancing_front", task) && !has("test1", task), "{task}");
    }
    for task in ["thrust rate", "symmetric jets"] {
        assert!(!has("balancing_front", task) && has("test1", task), "{task}");
    }
}

/// Asks some joint to turn at a velocity, once as a diagonal and once as a row.
#[derive(Debug)]
struct KeepVelocity {
    unknown: usize,
    velocity: f64,
    weights: Vec<f64>,
    is_row: bool,
}

impl Task for KeepVelocity {
    fn name(&self) -> &'static str {
        "keep velocity"
    }

    fn layout(&self) -> Layout {
        let weights = self.weights.clone();
        if self.is_row { Layout::Rows(weights) } else { Layout::Diagonal { first: self.unknown, weights } }
    }

    fn update(&self, _: &TaskInputs, equations: &mut Equations) {
        if self.is_row {
            equations.matrix[(self.unknown, 0)] = 1.0;
        }
        equations.offset[0] = -self.velocity;
    }
}

/// `u' = u + H⁻¹ e w (v − e·u) / (1 + w eᵀ H⁻¹ e)` over the unknowns that meet no bound: what one more square changes.
#[test]
fn a_task_of_ones_own_does_what_it_asks() {
    let config = experiment("test2");
    let robot = load_robot(&config.robot).unwrap();
    let start = config.simulator.initial.state();
    let thrust = &config.simulator.initial.thrust;
    let tick = |task: Option<KeepVelocity>| {
        let mut controller = config.controller(robot.clone()).unwrap();
        if let Some(task) = task {
            controller.add_task(Arc::new(task)).unwrap();
        }
        let mut controller = Running::new(controller);
        assert_eq!(controller.tick(&at(0.0, &start, thrust)).rates_qp.status, QpStatus::Solved);
        let command = controller.command();
        let u: Vec<f64> = command.thrust_rate.iter().chain(&command.joint_velocity).copied().collect();
        (DVector::from_vec(u), controller.terms().momentum_qp.problem.clone())
    };
    let (plain, problem) = tick(None);
    let is_free = |i: &usize| problem.lower[*i] < plain[*i] && plain[*i] < problem.upper[*i];
    let free: Vec<usize> = (0..27).filter(is_free).collect();
    let h = DMatrix::from_fn(free.len(), free.len(), |i, j| problem.h[(free[i], free[j])]);
    let place = 10;
    let unknown = free[place];
    assert!(unknown >= 4, "a joint");
    let velocity = plain[unknown] + 0.01;
    for weight in [1.0, 100.0, 1e6] {
        let mut e = DVector::zeros(free.len());
        e[place] = 1.0;
        let response = h.clone().cholesky().unwrap().solve(&e);
        let step = weight * (velocity - plain[unknown]) / (1.0 + weight * response[place]);
        let mut expected = plain.clone();
        for (response, &i) in response.iter().zip(&free) {
            expected[i] += response * step;
        }
        for is_row in [false, true] {
            let weights = vec![weight];
            let (found, _) = tick(Some(KeepVelocity { unknown, velocity, weights, is_row }));
            // Two QPs of condition 1e8, each solved to 1e-15 of its scale.
            assert_within!((&found - &expected).amax(), 1e-7 * (1.0 + expected.amax()), "weight {weight}");
            let left = (found[unknown] - velocity) / (plain[unknown] - velocity);
            assert_within!((left - 1.0 / (1.0 + weight * response[place])).abs(), 1e-6, "weight {weight}");
        }
    }
}

#[test]
fn tasks_that_mean_nothing_are_refused() {
    let config = experiment("test2");
    let mut controller = config.controller(load_robot(&config.robot).unwrap()).unwrap();
    let mut refusal = |unknown, weight, is_row| {
        let task = KeepVelocity { unknown, velocity: 0.0, weights: vec![weight], is_row };
        controller.add_task(Arc::new(task)).map_or_else(|error| error.to_string(), |()| String::new())
    };
    assert!(refusal(27, 1.0, false).contains("at most 27 unknowns"));
    assert!(refusal(3, -1.0, true).contains("weight of task `keep velocity` is -1"));
    assert!(refusal(3, f64::NAN, false).contains("weight of task `keep velocity` is NaN"));
    assert_eq!(refusal(3, 1.0, false), "");
    assert!(refusal(3, 1.0, false).contains("keep velocity"), "twice");
}

/// Refused for its second weight, when the first has been read.
#[test]
fn a_task_that_is_refused_leaves_nothing() {
    let config = experiment("test2");
    let start = config.simulator.initial.state();
    let thrust = &config.simulator.initial.thrust;
    let tick = |is_tried: bool| {
        let mut controller = config.controller(load_robot(&config.robot).unwrap()).unwrap();
        if is_tried {
            let weights = vec![1.0, -1.0];
            let task = KeepVelocity { unknown: 4, velocity: 0.0, weights, is_row: false };
            controller.add_task(Arc::new(task)).unwrap_err();
        }
        let mut controller = Running::new(controller);
        controller.tick(&at(0.0, &start, thrust));
        controller.terms().momentum_qp.problem.h.clone()
    };
    assert_eq!(tick(true), tick(false));
}

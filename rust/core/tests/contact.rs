//! The controller on the ground: what a foot may carry, when it carries, and what the two QPs make of it.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot go on has failed")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::{Running, TIME_STEP, assert_within, at, experiment, move_state, rng};
use flight_core::control::config::ControllerConfig;
use flight_core::control::detect::engines::EnginesConfig;
use flight_core::control::estimate::estimator::{EstimatorConfig, FilterConfig};
use flight_core::control::law::contact::{ContactConfig, LoadTransfer, WRENCH_ROWS};
use flight_core::control::law::setpoint::Setpoint;
use flight_core::control::{Modes, Terms};
use flight_core::kinematics::Kinematics;
use flight_core::robot::Foot;
use flight_core::{Measurement, RobotState};
use flight_io::{load_controller, load_robot};
use flight_sim::{Scenario, ScenarioConfig};
use nalgebra::{DVector, Vector3, Vector6};
use rand::RngExt;

fn standing() -> ScenarioConfig {
    experiment("balancing_front")
}

fn contact_config() -> ContactConfig {
    standing().controller.law.contact.unwrap()
}

fn controller(change: impl FnOnce(&mut ControllerConfig)) -> Running {
    let ScenarioConfig { robot, mut controller, mission, .. } = standing();
    change(&mut controller.law);
    Running::new(load_controller(load_robot(&robot).unwrap(), &controller, &mission).unwrap())
}

/// The left foot; the right one has the same limits.
fn foot() -> Foot {
    crate::common::robot("ironcub_mk1").feet.remove(0)
}

fn at_rest() -> RobotState {
    standing().simulator.initial.state()
}

/// Half the weight on each foot, pressing somewhat before its middle.
fn weight_on_both() -> [Vector6<f64>; 2] {
    [Vector6::new(0.0, 0.0, 212.5, 0.4, -1.2, 0.0), Vector6::new(0.0, 0.0, 212.5, -0.4, -1.2, 0.0)]
}

const THRUST: [f64; 4] = [0.0; 4];

fn measurement(state: &RobotState, wind: Vector3<f64>, feet: &[Vector6<f64>]) -> Measurement {
    Measurement { wind, foot_wrenches: foot_after_foot(feet), ..at(0.0, state, &THRUST) }
}

fn foot_after_foot(feet: &[Vector6<f64>]) -> DVector<f64> {
    DVector::from_iterator(6 * feet.len(), feet.iter().flatten().copied())
}

/// Inside the rows is inside the polygon of twelve corners on the friction circle, within the torsion, above
/// the least force, with the centre of pressure on the sole: judged by geometry, corner by corner.
#[test]
fn wrench_rows_are_the_geometry_they_stand_for() {
    let (limits, foot) = (contact_config().wrench, foot());
    let rows = limits.rows(&foot);
    assert_eq!(rows.len(), WRENCH_ROWS);
    let mut rng = rng(1);
    let corner = |k: u32| {
        let angle = f64::from(k) * std::f64::consts::TAU / 12.0;
        (limits.friction * angle.cos(), limits.friction * angle.sin())
    };
    let (mut inside, mut outside) = (0, 0);
    for _ in 0..200_000 {
        let fz = rng.random_range(-5.0..60.0_f64);
        let size = fz.abs().max(1.0);
        let (fx, fy) = (rng.random_range(-0.13..0.13) * size, rng.random_range(-0.13..0.13) * size);
        let (mx, my) = (rng.random_range(-0.06..0.06) * size, rng.random_range(-0.14..0.09) * size);
        let wrench = Vector6::new(fx, fy, fz, mx, my, rng.random_range(-0.016..0.016) * size);
        // A convex polygon holds what lies to the left of each of its sides.
        let in_polygon = (0..12).all(|k| {
            let ((ax, ay), (bx, by)) = (corner(k), corner(k + 1));
            (bx - ax) * (fy / fz - ay) - (by - ay) * (fx / fz - ax) >= 0.0
        });
        let (px, py) = (-my / fz, mx / fz);
        let expected = fz >= limits.vertical_force_min
            && in_polygon
            && wrench[5].abs() <= fz / 75.0
            && (-0.07..=0.12).contains(&px) // published: 1 cm beyond the corners
            && (-0.045..=0.05).contains(&py);
        let found = rows.iter().all(|(row, bound)| row.dot(&wrench) <= *bound);
        assert_eq!(found, expected, "{wrench}");
        if found { inside += 1 } else { outside += 1 }
    }
    assert!(inside > 5_000 && outside > 5_000, "{inside} inside, {outside} outside");
}

/// A controller that can take off, behind its first tick on the ground with thrusts that carry a quarter of the weight.
fn able_to_take_off() -> (Running, RobotState) {
    able_to_take_off_with(|_, _| ())
}

fn able_to_take_off_with(
    change: impl FnOnce(&mut LoadTransfer, &mut Option<EnginesConfig>),
) -> (Running, RobotState) {
    let mut config = experiment("take_off");
    let law = &mut config.controller.law;
    change(law.contact.as_mut().unwrap().load_transfer.as_mut().unwrap(), &mut law.fault_detection.engines);
    let controller = Running::new(config.controller(load_robot(&config.robot).unwrap()).unwrap());
    (controller, config.simulator.initial.state())
}

const QUARTER: [f64; 4] = [26.0; 4];

/// A tick on the ground towards a set-point `climb` above the centre of mass.
fn tick_with_load(
    running: &mut Running,
    state: &RobotState,
    time: f64,
    climb: f64,
    feet: &[Vector6<f64>; 2],
) {
    let mut kinematics = Kinematics::new(running.model());
    kinematics.update(running.model(), state);
    let com = kinematics.com + Vector3::new(0.0, 0.0, climb);
    let setpoint = Setpoint::at_rest(com, state.base.rotation);
    let measured =
        Measurement { time, thrust: QUARTER.to_vec(), ..measurement(state, Vector3::zeros(), feet) };
    running.tick_towards(&measured, &setpoint);
}

/// Moves a robot that stands hardly at all: a measurement with the same bits in tick after tick would count as frozen.
fn tremble(state: &mut RobotState) {
    state.joint_position[0] += 1e-12;
    state.velocity[0] = -state.velocity[0] + 1e-12;
    state.velocity[5] = -state.velocity[5] + 1e-12;
    state.base.position.x += 1e-12;
}

/// M111: offsets of the two rate tasks, entry by entry, and which side is relieved.
#[test]
fn the_side_that_is_relieved_loses_its_load_at_the_gain() {
    let (mut controller, state) = able_to_take_off();
    let gain = 1.0; // of configs/control/take_off.toml
    for (k, (climb, takes_off)) in
        [(0.0, false), (0.5, true), (0.009, false), (-0.5, false)].into_iter().enumerate()
    {
        tick_with_load(&mut controller, &state, 0.01 * k as f64, climb, &weight_on_both());
        let terms = controller.terms();
        let carried = controller.state().contact();
        assert!(carried.is_active);
        assert_eq!(terms.contact.takes_off, takes_off, "{climb} m");
        let (_, thrust_rates, _) = terms.momentum_qp.task("thrust rate").unwrap();
        let (_, force_rates, _) = terms.momentum_qp.task("force rate").unwrap();
        let (of_jets, of_feet) = if takes_off { (0.0, gain) } else { (gain, 0.0) };
        assert_eq!(thrust_rates, DVector::from_element(4, of_jets * 26.0));
        assert_eq!(force_rates, &carried.force * of_feet);
        assert!(carried.force.norm() > 100.0);
    }
}

/// M112: what `f_c*` starts with, follows slowly while the robot stands, and is while it takes off.
#[test]
fn the_desired_wrench_is_the_measured_one_at_take_off_and_follows_it_else() {
    let (mut controller, state) = able_to_take_off();
    tick_with_load(&mut controller, &state, 0.0, 0.0, &weight_on_both());
    let terms = controller.terms();
    let left = terms.kinematics.mass() * 9.81 - terms.momentum.a_t.row(2).sum() * 26.0;
    let measured: Vec<f64> = weight_on_both().iter().flatten().copied().collect();
    // κ_m Δt of configs/control/take_off.toml.
    let part = 1.0 * TIME_STEP;
    for (index, force) in controller.state().contact().force.iter().enumerate() {
        let start = if index % 6 == 2 { left / 2.0 } else { 0.0 };
        let expected = start + part * (measured[index] - start);
        assert_within!(
            (force - expected).abs(),
            1e-12 * 400.0,
            "component {index}: rounding of a sum of thrusts"
        );
    }
    tick_with_load(&mut controller, &state, 0.01, 0.5, &weight_on_both());
    for (force, measured) in controller.state().contact().force.iter().zip(&measured) {
        assert_within!((force - measured).abs(), 1e-12 * 400.0, "rounding of f + (m - f)");
    }
}

/// M101 on the ground: an impact of twenty times the weight is not predicted to last, so that what is measured after it
/// is accepted.
#[test]
fn an_impact_is_not_predicted_to_last() {
    let (mut running, state) = able_to_take_off();
    let feet = weight_on_both().map(|wrench| 20.0 * wrench);
    tick_with_load(&mut running, &state, 0.0, 0.0, &feet);
    tick_with_load(&mut running, &state, 0.01, 0.0, &weight_on_both());
    assert!(running.controller.command().modes.is_empty());
}

/// A tick without an answer of the torque QP predicts with its own wrenches of the feet, not with those of the last
/// answer: a state that is restored in another controller goes on alike.
#[test]
fn without_an_answer_the_wrenches_of_the_momentum_qp_are_predicted_to_act() {
    let mut running = controller(|config| config.torque.weight_acceleration = 1e306);
    let (state, feet) = (at_rest(), weight_on_both());
    let command = running.tick(&measurement(&state, Vector3::zeros(), &feet));
    assert!(command.modes.contains(Modes::TORQUE_HELD));
    let desired = &running.state().contact().force;
    assert!(desired.amax() > 100.0);
    assert_eq!(&running.terms().contact.force_of_torques, desired);
}

/// Feet of a robot that stands carry through a short loss of contact; those of one that takes off do not.
#[test]
fn feet_carry_through_a_short_loss_of_contact_unless_the_robot_takes_off() {
    let in_the_air = [Vector6::zeros(); 2];
    for (climb, carrying) in [(0.0, 20), (0.5, 0)] {
        // This robot is held up by nothing.
        let (mut controller, mut state) =
            able_to_take_off_with(|transfer, _| transfer.unmodelled_force_max = None);
        tick_with_load(&mut controller, &state, 0.0, climb, &weight_on_both());
        let mut ticks = 0;
        for k in 1..40 {
            tremble(&mut state);
            tick_with_load(&mut controller, &state, 0.01 * f64::from(k), climb, &in_the_air);
            ticks += i32::from(controller.state().contact().is_active);
        }
        // 0.2 s; the sum of twenty steps may round to either side of it.
        assert!((ticks - carrying).abs() <= i32::from(carrying > 0), "{ticks} ticks, climb of {climb} m");
    }
}

/// M114: feet that were in the air, measured or not, carry where the model does not explain what holds the robot up and its
/// set-point is below it, and the observer begins anew. Thrusts that carry a quarter of the weight leave 320 N.
#[test]
fn feet_carry_what_nothing_else_explains() {
    let (missing, weightless) = ([Vector6::repeat(f64::NAN); 2], [Vector6::zeros(); 2]);
    for (feet, climb, force_max, lands) in [
        (missing, -0.011, 300.0, true),
        (missing, -0.011, 350.0, false),
        (missing, -0.009, 300.0, false),
        (weightless, -0.011, 300.0, true),
        (weightless, -0.011, 350.0, false),
        (weightless, -0.009, 300.0, false),
    ] {
        let (mut running, mut state) = able_to_take_off_with(|transfer, engines| {
            transfer.unmodelled_force_max = Some(force_max);
            *engines = None; // the thrusts of these ticks do not follow their commands
        });
        tick_with_load(&mut running, &state, 0.0, 0.0, &weightless);
        let mut carries = false;
        for tick in 1..300 {
            tremble(&mut state);
            let before = running.terms().momentum.unmodelled_wrench[2];
            tick_with_load(&mut running, &state, 0.01 * f64::from(tick), climb, &feet);
            let carries_now = running.state().contact().is_active;
            if carries_now && !carries {
                assert!(before > 10.0, "{before} N");
                assert_eq!(running.terms().momentum.unmodelled_wrench, Vector6::zeros());
                let terms = running.terms();
                let left = terms.kinematics.mass() * 9.81 - terms.momentum.a_t.row(2).sum() * 26.0;
                let force: f64 = running.state().contact().force.iter().skip(2).step_by(6).sum();
                assert_within!((force - left).abs(), 1e-12 * 400.0, "rounding of a sum of thrusts");
            }
            carries = carries_now;
        }
        assert_eq!(carries, lands, "climb of {climb} m, {force_max} N");
    }
}

/// M114: wrenches that the momentum contradicts for longer than an impact lasts are not used, from that tick on. The
/// robot does not move; its thrusts leave 320 N to the feet.
#[test]
fn wrenches_that_contradict_the_momentum_are_not_believed() {
    let trusts = |running: &Running| !running.controller.command().modes.contains(Modes::FEET_PREDICTED);
    let feet = |vertical: f64| [Vector6::new(0.0, 0.0, 0.5 * vertical, 0.0, 0.0, 0.0); 2];
    for (climb, force_max, first, then, until, is_trusted) in [
        (0.0, 50.0, 320.0, 320.0, 100, true),
        (0.0, 90.0, 320.0, 424.0, 100, false),
        (0.0, 120.0, 320.0, 424.0, 100, true),
        (0.0, 90.0, 320.0, 216.0, 100, false),
        (0.0, 120.0, 320.0, 216.0, 100, true),
        // Feet of a robot that takes off carry no more in the tick in which they fail at zero.
        (0.5, 50.0, 320.0, 0.0, 100, false),
        // In the air the ground is not near.
        (0.5, 50.0, 0.0, 0.0, 100, true),
        // An impact.
        (0.0, 50.0, 320.0, 600.0, 12, true),
    ] {
        let (mut running, mut state) =
            able_to_take_off_with(|transfer, _| transfer.unmodelled_force_max = Some(force_max));
        let case = format!("climb of {climb} m, {first} N, then {then} N, {force_max} N");
        for tick in 0..60 {
            tremble(&mut state);
            let vertical = if (10..until).contains(&tick) { then } else { first };
            let was_trusted = trusts(&running);
            tick_with_load(&mut running, &state, 0.01 * f64::from(tick), climb, &feet(vertical));
            let terms = running.controller.terms();
            if was_trusted && !trusts(&running) {
                // Ten ticks after the momentum shows it.
                assert!((20..28).contains(&tick), "{case}: tick {tick}");
                assert_eq!(terms.momentum.unmodelled_wrench, Vector6::zeros());
                let left = terms.kinematics.mass() * 9.81 - terms.momentum.a_t.row(2).sum() * 26.0;
                let force = running.state().contact().force[2];
                assert_within!((force - 0.5 * left).abs(), 1e-12 * 400.0, "rounding of a sum of thrusts");
            }
        }
        assert_eq!(trusts(&running), is_trusted, "{case}");
    }
}

/// A foot that is not named is no contact: it adds no unknown, no wrench is expected of it, and the others may
/// stand in any order.
#[test]
fn feet_are_contacts_by_name() {
    let named = |feet: &[&str]| {
        controller(|law| {
            law.contact.as_mut().unwrap().feet = feet.iter().map(|&name| name.to_owned()).collect();
        })
    };
    let (state, [left, right]) = (at_rest(), weight_on_both());
    let first_tick = |controller: &mut Running, wrenches: &[Vector6<f64>]| {
        controller.tick(&measurement(&state, Vector3::zeros(), wrenches)).clone()
    };
    let mut one = named(&["r_sole"]);
    assert_eq!(first_tick(&mut one, &[right]).modes, Modes::default());
    assert_eq!(one.terms().momentum_qp.problem.len(), 6 + 23);
    assert!(one.state().contact().is_active);
    assert_eq!(one.terms().contact.soles.len(), 1);

    let torque = first_tick(&mut named(&["l_sole", "r_sole"]), &[left, right]).joint_torque;
    let other = first_tick(&mut named(&["r_sole", "l_sole"]), &[right, left]).joint_torque;
    // The QPs have a condition number of about 1e8; their unknowns stand in another order.
    assert_within!((torque - other).amax(), 1e-6);

    // Two wrenches for one foot are a bad measurement.
    assert!(first_tick(&mut one, &[left, right]).modes.contains(Modes::MEASUREMENT_IGNORED));
}

/// Both feet above the threshold, or none: `f_c*` starts from what is felt and is zero otherwise.
#[test]
fn contact_switches_with_the_measured_wrenches() {
    let mut controller = controller(|_| ());
    let state = at_rest();
    let still = Vector3::zeros();
    let mut tick = |feet: &[Vector6<f64>; 2]| {
        assert_eq!(controller.tick(&measurement(&state, still, feet)).modes, Modes::default());
        let contact = controller.state().contact();
        (contact.is_active, contact.force.clone(), contact.force_rate.clone())
    };
    let (active, force, rate) = tick(&[Vector6::zeros(); 2]);
    assert!(!active && force.amax() == 0.0 && rate.amax() == 0.0);

    let both = weight_on_both();
    let (active, force, rate) = tick(&both);
    assert!(active);
    let started =
        DVector::from_column_slice(&[0.0, 0.0, 212.5, 0.0, -1.2, 0.0, 0.0, 0.0, 212.5, 0.0, -1.2, 0.0]);
    assert_eq!(force, started);
    assert!(rate.amax() > 0.0);
    // The rate of one tick is integrated into the next.
    let (_, force, _) = tick(&both);
    assert_eq!(force, &started + rate * TIME_STEP);

    // One foot at the threshold does not carry.
    let mut light = both;
    light[1][2] = 3.5;
    let (active, force, rate) = tick(&light);
    assert!(!active && force.amax() == 0.0 && rate.amax() == 0.0);
    light[1][2] = 3.51;
    let (active, force, _) = tick(&light);
    assert!(active && force[8] == 3.51 && force[2] == 212.5);
}

/// Wrenches of feet that do not carry are fixed in both QPs, before a touchdown and after a take-off.
#[test]
fn wrenches_of_feet_that_do_not_carry_are_fixed() {
    let mut controller = controller(|_| ());
    let (state, in_the_air) = (at_rest(), [Vector6::zeros(); 2]);
    for (feet, carry) in [(in_the_air, false), (weight_on_both(), true), (in_the_air, false)] {
        controller.tick(&measurement(&state, Vector3::zeros(), &feet));
        let Terms { momentum_qp, torque_qp, .. } = controller.terms();
        for (problem, unknowns) in [
            (&momentum_qp.problem, momentum_qp.unknowns.force_rate.clone()),
            (&torque_qp.problem, torque_qp.foot_force.clone()),
        ] {
            assert_eq!(unknowns.len(), 12);
            let bounds =
                [&problem.lower, &problem.upper].map(|bound| bound.rows_range(unknowns.clone()).abs());
            assert!(bounds.iter().flatten().all(|bound| (*bound > 0.0) == carry), "{carry}");
        }
        assert_eq!(torque_qp.problem.is_box(), !carry);
    }
}

/// Of a robot that stands still in still air no wind is estimated: its feet carry it.
#[test]
fn the_ground_is_no_wind() {
    let mut standing = controller(|law| law.wind_observer = true);
    let (mut state, mass) = (at_rest(), standing.model().mass());
    let feet = [Vector6::new(0.0, 0.0, mass * 9.81 / 2.0, 0.0, 0.0, 0.0); 2];
    for tick in 0..200 {
        let time = f64::from(tick) * TIME_STEP;
        state.base.position.x += 1e-12; // the same bits in tick after tick could be frozen
        standing.tick(&Measurement { time, ..measurement(&state, Vector3::zeros(), &feet) });
    }
    let wind = standing.state().wind().unwrap().wind();
    assert_within!(wind.norm(), 1e-9, because "the weight and the feet cancel to rounding", "{wind}");
}

/// A robot that stands is estimated to stand: its feet are part of the model that runs ahead of late measurements.
#[test]
fn a_robot_that_stands_is_not_estimated_to_fall() {
    let late = FilterConfig { delay: 0.05, time_constant: 0.1 };
    let mut standing = controller(|law| {
        law.estimator = Some(EstimatorConfig {
            base_position: late,
            base_linear_velocity: late,
            joint_position: late,
            joint_velocity: late,
            ..EstimatorConfig::default()
        });
    });
    let state = at_rest();
    for tick in 0..20 {
        let time = f64::from(tick) * TIME_STEP;
        standing.tick(&Measurement { time, ..measurement(&state, Vector3::zeros(), &weight_on_both()) });
        let speed = standing.state().estimate().robot.state.base_linear_velocity().norm();
        assert_within!(speed, 0.05, because "f_c* of a foot is off by 5 N of 212, which is g / 40 over 0.1 s", "tick {tick}");
    }
}

/// M101 on the ground: other torques than were commanded change what the feet carry, not what is predicted of the motion;
/// other thrust rates do act.
#[test]
fn a_replaced_command_leaves_the_predicted_motion_of_a_robot_that_stands() {
    let seen_after = |replaced: Option<(f64, f64)>| {
        let (mut running, mut state) = able_to_take_off();
        tick_with_load(&mut running, &state, 0.0, 0.0, &weight_on_both());
        if let Some((share, rate)) = replaced {
            let torque = running.controller.command().joint_torque.clone() * share;
            let Running { controller, state } = &mut running;
            controller.replace_command(state.as_mut().unwrap(), &[rate; 4], torque.as_slice()).unwrap();
        }
        state.velocity.rows_mut(0, 6).fill(f64::NAN);
        state.base.position.fill(f64::NAN); // or the velocity follows it
        let thrust = [f64::NAN; 4];
        let feet = weight_on_both();
        let measured = measurement(&state, Vector3::zeros(), &feet);
        running.tick(&Measurement { time: TIME_STEP, thrust: thrust.to_vec(), ..measured });
        let used = &running.state().estimate();
        (used.robot.state.velocity.clone(), used.robot.thrust[0])
    };
    let (commanded, _) = seen_after(None);
    let (replaced, thrust) = seen_after(Some((0.5, 30.0)));
    assert_eq!(replaced, commanded);
    assert_within!((thrust - (26.0 + 30.0 * TIME_STEP)).abs(), 1e-12);
}

/// A robot that is to take off and has lost its place for long stays: its jets are relieved, not its feet, and its
/// set-point comes down to it.
#[test]
fn a_robot_on_its_way_down_does_not_take_off() {
    let (mut running, mut state) = able_to_take_off();
    tick_with_load(&mut running, &state, 0.0, 0.5, &weight_on_both());
    assert!(running.terms().contact.takes_off);
    state.base.position.fill(f64::NAN);
    for tick in 1..700 {
        tremble(&mut state);
        let (time, feet) = (f64::from(tick) * TIME_STEP, weight_on_both());
        let measured =
            Measurement { time, thrust: QUARTER.to_vec(), ..measurement(&state, Vector3::zeros(), &feet) };
        let setpoint = Setpoint::at_rest(Vector3::new(0.0, 0.0, 1.1), state.base.rotation);
        let command = running.tick_towards(&measured, &setpoint);
        let is_descending = command.modes.contains(Modes::DESCENDING);
        assert_eq!(running.terms().contact.takes_off, !is_descending, "tick {tick}");
    }
    assert!(running.controller.command().modes.contains(Modes::DESCENDING));
    let (raw, com) = (running.state().setpoint().raw().position.z, running.terms().kinematics.com.z);
    assert_within!((com - 0.01 - raw).abs(), 1e-9, "kept at the height of the load transfer below");
}

/// A robot that stands and has lost its place for long stays where it is: there is nowhere to descend to.
#[test]
fn a_robot_that_stands_does_not_descend() {
    let mut standing = controller(|_| ());
    let mut state = at_rest();
    standing.tick(&measurement(&state, Vector3::zeros(), &weight_on_both()));
    let height = standing.state().setpoint().raw().position.z;
    state.base.position.fill(f64::NAN);
    for tick in 1..500 {
        let time = f64::from(tick) * TIME_STEP;
        standing.tick(&Measurement { time, ..measurement(&state, Vector3::zeros(), &weight_on_both()) });
    }
    assert!(standing.controller.command().modes.contains(Modes::DESCENDING));
    assert_eq!(standing.state().setpoint().raw().position.z, height);
}

/// M107 holds in the air alone: with other gains for the way down the commands of a robot that has lost an engine are the
/// same while its feet carry, and others when they do not.
#[test]
fn the_law_of_a_lost_engine_is_that_of_the_air() {
    let controllers = [1.0, 3.0].map(|factor| {
        able_to_take_off_with(|_, engines| {
            let engines = engines.as_mut().unwrap();
            engines.deviation_max = 3.0;
            let descent = engines.descent.as_mut().unwrap();
            (descent.range_fraction_min, descent.momentum.c0) = (1.0, factor * descent.momentum.c0);
        })
    });
    let [(mut low, mut state), (mut high, _)] = controllers;
    let share = 0.77; // of its weight, that the thrusts leave to the feet
    for tick in 0..80 {
        let stands = tick < 40;
        let feet = weight_on_both().map(|wrench| if stands { share * wrench } else { Vector6::zeros() });
        // Without any motion what is measured would count as frozen.
        let speed = if tick % 2 == 0 { 1e-9 } else { -2e-9 };
        let fall = if stands { 0.0 } else { -share * 9.81 * TIME_STEP * f64::from(tick - 39) };
        state.velocity.fill(speed);
        state.velocity[2] += fall;
        state = move_state(&state, TIME_STEP);
        let [a, b] = [&mut low, &mut high].map(|running| {
            // The thrusts stay, though they are commanded to rise.
            tick_with_load(running, &state, f64::from(tick) * TIME_STEP, 0.5, &feet);
            running.controller.command().clone()
        });
        let carries = low.state().contact().is_active;
        let apart = (&a.joint_velocity - &b.joint_velocity).amax();
        assert_eq!(
            a.modes.contains(Modes::DESCENDING),
            tick >= 29,
            "tick {tick}: what the engine can do is allowed for"
        );
        assert_eq!(carries, tick < 59, "tick {tick}: to the end of the hold");
        assert!(if carries { apart == 0.0 } else { apart > 0.1 }, "tick {tick}: {apart} rad/s");
    }
}

/// Wrenches on feet that are not finite are those with which the torque QP keeps them at rest, and observers hold; a foot too
/// few stops the controller.
#[test]
fn unsound_feet_are_predicted_and_a_missing_one_is_a_bad_measurement() {
    let mut controller = controller(|config| {
        config.disturbance_observer = experiment("test2_observer").controller.law.disturbance_observer;
    });
    let (state, mut time) = (at_rest(), 0.0);
    let mut tick = |feet: &[Vector6<f64>]| {
        let measured = Measurement { time, ..measurement(&state, Vector3::zeros(), feet) };
        time += TIME_STEP;
        let modes = controller.tick(&measured).modes;
        let Terms { momentum, contact, .. } = controller.terms();
        let used = &controller.state().estimate().robot;
        let kept = contact.force_of_torques.as_slice().chunks_exact(6).map(Vector6::from_column_slice);
        let kept: Vec<_> = kept.collect();
        (modes, used.foot_wrenches.clone(), kept, momentum.unmodelled_wrench)
    };
    // More than the weight, and still at rest: something else pulls.
    let mut heavy = weight_on_both();
    heavy[0][2] += 40.0;
    let mut bad = heavy;
    bad[0][3] = f64::NAN;
    let _ = tick(&heavy);
    let (modes, _, kept, observed) = tick(&heavy);
    assert_eq!(modes, Modes::default());
    assert!(observed[2] < -0.5, "{observed}");
    let mut before = kept;
    assert!(before[0][2] > 10.0);
    for _ in 0..3 {
        let (modes, used, kept, held) = tick(&bad);
        assert_eq!(modes, Modes::FEET_PREDICTED);
        assert_eq!((used, held), (foot_after_foot(&before), observed));
        before = kept;
    }
    assert!(tick(&[Vector6::zeros()]).0.contains(Modes::MEASUREMENT_IGNORED));
    assert_eq!(tick(&weight_on_both()).0, Modes::default());
}

/// What is no foot, no ground, no motor is refused by name; so is a world that its engine does not know.
#[test]
fn bad_numbers_are_refused_by_name() {
    #[track_caller]
    fn refused(expected: &[&str], change: impl FnOnce(&mut ScenarioConfig)) {
        let mut config = standing();
        change(&mut config);
        let said = Scenario::check(&config).expect_err("refused").to_string();
        assert!(expected.iter().all(|part| said.contains(part)), "{said}");
    }
    fn contact(config: &mut ScenarioConfig) -> &mut ContactConfig {
        config.controller.law.contact.as_mut().unwrap()
    }
    Scenario::check(&standing()).unwrap();
    refused(&["contact.vertical_force_min` is 0", "> 0"], |c| contact(c).vertical_force_min = 0.0);
    refused(&["centre_of_pressure_margin is 0.05", "at most half", "`l_sole`"], |c| {
        contact(c).wrench.centre_of_pressure_margin = 0.05;
    });
    refused(&["load_transfer.unmodelled_force_max` is 0", "> 0"], |c| {
        contact(c).load_transfer = Some(LoadTransfer { gain: 1.0, unmodelled_force_max: Some(0.0) });
    });
    let mut blind = experiment("take_off").controller.law;
    blind.disturbance_observer = None;
    blind.fault_detection.engines = None;
    let said = blind.check(&crate::common::robot("ironcub_mk1")).expect_err("refused").to_string();
    assert!(
        said.contains("unmodelled_force_max is 50; expected none without controller.disturbance_observer"),
        "{said}"
    );
    refused(&["controller.contact.feet is []", "at least one"], |c| contact(c).feet.clear());
    refused(&["controller.contact.feet", "`l_sloe`", "l_sole"], |c| contact(c).feet[0] = "l_sloe".into());
    refused(&["controller.contact.feet", "`r_sole`", "more than once"], |c| {
        contact(c).feet[0] = "r_sole".into();
    });
    refused(&["friction_of", "`tail`", "l_ankle_pitch"], |c| {
        c.simulator.motors.as_mut().unwrap().friction_of.insert("tail".into(), 1.0);
    });
    refused(&["simulator.ground is absent", "take_off.toml"], |c| c.simulator.ground = None);
    refused(&["controller.contact is absent"], |c| c.controller.law.contact = None);
    refused(&["simulator.ground is given", "backend = \"mujoco\""], |c| {
        c.backend = flight_sim::Backend::Rust;
    });
    assert!(Scenario::new(&standing()).is_err(), "this engine has no ground");
    let said = experiment("test2");
    let mut sparrow = said.controller.clone();
    sparrow.law.contact = Some(contact_config());
    let mut footless = crate::common::robot("ironcub_mk1");
    footless.feet.clear();
    let said = sparrow.law.check(&footless).expect_err("refused").to_string();
    assert!(said.contains("controller.contact.feet names `l_sole`"), "{said}");
}

"""The standing controller against the symbolic derivation: both QPs, assembled here from its terms by dense algebra."""

from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.symbolic import MomentumModel, load_robot

ROOT = Path(__file__).resolve().parents[2]
FEET = ("l_sole", "r_sole")
TOLERANCE = 1e-9
"""Relative to the largest entry: sums of thousands of products, of entries that differ by factors of 1e6."""


@pytest.fixture(scope="module")
def model():
    robot = load_robot(ROOT / "configs/robot/ironcub_mk1.toml")
    aero = rust.load_config("take_off")["controller"]["aero"]
    model = MomentumModel(robot, aero)
    return model, ground_terms(model)


def ground_terms(model):
    """A_c, Λ_c, J_c and J̇_c ν (M54, M73), derived: a wrench (f, m) about p adds (f ; (p − p_G) × f + m) to L̇."""
    tree, com = model.tree, model.dynamics.com
    wrenches, total, motion = ca.SX.sym("f_c", 6, len(FEET)), ca.SX.zeros(6), ca.SX(0, 1)
    for name, wrench in zip(FEET, ca.horzsplit(wrenches), strict=True):
        pose, force, moment = tree.poses[name], wrench[:3], wrench[3:]
        total += ca.vertcat(force, ca.cross(pose.position - com, force) + moment)
        turning = ca.mtimes(ca.reshape(tree.rate(ca.vec(pose.rotation)), 3, 3), pose.rotation.T)
        motion = ca.vertcat(motion, tree.rate(pose.position), ca.inv_skew(turning))
    parts = {
        "a_c": ca.jacobian(total, ca.vec(wrenches)),
        "lambda_c": ca.jacobian(total, tree.q),
        "jacobian": ca.jacobian(motion, tree.velocity),
        "velocity_product": tree.rate(motion),
    }
    function = model.function("contact", list(parts.values()), [wrenches])

    def terms(state, thrust, wind, feet):
        found = function(*state, thrust, wind, np.transpose(feet))
        return SimpleNamespace(**{name: part.full().squeeze() for name, part in zip(parts, found, strict=True)})

    return terms


def ticks(count):
    """Second ticks of a robot that stands, takes off or lands: configuration, what was given, what came out."""
    config = rust.load_config("take_off")
    law = config["controller"]
    for key in (
        "disturbance_observer",
        "channels",
        "fault_detection",
    ):  # a random state does not follow from the one before
        del law[key]
    del law["contact"]["load_transfer"]["unmodelled_force_max"]  # which needs the observer
    initial, rng = config["simulator"]["initial"], np.random.default_rng(3)
    for index in range(count):
        controller = rust.Controller(config)
        given = []
        for _ in range(2):
            turn = rng.normal(size=4) * 0.1 + [1.0, 0.0, 0.0, 0.0]
            joints = np.array(initial["joint_position"]) + rng.uniform(-0.05, 0.05, 23)
            state = rust.State(rng.normal(size=3), rust.rotation_from_wxyz(turn), joints, rng.uniform(-0.3, 0.3, 29))
            feet = np.tile([0.0, 0.0, 150.0, 0.0, 0.0, 0.0], (2, 1)) + rng.uniform(-3.0, 3.0, (2, 6))
            given = [state, rng.uniform(20.0, 120.0, 4), rng.normal(size=3) * 5.0, feet]
            com = rust.dynamics(rust.Robot(config["robot"]), state).com_position
            setpoint = rust.Setpoint(
                com_position=np.add(com, [0.02, -0.01, 0.05 if index % 2 else -0.005]),
                rotation=rust.rotation_from_wxyz(turn + rng.normal(size=4) * 0.02),
                **{
                    name: rng.normal(size=3)
                    for name in (
                        *("com_velocity", "com_acceleration", "com_jerk"),
                        *("angular_velocity", "angular_acceleration", "angular_jerk"),
                    )
                },
            )
            tick = controller.tick(*given[:3], 0.01 * len(given), setpoint=setpoint, foot_wrenches=feet)
        yield law, given, setpoint, tick, bool(index % 2)


def momentum_cost(law, state, thrust, setpoint, tick, terms, contact, takes_off):
    """H and g of M57, M61 to M64, M73 and M111: Σ Aᵀ W A and Σ Aᵀ W b over the tasks."""
    nu, rotation = state.velocity, state.base_rotation
    mass = terms.mass_matrix[0, 0]
    n = 4 + 12 + 23
    jets, feet, joints = slice(0, 4), slice(4, 16), slice(16, n)
    lambda_ = terms.lambda_t + terms.lambda_a + contact.lambda_c
    rate = terms.momentum_rate + contact.a_c @ tick.contact.force.ravel()
    tasks = []

    gains = law["momentum"]
    kp, kd = np.array(gains["kp_linear"]), np.array(gains["kd_linear"])
    k = kp + kd + 1.0 / gains["ko"]
    motion = lambda_[:3] + k[:, None] * terms.momentum_matrix[:3]
    matrix = np.hstack([terms.a_t[:3], contact.a_c[:3], motion[:, 6:]])
    offset = motion[:, :6] @ nu[:6] - mass * (k * setpoint.com_velocity + setpoint.com_jerk)
    offset += (kd + 1.0) * (rate[:3] - mass * np.asarray(setpoint.com_acceleration))
    offset += kp * mass * (terms.com_position - setpoint.com_position)
    weights = law["weights"]
    tasks.append((matrix, offset, weights["momentum"]))

    turned = rotation.T @ np.hstack([terms.a_t, contact.a_c, lambda_[:, 6:]])[3:]
    demand = rotation.T @ (lambda_[3:, :6] @ nu[:6] - tick.sigma) - tick.k_ddot_desired
    tasks.append((turned, demand, weights["momentum"]))

    angular = np.zeros((3, n))
    angular[:, joints] = rotation.T @ terms.momentum_matrix[3:, 6:]
    inertia = rotation.T @ terms.centroidal_inertia @ rotation
    spin = (inertia - tick.inertia_0_b) @ rotation.T @ nu[3:6]
    tasks.append((angular, spin, weights["angular_momentum"]))

    still = np.zeros((12, n))
    still[:, joints] = contact.jacobian[:, 6:]
    tasks.append((still, contact.jacobian[:, :6] @ nu[:6], law["contact"]["weight_foot_velocity"]))

    symmetric = np.zeros((2, n))
    symmetric[0, [0, 1]] = symmetric[1, [2, 3]] = 1.0, -1.0
    tasks.append((symmetric, np.zeros(2), weights["symmetry"]))

    unit = np.eye(n)
    groups = (("torso", 3), ("left_arm", 4), ("right_arm", 4), ("left_leg", 6), ("right_leg", 6))
    posture = np.concatenate([np.full(count, law["posture_gain"][name]) for name, count in groups])
    tasks.append((unit[joints], posture * (state.joint_position - tick.posture), weights["posture"]))
    tasks.append((unit[joints], np.zeros(23), weights["joint_velocity"]))
    gain = law["contact"]["load_transfer"]["gain"]
    of_jets, of_feet = (0.0, gain) if takes_off else (gain, 0.0)
    tasks.append((unit[jets], of_jets * thrust, next(iter(set(weights["thrust_rate"].values())))))
    tasks.append((unit[feet], of_feet * tick.contact.force.ravel(), law["contact"]["weight_force_rate"]))
    tasks.append((unit, np.zeros(n), weights["regularisation"]))
    return sum(w * a.T @ a for a, _, w in tasks), sum(w * a.T @ b for a, b, w in tasks)


def torque_cost(law, tick, terms, contact):
    """H and g of M76, of the unknowns (f_c, τ), without its constant."""
    select = np.vstack([np.zeros((6, 23)), np.eye(23)])
    b = np.hstack([contact.jacobian.T, select])
    force = terms.jet_generalised + terms.aero_generalised - terms.bias
    rotors = np.diag(np.append(np.zeros(6), np.full(23, law["torque"]["rotor_inertia"])))
    acceleration = b.T @ np.linalg.solve(terms.mass_matrix + rotors, np.hstack([b, force[:, None]]))
    gain, free = acceleration[:, :-1], acceleration[:, -1] + np.append(contact.velocity_product, np.zeros(23))
    torque, feet = law["torque"], law["contact"]
    weight = np.append(np.full(12, feet["weight_foot_acceleration"]), np.full(23, torque["weight_acceleration"]))
    small = (
        np.append(np.full(12, feet["weight_force"]), np.full(23, torque["weight_torque"])) + torque["regularisation"]
    )
    wanted = np.append(np.zeros(12), tick.joint_acceleration_desired)
    g = gain.T @ (weight * (free - wanted))
    g[:12] -= feet["weight_force"] * tick.contact.force.ravel()
    return gain.T @ (weight[:, None] * gain) + np.diag(small), g


def test_both_qps_on_the_ground(model, agree):
    air, ground = model
    for law, (state, thrust, wind, _), setpoint, tick, takes_off in ticks(12):
        assert tick.contact.is_active
        terms = air.terms(*state, thrust, wind)
        contact = ground(state, thrust, wind, tick.contact.force)
        pairs = {
            "A_c": (contact.a_c, tick.contact.a_c),
            "J_c": (contact.jacobian, tick.contact.jacobian),
            "J_c rate times velocity": (contact.velocity_product, tick.contact.velocity_product),
        }
        cost = momentum_cost(law, state, thrust, setpoint, tick, terms, contact, takes_off)
        pairs |= {"momentum QP, H": (cost[0], tick.momentum_qp.h), "momentum QP, g": (cost[1], tick.momentum_qp.g)}
        cost = torque_cost(law, tick, terms, contact)
        pairs |= {"torque QP, H": (cost[0], tick.torque_qp.h), "torque QP, g": (cost[1], tick.torque_qp.g)}
        for name, (derived, ours) in pairs.items():
            scale = np.abs(ours).max()
            agree(f"crate = symbolic: {name}", np.reshape(derived, ours.shape) / scale, ours / scale, TOLERANCE)

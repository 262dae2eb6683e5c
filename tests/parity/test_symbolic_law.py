"""The controller against the symbolic derivation: both QPs, assembled here from its terms by dense algebra."""

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
    return model, MomentumModel(robot, {"model": "off"}), ground_terms(model)


def ground_terms(model):
    """A_c, Λ_c, J_c, J̇_c ν (M54, M73), rotations: a wrench (f, m) about p adds (f ; (p − p_G) × f + m) to L̇."""
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
        "rotations": ca.horzcat(*(tree.poses[name].rotation for name in FEET)),
    }
    function = model.function("contact", list(parts.values()), [wrenches])

    def terms(state, thrust, wind, feet):
        found = function(*state, thrust, wind, np.transpose(feet))
        return SimpleNamespace(**{name: part.full().squeeze() for name, part in zip(parts, found, strict=True)})

    return terms


def ticks(experiment, count):
    """Second ticks of a robot that stands, takes off or flies: what was given, and what came out of both ticks."""
    config = rust.load_config(experiment)
    law = config["controller"]
    # A random state does not follow from the one before.
    for key in ("disturbance_observer", "channels", "fault_detection"):
        law.pop(key, None)
    if "contact" in law:
        del law["contact"]["load_transfer"]["unmodelled_force_max"]  # which needs the observer
    initial, rng = config["simulator"]["initial"], np.random.default_rng(3)

    def vectors(*names):
        return {name: rng.normal(size=3) for name in names}

    for index in range(count):
        controller = rust.Controller(config)
        given, found = [], []
        for _ in range(2):
            turn = rng.normal(size=4) * 0.1 + [1.0, 0.0, 0.0, 0.0]
            joints = np.array(initial["joint_position"]) + rng.uniform(-0.05, 0.05, 23)
            state = rust.State(rng.normal(size=3), rust.rotation_from_wxyz(turn), joints, rng.uniform(-0.3, 0.3, 29))
            feet = np.tile([0.0, 0.0, 150.0, 0.0, 0.0, 0.0], (2, 1)) + rng.uniform(-3.0, 3.0, (2, 6))
            given = [state, rng.uniform(20.0, 120.0, 4), rng.normal(size=3) * 5.0]
            com = rust.dynamics(rust.Robot(config["robot"]), state).com_position
            setpoint = rust.Setpoint(
                com_position=np.add(com, [0.02, -0.01, 0.05 if index % 2 else -0.005]),
                rotation=rust.rotation_from_wxyz(turn + rng.normal(size=4) * 0.02),
                **vectors("com_velocity", "com_acceleration", "com_jerk"),
                **vectors("angular_velocity", "angular_acceleration", "angular_jerk"),
            )
            feet = feet if "contact" in law else None
            found.append(controller.tick(*given, 0.01 * len(found), setpoint=setpoint, foot_wrenches=feet))
        yield law, given, setpoint, found, bool(index % 2)


def attitude_law(gains, rotation, velocity, setpoint, inertia, moment):
    """Desired k̈ (M59, M60) in base axes and σ (M61) in inertial ones, of the moment about the centre of mass."""
    inverse, w, w_d = np.linalg.inv(inertia), rotation.T @ velocity, setpoint.angular_velocity
    momentum = inertia @ w
    rate = rotation.T @ moment - np.cross(w, momentum)
    error = setpoint.rotation.T @ rotation
    slope = error @ skew(w) - skew(w_d) @ error
    demand = inertia @ setpoint.angular_jerk - vee_of_skew_part(slope)
    demand -= (np.eye(3) + gains["c0"] * inverse) @ (rate - inertia @ setpoint.angular_acceleration)
    demand -= inverse @ (gains["c0"] * vee_of_skew_part(error) + gains["c1"] * (momentum - inertia @ w_d))
    sigma = np.cross(w, np.cross(w, momentum)) + 2.0 * np.cross(w, rate) + np.cross(inverse @ rate, momentum)
    return demand, rotation @ sigma


def skew(v):
    """S(v) with S(v) u = v × u."""
    return np.cross(np.eye(3), v)  # rows e_k × v


def vee_of_skew_part(a):
    """Return v with S(v) = (A − Aᵀ)/2."""
    return 0.5 * np.array([a[2, 1] - a[1, 2], a[0, 2] - a[2, 0], a[1, 0] - a[0, 1]])


def momentum_cost(law, state, thrust, setpoint, tick, terms, contact, takes_off):
    """H and g of M57, M61 to M64, M73 and M111: Σ Aᵀ W A and Σ Aᵀ W b over the tasks."""
    nu, rotation = state.velocity, state.base_rotation
    mass = terms.mass_matrix[0, 0]
    of_feet = contact.a_c.shape[1]
    n = 4 + of_feet + 23
    jets, feet, joints = slice(0, 4), slice(4, 4 + of_feet), slice(4 + of_feet, n)
    lambda_ = terms.lambda_t + terms.lambda_a + contact.lambda_c
    rate = terms.momentum_rate + contact.a_c @ contact.force
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
    wanted, sigma = attitude_law(gains, rotation, nu[3:6], setpoint, tick.inertia_0_b, rate[3:])
    tasks.append((turned, rotation.T @ (lambda_[3:, :6] @ nu[:6] - sigma) - wanted, weights["momentum"]))

    angular = np.zeros((3, n))
    angular[:, joints] = rotation.T @ terms.momentum_matrix[3:, 6:]
    inertia = rotation.T @ terms.centroidal_inertia @ rotation
    spin = (inertia - tick.inertia_0_b) @ rotation.T @ nu[3:6]
    tasks.append((angular, spin, weights["angular_momentum"]))

    symmetric = np.zeros((2, n))
    symmetric[0, [0, 1]] = symmetric[1, [2, 3]] = 1.0, -1.0
    tasks.append((symmetric, np.zeros(2), weights["symmetry"]))

    unit = np.eye(n)
    groups = (("torso", 3), ("left_arm", 4), ("right_arm", 4), ("left_leg", 6), ("right_leg", 6))
    posture = np.concatenate([np.full(count, law["posture_gain"][name]) for name, count in groups])
    tasks.append((unit[joints], posture * (state.joint_position - tick.posture), weights["posture"]))
    tasks.append((unit[joints], np.zeros(23), weights["joint_velocity"]))
    relieved = np.zeros(4)
    if of_feet:
        still = np.zeros((of_feet, n))
        still[:, joints] = contact.jacobian[:, 6:]
        tasks.append((still, contact.jacobian[:, :6] @ nu[:6], 150.0))
        gain = law["contact"]["load_transfer"]["gain"]
        relieved, pressing = (0.0 * thrust, gain * contact.force) if takes_off else (gain * thrust, 0.0 * contact.force)
        tasks.append((unit[feet], pressing, law["contact"]["weight_force_rate"]))
    tasks.append((unit[jets], relieved, next(iter(set(weights["thrust_rate"].values())))))
    tasks.append((unit, np.zeros(n), 1e-4))
    return sum(w * a.T @ a for a, _, w in tasks), sum(w * a.T @ b for a, b, w in tasks)


def torque_cost(law, state, tick, integral, terms, contact):
    """H and g of M76, of the unknowns (f_c, τ), without its constant; an integral of errors is used before it grows."""
    of_feet, torque = contact.a_c.shape[1], law["torque"]
    b = np.hstack([contact.jacobian.T, np.vstack([np.zeros((6, 23)), np.eye(23)])])
    force = terms.jet_generalised + terms.aero_generalised - terms.bias
    rotors = np.diag(np.append(np.zeros(6), np.full(23, torque["rotor_inertia"])))
    acceleration = b.T @ np.linalg.solve(terms.mass_matrix + rotors, np.hstack([b, force[:, None]]))
    gain, free = acceleration[:, :-1], acceleration[:, -1] + np.append(contact.velocity_product, np.zeros(23))

    def weights(of_feet_each, of_joints):
        return np.append(np.full(of_feet, of_feet_each), np.full(23, of_joints))

    weight = weights(100.0, torque["weight_acceleration"])
    small = weights(1.0, 0.001) + 1e-4
    wanted = -torque["kd"] * (state.velocity[6:] - tick.joint_velocity_command) - torque["kp"] * integral
    g = gain.T @ (weight * (free - np.append(np.zeros(of_feet), wanted)))
    g[:of_feet] -= contact.force
    return gain.T @ (weight[:, None] * gain) + np.diag(small), g


@pytest.mark.parametrize("experiment", ["test1", "test2", "take_off"])
def test_both_qps(experiment, model, agree):
    """In flight, with the air in the controller and without, and on the ground."""
    air, calm, ground = model
    of_soles = []
    for law, (state, thrust, wind), setpoint, (before, tick), takes_off in ticks(experiment, 12):
        terms = (calm if experiment == "test1" else air).terms(*state, thrust, wind)
        if tick.contact is None:
            none, force = np.zeros((6, 0)), np.zeros(0)
            contact = SimpleNamespace(
                a_c=none, lambda_c=0.0, jacobian=np.zeros((0, 29)), velocity_product=force, force=force
            )
            pairs = {}
        else:
            assert tick.contact.is_active
            contact = ground(state, thrust, wind, tick.contact.force)
            contact.force = tick.contact.force.ravel()
            pairs = {
                "A_c": (contact.a_c, tick.contact.a_c),
                "J_c": (contact.jacobian, tick.contact.jacobian),
                "J_c rate times velocity": (contact.velocity_product, tick.contact.velocity_product),
            }
            rows = tick.torque_qp.rows[:, :12].reshape(-1, 2, 2, 3)
            of_soles.append(np.einsum("nfkj,jfi->nfki", rows, contact.rotations.reshape(3, 2, 3)))
        cost = momentum_cost(law, state, thrust, setpoint, tick, terms, contact, takes_off)
        pairs |= {"momentum QP, H": (cost[0], tick.momentum_qp.h), "momentum QP, g": (cost[1], tick.momentum_qp.g)}
        cost = torque_cost(law, state, tick, before.velocity_error_integral, terms, contact)
        pairs |= {"torque QP, H": (cost[0], tick.torque_qp.h), "torque QP, g": (cost[1], tick.torque_qp.g)}
        for name, (derived, ours) in pairs.items():
            scale = np.abs(ours).max()
            agree(f"crate = symbolic: {name}", np.reshape(derived, ours.shape) / scale, ours / scale, TOLERANCE)
    # Whatever the attitude of a sole, its limits are the same in its axes.
    if of_soles:
        agree("limits of the soles", of_soles, np.broadcast_to(of_soles[0], np.shape(of_soles)), 1e-12)

"""Two complete states of the controller, computed without the crate and without the JAX implementation.

    bodies, joints and frames           Pinocchio, which reads the same URDF
    M, h, A_G, L, centre of mass        Pinocchio
    link forces, jets, A_T, Λ_T, Λ_a    `jax_aero.symbolic`: CasADi derivatives of momentum and energy
    tasks, H, g, bounds, torque QP      here, from the equations of `docs/model`, in NumPy
    answers of the QPs                  active bounds from DAQP, then one linear system

Gains, coefficients and limits are read from `configs/`. `python -m tests.golden.states` writes `states.json`.
"""

from __future__ import annotations

import json
from ctypes import c_int
from typing import Any

import casadi as ca
import daqp
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from jax_aero import rust
from jax_aero.symbolic import MomentumModel, load_robot
from tests.golden.inputs import AERO, EXPERIMENT, FILE, ROBOT, TORQUE_MAX
from tests.parity.test_dynamics_pinocchio import Oracle

DRAWN = ((4, 0.1, 0.03), (3, 0.1, 1.0))
"""Arguments of `draw_state`: four bounds of the momentum QP are active; twelve, and three of the torque QP."""

Array = NDArray[np.float64]
Values = dict[str, Array]


def skew(v: ArrayLike) -> Array:
    """S(v) with S(v) u = v × u."""
    return np.cross(np.eye(3), v)  # rows e_k × v


def vee_of_skew_part(a: Array) -> Array:
    """Return v with S(v) = (A − Aᵀ)/2."""
    return 0.5 * np.array([a[2, 1] - a[1, 2], a[0, 2] - a[2, 0], a[1, 0] - a[0, 1]])


def draw_state(seed: int, size: float, integral: float) -> Values:
    """Draw a state near hovering, `size` away from its set-point, in a wind of some 10 m/s."""
    rng = np.random.default_rng(seed)
    posture = np.array(rust.load_config(EXPERIMENT)["simulator"]["initial"]["joint_position"])

    def vector(scale: float, n: int = 3) -> Array:
        return rng.normal(scale=scale * size, size=n).round(4)

    def rotation(scale: float) -> Array:
        """Near a yaw of 180 deg, leaning forward until the jets of this posture push straight up."""
        wxyz = np.array([0.0, 0.024, 0.0, 1.0]) + np.append(vector(scale), 0.0)
        return rust.rotation_from_wxyz(wxyz / np.linalg.norm(wxyz))

    position = np.array([0.4, 0.8, 1.2])
    shear = np.array([[1.0, 0.02, -0.04], [0.0, 1.0, 0.01], [0.0, 0.0, 1.0]])
    return {
        "base_position": position,
        "base_rotation": rotation(0.1),
        "joint_position": posture + vector(0.1, len(posture)),
        "velocity": np.concatenate([vector(0.1), vector(0.2), vector(0.3, len(posture))]),
        "thrust": np.array([103.0, 103.0, 118.0, 118.0]) + vector(2.0, 4),
        "wind": np.array([-7.0, 4.0, -2.0]) + vector(3.0),
        "memory.posture": posture,
        "memory.inertia_0_b": shear.T @ np.diag([3.1, 2.9, 0.7]) @ shear,
        "memory.velocity_error_integral": rng.normal(scale=integral, size=len(posture)).round(4),
        "setpoint.com_position": position + vector(0.05) + [0.0, 0.0, -0.05],
        "setpoint.com_velocity": vector(0.1),
        "setpoint.com_acceleration": vector(0.1),
        "setpoint.com_jerk": vector(0.1),
        "setpoint.rotation": rotation(0.05),
        "setpoint.angular_velocity": vector(0.1),
        "setpoint.angular_acceleration": vector(0.1),
        "setpoint.angular_jerk": vector(0.1),
    }


def compute_physics(given: Values, model: MomentumModel) -> Values:
    """Compute what does not depend on gains."""
    robot = rust.Robot(ROBOT)
    state = [given[key] for key in ("base_position", "base_rotation", "joint_position", "velocity")]
    inputs = [*state, given["thrust"], given["wind"]]
    terms = model.terms(*inputs)
    oracle = Oracle(ROBOT.with_suffix(".urdf"), robot, {})
    oracle.set(rust.State(*state), _wxyz(given["base_rotation"]))
    momentum_matrix = oracle.mixed(pin.ccrba(oracle.model, oracle.data, oracle.q, oracle.velocity))
    links = ca.vertcat(*model.link_points)
    places = model.function(
        "places",
        [
            links,
            ca.jacobian(links, model.tree.q),
            ca.vertcat(*model.link_axes),
            ca.vertcat(*model.jet_points),
            ca.vertcat(*model.jet_axes),
        ],
    )
    points, jacobian, axes, jet_points, jet_axes = (np.array(value.full()) for value in places(*inputs))
    links_by_3 = (len(model.link_points), 3)
    jacobian = jacobian.reshape(*links_by_3, -1)
    return {
        "com_position": oracle.data.com[0].copy(),
        "mass_matrix": oracle.mass_matrix(),
        "bias": oracle.bias(),
        "momentum_matrix": momentum_matrix,
        "momentum": oracle.data.hg.vector.copy(),
        "centroidal_inertia": oracle.data.Ig.inertia.copy(),
        "link_axes": axes.reshape(links_by_3),
        "link_v_air": given["wind"] - jacobian @ given["velocity"],
        "link_arm_points": points.reshape(links_by_3),
        "link_jacobians": jacobian,
        "aero_force": terms.aero_force,
        "jet_axes": jet_axes.reshape(-1, 3),
        "jet_points": jet_points.reshape(-1, 3),
        "a_t": terms.a_t,
        "lambda_t": terms.lambda_t,
        "lambda_a": terms.lambda_a,
        "momentum_rate_estimate": terms.momentum_rate,
        "generalised_force": terms.jet_generalised + terms.aero_generalised,
    }


def robot_figures() -> dict[str, Any]:
    """List bodies, joints and frames as Pinocchio reads them."""
    names = rust.Robot(ROBOT)
    oracle = Oracle(ROBOT.with_suffix(".urdf"), names, {})
    model, data = oracle.model, oracle.data
    pin.computeJointJacobians(model, data, pin.neutral(model))
    joints = [1, *(model.getJointId(name) for name in names.joint_names)]
    bodies = []
    for body, joint in zip(names.body_names, joints, strict=True):
        inertia, placement = model.inertias[joint], model.jointPlacements[joint]
        column = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL)[3:, model.joints[joint].idx_v]
        figures = {
            "name": body,
            "mass": inertia.mass,
            "com": inertia.lever.tolist(),
            "inertia": inertia.inertia.tolist(),
        }
        if joint > 1:
            figures |= {
                "parent": names.body_names[joints.index(model.parents[joint])],
                "position": placement.translation.tolist(),
                "rotation": placement.rotation.tolist(),
                "axis": column.tolist(),
            }
        bodies.append(figures)
    frames = []
    for name in [*names.aero_link_names, "l_sole", "r_sole"]:
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        frames.append(
            {
                "name": name,
                "body": names.body_names[joints.index(frame.parentJoint)],
                "position": frame.placement.translation.tolist(),
                "rotation": frame.placement.rotation.tolist(),
            }
        )
    return {"bodies": bodies, "frames": frames}


def compute_control(given: Values, found: Values, config: dict[str, Any]) -> Values:
    """Compute tasks, QPs and their answers; the numbers of the equations are those of `docs/model`."""
    robot = load_robot(ROBOT)
    mass, nu, n_jets = robot.mass, given["velocity"], len(robot.jets)
    gains, weights, bounds, torque = (config[key] for key in ("momentum", "weights", "bounds", "torque"))
    setpoint = {key.split(".")[1]: value for key, value in given.items() if key.startswith("setpoint.")}
    a, rate = found["momentum_matrix"], found["momentum_rate_estimate"]
    lam = found["lambda_t"] + found["lambda_a"]

    # Linear rows.
    kp, kd = np.array(gains["kp_linear"]), np.array(gains["kd_linear"])
    k = kp + kd + 1.0 / gains["ko"]
    motion = lam[:3] + k[:, None] * a[:3]
    linear = np.hstack([found["a_t"][:3], motion[:, 6:]])
    linear_offset = motion[:, :6] @ nu[:6] - k * mass * setpoint["com_velocity"] - mass * setpoint["com_jerk"]
    linear_offset += (kd + 1.0) * (rate[:3] - mass * setpoint["com_acceleration"])
    linear_offset += kp * mass * (found["com_position"] - setpoint["com_position"])

    # Angular rows, in base axes.
    r, i0 = given["base_rotation"], given["memory.inertia_0_b"]
    i0_inv, w, w_d = np.linalg.inv(i0), r.T @ nu[3:6], setpoint["angular_velocity"]
    momentum = i0 @ w
    momentum_rate = r.T @ rate[3:] - np.cross(w, momentum)
    error = setpoint["rotation"].T @ r
    e, e_dot = vee_of_skew_part(error), vee_of_skew_part(error @ skew(w) - skew(w_d) @ error)
    rate_error = momentum_rate - i0 @ setpoint["angular_acceleration"]
    demand = i0 @ setpoint["angular_jerk"] - e_dot - (np.eye(3) + gains["c0"] * i0_inv) @ rate_error
    demand -= i0_inv @ (gains["c0"] * e + gains["c1"] * (momentum - i0 @ w_d))
    sigma = np.cross(w, np.cross(w, momentum)) + 2.0 * np.cross(w, momentum_rate)
    sigma += np.cross(i0_inv @ momentum_rate, momentum)
    angular = r.T @ np.hstack([found["a_t"][3:], lam[3:, 6:]])
    angular_offset = r.T @ lam[3:, :6] @ nu[:6] - sigma - demand
    limbs = np.hstack([np.zeros((3, n_jets)), r.T @ a[3:, 6:]])
    limbs_offset = (r.T @ found["centroidal_inertia"] @ r - i0) @ w

    # Cost and bounds of the momentum QP.
    task = np.vstack([linear, angular, limbs])
    offset = np.concatenate([linear_offset, angular_offset, limbs_offset])
    row_weights = np.repeat([weights["momentum"], weights["angular_momentum"]], [6, 3])
    h = task.T @ (row_weights[:, None] * task)
    g = task.T @ (row_weights * offset)
    jets = [jet.name for jet in robot.jets]
    of_joints = np.full(robot.n_joints, weights["posture"] + weights["joint_velocity"])
    h += np.diag(np.concatenate([[weights["thrust_rate"][jet] for jet in jets], of_joints]))
    h += weights["regularisation"] * np.eye(len(h))
    for pair in weights["symmetric_jets"]:
        i, j = map(jets.index, pair)
        difference = np.eye(len(h))[i] - np.eye(len(h))[j]
        h += weights["symmetry"] * np.outer(difference, difference)
    groups = rust.Robot(ROBOT).joint_groups
    posture_gain = {joint: config["posture_gain"][group] for group, joints in groups.items() for joint in joints}
    posture_error = given["joint_position"] - given["memory.posture"]
    g[n_jets:] += weights["posture"] * np.array([posture_gain[name] for name in robot.joint_names]) * posture_error

    value = np.concatenate([given["thrust"], given["joint_position"]])
    limits = np.vstack([[(jet.thrust_min, jet.thrust_max) for jet in robot.jets], robot.joint_limits])
    steepness = np.repeat([bounds["thrust_steepness"], bounds["joint_steepness"]], [n_jets, robot.n_joints])
    rate_max = [bounds["thrust_rate_max"][jet] for jet in jets]
    rate_max = np.array(rate_max + [np.radians(bounds["joint_velocity_max_deg"])] * robot.n_joints)
    lower = -rate_max * np.tanh(steepness * (value - limits[:, 0]))
    upper = rate_max * np.tanh(steepness * (limits[:, 1] - value))
    u = solve(h, g, lower, upper)

    # Torques.
    inverse = np.linalg.inv(found["mass_matrix"])
    gain, free = inverse[6:, 6:], (inverse @ (found["generalised_force"] - found["bias"]))[6:]
    joint_rate_error = nu[6:] - u[n_jets:]
    desired = -torque["kd"] * joint_rate_error - torque["kp"] * given["memory.velocity_error_integral"]
    torque_h = torque["weight_acceleration"] * gain.T @ gain
    torque_h += (torque["weight_torque"] + torque["regularisation"]) * np.eye(len(gain))
    torque_g = torque["weight_acceleration"] * gain.T @ (free - desired)
    limit = np.full(len(gain), TORQUE_MAX)
    return {
        "task": task,
        "task_offset": offset,
        "sigma": r @ sigma,
        "k_ddot_desired": demand,
        "momentum_qp.h": h,
        "momentum_qp.g": g,
        "momentum_qp.lower": lower,
        "momentum_qp.upper": upper,
        "thrust_rate": u[:n_jets],
        "joint_velocity_command": u[n_jets:],
        "joint_acceleration_free": free,
        "joint_acceleration_desired": desired,
        "torque_gain": gain,
        "torque_qp.h": torque_h,
        "torque_qp.g": torque_g,
        "unlimited_torque": solve(torque_h, torque_g, -limit, limit),
    }


def solve(h: Array, g: Array, lower: Array, upper: Array) -> Array:
    """Return argmin ½ xᵀ H x + gᵀ x within bounds: the active bounds of DAQP, the rest from one linear system."""
    x = daqp.solve(h, g, np.zeros((0, len(g))), upper, lower, np.zeros(len(g), dtype=c_int))[0]
    width = upper - lower
    at_lower, at_upper = x - lower <= 1e-6 * width, upper - x <= 1e-6 * width
    x = np.where(at_lower, lower, np.where(at_upper, upper, x))
    free = ~(at_lower | at_upper)
    x[free] = np.linalg.solve(h[np.ix_(free, free)], -(g + h[:, ~free] @ x[~free])[free])
    gradient = h @ x + g
    assert np.all(lower <= x)
    assert np.all(x <= upper)
    assert np.all(gradient[at_lower] > 0.0)
    assert np.all(gradient[at_upper] < 0.0)
    return x


def compute_controllers(given: Values) -> dict[str, Values]:
    """Compute both controllers at a state, and the link forces of the other model."""
    robot = load_robot(ROBOT)
    found: dict[str, Values] = {"given": given}
    for name in ("aero_aware", "baseline"):
        config = rust.load_config(EXPERIMENT)["controller"]
        aero = rust.load_aero(AERO[name]) if name in AERO else {"model": "off"}
        values = compute_physics(given, MomentumModel(robot, aero))
        found[name] = values | compute_control(given, values, config)
    del found["aero_aware"]["generalised_force"]
    changed = ("momentum_qp.h", "momentum_qp.g", "thrust_rate", "joint_velocity_command", "unlimited_torque")
    found["baseline"] = {key: found["baseline"][key] for key in changed}
    cylinders = compute_physics(given, MomentumModel(robot, rust.load_aero(AERO["sphere_cylinder"])))
    found["sphere_cylinder"] = {"aero_force": cylinders["aero_force"]}
    return found


def _wxyz(rotation: Array) -> Array:
    """Quaternion of a rotation whose largest component is not w: the eigenvector of 4 q qᵀ − 1."""
    r, t = rotation, np.trace(rotation)
    k = np.empty((4, 4))
    k[0, 0], k[1:, 1:] = t, r + r.T - t * np.eye(3)
    k[0, 1:] = k[1:, 0] = 2.0 * vee_of_skew_part(r)
    return np.linalg.eigh(k)[1][:, -1]


def main() -> None:
    """Draw, compute, write."""
    assert __doc__
    states = [compute_controllers(draw_state(*arguments)) for arguments in DRAWN]
    listed = [{part: {key: v.tolist() for key, v in values.items()} for part, values in s.items()} for s in states]
    content = {"source": " ".join(__doc__.split()), "robot": robot_figures(), "states": listed}
    lines = json.dumps(content, ensure_ascii=False)
    FILE.write_text(lines + "\n", encoding="utf-8")
    for state in states:
        qp = state["aero_aware"]
        u = np.concatenate([qp["thrust_rate"], qp["joint_velocity_command"]])
        active = np.sum((u == qp["momentum_qp.lower"]) | (u == qp["momentum_qp.upper"]))
        torques = np.sum(np.abs(qp["unlimited_torque"]) == 50.0)
        print(f"active bounds: {active} of the momentum QP, {torques} of the torque QP")


if __name__ == "__main__":
    main()

"""The plan of a descent beside IPOPT's optimum of the same problem (M178 to M180), which CasADi derives anew."""

from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jax_aero import rust
from jax_aero.base import tables
from jax_aero.control.mpc.clearance import LEAST_DISTANCE
from jax_aero.robot.groups import joints_of
from jax_aero.symbolic import MomentumModel, load_robot
from jax_aero.symbolic.clearance import kept_apart
from jax_aero.symbolic.trajectory import IPOPT
from tests.parity import knot

KNOTS, TAIL = [0.02] * 2 + [0.04] * 4 + [0.08] * 21, 1.0
"""Durations of the knots, and of the errors at the end [s]."""
LOSSES = {
    "robot": [("l_arm_jet", 19.0, 1.05), ("l_arm_jet", 28.0, 1.55), ("r_arm_jet", 19.0, 1.5)],
    "mk3_robot": [("l_arm_jet", 12.0, 1.55)],
}
"""The engine that stops, when [s], and the greatest quotient of the costs, by flight."""
DAMPING = 0.3
"""Added to IPOPT's second derivatives, which lack those of the motion: without it its steps are too long."""
SEARCH = IPOPT | {"ipopt.mu_strategy": "monotone", "ipopt.mu_init": 1e-2, "ipopt.tol": 5e-2}
SEARCH |= {"ipopt.compl_inf_tol": 1e-2, "ipopt.constr_viol_tol": 1e-3, "calc_lam_p": False}


class Problem:
    """Knots are w = (z, v, quaternion, k, T, Ṫ, s, λ, ṡ) / scale; `n` is the size of their state."""

    def __init__(self, config: Any) -> None:
        file, law = config["robot"], config["controller"]
        self.robot = robot = load_robot(file)
        self.joints = sorted(joints_of(file, tuple(law["mpc"]["joint_groups"])))
        jets, joints, of_all = len(robot.jets), len(self.joints), robot.n_joints
        sizes, units = [1, 3, 4, 3, jets, jets, joints, jets, joints], [1, 1, 1, 5, 50, 50, 1, 1, 1]
        self.n, self.scale = n, scale = 11 + 2 * jets + joints, np.repeat(units, sizes)
        w, p, h = ca.SX.sym("w", scale.size), ca.SX.sym("p", of_all + joints + 9 + jets), ca.SX.sym("h")
        z, v, wxyz, k, thrust, rate, s, part, s_dot = ca.vertsplit(w * scale, np.cumsum([0, *sizes]).tolist())
        q, posture, wind, beyond, works = ca.vertsplit(p, np.cumsum([0, of_all, joints, 3, 6, jets]).tolist())
        q_dot, xyz = ca.SX.zeros(of_all), wxyz[1:]
        q[self.joints], q_dot[self.joints] = s, s_dot
        turn = (wxyz[0] ** 2 - ca.sumsqr(xyz)) * ca.SX.eye(3) + 2.0 * (xyz @ xyz.T + wxyz[0] * ca.skew(xyz))
        model, here = MomentumModel(robot, law["aero"]), (ca.SX.zeros(3), turn / ca.sumsqr(wxyz), q)
        dynamics, apart = model.dynamics, kept_apart(model.tree, law["mpc"]["clearance"])
        body = model.function("body", [dynamics.locked_inertia, dynamics.com, dynamics.momentum, apart])
        inertia, arm, own, apart = body(*here, ca.vertcat(ca.SX.zeros(6), q_dot), thrust, wind)
        omega = ca.solve(inertia, k - own[3:])
        velocity = ca.vertcat(v - own[:3] / robot.mass - ca.cross(omega, arm), omega, q_dot)
        force = model.function("rate", [model.momentum_rate])(*here, velocity, thrust, wind) + beyond
        numbers = [tables.read(file)["engines"][name] for name in rust.Robot(file).arrays()["jets"]["engines"]]
        e = {key: ca.DM([of[key] for of in numbers]) for key in numbers[0]}
        drift = e["k_t"] * thrust + e["k_tt"] * thrust**2 + e["k_d"] * rate + e["k_dd"] * rate**2 + e["c"]
        drift, gain = drift + e["k_td"] * thrust * rate, e["b_u"] + e["b_t"] * thrust + e["b_d"] * rate
        ends = [drift + gain * end * (1.0 + e["b_uu"] * end) for end in (e["throttle_min"], e["throttle_max"])]
        of_engines = works * rate, works * (ca.fmin(*ends) + part * (ca.fmax(*ends) - ca.fmin(*ends)))
        x_dot = ca.vertcat(v[2], force[:3] / robot.mass, omega, force[3:], *of_engines, s_dot)
        by_turn, none = 0.5 * ca.vertcat(-xyz.T, wxyz[0] * ca.SX.eye(3) - ca.skew(xyz)), ca.SX.zeros(jets + joints)
        x_ddot = ca.jtimes(x_dot, w, ca.vertcat(x_dot[:4], by_turn @ omega, x_dot[7:], none) / scale)
        on = h * x_dot + 0.5 * h**2 * x_ddot
        half = ca.sqrt(ca.sumsqr(0.5 * on[4:7]) + 1e-20)
        turned = ca.cos(half) * wxyz + ca.sin(half) / half * by_turn @ on[4:7]
        moved = ca.vertcat(z + on[0], v + on[1:4], turned, ca.vertcat(k, thrust, rate, s) + on[7:]) / scale[:n]
        (idle, full), (lower, upper) = (robot.thrust_min, robot.thrust_max), robot.joint_limits[self.joints].T
        beyond_v = ca.sqrt(1.0 + (v[:2] / knot.LINEAR_BEYOND) ** 2)
        terms = [(knot.VELOCITY[0], v[:2] * ca.sqrt(2.0 / (1.0 + beyond_v))), (knot.JOINT_VELOCITY, s_dot)]
        terms += [(knot.VELOCITY[2], v[2] + law["setpoint"]["descent_speed"]), (knot.POSTURE, s - posture)]
        terms += [(knot.LEAN, here[1][:, 2] - ca.DM([0.0, 0.0, 1.0])), (knot.ANGULAR_VELOCITY, omega)]
        terms = [(h * weight, of) for weight, of in [*terms, (knot.THRUST_RATE, rate), (knot.ENGINE_INPUT, part - 0.5)]]
        terms += [(law["mpc"]["thrust_excess"] * works, thrust - ca.fmin(ca.fmax(thrust, idle), full))]
        terms += [(knot.JOINT_EXCESS, s - ca.fmin(ca.fmax(s, lower), upper))]
        terms += [(knot.CLEARANCE, ca.fmin(apart - LEAST_DISTANCE, 0.0))]
        residual = ca.vertcat(*(ca.sqrt(weight) * of for weight, of in terms))
        cost, slopes, by = 0.5 * ca.sumsqr(residual), ca.jacobian(moved, w), ca.jacobian(residual, w)
        hessian = ca.triu(by.T @ by + DAMPING * ca.SX.eye(scale.size))
        outputs = {"step": moved, "cost": cost, "slopes": slopes, "hessian": hessian}
        self.of = {name: ca.Function(name, [w, p, h], [ca.densify(output)]) for name, output in outputs.items()}

    def cost(self, x: Any, p: Any, inputs: Any) -> float:
        """Return that of inputs from a state on."""
        cost = 0.0
        for u, h in zip([*inputs, 0.0 * inputs[0]], [*KNOTS[: len(inputs)], TAIL], strict=True):
            w = np.append(x, u)
            cost, x = cost + float(self.of["cost"](w, p, h)), self.of["step"](w, p, h).full()[:, 0]
        return cost

    def least(self, start: Any, given: Any, knots: int) -> float:
        """Return the cost that IPOPT finds; it begins with a robot that stays where it is."""
        size, h, n = self.scale.size, ca.DM([*KNOTS[:knots], TAIL]).T, self.n
        x, p, factor = ca.MX.sym("x", size * (knots + 1)), ca.MX.sym("p", given.size), ca.MX.sym("factor")
        w, multipliers = ca.reshape(x, size, knots + 1), ca.MX.sym("multipliers", n * knots)

        def blocks(name: str, count: int) -> Any:
            found = self.of[name].map(count)(w[:, :count], ca.repmat(p, 1, count), h[:count])
            return ca.horzsplit(found, found.shape[1] // count)

        ends, f = ca.vec(w[:n, 1:]), sum(blocks("cost", knots + 1))
        g = ends - ca.vertcat(*blocks("step", knots))
        slopes = ca.jacobian(ends, x) - ca.horzcat(ca.diagcat(*blocks("slopes", knots)), ca.MX(n * knots, size))
        hessian = factor * ca.triu(ca.diagcat(*blocks("hessian", knots + 1)))
        of_hessian = [x, p, factor, multipliers], [hessian], ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        own = {"hess_lag": ca.Function("nlp_hess_l", *of_hessian)}
        own["jac_g"] = ca.Function("nlp_jac_g", [x, p], [g, slopes], ["x", "p"], ["g", "jac_g_x"])
        solver = ca.nlpsol("plan", "ipopt", {"x": x, "p": p, "f": f, "g": g}, SEARCH | own)
        works, fast = given[-len(self.robot.jets) :], np.full(len(self.joints), np.radians(150.0))  # limit in descents
        guess = np.tile(np.concatenate([start, 0.6 * works, 0.0 * fast]), (knots + 1, 1))
        least, most = np.full(guess.shape, -np.inf), np.full(guess.shape, np.inf)
        least[:, n:], most[:, n:] = np.append(0.0 * works, -fast), np.append(works, fast)
        least[0, :n], most[0, :n], least[-1, n:], most[-1, n:] = start, start, 0.0, 0.0
        found = solver(x0=guess.ravel(), p=given, lbx=least.ravel(), ubx=most.ravel(), lbg=0.0, ubg=0.0)
        assert solver.stats()["success"], solver.stats()["return_status"]
        return float(found["f"])


@pytest.mark.parametrize("name", LOSSES)
def test_no_plan_costs_much_more_than_the_optimum(name):
    """It costs what CasADi makes of its inputs, and a second after an engine stops not much more than IPOPT's."""
    plans = {"controller.mpc.nonlinear_descent": True}
    of = Problem(rust.load_config(name, plans))
    for stopped, time, most in LOSSES[name]:
        failure = {"disturbances.jets.failure": {"jet": stopped, "time": time, "kind": "off"}}
        config = rust.load_config(name, plans | failure | {"simulator.duration": time + 2.0})
        flight, end = rust.Flight(config), (time + 1.0) / config["controller"]["time_step"]
        while flight.tick <= end or "plan_kept" in flight.last.degraded_modes:
            flight.step()
        (cost, inputs), now, known = flight.controller_state.descent_plan(), flight.last, flight.last.estimates
        q, turn = np.asarray(known.state.joint_position), Rotation.from_matrix(known.state.base_rotation)
        momentum = now.momentum[:3] / of.robot.mass, turn.as_quat(scalar_first=True), now.momentum[3:]
        start = np.concatenate([now.com_position[2:], *momentum, known.thrust, known.thrust_rate, q[of.joints]])
        works = [jet.name != stopped for jet in of.robot.jets]
        given = np.concatenate([q, now.posture[of.joints], known.wind, now.unmodelled_wrench, works])
        start, inputs = start / of.scale[: of.n], inputs.reshape(-1, of.scale.size - of.n)
        places = inputs[:, : len(works)]
        assert not places[:, np.logical_not(works)].any()
        assert np.any(places[:, works] == 1.0)
        assert of.cost(start, given, inputs) == pytest.approx(cost, rel=1e-6)
        assert cost <= most * of.least(start, given, len(inputs))

"""A knot of a descent's plan in JAX, written once: motion and cost, as M178 of `docs/model` has them.

Derivatives are JAX's. Changes of a state are vectors δ = (z, v, θ, k, T, Ṫ, s) with `R ← exp(θ) R`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jax_aero.aero import LinkConventions, aero_model
from jax_aero.aero.link_forces import link_forces, wrench_about
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.dynamics import dynamics
from jax_aero.body.jets import acceleration_range, engines
from jax_aero.body.kinematics import kinematics
from jax_aero.body.robot import load_robot
from jax_aero.body.spatial import cross, exp_so3, multiply, skew
from jax_aero.control.law.momentum import thrust_map
from jax_aero.control.mpc.clearance import LEAST_DISTANCE, clearance_params, distances
from jax_aero.types import State

VELOCITY, LINEAR_BEYOND, LEAN, ANGULAR_VELOCITY = (80.0, 80.0, 300.0), 0.25, 400.0, 5.0
POSTURE, JOINT_VELOCITY, THRUST_RATE, ENGINE_INPUT = 0.05, 1.0, 1e-6, 0.01
CLEARANCE, JOINT_EXCESS = 300.0, 1e3


class Knot(NamedTuple):
    """State at a knot."""

    height: Any
    velocity: Any
    rotation: Any
    momentum: Any
    thrust: Any
    rate: Any
    joints: Any


class World:
    """What is constant along a plan, in still joints that are not planned."""

    def __init__(self, config: Any, posture: Any, wind: Any, speed: float) -> None:
        typed = scenario_config(config)
        self.robot = robot = load_robot(typed.robot)
        self.mpc = mpc = typed.controller.mpc
        numbers = dict(robot.joint_groups)
        self.joints = tuple(sorted({joint for name in mpc.joint_groups for joint in numbers[name]}))
        self.aero = aero_model(typed.controller.aero, robot)
        self.engines = engines(robot, robot.jets.engines)
        self.clearance = clearance_params(mpc.clearance, robot)
        self.posture, self.wind, self.speed, self.mass = jnp.asarray(posture), jnp.asarray(wind), speed, robot.mass
        self.jets = robot.jets.count

    def _moving(self, x: Knot, u: Any) -> tuple[Any, Any, Any]:
        """Return kinematics in the motion that has this momentum, and the angular velocity of the base."""
        at, robot = np.array(self.joints), self.robot
        n = robot.n_joints
        speeds = jnp.zeros(n).at[at].set(u[self.jets :])
        still = State(jnp.zeros(3), x.rotation, self.posture.at[at].set(x.joints), jnp.pad(speeds, (6, 0)))
        kin = kinematics(robot, still)
        dyn = dynamics(robot, still, kin)
        omega = jnp.linalg.solve(dyn.centroidal_inertia, x.momentum - dyn.momentum[3:])
        base = x.velocity - dyn.momentum[:3] / self.mass - cross(omega, kin.com)
        return kinematics(robot, still._replace(velocity=jnp.concatenate([base, omega, speeds]))), omega, still

    def rates(self, x: Knot, u: Any) -> Any:
        """Return ẋ as a change of the state."""
        kin, omega, _ = self._moving(x, u)
        rate = thrust_map(self.robot, kin)[2] @ x.thrust
        if self.mpc.air == "linear":
            rate = rate + wrench_about(link_forces(self.aero, self.robot, kin, LinkConventions(), self.wind), kin.com)
        rate = rate.at[2].add(-self.mass * self.robot.gravity)
        least, greatest = acceleration_range(self.engines, x.thrust, x.rate)
        acceleration = least + u[: self.jets] * (greatest - least)
        return jnp.concatenate(
            [x.velocity[2:], rate[:3] / self.mass, omega, rate[3:], x.rate, acceleration, u[self.jets :]]
        )

    def move(self, x: Knot, change: Any) -> Knot:
        """Return a state changed."""
        j = self.jets
        z, v, theta, k, thrust, rate, joints = jnp.split(change, np.cumsum([1, 3, 3, 3, j, j]))
        return Knot(
            x.height + z[0],
            x.velocity + v,
            multiply(exp_so3(theta), x.rotation),
            x.momentum + k,
            x.thrust + thrust,
            x.rate + rate,
            x.joints + joints,
        )

    def step(self, x: Knot, u: Any, h: float) -> tuple[Any, Any]:
        """Return the change over a knot, `h ẋ + h²/2 F ẋ`, and `(A B) = (1 0) + h (F G) + h²/2 F (F G)`."""
        rest = jnp.zeros(10 + 2 * self.jets + len(self.joints))
        x_dot = self.rates(x, u)
        by_x, by_u = jax.jacfwd(lambda change, u: self.rates(self.move(x, change), u), (0, 1))(rest, u)
        # Of two rotations that differ by θ, which turn by ω and ω': θ̇ = ω' − ω + ω × θ.
        by_x = by_x.at[4:7, 4:7].add(skew(x_dot[4:7]))
        both = jnp.concatenate([by_x, by_u], axis=1)
        moved = h * x_dot + 0.5 * h**2 * by_x @ x_dot
        return moved, jnp.eye(*both.shape) + h * both + 0.5 * h**2 * by_x @ both

    def residuals(self, x: Knot, u: Any, duration: float) -> tuple[Any, Any]:
        """Return weights and residuals of the cost `½ Σ w r²`, without the horizontal velocity."""
        _, omega, still = self._moving(x, u)
        lower, upper = jnp.asarray(self.robot.joint_limits)[np.array(self.joints)].T
        jets = self.robot.jets
        apart = distances(self.robot, self.clearance, self.joints, still.joint_position)[0]
        terms = [
            (duration * VELOCITY[2], x.velocity[2:] + self.speed),
            (duration * LEAN, x.rotation[:, 2] - jnp.array([0.0, 0.0, 1.0])),
            (duration * ANGULAR_VELOCITY, omega),
            (duration * THRUST_RATE, x.rate),
            (duration * ENGINE_INPUT, u[: self.jets] - 0.5),
            (self.mpc.thrust_excess, x.thrust - jnp.clip(x.thrust, jets.thrust_min, jets.thrust_max)),
            (duration * POSTURE, x.joints - self.posture[np.array(self.joints)]),
            (JOINT_EXCESS, x.joints - jnp.clip(x.joints, lower, upper)),
            (duration * JOINT_VELOCITY, u[self.jets :]),
            (CLEARANCE, jnp.minimum(apart - LEAST_DISTANCE, 0.0)),
        ]
        weights = jnp.concatenate([jnp.full(residual.shape, weight) for weight, residual in terms])
        return weights, jnp.concatenate([residual for _, residual in terms])

    def cost(self, x: Knot, u: Any, duration: float) -> tuple[Any, Any, Any]:
        """Return cost, gradient and Hessian by state and inputs: of squares that of Gauss and Newton."""
        rest, n = jnp.zeros(10 + 2 * self.jets + len(self.joints)), u.size

        def both(change: Any) -> Any:
            return self.residuals(self.move(x, change[:-n]), u + change[-n:], duration)

        def slow(v: Any) -> Any:
            return jnp.sum(duration * jnp.array(VELOCITY[:2]) * LINEAR_BEYOND**2 * (self._root(v) - 1.0))

        at = jnp.pad(rest, (0, n))
        weights, residual = both(at)
        slopes = jax.jacfwd(lambda change: both(change)[1])(at)
        horizontal = x.velocity[:2]
        gradient = (slopes.T @ (weights * residual)).at[1:3].add(jax.grad(slow)(horizontal))
        curvature = duration * jnp.array(VELOCITY[:2]) / self._root(horizontal)
        hessian = (slopes.T * weights) @ slopes + jnp.diag(jnp.zeros(at.size).at[1:3].set(curvature))
        return 0.5 * jnp.sum(weights * residual**2) + slow(horizontal), gradient, hessian

    def _root(self, v: Any) -> Any:
        return jnp.sqrt(1.0 + v**2 / LINEAR_BEYOND**2)

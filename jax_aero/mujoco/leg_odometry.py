"""State of a standing robot from its joints and its stationary soles: M113 of `docs/model`.

This is how the paper's robot estimates its state on the ground: the pose of the base from one sole, its velocity from
all soles, and joint velocities through a low pass.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from typing import Any

import mujoco  # type: ignore[import-untyped]
import numpy as np
from jaxtyping import Float

from jax_aero import rust
from jax_aero.body.mujoco_model import Order, mujoco_spec, order_of

DAMPING = 1e-7
"""Damping of the pseudo-inverse, as published."""


class LegOdometry:
    """Odometry of one robot from its legs.

    Parameters
    ----------
    model, order
        MuJoCo's model of the robot, and the indices of our joints in it.
    soles
        Sites of the stationary soles, starting with the one that determines the base pose.
    first
        Initial state, which is taken as measured.
    share
        Share of a change that the low pass of the joint velocities follows per tick, `1 − exp(−Δt/τ)`.
    """

    def __init__(self, model: Any, order: Order, soles: list[int], first: rust.State, share: float) -> None:
        self._model, self._order, self._soles, self._share = model, order, soles, share
        self._data = mujoco.MjData(model)
        position, rotation, joints, velocity = (np.asarray(part) for part in first)
        self._velocity = velocity[6:].copy()
        self._evaluate(joints)
        sole_rotation_b, sole_position_b = self._sole()
        self._rotation = rotation @ sole_rotation_b
        self._position = position + rotation @ sole_position_b

    @classmethod
    def on_first_sole(cls, source: str, feet: Sequence[str]) -> LegOdometry:
        """Return the odometry of a robot, given by its file, in the axes of its first foot, without a low pass."""
        robot, spec = rust.Robot(source), mujoco_spec(source)
        frames = {foot["name"]: foot["frame"] for foot in tomllib.loads(robot.toml_text)["feet"]}
        for name in feet:
            spec.body(frames[name]).add_site(name=name)
        model, names = spec.compile(), tuple(robot.joint_names)
        n = len(names)
        at_zero = rust.State(np.zeros(3), np.eye(3), np.zeros(n), np.zeros(6 + n))
        odometry = cls(model, order_of(source, names), [model.site(name).id for name in feet], at_zero, share=1.0)
        odometry._position, odometry._rotation = np.zeros(3), np.eye(3)
        return odometry

    def measure(self, truth: rust.State) -> rust.State:
        """Return the state estimated from joints and soles; call once per tick. Only the joints of `truth` are used."""
        joints, rates = np.asarray(truth.joint_position), np.asarray(truth.velocity)[6:]
        self._evaluate(joints)
        sole_rotation_b, sole_position_b = self._sole()
        rotation = self._rotation @ sole_rotation_b.T
        jacobian = np.vstack([self._jacobian(sole) for sole in self._soles])
        of_base, of_joints = jacobian[:, :6], jacobian[:, 6:]
        normal = of_base.T @ of_base + DAMPING * np.eye(6)
        velocity_b = -np.linalg.solve(normal, of_base.T @ (of_joints @ rates))
        self._velocity += self._share * (rates - self._velocity)
        velocity = np.concatenate([rotation @ velocity_b[:3], rotation @ velocity_b[3:], self._velocity])
        return rust.State(self._position - rotation @ sole_position_b, rotation, joints, velocity)

    def _evaluate(self, joint_position: Float[np.ndarray, " n"]) -> None:
        """Evaluate MuJoCo's kinematics at joint positions [rad], with the base at the origin."""
        self._data.qpos[:] = 0.0
        self._data.qpos[3] = 1.0
        self._data.qpos[self._order.joints] = joint_position
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)  # for Jacobians

    def _sole(self) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
        """Return rotation and position [m] of the first sole, base axes."""
        site = self._soles[0]
        return self._data.site_xmat[site].reshape(3, 3).copy(), self._data.site_xpos[site].copy()

    def _jacobian(self, sole: int) -> Float[np.ndarray, "6 N"]:
        """Return the Jacobian of a sole's velocity with respect to (ν_B, ṡ), base axes."""
        rows = np.zeros((6, self._model.nv))
        mujoco.mj_jacSite(self._model, self._data, rows[:3], rows[3:], sole)
        return rows[:, self._order.dofs]

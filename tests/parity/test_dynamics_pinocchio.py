"""Rigid-body dynamics against Pinocchio, which reads the same URDF.

Pinocchio's velocity of a free base is in base axes, v = (Rᵀ v_B, Rᵀ ω_B, ṡ). With ν = X v, X = blkdiag(R, R, 1):

    M_pin = Xᵀ M X,    A_pin = A X,    J_pin = J X
    h_pin = Xᵀ (h + M Ẋ v),    Ẋ v = (ω_B × v_B, 0, 0)

The axes turn with the base, so unlike MuJoCo's its bias holds the acceleration of the map.
"""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from jax_aero import rust
from jax_aero.rust import Robot

TOLERANCE = 1e-10
LOCKED = {"sparrow": {"neck": 0.2}, "slider": {"hatch_rail": 0.04}}


class Oracle:
    """A Pinocchio model of the URDF with a free base, in our order of joints."""

    def __init__(self, urdf: Path, robot: Robot, locked: dict[str, float]) -> None:
        model = pin.buildModelFromUrdf(str(urdf), pin.JointModelFreeFlyer())
        if locked:
            q = pin.neutral(model)
            for name, angle in locked.items():
                q[model.joints[model.getJointId(name)].idx_q] = angle
            model = pin.buildReducedModel(model, [model.getJointId(name) for name in locked], q)
        model.gravity.linear = np.array([0, 0, -robot.gravity])
        self.model, self.data = model, model.createData()
        self.bodies = [model.getFrameId(name, pin.FrameType.BODY) for name in robot.body_names]
        self.joints = [model.joints[model.getJointId(name)] for name in robot.joint_names]
        self.v = np.array([*range(6), *(joint.idx_v for joint in self.joints)])
        assert model.nv == len(self.v)

    def set(self, state: rust.State, wxyz: np.ndarray) -> None:
        rotation, velocity = np.asarray(state.base_rotation), np.asarray(state.velocity)
        self.x = np.eye(self.model.nv)
        self.x[:3, :3] = self.x[3:6, 3:6] = rotation
        # (position, quaternion xyzw, joints); a joint without limits has cosine and sine.
        self.q = np.zeros(self.model.nq)
        self.q[:7] = [*np.asarray(state.base_position), *wxyz[1:], wxyz[0]]
        for joint, angle in zip(self.joints, np.asarray(state.joint_position), strict=True):
            self.q[joint.idx_q : joint.idx_q + joint.nq] = [angle] if joint.nq == 1 else [np.cos(angle), np.sin(angle)]
        self.velocity = np.zeros(self.model.nv)
        self.velocity[self.v] = self.x.T @ velocity
        self.map_acceleration = np.zeros(self.model.nv)
        self.map_acceleration[:3] = np.cross(velocity[3:6], velocity[:3])

    def mixed(self, columns: np.ndarray) -> np.ndarray:
        """A Jacobian in our velocity and order: J = J_pin X⁻¹."""
        return columns[:, self.v] @ self.x.T

    def kinematics(self) -> dict[str, np.ndarray]:
        pin.framesForwardKinematics(self.model, self.data, self.q)
        poses = [self.data.oMf[body] for body in self.bodies]
        com = pin.centerOfMass(self.model, self.data, self.q)
        matrix = self.mixed(pin.ccrba(self.model, self.data, self.q, self.velocity))
        return {
            "body_positions": np.array([pose.translation for pose in poses]),
            "body_rotations": np.array([pose.rotation for pose in poses]),
            "com_position": com,
            "momentum_matrix": matrix,
            "momentum": self.data.hg.vector,
            "centroidal_inertia": self.data.Ig.inertia,
        }

    def mass_matrix(self) -> np.ndarray:
        upper = np.triu(pin.crba(self.model, self.data, self.q))
        full = upper + np.triu(upper, 1).T
        return self.x @ full[np.ix_(self.v, self.v)] @ self.x.T

    def bias(self) -> np.ndarray:
        theirs = pin.nonLinearEffects(self.model, self.data, self.q, self.velocity)[self.v]
        return self.x @ theirs - self.mass_matrix() @ self.map_acceleration

    def forward_dynamics(self, force: np.ndarray) -> np.ndarray:
        generalised = np.zeros(self.model.nv)
        generalised[self.v] = self.x.T @ force
        theirs = pin.aba(self.model, self.data, self.q, self.velocity, generalised)
        return self.x @ theirs[self.v] + self.map_acceleration


@pytest.fixture
def oracle(robot_name, robot, urdf) -> Oracle:
    return Oracle(urdf, robot, LOCKED.get(robot_name, {}))


def test_the_whole_state_agrees(oracle, agree_with_dynamics):
    agree_with_dynamics(oracle, TOLERANCE)

"""Rigid-body dynamics against MuJoCo C, which reads the same URDF.

MuJoCo's velocity of a free joint is linear in inertial axes but angular in base axes, v = (v_B, Rᵀ ω_B, ṡ). With
ν = X v and X = blkdiag(1, R, 1):

    M_mujoco = Xᵀ M X,    A_mujoco = A X,    J_mujoco = J X
    h_mujoco = Xᵀ (h + M Ẋ v),    ν̇ = X v̇ + Ẋ v,    Ẋ v = (0, R (w × w), 0) = 0,   w = Rᵀ ω_B

so the acceleration of the map vanishes: biases differ by the rotation of their three base moments alone.
"""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.base.places import CONFIGS
from jax_aero.body.mujoco_model import mujoco_model
from jax_aero.rust import Robot

TOLERANCE = 1e-10
LOCKED = {"sparrow": {"neck": ((0, 1, 0), 0.2)}, "slider": {"hatch_rail": ((0, 0, 1), 0.04)}}


class Oracle:
    """A MuJoCo model of the URDF with a free base, in our order of joints."""

    def __init__(self, urdf: Path, robot: Robot, locked: dict[str, tuple[tuple[float, ...], float]]) -> None:
        spec = mujoco.MjSpec.from_file(str(urdf))
        spec.compiler.fusestatic = False  # frames stay bodies, and the base is not welded to the world
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
        spec.option.gravity = [0, 0, -robot.gravity]
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_SPRING
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_DAMPER
        spec.worldbody.first_body().add_freejoint()
        for joint in spec.joints:
            joint.armature = joint.frictionloss = 0.0
        for name, (axis, angle) in locked.items():
            joint = spec.joint(name)
            assert np.allclose(joint.axis, axis)
            body, turn, quat = joint.parent, np.zeros(4), np.zeros(4)
            if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
                assert np.allclose(body.quat, [1, 0, 0, 0])
                body.pos = body.pos + angle * np.array(axis)
            else:
                mujoco.mju_axisAngle2Quat(turn, np.array(axis, float), angle)
                mujoco.mju_mulQuat(quat, body.quat, turn)
                body.quat = quat
            spec.delete(joint)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.bodies = [self.model.body(name).id for name in robot.body_names]
        joints = [self.model.joint(name) for name in robot.joint_names]
        self.q = np.array([joint.qposadr[0] for joint in joints])
        self.v = np.array([*range(6), *(joint.dofadr[0] for joint in joints)])
        assert self.model.nv == len(self.v)

    def set(self, state: rust.State, wxyz: np.ndarray) -> None:
        rotation = np.asarray(state.base_rotation)
        self.x = np.eye(self.model.nv)
        self.x[3:6, 3:6] = rotation
        self.data.qpos[:7] = [*np.asarray(state.base_position), *wxyz]
        self.data.qpos[self.q] = state.joint_position
        self.data.qvel[self.v] = self.x.T @ np.asarray(state.velocity)
        mujoco.mj_forward(self.model, self.data)

    def mixed(self, columns: np.ndarray) -> np.ndarray:
        """A Jacobian in our velocity and order: J = J_mujoco X⁻¹."""
        return columns[:, self.v] @ self.x.T

    def mass_matrix(self) -> np.ndarray:
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, full)
        return self.x @ full[np.ix_(self.v, self.v)] @ self.x.T

    def bias(self) -> np.ndarray:
        return self.x @ self.data.qfrc_bias[self.v]

    def momentum_matrix(self) -> np.ndarray:
        linear, angular = np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
        mujoco.mj_jacSubtreeCom(self.model, self.data, linear, 1)
        mujoco.mj_angmomMat(self.model, self.data, angular, 1)
        return self.mixed(np.vstack([self.model.body_subtreemass[1] * linear, angular]))

    def momentum(self) -> np.ndarray:
        mujoco.mj_subtreeVel(self.model, self.data)
        return np.concatenate(
            [self.model.body_subtreemass[1] * self.data.subtree_linvel[1], self.data.subtree_angmom[1]]
        )

    def kinematics(self) -> dict[str, np.ndarray]:
        matrix = self.momentum_matrix()
        return {
            "body_positions": self.data.xpos[self.bodies],
            "body_rotations": self.data.xmat[self.bodies].reshape(-1, 3, 3),
            "com_position": self.data.subtree_com[1],
            "momentum_matrix": matrix,
            "momentum": self.momentum(),
            "centroidal_inertia": matrix[3:, 3:6],
        }

    def jacobian(self, body: str) -> tuple[np.ndarray, np.ndarray]:
        linear, angular = np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
        mujoco.mj_jacBody(self.model, self.data, linear, angular, self.model.body(body).id)
        return self.mixed(linear), self.mixed(angular)

    def forward_dynamics(self, force: np.ndarray) -> np.ndarray:
        self.data.qfrc_applied[self.v] = self.x.T @ force
        mujoco.mj_forward(self.model, self.data)
        self.data.qfrc_applied[:] = 0
        return self.x @ self.data.qacc[self.v]


@pytest.fixture
def oracle(robot_name, robot, urdf) -> Oracle:
    return Oracle(urdf, robot, LOCKED.get(robot_name, {}))


def test_the_whole_state_agrees(robot, oracle, agree, agree_with_dynamics):
    agree("mass of the robot", robot.mass, oracle.model.body_subtreemass[1], 1e-14)
    agree_with_dynamics(oracle, TOLERANCE)


def test_every_frame_jacobian_agrees(robot, oracle, random_states, agree):
    frames = [oracle.model.body(i).name for i in range(1, oracle.model.nbody)]
    known = {*robot.body_names, *robot.aero_link_names}
    frames = [frame for frame in frames if frame in known or frame.endswith("sole")]
    assert len(frames) >= len(robot.body_names)
    for state, wxyz in random_states:
        oracle.set(state, wxyz)
        for frame in frames:
            ours, (linear, angular) = rust.frame_jacobian(robot, frame, state), oracle.jacobian(frame)
            agree("frame Jacobians, linear", ours.linear, linear, TOLERANCE)
            agree("frame Jacobians, angular", ours.angular, angular, TOLERANCE)


def test_what_is_kept_of_a_robot_follows_its_files(tmp_path):
    """As in a notebook, in which its files change between two calls."""
    for name in ("sparrow.toml", "sparrow.urdf"):
        (tmp_path / name).write_text((CONFIGS / "robot" / name).read_text())
    source = str(tmp_path / "sparrow.toml")
    before = mujoco_model(source)
    assert mujoco_model(source) is before
    urdf = tmp_path / "sparrow.urdf"
    urdf.write_text(urdf.read_text().replace('<mass value="2.5"/>', '<mass value="3.5"/>'))
    assert mujoco_model(source).body_mass.sum() == pytest.approx(before.body_mass.sum() + 1.0)

"""A robot on the ground: its bodies, drives and contacts in MuJoCo, a world of `rust.Flight`.

```text
observe   state, foot wrenches and joint torques of MuJoCo at x_k
advance   sub-steps of MuJoCo to x_{k+1} under held torques and the held force of jets, air and pushes
```

The crate does not simulate ground contact; this backend does. A foot has contact at the corners of its sole, small
spheres whose lowest points are those in the robot's file. Joints have stops unless the configuration disables them.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco  # type: ignore[import-untyped]
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.body.mujoco_model import mujoco_spec, order_of
from jax_aero.mujoco.leg_odometry import LegOdometry

Array = NDArray[np.float64]

CORNER_RADIUS = 0.005
"""Radius of the spheres at the corners of a sole [m]."""
HOLD_STIFFNESS, HOLD_DAMPING = 4000.0, 60.0
"""Stiffness and damping of the joints while the robot is put down [N m/rad, N m s/rad]."""
SETTLING = 1.0
"""Time for which these joints hold the initial posture before the controller starts at time zero [s]."""
CONTACT_TIME = 0.01
"""Time in which a touching corner comes to rest [s]; longer is softer."""
SIDE = (100.0, 100.0, 1.0)
"""Half lengths of the box that is the higher side of a step [m]."""


class GroundPlant:
    """The standing robot, simulated by MuJoCo.

    Parameters
    ----------
    config
        A resolved configuration with `simulator.ground`.

    Raises
    ------
    ValueError
        If the robot does not come to rest where it is put down.
    """

    def __init__(self, config: Mapping[str, Any]) -> None:
        self.source: str = config["robot"]
        self.robot = rust.Robot(self.source)
        table = tomllib.loads(self.robot.toml_text)
        simulator = config["simulator"]
        self.model = _model(self.source, self.robot, table.get("feet", []), config)
        self.data = mujoco.MjData(self.model)
        self._order = order_of(self.source, tuple(self.robot.joint_names))
        feet = self.robot.foot_names
        self._soles = [self.model.site(f"foot_{foot}").id for foot in feet]
        self._foot_of_geom = {
            self.model.geom(f"{foot['name']}_{corner}").id: index
            for index, foot in enumerate(table.get("feet", []))
            for corner in range(len(foot["vertices"]))
        }
        self._stand(simulator["initial"], simulator["ground"])
        motors = simulator.get("motors", {})
        shares = [motors.get("load_friction", {}).get(joint, 0.0) for joint in self.robot.joint_names]
        self._load_friction = np.array(shares) if any(shares) else None
        lag = motors.get("time_constant", 0.0)
        self._kept = np.exp(-self.model.opt.timestep / lag) if lag > 0.0 else 0.0
        self._friction = self.model.dof_frictionloss[self._order.dofs[6:]].copy()
        self._odometry: LegOdometry | None = None
        if settings := simulator["ground"].get("leg_odometry"):
            soles = [self._soles[feet.index(name)] for name in config["controller"]["contact"]["feet"]]
            time_constant = settings["velocity_time_constant"]
            share = -np.expm1(-config["controller"]["time_step"] / time_constant) if time_constant > 0.0 else 1.0
            self._odometry = LegOdometry(self.model, self._order, soles, self._state(), share)

    def _state(self) -> rust.State:
        """Return the state in the plant's arrays, after `mj_forward`."""
        data, order = self.data, self._order
        rotation = data.xmat[order.bodies[0]].reshape(3, 3).copy()
        nu = data.qvel[order.dofs]
        nu[3:6] = rotation @ nu[3:6]  # MuJoCo's angular part is in body axes
        return rust.State(data.qpos[:3].copy(), rotation, data.qpos[order.joints], nu)

    def _stand(self, initial: Mapping[str, Any], ground: Mapping[str, Any]) -> None:
        """Put the robot down with stiff joints, on a slope leaning with it; it is then at rest except for rounding."""
        qpos, model = self.data.qpos, self.model
        qpos[:3] = initial["base_position"]
        mujoco.mju_euler2Quat(qpos[3:7], np.radians(initial["base_rpy_deg"]), "XYZ")
        if "slope_deg" in ground:
            turn, rotation = _slope(ground)
            qpos[:3] = rotation @ qpos[:3]
            mujoco.mju_mulQuat(qpos[3:7], turn, qpos[3:7].copy())
        qpos[self._order.joints] = initial["joint_position"]
        model.jnt_stiffness[1:] = HOLD_STIFFNESS
        model.qpos_spring[:] = qpos
        own_damping = model.dof_damping.copy()
        model.dof_damping[6:] = HOLD_DAMPING
        for _ in range(round(SETTLING / model.opt.timestep)):
            mujoco.mj_step(model, self.data)
        held = self.data.qfrc_passive[self._order.dofs[6:]].copy()  # for the first measurement
        model.jnt_stiffness[:] = 0.0
        model.dof_damping[:] = own_damping
        self.data.time = 0.0
        self.data.ctrl[:] = held
        mujoco.mj_forward(model, self.data)
        if not self.is_sound:
            raise ValueError("`simulator.initial` puts the robot where it cannot come to rest: its state is not finite")

    def observe(self) -> rust.Seen:
        """Return what is seen at this moment."""
        data = self.data
        if is_sound := self.is_sound:
            mujoco.mj_forward(self.model, data)
        state = self._state()
        return rust.Seen(
            state=state,
            measured=self._odometry.measure(state) if self._odometry is not None and is_sound else state,
            foot_wrenches=self._foot_wrenches(),
            joint_torque=self._load(),
            soles=data.site_xpos[self._soles].copy(),
        )

    @property
    def is_sound(self) -> bool:
        """Whether every number of the state is finite."""
        return bool(np.isfinite(self.data.qpos).all() and np.isfinite(self.data.qvel).all())

    def advance(self, torque: Float[np.ndarray, "steps n"], force: Float[np.ndarray, " N"]) -> None:
        """Advance by one sub-step under each row of torques [N m], and this force throughout; see `rust.World`."""
        data, order = self.data, self._order
        if self._load_friction is not None:  # as in M153, with the load of the last tick
            self.model.dof_frictionloss[order.dofs[6:]] = self._friction + self._load_friction * np.abs(self._load())
        rotation = data.xmat[order.bodies[0]].reshape(3, 3)
        data.qfrc_applied[order.dofs] = np.concatenate([force[:3], rotation.T @ force[3:6], force[6:]])
        is_held = self._kept == 0.0 and (torque == torque[0]).all()
        for row in torque[:1] if is_held else torque:
            data.ctrl[:] = row + self._kept * (data.ctrl - row)  # the lag of M153
            mujoco.mj_step(self.model, data, len(torque) if is_held else 1)

    def _foot_wrenches(self) -> Array:
        data = self.data
        wrenches, count = np.zeros((len(self._soles), 6)), data.ncon
        if count == 0:
            return wrenches
        local = np.zeros((count, 6))
        for index in range(count):
            mujoco.mj_contactForce(self.model, data, index, local[index])
        contact = data.contact
        # The force is that on the second geometry; MuJoCo has planes before spheres and these before boxes.
        feet, signs = np.zeros(count, int), np.ones((count, 1))
        for index, (first, second) in enumerate(zip(contact.geom1.tolist(), contact.geom2.tolist(), strict=True)):
            is_second = second in self._foot_of_geom
            feet[index] = self._foot_of_geom[second if is_second else first]
            signs[index] = 1.0 if is_second else -1.0
        # The rows of a contact's frame are its axes; a corner in contact carries no moment.
        force = signs * (contact.frame.reshape(-1, 3, 3) * local[:, :3, None]).sum(axis=1)
        arm = contact.pos - data.site_xpos[self._soles][feet]
        np.add.at(wrenches, feet, np.hstack([force, np.cross(arm, force)]))
        return wrenches

    def _load(self) -> Array:
        """Return the torques that reach the joints [N m]; MuJoCo treats dry friction as a constraint."""
        data, friction = self.data, np.zeros(self.model.nv)
        rows = np.flatnonzero(data.efc_type[: data.nefc] == mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF)
        friction[data.efc_id[rows]] = data.efc_force[rows]
        return np.asarray((data.qfrc_actuator + data.qfrc_passive + friction)[self._order.dofs[6:]])


def _model(source: str, robot: rust.Robot, feet: Sequence[Mapping[str, Any]], config: Mapping[str, Any]) -> Any:
    """Return MuJoCo's model of the robot on a plane, with `feet` as in its file and motors as configured."""
    simulator = config["simulator"]
    ground, motors = simulator["ground"], simulator.get("motors", {})
    spec = mujoco_spec(source)
    option = spec.option
    # Without automatic reset, so that a diverging run ends instead of restarting.
    option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    if not simulator["joint_stops"]:
        option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    option.timestep = config["controller"]["time_step"] / simulator["substeps"]
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 100.0  # reduces creep along the ground
    option.tolerance = 1e-10
    contact = {
        "friction": [ground["friction"], 0.005, 0.0001],
        "solref": [CONTACT_TIME, 1.0],
        "solimp": [0.95, 0.99, 0.001, 0.5, 2.0],
    }
    _add_ground(spec, ground, contact)
    for foot in feet:
        body = spec.body(foot["frame"])
        body.add_site(name=f"foot_{foot['name']}")
        for corner, vertex in enumerate(foot["vertices"]):
            body.add_geom(
                name=f"{foot['name']}_{corner}",
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                size=[CORNER_RADIUS, 0.0, 0.0],
                pos=np.add(vertex, [0.0, 0.0, CORNER_RADIUS]),
                mass=0.0,
                contype=1,
                conaffinity=0,
                condim=3,
                **contact,
            )
    model = spec.compile()
    for joint, (lower, upper) in zip(robot.joint_names, robot.joint_stops, strict=True):
        model.joint(joint).range[:] = lower, upper
        model.jnt_limited[model.joint(joint).id] = np.isfinite(upper - lower)
    model.dof_frictionloss[6:] = motors.get("friction", 0.0)
    for joint, friction in motors.get("friction_of", {}).items():
        model.joint(joint).frictionloss[:] = friction
    # Dry friction is a soft constraint in MuJoCo, softened by the inertia of the limb alone. With default parameters,
    # an ankle that carries the robot creeps at degrees per second below its breakaway torque.
    model.dof_solref[6:] = [2.0 * option.timestep, 1.0]
    model.dof_solimp[6:] = [0.9999, 0.9999, 0.001, 0.5, 2.0]
    model.dof_damping[6:] = motors.get("damping", 0.0)
    model.dof_armature[6:] = motors.get("inertia", 0.0)
    return model


def _slope(ground: Mapping[str, Any]) -> tuple[Array, Array]:
    """Return the ground's rotation from level, as a quaternion and as a matrix (3, 3)."""
    turn, rotation = np.zeros(4), np.zeros(9)
    mujoco.mju_euler2Quat(turn, np.radians([*(ground.get("slope_deg") or (0.0, 0.0)), 0.0]), "XYZ")
    mujoco.mju_quat2Mat(rotation, turn)
    return turn, rotation.reshape(3, 3)


def _add_ground(spec: Any, ground: Mapping[str, Any], contact: Mapping[str, Any]) -> None:
    """Add the ground: a plane, turned by its slope, and of a step the higher side, as a box on the lower one."""
    turn, rotation = _slope(ground)
    step = ground.get("step") or {"start": 0.0, "height": 0.0}
    start, height = step["start"], step["height"]
    sides = [("ground", mujoco.mjtGeom.mjGEOM_PLANE, [0.0, 0.0, 1.0], [0.0, 0.0, min(0.0, height)])]
    if height != 0.0:
        centre = [start + np.sign(height) * SIDE[0], 0.0, max(0.0, height) - SIDE[2]]
        sides.append(("step", mujoco.mjtGeom.mjGEOM_BOX, list(SIDE), centre))
    for name, shape, size, centre in sides:
        spec.worldbody.add_geom(
            name=name,
            type=shape,
            size=size,
            pos=rotation @ centre,
            quat=turn,
            contype=0,
            conaffinity=1,
            condim=3,
            **contact,
        )


def begin(config: Mapping[str, Any]) -> rust.Flight:
    """Return the flight of a standing robot before its first tick.

    Raises
    ------
    ValueError
        If the configuration has no ground, or has settings that this backend does not support; or if the robot does not
        come to rest where it is put down.
    """
    config = {**config, "backend": "mujoco"}
    rust.check_config(config)
    return rust.Flight(config, GroundPlant(config))


def fly(config: Mapping[str, Any], progress: rust.Progress | None = None) -> rust.FlightResult:
    """Simulate the standing robot of a configuration until the end or until it tips over, as `begin` has it.

    Returns the same as `rust.fly`, with additional signals and figures of the ground.
    """
    return begin(config).run(progress)

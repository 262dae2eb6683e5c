"""A robot on the ground: our robot in MuJoCo, with its contacts, controlled by the Rust controller.

```text
observe   state and foot wrenches of MuJoCo at x_k; aerodynamic forces of the true wind, thrusts
control   thrust rates and torques from the controller's measurement: state, thrusts, foot wrenches, measured wind
record    and stop if the robot has tipped over
advance   sub-steps of MuJoCo to x_{k+1} under held torques and forces; thrusts follow their commanded rates
```

The crate does not simulate ground contact; this engine does. A foot has contact at the corners of its sole, small
spheres whose lowest points are those in the robot's file. Joints have stops unless the configuration disables them.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import mujoco  # type: ignore[import-untyped]
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from jax_aero import mujoco_model, rust
from jax_aero.control.modes import MODES
from jax_aero.leg_odometry import LegOdometry
from jax_aero.result import Outcome
from jax_aero.summary import condense, figures

Array = NDArray[np.float64]

CORNER_RADIUS = 0.005
"""Radius of the spheres at the corners of a sole [m]."""
HOLD_STIFFNESS, HOLD_DAMPING = 4000.0, 60.0
"""Stiffness and damping of the joints while the robot is put down [N m/rad, N m s/rad]."""


class Observation(NamedTuple):
    """State of the simulation at a tick."""

    state: rust.State
    measured: rust.State
    """State as the robot measures it."""
    foot_wrenches: Float[np.ndarray, "feet 6"]
    """Wrenches about the origin of each sole [N, N m], force first, inertial axes."""
    joint_torque: Float[np.ndarray, " n"]
    """Torques on the joints [N m]: motor torque minus friction."""
    aero_force: Float[np.ndarray, "L 3"]
    """Aerodynamic force on each link [N], inertial axes."""
    soles: Float[np.ndarray, "feet 3"]
    """Origins of the soles [m]."""


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
        self._aero = simulator["aero"]
        self._substeps: int = simulator["substeps"]
        self.model = _model(self.source, self.robot, table.get("feet", []), simulator)
        self.data = mujoco.MjData(self.model)
        self._order = mujoco_model.order_of(self.source, tuple(self.robot.joint_names))
        feet = self.robot.foot_names
        self._soles = [self.model.site(f"foot_{foot}").id for foot in feet]
        self._foot_of_geom = {
            self.model.geom(f"{foot['name']}_{corner}").id: index
            for index, foot in enumerate(table.get("feet", []))
            for corner in range(len(foot["vertices"]))
        }
        self.named = [feet.index(name) for name in config["controller"]["contact"]["feet"]]
        """Indices of the feet that the controller stands on, in its order."""
        self.thrust: Array = np.array(simulator["initial"]["thrust"], dtype=np.float64)
        """Thrust of every jet [N]."""
        self._jets = [self.model.site(f"jet_{jet}").id for jet in self.robot.jet_names]
        jets = self.robot.arrays()["jets"]
        self._thrust_min, self._axes, self._torque_to_thrust = (
            jets[key] for key in ("thrust_min", "axes", "torque_to_thrust")
        )
        self._links = [self.model.site(f"aero_{link}").id for link in self.robot.aero_link_names]
        self._stand(simulator["initial"], simulator["ground"]["settling"])
        self.model.jnt_stiffness[1:] = simulator.get("motors", {}).get("stiffness", 0.0)
        self.model.qpos_spring[:] = self.data.qpos
        self._odometry: LegOdometry | None = None
        if settings := simulator["ground"].get("leg_odometry"):
            soles = [self._soles[foot] for foot in self.named]
            time_constant = settings["velocity_time_constant"]
            share = -np.expm1(-simulator["time_step"] / time_constant) if time_constant > 0.0 else 1.0
            self._odometry = LegOdometry(self.model, self._order, soles, self._state(), share)

    def _state(self) -> rust.State:
        """Return the state in the plant's arrays, after `mj_forward`."""
        data, order = self.data, self._order
        rotation = data.xmat[order.bodies[0]].reshape(3, 3).copy()
        nu = data.qvel[order.dofs]
        nu[3:6] = rotation @ nu[3:6]  # MuJoCo's angular part is in body axes
        return rust.State(data.qpos[:3].copy(), rotation, data.qpos[order.joints], nu)

    def _stand(self, initial: Mapping[str, Any], settling: float) -> None:
        """Put the robot down with stiff joints; it is then at rest except for rounding."""
        qpos, model = self.data.qpos, self.model
        qpos[:3] = initial["base_position"]
        mujoco.mju_euler2Quat(qpos[3:7], np.radians(initial["base_rpy_deg"]), "XYZ")
        qpos[self._order.joints] = initial["joint_position"]
        model.jnt_stiffness[1:] = HOLD_STIFFNESS
        model.qpos_spring[:] = qpos
        own_damping = model.dof_damping.copy()
        model.dof_damping[6:] = HOLD_DAMPING
        for _ in range(round(settling / model.opt.timestep)):
            mujoco.mj_step(model, self.data)
        held = self.data.qfrc_passive[self._order.dofs[6:]].copy()  # for the first measurement
        model.jnt_stiffness[:] = 0.0
        model.dof_damping[:] = own_damping
        self.data.time = 0.0
        self.data.ctrl[:] = held
        mujoco.mj_forward(model, self.data)
        if not self.is_sound:
            raise ValueError("`simulator.initial` puts the robot where it cannot come to rest: its state is not finite")

    def observe(self, wind: Float[np.ndarray, "3"]) -> Observation:
        """Return the state at this tick, and hold the forces of a wind [m/s, inertial axes] until the next."""
        data = self.data
        mujoco.mj_forward(self.model, data)
        state = self._state()
        torque = (data.qfrc_actuator + data.qfrc_passive + self._dry_friction())[self._order.dofs[6:]]
        return Observation(
            state=state,
            measured=state if self._odometry is None else self._odometry.measure(state),
            foot_wrenches=self._foot_wrenches(),
            joint_torque=torque,
            aero_force=self._blow(state, wind),
            soles=data.site_xpos[self._soles].copy(),
        )

    @property
    def is_sound(self) -> bool:
        """Whether every number of the state is finite."""
        return bool(np.isfinite(self.data.qpos).all() and np.isfinite(self.data.qvel).all())

    def advance(self, torque: Float[np.ndarray, " n"], thrust_rate: Float[np.ndarray, " jets"]) -> None:
        """Advance one tick under held torques [N m]; thrusts follow their rates [N/s] (M31)."""
        self.data.ctrl[:] = torque
        mujoco.mj_step(self.model, self.data, self._substeps)
        tick = self._substeps * self.model.opt.timestep
        self.thrust = np.maximum(self.thrust + tick * np.asarray(thrust_rate), self._thrust_min)

    def _foot_wrenches(self) -> Array:
        data = self.data
        wrenches, count = np.zeros((len(self._soles), 6)), data.ncon
        if count == 0:
            return wrenches
        local = np.zeros((count, 6))
        for index in range(count):
            mujoco.mj_contactForce(self.model, data, index, local[index])
        contact = data.contact
        feet = [self._foot_of_geom[geom] for geom in contact.geom2.tolist()]
        # The rows of a contact's frame are its axes; a corner in contact carries no moment.
        force = (contact.frame.reshape(-1, 3, 3) * local[:, :3, None]).sum(axis=1)
        arm = contact.pos - data.site_xpos[self._soles][feet]
        np.add.at(wrenches, feet, np.hstack([force, np.cross(arm, force)]))
        return wrenches

    def _dry_friction(self) -> Array:
        """Return the generalised force of dry friction, which MuJoCo treats as a constraint."""
        data, force = self.data, np.zeros(self.model.nv)
        rows = np.flatnonzero(data.efc_type[: data.nefc] == mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF)
        force[data.efc_id[rows]] = data.efc_force[rows]
        return force

    def _blow(self, state: rust.State, wind: Array) -> Array:
        """Compute the link forces in a wind [m/s], and apply them and the thrusts until the next tick."""
        model, data = self.model, self.data
        forces = rust.link_forces(self.robot, self._aero, state, wind)
        data.qfrc_applied[:] = 0.0
        axes = np.einsum("jab,jb->ja", data.site_xmat[self._jets].reshape(-1, 3, 3), self._axes)
        thrusts = self.thrust[:, None] * axes
        pushes = zip(self._jets, thrusts, self._torque_to_thrust[:, None] * thrusts, strict=True)
        drags = zip(self._links, forces, np.zeros_like(forces), strict=True)
        for site, force, moment in [*pushes, *drags]:
            body = model.site_bodyid[site]
            mujoco.mj_applyFT(model, data, force, moment, data.site_xpos[site], body, data.qfrc_applied)
        return forces


def _model(source: str, robot: rust.Robot, feet: Sequence[Mapping[str, Any]], simulator: Mapping[str, Any]) -> Any:
    """Return MuJoCo's model of the robot on a plane, with `feet` as in its file and motors as configured."""
    ground, motors = simulator["ground"], simulator.get("motors", {})
    spec = mujoco_model.mujoco_spec(source)
    option = spec.option
    # Without automatic reset, so that a diverging run ends instead of restarting.
    option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    if not simulator["joint_stops"]:
        option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    option.timestep = simulator["time_step"] / simulator["substeps"]
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 100.0  # reduces creep along the ground
    option.tolerance = 1e-10
    contact = {
        "friction": [ground["friction"], 0.005, 0.0001],
        "solref": [ground["contact_time"], 1.0],
        "solimp": [0.95, 0.99, 0.001, 0.5, 2.0],
    }
    spec.worldbody.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 1.0],
        contype=0,
        conaffinity=1,
        condim=3,
        **contact,
    )
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


def fly(config: Mapping[str, Any], progress: rust.Progress | None = None) -> rust.FlightResult:
    """Simulate the standing robot of a configuration until the end or until it tips over.

    Returns the same as `rust.fly`, with additional signals and figures of the ground.

    Raises
    ------
    ValueError
        If the configuration has no ground, or has settings that this engine does not support; or if the robot does not
        come to rest where it is put down.
    """
    rust.check_config({**config, "engine": "mujoco"})
    simulator, disturbances = config["simulator"], config.get("disturbances", {})
    plant, controller = GroundPlant(config), rust.Controller(config)
    times = _times(simulator)
    blowing = rust.wind_velocity(config["wind"], times)
    measured = rust.wind_velocity(disturbances.get("controller_wind", config["wind"]), times)
    rows: list[dict[str, Any]] = []
    loss: tuple[Outcome, str] | None = None
    posture = None
    for k, time in enumerate(times):
        if not plant.is_sound:
            loss = "diverged", "state not finite"
            break
        seen, thrust = plant.observe(blowing[k]), plant.thrust
        tick = controller.tick(seen.measured, thrust, measured[k], time, foot_wrenches=seen.foot_wrenches[plant.named])
        posture = tick.posture
        row = _row(plant, seen, tick, time, thrust, blowing[k]) | {"raw_wind": measured[k]}
        rows.append(row)
        loss = _divergence(row, simulator["divergence"], plant.robot) or _fall(row, simulator["fall"])
        if loss is not None:
            break
        plant.advance(tick.joint_torque, tick.thrust_rate)
        if progress is not None:
            progress(k, len(blowing) - 1)
    log = {name: np.array([row[name] for row in rows], dtype=np.float64) for name in rows[0]}
    # A row that exceeds the divergence limits does not count in the figures of merit.
    merits = len(rows) - (loss is not None and loss[0] == "diverged" and plant.is_sound)
    summary = _summary({name: values[:merits] for name, values in log.items()}, np.asarray(posture))
    flown: Outcome = "off_course" if summary["max_com_error"] > simulator["course_error"] else "completed"
    return rust.FlightResult(
        log=log,
        joint_setpoint=np.asarray(posture),
        outcome=flown if loss is None else loss[0],
        lost_time=None if loss is None else float(time),
        lost_reason=None if loss is None else loss[1],
        summary=summary,
    )


def _times(simulator: Mapping[str, Any]) -> Array:
    ticks = int(np.floor(simulator["duration"] / simulator["time_step"] + 0.5))
    return np.asarray(np.arange(ticks + 1) * float(simulator["time_step"]), dtype=np.float64)


def _row(
    plant: GroundPlant, seen: Observation, tick: rust.Tick, time: float, thrust: Array, wind: Array
) -> dict[str, Any]:
    """Return every signal of one tick."""
    truth = rust.dynamics(plant.robot, seen.state)
    position, rotation, joints, nu = (np.asarray(part) for part in seen.state)
    desired = np.asarray(tick.setpoint.rotation)
    estimates = tick.estimates
    estimated_position, estimated_rotation, _, estimated_nu = (np.asarray(part) for part in estimates.state)
    raw_position, raw_rotation, raw_joints, raw_nu = (np.asarray(part) for part in seen.measured)
    contact = tick.contact
    if contact is None:
        raise ValueError("`controller.contact` is absent; expected a table: without feet the controller cannot stand")

    def expand_feet(named: Array) -> Array:
        every = np.zeros_like(seen.foot_wrenches)
        every[plant.named] = named
        return every

    return {
        "time": time,
        "base_position": position,
        "base_quaternion": _wxyz(rotation),
        "base_velocity": nu[:6],
        "base_rpy_setpoint": _rpy(desired),
        "joint_position": joints,
        "joint_velocity": nu[6:],
        "com_position": truth.com_position,
        "com_velocity": truth.momentum[:3] / plant.robot.mass,
        "com_setpoint": np.asarray(tick.setpoint.com_position),
        "rotation_error": _angle(desired.T @ rotation),
        "thrust": thrust,
        "thrust_rate": tick.thrust_rate,
        "joint_velocity_command": tick.joint_velocity_command,
        "joint_torque": tick.joint_torque,
        "wind": wind,
        "aero_force_sim": seen.aero_force,
        "aero_force_control": tick.aero_force,
        "momentum": truth.momentum,
        "momentum_setpoint": np.append(plant.robot.mass * np.asarray(tick.setpoint.com_velocity), np.zeros(3)),
        "momentum_rate_estimate": tick.momentum_rate_estimate,
        "unmodelled_wrench": tick.unmodelled_wrench,
        "measured_base_position": estimated_position,
        "measured_base_quaternion": _wxyz(estimated_rotation),
        "measured_base_velocity": estimated_nu[:6],
        "measured_joint_velocity": estimated_nu[6:],
        "measured_thrust": estimates.thrust,
        "measured_wind": estimates.wind,
        "measured_wind_std": estimates.wind_std,
        "raw_base_position": raw_position,
        "raw_base_rotation": raw_rotation,
        "raw_base_velocity": raw_nu[:6],
        "raw_joint_position": raw_joints,
        "raw_joint_velocity": raw_nu[6:],
        "raw_thrust": thrust,
        "qp_status": [tick.momentum_answer.status_code, tick.torque_answer.status_code],
        "qp_kkt": [tick.momentum_answer.kkt, tick.torque_answer.kkt],
        "qp_iterations": [tick.momentum_answer.iterations, tick.torque_answer.iterations],
        "degraded_modes": float(sum(MODES[mode] for mode in tick.degraded_modes)),
        "joint_condition": tick.joint_condition,
        "measured_torque_latency": tick.measured_latency[0],
        "measured_thrust_latency": tick.measured_latency[1],
        "joint_torque_measured": seen.joint_torque,
        "foot_wrench": seen.foot_wrenches,
        "sole_position": seen.soles,
        "feet_carry": float(contact.is_active),
        "contact_force": expand_feet(contact.force),
        "contact_force_rate": expand_feet(contact.force_rate),
        "contact_force_torque": expand_feet(contact.force_of_torques),
    }


def _wxyz(rotation: Array) -> Array:
    wxyz = np.zeros(4)
    mujoco.mju_mat2Quat(wxyz, rotation.ravel())
    return wxyz if wxyz[0] >= 0.0 else -wxyz


def _angle(rotation: Array) -> float:
    """Return the angle of a rotation [rad], from 0 to π."""
    wxyz = _wxyz(rotation)
    return float(2.0 * np.arctan2(np.linalg.norm(wxyz[1:]), wxyz[0]))


def _rpy(rotation: Array) -> list[float]:
    """Return roll, pitch and yaw [rad] of Rz(yaw) Ry(pitch) Rx(roll)."""
    (a, _, _), (b, _, _), (c, d, e) = rotation.tolist()
    return [math.atan2(d, e), math.atan2(-c, math.hypot(a, b)), math.atan2(b, a)]


def _divergence(row: Mapping[str, Any], limits: Mapping[str, float], robot: rust.Robot) -> tuple[Outcome, str] | None:
    """Apply the crate's criteria of divergence, without that on thrusts, which the controller limits here."""
    lower, upper = np.reshape(robot.joint_stops, (-1, 2)).T
    joints, base = row["joint_position"], row["base_velocity"]
    speed = max(np.linalg.norm(base[:3]), np.linalg.norm(row["wind"]))
    excess = np.max(np.maximum(lower - joints, joints - upper), initial=-np.inf)
    criteria = (
        (speed, "speed", "speed above {} m/s"),
        (np.linalg.norm(base[3:]), "angular_velocity", "angular velocity above {} rad/s"),
        (np.max(np.abs(row["joint_velocity"]), initial=0.0), "joint_velocity", "joint velocity above {} rad/s"),
        (excess, "joint_excess", "joint more than {} rad beyond its stop"),
    )
    for value, name, words in criteria:
        if value > limits[name]:
            return "diverged", words.format(np.format_float_positional(limits[name], trim="-"))
    return None


def _fall(row: Mapping[str, Any], limits: Mapping[str, float]) -> tuple[Outcome, str] | None:
    """Apply the crate's criteria of a fall."""
    angle = np.degrees(row["rotation_error"])
    distance = float(np.linalg.norm(row["com_position"] - row["com_setpoint"]))
    if not np.isfinite(angle) or not np.isfinite(distance):
        return "diverged", "state not finite"
    if angle > limits["rotation_error_deg"]:
        return "fell", f"rotation error {angle:.1f} deg"
    if distance > limits["com_error"]:
        return "fell", f"CoM error {distance:.2f} m"
    return None


def _summary(log: Mapping[str, Array], joint_setpoint: Array) -> dict[str, float]:
    airborne = np.count_nonzero(log["feet_carry"] == 0)
    tick = float(log["time"][1]) if len(log["time"]) > 1 else 0.0
    load = log["foot_wrench"][:, :, 2].sum(axis=1)
    touches = np.flatnonzero((load[:-1] == 0.0) & (load[1:] > 0.0))
    speed = np.max(-log["com_velocity"][touches, 2], initial=0.0)
    of_ground = {"time_off_the_ground": tick * airborne, "touchdown_speed": float(speed)}
    return figures(condense(log, joint_setpoint)) | of_ground

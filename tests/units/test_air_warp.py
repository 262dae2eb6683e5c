"""The air in MuJoCo Warp and Newton: the forces of the crate on every link of every world, on Warp's CPU."""

import dataclasses
from types import SimpleNamespace

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from jax_aero import air, rust
from jax_aero.base import places
from jax_aero.body.mujoco_model import to_mujoco
from jax_aero.body.robot import load_robot
from jax_aero.types import State
from tests.measurements import measured

wp = pytest.importorskip("warp", reason="Warp is not installed: make setup")
from jax_aero import air_warp  # noqa: E402

pytestmark = pytest.mark.usefixtures("x64")

# Two links on one body, one of them a sphere, and one on another, in the order of neither.
LIMBS = """
<mujoco><worldbody><body name="trunk" pos="0 0 1"><freejoint/>
  <geom type="capsule" fromto="0 0 0 0.05 0 0.5" size="0.1"/>
  <body name="arm" pos="0 0.2 0.4"><joint name="shoulder" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.04"/></body>
</body></worldbody></mujoco>
"""
LINKS = [
    air.Link("trunk", diameter=0.2, length=0.5, axis=(0.1, 0.0, 1.0), centre=(0.02, 0.0, 0.3)),
    air.Link("arm", diameter=0.08, length=0.5, centre=(0.0, 0.0, -0.25)),
    air.Link("trunk", diameter=0.18, centre=(0.0, 0.05, 0.7)),
]
WORLDS = 12


@pytest.fixture(autouse=True, scope="module")
def quiet():
    wp.config.log_level = wp.LOG_ERROR
    wp.init()


@pytest.fixture
def limbs():
    model = mujoco.MjModel.from_xml_string(LIMBS)
    return model, air.from_links(model, LINKS)


def place(model, rng):
    """Random poses and velocities of worlds from slow to fast, in MuJoCo."""
    worlds = [mujoco.MjData(model) for _ in range(WORLDS)]
    for count, data in enumerate(worlds):
        data.qpos[:] = rng.normal(size=model.nq)
        mujoco.mj_normalizeQuat(model, data.qpos)
        data.qvel[:] = 3.0 * count / WORLDS * rng.normal(size=model.nv)
        mujoco.mj_forward(model, data)
    return worlds


def draw_winds(rng):
    """Winds of 1 mm/s to 200 m/s: all Reynolds numbers of the tables, and below."""
    return np.geomspace(1e-3, 200.0, WORLDS)[:, None] * rng.normal(size=(WORLDS, 3))


def on_device(model, worlds):
    """What the kernel reads of MuJoCo Warp's model and data, from data of MuJoCo."""
    kinds = {"xpos": wp.vec3, "xmat": wp.mat33, "xipos": wp.vec3, "subtree_com": wp.vec3}
    kinds |= dict.fromkeys(("cvel", "xfrc_applied"), wp.spatial_vector)
    rows = {name: np.array([getattr(data, name) for data in worlds]) for name in kinds}
    rows["xmat"] = rows["xmat"].reshape(*rows["xmat"].shape[:2], 3, 3)
    arrays = {name: wp.array(values, dtype=kinds[name], device="cpu") for name, values in rows.items()}
    roots = wp.array(model.body_rootid, dtype=int, device="cpu")
    return SimpleNamespace(body_rootid=roots), SimpleNamespace(nworld=len(worlds), **arrays)


def wrenches(around, worlds, winds):
    """Wrenches in double precision, as in `xfrc_applied` (worlds, nbody, 6)."""
    fields = air._MujocoState._fields
    taken = [air._MujocoState(*(np.array(getattr(data, name)) for name in fields)) for data in worlds]
    return np.array([air._xfrc(around, state, jnp.asarray(wind)) for state, wind in zip(taken, winds, strict=True)])


def blow(around, model, worlds, winds, derivatives=False):
    device_model, data = on_device(model, worlds)
    found = air_warp.MujocoWarpAir(around, data, derivatives)
    found.wind.assign(winds)
    found(device_model, data)
    return found, data.xfrc_applied.numpy()


def agree(what, ours, theirs, tolerance=1e-5):
    """Largest difference in any world, of the largest entry in it."""
    axes = tuple(range(1, np.ndim(theirs)))
    measured(what, np.max(np.abs(ours - theirs).max(axis=axes) / np.abs(theirs).max(axis=axes)), tolerance)


@pytest.mark.parametrize(("name", "aero"), [("ironcub_mk1", "axisymmetric_corrected"), ("sparrow", "sphere_cylinder")])
def test_all_worlds_get_the_forces_of_the_crate(name, aero):
    robot, rng = load_robot(places.find("robot", name)), np.random.default_rng(5)
    model = air.mujoco_model(name)
    worlds, winds, expected = [mujoco.MjData(model) for _ in range(WORLDS)], draw_winds(rng), []
    for data, wind in zip(worlds, winds, strict=True):
        rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        rotation *= np.sign(np.linalg.det(rotation))
        joints = 0.5 * rng.normal(size=robot.n_joints)
        state = State(rng.normal(size=3), rotation, joints, rng.normal(size=6 + robot.n_joints))
        data.qpos[:], data.qvel[:] = to_mujoco(robot, State(*map(jnp.asarray, state)))
        mujoco.mj_forward(model, data)
        forces = rust.link_forces(rust.Robot(robot.source), rust.load_aero(aero), rust.State(*state), wind)
        expected.append(forces.sum(axis=0))
    around = air.from_robot(model, name, aero)
    _, found = blow(around, model, worlds, winds)
    agree(f"total force beside the crate's, {name}", found[:, :, :3].sum(axis=1), np.array(expected))
    agree(f"wrench of each body, {name}", found, wrenches(around, worlds, winds))


@pytest.mark.close_to_tolerance("the twin's ε in the sine, for wind along an axis")
@pytest.mark.parametrize("kind", ["sphere_cylinder", "axisymmetric"])
def test_the_derivative_by_velocity_is_that_of_the_force(limbs, kind):
    """The derivative of the generalised forces of the air by the velocities of the joints."""
    model, around = limbs
    rng = np.random.default_rng(11)
    if kind == "axisymmetric":
        drawn = [dataclasses.replace(link, coefficients=tuple(rng.normal(size=6))) for link in LINKS]
        around = air.from_links(model, drawn)
    worlds, winds = place(model, rng), draw_winds(rng)
    winds[-1] = worlds[-1].xmat[2].reshape(3, 3)[:, 2] * -9.0  # along the arm
    worlds[-1].qvel[:] = 0.0
    mujoco.mj_forward(model, worlds[-1])
    found, _ = blow(around, model, worlds, winds, derivatives=True)
    jacobians = np.zeros((WORLDS, len(found.bodies), 6, model.nv))
    for world, data in enumerate(worlds):
        for row, body in zip(jacobians[world], found.bodies, strict=True):
            mujoco.mj_jacBodyCom(model, data, row[:3], row[3:], body)
    generalised = np.einsum("wbij,wbik,wbkl->wjl", jacobians, found.derivatives.numpy(), jacobians)

    steps, quotients = 1e-6 * np.linalg.norm(winds, axis=1), np.zeros_like(generalised)
    for column in range(model.nv):
        for sign in (1.0, -1.0):
            for data, step in zip(worlds, steps, strict=True):
                data.qvel[column] += sign * step
                mujoco.mj_forward(model, data)
                data.qvel[column] -= sign * step
            moved = wrenches(around, worlds, winds)[:, found.bodies]
            quotients[:, :, column] += sign * np.einsum("wbij,wbi->wj", jacobians, moved) / (2.0 * steps[:, None])
    agree(f"derivative of the generalised force, {kind}", generalised, quotients)


def test_at_rest_there_is_neither_force_nor_derivative(limbs):
    model, around = limbs
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found, wrench = blow(around, model, [data], np.zeros((1, 3)), derivatives=True)
    assert not wrench.any()
    assert not found.derivatives.numpy().any()


def test_a_call_neither_allocates_nor_waits_and_reads_the_wind_of_the_moment(limbs, monkeypatch):
    """So that it can be part of a CUDA graph. Rows of bodies without links belong to others."""
    model, around = limbs
    worlds = place(model, np.random.default_rng(13))
    device_model, data = on_device(model, worlds)
    data.xfrc_applied.fill_(7.0)
    found = air_warp.MujocoWarpAir(around, data)

    def refuse(*_, **__):
        raise AssertionError

    with monkeypatch.context() as patch:
        for name in ("array", "zeros", "empty", "clone", "synchronize", "synchronize_device", "synchronize_stream"):
            patch.setattr(wp, name, refuse)
        for name in ("__init__", "numpy"):
            patch.setattr(type(data.xpos), name, refuse)
        found(device_model, data)
    assert (data.xfrc_applied.numpy()[:, 0] == 7.0).all()
    winds = draw_winds(np.random.default_rng(7))
    found.wind.assign(winds)
    found(device_model, data)
    agree("wrench after a change", data.xfrc_applied.numpy()[:, 1:], wrenches(around, worlds, winds)[:, 1:])


def newton_like(model, worlds):
    """What the kernel reads of Newton's model and state: bodies of all worlds in one row, and no body for the world."""
    twists, poses = [], []
    for data in worlds:
        for body in range(1, model.nbody):
            twist = np.zeros(6)
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, body, twist, 0)  # at the centre of mass
            twists.append([*twist[3:], *twist[:3]])
            poses.append([*data.xpos[body], *data.xquat[body][[1, 2, 3, 0]]])
    own = SimpleNamespace(
        device="cpu",
        body_label=["robot/trunk", "robot/trunk/arm"] * len(worlds),
        world_count=len(worlds),
        body_world=wp.array(np.repeat(np.arange(len(worlds)), 2), dtype=int, device="cpu"),
        body_com=wp.array(np.tile(model.body_ipos[1:], (len(worlds), 1)), dtype=wp.vec3, device="cpu"),
    )
    state = SimpleNamespace(
        body_q=wp.array(poses, dtype=wp.transform, device="cpu"),
        body_qd=wp.array(twists, dtype=wp.spatial_vector, device="cpu"),
        body_f=wp.array(np.ones((2 * len(worlds), 6)), dtype=wp.spatial_vector, device="cpu"),
    )
    return own, state


def test_newton_gets_the_wrenches_in_addition_to_its_own(limbs):
    model, around = limbs
    rng = np.random.default_rng(17)
    worlds, winds = place(model, rng), draw_winds(rng)
    own, state = newton_like(model, worlds)
    ours = air_warp.NewtonAir(air.from_links(own, LINKS), own, derivatives=True)
    ours.wind.assign(winds)
    ours.add(state)
    expected, (other, _) = wrenches(around, worlds, winds), blow(around, model, worlds, winds, derivatives=True)
    found = state.body_f.numpy().reshape(WORLDS, 2, 6)
    agree("wrench in Newton", found, 1.0 + expected[:, 1:])
    agree("derivative in Newton", ours.derivatives.numpy().reshape(WORLDS, 2, 6, 6), other.derivatives.numpy())


def test_newtons_own_kinematics_give_the_forces_of_mujoco(limbs):
    newton = pytest.importorskip("newton", reason="Newton is not installed: pip install newton")
    model, around = limbs
    rng = np.random.default_rng(19)
    worlds, winds = place(model, rng), draw_winds(rng)
    builder, scene = newton.ModelBuilder(), newton.ModelBuilder()
    builder.add_mjcf(LIMBS)
    scene.replicate(builder, WORLDS)
    theirs = scene.finalize(device="cpu")
    positions = np.array([data.qpos for data in worlds])
    positions[:, 3:7] = positions[:, [4, 5, 6, 3]]
    velocities = []
    for data in worlds:
        turned = data.xmat[1].reshape(3, 3) @ data.qvel[3:6]  # MuJoCo turns in body axes
        at_com = data.qvel[:3] + np.cross(turned, data.xipos[1] - data.xpos[1])
        velocities.append([*at_com, *turned, *data.qvel[6:]])
    theirs.joint_q.assign(positions.ravel())
    theirs.joint_qd.assign(np.ravel(velocities))
    state = theirs.state()
    newton.eval_fk(theirs, theirs.joint_q, theirs.joint_qd, state)
    ours = air_warp.NewtonAir(air.from_links(theirs, LINKS), theirs)
    ours.wind.assign(winds)
    ours.add(state)
    agree("wrench in Newton itself", state.body_f.numpy().reshape(WORLDS, 2, 6), wrenches(around, worlds, winds)[:, 1:])


def test_mujoco_warps_own_kinematics_give_the_forces_of_mujoco(limbs):
    mjw = pytest.importorskip("mujoco_warp", reason="Warp is not installed: make setup")
    model, around = limbs
    rng = np.random.default_rng(23)
    worlds, winds = place(model, rng), draw_winds(rng)
    theirs, data = mjw.put_model(model), mjw.put_data(model, worlds[0], nworld=WORLDS)
    data.qpos.assign(np.array([each.qpos for each in worlds]))
    data.qvel.assign(np.array([each.qvel for each in worlds]))
    for stage in (mjw.kinematics, mjw.com_pos, mjw.com_vel):
        stage(theirs, data)
    ours = theirs.callback.control = air_warp.MujocoWarpAir(around, data)
    ours.wind.assign(winds)
    theirs.callback.control(theirs, data)
    agree("wrench in MuJoCo Warp itself", data.xfrc_applied.numpy(), wrenches(around, worlds, winds))


def test_models_without_a_kernel_and_missing_bodies_are_refused(limbs):
    model, around = limbs
    _, data = on_device(model, [mujoco.MjData(model)])
    calm = air.from_robot(air.mujoco_model("sparrow"), "sparrow", "off")
    with pytest.raises(ValueError, match="NoAero, which has no kernel for Warp; expected an axisymmetric"):
        air_warp.MujocoWarpAir(calm, data)
    own, _ = newton_like(model, [mujoco.MjData(model)])
    with pytest.raises(ValueError, match="no body `arn`; did you mean arm"):
        air.from_links(own, [air.Link("arn", 0.1)])
    own.body_label = ["robot/trunk", "robot/leg"]
    with pytest.raises(ValueError, match="no body `arm`"):
        air_warp.NewtonAir(around, own)

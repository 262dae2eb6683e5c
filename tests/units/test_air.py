"""The air for other simulators: MuJoCo gets the forces of our simulator, with our robots and with declared links."""

import contextlib
import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from jax_aero import air, rust
from jax_aero.aero import LinkConventions, aero_model, generalised_aero_force, link_forces
from jax_aero.base import places
from jax_aero.body.kinematics import kinematics
from jax_aero.body.mujoco_model import mjx, mujoco_model, order_of, to_mujoco
from jax_aero.body.robot import load_robot
from jax_aero.config import AxisymmetricAeroConfig, SphereCylinderAeroConfig
from jax_aero.types import State
from tests.measurements import measured

pytestmark = pytest.mark.usefixtures("x64")

WIND = [3.0, -8.0, 1.0]
PENDULUM = """
<mujoco><option timestep="0.01"/><worldbody><body name="arm">
  <joint name="hinge" axis="0 1 0" damping="0.6"/>
  <geom type="sphere" pos="0 0 -0.5" size="0.05" mass="0.4"/>
</body></worldbody></mujoco>
"""
BALL = air.Link("arm", diameter=0.1, centre=(0.0, 0.0, -0.5), coefficients=(0.02, 0.0, 0.0, 0.0, 0.0, 0.0))


@jax.jit
def _generalised_force(aero, robot, state):
    kin = kinematics(robot, state)
    found = link_forces(aero, robot, kin, LinkConventions(), jnp.asarray(WIND))
    return generalised_aero_force(robot, kin, found, found.arm_points)


@contextlib.contextmanager
def install_callback(callback):
    """MuJoCo has one callback for all models."""
    mujoco.set_mjcb_control(callback)
    try:
        yield
    finally:
        mujoco.set_mjcb_control(None)


@pytest.mark.parametrize(
    ("name", "aero"),
    [("ironcub_mk1", "axisymmetric_corrected"), ("ironcub_mk1", "network"), ("sparrow", "sphere_cylinder")],
)
def test_mujoco_feels_the_air_of_our_simulator(name, aero):
    """The callback's effect on the generalised forces of MuJoCo, and the forces on the links beside the crate's."""
    robot = load_robot(places.find("robot", name))
    model = mujoco_model(robot.source)
    rng = np.random.default_rng(3)
    n = robot.n_joints
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    state = State(rng.normal(size=3), rotation, 0.5 * rng.normal(size=n), rng.normal(size=6 + n))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = to_mujoco(robot, State(*map(jnp.asarray, state)))
    mujoco.mj_forward(model, data)
    calm = data.qfrc_smooth.copy()
    wind = air.from_robot(model, name, aero)
    with install_callback(wind.callback(lambda _: WIND)):
        mujoco.mj_forward(model, data)
    felt = (data.qfrc_smooth - calm)[order_of(robot.source, robot.joint_names).dofs]
    felt[3:6] = rotation @ felt[3:6]  # MuJoCo turns in body axes

    expected = np.asarray(_generalised_force(aero_model(air.settings(aero), robot), robot, state))
    # The network's weighted sums are in single precision, and MuJoCo poses bodies with other roundings.
    tolerance = 1e-5 if aero == "network" else 1e-9
    measured(f"generalised force, {name}, {aero}", np.abs(felt - expected).max() / np.abs(expected).max(), tolerance)
    if aero == "axisymmetric_corrected":
        table = rust.load_config("test2")["simulator"]["aero"]
        crate = rust.link_forces(rust.Robot(robot.source), table, rust.State(*state), WIND)
        total = data.xfrc_applied[:, :3].sum(axis=0)
        measured("total force beside the crate's [N]", np.abs(total - crate.sum(axis=0)).max(), 1e-9)


def test_a_pendulum_leans_by_the_ratio_of_drag_and_weight():
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    data = mujoco.MjData(model)
    with install_callback(air.from_links(model, [BALL]).callback([6.0, 0.0, 0.0])):
        mujoco.mj_step(model, data, nstep=1500)
    drag = 0.5 * air.AIR_DENSITY * 0.02 * 6.0**2
    expected = -np.arctan(drag / (0.4 * 9.81))  # the hinge turns +z towards +x, and so -z towards -x
    measured("angle of the pendulum [rad]", abs(data.qpos[0] - expected), 1e-6)


TWO_TREES = """
<mujoco><worldbody>
  <body name="far" pos="9 0 0"><freejoint/><geom type="sphere" size="0.2" mass="5"/></body>
  <body name="arm"><freejoint/><geom type="sphere" pos="0 0 -0.5" size="0.05" mass="0.4"/>
    <body name="hand" pos="1 0 0"><joint axis="0 1 0"/><geom type="sphere" pos="0.3 0 0" size="0.05" mass="0.3"/></body>
  </body>
</worldbody></mujoco>
"""


def test_a_link_feels_the_velocity_of_its_own_body():
    """Drag of a ball on a turning hand, by MuJoCo's own velocity of the ball; another tree stands in the scene."""
    model = mujoco.MjModel.from_xml_string(TWO_TREES)
    data = mujoco.MjData(model)
    data.qvel[:] = np.random.default_rng(1).normal(size=model.nv)
    mujoco.mj_forward(model, data)
    hand = model.body("hand").id
    seen = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, hand, seen, 0)
    angular, linear = seen[:3], seen[3:]
    ball = dataclasses.replace(BALL, body="hand", centre=(0.3, 0.0, 0.0))
    loads = air.from_links(model, [ball]).loads(data, jnp.asarray(WIND))
    arm = data.xmat[hand].reshape(3, 3) @ ball.centre
    np.testing.assert_allclose(loads.points[0], data.xpos[hand] + arm, rtol=1e-12)
    flow = WIND - linear - np.cross(angular, arm)
    expected = 0.5 * air.AIR_DENSITY * 0.02 * np.linalg.norm(flow) * flow
    np.testing.assert_allclose(loads.forces[0], expected, rtol=1e-9)


def test_an_axis_of_a_link_is_a_direction_whatever_its_length():
    model, found = mujoco.MjModel.from_xml_string(PENDULUM), []
    for axis in ((0.0, 0.6, 0.8), (0.0, 3.0, 4.0)):
        wind, data = air.from_links(model, [air.Link("arm", diameter=0.1, length=0.3, axis=axis)]), mujoco.MjData(model)
        with install_callback(wind.callback(WIND)):
            mujoco.mj_forward(model, data)
        found.append(data.xfrc_applied.copy())
    np.testing.assert_allclose(found[1], found[0], rtol=0.0, atol=1e-12 * np.abs(found[0]).max())


def test_mjx_gets_the_forces_of_mujoco_as_a_pure_function():
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = 0.4, -2.0
    wind = air.from_links(
        model, [air.Link("arm", diameter=0.1, length=0.3, axis=(0.0, 1.0, 1.0), centre=(0.0, 0.0, -0.4))]
    )
    with install_callback(wind.callback(WIND)):
        mujoco.mj_forward(model, data)
    ours = mjx.put_model(model)
    start = mjx.make_data(ours).replace(qpos=jnp.array([0.4]), qvel=jnp.array([-2.0]))
    blown = jax.jit(lambda state: wind.blow(ours, state, jnp.asarray(WIND)).xfrc_applied)(start)
    measured("wrench in MJX [N, N m]", np.abs(np.asarray(blown) - data.xfrc_applied).max(), 1e-9)
    assert np.abs(data.xfrc_applied[1]).min() > 0.0


@pytest.mark.parametrize(
    ("links", "message"),
    [
        ([], "there is no link"),
        ([air.Link("arn", 0.1)], "no body `arn`; did you mean arm"),
        ([air.Link("arm", 0.0)], "diameter 0.0"),
        ([air.Link("arm", 0.1, axis=(0.0, 0.0, 0.0))], "axis of the link of `arm` is zero"),
        ([BALL, air.Link("arm", 0.1)], "some links have coefficients"),
    ],
)
def test_bad_links_are_refused(links, message):
    with pytest.raises(ValueError, match=message):
        air.from_links(mujoco.MjModel.from_xml_string(PENDULUM), links)


@pytest.mark.parametrize("aero", ["network", "axisymmetric_corrected"])
def test_a_model_of_a_whole_robot_is_refused_for_declared_links(aero):
    with pytest.raises(ValueError, match=f"`aero` is `{aero}`; expected a sphere and cylinder model"):
        air.from_links(mujoco.MjModel.from_xml_string(PENDULUM), [air.Link("arm", 0.1)], aero)


def test_wind_may_be_a_list_of_three_and_nothing_else():
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    around, data = air.from_links(model, [air.Link("arm", 0.1)]), mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    force = np.asarray(around.xfrc(data, [8.0, 0.0, 0.0]))
    assert np.array_equal(force, around.xfrc(data, np.array([8.0, 0.0, 0.0])))
    for wind in (8.0, [8.0, 0.0]):
        with pytest.raises(ValueError, match=r"`wind` has shape \((2,)?\); expected \(3,\)"):
            around.callback(wind)(model, data)


def test_the_model_of_a_robot_has_what_its_air_needs(monkeypatch):
    """Robots with and without coefficients have a default for their air, and every call makes a model of its own."""
    monkeypatch.setattr(air, "aero_model", lambda settings, _: settings)
    for name, kind in (("ironcub_mk1", AxisymmetricAeroConfig), ("sparrow", SphereCylinderAeroConfig)):
        model = air.mujoco_model(name)
        assert isinstance(air.from_robot(model, name).aero, kind)
    other = air.mujoco_model(name)
    other.body_mass[:] = 0.0
    assert model.body_mass.max() > 0.0


def test_a_robot_without_coefficients_is_led_to_another_model():
    robot = load_robot(places.find("robot", "sparrow"))
    robot = dataclasses.replace(robot, aero_links=dataclasses.replace(robot.aero_links, coefficients={}))
    assert air.default_model(robot) == "sphere_cylinder"
    with pytest.raises(ValueError, match=r'coefficients is `signed`; sparrow has none; .* such as "sphere_cylinder"'):
        aero_model(air.settings("axisymmetric_signed"), robot)


def test_a_robot_that_is_not_there_is_refused_with_a_way_on():
    """MuJoCo itself fixes the base of a URDF to the world."""
    fixed = mujoco.MjModel.from_xml_path(str(places.CONFIGS / "robot" / "sparrow.urdf"))
    for model, name in ((mujoco.MjModel.from_xml_string(PENDULUM), "ironcub_mk1"), (fixed, "sparrow")):
        with pytest.raises(ValueError, match=rf"the model has no body `.*; .*air\.mujoco_model\('{name}'\) makes"):
            air.from_robot(model, name)

"""The symbolic derivation against itself: laws that tie its terms together, and corners of its derivatives."""

import casadi as ca
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jax_aero import rust
from jax_aero.base import places
from jax_aero.body.mujoco_model import mujoco_model
from jax_aero.symbolic import MomentumModel, load_robot
from tests.aero_kinds import OF_LINKS
from tests.measurements import measured


@pytest.fixture(scope="module", params=[name for kind, name in OF_LINKS.items() if kind != "off"])
def model(request):
    return MomentumModel(load_robot(places.ROBOT), rust.load_aero(request.param))


def draw(model, seed):
    rng = np.random.default_rng(seed)
    n = model.robot.n_joints
    limits = model.robot.joint_limits
    return {
        "base_position": rng.normal(size=3),
        "base_rotation": Rotation.random(rng=rng).as_matrix(),
        "joint_position": rng.uniform(limits[:, 0], limits[:, 1]),
        "velocity": rng.normal(size=6 + n),
        "thrust": rng.uniform(20.0, 200.0, 4),
        "wind": rng.normal(size=3) * 8.0,
    }, rng


def move_state(state, acceleration, dt):
    """The state a moment later at the same thrusts and wind, to second order in dt."""
    nu = state["velocity"]
    turn = Rotation.from_rotvec((nu[3:6] + 0.5 * dt * acceleration[3:6]) * dt).as_matrix()
    step = nu * dt + 0.5 * acceleration * dt**2
    return state | {
        "base_position": state["base_position"] + step[:3],
        "base_rotation": turn @ state["base_rotation"],
        "joint_position": state["joint_position"] + step[6:],
        "velocity": nu + acceleration * dt,
    }


@pytest.mark.close_to_tolerance("the error of the quotient: dt² L⃛/6 at joint accelerations of 1e4 rad/s²")
@pytest.mark.parametrize("seed", range(3))
def test_momentum_changes_by_the_external_wrench_alone(model, seed):
    """d(A_G ν)/dt with ν̇ from the equations of motion is L̇, whatever the joint torques do."""
    state, rng = draw(model, seed)
    terms = model.terms(**state)
    torque = np.concatenate([np.zeros(6), rng.normal(scale=20.0, size=model.robot.n_joints)])
    force = torque + terms.jet_generalised + terms.aero_generalised - terms.bias
    acceleration = np.linalg.solve(terms.mass_matrix, force)
    dt = 1e-5
    ahead, behind = (model.terms(**move_state(state, acceleration, step)).momentum for step in (dt, -dt))
    np.testing.assert_allclose((ahead - behind) / (2 * dt), terms.momentum_rate, atol=2e-4 * np.abs(torque).max())


def test_generalised_forces_hold_the_wrench_at_the_base(model):
    """Moved from the base origin to the centre of mass, the base rows of Σ Jᵀ f are the momentum rate."""
    state, _ = draw(model, 20)
    terms = model.terms(**state)
    force = terms.jet_generalised + terms.aero_generalised
    weight = model.robot.mass * model.robot.gravity
    arm = terms.com_position - state["base_position"]
    np.testing.assert_allclose(force[:3] - [0.0, 0.0, weight], terms.momentum_rate[:3], atol=1e-10)
    np.testing.assert_allclose(force[3:6] - np.cross(arm, force[:3]), terms.momentum_rate[3:], atol=1e-10)


@pytest.mark.parametrize("wind", [np.zeros(3), *(10.0 * np.eye(3)), *(-10.0 * np.eye(3))])
def test_neither_still_air_nor_wind_along_an_axis_makes_a_derivative_infinite(model, wind):
    state, _ = draw(model, 40)
    state |= {"velocity": 0 * state["velocity"], "base_rotation": np.eye(3), "wind": wind}
    if not wind.any():
        measured("force in still air [N]", np.abs(model.terms(**state).aero_force).max(), 1e-12)
    by_all = ca.jacobian(model.momentum_rate, ca.vertcat(model.tree.q, model.tree.velocity, model.wind))
    assert np.isfinite(model.function("rates", [by_all])(*state.values()).full()).all()


INERTIAL = '<inertial><mass value="{}"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="{}"/></inertial>'
COLLISION = '<collision><geometry><cylinder radius="1" length="1"/></geometry></collision>'
ODD = f"""<?xml version="1.0" encoding="ISO-8859-1"?>
<robot name="r" xmlns="urn:urdf" xmlns:sim="urn:sim"><sim:link name="b"/>
<transmission><joint name="j"/></transmission><gazebo><link name="é"/></gazebo>
<link name="b">{INERTIAL.format(2, 1)}</link><link name="é">{INERTIAL.format(0, 1)}</link>
<link name="f">{COLLISION}{INERTIAL.format(1, 3)}</link><link name="m">{COLLISION}{INERTIAL.format(1, 1)}</link>
<joint name="i" type="fixed"><parent link="b"/><child link="é"/><axis xyz="0 0 0"/></joint>
<joint name="j" type="prismatic"><parent link="é"/><child link="f"/><axis xyz="0 3 0"/></joint>
<joint name="k" type="prismatic"><parent link="f"/><child link="m"/><axis xyz="0 1 0"/>
<mimic joint="j" multiplier="-2" offset="0.3"/></joint>
</robot>"""
TOML = 'name = "r"\nurdf = "r.urdf"\nbase_link = "b"\nlocked = { j = 0.1 }\n'


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_an_odd_robot_is_read_as_the_crate_reads_it(tmp_path):
    (tmp_path / "r.toml").write_text(TOML)
    (tmp_path / "r.urdf").write_bytes(ODD.encode("iso-8859-1"))
    with pytest.warns(UserWarning, match=r"r\.urdf: (axis of joint `j`|inertia of link `[éf]`)"):
        theirs = rust.Robot(tmp_path / "r.toml")
    derived = MomentumModel(load_robot(tmp_path / "r.toml"), {"model": "off"})
    assert derived.robot.mass == theirs.mass == 4.0
    state = rust.State(np.zeros(3), np.eye(3), np.zeros(0), np.arange(6.0))
    ours, expected = derived.terms(*state, np.zeros(0), np.zeros(3)), rust.dynamics(theirs, state)
    np.testing.assert_allclose(expected.com_position, [0.0, (0.1 + 0.2) / 4.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(ours.com_position, expected.com_position, atol=1e-12)
    np.testing.assert_allclose(ours.mass_matrix, expected.mass_matrix, rtol=1e-12, atol=1e-14)
    # MuJoCo's model of it has nothing that MJX could not let collide.
    model = mujoco_model(str(tmp_path / "r.toml"))
    data, mass_matrix = mujoco.MjData(model), np.zeros((6, 6))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass_matrix)
    assert model.ngeom == 0
    np.testing.assert_allclose(mass_matrix, expected.mass_matrix, rtol=1e-12, atol=1e-14)


def test_a_robot_that_the_crate_refuses_is_refused(tmp_path):
    (tmp_path / "r.toml").write_text(TOML.replace("j = 0.1", "i = 0.1"))
    (tmp_path / "r.urdf").write_bytes(ODD.encode("iso-8859-1"))
    with pytest.raises(ValueError, match=r"r\.urdf.*type of joint `i` is fixed"):
        load_robot(tmp_path / "r.toml")


def test_an_unknown_model_of_the_air_is_refused():
    with pytest.raises(ValueError, match="`vortex` is unknown"):
        MomentumModel(load_robot(places.find("robot", "sparrow")), {"model": "vortex"})

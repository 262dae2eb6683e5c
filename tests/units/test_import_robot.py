"""A URDF becomes a robot that is described, checked, trimmed and flown by one command."""

import dataclasses
import re
import struct
import tomllib
import warnings
import xml.etree.ElementTree as ET
from itertools import product
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.base import places, plain_values
from jax_aero.base.result import FlightResult
from jax_aero.base.terminal import Refused
from jax_aero.body import mesh
from jax_aero.body.mujoco_model import mujoco_model, order_of
from jax_aero.body.robot import load_robot as load_twin
from jax_aero.body.urdf import IDENTITY, read_urdf
from jax_aero.commands import robot as command
from jax_aero.memory import Growth
from jax_aero.robot import flight, masses, scenario, shapes, skeleton
from jax_aero.symbolic import load_robot

pytestmark = pytest.mark.filterwarnings("ignore:.*(limits_deg|is a guess|guess):UserWarning")

ROBOTS = places.CONFIGS / "robot"


def binary_stl(corners):
    """One triangle for every three corners in turn."""
    triangles = [corners[i : i + 3] for i in range(len(corners) - 2)]
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *np.ravel(triangle), 0) for triangle in triangles)
    return b"\0" * 80 + struct.pack("<I", len(triangles)) + body


def ascii_stl(corners):
    """The same as text."""
    lines = ["solid box"]
    for i in range(len(corners) - 2):
        vertices = ["vertex " + " ".join(str(x) for x in corner) for corner in corners[i : i + 3]]
        lines += ["facet normal 0 0 0", "outer loop", *vertices, "endloop", "endfacet"]
    return "\n".join([*lines, "endsolid box"]).encode()


CORNERS = [tuple(map(float, corner)) for corner in product((-350, 350), (-300, 300), (-30, 30))]


@pytest.mark.close_to_tolerance("the file names lengths in tenths of a millimetre")
@pytest.mark.parametrize("stl", [binary_stl, ascii_stl])
def test_meshes_named_by_package_give_the_sizes_of_links(tmp_path, stl, agree, measured):
    """The platform with a mesh in mm in place of its cylinder: it loads, trims and hovers."""
    folder = tmp_path / "share" / "plates"
    (folder / "meshes").mkdir(parents=True)
    (folder / "meshes" / "plate.stl").write_bytes(stl(CORNERS))
    text = (ROBOTS / "platform.urdf").read_text()
    mesh = '<mesh filename="package://plates/meshes/plate.stl" scale="0.001 0.001 0.001"/>'
    (folder / "plate.urdf").write_text(text.replace('<cylinder radius="0.35" length="0.06"/>', mesh))
    jets = [command.thruster(f"nozzle_{k}:z:80") for k in range(6)]
    result = command.import_robot(folder / "plate.urdf", tmp_path / "out", jets=jets)
    link = tomllib.loads((tmp_path / "out" / "robot.toml").read_text())["aero_links"][0]
    agree("length", link["length"], 0.06, 1e-12)  # a plate's axis is its short edge
    measured("diameter", abs(link["diameter"] - np.sqrt(0.7 * 0.6)), 1e-4)
    assert np.abs(result.trim.residual).max() < 1e-6
    assert result.hover.outcome == "completed"
    files = list((tmp_path / "out").iterdir())
    assert len(files) == 3
    for path in files:
        first = path.read_text(encoding="utf-8").splitlines()[0]
        assert (path.parent / first.removeprefix("#:schema ")).is_file()
    assert result.hover.summary["max_com_error"] < 0.01


RAFT = """<robot name="raft">
  <link name="deck">
    <inertial><mass value="6"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.2"/></inertial>
  </link>
  <link name="keel">
    <inertial><origin xyz="0 0 -0.3"/><mass value="1"/>
      <inertia ixx="0.03" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.001"/></inertial>
  </link>
  <joint name="hinge" type="revolute">
    <parent link="deck"/><child link="keel"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="30" velocity="0.5"/>
  </joint>
  {nozzles}
</robot>"""
"""A deck with a keel and nozzles in its corners, without any geometry."""


def nozzle(name, place, tilt=0.0):
    """Return a nozzle on the deck that pushes upwards, tilted about y [rad]."""
    origin = f'<origin xyz="{place[0]} {place[1]} 0" rpy="0 {tilt} 0"/>'
    ends = f'<parent link="deck"/><child link="{name}"/>'
    return f'<link name="{name}"/><joint name="{name}_mount" type="fixed">{ends}{origin}</joint>'


@pytest.mark.parametrize(("tilt", "forward"), [(0.15, "x"), (-0.15, "-x")])
def test_a_robot_that_hovers_nose_up_holds_its_trim(tmp_path, tilt, forward, measured, agree):
    corners = {f"n{k}": place for k, place in enumerate(product((-0.3, 0.3), (-0.3, 0.3)))}
    nozzles = "".join(nozzle(name, place, tilt) for name, place in corners.items())
    (tmp_path / "raft.urdf").write_text(RAFT.format(nozzles=nozzles))
    jets = [skeleton.Thruster(name, "z", 40.0) for name in corners]
    urdf, out = tmp_path / "raft.urdf", tmp_path / "out"
    result = command.import_robot(urdf, out, jets=jets, forward=forward, name="my raft", fly_mission=True)
    assert result.hover.outcome == result.mission.outcome == "completed"
    measured("distance", result.hover.summary["max_com_error"], 1e-6)
    measured("rotation", result.hover.summary["max_rotation_error"], 1e-6)
    table = tomllib.loads((tmp_path / "out" / "controller.toml").read_text())
    # The force is upright where the base leans against the tilt.
    lean = np.degrees(-0.15)
    # The jets are fixed to the deck: leaning from there it would leave its place.
    agree("limits", table["setpoint"]["nose_down_limits_deg"], [lean, lean], 1e-3)
    agree("velocity", table["bounds"]["joint_velocity_max_deg"], np.degrees(0.5), 1e-9)
    assert "torque_rate_max" not in table["torque"]
    # The keel's share in the angular momentum is its inertia about the centre of mass of both.
    share = 0.03 + 6.0 / 7.0 * 0.3**2
    agree("angular momentum", table["weights"]["angular_momentum"], scenario.JOINT_MOMENTUM / share**2, 1e-6 / share**2)
    agree("momentum", table["weights"]["momentum"], 10.0 * (43.3 / 7.0) ** 2, 1e-9)
    assert [path.name for path in (tmp_path / "out").glob("*_hover.toml")] == [
        f"{places.file_name('my raft')}_hover.toml"
    ]
    assert tomllib.loads((tmp_path / "out" / "robot.toml").read_text())["name"] == "my raft"


@pytest.mark.close_to_tolerance("the files have four digits")
@pytest.mark.parametrize("name", ["observer", "mpc"])
def test_the_shipped_controllers_of_mk3_follow_from_those_of_mk1_by_the_rules(name, agree):
    config = rust.load_config("mk3_hover")
    robot, posture = load_twin(config["robot"]), np.array(config["simulator"]["initial"]["joint_position"])
    crate = rust.Robot(config["robot"])
    dynamics = rust.dynamics(crate, rust.State.at_rest(crate, posture))
    soles = ("l_sole", "r_sole")
    ruled = scenario.controller(name, robot, dynamics, leans=(0.0, 20.0), soles=soles)
    without = scenario.controller(name, robot, dynamics, leans=(0.0, 20.0), soles=())
    for law, same in ((ruled.get("mpc"), set(soles)), (without.get("mpc"), set())):
        assert law is None or set(law["clearance"]["apart_from"]) & set(soles) == same
    shipped = rust.load_controller(f"mk3_{name}")
    assert shipped["torque"].pop("torque_rate_max") == 1e4  # none, where the rules leave the robot's own: none
    ruled["aero"] = shipped["aero"]
    assert shipped["aero"]["coefficients"] == "cfd"  # fitted, in place of the estimate of an import
    numbers, expected = (numbers_of(table) for table in (shipped, ruled))
    assert numbers.keys() == expected.keys()
    for key, value in expected.items():
        if isinstance(value, float):
            agree(key, numbers[key] / (value or 1.0), 1.0 if value else 0.0, 5e-4)
        else:
            assert numbers[key] == value, key


def numbers_of(table, place=""):
    """Return the values of a table by dotted key, numbers of lists one by one."""
    found = {}
    for key, value in table.items() if isinstance(table, dict) else enumerate(table):
        inner = isinstance(value, (dict, list))
        found |= numbers_of(value, f"{place}{key}.") if inner else {f"{place}{key}": value}
    return found


def test_the_greatest_lean_is_one_that_the_torques_can_hold(monkeypatch):
    """The sparrow's arms turn two of its jets against the body, which the third is fixed to."""
    monkeypatch.setattr(flight, "LEANS", (10.0,))
    robot = load_robot(ROBOTS / "sparrow.toml")
    free = scenario.joints_of_jets(load_twin(ROBOTS / "sparrow.toml"))
    assert [robot.joint_names[joint] for joint in free] == ["waist", "l_shoulder", "r_shoulder"]
    trim = flight._trim(robot, {}, "x")
    for scale, lean in ((1.0, 10.0), (1e-3, 0.0)):
        weak = dataclasses.replace(robot, joint_torque_max=scale * robot.joint_torque_max)
        found = flight.greatest_lean(weak, free, trim.joint_position, trim.base_rpy, "x")
        assert np.degrees(found) == pytest.approx(lean)


def test_the_trim_keeps_joints_from_their_limits(tmp_path):
    """Of parallel jets none turns the raft about the vertical, so one of the six equations is redundant."""
    corners = {f"n{k}": place for k, place in enumerate(product((-0.3, 0.3), (-0.3, 0.3)))}
    nozzles = "".join(nozzle(name, place) for name, place in corners.items())
    (tmp_path / "raft.urdf").write_text(RAFT.format(nozzles=nozzles))
    jets = [skeleton.Thruster(name, "z", 40.0) for name in corners]
    result = command.import_robot(tmp_path / "raft.urdf", tmp_path / "out", jets=jets, posture_deg={"hinge": 57.0})
    assert result.trim.message == "Solve_Succeeded"
    assert 0.85 < result.trim.joint_position[0] <= 1.0 - 2.0 * flight.RESERVE  # of a range from -1 to 1


@pytest.mark.parametrize(("along", "missed"), [(0.0, None), (0.1, "moment balance along y")])
def test_one_jet_on_one_link_has_a_trim_or_the_missed_balance_is_named(tmp_path, capsys, along, missed):
    root = ET.fromstring(RAFT.format(nozzles=nozzle("n", (along, 0.0))))
    for spare in [*root.findall("link[@name='keel']"), *root.findall("joint[@name='hinge']")]:
        root.remove(spare)
    ET.ElementTree(root).write(tmp_path / "disc.urdf")
    words = [str(tmp_path / "disc.urdf"), "--jet", "n:z:90", "--out", str(tmp_path / "out")]
    assert command.main(words) == (0 if missed is None else 1)
    printed = capsys.readouterr().out
    assert ("hover                completed" if missed is None else f"{missed} missed by") in printed


def test_of_a_flight_lost_before_it_settles_no_distance_is_reported(tmp_path):
    lost = FlightResult({}, np.zeros(0), "fell", 2.0, "CoM error", {"max_com_error": np.nan, "max_rotation_error": 0.1})
    trim = SimpleNamespace(feasible=True, message="found", residual=np.zeros(6), margin=0.1, thrust=np.ones(1))
    said = flight.report(flight.ImportResult(tmp_path, trim, lost, None))
    assert "hover                fell at 2.0 s (CoM error); attitude within 5.73 deg" in said


def test_of_a_lost_flight_the_limits_that_it_reached_are_reported():
    robot = load_twin(ROBOTS / "sparrow.toml")
    torque, thrust = np.zeros((500, 5)), np.zeros((500, 3))
    torque[:150, 0] = robot.joint_torque_max[0]  # long before
    torque[400:, 2], thrust[490:, 1] = -robot.joint_torque_max[2], robot.jets.thrust_max[1]
    log = {"time": 0.01 * np.arange(500), "joint_torque": torque, "thrust": thrust}
    found = flight.limits_reached(log, robot)
    assert found == ["joint_torque at its limit: waist"]


def test_the_sparrows_urdf_becomes_a_robot_that_flies(tmp_path, capsys):
    jets = ["back_nozzle:z:100", "l_thruster:-x:100", "r_thruster:-x:100"]
    words = [str(ROBOTS / "sparrow.urdf"), "--out", str(tmp_path / "sparrow"), "--hold", "neck"]
    words += [word for jet in jets for word in ("--jet", jet)] + ["--foot", "l_sole", "--foot", "r_sole"]
    assert command.main(words) == 0
    printed = capsys.readouterr().out
    assert "Solve_Succeeded" in printed
    assert "hover                completed; CoM within 0.0 mm; attitude within 0.00 deg" in printed
    table = tomllib.loads((tmp_path / "sparrow" / "robot.toml").read_text())
    names = [joint["name"] for group in table["joint_groups"] for joint in group["joints"]]
    assert sorted(names) == ["l_hip", "l_shoulder", "r_hip", "r_shoulder", "waist"]
    assert names.index("waist") < names.index("l_shoulder")
    assert [foot["name"] for foot in table["feet"]] == ["l_sole", "r_sole"]
    assert {vertex[2] for foot in table["feet"] for vertex in foot["vertices"]} == {0.0}
    # The files are the user's: nothing is written over them.
    assert command.main(words) == 2
    assert "not empty" in capsys.readouterr().err


@pytest.mark.parametrize("stays", [True, False])
def test_a_controller_whose_copy_parts_from_it_is_warned_of(stays, tmp_path, monkeypatch):
    """Of any import; whether this one's does is measured in its hover."""
    growths = []

    def growth(config, log):
        assert len(log["time"]) == 1001
        growths.append(Growth(np.array([1.0 if stays else 1.0142 * np.exp(0.0314j)]), np.zeros(1), np.zeros(1), 0.01))
        return growths[0]

    monkeypatch.setattr(flight.memory, "growth", growth)
    jets = [command.thruster(f"nozzle_{k}:z:80") for k in range(6)]
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        result = command.import_robot(ROBOTS / "platform.urdf", tmp_path / "out", jets=jets)
    assert [result.growth] == growths
    parts = "the controller's copy parts from it: a difference grows tenfold in 1.6 s, at 0.5 Hz"
    assert any(str(one.message).startswith(parts) for one in told) == (not stays)


def test_names_may_hold_what_is_no_bare_key(tmp_path):
    """Blanks, dots, quotes, backslashes and what is no ASCII, in every name of the URDF."""
    urdf = ET.parse(ROBOTS / "sparrow.urdf")
    for element in urdf.iter():
        for key in {"name", "link"} & set(element.attrib):
            element.set(key, rf'{element.get(key)} "x".\ü')
    urdf.write(tmp_path / "odd.urdf", encoding="utf-8", xml_declaration=True)
    nozzles = [("back_nozzle", "z"), ("l_thruster", "-x"), ("r_thruster", "-x")]
    name = r'{} "x".\ü'.format
    jets = [skeleton.Thruster(name(frame), axis, 100.0) for frame, axis in nozzles]
    feet = [name("l_sole"), name("r_sole")]
    result = command.import_robot(tmp_path / "odd.urdf", tmp_path / "out", jets=jets, feet=feet, held=[name("neck")])
    assert result.hover.outcome == "completed"
    table = tomllib.loads((tmp_path / "out" / "robot.toml").read_text(encoding="utf-8"))
    assert table["locked"] == {name("neck"): 0.0}


@pytest.mark.parametrize(
    ("limit", "position"),
    [
        ('lower="-0.5" upper="0.5"', 0.0),
        ('lower="0.1" upper="0.5"', 0.1),
        ('lower="-0.5" upper="-0.1"', -0.1),
        ("", 0.0),  # no range
    ],
)
def test_a_joint_is_held_as_near_to_zero_as_it_can_be(limit, position, tmp_path):
    urdf = (ROBOTS / "sparrow.urdf").read_text().replace('lower="-0.5" upper="0.5"', limit)
    (tmp_path / "sparrow.urdf").write_text(urdf)
    (neck,) = (joint for joint in read_urdf(tmp_path / "sparrow.urdf").joints if joint.name == "neck")
    assert skeleton.nearest_zero(neck) == position


@pytest.fixture
def unflown(monkeypatch):
    """No robot is trimmed and flown."""

    def fly(path, **_):
        return flight.ImportResult(path.parent, SimpleNamespace(feasible=True), None, None)

    monkeypatch.setattr(flight, "fly", fly)


def raft(folder, *changes):
    """Return the file of a raft with one nozzle, after replacements in its text."""
    text = RAFT.format(nozzles=nozzle("n", (0.0, 0.0)))
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "raft.urdf").write_text(text)
    return folder / "raft.urdf"


LIMIT = '<limit lower="-1" upper="1" effort="30" velocity="0.5"/>'


@pytest.mark.parametrize(
    ("limit", "guesses"),
    [
        (LIMIT, {}),
        (LIMIT.replace("30", "0"), {"torque_max": 100.0}),
        (LIMIT.replace("30", "1e5"), {"torque_max": 100.0}),
        (LIMIT.replace('velocity="0.5"', ""), {"velocity_max_deg": 180.0}),
        (LIMIT.replace('upper="1"', 'upper="-1"'), {"limits_deg": [-180.0, 180.0]}),
        ("", {"limits_deg": [-180.0, 180.0], "torque_max": 100.0, "velocity_max_deg": 180.0}),
    ],
)
@pytest.mark.usefixtures("unflown")
def test_guesses_are_printed_and_marked(limit, guesses, tmp_path):
    warned, result = imported(raft(tmp_path, (LIMIT, limit)), tmp_path / "out")
    reason = "of joint `hinge` is a guess, marked (?): the URDF says nothing usable"
    found = [warning for warning in warned if "is a guess" in warning]
    assert found == [f"{key} = {plain_values.toml_value(value)} {reason}" for key, value in guesses.items()]
    assert len(warned) - len(found) == ('upper="-1"' in limit)  # the range is said to be empty
    text = (result.folder / "robot.toml").read_text()
    (entry,) = tomllib.loads(text)["joint_groups"][0]["joints"]
    assert entry == {"name": "hinge", **guesses}
    (line,) = (line for line in text.splitlines() if line.startswith("    {"))
    assert line.endswith("# (?)") == bool(guesses)


def imported(urdf, out, **options):
    """Import a robot; return the warnings, and the result."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = command.import_robot(urdf, out, jets=[skeleton.Thruster("n", "z", 90.0)], **options)
    return [str(warning.message) for warning in caught], result


@pytest.mark.usefixtures("unflown")
def test_what_of_a_urdf_is_not_used_is_printed(tmp_path):
    spare = "<gazebo/><transmission><joint/></transmission><gazebo/></robot>"
    urdf = raft(tmp_path, ("</robot>", spare), (LIMIT, f'{LIMIT}<dynamics friction="2" damping="5"/>'))
    warned, result = imported(urdf, tmp_path / "out")
    assert result.unused == {"dynamics": 1, "gazebo": 2, "transmission": 1}
    assert len(warned) == 1
    assert "<dynamics> of joint `hinge` is not used: friction up to 2, damping up to 5; a flight has" in warned[0]
    assert "simulator.motors" in warned[0]
    trim = SimpleNamespace(feasible=True, message="found", residual=np.zeros(6), margin=0.1, thrust=np.ones(1))
    said = flight.report(dataclasses.replace(result, trim=trim))
    assert said.splitlines()[-1] == "not used             1 <dynamics>, 2 <gazebo>, 1 <transmission>"


@pytest.mark.usefixtures("unflown")
def test_an_import_is_replaced_where_that_is_asked_and_nothing_else_is(tmp_path):
    urdf, out = raft(tmp_path), tmp_path / "out"
    _, result = imported(urdf, out)
    trim = SimpleNamespace(feasible=False, message="z missed", residual=np.zeros(6), margin=0.0, thrust=np.ones(1))
    said = flight.report(dataclasses.replace(result, trim=trim))
    assert "greatest thrusts 90.0 N together, the axis in --jet FRAME:AXIS:MAX" in said
    with pytest.raises(Refused, match="or --overwrite the import"):
        imported(urdf, out)
    (out / "note.txt").write_text("of the one before")
    imported(urdf, out, overwrite=True)
    assert {path.name for path in out.iterdir()} >= {"robot.toml"}
    assert not (out / "note.txt").exists()
    (out / "robot.toml").rename(out / "note.txt")
    with pytest.raises(Refused, match=r"choose another --out$"):
        imported(urdf, out, overwrite=True)


def test_what_moves_has_a_mass_or_the_option_that_helps_is_named(tmp_path):
    """A dummy link behind a joint, and one before the robot."""

    def with_dummy(parent, child):
        ends = f'<parent link="{parent}"/><child link="{child}"/>'
        joint = f'<link name="dummy"/><joint name="dj" type="revolute">{ends}{LIMIT}</joint></robot>'
        return skeleton.Tree(read_urdf(raft(tmp_path, ("</robot>", joint))))

    for tree, message in (
        (with_dummy("keel", "dummy"), r"link `dummy` has no mass, but joint `dj` moves it.* --hold dj$"),
        (with_dummy("dummy", "deck"), r"the base, link `dummy`, has no mass.* --hold dj$"),
    ):
        with pytest.raises(Refused, match=message):
            masses.require(tree, tree.moving([]))
        masses.require(tree, tree.moving(["dj"]))
    with pytest.raises(Refused, match=r"the base, link `deck`, has no mass; expected an <inertial>$"):
        masses.require(skeleton.Tree(read_urdf(raft(tmp_path, ("inertial>", "massless>")))), [])


def test_a_link_without_mass_between_two_joints_is_noted(tmp_path):
    ends = '<parent link="{}"/><child link="{}"/>'
    parts = "".join(
        f'<joint name="{name}" type="revolute">{ends.format(*link)}{LIMIT}<axis xyz="{axis}"/></joint>'
        for name, link, axis in (("pitch", ("keel", "yoke"), "0 1 0"), ("roll", ("yoke", "arm"), "1 0 0"))
    )
    mass = '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    arm = f'<link name="yoke"/><link name="arm">{mass}</link>{parts}</robot>'
    tree = skeleton.Tree(read_urdf(raft(tmp_path, ("</robot>", arm))))
    assert masses.require(tree, tree.moving([])) == ["link `yoke` has no mass: it moves with what joint `roll` carries"]


def test_a_long_chain_is_walked():
    """Which no function follows by calling itself: Python allows a thousand calls within each other."""
    names = [f"j{number}" for number in range(1500)]
    links = [f"l{number}" for number in range(1501)]
    joint = SimpleNamespace(moves=True, mimics=None)
    joints = [
        SimpleNamespace(**vars(joint), name=name, parent=parent, child=child)
        for name, parent, child in zip(names, links, links[1:], strict=False)
    ]
    tree = skeleton.Tree(SimpleNamespace(links=links, joints=joints, inertials={}))
    assert [[one.name for one in chain] for chain in tree.chains([])] == [names]
    assert [[one.name for one in chain] for chain in tree.chains(names[1:])] == [names[:1]]


BASE = '<link name="b"><inertial><origin xyz="{com}"/><mass value="8"/>{inertia}</inertial>{shape}</link>'
INERTIA = '<inertia ixx="{0}" iyy="{0}" izz="{0}" ixy="0" ixz="0" iyz="0"/>'
SHAPE = '<visual><origin xyz="1 0 0"/><geometry><box size="0.5 0.3 0.1"/></geometry></visual>'


@pytest.mark.parametrize(
    ("com", "moment", "words"),
    [
        ("1 0 0", 0.2, None),
        ("1 0 0", 8.0 * 0.58**2, None),  # twice half the diagonal of 0.592 m is the greatest radius
        ("1 0 0", 8.0 * 0.60**2, "radius of gyration of link `b` is 0.6 m .* its geometry reaches 0.3 m"),
        ("1 0 0", 2e5, "radius of gyration of link `b` is 158 m"),  # kg mm2
        ("1.55 0 0", 0.2, None),
        ("0.4 0 0", 0.2, "centre of mass of link `b` is 0.6 m from the middle of its geometry"),
        ("1000 0 0", 0.2, "centre of mass of link `b` is 999 m"),  # mm
        ("1 0 0", 3e-20, "radius of gyration of link `b` is 6.12e-11 m"),
    ],
)
def test_masses_that_geometry_contradicts_are_named(com, moment, words, tmp_path):
    def doubts(shape, rest=""):
        link = BASE.format(com=com, inertia=INERTIA.format(moment), shape=shape)
        (tmp_path / "r.urdf").write_text(f'<robot name="r">{link}{rest}</robot>')
        listing = read_urdf(tmp_path / "r.urdf")
        return masses.doubts(skeleton.Tree(listing), shapes.boxes(listing, tmp_path))

    found = doubts(SHAPE)
    assert len(found) == (words is not None)
    assert words is None or re.match(words, found[0])
    # A link without geometry is within the robot.
    mount = f'<joint name="m" type="fixed"><parent link="b"/><child link="c"/></joint><link name="c">{SHAPE}</link>'
    assert len(doubts("", mount)) == (not 1e-9 < moment < 100.0 or com.startswith("1000"))
    assert doubts("") == []  # nothing to compare with


def test_no_mass_of_the_shipped_robots_is_doubtful():
    for path in ROBOTS.glob("*.urdf"):
        listing = read_urdf(path)
        assert masses.doubts(skeleton.Tree(listing), shapes.boxes(listing, ROBOTS)) == []


@pytest.mark.usefixtures("unflown")
def test_a_posture_outside_the_limits_is_named(tmp_path):
    urdf = raft(tmp_path)
    warned, _ = imported(urdf, tmp_path / "out", posture_deg={"hinge": 500.0})
    limits = "-57.2958 to 57.2958 deg"
    assert warned == [f"--posture hinge=500 is outside its limits, {limits}: the trim starts at the nearest"]
    assert imported(urdf, tmp_path / "other", posture_deg={"hinge": 57.0})[0] == []
    with pytest.raises(Refused, match="--posture: `hinge` is no joint that moves"):
        imported(urdf, tmp_path / "third", held=["hinge"], posture_deg={"hinge": 1.0})


def test_a_robot_starts_above_the_ground(tmp_path):
    """The lowest corner of the posture zero is the keel's, 0.3 m and half its length below the deck."""
    shape = '<visual><origin xyz="0 0 -0.3"/><geometry><box size="0.1 0.1 {}"/></geometry></visual>'
    for length in (0.2, 3.0):
        urdf = raft(tmp_path, ('<link name="keel">', f'<link name="keel">{shape.format(length)}'))
        listing = read_urdf(urdf)
        lowest = skeleton.Tree(listing).lowest(shapes.boxes(listing, tmp_path))
        assert lowest == pytest.approx(-0.3 - length / 2.0, abs=1e-15)


@pytest.mark.usefixtures("unflown")
def test_meshes_that_are_missing_are_left_out_by_an_option(tmp_path):
    meshes = ("missing.stl", "odd.ply")
    (tmp_path / meshes[1]).write_text("ply")
    visuals = "".join(f'<visual><geometry><mesh filename="{mesh}"/></geometry></visual>' for mesh in meshes)
    shape = '<visual><geometry><box size="1 1 0.1"/></geometry></visual>'
    drawn = {"keel": visuals, "deck": shape}
    changes = [(opening := f'<link name="{link}">', opening + parts) for link, parts in drawn.items()]
    urdf = raft(tmp_path, *changes)
    with pytest.raises(Refused, match=r"link `keel`: mesh missing.stl: .*; --skip-meshes leaves such meshes out"):
        imported(urdf, tmp_path / "out")
    warned, result = imported(urdf, tmp_path / "out", skip_meshes=True)
    assert warned == ["left out, as if they were not there: missing.stl of link `keel`, odd.ply of link `keel`"]
    links = tomllib.loads((result.folder / "robot.toml").read_text())["aero_links"]
    assert [link["name"] for link in links] == ["deck"]


def box_of(folder, *parts):
    """Return the box of a link with some `<visual>` parts."""
    text = "".join(f"<visual>{part}</visual>" for part in parts)
    (folder / "r.urdf").write_text(f'<robot name="r"><link name="l">{text}</link></robot>')
    return shapes.boxes(read_urdf(folder / "r.urdf"), folder)["l"]


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        ('<sphere radius="0.1"/>', (0.2, 0.2, 0.2)),
        ('<cylinder radius="0.1" length="0.5"/>', (0.2, 0.2, 0.5)),
        ('<capsule radius="0.1" length="0.5"/>', (0.2, 0.2, 0.5)),
        ('<box size="0.1 0.2 0.3"/>', (0.1, 0.2, 0.3)),
    ],
)
def test_a_link_is_as_large_as_its_geometry(shape, size, tmp_path):
    part = f'<origin xyz="1 2 3"/><geometry>{shape}</geometry>'
    found = box_of(tmp_path, part)
    np.testing.assert_allclose(found.size, size)
    assert found.is_sphere == shape.startswith("<sphere")
    # With a second part, 1 m further along x, the box is around both.
    both = box_of(tmp_path, part, part.replace('"1 2', '"2 2'))
    np.testing.assert_allclose(both.size, np.add(size, (1.0, 0.0, 0.0)))
    np.testing.assert_allclose(both.pose.position, (1.5, 2.0, 3.0))


def test_a_spoilt_urdf_is_refused_by_name_and_leaves_no_file(tmp_path):
    """What is refused: `rust/io/tests/robot/refusals.rs`."""
    text = (ROBOTS / "sparrow.urdf").read_text()
    (tmp_path / "spoilt.urdf").write_text(text.replace('size="', 'size="x', 1))
    jets = [command.thruster("back_nozzle:60")]
    with pytest.raises(ValueError, match=r"spoilt\.urdf: `size` of the <box> of link `.*` is `x"):
        command.import_robot(tmp_path / "spoilt.urdf", tmp_path / "out", jets=jets)
    with pytest.raises(ValueError, match="listed more than once"):
        command.import_robot(ROBOTS / "sparrow.urdf", tmp_path / "out", jets=2 * jets)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "required: --jet"),
        (["--jet", "nozzle"], "--jet: `nozzle`; expected FRAME"),
        (["--jet", "nozzle:-z"], "--jet: `nozzle:-z`; expected FRAME"),
        (["--jet", "nozzle:-z:0.0"], "--jet: `nozzle:-z:0.0`; expected FRAME"),
        (["--jet", "nozzle:up:3"], "--jet: `nozzle:up:3`; expected FRAME"),
        (["--jet", "nozzle:z:3:left"], "--jet: `nozzle:z:3:left`; expected FRAME"),
        (["--jet", "nozzle:3", "--posture", "knee"], "--posture: `knee`; expected JOINT=DEG"),
        (["--jet", "nozzle:3", "--posture", "knee=nan"], "--posture: `knee=nan`; expected JOINT=DEG"),
    ],
)
def test_what_an_option_expects_is_said(words, message, capsys):
    with pytest.raises(SystemExit):
        command.main(["robot.urdf", *words])
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("--hold", ["knee"] * 2),
        ("--posture", ["knee=1", "knee=2"]),
        ("--foot", ["knee"] * 2),
        ("--jet", ["knee:3"] * 2),
    ],
)
def test_what_an_option_names_it_names_once(option, words, capsys):
    assert command.main(["robot.urdf", "--jet", "nozzle:3", *(part for word in words for part in (option, word))]) == 2
    assert f"error: {option} names `knee` more than once; expected each once" in capsys.readouterr().err


def test_what_is_not_there_is_refused_by_name(tmp_path):
    urdf, folder = ROBOTS / "sparrow.urdf", tmp_path / "out"
    with pytest.raises(Refused, match="`tail` is no link"):
        command.import_robot(urdf, folder, jets=[skeleton.Thruster("tail", "z", 100.0)])
    with pytest.raises(Refused, match="`nack` is no joint"):
        command.import_robot(urdf, folder, jets=[], held=["nack"])
    with pytest.raises(Refused, match=r"--posture: `nack` is no joint that moves; did you mean neck"):
        command.import_robot(urdf, folder, jets=[], posture_deg={"nack": 1.0})
    with pytest.raises(Refused, match=r"package://nowhere/a.stl: 0 files"):
        mesh.mesh_file("package://nowhere/a.stl", tmp_path)
    assert not folder.exists()


@pytest.mark.parametrize(
    ("variable", "root", "place"),
    [
        ("AMENT_PREFIX_PATH", "install", "install/share/bird/meshes/a.stl"),
        ("ROS_PACKAGE_PATH", "src", "src/bird/meshes/a.stl"),
        ("ROS_PACKAGE_PATH", "src/bird", "src/bird/meshes/a.stl"),
        ("ROS_PACKAGE_PATH", "src", "src/robots/small/bird/meshes/a.stl"),
        (None, None, "bird/meshes/a.stl"),
        (None, None, "bird-main/meshes/a.stl"),
    ],
)
def test_meshes_are_found_where_ros_keeps_packages(variable, root, place, tmp_path, monkeypatch):
    urdf, path = tmp_path / place.split("/", 1)[0] / "urdf", tmp_path / place
    for folder in (urdf, path.parent, tmp_path / "empty"):
        folder.mkdir(parents=True, exist_ok=True)
    path.touch()
    for key in ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH"):
        monkeypatch.delenv(key, raising=False)
    if variable is not None:
        monkeypatch.setenv(variable, f"{tmp_path / 'empty'}:{tmp_path / root}")
    assert mesh.mesh_file("package://bird/meshes/a.stl", urdf).resolve() == path.resolve()


MIMIC = """<link name="toe"><inertial><mass value="0.1"/>
<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
<joint name="toe" type="revolute"><parent link="head"/><child link="toe"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="5" velocity="3"/><mimic joint="LEADER" multiplier="0.5"/></joint></robot>"""


@pytest.mark.parametrize(("leader", "held"), [("waist", ["neck", "toe"]), ("neck", ["neck"]), ("waist", ["neck"])])
def test_a_mimic_joint_is_held_or_follows_a_held_one(leader, held, tmp_path):
    mimic = MIMIC.replace("LEADER", leader)
    (tmp_path / "r.urdf").write_text((ROBOTS / "sparrow.urdf").read_text().replace("</robot>", mimic))
    tree = skeleton.Tree(read_urdf(tmp_path / "r.urdf"))
    if {leader, "toe"}.isdisjoint(held):
        with pytest.raises(Refused, match=r"`toe` is a mimic of `waist`.* --hold toe;"):
            tree.with_mimics(held, hold_mimics=False)
        held = tree.with_mimics(held, hold_mimics=True)
        assert held == ["neck", "toe"]
    assert tree.with_mimics(held, hold_mimics=False) == held
    moving = {joint.name for chain in tree.chains(held) for joint in chain}
    assert moving == {"waist", "l_shoulder", "r_shoulder", "l_hip", "r_hip"}


SMALL = '<inertial><mass value="0.1"/><inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial>'


def fingers(folder, leaders):
    """A raft with fingers that follow, as pairs of joint and leader; the first of a chain moves alone."""
    parts = ""
    for name, leader in leaders.items():
        mimic = f'<mimic joint="{leader}"/>' if leader else ""
        ends = f'<parent link="keel"/><child link="{name}"/>'
        parts += f'<link name="{name}">{SMALL}</link><joint name="{name}" type="revolute">{ends}{LIMIT}{mimic}</joint>'
    return raft(folder, ("</robot>", f"{parts}</robot>"))


@pytest.mark.parametrize(
    ("leaders", "named"),
    [
        ({"a": None, "b": "a", "c": "a"}, "joints `b`, `c` are mimics of `a`;"),
        ({"a": None, "b": "a", "c": "b"}, "joint `b` is a mimic of `a`, joint `c` is a mimic of `b`;"),
        ({"a": None, "b": "a", "x": None, "y": "x"}, "joint `b` is a mimic of `a`, joint `y` is a mimic of `x`;"),
        ({"b": "c", "c": "b"}, "joint `b` is a mimic of `c`, joint `c` is a mimic of `b`;"),
    ],
)
@pytest.mark.usefixtures("unflown")
def test_every_mimic_joint_is_named_at_once_and_held_by_one_option(leaders, named, tmp_path):
    """And by the options that the refusal states."""
    urdf = fingers(tmp_path, leaders)
    with pytest.raises(Refused, match=f"^{named}") as refused:
        imported(urdf, tmp_path / "out")
    ways = str(refused.value).partition("as does ")[2].partition(";")[0].split("--hold ")[1:]
    for number, options in enumerate(({"hold_mimics": True}, {"held": [way.strip() for way in ways]})):
        _, result = imported(urdf, tmp_path / f"out{number}", **options)
        table = tomllib.loads((result.folder / "robot.toml").read_text())
        assert sorted(table["locked"]) == sorted(name for name, leader in leaders.items() if leader)
    with pytest.raises(ValueError, match="a mimic of") as refused:
        rust.Robot(unlocked(result.folder / "robot.toml"))
    if "a" in leaders:  # the crate names all too, unless they follow each other in a circle
        assert all(f"`{name}`" in str(refused.value) for name, leader in leaders.items() if leader)


def unlocked(path):
    lines = [line for line in path.read_text().splitlines() if not line.startswith("locked")]
    path.write_text("\n".join(lines))
    return path


@pytest.mark.usefixtures("unflown")
def test_what_is_missing_is_named_at_once(tmp_path):
    """Meshes, links and joints of options, and joints that move no mass."""
    visuals = "".join(f'<visual><geometry><mesh filename="{mesh}.stl"/></geometry></visual>' for mesh in "abc")
    urdf = raft(tmp_path, ('<link name="keel">', f'<link name="keel">{visuals}'))
    more = r"link `keel`: mesh a.stl: .*; --skip-meshes .*; the same for 2 more: b.stl of link `keel`, c.stl of link "
    with pytest.raises(Refused, match=more):
        imported(urdf, tmp_path / "out")
    tree = skeleton.Tree(read_urdf(urdf))
    unknown = r"^--jet: `x` is no link .*, `y` is no link .*; --foot: `z` is no link .*; --hold: `w` is no joint"
    with pytest.raises(Refused, match=unknown):
        tree.check_frames(["x", "y"], ["z"], ["w"])
    ends = '<parent link="keel"/><child link="{0}"/>'
    idle = "".join(
        f'<link name="{name}"/><joint name="to_{name}" type="revolute">{ends.format(name)}{LIMIT}</joint>'
        for name in "pq"
    )
    tree = skeleton.Tree(read_urdf(raft(tmp_path, ("</robot>", f"{idle}</robot>"))))
    said = (
        r"^link `p` has no mass, but joint `to_p` moves it, link `q` .* `to_q` moves it; .*: --hold to_p --hold to_q$"
    )
    with pytest.raises(Refused, match=said):
        masses.require(tree, tree.moving([]))


@pytest.mark.parametrize(
    ("kind", "limit", "axis", "is_named"),
    [
        ("continuous", "", "0 0 1", True),
        ("continuous", "", "0 0 -1", True),
        ("revolute", '<limit effort="1" velocity="100"/>', "0 0 1", True),  # without range
        ("continuous", "", "1 0 0", False),  # a gimbal
        ("revolute", LIMIT, "0 0 1", False),
    ],
)
def test_rotors_that_spin_are_to_be_held(kind, limit, axis, is_named, tmp_path):
    """One behind a fixed joint that turns its axes by a quarter about the spin, and one behind another link."""
    parts = ""
    for k in (1, 2):
        ends = f'<parent link="keel"/><child link="hub_{k}"/><axis xyz="{axis}"/>{limit}'
        parts += f'<link name="hub_{k}">{SMALL}</link><joint name="spin_{k}" type="{kind}">{ends}</joint>'
        ends = f'<origin rpy="0 0 1.5707963"/><parent link="hub_{k}"/><child link="rotor_{k}"/>'
        parts += f'<link name="rotor_{k}"/><joint name="on_{k}" type="fixed">{ends}</joint>'
    tree = skeleton.Tree(read_urdf(raft(tmp_path, ("</robot>", f"{parts}</robot>"))))
    jets = [command.thruster(f"rotor_{k}:z:20:0.01") for k in (1, 2)]
    found = tree.spinning(jets, [])
    expected = "joints `spin_1`, `spin_2` turn jets about their axes without limits, as rotors spin: "
    assert [warning.startswith(expected) for warning in found] == [True] * is_named
    assert tree.spinning(jets, ["spin_1", "spin_2"]) == []


def test_a_refusal_of_a_robot_whose_rotors_spin_says_what_helps(tmp_path):
    """Of a quadrotor: its rotors' moments are so small that a weight of the controller has no range for them."""
    hub = '<inertial><mass value="0.01"/><inertia ixx="1e-5" iyy="1e-5" izz="2e-5" ixy="0" ixz="0" iyz="0"/></inertial>'
    body, parts = hub.replace("0.01", "1.0").replace("e-5", "e-2"), ""
    for k, place in enumerate(("0.2 0.2", "-0.2 0.2", "-0.2 -0.2", "0.2 -0.2")):
        ends = f'<parent link="body"/><child link="rotor_{k}"/><origin xyz="{place} 0.05"/><axis xyz="0 0 1"/>'
        parts += f'<link name="rotor_{k}">{hub}</link><joint name="spin_{k}" type="continuous">{ends}</joint>'
    box = '<visual><geometry><box size="0.3 0.3 0.1"/></geometry></visual>'
    urdf = tmp_path / "quad.urdf"
    urdf.write_text(f'<robot name="quad"><link name="body">{body}{box}</link>{parts}</robot>')
    jets = [command.thruster(f"rotor_{k}:z:8:{moment}") for k, moment in enumerate(("0.02", "-0.02") * 2)]
    held = "angular_momentum.* --hold spin_0 --hold spin_1 --hold spin_2 --hold spin_3"
    with pytest.warns(UserWarning, match="as rotors spin"), pytest.raises(Refused, match=held):
        command.import_robot(urdf, tmp_path / "quad", jets=jets)


@pytest.mark.parametrize("moment", [0.0, 0.2, -0.2])
def test_gimbals_hold_the_reaction_torques_of_rotors(tmp_path, moment, measured):
    """Four rotors that all turn the same way would turn the robot; tilted along the sides of its square they do not."""
    jets = [command.thruster(f"rotor_{k}:z:20:{moment}") for k in range(1, 5)]
    posture = {"joint_1": -75.0, "joint_2": 75.0, "joint_3": 75.0}
    found = command.import_robot(ROBOTS / "chain.urdf", tmp_path / "out", jets=jets, posture_deg=posture)
    assert found.hover.summary["max_com_error"] < 1e-3
    assert found.hover.summary["max_rotation_error"] < 0.1
    arrays = rust.Robot(tmp_path / "out" / "robot.toml").arrays()
    assert set(arrays["jets"]["torque_to_thrust"]) == {moment}

    path, flown = str(tmp_path / "out" / "robot.toml"), found.hover
    model = mujoco_model(path)
    data = mujoco.MjData(model)
    data.qpos[:3], data.qpos[3:7] = flown["base_position"][0], flown["base_quaternion"][0]
    data.qpos[order_of(path, tuple(rust.Robot(path).joint_names)).joints] = flown["joint_position"][0]
    mujoco.mj_fwdPosition(model, data)
    force, about_com = np.zeros(3), np.zeros(3)
    for k, thrust in enumerate(found.hover["thrust"][0], start=1):
        site = model.site(f"jet_rotor_{k}").id
        axis = thrust * data.site_xmat[site].reshape(3, 3)[:, 2]
        force += axis
        about_com += np.cross(data.site_xpos[site] - data.subtree_com[0], axis) + moment * axis
    # Sums of some 10 products of numbers below 50, and the tolerance of the trim's solver.
    measured("force [N]", np.abs(force - [0.0, 0.0, 9.81 * model.body_subtreemass[0]]).max(), 1e-9)
    measured("moment [N m]", np.abs(about_com).max(), 1e-9)


def test_every_greatest_thrust_has_an_engine_of_its_own():
    thrusts = [25.5, 1e6, 100.0, 100.00000001]
    table = tomllib.loads("\n".join(skeleton._jets([skeleton.Thruster(f"n{t}", "z", t) for t in thrusts])))
    found = [table["engines"][jet["engine"]]["b_u"] for jet in table["jets"]]
    assert found == [0.09 * thrust for thrust in thrusts]


def test_force_areas_are_those_of_cylinders_and_spheres():
    """Drag coefficients of 0.8 along the axis and of 1 across it, a third of the side for the normal force; 0.5."""
    disc = 0.25 * np.pi * 0.1**2
    rod, ball = (skeleton._areas("a", shapes.Box(IDENTITY, np.array([0.1, 0.1, z]))) for z in (0.6, 0.1))
    along, across = 0.8 * disc, 0.1 * 0.6
    assert rod == f"a = {{ cda = [{along:.4g}, 0.0, {across - along:.4g}, 0.0, 0.0], cna = {across / 3.0:.4g} }}"
    assert ball == f"a = {{ cda = [{0.5 * disc:.4g}, 0.0, 0.0, 0.0, 0.0], cna = 0.0 }}"

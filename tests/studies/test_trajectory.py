"""A small optimal flight, planned, exported and flown; the full ones take a minute each and are experiments."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import msgspec
import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

from experiments.studies.trajectory import figure
from experiments.studies.trajectory import study as experiment
from jax_aero import rust
from jax_aero.base import places, tables
from jax_aero.base.terminal import Refused
from jax_aero.figures.catalogue import FIGURES
from jax_aero.results import study
from jax_aero.robot import waypoints
from jax_aero.symbolic import load_robot, trajectory
from jax_aero.symbolic.trajectory import TrajectoryProblem, _lagrange, _lagrange_derivatives, _radau_weights

ROOT = Path(__file__).resolve().parents[2]
PATH = ROOT / "experiments/studies/trajectory/min_time.toml"


@pytest.fixture(scope="module")
def base():
    return rust.load_config("test2", {"wind.velocity": [0.0, -4.0, 0.0]})


@pytest.fixture(scope="module")
def climb(base):
    """Two metres up in a breeze from the side, on few points."""
    changes = {
        "end": [-0.00365, 0.00041, 2.751881],
        "free_groups": ["left_arm", "right_arm"],
        "duration_range": [2.0, 6.0],
        "intervals": 5,
        "degree": 2,
    }
    config = tables.load(PATH, trajectory.TrajectoryConfig, changes)
    robot = load_robot(base["robot"])
    return experiment.problem_of(config, base, robot)


@pytest.fixture(scope="module")
def plan(climb):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trajectory, "SMOOTHER", 1.0)  # one valley is enough here
        return climb.solve()


@pytest.mark.slow
def test_it_goes_where_it_was_sent_and_rests_there(climb, plan):
    config = climb.config
    assert plan.success, plan.message
    for sample, place in ((0, config.start), (-1, config.end)):
        np.testing.assert_allclose(plan.com[sample, 0], place, atol=1e-6)
        np.testing.assert_allclose(plan.com[sample, 1:3], 0.0, atol=1e-5)
        np.testing.assert_allclose(plan.base_rpy[sample], [0.0, 0.0, np.radians(config.yaw_deg)], atol=1e-6)
    assert config.duration_range.lower < plan.duration < config.duration_range.upper


def test_limits_hold(climb, plan):
    config = climb.config
    top = np.array([jet.thrust_max for jet in climb.model.robot.jets])
    slack = 1e-3  # between the points where they are imposed
    least = np.array([jet.thrust_min for jet in climb.model.robot.jets])
    assert (plan.thrust >= least + config.thrust_reserve * top - slack * top).all()
    assert (plan.thrust <= (1 - config.thrust_reserve) * top + slack * top).all()
    assert np.abs(plan.thrust_rate).max() <= config.thrust_rate_max + 1e-6
    assert np.abs(plan.joint_velocity).max() <= np.radians(config.joint_velocity_max_deg) + 1e-6
    held = np.setdiff1d(np.arange(23), climb.free_joints)
    np.testing.assert_array_equal(plan.joint_position[:, held], np.tile(climb.posture[held], (plan.time.size, 1)))


def test_velocity_acceleration_and_jerk_belong_together(plan):
    """Sampled from different expressions: polynomials, the momentum balance, its derivative."""
    dt = plan.time[1]
    for order, tolerance in ((0, 0.05), (1, 0.15), (2, 0.3)):
        slope = np.gradient(plan.com[:, order], dt, axis=0)[2:-2]
        error = np.abs(slope - plan.com[2:-2, order + 1])
        assert np.median(error) < tolerance * np.abs(plan.com[:, order + 1]).max()


def test_the_acceleration_is_what_the_crate_says(climb, plan, base):
    """The centroidal model, at its planned states, against the momentum rate of the Rust crate."""
    controller = rust.Controller(base)
    robot = rust.Robot(base["robot"])
    for sample in np.linspace(0, plan.time.size - 1, 7).astype(int):
        rotation = Rotation.from_euler("xyz", plan.base_rpy[sample]).as_matrix()
        joints = plan.joint_position[sample]
        velocity = np.concatenate([np.zeros(6), plan.joint_velocity[sample]])
        found = rust.dynamics(robot, rust.State(np.zeros(3), rotation, joints, velocity))
        spin = np.linalg.solve(found.centroidal_inertia, plan.angular_momentum[sample] - found.momentum[3:])
        velocity[3:6] = spin
        found = rust.dynamics(robot, rust.State(np.zeros(3), rotation, joints, velocity))
        velocity[:3] = plan.com[sample, 1] - found.momentum[:3] / robot.mass
        state = rust.State(np.zeros(3), rotation, joints, velocity)
        tick = controller.tick(state, plan.thrust[sample], climb.wind)
        np.testing.assert_allclose(tick.momentum[:3] / robot.mass, plan.com[sample, 1], atol=1e-9)
        np.testing.assert_allclose(tick.momentum[3:], plan.angular_momentum[sample], atol=1e-9)
        np.testing.assert_allclose(tick.momentum_rate_estimate[:3] / robot.mass, plan.com[sample, 2], atol=1e-8)


@pytest.mark.close_to_tolerance("the loop follows the reference with an error of its own, a physical figure")
def test_the_exported_reference_flies_in_closed_loop(climb, plan, base):
    text = experiment.csv_of(plan, 10.0, "a test")
    assert text.splitlines()[1] == waypoints.COLUMNS
    flight = experiment.fly(base, text, 10.0 + plan.duration + 3.0)
    assert flight.outcome == "completed"
    error = np.linalg.norm(flight.log["com_position"] - flight.log["com_setpoint"], axis=1)
    assert error[flight.log["time"] > 3.0].max() < 0.2  # the points are few; the experiments' plans are flown to 3 cm
    np.testing.assert_allclose(flight.log["com_position"][-1], climb.config.end, atol=5e-3)


def test_what_cannot_be_is_said_with_the_constraint(climb):
    """Upright in the paper's posture the robot cannot hover: without joints to move there is no start."""
    config = msgspec.structs.replace(climb.config, intervals=2)
    answer = TrajectoryProblem(climb.model, config, climb.wind, climb.posture, ()).solve()
    assert not answer.success
    assert "missed by" in answer.message
    assert "equilibrium" in answer.message or "dynamics" in answer.message


def test_fuel_is_the_line_through_idle_and_full_thrust(base):
    robot = load_robot(base["robot"])
    idle, slope = trajectory.fuel_lines(
        trajectory.load_fuel(tables.load(PATH, trajectory.TrajectoryConfig).fuel), robot
    )
    arm, chest = 60 * (idle[0] + slope[0] * np.array([2.0, 100.0])), 60 * (idle[2] + slope[2] * np.array([9.0, 220.0]))
    np.testing.assert_allclose([*arm, *chest], [0.08, 0.39, 0.13, 0.725])


def test_a_jet_without_consumption_is_refused(base):
    robot = load_robot(base["robot"])
    fuel = trajectory.load_fuel(ROOT / "configs/tables/fuel.toml")
    with pytest.raises(Refused, match=r"`fuel` has l_arm_jet, .*; expected one table for each jet"):
        trajectory.fuel_lines({name: line for name, line in fuel.items() if name != "r_arm_jet"}, robot)


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_collocation_is_exact_for_polynomials(degree):
    points = np.array([0.0, *ca.collocation_points(degree, "radau")])
    values = np.polynomial.polynomial.polyvander(points, degree)
    slopes = np.array([[k * p ** (k - 1) if k else 0.0 for p in points] for k in range(degree + 1)])
    np.testing.assert_allclose(values.T @ _lagrange_derivatives(points), slopes, atol=1e-10)
    np.testing.assert_allclose(values.T @ _lagrange(points, 0.3), 0.3 ** np.arange(degree + 1), atol=1e-12)
    powers = values[1:, :degree]
    np.testing.assert_allclose(powers.T @ _radau_weights(points), 1.0 / np.arange(1, degree + 1), atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('goal = "min_time"', 'goal = "min_noise"', '`goal` is "min_noise"; expected one of min_fuel, min_time'),
        ("intervals = 10", "intervals = 10.5", "`intervals` is 10.5; expected an integer"),
        ('"torso", ', '"tail", ', "free_groups names `tail`"),
    ],
)
def test_a_configuration_that_cannot_be_meant_is_refused(tmp_path, old, new, complaint):
    text = PATH.read_text()
    assert old in text
    path = tmp_path / "odd.toml"
    path.write_text(text.replace("../../../jax_aero", str(ROOT / "jax_aero")).replace(old, new))
    with pytest.raises(Refused, match=complaint):
        experiment.STUDY.run(str(path))


def test_without_a_trajectory_nothing_is_flown(monkeypatch):
    unsolved = SimpleNamespace(success=False, message="Infeasible_Problem_Detected")
    monkeypatch.setattr(experiment, "TrajectoryProblem", lambda *_: SimpleNamespace(solve=lambda: unsolved))
    with pytest.raises(Refused, match="min_time: no trajectory found: Infeasible"):
        experiment.STUDY.run("min_time")


def test_the_result_names_its_reference_and_its_flights(tmp_path, monkeypatch, climb, plan):
    rest = np.tile(plan.com[-1:, 0], (3, 1))
    log = {
        "time": np.array([10.0, 11.0, 30.0]),
        "com_position": rest,
        "com_velocity": np.zeros((3, 3)),
        "com_setpoint": rest,
        "base_rpy_setpoint": np.zeros((3, 3)),
        "thrust": np.full((3, 4), 100.0),
        "rotation_error": np.zeros(3),
    }
    flight = rust.FlightResult(log, np.zeros(23), "completed", None, None, {})
    dataset = experiment.to_dataset(plan, flight, flight, climb.model.robot, climb.config)
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    findings = study.Findings("Small", dataset, {"a figure": np.inf}, texts={"reference.csv": "time\n"})

    def compute(*_):
        return findings

    compute.__module__ = experiment.__name__  # whose code the manifest names
    small = replace(experiment.STUDY, compute=compute)
    document = small.run("min_time", {"speed_max": 3.0})
    changed = tmp_path / "trajectory" / "min_time--speed_max=3.0"
    assert sorted(path.name for path in changed.iterdir()) == ["manifest.json", "reference.csv", "run.nc"]
    assert document["summary"] == {"a figure": None}
    assert document["name"] == changed.name
    assert document["command"] == "jax-aero study trajectory min_time --set speed_max=3.0"
    assert document["config"]["speed_max"] == 3.0
    read = xr.load_dataset(changed / "run.nc", engine="h5netcdf")
    assert read["com_position_plan"].attrs["units"] == "m"
    again, other = small.run("min_time", {"speed_max": 3.0}), small.run("min_time")
    assert read.attrs["config_hash"] == document["config_digest"] == again["config_digest"]
    assert other["config_digest"] != document["config_digest"]
    folder = changed.with_name("min_time")
    before = {path: path.read_bytes() for path in sorted(folder.iterdir())}
    small.run("min_time", {"speed_max": 2.0})
    assert {path: path.read_bytes() for path in sorted(folder.iterdir())} == before
    _, hashes = FIGURES["trajectory"].draw_from_results(tmp_path, ("min_time",))
    assert set(hashes) == {"min_time"}
    found = experiment.figures("flown", dataset, "flown")
    assert found["flown: peak CoM error [m]"] == 0.0
    # One that is away from the end when its log ends does not arrive, and has all its thrusts.
    log["com_position"] = rest + np.array([[0.0], [0.0], [1.0]])
    astray = experiment.to_dataset(plan, flight, flight, climb.model.robot, climb.config)
    found = experiment.figures("flown", astray, "flown")
    assert np.isnan([found["flown: arrives within 5 cm after [s]"], found["flown: fuel until then [l]"]]).all()
    assert found["flown: thrusts [N]"] == "100.0 to 100.0"
    FIGURES["trajectory"].draw(astray.assign_attrs(title="Small", name="min_time"))


@pytest.mark.parametrize(("studies", "jets"), [(1, 6), (2, 4), (3, 3)])
def test_planned_flights_show_every_jet_of_every_study(studies, jets):
    time, names = np.arange(3.0), [f"jet_{number}" for number in range(jets)]
    variables = {}
    for of in ("paper", "flown", "plan"):
        vectors = ((f"time_{of}", "xyz"), np.ones((3, 3)))
        variables |= {f"com_position_{of}": vectors, f"com_velocity_{of}": vectors}
        variables |= {f"base_rpy_{of}": ((f"time_{of}", "rpy"), np.zeros((3, 3)))}
        variables |= {f"{name}_{of}": (f"time_{of}", time) for name in ("fuel", "com_error")}
        variables |= {f"thrust_{of}": ((f"time_{of}", "jet"), np.ones((3, jets)))}
    coords = {f"time_{of}": time for of in ("paper", "flown", "plan")} | {"jet": names, "xyz": list("xyz")}
    coords |= {"rpy": ["roll", "pitch", "yaw"]}
    attributes = {"name": "made_up", "title": "Made up", "arrival_paper": 2.0, "arrival_flown": 1.0}
    drawn = figure.draw(*[xr.Dataset(variables, coords, attributes)] * studies)
    assert [len(axes.lines) for axes in drawn.axes[6:]] == [2 * jets] * studies
    assert len({line.get_color() for line in drawn.axes[6].lines}) == jets

"""The Python face of the crate, with short flights."""

import signal
import subprocess
import sys
import threading

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jax_aero import __main__ as commands
from jax_aero import rust
from jax_aero.base import tables
from jax_aero.base.places import CONFIGS, HOME, ROBOT
from jax_aero.base.terminal import ConfigError

TEST2 = HOME / "configs" / "experiments" / "test2.toml"
SHORT = {"simulator.duration": 1.0}


def test_changes_are_judged_together():
    ramp = {"wind.ramp_start": 12.0, "wind.ramp_end": 20.0}
    assert rust.load_config(TEST2, ramp)["wind"]["ramp_start"] == 12.0
    with pytest.raises(ValueError, match=r"wind\.ramp_start"):
        rust.load_config(TEST2, {"wind.ramp_start": 12.0})


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        (np.float64, "is a type; expected a number, text"),
        (1 + 2j, "is a complex; expected"),
        (float("nan"), "`simulator.duration` is NaN; expected a finite number"),
    ],
)
def test_a_value_no_file_could_hold_is_refused(value, reason):
    with pytest.raises(ValueError, match=reason):
        rust.load_config(TEST2, {"simulator.duration": value})


def test_a_configuration_is_checked_once_on_its_way_to_a_flight(tmp_path):
    """What was read from a file is checked; another check of the same reads nothing."""
    config = rust.load_config("test2", {"simulator.duration": 1.0})
    own = tmp_path / "mk1.toml"
    own.write_text(ROBOT.read_text().replace('urdf = "', f'urdf = "{ROBOT.parent}/'))
    mine = rust.load_config("test2", {"robot": own})
    own.unlink()
    rust.check_config(mine)
    rust.check_config(config)
    with pytest.raises(ConfigError, match=r"cannot read .*mk1\.toml"):
        rust.check_config(mine)


def test_what_runs_on_board_names_no_simulator():
    """The experiment that embeds it has the same controller."""
    alone, flown = rust.load_onboard("robot"), rust.load_config("robot")
    assert alone.keys() == {"robot", "controller", "mission"}
    assert alone == {key: flown[key] for key in alone}
    state = rust.State(
        np.array([0.0, 0.0, 0.8]), np.eye(3), flown["simulator"]["initial"]["joint_position"], np.zeros(29)
    )
    ticks = [rust.Controller(one).tick(state, [98.0] * 4, np.zeros(3)) for one in (alone, flown)]
    np.testing.assert_array_equal(*(tick.joint_torque for tick in ticks))
    with pytest.raises(ValueError, match="unknown key `wind`"):
        rust.Controller({**alone, "wind": flown["wind"]})


def test_an_exception_in_the_progress_callback_ends_the_flight():
    def stop(tick, n_ticks):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rust.fly(rust.load_config(TEST2), stop)


@pytest.mark.parametrize("threads", [0, -1])
def test_a_number_of_threads_is_positive(threads):
    with pytest.raises(ValueError, match=rf"`threads` is {threads}; expected at least 1"):
        rust.fly_batch([rust.load_config(TEST2, SHORT)], threads)


def test_a_command_is_replaced_after_a_tick_and_by_numbers():
    config = rust.load_config(TEST2)
    now, controller = rust.Flight(config).truth, rust.Controller(config)
    with pytest.raises(ValueError, match="no flight has begun"):
        controller.replace_command(np.zeros(4), np.zeros(23))
    controller.tick(now.state, now.thrust, now.wind, now.time)
    before = controller.state
    with pytest.raises(ValueError, match="thrust_rate"):
        controller.replace_command(np.zeros(3), np.zeros(23))
    for torque in (np.nan, 1e3):
        with pytest.raises(ValueError, match="expected for every joint of this robot a torque of at most twice its"):
            controller.replace_command(np.zeros(4), np.full(23, torque))
    assert controller.state == before
    controller.replace_command(np.zeros(4), np.zeros(23))
    assert controller.state != before


def test_a_table_is_refused_by_key_and_a_time_that_is_not_finite():
    robot, still = rust.Robot(HOME / "configs/robot/ironcub_mk1.toml"), np.zeros((13, 3))
    with pytest.raises(ValueError, match=r"^wind: `velocity` is \[1.0,2.0\]; expected a list of 3$"):
        rust.wind_velocity({"profile": "constant", "velocity": [1.0, 2.0]}, [0.0])
    with pytest.raises(ValueError, match=r"^`times` is NaN; expected finite numbers"):
        rust.wind_velocity({"profile": "constant", "velocity": [1.0, 2.0, 3.0]}, [0.0, np.nan])
    with pytest.raises(ValueError, match=r'^aero: `air_density` is "thin"; expected a number > 0$'):
        rust.aero_forces(
            robot, {"model": "axisymmetric", "coefficients": "published", "air_density": "thin"}, still, still
        )


def test_setpoints_begin_where_a_robot_can_be_and_are_not_endless():
    config = rust.load_config(TEST2, SHORT)
    with pytest.raises(ValueError, match=r"^`com` is NaN; expected finite numbers"):
        rust.setpoint_trajectory(config, [np.nan, 0.0, 0.0], np.eye(3))
    with pytest.raises(ValueError, match=r"^`rotation` deviates from a rotation by"):
        rust.setpoint_trajectory(config, np.zeros(3), 2.0 * np.eye(3))
    config["simulator"]["duration"] = 1e9
    with pytest.raises(ValueError, match="is 100000000000; expected at most ten million ticks"):
        rust.setpoint_trajectory(config, np.zeros(3), np.eye(3))


def test_a_state_without_feet_is_ignored():
    flying, standing = (rust.Controller(rust.load_config(name)) for name in ("test2", "balancing_front"))
    now = rust.Flight(rust.load_config(TEST2)).truth
    flying.tick(now.state, now.thrust, now.wind, now.time)
    standing.state = flying.state
    assert standing.tick(now.state, now.thrust, now.wind, now.time).degraded_modes == ["state_ignored"]


def test_other_threads_run_while_a_flight_is_under_way():
    """The crate gives the interpreter away, so a flight in one thread does not hold up another."""
    config = rust.load_config(TEST2)
    thread = threading.Thread(target=rust.fly, args=(config,))
    thread.start()
    turns = 0
    while thread.is_alive():
        turns += 1
    thread.join()
    assert turns > 1000


LONG_CALL = """
import sys
from jax_aero import rust

def flying(done, total):
    print("flying", flush=True)

config = rust.load_config("configs/experiments/no_wind.toml", {"simulator.duration": 2000.0})
if sys.argv[1] == "batch":
    rust.fly_batch([config] * 20, threads=1, progress=flying)
else:
    rust.fly(config, flying)
"""


@pytest.mark.parametrize("call", ["batch", "single"])
def test_ctrl_c_ends_a_long_call_at_once(call, start):
    """The interrupt arrives while Rust flies with the interpreter lock released."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = start(sys.executable, "-c", LONG_CALL, call, cwd=HOME, **pipes)
    assert process.stdout.readline() == "flying\n"
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode != 0
    assert "KeyboardInterrupt" in errors


SEEN = {"simulator.duration": 0.2, "wind.ramp_start": 0.0, "wind.ramp_end": 0.1, "simulator.sensors.seed": 3}


def same(flight, other):
    """Whether two flights have the same bits."""
    figures = [list(one.summary.values()) for one in (flight, other)]
    is_ending = (flight.outcome, flight.lost_time) == (other.outcome, other.lost_time)
    is_ending &= np.array_equal(*figures, equal_nan=True)
    return is_ending and all(np.array_equal(flight[name], other[name], equal_nan=True) for name in other.log)


def test_a_flight_tick_by_tick_is_the_flight():
    """With sensors, an outage and a delay: whatever is looked at in between, every bit is the same."""
    lost = {"channel": "base_position", "start": 0.1, "kind": "missing"}
    changes = SEEN | {"simulator.substeps": 2, "simulator.actuation": {"torque_delay": 0.005}}
    config = rust.load_config("test2_sensors", changes | {"disturbances.outages": [lost]})
    config["simulator"]["fall"]["com_error"] = 100.0
    whole, flight = rust.fly(config), rust.Flight(config)
    assert flight.n_ticks == 20
    for tick, time in enumerate(whole["time"]):
        assert (flight.tick, flight.truth.time, flight.has_ended) == (tick, time, False)
        assert np.array_equal(flight.truth.state.base_position, whole["base_position"][tick])
        assert np.array_equal(flight.truth.wind, whole["wind"][tick])
        seen = flight.measurement
        assert np.array_equal(seen.thrust, whole["raw_thrust"][tick])
        assert np.array_equal(seen.state.base_position, whole["raw_base_position"][tick], equal_nan=True)
        tried = flight.try_tick()
        assert np.array_equal(tried.setpoint.com_position, whole["com_setpoint"][tick])
        assert flight.step()
        assert np.array_equal(flight.last.joint_torque, tried.joint_torque)
        assert np.array_equal(flight.last.joint_torque, whole["joint_torque"][tick])
    assert flight.has_ended
    assert not flight.step()
    assert same(flight.result(), whole)
    reports = []
    assert same(rust.Flight(config).run(lambda *report: reports.append(report)), whole)
    assert reports == [(tick, 20) for tick in range(21)]


def test_a_flight_that_cannot_begin_says_why():
    """As a whole and tick by tick."""
    wrong = {"channel": "joints", "start": 0.0, "duration": 0.01, "kind": "wrong", "error": 6.0}
    config = rust.load_config("test2_observer", {"simulator.duration": 0.1, "disturbances.outages": [wrong]})
    for begin in (rust.fly, lambda config: rust.Flight(config).step(), lambda config: rust.Flight(config).try_tick()):
        with pytest.raises(ValueError, match=r"^a flight cannot begin: `joint_position\[0\]` holds "):
            begin(config)


def test_what_is_handed_in_as_the_flight_has_it_changes_nothing():
    """Its own measurement, its own command, the own forces of its air."""
    config = rust.load_config("test2_sensors", SEEN | {"simulator.substeps": 1})
    whole, flight, other = rust.fly(config), rust.Flight(config), rust.Controller(config)

    def command(seen):
        tick = other.tick(seen.state, seen.thrust, seen.wind, seen.time)
        return rust.Command(tick.thrust_rate, tick.joint_torque)

    for forces in whole["aero_force_sim"]:
        flight.step(measurement=flight.measurement, link_forces=forces)
    assert same(flight.result(), whole)
    assert same(rust.Flight(config, controller=command).run(), whole)


def test_a_residual_is_flown_within_its_bounds():
    config = rust.load_config(TEST2, {"simulator.duration": 0.1})
    flights = rust.Flight(config), rust.Flight(config)
    for _ in range(10):
        flights[0].step()
        flights[1].step(residual=rust.Residual([5.0, 0.0, 0.0, 0.0], np.zeros(23)))
    added = flights[1].last.thrust_rate - flights[0].last.thrust_rate
    assert flights[1].last.residual[0] == 5.0
    assert added[0] > 1.0
    assert np.any(flights[1].residual_wrench)
    assert not np.any(flights[0].residual_wrench)


def test_a_controller_of_ones_own():
    """It keeps height by thrust alone; without it the robot falls 0.1 m in that time. The log has what acts."""
    config = rust.load_config("no_wind", {"simulator.duration": 0.14})
    robot, commanded, followed = rust.Robot(config["robot"]), [], []

    def keep_height(seen):
        dynamics = rust.dynamics(robot, seen.state)
        climb = 900.0 * (height - dynamics.com_position[2]) - 60.0 * dynamics.momentum[2] / robot.mass
        wanted = seen.thrust * robot.mass * (robot.gravity + climb) / seen.thrust.sum()
        commanded.append((wanted - seen.thrust) / 0.05)
        followed.append(seen.setpoint.com_position)
        return rust.Command(commanded[-1], np.zeros(23))

    flight = rust.Flight(config, controller=keep_height)
    height = rust.dynamics(robot, flight.truth.state).com_position[2]
    log = flight.run().log
    assert np.abs(log["com_position"][:, 2] - height).max() < 0.02
    assert np.array_equal(log["thrust_rate"], commanded)
    assert np.array_equal(log["com_setpoint"], followed)
    assert not log["joint_torque"].any()


OWN = """
from dataclasses import dataclass
from constants import PUSH

@dataclass
class Same:
    config: dict

    def __call__(self, seen):
        return [PUSH] * 4, [0.0] * len(seen.state.joint_position)

def late(seen):
    return None if seen.time > 0.03 else Same({})(seen)
"""


@pytest.fixture
def own(tmp_path):
    (tmp_path / "own.py").write_text(OWN, encoding="utf-8")
    (tmp_path / "constants.py").write_text("PUSH = 2.0", encoding="utf-8")

    def config(name, **changes):
        table = {"file": str(tmp_path / "own.py"), "name": name}
        return rust.load_config("no_wind", {"simulator.duration": 0.05, "own_controller": table, **changes})

    return config


def test_a_flight_s_file_names_a_controller_of_ones_own(own, tmp_path):
    config = own("Same")
    assert (rust.fly(config)["thrust_rate"] == 2.0).all()
    flown = rust.fly_batch([config, config | {"own_controller": None}])
    assert [flight.outcome for flight in flown] == ["completed", "completed"]
    digest = rust.config_digest(config)
    (tmp_path / "own.py").write_text(OWN.replace("0.03", "0.04"), encoding="utf-8")
    assert rust.config_digest(config) != digest


def test_one_command_flies_a_controller_of_ones_own_beside_a_shipped_one(own, tmp_path, capsys):
    own("Same")  # writes the file
    words = ["fly", "no_wind", "--set", "simulator.duration=0.05", "--out", str(tmp_path / "out")]
    mine = ["--controller", f"{tmp_path / 'own.py'}:Same"]
    assert commands.main([*words, *mine, "--controller", "robot_ideal"]) == 0
    assert len([line for line in capsys.readouterr().out.splitlines() if "completed" in line]) == 2
    assert commands.main([*words, "--controller", "robot"]) == 2
    assert "controller.torque.rotor_inertia is 0.05; expected 0" in capsys.readouterr().err
    assert commands.main([*words, *mine, "--controller", "robot_ideal", "--name", "one"]) == 2
    assert "expected one controller" in capsys.readouterr().err


def test_a_controller_of_ones_own_is_refused_by_name_and_line(own):
    with pytest.raises(ValueError, match=r"own controller at 0.04 s: .*NoneType"):
        rust.fly(own("late"))
    with pytest.raises(ConfigError, match=r"`own_controller.name` is \"Other\"; expected the name of a function"):
        rust.fly(own("Other"))
    with pytest.raises(ConfigError, match="own_controller"):
        rust.Controller(own("Same"))
    broken = own("Same")
    broken["own_controller"]["file"] = str(rust.__file__)[:-3] + "_absent.py"
    with pytest.raises(ConfigError, match=r"own_controller.file"):
        rust.fly(broken)


@pytest.mark.close_to_tolerance("of the second order in the step, and the step is as it is")
def test_forces_of_ones_own(agree):
    """1 N on each of 13 links for one tick from rest adds their impulse, to the second order in the step."""
    changes = {"simulator.substeps": 3, "simulator.initial.free_fall_tick": False}
    config = rust.load_config(TEST2, changes | {"wind.ramp_start": -1.0, "wind.ramp_end": 0.0})
    robot, momenta = rust.Robot(config["robot"]), []
    for force in (0.0, -1.0):
        flight = rust.Flight(config)
        forces = np.tile([0.0, force, 0.0], (13, 1))
        flight.step(command=rust.Command(np.zeros(4), np.zeros(23)), link_forces=forces)
        momenta.append(rust.dynamics(robot, flight.truth.state).momentum)
        flight.step()
        assert np.array_equal(flight.result()["aero_force_sim"][0], forces)
    agree("momentum added", momenta[1][1] - momenta[0][1], -0.13, 0.01)
    assert np.any(flight.result()["aero_force_sim"][1]), "without given forces the model's act again"


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("thrust_rate", {"command": rust.Command(np.zeros(3), np.zeros(23))}),
        ("joint_torque", {"command": rust.Command(np.zeros(4), np.full(23, np.nan))}),
        ("link_forces", {"link_forces": np.zeros((12, 3))}),
        ("residual.thrust_rate", {"residual": rust.Residual(np.zeros(3), np.zeros(23))}),
    ],
)
def test_a_step_that_cannot_be_taken_is_refused(name, given):
    flight = rust.Flight(rust.load_config(TEST2))
    with pytest.raises(ValueError, match=f"`{name}`"):
        flight.step(**given)
    assert flight.tick == 0


class Bodies:
    """A world in Python, of the crate's equations of motion: semi-implicit Euler."""

    def __init__(self, config):
        self.robot = rust.Robot(config["robot"])
        self.step = config["controller"]["time_step"] / config["simulator"]["substeps"]
        self.state = rust.Flight(config).truth.state
        self.torque = np.zeros(len(self.robot.joint_names))

    def observe(self):
        feet = len(self.robot.foot_names)
        return rust.Seen(self.state, self.state, np.ones((feet, 6)), self.torque, np.zeros((feet, 3)))

    def advance(self, torque, force):
        for row in torque:
            generalised = force + np.append(np.zeros(6), row)
            velocity = self.state.velocity + self.step * rust.forward_dynamics(self.robot, self.state, generalised)
            position, rotation, joints, _ = self.state
            turn = Rotation.from_rotvec(self.step * velocity[3:6]).as_matrix()
            moved = position + self.step * velocity[:3], turn @ rotation, joints + self.step * velocity[6:]
            self.state, self.torque = rust.State(*moved, velocity), row


@pytest.mark.close_to_tolerance("the same equations in another order, for a second")
def test_a_world_of_ones_own_is_flown_as_the_crates(measured):
    """With engines, a push, sensors, delays and two rates, which are the crate's: the same flight but for rounding."""
    push = {"body": "chest", "force": [20.0, 0.0, 5.0], "moment": [0.0, 1.0, 0.0], "start": 0.3, "duration": 0.2}
    changes = {
        "simulator.duration": 1.0,
        "simulator.substeps": 1,
        "simulator.joint_stops": False,  # the world in Python has none
        "simulator.initial.free_fall_tick": False,
        "simulator.jets": {"dynamics": "throttled"},
        "simulator.actuation": {"torque_delay": 0.01},
        "simulator.sensors.joints.resolution": 0.0,  # steps of encoders amplify rounding
        "disturbances.pushes": [push],
    }
    config = rust.load_config("test2_sensors", changes)
    theirs, crates = rust.Flight(config, Bodies(config)).run(), rust.fly(config)
    assert theirs.outcome == crates.outcome == "completed"
    for name in crates.log.keys() - {"qp_iterations"}:
        scale = np.nanmax(np.abs(crates[name]), initial=1.0)
        both = ~(np.isnan(theirs[name]) & np.isnan(crates[name]))  # a latency that is not known yet
        error = np.abs(theirs[name] - crates[name])[both].max(initial=0.0) / scale
        measured(name, error, 1e-6, because="rounding, amplified in a second")
    assert set(theirs.log) - set(crates.log) == {name for name, one in rust.signals().items() if one.is_of_ground}
    assert (theirs["foot_wrench"] == 1.0).all()
    assert np.array_equal(theirs["joint_torque_measured"][2:], theirs["joint_torque"][:-2])
    assert theirs.summary["time_off_the_ground"] == pytest.approx(1.01)


def test_what_a_world_raises_is_raised():
    class Broken(Bodies):
        def advance(self, *_):
            raise RuntimeError("out of order")

    config = rust.load_config("test2", {"simulator.initial.free_fall_tick": False})
    with pytest.raises(RuntimeError, match="out of order"):
        rust.Flight(config, Broken(config)).step()
    world = Bodies(config)
    world.torque = np.zeros(3)
    with pytest.raises(ValueError, match=r"`joint_torque` has shape \[3\]; expected \[23\]"):
        rust.Flight(config, world).step()
    with pytest.raises(ValueError, match=r"free_fall_tick is true"):
        rust.Flight(rust.load_config("test2"), world)


HEIGHT = {"bias": 0.5, "noise_std": 0.02, "delay": 0.02, "period": 0.03, "gaps": 0.3}


def test_a_measurement_may_have_a_height_and_speeds_of_shafts_in_place_of_thrusts():
    """Flown by speeds: what its controller is given is logged, may be handed back, and begins another flight."""
    shaft = tables.read(CONFIGS / "engines" / "jetcat_p300.toml")
    jets = {"dynamics": "throttled", "feedback": "speed", "shaft": shaft}
    changes = {"simulator.duration": 0.2, "simulator.jets": jets, "controller.shaft": shaft}
    changes |= {"simulator.sensors.height": HEIGHT}
    config = rust.load_config("robot", changes)
    whole, flight, controller = rust.fly(config), rust.Flight(config), rust.Controller(config)
    assert 0 < np.isfinite(whole["raw_height"]).sum() < 20
    for tick in range(20):
        seen = flight.measurement
        assert np.isnan(seen.thrust).all()
        assert np.array_equal(seen.shaft_speed, whole["raw_shaft_speed"][tick])
        np.testing.assert_array_equal(seen.height, whole["raw_height"][tick])
        given = {"shaft_speed": seen.shaft_speed, "height": seen.height}
        asked = controller.tick(seen.state, seen.thrust, seen.wind, seen.time, **given)
        assert flight.step(measurement=seen)
        assert np.array_equal(asked.thrust_rate, whole["thrust_rate"][tick]) or tick > 0
        assert np.array_equal(flight.last.joint_torque, whole["joint_torque"][tick])


@pytest.mark.parametrize("part", ["thrust", "wind", "foot_wrenches", "shaft_speed", "link_forces", "command"])
def test_a_refused_step_changes_nothing(part):
    """Of a measurement with one part of a wrong size nothing is used: the flight goes on to the same bits."""
    config = rust.load_config("test2", {"simulator.duration": 0.2})
    flight, other = rust.Flight(config), rust.Flight(config)
    for _ in range(3):
        assert flight.step()
        assert other.step()
    seen = flight.measurement
    wrong = seen._replace(thrust=seen.thrust + 30.0, wind=seen.wind + 5.0, height=2.0)
    beside = {}
    if part == "link_forces":
        beside = {part: np.zeros((2, 3))}
    elif part == "command":
        beside = {part: (np.full(4, 1e12), np.zeros(23))}
    else:
        wrong = wrong._replace(**{part: np.zeros((7, 7))})
    with pytest.raises(ValueError, match=r"."):
        flight.step(measurement=wrong, **beside)
    for _ in range(5):
        assert flight.step()
        assert other.step()
        assert np.array_equal(flight.last.joint_torque, other.last.joint_torque)
        assert np.array_equal(flight.last.thrust_rate, other.last.thrust_rate)


def test_a_height_above_another_ground_is_measured():
    """Above a ground 2 m below the start, every third tick, with gaps and noise; a healthy flight keeps its bits."""
    changes = {"simulator.duration": 6.0, "simulator.initial.base_velocity": [0.0, 0.0, 0.2, 0.0, 0.0, 0.0]}
    of_height = {"simulator.ground_height": -2.0, "simulator.sensors.height": HEIGHT}
    usual, config = (rust.load_config("test2_sensors", changes | more) for more in ({}, of_height))
    flight, plain = rust.fly(config), rust.fly(usual)
    raw = flight["raw_height"]
    assert np.isnan(plain["raw_height"]).all()
    measured = np.flatnonzero(np.isfinite(raw))
    assert (measured % 3 == 0).all()
    assert 0.55 < len(measured) / 201 < 0.85
    late = np.maximum(measured - 2, 0)
    error = raw[measured] - (flight["base_position"][late, 2] - flight["base_position"][0, 2] + 2.0)
    assert abs(np.mean(error) - 0.5) < 0.01  # five standard deviations of the mean
    assert abs(np.std(error) - 0.02) < 0.005
    for name in set(plain.log) - {"raw_height", "degraded_modes"}:
        assert np.array_equal(plain[name], flight[name], equal_nan=True), name


def test_a_height_that_is_lost_is_announced():
    """Once it has been missing for 0.15 s; a flight without such a sensor has no such mode."""
    changes = {"simulator.duration": 0.5, "simulator.sensors.height": {}}
    outage = {"channel": "height", "kind": "missing", "start": 0.1, "duration": 0.3}
    healthy, lost = (
        rust.fly(rust.load_config("test2_sensors", changes | more))["degraded_modes"].astype(int) & (1 << 25)
        for more in ({}, {"disturbances.outages": [outage]})
    )
    assert not healthy.any()
    found = np.flatnonzero(lost)
    assert (found[0] in (25, 26), found[-1]) == (True, 39)


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        (
            "test2",
            {"disturbances.outages": [{"channel": "height", "kind": "missing", "start": 1.0}]},
            "height is absent",
        ),
        ("take_off", {"simulator.ground_height": 0.5}, 'backend = "mujoco" simulates nothing else here'),
        ("test2", {"simulator.ground_height": 2e3}, r"simulator\.ground_height"),
        ("test2_sensors", {"simulator.sensors.height": {"gaps": 1.5}}, r"simulator\.sensors\.height\.gaps"),
    ],
)
def test_a_height_that_cannot_be_is_refused(name, changes, message):
    with pytest.raises(ConfigError, match=message):
        rust.load_config(name, changes)


def test_a_descent_is_planned_to_the_measured_ground():
    """As high as the start it changes millimetres; to a lower one the robot sinks faster, to a higher one slower.

    Nothing is measured late, and the estimator is configured so: the ground is where a late position is above
    the height.
    """
    estimator = rust.load_config("robot")["controller"]["estimator"]
    late = [name for name, table in estimator.items() if isinstance(table, dict) and "delay" in table]

    def height_after(ground, sensors):
        failure = {"jet": "l_arm_jet", "time": 0.3, "kind": "off"}
        changes = {"simulator.duration": 1.0, "simulator.initial.base_velocity": [0.0, 0.0, 2.0, 0.0, 0.0, 0.0]}
        changes |= {"disturbances.jets.failure": failure, "simulator.sensors": sensors}
        changes |= {f"controller.estimator.{name}.delay": 0.0 for name in late}
        flight = rust.fly(rust.load_config("robot", changes | {"simulator.ground_height": ground}))
        return flight["com_position"][-1, 2]

    unknown, same = (height_after(0.0, sensors) for sensors in ({"seed": 1}, {"height": {}}))
    lower, higher = (height_after(ground, {"height": {}}) for ground in (-1.0, 0.4))
    assert abs(same - unknown) < 0.003
    assert lower + 0.01 < same < higher - 0.01
    assert height_after(-1.0, {"seed": 1}) == unknown, "no measurement shows that it is lower"

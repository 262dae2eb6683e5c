"""The Python face of the crate, with short flights."""

import json
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest

from experiments import record
from jax_aero import rust
from jax_aero.command import ConfigError
from jax_aero.places import HOME, ROBOT

TEST2 = HOME / "configs" / "experiments" / "test2.toml"
SHORT = {"simulator.duration": 1.0}


def test_overrides_change_just_what_they_name():
    plain = rust.load_config(TEST2)
    changed = rust.load_config(TEST2, {"wind.velocity": [0.0, -12.0, 0.0]})
    assert changed["wind"].pop("velocity") == [0.0, -12.0, 0.0]
    plain["wind"].pop("velocity")
    assert changed == plain


def test_overrides_are_judged_together():
    ramp = {"wind.ramp_start": 12.0, "wind.ramp_end": 20.0}
    assert rust.load_config(TEST2, ramp)["wind"]["ramp_start"] == 12.0
    with pytest.raises(ValueError, match=r"wind\.ramp_start"):
        rust.load_config(TEST2, {"wind.ramp_start": 12.0})


def test_a_wrong_value_of_a_known_key_does_not_make_the_key_unknown():
    failure = {"jet": "l_arm", "time": 1.0, "kind": "off"}
    with pytest.raises(ValueError, match=r"^cannot set `disturbances\.jets\.failure` = .* names `l_arm`"):
        rust.load_config(TEST2, {"disturbances.jets.failure": failure})
    with pytest.raises(ValueError, match=r"^unknown key `disturbances\.jets\.failur`; did you mean"):
        rust.load_config(TEST2, {"disturbances.jets.failur": failure})


@pytest.mark.parametrize(
    ("key", "near"),
    [
        ("disturbances.jets.thrust_limits_scale", "disturbances.jets.thrust_limit_scale"),  # absent by default
        ("duration", "simulator.duration"),
    ],
)
def test_an_unknown_key_is_refused_with_one_suggestion_and_the_keys_of_its_table(key, near):
    with pytest.raises(ValueError, match=f"^unknown key `{key}`; did you mean `{near}`\\? \\(known: [\\w, ]+\\)$"):
        rust.load_config(TEST2, {key: 0.7})


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


def test_the_digest_follows_the_configuration_alone():
    config = rust.load_config(TEST2)
    assert rust.config_digest(config) == rust.config_digest(json.loads(json.dumps(config)))
    assert rust.config_digest(config) != rust.config_digest(rust.load_config(TEST2, SHORT))


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


def test_a_real_log_fits_the_schema_of_result_files():
    config = rust.load_config(TEST2, SHORT)
    dataset = record.to_dataset(
        rust.fly(config), rust.Robot(config["robot"]), title=config["title"], config_digest="0" * 64
    )
    assert dataset.sizes["time"] >= 100
    assert dataset.sizes["link"] == 13


def test_progress_runs_up_to_the_end():
    seen = []
    rust.fly(rust.load_config(TEST2, SHORT), lambda tick, n_ticks: seen.append((tick, n_ticks)))
    ticks = [tick for tick, _ in seen]
    assert ticks == sorted(ticks)
    assert all(tick <= n_ticks for tick, n_ticks in seen)


def test_an_exception_in_the_progress_callback_ends_the_flight():
    def stop(tick, n_ticks):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rust.fly(rust.load_config(TEST2), stop)


def test_a_batch_equals_single_flights_whatever_the_number_of_threads():
    configs = [rust.load_config(TEST2, {**SHORT, "wind.velocity": [0.0, -speed, 0.0]}) for speed in (0.0, 5.0, 10.0)]
    single = [rust.fly(config) for config in configs]
    for threads in (1, 3):
        batch = rust.fly_batch(configs, threads, full_log=True)
        for alone, together in zip(single, batch, strict=True):
            np.testing.assert_equal(alone.summary, together.summary)  # NaN before a flight has settled
            for name, values in alone.log.items():
                np.testing.assert_array_equal(values, together[name], err_msg=name)


def test_a_refused_configuration_costs_no_flight():
    config, reports = rust.load_config(TEST2, SHORT), []
    lacking = config | {"wind": {"profile": "file", "path": "no/such.csv"}}
    with pytest.raises(ValueError, match=r"flight 1 of the batch: .*no/such\.csv"):
        rust.fly_batch([config, lacking], progress=lambda *report: reports.append(report))
    assert all(done == 0 for done, _ in reports)


@pytest.mark.parametrize("threads", [0, -1])
def test_a_number_of_threads_is_positive(threads):
    with pytest.raises(ValueError, match=rf"`threads` is {threads}; expected at least 1"):
        rust.fly_batch([rust.load_config(TEST2, SHORT)], threads)


def test_a_command_is_replaced_after_a_tick_and_by_numbers():
    config = rust.load_config(TEST2)
    plant, controller = rust.Plant(config), rust.Controller(config)
    now = plant.reset()
    with pytest.raises(ValueError, match="no flight has begun"):
        controller.replace_command(np.zeros(4), np.zeros(23))
    controller.tick(now.state, now.thrust, now.wind, now.time)
    before = controller.state
    with pytest.raises(ValueError, match="thrust_rate"):
        controller.replace_command(np.zeros(3), np.zeros(23))
    with pytest.raises(ValueError, match="expected a finite number for every thrust rate and joint torque"):
        controller.replace_command(np.zeros(4), np.full(23, np.nan))
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


def test_a_state_without_feet_is_a_status():
    flying, standing = (rust.Controller(rust.load_config(name)) for name in ("test2", "balancing_front"))
    now = rust.Plant(rust.load_config(TEST2)).reset()
    flying.tick(now.state, now.thrust, now.wind, now.time)
    standing.state = flying.state
    assert standing.tick(now.state, now.thrust, now.wind, now.time).status == "BadState"


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


def test_a_loop_over_the_plant_is_the_flight():
    """The crate's controller in a Python loop: the same bits at every tick."""
    config = rust.load_config(TEST2, {"simulator.duration": 0.2, "wind.ramp_start": 0.0, "wind.ramp_end": 0.1})
    plant, controller, flight = rust.Plant(config), rust.Controller(config), rust.fly(config)
    for _ in range(2):
        now, controller = plant.reset(), rust.Controller(config)
        for tick, time_of_log in enumerate(flight["time"]):
            assert now.time == time_of_log
            assert np.array_equal(now.state.base_position, flight["base_position"][tick])
            assert np.array_equal(now.thrust, flight["thrust"][tick])
            assert np.array_equal(now.wind, flight["wind"][tick])
            command = controller.tick(now.state, now.thrust, now.wind, now.time)
            now = plant.step(command.thrust_rate, command.joint_torque)
            assert np.array_equal(plant.link_forces, flight["aero_force_sim"][tick])


def test_a_controller_of_ones_own_over_the_plant():
    """It keeps height by thrust alone; without it the robot falls 0.1 m in that time."""
    config = rust.load_config(HOME / "configs/experiments/no_wind.toml")
    robot, plant = rust.Robot(config["robot"]), rust.Plant(config)
    now = plant.reset()
    com = rust.dynamics(robot, now.state).com_position[2]
    for _ in range(15):
        dynamics = rust.dynamics(robot, now.state)
        velocity = dynamics.momentum[2] / robot.mass
        climb = 900.0 * (com - dynamics.com_position[2]) - 60.0 * velocity
        wanted = now.thrust * robot.mass * (robot.gravity + climb) / now.thrust.sum()
        now = plant.step((wanted - now.thrust) / 0.05, np.zeros(23))
    assert abs(rust.dynamics(robot, now.state).com_position[2] - com) < 0.02


@pytest.mark.close_to_tolerance("of the second order in the step, and the step is as it is")
def test_forces_of_ones_own_over_the_plant(agree):
    """1 N on each of 13 links for one tick from rest adds their impulse, to the second order in the step."""
    changes = {"simulator.substeps": 3, "simulator.initial.free_fall_tick": False}
    config = rust.load_config(TEST2, changes | {"wind.ramp_start": -1.0, "wind.ramp_end": 0.0})
    robot, plant = rust.Robot(config["robot"]), rust.Plant(config)
    momenta = []
    for force in (0.0, -1.0):
        plant.reset()
        now = plant.step(np.zeros(4), np.zeros(23), np.tile([0.0, force, 0.0], (13, 1)))
        assert np.array_equal(plant.link_forces, np.tile([0.0, force, 0.0], (13, 1)))
        momenta.append(rust.dynamics(robot, now.state).momentum)
    agree("momentum added", momenta[1][1] - momenta[0][1], -0.13, 0.01)
    plant.reset()
    plant.step(np.zeros(4), np.zeros(23))
    assert np.any(plant.link_forces), "without given forces the model's act again"


@pytest.mark.parametrize(
    ("name", "value"),
    [("thrust_rate", np.zeros(3)), ("joint_torque", np.full(23, np.nan)), ("link_forces", np.zeros((12, 3)))],
)
def test_a_step_that_cannot_be_taken_is_refused(name, value):
    plant = rust.Plant(rust.load_config(TEST2))
    command = {"thrust_rate": np.zeros(4), "joint_torque": np.zeros(23)} | {name: value}
    with pytest.raises(ValueError, match=f"`{name}`"):
        plant.step(**command)


@pytest.mark.parametrize("factor", [1.01, np.nan])
def test_a_rotation_that_is_none_is_predicted_not_refused(factor):
    config = rust.load_config(TEST2)
    plant, controller = rust.Plant(config), rust.Controller(config)
    now = plant.reset()
    assert controller.tick(now.state, now.thrust, now.wind, now.time).degraded_modes == []
    now = plant.measure()
    stretched = now.state._replace(base_rotation=factor * now.state.base_rotation)
    tick = controller.tick(stretched, now.thrust, now.wind, now.time + 0.01)
    assert tick.degraded_modes == ["rotation_predicted"]
    with pytest.raises(ValueError, match="deviates from a rotation"):
        rust.dynamics(rust.Robot(config["robot"]), stretched)

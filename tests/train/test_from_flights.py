"""The air from logs of flights: what is read of a log, what is refused, and the command from end to end."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from jax_aero import rust
from jax_aero.aero.network_card import load_network
from jax_aero.base import places
from jax_aero.base.terminal import Refused
from jax_aero.body.robot import load_robot
from jax_aero.cli import main
from jax_aero.identify import samples
from jax_aero.train import flights as observed
from jax_aero.train import from_flights as command

WIND = {
    "profile": "turbulent", "velocity": [9.0, -6.0, 0.0], "ramp_start": 0.5, "ramp_end": 2.0, "std": [3.0, 3.0, 1.5],
    "time_scale": 1.5, "seed": 4,
}  # fmt: skip
KEYS = {"simulator.duration": 12.0, "wind": WIND, "mission": {}}


@pytest.fixture(scope="module")
def config():
    return rust.load_config("test1_observer", KEYS)


@pytest.fixture(scope="module")
def robot(config):
    return load_robot(config["robot"])


@pytest.fixture(scope="module")
def log(config):
    return dict(rust.fly(config).log)


# --- what a log holds --------------------------------------------------------------------------------------------


def truth(log, config):
    """The filtered force that the simulator applied, whole robot, inertial axes."""
    share, held, found = 1.0 - np.exp(-3.0 * config["controller"]["time_step"]), np.zeros(3), []
    for force in log["aero_force_sim"].sum(axis=1):
        held = held + share * (force - held)
        found.append(held)
    return np.array(found)


def test_the_wrench_is_that_of_the_air_whatever_controller_flew(log, config, robot, agree):
    """An observer without a model estimated it; with a model, or none of both, the log is replayed through one."""
    flight = observed.flight_of("log", log, config, robot)
    np.testing.assert_array_equal(flight.wrench, log["unmodelled_wrench"])
    late = flight.is_valid
    assert late.sum() > 900
    agree("observed force [N]", flight.wrench[late, :3], truth(log, config)[late], 0.6)
    aware = rust.load_config("test2", KEYS)
    flown = dict(rust.fly(aware).log)
    replayed = observed.flight_of("log", flown, aware, robot)
    agree("replayed force [N]", replayed.wrench[late, :3], truth(flown, aware)[late], 0.6)
    assert np.abs(flown["unmodelled_wrench"]).max() < 1.0
    assert np.std(replayed.wrench[late, 0]) > 1.0


def test_the_air_is_relative_to_the_base_in_its_axes(log, config, robot):
    flight = observed.flight_of("log", log, config, robot)
    place = 700
    relative = log["raw_wind"][place] - log["base_velocity"][place, :3]
    turn = rust.rotation_from_wxyz(log["base_quaternion"][place : place + 1])[0]
    np.testing.assert_allclose(flight.air[place], turn.T @ relative, atol=1e-9)
    np.testing.assert_allclose(flight.pressure[place], 0.5 * 1.225 * relative @ relative, rtol=1e-9)


def test_what_flights_know_is_named(log, config, robot):
    """The wind blows in +x, −y: from behind, with x backward from ahead; 0 is ahead, 90 the left."""
    flight = observed.flight_of("log", log, config, robot)
    forward = np.asarray(robot.forward_axis)
    left = np.cross([0.0, 0.0, 1.0], forward)
    for angle in (0.0, 90.0, 210.0, 330.0):
        comes_from = np.cos(np.radians(angle)) * forward + np.sin(np.radians(angle)) * left
        assert observed.sector_of(-5.0 * comes_from[None], robot)[0] == angle / observed.SECTOR
    facts = observed.known([flight], robot)
    seconds = facts["seconds by direction of the wind [deg]"]
    assert sum(seconds.values()) == pytest.approx(flight.seconds, abs=1.0)
    assert set(observed.unknown(facts)) == {f"{angle} deg" for angle, value in seconds.items() if value < 2.0}
    assert 5 < len(observed.unknown(facts)) < 12
    assert facts["joints [deg]"].keys() == set(robot.joint_names)


# --- what is refused ---------------------------------------------------------------------------------------------


def changed(**signals):
    def change(log):
        return log | {name: of(log) for name, of in signals.items()}

    return change


def cut(log):
    return {name: rows[:500] for name, rows in log.items()}


def foreign(change):
    """A log of others, which holds no observed wrench."""
    return lambda log: change({name: rows for name, rows in log.items() if name != "unmodelled_wrench"})


REFUSED = {
    "still air": (changed(raw_wind=lambda log: 0.0 * log["raw_wind"]), "does not change in 100 % of its ticks"),
    "no wind but noise": (
        changed(measured_wind=lambda log: 0.02 * log["raw_wind"], raw_wind=lambda log: 0.02 * log["raw_wind"]),
        "is flown in still air; expected wind of 2 m/s or more",
    ),
    "a stuck anemometer": (
        changed(raw_wind=lambda log: np.where(log["time"][:, None] < 4.0, log["raw_wind"], log["raw_wind"][400])),
        "`raw_wind` of `log` does not change in 6. % of its ticks",
    ),
    "too short": (cut, "has .* s in the air and the wind; expected at least 8 s"),
    "on the ground": (
        changed(
            unmodelled_wrench=lambda log: log["unmodelled_wrench"] + 400.0 * np.eye(6)[2],
            measured_base_velocity=lambda log: 0.0 * log["measured_base_velocity"],
        ),
        "ticks left out: .* on the ground",
    ),
    "wind in km/h": (changed(raw_wind=lambda log: 3.6 * log["raw_wind"]), r"`raw_wind` of `log` reaches .* \(km/h\?\)"),
    "wind in knots": (
        changed(raw_wind=lambda log: 1.94 * log["raw_wind"], measured_wind=lambda log: 1.94 * log["measured_wind"]),
        r"is 0\.\d+ times that of the robot's coefficients in `raw_wind`; expected .* knots\?",
    ),
    "thrusts in kgf": (
        foreign(changed(raw_thrust=lambda log: log["raw_thrust"] / 9.81)),
        "ticks left out: .* with thrusts in another unit",
    ),
    "thrusts of another robot": (
        changed(unmodelled_wrench=lambda log: log["unmodelled_wrench"] - 200.0 * np.eye(6)[2]),
        r"thrusts of `log` carry 14. % of the robot's weight; expected about all of it \(another unit, or",
    ),
    "a wind that is not measured": (
        changed(raw_wind=lambda log: np.nan * log["raw_wind"], measured_wind=lambda log: np.nan * log["raw_wind"]),
        "has 0 s in the air and the wind; expected",
    ),
}


@pytest.mark.filterwarnings("ignore:All-NaN")
@pytest.mark.parametrize("what", REFUSED)
def test_a_log_that_tells_nothing_of_the_air_is_refused_with_the_reason(what, log, config, robot):
    change, reason = REFUSED[what]
    with pytest.raises(Refused, match=reason):
        observed.flight_of("log", change(log), config, robot)


def test_a_log_needs_a_measured_wind_but_no_torques(log, config):
    crate = rust.Robot(config["robot"])
    with pytest.raises(Refused, match="`log` has no `raw_wind`"):
        samples.check({k: v for k, v in log.items() if k != "raw_wind"}, "log", crate, observed.NEEDED)
    samples.check({k: v for k, v in log.items() if k != "joint_torque"}, "log", crate, observed.NEEDED)


def test_a_controller_without_a_measured_wind_is_refused(config):
    estimated = rust.load_config("test1_observer", KEYS)
    estimated["controller"]["wind_observer"] = {"anything": 1.0}
    with pytest.raises(Refused, match="wind_observer"):
        observed.observing(estimated)


# --- the command -------------------------------------------------------------------------------------------------

SMALL = {"network.hidden": "[4]", "training.epochs": "4", "training.validate_every": "2", "held_out": "0.4"}
OPTIONS = [word for key, value in SMALL.items() for word in ("--set", f"{key}={value}")]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Two flights: of a controller that observes, and of one with a model."""
    folder = tmp_path_factory.mktemp("flights")
    for name, seed in (("test1_observer", 4), ("test2", 5)):
        wind = ", ".join(f"{key} = {json.dumps(value)}" for key, value in (WIND | {"seed": seed}).items())
        words = ["--set", f"wind={{{wind}}}", "--set", "simulator.duration=12", "--set", "mission={}"]
        assert main(["fly", name, *words, "--out", str(folder / name)]) == 0
    return [str(path.parent) for path in sorted(folder.rglob("run.nc"))]


@pytest.fixture(scope="module")
def learnt(results, tmp_path_factory):
    out = tmp_path_factory.mktemp("learnt") / "air"
    assert (
        main(["train", "flights", *results, *OPTIONS, "--out", str(out), "--write", str(out.parent / "card.json")]) == 0
    )
    return out


@pytest.mark.slow
def test_the_card_flies_and_says_that_single_links_are_not_determined(learnt, robot):
    card = json.loads((learnt / "air.json").read_text())
    assert "forces of single links are not determined" in card["training"]["note"]
    assert card["training"]["flights"] == 2
    assert "seconds by direction of the wind [deg]" in card["training"]["known"]
    assert (learnt.parent / "card.json").read_text().replace("card", "air") == (learnt / "air.json").read_text()
    for name in ("air", "refit"):
        load_network(learnt / f"{name}.json", robot)
        aero = {"model": "network", "card": str(learnt / f"{name}.json"), "precision": "f32", "air_density": 1.225}
        flown = rust.fly(rust.load_config("test2", {"simulator.duration": 0.5, "controller.aero": aero}))
        assert flown.outcome == "completed"


def test_the_result_names_the_flights_held_out_and_what_each_model_leaves(learnt, capsys):
    document = json.loads((learnt / "manifest.json").read_text())
    summary = document["summary"]
    assert len(summary["held out"]) == 1
    assert {"nothing", "signed", "refit", "learnt"} <= summary["left"].keys()
    assert summary["left"]["refit"]["force [N]"] < summary["left"]["nothing"]["force [N]"]
    run = xr.load_dataset(learnt / "run.nc")
    assert run["epoch"].values.tolist() == [[2.0, 4.0]]
    assert np.isfinite(run["validation_loss"]).all()
    text = command.report(summary)
    assert "forces of single links are not determined" in text
    assert "unknown: wind from" in text


@pytest.mark.slow
def test_a_finished_result_is_not_trained_again_and_another_is_not_replaced(results, learnt, capsys):
    words = ["train", "flights", *results, *OPTIONS, "--out", str(learnt)]
    assert main(words) == 0
    assert "is finished already" in capsys.readouterr().out
    assert main([*words, "--set", "seed=7"]) != 0


@pytest.mark.slow
def test_an_interrupted_training_goes_on(results, learnt, tmp_path, monkeypatch):
    """The loop stops after two epochs; the same command ends with the same bits."""
    whole, fit = (learnt / "air.safetensors").read_bytes(), command.fit

    def stop(*given, on_epoch, **more):
        def then(epoch, *losses):
            on_epoch(epoch, *losses)
            if epoch == 2:
                raise KeyboardInterrupt

        return fit(*given, on_epoch=then, **more)

    words = ["train", "flights", *results, *OPTIONS, "--out", str(tmp_path / "air")]
    with monkeypatch.context() as patched:
        patched.setattr(command, "fit", stop)
        assert main(words) != 0
    assert main(words) == 0
    assert (tmp_path / "air" / "air.safetensors").read_bytes() == whole


def test_logs_of_others_are_read_by_a_map(log, config, robot, tmp_path):
    """With other names and units, without torques and without an observer: the same air."""
    table = {"t_ms": 1e3 * log["time"]}
    names = rust.Robot(config["robot"]).joint_names
    table |= {f"q_{name}": np.degrees(column) for name, column in zip(names, log["raw_joint_position"].T, strict=True)}
    table |= {f"rate_{name}": column for name, column in zip(names, log["raw_joint_velocity"].T, strict=True)}
    jets = rust.Robot(config["robot"]).jet_names
    table |= {f"thrust_{name}": column for name, column in zip(jets, log["raw_thrust"].T, strict=True)}
    columns = {}
    for signal, width in (
        ("raw_base_position", 3),
        ("raw_base_rotation", 9),
        ("raw_base_velocity", 6),
        ("raw_wind", 3),
    ):
        columns[signal] = [f"{signal}_{number}" for number in range(width)]
        factor = 1.0 / 0.514444 if signal == "raw_wind" else 1.0
        table |= dict(zip(columns[signal], factor * log[signal].reshape(-1, width).T, strict=True))
    pd.DataFrame(table).to_csv(tmp_path / "theirs.csv", index=False)
    mapping = ['time = { columns = "t_ms", scale = 1e-3 }']
    mapping += [
        'raw_joint_position = { columns = "q_{}", scale = 0.0174532925199433 }',
        'raw_joint_velocity = { columns = "rate_{}" }',
        'raw_thrust = { columns = "thrust_{}" }',
    ]
    for signal, of in columns.items():
        scale = ", scale = 0.514444" if signal == "raw_wind" else ""
        mapping.append(f"{signal} = {{ columns = {json.dumps(of)}{scale} }}")
    (tmp_path / "theirs.toml").write_text("\n".join(mapping))
    one = tmp_path / "theirs.csv"
    _, (flight,) = command.read_logs([one], tmp_path / "theirs.toml", "test2", None, 1.225)
    own = observed.flight_of("log", log, config, robot)
    late = own.is_valid[: len(flight.turn)]
    assert np.sqrt(np.mean((flight.wrench - own.wrench[: len(flight.turn)])[late, :3] ** 2)) < 0.2
    np.testing.assert_allclose(flight.air[late], own.air[: len(flight.turn)][late], atol=1e-3)
    (tmp_path / "theirs.toml").write_text("\n".join(mapping).replace(", scale = 0.514444", ""))
    with pytest.raises(Refused, match="knots"):
        command.read_logs([one], tmp_path / "theirs.toml", "test2", None, 1.225)
    (tmp_path / "theirs.toml").write_text("\n".join(mapping).replace(", scale = 0.0174532925199433", ""))
    with pytest.raises(Refused, match="deg"):
        command.read_logs([one], tmp_path / "theirs.toml", "test2", None, 1.225)
    with pytest.raises(Refused, match="expected --experiment NAME"):
        command.read_logs([one], tmp_path / "theirs.toml", None, None, 1.225)


def test_a_log_of_another_robot_is_refused(results):
    mk3 = places.CONFIGS / "robot" / "ironcub_mk3.toml"
    with pytest.raises(Refused, match=r"is of ironcub_mk1\.toml; expected ironcub_mk3\.toml"):
        command.read_logs([Path(results[0])], None, None, str(mk3), 1.225)


def test_settings_that_do_not_fit_the_robot_are_refused(robot):
    settings, _ = command.read_settings(places.CONFIGS / "training_flights" / "hover.toml", {"network.baseline": "cfd"})
    with pytest.raises(Refused, match=r"network\.baseline"):
        settings.start(robot, 0)


def test_a_short_flight_shortens_all_windows(log, config, robot):
    settings, _ = command.read_settings(places.CONFIGS / "training_flights" / "hover.toml", {"network.hidden": [4]})
    flight = observed.flight_of("log", log, config, robot)
    rows = settings.rows([flight, replace_turn(flight)])
    assert rows.window == pytest.approx(12.01)


def replace_turn(flight):
    return flight._replace(turn=np.concatenate([flight.turn, flight.turn]))

"""The comparison of crate and JAX: its worst differences, its samples, its table, and its command without a flight."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from jax_aero import rust, sim, verify
from jax_aero.verify import cli


def test_the_worst_sample_counts_against_the_greatest_answer():
    comparison = verify.Comparison()
    comparison.add("dynamics", "bias", [1.0, 2.1], [1.0, 2.0], 0.02)
    comparison.add("dynamics", "bias", [-4.0, 8.05], [-4.0, 8.0], 0.02)
    comparison.add("flight", "wind", [0.0, 1e-6], [0.0, 0.0], 1e-6, relative=False)
    relative, absolute = comparison.rows
    assert (relative.absolute, relative.scale) == (pytest.approx(0.1), 8.0)
    assert relative.agrees
    assert absolute.agrees
    assert absolute.relative == absolute.absolute == 1e-6  # there is nothing to be relative to
    comparison.add("flight", "wind", [0.0, -3e-6], [0.0, 0.0], 1e-6, relative=False)
    assert not absolute.agrees
    comparison.add("dynamics", "bias", [np.nan], [1.0], 0.02)
    comparison.add("dynamics", "bias", [1.0], [1.0], 0.02)
    assert not relative.agrees


def test_a_small_error_in_a_quantity_that_vanishes_is_found():
    """Where the jets carry the weight, lift minus weight is rounding: a relative tolerance has nothing to refer to."""
    config = rust.load_config("platform_hover", {"simulator.duration": 0.02})
    (sample,) = verify.recorded_samples(config, rust.fly(config), 1)
    robot = rust.Robot(config["robot"])
    weight = robot.mass * robot.gravity
    sample = replace(sample, thrust=np.full(6, weight / verify._crate_tick(config, sample).jet_axes[:, 2].sum()))
    rounded = verify.round_sample(np.random.default_rng(0), sample)
    theirs, nearby = (verify._crate_tick(config, near).momentum_rate_estimate[2] for near in (sample, rounded))
    assert abs(theirs) < 1e-15 * weight
    for error, agrees in ((0.0, True), (2.0 * np.spacing(weight), True), (1e-13 * weight, False), (np.nan, False)):
        comparison = verify.Comparison()
        comparison.add("recorded", "momentum_rate_estimate", theirs + error, theirs, 1e-10, rounded=nearby)
        assert comparison.rows[0].agrees == agrees, error


def test_a_sample_is_rounded_in_every_number_that_is_not_zero():
    sample = verify.random_samples(rust.load_config("test2"), 1)[0]
    rounded = verify.round_sample(np.random.default_rng(0), sample)
    pairs = [
        *zip(sample.state, rounded.state, strict=True),
        (sample.thrust, rounded.thrust),
        (sample.wind, rounded.wind),
    ]
    pairs += [(value, getattr(rounded.setpoint, name)) for name, value in vars(sample.setpoint).items()]
    pairs += zip(sample.memory, rounded.memory, strict=True)
    for value, other in pairs:
        assert np.any(value != other)
        assert np.abs(value - other).max() <= 4.0 * np.spacing(np.abs(value).max())


def test_a_flight_that_is_lost_too_early_ends_otherwise(monkeypatch):
    config = rust.load_config("test2", {"simulator.duration": 0.5, "simulator.fall.com_error": 1e-3})
    crate = rust.fly(config)
    assert crate.outcome == "fell"
    for missing, agrees in ((0, True), (1, False)):
        ticks = len(crate["time"]) - missing
        ours = replace(crate, log={name: signal[:ticks] for name, signal in crate.log.items()})
        monkeypatch.setattr(sim, "fly", lambda _, ours=ours: ours)
        comparison = verify.Comparison()
        verify.verify_flight(config, comparison)
        assert all(row.agrees for row in comparison.rows) == agrees


def test_a_flight_may_differ_by_what_a_rounding_of_its_start_makes(monkeypatch):
    """With encoders, in whose resolution a rounding decides; a start that is another is found."""
    config = rust.load_config("test2_sensors", {"simulator.duration": 2.0})
    rounded = verify._round_start(np.random.default_rng(9), config)
    other = rust.set_keys(config, {"simulator.initial.base_velocity": [0.01, 0, 0, 0, 0, 0]})
    for flown, agrees in ((rounded, True), (other, False)):
        ours = rust.fly(flown)
        monkeypatch.setattr(sim, "fly", lambda _, ours=ours: ours)
        comparison = verify.Comparison()
        verify.verify_flight(config, comparison)
        assert all(row.agrees for row in comparison.rows) == agrees


def test_all_keys_that_jax_does_not_fly_are_named_at_once(capsys):
    assert cli.main(["--config", "robot"]) == 2
    printed = capsys.readouterr().err
    assert all(f"`{key}`" in printed for key in ("simulator.motors", "controller.jet_dynamics"))


def test_samples_of_a_flight_are_spread_from_its_first_to_its_last_tick(agree):
    config = rust.load_config("test2", {"simulator.duration": 0.02, "simulator.time_step": 0.01})
    flight = rust.fly(config)
    first, last = verify.recorded_samples(config, flight, 2)
    for sample, tick in ((first, 0), (last, -1)):
        velocity = np.concatenate([flight["base_velocity"][tick], flight["joint_velocity"][tick]])
        np.testing.assert_array_equal(sample.state.velocity, velocity)
        np.testing.assert_array_equal(sample.thrust, flight["thrust"][tick])
        np.testing.assert_array_equal(sample.setpoint.com_position, flight["com_setpoint"][tick])
    assert np.any(first.state.velocity != last.state.velocity)
    tick = rust.Controller(config).tick(first.state, first.thrust, first.wind, 0.0)
    agree("first inertia", first.memory[1], tick.inertia_0_b, 1e-12)


def test_random_states_have_joints_between_their_limits():
    limits = np.array([[-1.0, 3.0], [5.0, 6.0]])
    states = list(verify.random_states(np.random.default_rng(1), limits, 50))
    share = (np.array([state.joint_position for state in states]) - limits[:, 0]) / np.ptp(limits, axis=1)
    assert np.all((share >= 0.0) & (share <= 1.0))
    # Of 50 the chance that none is in an outer fifth is 1e-5.
    assert np.all(share.min(axis=0) < 0.2)
    assert np.all(share.max(axis=0) > 0.8)
    (without,) = verify.random_states(np.random.default_rng(1), [], 1)
    assert np.shape(without.joint_position) == (0,)
    assert np.shape(without.velocity) == (6,)


def test_networks_are_compared_in_double_precision():
    found = verify.use_double_precision(rust.load_config("robustness"))
    assert found["simulator"]["aero"]["precision"] == "f64"
    assert "precision" not in found["controller"]["aero"]


CRATES = SimpleNamespace(lost_time=None)
"""A flight in place of the crate's."""


@pytest.fixture
def compared(monkeypatch):
    """Put made-up differences in place of comparisons: of the robot 0.1 of its tolerance, of others as given."""
    calls, size = [], {"tick": 0.1}

    def robot(path, states, comparison, backend, seed):
        calls.append((path, states, backend, seed))
        comparison.add("dynamics", "bias", [1.0 + 1e-11], [1.0], 1e-10)

    def ticks(config, samples, group, comparison):
        calls.append((group, samples))
        comparison.add(group, "task", [1.0 + size["tick"] * 1e-10], [1.0], 1e-10)

    def flight(config, comparison, backend):
        comparison.add("flight", "wind", [0.0], [0.0], 1e-6, relative=False)
        return CRATES, CRATES

    for name, made_up in (("verify_robot", robot), ("verify_ticks", ticks), ("verify_flight", flight)):
        monkeypatch.setattr(cli, name, made_up)
    monkeypatch.setattr(cli, "random_samples", lambda _, states, seed: ("random", states, seed))
    monkeypatch.setattr(cli, "recorded_samples", lambda _, flight, states: (flight, states))
    return calls, size


def test_the_command_compares_robot_ticks_and_flight(compared, tmp_path, capsys):
    calls, size = compared
    words = ["--config", "test1", "--states", "7", "--seed", "3", "--out", str(tmp_path)]
    assert cli.main(words) == 0
    assert [call[1:] for call in calls] == [(7, "tree", 3), (("random", 7, 3),), ((CRATES, 7),)]
    printed = capsys.readouterr().out
    row = "| {:8} | {:26} | {:8} | {:8} |  0.0e+00 | {}     | agrees    |".format
    assert row("dynamics", "bias", " 1.0e-11", " 1.0e-11", "1e-10 rel") in printed
    assert row("flight", "wind", " 0.0e+00", " 0.0e+00", "1e-06 abs") in printed
    assert "4 of 4 quantities agree" in printed
    document = json.loads((tmp_path / "verify.json").read_text())
    assert [row["agrees"] for row in document["rows"]] == [True] * 4
    assert document["config"] == rust.config_digest(rust.load_config("test1"))[:12]
    assert (tmp_path / "verify.png").stat().st_size > 0
    assert "config: " in (tmp_path / "verify.md").read_text()

    size["tick"] = 10.0
    assert cli.main(words) == 1
    printed = capsys.readouterr().out
    assert "DISAGREES" in printed
    assert "2 of 4 quantities agree, not random task, recorded task" in printed


def test_the_result_of_another_comparison_is_kept(compared, tmp_path, capsys):
    words = ["--config", "test1", "--states", "7", "--out", str(tmp_path)]
    assert cli.main(words) == 0
    others = [["--config", "test2"], ["--states", "8"], ["--seed", "1"], ["--set", "simulator.duration=1"]]
    robots = [["--robot", str(cli.places.CONFIGS / "robot" / f"{name}.toml")] for name in ("platform", "sparrow")]
    before = (tmp_path / "verify.json").read_bytes()
    for other in others:
        assert cli.main([*words, *other]) == 2
        assert "is the result of another comparison; choose another --out" in capsys.readouterr().err
    assert (tmp_path / "verify.json").read_bytes() == before
    assert len(compared[0]) == 3  # refused before anything is compared
    assert cli.main([*robots[0], "--out", str(tmp_path), "--overwrite"]) == 0
    assert cli.main([*robots[0], "--out", str(tmp_path)]) == 0
    assert cli.main([*robots[1], "--out", str(tmp_path)]) == 2


def test_results_of_robots_are_named_after_them(monkeypatch, tmp_path):
    monkeypatch.setattr(cli.places, "RESULTS", tmp_path)
    text = (cli.places.CONFIGS / "robot" / "platform.toml").read_text().replace('"platform.urdf"', '"robot.urdf"')
    (tmp_path / "robot.toml").write_text(text.replace("name = ", 'name = "my robot" # ', 1))
    (tmp_path / "robot.urdf").write_text((cli.places.CONFIGS / "robot" / "platform.urdf").read_text())
    folder, facts = cli._subject(cli._parse(["--robot", str(tmp_path / "robot.toml")]), None)
    assert folder == tmp_path / "verify" / cli.places.file_name("my robot")
    assert facts["robot"] == "my robot"


def test_a_robot_alone_is_compared_without_a_flight(compared, tmp_path):
    path = str(rust.load_config("test1")["robot"])
    assert cli.main(["--robot", path, "--backend", "mjx", "--out", str(tmp_path)]) == 0
    assert compared[0] == [(path, 50, "mjx", 0)]
    assert json.loads((tmp_path / "verify.json").read_text())["backend"] == "mjx"


@pytest.mark.parametrize("flight", ["--config=test1", "--controller=a.toml", "--set=wind.velocity=[0,0,0]"])
def test_a_robot_alone_has_no_flight(flight, capsys):
    with pytest.raises(SystemExit, match="2"):
        cli.main(["--robot", "a.toml", flight])
    assert "--robot" in capsys.readouterr().err


def test_another_controller_takes_the_place_of_the_flights(tmp_path, capsys):
    controller = rust.load_config("test1")
    observer = cli.places.CONFIGS / "control" / "observer.toml"
    options = cli._parse(["--config", "test1", "--controller", str(observer), "--set", "simulator.duration=1"])
    found = cli._config(options)
    assert found["controller"] != controller["controller"]
    assert found["controller"]["observer"]
    assert found["simulator"]["duration"] == 1
    assert cli.main(["--config", "nowhere", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err.startswith("error: there is no `nowhere`")


def test_a_robot_that_is_not_there_is_refused(tmp_path, capsys):
    assert cli.main(["--robot", str(tmp_path / "none.toml"), "--out", str(tmp_path / "out")]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("error: ")
    assert "none.toml" in shown.err
    assert not (tmp_path / "out").exists()


def test_every_file_is_replaced_whole(tmp_path):
    comparison = verify.Comparison()
    comparison.add("dynamics", "bias", [np.nan], [1.0], 0.02)
    written = cli.write(comparison.rows, tmp_path, {"crate": "first"})
    assert json.loads(written[1].read_text())["rows"][0]["absolute"] is None
    kept = [tmp_path / f"kept{path.suffix}" for path in written]
    for path, old in zip(written, kept, strict=True):
        old.hardlink_to(path)
    before = [old.read_bytes() for old in kept]
    cli.write(comparison.rows, tmp_path, {"crate": "second"})
    # Who had the old file open still has all of it.
    assert [old.read_bytes() for old in kept] == before
    assert json.loads(written[1].read_text())["crate"] == "second"
    assert not any(path.samefile(old) for path, old in zip(written, kept, strict=True))

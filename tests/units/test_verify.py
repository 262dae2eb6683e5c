"""The comparison of crate and JAX: its worst differences, its samples, its table, and its command without a flight."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from jax_aero import rust, verify
from jax_aero.base.typed_config import scenario_config
from jax_aero.commands import verify as cli
from jax_aero.refusals import refused
from jax_aero.verify import compare, everything, flight, library, lines, reach
from jax_aero.verify import ticks as verify_ticks


def test_the_worst_sample_counts_against_the_greatest_answer():
    row = compare("dynamics", "bias", [[1.0, 2.1], [-4.0, 8.05]], [[1.0, 2.0], [-4.0, 8.0]], 0.02)
    assert (row.absolute, row.scale) == (pytest.approx(0.1), 8.0)
    assert row.agrees
    for apart, agrees in ((1e-6, True), (-3e-6, False)):
        row = compare("flight", "wind", [[0.0], [apart]], [[0.0], [0.0]], 1e-6, relative=False)
        assert row.absolute == row.relative == abs(apart)  # there is nothing to be relative to
        assert row.agrees == agrees
    assert compare("tick", "wind", [np.nan], [np.nan], 0.0).agrees  # unknown in both
    assert not compare("tick", "wind", [np.nan, 1.0], [1.0, 1.0], 0.02).agrees
    assert not compare("tick", "wind", [1.0, 1.0], [1.0, np.nan], 0.02).agrees


def test_a_rounding_excuses_only_the_samples_near_it():
    theirs, rounded = np.ones(100), np.ones(100)
    rounded[50] += 1e-6
    for tick, agrees in ((50, True), (45, True), (55, True), (44, False), (56, False)):
        ours = theirs + np.where(np.arange(100) == tick, 1e-5, 0.0)
        assert compare("tick", "wind", ours, theirs, 1e-10, rounded=rounded, carried=5).agrees == agrees, tick
        assert compare("random", "wind", ours, theirs, 1e-10, rounded=rounded).agrees
    assert not compare("random", "wind", theirs + 4e-5, theirs, 1e-10, rounded=rounded).agrees


def test_a_small_error_in_a_quantity_that_vanishes_is_found():
    """Where the jets carry the weight, lift minus weight is rounding: a relative tolerance has nothing to refer to."""
    config = rust.load_config("platform_hover")
    robot = rust.Robot(config["robot"])
    (sample,), weight = verify.random_samples(config, 1), robot.mass * robot.gravity
    sample = replace(sample, state=rust.State.at_rest(robot), wind=np.zeros(3))
    (tick, _) = verify_ticks.crate_ticks(config, [sample])
    sample = replace(sample, thrust=np.full(6, weight / tick.jet_axes[:, 2].sum()))
    rounded = verify.round_sample(np.random.default_rng(0), sample)
    theirs, nearby = (
        verify_ticks.crate_ticks(config, [near])[0].momentum_rate_estimate[2] for near in (sample, rounded)
    )
    assert abs(theirs) < 1e-15 * weight
    for error, agrees in ((0.0, True), (2.0 * np.spacing(weight), True), (1e-13 * weight, False), (np.nan, False)):
        row = compare("random", "momentum_rate_estimate", [theirs + error], [theirs], 1e-10, rounded=[nearby])
        assert row.agrees == agrees, error


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


def as_flown(crate, **changes):
    """Return a flight of the crate as if JAX had flown it, with some signals changed."""
    return replace(crate, log={**crate.log, **changes})


def test_every_signal_of_a_tick_is_compared():
    config = rust.load_config("test2", {"simulator.duration": 0.1})
    crate = rust.fly(config)
    rounded = flight.replay_rounded(config, crate, crate)
    ticks, rows = flight.compare_ticks(crate, crate, rounded)
    assert ticks == 11
    assert {row.quantity for row in rows} == {*crate.log, "outcome"} - {*flight.NOT_COMPARED}
    assert all(row.agrees for row in rows)
    for name in crate.log.keys() - {*flight.NOT_COMPARED}:
        signal = crate[name].copy()
        signal[7] = np.nan_to_num(signal[7]) + 1e-6 * max(1.0, np.abs(np.nan_to_num(signal)).max())
        _, rows = flight.compare_ticks(crate, as_flown(crate, **{name: signal}), rounded)
        assert [row.quantity for row in rows if not row.agrees] == [name]
    shorter = as_flown(crate, **{name: signal[:9] for name, signal in crate.log.items()})
    assert not any(row.agrees for row in flight.compare_ticks(crate, shorter, rounded)[1][:-1] if row.scale)
    ended = replace(crate, outcome="fell", lost_time=0.1)
    assert [row.quantity for row in flight.compare_ticks(crate, ended, rounded)[1] if not row.agrees] == ["outcome"]


def test_ticks_are_compared_until_the_guard_acts():
    config = rust.load_config("test2", {"simulator.duration": 0.1})
    crate = rust.fly(config)
    guarded = as_flown(crate, degraded_modes=np.where(np.arange(11) > 6, 1.0, 0.0))
    ticks, rows = flight.compare_ticks(guarded, crate, flight.replay_rounded(config, crate, crate))
    assert ticks == 7
    assert all(row.agrees and row.quantity != "outcome" for row in rows)


def test_a_flight_is_compared_until_a_rounding_decides():
    crate = rust.fly(rust.load_config("test2", {"simulator.duration": 0.1}))
    time = crate["time"]

    def beginning(tick, size):
        return as_flown(crate, thrust=crate["thrust"] + np.where(np.arange(11) < tick, 0.0, size)[:, None])

    for rounded, twin, until, agrees in (
        (crate, crate, 10, True),
        (crate, beginning(10, 3e-6), 10, False),
        (beginning(6, 3e-6), beginning(6, 1.0), 5, True),
        (beginning(6, 3e-6), beginning(5, 3e-6), 5, False),
        (beginning(2, 5e-7), beginning(2, 3e-6), 10, True),
    ):
        found, rows = flight.compare_flight(crate, twin, rounded)
        assert found == time[until]
        assert all(row.agrees for row in rows) == agrees


def test_a_controller_with_feet_is_refused(capsys):
    assert cli.main(["--config", "take_off"]) == 2
    assert "simulator.ground is given" in capsys.readouterr().err


def test_every_experiment_is_compared_or_refused_for_what_jax_lacks():
    """The page has this list; it may only become shorter."""
    found = {}
    for name in cli.places.names("experiments"):
        config = rust.load_config(name)
        lacks = {refusal.lacks for refusal in refused(scenario_config(config))}
        assert (verify.compared(config) == "tick") == (not lacks), name
        found[name] = lacks
    owed = set().union(*found.values())
    assert owed <= {
        "ground contact",
        "fuel",
        "torques of a second rate",
        "maps of turbines",
        "channels",
        "fault detection",
    }
    assert sum(not lacks for lacks in found.values()) >= 45


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


@pytest.mark.parametrize("name", ["test2", "robot", "mk3_robot"])
def test_flights_astray_are_lost_at_their_limits(name):
    """Joints reach stops and torque rates limits, in ticks that are all compared."""
    config = rust.set_keys(rust.load_config(name), flight.UNGUARDED)
    robot = rust.Robot(config["robot"])
    (lower, upper), law = np.transpose(robot.joint_stops), config["controller"]
    at_stops, torques_at_limits, fast = 0, 0, (1.0 - 1e-9) * law["time_step"] * law["torque"]["torque_rate_max"]
    for lost in flight.fly_astray(config):
        assert lost.outcome in {"fell", "diverged"}
        assert len(lost["time"]) - 1 <= flight.ticks_unguarded(lost)
        beyond = (lost["joint_position"] < lower + 1e-6) | (lost["joint_position"] > upper - 1e-6)
        at_stops += beyond.any(axis=0).sum()
        torques_at_limits += np.sum(np.abs(np.diff(lost["joint_torque"], axis=0)) > fast)
    assert at_stops > 20
    assert torques_at_limits > 1


@pytest.fixture
def compared(monkeypatch):
    """Put made-up differences in place of comparisons: of the robot 0.1 of its tolerance, of others as given."""
    calls, size = [], {"tick": 0.1}

    def robots(path, states, backend, seed):
        calls.append((path, states, backend, seed))
        return [compare("dynamics", "bias", [1.0 + 1e-11], [1.0], 1e-10)]

    def ticks(config, samples, sides):
        calls.append(samples)
        return [compare("random", "task", [1.0 + size["tick"] * 1e-10], [1.0], 1e-10)]

    def fly(config, backend):
        rows = [compare("flight", "wind", [0.0], [0.0], 1e-6, relative=False)]
        return SimpleNamespace(rows=rows, share=0.998, until=12.34, scenario=None, sections=[])

    monkeypatch.setattr(library, "find", lambda: None)
    monkeypatch.setattr(cli, "verify_robots", robots)
    monkeypatch.setattr(reach, "unreached", lambda *_: ["fall.com_error"])
    monkeypatch.setattr(verify_ticks, "verify_ticks", ticks)
    monkeypatch.setattr(verify_ticks, "verify_held", lambda *_: [])
    monkeypatch.setattr(everything, "verify_everything", lambda: ([], []))
    monkeypatch.setattr(lines, "unexecuted", lambda *_: ["control/qp.py: 8-9", "sim/wind.py:12: no"])
    monkeypatch.setattr(flight, "verify_flight", fly)
    monkeypatch.setattr(cli, "random_samples", lambda _, states, seed: ("random", states, seed))
    return calls, size


def test_the_command_compares_robot_ticks_and_flight(compared, tmp_path, capsys):
    calls, size = compared
    words = ["--config", "test1", "--states", "7", "--seed", "3", "--out", str(tmp_path)]
    assert cli.main(words) == 0
    assert calls[0][1:] == (7, "tree", 3)
    assert calls[1:] == [("random", 7, 3)]
    printed = capsys.readouterr().out
    row = "| {:8} | {:26} |       1 | {:8} | {:8} |  0.0e+00 | {}     | agrees    |".format
    assert row("dynamics", "bias", " 1.0e-11", " 1.0e-11", "1e-10 rel") in printed
    assert row("flight", "wind", " 0.0e+00", " 0.0e+00", "1e-06 abs") in printed
    assert "compared: 99.8% of the ticks, the flight up to 12.34 s" in printed
    assert "not reached: fall.com_error" in printed
    assert "not executed: 2" in printed
    assert "C library: not built: cargo build" in printed
    assert "3 of 3 quantities agree" in printed
    document = json.loads((tmp_path / "verify.json").read_text())
    assert [row["agrees"] for row in document["rows"]] == [True] * 3
    assert document["not reached"] == ["fall.com_error"]
    assert document["not executed"] == ["control/qp.py: 8-9", "sim/wind.py:12: no"]
    assert document["config"] == rust.config_digest(rust.load_config("test1"))[:12]
    assert "config: " in (tmp_path / "verify.md").read_text()

    assert cli.main([*words, "--quick"]) == 0
    assert json.loads((tmp_path / "verify.json").read_text())["not reached"] == ["not examined"]
    capsys.readouterr()
    size["tick"] = 10.0
    assert cli.main(words) == 1
    printed = capsys.readouterr().out
    assert "DISAGREES" in printed
    assert "2 of 3 quantities agree, not random task" in printed


def test_of_all_flights_those_that_disagree_fail_and_those_that_jax_lacks_do_not(
    compared, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(cli.places, "RESULTS", tmp_path)
    monkeypatch.setattr(cli.places, "names", lambda _: ["take_off", "test1"])
    assert cli.main(["--all"]) == 0
    shown = capsys.readouterr()
    assert "simulator.ground is given" in shown.err
    assert "not executed by any:" in shown.out
    # Another controller that is refused is the caller's mistake.
    assert cli.main(["--all", "--overwrite", "--set", "controller.torque.steps=2"]) == 2
    compared[1]["tick"] = 2.0
    assert cli.main(["--all", "--overwrite"]) == 1


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
    assert len(compared[0]) == 2  # refused before anything is compared
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
    assert cli.main(["--robot", path, "--dynamics", "mjx", "--out", str(tmp_path)]) == 0
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
    assert found["controller"]["disturbance_observer"]
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
    rows = [compare("dynamics", "bias", [np.nan], [1.0], 0.02)]
    written = cli.write(rows, tmp_path, {"crate": "first"})
    assert json.loads(written[1].read_text())["rows"][0]["absolute"] is None
    kept = [tmp_path / f"kept{path.suffix}" for path in written]
    for path, old in zip(written, kept, strict=True):
        old.hardlink_to(path)
    before = [old.read_bytes() for old in kept]
    cli.write(rows, tmp_path, {"crate": "second"})
    # Who had the old file open still has all of it.
    assert [old.read_bytes() for old in kept] == before
    assert json.loads(written[1].read_text())["crate"] == "second"
    assert not any(path.samefile(old) for path, old in zip(written, kept, strict=True))

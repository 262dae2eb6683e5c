"""An engine from a bench's log: reading, smoothing, regression, descent; and other engines in the arms."""

import jax
import numpy as np
import pytest

from experiments import Refused, record
from experiments.studies.identify_engine import study as bench
from jax_aero.base import tables
from jax_aero.base.places import ROBOT
from paper_figs.figures import FIGURES


@pytest.fixture(scope="module")
def truth():
    table = tables.read(ROBOT)["engines"]["P220"]
    return np.array([table[key] for key in bench.ENGINE_KEYS], dtype=float)


@pytest.fixture(scope="module")
def log(truth):
    return bench.bench_log(truth, 1)


def test_a_log_is_read_as_it_was_written(log, tmp_path, agree):
    (tmp_path / "a.csv").write_text(bench.log_text(log))
    read = bench.read_log(tmp_path / "a.csv")
    agree("thrust", read.thrust, log.thrust, 1e-4)
    agree("throttle", read.throttle, log.throttle, 1e-4)


def test_a_faster_log_is_read_at_every_step(log, tmp_path, agree):
    """At 400 Hz, with other samples between those of the steps."""
    often = bench.Log(*(np.repeat(part, 4) for part in log))
    between = np.arange(often.time.size) % 4
    rows = zip(often.time + between * bench.STEP / 4, often.throttle + between, often.thrust - between, strict=True)
    lines = [",".join(bench.COLUMNS), *(",".join(map(repr, map(float, row))) for row in rows)]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    read = bench.read_log(tmp_path / "a.csv")
    agree("time", read.time, log.time, 1e-4)
    agree("thrust", read.thrust, log.thrust, 1e-4)
    agree("throttle", read.throttle, log.throttle, 1e-4)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a,b\n1,2\n", "expected numbers in the columns time_s, throttle_percent, thrust_n"),
        ("time_s,throttle_percent,thrust_n\n0,1,x\n", "expected numbers"),
        ("time_s,throttle_percent,thrust_n\n0,1,2\n", "1 steps of 0.01 s; expected more than 2000"),
        ("1" * 200_000, "expected numbers"),
    ],
)
def test_what_is_no_log_is_refused(text, words, tmp_path):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(Refused, match=words):
        bench.read_log(tmp_path / "a.csv")
    with pytest.raises(Refused, match="cannot read"):
        bench.read_log(tmp_path / "none.csv")


def test_a_log_with_a_gap_is_refused(log, tmp_path):
    times = log.time.copy()
    times[100:] += 1.0
    (tmp_path / "a.csv").write_text(bench.log_text(log._replace(time=times)))
    with pytest.raises(Refused, match=r"samples are 0\.01 to 1\.01 s apart; expected 0 to 0\.01 s"):
        bench.read_log(tmp_path / "a.csv")


def test_smoothing_leaves_a_cubic_alone(measured):
    t = bench.STEP * np.arange(200)
    found = bench.smooth(3.0 + 2.0 * t - t**2 + 0.5 * t**3)
    inner = slice(bench.WINDOW, -bench.WINDOW)
    # Condition of the cubics in powers of 0.1 s: 1e4 last bits of 4 in value, 1e4 times more in each derivative.
    measured("thrust", np.abs(found.thrust - (3.0 + 2.0 * t - t**2 + 0.5 * t**3))[inner].max(), 1e-11)
    measured("rate", np.abs(found.rate - (2.0 - 2.0 * t + 1.5 * t**2))[inner].max(), 1e-9)
    measured("acceleration", np.abs(found.acceleration - (-2.0 + 3.0 * t))[inner].max(), 1e-7)


def test_the_generator_obeys_the_crates_engine(truth, agree):
    """Plain numbers against the arrays of the JAX twin, whose parity with the crate other tests hold."""
    from jax_aero.body.jets import Engines, thrust_acceleration

    plain = Engines(*truth.tolist())
    with jax.enable_x64(True):
        for thrust, rate, throttle in ((120.0, 15.0, 60.0), (40.0, -30.0, 90.0)):
            twin = thrust_acceleration(Engines(*truth), thrust, rate, throttle)
            agree("acceleration", bench.acceleration_of(plain, thrust, rate, throttle), float(twin), 1e-12)
    agree("step", bench.advance_thrust(10.0, 2.0, 4.0, 0.5), (10.0 + 1.0 + 0.5, 4.0), 1e-15)


def test_a_log_of_a_minute_gives_the_engine(truth, log, measured, tmp_path):
    """From regression alone to the whole log: another log is simulated to within its noise."""
    with jax.enable_x64(True):
        found = bench.identify(log, truth[10:])
        other = bench.bench_log(truth, 2, 30.0)
        whole = bench.simulate(found, other.throttle, bench.smooth(other.thrust))
        true = bench.simulate(truth, other.throttle, bench.smooth(other.thrust))
        states, likelihood = bench.estimate(truth, other, bench.PUBLISHED_Q, 0.01)
        _, wrong = bench.estimate(truth, other, bench.PUBLISHED_Q, 1e-4)
    settled = slice(300, None)
    error = np.sqrt(np.mean((whole - true)[settled] ** 2))
    measured("held-out thrust [N]", error, 4.0, because="one seed of noise: what a minute of it leaves unknown")
    # The estimator is better than its sensor, and a noise it does not have is less likely.
    assert np.std((states[:, 0] - true)[settled]) < 0.6 * bench.NOISE
    assert likelihood > wrong
    dataset = bench.to_dataset(other, found, truth, whole, true, {"tuned": states, "published": states})
    dataset.attrs |= {"made": 1, "config_hash": "0"}
    assert bench.figures(dataset)["noise: measured less smoothed [N]"] < 1.2
    folder = tmp_path / "identify_engine" / "P220"
    folder.mkdir(parents=True)
    record.write_dataset(dataset, folder / "run.nc")
    figure, hashes = FIGURES["engine"].draw_from_results(tmp_path / "flight")
    assert len(figure.axes) == 3
    assert hashes == {"P220": "0"}


def test_figures_are_root_mean_squares_on_the_held_out_log(truth, agree):
    """A ramp of 20 N/s from 10 N, simulated 3 N and 4 N off, estimated 1 N and 2 N/s off."""
    t = bench.STEP * np.arange(2500)
    thrust = 10.0 + 20.0 * t
    log = bench.Log(t, 50.0 + 0.0 * t, thrust)
    off = np.column_stack([thrust, 20.0 + 0.0 * t]) + np.array([1.0, -2.0])
    data = bench.to_dataset(log, truth, truth, thrust + 3.0, thrust - 4.0, {"tuned": off, "published": off})
    data.attrs |= {"made": 0, "r": 0.5}
    found = bench.figures(data)
    span = np.ptp(bench.smooth(thrust).thrust)
    # Cubics and differences of 500 N have 1e-11 of it.
    expected = [0.0, 3.0, 100.0 * 3.0 / span, 4.0, 100.0 * 4.0 / span, 1.0, 2.0, 1.0, 2.0, 0.5]
    agree("figures", list(found.values()), expected, 1e-8)


def test_the_noise_of_a_log_is_that_about_its_smoothed_thrust(truth, monkeypatch, measured):
    """A cubic with noise of 2 N, and edges of ten steps; of the filters' Q the one that is said to be likeliest."""
    t = bench.STEP * np.arange(20_000)
    thrust = 50.0 + 0.01 * t**2 + 2.0 * np.random.default_rng(1).normal(size=t.size) + 20.0 * np.floor(t / 20.0)
    monkeypatch.setattr(bench, "estimate", lambda _engine, _log, q, _r: (None, q[0, 0] - abs(q[1, 1] - 1.0)))
    q, r = bench.tune(truth, bench.Log(t, 0.0 * t, thrust))
    np.testing.assert_array_equal(q, np.diag([10.0, 1.0]))
    # A median of n magnitudes is known to 1.17/√n; two of them for the variance, neighbours are alike, four of these.
    limit = 4.0 * 2.0 * 1.17 / np.sqrt(t.size) + 0.02
    measured("variance", abs(r / bench.STEP / 4.0 - 1.0), limit, because="one seed of noise")


def test_an_engine_is_identified_from_the_logs_that_are_named(truth, log, tmp_path, monkeypatch):
    for name in ("train", "test"):
        (tmp_path / f"{name}.csv").write_text(bench.log_text(log))
    seen = []
    monkeypatch.setattr(bench, "identify", lambda train, throttle: seen.append((train, throttle)) or truth)
    monkeypatch.setattr(bench, "tune", lambda *_: (np.diag([2.0, 3.0]), 0.25))
    logs = bench.EngineLogs(train=tmp_path / "train.csv", test=tmp_path / "test.csv")
    read = bench.compute("P220", logs)
    assert (read.dataset.attrs["made"], read.texts) == (0, {})
    made = bench.compute("P220", bench.EngineLogs())
    assert made.dataset.attrs["made"] == 1
    assert sorted(made.texts) == ["test.csv", "train.csv"]
    assert made.texts["train.csv"] != made.texts["test.csv"]
    assert [made.summary[f"tuned {key}"] for key in ("q_thrust", "q_rate", "r")] == [2.0, 3.0, 0.25]
    # The coefficients of the throttle are taken from the file.
    np.testing.assert_array_equal(seen[0][1], truth[10:])
    with pytest.raises(Refused, match=r"no engine `V2`; there are .*P220"):
        bench.compute("V2", bench.EngineLogs())
    with pytest.raises(ValueError, match="expected both `train` and `test`, or none"):
        bench.EngineLogs(train=tmp_path / "train.csv")

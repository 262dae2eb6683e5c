"""An engine of the shaft's speed from a bench's log."""

import numpy as np
import pytest

from experiments.studies.identify_engine import shaft, study
from jax_aero.base.tables import Interval
from jax_aero.base.terminal import Refused
from jax_aero.body.shaft import Ambient
from jax_aero.data.import_bench import Bench

MADE = {
    "idle": 0.25,
    "ramp_up": 0.2,
    "ramp_down": 0.15,
    "lag_up": 0.7,
    "lag_down": 0.9,
    "acceleration": 0.25,
    "deceleration": 0.3,
    "exponent": 1.4,
    "thrust_max": 160.0,
    "square_share": 0.4,
    "dead_time": 0.1,
}
"""An engine that is made up: another one than any on a bench."""
FULL = 120_000.0
STEPS = [(0.0, 0.0), (4.0, 40.0), (10.0, 100.0), (18.0, 60.0), (24.0, 85.0), (30.0, 0.0), (38.0, 55.0), (44.0, 20.0)]


def made_bench(rate=50.0, drift=0.0, noise=(50.0, 0.5), seed=3):
    """The log of a run of 50 s between two stands of 10 s, integrated in steps of 1 ms, in plain numbers."""
    k, rng = MADE, np.random.default_rng(seed)
    step = 1e-3
    time = np.arange(-10.0, 60.0, step)
    throttle = np.array([next((u for t, u in reversed(STEPS) if x - k["dead_time"] >= t), 0.0) for x in time])
    runs = (time >= 0.0) & (time < 50.0)
    speed, wanted, signals = k["idle"], k["idle"], np.zeros((3, time.size))
    heat = 0.0
    for tick in np.flatnonzero(runs):
        goal = k["idle"] + (1.0 - k["idle"]) * throttle[tick] / 100.0
        wanted += min(max(goal - wanted, -step * k["ramp_down"]), step * k["ramp_up"])
        error = wanted - speed
        most = speed ** k["exponent"]
        rate_now = error / (k["lag_up"] if error > 0 else k["lag_down"])
        thrust = k["thrust_max"] * (k["square_share"] * speed**2 + (1.0 - k["square_share"]) * speed**3)
        heat += thrust * step
        signals[:, tick] = wanted, speed, thrust + drift * heat
        speed += step * min(max(rate_now, -k["deceleration"] * most), k["acceleration"] * most)
    signals[2, time >= 50.0] = drift * heat
    rows = np.arange(0, time.size, round(1.0 / rate / step))
    speeds = FULL * signals[1, rows] + np.where(runs[rows], rng.normal(scale=noise[0], size=rows.size), 0.0)
    thrusts = signals[2, rows] + rng.normal(scale=noise[1], size=rows.size)
    # The throttle of the log is that of the present; the engine has it after its dead time.
    asked = np.array([next((u for t, u in reversed(STEPS) if x >= t), 0.0) for x in time[rows]])
    return Bench(time[rows], asked, np.full(rows.size, np.nan), speeds, thrusts)


def found_of(log):
    return shaft.identify(shaft.sample(log, (0.0, 49.9), Ambient()))


def outside(fitted, truth):
    """Numbers of which the truth is outside of the interval, widened by a sample of 20 ms, or by a hundredth."""
    wrong = set()
    for name in fitted.interval.keys() & truth.keys():
        least, greatest = fitted.interval[name]
        slack = 0.02 if shaft.UNITS.get(name) == "s" else 0.01 * abs(truth[name])
        if not least - slack <= truth[name] <= greatest + slack:
            wrong.add(name)
    return wrong


@pytest.fixture(scope="module")
def fitted_made():
    log = made_bench(drift=0.002)
    thrust = np.where(log.thrust > 140.0, np.nan, log.thrust)  # clipped
    speed = log.speed.copy()
    speed[1200:1300] = np.nan  # a gap of 2 s
    return found_of(log._replace(thrust=thrust, speed=speed))


def test_the_truth_of_a_made_up_bench_lies_within_its_intervals(fitted_made, measured):
    """With noise, a gap, clipped thrusts and a cell whose zero drifts by 6 N."""
    assert not outside(fitted_made, MADE)
    width = np.diff(fitted_made.interval["lag_up"])[0]
    measured("interval of the lag [s]", width, 0.4, because="one seed of noise")
    measured("thrust [N]", abs(fitted_made.numbers["thrust_max"] - 160.0), 3.0, because="a drift of 6 N, removed")


@pytest.mark.parametrize(
    ("name", "factor"),
    [("lag_up", 1.5), ("acceleration", 0.7), ("ramp_down", 1.2), ("thrust_max", 1.05), ("square_share", -1.0)],
)
def test_a_wrong_factor_or_sign_lies_outside_of_them(fitted_made, name, factor):
    assert outside(fitted_made, MADE | {name: factor * MADE[name]}) == {name}


def test_of_speeds_or_of_thrusts_alone_the_rest_is_predicted(measured):
    log = made_bench(rate=20.0)
    nothing = np.full(log.time.size, np.nan)
    of_speed = found_of(log._replace(thrust=nothing))
    assert not outside(of_speed, MADE)
    assert np.isnan(of_speed.numbers["thrust_max"])
    only = log._replace(speed=nothing)
    of_thrust = found_of(only)
    run = shaft.sample(only, (0.0, 49.9), Ambient())
    off = np.sqrt(np.nanmean((of_thrust.thrust - run.thrust) ** 2))
    measured("thrust [N]", off, 1.0, because="noise of 0.5 N, and ramps that steps of 10 ms resolve")


def test_the_wanted_speed_tells_ramps_and_idle(agree):
    time = np.arange(0.0, 20.0, 0.1)
    wanted = np.interp(time, [0.0, 2.0, 4.0, 10.0, 13.0], [0.3, 0.3, 0.7, 1.0, 0.4]) * 1e5
    wanted[(time > 4.05) & (time < 8.0)] = 0.7e5
    run = shaft.sample(Bench(time, np.nan * time, wanted, wanted, np.nan * time), (0.0, 20.0), Ambient())
    assert run.speed_max == max(wanted)
    found = shaft.ramps(run)
    agree("up", found["ramp_up"] * run.speed_max, 2e4, 0.02 * 2e4)
    agree("down", found["ramp_down"] * run.speed_max, 2e4, 0.02 * 2e4)
    assert run.rises[500]
    assert not run.rises[1200]


def test_a_long_gap_stays_one_and_a_short_one_is_a_line(agree):
    stamps = np.array([0.0, 0.1, 0.2, 0.6, 2.0, 2.1])
    found = shaft.resample(np.array([0.05, 0.4, 1.0, 2.05, 3.0]), stamps, 10.0 * stamps)
    agree("lines", found[[0, 1, 3]], [0.5, 4.0, 20.5], 1e-12)
    assert np.isnan(found[[2, 4]]).all()


def test_a_bench_gives_errors_of_the_engine(tmp_path, monkeypatch):
    log = made_bench(rate=20.0)
    monkeypatch.setattr(study, "load_bench", lambda _: log)
    monkeypatch.setattr(shaft, "BLOCK", 25.0)
    path = tmp_path / "a.nc"
    path.touch()
    span = {"lower": 0.0, "upper": 49.9}
    logs = study.EngineLogs(bench=path, span=Interval(**span))
    found = study.compute("made", logs).summary
    assert found["simulated, rise: rms error of thrust [N]"] < 2.0
    with pytest.raises(Refused, match="expected --set bench=FILE"):
        study.compute("made", study.EngineLogs())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"throttle": np.nan}, "neither the speed that is wanted nor the throttle"),
        ({"speed": np.nan, "thrust": np.nan}, "neither speeds nor thrusts"),
        ({"time": 1e3}, "0 rows from 0 to 49.9 s"),
    ],
)
def test_a_log_from_which_nothing_follows_is_refused(change, words):
    log = made_bench(rate=10.0)
    with pytest.raises(Refused, match=words):
        shaft.sample(
            log._replace(**{key: value + 0.0 * log.time for key, value in change.items()}), (0.0, 49.9), Ambient()
        )

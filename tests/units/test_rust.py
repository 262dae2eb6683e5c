"""The Python face of the crate, with short flights."""

import json
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from experiments import record
from experiments.manifest import REPOSITORY
from jax_aero import rust

TEST2 = REPOSITORY / "configs" / "experiments" / "test2.toml"
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


@pytest.mark.parametrize("value", [np.float64, {1, 2}, float("nan")])
def test_a_value_no_file_could_hold_is_refused(value):
    with pytest.raises(ValueError, match="no number, text, list or table"):
        rust.load_config(TEST2, {"simulator.duration": value})


def test_the_digest_follows_the_configuration_alone():
    config = rust.load_config(TEST2)
    assert rust.config_digest(config) == rust.config_digest(json.loads(json.dumps(config)))
    assert rust.config_digest(config) != rust.config_digest(rust.load_config(TEST2, SHORT))


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
            assert alone.summary == together.summary
            for name, values in alone.log.items():
                np.testing.assert_array_equal(values, together[name], err_msg=name)


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


SLOW_BATCH = """
import sys
from jax_aero import rust
config = rust.load_config("configs/experiments/test2.toml", {"simulator.duration": 20.0})
print("ready", flush=True)
rust.fly_batch([config] * 2000) if sys.argv[1] == "batch" else rust.fly(
    rust.load_config("configs/experiments/no_wind.toml", {"simulator.duration": 2000.0})
)
"""


@pytest.mark.parametrize("call", ["batch", "single"])
def test_ctrl_c_ends_a_long_call_at_once(call, start):
    """The interrupt arrives while Rust flies with the interpreter lock released."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = start(sys.executable, "-c", SLOW_BATCH, call, cwd=REPOSITORY, **pipes)
    assert process.stdout.readline() == "ready\n"
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=10)
    assert process.returncode != 0
    assert "KeyboardInterrupt" in errors

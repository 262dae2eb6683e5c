"""What many tests use: measurements, processes that end, a made-up flight."""

from __future__ import annotations

import gc
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jax_aero import rust
from jax_aero.base import places
from jax_aero.base.result import FlightResult, labels_of
from jax_aero.results import record
from jax_aero.results.flight import identity_of

pytest_plugins = ["tests.measurements"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put tests in a browser first: at the end one process would wait for them alone."""
    items.sort(key=lambda item: "view" not in item.path.parts)


# --- durations ----------------------------------------------------------------------------------------------------

_seconds: Counter[str] = Counter()
"""Durations of set-up, call and tear-down, by folder of `tests/` [s]."""


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Add a duration to those of its folder; the controller of several processes receives all reports."""
    path = report.nodeid.partition("::")[0]
    _seconds[path.rpartition("/")[0].removeprefix("tests/")] += report.duration


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Write the durations of the folders, as if one process had run all tests."""
    said = ", ".join(f"{folder} {seconds:.0f} s" for folder, seconds in _seconds.most_common())
    terminalreporter.write_line(f"durations, all processes together: {said}; {_seconds.total():.0f} s in all")


# --- what was skipped ---------------------------------------------------------------------------------------------


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_sessionfinish(session: pytest.Session) -> Iterator[None]:
    """Write as the last line what was skipped: how often, why, and the command that brings what it needs."""
    yield
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is not None and (skipped := reporter.stats.get("skipped")):
        reasons = Counter(report.longrepr[2].removeprefix("Skipped: ") for report in skipped)
        each = "; ".join(f"{count} × {reason}" for reason, count in reasons.most_common())
        reporter.write_line(f"{len(skipped)} skipped: {each}")


# --- memory -------------------------------------------------------------------------------------------------------

# JAX's traces are millions of small objects: with Python's usual thresholds a tenth of its tests' time goes into
# looking for garbage among them.
gc.set_threshold(100_000, 50, 100)


@pytest.fixture(scope="module", autouse=True)
def compiled_programs() -> Iterator[None]:
    """Drop what XLA has compiled with the tests of a module, or a process holds some gigabytes of it at the end."""
    yield
    if "jax" in sys.modules:
        sys.modules["jax"].clear_caches()


# --- processes ----------------------------------------------------------------------------------------------------


@pytest.fixture
def start() -> Iterator[Callable[..., subprocess.Popen[Any]]]:
    """Start processes that SIGINT interrupts, also where the tests themselves ignore it, and end them with the test."""
    with ExitStack() as processes:

        def start(*command: object, **options: Any) -> subprocess.Popen[Any]:
            # A child ignores what its parent ignores, while a signal that its parent handles is back at its default.
            before = signal.signal(signal.SIGINT, signal.default_int_handler)
            try:
                process = subprocess.Popen([str(word) for word in command], **options)
            finally:
                signal.signal(signal.SIGINT, before)
            processes.enter_context(process)
            processes.callback(process.kill)
            return process

        yield start


@pytest.fixture
def stopped_sweep(monkeypatch: pytest.MonkeyPatch) -> Callable[[Any, int, Path], None]:
    """Fly a sweep (`Design`) into a folder until some of its chunks are there."""
    # Needs a package that the tests of the core do not.
    from jax_aero.sweep import run

    flown = run._fly_chunks

    def stop(design: Any, count: int, out: Path) -> None:
        def fly_and_stop(design: Any, chunks: list[int], *where: Any) -> Iterator[Any]:
            yield from flown(design, chunks[:count], *where)
            raise KeyboardInterrupt

        with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
            patched.setattr(run, "_fly_chunks", fly_and_stop)
            run.run(design, workers=1, out=out)

    return stop


# --- a made-up flight ---------------------------------------------------------------------------------------------


ROBOT = rust.Robot(places.ROBOT)


@pytest.fixture(scope="session")
def robot() -> rust.Robot:
    return ROBOT


def made_up_flight(duration: float = 50.0, lost_time: float | None = None, step: float = 0.1) -> FlightResult:
    t = np.arange(0.0, (lost_time or duration) + step / 2, step)
    n = t.size
    ramp = np.clip((t - 5.0) / 5.0, 0.0, 1.0)
    drift = ramp * (np.exp((t - t[-1]) / 3.0) if lost_time else 0.05)
    reference = np.stack(
        [3.0 * np.clip(t - 20.0, 0.0, 15.0), 0.0 * t, 0.75 + 0.7 * np.clip(t - 10.0, 0.0, 7.0)], axis=1
    )
    wobble = np.sin(t[:, None] + np.arange(23.0)) * (0.05 + 0.4 * drift)[:, None]
    force = np.zeros((n, 13, 3))
    force[:, :, 1] = -ramp[:, None]
    force[:, :, 0] = -0.5 * np.sin(t / 8.0)[:, None] ** 2
    sizes = {"time": n} | {dim: len(labels) for dim, labels in labels_of(ROBOT).items()}
    log = {
        name: np.full([sizes[dim] for dim in signal.dims], 0.1 if name.startswith("raw_") else 0.0)
        for name, signal in rust.signals().items()
        if signal.dims[0] == "time" and not signal.is_of_ground
    }
    log |= {
        "time": t,
        "base_position": reference + 0.05,
        "base_quaternion": np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)),
        "joint_position": 0.2 + wobble,
        "com_position": reference + drift[:, None] * np.array([0.1, -0.6, 0.05]),
        "com_setpoint": reference,
        "rotation_error": 0.03 + 1.5 * drift,
        "base_rpy_setpoint": np.tile([0.0, 0.0, np.pi], (n, 1)),
        "thrust": np.array([98.0, 98.0, 113.0, 113.0])
        + np.outer(ramp, [20.0, -15.0, 30.0, -25.0]) * (1 + drift[:, None]),
        "wind": np.outer(ramp, [0.0, -10.0, 0.0]),
        "aero_force_sim": force,
        "aero_force_control": 0.8 * force,
        "measured_base_quaternion": np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        "measured_wind": np.outer(ramp, [0.0, -10.0, 0.0]),
        "raw_base_rotation": np.tile(np.eye(3), (n, 1, 1)),
        "qp_kkt": np.full((n, 2), 1e-12),
        "qp_iterations": np.full((n, 2), 3.0),
    }
    return FlightResult(
        log=log,
        joint_setpoint=np.full(23, 0.2),
        outcome="fell" if lost_time else "completed",
        lost_time=lost_time,
        lost_reason="rotation error above 90 deg" if lost_time else None,
        summary={"max_com_error": 0.017, "max_rotation_error": 0.05, "thrust_min": 57.9, "thrust_max": 179.2},
    )


@pytest.fixture
def make_flight() -> Callable[..., FlightResult]:
    return made_up_flight


@pytest.fixture(scope="session")
def made_up_results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A results folder with the flights the figures show; one of them falls. A test that changes it copies it."""
    results = tmp_path_factory.mktemp("made_up")
    falls = {"test1": None, "test2": None, "test1_published": 21.5, "test2_published": None}
    falls |= dict.fromkeys(["test1_observer", "test1_published_observer"])
    falls |= dict.fromkeys(["test3", "test4", "robustness", "test4_published", "robustness_published"])
    falls |= {"test3_published": 20.5, "test1_gale": 27.6}
    falls |= dict.fromkeys(["test2_gale", "test1_observer_gale", "robot_gale"])
    for name, lost_time in falls.items():
        digest = name.encode().hex().ljust(64, "0")
        dataset = record.to_dataset(
            made_up_flight(lost_time=lost_time), ROBOT, title=f"{name}: made up", config_digest=digest
        )
        facts = identity_of(rust.load_config(name)).facts
        record.write_run(results / "flight" / name, dataset, {"name": name, **facts})
    return results


@pytest.fixture(scope="module")
def x64() -> Iterator[None]:
    """Double precision for the JAX tests of a module alone."""
    import jax

    with jax.enable_x64(True):
        yield


# --- both engines -------------------------------------------------------------------------------------------------


@pytest.fixture
def fly_both(measured: Callable[..., None]) -> Callable[..., tuple[FlightResult, FlightResult]]:
    """Hold a flight of the crate to JAX as `jax-aero verify` does, and return both's; figures of merit agree to 1e-6.

    A `tolerance` relative to the greatest value of each signal replaces that of `verify`, tick by tick.
    """
    # Needs a package that the tests of the core do not.
    from jax_aero.verify.flight import verify_flight

    def fly(config: dict[str, Any], tolerance: float | None = None) -> tuple[FlightResult, FlightResult]:
        found = verify_flight(config)
        crate, twin = found.crate, found.twin
        assert found.share == 1.0
        shapes = [{name: values.shape for name, values in flight.log.items()} for flight in (crate, twin)]
        assert shapes[0] == shapes[1]
        for row in found.rows:
            if tolerance is None:
                assert row.agrees, row
            elif row.group == "tick":
                measured(f"{config['title']}: {row.quantity}", row.relative, tolerance)
        assert twin.summary.keys() == crate.summary.keys()
        for name in crate.summary.keys() - {"max_kkt", "max_qp_iterations"}:
            expected = crate.summary[name]
            assert np.isnan(twin.summary[name]) == np.isnan(expected), name
            error = np.nan_to_num(abs(twin.summary[name] - expected))
            measured(name, error, np.nan_to_num(max(1e-9, (tolerance or 1e-6) * abs(expected))))
        return crate, twin

    return fly

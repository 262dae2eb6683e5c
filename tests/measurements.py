"""Numbers that tests measure, their tolerances, and on request those that use much of their tolerance."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import ArrayLike

CLOSE = 0.1
"""The summary lists what uses more than this fraction of its tolerance."""


class Measurement(NamedTuple):
    """A figure that a test compares with its tolerance."""

    test: str
    what: str
    figure: float
    tolerance: float
    reason: str
    """Why it is fine that the figure is more than a tenth of its tolerance; empty where none is stated."""

    @property
    def used(self) -> float:
        """Fraction of the tolerance that is used."""
        return self.figure / self.tolerance if self.tolerance > 0 else float(self.figure > 0)


_measurements: list[Measurement] = []
_figures: dict[tuple[str, str], float | str] = {}
_running: list[pytest.Item] = []


def measured(what: str, figure: float | str, tolerance: float | None = None, because: str = "") -> None:
    """Compare a figure with its tolerance; without one, only put it into the table at the end of the run.

    Of several figures of one name the largest stays. `because` is the reason why more than a tenth of the tolerance may
    be used; for all measurements of a test, its mark `close_to_tolerance` is.
    """
    if tolerance is not None:
        _record(what, float(figure), tolerance, because)
        assert figure <= tolerance, f"{what}: {figure:.3e}, allowed {tolerance:.3e}"
        return
    _keep(_running[0].path.stem.removeprefix("test_"), what, figure)


def _keep(module: str, what: str, figure: float | str) -> None:
    before = _figures.get((module, what))
    if not isinstance(figure, str):
        figure = float(figure) if before is None else max(float(figure), float(before))
    _figures[module, what] = figure


def agree(quantity: str, ours: ArrayLike, theirs: ArrayLike, tolerance: float) -> None:
    """Compare two arrays relative to the largest entry of the second."""
    ours, theirs = np.asarray(ours), np.asarray(theirs)
    assert ours.shape == theirs.shape, quantity
    error = float(np.max(np.abs(ours - theirs)) / max(float(np.max(np.abs(theirs))), 1e-300))
    measured(quantity, error, tolerance)


@pytest.fixture(name="measured")
def _measured() -> Callable[..., None]:
    return measured


@pytest.fixture(name="agree")
def _agree() -> Callable[[str, ArrayLike, ArrayLike, float], None]:
    return agree


def _record(what: str, figure: float, tolerance: float, because: str = "") -> None:
    if _running:
        marker = _running[0].get_closest_marker("close_to_tolerance")
        test = _running[0].nodeid.removeprefix("tests/").partition("[")[0]
        reason = because or (marker.args[0] if marker else "")
        _measurements.append(Measurement(test, what, float(figure), float(tolerance), reason))


# --- np.testing.assert_allclose is a measurement too ----------------------------------------------------------------

_assert_allclose = np.testing.assert_allclose


def _measured_allclose(
    actual: ArrayLike, desired: ArrayLike, rtol: float = 1e-7, atol: float = 0.0, **options: Any
) -> None:
    """Do what `np.testing.assert_allclose` does, and record the entry that uses most of its tolerance."""
    difference = np.ravel(np.abs(np.subtract(actual, desired)))
    allowed = np.ravel(
        np.broadcast_to(atol + rtol * np.abs(desired), np.broadcast_shapes(np.shape(actual), np.shape(desired)))
    )
    finite = np.isfinite(difference) & np.isfinite(allowed)
    if finite.any():
        difference, allowed = difference[finite], allowed[finite]
        worst = np.argmax(difference / np.maximum(allowed, 1e-300))
        _record(options.get("err_msg") or "assert_allclose", difference[worst], allowed[worst])
    _assert_allclose(actual, desired, rtol=rtol, atol=atol, **options)


def pytest_configure() -> None:
    """Measure what every `np.testing.assert_allclose` compares."""
    np.testing.assert_allclose = _measured_allclose


def pytest_unconfigure() -> None:
    """Put NumPy's own back."""
    np.testing.assert_allclose = _assert_allclose


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Hand over what a worker process measured."""
    if (output := getattr(session.config, "workeroutput", None)) is not None:
        output["measurements"] = [tuple(one) for one in _measurements]
        output["figures"] = list(_figures.items())


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Take over what a worker process measured."""
    output = getattr(node, "workeroutput", {})
    _measurements.extend(Measurement(*one) for one in output.get("measurements", ()))
    for (module, what), figure in output.get("figures", ()):
        _keep(module, what, figure)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Store the name of the test that measures."""
    _running[:] = [item]
    try:
        return (yield)
    finally:
        _running.clear()


# --- the summary --------------------------------------------------------------------------------------------------


def _read_rust() -> Iterator[Measurement]:
    """Yield what the Rust tests wrote into the folder `MEASURED`, one file for each process."""
    folder = os.environ.get("MEASURED")
    for file in sorted(Path(folder).glob("*.tsv")) if folder else ():
        for line in file.read_text(encoding="utf-8").splitlines():
            test, what, figure, tolerance, reason = line.split("\t")
            yield Measurement(test, what, float(figure), float(tolerance), reason)


def _worst(measurements: Iterable[Measurement]) -> list[Measurement]:
    """Keep of several of one name in one test that which uses most of its tolerance; sorted by that."""
    worst: dict[tuple[str, str], Measurement] = {}
    for one in measurements:
        kept = worst.setdefault((one.test, one.what), one)
        if not one.used <= kept.used:
            worst[one.test, one.what] = one
    return sorted(worst.values(), key=lambda one: -one.used)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let the summary be asked for: a passing run is read for what passed and what was skipped."""
    parser.addoption(
        "--tolerances", action="store_true", help="print figures, and measurements that use much of their tolerance"
    )


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Write, where asked, the table of figures, and what uses more than a tenth of its tolerance; else their number."""
    everything = _worst([*_read_rust(), *_measurements])
    close = [one for one in everything if not one.used <= CLOSE]
    title = f"{len(close)} of {len(everything)} measurements use more than {CLOSE:.0%} of their tolerance"
    if not config.getoption("--tolerances", default=False):
        if everything:
            terminalreporter.write_line(f"{title} (listed by --tolerances)")
        return
    if _figures:
        terminalreporter.section("figures")
    widths = [max((len(key[column]) for key in _figures), default=0) for column in (0, 1)]
    for (module, what), figure in sorted(_figures.items(), key=lambda row: row[0][0]):
        text = figure if isinstance(figure, str) else f"{figure:.1e}"
        terminalreporter.write_line(f"{module:<{widths[0]}}  {what:<{widths[1]}}  {text}")
    if everything:
        terminalreporter.section(title)
    for test, what, figure, tolerance, reason in close:
        used = f"{figure:.2g} of {tolerance:.2g}"
        terminalreporter.write_line(f"{test}: {what}: {used}: {reason or 'NO REASON STATED'}")

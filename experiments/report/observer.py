"""Claims of ours on the recommended controller, judged from its sweeps; the paper does not contain them.

An error over many flights is given as median, 90 % quantile and maximum.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from experiments.report.judges import Judge
from experiments.report.results import Cell, Results, count
from experiments.report.verdicts import Judged, Verdict, judge
from experiments.sweep.table import wilson

UNWARNED_SHARE = 0.02
"""Greatest share of lost flights that may be lost without a warning."""

OUTAGE_SPEED = 10.0
"""Wind speed of the claims on outages, that of the paper [m/s]."""


def _errors(cell: Cell) -> str:
    low, high, worst = (cell[f"rotation_error_deg_{name}"] for name in ("median", "high", "worst"))
    return f"{count(cell)} complete, rotation error {low:.1f}, {high:.1f}, {worst:.1f}°"


def _judge_list(bad: list[str]) -> Verdict:
    return judge(not bad, ", ".join(bad))


def _list_failures(cells: Iterable[tuple[str, Cell]], error: str, limit: float) -> list[str]:
    """Return the cells in which flights are lost or the error exceeds a limit [deg]."""
    found = []
    for name, cell in cells:
        if cell["completed"] < cell["flights"]:
            found.append(f"{name}: {cell['flights'] - cell['completed']} of {cell['flights']} do not complete")
        elif cell[f"rotation_error_deg_{error}"] > limit:
            found.append(f"{name}: {cell[f'rotation_error_deg_{error}']:.1f}°")
    return found


def _judge_errors(cells: Sequence[tuple[str, Cell]], error: str, limit: float) -> Judged:
    """Return the errors of named cells, and whether all complete within a limit [deg]."""
    return "; ".join(f"{name}: {_errors(cell)}" for name, cell in cells), _judge_list(
        _list_failures(cells, error, limit)
    )


def tests(arms: str, limit: float) -> Judge:
    """Judge TEST1 and TEST3, flown without an aerodynamic model."""

    def judge(results: Results) -> Judged:
        sweep = results.sweep("observer_tests")
        cells = [(test, sweep.cell(test=f"{test}, {arms} arms")) for test in ("TEST1", "TEST3")]
        return _judge_errors(cells, "worst", limit)

    return judge


def _pool_cells(cells: list[dict[str, Any]]) -> str:
    flights = sum(cell["flights"] for cell in cells)
    lost = flights - sum(cell["completed"] for cell in cells)
    worst = max(cell["rotation_error_deg_worst"] for cell in cells)
    medians = [cell["rotation_error_deg_median"] for cell in cells]
    return (
        f"{lost} of {flights} do not complete, medians of the directions {min(medians):.1f} to {max(medians):.1f}°, "
        f"worst {worst:.1f}°"
    )


def fast_wind(results: Results) -> Judged:
    """Judge flights in winds of 26 m/s from all directions."""
    sweep = results.sweep("observer_wind")
    texts, bad = [], []
    for controller in sweep.levels("controller"):
        cells = sweep.select(controller=controller, speed=26.0)
        texts.append(f"{controller}: {_pool_cells(cells)}")
        bad += _list_failures(((f"{controller} from {cell['direction']:g}°", cell) for cell in cells), "median", 12.0)
    return "; ".join(texts), _judge_list(bad)


def every_wind(results: Results) -> Judged:
    """Judge winds of up to 40 m/s."""
    sweep = results.sweep("observer_wind")
    texts, bad = [], []
    for controller in sweep.levels("controller"):
        for speed in sweep.levels("speed"):
            cells = sweep.select(controller=controller, speed=speed)
            lost = sum(cell["flights"] - cell["completed"] for cell in cells)
            if speed > 26.0:
                texts.append(f"{controller}, {speed:g} m/s: {_pool_cells(cells)}")
            if lost:
                bad.append(f"{controller} at {speed:g} m/s: {lost} of {sum(cell['flights'] for cell in cells)}")
    return "; ".join(texts), _judge_list(bad)


def model_errors(results: Results) -> Judged:
    """Judge flights of robots that differ from the controller's model."""
    sweep = results.sweep("observer_errors")
    named = ("mass +10 %", "CoM 4 cm", "left arm jet -10 %")
    errors = [name for name in sweep.levels("model_error") if any(word in name for word in named)]
    cells = [(error, sweep.cell(controller="observer and model", model_error=error)) for error in errors]
    return _judge_errors(cells, "median", 10.0)


def sensors(results: Results) -> Judged:
    """Judge flights with realistic sensors."""
    sweep = results.sweep("sensors_tests")
    cells = [
        (flight, sweep.cell(controller="observer and estimator", flight=flight)) for flight in sweep.levels("flight")
    ]
    return _judge_errors(cells, "worst", 12.0)


def false_alarms(results: Results) -> Judged:
    """Judge how often a channel is predicted or an engine limited in flights without failures."""
    cells = results.sweep("observer_tests").cells + results.sweep("sensors_tests").select(
        controller="observer and estimator"
    )
    flights, alarmed = (sum(cell[name] for cell in cells) for name in ("flights", "degraded"))
    low, high = wilson(alarmed, flights)
    text = f"{alarmed} of {flights} flights, {1000.0 * low:.1f} to {1000.0 * high:.1f} of 1000 (95 %)"
    return text, judge(not alarmed, f"{alarmed} false alarms")


def announced_losses(results: Results) -> Judged:
    """Judge how many flights are lost that were not degraded 0.3 s before, with one fault and with two."""
    texts, missed, losses = [], 0, 0
    for name in ("faults", "fault_pairs"):
        sweep = results.sweep(name)
        for controller in sweep.levels("controller"):
            cells = sweep.select(controller=controller)
            columns = ("flights", "unwarned", "fell", "diverged")
            flights, unwarned, fell, diverged = (sum(cell[column] for cell in cells) for column in columns)
            texts.append(f"{name}, {controller}: {unwarned} of {fell + diverged} lost ones of {flights}")
            missed, losses = missed + unwarned, losses + fell + diverged
    low, high = wilson(missed, losses)
    whole = f"{missed} of {losses} ({100.0 * low:.1f} to {100.0 * high:.1f} %)"
    return f"{whole}; {'; '.join(texts)}", judge(missed <= UNWARNED_SHARE * losses, whole)


def _outages(results: Results, what: Mapping[str, tuple[float, ...]]) -> Judged:
    sweep = results.sweep("outages_observer")
    cells = [
        (f"{channel}, {'for good' if duration > 30.0 else f'{duration:g} s'}", cell)
        for channel, durations in what.items()
        for duration in durations
        for cell in sweep.select(channel=channel, duration=duration, speed=OUTAGE_SPEED)
    ]
    return _judge_errors(cells, "worst", 90.0)


def permanent_outages(results: Results) -> Judged:
    """Judge flights that lose wind or thrust sensors for good."""
    return _outages(results, {"wind": (60.0,), "all thrusts": (60.0,)})


def temporary_outages(results: Results) -> Judged:
    """Judge flights that temporarily lose base rotation, velocity or position."""
    return _outages(results, dict.fromkeys(("rotation", "velocity", "position"), (0.3, 1.0)))


def lost_engines(results: Results) -> Judged:
    """Judge hovering flights in which an engine fades, stops or keeps its thrust."""
    sweep = results.sweep("engine_loss")
    cells = [
        (failure.removesuffix(" at 18 s"), sweep.cell(engines="found, descends", failure=failure))
        for failure in sweep.levels("failure")
        if failure.endswith("at 18 s")
    ]
    return _judge_errors(cells, "worst", 90.0)


def ahead_in_turbulence(results: Results) -> Judged:
    """Judge the predictive law in turbulence, with a model of the air and without."""
    sweep = results.sweep("ahead_turbulence")
    cells = [
        (f"{controller}, {world}, {speed:g} m/s", sweep.cell(controller=controller, world=world, speed=speed))
        for controller in sweep.levels("controller")
        if controller.startswith("predictive")
        for world in sweep.levels("world")
        for speed in sweep.levels("speed")
    ]
    return _judge_errors(cells, "worst", 5.0)


def ahead_without_engine(results: Results) -> Judged:
    """Judge the predictive law after an engine has stopped at once while hovering."""
    sweep = results.sweep("ahead_engine_loss")
    cells = [
        (f"{failure.removesuffix(' at 18 s')}, {controller}", sweep.cell(controller=controller, failure=failure))
        for controller in sweep.levels("controller")
        if controller.startswith("predictive")
        for failure in sweep.levels("failure")
        if failure.endswith("at 18 s")
    ]
    return _judge_errors(cells, "worst", 90.0)


def wind_estimate(results: Results) -> Judged:
    """Judge the wind estimated from the wrench."""
    found = results.study("wind_observer", "turbulence")
    worlds: dict[str, list[Mapping[str, float]]] = {}
    for name, figures in found.items():
        worlds.setdefault(name.rpartition(", ")[0], []).append(figures)
    speeds = [name.rpartition(", ")[2].removesuffix(" m/s") for name in found]
    texts, bad = [], []
    for world, cells in worlds.items():
        rms, inside = ([cell[key] for cell in cells] for key in ("rms", "inside"))
        shown = f"{min(rms):.2f} to {max(rms):.2f} m/s rms, {100 * min(inside):.0f} to {100 * max(inside):.0f} % inside"
        texts.append(f"{world}: {shown}")
        wrong = {
            f"up to {max(rms):.1f} m/s": max(rms) > 1.5,
            "interval too wide": max(inside) > 0.95,
            "interval too narrow": min(inside) < 0.85,
        }
        bad += [f"{world}: {how}" for how, holds in wrong.items() if holds]
    return f"{speeds[0]} to {speeds[-1]} m/s; " + "; ".join(texts), _judge_list(bad)

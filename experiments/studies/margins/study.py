"""Sizes of errors from which half of the robots are lost, and what announces the losses.

For each flight and each error, robots of a robot's world fly with the greatest size of the error. If at least half of
them are lost, a bisection seeks the size from which on that is so, with the same robots at every size; it takes losses
to be no rarer where an error is greater. Of the smallest size with half of them lost are the modes of the
controller that are set in most flights, and the time for which lost robots were degraded before. An interrupted run is
resumed by the same command. The result goes to `results/margins/NAME/`.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np
import xarray as xr

from jax_aero import backends, rust
from jax_aero.base import quantities, tables
from jax_aero.base.result import LOST
from jax_aero.base.terminal import ConfigError, Refused
from jax_aero.results.study import Findings, Study
from jax_aero.results.work import Work
from jax_aero.sweep import aggregate
from jax_aero.sweep.perturbation import Perturbation

Robots: TypeAlias = Callable[[str, Mapping[str, Any]], Mapping[str, Any]]
"""Function from the name of a job and changed keys to what the flights of all robots are, by column."""

HALF = 0.5
"""Share of lost robots at a margin."""


class Flown(tables.Table, frozen=True):
    """What is flown with each error."""

    label: str
    experiment: str


class Error(tables.Table, frozen=True):
    """What a robot differs by from what its controller knows."""

    name: str
    unit: str
    sizes: tables.Interval
    """Of `none` and `most`."""
    none: dict[str, Any]
    """Values of keys, as the experiments have them."""
    most: dict[str, Any]
    """Values of the same keys with the greatest error."""

    def __post_init__(self) -> None:
        if self.none.keys() != self.most.keys():
            raise ConfigError.of("most", sorted(self.most), f"the keys of `none`, {sorted(self.none)}")

    def size(self, share: float) -> float:
        """Return the size of a share of the greatest error, in its unit."""
        return self.sizes.lower + share * (self.sizes.upper - self.sizes.lower)

    def keys(self, share: float) -> dict[str, Any]:
        """Return the values of the keys for a share of the greatest error."""
        keys: dict[str, Any] = between(self.none, self.most, share)
        return keys


class Margins(tables.Table, frozen=True):
    """One file of `experiments/studies/margins/`."""

    title: str
    flown: tuple[Flown, ...]
    error: tuple[Error, ...]
    perturbation: Perturbation
    """What robots differ by, beside the error."""
    robots: tables.Count = 16
    accuracy: tables.Fraction = 0.125
    """Greatest length of a bisection's last interval, as a share of its upper end."""
    halvings: tables.Natural = 8
    """Most halvings of a bisection, whatever its accuracy."""
    seed: tables.Seed = 0

    def __post_init__(self) -> None:
        for name, labels in (("flown", [one.label for one in self.flown]), ("error", [one.name for one in self.error])):
            if not labels or len(set(labels)) < len(labels):
                raise ConfigError.of(name, labels, "one or more, each once")


def between(none: Any, most: Any, share: float) -> Any:
    """Return the value between two of the same shape, linear in their numbers; `none` where they are no numbers.

    >>> between({"a": [0.0, 1.0], "body": "chest"}, {"a": [4.0, 1.0], "body": "chest"}, 0.25)
    {'a': [1.0, 1.0], 'body': 'chest'}
    """
    if isinstance(none, Mapping):
        return {key: between(value, most[key], share) for key, value in none.items()}
    if isinstance(none, list):
        return [between(*pair, share) for pair in zip(none, most, strict=True)]
    return none + share * (most - none) if isinstance(none, float) else none


def bisected(lost: Callable[[float], float], halvings: int, accuracy: float) -> list[float]:
    """Return the shares of the greatest error that are flown: its whole first, then towards where half are lost.

    `lost` is the share of robots that are lost, by that of the error; if fewer than half are lost at the greatest
    error, only this is flown. The last interval is at most `accuracy` of its upper end, or that of the last halving.

    >>> bisected(lambda share: float(share > 0.3), 8, 0.25)
    [1.0, 0.5, 0.25, 0.375, 0.3125]
    >>> bisected(lambda share: float(share > 0.3), 2, 0.0)
    [1.0, 0.5, 0.25]
    >>> bisected(lambda share: 0.4, 8, 0.25)
    [1.0]
    """
    flown, low, high = [1.0], 0.0, 1.0
    if lost(1.0) < HALF:
        return flown
    for _ in range(halvings):
        if high - low <= accuracy * high:
            break
        middle = 0.5 * (low + high)
        flown.append(middle)
        low, high = (low, middle) if lost(middle) >= HALF else (middle, high)
    return flown


def fly(asked: Margins, config: rust.Config, changes: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Return columns of a sweep's table of flights, with changed keys, for all robots."""
    changed, robot = rust.set_keys(config, changes), rust.Robot(config["robot"])
    drawn = [copy.deepcopy(changed) for _ in range(asked.robots)]
    for repeat, one in enumerate(drawn):
        asked.perturbation.apply(one, asked.seed, repeat, robot)
    flights = []
    for flown in backends.backend(backends.backend_of(config)).fly_batch(drawn):
        if isinstance(flown, backends.Failure):
            raise Refused(f"a flight with {dict(changes)} cannot be flown: {flown.reason}")
        ended = {"outcome": flown.outcome, "lost_time": np.nan if flown.lost_time is None else flown.lost_time}
        flights.append(ended | quantities.in_columns(flown.summary))
    return {name: [flight[name] for flight in flights] for name in flights[0]}


def share_lost(flights: Mapping[str, Any]) -> float:
    """Return the share of flights that are lost."""
    return float(np.mean(np.isin(flights["outcome"], LOST)))


def kept(asked: Margins, flown: Flown, work: Work) -> Robots:
    """Return the function that flies all robots, or reads what is kept of them."""
    config = rust.load_config(flown.experiment)

    def of(job: str, changes: Mapping[str, Any]) -> Mapping[str, Any]:
        name = f"{flown.label}, {job}"
        flights = work.read_json(name)
        if flights is None:
            flights = fly(asked, config, changes)
            work.write_json(name, flights)
        return dict(flights)

    return of


def margin(asked: Margins, error: Error, robots: Robots) -> dict[float, Any]:
    """Return the flights of one error by the shares of the greatest that are flown."""
    flown: dict[float, Any] = {}

    def lost(share: float) -> float:
        flown[share] = robots(f"{error.name} {share:g}", error.keys(share))
        return share_lost(flown[share])

    bisected(lost, asked.halvings, asked.accuracy)
    return flown


def found(error: Error, flown: Mapping[float, Any]) -> dict[str, Any]:
    """Return a row of the summary: between which sizes the margin is, and what announces losses just above it."""
    lost = {share: share_lost(flights) for share, flights in sorted(flown.items())}
    beyond = [share for share, part in lost.items() if part >= HALF]
    if not beyond:
        return {"half lost from": f"> {error.size(1.0):g} {error.unit}"}
    above = beyond[0]
    below = max((share for share in lost if share < above), default=0.0)
    figures = aggregate.figures(flown[above])
    announced = figures["announced_s"]
    return {
        "half lost from": f"{error.size(below):.3g} to {error.size(above):.3g} {error.unit}",
        "lost": f"{figures['lost']} of {figures['flights']}",
        "unwarned": figures["unwarned"],
        "announced [s]": announced,
        "modes": " ".join(name for name, bit in rust.MODES.items() if figures["modes"] & bit),
    }


def compute(_: str, asked: Margins, work: Work) -> Findings:
    """Fly every error with every flight."""
    summary: dict[str, Any] = {}
    sizes = np.full((len(asked.flown), len(asked.error), asked.halvings + 1), np.nan)
    lost, nothing = np.full_like(sizes, np.nan), np.zeros(len(asked.flown))
    for row, one in enumerate(asked.flown):
        robots = kept(asked, one, work)
        nothing[row] = share_lost(robots("no error", {}))
        for column, error in enumerate(asked.error):
            flown = margin(asked, error, robots)
            for place, (share, of) in enumerate(sorted(flown.items())):
                sizes[row, column, place], lost[row, column, place] = error.size(share), share_lost(of)
            summary[f"{error.name}, {one.label}"] = line = found(error, flown)
            print(f"{one.label}, {error.name}: half lost from {line['half lost from']}", flush=True)
    dims = ("flown", "error", "step")
    data = xr.Dataset(
        {
            "size": (dims, sizes, {"long_name": "size of the error, in its unit"}),
            "lost": (dims, lost, {"units": "1", "long_name": "share of the robots that are lost"}),
            "lost_without": ("flown", nothing, {"units": "1", "long_name": "share without an error"}),
            "none": ("error", [error.sizes.lower for error in asked.error], {"long_name": "size of no error"}),
            "unit": ("error", [error.unit for error in asked.error]),
        },
        {"flown": [one.label for one in asked.flown], "error": [error.name for error in asked.error]},
    )
    flights = {one.experiment: rust.load_config(one.experiment) for one in asked.flown}
    return Findings(asked.title, data, summary, flights=flights)


STUDY = Study("margins", __doc__, Margins, compute, ("flight", "take_off"), backend="rust", resumes=True)
main = STUDY.main

"""What no comparison has reached: numbers of JAX's controller and plant whose change nothing that was compared shows.

A wrong number of these agrees in everything. Each is changed alone in the first random ticks, if they depend on it, and
in the first ticks of a flight astray; there almost all show. What has shown nothing yet is changed together, in other
random ticks and in one section of the flights after the other; where something compared is different, either half of it
is, until each of those that show is found alone. What a number of zero is multiplied with shows nothing, so only a
comparison in which it is not zero reaches it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

from jax_aero.control.law.torques import INTEGRAL_LIMIT
from jax_aero.sim.scenario import Scenario
from jax_aero.verify import LEAST_SCALE, Sample
from jax_aero.verify.flight import Section, fly_section
from jax_aero.verify.ticks import twin_ticks

CHANGE = 1.1
"""Factor of a number, so that limits act later; one more than what a zero becomes. Integers change by one."""

ASTRAY = 4
"""Number of the flights astray, whose sections come first; almost everything shows in them."""

SEEN = 1e-6
"""Difference that counts, relative to the greatest entry: far more than any tolerance."""

FEW, FIRST = 2, 10
"""Random ticks that are computed anew at once, and ticks of each flight astray before whole sections; almost everything
shows in the first of them."""

ROBOTS = ("plant.robot.", "controller_model.")

OF_TICKS = ("controller", "plant.robot.")
"""Beginnings of the names of what random ticks depend on."""

COPIED = (
    "aero_links.coefficients",
    "aero_links.diameters",
    "aero_links.lengths",
    "engines",
    "forward_axis",
    "joint_limits",
    "joint_torque_max",
    "joint_torque_rate_max",
    "joint_velocity_max",
)
"""Beginnings of the names of a robot's numbers that no flight reads: it has a copy, or they are of other choices."""

Change = tuple[str, Any]
"""Name of a leaf, and its array with other numbers."""

BEGUN = ("n_ticks", "plant.jets.failure_time", "plant.joint_faults.start", "plant.pushes.start")
"""Numbers that the first state of a flight has, or its end."""


class Compared(NamedTuple):
    """What was compared of one scenario: random ticks, and sections of flights, those astray first."""

    scenario: Scenario
    samples: Sequence[Sample]
    sections: Sequence[Section]


def unreached(flown: Compared, others: Sequence[Compared] = ()) -> list[str]:
    """Return the names of all numbers of a scenario that nothing has reached, neither in `others` by the same name."""
    with jax.enable_x64(True):
        own = _Reach(*flown)
        names = [] if own.integral >= INTEGRAL_LIMIT else ["limit of the integral"]
        # In the flight itself zeros beside other numbers have to show, too.
        left = own.hidden(own.names, zeros=True)
        for other in others:
            left = _Reach(*other).hidden(left, zeros=False)
        return names + left


class _Reach:
    """Which numbers one scenario's comparisons depend on."""

    def __init__(self, scenario: Scenario, samples: Sequence[Sample], sections: Sequence[Section]) -> None:
        # All parts have equal length, so that they are one program.
        parts = [[*samples, *samples][first : first + FEW] for first in range(0, len(samples), FEW)]
        expected = [random_ticks(scenario, part) for part in parts]
        # A robot without joints has none.
        integrals = [part.get("velocity_error_integral", INTEGRAL_LIMIT) for part in expected]
        self.integral = max((np.abs(integral).max() for integral in integrals), default=0.0)
        # Neighbours are alike, so by the golden ratio each section is far from those before it.
        flown = sections[ASTRAY:]
        flown = [flown[place] for place in sorted(range(len(flown)), key=lambda place: 0.618034 * place % 1.0)]
        self.random: list[Callable[[Scenario], bool]] = list(map(partial(partial, _are_others), parts, expected))
        self.flown: list[Callable[[Scenario], bool]] = [
            *(partial(is_another, section=section, ticks=FIRST) for section in sections[:ASTRAY]),
            *(partial(is_another, section=section) for section in (*sections[:ASTRAY], *flown)),
        ]
        leaves, self.structure = jax.tree_util.tree_flatten_with_path(scenario)
        self.values = [value for _, value in leaves]
        names = [jax.tree_util.keystr(path).lstrip(".") for path, _ in leaves]
        self.names = {name: place for place, name in enumerate(names) if not _is_copied(name)}

    def hidden(self, names: Iterable[str], *, zeros: bool) -> list[str]:
        """Return the names of which a change of what is not zero shows nothing, or one of `zeros` beside it."""
        names, unseen, left = list(names), set[str](), list[Change]()
        for name in names:
            if name not in self.names:
                unseen.add(name)
            elif np.size(leaf := self.values[self.names[name]]):
                of_numbers, of_zeros = changes(leaf)
                if of_numbers is None:
                    unseen.add(name)
                    continue
                left.append((name, of_numbers))
                if zeros and of_zeros is not None:
                    left.append((name, of_zeros))
        others = [change for change in left if not change[0].startswith(OF_TICKS)]
        left = self._left_by(self.random, [change for change in left if change[0].startswith(OF_TICKS)])
        left = self._left_by(self.flown, left + others)
        unseen |= {name for name, _ in left}
        return [name for name in names if name in unseen]

    def _left_by(self, comparisons: Sequence[Callable[[Scenario], bool]], made: list[Change]) -> list[Change]:
        """Return the changes that show in none of these comparisons."""
        for number, comparison in enumerate(comparisons):
            parts = [made] if number else [[change] for change in made]
            made = [change for part in parts for change in self._not_shown(comparison, part)]
        return made

    def _not_shown(self, comparison: Callable[[Scenario], bool], made: list[Change]) -> list[Change]:
        """Return the changes that do not show: all if none does together, otherwise those of either half."""
        if not made or not comparison(self._changed(made)):
            return made
        if len(made) == 1:
            return []
        half = len(made) // 2
        return self._not_shown(comparison, made[:half]) + self._not_shown(comparison, made[half:])

    def _changed(self, made: Iterable[Change]) -> Scenario:
        values = list(self.values)
        for name, value in made:
            place = self.names[name]
            values[place] = np.where(value == np.asarray(self.values[place]), values[place], value).astype(value.dtype)
        scenario: Scenario = jax.tree.unflatten(self.structure, values)
        return scenario


def _is_copied(name: str) -> bool:
    return name in BEGUN or any(name.removeprefix(robot).startswith(COPIED) for robot in ROBOTS if robot in name)


def random_ticks(scenario: Scenario, samples: Sequence[Sample]) -> dict[str, Any]:
    """Return the quantities of random ticks of a scenario's controller."""
    controller: Any = scenario.controller
    return twin_ticks(controller, scenario.model, samples)


def changes(leaf: Any) -> tuple[Any | None, Any | None]:
    """Return an array with other numbers in place of those that are not zero, and of zeros; `None` without such."""
    leaf = np.asarray(leaf)
    is_zero = leaf == 0
    if leaf.dtype == bool:
        other = ~leaf
    elif np.issubdtype(leaf.dtype, np.integer):
        other = leaf + np.where(leaf > 0, -1, 1)
    else:
        other = np.where(is_zero, CHANGE - 1.0, CHANGE * leaf)
    parts = [
        np.where(chosen, other, leaf).astype(leaf.dtype) if chosen.any() else None for chosen in (~is_zero, is_zero)
    ]
    return parts[0], parts[1]


def _are_others(samples: Sequence[Sample], expected: Mapping[str, Any], changed: Scenario) -> bool:
    """Return whether random ticks are others in a changed scenario."""
    return differ(random_ticks(changed, samples), expected)


def is_another(changed: Scenario, section: Section, ticks: int | None = None) -> bool:
    """Return whether a section of a flight, or its first ticks, are others in a changed scenario."""
    few = np.int32(section.ticks if ticks is None else min(ticks, section.ticks))
    again = fly_section(changed, *section[:4], few, section.once)
    ends_alike = few < section.ticks or int(again.after.loss) == int(section.after.loss)
    return not ends_alike or differ(again.rows, {name: value[:few] for name, value in section.rows.items()})


def differ(ours: Mapping[str, Any], expected: Mapping[str, Any]) -> bool:
    """Return whether any quantity is different."""
    for name, value in expected.items():
        if value is None:
            continue
        value, other = np.asarray(value, np.float64), np.asarray(ours[name], np.float64)
        scale = max(np.max(np.abs(np.nan_to_num(value)), initial=0.0), LEAST_SCALE)
        if not np.allclose(other, value, rtol=0.0, atol=SEEN * scale, equal_nan=True):
            return True
    return False

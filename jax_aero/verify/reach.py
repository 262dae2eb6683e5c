"""What no comparison has reached: numbers of JAX's controller and plant whose change nothing that was compared shows.

A wrong number of these agrees in everything. Each is changed alone, in the random ticks and in one section of the
flights after the other, until something compared is different.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import jax
import numpy as np

from jax_aero.control.law.torques import INTEGRAL_LIMIT
from jax_aero.sim.scenario import Scenario
from jax_aero.verify import LEAST_SCALE, Sample
from jax_aero.verify.flight import Section, fly_section
from jax_aero.verify.ticks import twin_ticks

CHANGE = 1.1
"""Factor of a number, so that limits act later; of zeros alone one more than what they become."""

ASTRAY = 4
"""Number of the flights astray, whose sections come first; almost everything shows in them."""

SEEN = 1e-6
"""Difference that counts, relative to the greatest entry: far more than any tolerance."""

COPIED = (
    "n_ticks",
    "plant.robot.aero_links.coefficients",
    "plant.robot.aero_links.diameters",
    "plant.robot.aero_links.lengths",
    "plant.robot.engines",
    "plant.robot.forward_axis",
    "plant.robot.joint_limits",
    "plant.robot.joint_torque_max",
    "plant.robot.joint_torque_rate_max",
    "plant.robot.joint_velocity_max",
)
"""Beginnings of the names of what a flight does not read: numbers of which it has a copy, those of other choices."""


def unreached(scenario: Scenario, samples: Sequence[Sample], sections: Sequence[Section]) -> list[str]:
    """Return the names of all numbers of a scenario that nothing has reached."""
    with jax.enable_x64(True):
        expected = random_ticks(scenario, samples)
        integral = np.abs(expected["velocity_error_integral"]).max(initial=0.0)
        found = [] if integral >= INTEGRAL_LIMIT else ["limit of the integral"]

        # Neighbours are alike, so by the golden ratio each section is far from those before it.
        flown = sections[ASTRAY:]
        spread = [flown[place] for place in sorted(range(len(flown)), key=lambda place: 0.618034 * place % 1.0)]

        def shows(changed: Scenario) -> Iterator[bool]:
            yield from (is_another(changed, section) for section in sections[:ASTRAY])
            yield differ(random_ticks(changed, samples), expected)
            yield from (is_another(changed, section) for section in spread)

        return found + [name for name, changed in changes(scenario) if not any(shows(changed))]


def random_ticks(scenario: Scenario, samples: Sequence[Sample]) -> dict[str, Any]:
    """Return the quantities of random ticks of a scenario's controller."""
    controller: Any = scenario.controller
    return twin_ticks(controller, scenario.model, samples)


def changes(scenario: Scenario) -> Iterator[tuple[str, Scenario]]:
    """Yield every number, or array of numbers, with a scenario in which it is another."""
    leaves, structure = jax.tree_util.tree_flatten_with_path(scenario)
    for place, (path, leaf) in enumerate(leaves):
        name = jax.tree_util.keystr(path).lstrip(".")
        if np.size(leaf) and not name.startswith(COPIED):
            values = [value for _, value in leaves]
            values[place] = CHANGE * np.asarray(leaf) if np.any(np.asarray(leaf)) else np.full_like(leaf, CHANGE - 1.0)
            yield name, jax.tree.unflatten(structure, values)


def is_another(changed: Scenario, section: Section) -> bool:
    """Return whether a section of a flight is another one in a changed scenario."""
    again = fly_section(changed, *section[:4])
    return int(again.after.loss) != int(section.after.loss) or differ(again.rows, section.rows)


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

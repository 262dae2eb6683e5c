"""Error goals of the open solver, and whether they are met."""

from __future__ import annotations

from collections.abc import Mapping

GOALS = {
    "drag, relative error, rms": 0.1,
    "total force, rms [m2]": 0.015,
    "links, mean square [m4]": 1.5e-5,
    "drag coefficient, relative error": 0.15,
}
"""Goals by name of the error, which a subject may precede; the last one is for a sphere and a cylinder."""


def verdicts(errors: Mapping[str, float]) -> dict[str, str]:
    """Return whether every error with a goal meets it; NaN does not."""
    judged = {}
    for name, error in errors.items():
        if (goal := GOALS.get(name.rpartition(": ")[2])) is not None:
            ratio = abs(error) / goal
            judged[f"{name}, goal of {goal:g}"] = "met" if ratio <= 1.0 else f"missed, {ratio:.2g} times that"
    return judged

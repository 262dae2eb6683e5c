"""Texts of verdicts: agrees, differs (by how much), out of reach (why), not flown here; preceded by outdated."""

AGREES = "agrees"
NOT_FLOWN = "not flown here"
OUTDATED = "outdated"
ANOTHER = "made with another configuration than today's"
"""Reason why a verdict is outdated, followed by the difference."""


def explain_difference(how: str) -> str:
    """Return the verdict for a value that differs, and how."""
    return f"differs: {how}"


def judge(holds: bool, how: str = "it does not hold") -> str:
    """Return whether a claim holds, or how it differs."""
    return AGREES if holds else explain_difference(how)


def explain_absence(why: str) -> str:
    """Return the verdict for a measurement that is impossible here, and why."""
    return f"out of reach: {why}"


def judge_range(value: float, low: float, high: float, unit: str) -> str:
    """Return whether a value lies between two bounds, or by how much it misses the nearer one."""
    if low <= value <= high:
        return AGREES
    return explain_difference(f"{value - (low if value < low else high):+.3g} {unit}".rstrip())

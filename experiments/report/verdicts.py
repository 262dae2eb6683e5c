"""The words of a verdict: agrees, differs (by how much), out of reach (why), not flown here; outdated, before them."""

AGREES = "agrees"
NOT_FLOWN = "not flown here"
OUTDATED = "outdated"
ANOTHER = "made with another configuration than today's"
"""Why a verdict is outdated; what differs follows."""


def differs(how: str) -> str:
    """Return the verdict of a figure that is another one, and how."""
    return f"differs: {how}"


def judged(holds: bool, how: str = "it does not hold") -> str:
    """Return whether a claim holds, else how it differs."""
    return AGREES if holds else differs(how)


def out_of_reach(why: str) -> str:
    """Return the verdict of what cannot be made here, and why."""
    return f"out of reach: {why}"


def within(value: float, low: float, high: float, unit: str) -> str:
    """Return whether a value lies between two bounds, else by how much it misses the nearer one."""
    if low <= value <= high:
        return AGREES
    return differs(f"{value - (low if value < low else high):+.3g} {unit}".rstrip())

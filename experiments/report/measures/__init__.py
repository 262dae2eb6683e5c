"""Measures of claims: functions that return values by case, of which the bounds of a claim decide."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, TypeAlias

Cases: TypeAlias = Mapping[str, Mapping[str, Any]]
"""Values by case, such as the lever arms; one case without a name if there is but one."""


class Measured(NamedTuple):
    """What a measure found, and its text if the claim does not say how it is written."""

    cases: Cases
    text: str = ""


def one(**values: Any) -> Measured:
    """Return what was measured of a single case."""
    return Measured({"": values})

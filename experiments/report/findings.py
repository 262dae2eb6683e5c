"""Verdicts on claims, what was found of each, and the file that keeps it: `docs/claims.json` for the documentation."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Literal, TypeAlias

import msgspec

from experiments import manifest
from jax_aero.base.files import read_json


class Kind(Enum):
    """Kind of a verdict; the value is its word in texts and in `docs/claims.json`."""

    AGREES = "agrees"
    IN_PART = "agrees in part"
    DIFFERS = "differs"
    OUT_OF_REACH = "out of reach"
    NOT_COMPARED = "not compared"
    NOT_FLOWN = "not flown here"
    OUTDATED = "outdated"
    ERROR = "error"


@dataclass(frozen=True)
class Verdict:
    """A verdict with its whole text."""

    kind: Kind
    text: str

    def __str__(self) -> str:
        return self.text

    @property
    def tone(self) -> Literal["good", "bad", "open"]:
        """Return how it is coloured: what agrees in part is neither good nor bad."""
        if self.kind is Kind.AGREES:
            return "good"
        return "bad" if self.kind in (Kind.DIFFERS, Kind.ERROR) else "open"

    def but(self, limit: str) -> Verdict:
        """Return the verdict with an addition that limits it: what agrees then agrees in part."""
        kind = Kind.IN_PART if self.kind is Kind.AGREES and limit else self.kind
        return Verdict(kind, f"{self}{limit}")


Judged: TypeAlias = tuple[str, Verdict]
"""A measurement as text, and the verdict."""

AGREES, NOT_FLOWN, OUTDATED = (Verdict(kind, kind.value) for kind in (Kind.AGREES, Kind.NOT_FLOWN, Kind.OUTDATED))
ANOTHER = "made of another configuration or code than today's"
"""Reason why a verdict is outdated, followed by the difference."""


def differs(how: str) -> Verdict:
    """Return the verdict for a value that differs, and how."""
    return Verdict(Kind.DIFFERS, f"differs: {how}")


def out_of_reach(why: str) -> Verdict:
    """Return the verdict for a measurement that is impossible here, and why."""
    return Verdict(Kind.OUT_OF_REACH, f"out of reach: {why}")


def error(reason: Exception) -> Verdict:
    """Return the verdict of a judge that failed."""
    return Verdict(Kind.ERROR, f"error: {type(reason).__name__}: {reason}")


def mark_outdated(verdict: Verdict) -> Verdict:
    """Return a verdict from results of another configuration or code."""
    return Verdict(Kind.OUTDATED, f"outdated: {verdict}")


def in_parts(text: str, *parts: Verdict) -> Verdict:
    """Return the verdict on a claim of several parts: theirs if they have the same kind, or else agrees in part."""
    kinds = {part.kind for part in parts}
    return Verdict(kinds.pop() if len(kinds) == 1 else Kind.IN_PART, text)


def judge(holds: bool, how: str = "it does not hold") -> Verdict:
    """Return whether a claim holds, or how it differs."""
    return AGREES if holds else differs(how)


def judge_range(value: float, low: float, high: float, unit: str) -> Verdict:
    """Return whether a value lies between two bounds, or by how much it misses the nearer one."""
    if low <= value <= high:
        return AGREES
    return differs(f"{value - (low if value < low else high):+.3g} {unit}".rstrip())


@dataclass(frozen=True)
class Finding:
    """What was found of a claim."""

    measured: str
    verdict: Verdict
    commit: str | None = None
    """Commit at which the latest of the results used was made; `None` if only files are used."""


class Record(msgspec.Struct):
    """`claims.json` of a report: findings by the claims' keys."""

    claims: dict[str, Finding]


def read(path: Path) -> dict[str, Finding]:
    """Return the findings of a file; none if there is no such file."""
    return msgspec.convert(read_json(path, Record), Record).claims if os.path.lexists(path) else {}


def to_json(found: Mapping[str, Finding], kept: Path) -> str:
    """Return findings from results as JSON, each with its commit.

    A claim that is not flown here, or otherwise than today, keeps its stored finding. The commit is that of the
    results, which may be older than the code that judges them.
    """
    older, here = read(kept), manifest.git_state()["commit"]
    claims = {}
    for key, finding in found.items():
        old = older.get(key)
        is_kept = finding.verdict.kind in (Kind.NOT_FLOWN, Kind.OUTDATED) or (
            old is not None and (old.measured, old.verdict) == (finding.measured, finding.verdict)
        )
        claims[key] = old if old and is_kept else replace(finding, commit=finding.commit or here)
    document = {"command": "jax-aero report --claims docs/claims.json", "claims": msgspec.to_builtins(claims)}
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"

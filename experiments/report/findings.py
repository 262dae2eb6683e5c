"""Findings of claims, and the file that keeps those of results: `docs/claims.json` for the documentation."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec

from experiments import manifest
from experiments.report.verdicts import Kind, Verdict
from jax_aero.base.files import read_json


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

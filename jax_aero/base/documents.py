"""Documents (JSON) beside results: the keys that are read, and their types. They may hold other keys too."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

import msgspec

from jax_aero.base.result import Outcome

Drawing: TypeAlias = Literal["levels", "curve", "map", "scatter", "matrix", "pairs", "front"]
"""How the figure of a sweep is drawn."""


class _Git(msgspec.Struct):
    commit: str | None = None


class _Files(msgspec.Struct):
    files: dict[str, str] = {}


class _Sources(msgspec.Struct):
    flights: dict[str, str]
    files: dict[str, str]
    configurations: dict[str, dict[str, Any]] = {}


class Manifest(msgspec.Struct, kw_only=True):
    """`manifest.json` of a result."""

    title: str = ""
    created: str = ""
    git: _Git | None = None
    numerics: dict[str, int] = {}
    config: dict[str, Any] = {}
    config_digest: str = ""
    summary: dict[str, Any] = {}
    files: dict[str, str] = {}
    sources: _Sources | None = None


class Flight(Manifest, kw_only=True):
    """`manifest.json` of a flight."""

    name: str
    outcome: Outcome
    lost_time: float | None
    lost_reason: str | None
    summary: dict[str, float | None]


class _Axis(msgspec.Struct):
    name: str
    label: str
    unit: str
    levels: list[str | float]


class Kept(Manifest, kw_only=True):
    """`manifest.json` of a result of which the documentation keeps what it found."""

    title: str
    command: str
    created: str
    git: _Git | None
    config: dict[str, Any]
    config_digest: str
    summary: dict[str, Any]


class _TrainingSummary(msgspec.Struct):
    parameters: int
    errors: dict[str, dict[str, Any]]


class Training(Manifest, kw_only=True):
    """`manifest.json` of a trained network."""

    summary: _TrainingSummary  # type: ignore[assignment]  # more than any manifest has


class _Drawing(msgspec.Struct, kw_only=True):
    title: str
    drawing: Drawing
    panels: str
    axes: list[_Axis]


class DrawnSweep(_Drawing, kw_only=True):
    """`sweep.json` of a finished sweep, for its figure."""

    config_digest: str
    repeats: int
    perturbation: dict[str, Any]


class _Counts(msgspec.Struct):
    completed: int
    fell: int
    error: int


class _Outcomes(_Files, kw_only=True):
    created: str
    flights: int
    seconds: float
    flights_per_minute: float | None
    outcomes: _Counts


class _Device(msgspec.Struct):
    cores: int | None


class FinishedSweep(_Drawing, kw_only=True):
    """`sweep.json` of a finished sweep, for the report."""

    config_digest: str
    numerics: dict[str, int] = {}
    description: str
    design: str
    repeats: int
    seed: int
    perturbation: dict[str, Any]
    rows: int
    backend: str
    device: _Device
    finished: _Outcomes
    git: _Git | None


class Ensemble(msgspec.Struct):
    """`ensemble.json`: the cards of networks beside it."""

    members: list[str]

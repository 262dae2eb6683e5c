"""The one judge: a claim, what a measure found for it in each of its cases, the verdict, and the file that keeps it.

```text
claim (paper.toml, a sweep's file) ──► measure ──► values by case ──► bounds of the claim ──► verdict
```
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from experiments.report.measures import Cases, Measured, files, one, results
from experiments.report.results import NotFlownError, Results, StaleError
from jax_aero import rust
from jax_aero.base import places, tables
from jax_aero.base.files import read_json
from jax_aero.base.references import file_hash
from jax_aero.base.terminal import ConfigError, Refused
from jax_aero.results import manifest
from jax_aero.results.identity import VERSIONS
from jax_aero.stored.outdated import ANOTHER
from jax_aero.sweep import spec
from jax_aero.sweep.criteria import Criterion
from jax_aero.sweep.design import Design

MEASURES = {"files": files, "results": results}
"""Modules of measures: the first needs committed files alone."""
OF_SWEEP = "results.cells"
"""Measure of a claim in the file of a sweep."""


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

    @classmethod
    def of(cls, verdict: str) -> Kind:
        """Return the kind of a verdict's text: "agrees in part", or the word with which it begins."""
        return max((kind for kind in cls if verdict.startswith(kind.value)), key=lambda kind: len(kind.value))


class Verdict(msgspec.Struct, frozen=True):
    """A verdict with its whole text."""

    kind: Kind
    text: str

    def __str__(self) -> str:
        return self.text

    @classmethod
    def of(cls, kind: Kind, why: str = "") -> Verdict:
        """Return the verdict that says its kind, and why."""
        return cls(kind, f"{kind.value}: {why}" if why else kind.value)

    def but(self, limit: str) -> Verdict:
        """Return the verdict with an addition that limits it: what agrees then agrees in part."""
        return Verdict(Kind.IN_PART if self.kind is Kind.AGREES and limit else self.kind, f"{self}{limit}")


UNDECIDED = (Kind.OUT_OF_REACH, Kind.NOT_COMPARED)
"""Kinds of the verdicts that a claim may state of itself."""

AGREES, NOT_FLOWN, OUTDATED = map(Verdict.of, (Kind.AGREES, Kind.NOT_FLOWN, Kind.OUTDATED))


class Bound(tables.Table, frozen=True):
    """What a value has to be, in every case that has it."""

    of: str
    """Name of the value."""
    least: float | None = None
    most: float | None = None
    above: float | None = None
    below: float | None = None
    equal: bool | float | str | list[Any] | None = None
    unit: str = ""
    how: str = "{miss:+.3g} {unit}"
    """How it differs; values of the case stand in braces, `miss` is the distance to the nearer bound."""
    part: str = ""
    """Part of the claim that it decides, if not the case."""

    def __post_init__(self) -> None:
        if not self._ends and self.equal is None:
            raise ConfigError.of("of", self.of, "a limit beside it: least, most, above, below or equal")

    @property
    def _ends(self) -> list[float]:
        return [end for end in (self.least, self.above, self.most, self.below) if end is not None]

    def holds(self, value: Any) -> bool:
        """Return whether a value is within the bounds; NaN is not."""
        return (
            (self.least is None or value >= self.least)
            and (self.most is None or value <= self.most)
            and (self.above is None or value > self.above)
            and (self.below is None or value < self.below)
            and (self.equal is None or value == self.equal)
        )

    def differs(self, case: str, values: Mapping[str, Any]) -> str:
        """Return how the value of a case differs."""
        value = values[self.of]
        miss = value - min(self._ends, key=lambda end: abs(value - end)) if self._ends else 0.0
        return self.how.format_map({"case": case, "miss": miss, "unit": self.unit, **values}).rstrip()


class Claim(tables.Table, frozen=True):
    """A statement of the paper or of this project, how it is measured, and the bounds of what it says."""

    where: str
    """Place in the paper, or "ours"."""
    states: str
    measure: str = ""
    """Module of `MEASURES` and function; none if nothing is measured."""
    arguments: dict[str, Any] = msgspec.field(default_factory=dict)
    says: str = ""
    """What was measured of a case, with values in braces."""
    before: str = ""
    """Text before the cases, with values of the first one."""
    join: str = "; "
    """Between cases."""
    asks: tuple[Bound, ...] = ()
    remarks: tuple[Bound, ...] = ()
    """Bounds that limit a verdict without deciding it: `how`, with the cases in which they fail, follows its text."""
    in_part: str = ""
    """Verdict if `holds` and `fails`, parts or cases, differ; without it a claim holds everywhere or not."""
    verdict: str = ""
    """The verdict if none of ours can be computed: the word of its kind, and the reason."""
    commands: tuple[str, ...] = ()
    """Commands that make the results, without `jax-aero`; none if committed files suffice."""
    figure: str = ""
    """Figure or sweep that shows it, if not that of its item."""

    def __post_init__(self) -> None:
        module, _, name = self.measure.partition(".")
        if self.measure and not hasattr(MEASURES.get(module), name):
            known = ", ".join(MEASURES)
            raise ConfigError.of("measure", self.measure, f"a function of a module of measures ({known}), or none")
        words = [kind.value for kind in UNDECIDED]
        if self.verdict and self.verdict.partition(":")[0] not in words:
            raise ConfigError.of("verdict", self.verdict, f"none, or {' or '.join(words)}, and why")
        if bool(self.verdict) is bool(self.asks) or (self.asks and not self.measure):
            raise ConfigError.of("asks", len(self.asks), "bounds of what is measured, or a verdict without any")

    @property
    def identity(self) -> str:
        """Return a digest of this claim and of today's configurations of its results."""
        made = [_today(command) for command in each(self.commands)]
        text = json.dumps([msgspec.to_builtins(self, enc_hook=str), made], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    @property
    def is_of_sweep(self) -> bool:
        """Return whether it stands in the file of a sweep, with which its finding is kept."""
        return self.measure == OF_SWEEP

    def measured(self, known: Results) -> Measured:
        """Return what is measured in results."""
        module, _, name = self.measure.partition(".")
        if not name:
            return one()
        result: Measured = getattr(MEASURES[module], name)(*([known] if module == "results" else []), **self.arguments)
        return result

    def decide(self, known: Results) -> tuple[str, Verdict]:
        """Return measurement and verdict from results."""
        result = self.measured(known)
        return self.text(result), self.judge(result.cases)

    def find(self, known: Results) -> Finding:
        """Return measurement and verdict from the results that exist."""
        known.made.clear()
        try:
            result = self.measured(known)
            measured, verdict = self.text(result), self.judge(result.cases)
        except NotFlownError as reason:
            verdict = OUTDATED if isinstance(reason, StaleError) else NOT_FLOWN
            return Finding("; ".join(known.failures(each(self.commands))) or str(reason), verdict)
        except Refused:
            raise
        except Exception as reason:  # of a result that does not fit, or of the measure
            return Finding("no measurement", Verdict.of(Kind.ERROR, f"{type(reason).__name__}: {reason}"))
        if changed := [f"{name} ({made.differs})" for name, made in known.made.items() if made.differs]:
            measured = f"{measured}; {ANOTHER}: {', '.join(changed)}"
            verdict = Verdict.of(Kind.OUTDATED, verdict.text)
        commits = {made.created: made.commit for made in known.made.values() if made.created and made.commit}
        commit = commits[max(commits)] if commits else None
        return Finding(measured, verdict, commit, self.identity, result.cases if self.commands else {})

    def check(self, finding: Finding) -> None:
        """Refuse a finding whose text or verdict does not follow from its numbers."""
        again = Measured(finding.cases)
        if (said := (self.text(again), self.judge(again.cases))) != (finding.measured, finding.verdict):
            raise Refused(
                f'"{finding.measured}", "{finding.verdict}" contradict the numbers beside them, from which follow '
                f'"{said[0]}", "{said[1]}"'
            )

    def text(self, measured: Measured) -> str:
        """Return what was measured."""
        if not self.says:
            return measured.text
        said = [self.says.format_map({"case": case, **values}) for case, values in measured.cases.items()]
        return self.before.format_map(next(iter(measured.cases.values()))) + self.join.join(said)

    def judge(self, cases: Cases) -> Verdict:
        """Return the verdict on values by case; `LookupError` if a bound is of a value that no case has."""
        if self.verdict:
            return Verdict(Kind(self.verdict.partition(":")[0]), self.verdict)
        known = {name for values in cases.values() for name in values}
        if unknown := [bound.of for bound in (*self.asks, *self.remarks) if bound.of not in known]:
            raise LookupError(f"no case has `{unknown[0]}`")
        asked = list(_applied(self.asks, cases))
        failed = [
            (bound.part or case, bound.differs(case, values))
            for bound, case, values in asked
            if not bound.holds(values[bound.of])
        ]
        fails, how = (", ".join(dict.fromkeys(texts)) for texts in (zip(*failed, strict=True) if failed else ((), ())))
        parts = dict.fromkeys(bound.part or case for bound, case, _ in asked)
        holds = [part for part in parts if part not in dict(failed)]
        said = {"holds": ", ".join(holds), "fails": fails, "how": how, "held": len(holds), "parts": len(parts)}
        verdict = AGREES
        if failed and holds and self.in_part:
            verdict = Verdict(Kind.IN_PART, self.in_part.format_map(said))
        elif failed:
            verdict = Verdict.of(Kind.DIFFERS, how)
        for bound in self.remarks:
            limits = [
                (case, values) for _, case, values in _applied([bound], cases) if not bound.holds(values[bound.of])
            ]
            if limits:
                fails = ", ".join(case for case, _ in limits)
                verdict = verdict.but(bound.how.format_map({**limits[0][1], "fails": fails}))
        return verdict


@cache
def _today(command: str) -> list[str]:
    """Return digests of the configurations that a command makes its results of, and the versions of the numbers."""
    _, word, *names = command.split()
    versions = [f"{name} {version}" for name, version in VERSIONS.items()]
    if word == "fly":
        return [*versions, *(rust.config_digest(rust.load_config(name)) for name in names)]
    if word == "sweep":
        return [*versions, *(Design(spec.load(name)).digest for name in names)]
    kind, *chosen = [f"cfd_{names[0]}", *names[1:]] if word == "cfd" else names
    return [file_hash(places.find(kind, name)) for name in chosen or places.names(kind)]


def of_sweep(name: str, claim: Criterion) -> Claim:
    """Return the claim in the file of a sweep."""
    limits = [
        Bound(of=column, most=limit, how=f"{{case}}: {{{column}_text}}") for column, limit in claim.at_most.items()
    ]
    of, how = ("above", "{above} too many") if claim.share else ("others", "{case}: {missed}")
    return Claim(
        where="ours",
        states=claim.states,
        measure=OF_SWEEP,
        arguments={"name": name, "claim": claim},
        asks=(Bound(of=of, most=0, how=how), *limits),
        remarks=(Bound(of="is_decided", equal=True, how="; not decided: {limit:g} % is within the interval"),)
        if claim.share
        else (),
        commands=(f"sweep {name}",),
    )


def each(commands: Sequence[str]) -> list[str]:
    """Return commands as they are typed, one for each flight and each sweep."""
    made: list[str] = []
    for line in whole(commands):
        word, *names = line.split()[1:]
        made += [f"jax-aero {word} {name}" for name in names] if word in ("fly", "sweep") else [line]
    return made


def whole(commands: Sequence[str]) -> list[str]:
    """Return commands as they are typed."""
    return [command if command.startswith("jax-aero ") else f"jax-aero {command}" for command in commands]


def _applied(bounds: Iterable[Bound], cases: Cases) -> Iterator[tuple[Bound, str, Mapping[str, Any]]]:
    """Yield bounds with the cases that have their values."""
    return ((bound, case, values) for case, values in cases.items() for bound in bounds if bound.of in values)


# --- what was found -------------------------------------------------------------------------------------------------


class Finding(msgspec.Struct, frozen=True):
    """What was found of a claim."""

    measured: str
    verdict: Verdict
    commit: str | None = None
    """Commit at which the latest of the results used was made; `None` if only files are used."""
    identity: str = ""
    """That of its claim and of its results (`Claim.identity`)."""
    cases: Cases = {}
    """The numbers from which text and verdict follow; none of files or of the rows of a sweep, which have them."""


class Record(msgspec.Struct):
    """`claims.json` of a report: findings by the claims' keys."""

    claims: dict[str, Finding]
    seal: str = ""
    """Digest of them, by which an edited file is recognised."""


def read(path: Path) -> dict[str, Finding]:
    """Return the findings of a file; none if there is no such file.

    Raises
    ------
    Refused
        If they are not what was written there.
    """
    if not os.path.lexists(path):
        return {}
    record = msgspec.convert(read_json(path, Record), Record)
    if record.seal != seal_of(record.claims):
        raise Refused(f"{path} is not what was written there: jax-aero report --claims writes it")
    return {
        key: msgspec.structs.replace(finding, cases=_with_nan(finding.cases)) for key, finding in record.claims.items()
    }


def seal_of(claims: Mapping[str, Finding]) -> str:
    """Return the digest of findings."""
    return hashlib.sha256(json.dumps(_plain(claims), sort_keys=True).encode()).hexdigest()


def _plain(claims: Mapping[str, Finding]) -> Any:
    """Return findings as JSON has them, in which `None` is no number."""
    numbers = {
        key: {case: {name: _json(value) for name, value in values.items()} for case, values in finding.cases.items()}
        for key, finding in claims.items()
    }
    findings = {key: msgspec.structs.replace(finding, cases=numbers[key]) for key, finding in claims.items()}
    return msgspec.to_builtins(findings)


def _json(value: Any) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and math.isnan(value) else value


def _with_nan(cases: Cases) -> Cases:
    return {
        case: {name: math.nan if value is None else value for name, value in values.items()}
        for case, values in cases.items()
    }


def to_json(findings: Mapping[str, Finding], kept: Path) -> str:
    """Return findings from results as JSON, each with its commit.

    A claim that is not flown here, or otherwise than today, keeps its stored finding. The commit is that of the
    results, which may be older than the code that judges them.
    """
    older, here = read(kept), manifest.git_state()["commit"]
    claims = {}
    for key, finding in findings.items():
        old = older.get(key)
        is_kept = finding.verdict.kind in (Kind.NOT_FLOWN, Kind.OUTDATED) or (
            old is not None and (old.measured, old.verdict) == (finding.measured, finding.verdict)
        )
        commit = old.commit if old and is_kept else finding.commit or here
        is_judged = finding.verdict.kind not in (Kind.NOT_FLOWN, Kind.OUTDATED)
        claims[key] = old if old and not is_judged else msgspec.structs.replace(finding, commit=commit)
    document = {"command": "jax-aero report --claims docs/claims.json", "claims": _plain(claims)}
    return json.dumps(document | {"seal": seal_of(claims)}, indent=1, ensure_ascii=False) + "\n"

"""The file of a sweep, read and checked: what varies, around which flight, how often."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeVar

from experiments import Refused, manifest
from experiments.engines import ENGINES
from experiments.sweep.perturbation import Perturbation

CONFIGS = manifest.REPOSITORY / "configs" / "sweeps"
DESIGNS = ("grid", "list", "latin_hypercube", "sobol")
DRAWINGS = ("levels", "curve", "map", "scatter")

T = TypeVar("T")


@dataclass(frozen=True)
class Level:
    """One value of an axis: a label, the keys it sets, and perhaps another flight to start from."""

    label: str | float
    set: Mapping[str, Any] = field(default_factory=dict)
    base: str | None = None


@dataclass(frozen=True)
class Axis:
    """One thing that varies."""

    name: str
    label: str
    unit: str
    levels: tuple[Level, ...]
    """Of grids and lists; empty for a sampled axis."""
    keys: tuple[str, ...] = ()
    low: float = 0.0
    high: float = 0.0

    def sampled(self, value: float) -> Level:
        """Return the level of one value."""
        return Level(value, dict.fromkeys(self.keys, value))


@dataclass(frozen=True)
class Spec:
    """One sweep."""

    name: str
    title: str
    description: str
    base: str
    axes: tuple[Axis, ...]
    design: str = "grid"
    samples: int = 0
    set: Mapping[str, Any] = field(default_factory=dict)
    engine: str = "rust"
    seed: int = 1
    repeats: int = 1
    chunk: int = 48
    perturbation: Perturbation = field(default_factory=Perturbation)
    drawing: str = "curve"
    panels: str = ""
    """Axis whose levels are panels of a figure, if any."""

    def __post_init__(self) -> None:
        _among(self.name, "design", self.design, DESIGNS)
        _among(self.name, "drawing", self.drawing, DRAWINGS)
        _among(self.name, "engine", self.engine, tuple(ENGINES))
        for key in ("repeats", "chunk"):
            if not 1 <= getattr(self, key) <= 1_000_000:
                raise Refused(
                    f"sweep {self.name}: {key} = {getattr(self, key)}; expected an integer from 1 to a million"
                )
        if len({axis.name for axis in self.axes}) < len(self.axes):
            raise Refused(f"sweep {self.name}: two axes have one name")
        if not self.axes:
            raise Refused(f"sweep {self.name}: no [[axis]]; expected at least one")
        for axis in self.axes:
            if self.is_sampled == bool(axis.levels):
                wanted = "low and high" if self.is_sampled else "values, a range or levels"
                raise Refused(f"sweep {self.name}: axis {axis.name} of a {self.design} needs {wanted}")
        if self.is_sampled and self.samples < 1:
            raise Refused(f"sweep {self.name}: samples = {self.samples}; expected at least 1")
        if self.panels and self.panels not in {axis.name for axis in self.axes}:
            raise Refused(f"sweep {self.name}: panels = {self.panels!r}; expected the name of an axis")
        if self.design == "list" and len({len(axis.levels) for axis in self.axes}) > 1:
            raise Refused(f"sweep {self.name}: the axes of a list need equally many values")

    @property
    def is_sampled(self) -> bool:
        """Return whether a quasi-random design chooses the cells."""
        return self.design in ("latin_hypercube", "sobol")


def available() -> dict[str, str]:
    """Return name and title of every sweep."""
    titles = {}
    for path in sorted(CONFIGS.glob("*.toml")):
        titles[path.stem] = str(_read(path).get("title", ""))
    return titles


def load(name: str) -> Spec:
    """Read the sweep of a name or of a path."""
    path = Path(name) if "/" in name or name.endswith(".toml") else CONFIGS / f"{name}.toml"
    if not path.is_file():
        raise Refused(f"no sweep `{name}`; there are {', '.join(available()) or 'none'}")
    return from_table(path.stem, _with_files(_read(path), path.parent))


def from_table(name: str, table: Mapping[str, Any]) -> Spec:
    """Return the checked sweep of a table."""
    table = dict(table)
    axes = tuple(_axis(name, entry) for entry in table.pop("axis", ()))
    perturbation = _build(Perturbation, table.pop("perturbation", {}), f"sweep {name}: perturbation")
    return _build(Spec, {**table, "name": name, "axes": axes, "perturbation": perturbation}, f"sweep {name}")


def _with_files(value: Any, folder: Path) -> Any:
    """Return `value` with every table `{ file = "..." }` in it replaced by that file's table.

    A network's `card` in such a table is a path that starts there, too.
    """
    if isinstance(value, Mapping):
        if value.keys() == {"file"}:
            return _with_files(_read(folder / value["file"]), (folder / value["file"]).parent)
        if isinstance(card := value.get("card"), str):
            value = {**value, "card": str((folder / card).resolve())}
        return {key: _with_files(item, folder) for key, item in value.items()}
    return [_with_files(item, folder) for item in value] if isinstance(value, list) else value


def _axis(sweep: str, entry: Mapping[str, Any]) -> Axis:
    name = entry.get("name")
    where = f"sweep {sweep}: axis {name}"
    known = {"name", "label", "unit", "key", "keys", "values", "range", "low", "high", "level"}
    if unknown := entry.keys() - known:
        raise Refused(f"{where}: unknown key {', '.join(sorted(unknown))}; known: {', '.join(sorted(known))}")
    if not isinstance(name, str) or not name.isidentifier():
        raise Refused(f"{where}: name = {name!r}; expected a word")
    keys = tuple(entry.get("keys", [entry["key"]] if "key" in entry else ()))
    blank = Axis(name, str(entry.get("label", name)), str(entry.get("unit", "")), levels=(), keys=keys)
    if "level" in entry:
        levels = (_build(Level, level, f"{where}: level") for level in entry["level"])
        return replace(blank, levels=tuple(levels))
    if not keys:
        raise Refused(f"{where}: no key; expected `key`, `keys` or `level`")
    if "low" in entry or "high" in entry:
        low, high = (_number(where, key, entry.get(key)) for key in ("low", "high"))
        if low >= high:
            raise Refused(f"{where}: low = {low}, high = {high}; expected low < high")
        return replace(blank, low=low, high=high)
    values = (_number(where, "values", value) for value in _values(where, entry))
    return replace(blank, levels=tuple(blank.sampled(value) for value in values))


def _values(where: str, entry: Mapping[str, Any]) -> Sequence[Any]:
    if "range" not in entry:
        values: Sequence[Any] = entry.get("values", ())
        return values
    span = entry["range"]
    if not isinstance(span, Mapping) or span.keys() != {"start", "stop", "num"} or span["num"] < 2:
        raise Refused(f"{where}: range = {span}; expected {{ start, stop, num }} with num ≥ 2")
    step = (span["stop"] - span["start"]) / (span["num"] - 1)
    return [span["start"] + step * index for index in range(span["num"])]


def _number(where: str, key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise Refused(f"{where}: {key} has {value!r}; expected a number")
    # Fifteen digits: 0.1 + 0.2 is 0.3 in a table.
    return float(f"{value:.15g}")


def _build(kind: type[T], table: Mapping[str, Any], where: str) -> T:
    known = {item.name for item in fields(kind)}  # type: ignore[arg-type]
    if unknown := table.keys() - known:
        raise Refused(f"{where}: unknown key {', '.join(sorted(unknown))}; known: {', '.join(sorted(known))}")
    try:
        return kind(**table)
    except TypeError as reason:
        raise Refused(f"{where}: {reason}") from None


def _among(sweep: str, key: str, value: str, known: Sequence[str]) -> None:
    if value not in known:
        raise Refused(f"sweep {sweep}: {key} = {value!r}; expected one of {', '.join(known)}")


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, tomllib.TOMLDecodeError) as reason:
        raise Refused(f"{manifest.portable(path)}: {reason}") from None

"""The file of a sweep: what varies, around which flight, how often."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from jax_aero.base import places, tables
from jax_aero.base.documents import Drawing
from jax_aero.base.terminal import ConfigError
from jax_aero.results import study
from jax_aero.sweep import keys
from jax_aero.sweep.criteria import Criterion
from jax_aero.sweep.perturbation import Perturbation

MAX_FILES = 128
"""Greatest number of files in a sweep; nested files are as deep in recursive calls."""

MAX_CELLS, MAX_ROWS = 100_000, 1_000_000
"""Greatest number of cells, which are all checked before the first flight, and of flights, whose table is in memory."""

MAX_AXES, MAX_LEVELS = 100, 1000
"""Greatest number of axes, each a column of the tables, and of levels with labels of one axis, which figures name."""

PATHS = ("card", "ensemble", "file", "path", "robot")
"""Last parts of keys whose values are paths."""


class Level(tables.Table, frozen=True):
    """One value of an axis: a label, the keys it sets, and optionally another base flight."""

    label: str | float
    set: dict[str, Any] = msgspec.field(default_factory=dict)
    """Values by dotted key of the flight."""
    base: str | None = None
    """Name or path of an experiment that replaces the sweep's base."""


class Range(tables.Table, frozen=True):
    """Evenly spaced values, including both ends."""

    start: float
    stop: float
    num: Annotated[int, msgspec.Meta(ge=2, le=MAX_CELLS)]


class Axis(tables.Table, frozen=True):
    """An axis of a sweep: levels, values of keys, or, for a sampled design, an interval of values."""

    name: Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z_]\w*$")]
    label: str = ""
    unit: str = ""
    key: str | None = None
    """Dotted key of the flight that is set to every value."""
    keys: tuple[str, ...] = ()
    """Several such keys."""
    values: tuple[float, ...] = ()
    range: Range | None = None
    """Range that replaces `values`."""
    low: float | None = None
    """Lower end of a sampled axis, whose upper end is `high`."""
    high: float | None = None
    level: Annotated[tuple[Level, ...], msgspec.Meta(max_length=MAX_LEVELS)] = ()
    """Levels that replace keys and values."""

    def __post_init__(self) -> None:
        if sum(map(bool, (self.key, self.keys, self.level))) != 1:
            raise ConfigError.of("", self.name, "one of `key`, `keys` and `level`")
        if sum((bool(self.values), self.range is not None, self.low is not None, bool(self.level))) > 1:
            raise ConfigError.of("", self.name, "one of `values`, `range`, `low` with `high`, and `level`")
        if len({type(level.label) for level in self.level}) > 1:
            raise ConfigError.of(
                "level", [level.label for level in self.level], "labels that are numbers or texts alone"
            )
        if (self.low is None) != (self.high is None) or (self.is_sampled and not self.ends[0] < self.ends[1]):
            raise ConfigError.of("low", self.low, f"a number below `high`, {self.high}")

    @property
    def written_keys(self) -> tuple[str, ...]:
        """Return the keys that are set to the values."""
        return self.keys or ((self.key,) if self.key else ())

    @property
    def is_sampled(self) -> bool:
        """Return whether values are sampled from an interval."""
        return self.low is not None

    @property
    def ends(self) -> tuple[float, float]:
        """Return the ends of the interval of a sampled axis."""
        return self.low or 0.0, self.high or 0.0

    @property
    def n_levels(self) -> int:
        """Return the number of levels of an axis of a grid or list."""
        return self.range.num if self.range is not None else len(self.level or self.values)

    @property
    def levels(self) -> tuple[Level, ...]:
        """Return the levels of an axis of a grid or list."""
        if self.level:
            return self.level
        values = self.values
        if self.range is not None:
            step = (self.range.stop - self.range.start) / (self.range.num - 1)
            values = tuple(self.range.start + step * index for index in range(self.range.num))
        # Fifteen digits, so that 0.1 + 0.2 is 0.3 in a table.
        return tuple(self.level_at(float(f"{value:.15g}")) for value in values)

    @property
    def settings(self) -> tuple[dict[str, Any], ...]:
        """Return the settings of all levels; of an axis of values, those of one."""
        return tuple(level.set for level in self.level) or (dict.fromkeys(self.written_keys, 0.0),)

    def level_at(self, value: float) -> Level:
        """Return the level of one value; a whole number becomes an integer, which is also accepted as a float."""
        return Level(label=value, set=dict.fromkeys(self.written_keys, int(value) if value.is_integer() else value))


class Tabled(tables.Table, frozen=True):
    """The table of a kept result (`jax-aero report keep`)."""

    pooled: tuple[str, ...] = ()
    """Axes over whose levels the flights are pooled."""
    shows: tuple[Literal["share", "errors", "found", "announced", "modes"], ...] = ("errors",)
    """Figures beside the number of flights that complete: share with its interval, errors of rotation and position,
    when the first failure is found, how long before a loss it is announced, and the modes of the controller."""


class Spec(tables.Table, frozen=True):
    """One sweep: what varies, around which flight, how often."""

    title: str
    base: str
    """Name or path of the base experiment."""
    axis: Annotated[tuple[Axis, ...], msgspec.Meta(min_length=1, max_length=MAX_AXES)]
    description: str = ""
    name: Annotated[str, msgspec.Meta(pattern=places.NAME)] = ""
    """Name of the result's folder; by default that of the file."""
    design: Literal["grid", "list", "pairs", "latin_hypercube", "sobol"] = "grid"
    """Cells that are flown: all combinations, the axes in parallel, all pairs of levels of the first axis, or a
    quasi-random sample. Pairs have a second axis, `NAME_2`, and leave out levels of which one replaces the other."""
    samples: Annotated[int, msgspec.Meta(ge=0, le=MAX_CELLS)] = 0
    """Number of cells of a quasi-random design."""
    set: dict[str, Any] = msgspec.field(default_factory=dict)
    """Values by dotted key, set in every cell."""
    backend: Literal["rust", "jax", "mujoco"] = "rust"
    seed: tables.Seed = 1
    repeats: tables.Count = 1
    """Flights in each cell, each with its own perturbation."""
    chunk: tables.Count = 48
    """Flights that are computed and stored together."""
    perturbation: Perturbation = Perturbation()
    drawing: Drawing = "curve"
    panels: str = ""
    """Axis whose levels are panels of a figure and columns of a table, if any."""
    tabled: Tabled = Tabled()
    claim: tuple[Criterion, ...] = ()
    """Statements that the sweep decides."""

    def __post_init__(self) -> None:
        names = [axis.name for axis in self.axes]
        if len(set(names)) < len(names):
            raise ConfigError.of("axis", names, "names that differ")
        for index, axis in enumerate(self.axis):
            if self.is_sampled is not axis.is_sampled or (not axis.is_sampled and not axis.n_levels):
                wanted = "low and high" if self.is_sampled else "values, a range or levels"
                raise ConfigError.of(f"axis[{index}]", axis.name, f"{wanted}, in a {self.design}")
        if self.is_sampled is not (self.samples > 0):
            wanted = "at least 1" if self.is_sampled else "none"
            raise ConfigError.of("samples", self.samples, f"{wanted} for a {self.design}")
        if self.panels and self.panels not in names:
            raise ConfigError.of("panels", self.panels, f"the name of an axis: {', '.join(names)}")
        if unknown := {*self.tabled.pooled} - {*names}:
            raise ConfigError.of("tabled.pooled", min(unknown), f"names of axes: {', '.join(names)}")
        if self.design == "list" and len({axis.n_levels for axis in self.axis}) > 1:
            raise ConfigError.of(
                "axis", [axis.n_levels for axis in self.axis], "equally many values of all axes of a list"
            )
        self._check_size()
        self._check_keys()
        for index, claim in enumerate(self.claim):
            claim.check({axis.name: [level.label for level in axis.levels] for axis in self.axes}, f"claim[{index}]")

    def _check_size(self) -> None:
        cells = self.samples or 1
        for axis in self.axes:
            cells = max(cells, axis.n_levels) if self.design == "list" or self.is_sampled else cells * axis.n_levels
            if cells > MAX_CELLS:
                counts = [axis.n_levels for axis in self.axis]
                raise ConfigError.of("axis", counts, f"numbers of levels that make at most {MAX_CELLS} cells")
        if cells * self.repeats > MAX_ROWS:
            raise ConfigError.of("repeats", self.repeats, f"at most {MAX_ROWS // cells} for {cells} cells")

    def _check_keys(self) -> None:
        # Of every setting: its axis and key, and whether a list joins it, by the keys that would replace it.
        taken: dict[str, tuple[str, str, bool]] = {}
        for axis in self.axis:
            written = [item for settings in axis.settings for item in settings.items()]
            for key, value in written:
                earlier, lost, is_list = taken.get(key, ("", "", True))
                if lost and not (lost == key and is_list and keys.are_joined(value)):
                    expected = f"one that sets other keys than {earlier}: `{key}` replaces `{lost}`"
                    raise ConfigError.of("axis", axis.name, expected)
            for key, value in written:
                taken |= dict.fromkeys(keys.replacing(key, value), (axis.name, key, keys.are_joined(value)))

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Return the axes of the cells; those of pairs begin with the first axis twice."""
        first, *others = self.axis
        is_paired = self.design == "pairs"
        return (first, msgspec.structs.replace(first, name=f"{first.name}_2"), *others) if is_paired else self.axis

    @property
    def is_sampled(self) -> bool:
        """Return whether the design is quasi-random."""
        return self.design in ("latin_hypercube", "sobol")


def load(name: str) -> Spec:
    """Read the sweep given by name or path."""
    path = study.find("sweeps", name)
    table = _with_files(tables.read(path), path.parent, iter(range(MAX_FILES)))
    return from_table(study.result_name("sweeps", path, table.get("name")), table)


def from_table(name: str, table: Mapping[str, Any]) -> Spec:
    """Return the checked sweep described by a table."""
    return tables.convert({"name": name, **table}, Spec, f"sweep {name}")


def _with_files(value: Any, folder: Path, count: Iterator[int]) -> Any:
    """Return `value` with every table `{ file = "..." }` replaced by that file's table, while `count` lasts.

    Paths, including those that replace names of flights, are relative to the file that contains them, or to the shipped
    sweeps.
    """
    if isinstance(value, Mapping):
        if value.keys() == {"file"}:
            if next(count, None) is None:
                raise ConfigError(f"{value['file']}: more than {MAX_FILES} files are read", file=value["file"])
            shipped = places.CONFIGS / "sweeps" / value["file"]
            path = shipped if shipped.is_file() and not (folder / value["file"]).exists() else folder / value["file"]
            return _with_files(tables.read(path), path.parent, count)
        return {
            key: str((folder / item).resolve())
            if isinstance(item, str) and (key.rpartition(".")[2] in PATHS or (key == "base" and places.is_path(item)))
            else _with_files(item, folder, count)
            for key, item in value.items()
        }
    return [_with_files(item, folder, count) for item in value] if isinstance(value, list) else value

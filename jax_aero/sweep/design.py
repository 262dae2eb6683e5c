"""The cells of a sweep from its axes, and the configuration of a row from its number."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from jax_aero import rust
from jax_aero.base import plain_values
from jax_aero.base.references import file_hash
from jax_aero.base.terminal import ConfigError, Refused
from jax_aero.results import manifest
from jax_aero.sweep import columns, keys, table
from jax_aero.sweep.perturbation import members
from jax_aero.sweep.spec import Level, Spec

MOST_TEXTS = 4096
"""Greatest number of cells whose configuration is kept, some 40 MB."""


@dataclass(frozen=True)
class Design:
    """A sweep with its base flights: everything needed to fly any row."""

    spec: Spec
    file: Path | None = None
    """Its file, if it has one."""

    def __post_init__(self) -> None:
        if taken := {*columns.FLIGHTS, *columns.CELLS} & {axis.name for axis in self.spec.axes}:
            raise Refused(f"sweep {self.spec.name}: axis `{min(taken)}` has the name of a column of its tables")

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process needs: it reads and resolves no flight, and makes all else itself, once."""
        return {"spec": self.spec, "file": self.file, "bases": self.bases}

    @cached_property
    def cells(self) -> list[tuple[Level, ...]]:
        """Return the level of every axis for each cell; the last axis varies fastest."""
        axes = self.spec.axes
        if self.spec.design == "grid":
            return list(itertools.product(*(axis.levels for axis in axes)))
        if self.spec.design == "list":
            return list(zip(*(axis.levels for axis in axes), strict=True))
        if self.spec.design == "pairs":
            levels, _, *others = (axis.levels for axis in axes)
            pairs = [
                pair for pair in itertools.combinations(levels, 2) if not keys.do_conflict(pair[0].set, pair[1].set)
            ]
            return [(*pair, *rest) for pair in pairs for rest in itertools.product(*others)]
        points = unit_points(self.spec.design, len(axes), self.spec.samples, self.spec.seed)
        return [
            tuple(
                # Ten digits suffice for a sample, and are readable in a table.
                axis.level_at(float(f"{axis.ends[0] + (axis.ends[1] - axis.ends[0]) * x:.10g}"))
                for axis, x in zip(axes, point, strict=True)
            )
            for point in points
        ]

    @property
    def labels(self) -> Iterator[dict[str, str | float]]:
        """Yield the label of every axis for each cell."""
        for levels in self.cells:
            yield {axis.name: level.label for axis, level in zip(self.spec.axes, levels, strict=True)}

    @property
    def n_rows(self) -> int:
        """Return the number of flights."""
        return len(self.cells) * self.spec.repeats

    def missing(self, flown: Iterable[range] = ()) -> list[range]:
        """Return the rows beside those that are flown, in chunks."""
        known = [row for rows in flown for row in rows]
        left = np.setdiff1d(np.arange(self.n_rows), np.array(known, dtype=int))
        cuts = np.flatnonzero((np.diff(left) > 1) | (left[1:] % self.spec.chunk == 0)) + 1
        return [range(int(part[0]), int(part[-1]) + 1) for part in np.split(left, cuts) if len(part)]

    def place(self, row: int) -> tuple[int, int]:
        """Return cell and repeat of a row; all cells have their first flight before any has its second."""
        repeat, cell = divmod(row, len(self.cells))
        return cell, repeat

    @cached_property
    def bases(self) -> dict[str, rust.Config]:
        """Return the flights that cells are based on, by name."""
        names = {self.spec.base, *(level.base for axis in self.spec.axes for level in axis.levels if level.base)}
        return {name: _load(self.spec.name, name) for name in sorted(names)}

    def cell_config(self, cell: int) -> rust.Config:
        """Return the unperturbed configuration of a cell, which the caller may change."""
        text = self._texts.get(cell)
        if text is None:
            if len(self._texts) >= MOST_TEXTS:
                self._texts.clear()
            text = self._texts[cell] = msgspec.json.encode(self._make_cell(cell))
        config: rust.Config = msgspec.json.decode(text)
        return config

    @cached_property
    def _texts(self) -> dict[int, bytes]:
        """Configurations of cells as JSON, which is read faster than a configuration is made or copied."""
        return {}

    def _make_cell(self, cell: int) -> rust.Config:
        levels = self.cells[cell]
        with self._name_cell(cell):
            base, *others = {level.base for level in levels if level.base} or {self.spec.base}
            if others:
                raise Refused(f"its levels have the `base` {' and '.join(sorted([base, *others]))}; expected one")
            return keys.set_all(self.bases[base], self.spec.set, keys.join(level.set for level in levels))

    def row_config(self, row: int) -> rust.Config:
        """Return the configuration of a row: its cell's, perturbed by the random numbers of its repeat."""
        cell, repeat = self.place(row)
        config = self.cell_config(cell)
        self.perturb(config, repeat, {key for level in self.cells[cell] for key in level.set})
        return config

    def perturb(self, config: rust.Config, repeat: int, chosen: Set[str] = frozenset()) -> None:
        """Perturb a configuration in place by the draws of a repeat, but for the `chosen` keys of seeds."""
        self.spec.perturbation.apply(config, self.spec.seed, repeat, _robot(config["robot"]), chosen)

    def config_hash(self, cell: int, config: rust.Config) -> str:
        """Return `table.config_hash` of a configuration of a cell, perturbed or not; every file is read once."""
        levels = zip(self.spec.axes, self.cells[cell], strict=True)
        of_cell = tuple(level.label for axis, level in levels if not axis.is_sampled)
        paths = self._paths.get(of_cell)
        if paths is None:
            paths = self._paths[of_cell] = rust.path_keys(config)
        return table.config_hash(config, paths, self._file_hash)

    @cached_property
    def _paths(self) -> dict[tuple[str | float, ...], list[str]]:
        """Keys of paths by the levels of axes that are not sampled; a sampled number is no path."""
        return {}

    @cached_property
    def _file_hash(self) -> Callable[[Path], str]:
        return cache(file_hash)

    @property
    def digest(self) -> str:
        """Return a hash of everything except code that determines the result: levels and files that they name."""
        return self.digest_of(self.spec.repeats)

    def digest_of(self, repeats: int) -> str:
        """Return the digest of this sweep with so many repeats."""
        numbers = [self.spec.seed, repeats, self.spec.chunk, self.spec.backend]
        return hashlib.sha256(json.dumps(self._hashed | {"numbers": numbers}, sort_keys=True).encode()).hexdigest()

    @cached_property
    def _hashed(self) -> dict[str, Any]:
        ensemble = self.spec.perturbation.ensemble
        return {
            "axes": [axis.name for axis in self.spec.axes],
            "labels": [[level.label for level in levels] for levels in self.cells],
            "cells": [self.config_hash(cell, self.cell_config(cell)) for cell in self._first_of_levels()],
            "networks": [[card.name, file_hash(card)] for card in members(ensemble)] if ensemble else [],
            "perturbation": manifest.make_portable(plain_values.to_builtins(self.spec.perturbation)),
        }

    def _first_of_levels(self) -> Iterator[int]:
        """Yield the first cell of every level and of every base: together they have all that cells are made of."""
        known: set[object] = set()
        for cell, levels in enumerate(self.cells):
            mine = {*enumerate(level.label for level in levels), *(level.base for level in levels)}
            if not mine <= known:
                known |= mine
                yield cell

    def check(self) -> None:
        """Refuse, before the first flight, a sweep with duplicate cells or with cells that cannot be flown."""
        if not self.cells:
            raise ConfigError.of("axis", self.spec.axis[0].name, "levels that can be combined").in_file(
                f"sweep {self.spec.name}"
            )
        for number, claim in enumerate(self.spec.claim):
            if not any(map(claim.covers, self.labels)):
                cells = dict(claim.cells)
                raise ConfigError.of(f"claim[{number}].cells", cells, "levels of one cell or more").in_file(
                    f"sweep {self.spec.name}"
                )
        firsts: dict[tuple[str | float, ...], int] = {}
        for cell, levels in enumerate(self.cells):
            with self._name_cell(cell):
                if (first := firsts.setdefault(tuple(level.label for level in levels), cell)) < cell:
                    raise Refused(f"cell {first} has the same levels; expected each combination once")
        # Samples, of which there may be many, are refused when they are drawn.
        for cell in range(1 if self.spec.is_sampled else len(self.cells)):
            config = self.cell_config(cell)
            with self._name_cell(cell):
                if (backend := config.get("backend", self.spec.backend)) != self.spec.backend:
                    raise Refused(
                        f"`backend` of the flight is {backend!r}; expected {self.spec.backend!r}, as of the sweep"
                    )
                rust.check_config(config)  # unperturbed first, since only a valid one can be perturbed
                self.perturb(config, 0)
                rust.check_config(config)

    def refuse_samples(self, rows: Iterable[int], reasons: Iterable[str | None]) -> None:
        """Refuse a sample whose first flight could not be flown, for a reason."""
        for row, reason in zip(rows, reasons, strict=True):
            cell, repeat = self.place(row)
            if reason is not None and repeat == 0 and self.spec.is_sampled:
                with self._name_cell(cell):
                    raise Refused(reason)

    @contextmanager
    def _name_cell(self, cell: int) -> Iterator[None]:
        """Add the names of sweep and cell to a refusal."""
        try:
            yield
        except ValueError as reason:
            pairs = zip(self.spec.axes, self.cells[cell], strict=True)
            labels = ", ".join(f"{axis.name} = {level.label}" for axis, level in pairs)
            raise Refused(f"sweep {self.spec.name}: cell {cell} ({labels}): {reason}") from None


def unit_points(design: str, dimensions: int, samples: int, seed: int) -> Sequence[Sequence[float]]:
    """Return the points of a quasi-random design in the unit cube."""
    from scipy.stats import qmc

    if design == "sobol":
        sampler = qmc.Sobol(dimensions, rng=seed)
        # A whole power of two, truncated, since only complete sets of Sobol points are balanced.
        points = sampler.random_base2(max(0, (samples - 1).bit_length()))[:samples]
    else:
        points = qmc.LatinHypercube(dimensions, rng=seed).random(samples)
    coordinates: list[list[float]] = points.tolist()
    return coordinates


@cache
def _robot(path: str) -> rust.Robot:
    return rust.Robot(path)


def _load(sweep: str, name: str) -> rust.Config:
    try:
        return rust.load_config(name)
    except ValueError as reason:
        raise Refused(f"sweep {sweep}: {reason}") from None

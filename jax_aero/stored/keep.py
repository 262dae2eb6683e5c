"""Keep the figures of finished results in `docs/results/`.

`jax-aero report keep NAME` reads the sweep NAME, or any other result given by its folder below `results/`, such as
`wind_observer/turbulence`, and writes NAME.json. `--all` does so for everything that is kept, where its result is
there.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pandas as pd

from jax_aero import backends
from jax_aero.base import documents, places
from jax_aero.base.arguments import Parser, add_results, complete_with
from jax_aero.base.files import read_json, write_text
from jax_aero.base.terminal import Refused, exit_status
from jax_aero.results import manifest
from jax_aero.results.identity import numerics_of
from jax_aero.stored import kept, outdated
from jax_aero.stored.kept import Axis, Kept
from jax_aero.stored.outdated import ANOTHER
from jax_aero.sweep import aggregate, result, run, spec
from jax_aero.sweep.design import Design
from jax_aero.sweep.perturbation import perturbed
from jax_aero.sweep.spec import Spec

FIRST = ("max_rotation_error", "thrust_max", "end_com_x", "end_com_z")
"""Figures that are kept of the first flight of each cell."""

DIGITS = 5
"""Significant digits of a kept number."""


def main(arguments: Sequence[str]) -> int:
    """Keep results; return the exit status."""
    given = _parser().parse_args(arguments)

    def work() -> None:
        if not places.IS_CHECKOUT:
            raise Refused("results are kept in docs/ of a checkout of the repository, and this is none")
        for folder in _chosen(given):
            if folder.is_dir() and (difference := outdated.result(folder.parent.name, folder)):
                raise Refused(f"{os.path.relpath(folder)} is {ANOTHER} ({difference})")
            _write(of_folder(folder, given.named))

    return exit_status(work)


def _parser() -> argparse.ArgumentParser:
    parser = Parser("report keep", __doc__)
    named = parser.add_argument("names", nargs="*", metavar="NAME", help="a sweep, or a folder below results/")
    complete_with(named, lambda: places.names("sweeps"))
    parser.add_argument("--name", dest="named", metavar="NAME", help="name of the kept result")
    parser.add_argument("--all", action="store_true", help="everything that is kept, where its result is there")
    add_results(parser)
    return parser


def _chosen(given: argparse.Namespace) -> Iterator[Path]:
    """Yield the folders of the results to keep."""
    if given.named and len(given.names) != 1:
        raise Refused(f"--name is {given.named} for {len(given.names)} results; expected one")
    for name in given.names:
        yield given.results / (name if "/" in name else f"sweeps/{name}")
    for name in kept.names() if given.all else ():
        folder = given.results / kept.read(name).result
        if folder.is_dir():
            yield folder
        else:
            print(f"{name} stays as it is: {os.path.relpath(folder)} is not there")


def of_folder(folder: Path, named: str | None = None) -> Kept:
    """Return what is kept of a finished result, under its own name or another."""
    if (folder / run.SWEEP_FILE).is_file():
        return of_sweep(folder, named)
    if not (folder / places.MANIFEST_FILE).is_file():
        raise Refused(f"{os.path.relpath(folder)} holds no finished result")
    document = read_json(folder / places.MANIFEST_FILE, documents.Kept)
    return Kept(
        name=named or f"{folder.parent.name}_{folder.name}",
        result=f"{folder.parent.name}/{folder.name}",
        title=document["title"],
        command=document["command"],
        created=document["created"],
        commit=_commit(document),
        digest=document["config_digest"],
        numerics=numerics_of(document),
        config=document["config"],
        summary=_shorten(document["summary"] | document.get("quality", {})),
    )


def benchmark(name: str, title: str, about: str, command: str, measured: Mapping[str, Mapping[str, float]]) -> None:
    """Keep what a benchmark found."""
    document = Kept(
        name=name,
        result=f"bench/{name}",
        title=title,
        about=about,
        command=command,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        commit=_commit({"git": manifest.git_state()}),
        digest="",
        summary=_shorten(measured),
    )
    _write(document)


def _write(document: Kept) -> None:
    write_text(kept.FOLDER / f"{document.name}.json", to_json(document))


def _commit(document: Mapping[str, Any]) -> str | None:
    """Return the commit whose code made a result; `None` if it was changed, or is unknown."""
    git = document["git"] or {}
    return None if git.get("dirty") else git.get("commit")


def of_sweep(folder: Path, named: str | None = None) -> Kept:
    """Return what is kept of a finished sweep: rows of flights, and the findings of its claims."""
    flown = result.read(folder)
    document = flown.document
    if document["backend"] == "jax":
        raise Refused(f"{os.path.relpath(folder)} is flown by JAX, which does not say what fault detection finds")
    asked = spec.load(folder.name) if folder.name in places.names("sweeps") else None
    tabled = asked.tabled if asked else spec.Tabled()
    is_paired, is_sampled = document["design"] == "pairs", asked is not None and asked.is_sampled
    whole = [Axis(axis["name"], axis["label"], axis["unit"], axis["levels"]) for axis in document["axes"]]
    second = [whole[1].name] if is_paired else []
    axes = [axis for axis in whole if not is_sampled and axis.name not in (*tabled.pooled, *second)]
    flights = flown.flights.copy()
    flights["onset"] = flights["cell"].map(_onsets(asked, document["config_digest"]))
    firsts = list(_firsts(Design(asked), flights)) if asked else []  # others cannot be flown again
    flights = flights[flights["outcome"] != "error"]
    rows = list(_rows(flights, axes, (whole[0].name, whole[1].name) if is_paired else None))
    return Kept(
        name=named or folder.name,
        result=f"sweeps/{folder.name}",
        title=document["title"],
        about=document["description"],
        command=f"jax-aero sweep {folder.name}" if asked else "jax-aero challenge CONTROLLER",
        created=document["finished"]["created"],
        commit=_commit(document),
        digest=document["config_digest"],
        numerics=numerics_of(document),
        seed=document["seed"],
        each=_each(document),
        axes=axes,
        drawing=document["drawing"],
        panels=document["panels"],
        paired=whole[0].name if is_paired else "",
        pooled=[axis.label for axis in whole if axis.name in tabled.pooled],
        shows=list(tabled.shows),
        outcomes=document["finished"]["outcomes"],
        columns=[*(axis.name for axis in axes), *aggregate.KEPT],
        rows=[[*levels, *_shorten(list(figures.values()))] for levels, figures in rows],
        firsts=firsts,
    )


def _onsets(asked: Spec | None, digest: str) -> dict[int, float]:
    """Return when the first failure of each cell begins [s]; nothing if the flights were of another configuration."""
    design = Design(asked) if asked else None
    if design is None or design.digest != digest:
        return {}
    return {cell: _onset(design.cell_config(cell)) for cell in range(len(design.cells))}


def _onset(config: Mapping[str, Any]) -> float:
    disturbances = config.get("disturbances", {})
    failure = disturbances.get("jets", {}).get("failure")
    lists = [faults for faults in disturbances.values() if isinstance(faults, list | tuple)]
    begins = [fault["start"] for faults in lists for fault in faults]
    return float(min([*begins, *([failure["time"]] if failure else [])], default=0.0))


def _each(document: Mapping[str, Any]) -> str:
    """Return how many flights a cell has, and what of them is perturbed."""
    repeats = document["repeats"]
    return f"{'one' if repeats == 1 else repeats} in each cell, {perturbed(document['perturbation'])}"


def _rows(
    flights: pd.DataFrame, axes: Sequence[Axis], pair: tuple[str, str] | None
) -> Iterator[tuple[list[Any], dict[str, Any]]]:
    """Yield levels and figures of the flights for every combination of levels that some have.

    Of pairs, a level of the first axis has all flights in which it is one of the two.
    """
    if pair is not None:
        first, other = pair
        flights = pd.concat([flights, flights.assign(**{first: flights[other]})])
    for levels in itertools.product(*(axis.levels for axis in axes)):
        mine = flights
        for axis, level in zip(axes, levels, strict=True):
            mine = mine[mine[axis.name] == level]
        if len(mine):
            yield list(levels), figures(mine)


def figures(flights: pd.DataFrame) -> dict[str, Any]:
    """Return what is kept of flights."""
    every = aggregate.figures({str(name): values.to_numpy() for name, values in flights.items()})
    return {name: every[name] for name in aggregate.KEPT}


def first_of(flight: Mapping[str, Any]) -> list[Any]:
    """Return what is kept of the first flight of a cell, from its outcome and its figures."""
    return [flight["outcome"], *_shorten([flight[name] for name in FIRST])]


def _firsts(design: Design, flights: pd.DataFrame) -> Iterator[list[Any]]:
    """Yield what is kept of first flights; nothing if MuJoCo simulates or Python controls.

    Functions of the C library and of NumPy round as their processor has fused multiplications, and feet on the ground
    enlarge the last bit to centimetres within two seconds.
    """
    first = flights[flights["repeat"] == 0].assign(max_rotation_error=np.radians(flights["max_rotation_error_deg"]))
    for levels, flight in zip(design.cells, first.to_dict("records"), strict=True):
        is_of_crate = design.spec.backend == "rust" and not any("own_controller" in level.set for level in levels)
        yield first_of(flight) if is_of_crate else []


def fly_again(document: Kept, cell: int) -> list[Any]:
    """Return what is kept of the first flight of a cell, flown anew from the present file of the sweep."""
    design = Design(spec.load(document.result.removeprefix("sweeps/")))
    if len(design.cells) != len(document.firsts):
        raise Refused(f"{document.name} keeps {len(document.firsts)} cells; its sweep has {len(design.cells)}")
    flight = backends.backend(design.spec.backend).fly(design.row_config(cell))
    return first_of({"outcome": flight.outcome, **flight.summary})


def _shorten(value: Any) -> Any:
    """Return numbers with `DIGITS` significant digits, and the infinite error of a lost flight as a word."""
    if isinstance(value, float):
        if value == math.inf:
            return kept.LOST
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, Mapping):
        return {key: _shorten(item) for key, item in value.items()}
    return [_shorten(item) for item in value] if isinstance(value, list) else value


def to_json(document: Kept) -> str:
    """Return a kept result as JSON, sealed, with a line for each row."""
    sealed = msgspec.to_builtins(msgspec.structs.replace(document, seal=kept.seal_of(document)))
    tables = {name: sealed.pop(name) for name in ("rows", "firsts") if name in sealed}
    text = json.dumps(sealed, indent=1, ensure_ascii=False)
    for name, rows in tables.items():
        lines = ",\n".join(f"  {json.dumps(row, ensure_ascii=False)}" for row in rows)
        text = f'{text[:-2]},\n "{name}": [\n{lines}\n ]\n}}'
    return f"{text}\n"

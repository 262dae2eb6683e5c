"""Fly one controller through the tasks of wind-humanoid-1, beside the shipped ones.

CONTROLLER is FILE.py:NAME, a function or class (docs/own_controller.md), or a configuration: a name in
configs/control, or a file; it flies the tasks of iRonCub-Mk3 if mk3_NAME stands beside it. With --seed N tasks of other
random numbers are flown too, and reported beside those of the published ones.

The table has the flights that complete their mission or land, with the Wilson interval of their share, and the medians
of their greatest errors. It goes with picture and JSON to results/challenge/NAME/.
"""

from __future__ import annotations

import argparse
import os
import shlex
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs

from jax_aero import own, rust
from jax_aero.base import arguments, places
from jax_aero.base.files import write_bytes, write_text
from jax_aero.base.parquet import read_table
from jax_aero.base.terminal import Refused, exit_status
from jax_aero.figures import drawings
from jax_aero.results import record, study
from jax_aero.results.table import text_table
from jax_aero.stored import keep, kept
from jax_aero.stored.kept import Kept
from jax_aero.sweep import run, spec
from jax_aero.sweep.design import Design
from jax_aero.sweep.spec import Level, Spec

TASKS = {"mk1": "wind_humanoid_1", "mk3": "wind_humanoid_1_mk3"}
"""Sweeps of tasks, by robot."""
TIMED = 5.0
"""Duration of the flight whose ticks are timed [s]."""


def main(arguments: Sequence[str]) -> int:
    """Fly the tasks; return the exit status."""
    given = _parser().parse_args(arguments)

    def work() -> None:
        stem = given.controller.rpartition(":")[2] if ":" in given.controller else Path(given.controller).stem
        name = given.named or places.file_name(stem)
        if any(name in kept.read(sweep).axes[0].levels for sweep in TASKS.values()):
            raise Refused(f"--name is {name}, that of a shipped controller; expected another")
        levels = {robot: level_of(given.controller, name, robot, given.tick) for robot in given.tasks or TASKS}
        if not any(levels.values()):
            raise Refused(f"{given.controller} is no controller of {', '.join(levels)}; that of Mk3 is mk3_NAME")
        flown = {
            TASKS[robot]: [fly(tasks, given.workers, given.out) for tasks in specs(robot, level, given.seed)]
            for robot, level in levels.items()
            if level is not None
        }
        seed = [] if given.seed is None else ["--seed", str(given.seed)]
        command = shlex.join(["jax-aero", "challenge", given.controller, *seed])
        document = structs.replace(beside(name, flown, times(levels)), command=command, seed=given.seed)
        columns, rows = kept.page_table(document)
        print(text_table([columns, *rows]))
        folder = (given.out or places.RESULTS / "challenge") / name
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / f"{name}.json", keep.to_json(document))
        write_bytes(folder / f"{name}.webp", drawings.draw_small(document.sweep))
        headings = ("controller", *next(iter(document.summary.values())))
        print(text_table([headings, *((name, *map(str, of.values())) for name, of in document.summary.items())]))
        print(os.path.relpath(folder))

    return exit_status(work, interrupted="the same command goes on with the next chunk")


def level_of(controller: str, name: str, robot: str = "mk1", tick: float | None = None) -> Level | None:
    """Return the level of an axis that flies a controller on a robot; `None` if it is for the other one."""
    if ":" in controller:
        settings: dict[str, Any] = {"own_controller": study.own_controller(controller)}
    else:
        path = study.find("control", controller)
        if robot == "mk3" and not path.stem.startswith("mk3_"):
            path = path.with_stem(f"mk3_{path.stem}")
        if not path.is_file() or path.stem.startswith("mk3_") is not (robot == "mk3"):
            return None
        settings = {"controller": rust.load_controller(path)}
    return Level(label=name, set=settings | ({} if tick is None else {"controller.time_step": tick}))


def specs(robot: str, level: Level, seed: int | None = None) -> Iterator[Spec]:
    """Yield the tasks of a robot with one controller: of the published random numbers, and of those of a seed."""
    tasks = spec.load(TASKS[robot])
    for number in [None] if seed is None else [None, seed]:
        label = level.label if number is None else f"{level.label}, seed {number}"
        axis = structs.replace(tasks.axis[0], level=(structs.replace(level, label=label),))
        more = {"name": places.file_name(f"{tasks.name}--{label}"), "axis": (axis, *tasks.axis[1:])}
        yield structs.replace(tasks, **more, **({} if number is None else {"seed": number}))


def fly(tasks: Spec, workers: int | None = None, out: Path | None = None) -> Kept:
    """Fly the tasks, or what is missing of them; refuse a controller that fails in one, since it then has no score.

    A controller of one's own that fails in the first one is refused before the others.
    """
    design = Design(tasks)
    if "own_controller" in (first := design.row_config(0)):
        try:
            rust.fly(first)
        except ValueError as reason:
            raise Refused(
                f"{tasks.name}: the first flight could not be flown, so there is no score: {reason}"
            ) from None
    existing = record.read_manifest((out or run.RESULTS) / tasks.name)
    is_other = existing is not None and bool(run.identity_of(design).difference(existing))
    folder = run.run(design, workers=workers, out=out, overwrite=is_other)
    if errors := read_table(folder / "table.parquet")["error"].drop_null().to_pylist():
        raise Refused(f"{tasks.name}: {len(errors)} flights could not be flown, so there is no score: {errors[0]}")
    return keep.of_sweep(folder)


def beside(name: str, flown: Mapping[str, Sequence[Kept]], timed: Mapping[str, Any]) -> Kept:
    """Return the results of a controller beside the shipped ones, of all robots in one table."""
    all_of = [one for sweep, mine in flown.items() for one in (kept.read(sweep), *mine)]
    last = all_of[-1]
    levels = [list(dict.fromkeys(level for one in all_of for level in one.axes[place].levels)) for place in (0, 1)]
    return structs.replace(
        last,
        name=name,
        title="wind-humanoid-1",
        about="",
        axes=[structs.replace(axis, levels=shown) for axis, shown in zip(last.axes, levels, strict=True)],
        rows=[row for one in all_of for row in one.rows],
        outcomes={},
        firsts=[],
        shows=["share", "errors"],
        summary=dict(timed),
    )


def times(levels: Mapping[str, Level | None]) -> dict[str, dict[str, float]]:
    """Return the times of a tick of a controller and of the crate's, in the world of its first robot, here."""
    robot, mine = next((robot, level) for robot, level in levels.items() if level is not None)
    shipped = spec.load(TASKS[robot])
    world = next(cell for cell, task in enumerate(shipped.axis[1].levels) if not task.set)
    by_robot = {}
    for level in (*(level for level in shipped.axis[0].levels if "own_controller" not in level.set), mine):
        (alone,) = specs(robot, level)
        config = rust.set_keys(Design(alone).cell_config(world), {"simulator.duration": TIMED})
        seconds = 1e3 * np.array(_time(config))
        by_robot[str(level.label)] = {
            f"time of a tick, {text} [ms]": float(f"{np.quantile(seconds, share):.3g}")
            for text, share in (("median", 0.5), ("99 %", 0.99))
        }
    return by_robot


def _time(config: rust.Config) -> list[float]:
    """Return the times of the ticks of a flight [s]."""
    if config.get("own_controller"):
        mine = own.Own(config, rust.Robot(config["robot"]))
        rust.Flight(config, controller=mine).run()
        return mine.times
    flight, controller, seconds = rust.Flight(config), rust.Controller(config), []
    while not flight.has_ended:
        seen = flight.measurement
        started = time.perf_counter()
        tick = controller.tick(seen.state, seen.thrust, seen.wind, seen.time)
        seconds.append(time.perf_counter() - started)
        flight.step(command=rust.Command(tick.thrust_rate, tick.joint_torque))
    return seconds


def _parser() -> argparse.ArgumentParser:
    parser = arguments.Parser("challenge", __doc__)
    parser.add_argument("controller", metavar="CONTROLLER", help="FILE.py:NAME, or a configuration of a controller")
    parser.add_argument("--tasks", action="append", choices=list(TASKS), help="tasks of this robot alone")
    parser.add_argument("--seed", type=int, metavar="N", help="seed of other tasks, reported beside the published ones")
    parser.add_argument("--tick", type=float, metavar="S", help="period of the controller [s] (default 0.01)")
    parser.add_argument("--workers", type=arguments.count, metavar="N", help="threads (default: one per core)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the results (default results/)")
    arguments.add_name(parser, "default: that of the function, class or file")
    return parser

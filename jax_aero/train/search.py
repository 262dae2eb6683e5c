"""Search for better settings: `jax-aero train search NAME --dataset FILE`.

A file of `configs/training_search/` names a training file and ranges for some of its keys. A trial trains one network
per inner fold of whole postures, without members or students, and is judged by the mean error of the rows held out.
An interrupted search goes on with the next trial, and a finished one with --trials of more.
"""

from __future__ import annotations

import argparse
import copy
import csv
import io
import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
import optuna
from msgspec.structs import replace

from jax_aero.aero.dataset import Dataset, load
from jax_aero.base import places, plain_values, tables
from jax_aero.base.arguments import Parser, count
from jax_aero.base.files import lock_work, resolve, write_text
from jax_aero.base.keys import set_key
from jax_aero.base.terminal import ConfigError, exit_status
from jax_aero.results import manifest, record, study
from jax_aero.results.identity import PYTHON, Identity
from jax_aero.results.work import Work
from jax_aero.train import config, fit, samples_of

RESULTS = places.RESULTS / "training_search"


class Range(tables.Table, frozen=True):
    """Range of one key in a search: choices, or an interval."""

    choices: Annotated[tuple[Any, ...], msgspec.Meta(min_length=1)] | None = None
    low: float | None = None
    high: float | None = None
    log: bool = False
    """Whether the search is uniform in the logarithm."""

    def check(self, key: str) -> None:
        """Refuse the range of this key if it is neither choices nor an interval."""
        numbers = [number is not None for number in (self.low, self.high)]
        if any(numbers) if self.choices is not None else not all(numbers):
            raise ConfigError.of(key, plain_values.to_table(self), "choices, or low and high, perhaps log")
        if self.low is not None and self.high is not None:
            if not self.low < self.high:
                raise ConfigError.of(f"{key}.low", self.low, f"a number below high, {self.high:g}")
            if self.log and not self.low > 0.0:
                raise ConfigError.of(f"{key}.low", self.low, "a number above 0, as its logarithm is searched")


class SearchConfig(tables.Table, frozen=True):
    """A search for training settings."""

    base: Path
    """The training file that trials start from."""
    trials: tables.Count
    seed: tables.Seed
    fold_seed: tables.Seed
    folds: tables.Count
    """Inner folds of whole postures."""
    folds_run: tables.Count
    space: dict[str, Range]
    """Ranges by dotted key of the training file."""

    def __post_init__(self) -> None:
        for key, one in self.space.items():
            one.check(f"space.{key}")
        if self.folds_run > self.folds:
            raise ConfigError.of("folds_run", self.folds_run, f"at most {self.folds}, which is `folds`")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = Parser("train search", __doc__)
    study.add_names(parser, "training_search", "name")
    parser.add_argument("--dataset", type=Path, required=True, metavar="FILE", help="what to train on")
    parser.add_argument(
        "--trials", type=count, metavar="N", help="stop when there are so many (default: what the file says)"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="result folder (default results/training_search/NAME)")
    study.add_overwrite(parser)
    given = parser.parse_args(arguments)
    return exit_status(lambda: run(given), interrupted="the same command goes on with the next trial")


def run(given: argparse.Namespace) -> None:
    """Search until there are enough trials; write the table of them."""
    path = study.find("training_search", given.name)
    settings = tables.load(path, SearchConfig)
    base = tables.read(settings.base)
    robot = replace_keys(settings.base, base, {}).robot_model
    dataset = load(given.dataset, robot)
    out = resolve(given.out or RESULTS / study.result_name("training_search", path))
    table = {**plain_values.to_builtins(settings), "base": base}
    identity = Identity.of({"table": table, "data": dataset.sha256}, [settings.base], [PYTHON])
    optuna.logging.set_verbosity(optuna.logging.ERROR)  # with warnings it prints a traceback after Ctrl-C
    search, trials = optuna.create_study(direction="minimize"), list[Trial]()
    wanted = given.trials or settings.trials
    with lock_work(out):
        record.check_replaceable(out, lambda kept: not identity.difference(kept), overwrite=given.overwrite)
        work = Work.on(out, identity)  # it stays: a later call may ask for more trials
        for number in range(wanted):
            # What a trial draws follows from those before it alone, also where they are not made again.
            search.sampler = optuna.samplers.TPESampler(seed=settings.seed + number)
            drawn = search.ask()
            training = replace_keys(settings.base, base, suggestions(drawn, settings.space))
            kept = work.read_json(f"trial-{number}")
            if kept is None:
                started = time.perf_counter()
                error = error_of(training, dataset, settings)
                kept = {"error": error, "seconds": time.perf_counter() - started}
                work.write_json(f"trial-{number}", kept)
                print(f"trial {number + 1} of {wanted}: {error:.3e} m4 in {kept['seconds']:.0f} s: {drawn.params}")
            search.tell(drawn, kept["error"])
            trials.append(Trial(number, kept["error"], kept["seconds"], drawn.params))
        _write(out, trials, table, identity, dataset.sha256)
    print(f"best of {wanted}: {search.best_value:.3e} m4 with {search.best_params}")


class Trial(NamedTuple):
    """One trial."""

    number: int
    error: float
    """[m⁴]"""
    seconds: float
    params: dict[str, Any]


def suggestions(trial: optuna.Trial, space: Mapping[str, Range]) -> dict[str, Any]:
    """Return one value for every key of the space."""
    chosen: dict[str, Any] = {}
    for key, entry in space.items():
        if entry.choices is not None:
            # Optuna has no lists: their texts stand for them.
            chosen[key] = json.loads(trial.suggest_categorical(key, [json.dumps(value) for value in entry.choices]))
        elif entry.low is not None and entry.high is not None:
            chosen[key] = trial.suggest_float(key, entry.low, entry.high, log=entry.log)
    return chosen


def replace_keys(path: Path, base: Mapping[str, Any], changes: Mapping[str, Any]) -> config.Training:
    """Return the base file with some keys changed; noise of features that a trial lacks is left out."""
    table = copy.deepcopy(dict(base))
    for key, value in changes.items():
        set_key(table, key, value)
    training: config.Training = tables.convert(table, config.Training, path.name, path.parent)
    noise = {block: std for block, std in training.training.noise.items() if block in training.network.features}
    return replace(training, training=replace(training.training, noise=noise))


def error_of(training: config.Training, dataset: Dataset, settings: SearchConfig) -> float:
    """Return the mean error over the inner folds [m⁴]; infinite where a network diverges."""
    rows = dataset.add_mirror_images() if training.mirrored else dataset
    robot = training.robot_model
    errors = []
    for train, held_out in rows.grouped_folds(settings.fold_seed, settings.folds)[: settings.folds_run]:
        start = training.start(training.seed)
        samples = samples_of(start, robot, rows.take(train))
        unseen = samples_of(start, robot, rows.take(held_out))
        try:
            error = fit(start, samples, unseen, training.training, training.seed).error
        except FloatingPointError:
            return np.inf
        errors.append(error if error is not None and np.isfinite(error) else np.inf)
    return float(np.mean(errors))


def _write(out: Path, trials: Sequence[Trial], table: Mapping[str, Any], identity: Identity, dataset: str) -> None:
    keys = sorted({key for trial in trials for key in trial.params})
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(["trial", "error_m4", "seconds", *keys])
    for trial in trials:
        writer.writerow([trial.number, trial.error, trial.seconds, *(trial.params.get(key) for key in keys)])
    best = min(trials, key=lambda trial: trial.error)
    document = manifest.build(
        out.name,
        "Search for training settings",
        table,
        identity,
        summary={"best_error_m4": best.error, "best": best.params, "trials": len(trials)},
        command=["jax-aero", "train", *sys.argv[2:]],
        backend="optuna",
        dataset=dataset,
        timings_s={"all trials": sum(trial.seconds for trial in trials)},
    )
    record.write_result(out, document, lambda draft: write_text(draft / "trials.csv", text.getvalue()), replace=True)

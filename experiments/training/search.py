"""Search for better settings: `jax-aero train search NAME --dataset FILE`.

A file of `configs/training_search/` names a training file and ranges for some of its keys. A trial trains one network
per inner fold of whole postures, without members or students, and is judged by the mean error of the rows held out:
of the weights that are kept, with patience the best ones.
Trials are stored in a SQLite file, so a search can be resumed. A trial that was interrupted counts as failed, and is
drawn again.
"""

from __future__ import annotations

import argparse
import copy
import csv
import io
import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import optuna
from msgspec.structs import replace

from experiments import Refused, manifest, study
from experiments.identity import Identity
from experiments.training import config
from jax_aero.aero.dataset import Dataset, load
from jax_aero.base import documents, places, plain, tables
from jax_aero.base.files import lock, read_json, resolve, write_json, write_text
from jax_aero.base.keys import set_key
from jax_aero.base.terminal import ConfigError, exit_status
from jax_aero.cli import Parser, count
from jax_aero.train import fit, samples_of

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
            raise ConfigError.of(key, plain.to_table(self), "choices, or low and high, perhaps log")
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
    given = parser.parse_args(arguments)
    return exit_status(lambda: run(given), interrupted="the same command goes on with the next trial")


def run(given: argparse.Namespace) -> None:
    """Search until there are enough trials; write the table of them."""
    path = study.find("training_search", given.name)
    settings = tables.load(path, SearchConfig)
    base = tables.read(settings.base)
    dataset = load(given.dataset)
    out = resolve(given.out or RESULTS / study.result_name("training_search", path))
    # One study per question: another dataset, space or code must not be mixed in.
    asked = {"table": plain.to_builtins(settings), "base": base, "data": dataset.sha256}
    identity = Identity.of(asked, [__name__])
    if (out / places.RUN_FILE).exists() or _digest_in(out) not in (None, identity.digest):
        raise Refused(f"{manifest.make_portable(out)} holds another result; choose another --out, or remove it")
    out.mkdir(parents=True, exist_ok=True)
    optuna.logging.set_verbosity(optuna.logging.ERROR)  # with warnings it prints a traceback after Ctrl-C
    search = optuna.create_study(
        study_name=f"{identity.digest[:16]} {identity.code}",
        storage=f"sqlite:///{out / 'trials.db'}",
        direction="minimize",
        load_if_exists=True,
    )
    wanted = given.trials or settings.trials

    def objective(trial: optuna.Trial) -> float:
        return error_of(replace_keys(path, base, suggestions(trial, settings.space)), dataset, settings)

    def say(_: optuna.Study, trial: optuna.trial.FrozenTrial) -> None:
        seconds = trial.duration.total_seconds() if trial.duration else 0.0
        print(
            f"trial {_count_complete(search)} of {wanted}: {trial.value:.3e} m4 (best {search.best_value:.3e}) "
            f"in {seconds:.0f} s: {trial.params}",
            flush=True,
        )

    with lock(out):
        for trial in search.get_trials(states=(optuna.trial.TrialState.RUNNING,)):  # of a process that was killed
            search.tell(trial.number, state=optuna.trial.TrialState.FAIL)
        while (done := _count_complete(search)) < wanted:
            # What was interrupted is drawn again, as in a search that is not.
            search.sampler = optuna.samplers.TPESampler(seed=settings.seed + done)
            search.optimize(objective, n_trials=1, callbacks=[say])
    _write(out, search, {**plain.to_builtins(settings), "base": base}, identity, dataset.sha256)
    print(f"best of {_count_complete(search)}: {search.best_value:.3e} m4 with {search.best_params}")


def _digest_in(folder: Path) -> str | None:
    """Return the digest of the result in a folder: `None` where there is none, empty where it cannot be read."""
    path = folder / places.MANIFEST_FILE
    if not os.path.lexists(path):
        return None
    try:
        return str(read_json(path, documents.Manifest).get("config_digest", ""))
    except Refused:
        return ""


def _count_complete(search: optuna.Study) -> int:
    return sum(trial.state == optuna.trial.TrialState.COMPLETE for trial in search.trials)


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
    robot = config.robot(training.robot)
    errors = []
    for train, held_out in rows.grouped_folds(settings.fold_seed, settings.folds)[: settings.folds_run]:
        start = training.start(robot, training.seed)
        samples = samples_of(start, robot, rows.take(train))
        unseen = samples_of(start, robot, rows.take(held_out))
        try:
            error = fit(start, samples, unseen, training.training, training.seed).error
        except FloatingPointError:
            return np.inf
        errors.append(error if error is not None and np.isfinite(error) else np.inf)
    return float(np.mean(errors))


def _write(out: Path, search: optuna.Study, table: Mapping[str, Any], identity: Identity, dataset: str) -> None:
    keys = sorted({key for trial in search.trials for key in trial.params})
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(["trial", "state", "error_m4", "seconds", *keys])
    for trial in search.trials:
        seconds = trial.duration.total_seconds() if trial.duration else ""
        writer.writerow(
            [trial.number, trial.state.name, trial.value, seconds, *(trial.params.get(key) for key in keys)]
        )
    write_text(out / "trials.csv", text.getvalue())
    document = manifest.build(
        out.name,
        "Search for training settings",
        table,
        identity,
        summary={"best_error_m4": search.best_value, "best": search.best_params, "trials": _count_complete(search)},
        command=["jax-aero", "train", *sys.argv[2:]],
        engine="optuna",
        dataset=dataset,
        timings_s={"all trials": sum(t.duration.total_seconds() for t in search.trials if t.duration)},
    )
    write_json(out / places.MANIFEST_FILE, document)

"""Train a network of link forces and report its errors: `jax-aero train NAME --dataset FILE`.

A file of `configs/training/` is trained once per fold of whole postures (`grouped`), once on a random split, which
leaks information (`random`), and once on all rows; errors are those on held-out rows, beside those of simpler models.
An interrupted run is resumed by the same command; a finished one is only replaced with --overwrite.
`--write` also copies the weights to where flights find them.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from jax_aero.aero.dataset import Dataset, load
from jax_aero.aero.network import Network
from jax_aero.aero.network_card import save_network
from jax_aero.base import documents, places
from jax_aero.base.arguments import Parser
from jax_aero.base.cards import card_path, copy_card
from jax_aero.base.files import lock_work, resolve
from jax_aero.base.keys import parse_assignments
from jax_aero.base.terminal import Refused, exit_status, terminal
from jax_aero.results import manifest, record, study
from jax_aero.results.changes import folder_suffix
from jax_aero.results.identity import PYTHON, Identity
from jax_aero.results.work import Work
from jax_aero.train import config, parts, result
from jax_aero.train.loop import ERROR_UNIT
from jax_aero.train.parts import FinishedPart

RESULTS = places.RESULTS / "training"
LINE_INTERVAL = 60.0
"""Least time between two lines of progress that are not on a terminal [s]."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = Parser("train", __doc__)
    study.add_names(parser, "training", "name")
    parser.add_argument("--dataset", type=Path, required=True, metavar="FILE", help="from import-cfd or cfd")
    study.add_set(parser, study.example_of("training"))
    parser.add_argument("--out", type=Path, metavar="DIR", help="result folder (default results/training/NAME)")
    parser.add_argument("--write", type=Path, metavar="CARD", help="also write weights and card there (…/NAME.json)")
    parser.add_argument("--overwrite", action="store_true", help="train again and replace an existing result")
    given = parser.parse_args(arguments)
    return exit_status(lambda: print(table(run(given))), interrupted="the same command goes on where this one stopped")


def run(given: argparse.Namespace) -> dict[str, Any]:
    """Train all parts and write the result, unless it exists; return the errors of the splits."""
    path = study.find("training", given.name)
    changes = parse_assignments(given.set)
    training, document = config.read(path, changes)
    if given.write:
        card_path(given.write)  # a wrong path is refused before the training
        if not training.final:
            raise Refused(f"{path.name}: final is false, so there are no weights to --write")
    dataset = load(given.dataset, training.robot_model)
    if training.mirrored:
        dataset = dataset.add_mirror_images()
    named = given.out or RESULTS / (study.result_name("training", path) + folder_suffix(changes))
    folder = resolve(named)
    asked = {"training": document, "error": ERROR_UNIT, "data": dataset.sha256}
    identity = Identity.of(asked, [training.robot], [PYTHON])
    with lock_work(folder):
        trained = record.find_existing(folder, identity, documents.Training, overwrite=given.overwrite)
        if trained is None:
            trained = _train_parts(given, training, document, identity, dataset, folder)
    if given.write:
        copy_card(folder / f"{folder.name}.json", given.write)
    summary = trained["summary"]
    print(f"{manifest.make_portable(folder)}: {summary['parameters']} parameters")
    return dict(summary["errors"])


def _train_parts(
    given: argparse.Namespace,
    training: config.Training,
    table: dict[str, Any],
    identity: Identity,
    dataset: Dataset,
    folder: Path,
) -> dict[str, Any]:
    """Train all parts and write the result; return its manifest."""
    started = time.perf_counter()
    todo = list(parts.parts(training, dataset))
    work = Work.on(folder, identity)
    finished, network = _train(training, dataset, todo, work)
    errors = result.summarise(finished, training.chosen_on, dataset.links)

    def save(draft: Path) -> None:
        if network is not None:
            facts = result.card_facts(
                dataset,
                errors,
                epochs=training.epochs,
                seed=training.seed,
                source=given.dataset.name,
                held_out=f"final weights: all rows; errors: {_describe_validation(training)}",
            ) | {"check": result.check_rows(network, training.robot_model, dataset)}
            card = draft / f"{folder.name}.json"
            save_network(card, network, training.robot_model, description=training.description, training=facts)

    timings = {one.part.name: float(one.errors["seconds"]) for one in finished}
    copies = training.ensemble.members if training.ensemble.keep == "mean" else 1
    document = manifest.build(
        folder.name,
        training.title,
        table,
        identity,
        summary={
            "errors": errors,
            "parameters": training.start(0).parameters * copies,
            "seconds_per_epoch": {one.part.name: one.errors["seconds_per_epoch"] for one in finished},
        },
        command=["jax-aero", "train", *sys.argv[2:]],
        backend="jax",
        dataset=dataset.sha256,
        timings_s=timings | {"this call": time.perf_counter() - started},
    )
    data = result.to_dataset(training.robot_model, dataset, finished, training.title)
    data.attrs["config_hash"] = identity.digest
    record.write_run(folder, data, document, replace=given.overwrite, more=save)
    work.clear()
    return document


def _describe_validation(training: config.Training) -> str:
    held = training.validation
    folds = f"{held.folds_run} of {held.folds}" if held.folds_run < held.folds else f"{held.folds}"
    return (
        f"grouped: {folds} folds of whole postures with their mirror images, fold seeds {list(held.fold_seeds)}; "
        f"random: {held.fraction:.0%} of all rows, seeds {list(held.random_seeds)}"
    )


def _train(
    training: config.Training, dataset: Dataset, todo: Sequence[parts.Part], work: Work
) -> tuple[list[FinishedPart], Network | None]:
    robot = training.robot_model
    finished: list[FinishedPart] = []
    network = None
    is_quiet = not sys.stderr.isatty()
    with tqdm(
        total=len(todo) * training.epochs,
        unit="epoch",
        file=terminal(),
        mininterval=LINE_INTERVAL if is_quiet else 0.1,
        dynamic_ncols=True,
    ) as bar:
        for number, part in enumerate(todo):
            bar.set_description(part.name)

            def on_epoch(epoch: int, train: float, error: float | None, before: int = number * training.epochs) -> None:
                shown = {"train": f"{train:.2e}"} | ({} if error is None else {"held out": f"{error:.2e}"})
                bar.set_postfix(shown, refresh=False)
                if (resumed := before + epoch - 1 - bar.n) > 0:  # by earlier calls, whose time is not known
                    bar.initial += resumed
                    bar.n = bar.last_print_n = bar.n + resumed
                bar.update()

            # The last part is trained again if needed, since its weights are required.
            done = parts.recall(work, part) if part.split != "final" else None
            if done is None:
                done, network = parts.run(part, training, robot, dataset, work, on_epoch)
                if part.split != "final":
                    parts.keep(work, done)
                    network = None
            finished.append(done)
            if is_quiet:
                mse = f", held out {done.errors['mse']:.3e} m4" if "mse" in done.errors else ""
                print(
                    f"{part.name}: train {done.errors['train_mse']:.3e}{mse}, {done.errors['seconds']:.0f} s",
                    file=sys.stderr,
                    flush=True,
                )
    return finished, network


def table(errors: dict[str, Any]) -> str:
    """Return the errors as a table that always shows both splits."""
    names = list(next(iter(errors.values()))["baselines"]) if errors else []
    splits: list[str] = [split for split in ("random", "grouped") if split in errors]
    by_split = [errors[split] for split in splits]
    rows = {
        "network": [one["mse"] for one in by_split],
        "  standard deviation over folds": [one["fold_std"] for one in by_split],
        "  worst fold": [one["fold_max"] for one in by_split],
    }
    if errors.get("grouped", {}).get("elsewhere_mse") is not None:
        rows["  postures on which nothing was chosen"] = [one.get("elsewhere_mse") for one in by_split]
    rows["mean of all members"] = [one["ensemble_mse"] for one in by_split]
    rows["network, rows it was trained on"] = [one["train_mse"] for one in by_split]
    rows |= {name: [one["baselines"][name] for one in by_split] for name in names}
    cells = {text: ["-" if value is None else f"{value:.3e}" for value in values] for text, values in rows.items()}
    cells = {"mean squared error of held-out rows [m^4]": splits, **cells}
    return "\n".join(text.ljust(44) + "".join(cell.rjust(12) for cell in row) for text, row in cells.items())

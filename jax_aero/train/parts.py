"""One part of a training run: train on some rows, predict the held-out ones, store both until the run is complete."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from jax_aero.aero.dataset import Dataset, Floats, Indices
from jax_aero.aero.network import Layer, Network
from jax_aero.aero.posture import total_wrench, vector_rms
from jax_aero.base.terminal import Refused
from jax_aero.body.robot import RobotModel
from jax_aero.results.work import Work
from jax_aero.train import (
    Checkpoint,
    FitResult,
    Samples,
    Settings,
    baseline_errors,
    distil_samples,
    fit,
    load_checkpoint,
    predict_areas,
    samples_of,
    save_checkpoint,
)
from jax_aero.train.config import Training
from jax_aero.train.loss import mean_square

OnEpoch = Callable[[int, float, float | None], None]
"""Function of the epochs of this part that are done, its networks together, and the losses."""


@dataclass(frozen=True)
class Part:
    """Rows that one part trains on and holds out."""

    name: str
    split: str
    """`random`, `grouped` or `final`."""
    seed: int
    """Seed of the split, which also determines the network's random numbers."""
    train: Indices
    held_out: Indices


@dataclass(frozen=True)
class FinishedPart:
    """A finished part."""

    part: Part
    errors: Mapping[str, Any]
    """`mse`, `train_mse`, `by_posture`, `by_link`, baselines, times."""
    areas: npt.NDArray[np.float32]
    """(held out, 13, 3) predictions, base axes."""
    curves: Mapping[str, list[list[float | None]]]
    """Loss curves by name of the network, as rows of epoch, training loss, validation loss."""


def parts(training: Training, dataset: Dataset) -> Iterator[Part]:
    """Return the parts of a run, the grouped ones first."""
    held = training.validation
    for seed in held.fold_seeds:
        for fold, (train, rest) in enumerate(dataset.grouped_folds(seed, held.folds)[: held.folds_run]):
            yield Part(f"grouped-{seed}-{fold}", "grouped", seed, train, rest)
    for seed in held.random_seeds:
        train, rest = dataset.random_split(seed, held.fraction)
        if not 0 < len(rest) < len(dataset):
            raise Refused(
                f"`validation.fraction` is {held.fraction:g}, which holds out {len(rest)} of {len(dataset)} rows; "
                "expected some of them, not all"
            )
        yield Part(f"random-{seed}", "random", seed, train, rest)
    if training.final:
        everything = np.arange(len(dataset), dtype=np.int64)
        yield Part("final", "final", 0, everything, everything[:0])


def run(
    part: Part, training: Training, robot: RobotModel, dataset: Dataset, work: Work, on_epoch: OnEpoch
) -> tuple[FinishedPart, Network]:
    """Train one part, resuming from its checkpoints."""
    started = time.perf_counter()
    rows, held_out = dataset.take(part.train), dataset.take(part.held_out)
    model = training.start(training.seed)
    samples = samples_of(model, robot, rows)
    unseen = samples_of(model, robot, held_out) if len(held_out) else None
    curves: dict[str, list[list[float | None]]] = {}
    first, before = training.seed + 1000 * part.seed, 0

    def fit_part(name: str, samples: Samples, settings: Settings, seed: int) -> FitResult:
        nonlocal before
        fitted = fit(
            training.start(seed),
            samples,
            unseen,
            settings,
            seed,
            checkpoint=work.path(f"{part.name}-{name}"),
            on_epoch=lambda epoch, *losses: on_epoch(before + epoch, *losses),
        )
        before += settings.epochs
        curves[f"{part.name}-{name}"] = [list(row) for row in fitted.curves]
        return fitted

    fitted = [
        fit_part(f"member-{member}", samples, training.training, first + member)
        for member in range(training.ensemble.members)
    ]
    members = [one.network for one in fitted]
    network = mean_of(members)
    if (how := training.distillation) is not None:
        taught = distil_samples(
            members, robot, rows, count=how.samples, spread_deg=how.spread_deg, seed=first + len(members)
        )
        network = fit_part("student", taught, how.training, first + len(members)).network
    errors: dict[str, Any] = {
        "train_mse": mean_square(predict_areas(network, robot, rows) - rows.force_area_b),
        "seconds": time.perf_counter() - started,
        "seconds_per_epoch": float(np.median([one.seconds_per_epoch for one in fitted])),
        "rows": len(rows),
        "held_out": len(held_out),
    }
    areas = np.zeros((0, *dataset.force_area_b.shape[1:]), np.float32)
    if len(held_out):
        predicted = predict_areas(network, robot, held_out)
        teachers = predict_areas(mean_of(members), robot, held_out) if training.distillation else predicted
        areas = predicted.astype(np.float32)
        errors |= _errors(robot, predicted, held_out) | {"baselines": baseline_errors(robot, rows, held_out)}
        errors["ensemble_mse"] = mean_square(teachers - held_out.force_area_b)
    return FinishedPart(part, errors, areas, curves), network


def mean_of(members: list[Network]) -> Network:
    """Return one network with the members of several, whose output is their mean."""
    layers = tuple(
        Layer(*(np.concatenate([getattr(net.layers[i], name) for net in members]) for name in ("weight", "bias")))  # type: ignore[arg-type]  # NumPy arrays are leaves too
        for i in range(len(members[0].layers))
    )
    return dataclasses.replace(members[0], layers=layers)


def _errors(robot: RobotModel, predicted: Floats, held_out: Dataset) -> dict[str, Any]:
    error = predicted - held_out.force_area_b
    spread = mean_square(held_out.force_area_b - held_out.force_area_b.mean(axis=0))
    off = total_wrench(robot, held_out.joint_position(robot), error)
    present = total_wrench(robot, held_out.joint_position(robot), held_out.force_area_b)
    return {
        "mse": mean_square(error),
        "r2": 1.0 - mean_square(error) / spread,
        "whole_robot_rms": vector_rms(off.force_area),
        "moment_rms": vector_rms(off.moment_volume),
        "moment_present_rms": vector_rms(present.moment_volume),
        "by_posture": {name: mean_square(error[held_out.posture == name]) for name in held_out.postures},
        "by_link": [mean_square(error[:, link]) for link in range(error.shape[1])],
    }


def keep(work: Work, finished: FinishedPart) -> None:
    """Store a finished part, whose checkpoints are then not needed."""
    name, facts = finished.part.name, {"errors": finished.errors, "curves": finished.curves}
    save_checkpoint(work.path(name), work.seal_of(name), Checkpoint(finished.areas, facts))
    for network in finished.curves:
        work.path(network).unlink(missing_ok=True)


def recall(work: Work, part: Part) -> FinishedPart | None:
    """Return a part that was finished earlier, or `None`."""
    stored = load_checkpoint(work.path(part.name), work.seal_of(part.name), 0)
    return FinishedPart(part, areas=np.asarray(stored.state), **stored.facts) if stored else None

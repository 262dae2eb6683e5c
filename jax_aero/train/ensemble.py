"""Train independent networks and calibrate their total force and moment: `jax-aero train ensemble`.

Eight small networks differ in initial weights, inputs, widths, axisymmetric part and in the postures of their training.
Each fold of whole postures is predicted by networks trained without it. The spread of the networks and a conformal
factor give intervals for total force and total moment about the centre of mass, whose coverage is measured for each
posture with the factor of the other postures. The result goes to `results/training/ensemble/`; `--write DIR` writes
weights, cards and `ensemble.json` to DIR. An interrupted run is resumed by the same command.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from jax_aero.aero.dataset import Dataset, Floats, Indices, load
from jax_aero.aero.network import Network
from jax_aero.aero.network_card import save_network
from jax_aero.aero.posture import link_arms, total_wrench, vector_rms
from jax_aero.base import places, tables
from jax_aero.base.arguments import Parser, complete_with, count
from jax_aero.base.files import lock_work, resolve, write_json
from jax_aero.base.terminal import exit_status
from jax_aero.results import manifest, record, study
from jax_aero.results.identity import ANOTHER, PYTHON, Identity
from jax_aero.results.work import Work
from jax_aero.train import Checkpoint, config, fit, load_checkpoint, predict_areas, result, samples_of, save_checkpoint

FOLDS = 5
COVERAGE = 0.9
SEED = 100
"""Seed of the first network."""
JOINT_NOISE = {"wind": 0.05, "joints": 0.02, "link_shadow": 0.03}

MEMBERS: tuple[Mapping[str, Any], ...] = (
    {"hidden": [64, 64, 64]},
    {"hidden": [96, 96, 96]},
    {"hidden": [64, 64, 64, 64], "baseline": "corrected"},
    {"hidden": [96, 64, 96], "baseline": "refit"},
    {"hidden": [80, 80, 80], "features": ["link_wind", "link_position"]},
    {"hidden": [96, 96], "activation": "tanh"},
    {"hidden": [96, 96, 96], "features": ["wind", "joints", "link_shadow"]},
    {"hidden": [64, 96, 64], "baseline": "none"},
)
"""Differences of each network from the base."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = Parser("train ensemble", __doc__)
    parser.add_argument("--dataset", type=Path, required=True, metavar="FILE", help="from import-cfd")
    about = "training whose robot, network and settings members share (default compact)"
    complete_with(
        parser.add_argument("--base", default="compact", metavar="NAME", help=about), lambda: places.names("training")
    )
    parser.add_argument("--epochs", type=count, default=60, metavar="N", help="epochs of every network (default 60)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="result folder (default results/training/ensemble)")
    parser.add_argument("--overwrite", action="store_true", help="replace the result of another ensemble")
    parser.add_argument("--write", type=Path, metavar="DIR", help="write weights, cards and ensemble.json there")
    given = parser.parse_args(arguments)

    def work() -> None:
        folder = resolve(given.out or places.RESULTS / "training" / "ensemble")
        with lock_work(folder):
            base = study.find("training", given.base)
            manifest = run(given.dataset, base, given.epochs, folder, given.write, overwrite=given.overwrite)
        print(study.listing(manifest["summary"]))

    return exit_status(work, interrupted="the same command goes on where this one stopped")


def run(
    path: Path, base: Path, epochs: int, folder: Path, write: Path | None, *, overwrite: bool = False
) -> dict[str, Any]:
    """Train, calibrate and write; return the manifest."""
    started = time.perf_counter()
    trainings = [member_training(base, changes, epochs) for changes in MEMBERS]
    robot = trainings[0].robot_model
    dataset = load(path, robot).add_mirror_images()
    asked = {"members": list(MEMBERS), "epochs": epochs, "data": dataset.sha256}
    identity = Identity.of(asked, [base], [PYTHON])
    record.check_replaceable(folder, lambda kept: identity.difference(kept) != ANOTHER, overwrite=overwrite)
    work = Work.on(folder, identity)
    predicted = np.zeros((len(MEMBERS), len(dataset), *dataset.force_area_b.shape[1:]), np.float32)
    for fold, (train, held_out) in enumerate(dataset.grouped_folds(0, FOLDS)):
        for number, training in enumerate(trainings):
            job = f"fold-{fold}-member-{number}"
            kept = load_checkpoint(work.path(job), work.seal_of(job), 0)
            if kept is None:
                network = train_member(number, training, dataset.take(leave_one_out(dataset, train, fold + number)))
                areas = predict_areas(network, robot, dataset.take(held_out)).astype(np.float32)
                kept = Checkpoint(areas, {})
                save_checkpoint(work.path(job), work.seal_of(job), kept)
                print(f"{job}: {time.perf_counter() - started:.0f} s", file=sys.stderr, flush=True)
            predicted[number, held_out] = kept.state
    totals = [total_wrench(robot, dataset.joint_position(robot), areas.astype(np.float64)) for areas in predicted]
    truth = total_wrench(robot, dataset.joint_position(robot), dataset.force_area_b)
    calibration = {
        name: intervals(np.stack([getattr(one, key) for one in totals]), getattr(truth, key), dataset.family)
        for name, key in (("force", "force_area"), ("moment", "moment_volume"))
    }
    arms = link_arms(robot, dataset.joint_position(robot))
    summary = summarise(predicted, dataset, calibration)
    summary["links: half width of factors that widen the draws"] = link_half_width(
        calibration["moment"], np.cross(arms, dataset.force_area_b)
    )
    if write is not None:
        write_members(write, trainings, dataset, calibration, summary, path.name)
    data = to_dataset(dataset, totals, truth, identity.digest)
    settings = {"members": [dict(one) for one in MEMBERS], "epochs": epochs, "folds": FOLDS}
    document = manifest.build(
        "ensemble",
        data.attrs["title"],
        settings,
        identity,
        summary=summary,
        command=["jax-aero", "train", *sys.argv[2:]],
        backend="jax",
        dataset=dataset.sha256,
        timings_s={"this call": time.perf_counter() - started},
    )
    record.write_run(folder, data, document, replace=True)  # the work stays: a later --write does not train the folds
    return document


def member_training(base: Path, changes: Mapping[str, Any], epochs: int) -> config.Training:
    """Return the settings of one network."""
    table = tables.read(base)
    table["network"] |= dict(changes)
    blocks = table["network"]["features"]
    noise = table["training"]["noise"] | JOINT_NOISE
    table["training"] |= {"epochs": epochs, "noise": {block: noise[block] for block in blocks}}
    table["ensemble"] = {"members": 1, "keep": "mean"}
    del table["distillation"]
    return tables.convert(table, config.Training, base.name, base.parent)


def train_member(number: int, training: config.Training, rows: Dataset) -> Network:
    """Train one network from random initial weights."""
    seed = SEED + number
    start = training.start(seed)
    return fit(start, samples_of(start, training.robot_model, rows), None, training.training, seed).network


def leave_one_out(dataset: Dataset, rows: Indices, number: int) -> Indices:
    """Return rows without those of one posture and its mirror image, which differ between numbers."""
    families = np.unique(dataset.family[rows])
    kept: Indices = rows[dataset.family[rows] != families[number % len(families)]]
    return kept


def intervals(predicted: Floats, truth: Floats, family: Indices) -> dict[str, Any]:
    """Return a conformal factor k such that |error| ≤ k √(s² + s₀²) with the networks' spread s, and its coverage.

    Parameters
    ----------
    predicted
        (members, N, 3), every row by networks trained without its posture.
    family
        (N,) number of the posture, equal for mirror images.
    """
    error = np.linalg.norm(predicted.mean(axis=0) - truth, axis=1)
    spread = np.sqrt(predicted.var(axis=0, ddof=1).sum(axis=1))
    spread_rms = float(np.sqrt(np.mean(spread**2)))
    score = error / np.sqrt(spread**2 + spread_rms**2)
    covered = {}
    for one in np.unique(family):
        other = np.quantile(score[family != one], COVERAGE)
        covered[int(one)] = float(np.mean(score[family == one] <= other))
    factor = float(np.quantile(score, COVERAGE))
    weights = [int(np.sum(family == one)) for one in covered]
    return {
        "factor": factor,
        "spread_rms": spread_rms,
        "rms": vector_rms(predicted.mean(axis=0) - truth),
        "coverage": float(np.average(list(covered.values()), weights=weights)),
        "coverage_min": min(covered.values()),
        "coverage_max": max(covered.values()),
        "half_width": float(np.mean(factor * np.sqrt(spread**2 + spread_rms**2))),
        "correlation": float(np.corrcoef(error, spread)[0, 1]),
    }


def link_half_width(moment: Mapping[str, float], of_links: Floats) -> float:
    """Return h such that a random network with random factors 1 ± h on its links' forces has the networks' error.

    Uniform, independent factors add a variance of h²/3 Σ_l |m_l|² to the total moment, which must equal rms² − s₀²,
    from error and spread of the networks on unseen postures.

    Parameters
    ----------
    moment
        Error `rms` and spread `spread_rms` of the total moment [m³], from `intervals`.
    of_links
        (N, L, 3) moment volumes of the links about the centre of mass [m³].
    """
    missing = moment["rms"] ** 2 - moment["spread_rms"] ** 2
    return float(np.sqrt(3.0 * max(missing, 0.0) / np.mean(np.sum(of_links**2, axis=(1, 2)))))


def summarise(predicted: Any, dataset: Dataset, intervals: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Return the figures of a card: errors on unseen postures, and coverage of the intervals."""
    mean = predicted.mean(axis=0) - dataset.force_area_b
    single = [float(np.mean((one - dataset.force_area_b) ** 2)) for one in predicted]
    summary = {
        "links, mean of the networks: mean square error [m4]": float(np.mean(mean**2)),
        "links, best single network [m4]": min(single),
        "links, worst single network [m4]": max(single),
    }
    for name, unit in (("force", "m2"), ("moment", "m3")):
        one = intervals[name]
        summary |= {
            f"total {name}: rms error of the mean [{unit}]": one["rms"],
            f"total {name}: conformal factor": one["factor"],
            f"total {name}: mean half width [{unit}]": one["half_width"],
            f"total {name}: coverage of unseen postures": one["coverage"],
            f"total {name}: coverage, worst posture": one["coverage_min"],
            f"total {name}: coverage, best posture": one["coverage_max"],
            f"total {name}: correlation of error and spread": one["correlation"],
        }
    return summary


def write_members(
    folder: Path,
    trainings: Sequence[config.Training],
    dataset: Dataset,
    intervals: Mapping[str, Any],
    summary: Mapping[str, float],
    source: str,
) -> None:
    """Write weights and cards of networks trained on all postures but one each, and their calibration."""
    robot = trainings[0].robot_model
    everything = np.arange(len(dataset), dtype=np.int64)
    for number, training in enumerate(trainings):
        rows = dataset.take(leave_one_out(dataset, everything, number))
        network = train_member(number, training, rows)
        left_out = sorted(set(dataset.postures) - set(rows.postures))
        facts = result.card_facts(
            rows,
            {},
            epochs=training.training.epochs,
            seed=SEED + number,
            source=source,
            held_out=f"one of an ensemble, not shown {', '.join(left_out)}; errors: ensemble.json",
        )
        save_network(
            folder / f"member_{number}.json",
            network,
            robot,
            description=f"Network {number} of an ensemble of independent ones.",
            training=facts | {"check": result.check_rows(network, robot, dataset)},
        )
    card = {
        "members": [f"member_{number}.json" for number in range(len(trainings))],
        "interval": "|error| <= factor sqrt(spread^2 + spread_rms^2); spread: standard deviation of the members, "
        "all axes",
        "coverage_aimed_at": COVERAGE,
        "force_m2": intervals["force"],
        "moment_about_com_m3": intervals["moment"],
        "unseen_postures": dict(summary),
        "dataset_sha256": dataset.sha256,
    }
    write_json(folder / "ensemble.json", card)


def to_dataset(dataset: Dataset, totals: Sequence[Any], truth: Any, digest: str) -> xr.Dataset:
    """Return the predictions for unseen postures as a labelled dataset."""
    row = ("member", "row", "xyz")
    variables: dict[str, Any] = {
        "force_area": (("row", "xyz"), truth.force_area, {"units": "m2"}),
        "moment_volume": (
            ("row", "xyz"),
            truth.moment_volume,
            {"units": "m3", "long_name": "about the centre of mass"},
        ),
        "predicted_force_area": (row, np.stack([one.force_area for one in totals]), {"units": "m2"}),
        "predicted_moment_volume": (row, np.stack([one.moment_volume for one in totals]), {"units": "m3"}),
        "wind": (("row", "xyz"), dataset.wind_b, {"units": "1"}),
    }
    coords = {"posture": ("row", dataset.posture.astype(str)), "xyz": ["x", "y", "z"]}
    title = "An ensemble of networks on postures that it has not seen"
    return xr.Dataset(variables, coords, {"title": title, "config_hash": digest})

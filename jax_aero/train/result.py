"""Result of a training run: predictions of held-out rows, loss curves, errors, facts for a card."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import xarray as xr

from jax_aero.aero.dataset import Dataset, Floats
from jax_aero.aero.network import Network, with_precision
from jax_aero.aero.posture import link_axes
from jax_aero.base import places, run_file
from jax_aero.base.terminal import Refused
from jax_aero.body.robot import RobotModel
from jax_aero.data import fit
from jax_aero.data.import_cfd import COMMIT
from jax_aero.results import record
from jax_aero.train.loop import ERROR_UNIT
from jax_aero.train.parts import FinishedPart
from jax_aero.train.samples import predict_areas

FREESTREAM_NOTE = (
    "Trained on free-stream simulations that the authors of the paper made public in the history of the repository "
    f"ami-iit/element_cfd-simulation (commit {COMMIT}), from before that repository had a licence file. The table "
    "itself is not part of this project: import it from there. These weights are this project's own result."
)
OPEN_NOTE = (
    "Trained on the project's own simulations by an open solver (docs/air.md). Of the public free-stream table are the "
    "normal-force coefficients of the signed axisymmetric model, where the network corrects that."
)
OTHER_NOTE = "Trained on data that are no part of this project; `dataset` and `dataset_sha256` say which."
NOTES = {"openfoam": OPEN_NOTE, COMMIT: FREESTREAM_NOTE}
"""Text of a card about its data, by a word in their provenance."""


def training_of(name: str) -> Path:
    """Return the result of `train NAME`."""
    return places.RESULTS / "training" / name / places.RUN_FILE


def held_out_network(name: str, data: Dataset) -> Floats | None:
    """Return the force areas (N, links, 3) that `train NAME` predicted for postures held out, if it was run."""
    path = training_of(name)
    if (manifest := record.read_manifest(path.parent)) is None:
        return None
    if manifest.get("dataset") not in (data.sha256, data.add_mirror_images().sha256):
        raise Refused(f"{path} is of another dataset; train again on this one, or move it away")
    run = run_file.read(path)
    return np.asarray(run["area_grouped"].values[run["is_mirrored"].values == 0], dtype=np.float64)


def summarise(finished: Sequence[FinishedPart], chosen_on: Sequence[str], links: Sequence[str]) -> dict[str, Any]:
    """Return the errors of each split: mean over rows, spread over folds, and the baselines on the same rows.

    Settings that were chosen by looking at some postures are also judged on the other ones: `elsewhere_mse`.
    """
    by_split: dict[str, Any] = {}
    for split in ("random", "grouped"):
        here = [one for one in finished if one.part.split == split]
        if not here:
            continue
        weights = np.array([one.errors["held_out"] for one in here], dtype=float)
        folds = np.array([one.errors["mse"] for one in here])

        def mean(values: Sequence[float], weights: Any = weights) -> float:
            return float(np.average(values, weights=weights))

        by_split[split] = {
            "mse": mean([one.errors["mse"] for one in here]),
            "folds": len(here),
            "fold_std": float(folds.std(ddof=1)) if len(here) > 1 else None,
            "fold_min": float(folds.min()),
            "fold_max": float(folds.max()),
            "train_mse": mean([one.errors["train_mse"] for one in here]),
            "ensemble_mse": mean([one.errors["ensemble_mse"] for one in here]),
            **{
                name: float(np.sqrt(mean([one.errors[name] ** 2 for one in here])))
                for name in ("whole_robot_rms", "moment_rms", "moment_present_rms")
            },
            "by_link": dict(
                zip(links, np.average([one.errors["by_link"] for one in here], axis=0, weights=weights), strict=True)
            ),
            "baselines": {
                name: mean([one.errors["baselines"][name] for one in here]) for name in here[0].errors["baselines"]
            },
        }
        if split == "grouped":
            names = sorted({name for one in here for name in one.errors["by_posture"]})
            rows = {
                name: [one.errors["by_posture"][name] for one in here if name in one.errors["by_posture"]]
                for name in names
            }
            means = {name: float(np.mean(values)) for name, values in rows.items()}
            others = [value for name, value in means.items() if name not in chosen_on]
            by_split[split]["by_posture"] = means
            by_split[split]["elsewhere_mse"] = float(np.mean(others)) if chosen_on and others else None
    return by_split


def to_dataset(robot: RobotModel, dataset: Dataset, finished: Sequence[FinishedPart], title: str) -> xr.Dataset:
    """Return predictions of the first seed of each split, those of the axisymmetric model, and all loss curves."""
    areas = dataset.force_area_b.astype(np.float32)
    axes = link_axes(robot, dataset.joint_position(robot))
    variables: dict[str, Any] = {
        "area": (("row", "link", "xyz"), areas, _unit("force area, as given")),
        "wind": (("row", "xyz"), dataset.wind_b, {"units": "1", "long_name": "unit wind, base axes"}),
        "joint_position": (("row", "joint"), dataset.joint_position_deg, {"units": "degree"}),
        "attack": (
            ("row", "link"),
            np.degrees(np.arccos(fit.angles(axes, dataset.wind_b).cos)),
            {"units": "degree", "long_name": "angle between the link's axis and where the wind comes from"},
        ),
    }
    if (corrected := robot.aero_links.coefficients.get("corrected")) is not None:
        predicted = fit.predicted_areas(np.asarray(corrected), axes, dataset.wind_b).astype(np.float32)
        text = "force area of the published axisymmetric model, head corrected"
        variables["area_axisymmetric"] = (("row", "link", "xyz"), predicted, _unit(text))
    for split in ("random", "grouped"):
        here = [one for one in finished if one.part.split == split]
        if not here:
            continue
        predicted = np.full_like(areas, np.nan)
        for one in here:
            if one.part.seed == here[0].part.seed:
                predicted[one.part.held_out] = one.areas
        text = f"force area predicted for rows held out, {split} split; nan where a row was trained on"
        variables[f"area_{split}"] = (("row", "link", "xyz"), predicted, _unit(text))
    curves = {name: rows for one in finished for name, rows in one.curves.items()}
    longest = max((len(rows) for rows in curves.values()), default=0)
    filled = np.full((len(curves), longest, 3), np.nan)
    for index, rows in enumerate(curves.values()):
        if rows:
            filled[index, : len(rows)] = [[np.nan if v is None else v for v in row] for row in rows]
    for column, (name, unit, text) in enumerate(
        (
            ("epoch", "1", "epochs done"),
            ("train_loss", "m4", "mean squared error while training, with dropout and noise"),
            ("validation_loss", "m4", "mean squared error of held-out rows, without dropout"),
        )
    ):
        variables[name] = (("curve", "step"), filled[:, :, column], {"units": unit, "long_name": text})
    coords: dict[str, Any] = {
        "posture": ("row", dataset.posture.astype(str)),
        "is_mirrored": ("row", dataset.is_mirrored.astype("i1")),
        "pitch": ("row", dataset.pitch_deg, {"units": "degree"}),
        "yaw": ("row", dataset.yaw_deg, {"units": "degree"}),
        "joint": list(dataset.joints),
        "link": list(dataset.links),
        "xyz": ["x", "y", "z"],
        "curve": list(curves),
    }
    return xr.Dataset(variables, coords, {"title": title})


def _unit(text: str) -> dict[str, str]:
    return {"units": "m2", "long_name": text}


def card_facts(
    dataset: Dataset, errors: Mapping[str, Any], *, epochs: int, seed: int, source: str, held_out: str
) -> dict[str, Any]:
    """Return the facts about the training for a card, without any about this machine."""
    baselines = {split: errors[split]["baselines"] for split in errors}
    plain = {
        split: {key: value for key, value in error.items() if key not in ("baselines", "by_link")}
        for split, error in errors.items()
    }
    source_text = " ".join([*dataset.provenance, *dataset.provenance.values()]).lower()
    return {
        "dataset": source,
        "dataset_sha256": dataset.sha256,
        "rows": len(dataset),
        "split": held_out,
        "seed": seed,
        "epochs": epochs,
        "errors": plain,
        "error_unit": ERROR_UNIT,
        "baselines": baselines,
        "note": next((note for word, note in NOTES.items() if word in source_text), OTHER_NOTE),
    }


def check_rows(network: Network, robot: RobotModel, dataset: Dataset) -> list[dict[str, Any]]:
    """Return some outputs of the network, with which readers check that they read the weights correctly.

    The last row is synthetic: a posture that is not in the data, and a wind off the grid.
    """
    # Weights are in single precision, as in flight; outputs are compared in double precision.
    some = dataset.take(np.array([0, len(dataset) // 3, len(dataset) // 3]))
    joints = some.joint_position_deg.copy()
    wind = some.wind_b.copy()
    joints[-1] = np.linspace(-30.0, 30.0, len(dataset.joints))
    wind[-1] = np.array([2.0, -3.0, 6.0]) / 7.0
    some = replace(some, joint_position_deg=joints, wind_b=wind)
    with jax.enable_x64(True):
        areas = predict_areas(with_precision(network, np.float64), robot, some)
    return [
        {"joint_position_deg": q.tolist(), "wind_b": w.tolist(), "areas_b": a.tolist()}
        for q, w, a in zip(joints, wind, areas, strict=True)
    ]

"""Compare our simulations with models and with those of others: `jax-aero cfd compare NAME`.

NAME is a design of `jax-aero cfd`. Its rows are compared with the project's models and, on left-out postures, with the
network that `train NAME` made of them. With `--set table=FILE`, a dataset of `import-cfd`, all are also compared on
rows of equal posture and wind. Cases and mirror images that are one case are averaged first, in both datasets.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from jax_aero.aero.dataset import Dataset, Floats, Indices, load
from jax_aero.aero.posture import NEWTON_METRES, total_wrench, vector_rms
from jax_aero.base import tables
from jax_aero.base.places import ROBOT
from jax_aero.base.terminal import Refused
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.cfd.compute import dataset_of
from jax_aero.cfd.goals import verdicts
from jax_aero.cfd.models import MODEL_FILES, model_areas
from jax_aero.data.import_cfd import POSTURES
from jax_aero.data.ironcub import LINKS
from jax_aero.results.study import Findings, Study
from jax_aero.train.result import held_out_network, training_of

OPEN = "open solver"
SHOWN = ("axisymmetric, corrected", "network, shipped")
"""Models of the project that are shown."""


class CompareConfig(tables.Table, frozen=True):
    """Settings of a comparison."""

    dataset: Path | None = None
    """Dataset of the design; by default `results/cfd/NAME/dataset.nc`."""
    table: Path | None = None
    """Dataset of `import-cfd` to compare with."""


def compute(name: str, config: CompareConfig) -> Findings:
    """Compare."""
    path = config.dataset or dataset_of(name)
    robot = load_robot(ROBOT)
    cases = load(path, robot)
    ours = symmetrise(cases)
    summary: dict[str, Any] = {"cases": len(ours), "postures": len(ours.postures)}
    summary |= asymmetry(robot, cases) | couples(robot, ours)
    models = models_at(robot, ours)
    files = [*MODEL_FILES, POSTURES]
    if (trained := held_out_network(name, cases)) is not None:
        models["network, trained on postures other than the row's"] = trained
        files.append(training_of(name))
    summary |= model_errors(robot, models, ours, f"beside the {OPEN}")
    result = to_rows(models, ours)
    if config.table:
        here, there, rows = match_cases(ours, symmetrise(load(config.table, robot)))
        summary["cases with a counterpart in the table"] = len(rows)
        all_models = {OPEN: ours.force_area_b, **models}
        at_rows = {model: areas[rows] for model, areas in all_models.items()}
        beside_table = model_errors(robot, at_rows, there, "beside the table")
        own = {name: error for name, error in beside_table.items() if name.startswith(OPEN)}
        summary |= beside_table | verdicts(own)
        for posture in here.postures:
            own = here.posture == posture
            of_posture = errors(robot, here.force_area_b[own], there.take(own))
            summary |= {f"{posture} ({own.sum()}): {key}": value for key, value in of_posture.items()}
        off = np.sqrt(np.mean(np.sum((here.force_area_b - there.force_area_b) ** 2, axis=2), axis=0))
        names = [f"{OPEN}, beside the table: {link}, rms [m2]" for link in LINKS]
        summary |= dict(zip(names, off.tolist(), strict=True))
        result = to_rows(at_rows, there)
    return Findings(f"Open CFD `{name}` beside others", result, summary, files=files)


STUDY = Study(
    "cfd_compare",
    __doc__,
    CompareConfig,
    compute,
    ("open",),
    backend="openfoam",
    reads=lambda name, config: [] if config.dataset else [dataset_of(name)],
)
main = STUDY.main


def symmetrise(data: Dataset) -> Dataset:
    """Return the rows, each averaged with all rows of the same case, including mirror images."""
    both = data.add_mirror_images()
    count = np.bincount(both.group)

    def mean(values: Floats) -> Floats:
        total = np.zeros((len(count), *values.shape[1:]))
        np.add.at(total, both.group, values)
        means: Floats = (total / count[:, None, None])[both.group[: len(data)]]
        return means

    couples = None if both.couple_volume_b is None else mean(both.couple_volume_b)
    return replace(data, force_area_b=mean(both.force_area_b), couple_volume_b=couples)


def asymmetry(robot: RobotModel, data: Dataset) -> dict[str, float]:
    """Return the differences between cases that are mirror images of each other."""
    both, count = data.add_mirror_images(), len(data)
    mirrored, direct = np.nonzero(both.group[count:, None] == both.group[:count])
    is_pair = mirrored < direct
    if not is_pair.any():
        return {}
    differences = errors(robot, data.force_area_b[direct[is_pair]], both.take(count + mirrored[is_pair]))
    named = {f"mirror images: {key}": value for key, value in differences.items()}
    return {"mirror images: pairs": int(is_pair.sum()), **named}


def model_errors(robot: RobotModel, models: Mapping[str, Floats], truth: Dataset, where: str) -> dict[str, float]:
    """Return the errors of all models, by model and reference."""
    return {
        f"{model}, {where}: {key}": value
        for model, areas in models.items()
        for key, value in errors(robot, areas, truth).items()
    }


def match_cases(ours: Dataset, table: Dataset) -> tuple[Dataset, Dataset, Indices]:
    """Return the rows of ours that the table contains, also as mirror images, those of the table, and their indices."""
    there = table.add_mirror_images()
    place = {key: row for row, key in reversed(list(enumerate(_keys(there))))}
    pairs = [(row, place[key]) for row, key in enumerate(_keys(ours)) if key in place]
    if not pairs:
        raise Refused("no case of the design has posture and wind of a row of the table")
    rows = np.array(pairs)
    return ours.take(rows[:, 0]), there.take(rows[:, 1]), rows[:, 0]


def _keys(data: Dataset) -> list[tuple[float, ...]]:
    return [tuple(row) for row in np.round(np.column_stack([data.joint_position_deg, data.wind_b]), 5)]


def errors(robot: RobotModel, areas: Floats, there: Dataset) -> dict[str, float]:
    """Return the errors of force areas (N, 13, 3) [m²], base axes, relative to the rows of a table."""
    off = areas - there.force_area_b
    drag, right = (np.einsum("nla,na->n", part, there.wind_b) for part in (areas, there.force_area_b))
    wrench = total_wrench(robot, there.joint_position(robot), off)
    return {
        "drag, relative error, mean": float(np.mean(drag / right - 1.0)),
        "drag, relative error, rms": float(np.sqrt(np.mean((drag / right - 1.0) ** 2))),
        "total force, rms [m2]": vector_rms(wrench.force_area),
        "links, mean square [m4]": float(np.mean(off**2)),
        "moment of forces at link centres, rms [N m at 10 m/s]": NEWTON_METRES * vector_rms(wrench.moment_volume),
    }


def models_at(robot: RobotModel, data: Dataset) -> dict[str, Floats]:
    """Return the force areas (N, 13, 3) [m²] of the project's models in the same cases."""
    points = xr.Dataset(
        {
            "joint_position": (("point", "joint"), data.joint_position_deg),
            **{key: ("point", getattr(data, f"{key}_deg")) for key in ("pitch", "yaw")},
            "speed": ("point", data.speed),
        }
    )
    areas = model_areas(robot, points)
    return {name: areas[name] for name in SHOWN}


def couples(robot: RobotModel, data: Dataset) -> dict[str, float]:
    """Return the part of the moment due to couples on links, which tables of forces lack."""
    if data.couple_volume_b is None:
        return {}
    volumes = data.couple_volume_b.sum(axis=1)
    moment = total_wrench(robot, data.joint_position(robot), data.force_area_b).moment_volume
    names = {"forces at link centres": moment, "couples on links": volumes, "both": moment + volumes}
    return {
        f"moment about the centre of mass, {name}, rms [N m at 10 m/s]": NEWTON_METRES * vector_rms(value)
        for name, value in names.items()
    }


def to_rows(models: Mapping[str, Floats], there: Dataset) -> xr.Dataset:
    """Return the force areas of all models and of the reference, row by row."""
    areas = np.stack([*models.values(), there.force_area_b])
    return xr.Dataset(
        {"force_area_b": (("model", "row", "link", "xyz"), areas, {"units": "m2"})},
        {
            "model": [*models, "compared with"],
            "link": list(LINKS),
            "xyz": ["x", "y", "z"],
            "posture": ("row", there.posture.astype(str)),
            "pitch": ("row", there.pitch_deg, {"units": "degree"}),
            "yaw": ("row", there.yaw_deg, {"units": "degree"}),
        },
    )

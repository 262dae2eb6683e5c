"""Cases of a design, computed with OpenFOAM and kept one by one, and the dataset of those that are accepted."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from jax_aero.aero.dataset import Dataset, Floats, save
from jax_aero.base import places, plain_values, tables
from jax_aero.base.files import lock_work, read_json, write_json
from jax_aero.base.terminal import Refused, terminal
from jax_aero.cfd.design import KIND, Case, Design
from jax_aero.cfd.geometry import Surface
from jax_aero.cfd.settings import Settings
from jax_aero.cfd.simulate import Result, simulate
from jax_aero.data.cfd import checks
from jax_aero.data.ironcub import JOINTS
from jax_aero.results import manifest, record, study
from jax_aero.results.changes import options_of
from jax_aero.results.identity import PYTHON, Identity
from jax_aero.results.work import Work

RESULTS, CASES = places.RESULTS / KIND, "cases.json"
Simulate = Callable[[Mapping[str, Surface], Iterable[Floats], Settings, Path], Iterator[Result]]


def folder_of(design: Design, out: Path | None = None) -> Path:
    """Return the folder of a design's cases."""
    if out:
        return out / (design.named or design.name)
    return RESULTS / study.folder_name(KIND, design.name, design.changes, design.named)


def dataset_of(name: str) -> Path:
    """Return the dataset of a design."""
    path = RESULTS / name / "dataset.nc"
    if not path.is_file():
        raise Refused(f"no {path}; make it with: jax-aero cfd {name}")
    return path


def compute(design: Design, folder: Path, simulator: Simulate = simulate) -> None:
    """Compute the missing cases of a design."""
    settings, surfaces = design.spec.settings, design.surfaces
    with lock_work(folder), tqdm(desc=design.name, unit="case", file=terminal(), disable=None) as bar:
        record.check_replaceable(folder, lambda kept: not _identity(design).difference(kept), overwrite=False)
        work, known = Work.on(folder, _identity(design)), read_cases(design, folder)
        left = {name: [case for case in cases if case not in known] for name, cases in design.cases.items()}
        bar.reset(total=sum(1 for _ in design))
        bar.update(len(known))
        for name, cases in left.items():
            winds = [case.wind_b for case in cases]
            with tempfile.TemporaryDirectory(prefix="jax-aero-cfd-") as scratch:
                solved = simulator(surfaces[name], winds, settings, Path(scratch)) if winds else ()
                for case, result in zip(cases, solved, strict=True):
                    work.write_json(case.name, plain_values.to_builtins(result))
                    bar.update()


def _identity(design: Design) -> Identity:
    return Identity(design.digest, (PYTHON,))


def collect(design: Design, folder: Path) -> str:
    """Write the result from the cases that are there; return a message."""
    results, identity = read_cases(design, folder), _identity(design)
    accepted = accepted_cases(design, folder)
    dataset = to_dataset(design, accepted)
    refused = {case.name: result.reason for case, result in results.items() if result.reason}
    missing = sum(1 for _ in design) - len(results)
    summary = {
        "accepted": len(accepted),
        "refused": len(refused),
        "not computed": missing,
        "postures": len(dataset.postures),
    }
    quality = {name: float(np.median(values)) for name, values in dataset.quality.items()}
    document = manifest.build(
        design.name,
        design.spec.title,
        plain_values.to_builtins(design.spec),
        identity,
        summary=summary,
        command=["jax-aero", KIND, design.name, *options_of(design.changes, design.named)],
        backend="openfoam",
        refused=refused,
        quality=quality,
        dataset=dataset.sha256,
    )

    def write(draft: Path) -> None:
        save(dataset, draft / "dataset.nc")
        write_json(draft / CASES, {case.name: plain_values.to_builtins(result) for case, result in results.items()})

    with lock_work(folder):
        record.write_result(folder, document, write, replace=True)
        if not missing:
            Work.on(folder, identity).clear()
    lines = [f"{design.spec.title}: " + ", ".join(f"{count} {what}" for what, count in summary.items())]
    lines += [f"  {name}: {reason}" for name, reason in refused.items()]
    lines += [f"  {name:<34} {median:.4g}" for name, median in quality.items()]
    return "\n".join([*lines, os.path.relpath(folder / "dataset.nc")])


def read_cases(design: Design, folder: Path) -> dict[Case, Result]:
    """Return the computed cases of a design: those of its result, and of the work on it."""
    work, stored = Work.on(folder, _identity(design)), dict[str, Any]()
    if (kept := record.read_manifest(folder)) and not _identity(design).difference(kept):
        # A result from before `cases.json` has a file of each case.
        whole = folder / CASES
        older = {path.stem: read_json(path) for path in (folder / "cases").glob("*.json")}
        stored = read_json(whole) if whole.is_file() else older
    known = {case: stored.get(case.name) or work.read_json(case.name) for case in design}
    return {case: tables.convert(result, Result, case.name) for case, result in known.items() if result}


def accepted_cases(design: Design, folder: Path) -> dict[Case, Result]:
    """Return the accepted cases of a design, of which there is at least one."""
    accepted = {case: result for case, result in read_cases(design, folder).items() if not result.reason}
    if not accepted:
        raise Refused(f"{os.path.relpath(folder)} has no accepted case of {sum(1 for _ in design)}")
    return accepted


def to_dataset(design: Design, accepted: Mapping[Case, Result]) -> Dataset:
    """Return the accepted cases as a dataset."""
    n = len(accepted)
    air = design.spec.settings.air
    results = list(accepted.values())
    links = tuple(results[0].force_area_b)
    data = Dataset(
        posture=np.array([case.posture for case in accepted]),
        is_mirrored=np.zeros(n, dtype=bool),
        joint_position_deg=np.stack([design.joints[case.posture] for case in accepted]),
        wind_b=np.stack([case.wind_b for case in accepted]),
        pitch_deg=np.array([case.pitch_deg for case in accepted]),
        yaw_deg=np.array([case.yaw_deg for case in accepted]),
        force_area_b=np.array([[result.force_area_b[link] for link in links] for result in results]),
        couple_volume_b=np.array([[result.couple_volume_b[link] for link in links] for result in results]),
        speed=np.full(n, air.speed),
        air_density=np.full(n, air.density),
        quality={name: np.array([result.quality[name] for result in results]) for name in results[0].quality},
        joints=JOINTS,
        links=links,
        provenance={
            "source": f"OpenFOAM (simpleFoam, k-omega SST) around {design.spec.geometry} of the URDF; jax-aero cfd",
            "design": design.name,
            "settings": json.dumps(plain_values.to_builtins(design.spec.settings), sort_keys=True),
            "robot_sha256": design.digest,
        },
    )
    return replace(data, checks=checks(data))

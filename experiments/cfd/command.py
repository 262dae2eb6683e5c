"""Compute aerodynamic forces and couples on the links with OpenFOAM: `jax-aero cfd NAME`.

A design (configs/cfd/NAME.toml) names postures, winds and settings. A posture is meshed once for all of its winds.
Every case is kept as soon as it is computed, so the same command resumes an interrupted run. Finally the result is
written: `dataset.nc` with the accepted cases, in the format of `import-cfd`, `cases.json` with all, and `manifest.json`
with the refused ones and the reasons. Needs OpenFOAM: apt-get install openfoam.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from experiments import Refused, manifest, overrides, record, study
from experiments.cfd import foam
from experiments.cfd.design import KIND, Case, Design
from experiments.cfd.geometry import Surface
from experiments.cfd.settings import Settings
from experiments.cfd.simulate import Result, simulate
from experiments.data.cfd import checks
from experiments.data.ironcub import JOINTS
from experiments.identity import PYTHON, Identity
from experiments.work import Work
from jax_aero.aero.dataset import Dataset, Floats, save
from jax_aero.base import places, plain, tables
from jax_aero.base.files import lock_work, read_json, write_json
from jax_aero.base.terminal import exit_status, terminal
from jax_aero.cli import Parser

RESULTS, CASES = places.RESULTS / KIND, "cases.json"
Simulate = Callable[[Mapping[str, Surface], Iterable[Floats], Settings, Path], Iterator[Result]]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = Parser(KIND, __doc__)
    study.add_names(parser, KIND, nargs="+")
    study.add_set(parser, study.example_of(KIND))
    study.add_name(parser)
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the results (default results/cfd)")
    parser.add_argument("--finish", action="store_true", help="compute nothing; collect the existing cases")
    given = parser.parse_args(arguments)

    def work() -> None:
        study.check_name(given)
        for name in given.names:
            design = Design.read(name, overrides.parse(given.set), given.named)
            folder = folder_of(design, given.out)
            if not given.finish:
                foam.environment()
                compute(design, folder)
            print(collect(design, folder))

    return exit_status(work, interrupted="the same command goes on with the next case")


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
                    work.write_json(case.name, plain.to_builtins(result))
                    bar.update()


def _identity(design: Design) -> Identity:
    return Identity(design.digest, (PYTHON,))


def collect(design: Design, folder: Path) -> str:
    """Write the result from the cases that are there; return a message."""
    found, identity = read_cases(design, folder), _identity(design)
    accepted = accepted_cases(design, folder)
    dataset = to_dataset(design, accepted)
    refused = {case.name: result.reason for case, result in found.items() if result.reason}
    missing = sum(1 for _ in design) - len(found)
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
        plain.to_builtins(design.spec),
        identity,
        summary=summary,
        command=["jax-aero", KIND, design.name, *overrides.options(design.changes, design.named)],
        backend="openfoam",
        refused=refused,
        quality=quality,
        dataset=dataset.sha256,
    )

    def write(draft: Path) -> None:
        save(dataset, draft / "dataset.nc")
        write_json(draft / CASES, {case.name: plain.to_builtins(result) for case, result in found.items()})

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
    found = {case: stored.get(case.name) or work.read_json(case.name) for case in design}
    return {case: tables.convert(result, Result, case.name) for case, result in found.items() if result}


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
            "settings": json.dumps(plain.to_builtins(design.spec.settings), sort_keys=True),
            "robot_sha256": design.digest,
        },
    )
    return replace(data, checks=checks(data))

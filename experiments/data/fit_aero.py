"""Fit the paper's axisymmetric model to a dataset: `jax-aero data fit-aero [NAME]`.

Lasso selects terms and least squares fits them, family by family. In addition, the published terms are refitted, the
origin of the published normal-force coefficients is tested, and every coefficient set of the robot is evaluated on the
data. The result goes to `results/fit_aero/NAME/`, with the new coefficients as TOML; `jax-aero figures fig4_fit`
draws it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from experiments.study import Findings, Study
from jax_aero import places, tables
from jax_aero.aero import fit
from jax_aero.aero.dataset import LINKS, Dataset, Floats, load
from jax_aero.aero.posture import link_axes
from jax_aero.places import ROBOT
from jax_aero.robot import RobotModel, load_robot

PRINTED, RIGHT = "published", "corrected"
"""Coefficient sets of the robot: as printed, and with the head's misprint corrected."""


class FitConfig(tables.Table, frozen=True):
    """Settings of a fit."""

    dataset: Path | None = None
    """Dataset from import-cfd; by default `results/datasets/NAME.nc`, or else the shipped one of that name."""


def compute(name: str, config: FitConfig) -> Findings:
    """Fit and compare the models."""
    path = config.dataset or dataset_of(name)
    computed = load(path)
    computed = computed.take(~computed.is_mirrored)
    dataset = computed.add_mirror_images()
    robot = load_robot(ROBOT)
    axes = link_axes(robot, dataset.joint_position_deg)
    fits = fit.fit(dataset, axes)
    rows = np.flatnonzero(~dataset.is_mirrored)
    variants = variants_of(robot, fits)
    quality = {
        variant: fit.quality(fit.predicted_areas(areas, axes[rows], computed.wind_b), computed)
        for variant, areas in variants.items()
    }
    refitted = published_terms(robot, dataset, axes)
    return Findings(
        f"Axisymmetric model fitted to {path.name}",
        to_dataset(dataset, axes, variants, refitted),
        figures(quality, fits, refitted),
        inputs={"dataset": path.name, "sha256": dataset.sha256, "provenance": dict(dataset.provenance)},
        files=[ROBOT],
        texts={"refit.toml": toml(fits, path.name)},
        report=report(quality, fits, refitted),
    )


STUDY = Study(
    "fit_aero",
    __doc__,
    FitConfig,
    compute,
    ("freestream",),
    engine="scikit-learn",
    reads=lambda name, config: [] if config.dataset else [dataset_of(name)],
    words="data fit-aero",
)
main = STUDY.main


def dataset_of(name: str) -> Path:
    """Return the dataset of a name: one in `results/datasets`, or else a shipped one."""
    own, shipped = (folder / f"{name}.nc" for folder in (places.RESULTS / "datasets", places.CONFIGS / "aero/datasets"))
    return shipped if shipped.is_file() and not own.is_file() else own


def variants_of(robot: RobotModel, fits: Mapping[str, fit.FamilyFit]) -> dict[str, Floats]:
    """Return the coefficients (13, 6) of every variant: the robot's sets and the new fit."""
    wanted = (PRINTED, RIGHT, "signed", "alternative")
    sets = {name: np.asarray(robot.aero_links.coefficients[name]) for name in wanted}
    return {**sets, "refit": fit.coefficients_of(fits)}


class RefittedLink(NamedTuple):
    """Published model of one family, with its terms refitted."""

    printed: Floats
    """(5,) published drag weights, the head's misprint corrected [m²]."""
    found: Floats
    """(5,) refitted weights of the same terms [m²]."""
    spread: Floats
    """(5,) standard errors of the refitted weights, by leaving postures out [m²]."""
    printed_cna: float
    """Published normal-force coefficient [m²]."""


def published_terms(robot: RobotModel, dataset: Dataset, axes: Floats) -> dict[str, RefittedLink]:
    """Fit exactly the terms of the published model."""
    printed = np.asarray(robot.aero_links.coefficients[RIGHT])
    geometry = fit.angles(axes, dataset.wind_b)
    force = fit.parts(dataset.force_area_b, geometry.wind)
    found = {}
    for family, members in fit.FAMILIES.items():
        links = [LINKS.index(name) for name in members]
        weights = printed[links[0], :5]
        used = np.flatnonzero(weights)
        terms = [fit.MODEL_TERMS[index] for index in used]
        matrix = fit.columns_of(terms, geometry.cos[:, links].ravel(), geometry.sin[:, links].ravel())
        target, posture = force.drag[:, links].ravel(), np.repeat(dataset.family, len(links))
        table = RefittedLink(weights, np.zeros(5), np.zeros(5), float(printed[links[0], 5]))
        table.found[used] = fit.least_squares(matrix, target)
        table.spread[used] = fit.spread(matrix, target, posture)
        found[family] = table
    return found


def has_same_digits(found: float, printed: float, digits: int, slack: int = 0) -> bool:
    """Return whether two numbers rounded to significant digits agree, with the last digit off by at most `slack`."""
    step = 10.0 ** (np.floor(np.log10(abs(printed))) - digits + 1)
    return bool(abs(round(found / step) - round(printed / step)) <= slack)


def figures(
    quality: Mapping[str, fit.Quality], fits: Mapping[str, fit.FamilyFit], refitted: Mapping[str, RefittedLink]
) -> dict[str, float]:
    """Return the figures of the comparison."""
    found: dict[str, float] = {}
    for variant, measure in quality.items():
        found[f"{variant}: link mean square error [m4]"] = measure.mse
        found[f"{variant}: R2"] = measure.r2
        found[f"{variant}: whole-robot drag, rms over mean"] = measure.drag_rms
        found[f"{variant}: whole-robot force across the wind, rms [m2]"] = measure.lift_side_rms
    pairs = [
        (float(table.found[i]), float(table.printed[i]), float(table.spread[i]))
        for table in refitted.values()
        for i in np.flatnonzero(table.printed)
    ]
    found["drag coefficients of the published model"] = len(pairs)
    found["of these, refitted equal to two digits"] = sum(has_same_digits(a, b, 2) for a, b, _ in pairs)
    found["of these, with the second digit off by at most 1"] = sum(has_same_digits(a, b, 2, 1) for a, b, _ in pairs)
    found["of these, refitted within 5 %"] = sum(abs(a / b - 1.0) <= 0.05 for a, b, _ in pairs)
    found["of these, refitted within two standard errors"] = sum(abs(a - b) <= 2.0 * s for a, b, s in pairs)
    for family, kept in fits.items():
        found[f"{family}: w5 signed [m2]"] = kept.cna
        found[f"{family}: w5 of the magnitude [m2]"] = kept.cna_of_magnitude
    return found


def report(
    quality: Mapping[str, fit.Quality], fits: Mapping[str, fit.FamilyFit], refitted: Mapping[str, RefittedLink]
) -> str:
    """Return the printed tables."""
    lines = ["variant        link MSE [m4]     R2   drag rms   across rms [m2]"]
    lines += [
        f"{name:<14} {q.mse:13.3g} {q.r2:6.2f} {100 * q.drag_rms:8.1f} % {q.lift_side_rms:12.4f}"
        for name, q in quality.items()
    ]
    lines += ["", "drag coefficients, published terms    printed     refit  +- spread"]
    for family, table in refitted.items():
        for index in np.flatnonzero(table.printed):
            printed, found, spread = (values[index] for values in table[:3])
            mark = "" if has_same_digits(found, printed, 2) else "  differs"
            lines.append(f"  {family:<12} w{index}                  {printed:10.5f} {found:10.5f}  {spread:.5f}{mark}")
    lines += ["", "normal-force coefficient      printed  of magnitude   signed   terms that Lasso keeps"]
    for family, kept in fits.items():
        terms = " ".join(f"w{fit.MODEL_TERMS.index(term)}" for term in kept.terms)
        printed = refitted[family].printed_cna
        lines.append(f"  {family:<24} {printed:10.4f} {kept.cna_of_magnitude:12.4f} {kept.cna:9.4f}   {terms}")
    return "\n".join(lines)


def toml(fits: Mapping[str, fit.FamilyFit], source: str) -> str:
    """Return the coefficient set in the format of a robot's file."""
    lines = [f"# Our fit of {source}: jax-aero data fit-aero", "[coefficients.refit]"]
    for family, kept in fits.items():
        cda = ", ".join(f"{weight:.5f}" if weight else "0.0" for weight in kept.cda)
        lines.append(f"{family:<9} = {{ cda = [{cda}], cna = {kept.cna:.4f} }}")
    return "\n".join(lines) + "\n"


def to_dataset(
    dataset: Dataset, axes: Floats, variants: Mapping[str, Floats], refitted: Mapping[str, RefittedLink]
) -> xr.Dataset:
    """Return the data of the figure with labels: every row over the angle of attack, and the coefficients."""
    geometry = fit.angles(axes, dataset.wind_b)
    force = fit.parts(dataset.force_area_b, geometry.wind)
    # At the poles the normal direction is undefined; the whole force across the wind is used.
    length = np.maximum(geometry.sin, 1e-6)
    signed = np.sum(force.across * geometry.normal, axis=-1) / length
    points = {
        "angle_of_attack": (np.degrees(np.arccos(geometry.cos)), "degree", "between link axis and upstream direction"),
        "drag_area": (force.drag, "m2", "force area along the wind"),
        "normal_area": (signed, "m2", "force area towards the link's axis, signed"),
        "across_area": (np.linalg.norm(force.across, axis=-1), "m2", "magnitude of the force area across the wind"),
    }
    variables: dict[str, Any] = {
        name: (("row", "link"), values.astype("f4"), {"units": units, "long_name": text})
        for name, (values, units, text) in points.items()
    }
    meaning = {"units": "m2", "long_name": "w0 .. w5 of the axisymmetric model"}
    variables["coefficients"] = (("variant", "link", "term"), np.stack(list(variants.values())), meaning)
    for key in ("printed", "found", "spread"):
        table = np.stack([getattr(entry, key) for entry in refitted.values()])
        variables[f"published_terms_{key}"] = (("family", "drag_term"), table, {"units": "m2"})
    coords = {
        "link": list(LINKS),
        "variant": list(variants),
        "term": [f"w{index}" for index in range(6)],
        "family": list(refitted),
        "drag_term": [f"w{index}" for index in range(5)],
    }
    return xr.Dataset(variables, coords)

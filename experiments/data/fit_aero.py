"""Fit the paper's axisymmetric model to a dataset: `jax-aero data fit-aero [NAME]`.

Lasso selects terms and least squares fits them, family by family. Every coefficient set of the robot is evaluated on
the data, and the fit also on postures that were left out of it, as is a network that `train` made with `--out
results/training/NAME`; intervals are over the choice of postures. If the robot has the published coefficients, their
terms are refitted and the origin of their normal forces is tested. The result goes to `results/fit_aero/NAME/`, with
the new coefficients as TOML; `jax-aero figures fig4_fit` draws it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import xarray as xr

from experiments.cfd.models import NEWTON_METRES
from experiments.data import fit
from experiments.study import Findings, Study
from experiments.training.result import held_out_network, training_of
from jax_aero.aero.dataset import Dataset, Floats, load
from jax_aero.aero.posture import interval_by_posture, link_axes, total_wrench, vector_rms
from jax_aero.base import places, tables
from jax_aero.base.places import ROBOT
from jax_aero.body.robot import RobotModel, load_robot

RIGHT = "corrected"
"""Coefficient set of the robot with the head's misprint corrected."""
LEFT_OUT, NETWORK = "refit, posture left out", "network, posture left out"


class FitConfig(tables.Table, frozen=True):
    """Settings of a fit."""

    dataset: Path | None = None
    """Dataset of import-cfd or cfd; by default `results/datasets/NAME.nc`, or else the shipped one of that name."""
    robot: Path = msgspec.field(default_factory=lambda: ROBOT)
    """Robot of the dataset."""


def compute(name: str, config: FitConfig) -> Findings:
    """Fit and compare the models."""
    path = config.dataset or dataset_of(name)
    robot = load_robot(config.robot)
    computed = load(path, robot)
    computed = computed.take(~computed.is_mirrored)
    dataset = computed.add_mirror_images()
    axes = link_axes(robot, dataset.joint_position(robot))
    families = fit.families_of(robot)
    fits = fit.fit(dataset, axes, families)
    rows = np.flatnonzero(~dataset.is_mirrored)
    # The robot's sets, and the new fit in place of an older one.
    variants = {name: np.asarray(areas) for name, areas in robot.aero_links.coefficients.items()}
    variants["refit"] = fit.coefficients_of(fits, families, dataset.links)
    predicted = {
        variant: fit.predicted_areas(areas, axes[rows], computed.wind_b) for variant, areas in variants.items()
    }
    quality = {variant: fit.quality(areas, computed) for variant, areas in predicted.items()}
    predicted[LEFT_OUT] = fit.held_out_areas(dataset, axes, families)[rows]
    if (trained := held_out_network(name, computed)) is not None:
        predicted[NETWORK] = trained
    refitted = published_terms(robot, dataset, axes, families) if RIGHT in variants else {}
    errors = {variant: total_errors(robot, areas, computed) for variant, areas in predicted.items()}
    errors["nothing"] = total_errors(robot, np.zeros_like(computed.force_area_b), computed)
    return Findings(
        f"Axisymmetric model fitted to {path.name}",
        to_dataset(dataset, axes, variants, refitted),
        figures(quality, fits, refitted) | error_figures(errors),
        inputs={"dataset": path.name, "sha256": dataset.sha256, "provenance": dict(dataset.provenance)},
        files=[config.robot, *([training_of(name)] if NETWORK in predicted else [])],
        texts={"refit.toml": toml(fits, path.name, name)},
        report=report(quality, fits, refitted) + "\n\n" + error_report(errors),
    )


STUDY = Study(
    "fit_aero",
    __doc__,
    FitConfig,
    compute,
    ("freestream",),
    backend="scikit-learn",
    reads=lambda name, config: [] if config.dataset else [dataset_of(name)],
)
main = STUDY.main


def dataset_of(name: str) -> Path:
    """Return the dataset of a name: one in `results/datasets`, or else a shipped one."""
    own, shipped = (folder / f"{name}.nc" for folder in (places.RESULTS / "datasets", places.CONFIGS / "aero/datasets"))
    return shipped if shipped.is_file() and not own.is_file() else own


class Errors(NamedTuple):
    """Errors of whole-robot totals, with 95 % intervals over the choice of postures; (value, low, high) each."""

    drag: Floats
    """Rms error of the drag over its mean [1]."""
    side: Floats
    """Rms error of the lateral force area, the base's y axis [m²]."""
    across: Floats
    """Rms error of the force area normal to the wind [m²]."""
    moment: Floats
    """Rms error of the moment about the centre of mass at 10 m/s [N m]."""


def total_errors(robot: RobotModel, areas: Floats, truth: Dataset) -> Errors:
    """Return the errors of force areas (N, L, 3) [m²], base axes; the couples on links belong to the true moment."""
    wrench = total_wrench(robot, truth.joint_position(robot), areas - truth.force_area_b)
    moment = wrench.moment_volume
    if truth.couple_volume_b is not None:
        moment = moment - truth.couple_volume_b.sum(axis=1)
    drag = np.sum(wrench.force_area * truth.wind_b, axis=1, keepdims=True)
    mean = np.mean(np.sum(truth.force_area_b.sum(axis=1) * truth.wind_b, axis=1))
    off = [drag / mean, wrench.force_area[:, 1:2], wrench.force_area - drag * truth.wind_b, NEWTON_METRES * moment]
    found = [np.array([vector_rms(one), *interval_by_posture(one, truth.family)]) for one in off]
    return Errors(*found)


ERRORS = {
    "drag": "whole-robot drag, rms over mean",
    "side": "whole-robot lateral force, rms [m2]",
    "across": "whole-robot force across the wind, rms [m2]",
    "moment": "moment about the centre of mass, rms [N m at 10 m/s]",
}
"""Names of the fields of `Errors` in the summary."""


def error_figures(errors: Mapping[str, Errors]) -> dict[str, float]:
    """Return the errors of totals and the ends of their intervals."""
    return {
        f"{variant}: {ERRORS[name]}{end}": float(value)
        for variant, found in errors.items()
        for name, values in found._asdict().items()
        for end, value in zip(("", ", 2.5 %", ", 97.5 %"), values, strict=True)
    }


def error_report(errors: Mapping[str, Errors]) -> str:
    """Return the printed table of errors of totals."""
    lines = ["whole robot, rms error (95 % interval over postures)"]
    lines.append(f"{'variant':<28} {'drag [%]':>18} {'lateral [m2]':>24} {'across [m2]':>24} {'moment [N m]':>20}")
    for name, found in errors.items():
        cells = []
        for values, digits, width in zip((100 * found.drag, *found[1:]), (1, 4, 4, 2), (18, 24, 24, 20), strict=True):
            value, low, high = (f"{number:.{digits}f}" for number in values)
            cells.append(f"{value} ({low}, {high})".rjust(width))
        lines.append(f"{name:<28} " + " ".join(cells))
    return "\n".join(lines)


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


def published_terms(
    robot: RobotModel, dataset: Dataset, axes: Floats, families: Mapping[str, Sequence[str]]
) -> dict[str, RefittedLink]:
    """Fit exactly the terms of the published model."""
    printed = np.asarray(robot.aero_links.coefficients[RIGHT])
    geometry = fit.angles(axes, dataset.wind_b)
    force = fit.parts(dataset.force_area_b, geometry.wind)
    found = {}
    for family, members in families.items():
        links = [dataset.links.index(name) for name in members]
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
    if refitted:
        found |= agreement(refitted)
    for family, kept in fits.items():
        found[f"{family}: w5 signed [m2]"] = kept.cna
        found[f"{family}: w5 of the magnitude [m2]"] = kept.cna_of_magnitude
    return found


def agreement(refitted: Mapping[str, RefittedLink]) -> dict[str, float]:
    """Return how many of the published drag coefficients the refit of their terms confirms."""
    pairs = [
        (float(table.found[i]), float(table.printed[i]), float(table.spread[i]))
        for table in refitted.values()
        for i in np.flatnonzero(table.printed)
    ]
    found: dict[str, float] = {"drag coefficients of the published model": len(pairs)}
    found["of these, refitted equal to two digits"] = sum(has_same_digits(a, b, 2) for a, b, _ in pairs)
    found["of these, with the second digit off by at most 1"] = sum(has_same_digits(a, b, 2, 1) for a, b, _ in pairs)
    found["of these, refitted within 5 %"] = sum(abs(a / b - 1.0) <= 0.05 for a, b, _ in pairs)
    found["of these, refitted within two standard errors"] = sum(abs(a - b) <= 2.0 * s for a, b, s in pairs)
    return found


def report(
    quality: Mapping[str, fit.Quality], fits: Mapping[str, fit.FamilyFit], refitted: Mapping[str, RefittedLink]
) -> str:
    """Return the printed tables."""
    lines = [f"{'variant':<14} link MSE [m4]     R2"]
    lines += [f"{name:<14} {q.mse:13.3g} {q.r2:6.2f}" for name, q in quality.items()]
    if refitted:
        lines += ["", "drag coefficients, published terms    printed     refit  +- spread"]
    for family, table in refitted.items():
        for index in np.flatnonzero(table.printed):
            printed, found, spread = (values[index] for values in table[:3])
            mark = "" if has_same_digits(found, printed, 2) else "  differs"
            lines.append(f"  {family:<12} w{index}                  {printed:10.5f} {found:10.5f}  {spread:.5f}{mark}")
    lines += ["", "normal-force coefficient      printed  of magnitude   signed   terms that Lasso keeps"]
    for family, kept in fits.items():
        terms = " ".join(f"w{fit.MODEL_TERMS.index(term)}" for term in kept.terms)
        printed = f"{refitted[family].printed_cna:.4f}" if refitted else "none"
        lines.append(f"  {family:<24} {printed:>10} {kept.cna_of_magnitude:12.4f} {kept.cna:9.4f}   {terms}")
    return "\n".join(lines)


def toml(fits: Mapping[str, fit.FamilyFit], source: str, name: str) -> str:
    """Return the coefficient set in the format of a robot's file."""
    lines = [f"# Our fit of {source}: jax-aero data fit-aero {name}", "[coefficients.refit]"]
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
    for key in ("printed", "found", "spread") if refitted else ():
        table = np.stack([getattr(entry, key) for entry in refitted.values()])
        variables[f"published_terms_{key}"] = (("family", "drag_term"), table, {"units": "m2"})
    coords = {
        "link": list(dataset.links),
        "variant": list(variants),
        "term": [f"w{index}" for index in range(6)],
        "family": list(refitted),
        "drag_term": [f"w{index}" for index in range(5)],
    }
    return xr.Dataset(variables, coords)

"""Fit the paper's axisymmetric model to a dataset: `jax-aero data fit-aero [NAME]`.

Lasso selects terms and least squares fits them, family by family. Every coefficient set of the robot is evaluated on
the data, and the fit also on postures that were left out of it, as is a network that `train` made with `--out
results/training/NAME`; intervals are over the choice of postures. The result goes to `results/fit_aero/NAME/`, with the
new coefficients as TOML; `jax-aero figures fig4_fit` draws it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import xarray as xr

from jax_aero.aero.dataset import Dataset, Floats, load
from jax_aero.aero.posture import NEWTON_METRES, interval_by_posture, link_axes, total_wrench, vector_rms
from jax_aero.base import places, tables
from jax_aero.base.places import ROBOT
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.data import fit
from jax_aero.results.study import Findings, Study
from jax_aero.train.result import held_out_network, training_of

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
    errors = {variant: total_errors(robot, areas, computed) for variant, areas in predicted.items()}
    errors["nothing"] = total_errors(robot, np.zeros_like(computed.force_area_b), computed)
    return Findings(
        f"Axisymmetric model fitted to {path.name}",
        to_dataset(dataset, axes, variants),
        figures(quality, fits) | error_figures(errors),
        inputs={"dataset": path.name, "sha256": dataset.sha256, "provenance": dict(dataset.provenance)},
        files=[config.robot, *([training_of(name)] if NETWORK in predicted else [])],
        texts={"refit.toml": toml(fits, path.name, name)},
        report=report(quality, fits) + "\n\n" + error_report(errors),
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
    rows = [np.array([vector_rms(one), *interval_by_posture(one, truth.family)]) for one in off]
    return Errors(*rows)


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
        for variant, error in errors.items()
        for name, values in error._asdict().items()
        for end, value in zip(("", ", 2.5 %", ", 97.5 %"), values, strict=True)
    }


def error_report(errors: Mapping[str, Errors]) -> str:
    """Return the printed table of errors of totals."""
    lines = ["whole robot, rms error (95 % interval over postures)"]
    lines.append(f"{'variant':<28} {'drag [%]':>18} {'lateral [m2]':>24} {'across [m2]':>24} {'moment [N m]':>20}")
    for name, error in errors.items():
        cells = []
        for values, digits, width in zip((100 * error.drag, *error[1:]), (1, 4, 4, 2), (18, 24, 24, 20), strict=True):
            value, low, high = (f"{number:.{digits}f}" for number in values)
            cells.append(f"{value} ({low}, {high})".rjust(width))
        lines.append(f"{name:<28} " + " ".join(cells))
    return "\n".join(lines)


def figures(quality: Mapping[str, fit.Quality], fits: Mapping[str, fit.FamilyFit]) -> dict[str, float]:
    """Return the figures of the comparison."""
    rows: dict[str, float] = {}
    for variant, measure in quality.items():
        rows[f"{variant}: link mean square error [m4]"] = measure.mse
        rows[f"{variant}: R2"] = measure.r2
    for family, kept in fits.items():
        rows[f"{family}: w5 signed [m2]"] = kept.cna
        rows[f"{family}: w5 of the magnitude [m2]"] = kept.cna_of_magnitude
    return rows


def report(quality: Mapping[str, fit.Quality], fits: Mapping[str, fit.FamilyFit]) -> str:
    """Return the printed tables."""
    lines = [f"{'variant':<14} link MSE [m4]     R2"]
    lines += [f"{name:<14} {q.mse:13.3g} {q.r2:6.2f}" for name, q in quality.items()]
    lines += ["", "normal-force coefficient   of magnitude   signed   terms that Lasso keeps"]
    for family, kept in fits.items():
        terms = " ".join(f"w{fit.MODEL_TERMS.index(term)}" for term in kept.terms)
        lines.append(f"  {family:<24} {kept.cna_of_magnitude:12.4f} {kept.cna:9.4f}   {terms}")
    return "\n".join(lines)


def toml(fits: Mapping[str, fit.FamilyFit], source: str, name: str) -> str:
    """Return the coefficient set in the format of a robot's file."""
    lines = [f"# Our fit of {source}: jax-aero data fit-aero {name}", "[coefficients.refit]"]
    for family, kept in fits.items():
        cda = ", ".join(f"{weight:.5f}" if weight else "0.0" for weight in kept.cda)
        lines.append(f"{family:<9} = {{ cda = [{cda}], cna = {kept.cna:.4f} }}")
    return "\n".join(lines) + "\n"


def to_dataset(dataset: Dataset, axes: Floats, variants: Mapping[str, Floats]) -> xr.Dataset:
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
    coords = {
        "link": list(dataset.links),
        "variant": list(variants),
        "term": [f"w{index}" for index in range(6)],
    }
    return xr.Dataset(variables, coords)

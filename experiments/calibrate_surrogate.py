"""Calibrate the panel model on published data: `jax-aero calibrate-surrogate`.

The data are published drag curves of the links, and the whole robot's force in the typed tables of wind tunnel and CFD
except the postures flight50 and flight60, on which the result is compared with the axisymmetric model. The penalties
have the smallest error on calibration postures left out in turn. The result goes to
`results/calibrate_surrogate/calibration/`, with the coefficients as `surrogate.toml`, which is copied to
`configs/aero/panels/`; `jax-aero figures surrogate` draws it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from experiments.import_cfd import POSTURES, known_postures
from experiments.study import Findings, Study
from jax_aero import places, tables
from jax_aero.aero import fit, surrogate_fit
from jax_aero.aero.dataset import Floats, tunnel_from_base
from jax_aero.aero.posture import link_axes, vector_rms
from jax_aero.aero.surrogate import TERMS, Wake, batched_features, build_panels, force_areas
from jax_aero.aero.surrogate_fit import Records, Settings
from jax_aero.places import ROBOT
from jax_aero.robot import RobotModel, load_robot

TUNNEL, CFD = (places.CONFIGS / "tables" / name for name in ("wind_tunnel.toml", "cfd_tunnel.toml"))

JUDGES = ("flight50", "flight60")
"""Postures that are not used for the calibration."""
LARGEST_SIDESLIP = 20.0
"""Sideslip beyond which the support is exposed to the wind [deg]."""
MESH, TURBULENCE = "953C", "SST k-omega"
CURVES = "corrected"
"""Coefficient set of the published drag curves, with the misprint of the head corrected."""
COMPARED = ("corrected", "signed", "refit")

PANELS = {"spacing": 0.045, "cluster_size": 0.12}
WAKE = Wake(gamma=2.0, kappa=3.0, grow=0.3, start=0.0134, decay=1.0, up_length=0.0335)


class Row(NamedTuple):
    """One force on the whole robot."""

    source: str
    posture: str
    pitch_deg: float
    yaw_deg: float
    cda: float
    csa: float
    cla: float


class CalibrationConfig(tables.Table, frozen=True):
    """Configuration of a calibration, which has no settings."""


def compute(_name: str, _config: CalibrationConfig) -> Findings:
    """Calibrate and evaluate."""
    robot = load_robot(ROBOT)
    rows = list(table_rows())
    learned = records([row for row in rows if row.posture not in JUDGES])
    everything = records([row for row in rows if row.source == "tunnel"])
    features = batched_features(robot, build_panels(robot, **PANELS), WAKE)
    curves = np.asarray(robot.aero_links.coefficients[CURVES])
    calibration = surrogate_fit.prepare(robot, curves, features, learned)
    settings, tried = surrogate_fit.choose(calibration)
    weights = surrogate_fit.solve(calibration, settings)

    seen = features(everything.joint_position_deg, everything.wind_b)
    areas = {"surrogate": force_areas(weights[surrogate_fit.FAMILY_OF], seen).sum(axis=1)}
    areas |= {name: axisymmetric(robot, name, everything) for name in COMPARED}
    turn = tunnel_from_base(everything.pitch_deg, everything.yaw_deg)
    models = {name: np.einsum("nij,nj->ni", turn, area) for name, area in areas.items()}
    inputs = {"panels": PANELS, "wake": WAKE._asdict(), "settings": settings._asdict()}
    return Findings(
        "Panel model and axisymmetric models beside the wind tunnel",
        to_dataset(everything, models),
        {"left-out calibration postures, rms vector error [m2]": tried[settings], **figures(everything, models)},
        inputs=inputs | {"records": len(learned.posture)},
        files=[ROBOT, POSTURES, TUNNEL, CFD],
        texts={"surrogate.toml": toml(weights, sources_of(settings))},
    )


STUDY = Study("calibrate_surrogate", __doc__, CalibrationConfig, compute, ("calibration",), engine="jax")
main = STUDY.main


def table_rows() -> Iterator[Row]:
    """Yield the records of the typed tables that can be compared with a model of the robot alone."""
    tunnel = tables.read(TUNNEL)
    for table in tunnel["hovering"]:
        for yaw, *areas in zip(table["beta_deg"], *_areas(table), strict=True):
            if abs(yaw) <= LARGEST_SIDESLIP:
                yield Row("tunnel", "hovering", 90.0, yaw, *areas)
    for table in tunnel["flight"]:
        for pitch, *areas in zip(table["alpha_deg"], *_areas(table), strict=True):
            yield Row("tunnel", table["posture"], pitch, 0.0, *areas)
    for table in tables.read(CFD)["run"]:
        if (table["mesh"], table["turbulence"]) != (MESH, TURBULENCE):
            continue
        for pitch, yaw, *areas in zip(table["alpha_deg"], table["beta_deg"], *_areas(table), strict=True):
            if abs(yaw) <= LARGEST_SIDESLIP:
                yield Row("cfd", table["posture"], pitch, yaw, *areas)


def _areas(table: Mapping[str, Any]) -> list[list[float]]:
    return [table[name] for name in ("cda", "csa", "cla")]


def records(rows: Sequence[Row]) -> Records:
    """Return rows as arrays."""
    postures = known_postures()
    return Records(
        posture=tuple(row.posture for row in rows),
        joint_position_deg=np.stack([postures[row.posture] for row in rows]),
        pitch_deg=np.array([row.pitch_deg for row in rows], dtype=np.float64),
        yaw_deg=np.array([row.yaw_deg for row in rows], dtype=np.float64),
        force_area_w=np.array([row[4:] for row in rows], dtype=np.float64),
    )


def axisymmetric(robot: RobotModel, name: str, table: Records) -> Floats:
    """Return the whole robot's force area (n, 3) [m²], base axes, for one coefficient set."""
    axes = link_axes(robot, table.joint_position_deg)
    areas = fit.predicted_areas(np.asarray(robot.aero_links.coefficients[name]), axes, table.wind_b)
    total: Floats = areas.sum(axis=1)
    return total


def figures(table: Records, models: Mapping[str, Floats]) -> dict[str, float]:
    """Return the rms vector error of every model by posture, and of the drag alone."""
    names = np.array(table.posture)
    found = {}
    for posture in dict.fromkeys(table.posture):
        own = names == posture
        seen = "held out" if posture in JUDGES else "calibration"
        for model, areas in models.items():
            error = vector_rms(areas[own] - table.force_area_w[own])
            found[f"{posture} ({seen}), {model}: rms vector error [m2]"] = error
    return found


def toml(weights: Floats, about: Sequence[str]) -> str:
    """Return the text of a file for `load_surrogate`: coefficients (8, 12) by family, with comment lines `about`."""
    lines = [
        *(f"# {line}" for line in ("The panel model of jax_aero/aero/surrogate.py.", *about)),
        "",
        "[panels] # lengths in m",
        *(f"{name} = {value}" for name, value in PANELS.items()),
        "",
        "[wake] # lengths in m",
        *(f"{name} = {value}" for name, value in WAKE._asdict().items()),
        "",
        f"# Pressure on {', '.join(TERMS[:6])},",
        f"# {', '.join(TERMS[6:])}.",
        "[coefficients]",
    ]
    for family, row in zip(fit.FAMILIES, weights, strict=True):
        lines.append(f"{family} = [{', '.join(f'{value:.5g}' for value in row)}]")
    return "\n".join(lines) + "\n"


def sources_of(settings: Settings) -> list[str]:
    """Return comment lines on the data that the coefficients were fitted to."""
    return [
        "Our fit to published data alone: drag curves of the links, wind tunnel and CFD of configs/tables without",
        "flight50 and flight60, by jax-aero calibrate-surrogate",
        f"Penalties by leaving out postures: {', '.join(f'{k} {v:g}' for k, v in settings._asdict().items())}.",
    ]


def to_dataset(table: Records, models: Mapping[str, Floats]) -> xr.Dataset:
    """Return the data of the figure with labels."""
    variables: dict[str, Any] = {
        "measured": (("record", "component"), table.force_area_w, {"units": "m2", "long_name": "wind tunnel"}),
        "predicted": (("model", "record", "component"), np.stack(list(models.values())), {"units": "m2"}),
        "pitch_deg": (("record",), table.pitch_deg, {"units": "degree"}),
        "yaw_deg": (("record",), table.yaw_deg, {"units": "degree"}),
    }
    coords = {"component": ["drag", "side", "lift"], "model": list(models), "posture": ("record", list(table.posture))}
    return xr.Dataset(variables, coords, {"held_out": " ".join(JUDGES)})

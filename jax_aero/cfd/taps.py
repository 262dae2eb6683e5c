"""Compare our flow with the pressures that were measured on the robot's skin: `jax-aero cfd taps NAME`.

NAME is a design of `jax-aero cfd` with `taps`; its cases are compared with a dataset of `import-pressures`, tap by tap,
with the mean over the points of equal posture, wind and speed. Flagged taps are left out. The bar is Newton's formula

    Cp = 1.4 max(cos, 0)² − 0.4,    cos = −n · w,

with the outward normal n and the direction w of the air's motion. Postures that are held out
(configs/tables/pressure_taps.toml) are reported apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr

from jax_aero.aero.dataset import Floats
from jax_aero.aero.posture import axes_of
from jax_aero.base import run_file, tables
from jax_aero.base.terminal import Refused
from jax_aero.body.robot import load_robot
from jax_aero.cfd.compute import accepted_cases, dataset_of, folder_of, to_dataset
from jax_aero.cfd.design import Case, Design
from jax_aero.cfd.simulate import Result
from jax_aero.cfd.tunnel import points_beside
from jax_aero.data.import_cfd import OUT
from jax_aero.data.import_pressures import TAPS
from jax_aero.results.study import Findings, Study

SIDE = 0.5
"""Greatest |cos| on a side."""
MODELS = {"flow": "cp", "Newton": "cp_newton"}


class TapsConfig(tables.Table, frozen=True):
    """Settings of a comparison."""

    pressures: Path | None = None
    """Dataset of `import-pressures`; by default that of the robot in `results/datasets`."""


def compute(name: str, config: TapsConfig) -> Findings:
    """Compare."""
    design = Design.read(name, {})
    path = config.pressures or OUT / f"pressures_{design.spec.taps}.nc"
    if not path.is_file():
        raise Refused(f"no {path}; make it with: jax-aero data import-pressures --clone DIR")
    points = run_file.read(path)
    if points.attrs["robot"] != design.spec.taps:
        raise Refused(f"{path} has taps of {points.attrs['robot']}; expected {design.spec.taps or 'none'}, as {name}")
    accepted = accepted_cases(design, folder_of(design))
    data = compare_taps(design, accepted, points)
    return Findings(f"Pressures of `{name}` beside the wind tunnel", data, summary(data), files=[path, TAPS])


STUDY = Study(
    "cfd_taps",
    __doc__,
    TapsConfig,
    compute,
    ("mk1_taps",),
    backend="openfoam",
    reads=lambda name, _: [dataset_of(name)],
)
main = STUDY.main


def newton(cos: Floats) -> Floats:
    """Return the pressure coefficients of Newton's formula, with a constant base pressure."""
    coefficients: Floats = 1.4 * np.maximum(cos, 0.0) ** 2 - 0.4
    return coefficients


def compare_taps(design: Design, accepted: Mapping[Case, Result], points: xr.Dataset) -> xr.Dataset:
    """Return pressure coefficients of every case that was measured and of every tap; NaN where one is not known.

    Vectors are in the axes of the tunnel's tables: x backward, y to the robot's right, z up.
    """
    axes = axes_of(load_robot(design.spec.robot))
    taps = [tap for tap in points["tap"].values.tolist() if tap in design.taps]
    measured = points["cp"].where(points["flag"] == 0).sel(tap=taps)
    beside = zip(accepted, points_beside(to_dataset(design, accepted), points, axes), strict=True)
    rows = {case: measured[near].mean("point").values for case, (near, _) in beside if near.any()}
    if not rows:
        raise Refused("no case has the posture, wind and speed of a measured point")
    on = {
        posture: {tap: on for part in parts.values() for tap, on in part.taps.items()}
        for posture, parts in design.surfaces.items()
    }
    position, normal = (
        np.array([[getattr(on[case.posture][tap], key) for tap in taps] for case in rows]) @ axes
        for key in ("position", "normal")
    )
    wind = np.array([case.wind_b for case in rows]) @ axes
    cos = -np.einsum("ctx,cx->ct", normal, wind)
    held_out = tables.read(TAPS)["held_out"][design.spec.taps]
    pair, vector = ("case", "tap"), ("case", "tap", "xyz")
    return xr.Dataset(
        {
            "cp": (pair, [[accepted[case].cp[tap] for tap in taps] for case in rows]),
            "cp_tunnel": (pair, np.stack([*rows.values()])),
            "cp_newton": (pair, newton(cos)),
            "cos": (pair, cos),
            "position": (vector, position, {"units": "m"}),
            "normal": (vector, normal),
        },
        {
            "posture": ("case", [case.posture for case in rows]),
            "pitch": ("case", [case.pitch_deg for case in rows], {"units": "degree"}),
            "yaw": ("case", [case.yaw_deg for case in rows], {"units": "degree"}),
            "is_held_out": ("case", np.array([case.posture in held_out for case in rows]).astype("i1")),
            "tap": taps,
            "link": ("tap", [design.taps[tap]["link"].removeprefix("l_").removeprefix("r_") for tap in taps]),
        },
    )


def summary(data: xr.Dataset) -> dict[str, float | str]:
    """Return correlation and errors of the flow and of Newton's formula, by group of postures, link and side."""
    held = data["is_held_out"].values == 1
    figures: dict[str, float | str] = {}
    for group, rows in (("", ~held), ("held-out postures, ", held)):
        if not rows.any():
            continue
        part = data.isel(case=rows)
        figures[f"{group}cases"] = int(rows.sum())
        known, cos = np.isfinite(part["cp_tunnel"].values), part["cos"].values
        places = {"all": known, "front": cos > SIDE, "sides": np.abs(cos) <= SIDE, "back": cos < -SIDE}
        links = data["link"].values
        places |= {link: np.broadcast_to(links == link, known.shape) for link in dict.fromkeys(links.tolist())}
        worse = []
        for place, chosen in places.items():
            if not (chosen & known).any():
                continue
            own = errors(part, chosen & known)
            figures |= {f"{group}{place}: {key}": value for key, value in own.items()}
            worse += [place] if own["flow, rms"] >= own["Newton, rms"] else []
        figures[f"{group}flow no better than Newton's formula, by rms"] = ", ".join(worse) or "nowhere"
    return figures


def errors(data: xr.Dataset, chosen: Floats) -> dict[str, float]:
    """Return number of pairs, correlation r, mean and rms error of the chosen (case, tap)."""
    tunnel = data["cp_tunnel"].values[chosen]
    figures: dict[str, float] = {"pairs": len(tunnel)}
    for model, key in MODELS.items():
        values = data[key].values[chosen]
        if min(np.ptp(values), np.ptp(tunnel)) > 0.0:  # Newton's formula is constant on the back
            figures[f"{model}, r"] = float(np.corrcoef(values, tunnel)[0, 1])
        figures[f"{model}, rms"] = float(np.sqrt(np.mean((values - tunnel) ** 2)))
        figures[f"{model} less tunnel, mean"] = float(np.mean(values - tunnel))
    return figures

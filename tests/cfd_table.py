"""Made-up simulations: datasets, and the layout of the solver's table of the free-stream campaign."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jax_aero.aero.dataset import Dataset, tunnel_from_base, wind_direction
from jax_aero.data import cfd, fit
from jax_aero.data.ironcub import JOINTS, LINKS

Array = NDArray[np.float64]
Row = tuple[str, float, float, Array]
"""Posture, pitch and yaw [deg], and (13, 3) drag, lift and side area of each surface [m²]."""

CFD_COLUMNS = [
    "config",
    "pitchAngle",
    "yawAngle",
    *(f"{part}-{kind}" for part in ["ironcub", *cfd.SURFACES] for kind in ("cd", "cl", "cs")),
]


def made_up_dataset(postures: Mapping[str, Array], pitch: Array, yaw: Array, areas: Any = 0.0, **more: Any) -> Dataset:
    """Return a dataset of postures, given by their joints [deg], that each stand in all winds."""
    n, count = len(postures) * len(pitch), len(pitch)
    return Dataset(
        posture=np.repeat([*postures], count),
        is_mirrored=np.zeros(n, dtype=bool),
        joint_position_deg=np.repeat([*postures.values()], count, axis=0),
        wind_b=np.tile(wind_direction(pitch, yaw), (len(postures), 1)),
        pitch_deg=np.tile(pitch, len(postures)),
        yaw_deg=np.tile(yaw, len(postures)),
        force_area_b=np.broadcast_to(areas, (n, len(more.get("links", LINKS)), 3)),
        speed=np.full(n, 17.0),
        air_density=np.full(n, 1.225),
        **{"joints": JOINTS, "links": LINKS, **more},
    )


def in_tunnel_axes(data: Dataset) -> Array:
    """Return drag, side and lift area (N, L, 3) [m²]."""
    return np.einsum("nij,nlj->nli", tunnel_from_base(data.pitch_deg, data.yaw_deg), data.force_area_b)


def solver_table(rows: Iterable[Row], changes: Mapping[tuple[int, str], str] | None = None) -> str:
    """Write the table, with a cell changed by line and column; line 1 is the header."""
    lines = [list(CFD_COLUMNS)]
    for posture, pitch, yaw, areas in rows:
        numbers = [*areas.sum(axis=0), *areas.ravel()]
        lines.append([posture, str(pitch), str(yaw), *(repr(float(value)) for value in numbers)])
    for (line, column), value in (changes or {}).items():
        lines[line - 1][CFD_COLUMNS.index(column)] = value
    return "\n".join(",".join(line) for line in lines) + "\n"


def modelled_rows(axes: Mapping[str, Array], coefficients: Array, winds: Iterable[tuple[float, float]]) -> list[Row]:
    """Compute the axisymmetric model for postures, given by the axes of their links (13, 3), in winds (pitch, yaw)."""
    rows = []
    for posture, axes_b in axes.items():
        for pitch, yaw in winds:
            areas_b = fit.predicted_areas(coefficients, axes_b[None], wind_direction([pitch], [yaw]))[0]
            drag_side_lift = areas_b @ tunnel_from_base(pitch, yaw).T
            rows.append((posture, pitch, yaw, drag_side_lift[:, [0, 2, 1]]))
    return rows

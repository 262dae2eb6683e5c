"""Import of the authors' table of free-stream simulations into a `Dataset`, with a record of the checks.

The solver's table is a CSV: posture, angles, and drag, lift and side area of the whole robot and of 13 surfaces.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from jax_aero import rust
from jax_aero.aero.dataset import (
    MIRROR_AXES,
    Dataset,
    Floats,
    mirrored_areas,
    mirrored_joints,
    tunnel_from_base,
    wind_direction,
)
from jax_aero.data.ironcub import JOINTS, LINKS

SURFACES: Mapping[str, str] = {
    "head": "head",
    "torso": "chest",
    "left-back-turbine": "chest_l_jet_turbine",
    "right-back-turbine": "chest_r_jet_turbine",
    "left-arm": "l_upper_arm",
    "left-arm-turbine": "l_arm_jet_turbine",
    "right-arm": "r_upper_arm",
    "right-arm-turbine": "r_arm_jet_turbine",
    "root-link": "root_link",
    "left-leg-upper": "l_upper_leg",
    "left-leg-lower": "l_lower_leg",
    "right-leg-upper": "r_upper_leg",
    "right-leg-lower": "r_lower_leg",
}
"""Link of the robot for each surface of the solver. The upper arms include the shoulders, the upper legs the hips' roll
links, the root link the hips' pitch links, the chest the torso, and the lower legs the feet."""

TOTAL = "ironcub"
COMPONENTS = ("cd", "cs", "cl")
"""Drag, side and lift coefficients: x, y and z of the tunnel frame."""

SPEED, AIR_DENSITY = 17.0, 1.225
"""Speed and air density of the simulations [m/s, kg/m³], which the table does not contain."""

LARGEST_SUM_ERROR = 1e-5
"""Largest accepted difference between the sum of the links and the whole robot [m²]; at most 1e-8 in the public
table."""


def read_solver_table(text: str, postures: Mapping[str, Floats], *, source: str) -> Dataset:
    """Parse the solver's table.

    Parameters
    ----------
    text
        Content of the CSV file.
    postures
        Joint angles (19,) [deg] by posture name, the value in the column `config`.
    source
        Name of the table in messages and in the provenance.

    Raises
    ------
    ValueError
        If a value is invalid; the message names source, line, column, value and what was expected.
    """
    if text.startswith("version https://git-lfs"):
        raise ValueError(f"{source} is a Git LFS pointer, not the table; fetch it with: git lfs pull")
    columns = [
        "pitchAngle",
        "yawAngle",
        *(f"{part}-{name}" for part in (TOTAL, *SURFACES) for name in COMPONENTS),
    ]
    table = rust.read_csv(text, source, {"config": "text", **dict.fromkeys(columns, "number")})
    names, lines, values = table.texts["config"], table.lines, np.column_stack(list(table.numbers.values()))
    for row, line in zip(values, lines, strict=True):
        _check_angles(row, f"{source}, line {line}")
    if unknown := Counter(name for name in names if name not in postures):
        place = f"{source}, line {next(line for line, name in zip(lines, names, strict=True) if name in unknown)}"
        rows_of = ", ".join(f"`{name}` ({count} row{'s'[: count > 1]})" for name, count in unknown.items())
        raise ValueError(
            f"{place}, column `config`: no joint angles are known for {rows_of}; expected one of "
            f"{', '.join(postures)}, or a file of joint angles that has it"
        )
    if not names:
        raise ValueError(f"{source} has no rows; expected one per posture and wind direction")
    pitch, yaw = values[:, 0], values[:, 1]
    areas_w = values[:, 2:].reshape(len(names), 1 + len(SURFACES), 3)
    sum_error = np.abs(areas_w[:, 1:].sum(axis=1) - areas_w[:, 0]).max(axis=1)
    worst = int(sum_error.argmax())
    if sum_error[worst] > LARGEST_SUM_ERROR:
        raise ValueError(
            f"{source}, line {lines[worst]}: the surfaces differ by {sum_error[worst]:.3g} m2 from `{TOTAL}-*`; "
            f"expected at most {LARGEST_SUM_ERROR:g}"
        )
    dataset = Dataset(
        posture=np.array(names),
        is_mirrored=np.zeros(len(names), dtype=bool),
        joint_position_deg=np.stack([postures[name] for name in names]),
        wind_b=wind_direction(pitch, yaw),
        pitch_deg=pitch,
        yaw_deg=yaw,
        # f_b = R^T f_t with (drag, side, lift) as (x, y, z) of the tunnel frame.
        force_area_b=np.einsum("nji,nlj->nli", tunnel_from_base(pitch, yaw), areas_w[:, 1:]),
        speed=np.full(len(names), SPEED),
        air_density=np.full(len(names), AIR_DENSITY),
        joints=JOINTS,
        links=LINKS,
        provenance={
            "source": source,
            "file_sha256": hashlib.sha256(text.encode()).hexdigest(),
            "layout": "solver table: drag, lift and side area per surface, wind axes",
            "surfaces": "; ".join(f"{surface} -> {link}" for surface, link in SURFACES.items()),
            "speed_and_density": f"{SPEED:g} m/s and {AIR_DENSITY:g} kg/m3, stated by the paper, not by the table",
        },
    )
    difference = {"links minus whole robot, largest [m2]": float(sum_error.max())}
    return replace(dataset, checks={**checks(dataset), **difference})


def checks(dataset: Dataset) -> dict[str, float]:
    """Return the numbers of rows and postures, the spread of repeated rows and the asymmetry of symmetric cases."""
    areas = dataset.force_area_b
    order = np.argsort(dataset.group, kind="stable")
    same = dataset.group[order[1:]] == dataset.group[order[:-1]]
    repeats = areas[order[1:][same]] - areas[order[:-1][same]]
    _, sizes = np.unique(dataset.group, return_counts=True)
    angles, wind = dataset.joint_position_deg, dataset.wind_b
    alone = np.all(np.abs(mirrored_joints(angles, dataset.joints) - angles) < 1e-6, axis=1)
    alone &= np.all(np.abs(wind * MIRROR_AXES - wind) < 1e-6, axis=1)
    tilt = mirrored_areas(areas[alone], dataset.links) - areas[alone]
    figures: dict[str, float] = {
        "rows": len(dataset),
        "postures": len(np.unique(dataset.family)),
        "groups of equal posture and wind that occur more than once": int((sizes > 1).sum()),
        f"variance over the {3 * len(dataset.links)} components [m4]": float(
            areas.reshape(len(dataset), -1).var(axis=0).mean()
        ),
    }
    if len(repeats):
        figures["difference within those groups, mean square [m4]"] = float(np.mean(repeats**2))
    if len(tilt):
        figures["rows that should be their own mirror image"] = int(alone.sum())
        figures["their distance from it, mean square [m4]"] = float(np.mean(tilt**2))
        figures["their distance from it, largest [m2]"] = float(np.abs(tilt).max())
    return figures


def _check_angles(row: Floats, place: str) -> None:
    for column, value, low, high in (("pitchAngle", row[0], 0.0, 180.0), ("yawAngle", row[1], -180.0, 180.0)):
        if not low <= value <= high:
            raise ValueError(f"{place}, column `{column}`: {value:g}; expected {low:g} to {high:g} degrees")

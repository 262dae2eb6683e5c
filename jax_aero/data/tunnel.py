"""Balance files of the wind tunnel: six components, reduced to force areas and moment volumes with their uncertainty.

    GVP files ──► Points ──reduce_points──► xarray.Dataset

Balance axes of iRonCub-Mk1 are X forward, Y left, Z up and turn with the robot; those of Mk3 are X left, Y down, Z
backward. Base (`root_link`) axes are x backward, y right, z up. Equations M28 and M95 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from jax_aero.aero.dataset import Floats, number
from jax_aero.data.ironcub import JOINTS

GVP_COLUMNS = 86
GVP_USED = (*range(1, 5), *range(8, 11), 12, *range(14, 20), *range(74, 80))
"""Columns of a balance file that are read."""
COMPONENTS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
WIND_OFF = 5.0
"""Speed below which the wind is off [m/s]."""
EXPOSED = {"hovering": 20.5, "flight": 1.0}
"""Sideslip, by kind of test, beyond which the support is exposed to the wind or the file has combined wind [deg]."""

HIP = np.array([0.00645, 0.0, -0.11991])
"""Midpoint of the hip-pitch axis of Mk1 relative to the base origin, base axes [m]."""
BASE_FROM_BALANCE = {"mk1": np.diag([-1.0, -1.0, 1.0]), "mk3": np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])}
"""Rotation from balance to base axes for a robot mounted upright."""
MOUNT = {("mk1", "hovering"): 0.0, ("mk1", "flight"): -45.0, ("mk3", "hovering"): 0.0, ("mk3", "flight"): 0.0}
"""Pitch of the robot on the balance [deg]; the pitch of Mk1 is 90° + mount + pitch of the balance."""

YAW = {"mk1": 1.0, "mk3": -1.0}
"""Sign of the yaw in the files. Mk3's is opposite: with this sign, in all 316 points of its public files with more than
5° of yaw, the lateral force on the robot has the direction of the lateral wind; with the other sign it opposes it."""


class Lever(NamedTuple):
    """Offset of the balance centre."""

    offset: tuple[float, float, float]
    """Offset [m]; of Mk1 from the hip-pitch axis, balance axes."""
    deviation: tuple[float, float, float]
    """Standard deviations of the offset, balance axes [m]."""


LEVERS = {
    (kind, side): Lever((-0.497, 0.0, height), deviation)
    for kind, deviation in (("hovering", (0.03, 0.01, 0.005)), ("flight", (0.11, 0.01, 0.02)))
    for side, height in (("below", -0.021), ("above", 0.021))
}
"""Offsets by kind of test and side of the balance centre. The authors' scripts changed the sign of the height once; for
the mount of the flight postures the distance is uncertain."""
BALANCE_OF_MK3 = Lever((0.206, 0.0, -0.024), (0.014, 0.005, 0.01))
"""Balance centre of Mk3 from the base origin, x backward, and deviations in balance axes [m].

The gravity sweep of homePos (TID_0001.tara, 65.0 kg) has the centre of gravity (-14, -32, -202) mm from it in balance
axes, within (6, 0.5, 0.5) mm; the model (65.95 kg) has it 4 mm behind and 8 mm above the base origin. Sideways the
robot is taken as symmetric."""
REPEATABILITY = np.array([0.002, 0.003, 0.001])
"""Repeatability of moment volumes within a campaign, base axes [m³]."""


@dataclass(frozen=True)
class Points:
    """Measured points as stored in the files; N rows."""

    campaign: Sequence[str]
    test: Sequence[str]
    point: Sequence[int]
    kind: Sequence[str]
    """Kind of test, `hovering` or `flight`."""
    posture: Sequence[str]
    marks: Sequence[tuple[str, ...]]
    """Reasons to doubt a point, from the table of tests."""
    robot: str
    pitch_deg: Floats
    """Angle of the robot's vertical axis above the horizontal [deg]."""
    yaw_deg: Floats
    speed: Floats
    dynamic_pressure: Floats
    air_density: Floats
    temperature: Floats
    load: Floats
    """(N, 6) [N, N m], balance axes about the balance centre, tare and wind-off zero removed."""
    deviation: Floats
    """(N, 6) sample standard deviations of the load."""
    zero_return: Floats
    """(N, 6) last reading of the test without wind; NaN if there is none."""

    def __len__(self) -> int:
        return len(self.test)


def read_gvp(text: str, source: str) -> Floats:
    """Return the rows (n, 86) of a balance file, wind-off rows included; columns that are not in `GVP_USED` are NaN.

    Raises
    ------
    ValueError
        If the content violates the format; the message names file, line and column.
    """
    places, lines = _lines(text)
    if len(lines) < 3 or "=" not in lines[0] or not lines[1].startswith("ID(0)"):
        raise ValueError(f"{source}: no balance file; expected a line KEY=VALUE;…, one of columns ID(0),…, and rows")
    values = np.full((len(lines) - 2, GVP_COLUMNS), np.nan)
    for row, place, line in zip(values, places[2:], lines[2:], strict=True):
        cells = line.split("\t")
        if len(cells) != GVP_COLUMNS:
            raise ValueError(f"{source}, line {place}: {len(cells)} columns; expected {GVP_COLUMNS}")
        row[list(GVP_USED)] = [number(cells[column], f"{source}, line {place}", str(column)) for column in GVP_USED]
    return values


def _lines(text: str) -> tuple[list[int], list[str]]:
    """Return the number and text of every line that is not empty."""
    kept = [(place, line) for place, line in enumerate(text.splitlines(), start=1) if line.strip()]
    return [place for place, _ in kept], [line for _, line in kept]


def read_sweep(text: str, source: str) -> tuple[Floats, Floats]:
    """Return forces and moments (n, 3) of a gravity sweep (`.tara`), balance axes, minus its first zero [N, N m]."""
    places, lines = _lines(text)
    if len(lines) < 2 or not lines[0].startswith("a_nom"):
        raise ValueError(f"{source}: no gravity sweep; expected a line of columns a_nom[deg], …, and rows")
    rows = []
    for place, line in zip(places[1:], lines[1:], strict=True):
        cells = line.split("\t")
        if len(cells) < 10:
            raise ValueError(f"{source}, line {place}: {len(cells)} columns; expected at least 10")
        rows.append([number(cells[column], f"{source}, line {place}", str(column)) for column in range(4, 10)])
    loads = np.array(rows)
    return loads[:, :3], loads[:, 3:]


def centre_of_gravity(force: Floats, moment: Floats) -> tuple[Floats, Floats]:
    """Return the centre of gravity (3,) of the load, relative to the balance centre, and its standard errors [m].

    Turning the balance changes the weight in its axes by ΔF and its moment by ΔM = r × ΔF.
    """
    matrix = np.cross(force[:, None], np.eye(3)).reshape(-1, 3)
    right = moment.reshape(-1)
    normal = np.linalg.inv(matrix.T @ matrix)
    r = normal @ matrix.T @ right
    left = right - matrix @ r
    variance = float(left @ left) / max(len(right) - 3, 1)
    return r, np.sqrt(variance * np.diag(normal))


class Test(NamedTuple):
    """Entry of one test in the table of tests."""

    campaign: str
    kind: str
    posture: str
    robot: str
    marks: tuple[str, ...]
    """Reasons to doubt the whole test."""
    point_marks: Mapping[int, tuple[str, ...]]
    """Reasons to doubt single points."""
    tare_above_deg: float | None = None
    """Pitch of the robot beyond which the tare was extrapolated [deg]."""


def points_of(test: str, about: Test, gvp: Floats) -> Points:
    """Return the points with wind among the rows of one file."""
    on = gvp[:, 8] >= WIND_OFF
    rows, off = gvp[on], gvp[~on]
    zero = off[-1, 14:20] if len(off) else np.full(6, np.nan)
    pitch = rows[:, 3] + (90.0 + MOUNT[about.robot, about.kind] if about.robot == "mk1" else 0.0)
    numbers = list(range(1, len(rows) + 1))  # the numbers in a file may begin anywhere
    return Points(
        campaign=[about.campaign] * len(rows),
        test=[test] * len(rows),
        point=numbers,
        kind=[about.kind] * len(rows),
        posture=[about.posture] * len(rows),
        marks=[_marks(about, point, alpha) for point, alpha in zip(numbers, pitch, strict=True)],
        robot=about.robot,
        pitch_deg=pitch,
        yaw_deg=YAW[about.robot] * rows[:, 4],
        speed=rows[:, 8],
        dynamic_pressure=rows[:, 9],
        air_density=rows[:, 10],
        temperature=rows[:, 12],
        load=rows[:, 14:20],
        deviation=rows[:, 74:80],
        zero_return=np.tile(zero, (len(rows), 1)),
    )


def _marks(about: Test, point: int, pitch: float) -> tuple[str, ...]:
    extrapolated = about.tare_above_deg is not None and pitch > about.tare_above_deg + 1.0
    return (
        *about.marks,
        *about.point_marks.get(point, ()),
        *(("tare extrapolated",) if extrapolated else ()),
    )


def join(parts: Sequence[Points]) -> Points:
    """Return the points of several files of one robot as one set."""
    if len({part.robot for part in parts}) != 1:
        raise ValueError(f"points of {sorted({part.robot for part in parts})}; expected one robot")
    joined: dict[str, Any] = {"robot": parts[0].robot}
    for name in Points.__dataclass_fields__:
        if name == "robot":
            continue
        values = [getattr(part, name) for part in parts]
        is_array = isinstance(values[0], np.ndarray)
        joined[name] = np.concatenate(values) if is_array else [entry for value in values for entry in value]
    return Points(**joined)


def base_from_balance(robot: str, kind: str) -> Floats:
    """Return the rotation (3, 3) from balance axes to base axes: Ry(−mount) and the change of axes."""
    angle = -np.radians(MOUNT[robot, kind])
    c, s = np.cos(angle), np.sin(angle)
    turned: Floats = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]) @ BASE_FROM_BALANCE[robot]
    return turned


def reduce_points(points: Points, joints: Mapping[str, Floats], coms: Mapping[str, Floats], side: str) -> xr.Dataset:
    """Reduce points to force areas and moment volumes in base axes, about balance centre, hip and centre of mass.

        M_hip = M_bal + r × F,   M_com = M_hip + (p_hip − p_com) × F                                   (M95)

    with r the balance centre relative to the hip. Of Mk3 it is known relative to the base instead, and M_hip is NaN;
    M_com is NaN without a centre of mass.

    Parameters
    ----------
    joints, coms
        Joint angles (19,) [deg] and centre of mass (3,) [m], base axes, by posture.
    side
        Whether Mk1's balance centre is `below` or `above` the hip-pitch axis.
    """
    n = len(points)
    turns = np.stack([base_from_balance(points.robot, kind) for kind in points.kind])
    q = points.dynamic_pressure[:, None]
    forces = np.einsum("nij,nj->ni", turns, points.load[:, :3] / q)
    moments = np.einsum("nij,nj->ni", turns, points.load[:, 3:] / q)
    zero = np.einsum("nij,nkj->nki", turns, (points.zero_return / q).reshape(n, 2, 3))
    com = np.array([coms.get(posture, np.full(3, np.nan)) for posture in points.posture])
    if points.robot == "mk1":
        levers = [LEVERS[kind, side] for kind in points.kind]
        to_hip = np.einsum("nij,nj->ni", turns, np.array([lever.offset for lever in levers]))
        to_com = to_hip + HIP - com
    else:
        levers = [BALANCE_OF_MK3] * n
        to_hip = np.full((n, 3), np.nan)
        to_com = BALANCE_OF_MK3.offset - com
    sigma = np.array([lever.deviation for lever in levers])
    u_lever = np.sqrt(sum(_lever_part(axis, sigma, points.load[:, :3] / q, turns) ** 2 for axis in range(3)))
    u_zero = np.abs(zero[:, 1] + np.cross(to_com, zero[:, 0]))
    u_repeat = np.tile(REPEATABILITY, (n, 1))
    exposed = np.abs(points.yaw_deg) > [EXPOSED[kind] for kind in points.kind]
    marks = [(*own, "support") if is_exposed else own for own, is_exposed in zip(points.marks, exposed, strict=True)]
    angles = np.array([joints.get(name, np.full(len(JOINTS), np.nan)) for name in points.posture])
    vector, load = ("point", "axis"), ("point", "component")
    area, volume = {"units": "m2"}, {"units": "m3"}
    variables: dict[str, Any] = {
        "number": ("point", np.array(points.point), {"long_name": "number of the point in its test"}),
        "pitch": (
            "point",
            points.pitch_deg,
            {"units": "degree", "long_name": "robot's vertical axis above horizontal"},
        ),
        "yaw": ("point", points.yaw_deg, {"units": "degree", "long_name": "about the tunnel's vertical"}),
        "speed": ("point", points.speed, {"units": "m s-1"}),
        "dynamic_pressure": ("point", points.dynamic_pressure, {"units": "Pa"}),
        "air_density": ("point", points.air_density, {"units": "kg m-3"}),
        "temperature": ("point", points.temperature, {"units": "K"}),
        "load": (load, points.load, {"units": "N, N m", "long_name": "balance axes, about the balance centre"}),
        "deviation": (load, points.deviation, {"units": "N, N m", "long_name": "of the samples: unsteadiness"}),
        "zero_return": (load, points.zero_return, {"units": "N, N m", "long_name": "last reading without wind"}),
        "force_area": (vector, forces, area),
        "moment_balance": (vector, moments, volume),
        "moment_hip": (vector, moments + np.cross(to_hip, forces), volume),
        "moment_com": (vector, moments + np.cross(to_com, forces), volume),
        "u_lever": (vector, u_lever, volume),
        "u_zero": (vector, u_zero, volume),
        "u_repeat": (vector, u_repeat, volume),
        "u_total": (vector, np.sqrt(u_lever**2 + u_zero**2 + u_repeat**2), volume),
        "com": (vector, com, {"units": "m", "long_name": "centre of mass of the model from the base origin"}),
        "joint_position": (("point", "joint"), angles, {"units": "degree"}),
    }
    coords: dict[str, Any] = {
        "campaign": ("point", list(points.campaign)),
        "test": ("point", list(points.test)),
        "kind": ("point", list(points.kind)),
        "posture": ("point", list(points.posture)),
        "marks": ("point", [", ".join(mark) for mark in marks]),
        "robot_only": ("point", np.array([not mark for mark in marks]).astype("i1")),
        "axis": ["x", "y", "z"],
        "component": list(COMPONENTS),
        "joint": list(JOINTS),
    }
    text = "base (root_link) axes: x backward, y right, z up; divided by the dynamic pressure"
    return xr.Dataset(variables, coords, {"robot": points.robot, "side": side, "axes": text})


def _lever_part(axis: int, sigma: Floats, forces: Floats, turns: Floats) -> Floats:
    """Return the moment volume (N, 3), base axes, of a one-sigma error of the offset along one balance axis."""
    offset = np.zeros_like(sigma)
    offset[:, axis] = sigma[:, axis]
    part: Floats = np.einsum("nij,nj->ni", turns, np.cross(offset, forces))
    return part

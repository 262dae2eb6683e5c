"""Numbers that are found, with names, units and intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from jax_aero.body.robot import RobotModel
from jax_aero.identify.motion import Numbers
from jax_aero.identify.search import Found

Array = NDArray[np.float64]
Record = dict[str, Any]

UNITS = {
    "mass": ("%", 100.0),
    "com": ("mm", 1e3),
    "inertia": ("%", 100.0),
    "bodies": ("1e-3, mm", 1e3),
    "fuel": ("mg/(N s)", 1e6),
    "torque_gain": ("%", 100.0),
    "thrust_gain": ("%", 100.0),
    "thrust_offset": ("N", 1.0),
    "thrust_axes": ("deg", np.degrees(1.0)),
    "imu": ("deg", np.degrees(1.0)),
    "gyro": ("deg", np.degrees(1.0)),
    "encoders": ("deg", np.degrees(1.0)),
    "friction": ("N m", 1.0),
    "damping": ("N m s", 1.0),
    "air": ("%", 100.0),
    "air_turn": ("deg", np.degrees(1.0)),
    "air_point": ("mm", 1e3),
    "wrench": ("N, N m", 1.0),
    "wind": ("m/s", 1.0),
    "delay": ("ms", 1e3),
}
BODY = ("mass", "x", "y", "z", "size.x", "size.y", "size.z", "shear.zx", "shear.zy", "shear.yx")
"""Parts of a body's numbers."""
FOUND = 0.5
"""Share of the data in a number from which it is found."""
RELATED = 0.3
"""Correlation of errors from which it is stored."""
INTERVAL = 0.95
"""Probability of an interval."""
Z = float(ndtri(0.5 + 0.5 * INTERVAL))
"""Its half width in deviations of a normal distribution."""
MANY = ("bodies", "air_turn", "air_point")
"""Numbers of which only those that are found are shown."""
UNIFORM = ("mass", "com", "inertia", "thrust_gain", "torque_gain", "thrust_axes", "imu", "encoders", "friction")
"""Numbers whose prior is uniform."""


def labels(robot: RobotModel) -> list[tuple[str, str, float]]:
    """Return name, unit and factor to it of every number, in order."""
    jets, joints, xyz = robot.jets.names, robot.joint_names, "xyz"
    entries: dict[str, Sequence[str]] = {
        "com": xyz, "thrust_gain": jets, "thrust_offset": jets, "imu": xyz, "encoders": joints, "friction": joints,
        "air": robot.aero_links.names,
        "bodies": [f"{body}.{part}" for body in robot.body_names for part in BODY],
        "torque_gain": [name for name, _ in robot.joint_groups], "gyro": xyz,
        **{name: [f"{link}.{axis}" for link in robot.aero_links.names for axis in xyz] for name in MANY[1:]},
        "thrust_axes": [f"{jet}.{number}" for jet in jets for number in (1, 2)],
        "wrench": ["fx", "fy", "fz", "mx", "my", "mz"], "wind": xyz, "delay": ["thrust", "torque"],
    }  # fmt: skip
    rows = []
    for name in Numbers._fields:
        unit, factor = UNITS[name]
        rows += [(f"{name}.{entry}" if entry else name, unit, factor) for entry in entries.get(name, [""])]
    return rows


def records(robot: RobotModel, estimate: Found, shown: NDArray[np.bool_]) -> list[Record]:
    """Return the numbers as data, in their units: value, interval, deviation before, share of the data."""
    rows, (low, middle, high) = [], estimates(robot, estimate)
    for place in np.flatnonzero(shown):
        name, unit, factor = labels(robot)[place]
        rows.append(
            {
                "name": name,
                "value": factor * float(middle[place]),
                "interval": [factor * float(low[place]), factor * float(high[place])],
                "unit": unit,
                "prior": factor * float(estimate.prior[place]),
                "share": float(estimate.share[place]),
                "found": bool(estimate.share[place] >= FOUND),
            }
        )
    return rows


def correlations(robot: RobotModel, estimate: Found, shown: NDArray[np.bool_]) -> list[tuple[str, str, float]]:
    """Return the numbers that are found and the correlations of their errors, those of `RELATED` and above."""
    places = np.flatnonzero(shown & (estimate.share >= FOUND))
    names = [labels(robot)[place][0] for place in places]
    deviation = estimate.deviation[places]
    matrix = estimate.covariance[np.ix_(places, places)] / np.outer(deviation, deviation)
    pairs = np.argwhere(np.triu(np.abs(matrix) >= RELATED, 1)).tolist()
    return [(names[row], names[column], round(float(matrix[row, column]), 3)) for row, column in pairs]


def estimates(robot: RobotModel, estimate: Found) -> tuple[Array, Array, Array]:
    """Return of all numbers the lower ends of their intervals, `INTERVAL` likely, their medians, and the upper ends."""
    low, middle, high = quantiles(robot, estimate, (0.5 - 0.5 * INTERVAL, 0.5, 0.5 + 0.5 * INTERVAL))
    return low, middle, high


def quantiles(robot: RobotModel, estimate: Found, probabilities: Sequence[float]) -> list[Array]:
    """Return the values below which all numbers are with these probabilities.

    Errors of a file are uniform in `UNIFORM`, of friction from zero, so that what the data alone give is cut there.
    """
    is_free = estimate.prior > 0.0
    before, after = np.where(is_free, estimate.prior, 1.0), np.where(is_free, estimate.deviation, 1.0)
    names = [name.split(".")[0] for name, *_ in labels(robot)]
    half = np.sqrt(3.0) * before
    least = np.where([name == "friction" for name in names], 0.0, -half)
    precision = np.maximum(after**-2 - before**-2, 1e-9 * before**-2)
    alone, spread = estimate.value * after**-2 / precision, precision**-0.5
    is_cut = np.array([name in UNIFORM for name in names]) & is_free
    is_cut &= (alone + 2.0 * spread >= least) & (alone - 2.0 * spread <= half)
    edges = [np.where(is_cut, ndtr((edge - alone) / spread), outer) for edge, outer in ((least, 0.0), (half, 1.0))]
    centre, width = np.where(is_cut, alone, estimate.value), np.where(is_cut, spread, estimate.deviation)
    return [centre + width * ndtri(edges[0] + part * (edges[1] - edges[0])) for part in probabilities]


def describe(row: Record) -> str:
    """Return a number with its interval."""
    low, high = row["interval"]
    return f"{row['value']:.3g} ({low:.3g} to {high:.3g}) {row['unit']}"

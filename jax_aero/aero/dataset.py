"""Force areas of every link for many postures and wind directions: one format for CFD and `.mat` tables.

    solver table, authors' `.mat` ──► Dataset ──► NetCDF;   Dataset ──split──► training, validation

All vectors are in base (`root_link`) axes: x backward, y to the robot's right, z up. The tunnel frame of the tables has
x along the wind and z up. The robot's attitude in it is `R_tunnel_from_base = Rz(yaw) Ry(pitch − 90°)`, so pitch is the
angle of the robot's vertical axis above the horizontal: 90° upright, 0° prone with the head upstream.

Equation M28 of `docs/model`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import xarray as xr
from jaxtyping import Bool, Float, Int

from jax_aero import rust
from jax_aero.base import netcdf
from jax_aero.base.files import read_bytes, write_netcdf
from jax_aero.body.mirror import ODD_JOINTS, opposite_indices
from jax_aero.body.robot import RobotModel

Floats: TypeAlias = npt.NDArray[np.float64]
Indices: TypeAlias = npt.NDArray[np.int64]

FORMAT = "jax-aero force areas 1"
AREA_UNITS = "m2"
QUALITY = "quality: "
"""Prefix of the variables of `Dataset.quality` in a file."""


MIRROR_AXES = np.array([1.0, -1.0, 1.0])
"""Signs of a vector's components when mirrored about the base's x-z plane."""


def mirrored_joints(
    joint_position_deg: Float[np.ndarray, "*batch s"], joints: Sequence[str]
) -> Float[np.ndarray, "*batch s"]:
    """Return the angles of these joints in the mirror image, in the unit given."""
    signs = np.where(np.isin(joints, ODD_JOINTS), -1.0, 1.0)
    flipped: Floats = joint_position_deg[..., opposite_indices(joints)] * signs
    return flipped


def mirrored_areas(
    force_area_b: Float[np.ndarray, "*batch L 3"], links: Sequence[str]
) -> Float[np.ndarray, "*batch L 3"]:
    """Return the force areas of these links in the mirror image, base axes."""
    flipped: Floats = force_area_b[..., opposite_indices(links), :] * MIRROR_AXES
    return flipped


def reorder_joints(
    joint_names: Sequence[str], joints: Sequence[str], joint_position_deg: Float[np.ndarray, "*batch s"]
) -> Float[np.ndarray, "*batch n"]:
    """Return the robot's joint positions [rad] from a table's angles of some joints [deg]; the others are zero.

    Raises
    ------
    ValueError
        If the robot lacks a joint of the table.
    """
    names = list(joint_names)
    if missing := [name for name in joints if name not in names]:
        raise ValueError(f"the robot has no joint {', '.join(missing)}; expected those of the table")
    positions = np.zeros((*np.shape(joint_position_deg)[:-1], len(names)))
    positions[..., [names.index(name) for name in joints]] = np.radians(joint_position_deg)
    return positions


def wind_direction(pitch_deg: npt.ArrayLike, yaw_deg: npt.ArrayLike) -> Float[np.ndarray, "*batch 3"]:
    """Return the direction of the air's motion, base axes: `(cos p cos y, −sin y, sin p cos y)`, p = pitch − 90°."""
    return tunnel_from_base(pitch_deg, yaw_deg)[..., 0, :]


def tunnel_from_base(pitch_deg: npt.ArrayLike, yaw_deg: npt.ArrayLike) -> Float[np.ndarray, "*batch 3 3"]:
    """Return the rotation `Rz(yaw) Ry(pitch − 90°)`."""
    p, y = np.broadcast_arrays(np.radians(np.asarray(pitch_deg, float) - 90.0), np.radians(np.asarray(yaw_deg, float)))
    cp, sp, cy, sy, nil = np.cos(p), np.sin(p), np.cos(y), np.sin(y), np.zeros(p.shape)
    rows = [[cy * cp, -sy, cy * sp], [sy * cp, cy, sy * sp], [-sp, nil, cp]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


@dataclass(frozen=True)
class Dataset:
    """Force areas `F / (½ ρ V²)` of links, one row for each simulated or measured case."""

    posture: npt.NDArray[np.str_]
    """Name of the posture; that of a mirror image is the same."""
    is_mirrored: Bool[np.ndarray, " B"]
    """Whether the row is the mirror image of a computed one."""
    joint_position_deg: Float[np.ndarray, "B s"]
    """Joint angles [deg], order of `joints`."""
    wind_b: Float[np.ndarray, "B 3"]
    """Unit vector of the air's motion, base axes."""
    pitch_deg: Float[np.ndarray, " B"]
    """Angle of the robot's vertical axis above the horizontal [deg]."""
    yaw_deg: Float[np.ndarray, " B"]
    """Yaw of the robot about the tunnel's vertical [deg]."""
    force_area_b: Float[np.ndarray, "B L 3"]
    """Force areas [m²], base axes, order of `links`."""
    speed: Float[np.ndarray, " B"]
    """Speed of the air [m/s]."""
    air_density: Float[np.ndarray, " B"]
    """Density of the air [kg/m³]."""
    joints: tuple[str, ...]
    """The joints of the robot that differ between postures."""
    links: tuple[str, ...]
    """The robot's aerodynamic links."""
    couple_volume_b: Float[np.ndarray, "B L 3"] | None = None
    """Moments about the links' centres `M / (½ ρ V²)` [m³], base axes; `None` if unknown."""
    quality: Mapping[str, Float[np.ndarray, " B"]] = field(default_factory=dict)
    """Quality measures that a solver reported for every row, by name with unit."""
    provenance: Mapping[str, str] = field(default_factory=dict)
    """Origin of the rows."""
    checks: Mapping[str, float] = field(default_factory=dict)
    """Results of the checks at the import, by name with unit."""

    def __post_init__(self) -> None:
        n = len(self.posture)
        shapes = {"is_mirrored": (n,), "joint_position_deg": (n, len(self.joints)), "wind_b": (n, 3), "pitch_deg": (n,)}
        shapes |= {"yaw_deg": (n,), "force_area_b": (n, len(self.links), 3), "speed": (n,), "air_density": (n,)}
        if self.couple_volume_b is not None:
            shapes["couple_volume_b"] = (n, len(self.links), 3)
        values = {name: getattr(self, name) for name in shapes} | dict(self.quality)
        for name, value in values.items():
            shape = shapes.get(name, (n,))
            if value.shape != shape:
                raise ValueError(f"`{name}` has shape {value.shape}; expected {shape} for {n} rows")
            if not np.all(np.isfinite(value)):
                row = int(np.argwhere(~np.isfinite(value))[0][0])
                raise ValueError(f"`{name}` of row {row} (`{self.posture[row]}`) is not finite")
        lengths = np.linalg.norm(self.wind_b, axis=1)
        if n and np.abs(lengths - 1.0).max() > 1e-6:
            row = int(np.abs(lengths - 1.0).argmax())
            raise ValueError(f"wind_b of row {row} has length {lengths[row]:.6g}; expected a unit vector")

    def __len__(self) -> int:
        return len(self.posture)

    @cached_property
    def group(self) -> Int[np.ndarray, " B"]:
        """Number shared by rows of equal joint angles and wind, such as poles of the grid or own mirror images."""
        key = np.column_stack([self.joint_position_deg, self.wind_b])
        _, numbers = np.unique(np.round(key, 6), axis=0, return_inverse=True)
        return np.asarray(numbers, dtype=np.int64).reshape(-1)

    @cached_property
    def family(self) -> Int[np.ndarray, " B"]:
        """Number that identifies a posture and its mirror image, independent of their names."""
        angles = np.round(self.joint_position_deg, 6)
        images = np.round(mirrored_joints(self.joint_position_deg, self.joints), 6)
        swap = np.array(
            [tuple(b) < tuple(a) for a, b in zip(angles.tolist(), images.tolist(), strict=True)], dtype=bool
        )
        canonical = np.where(swap[:, None], images, angles) if len(self) else angles
        _, numbers = np.unique(canonical, axis=0, return_inverse=True)
        return np.asarray(numbers, dtype=np.int64).reshape(-1)

    def joint_position(self, robot: RobotModel) -> Float[np.ndarray, "B n"]:
        """Positions of all joints of a robot [rad]."""
        return reorder_joints(robot.joint_names, self.joints, self.joint_position_deg)

    @property
    def postures(self) -> tuple[str, ...]:
        """Names of the postures, in order of first appearance."""
        return tuple(dict.fromkeys(self.posture.tolist()))

    @property
    def force_area_w(self) -> Float[np.ndarray, "B L 3"]:
        """Drag, side and lift area [m²]: x, y and z of the tunnel frame, with x along the wind."""
        areas: Floats = np.einsum("nij,nlj->nli", tunnel_from_base(self.pitch_deg, self.yaw_deg), self.force_area_b)
        return areas

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the numbers that a model is trained on: postures, mirroring, joints, wind and areas, in order."""
        digest = hashlib.sha256(FORMAT.encode())
        digest.update("\n".join(self.posture.tolist()).encode())
        digest.update(np.packbits(self.is_mirrored).tobytes())
        couples = [] if self.couple_volume_b is None else [self.couple_volume_b]
        for array in (self.joint_position_deg, self.wind_b, self.force_area_b, *couples):
            digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return digest.hexdigest()

    def take(self, rows: npt.NDArray[Any] | slice) -> Dataset:
        """Return the selected rows."""
        arrays: dict[str, Any] = {name: getattr(self, name)[rows] for name in ARRAYS}
        if self.couple_volume_b is not None:
            arrays["couple_volume_b"] = self.couple_volume_b[rows]
        return replace(self, **arrays, quality={name: values[rows] for name, values in self.quality.items()})

    def add_mirror_images(self) -> Dataset:
        """Return the rows followed by their mirror images; unchanged if the dataset already holds mirror images."""
        if self.is_mirrored.any():
            return self
        n = len(self)
        both = self.take(np.tile(np.arange(n), 2))
        is_twin = np.repeat([False, True], n)

        def append_images(values: Floats, images: Floats) -> Floats:
            return np.concatenate([values[:n], images[n:]])

        angles, couples = both.joint_position_deg, both.couple_volume_b
        return replace(
            both,
            is_mirrored=is_twin,
            joint_position_deg=append_images(angles, mirrored_joints(angles, self.joints)),
            wind_b=append_images(both.wind_b, both.wind_b * MIRROR_AXES),
            yaw_deg=append_images(both.yaw_deg, -both.yaw_deg),
            force_area_b=append_images(both.force_area_b, mirrored_areas(both.force_area_b, self.links)),
            # Moments are axial vectors, whose mirror image has the opposite sign.
            couple_volume_b=None if couples is None else append_images(couples, -mirrored_areas(couples, self.links)),
        )

    def random_split(self, seed: int, fraction: float) -> tuple[Int[np.ndarray, " _"], Int[np.ndarray, " _"]]:
        """Return rows for training and for validation, drawn at random: the paper's split.

        Mirror images and nearly equal rows are in both parts, which leaks information. Report `grouped_folds` as well.
        """
        order = np.random.default_rng(seed).permutation(len(self)).astype(np.int64)
        count = round(fraction * len(self))
        return np.sort(order[count:]), np.sort(order[:count])

    def grouped_folds(self, seed: int, folds: int = 5) -> list[tuple[Int[np.ndarray, " _"], Int[np.ndarray, " _"]]]:
        """Return splits by whole postures with their mirror images, in which each posture is held out exactly once."""
        families = np.random.default_rng(seed).permutation(np.unique(self.family))
        if not 2 <= folds <= len(families):
            raise ValueError(f"folds is {folds}; expected 2 to {len(families)}, the number of postures")
        held = [np.isin(self.family, part) for part in np.array_split(families, folds)]
        return [(np.flatnonzero(~rows), np.flatnonzero(rows)) for rows in held]


ARRAYS = (
    *("posture", "is_mirrored", "joint_position_deg", "wind_b", "pitch_deg", "yaw_deg"),
    *("force_area_b", "speed", "air_density"),
)
"""Fields of `Dataset` with one entry per row."""

_VARIABLES: Mapping[str, tuple[tuple[str, ...], str, str]] = {
    "joint_position_deg": (("row", "joint"), "degree", "joint angle"),
    "wind_b": (("row", "xyz"), "1", "unit vector along which the air moves, base axes"),
    "pitch_deg": (("row",), "degree", "vertical axis of the robot above the horizontal"),
    "yaw_deg": (("row",), "degree", "yaw about the vertical of the tunnel"),
    "force_area_b": (("row", "link", "xyz"), AREA_UNITS, "force over dynamic pressure, base axes"),
    "speed": (("row",), "m s-1", "speed of the air"),
    "air_density": (("row",), "kg m-3", "density of the air"),
}


def save(dataset: Dataset, path: str | PathLike[str]) -> None:
    """Write the dataset as NetCDF; the file is written completely or not at all."""
    target = Path(path)
    coords: dict[str, Any] = {
        "posture": ("row", dataset.posture.astype(str)),
        "is_mirrored": ("row", dataset.is_mirrored.astype("i1")),
        "group": ("row", dataset.group, {"long_name": "rows of one body shape in one wind share a number"}),
        "joint": list(dataset.joints),
        "link": list(dataset.links),
        "xyz": ["x", "y", "z"],
    }
    variables = {
        name: (dims, getattr(dataset, name), {"units": units, "long_name": text})
        for name, (dims, units, text) in _VARIABLES.items()
    }
    if dataset.couple_volume_b is not None:
        text = "moment about the link's centre over dynamic pressure, base axes"
        variables["couple_volume_b"] = (
            ("row", "link", "xyz"),
            dataset.couple_volume_b,
            {"units": "m3", "long_name": text},
        )
    variables |= {f"{QUALITY}{name}": (("row",), values, {}) for name, values in dataset.quality.items()}
    facts: dict[str, str | float] = {"format": FORMAT, "sha256": dataset.sha256}
    facts |= {f"provenance: {key}": value for key, value in dataset.provenance.items()}
    facts |= {f"check: {key}": float(value) for key, value in dataset.checks.items()}
    write_netcdf(target, xr.Dataset(variables, coords, facts))


def load(path: str | PathLike[str], robot: RobotModel) -> Dataset:
    """Read a file that `save` wrote, of a robot.

    Raises
    ------
    ValueError
        If the file is missing, of another format or another robot, or if its numbers are not those that were written.
    """
    if not Path(path).is_file():
        raise ValueError(f"there is no dataset {path}; write it with: jax-aero data import-cfd")
    try:
        with netcdf.open_dataset(Path(path)) as opened:
            table = opened.load()
    except Exception as reason:  # the reader raises many types for other formats
        raise ValueError(f"{path} is not a dataset of this project: {reason}") from reason
    if table.attrs.get("format") != FORMAT:
        raise ValueError(f"format of {path} is {table.attrs.get('format')!r}; expected {FORMAT!r}")
    joints, links = (table[name].values.tolist() for name in ("joint", "link"))
    if links != list(robot.aero_links.names):
        raise ValueError(f"links of {path} are {links}; expected {list(robot.aero_links.names)}")
    if not set(joints) <= set(robot.joint_names):
        raise ValueError(f"joints of {path} are {joints}; expected some of {list(robot.joint_names)}")

    def facts(kind: str) -> dict[str, Any]:
        return {key.removeprefix(kind): value for key, value in table.attrs.items() if key.startswith(kind)}

    couples = ("couple_volume_b",) if "couple_volume_b" in table else ()
    dataset = Dataset(
        posture=table["posture"].values.astype(str),
        is_mirrored=table["is_mirrored"].values.astype(bool),
        **{name: table[name].values.astype(np.float64) for name in (*_VARIABLES, *couples)},
        quality={
            str(name).removeprefix(QUALITY): table[name].values.astype(np.float64)
            for name in table.data_vars
            if str(name).startswith(QUALITY)
        },
        provenance={key: str(value) for key, value in facts("provenance: ").items()},
        checks={key: float(value) for key, value in facts("check: ").items()},
        joints=tuple(joints),
        links=tuple(links),
    )
    if dataset.sha256 != table.attrs["sha256"]:
        raise ValueError(f"{path} says sha256 {table.attrs['sha256'][:12]}…, its numbers give {dataset.sha256[:12]}…")
    return dataset


def read_postures(path: str | PathLike[str], joints: Sequence[str]) -> dict[str, Float[np.ndarray, " s"]]:
    """Read angles of these joints [deg] by posture name, from a CSV with the columns `name` and `<joint>_deg`.

    Raises
    ------
    ValueError
        If a value is invalid; the message names file, line, column and value.
    """
    columns = {"name": "text", **{f"{joint}_deg": "number" for joint in joints}}
    table = rust.read_csv(read_bytes(Path(path)), str(path), columns)
    names, angles = table.texts["name"], np.column_stack(list(table.numbers.values()))
    for row, name in enumerate(names):
        if name in names[:row]:
            raise ValueError(f"line {table.lines[row]} of {path}: posture `{name}` stands there twice")
    return dict(zip(names, angles, strict=True))


def number(text: str | None, place: str, column: str) -> float:
    """Return a finite number; raise `ValueError` naming place and column otherwise."""
    try:
        value = float(text if text is not None else "")
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        given = "the line ends before it" if text is None else f"{text!r}"
        raise ValueError(f"{place}, column `{column}`: {given}; expected a finite number")
    return value

"""The file of a CFD design: postures, winds and settings, read and checked."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias

import msgspec
import numpy as np

from jax_aero import rust
from jax_aero.aero.dataset import Floats, read_postures, wind_direction
from jax_aero.base import plain_values, tables
from jax_aero.base.terminal import ConfigError, Refused
from jax_aero.cfd.case import DICTIONARIES
from jax_aero.cfd.geometry import Surface, robot_surfaces
from jax_aero.cfd.settings import Settings
from jax_aero.data.import_cfd import POSTURES, known_postures
from jax_aero.data.import_pressures import TAPS
from jax_aero.data.ironcub import JOINTS
from jax_aero.results import study
from jax_aero.sweep.design import unit_points
from jax_aero.view.shapes import look_of

KIND = "cfd"


Angles: TypeAlias = Annotated[tuple[float, ...], msgspec.Meta(max_length=1000)]
"""Angles [deg], of which a grid has a million combinations at most."""


class Winds(tables.Table, frozen=True):
    """Directions of the wind, given as pitch and yaw of the robot in the tunnel [deg]."""

    design: Literal["grid", "list", "sobol"]
    """All combinations, pairs, or quasi-random directions on the sphere that differ between postures."""
    pitch_deg: Angles = ()
    """Angle of the robot's vertical axis above the horizontal, 0 to 180, for a grid or list."""
    yaw_deg: Angles = ()
    """Yaw about the vertical of the tunnel, −180 to 180, for a grid or list."""
    samples: tables.Natural = 0
    """Number of directions per posture in a sobol design."""
    seed: tables.Seed = 1
    steps_deg: tuple[tables.Positive, tables.Positive] | None = None
    """Steps to which a sobol design rounds pitch and yaw, so that its points belong to a grid."""

    def __post_init__(self) -> None:
        if self.design == "sobol":
            if self.samples < 1:
                raise ConfigError.of("samples", self.samples, "at least 1 in a sobol design")
        elif not self.pitch_deg or not self.yaw_deg:
            name = "yaw_deg" if self.pitch_deg else "pitch_deg"
            raise ConfigError.of(name, [], f"angles, in a {self.design}")
        if self.design == "list" and len(self.pitch_deg) != len(self.yaw_deg):
            raise ConfigError.of("yaw_deg", self.yaw_deg, f"{len(self.pitch_deg)} values, as pitch_deg")
        for name, values, low, high in (
            ("pitch_deg", self.pitch_deg, 0.0, 180.0),
            ("yaw_deg", self.yaw_deg, -180.0, 180.0),
        ):
            for index, value in enumerate(values):
                if not low <= value <= high:
                    raise ConfigError.of(f"{name}[{index}]", value, f"{low:g} to {high:g}")

    def directions(self, posture: int) -> list[tuple[float, float]]:
        """Return pitch and yaw of every wind for a posture, given its index in the table of postures."""
        if self.design == "grid":
            return list(itertools.product(self.pitch_deg, self.yaw_deg))
        if self.design == "list":
            return list(zip(self.pitch_deg, self.yaw_deg, strict=True))
        points = unit_points("sobol", 2, self.samples * (posture + 1), self.seed)
        angles = [_direction_on_sphere(*point) for point in points[self.samples * posture :]]
        if self.steps_deg:
            by_pitch, by_yaw = self.steps_deg
            angles = [(by_pitch * round(pitch / by_pitch), by_yaw * round(yaw / by_yaw)) for pitch, yaw in angles]
        return list(dict.fromkeys((pitch, -180.0 if yaw == 180.0 else yaw) for pitch, yaw in angles))


def _direction_on_sphere(u: float, v: float) -> tuple[float, float]:
    """Map a point of the unit square to pitch and yaw [deg], such that directions are uniform on the sphere."""
    yaw = np.degrees(np.arcsin(2.0 * u - 1.0))
    turn = 360.0 * v - 180.0  # angle of the wind in the base's x-z plane
    if abs(turn) <= 90.0:
        return 90.0 + turn, float(yaw)
    # Wind from behind is equivalent to the robot yawed by 180°.
    return 90.0 + turn - np.copysign(180.0, turn), float(np.copysign(180.0, yaw) - yaw)


class Spec(tables.Table, frozen=True):
    """Settings of a design."""

    title: str
    postures: Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]
    """Names in `configs/tables/postures.toml` or in `joints`."""
    winds: Winds
    robot: Path
    geometry: Literal["primitives", "meshes"] = "primitives"
    """Geometry of the robot: primitives of its URDF, or also its meshes, found relative to the URDF."""
    joints: Path | None = None
    """Joint angles by posture: a TOML of the form of `configs/tables/postures.toml`, or a CSV as of `import-cfd`."""
    taps: str = ""
    """Robot in `configs/tables/pressure_taps.toml` at whose taps the pressure is read; empty for none."""
    winds_of: dict[str, Winds] = msgspec.field(default_factory=dict)
    """Other winds of some postures, by name."""
    settings: Settings = Settings()


class Case(NamedTuple):
    """One posture in one wind."""

    posture: str
    pitch_deg: float
    yaw_deg: float

    @property
    def wind_b(self) -> Floats:
        """Return the unit vector of the air's motion, base axes."""
        return wind_direction(self.pitch_deg, self.yaw_deg)

    @property
    def name(self) -> str:
        """Return the name of the case."""
        return f"{self.posture}_{self.pitch_deg:g}_{self.yaw_deg:g}"


@dataclass(frozen=True)
class Design:
    """A design with its robot and postures."""

    name: str
    spec: Spec
    changes: Mapping[str, Any] = field(default_factory=dict)
    """Changed keys and their values."""
    named: str | None = None
    """Name of the result, if it is not that of the design and its changes."""

    @classmethod
    def read(cls, name: str, changes: Mapping[str, Any], named: str | None = None) -> Design:
        """Read a file of `configs/cfd/` by name, or any file by path."""
        path = study.find(KIND, name)
        return cls(study.result_name(KIND, path), tables.load(path, Spec, changes), changes, named)

    @cached_property
    def robot(self) -> rust.Robot:
        """Return the robot."""
        return rust.Robot(self.spec.robot)

    @cached_property
    def known_postures(self) -> dict[str, Floats]:
        """Return the joint angles (19,) [deg] of all known postures."""
        path = self.spec.joints or POSTURES
        return known_postures(path=path) if path.suffix.lower() == ".toml" else read_postures(path, JOINTS)

    @cached_property
    def joints(self) -> dict[str, Floats]:
        """Return joint angles (19,) [deg] by posture."""
        known = self.known_postures
        if unknown := sorted(set(self.spec.postures) - set(known)):
            raise Refused(f"no posture {', '.join(unknown)}; there are {', '.join(known)}")
        return {name: known[name] for name in self.spec.postures}

    @cached_property
    def cases(self) -> dict[str, list[Case]]:
        """Return the cases of every posture."""
        places = list(self.known_postures)
        return {
            name: [
                Case(name, *pair)
                for pair in self.spec.winds_of.get(name, self.spec.winds).directions(places.index(name))
            ]
            for name in self.joints
        }

    @property
    def meshes_of(self) -> Path | None:
        """Return the robot's file if its meshes are used, otherwise `None`."""
        return self.spec.robot if self.spec.geometry == "meshes" else None

    @cached_property
    def surfaces(self) -> dict[str, dict[str, Surface]]:
        """Return the surfaces of the links by posture."""
        return {
            name: robot_surfaces(self.robot, joints, self.meshes_of, self.taps) for name, joints in self.joints.items()
        }

    @cached_property
    def taps(self) -> dict[str, dict[str, Any]]:
        """Return link, position and normal of the taps that have them, by name."""
        facts = tables.read(TAPS)
        if self.spec.taps and self.spec.taps not in facts["held_out"]:
            raise ConfigError.of("taps", self.spec.taps, f"one of {', '.join(facts['held_out'])}, or none")
        return {tap: about for tap, about in facts.get(self.spec.taps, {}).items() if "link" in about}

    def __iter__(self) -> Iterator[Case]:
        return itertools.chain.from_iterable(self.cases.values())

    @property
    def digest(self) -> str:
        """Return a hash of everything that determines a case's result; postures and winds can be added to a design."""
        settings = plain_values.to_builtins(self.spec.settings)
        settings["solver"].pop("ranks")
        text = json.dumps(settings, sort_keys=True) + self.robot.urdf_text + self.robot.toml_text
        text += json.dumps(self.taps) if self.taps else ""
        hashed = hashlib.sha256(text.encode() + (self.spec.joints or POSTURES).read_bytes() + DICTIONARIES.read_bytes())
        if self.meshes_of:
            for shape in look_of(self.robot, self.meshes_of).shapes:
                for part in shape.mesh or ():
                    hashed.update(part.tobytes())
        return hashed.hexdigest()

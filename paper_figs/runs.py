"""Result folders of flights and studies, read for figures; never written."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import xarray as xr

from jax_aero.base import kinds, run_file
from jax_aero.base.places import RESULTS, RUN_FILE, is_path
from jax_aero.base.terminal import Refused
from paper_figs import style

Series = xr.DataArray


class NotDrawn(Exception):
    """A figure cannot be drawn; the message states the reason and the remedy."""


class MissingRun(NotDrawn):
    """A figure lacks a flight or a package; the message names it and how to get it."""


@dataclass(frozen=True)
class Run:
    """One flight, up to its end or loss."""

    name: str
    data: xr.Dataset

    @property
    def title(self) -> str:
        """Return the title of the run, in the paper's terms."""
        return escape_text(self.data.attrs["title"])

    @property
    def config_hash(self) -> str:
        """Return the digest of the flown configuration."""
        return str(self.data.attrs["config_hash"])

    @property
    def lost_time(self) -> float | None:
        """Return when the flight was lost [s], or `None` if it reached its end."""
        time = float(self.data.attrs["lost_time"])
        return None if np.isnan(time) else time

    @property
    def ending(self) -> str:
        """Return the outcome in words: "fell at 21.4 s", "descended at 30.2 s"."""
        end = float(self.data["time"][-1]) if self.lost_time is None else self.lost_time
        return f"{self.data.attrs['outcome']} at {end:.1f} s"

    @cached_property
    def log_to_loss(self) -> xr.Dataset:
        """Return the log up to its loss, after which values are not meaningful and may be unbounded."""
        return self.data if self.lost_time is None else self.data.sel(time=slice(None, self.lost_time))

    def joint_error_sum_deg(self) -> Series:
        """Return the sum of absolute joint errors of each group [deg], dims time and group."""
        error = abs(self.log_to_loss["joint_position"] - self.log_to_loss["joint_setpoint"]) * (180.0 / np.pi)
        group_of = self.log_to_loss["joint_group"].values
        groups = list(dict.fromkeys(group_of.tolist()))  # in the robot's order
        sums = np.zeros((len(error["time"]), len(groups)))
        for column, group in enumerate(groups):
            sums[:, column] = error.isel(joint=np.flatnonzero(group_of == group)).sum("joint").values
        return Series(sums, {"time": error["time"], "group": groups}, ("time", "group"))

    def rotation_error_deg(self) -> Series:
        """Return the angle between the base's rotation and its reference [deg]."""
        return self.log_to_loss["rotation_error"] * (180.0 / np.pi)

    def com_error(self) -> Series:
        """Return the distance of the centre of mass from its reference [m]."""
        offset = self.log_to_loss["com_position"] - self.log_to_loss["com_setpoint"]
        return (offset**2).sum("xyz") ** 0.5


def escape_text(text: object) -> str:
    """Return a text, in which `$` is an ordinary character if what stands between them cannot be typeset."""
    return str(text) if style.can_be_typeset(str(text)) else str(text).replace("$", r"\$")


def folder_of(results: Path, kind: str, name: str) -> Path:
    """Return the folder of a result of a kind; `results` is that of flights, and a flight's name may be a path."""
    if kind != "flight":
        return results.parent / kind / name
    return Path(name) if is_path(name) else results / name


def load(results: Path, name: str, label: str | None = None) -> Run:
    """Read the run of this name, or in a folder given by its path, with a label in place of its name and title."""
    path = folder_of(results, "flight", name) / RUN_FILE
    if is_path(name) and not path.is_file():
        raise MissingRun(f"no flight in `{name}`; expected the folder of one")
    if not path.is_file():
        fly = kinds.find("flight")
        elsewhere = "" if results.resolve() == (RESULTS / "flight").resolve() else f" --out {results}"
        raise MissingRun(f"no flight `{name}` in {results}; fly it with: {fly.line(name, options=elsewhere)}")
    data = read(path)
    return Run(path.parent.name, data) if label is None else Run(escape_text(label), data.assign_attrs(title=label))


def load_study(results: Path, kind: str, name: str) -> xr.Dataset:
    """Read a study of a kind, with its name as an attribute; `results` is the folder of flights beside it."""
    path = folder_of(results, kind, name) / RUN_FILE
    if not path.is_file():
        raise MissingRun(f"no study `{name}` in {path.parents[1]}; make it with: {kinds.find(kind).line(name)}")
    return read(path).assign_attrs(name=name)


def read(path: Path) -> xr.Dataset:
    """Read a result file; a damaged one counts as missing."""
    try:
        return run_file.read(path)
    except Refused as reason:
        raise MissingRun(str(reason)) from reason

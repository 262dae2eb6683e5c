"""Result folders as the figures see them: read, never written."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import xarray as xr

from jax_aero.places import RESULTS

Series = xr.DataArray


class NotDrawn(Exception):
    """A figure cannot be drawn; the message says why, and what to do."""


class MissingRun(NotDrawn):
    """A figure lacks a flight, or a package, that it is drawn with; the message says which, and how to get it."""


@dataclass(frozen=True)
class Run:
    """One flight, up to its end or its loss."""

    name: str
    data: xr.Dataset

    @property
    def title(self) -> str:
        """Return what the run calls itself in the paper's words."""
        return as_written(self.data.attrs["title"])

    @property
    def config_hash(self) -> str:
        """Return the digest of the configuration that was flown."""
        return str(self.data.attrs["config_hash"])

    @property
    def lost_time(self) -> float | None:
        """Return when the flight was lost [s], or `None` if it reached its end."""
        time = float(self.data.attrs["lost_time"])
        return None if np.isnan(time) else time

    @property
    def ending(self) -> str:
        """Return how the flight was lost, and when: "fell at 21.4 s"."""
        return f"{self.data.attrs['outcome']} at {self.lost_time:.1f} s"

    @cached_property
    def flown(self) -> xr.Dataset:
        """Return the log up to its loss: behind it numbers lose their meaning, and their bounds."""
        return self.data if self.lost_time is None else self.data.sel(time=slice(None, self.lost_time))

    def joint_error_deg(self) -> Series:
        """Return the sum of absolute joint errors of each group [deg], dims time and group."""
        error = abs(self.flown["joint_position"] - self.flown["joint_setpoint"]) * (180.0 / np.pi)
        group_of = self.flown["joint_group"].values
        groups = list(dict.fromkeys(group_of.tolist()))  # in the robot's order
        sums = np.zeros((len(error["time"]), len(groups)))
        for column, group in enumerate(groups):
            sums[:, column] = error.isel(joint=np.flatnonzero(group_of == group)).sum("joint").values
        return Series(sums, {"time": error["time"], "group": groups}, ("time", "group"))

    def rotation_error_deg(self) -> Series:
        """Return the angle between the base's rotation and its reference [deg]."""
        return self.flown["rotation_error"] * (180.0 / np.pi)

    def com_error(self) -> Series:
        """Return the distance of the centre of mass from its reference [m]."""
        offset = self.flown["com_position"] - self.flown["com_setpoint"]
        return (offset**2).sum("xyz") ** 0.5


def as_written(text: object) -> str:
    """Return a text of a file so that Matplotlib writes `$` as it is, and does not read mathematics between two."""
    return str(text).replace("$", r"\$")


def load(results: Path, name: str) -> Run:
    """Read the run of one name."""
    path = results / name / "run.nc"
    if not path.is_file():
        elsewhere = "" if results.resolve() == (RESULTS / "flight").resolve() else f" --out {results}"
        raise MissingRun(
            f"no flight `{name}` in {results}; fly it with: python -m experiments {as_typed(name, elsewhere)}"
        )
    return Run(name, read(path))


def as_typed(name: str, options: str = "") -> str:
    """Return the words that make a result: `test2--wind.seed=3` is `test2` with something set."""
    stem, changed, _ = name.partition("--")
    return f"{stem}{options}" + (" --set ... (the changes in its name)" if changed else "")


def read(path: Path) -> xr.Dataset:
    """Read a result file; what is damaged counts as missing."""
    try:
        return xr.load_dataset(path, engine="h5netcdf")
    except Exception as reason:  # HDF5 fails in many ways on a damaged file
        raise MissingRun(f"{path} is damaged ({reason}); remove its folder and make it again") from reason

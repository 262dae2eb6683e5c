"""Data of a report, read once: flights, sweeps, studies."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base import documents, flights, keys, places, run_file
from jax_aero.base.files import find_damaged, read_json
from jax_aero.base.result import ending
from jax_aero.base.terminal import Refused
from jax_aero.rust import SETTLING_TIME
from jax_aero.stored import outdated
from jax_aero.stored.outdated import ANOTHER
from jax_aero.sweep import result as sweep
from jax_aero.sweep.result import SweepResult

Array: TypeAlias = NDArray[Any]
Cell: TypeAlias = Mapping[str, Any]

FAILED = "failed.json"
"""File of a results folder: the commands of `make reproduce` that failed, each with the reason."""
WINDY = 3.0
"""Least relative wind whose direction is meaningful [m/s]."""
MOVING = 0.02
"""Least speed of a set-point that moves [m/s]."""
LATE, STRONG = 35.0, 1.0
"""Time from which on the paper's models differ most [s], and least force whose sign is compared [N]."""
FULL = 0.99
"""Share of the greatest wind from which on it counts as full."""
SAMPLED = 50
"""Ticks between two samples of moments."""
FINAL = 3.0
"""Duration of the end of a flight, at rest in the paper's mission [s]."""


class NotFlownError(Exception):
    """A measurement is missing; the message names the command that makes it."""


class StaleError(NotFlownError):
    """A result is of another configuration or numerics than today's, and is therefore refused."""


@dataclass(frozen=True)
class Flight:
    """One flight; angles are in degrees."""

    folder: Path
    document: Mapping[str, Any]
    """Its manifest."""

    @property
    def ending(self) -> str:
        """Return how it ended."""
        return ending(*(self.document[key] for key in ("outcome", "lost_time", "lost_reason")))

    def figure(self, name: str) -> float:
        """Return a figure of its summary; NaN if it has none."""
        value = self.document["summary"].get(name)
        return np.nan if value is None else float(value)

    @property
    def rotation_error(self) -> float:
        """Return the greatest rotation error [deg]."""
        return float(np.degrees(self.figure("max_rotation_error")))

    @property
    def com_error(self) -> float:
        """Return the greatest position error after settling [m]; NaN if the flight ended before."""
        return self.figure("max_com_error")

    @property
    def thrust(self) -> tuple[float, float]:
        """Return the least and the greatest thrust [N]."""
        return self.figure("thrust_min"), self.figure("thrust_max")

    @cached_property
    def run(self) -> xr.Dataset:
        """Return its signals; as in its summary, without the row in which it diverged."""
        run = run_file.read(self.folder / places.RUN_FILE)
        return run.isel(time=slice(-1)) if run.attrs["outcome"] == "diverged" else run

    @property
    def joint_errors(self) -> dict[str, tuple[float, float]]:
        """Return, for each part of the body, the greatest sum of its joint errors and its mean over the last seconds.

        In degrees.
        """
        run = self.run
        errors = np.degrees(1.0) * abs(run["joint_position"] - run["joint_setpoint"]).groupby("joint_group").sum(
            "joint"
        )
        is_late = run["time"] >= run["time"][-1] - FINAL
        return {
            str(part).replace("_", " "): (float(error.max()), float(error[is_late.values].mean()))
            for part, error in ((part, errors.sel(joint_group=part)) for part in errors["joint_group"].values)
        }

    @property
    def asymmetry(self) -> tuple[float, float]:
        """Return the greatest difference between left and right thrust after settling: arms, chest [N]."""
        thrust = self.run["thrust"].sel(time=slice(SETTLING_TIME, None))

        def difference(part: str) -> float:
            pair = thrust.isel(jet=[part in str(jet) for jet in thrust["jet"].values])
            return float(abs(pair.diff("jet")).max()) if pair.sizes["jet"] == 2 else np.nan

        return difference("arm"), difference("chest")

    @property
    def moments(self) -> dict[str, float]:
        """Return the mean moment of the air about the centre of mass, and its sum with that of the thrusts [N m].

        In the full wind at rest; `exchanged` is the sum with left and right thrusts exchanged.
        """
        controller, moments = rust.Controller(rust.load_config(self.folder.name)), []
        for tick in np.flatnonzero(self.is_windy & ~self.is_moving)[::SAMPLED]:
            at = self.run.isel(time=tick)
            position, rotation, joints, thrust, wind = (
                at[name].values for name in ("base_position", "raw_base_rotation", "joint_position", "thrust", "wind")
            )
            velocity = np.concatenate([at["base_velocity"], at["joint_velocity"]])
            now = controller.tick(rust.State(position, rotation, joints, velocity), thrust, wind, float(at["time"]))
            acting = [(now.link_arm_points, at["aero_force_sim"].values)]
            acting += [(now.jet_points, now.jet_axes * rows[:, None]) for rows in (thrust, thrust[self.mirrored])]
            moments.append([np.cross(points - now.com_position, forces).sum(axis=0) for points, forces in acting])
        air, thrusts, exchanged = np.mean(moments, axis=0)
        sums = {"air": air, "left": air + thrusts, "exchanged": air + exchanged}
        return {name: float(np.linalg.norm(moment)) for name, moment in sums.items()}

    @property
    def mirrored(self) -> list[int]:
        """Return the number of the jet on the other side, of each jet."""
        names = [f"_{jet}" for jet in self.run["jet"].values]
        return [names.index(re.sub("_[lr]_", lambda side: {"_l_": "_r_"}.get(side[0], "_l_"), name)) for name in names]

    @property
    def is_windy(self) -> Array:
        """Return at which times the wind has risen to its full speed, after settling."""
        speed = np.linalg.norm(self.run["wind"].values, axis=1)
        return np.asarray((speed >= FULL * speed.max()) & (self.run["time"].values >= SETTLING_TIME))

    @property
    def is_moving(self) -> Array:
        """Return at which times the set-point moves."""
        return np.asarray(np.linalg.norm(self.run["com_setpoint"].differentiate("time").values, axis=1) > MOVING)

    @property
    def forces_apart(self) -> dict[str, float]:
        """Return how far simulated and assumed aerodynamic force differ in the mean [N], and the share of equal signs.

        In the full wind: while the set-point moves and rests, before `LATE` and later; of components of at least
        `STRONG`. The still air before would count as rest.
        """
        simulated, assumed = (flights.aero_force(self.run, of_controller=side).values for side in (False, True))
        difference, is_late = np.linalg.norm(simulated - assumed, axis=1), self.run["time"].values >= LATE
        parts = {"moving": self.is_moving, "resting": ~self.is_moving, "early": ~is_late, "late": is_late}
        is_strong = (abs(simulated) > STRONG) & self.is_windy[:, None]
        signs = 100.0 * float((np.sign(simulated) == np.sign(assumed))[is_strong].mean())
        return {name: float(difference[rows & self.is_windy].mean()) for name, rows in parts.items()} | {"signs": signs}

    @property
    def force_angle(self) -> tuple[float, float]:
        """Return the angle between total force and relative wind [deg]: median and greatest; NaN without wind."""
        air, force = (self.run["wind"] - self.run["com_velocity"]).values, flights.aero_force(self.run).values
        windy = np.linalg.norm(air, axis=1) > WINDY
        if not windy.any():
            return np.nan, np.nan
        air, force = air[windy], force[windy]
        sizes = np.linalg.norm(air, axis=1) * np.maximum(np.linalg.norm(force, axis=1), 1e-12)
        angle = np.degrees(np.arccos(np.clip((air * force).sum(axis=1) / sizes, -1.0, 1.0)))
        return float(np.median(angle)), float(angle.max())

    @property
    def stood(self) -> tuple[float, float]:
        """Return when the wind of a ground experiment begins to rise [s], and the mass of its robot [kg]."""
        start = float(keys.get(self.document["config"], "disturbances.controller_wind")["ramp_start"])
        return start, rust.Robot(str(places.ROBOT)).mass


class Origin(NamedTuple):
    """Origin of a result."""

    created: str
    """Time of creation; empty if unknown."""
    commit: str | None
    differs: str
    """Difference of its configuration from the present one; empty if there is none."""


@dataclass(frozen=True)
class Results:
    """A results folder."""

    folder: Path
    stale: bool = False
    """Whether results of another configuration or numerics are used, and marked, instead of refused."""
    made: dict[str, Origin] = field(default_factory=dict)
    """Origins of the results that were used, by name."""

    def failures(self, commands: Iterable[str]) -> list[str]:
        """Return which of these commands failed in the last `make reproduce`, and why."""
        path = self.folder / FAILED
        failed = read_json(path, dict[str, str]) if path.is_file() else {}
        return [f"`{command}` failed: {failed[command]}" for command in commands if command in failed]

    @cached_property
    def flights(self) -> dict[str, Flight]:
        """Return every flight without --set, by name; others are not the paper's."""
        by_name = {}
        for folder in sorted((self.folder / "flight").glob("[!.]*")):
            path = folder / places.MANIFEST_FILE
            if "--" not in folder.name and os.path.lexists(path):
                by_name[folder.name] = Flight(folder, read_json(path, documents.Manifest))
                _require_whole(folder, by_name[folder.name].document)
        return by_name

    @cached_property
    def sweeps(self) -> dict[str, SweepResult]:
        """Return every finished sweep, by name."""
        folders = sorted(path.parent for path in (self.folder / "sweeps").glob("[!.]*/cells.parquet"))
        whole = (folder for folder in folders if "finished" in read_json(folder / places.SWEEP_FILE))
        return {folder.name: sweep.read(folder) for folder in whole}

    @cached_property
    def differences(self) -> dict[str, str]:
        """Return the difference of every flight and sweep from today's, by name; empty if there is none."""
        flights = {name: outdated.flight(name, flight.document) for name, flight in self.flights.items()}
        swept = {name: self.folder / "sweeps" / name for name in self.sweeps}
        sweeps = {f"sweep {name}": outdated.sweep(at, self.sweeps[name].document) for name, at in swept.items()}
        return flights | sweeps

    @property
    def refused(self) -> dict[str, str]:
        """Return the flights and sweeps that are of another configuration or numerics, with the difference."""
        return {} if self.stale else {name: differs for name, differs in self.differences.items() if differs}

    def flight(self, name: str) -> Flight:
        """Return a flight without --set."""
        if name not in self.flights:
            raise NotFlownError(f"`jax-aero fly {name}` has not been run")
        self._use(name, self.flights[name].document, self.differences[name])
        return self.flights[name]

    def sweep(self, name: str) -> SweepResult:
        """Return a finished sweep without failed flights."""
        if name not in self.sweeps:
            raise NotFlownError(f"`jax-aero sweep {name}` has not been run")
        result, differs = self.sweeps[name], self.differences[f"sweep {name}"]
        failed = result.document["finished"]["outcomes"].get("error")
        if failed and (self.stale or not differs):
            raise NotFlownError(f"{failed} flights of `jax-aero sweep {name}` could not be flown")
        self._use(f"sweep {name}", result.document, differs)
        return result

    def study(self, kind: str, name: str) -> dict[str, Any]:
        """Return the figures of a study."""
        path = self.folder / kind / name / places.MANIFEST_FILE
        if not path.is_file():
            command = "cfd flow" if kind == "cfd_flow" else f"study {kind}"
            raise NotFlownError(f"`jax-aero {command} {name}` has not been run")
        document = read_json(path, documents.Manifest)
        self._use(f"{kind} {name}", document, outdated.study(kind, name, document))
        return dict(document.get("summary", {}))

    def _use(self, name: str, document: Mapping[str, Any], differs: str) -> None:
        """Refuse a result that differs from today's, or else record its origin."""
        if differs and not self.stale:
            raise StaleError(f"{ANOTHER}: {name} ({differs})")
        created = document.get("finished", document).get("created", "")
        self.made[name] = Origin(created, (document.get("git") or {}).get("commit"), differs)

    def figures(self, name: str) -> dict[str, str]:
        """Return the paths of a figure, relative to the report, by the runs it shows; "" for its default runs."""
        drawn = [self.folder / "figures" / f"{name}.png", *sorted(self.folder.glob(f"figures/{name}--*.png"))]
        return {
            path.stem.removeprefix(name).removeprefix("--"): f"figures/{path.name}" for path in drawn if path.is_file()
        }


def _require_whole(folder: Path, document: Mapping[str, Any]) -> None:
    if name := find_damaged(folder, document.get("files") or {}):
        raise Refused(f"{folder / name} is not what was written there; --overwrite flies it again")


def count(cell: Cell) -> str:
    """Return "39 of 40 (87 to 100 %)": the number that complete, and its 95 % interval."""
    low, high = (100.0 * cell[f"completed_{end}"] for end in ("low", "high"))
    return f"{cell['completed']} of {cell['flights']} ({low:.0f} to {high:.0f} %)"

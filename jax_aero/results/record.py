"""Result folders, their content and writing: the interface between runs and figures.

A folder holds `run.nc` (every signal and figure of merit once, with unit and named coordinates) and `manifest.json`
(the configuration, the code, the machine, the checksum of every other file). It is written completely or not at all.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base import documents
from jax_aero.base.files import (
    Variables,
    checksums,
    complete_folder,
    find_damaged,
    read_json,
    write_bytes,
    write_json,
    write_netcdf,
    write_variables,
)
from jax_aero.base.kinds import KINDS
from jax_aero.base.places import MANIFEST_FILE, RUN_FILE, SWEEP_FILE
from jax_aero.base.quantities import attributes_of
from jax_aero.base.result import FlightResult, is_repeated, labels_of
from jax_aero.base.terminal import Refused
from jax_aero.results.identity import ANOTHER, Identity

if TYPE_CHECKING:
    import xarray as xr


def to_dataset(
    flight: FlightResult, robot: rust.Robot, *, title: str, config_digest: str, backend: str = "rust"
) -> xr.Dataset:
    """Return a flight's log as a dataset with dimensions, coordinates and units."""
    import xarray as xr

    return xr.Dataset(*to_variables(flight, robot, title=title, config_digest=config_digest, backend=backend))


def to_variables(
    flight: FlightResult, robot: rust.Robot, *, title: str, config_digest: str, backend: str = "rust"
) -> Variables:
    """Return what `to_dataset` makes a dataset of."""
    variables: dict[str, Any] = {}
    values = {**flight.log, "joint_setpoint": np.asarray(flight.joint_setpoint)}
    declared = rust.signals()
    on_feet = any(name in values and signal.is_of_ground for name, signal in declared.items())
    coords = _coordinates(flight, robot)
    if not on_feet:
        del coords["foot"]
    for name, signal in declared.items():
        if name == "time" or (signal.is_of_ground and not on_feet):
            continue
        if name not in values:
            raise ValueError(f"the flight's log has no `{name}`")
        shape = tuple(coords[dim][1].shape[0] for dim in signal.dims)
        if values[name].shape != shape:
            raise ValueError(f"`{name}` has shape {values[name].shape}; expected {shape} for {signal.dims}")
        if is_repeated(name, values):
            continue
        variables[name] = (signal.dims, *_stored(signal, values[name]))
    if undeclared := values.keys() - declared.keys():
        raise ValueError(f"the crate declares no signal {', '.join(sorted(undeclared))}")
    for name, figure in rust.figures().items():
        if name in flight.summary:
            variables[name] = ((), *_stored(figure, np.asarray(flight.summary[name])))
    facts: dict[str, str | float] = {
        "title": title,
        "outcome": flight.outcome,
        # NetCDF attributes have no null, so NaN and the empty text are used for a flight that was not lost.
        "lost_time": np.nan if flight.lost_time is None else flight.lost_time,
        "lost_reason": flight.lost_reason or "",
        "backend": backend,
        "config_hash": config_digest,
    }
    return Variables(variables, coords, facts)


def _stored(quantity: rust.Quantity, values: NDArray[np.float64]) -> tuple[NDArray[Any], dict[str, Any]]:
    """Return the numbers of a quantity as a file has them, with their attributes."""
    # No integer stands for an unknown one, such as those of a tick that no controller has answered.
    kind = np.int32 if quantity.numbers != "real" and np.isfinite(values).all() else np.float64
    return values.astype(kind), attributes_of(quantity, kind)


def _coordinates(flight: FlightResult, robot: rust.Robot) -> dict[str, Any]:
    group_of = {joint: group for group, joints in robot.joint_groups.items() for joint in joints}
    coords: dict[str, Any] = {"time": ("time", flight.log["time"], attributes_of(rust.signals()["time"]))}
    for dim, names in labels_of(robot).items():
        coords[dim] = (dim, np.array(list(names), dtype=str), {})
    groups = np.array([group_of.get(joint, "") for joint in robot.joint_names], dtype=str)
    coords["joint_group"] = ("joint", groups, {"long_name": "sub-assembly of the joint"})
    return coords


def write_run(
    folder: Path,
    dataset: xr.Dataset | Variables,
    manifest: Mapping[str, Any],
    *,
    replace: bool = False,
    texts: Mapping[str, str | bytes] | None = None,
    more: Callable[[Path], object] = lambda _: None,
) -> None:
    """Write the folder of a result with a dataset; `texts` are additional files by name, and `more` writes others."""

    def write(draft: Path) -> None:
        if isinstance(dataset, Variables):
            write_variables(draft / RUN_FILE, dataset)
        else:
            write_netcdf(draft / RUN_FILE, dataset)
        for name, text in (texts or {}).items():
            write_bytes(draft / name, text if isinstance(text, bytes) else text.encode())
        more(draft)

    write_result(folder, manifest, write, replace=replace)


def write_result(
    folder: Path,
    manifest: Mapping[str, Any],
    write: Callable[[Path], object],
    *,
    replace: bool = False,
    named: str = MANIFEST_FILE,
) -> None:
    """Write a whole result folder at once: what `write` puts into it, and the manifest with checksums of that."""
    with complete_folder(folder, replace=replace) as draft:
        write(draft)
        files = checksums(draft)
        write_json(draft / named, {**manifest, "files": files})
        if replace and folder.exists() and (others := set(unrelated_files(folder)) - set(files)):
            raise Refused(f"{folder.name} holds more than a result ({min(others)}), so it is not replaced")


def read_manifest(folder: Path, form: Any = documents.Manifest) -> dict[str, Any] | None:
    """Return the manifest of a finished result, or `None` if there is none of this form."""
    try:
        return read_json(_manifest_of(folder), form)
    except Refused:
        return None


def _manifest_of(folder: Path) -> Path:
    sweep = folder / SWEEP_FILE
    return sweep if os.path.lexists(sweep) else folder / MANIFEST_FILE


def files_of(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Return the checksums of the files of a result, by its manifest; older sweeps have them in a table of it."""
    return dict(manifest.get("files") or manifest.get("finished", {}).get("files") or {})


def find_existing(
    folder: Path, identity: Identity, form: Any, *, overwrite: bool, quiet: bool = False
) -> dict[str, Any] | None:
    """Return the manifest of a finished result of this identity; `None` if there is none, or it is to be replaced.

    A result of another identity, and a damaged one, are refused without `overwrite`. It says so unless `quiet`.
    """
    finished = None if overwrite else read_manifest(folder, form)
    if finished is None or identity.difference(finished) == ANOTHER:
        check_replaceable(folder, lambda _: False, overwrite=overwrite)
        return None
    shown = os.path.relpath(folder)
    if name := find_damaged(folder, files_of(finished)):
        raise Refused(f"{shown}/{name} is not what was written there; --overwrite makes it again")
    if difference := identity.difference(finished):
        raise Refused(f"{shown} was made by {difference}; --overwrite makes it again")
    commit = (finished.get("git") or {}).get("commit") or "unknown"
    if not quiet:
        print(f"{shown} is finished already (commit {commit[:10]}); --overwrite makes it again")
    return finished


def check_replaceable(folder: Path, is_equal: Callable[[Mapping[str, Any]], bool], *, overwrite: bool) -> None:
    """Refuse to replace what is more than a result, or, without `overwrite`, another one.

    `is_equal` says of a manifest whether its configuration is the same.
    """
    if not os.path.lexists(folder):
        return
    shown, finished = os.path.relpath(folder), read_manifest(folder)
    if not overwrite and (finished is None or not is_equal(finished)):
        what = f"no finished result{_damage(folder)}" if finished is None else "the result of another configuration"
        raise Refused(f"{shown} holds {what}; choose another name or --out, or --overwrite it")
    if others := unrelated_files(folder):
        raise Refused(f"{shown} holds more than a result ({others[0]}), so it is not overwritten")


def _damage(folder: Path) -> str:
    """Return what is wrong with the manifest of a folder, in parentheses; empty if it is whole or not there."""
    path = _manifest_of(folder)
    try:
        if os.path.lexists(path):
            read_json(path, documents.Manifest)
    except Refused as reason:
        return f" ({reason})"
    return ""


def unrelated_files(folder: Path) -> list[str]:
    """Return the files in a folder that its manifest does not list; replacing the result would delete them.

    A file in the folder's place is such a one.
    """
    if folder.is_file():
        return [folder.name]
    kinds = [*KINDS.values()]
    own = {kind.manifest for kind in kinds} | {name for kind in kinds for name in kind.files}
    own |= files_of(read_manifest(folder) or {}).keys()
    paths = (path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir())
    return sorted(path for path in paths if path not in own)

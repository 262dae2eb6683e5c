"""One kind of experiment: a closed-loop flight, from configuration to result folder."""

from __future__ import annotations

import functools
import os
import time
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jax_aero import backends, rust
from jax_aero.base import documents, places, typed_config
from jax_aero.base.files import lock_work
from jax_aero.base.terminal import Refused, progress_bar
from jax_aero.results import manifest, record, study
from jax_aero.results.identity import Identity, computed_by

PAPER_RUNS = tuple(
    f"{name}{arms}" for arms in ("", "_published") for name in ("test1", "test2", "test3", "test4", "robustness")
)
"""The paper's flights, with corrected and with published lever arms."""


def folder_of(name: str) -> Path:
    """Return the folder of the result of this name."""
    return places.RESULTS / "flight" / name


def obtain(name: str) -> Path:
    """Return the file of a flight by its name; that of an experiment is flown if it is not there, or not of today."""
    path = folder_of(name) / places.RUN_FILE
    if name in places.names("experiments"):
        run(study.find("experiments", name), {}, command=["jax-aero", "fly", name], renew=True)
    elif not path.is_file():
        raise Refused(f"no flight `{name}`; fly it with: jax-aero fly {name}")
    return path


def identity_of(config: rust.Config) -> Identity:
    """Return the identity of the flight of a configuration."""
    return Identity(rust.config_digest(config), computed_by(backends.backend_of(config)))


def run(
    path: Path,
    changes: Mapping[str, Any],
    *,
    command: Sequence[str],
    named: str | None = None,
    out: Path | None = None,
    overwrite: bool = False,
    renew: bool = False,
    config: rust.Config | None = None,
) -> dict[str, Any]:
    """Fly one configuration and write its folder, unless it is already there; return the manifest.

    It is that of a file with its changes, or `config` in its place. A result of another identity is refused, or
    replaced with `overwrite` or `renew`; the former replaces any.
    Warnings about the configuration and the files of its robot are stored in the manifest.
    """
    if out:
        name = named or path.stem
    else:
        name = study.folder_name("experiments", study.result_name("experiments", path), changes, named)
    try:
        with warnings.catch_warnings(record=True) as raised:
            warnings.simplefilter("always")
            config = rust.load_config(path, changes) if config is None else config
            robot = rust.Robot(config["robot"])
    except ValueError as reason:
        raise Refused(f"{path.stem}: {reason}") from None
    warned = [str(warning.message) for warning in raised]
    for text in warned:
        warnings.warn(text, stacklevel=2)
    folder = out / name if out else folder_of(name)
    identity, backend = identity_of(config), backends.backend_of(config)
    with lock_work(folder):
        if renew:
            overwrite = bool(identity.difference(record.read_manifest(folder) or {}))
        finished = record.find_existing(folder, identity, documents.Flight, overwrite=overwrite)
        if finished is not None:
            return finished
        started = time.perf_counter()
        try:
            flight = _fly(config, name)
        except ValueError as reason:  # a back end that does not support a setting
            raise Refused(f"{name}: {reason}") from None
        document = manifest.build(
            name,
            config.get("title") or name,
            config,
            identity,
            summary=flight.summary,
            command=command,
            backend=backend,
            outcome=flight.outcome,
            lost_time=flight.lost_time,
            lost_reason=flight.lost_reason,
            overrides=manifest.make_portable(changes),
            warnings=[_portable_warning(text) for text in warned] or None,
            seed=dict(manifest.seeds(config)) or None,
            wall_time_s=round(time.perf_counter() - started, 3),
        )
        dataset = record.to_variables(
            flight, robot, title=document["title"], config_digest=identity.digest, backend=backend
        )
        copy = functools.partial(typed_config.copy_outside, config)
        record.write_run(folder, dataset, document, replace=overwrite, more=copy)
    print(os.path.relpath(folder / places.RUN_FILE))
    return document


def _portable_warning(text: str) -> str:
    """Return a warning that may begin with a file, without the place of that file on this machine."""
    file, separator, words = text.partition(": ")
    return f"{manifest.make_portable(file)}{separator}{words}"


def _fly(config: rust.Config, name: str) -> rust.FlightResult:
    with progress_bar("tick", name) as show:
        return backends.backend(backends.backend_of(config)).fly(config, show)

"""Improve gains and weights of a controller by gradients through short flights in many worlds.

A configuration names a controller, the keys whose values are tuned, and a sweep of sampled design whose cells are the
worlds: wind, noise, errors of the controller's model. Every step uses new worlds; the answer is chosen on
worlds that no step uses. The result contains the tuned controller, a file based on the original one. An interrupted
run is resumed by the same command. Compilation takes minutes, once if JAX_COMPILATION_CACHE_DIR is set.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import jax
import msgspec
import numpy as np
import xarray as xr

from experiments import study
from experiments.identity import Identity
from experiments.study import Findings, Study
from experiments.sweep import spec
from experiments.sweep.design import Design
from experiments.work import Work
from jax_aero import rust
from jax_aero.base import keys, places, plain, tables
from jax_aero.base.terminal import ConfigError, Refused
from jax_aero.sim.batch import Group, group_flights
from jax_aero.train.gains import Cost, Sample, Steps, TuningResult, gradients, tune


class TuneConfig(tables.Table, frozen=True):
    """One file of `experiments/studies/tune/`."""

    title: str
    controller: Path
    """Controller whose values are tuned."""
    worlds: Path
    """A sweep of sampled design: each world is a cell with its own perturbation."""
    keys: Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]
    """Values of the controller: numbers, or lists or tables of numbers that it holds as one array (`posture_gain`,
    `weights.thrust_rate`); each is multiplied by one factor, common to all entries of a list or table."""
    duration: tables.Positive
    """Duration of a flight [s]."""
    cost: Cost
    steps: Steps
    seed: tables.Seed = 1
    """Seed of the worlds; those of the validation use the next one."""

    def __post_init__(self) -> None:
        if len(set(self.keys)) < len(self.keys):
            raise ConfigError.of("keys", self.keys, "each key once")


def compute(name: str, config: TuneConfig, work: Work) -> Findings:
    """Tune, resuming an interrupted run."""
    controller = rust.load_controller(config.controller)
    for key in config.keys:
        if keys.get(controller, key) is None:
            raise Refused(f"{name}.toml: `{key}` in keys is no value of {config.controller.name}")
    worlds = spec.load(str(config.worlds))
    if not worlds.is_sampled:
        raise Refused(f"{config.worlds.name} is a {worlds.design}; expected a sampled design")
    base = rust.load_config(worlds.base)
    work = work.narrowed(Identity(rust.config_digest(base)))
    with jax.enable_x64(True):
        found = tune(
            _sample(config, controller, worlds),
            len(config.keys),
            config.steps,
            checkpoint=work.path("steps"),
            digest=work.of,
        )
    before, after = found.validations[0], min(found.validations, key=lambda one: one.cost)
    factors = {key: math.exp(value) for key, value in zip(config.keys, after.logarithms, strict=True)}
    summary: dict[str, Any] = {
        "cost of unseen worlds, before": math.exp(before.cost),
        "cost of unseen worlds, tuned": math.exp(after.cost),
        "steps to the tuned values": after.step,
        "worlds left out of steps": sum(found.left_out) / (config.steps.count * config.steps.batch),
        **{f"factor of {key}": factor for key, factor in factors.items()},
    }
    texts = {f"{name}.toml": tuned_controller(config, controller, factors, work.folder.with_name(name))}
    flights = {places.name_of(worlds.base): base}
    return Findings(config.title, to_dataset(config, found), summary, flights=flights, texts=texts)


STUDY = Study(
    "tune",
    __doc__,
    TuneConfig,
    compute,
    ("aero_aware",),
    backend="jax",
    resumes=True,
)
main = STUDY.main


def world(worlds: Design, number: int, controller: Mapping[str, Any], duration: float) -> rust.Config:
    """Return the configuration of one world."""
    config = worlds.cell_config(number)
    worlds.perturb(config, number)
    simulator = {**config["simulator"], "duration": duration}
    return {**config, "simulator": simulator, "controller": controller}


def _sample(config: TuneConfig, controller: Mapping[str, Any], worlds: spec.Spec) -> Sample:
    steps = config.steps

    def draw_design(samples: int, seed: int) -> Design:
        return Design(msgspec.structs.replace(worlds, samples=samples, seed=seed))

    training = draw_design(steps.count * steps.batch, config.seed)
    unseen = draw_design(steps.validation, config.seed + 1)

    def group(step: int) -> Group:
        design, first = (training, step) if step >= 0 else (unseen, -1 - step)
        numbers = range(first * steps.batch, (first + 1) * steps.batch)
        groups = group_flights(world(design, number, controller, config.duration) for number in numbers)
        if len(groups) > 1:
            raise Refused(f"{config.worlds.name}: its worlds differ in more than numbers; expected one structure")
        return groups[0]

    return lambda theta, step: gradients(theta, group(step), config.keys, config.cost)


def tuned_controller(
    config: TuneConfig, controller: Mapping[str, Any], factors: Mapping[str, float], folder: Path
) -> str:
    """Return the file of the tuned controller, for this folder and based on the original one."""
    table: dict[str, Any] = {}
    for key, factor in factors.items():
        keys.set_key(table, key, _times(keys.get(controller, key), factor))
    lines = [
        f"#:schema {study.schema_of('control', folder)}",
        f"# {config.controller.name} with values tuned by gradient: `jax-aero study tune {folder.name}`. Ours.",
        f'base = "{os.path.relpath(config.controller, folder.resolve())}"',
    ]
    return "\n".join([*lines, "", plain.toml(table)]) + "\n"


def _times(value: Any, factor: float) -> Any:
    """Return a value times a factor, rounded to four digits."""
    if isinstance(value, Mapping):
        return {name: _times(entry, factor) for name, entry in value.items()}
    if isinstance(value, Sequence):
        return [_times(entry, factor) for entry in value]
    return float(f"{value * factor:.4g}")


def to_dataset(config: TuneConfig, found: TuningResult) -> xr.Dataset:
    """Return costs and factors along the run as a labelled dataset."""
    looks = found.validations
    return xr.Dataset(
        {
            "cost": ("step", np.exp(found.costs), {"units": "1", "long_name": "geometric mean of a step's worlds"}),
            "left_out": ("step", list(found.left_out), {"units": "1", "long_name": "worlds left out of a step"}),
            "unseen_cost": (
                "validation",
                np.exp([look.cost for look in looks]),
                {"units": "1", "long_name": "geometric mean of worlds that no step sees"},
            ),
            "factor": (
                ("validation", "key"),
                np.exp([look.logarithms for look in looks]),
                {"units": "1", "long_name": "factor on the original value"},
            ),
        },
        {
            "step": np.arange(len(found.costs)),
            "validation": ("validation", [look.step for look in looks], {"units": "1", "long_name": "steps done"}),
            "key": list(config.keys),
        },
    )

"""Configuration of a training run: typed settings from a TOML file."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
from msgspec import Meta

from jax_aero.aero.network import Activation, Frame, Layout, Network, check_output, init_network
from jax_aero.base import tables
from jax_aero.base.keys import set_key
from jax_aero.base.network_inputs import Block
from jax_aero.base.terminal import ConfigError
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.train import Settings


class NetworkConfig(tables.Table, frozen=True):
    """Structure of a network."""

    features: Annotated[tuple[Block, ...], Meta(min_length=1)]
    """Blocks of input features."""
    hidden: tuple[tables.Count, ...]
    """Widths of the hidden layers."""
    activation: Activation
    frame: Frame
    """Axes of the output."""
    layout: Layout
    """Layout of the output."""
    mirror: bool
    """Whether the network is symmetric by construction."""
    baseline: str
    """Coefficient set that the network corrects, or `none`."""
    start: Literal["published", "unit"]
    """Distribution of the initial weights."""

    def __post_init__(self) -> None:
        check_output(self.frame, self.layout)
        tables.check_levels(self, "features")  # a card has each block once


class Ensemble(tables.Table, frozen=True):
    """Several networks with different random numbers."""

    members: tables.Count
    keep: Literal["mean", "student"]
    """Final network: the mean of the members, or one network distilled from it."""


class Distillation(tables.Table, frozen=True):
    """Distillation of one network from the mean of several."""

    samples: tables.Count
    spread_deg: tables.NonNegative
    """Standard deviation of the postures about those of the dataset [deg]."""
    training: Settings


class Validation(tables.Table, frozen=True):
    """Rows that are held out."""

    fraction: Annotated[float, Meta(gt=0.0, lt=1.0)]
    random_seeds: tuple[tables.Seed, ...]
    folds: tables.Count
    folds_run: tables.Count
    fold_seeds: tuple[tables.Seed, ...]

    def __post_init__(self) -> None:
        for name in ("random_seeds", "fold_seeds"):
            if len(set(seeds := getattr(self, name))) < len(seeds):
                raise ConfigError.of(name, seeds, "each seed once")
        if self.folds_run > self.folds:
            raise ConfigError.of("folds_run", self.folds_run, f"at most {self.folds}, which is `folds`")


class Training(tables.Table, frozen=True):
    """One file of `configs/training/`."""

    title: str
    description: str
    robot: Path
    """Robot of the dataset."""
    seed: tables.Seed
    mirrored: bool
    """Whether mirror images are added to the rows."""
    final: bool
    """Whether a network is finally trained on all rows."""
    chosen_on: tuple[str, ...]
    """Postures whose errors were used to choose these settings."""
    network: NetworkConfig
    training: Settings
    ensemble: Ensemble
    validation: Validation
    distillation: Distillation | None = None
    """Settings for `ensemble.keep = "student"`."""

    def __post_init__(self) -> None:
        known = ("none", *self.robot_model.aero_links.coefficients)
        if (name := self.network.baseline) not in known:
            raise ConfigError.of("network.baseline", name, f"one of {', '.join(known)}")
        if (self.ensemble.keep == "student") != (self.distillation is not None):
            stated = "given" if self.distillation else "absent"
            raise ConfigError.of("distillation", stated, "a table with `ensemble.keep = student`, and only there")

    @property
    def robot_model(self) -> RobotModel:
        """The robot."""
        return _load_robot(self.robot)

    @property
    def epochs(self) -> int:
        """Epochs of one part, summed over members and student."""
        return self.ensemble.members * self.training.epochs + (
            self.distillation.training.epochs if self.distillation else 0
        )

    def start(self, seed: int) -> Network:
        """Return a network with random weights."""
        robot = self.robot_model
        shape = self.network
        rows = None if shape.baseline == "none" else robot.aero_links.coefficients[shape.baseline]
        return init_network(
            jax.random.key(seed),
            robot,
            hidden=shape.hidden,
            blocks=shape.features,
            activation=shape.activation,
            mirror=shape.mirror,
            frame=shape.frame,
            layout=shape.layout,
            baseline=rows,
            start=shape.start,
        )


def read(path: Path, changes: Mapping[str, Any] | None = None) -> tuple[Training, dict[str, Any]]:
    """Read and check a file, with some keys changed; return it as typed settings and as a table."""
    table = tables.read(path)
    for key, value in (changes or {}).items():
        set_key(table, key, value)
    return tables.convert(table, Training, path.name, path.parent), table


_load_robot = functools.cache(load_robot)

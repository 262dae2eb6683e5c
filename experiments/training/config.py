"""A training run's configuration: TOML in, typed settings out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import jax

from experiments import Refused, manifest, study
from jax_aero.aero.network import ACTIVATIONS, BLOCKS, Network, check_output, init_network
from jax_aero.keys import get, set_key
from jax_aero.robot import RobotModel, load_robot
from jax_aero.train import Settings

ROBOT = manifest.REPOSITORY / "configs" / "robot" / "ironcub_mk1.toml"

NUMBER = (int, float)
NETWORK = {
    "features": list,
    "hidden": list,
    "activation": str,
    "frame": str,
    "layout": str,
    "mirror": bool,
    "baseline": str,
    "start": str,
}
TRAINING = {
    "epochs": int,
    "learning_rate": NUMBER,
    "batch": int,
    "schedule": str,
    "warm_up": int,
    "beta2": NUMBER,
    "weight_decay": NUMBER,
    "dropout": NUMBER,
    "noise": dict,
    "matmul": str,
    "scale_output": bool,
    "validate_every": int,
    "patience": int,
}
ENSEMBLE = {"members": int, "keep": str}
DISTILLATION = {"samples": int, "spread_deg": NUMBER, "training": TRAINING}
VALIDATION = {"fraction": NUMBER, "random_seeds": list, "folds": int, "folds_run": int, "fold_seeds": list}
KEYS = {
    "title": str,
    "description": str,
    "seed": int,
    "mirrored": bool,
    "final": bool,
    "chosen_on": list,
    "network": NETWORK,
    "training": TRAINING,
    "ensemble": ENSEMBLE,
    "validation": VALIDATION,
}


@dataclass(frozen=True)
class Distillation:
    """How one network learns from the mean of several."""

    samples: int
    spread_deg: float
    settings: Settings


@dataclass(frozen=True)
class Validation:
    """What is held out."""

    fraction: float
    random_seeds: tuple[int, ...]
    folds: int
    folds_run: int
    fold_seeds: tuple[int, ...]


@dataclass(frozen=True)
class Training:
    """One file of `configs/training/`."""

    title: str
    description: str
    seed: int
    is_mirrored: bool
    """Whether mirror images are added to the rows."""
    has_final: bool
    """Whether a network is trained on all rows in the end."""
    chosen_on: tuple[str, ...]
    """Postures whose errors were looked at when these settings were chosen."""
    network: Mapping[str, Any]
    settings: Settings
    members: int
    keep: str
    """What becomes of several members: `mean`, or `student`, one network that is taught by them."""
    distillation: Distillation | None
    validation: Validation

    @property
    def epochs(self) -> int:
        """Epochs of one part, all members and the student together."""
        return self.members * self.settings.epochs + (self.distillation.settings.epochs if self.distillation else 0)

    def start(self, robot: RobotModel, seed: int) -> Network:
        """Return a network with random weights."""
        shape = self.network
        rows = None if shape["baseline"] == "none" else robot.aero_links.coefficients[shape["baseline"]]
        return init_network(
            jax.random.key(seed),
            robot,
            hidden=tuple(shape["hidden"]),
            blocks=tuple(shape["features"]),
            activation=shape["activation"],
            mirror=shape["mirror"],
            frame=shape["frame"],
            layout=shape["layout"],
            baseline=rows,
            start=shape["start"],
        )


def read(path: Path, changes: Mapping[str, Any] | None = None) -> tuple[Training, dict[str, Any]]:
    """Read and check a file, with some keys changed; return it typed, and as a table."""
    table = study.read(path)
    for key, value in (changes or {}).items():
        change(table, key, value)
    return parse(path, table), table


def change(table: dict[str, Any], key: str, value: Any) -> None:
    """Set a dotted key that the file has."""
    if get(table, key) is None:
        raise Refused(f"--set {key}: there is no such key in the file")
    set_key(table, key, value)


def parse(path: Path, table: Mapping[str, Any]) -> Training:
    """Check a table and return it typed."""
    has_student = isinstance(table.get("ensemble"), Mapping) and table["ensemble"].get("keep") == "student"
    study.check_keys(path, table, KEYS | ({"distillation": DISTILLATION} if has_student else {}))
    try:
        _check_network(table["network"])
        ensemble, held = table["ensemble"], table["validation"]
        _check_rest(ensemble, held)
        student = table.get("distillation")
        return Training(
            title=table["title"],
            description=table["description"],
            seed=table["seed"],
            is_mirrored=table["mirrored"],
            has_final=table["final"],
            chosen_on=tuple(table["chosen_on"]),
            network=table["network"],
            settings=_settings(table["training"]),
            members=ensemble["members"],
            keep=ensemble["keep"],
            distillation=student
            and Distillation(student["samples"], float(student["spread_deg"]), _settings(student["training"])),
            validation=Validation(
                fraction=float(held["fraction"]),
                random_seeds=tuple(held["random_seeds"]),
                folds=held["folds"],
                folds_run=held["folds_run"],
                fold_seeds=tuple(held["fold_seeds"]),
            ),
        )
    except ValueError as reason:
        raise Refused(f"{path.name}: {reason}") from None


def _check_rest(ensemble: Mapping[str, Any], held: Mapping[str, Any]) -> None:
    if ensemble["keep"] not in ("mean", "student") or ensemble["members"] < 1:
        raise ValueError(f"`ensemble` is {ensemble}; expected 1 or more members, and keep mean or student")
    if not 1 <= held["folds_run"] <= held["folds"] or not 0.0 < held["fraction"] < 1.0:
        raise ValueError(f"`validation` is {held}; expected folds_run from 1 to folds, fraction between 0 and 1")


def _check_network(shape: Mapping[str, Any]) -> None:
    if not shape["features"] or set(shape["features"]) - set(BLOCKS):
        raise ValueError(f"`network.features` is {shape['features']}; expected some of {', '.join(BLOCKS)}")
    if shape["activation"] not in ACTIVATIONS:
        raise ValueError(f"`network.activation` is {shape['activation']!r}; expected one of {', '.join(ACTIVATIONS)}")
    if not all(isinstance(width, int) and width > 0 for width in shape["hidden"]):
        raise ValueError(f"`network.hidden` is {shape['hidden']}; expected positive widths")
    if shape["baseline"] not in ("none", *(sets := robot().aero_links.coefficients)):
        raise ValueError(f"`network.baseline` is {shape['baseline']!r}; expected none, or one of {', '.join(sets)}")
    if shape["start"] not in ("published", "unit"):
        raise ValueError(f"`network.start` is {shape['start']!r}; expected published or unit")
    check_output(shape["frame"], shape["layout"])


def _settings(table: Mapping[str, Any]) -> Settings:
    values: dict[str, Any] = {item.name: table[item.name] for item in fields(Settings)}
    values["noise"] = tuple(sorted((block, float(std)) for block, std in table["noise"].items()))
    return Settings(**values)


def robot() -> RobotModel:
    """Return the robot whose links the datasets describe."""
    return load_robot(ROBOT)

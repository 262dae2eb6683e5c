"""Learn the air from logs of flights: `jax-aero train flights LOG ...`.

LOG is what `jax-aero replay` reads: a result of `jax-aero fly`, an MCAP, MATLAB or CSV file, with a measured wind. The
network's total force and moment are fitted to the wrench that a disturbance observer estimates without an aerodynamic
model; logs of other controllers are replayed through one. Whole flights are held out and judge: nothing, the robot's
coefficients, coefficients fitted to the same flights, and the network.

`results/training_flights/NAME/` holds the card of the network, NAME.json, and that of the coefficients, refit.json;
`--set controller.aero` takes either. Forces of single links are not determined by total wrenches. An interrupted run is
resumed by the same command.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from msgspec import Meta, structs
from tqdm import tqdm

from jax_aero import rust
from jax_aero.aero.network import Network, init_network
from jax_aero.aero.network_card import save_network
from jax_aero.base import arguments, documents, places, tables
from jax_aero.base.arguments import Parser, complete_with
from jax_aero.base.cards import card_path, copy_card
from jax_aero.base.files import lock_work, resolve
from jax_aero.base.keys import parse_assignments, set_key
from jax_aero.base.terminal import ConfigError, Refused, exit_status, terminal
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.results import manifest, record, study
from jax_aero.results.changes import folder_suffix
from jax_aero.results.identity import Identity
from jax_aero.results.table import text_table
from jax_aero.results.work import Work
from jax_aero.train import flights as observed
from jax_aero.train import refit
from jax_aero.train.config import NetworkConfig
from jax_aero.train.flights import Flight, Sampling
from jax_aero.train.loop import FitResult, Settings, fit
from jax_aero.train.parts import mean_of
from jax_aero.train.wrench import ObservedWrenches, Windows
from jax_aero.view import logs

KIND = "training_flights"
NOTE = (
    "Learnt from total forces and moments: the forces of single links are not determined by them, and what the links "
    "say beside their sum is a guess. Winds and postures that no flight had are unknown to it (`known`)."
)


class SamplingConfig(tables.Table, frozen=True):
    """How rows are taken from flights."""

    step: tables.Positive
    """Time between rows [s]."""
    window: tables.Positive
    """Longest window that has constants of its own [s]."""
    settling: tables.NonNegative
    """Time at its start that does not count [s]."""


class Observed(tables.Table, frozen=True):
    """What is known of observed wrenches beforehand; see `jax_aero.train.wrench`."""

    noise: tuple[tables.Positive, tables.Positive]
    """Standard deviation of a force and a moment [N, N m]."""
    constants: tuple[tables.NonNegative, tables.NonNegative, tables.NonNegative]
    """Standard deviation of constant force and moment on the base, and of the weight [N, N m, N]."""
    area: tables.Positive
    """Usual size of what is learnt of a link's force area [m²]."""
    shrink: tables.NonNegative
    """Weight of the squares of what is learnt."""


class FlightTraining(tables.Table, frozen=True):
    """One file of `configs/training_flights/`."""

    title: str
    description: str
    seed: tables.Seed
    members: tables.Count
    """Networks whose mean is the result."""
    held_out: Annotated[float, Meta(ge=0.0, lt=1.0)]
    """Share of the flights that judges."""
    air_density: tables.Positive
    """[kg/m³]"""
    network: NetworkConfig
    training: Settings
    sampling: SamplingConfig
    observed: Observed

    def start(self, robot: RobotModel, seed: int) -> Network:
        """Return a network with random weights."""
        shape = self.network
        known = ("none", *robot.aero_links.coefficients)
        if shape.baseline not in known:
            raise ConfigError.of("network.baseline", shape.baseline, f"one of {', '.join(known)}")
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
            baseline=None if rows is None else jnp.asarray(rows, jnp.float32),
            start=shape.start,
        )

    def objective(self, gain: tuple[float, float]) -> ObservedWrenches:
        """Return what is minimised, for an observer's gains."""
        of = self.observed
        shape = self.network
        return ObservedWrenches(
            shape.frame, shape.layout, gain, self.sampling.step, of.noise, of.constants, of.area, of.shrink
        )

    def rows(self, every: Sequence[Flight]) -> Sampling:
        """Return how rows are taken from flights, in windows no longer than the shortest one."""
        shortest = min(len(flight.turn) * flight.step for flight in every)
        return Sampling(self.sampling.step, min(self.sampling.window, shortest), self.sampling.settling)


class Learnt(NamedTuple):
    """What was learnt from flights."""

    network: Network
    refit: Network
    """Coefficients fitted to the same flights, as a network that is its baseline alone."""
    members: list[FitResult]
    held_out: list[int]
    """Numbers of the flights that judge."""
    errors: dict[str, tuple[float, float]]
    """Root mean squares of what models leave of the observed force and moment [N, N m], of flights held out or, if none
    is, of all."""


def main(words: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = Parser("train flights", __doc__)
    parser.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="result, or .mcap, .mat or .csv file")
    about = "settings, a file stem in configs/training_flights, or a path (default hover)"
    complete_with(
        parser.add_argument("--base", default="hover", metavar="NAME", help=about), lambda: places.names(KIND)
    )
    about = "experiment with the controller of the logs (default: what the first log was flown with)"
    parser.add_argument("--experiment", metavar="NAME", help=about)
    parser.add_argument("--robot", metavar="FILE", help="robot file (default: that of the experiment)")
    parser.add_argument("--map", type=Path, metavar="FILE", help="TOML file that names the columns of logs of others")
    study.add_set(parser, 'network.baseline="corrected"')
    arguments.add_name(parser, "that of the settings")
    parser.add_argument("--out", type=Path, metavar="DIR", help=f"result folder (default results/{KIND}/NAME)")
    parser.add_argument("--write", type=Path, metavar="CARD", help="also write weights and card there (…/NAME.json)")
    parser.add_argument("--overwrite", action="store_true", help="train again and replace an existing result")
    given = parser.parse_args(words)
    return exit_status(lambda: run(given), interrupted="the same command goes on where this one stopped")


def read_settings(path: Path, changes: Mapping[str, Any]) -> tuple[FlightTraining, dict[str, Any]]:
    """Read and check a file, with some keys changed; return it as typed settings and as a table."""
    table = tables.read(path)
    for key, value in changes.items():
        set_key(table, key, value)
    return tables.convert(table, FlightTraining, path.name, path.parent), table


def run(given: argparse.Namespace) -> None:
    """Read the logs, train, and write the result, unless it exists."""
    path, changes = study.find(KIND, given.base), parse_assignments(given.set)
    settings, table = read_settings(path, changes)
    if given.write:
        card_path(given.write)  # a wrong path is refused before the training
    config, every = read_logs(given.logs, given.map, given.experiment, given.robot, settings.air_density)
    robot = load_robot(config["robot"])
    settings.start(robot, 0)  # a wrong baseline too
    name = given.named or study.result_name(KIND, path) + folder_suffix(changes)
    folder = resolve(given.out or places.RESULTS / KIND / name)
    digest = digest_of(every)
    identity = Identity.of({"settings": table, "flights": digest}, [Path(config["robot"])])
    with lock_work(folder):
        trained = record.find_existing(folder, identity, documents.Manifest, overwrite=given.overwrite)
        if trained is None:
            trained = _train(given, settings, table, identity, every, robot, folder, digest)
    if given.write:
        copy_card(folder / f"{folder.name}.json", given.write)
    print(report(trained["summary"]))
    print(f"{manifest.make_portable(folder)}: {folder.name}.json, refit.json")


def read_logs(
    paths: Sequence[Path], mapping: Path | None, experiment: str | None, robot_file: str | None, air_density: float
) -> tuple[rust.Config, list[Flight]]:
    """Return the configuration of the robot, and what logs hold of the air; refuse those of different robots."""
    named = None if experiment is None else rust.load_config(experiment)
    first, flights = named, []
    for path in paths:
        own = None if path.suffix.lower() in logs.FORMATS and named else logs.read(path, named, mapping, None).config
        config = dict(named or own or {})
        if not config:
            raise Refused(f"`{path}` does not hold the configuration of a flight; expected --experiment NAME")
        first = first or config
        expected = str(Path(robot_file or first["robot"]).resolve())
        _check_robot(path, own, expected)
        config["robot"] = expected
        flights.append(observed.read(path, mapping, config, load_robot(expected), air_density))
    assert first is not None  # there is at least one log
    if len({(flight.gain, flight.step) for flight in flights}) > 1:
        raise Refused("logs have observers of different gains or periods; expected one, or --experiment NAME")
    return {**first, "robot": str(Path(robot_file or first["robot"]).resolve())}, flights


def _check_robot(path: Path, own: rust.Config | None, expected: str) -> None:
    """Refuse a log of another robot than the expected one, as its configuration has it."""
    if own is None:
        return
    names = [rust.Robot(file).joint_names for file in (own["robot"], expected)]
    if names[0] != names[1] or rust.Robot(own["robot"]).mass != rust.Robot(expected).mass:
        raise Refused(
            f"`{path}` is of {Path(own['robot']).name}; expected {Path(expected).name}, as the first log or --robot"
        )


def digest_of(every: Sequence[Flight]) -> str:
    """Return a digest of what logs hold of the air."""
    total = hashlib.sha256()
    for flight in every:
        for part in flight[1:]:
            total.update(np.ascontiguousarray(part).tobytes())
    return total.hexdigest()


def learn(
    settings: FlightTraining, every: Sequence[Flight], robot: RobotModel, work: Work | None = None, bar: Any = None
) -> Learnt:
    """Learn the air from flights; `work` keeps checkpoints."""
    objective, start = settings.objective(every[0].gain), settings.start(robot, settings.seed)
    order = np.random.default_rng(settings.seed).permutation(len(every))
    held_out = sorted(order[: min(round(settings.held_out * len(every)), len(every) - 1)].tolist())
    rows = settings.rows(every)

    def windows(flights: Sequence[Flight]) -> Windows:
        return observed.windows(flights, start, robot, objective, rows)

    training = windows([flight for number, flight in enumerate(every) if number not in held_out])
    judging = windows([every[number] for number in held_out]) if held_out else None
    batch = min(settings.training.batch or len(training.x), len(training.x))
    members = []
    for member in range(settings.members):
        seed = settings.seed + member

        def on_epoch(epoch: int, train: float, error: float | None, member: int = member) -> None:
            if bar is not None:
                shown = {"loss": f"{train:.3f}"} | ({} if error is None else {"held out": f"{error:.3f}"})
                bar.set_postfix(shown, refresh=False)
                bar.update(member * settings.training.epochs + epoch - bar.n)

        members.append(
            fit(
                settings.start(robot, seed),
                training,
                judging,
                structs.replace(settings.training, batch=batch),
                seed,
                objective=objective,
                checkpoint=None if work is None else work.path(f"member-{member}"),
                on_epoch=on_epoch,
            )
        )
    sets = robot.aero_links.coefficients
    zero = np.zeros((robot.aero_links.count, refit.TERMS))
    begin = zero if start.baseline is None else np.asarray(start.baseline, np.float64)
    models = {"nothing": zero} | {name: np.asarray(rows) for name, rows in sets.items()}
    models |= {"refit": refit.refit(robot, training, objective, begin)}
    seen = training if judging is None else judging
    network = mean_of([one.network for one in members])
    left = {name: refit.left(rows, seen, objective) for name, rows in models.items()}
    left["learnt"] = objective.evaluate(network, seen)
    errors = {name: objective.rms(one, seen) for name, one in left.items()}
    return Learnt(network, refit.as_network(robot, models["refit"]), members, held_out, errors)


def _train(
    given: argparse.Namespace,
    settings: FlightTraining,
    table: Mapping[str, Any],
    identity: Identity,
    every: Sequence[Flight],
    robot: RobotModel,
    folder: Path,
    digest: str,
) -> dict[str, Any]:
    """Learn and write the result; return its manifest."""
    started = time.perf_counter(), time.process_time()
    work = Work.on(folder, identity)
    is_quiet = not sys.stderr.isatty()
    with tqdm(
        total=settings.members * settings.training.epochs,
        unit="epoch",
        file=terminal(),
        mininterval=60.0 if is_quiet else 0.1,
        dynamic_ncols=True,
    ) as bar:
        learnt = learn(settings, every, robot, work, bar)
    known = observed.known(every, robot)
    minutes = sum(flight.seconds for flight in every) / 60.0
    summary = {
        "flights": len(every),
        "minutes": minutes,
        "held out": [every[number].name for number in learnt.held_out],
        "left": {name: {"force [N]": f, "moment [N m]": m} for name, (f, m) in learnt.errors.items()},
        "unknown": observed.unknown(known),
        "parameters": learnt.network.parameters,
    }
    facts = {
        "flights": len(every),
        "minutes": round(minutes, 3),
        "flights_sha256": digest,
        "seed": settings.seed,
        "epochs": settings.training.epochs,
        "errors": summary["left"],
        "error_unit": "rms of the observed wrench, less constants of each flight; " + _judged_by(learnt),
        "known": known,
        "note": NOTE,
    }

    def save(draft: Path) -> None:
        cards = {folder.name: (learnt.network, settings.description), "refit": (learnt.refit, REFIT)}
        for name, (network, text) in cards.items():
            save_network(draft / f"{name}.json", network, robot, description=text, training=facts)

    document = manifest.build(
        folder.name,
        settings.title,
        table,
        identity,
        summary=summary,
        command=["jax-aero", "train", "flights", "--base", given.base, *map(str, given.logs), *_options(given)],
        backend="jax",
        dataset=digest,
        timings_s={"this call": time.perf_counter() - started[0], "processor": time.process_time() - started[1]},
    )
    data = to_dataset(learnt, settings.title).assign_attrs(config_hash=identity.digest)
    record.write_run(folder, data, document, replace=given.overwrite, more=save)
    work.clear()
    return document


REFIT = "Axisymmetric coefficients fitted to the wrenches that a disturbance observer saw in flights."


def _judged_by(learnt: Learnt) -> str:
    return "of flights held out" if learnt.held_out else "of the flights trained on"


def _options(given: argparse.Namespace) -> list[str]:
    named = {"--experiment": given.experiment, "--robot": given.robot, "--map": given.map, "--name": given.named}
    options = [word for key, value in named.items() if value is not None for word in (key, str(value))]
    return [*options, *(word for change in given.set for word in ("--set", change))]


def to_dataset(learnt: Learnt, title: str) -> xr.Dataset:
    """Return the loss curves of the members, and what each model leaves."""
    curves = np.array([[[np.nan if v is None else v for v in row] for row in one.curves] for one in learnt.members])
    unit = {"units": "1", "long_name": "mean square of errors over their standard deviations, with priors"}
    return xr.Dataset(
        {
            "epoch": (("curve", "step"), curves[:, :, 0], {"units": "1"}),
            "train_loss": (("curve", "step"), curves[:, :, 1], unit),
            "validation_loss": (("curve", "step"), curves[:, :, 2], unit),
            "left_force": ("model", [force for force, _ in learnt.errors.values()], {"units": "N"}),
            "left_moment": ("model", [moment for _, moment in learnt.errors.values()], {"units": "N m"}),
        },
        {"curve": [f"member-{number}" for number in range(len(curves))], "model": list(learnt.errors)},
        {"title": title},
    )


def report(summary: Mapping[str, Any]) -> str:
    """Return what models leave as a table, and what flights do not know."""
    held_out = len(summary["held out"])
    of = f"of {held_out} of {summary['flights']} flights, held out" if held_out else "of the flights trained on"
    rows = [(f"what is left {of}, rms", "force [N]", "moment [N m]")]
    rows += [(name, *(f"{value:.3g}" for value in left.values())) for name, left in summary["left"].items()]
    unknown = ", ".join(summary["unknown"])
    lines = [text_table(rows), f"{summary['minutes']:.1f} minutes of flight; forces of single links are not determined"]
    return "\n".join([*lines, *([f"unknown: wind from {unknown} (0 ahead, 90 left)"] if unknown else [])])

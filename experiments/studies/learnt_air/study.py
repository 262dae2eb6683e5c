"""The air, learnt from simulated flights, and judged in others: in airs of other families, with a bad anemometer.

`jax-aero study learnt_air NAME` flies robots that are not as their file has them, without an aerodynamic model, in a
true air; `jax-aero train flights` learns it from their logs. The paper's law then flies in other winds with the nominal
model, coefficients fitted to the same flights, what was learnt, and the true air. `merit` is (nominal − learnt) over
(nominal − true) of the medians of the greatest rotation error, a lost flight being the worst; its 95 % interval is a
bootstrap over winds. Errors of wrenches are those in flights that were not learnt from, beside the true ones.

`minutes` learns from 2 to 32 minutes instead, of several kinds of flights, and judges in turbulence. The truth is
always a simulated one.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from experiments.studies.learnt_air import worlds
from jax_aero import rust
from jax_aero.aero.network import Network
from jax_aero.aero.network_card import save_network
from jax_aero.base import places, tables
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.results.study import Findings, Study
from jax_aero.results.work import Work
from jax_aero.train import flights as observed
from jax_aero.train import from_flights, refit
from jax_aero.train.flights import Flight
from jax_aero.train.from_flights import FlightTraining

Array = NDArray[np.float64]

SETTINGS = places.CONFIGS / "training_flights" / "hover.toml"
MODELS = ("nominal", "refit", "learnt", "true")
LEARNERS = ("learnt", "learnt on nominal", "refit")
"""What `minutes` learns: networks from nothing and on the nominal model, and coefficients fitted from the latter."""
FIGURES = {"rotation": ("max_rotation_error", np.degrees(1.0)), "position": ("max_com_error", 100.0)}
"""Figures of merit of a flight, with the factor to degrees and centimetres."""
DRAWS = 2000
"""Of the bootstrap."""
SECONDS = 40.0
"""Length of a flight to learn from [s]."""
STEPS = 750
"""Steps of a training of `minutes`."""
EVERY = 0.1
"""Time between rows at which wrenches are compared [s]."""


class LearntAir(tables.Table, frozen=True):
    """One file of the study."""

    air: Literal["shipped", "other", "spheres"]
    """The shipped network; a network of another family, taught by another solver; spheres and cylinders."""
    anemometers: tuple[Literal["exact", "wrong"], ...] = ("exact", "wrong")
    laws: tuple[str, ...] = ("test2",)
    """Experiments whose law and world fly, from hover."""
    lag: tables.NonNegative = 0.0
    """Time constant with which the true forces follow those of the air [s]; no model knows it."""
    flown: str = "robot"
    """Experiment whose robot is flown without a model to learn from."""
    flights: tables.Count = 24
    """Flights of 40 s to learn from."""
    winds: tables.Count = 256
    """Winds that judge, of each profile."""
    judges: tables.Count = 8
    """Flights whose wrench judges."""
    controls: bool = False
    """Whether winds are also shuffled between flights, and flights without one sector of the wind are learnt from."""
    minutes: tuple[tables.Positive, ...] = ()
    """Minutes of flight to learn from; then flights in turbulence alone judge, beside wrenches."""
    kinds: tuple[Literal["mixed", "hover", "mission", "excited"], ...] = ("mixed",)
    """Kinds of flights of `minutes`."""
    seed: tables.Seed = 1
    """Seed of all draws: that of claims is taken from the commit that states them."""


# --- learning ----------------------------------------------------------------------------------------------------


def settings_of(**changes: Any) -> FlightTraining:
    """Return the frozen settings, without flights held out, since other flights judge."""
    settings, _ = from_flights.read_settings(SETTINGS, {"held_out": 0.0} | changes)
    return settings


class Record:
    """A flight to learn from, or to judge by: what it holds of the air, and the truth."""

    def __init__(self, config: rust.Config, robot: RobotModel, name: str, lag: float = 0.0) -> None:
        flown = worlds.fly(config, None, np.asarray(robot.forward_axis), lag)
        log = dict(flown.log)
        if flown.outcome != "completed":  # what a robot that falls measures is no flight
            log = {key: rows[:-100] for key, rows in log.items()}
        self.flight: Flight = observed.flight_of(name, log, config, robot)
        self.log = log
        self.force = np.asarray(log["aero_force_sim"], np.float64)
        self.rotation = rust.rotation_from_wxyz(log["base_quaternion"])

    def truth(self, rows: NDArray[np.int64], robot: RobotModel) -> Array:
        """Return the true wrench about the centre of mass in some ticks, inertial axes [N, N m]."""
        _, arms = observed.geometry_of(robot, np.asarray(self.log["joint_position"])[rows])
        turned = np.einsum("kij,klj->kli", self.rotation[rows], np.asarray(arms))
        force = self.force[rows]
        return np.concatenate([force.sum(axis=1), np.cross(turned, force).sum(axis=1)], axis=1)


def errors_of(network: Network, judges: Sequence[Record], robot: RobotModel, chosen: Any = None) -> tuple[float, float]:
    """Return root mean squares of the errors of force and moment in flights that judge [N, N m].

    `chosen(flight, rows)` selects ticks.
    """
    off = []
    for judge in judges:
        step = max(1, round(EVERY / judge.flight.step))
        rows = np.flatnonzero(judge.flight.is_valid)[::step]
        rows = rows if chosen is None else rows[chosen(judge.flight, rows)]
        if len(rows):
            off.append(observed.network_wrench(network, judge.flight, rows, robot) - judge.truth(rows, robot))
    square = np.concatenate(off) ** 2
    return float(np.sqrt(square[:, :3].sum(1).mean())), float(np.sqrt(square[:, 3:].sum(1).mean()))


# --- judging -----------------------------------------------------------------------------------------------------


def merit(errors: Mapping[str, Array], rng: np.random.Generator) -> dict[str, float]:
    """Return medians, numbers lost and the figure of merit of errors by model, infinite where a flight was lost."""
    medians = {name: float(np.median(rows)) for name, rows in errors.items()}
    figures = {f"{name}, median": value for name, value in medians.items()}
    figures |= {f"{name}, lost": float(np.isinf(rows).sum()) for name, rows in errors.items()}
    count = len(next(iter(errors.values())))
    drawn = {name: np.empty(DRAWS) for name in errors}
    for draw in range(DRAWS):
        rows = rng.integers(count, size=count)
        for name, values in errors.items():
            drawn[name][draw] = np.median(values[rows])
    for name in errors.keys() - {"nominal", "true"}:
        with np.errstate(invalid="ignore", divide="ignore"):
            value = _share(medians["nominal"], medians[name], medians["true"])
            spread = _share(drawn["nominal"], drawn[name], drawn["true"])
        low, high = (
            np.quantile(spread[np.isfinite(spread)], (0.025, 0.975)) if np.isfinite(spread).any() else (np.nan,) * 2
        )
        figures |= {f"{name}, merit": float(value), f"{name}, merit from": float(low), f"{name}, merit to": float(high)}
    return figures


def _share(nominal: Any, learnt: Any, true: Any) -> Any:
    return (nominal - learnt) / (nominal - true)


def judged(
    asked: LearntAir,
    law: str,
    profile: str,
    anemometer: str,
    air: Mapping[str, Any],
    models: Mapping[str, Any],
    robot: RobotModel,
) -> dict[str, dict[str, list[float]]]:
    """Return rotation and position errors [deg, cm] of all winds by model, infinite for lost flights."""
    forward = np.asarray(robot.forward_axis)
    by_model: dict[str, dict[str, list[float]]] = {}
    for name, model in models.items():
        by_model[name] = {figure: [] for figure in FIGURES}
        for number in range(asked.winds):
            seed = asked.seed + 1000
            errors = worlds.errors_of(seed, number) if anemometer == "wrong" else None
            config = worlds.judging(law, profile, seed, number, air, model)
            flown = worlds.fly(config, errors, forward, asked.lag)
            for figure, (key, factor) in FIGURES.items():
                is_lost = flown.outcome != "completed"
                by_model[name][figure].append(np.inf if is_lost else float(flown.summary[key]) * factor)
    return by_model


# --- the study ---------------------------------------------------------------------------------------------------


def compute(name: str, asked: LearntAir, work: Work) -> Findings:
    """Fly, learn, and judge."""
    robot = load_robot(rust.load_config(asked.flown)["robot"])
    with tempfile.TemporaryDirectory() as kept:
        folder = Path(kept)
        air = worlds.air_of(asked.air, robot, folder)
        if asked.minutes:
            return _minutes(asked, air, robot, folder, work)
        return _cells(name, asked, air, robot, folder, work)


def _records(
    asked: LearntAir, count: int, air: Mapping[str, Any], robot: RobotModel, folder: Path, kind: str, seed: int
) -> list[Record]:
    made = []
    for number in range(count):
        config = worlds.learning(seed, number, count, air, kind, folder, asked.flown)
        made.append(Record(config, robot, f"{kind}-{number}", asked.lag))
    return made


def _nominal(asked: LearntAir) -> dict[str, Any]:
    """Return the aerodynamic model that the robot has without learning."""
    return dict(rust.load_config(asked.flown)["controller"]["aero"])


def _say(text: str) -> None:
    print(f"{time.process_time():.0f} s: {text}", file=sys.stderr, flush=True)


def _cells(
    name: str, asked: LearntAir, air: Mapping[str, Any], robot: RobotModel, folder: Path, work: Work
) -> Findings:
    settings, summary = settings_of(), dict[str, Any]()
    nominal = _nominal(asked)
    began = time.process_time()
    records: list[Record] = []
    judges: list[Record] = []
    errors: dict[tuple[str, str, str], Any] = {}
    cards: dict[str, bytes] = {}
    seconds: dict[str, float] = {}
    for anemometer in asked.anemometers:
        kept = work.read_json(f"learnt-{anemometer}")
        if kept is None:
            if not records:
                records = _records(asked, asked.flights, air, robot, folder, "mixed", asked.seed)
                seconds["flights to learn from"] = time.process_time() - began
                judges = _records(asked, asked.judges, air, robot, folder, "mixed", asked.seed + 500)
                _say(f"{len(records)} flights to learn from, {len(judges)} that judge")
            flights = _seen(asked, records, anemometer, robot)
            start = time.process_time()
            learnt = from_flights.learn(settings, flights, robot)
            seconds[f"learning, {anemometer}"] = time.process_time() - start
            zero = np.zeros((robot.aero_links.count, refit.TERMS))
            coefficients = {"nothing": zero, "nominal": robot.aero_links.coefficients[nominal["coefficients"]]}
            networks = {key: refit.as_network(robot, np.asarray(rows)) for key, rows in coefficients.items()}
            networks |= {"refit": learnt.refit, "learnt": learnt.network}
            wrench = {key: errors_of(network, judges, robot) for key, network in networks.items()}
            if asked.controls and anemometer == "exact":
                wrench |= _controls(settings, networks["nominal"], flights, judges, robot, summary)
            kept = {"wrench": wrench, "cards": {}, "controls": dict(summary)}
            for key in ("refit", "learnt"):
                path = folder / f"{key}_{anemometer}.json"
                text = from_flights.REFIT if key == "refit" else settings.description
                facts = {"flights": len(flights), "note": from_flights.NOTE}
                save_network(path, networks[key], robot, description=text, training=facts)
                for file in (path, path.with_suffix(".safetensors")):
                    kept["cards"][file.name] = file.read_bytes().hex()
            kept["seconds"] = seconds
            work.write_json(f"learnt-{anemometer}", kept)
            _say(f"learnt with the {anemometer} anemometer: {wrench}")
        summary |= kept["controls"]
        seconds |= kept["seconds"]
        for file, content in kept["cards"].items():
            cards[file] = bytes.fromhex(content)
            (folder / file).write_bytes(cards[file])
        for key, (force, moment) in kept["wrench"].items():
            summary[f"wrench, {anemometer}, {key}"] = {"force [N]": force, "moment [N m]": moment}
        models: dict[str, Mapping[str, Any]] = {"nominal": nominal} | {
            key: worlds.card(folder / f"{key}_{anemometer}.json") for key in ("refit", "learnt")
        }
        models |= {"true": air}
        for law in asked.laws:
            for profile in ("gust", "turbulence"):
                job = f"{law}-{profile}-{anemometer}"
                flown = work.read_json(job)
                if flown is None:
                    start = time.process_time()
                    flown = judged(asked, law, profile, anemometer, air, models, robot)
                    work.write_json(job, flown)
                    _say(f"{job}: {time.process_time() - start:.0f} s")
                errors[law, profile, anemometer] = flown
                for figure in FIGURES:
                    of_models = {key: np.array(rows[figure]) for key, rows in flown.items()}
                    found_merit = merit(of_models, np.random.default_rng(asked.seed))
                    summary[f"{law}, {profile}, {anemometer}, {figure}"] = found_merit
    summary |= {f"processor time, {key} [s]": value for key, value in seconds.items()}
    data = _dataset(asked, errors)
    return Findings(
        f"The air of {asked.air}, learnt from {asked.flights * 40.0 / 60.0:.0f} minutes of simulated flight",
        data,
        summary,
        flights={law: rust.load_config(law) for law in (asked.flown, *asked.laws)},
        files=[SETTINGS],
        inputs={"name": name},
        texts=cards,
    )


def _seen(asked: LearntAir, records: Sequence[Record], anemometer: str, robot: RobotModel) -> list[Flight]:
    """Return what flights hold of the air by an anemometer."""
    if anemometer == "exact":
        return [record.flight for record in records]
    config = rust.load_config(asked.flown, {"controller.aero": {"model": "off"}})
    flights = []
    for number, record in enumerate(records):
        log = worlds.misread(record.log, asked.seed, number, np.asarray(robot.forward_axis))
        flights.append(observed.flight_of(record.flight.name, log, config, robot))
    return flights


def _controls(
    settings: FlightTraining,
    nominal: Network,
    flights: Sequence[Flight],
    judges: Sequence[Record],
    robot: RobotModel,
    summary: dict[str, Any],
) -> dict[str, tuple[float, float]]:
    """Return errors of what is learnt from winds of other flights, and from flights without one sector of the wind."""
    length = min(len(flight.turn) for flight in flights)
    half, shuffled = len(flights) // 2, []
    for one, other in zip(flights, [*flights[half:], *flights[:half]], strict=True):
        cut = {key: getattr(one, key)[:length] for key in ("turn", "joints", "wrench", "is_valid")}
        shuffled.append(one._replace(**cut, air=other.air[:length], pressure=other.pressure[:length]))
    errors = {
        "learnt, winds of other flights": errors_of(
            from_flights.learn(settings, shuffled, robot).network, judges, robot
        )
    }
    # The wind from the left, a sector of 90 degrees.
    left = {2, 3, 4}

    def in_sector(flight: Flight, rows: Any = slice(None)) -> Any:
        return np.isin(observed.sector_of(flight.air[rows], robot), list(left))

    without = [flight._replace(is_valid=flight.is_valid & ~in_sector(flight)) for flight in flights]
    facts = observed.known(without, robot)
    summary["sectors named as unknown"] = ", ".join(observed.unknown(facts))
    network = from_flights.learn(settings, [flight for flight in without if flight.seconds > 5.0], robot).network
    errors["learnt without a sector, in it"] = errors_of(network, judges, robot, in_sector)
    errors["learnt without a sector, elsewhere"] = errors_of(network, judges, robot, lambda *row: ~in_sector(*row))
    errors["nominal, in that sector"] = errors_of(nominal, judges, robot, in_sector)
    return errors


def _minutes(asked: LearntAir, air: Mapping[str, Any], robot: RobotModel, folder: Path, work: Work) -> Findings:
    """Learn from more and more minutes of several kinds of flights, with and without the nominal model beneath."""
    judges = _records(asked, asked.judges, air, robot, folder, "mixed", asked.seed + 500)
    baseline = str(_nominal(asked)["coefficients"])
    nominal = np.asarray(robot.aero_links.coefficients[baseline])
    zero = np.zeros_like(nominal)
    figures: dict[str, dict[str, Any]] = {}
    for kind in asked.kinds:
        most = round(max(asked.minutes) * 60.0 / SECONDS)
        every: list[Record] = []
        for minutes in asked.minutes:
            count = round(minutes * 60.0 / SECONDS)
            job = f"{kind}, {minutes:g} minutes"
            kept = work.read_json(job)
            if kept is None:
                every = every or _records(asked, most, air, robot, folder, kind, asked.seed)
                # From all sides, however few they are.
                flights = [every[number].flight for number in (np.arange(count) * most // count).tolist()]
                kept = {}
                for model, base in (("learnt", "none"), ("learnt on nominal", baseline)):
                    # As many steps, whatever there is to learn from.
                    batches = max(1, count // settings_of().training.batch)
                    settings = settings_of(**{"network.baseline": base, "training.epochs": STEPS // batches})
                    start = time.process_time()
                    learnt = from_flights.learn(settings, flights, robot)
                    kept[model] = {"processor time [s]": time.process_time() - start}
                    kept[model] |= _judged_alone(asked, learnt.network, air, judges, robot, folder)
                kept["refit"] = _judged_alone(asked, learnt.refit, air, judges, robot, folder)
                work.write_json(job, kept)
                _say(f"{job}: {kept}")
            figures |= {f"{job}, {model}": row for model, row in kept.items()}
    lines = {"nothing": refit.as_network(robot, zero), "nominal": refit.as_network(robot, nominal), "true": None}
    figures |= {name: _judged_alone(asked, network, air, judges, robot, folder) for name, network in lines.items()}
    shape = (len(asked.kinds), len(asked.minutes), len(LEARNERS))
    measures = {"force": "N", "moment": "N m", "rotation": "degree", "lost": "1"}
    titles = {f"{measure} [{unit}]" if unit != "1" else measure: measure for measure, unit in measures.items()}
    data = xr.Dataset(coords={"kind": list(asked.kinds), "minutes": list(asked.minutes), "model": list(LEARNERS)})
    data["minutes"].attrs["units"] = "min"
    for title, measure in titles.items():
        rows = [
            figures[f"{kind}, {minutes:g} minutes, {model}"][title]
            for kind in asked.kinds
            for minutes in asked.minutes
            for model in LEARNERS
        ]
        data[measure] = ("kind", "minutes", "model"), np.reshape(rows, shape), {"units": measures[measure]}
        data[f"{measure}_line"] = "line", [figures[line][title] for line in lines], {"units": measures[measure]}
    flights_of = {law: rust.load_config(law) for law in (asked.flown, asked.laws[0])}
    title = "How much flight it takes to learn the air"
    return Findings(title, data.assign_coords(line=list(lines)), figures, flights=flights_of, files=[SETTINGS])


def _judged_alone(
    asked: LearntAir,
    network: Network | None,
    air: Mapping[str, Any],
    judges: Sequence[Record],
    robot: RobotModel,
    folder: Path,
) -> dict[str, float]:
    """Return a network's errors of the wrench, and those of flights in turbulence with it; of the true air for None."""
    model, (force, moment) = air, (0.0, 0.0)
    if network is not None:
        force, moment = errors_of(network, judges, robot)
        path = folder / f"{time.monotonic_ns()}.json"  # the crate keeps what it has read from a path
        save_network(path, network, robot, description="An air that is judged.", training={})
        model = worlds.card(path)
    flown = judged(asked, asked.laws[0], "turbulence", "exact", air, {"": model}, robot)[""]["rotation"]
    lost = float(np.isinf(flown).sum())
    return {"force [N]": force, "moment [N m]": moment, "rotation [degree]": float(np.median(flown)), "lost": lost}


def _dataset(asked: LearntAir, errors: Mapping[tuple[str, str, str], Any]) -> xr.Dataset:
    """Return the errors of every flight."""
    shape = (len(asked.laws), 2, len(asked.anemometers), len(MODELS), asked.winds)
    by_figure = {figure: np.full(shape, np.nan) for figure in FIGURES}
    profiles = ("gust", "turbulence")
    for (law, profile, anemometer), flown in errors.items():
        place = asked.laws.index(law), profiles.index(profile), asked.anemometers.index(anemometer)
        for number, model in enumerate(MODELS):
            for figure in FIGURES:
                by_figure[figure][(*place, number)] = flown[model][figure]
    dims = ("law", "profile", "anemometer", "model", "wind")
    return xr.Dataset(
        {
            "rotation": (
                dims,
                by_figure["rotation"],
                {"units": "degree", "long_name": "greatest rotation error; inf: lost"},
            ),
            "position": (
                dims,
                by_figure["position"],
                {"units": "cm", "long_name": "greatest error of the CoM; inf: lost"},
            ),
        },
        {
            "law": list(asked.laws),
            "profile": list(profiles),
            "anemometer": list(asked.anemometers),
            "model": list(MODELS),
        },
    )


STUDY = Study("learnt_air", __doc__, LearntAir, compute, ("shipped",), backend="rust and jax", resumes=True)
main = STUDY.main

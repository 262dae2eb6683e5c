"""Aerodynamic coefficients identified from the log of one flight, by gradients through the model.

`jax-aero study identify_aero` flies TEST2 with force areas that differ from those in the robot's file, records
what sensors would measure (positions, velocities with noise, commanded thrusts and torques, the wind), and identifies
the areas that explain the log. Starting at many logged states, it simulates the next 0.1 s under the logged commands,
compares the velocities and descends along the gradient through the simulation. The controller is not involved. The
result is validated on the forces of another flight, in head wind. `--set log=FILE` reads a recorded log of
`--set experiment=NAME` instead (`jax-aero replay` says which, with `--set map=FILE`): the true areas are then unknown.

    minimise  Σ ((ν_simulated − ν_logged)/σ)² / 2  +  Σ (θ/0.3)² / 2      areas = (1 + θ) · those of the file

The result goes to `results/identify_aero/aero/`; `jax-aero figures identify` draws it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from experiments import Refused
from experiments.study import Findings, Study
from jax_aero import rust, sim
from jax_aero.aero import Axisymmetric
from jax_aero.base import tables
from jax_aero.base.typed import scenario_config
from jax_aero.body.robot import load_robot
from jax_aero.body.spatial import wxyz_from_rotation
from jax_aero.sim.rollout import fly_chunk
from jax_aero.train.identify import descend, misfit_of, segments_of, wrenches_along
from jax_aero.view import logs

FLIGHT, VALIDATION = "test2", "head_wind"
SPREAD = 0.3
"""Greatest relative deviation of the true areas from those of the file, and width of the prior."""
NOISE = {"base": 2e-3, "joints": 5e-3}
"""Standard deviation of the logged velocities [m/s and rad/s, rad/s]."""
HORIZON = 10
"""Ticks simulated from every logged state."""
FIRST_TICK, N_STARTS = 600, 240
"""First tick used, after which there is wind, and number of initial states."""


class IdentifyConfig(tables.Table, frozen=True):
    """Settings of an identification."""

    seed: tables.Seed = 1
    """Seed of the true areas and of the noise."""
    steps: tables.Count = 150
    """Number of steps of the descent."""
    rate: tables.Positive = 0.03
    """Step size of the descent."""
    log: Path | None = None
    """Recorded log, with its commands; without it a flight with other areas is simulated."""
    map: Path | None = None
    """File that names the columns of the log."""
    experiment: str = FLIGHT
    """Experiment with the robot, the areas and the time step of the log."""


def compute(_: str, settings: IdentifyConfig) -> Findings:
    """Fly, identify and validate."""
    config = rust.load_config(settings.experiment)
    validation = rust.load_config(VALIDATION, {"simulator.duration": 20.0})
    with jax.enable_x64(True):
        typed = scenario_config(config)
        scenario, state = sim.prepare(typed)
        model = scenario.plant.aero
        assert isinstance(model, Axisymmetric)
        rng = np.random.default_rng(settings.seed)
        families, member = np.unique(np.asarray(model.areas), axis=0, return_inverse=True)
        models, truth = {"file": model}, None
        if settings.log is not None:
            segments = segments_of(read_log(settings.log, settings.map, config), 0, N_STARTS, HORIZON)
        else:
            truth = rng.uniform(-SPREAD, SPREAD, families.shape) * (families != 0.0)
            models["true"] = replace(model, areas=model.areas * (1.0 + truth[member.ravel()]))
            flown = replace(scenario, plant=replace(scenario.plant, aero=models["true"]))
            _, rows = fly_chunk(flown, state, jnp.array(0, jnp.int32), int(scenario.n_ticks) + 1)
            log = {name: np.asarray(signal) for name, signal in rows._asdict().items()}
            segments = segments_of(with_noise(log, rng), FIRST_TICK, N_STARTS, HORIZON)
        deviation = np.concatenate([np.full(6, NOISE["base"]), np.full(scenario.plant.robot.n_joints, NOISE["joints"])])
        misfit = misfit_of(scenario.plant, model, segments, member.ravel(), deviation, SPREAD)
        theta, losses = descend(misfit, families != 0.0, settings.steps, settings.rate)
        loss_true = None if truth is None else float(misfit(jnp.asarray(truth)))
        models["identified"] = replace(model, areas=model.areas * (1.0 + theta[member.ravel()]))
        flown_ahead = rust.fly(validation).log
        windy = flown_ahead["time"] >= FIRST_TICK * typed.simulator.time_step
        validation_log = {name: signal[windy] for name, signal in flown_ahead.items()}
        forces = wrenches_along(validation_log, load_robot(validation["robot"]), models)

    links = scenario.plant.robot.aero_links.names
    dataset = to_dataset(families, truth, theta, losses, validation_log["time"], forces, links, member.ravel())
    if loss_true is not None:
        dataset.attrs["loss_true"] = loss_true
    flights = {settings.experiment: config, VALIDATION: validation}
    return Findings("Aerodynamic coefficients from a flight's log", dataset, figures(dataset), flights=flights)


STUDY = Study("identify_aero", __doc__, IdentifyConfig, compute, ("aero",), engine="jax")
main = STUDY.main


def read_log(path: Path, mapping: Path | None, config: rust.Config) -> dict[str, NDArray[np.float64]]:
    """Return what a recorded log says of the robot, its commands and the air, by the names of a flight's signals.

    Raises
    ------
    Refused
        For a log that lacks a signal, or a number of it, and one that is too short.
    """
    robot, step = rust.Robot(config["robot"]), float(config["simulator"]["time_step"])
    found = logs.at_ticks(logs.read(path, config, mapping), robot, step, path).signals
    names = {name: f"raw_{name}" for name in MEASURED} | {name: name for name in ("joint_torque", "thrust_rate")}
    if lacking := [name for name in names.values() if name not in found]:
        raise Refused(
            f"`{path}` has no {', '.join(f'`{name}`' for name in lacking)}; expected measurements and commands"
        )
    log = {name: found[source] for name, source in names.items()}
    log["base_quaternion"] = wxyz_from_rotation(found["raw_base_rotation"])
    if missing := [name for name, rows in log.items() if not np.isfinite(rows).all()]:
        raise Refused(f"`{path}` lacks numbers of `{missing[0]}`; expected every row")
    if len(found["time"]) <= HORIZON + 1:
        raise Refused(f"`{path}` has {len(found['time'])} ticks of {step:g} s; expected more than {HORIZON + 1}")
    return {"time": found["time"], **log}


MEASURED = ("base_position", "base_velocity", "joint_position", "joint_velocity", "thrust", "wind")


def with_noise(log: Mapping[str, NDArray[np.float64]], rng: np.random.Generator) -> dict[str, NDArray[np.float64]]:
    """Return the log with the noise of sensors."""
    scale = {"base_velocity": NOISE["base"], "joint_velocity": NOISE["joints"]}
    noisy = {name: log[name] + rng.normal(scale=std, size=log[name].shape) for name, std in scale.items()}
    return dict(log) | noisy


def to_dataset(
    families: NDArray[np.float64],
    truth: NDArray[np.float64] | None,
    theta: NDArray[np.float64],
    losses: NDArray[np.float64],
    times: NDArray[np.float64],
    forces: Mapping[str, NDArray[np.float64]],
    links: Sequence[str],
    member: NDArray[np.int64],
) -> xr.Dataset:
    """Return areas of every model, descent, and forces in the validation flight as a labelled dataset."""
    names = [
        " ".join(link for link, own in zip(links, member, strict=True) if own == family)
        for family in range(len(families))
    ]
    areas = {"file": families, "identified": families * (1.0 + theta)}
    if truth is not None:
        areas["true"] = families * (1.0 + truth)
    variables: dict[str, Any] = {
        f"areas_{model}": (("family", "coefficient"), value, {"units": "m2", "long_name": f"force areas, {model}"})
        for model, value in areas.items()
    }
    variables["loss"] = (("step",), losses, {"units": "1", "long_name": "misfit per logged velocity, with the prior"})
    for model in areas:
        text = f"total aerodynamic force and moment, areas {model}"
        variables[f"wrench_{model}"] = (("time", "six"), forces[model], {"units": "N, N m", "long_name": text})
    coordinates = {
        "family": names,
        "coefficient": ["w0", "w1", "w2", "w3", "w4", "w5"],
        "time": ("time", times, {"units": "s"}),
    }
    return xr.Dataset(variables, coordinates, {"validation": VALIDATION, "spread": SPREAD})


def figures(dataset: xr.Dataset) -> dict[str, float]:
    """Return the errors of forces and moments in the validation flight, before and after the identification.

    Without true areas: how far those that are identified are from those of the file.
    """
    force, moment = slice(0, 3), slice(3, 6)
    of_descent = {"loss at the start": float(dataset["loss"][0]), "loss at the end": float(dataset["loss"][-1])}
    if "wrench_true" not in dataset:
        change = dataset["wrench_identified"] - dataset["wrench_file"]

        def rms(rows: xr.DataArray) -> float:
            return float(np.sqrt((rows**2).sum("six").mean("time")))

        return {
            "rms change of the force [N]": rms(change.isel(six=force)),
            "rms change of the moment [N m]": rms(change.isel(six=moment)),
            "rms force, areas of the file [N]": rms(dataset["wrench_file"].isel(six=force)),
        } | of_descent

    def error(model: str, part: slice) -> float:
        wrong = (dataset[f"wrench_{model}"] - dataset["wrench_true"]).isel(six=part)
        return float(np.sqrt((wrong**2).sum("six").mean("time")))

    return {
        "rms force error, areas of the file [N]": error("file", force),
        "rms force error, identified [N]": error("identified", force),
        "rms moment error, areas of the file [N m]": error("file", moment),
        "rms moment error, identified [N m]": error("identified", moment),
        "rms true force [N]": float(np.sqrt((dataset["wrench_true"].isel(six=force) ** 2).sum("six").mean("time"))),
        **of_descent,
        "loss with the true areas": float(dataset.attrs["loss_true"]),
    }

"""Sensitivity of a hover in wind to every number of a robot: one gradient, and differences of the crate."""

from __future__ import annotations

import dataclasses
import time
import xml.etree.ElementTree as ET
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.studies.design.campaign import POSITION, ROTATION, Row
from experiments.studies.design.robots import find, inertial, numbers, set_inertial, set_numbers
from jax_aero import rust
from jax_aero.base import plain_values, tables
from jax_aero.body.spatial import rotation_from_rpy, rpy_from_rotation
from jax_aero.sim import FlightState, Scenario, begin, prepare, rollout
from jax_aero.sim.plant import COMPILER_OPTIONS

Numbers = dict[str, Any]
UNITS = {"mass": 0.01, "com": 0.01, "joint": 0.01, "jet": 0.01, "axis": np.radians(1.0), "area": 0.01}
"""What counts as one change: a hundredth of a mass or an area, a centimetre, a degree."""
STEPS = {"mass": 1e-5, "com": 1e-6, "joint": 1e-6, "jet": 1e-6, "axis": 1e-5, "area": 1e-4}
"""Half widths of the differences [1, m, rad]."""


def cost_of(com_error: Any, rotation_error: Any) -> Any:
    """Return the mean cost of tracking of a flight whose errors have a row per tick."""
    return ((com_error**2).sum(-1) / POSITION**2 + rotation_error**2 / ROTATION**2).mean()


def nothing(robot: rust.Robot) -> Numbers:
    """Return no change of a robot's numbers, by kind; masses, with their inertias, and areas change relatively."""
    bodies, joints, jets = len(robot.body_names), len(robot.joint_names), len(robot.jet_names)
    shapes = {"mass": (bodies,), "com": (bodies, 3), "joint": (joints, 3), "jet": (jets, 3), "axis": (jets, 3)}
    return {kind: np.zeros(shape) for kind, shape in (shapes | {"area": (len(robot.aero_link_names),)}).items()}


def change(scenario: Any, state: FlightState, by: Numbers, frames: list[str]) -> tuple[Scenario, FlightState]:
    """Return a flight of the changed robot, whose controller's model has the change; a jet takes its turbine along."""
    robot, replace = scenario.plant.robot, dataclasses.replace
    jets, links, factor = robot.jets, robot.aero_links, (1.0 + by["area"])[:, None]
    turns = jax.vmap(rotation_from_rpy)(by["axis"])
    own = np.array([[float(jet == link) for jet in frames[: jets.count]] for link in frames[jets.count :]])
    turned = jnp.einsum("lj,jab->lab", own, turns) + (1.0 - own.sum(axis=1))[:, None, None] * np.eye(3)
    changed = replace(
        robot,
        masses=robot.masses * (1.0 + by["mass"]),
        inertias=robot.inertias * (1.0 + by["mass"])[:, None, None],
        coms=robot.coms + by["com"],
        joint_positions=robot.joint_positions + by["joint"],
        jets=replace(jets, positions=jets.positions + by["jet"], rotations=turns @ jets.rotations),
        aero_links=replace(links, positions=links.positions + own @ by["jet"], rotations=turned @ links.rotations),
    )
    air, known = scenario.plant.aero, scenario.controller.aero
    plant = replace(scenario.plant, robot=changed, aero=replace(air, areas=air.areas * factor))
    controller = replace(scenario.controller, aero=replace(known, areas=known.areas * factor))
    scenario = replace(scenario, plant=plant, controller=controller)
    return scenario, begin(scenario, state.plant)


def gradient(config: rust.Config) -> tuple[float, Numbers, dict[str, float]]:
    """Return the cost of a flight, its derivatives by every number in reverse mode, and times [s]."""
    robot = rust.Robot(config["robot"])
    frames, by, times = [*robot.jet_frames, *robot.aero_link_frames], nothing(robot), {}
    with jax.enable_x64(True):
        scenario, state = prepare(config)
        ticks = int(scenario.n_ticks)

        def cost(by: Numbers) -> Any:
            changed = change(scenario, state, by, frames)
            kept = rollout(
                *changed, ticks, lambda row: (row["com_position"] - row["com_setpoint"], row["rotation_error"])
            )
            return cost_of(*kept[1])

        slope = jax.jit(jax.value_and_grad(cost), compiler_options=COMPILER_OPTIONS)
        for name in ("gradient, with compilation", "gradient"):
            started = time.perf_counter()
            value, slopes = jax.device_get(slope(by))
            times[name] = time.perf_counter() - started
    return float(value), jax.tree.map(np.asarray, slopes), times


def differences(config: rust.Config) -> tuple[float, Numbers, float]:
    """Return the same by central differences of the crate, whose robots are files, and the time [s]."""
    started, robot = time.perf_counter(), rust.Robot(config["robot"])
    derivatives = nothing(robot)
    with TemporaryDirectory() as folder:

        def cost(kind: str = "mass", index: tuple[int, ...] = (0,), by: float = 0.0) -> float:
            path = change_files(Path(config["robot"]), robot, Path(folder), kind, index, by)
            flown = rust.fly_batch([config | {"robot": str(path)}], threads=1, full_log=True)[0]
            com = flown["com_position"] - flown["com_setpoint"]
            return float(cost_of(com[:-1], flown["rotation_error"][:-1]))

        for kind, values in derivatives.items():
            step = STEPS[kind]
            for index in np.ndindex(values.shape):
                values[index] = (cost(kind, index, step) - cost(kind, index, -step)) / (2.0 * step)
        return cost(), derivatives, time.perf_counter() - started


def change_files(source: Path, robot: rust.Robot, folder: Path, kind: str, index: tuple[int, ...], by: float) -> Path:
    """Write a robot with one changed number into a folder; return the path of its TOML file."""
    table = tables.read(source)
    tree = ET.parse(source.with_name(table["urdf"]))
    parts = {(part.tag, part.get("name")): part for part in tree.getroot()}
    shift = by * np.eye(3)[index[-1]] if len(index) > 1 else np.zeros(3)
    if kind in ("mass", "com"):
        link, factor = parts["link", robot.body_names[index[0]]], 1.0 + by * (kind == "mass")
        mass, com, inertia = inertial(link)
        set_inertial(link, factor * mass, com + shift, factor * inertia)
    elif kind == "area":
        families = {link["name"]: link["family"] for link in table["aero_links"]}
        factors = {link: 1.0 + by * (link == robot.aero_link_names[index[0]]) for link in families}
        table["aero_links"] = [link | {"family": link["name"]} for link in table["aero_links"]]
        for name, areas in table["coefficients"].items():
            table["coefficients"][name] = {
                link: {key: (factors[link] * np.array(area)).tolist() for key, area in areas[family].items()}
                for link, family in families.items()
            }
    else:
        name = robot.joint_names[index[0]] if kind == "joint" else f"{robot.jet_frames[index[0]]}_frame"
        origin = find(parts["joint", name], "origin")
        if kind == "axis":
            turned = rotation_from_rpy(shift) @ rotation_from_rpy(numbers(origin, "rpy"))
            set_numbers(origin, "rpy", rpy_from_rotation(turned))
        else:
            set_numbers(origin, "xyz", numbers(origin, "xyz") + shift)
    path = folder / "robot.toml"
    tree.write(path.with_suffix(".urdf"))
    path.write_text(plain_values.toml(table | {"urdf": "robot.urdf"}), encoding="utf-8")
    return path


def placed(config: rust.Config, effects: Numbers) -> list[Row]:
    """Return links, joints and jets in space [m], with what one unit of change does to the cost [%].

    A centimetre of a link's centre of mass, of a joint, a degree of a jet: the root of the squares over the axes.
    """
    robot, initial = rust.Robot(config["robot"]), config["simulator"]["initial"]
    rotation = rotation_from_rpy(np.radians(initial["base_rpy_deg"]))
    state = rust.State.at_rest(robot, initial["joint_position"])._replace(base_rotation=rotation)
    dyn, known = rust.dynamics(robot, state), robot.arrays()
    size = {kind: np.linalg.norm(effects[kind], axis=1) for kind in ("com", "joint", "axis")}
    shapes = []

    def add(kind: str, name: str, body: int, points: Any, effect: float, width: float = 0.0) -> None:
        ends = dyn.body_positions[body] + points @ dyn.body_rotations[body].T
        shapes.append({"kind": kind, "name": name, "ends": ends, "width": width, "effect": effect})

    one, jets = known["aero_links"], known["jets"]
    for i, (name, body) in enumerate(zip(robot.aero_link_names, one["bodies"], strict=True)):
        half = (0.0 if one["is_sphere"][i] else 0.5 * one["lengths"][i]) * one["axes"][i]
        points = (
            one["positions"][i] + np.stack([one["centres"][i] - half, one["centres"][i] + half]) @ one["rotations"][i].T
        )
        add("com", name, body, points, size["com"][body], one["diameters"][i])
    for i, name in enumerate(robot.joint_names):
        add("joint", name, i + 1, np.zeros((2, 3)), size["joint"][i])
    for i, (name, body) in enumerate(zip(robot.jet_names, jets["bodies"], strict=True)):
        down = -0.35 * jets["rotations"][i] @ jets["axes"][i]
        add("axis", name, body, jets["positions"][i] + np.stack([0.0 * down, down]), size["axis"][i])
    return shapes

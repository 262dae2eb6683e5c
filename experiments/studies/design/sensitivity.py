"""Sensitivity of a short flight in wind to every number of a robot: one gradient, and differences of the crate."""

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
from numpy.typing import NDArray

from jax_aero import plain, rust, tables
from jax_aero.rotations import rotation_from_rpy, rpy_from_rotation
from jax_aero.sim import FlightState, Scenario, begin, prepare, rollout
from jax_aero.sim.plant import COMPILER_OPTIONS
from jax_aero.spatial import rotation_from_rpy as turn_from_rpy

Array = NDArray[np.float64]
Numbers = dict[str, Any]
POSITION, ROTATION = 0.05, np.radians(3.0)
"""Errors of unit cost [m, rad], as those of the study `tune`."""
UNITS = {"mass": 0.01, "com": 0.01, "joint": 0.01, "jet": 0.01, "axis": np.radians(1.0), "area": 0.01}
"""What counts as one change: a hundredth of a mass or an area, a centimetre, a degree."""
STEPS = {"mass": 1e-5, "com": 1e-6, "joint": 1e-6, "jet": 1e-6, "axis": 1e-5, "area": 1e-4}
"""Half widths of the differences [1, m, rad]."""


def cost_of(com_error: Any, rotation_error: Any) -> Any:
    """Return the mean cost of tracking of a flight whose errors have a row per tick."""
    return ((com_error**2).sum(-1) / POSITION**2 + rotation_error**2 / ROTATION**2).mean()


def nothing(robot: rust.Robot) -> Numbers:
    """Return the changes of a robot's numbers by kind, all zero.

    Masses, with their inertias, and areas change relatively. A jet moves with the link in whose frame it is.
    """
    bodies, joints, jets, links = (
        len(names) for names in (robot.body_names, robot.joint_names, robot.jet_names, robot.aero_link_names)
    )
    shapes = {"mass": (bodies,), "com": (bodies, 3), "joint": (joints, 3), "jet": (jets, 3), "axis": (jets, 3)}
    return {kind: np.zeros(shape) for kind, shape in (shapes | {"area": (links,)}).items()}


def change(scenario: Any, state: FlightState, by: Numbers, frames: list[str]) -> tuple[Scenario, FlightState]:
    """Return a flight of the changed robot, whose controller knows the change."""
    robot, replace = scenario.plant.robot, dataclasses.replace
    jets, links = robot.jets, robot.aero_links
    turns = jax.vmap(turn_from_rpy)(by["axis"])
    own = np.array([[float(jet == link) for jet in frames[: jets.count]] for link in frames[jets.count :]])
    turned = jnp.einsum("lj,jab->lab", own, turns) + jnp.where((own.sum(axis=1) > 0.0)[:, None, None], 0.0, jnp.eye(3))
    changed = replace(
        robot,
        masses=robot.masses * (1.0 + by["mass"]),
        inertias=robot.inertias * (1.0 + by["mass"])[:, None, None],
        coms=robot.coms + by["com"],
        joint_positions=robot.joint_positions + by["joint"],
        jets=replace(jets, positions=jets.positions + by["jet"], rotations=turns @ jets.rotations),
        aero_links=replace(links, positions=links.positions + own @ by["jet"], rotations=turned @ links.rotations),
    )
    factor = (1.0 + by["area"])[:, None]
    air, controller = scenario.plant.aero, scenario.controller
    known = replace(controller.aero, areas=controller.aero.areas * factor)
    plant = replace(scenario.plant, robot=changed, aero=replace(air, areas=air.areas * factor))
    scenario = replace(scenario, plant=plant, controller=replace(controller, aero=known))
    return scenario, begin(scenario, state.plant)


def gradient(config: rust.Config) -> tuple[float, Numbers, dict[str, float]]:
    """Return the cost of a flight, its derivatives by every number in reverse mode, and times [s]."""
    robot = rust.Robot(config["robot"])
    with jax.enable_x64(True):
        scenario, state = prepare(config)
        ticks, frames = int(scenario.n_ticks), [*robot.jet_frames, *robot.aero_link_frames]

        def cost(by: Numbers) -> Any:
            flown, start = change(scenario, state, by, frames)
            _, (com, rotation) = rollout(
                flown, start, ticks, lambda row: (row.com_position - row.com_setpoint, row.rotation_error), 0, 100
            )
            return cost_of(com, rotation)

        slope = jax.jit(jax.value_and_grad(cost), compiler_options=COMPILER_OPTIONS)
        by, times = nothing(robot), {}
        for name in ("gradient, with compilation", "gradient"):
            started = time.perf_counter()
            value, slopes = jax.device_get(slope(by))
            times[name] = time.perf_counter() - started
    return float(value), jax.tree.map(np.asarray, slopes), times


def differences(config: rust.Config) -> tuple[float, Numbers, float]:
    """Return the same by central differences of the crate, whose robots are files, and the time [s]."""
    started = time.perf_counter()
    robot = rust.Robot(config["robot"])
    found = nothing(robot)
    with TemporaryDirectory() as folder:

        def cost(kind: str = "mass", index: tuple[int, ...] = (0,), by: float = 0.0) -> float:
            path = change_files(Path(config["robot"]), robot, Path(folder), kind, index, by)
            flown = rust.fly_batch([config | {"robot": str(path)}], threads=1, full_log=True)[0]
            com = flown["com_position"] - flown["com_setpoint"]
            return float(cost_of(com[:-1], flown["rotation_error"][:-1]))

        for kind, values in found.items():
            step = STEPS[kind]
            for index in np.ndindex(values.shape):
                values[index] = (cost(kind, index, step) - cost(kind, index, -step)) / (2.0 * step)
        value = cost()
    return value, found, time.perf_counter() - started


def change_files(source: Path, robot: rust.Robot, folder: Path, kind: str, index: tuple[int, ...], by: float) -> Path:
    """Write a robot with one changed number into a folder; return the path of its TOML file."""
    table = tables.read(source)
    tree = ET.parse(source.with_name(table["urdf"]))
    root, (first, *axis) = tree.getroot(), index
    if kind in ("mass", "com"):
        link = _named(root, "link", robot.body_names[first])
        if kind == "com":
            _add(link.find("inertial/origin"), "xyz", axis[0], by)
        else:
            for part in link.iterfind("inertial/*"):
                for key in {*part.keys()} - {"xyz", "rpy"}:
                    part.set(key, repr(float(part.get(key, 0.0)) * (1.0 + by)))
    elif kind == "area":
        families = {link["name"]: link["family"] for link in table["aero_links"]}
        factors = {link: 1.0 + by * (link == robot.aero_link_names[first]) for link in families}
        table["aero_links"] = [link | {"family": link["name"]} for link in table["aero_links"]]
        table["coefficients"] = {
            name: {
                link: {key: (factors[link] * np.array(area)).tolist() for key, area in areas[family].items()}
                for link, family in families.items()
            }
            for name, areas in table["coefficients"].items()
        }
    else:
        name = robot.joint_names[first] if kind == "joint" else f"{robot.jet_frames[first]}_frame"
        origin = _named(root, "joint", name).find("origin")
        if kind == "axis" and origin is not None:
            turn = rotation_from_rpy(by * np.eye(3)[axis[0]])
            rotation = rotation_from_rpy(np.array(origin.get("rpy", "0 0 0").split(), dtype=np.float64))
            origin.set("rpy", " ".join(map(repr, rpy_from_rotation(turn @ rotation).tolist())))
        else:
            _add(origin, "xyz", axis[0], by)
    path = folder / "robot.toml"
    tree.write(path.with_suffix(".urdf"))
    path.write_text(plain.toml(table | {"urdf": "robot.urdf"}), encoding="utf-8")
    return path


def _named(root: ET.Element, tag: str, name: str) -> ET.Element:
    return next(part for part in root.iterfind(tag) if part.get("name") == name)


def _add(origin: ET.Element | None, key: str, axis: int, by: float) -> None:
    if origin is None:
        raise AssertionError("a link or joint with numbers has an origin")
    values = np.array(origin.get(key, "0 0 0").split(), dtype=np.float64)
    values[axis] += by
    origin.set(key, " ".join(map(repr, values.tolist())))


def placed(config: rust.Config, effects: Numbers) -> list[dict[str, Any]]:
    """Return links, joints and jets in space [m], with what one unit of change does to the cost [%].

    A centimetre of a link's centre of mass, of a joint, a degree of a jet: the root of the squares over the axes.
    """
    robot, initial = rust.Robot(config["robot"]), config["simulator"]["initial"]
    rotation = rotation_from_rpy(np.radians(initial["base_rpy_deg"]))
    state = rust.State.at_rest(robot, initial["joint_position"])._replace(base_rotation=rotation)
    found, numbers = rust.dynamics(robot, state), robot.arrays()
    links, jets = numbers["aero_links"], numbers["jets"]
    size = {kind: np.linalg.norm(np.atleast_2d(one.T).T, axis=1) for kind, one in effects.items()}

    def put(body: int, *points: Array) -> list[Array]:
        return [found.body_positions[body] + found.body_rotations[body] @ point for point in points]

    shapes = []
    for i, (name, body) in enumerate(zip(robot.aero_link_names, links["bodies"], strict=True)):
        half = 0.0 if links["is_sphere"][i] else 0.5 * links["lengths"][i]
        turn, middle = links["rotations"][i], links["centres"][i]
        along = [links["positions"][i] + turn @ (middle + sign * half * links["axes"][i]) for sign in (-1.0, 1.0)]
        width, ends = links["diameters"][i], put(body, *along)
        shapes.append({"kind": "com", "name": name, "ends": ends, "width": width, "effect": size["com"][body]})
    for i, name in enumerate(robot.joint_names):
        at = found.body_positions[i + 1]
        shapes.append({"kind": "joint", "name": name, "ends": [at, at], "width": 0.0, "effect": size["joint"][i]})
    for i, (name, body) in enumerate(zip(robot.jet_names, jets["bodies"], strict=True)):
        axis = jets["rotations"][i] @ jets["axes"][i]
        ends = put(body, jets["positions"][i], jets["positions"][i] - 0.35 * axis)
        shapes.append({"kind": "axis", "name": name, "ends": ends, "width": 0.0, "effect": size["axis"][i]})
    return shapes

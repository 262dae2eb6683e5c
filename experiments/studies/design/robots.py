"""Designs of iRonCub-Mk3: their files, a trim in still air, and their controller by the rules of an import."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import qmc

from jax_aero import rust
from jax_aero.base import keys, places, plain_values, tables
from jax_aero.body.robot import load_robot
from jax_aero.body.spatial import rotation_from_rpy, rpy_from_rotation
from jax_aero.robot import flight, scenario

Array = NDArray[np.float64]
MK3 = places.CONFIGS / "robot" / "ironcub_mk3.toml"
TURBINE = 2.0
"""Mass of a turbine [kg], a point in the middle of its cylinder. Ours: the forearm's centre of mass allows no more."""
RANGES = {
    "arm_jet_out": (-0.04, 0.08),
    "arm_jet_up": (-0.08, 0.08),
    "arm_jet_splay": (-15.0, 15.0),
    "arm_jet_tilt": (-15.0, 15.0),
    "chest_jet_out": (-0.08, 0.12),
    "chest_jet_back": (-0.08, 0.08),
    "chest_jet_up": (-0.10, 0.15),
    "chest_jet_splay": (-15.0, 15.0),
    "chest_jet_tilt": (-12.0, 12.0),
    "shoulder_out": (-0.03, 0.08),
    "shoulder_up": (-0.08, 0.08),
    "upper_arm": (0.8, 1.4),
    "leg": (0.8, 1.2),
    "leg_mass": (0.8, 1.2),
}
"""Least and greatest change of iRonCub-Mk3 on both sides [m, deg], or factor: of jets in the axes of the link that
carries them (splay turns a thrust inwards, tilt forwards), and on lengths and the mass of a leg, which the chest
balances. Mass and force areas of a limb go with its length, the turbine with its jet."""
LIMBS = {"upper_arm": ("shoulder_2", "upper_arm"), "leg": ("hip_2", "upper_leg", "lower_leg")}
LEG = ("hip_1", "hip_2", "upper_leg", "lower_leg", "ankle_1", "ankle_2")
OF_MK3 = ("aero.coefficients", "fault_detection.latency.torque_max", "mpc.descent.attitude", "torque.torque_rate_max")
"""What iRonCub-Mk3's controller has that no rule gives."""
CLEARANCE, PLUME = 0.03, 1.0
"""Least distance from the axis of an exhaust to a link, and length of the axis [m], as in iRonCub-Mk3's own trim."""


def draw(count: int, seed: int) -> Array:
    """Return designs (count, parameters) of a scrambled Sobol sequence, the first of which is iRonCub-Mk3."""
    points = qmc.Sobol(len(RANGES), rng=seed).random_base2(int(np.ceil(np.log2(count + 1))))
    designs: Array = qmc.scale(points, *np.array(list(RANGES.values())).T)[:count]
    designs[0] = [float(name in (*LIMBS, "leg_mass")) for name in RANGES]
    return designs


def write(design: Mapping[str, float], folder: Path, name: str = "robot") -> Path:
    """Write TOML and URDF of a design into a folder; return the path of the former."""
    table = tables.read(MK3)
    tree = ET.parse(MK3.with_name(table["urdf"]))
    parts = {(part.tag, part.get("name")): part for part in tree.getroot()}
    links = {link["name"]: link for link in table["aero_links"]}
    for side, sign in (("l", 1.0), ("r", -1.0)):
        for kind, jet, carrier in (
            ("arm", f"{side}_arm_jet", f"{side}_elbow_1"),
            ("chest", f"chest_{side}_jet", "chest"),
        ):
            ways = ("back", "out", "up", "splay", "tilt")
            back, out, up, splay, tilt = (design.get(f"{kind}_jet_{way}", 0.0) for way in ways)
            origin, centre = find(parts["joint", f"{jet}_turbine_frame"], "origin"), links[f"{jet}_turbine"]["centre"]
            old, rotation = numbers(origin, "xyz"), rotation_from_rpy(numbers(origin, "rpy"))
            new = old + [-back, sign * out, up]  # noqa: RUF005 - a sum of arrays
            turned = rotation_from_rpy(np.radians([sign * splay, tilt, 0.0])) @ rotation
            set_numbers(origin, "xyz", new)
            set_numbers(origin, "rpy", rpy_from_rotation(turned))
            mass, com, inertia = inertial(parts["link", carrier])
            before, after = rotation @ centre + old, turned @ centre + new
            moved = com + TURBINE / mass * (after - before)
            inertia += mass * (_about(com) - _about(moved)) + TURBINE * (_about(after) - _about(before))
            set_inertial(parts["link", carrier], mass, moved, inertia)
        shoulder = find(parts["joint", f"{side}_shoulder_pitch"], "origin")
        moved = np.array([0.0, sign * design["shoulder_out"], design["shoulder_up"]])
        set_numbers(shoulder, "xyz", numbers(shoulder, "xyz") + moved)
        for limb, bodies in LIMBS.items():
            for body in (f"{side}_{body}" for body in bodies):
                carried = [part for part in tree.iter("joint") if find(part, "parent").get("link") == body]
                _stretch(parts["link", body], carried, links.get(body), design[limb])
    shed = 0.0
    for link in (parts["link", f"{side}_{body}"] for side in "lr" for body in LEG):
        mass, com, inertia = inertial(link)
        shed += (1.0 - design["leg_mass"]) * mass
        set_inertial(link, design["leg_mass"] * mass, com, design["leg_mass"] * inertia)
    mass, com, inertia = inertial(parts["link", "chest"])
    set_inertial(parts["link", "chest"], mass + shed, com, (1.0 + shed / mass) * inertia)
    factors = {body: design[limb] for limb, bodies in LIMBS.items() for body in bodies}
    for areas in table["coefficients"].values():
        for family in factors.keys() & areas.keys():
            areas[family] = {key: (factors[family] * np.array(area)).tolist() for key, area in areas[family].items()}
    tree.write(folder / f"{name}.urdf", encoding="utf-8", xml_declaration=True)
    path = folder / f"{name}.toml"
    path.write_text(plain_values.toml(table | {"urdf": f"{name}.urdf"}) + "\n", encoding="utf-8")
    return path


def _stretch(link: ET.Element, carried: list[ET.Element], shape: dict[str, Any] | None, factor: float) -> None:
    """Stretch a link along z, with what it carries and its aerodynamic shape."""
    mass, com, inertia = inertial(link)
    along = np.array([1.0, 1.0, factor])
    scatter = np.outer(along, along) * (0.5 * np.trace(inertia) * np.eye(3) - inertia)
    set_inertial(link, factor * mass, along * com, factor * (np.trace(scatter) * np.eye(3) - scatter))
    for origin in (*link.iterfind("visual/origin"), *(find(joint, "origin") for joint in carried)):
        set_numbers(origin, "xyz", along * numbers(origin, "xyz"))
    for cylinder in link.iter("cylinder"):
        set_numbers(cylinder, "length", factor * numbers(cylinder, "length"))
    if shape:
        shape |= {"centre": (along * shape["centre"]).tolist(), "length": factor * shape["length"]}


def find(part: ET.Element, path: str) -> ET.Element:
    """Return what is at a path within a part of a URDF."""
    element = part.find(path)
    if element is None:
        raise AssertionError(f"`{part.get('name')}` of iRonCub-Mk3 has a {path}")
    return element


def numbers(part: ET.Element, key: str) -> Array:
    """Return the numbers of an attribute."""
    return np.array(part.get(key, "0 0 0").split(), dtype=np.float64)


def set_numbers(part: ET.Element, key: str, values: Array) -> None:
    """Set the numbers of an attribute."""
    part.set(key, " ".join(f"{value:.12g}" for value in values))


def inertial(link: ET.Element) -> tuple[float, Array, Array]:
    """Return mass [kg], centre of mass [m] and inertia about it [kg m²], in link axes."""
    about = find(link, "inertial/inertia")
    inertia = [[float(about.get(f"i{min(a, b)}{max(a, b)}", 0.0)) for b in "xyz"] for a in "xyz"]
    mass = float(numbers(find(link, "inertial/mass"), "value")[0])
    return mass, numbers(find(link, "inertial/origin"), "xyz"), np.array(inertia)


def set_inertial(link: ET.Element, mass: float, com: Array, inertia: Array) -> None:
    """Set what `inertial` returns."""
    set_numbers(find(link, "inertial/mass"), "value", np.array([mass]))
    set_numbers(find(link, "inertial/origin"), "xyz", com)
    for (i, a), (j, b) in ((one, other) for one in enumerate("xyz") for other in enumerate("xyz") if one <= other):
        find(link, "inertial/inertia").set(f"i{a}{b}", f"{inertia[i, j]:.12g}")


def _about(r: Array) -> Array:
    """Return the inertia of a unit mass at r."""
    return np.asarray(r @ r * np.eye(3) - np.outer(r, r))


class Trim(NamedTuple):
    """An equilibrium in still air, or the state nearest to one."""

    missed: str
    """What cannot be met; empty for a trim."""
    base_rpy: Array
    joint_position: Array
    thrust: Array


def find_trim(path: Path, joints: Array) -> Trim:
    """Find the trim nearest to a posture with equal and small thrusts, by the rule of an import.

    Thrusts, joints and torques keep `flight.RESERVE` of their ranges, exhausts `CLEARANCE`.
    """
    robot, twin, n, reserve = rust.Robot(path), load_robot(path), len(joints), flight.RESERVE
    jets, links = twin.jets, twin.aero_links
    top, least, torque_max = np.array(robot.thrust_max), np.array(robot.thrust_min), np.asarray(twin.joint_torque_max)
    low, high = np.array(robot.joint_limits).T
    low, high = low + reserve * (high - low), high - reserve * (high - low)
    wanted, weight = np.clip(joints, low, high), robot.mass * robot.gravity
    axes, half = _turn(jets.rotations, jets.axes), np.where(links.is_sphere, 0.0, 0.5 * np.asarray(links.lengths))
    ends = [links.positions + _turn(links.rotations, links.centres + s * half[:, None] * links.axes) for s in (-1, 1)]
    apart = np.array(jets.bodies)[:, None] != np.array(links.bodies)

    @cache
    def rows_of(unknowns: bytes) -> Array:
        x = np.frombuffer(unknowns)
        attitude, posture, thrust = rotation_from_rpy(np.array([*x[:2], 0.0])), x[2 : 2 + n], 100.0 * x[2 + n :]
        state = rust.State(np.zeros(3), attitude, posture, np.zeros(6 + n))
        dyn = rust.dynamics(robot, state)

        def put(bodies: Any, points: Any) -> Array:
            return np.asarray(dyn.body_positions[list(bodies)] + _turn(dyn.body_rotations[list(bodies)], points))

        along = _turn(dyn.body_rotations[list(jets.bodies)], axes)
        jacobians = [rust.frame_jacobian(robot, frame, state).linear for frame in robot.jet_frames]
        left = dyn.bias - sum(t * j.T @ a for t, j, a in zip(thrust, jacobians, along, strict=True))
        start, end = (put(links.bodies, points) for points in ends)
        plume = put(jets.bodies, jets.positions)[:, None] - np.linspace(0.0, PLUME, 25)[:, None] * along[:, None]
        away, way = plume[:, :, None] - start, end - start
        nearest = np.clip((away * way).sum(-1) / ((way**2).sum(-1) + 1e-12), 0.0, 1.0)
        gaps = np.linalg.norm(away - nearest[..., None] * way, axis=-1).min(axis=1)
        clear = (gaps - 0.5 * np.asarray(links.diameters) - CLEARANCE)[apart]
        return np.concatenate(
            [left[:3] / 100.0, left[3:6] / 10.0, 1.0 - reserve - abs(left[6:]) / torque_max, clear / 0.1]
        )

    def rows(x: Array) -> Array:
        return rows_of(x.tobytes())

    def cost(x: Array) -> float:
        off, thrust = x[2 : 2 + n] - wanted, 100.0 * x[2 + n :]
        return float(thrust.sum() / weight + off @ off / n + ((thrust / top) ** 2).sum())

    thrusts = np.stack([least + reserve * top, top - reserve * top]) / 100.0
    bounds = np.vstack([[(-0.3, 0.3), (-0.5, 0.5)], np.stack([low, high], axis=1), thrusts.T])
    x = np.clip([0.0, 0.0, *wanted, *[weight / top.size / 100.0] * top.size], *bounds.T)
    limits = [{"type": "eq", "fun": lambda x: rows(x)[:6]}, {"type": "ineq", "fun": lambda x: rows(x)[6:]}]
    options = {"maxiter": 60, "ftol": 1e-7}
    x = np.clip(minimize(cost, x, method="SLSQP", bounds=bounds, constraints=limits, options=options).x, *bounds.T)
    balance, torque, exhaust = np.split(rows(x), [6, 6 + n])
    slack = {"balance": -np.abs(balance), "torque": torque, "exhaust": exhaust}
    missed = [name for name, row in slack.items() if not row.min() > -1e-4]
    return Trim(", ".join(missed), np.array([*x[:2], 0.0]), x[2 : 2 + n], 100.0 * x[2 + n :])


def _turn(rotations: Any, vectors: Any) -> Array:
    return np.asarray(np.einsum("kij,kj->ki", rotations, vectors))


def fit(path: Path, base: rust.Config) -> tuple[Trim, rust.Config]:
    """Return the trim of a robot's file and, if it has one, `base` flown by it from there with its own controller."""
    initial, own = base["simulator"]["initial"], base["controller"]
    trim = find_trim(path, np.array(initial["joint_position"]))
    if trim.missed:
        return trim, {}
    robot = rust.Robot(path)
    state = rust.State.at_rest(robot, trim.joint_position)._replace(base_rotation=rotation_from_rpy(trim.base_rpy))
    down = float(np.degrees(trim.base_rpy[1]))
    # The greatest lean of the rule takes minutes to find; iRonCub-Mk3's is taken.
    leans = (down, down + float(np.ptp(own["setpoint"]["nose_down_limits_deg"])))
    dynamics, soles = rust.dynamics(robot, state), ("l_sole", "r_sole")
    controller = scenario.controller("robot", load_robot(path), dynamics, leans=leans, soles=soles)
    for key in OF_MK3:
        keys.set_key(controller, key, keys.get(own, key))
    start = {"base_rpy_deg": np.degrees(trim.base_rpy), "joint_position": trim.joint_position, "thrust": trim.thrust}
    start = initial | {key: values.tolist() for key, values in start.items()}
    return trim, base | {
        "robot": str(path),
        "controller": controller,
        "simulator": base["simulator"] | {"initial": start},
    }

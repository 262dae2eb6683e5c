"""Perturbed flights: initial state, wind and coefficients drawn around their nominal values.

Repeat r has the same random numbers in every cell, so that cells are compared on the same draws.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jax_aero.base import documents, keys, tables
from jax_aero.base.files import read_json
from jax_aero.base.terminal import ConfigError
from jax_aero.rust import Robot

CHANCE = {
    "wind": ("time_scale",),
    "disturbances.wind_estimate": (),
    "disturbances.jets.measurement_noise": (),
    "simulator.sensors": (),
    "simulator.actuation": (),
}
"""Tables that get a new seed in every repeat, and the keys that they need to have random numbers at all."""


class Draw(NamedTuple):
    """What a key of a perturbation draws."""

    stream: int
    """Number of its random numbers, of its own, so that a key leaves the draws of others as they were."""
    part: str
    """What is perturbed."""


DRAWS = {
    "joint_position": Draw(0, "start"),
    "base_rpy_deg": Draw(1, "start"),
    "base_velocity": Draw(2, "start"),
    "thrust": Draw(3, "start"),
    "wind_speed": Draw(4, "wind"),
    "wind_direction_deg": Draw(5, "wind"),
    "drag": Draw(6, "aerodynamics"),
    "normal": Draw(7, "aerodynamics"),
    "link": Draw(8, "aerodynamics"),
    "ensemble": Draw(10, "aerodynamics"),
    "any_direction": Draw(15, "directions of pushes"),
    "mass": Draw(11, "model of the robot"),
    "com": Draw(12, "model of the robot"),
    "inertia": Draw(13, "model of the robot"),
    "thrust_axis_deg": Draw(14, "model of the robot"),
    "thrust_gain": Draw(16, "thrusts"),
    "imu_deg": Draw(17, "sensors"),
    "encoders_deg": Draw(18, "sensors"),
    "latency": Draw(19, "delays"),
    "friction": Draw(20, "friction"),
}
"""Draws by key of a perturbation, in the order in which they are said."""
SEED_STREAM = 9
"""Stream of the seeds."""

MOST_DRAWS = 256
"""Draws that are kept for the next cells of a repeat."""


class Perturbation(tables.Table, frozen=True):
    """Half widths of uniform distributions, and an ensemble to draw from; by default nothing is perturbed."""

    joint_position: tables.NonNegative = 0.0
    """Half width for every initial joint position [rad]."""
    base_rpy_deg: tables.NonNegative = 0.0
    """Half width for the initial roll, pitch and yaw [deg]."""
    base_velocity: tables.NonNegative = 0.0
    """Of every initial velocity of the base [m/s, rad/s]."""
    thrust: tables.NonNegative = 0.0
    """Of every initial thrust, which stays between 0 and the jet's greatest [N]."""
    wind_speed: tables.NonNegative = 0.0
    """Of the wind speed, relative."""
    wind_direction_deg: tables.NonNegative = 0.0
    """Half width for the direction of the wind about the vertical [deg]."""
    drag: tables.NonNegative = 0.0
    """Half width for the drag of all links in the simulator, relative."""
    normal: tables.NonNegative = 0.0
    """Half width for the normal force of all links in the simulator, relative."""
    link: tables.NonNegative = 0.0
    """Half width for the force on each link in the simulator, relative."""
    mass: tables.NonNegative = 0.0
    """Half width for the masses of the controller's robot, relative."""
    com: tables.NonNegative = 0.0
    """Half width for the centre of mass of its base body, along each axis [m]."""
    inertia: tables.NonNegative = 0.0
    """Half width for its inertias, beside that of the masses, relative."""
    thrust_axis_deg: tables.NonNegative = 0.0
    """Half width for the rotation of each of its jets about each axis [deg]."""
    thrust_gain: tables.NonNegative = 0.0
    """Half width for the force of each jet over its thrust, relative."""
    imu_deg: tables.NonNegative = 0.0
    """Half width for the rotation of the measured base about each axis [deg]."""
    encoders_deg: tables.NonNegative = 0.0
    """Half width for the offset of every measured joint position [deg]."""
    latency: tables.NonNegative = 0.0
    """Half width for the delays of torques and thrusts, rounded to steps of the physics [s]."""
    friction: tables.NonNegative = 0.0
    """Greatest dry friction of a drive [N m]."""
    any_direction: bool = False
    """Whether pushes and the wind's gust get random directions, equally likely: on the sphere, about the vertical."""
    ensemble: Path | None = None
    """`ensemble.json` of train-ensemble: the network of `simulator.aero` is one of its members, all equally often."""

    def apply(
        self, config: dict[str, Any], seed: int, repeat: int, robot: Robot, chosen: Set[str] = frozenset()
    ) -> None:
        """Perturb a configuration of this robot in place, but for the `chosen` keys of seeds."""

        def draw_around(name: str, values: Sequence[float]) -> list[float]:
            width = getattr(self, name)
            if not width:
                return [float(value) for value in values]
            drawn: list[float] = np.add(values, _uniform(seed, repeat, name, len(values)) * width).tolist()
            return drawn

        initial = config["simulator"]["initial"]
        for name in ("joint_position", "base_rpy_deg", "base_velocity", "thrust"):
            if getattr(self, name):
                initial[name] = draw_around(name, initial[name])
        if self.thrust:
            ranges = zip(initial["thrust"], robot.thrust_min, robot.thrust_max, strict=True)
            initial["thrust"] = [min(max(least, thrust), greatest) for thrust, least, greatest in ranges]
        self._blow(config["wind"], draw_around)
        self._mislead(config, draw_around, robot)
        self._wear(config, draw_around, robot)
        if self.any_direction:
            _turn(config, _stream(seed, repeat, DRAWS["any_direction"].stream))
        self._reshape(config, draw_around, robot.aero_link_names)
        if self.ensemble:
            _draw(config["simulator"]["aero"], members(self.ensemble), seed, repeat)
        _seed(config, _seeds(seed, repeat), chosen)

    def _blow(self, wind: dict[str, Any], around: Any) -> None:
        if "velocity" not in wind or not (self.wind_speed or self.wind_direction_deg):
            return
        (factor,), (turn,) = around("wind_speed", [1.0]), around("wind_direction_deg", [0.0])
        x, y, z = wind["velocity"]
        cos, sin = math.cos(math.radians(turn)), math.sin(math.radians(turn))
        wind["velocity"] = [factor * (cos * x - sin * y), factor * (sin * x + cos * y), factor * z]

    def _mislead(self, config: dict[str, Any], around: Any, robot: Robot) -> None:
        drawn = {
            "mass_scale": around("mass", [1.0])[0],
            "com_offset": around("com", [0.0] * 3),
            "inertia_scale": around("inertia", [1.0])[0],
            "thrust_axes": np.radians(around("thrust_axis_deg", [0.0] * 3 * len(robot.jet_names)))
            .reshape(-1, 3)
            .tolist(),
        }
        widths = (self.mass, self.com, self.inertia, self.thrust_axis_deg)
        error = {key: value for (key, value), width in zip(drawn.items(), widths, strict=True) if width}
        if error:
            of_flight = config.setdefault("disturbances", {}).setdefault("model_error", {})
            # The errors of the flight stay: scales multiply, offsets and rotations add up.
            for key in ("mass_scale", "inertia_scale"):
                if key in error:
                    error[key] *= of_flight.get(key, 1.0)
            for key in ("com_offset", "thrust_axes"):
                if key in error and of_flight.get(key):
                    error[key] = np.add(error[key], of_flight[key]).tolist()
            of_flight.update(error)

    def _wear(self, config: dict[str, Any], around: Any, robot: Robot) -> None:
        """Change what the robot's file does not state: engines, sensors, delays and drives."""
        simulator = config["simulator"]
        if self.thrust_gain:
            scale = config.setdefault("disturbances", {}).setdefault("jets", {}).setdefault("force_scale", {})
            factors = around("thrust_gain", [1.0] * len(robot.jet_names))
            scale |= {jet: scale.get(jet, 1.0) * x for jet, x in zip(robot.jet_names, factors, strict=True)}
        for key, name, count in (("imu_deg", "base_rotation", 3), ("encoders_deg", "joints", len(robot.joint_names))):
            if getattr(self, key):
                sensor = simulator.setdefault("sensors", {}).setdefault(name, {})
                bias = sensor.get("bias") or [0.0] * count
                sensor["bias"] = np.add(bias, np.radians(around(key, [0.0] * count))).tolist()
        if self.latency:
            actuation = simulator.setdefault("actuation", {})
            step = config["controller"]["time_step"] / simulator["substeps"]
            for name, late in zip(("torque_delay", "thrust_delay"), around("latency", [0.0] * 2), strict=True):
                actuation[name] = step * round(max(actuation.get(name, 0.0) + late, 0.0) / step)
        if self.friction:
            drawn = np.abs(around("friction", [0.0] * len(robot.joint_names))).tolist()
            if "motors" not in simulator:
                raise ConfigError.of(
                    "perturbation.friction", self.friction, "0, as the flight has no `simulator.motors`"
                )
            simulator["motors"]["friction_of"] = dict(zip(robot.joint_names, drawn, strict=True))

    def _reshape(self, config: dict[str, Any], around: Any, links: Sequence[str]) -> None:
        if not (self.drag or self.normal or self.link):
            return
        factors = config.setdefault("disturbances", {}).setdefault("aero", {})
        for name in ("drag", "normal"):
            if getattr(self, name):
                factors[name] = factors.get(name, 1.0) * around(name, [1.0])[0]
        if self.link:
            given: Mapping[str, float] = factors.get("links", {})
            drawn = around("link", [1.0] * len(links))
            factors["links"] = {link: given.get(link, 1.0) * x for link, x in zip(links, drawn, strict=True)}


def _stream(seed: int, repeat: int, number: int) -> np.random.Generator:
    return np.random.default_rng([seed, repeat, number])


# The flights of a chunk, neighbours in repeat and cell, have few draws between them; a generator is made in 10 us.
@lru_cache(MOST_DRAWS)
def _uniform(seed: int, repeat: int, key: str, count: int) -> NDArray[np.float64]:
    return _stream(seed, repeat, DRAWS[key].stream).uniform(-1.0, 1.0, count)


@lru_cache(MOST_DRAWS)
def _seeds(seed: int, repeat: int) -> tuple[int, ...]:
    """Return the seeds of the tables of `CHANCE`."""
    stream = _stream(seed, repeat, SEED_STREAM)
    return tuple(int(stream.integers(2**31)) for _ in CHANCE)


def perturbed(given: Mapping[str, Any]) -> str:
    """Return what a perturbation differs in: "start and wind perturbed"; "unperturbed" if in nothing.

    >>> perturbed({"wind_speed": 1e-6, "mass": 0.0, "drag": 0.1})
    'wind and aerodynamics perturbed'
    """
    *parts, last = dict.fromkeys(draw.part for key, draw in DRAWS.items() if given.get(key)) or [""]
    return f"{' and '.join(filter(None, (', '.join(parts), last)))} perturbed" if last else "unperturbed"


@cache
def members(ensemble: Path) -> tuple[Path, ...]:
    """Return the cards of an ensemble's members."""
    try:
        cards = tuple(map(ensemble.with_name, read_json(ensemble, documents.Ensemble)["members"]))
    except ValueError:
        cards = ()
    if not cards or not all(card.is_file() for card in cards):
        wanted = "the ensemble.json of train-ensemble, with its networks beside it"
        raise ConfigError.of("perturbation.ensemble", str(ensemble), wanted)
    return cards


def _turn(config: dict[str, Any], stream: np.random.Generator) -> None:
    """Give pushes and a gust random directions; their sizes stay."""
    for push in config.get("disturbances", {}).get("pushes", []):
        for name in ("force", "moment"):
            direction = stream.normal(size=3)
            size = math.hypot(*push.get(name, [0.0]))
            push[name] = [float(part) for part in size * direction / np.linalg.norm(direction)]
    turn = stream.uniform(0.0, 2.0 * math.pi)
    if "gust" in config["wind"]:
        size = math.hypot(*config["wind"]["gust"])
        config["wind"]["gust"] = [size * math.cos(turn), size * math.sin(turn), 0.0]


def _draw(aero: dict[str, Any], cards: Sequence[Path], seed: int, repeat: int) -> None:
    """Select the simulator's network: all members in random order, then all again in a new order."""
    if aero["model"] != "network":
        expected = '"network", as `perturbation.ensemble` draws its card'
        raise ConfigError.of("simulator.aero.model", aero["model"], expected)
    turn, place = divmod(repeat, len(cards))
    order = _stream(seed, turn, DRAWS["ensemble"].stream).permutation(len(cards))
    aero["card"] = str(cards[order[place]])


def _seed(config: dict[str, Any], seeds: Sequence[int], chosen: Set[str]) -> None:
    """Set the seeds of all tables with random numbers for this repeat, but for those that an axis has chosen."""
    for (key, marks), drawn in zip(CHANCE.items(), seeds, strict=True):
        table = keys.get(config, key)
        if isinstance(table, dict) and all(mark in table for mark in marks) and f"{key}.seed" not in chosen:
            table["seed"] = drawn

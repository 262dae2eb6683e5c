"""The worlds of the study: airs, anemometers, flights that are learnt from, and flights that judge."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.aero import dataset
from jax_aero.aero.network import init_network
from jax_aero.aero.network_card import save_network
from jax_aero.base import places
from jax_aero.body.robot import RobotModel
from jax_aero.identify import excite
from jax_aero.sweep.perturbation import Perturbation
from jax_aero.train import Settings, fit, samples_of

Array = NDArray[np.float64]
Signals = dict[str, Array]

WRONG = Perturbation(
    base_rpy_deg=3.0, base_velocity=0.15, joint_position=0.03, thrust=8.0,
    mass=0.05, com=0.01, inertia=0.1, thrust_axis_deg=1.0,
)  # fmt: skip
"""Robots that are not as their file has them: those of `configs/perturbation/robot.toml`."""
STARTS = Perturbation(base_rpy_deg=1.0, base_velocity=0.05, joint_position=0.02, thrust=2.0)
"""What ideal robots differ in: their starts."""
NOISE, BIAS, LATE, WAKE = 0.5, 1.0, 0.05, 0.8
"""Errors of the anemometer: standard deviation of its noise [m/s], length of a bias [m/s], age [s], and the share of
the wind that it reads where the air comes from behind."""
BEHIND = math.radians(45.0)
"""Half width of the sector about straight behind in which it stands in the robot's wake."""
OTHER = Settings(epochs=300, learning_rate=3e-3, batch=64, schedule="cosine", validate_every=300)
"""Training of the network of another family."""


# --- airs --------------------------------------------------------------------------------------------------------


def card(path: Path) -> dict[str, Any]:
    """Return the table of an aerodynamic model of a network."""
    return {"model": "network", "card": str(path.resolve()), "precision": "f32", "air_density": 1.225}


def air_of(name: str, robot: RobotModel, folder: Path) -> dict[str, Any]:
    """Return the table of a true air; the network of another family is trained into a folder."""
    if name == "shipped":
        return card(places.CONFIGS / "aero/networks/default.json")
    if name == "spheres":
        spheres = {"base": str(places.CONFIGS / "aero/sphere_cylinder.toml")}
        return dict(rust.load_config("test2", {"simulator.aero": spheres})["simulator"]["aero"])
    path = folder / "other.json"
    if not path.exists():
        # Another solver's data, other postures, base axes, hyperbolic tangents, no symmetry, no features of links.
        rows = dataset.load(places.CONFIGS / "aero/datasets/open.nc", robot).add_mirror_images()
        start = init_network(
            jax.random.key(5), robot, hidden=(64, 64), blocks=("wind", "joints"), activation="tanh", start="unit"
        )
        network = fit(start, samples_of(start, robot, rows), None, OTHER, 5).network
        save_network(path, network, robot, description="An air of another family.", training={"rows": len(rows)})
    return card(path)


# --- anemometers -------------------------------------------------------------------------------------------------


def errors_of(seed: int, number: int) -> dict[str, Any]:
    """Return `disturbances.wind_estimate` of a flight: noise, and a bias of a direction of its own."""
    rng = np.random.default_rng([seed, number, 7])
    angle = rng.uniform(0.0, 2.0 * math.pi)
    bias = [BIAS * math.cos(angle), BIAS * math.sin(angle), 0.0]
    return {"noise_std": NOISE, "bias": bias, "delay": LATE, "seed": int(rng.integers(2**31))}


def in_wake(wind: Array, rotation: Array, forward: Array) -> bool:
    """Return whether the air comes from behind a robot of this base rotation."""
    ahead = rotation @ forward
    along, across = wind[:2] @ ahead[:2], wind[0] * ahead[1] - wind[1] * ahead[0]
    return bool(abs(math.atan2(across, along)) < BEHIND)


def misread(log: Mapping[str, Array], seed: int, number: int, forward: Array) -> Signals:
    """Return a log whose wind was measured with errors; the controller that flew it uses no wind."""
    errors, wind = errors_of(seed, number), log["raw_wind"]
    late = round(LATE / (log["time"][1] - log["time"][0]))
    measured = wind[np.maximum(np.arange(len(wind)) - late, 0)] + errors["bias"]
    measured = measured + NOISE * np.random.default_rng(errors["seed"]).normal(size=wind.shape)
    turns = rust.rotation_from_wxyz(log["base_quaternion"])
    stands = np.array([in_wake(*row, forward) for row in zip(wind, turns, strict=True)])
    measured[stands] *= WAKE
    return {**log, "raw_wind": measured, "measured_wind": measured}


# --- flights -----------------------------------------------------------------------------------------------------


def turbulence(draw: np.random.Generator, angle: float, least: float, most: float, share: float) -> dict[str, Any]:
    """Return a turbulent wind from a direction [rad] whose gusts have this share of its speed."""
    speed = draw.uniform(least, most)
    return {
        "profile": "turbulent",
        "velocity": [speed * math.cos(angle), speed * math.sin(angle), 0.0],
        "std": [share * speed, share * speed, 0.5 * share * speed],
        "time_scale": float(draw.uniform(1.0, 4.0)),
        "seed": int(draw.integers(2**31)),
    }


def learning(
    seed: int, number: int, count: int, air: Mapping[str, Any], kind: str, folder: Path, experiment: str = "robot"
) -> rust.Config:
    """Return a flight to learn from: `robot` without a model in turbulence of 5 to 15 m/s, from all sides in turn.

    `kind` is `mixed` (every third in hover, the others on the mission), `hover`, `mission` or `excited`: a hover whose
    attitude moves.
    """
    draw = np.random.default_rng([seed, number])
    angle = 2.0 * math.pi * (number + draw.uniform()) / count
    wind = turbulence(draw, angle, 5.0, 15.0, 0.3) | {"ramp_start": 4.0, "ramp_end": 8.0}
    keys: dict[str, Any] = {"simulator.duration": 40.0, "controller.aero": {"model": "off"}, "simulator.aero": air}
    if kind in ("hover", "excited") or (kind == "mixed" and number % 3 == 0):
        keys["mission"] = {}
    config = rust.load_config(experiment, keys | {"wind": wind})
    if kind == "excited":
        place = folder / f"excited-{number}"
        place.mkdir(parents=True, exist_ok=True)
        excite.write(place / "excite.csv", excite.reference_of(config, ["roll", "pitch", "yaw"], 4.0, 38.0))
        config = rust.resolve_config({**config, "mission": {"file": str(place / "excite.csv")}})
    WRONG.apply(config, seed, number, rust.Robot(config["robot"]))
    config["wind"] = wind  # whose seed is drawn above
    return config


def judging(law: str, profile: str, seed: int, number: int, air: Mapping[str, Any], model: Any) -> rust.Config:
    """Return a flight that judges: a hover in a wind of 8 to 18 m/s, `gust` or `turbulence`."""
    draw = np.random.default_rng([seed, number])
    angle = draw.uniform(0.0, 2.0 * math.pi)
    if profile == "turbulence":
        wind = turbulence(draw, angle, 8.0, 18.0, 0.2) | {"ramp_start": 1.0, "ramp_end": 3.0}
        seconds = 12.0
    else:
        speed, seconds = draw.uniform(8.0, 18.0), 7.0
        gust = [speed * math.cos(angle), speed * math.sin(angle), 0.0]
        duration = float(draw.uniform(0.8, 1.6))
        wind = {"profile": "gust", "velocity": [0.0] * 3, "gust": gust, "start": 2.0, "duration": duration}
    keys = {"simulator.duration": seconds, "wind": wind, "mission": {}, "controller.aero": model, "simulator.aero": air}
    of = json.dumps([law, profile, dict(air), model], sort_keys=True)
    if of not in _loaded:
        if rust.load_config(law)["controller"].get("mpc"):
            keys["controller.mpc.air"] = "constant"  # only the axisymmetric model has the derivatives of a linear one
        config = rust.load_config(law, keys)
        _loaded[of] = config, rust.Robot(config["robot"])
    loaded, robot = _loaded[of]
    config = copy.deepcopy(loaded)
    (WRONG if config["simulator"].get("sensors") else STARTS).apply(config, seed, number, robot)
    config["wind"] = wind
    return config


_loaded: dict[str, tuple[rust.Config, rust.Robot]] = {}
"""Flights that judge, which differ in their wind and in what is drawn alone."""


def fly(config: rust.Config, errors: Mapping[str, Any] | None, forward: Array, lag: float = 0.0) -> Any:
    """Fly; with errors of the anemometer it also stands in the robot's wake.

    With a lag [s], forces follow those of the air with a first-order delay, from what they are at the start.
    """
    if errors is None and lag == 0.0:
        return rust.fly(config)
    flown = copy.deepcopy(config)
    if errors is not None:
        flown.setdefault("disturbances", {})["wind_estimate"] = dict(errors)
    flight = rust.Flight(flown)
    behind = Behind(flown, lag)
    while not flight.has_ended:
        seen = None
        if errors is not None:
            seen = flight.measurement
            if in_wake(np.asarray(seen.wind), np.asarray(seen.state.base_rotation), forward):
                seen = seen._replace(wind=WAKE * np.asarray(seen.wind))
        flight.step(measurement=seen, link_forces=behind.forces(flight.truth) if lag > 0.0 else None)
    return flight.result()


class Behind:
    """Forces f that follow those F of a flight's air: lag · ḟ = F − f, by implicit Euler steps of a tick."""

    def __init__(self, config: rust.Config, lag: float) -> None:
        self._robot, self._air = rust.Robot(config["robot"]), config["simulator"]["aero"]
        step = config["controller"]["time_step"]
        self._share = step / (step + lag)
        self._forces: Array | None = None

    def forces(self, truth: Any) -> Array:
        """Return the forces in this tick (links, 3) [N, inertial axes]."""
        due = rust.link_forces(self._robot, self._air, truth.state, truth.wind)
        last = due if self._forces is None else self._forces
        self._forces = last + self._share * (due - last)
        return self._forces

"""Settings that can be changed while a flight is shown, and their effect on its configuration."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jax_aero import rust
from jax_aero.places import CONFIGS
from jax_aero.wind_direction import speed_and_direction, wind_from

AERO = CONFIGS / "aero"
MODELS = {
    "axisymmetric, corrected": AERO / "axisymmetric_corrected.toml",
    "axisymmetric, published": AERO / "axisymmetric_published.toml",
    "axisymmetric, signed": AERO / "axisymmetric_signed.toml",
    "axisymmetric, alternative": AERO / "axisymmetric_alternative.toml",
    "spheres and cylinders": AERO / "sphere_cylinder.toml",
    "no air": AERO / "off.toml",
} | {f"network {card.stem}": card for card in sorted((AERO / "networks").glob("**/*.json")) if card.stem != "ensemble"}
"""Files of the aerodynamic models by displayed name: a table, or the card of a network."""

AS_GIVEN = "as in the result"
"""Name for an aerodynamic table that is not in `MODELS`."""

CONTROLLERS = ("baseline", "aware")
ARMS = ("corrected", "published")

# Differences of configs/simulator/flight_published.toml and configs/control/aero_aware_published.toml from the
# physically correct files, except coefficients.
SIMULATOR_ARMS = {
    "corrected": {"lever_arm": "rotated", "integrator": "semi_implicit_euler", "joint_stops": True},
    "published": {"lever_arm": "unrotated", "integrator": "explicit_euler", "joint_stops": False},
}
CONTROLLER_ARMS = {
    "corrected": {"lever_arm": "rotated", "jacobian_offset": "link_rotation", "link_velocity": "at_centre"},
    "published": {"lever_arm": "unrotated", "jacobian_offset": "base_rotation", "link_velocity": "shifted_twice"},
}

# As published, one torque limit replaces the limits of the robot's joints [N m].
CONTROLLER_TORQUE: dict[str, dict[str, float]] = {"corrected": {}, "published": {"torque_max": 50.0}}


@dataclass(frozen=True)
class Settings:
    """Settings on the page.

    Attributes
    ----------
    wind_speed
        Speed [m/s].
    wind_direction_deg
        Direction that the wind comes from [deg]: 0 from ahead (+x), 90 from the robot's left (+y).
    controller
        `baseline`, without an aerodynamic model, or `aware`.
    model
        Aerodynamic model of the simulator and of an aware controller: a key of `MODELS`,
        the path of a network's card, or `AS_GIVEN`.
    arms
        Convention of the lever arms, in simulator and controller: `corrected` or `published`.
    feedback_scale
        Factor on every force that the controller estimates.
    """

    wind_speed: float = 10.0
    wind_direction_deg: float = 90.0
    controller: str = "baseline"
    model: str = "axisymmetric, corrected"
    arms: str = "corrected"
    feedback_scale: float = 1.0

    @property
    def title(self) -> str:
        """Title that identifies this flight, in one line."""
        scale = "" if self.controller == "baseline" or self.feedback_scale == 1.0 else f" × {self.feedback_scale:g}"
        return f"{self.controller}{scale}, {self.wind_speed:g} m/s from {self.wind_direction_deg:g}°, {self.arms} arms"


def default_config() -> rust.Config:
    """Return the configuration of TEST1, which is used if no result is given."""
    return rust.load_config("test1")


def settings_of(config: rust.Config) -> Settings:
    """Return the settings nearest to a configuration."""
    velocity = config["wind"].get("velocity", [0.0, 0.0, 0.0])
    speed, direction = speed_and_direction(velocity) if any(velocity[:2]) else (0.0, 90.0)
    is_baseline = config["controller"]["aero"]["model"] == "off"
    return Settings(
        wind_speed=round(speed, 6),
        wind_direction_deg=round(direction, 6) + 0.0,
        controller="baseline" if is_baseline else "aware",
        model=_model_of(config["simulator"]["aero"]),
        arms="published" if config["simulator"]["lever_arm"] == "unrotated" else "corrected",
        feedback_scale=float(config.get("disturbances", {}).get("aero_estimate", {}).get("scale", 1.0)),
    )


def _model_of(aero: dict[str, Any]) -> str:
    for name in MODELS:
        table = aero_table(name)
        if all(aero.get(key) == table.get(key) for key in ("model", "coefficients", "card")):
            return name
    return str(aero.get("card", AS_GIVEN))


def can_change_wind(config: rust.Config) -> bool:
    """Return whether the configuration's wind has a velocity; a recorded wind has none."""
    return "velocity" in config["wind"]


def apply(base: rust.Config, settings: Settings) -> rust.Config:
    """Return `base`, changed where the settings differ from its own.

    Other values are kept, so applying a configuration's own settings returns the same configuration.
    """
    before = settings_of(base)
    config = copy.deepcopy(base)
    simulator, controller = config["simulator"], config["controller"]
    wind, wind_before = (wind_from(one.wind_speed, one.wind_direction_deg) for one in (settings, before))
    if can_change_wind(base) and wind != wind_before:
        config["wind"]["velocity"] = wind
        if before.wind_speed == 0.0 and config["wind"]["profile"] == "constant":
            # Still air does not define how a wind rises: use the profile of the paper's flights.
            config["wind"] |= {"profile": "ramp", "ramp_start": 5.0, "ramp_end": 10.0}
    if settings.arms != before.arms:
        simulator |= SIMULATOR_ARMS[settings.arms]
        controller |= CONTROLLER_ARMS[settings.arms]
        controller["torque"].pop("torque_max", None)
        controller["torque"] |= CONTROLLER_TORQUE[settings.arms]
    if settings.model != before.model:
        simulator["aero"] = aero_table(settings.model)
    if (settings.controller, settings.model) != (before.controller, before.model):
        is_baseline = settings.controller == "baseline"
        controller["aero"] = aero_table("no air") if is_baseline else copy.deepcopy(simulator["aero"])
    if settings.feedback_scale != before.feedback_scale:
        config.setdefault("disturbances", {}).setdefault("aero_estimate", {})["scale"] = settings.feedback_scale
    if config != base:
        config["title"] = settings.title
    return config


def aero_table(model: str) -> dict[str, Any]:
    """Return the table of a model, including its base files: a key of `MODELS`, or the path of a network's card."""
    file = MODELS.get(model, Path(model))
    if file.suffix == ".json":
        return rust.load_aero("network") | {"card": str(file)}
    return rust.load_aero(file)

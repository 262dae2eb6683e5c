"""Force areas of the project's aerodynamic models at measured or simulated points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from jax_aero import rust
from jax_aero.aero import LinkConventions, aero_model, link_forces
from jax_aero.aero.dataset import Floats, wind_direction
from jax_aero.base import places, typed_config
from jax_aero.base.places import ROBOT
from jax_aero.body.kinematics import kinematics_at_rest
from jax_aero.body.robot import RobotModel
from jax_aero.data.ironcub import joint_position

AERO = places.CONFIGS / "aero"
MODELS = {
    "axisymmetric, published": "axisymmetric_published",
    "axisymmetric, corrected": "axisymmetric_corrected",
    "axisymmetric, signed": "axisymmetric_signed",
    "axisymmetric, refit": "axisymmetric_refit",
    "spheres and cylinders": "sphere_cylinder",
    "network, shipped": "network",
}
MODEL_FILES = (ROBOT, *(AERO / f"{name}.toml" for name in MODELS.values()))
"""Files that determine the forces of all models, together with the files that these name."""


def model_areas(robot: RobotModel, data: xr.Dataset) -> dict[str, Floats]:
    """Return the force areas of the links (N, 13, 3) [m²], base axes, by model."""
    joints, wind = data["joint_position"].values, wind_direction(data["pitch"].values, data["yaw"].values)
    areas = {}
    for name, file in MODELS.items():
        table = rust.load_aero(file)
        areas[name] = evaluate_areas(robot, table, joints, wind * data["speed"].values[:, None])
    return areas


def evaluate_areas(robot: RobotModel, table: Mapping[str, Any], joints: Floats, air: Floats) -> Floats:
    """Return the force areas (N, 13, 3) [m²] of a model at rest in air of velocity (N, 3) [m/s], base axes."""
    with jax.enable_x64(True):
        model = aero_model(typed_config.aero_config(table), robot)

        def areas_in_wind(position: Any, wind: Any) -> Any:
            link = link_forces(model, robot, kinematics_at_rest(robot, position), LinkConventions(), wind)
            return link.forces / (0.5 * float(table["air_density"]) * jnp.sum(wind**2))

        areas = jax.jit(jax.vmap(areas_in_wind))(joint_position(robot, joints), air)
        return np.asarray(areas, dtype=np.float64)

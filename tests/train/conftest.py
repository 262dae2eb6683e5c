from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from jax_aero.aero.dataset import Dataset, wind_direction
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.data.ironcub import JOINTS, LINKS
from tests import cfd_table

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def ironcub() -> RobotModel:
    return load_robot(ROOT / "configs" / "robot" / "ironcub_mk1.toml")


@pytest.fixture(scope="session")
def made_up_dataset() -> Dataset:
    """Six postures in 24 winds, with areas that follow the wind: nothing physical, but something to learn."""
    rng = np.random.default_rng(4)
    pitch, yaw = (part.ravel() for part in np.meshgrid(np.arange(0.0, 181.0, 36.0), [-100.0, -20.0, 60.0, 140.0]))
    joints = rng.uniform(-25.0, 35.0, size=(6, len(JOINTS)))
    wind = wind_direction(pitch, yaw)
    areas = [0.02 * wind[:, None, :] * np.linspace(0.2, 1.0, len(LINKS))[:, None] * (1.0 + q[3] / 90.0) for q in joints]
    postures = {f"posture{i}": q for i, q in enumerate(joints)}
    return cfd_table.made_up_dataset(postures, pitch, yaw, np.concatenate(areas), provenance={"source": "made up"})

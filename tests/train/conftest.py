from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from jax_aero.aero.dataset import JOINTS, LINKS, Dataset, wind_direction
from jax_aero.body.robot import RobotModel, load_robot

ROOT = Path(__file__).parents[2]
COMPACT = ("link_wind", "link_position", "link_shadow")


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
    n = 6 * len(wind)
    return Dataset(
        posture=np.repeat([f"posture{i}" for i in range(6)], len(wind)),
        is_mirrored=np.zeros(n, dtype=bool),
        joint_position_deg=np.repeat(joints, len(wind), axis=0),
        wind_b=np.tile(wind, (6, 1)),
        pitch_deg=np.tile(pitch, 6),
        yaw_deg=np.tile(yaw, 6),
        force_area_b=np.concatenate(areas),
        speed=np.full(n, 17.0),
        air_density=np.full(n, 1.225),
        provenance={"source": "made up"},
    )

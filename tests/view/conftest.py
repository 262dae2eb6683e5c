"""A real flight that ends badly, as a result folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments import manifest, record
from jax_aero import rust

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def fallen(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """TEST1 with published arms, which falls at about 21 s."""
    config = rust.load_config(ROOT / "configs/experiments/test1_published.toml")
    flight = rust.fly(config)
    dataset = record.to_dataset(
        flight,
        rust.Robot(config["robot"]),
        title=config["title"],
        config_digest=rust.config_digest(config),
    )
    folder = tmp_path_factory.mktemp("results") / "fallen"
    record.write_run(folder, dataset, {"title": config["title"], "config": manifest.make_portable(config)})
    return folder

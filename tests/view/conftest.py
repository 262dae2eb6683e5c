"""A real flight that ends badly, as a result folder, and a robot that stands still."""

from __future__ import annotations

import fcntl
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.results import manifest, record
from jax_aero.view.recording import Recording
from tests.browser import open_chromium

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def fallen(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """TEST1 with published arms, which falls at about 21 s."""
    config = rust.load_config("test1_published")
    flight = rust.fly(config)
    dataset = record.to_dataset(
        flight, rust.Robot(config["robot"]), title=config["title"], config_digest=rust.config_digest(config)
    )
    folder = tmp_path_factory.mktemp("results") / "fallen"
    record.write_run(folder, dataset, {"title": config["title"], "config": manifest.make_portable(config)})
    return folder


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page, built by `make lab`; skips where a tool for that is missing."""
    if shutil.which("npm") is None or shutil.which("node") is None:
        pytest.skip("node and npm are not installed: apt-get install nodejs npm")
    folder = subprocess.run(
        ["rustc", "--print", "target-libdir", "--target", "wasm32-unknown-unknown"], capture_output=True, text=True
    ).stdout.strip()
    if not folder or not Path(folder).is_dir():
        pytest.skip("the target for pages is not installed: rustup target add wasm32-unknown-unknown")
    with (ROOT / "target/lab.lock").open("w") as lock:  # test processes build one after the other
        fcntl.flock(lock, fcntl.LOCK_EX)
        packages = subprocess.run(["make", "rust/lab/page/node_modules"], cwd=ROOT, capture_output=True, text=True)
        if packages.returncode:
            pytest.skip("npm cannot fetch its packages: make rust/lab/page/node_modules")
        # The compiled module is the one that this test has imported.
        done = subprocess.run(["make", "-o", ".venv/.module", "lab"], cwd=ROOT, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return shutil.copytree(
            ROOT / "target/lab", tmp_path_factory.mktemp("lab") / "lab"
        )  # which no other process builds anew


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with open_chromium() as opened:
        yield opened


@pytest.fixture
def standing() -> Callable[..., Recording]:
    """Two seconds of the robot of a file, which does not move."""
    return _standing


def _standing(path: Path, title: str = "standing") -> Recording:
    robot = rust.Robot(path)
    n, joints, jets, links = 3, len(robot.joint_names), len(robot.jet_names), len(robot.aero_link_names)
    still = {
        "time": np.arange(n) * 1.0,
        "base_position": np.tile([0.0, 0.0, 1.0], (n, 1)),
        "base_quaternion": np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        "base_rpy_setpoint": np.zeros((n, 3)),
        "joint_position": np.zeros((n, joints)),
        "com_position": np.tile([0.0, 0.0, 1.0], (n, 1)),
        "com_velocity": np.zeros((n, 3)),
        "com_setpoint": np.tile([0.0, 0.0, 1.0], (n, 1)),
        "rotation_error": np.zeros(n),
        "thrust": np.full((n, jets), 40.0),
        "wind": np.zeros((n, 3)),
        "aero_force_sim": np.zeros((n, links, 3)),
    }
    return Recording(title, still, robot, path, "completed", None, None)


def near(picture: NDArray[Any], colour: tuple[int, int, int]) -> int:
    """Number of pixels with the hue of a colour, in light or shade."""
    p, c = picture.reshape(-1, 3).astype(float), np.array(colour, dtype=float)
    cosine = p @ c / (np.linalg.norm(p, axis=1) * np.linalg.norm(c) + 1e-9)
    return int((cosine > 0.995).sum())

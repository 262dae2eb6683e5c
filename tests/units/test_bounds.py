"""What is too large, too deep or too many is refused before time and memory are spent on it, in both languages."""

import json
from pathlib import Path

import pytest

from jax_aero import _core, rust
from jax_aero.base import files, places
from jax_aero.base.terminal import ConfigError
from jax_aero.sweep import spec

SPARROW = places.find("robot", "sparrow")


@pytest.fixture
def robot(tmp_path) -> Path:
    """A robot whose files may be spoilt."""
    for suffix in (".toml", ".urdf"):
        (tmp_path / f"sparrow{suffix}").write_bytes(SPARROW.with_suffix(suffix).read_bytes())
    return tmp_path / "sparrow.toml"


def test_a_device_and_a_huge_file_are_not_read(robot):
    """The file is sparse: it takes no space, but would take the memory."""
    urdf = robot.with_suffix(".urdf")
    urdf.unlink()
    urdf.symlink_to("/dev/zero")
    with pytest.raises(ValueError, match="expected a regular file of at most"):
        rust.Robot(robot)
    urdf.unlink()
    with urdf.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(ValueError, match="expected a regular file of at most 67108864 bytes"):
        rust.Robot(robot)


def test_weights_that_are_a_device_or_huge_are_not_read(tmp_path):
    config = rust.load_config("test4")
    card = Path(config["simulator"]["aero"]["card"])
    (tmp_path / card.name).write_bytes(card.read_bytes())
    weights = tmp_path / json.loads(card.read_text())["weights"]["file"]
    config["simulator"]["aero"]["card"] = str(tmp_path / card.name)
    expected = "expected a regular file of at most 67108864 bytes"
    weights.symlink_to("/dev/zero")
    with pytest.raises(ValueError, match=expected):
        rust.check_config(config)
    with pytest.raises(ValueError, match=expected):
        files.read_bytes(weights)
    weights.unlink()
    with weights.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(ValueError, match=expected):
        rust.check_config(config)


def test_a_solver_of_too_many_variables_is_refused():
    with pytest.raises(ValueError, match="n is 200000; expected at most 4096"):
        rust.BoxQpSolver(200_000)


def test_files_of_a_sweep_that_name_one_another_end(tmp_path):
    (tmp_path / "loop.toml").write_text('set = { file = "loop.toml" }\n')
    with pytest.raises(ConfigError, match="more than 128 files are read"):
        spec.load(str(tmp_path / "loop.toml"))
    for depth in range(16):  # each file names the next one thrice
        text = "".join(f'{key} = {{ file = "{depth + 1}.toml" }}\n' for key in "abc")
        (tmp_path / f"{depth}.toml").write_text(text)
    (tmp_path / "16.toml").write_text("")
    with pytest.raises(ConfigError, match="more than 128 files are read"):
        spec.load(str(tmp_path / "0.toml"))


def test_a_panic_is_an_exception():
    """One that is raised in a callback goes through the crate as a panic, and comes out at the end of the call."""

    def panics(tick: int, n_ticks: int) -> None:
        raise _core.PanicException("planted")

    with pytest.raises(Exception, match="planted") as raised:
        rust.fly(rust.load_config("test2", {"simulator.duration": 2.0}), panics)
    assert isinstance(raised.value, RuntimeError)
    assert isinstance(raised.value, _core.PanicException)

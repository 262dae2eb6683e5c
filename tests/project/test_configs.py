"""Every file of numbers can be read, and says where its numbers come from."""

import re
import tomllib
from pathlib import Path

import pytest

from jax_aero import rust
from jax_aero.base import places
from jax_aero.base.controllers import CONTROLLERS
from jax_aero.sweep import spec
from jax_aero.sweep.design import Design

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = sorted((ROOT / "configs").rglob("*.toml"))
EXPERIMENTS = sorted((ROOT / "configs" / "experiments").glob("*.toml"))
# "Source: ...", the paper, a published file by its name, or ourselves.
SOURCE = re.compile(r"#.*(\bsources?\b|\bpaper\b|\bpublished\b|\bours?\b|\w+\.m\b)", re.IGNORECASE)


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT / "configs"))


def test_every_file_names_the_source_of_its_numbers():
    """In a comment; whether a file can be read, `test_schema.py` asks."""
    assert [name_of(path) for path in CONFIGS if not SOURCE.search(path.read_text(encoding="utf-8"))] == []


def test_no_two_experiments_are_the_same():
    described = {}
    for path in EXPERIMENTS:
        config = rust.load_config(path)
        text = repr({key: value for key, value in config.items() if key not in ("title", "description")})
        assert text not in described, f"{path.stem} flies what {described.get(text)} flies"
        described[text] = path.stem


@pytest.mark.parametrize(
    ("key", "file"),
    {
        "baseline": "baseline",
        "aware": "aero_aware",
        "observer": "observer_without_model",
        "both": "observer",
        "mpc": "mpc",
    }.items(),
)
def test_the_flight_lab_calls_a_controller_by_its_name_in_the_list(key, file):
    page = (ROOT / "rust/lab/page/scenario.js").read_text(encoding="utf-8")
    assert f'{key}: ["{CONTROLLERS[file].label}", ' in page


def controller_of(path):
    """The name of the file of a flight's controller."""
    flight = tomllib.loads(path.read_text(encoding="utf-8"))
    if "controller" not in flight:
        return controller_of(path.parent / flight["base"])
    return Path(flight["controller"]["base"]).stem


def test_a_title_names_the_controller_of_its_flight_by_the_list():
    files = {one.label: file for file, one in CONTROLLERS.items()}
    named = {}
    for path in EXPERIMENTS:
        said = rust.load_config(path)["title"].partition(": ")[2].partition(", network")[0]
        if said in files:
            named[path.stem] = files[said], controller_of(path).removesuffix("_published")
    assert {flight for flight, (said, flown) in named.items() if said != flown} == set()
    assert {"test1", "test2", "test4", "test1_observer_gale", "robot_gale", "test2_sensors"} <= named.keys()


def test_test1_and_test2_differ_in_the_controller_alone():
    first, second = (rust.load_config(f"test{n}") for n in (1, 2))
    different = {key for key in first if first[key] != second[key]}
    assert different == {"title", "description", "controller"}


def table(path):
    return tomllib.loads((ROOT / "configs" / path).read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", ["observer_tests", "observer_missions"])
def test_a_sweep_that_adds_the_observer_adds_all_of_it(name):
    observer = table("control/observer.toml")
    parts = {"disturbance_observer", "weights", "channels", "fault_detection"}
    detectors = observer["fault_detection"]
    assert observer.keys() == {"base"} | parts
    added = {key: value for key, value in table(f"sweeps/{name}.toml")["set"].items() if key.startswith("controller.")}
    assert added == {
        "controller.disturbance_observer": observer["disturbance_observer"],
        "controller.weights.joint_velocity": observer["weights"]["joint_velocity"],
        "controller.channels.jump": observer["channels"]["jump"],
        **{f"controller.fault_detection.{name}": detector for name, detector in detectors.items()},
    }
    assert observer["weights"].keys() == {"joint_velocity"}
    assert observer["channels"].keys() == {"jump"}


def test_a_loss_that_is_found_without_a_descent_is_found_as_the_observer_finds_it():
    observer = table("control/observer.toml")["fault_detection"]["engines"]
    (axis,) = (axis for axis in table("sweeps/engine_loss.toml")["axis"] if axis["name"] == "engines")
    (level,) = (level for level in axis["level"] if level["label"] == "found, flies on")
    assert {"descent": observer["descent"], **level["set"]["controller.fault_detection.engines"]} == observer
    assert "descent" not in level["set"]["controller.fault_detection.engines"]


def test_a_sweep_of_realistic_sensors_has_the_realistic_sensors():
    added = table("sweeps/sensors_tests.toml")["set"]["simulator.sensors"]
    assert added == table("simulator/flight_sensors.toml")["sensors"]


# --- faults are flown until they have met what the mission asks

OF_HOVER = {"robot_unmeasured_healthy"}
"""Sweeps that ask what is found in hover, not what is survived."""
SWEEPS = [name for name in places.names("sweeps") if not spec.load(name).is_sampled and name not in OF_HOVER]


def lasting(config):
    """Whether a fault lasts to the end of the flight; a robot lands after an engine's stop, which ends its flight."""
    disturbances = config.get("disturbances", {})
    failure = disturbances.get("jets", {}).get("failure")
    outages = [outage for outage in disturbances.get("outages", []) if "duration" not in outage]
    return bool(disturbances.get("joints") or outages or (failure and failure["kind"] != "off"))


def end_of_mission(config):
    """When the last part of a mission in a line ends [s]; zero of a mission of other parts."""
    parts = [part for parts in config["mission"].values() if isinstance(parts, list | tuple) for part in parts]
    return max((end for part in parts if isinstance(part, list | tuple) for end in part), default=0.0)


@pytest.mark.parametrize("name", SWEEPS)
def test_flights_with_a_lasting_fault_go_on_to_the_end_of_the_mission(name):
    """Those that end before have survived what they have not met."""
    design = Design(spec.load(name))
    for cell in range(len(design.cells)):
        config = design.cell_config(cell)
        if lasting(config):
            assert config["simulator"]["duration"] >= end_of_mission(config), design.cells[cell]


def test_a_short_flight_with_a_stuck_joint_is_found():
    config = rust.load_config("robot", {"simulator.duration": 25.0})
    stuck = [{"joint": "torso_pitch", "kind": "stuck", "start": 18.0}]
    config = rust.set_keys(config, {"disturbances.joints": stuck})
    assert lasting(config)
    assert config["simulator"]["duration"] < end_of_mission(config) == 47.0

"""Complete ticks of the controller: what it was given, and every intermediate value it computed.

`python -m tests.golden.ticks [NAME ...]` stores those of some flights again, of all if there is none.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.rust import Controller, State
from tests.golden import flights

FOLDER = Path(__file__).parent / "ticks"
INSTANTS = {
    "test1": (2200, 3000),
    "test2": (700, 1400, 2600),
    "test4": (1400,),
    "thrust_saturation": (1200, 2000),
    "balancing_front": (2000, 2500),
}
"""Rows of flights whose state, thrust, wind and feet the ticks start from."""

CHANGED: dict[str, dict[str, Any]] = {
    "test2_1400": {"memory.velocity_error_integral": 10.0 * np.cos(np.arange(23.0))},
    "balancing_front_2500": {"foot_wrenches": [[2.0, 0.0, 210.0, 1.0, 60.0, 0.0], [-2.0, 0.0, 214.0, -1.0, 48.0, 0.0]]},
}
"""Where a tick is given something else than its flight had, so that torques and foot wrenches reach their bounds: joint
errors in rad s, wrenches in N and N m with their centre of pressure beyond the toes."""

MEMORY = ("posture", "inertia_0_b", "velocity_error_integral")
GIVEN = ("base_position", "base_rotation", "joint_position", "velocity", "thrust", "wind", "time")
FEET = "foot_wrenches"

Values = dict[str, NDArray[np.float64]]

LEFT_OUT = {"estimates", "joint_condition", "measured_latency", "residual", "residual_wrench", "throttle"}
"""What a stored tick does not hold: without estimators the measurement, and what these flights have none of."""


def compute(config: rust.Config, given: Values) -> Values:
    """Compute the tick of a controller with this memory and set-point, all values by their names."""
    controller = Controller(config)
    state = State(*(given[key] for key in GIVEN[:4]))
    setpoint = {key.split(".")[1]: value for key, value in given.items() if key.startswith("setpoint.")}
    measurement = state, given["thrust"], given["wind"], float(given["time"])
    started = controller.start(*measurement, foot_wrenches=given.get(FEET))
    controller.state = started.with_posture_control(*(given[f"memory.{key}"] for key in MEMORY))
    return values(controller.tick(*measurement, setpoint=rust.Setpoint(**setpoint), foot_wrenches=given.get(FEET)))


def values(tick: rust.Tick) -> Values:
    """Return every number of a tick by its name, nested ones with a dot."""
    found: Values = {}

    def add(name: str, value: Any) -> None:
        if isinstance(value, np.ndarray):
            found[name] = value
        elif hasattr(value, "_asdict") or hasattr(value, "__dataclass_fields__"):
            parts = value._asdict() if hasattr(value, "_asdict") else vars(value)
            for key, part in parts.items():
                add(f"{name}.{key}", part)

    for key, value in vars(tick).items():
        if key not in LEFT_OUT:
            add(key, value)
    return found


def load_stored(name: str) -> tuple[Values, Values]:
    """Return what a stored tick was given, and what came out."""
    with np.load(FOLDER / f"{name}.npz") as file:
        content = dict(file)
    given = {key.removeprefix("given "): value for key, value in content.items() if key.startswith("given ")}
    return given, {key: value for key, value in content.items() if not key.startswith("given ")}


def make(names: list[str]) -> None:
    """Fly, take the instants and store their ticks."""
    FOLDER.mkdir(exist_ok=True)
    for name in names or INSTANTS:
        rows = INSTANTS[name]
        config = rust.load_config(name)
        log = flights.fly(config).log
        controller = Controller(config)
        before: rust.Tick | None = None
        for row in range(max(rows) + 1):
            given: Values = {
                "base_position": log["base_position"][row],
                "base_rotation": rust.rotation_from_wxyz(log["base_quaternion"][row]),
                "joint_position": log["joint_position"][row],
                "velocity": np.concatenate([log["base_velocity"][row], log["joint_velocity"][row]]),
                "thrust": log["thrust"][row],
                "wind": log.get("measured_wind", log["wind"])[row],
                "time": log["time"][row],
            }
            if "foot_wrench" in log:
                given[FEET] = log["foot_wrench"][row]
            measurement = State(*(given[key] for key in GIVEN[:4])), *(given[key] for key in GIVEN[4:])
            tick = controller.tick(*measurement, foot_wrenches=given.get(FEET))
            if row in rows and before is not None:
                given |= {f"memory.{key}": getattr(before, key) for key in MEMORY}
                given |= {key: value for key, value in values(tick).items() if key.startswith("setpoint.")}
                given |= {key: np.array(value) for key, value in CHANGED.get(f"{name}_{row}", {}).items()}
                found = compute(config, given)
                prefixed = {f"given {key}": value for key, value in given.items()}
                np.savez_compressed(FOLDER / f"{name}_{row}.npz", **prefixed, **found)
            before = tick


if __name__ == "__main__":
    make(sys.argv[1:])

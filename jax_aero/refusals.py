"""What the crate flies and JAX does not: one table of keys, which `jax_aero.sim.prepare` refuses.

>>> sorted({refusal.lacks for refusal in REFUSALS})[:2]
['channels', 'controllers of the crate']
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from jax_aero.config import MeasuredJetsConfig, ScenarioConfig, ThrottledJetsConfig

Find = Callable[[ScenarioConfig], Any]


class Refusal(NamedTuple):
    """A key of which JAX flies some values only."""

    key: str
    lacks: str
    """What JAX lacks, which the crate or the ground of MuJoCo has."""
    found: Find
    """Return the value that is not flown, and nothing, such as `None` or zero, of a configuration that is."""
    expected: str = "none"
    is_of_law: bool = False
    """Whether the law alone cannot be computed either."""


def _sensor(name: str, key: str) -> Find:
    return lambda config: getattr(getattr(config.simulator.sensors, name, None), key, None)


def _failure(config: ScenarioConfig) -> Any:
    return config.controller.fault_detection.engines is not None and config.disturbances.jets.failure


def _hidden_limit(config: ScenarioConfig) -> Any:
    jets, engines = config.disturbances.jets, config.controller.fault_detection.engines
    return None if engines is None or jets.limit_is_known else jets.thrust_limit_scale


def _shaft(config: ScenarioConfig) -> Any:
    jets = config.simulator.jets
    return jets.shaft if isinstance(jets, ThrottledJetsConfig) else None


BASE_SENSORS = ("base_position", "base_rotation", "base_linear_velocity", "base_angular_velocity")

GROUND, CHANNELS, DETECTION = "ground contact", "channels", "fault detection"

REFUSALS = (
    Refusal("simulator.ground", GROUND, lambda config: config.simulator.ground),
    Refusal("simulator.ground_height", GROUND, lambda config: config.simulator.ground_height),
    Refusal("simulator.sensors.feet", GROUND, lambda config: getattr(config.simulator.sensors, "feet", None)),
    Refusal("controller.contact", GROUND, lambda config: config.controller.contact, is_of_law=True),
    Refusal("controller.use_jets", GROUND, lambda config: not config.controller.use_jets, "true", is_of_law=True),
    Refusal("simulator.fuel", "fuel", lambda config: config.simulator.fuel),
    Refusal(
        "controller.torque.steps",
        "torques of a second rate",
        lambda config: config.controller.torque.steps > 1 and config.controller.torque.steps,
        "1",
    ),
    Refusal(
        "simulator.jets.dynamics",
        "maps of turbines",
        lambda config: isinstance(config.simulator.jets, MeasuredJetsConfig) and "measured",
        '"ideal" or "throttled"',
    ),
    Refusal("simulator.jets.shaft", "engines of shafts", _shaft),
    Refusal("controller.shaft", "engines of shafts", lambda config: config.controller.shaft, is_of_law=True),
    *(
        Refusal(f"simulator.sensors.{name}.{key}", CHANNELS, _sensor(name, key), "0")
        for name in BASE_SENSORS
        for key in ("period", "gaps")
    ),
    Refusal("simulator.sensors.height", CHANNELS, lambda config: getattr(config.simulator.sensors, "height", None)),
    Refusal(
        "disturbances.outages",
        CHANNELS,
        lambda config: [outage.kind for outage in config.disturbances.outages if outage.kind != "wrong"],
        'the kind "wrong" alone',
    ),
    Refusal("disturbances.jets.failure", DETECTION, _failure, "none with `controller.fault_detection.engines`"),
    Refusal(
        "disturbances.jets.thrust_limit_scale",
        DETECTION,
        _hidden_limit,
        "none with `controller.fault_detection.engines`, or that `limit_is_known`",
    ),
    Refusal(
        "disturbances.joints",
        DETECTION,
        lambda config: config.controller.fault_detection.joints is not None and config.disturbances.joints,
        "none with `controller.fault_detection.joints`",
    ),
    Refusal("own_controller", "controllers of the crate", lambda c: (c.own_controller or {}).get("name")),
)
"""All that is refused."""


def refused(config: ScenarioConfig, *, of_law: bool = False) -> list[Refusal]:
    """Return what a configuration has that JAX does not fly; of the law alone, its own."""
    return [refusal for refusal in REFUSALS if refusal.found(config) and (refusal.is_of_law or not of_law)]


def refuse(config: ScenarioConfig, *, of_law: bool = False) -> None:
    """Refuse what the crate, or MuJoCo's back end, flies and JAX does not, by all its keys; of the law alone, its own.

    Raises
    ------
    ValueError
        If the configuration contains any.
    """
    if reasons := list(_describe(config, of_law=of_law)):
        raise ValueError("\n".join(reasons))


def _describe(config: ScenarioConfig, *, of_law: bool) -> Iterator[str]:
    for refusal in refused(config, of_law=of_law):
        value = refusal.found(config)
        said = value if isinstance(value, int | float) and not isinstance(value, bool) else "given"
        crate = 'the crate flies it (`backend = "rust"`)'
        yield f"`{refusal.key}` is {said}; expected {refusal.expected}: JAX lacks {refusal.lacks}; {crate}"

"""The disturbances of a flight. One more is a file with a `Disturbance`, and here a field and a line of `configured`.

Errors of a part of the flight surround or replace it: `jet_faults` the jets, `aero.factors` the air forces,
`model_error` the controller's robot.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from typing import Any, TypeAlias

from jaxtyping import Float

from jax_aero.body.robot import RobotModel
from jax_aero.config import ScenarioConfig
from jax_aero.control.measurement import Measurement
from jax_aero.sim.actuation import Actuation, actuation
from jax_aero.sim.disturbance import Disturbance, Moment
from jax_aero.sim.plant import Acting, n_ticks
from jax_aero.sim.pushes import Pushes, configured_pushes
from jax_aero.sim.sensors import Sensors, sensors
from jax_aero.sim.wind import Wind
from jax_aero.sim.wind_estimate import WindEstimate, wind_estimate
from jax_aero.types import Array, leaf, pytree

States: TypeAlias = dict[str, Any]
"""State of every disturbance between two ticks, by name."""


@pytree
class Disturbances:
    """Disturbances in the order in which they act; `None` for those that a flight does not have."""

    wind_estimate: WindEstimate | None
    sensors: Sensors | None
    actuation: Actuation | None
    pushes: Pushes | None

    def each(self) -> Iterator[tuple[str, Disturbance]]:
        """Yield those of this flight by name."""
        for item in fields(self):
            if (disturbance := getattr(self, item.name)) is not None:
                yield item.name, disturbance

    def start(self, first: Measurement) -> States:
        """Return all states at the first tick, given its true values."""
        return {name: disturbance.start(first) for name, disturbance in self.each()}

    def measure(self, states: States, true: Measurement, moment: Moment) -> tuple[States, Measurement]:
        """Return the next states, and what the controller receives."""
        after, measurement = dict(states), true
        for name, disturbance in self.each():
            after[name], measurement = disturbance.measure(states[name], measurement, moment)
        return after, measurement

    def act(self, states: States, commanded: Acting, step: Float[Array, ""]) -> tuple[States, Acting]:
        """Return the next states, and what acts on the plant in the sub-steps of a tick, of `step` [s] each."""
        after, acting = dict(states), commanded
        for name, disturbance in self.each():
            after[name], acting = disturbance.act(states[name], acting, step)
        return after, acting


def configured(config: ScenarioConfig, robot: RobotModel, measured_wind: Wind) -> Disturbances:
    """Return the configured disturbances. Call it outside loops, since noise, delays and losses are drawn."""
    simulator, given, ticks = config.simulator, config.disturbances, n_ticks(config)
    time_step, joints, jets = leaf(config.controller.time_step), robot.n_joints, robot.jets.count
    estimate, sensing, way = given.wind_estimate, simulator.sensors, simulator.actuation
    return Disturbances(
        wind_estimate=None if estimate is None else wind_estimate(estimate, time_step, measured_wind, ticks),
        sensors=None if sensing is None else sensors(sensing, time_step, ticks, joints, jets),
        actuation=None if way is None else actuation(way, config.controller.time_step, simulator.substeps, ticks),
        pushes=configured_pushes(given.pushes, robot),
    )

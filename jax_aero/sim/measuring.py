"""What the controller is given of the simulated robot: sensors, errors of the measured wind, outages.

```text
truth ──► sensors ──► outages ──► Measurement ──► controller
wind ──► errors of the measured wind ──┘
```
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float, Int

from jax_aero.body.robot import RobotModel
from jax_aero.config import ScenarioConfig
from jax_aero.control.measurement import Measurement
from jax_aero.sim.outages import WrongChannel, wrong_channels
from jax_aero.sim.sensors import Sensors, SensorState, sensors
from jax_aero.sim.wind import Wind, wind_model, wind_velocity
from jax_aero.sim.wind_estimate import WindEstimate, wind_estimate
from jax_aero.types import Array, leaf, pytree


class MeasuringState(NamedTuple):
    """State between two ticks."""

    sensors: SensorState | None
    wind: Float[Array, "3"] | None
    """Measured wind of the last tick [m/s]; `None` without errors."""


@pytree
class Measuring:
    """What stands between a simulated robot and its controller."""

    sensors: Sensors | None
    """Errors of what is measured; `None` for none."""
    controller_wind: Wind | None
    """Wind that the controller receives in place of the simulated one."""
    wind_estimate: WindEstimate | None
    """Errors of the measured wind; `None` for none."""
    outages: tuple[WrongChannel, ...]

    @property
    def computed_from(self) -> tuple[str, ...]:
        """Return the wind whose mean is measured."""
        has_mean = self.wind_estimate is not None and self.wind_estimate.mean is not None
        return ("controller_wind",) if has_mean else ()

    def start(self, first: Measurement) -> MeasuringState:
        """Return the state before the first tick, of a robot whose exact measurement is `first`."""
        measured = None if self.wind_estimate is None else jnp.zeros_like(first.wind)
        return MeasuringState(None if self.sensors is None else self.sensors.start(first), measured)

    def measure(
        self,
        state: MeasuringState,
        true: Measurement,
        tick: Int[Array, ""],
        wind: Wind,
        time_step: Float[Array, ""],
    ) -> tuple[MeasuringState, Measurement]:
        """Return the next state, and the measurement of a tick of which `true` is the exact one."""
        sample, given = true, wind if self.controller_wind is None else self.controller_wind
        if self.wind_estimate is not None and state.wind is not None:
            measured = self.wind_estimate.measure(state.wind, given, tick, time_step)
            state, sample = state._replace(wind=measured), sample._replace(wind=measured)
        elif self.controller_wind is not None:
            sample = sample._replace(wind=wind_velocity(given, true.time))
        if self.sensors is not None and state.sensors is not None:
            reading, sample = self.sensors.measure(state.sensors, sample, tick, wind)
            state = state._replace(sensors=reading)
        for outage in self.outages:
            sample = outage.spoil(sample)
        return state, sample


def measuring(config: ScenarioConfig, robot: RobotModel, wind: Wind, ticks: int, drawn: int) -> Measuring:
    """Return what is measured in a flight of `ticks` ticks. Call it outside loops: it draws noise of `drawn` ticks."""
    simulator, disturbances, step = config.simulator, config.disturbances, config.controller.time_step
    replaced, errors, sensing = disturbances.controller_wind, disturbances.wind_estimate, simulator.sensors
    given = None if replaced is None else wind_model(replaced)
    return Measuring(
        None if sensing is None else sensors(sensing, leaf(step), drawn, robot.n_joints, robot.jets.count),
        given,
        None if errors is None else wind_estimate(errors, given or wind, step, ticks, drawn),
        wrong_channels(disturbances.outages, robot),
    )

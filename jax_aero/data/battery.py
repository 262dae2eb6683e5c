"""Why jets and not electric fans: the paper's comparison of battery and fuel for a hovering robot.

A hovering robot of mass m needs a thrust equal to its weight, and consumption is proportional to thrust (the paper's
assumptions). A battery keeps its mass, fuel is burnt:

```text
battery   m_b = e t (m + m_b)          ⇒  m_b = m x / (1 − x),   x = p t / E
fuel      dm/dt = −c m, empty at t     ⇒  m_f = m (exp(c t) − 1)
```

p power per thrust [W/kg], E specific energy [Wh/kg], c fuel mass per thrust and time [1/s], t flight time.
Source: paper, Methods, "Actuators Selection".
"""

from __future__ import annotations

import math

from jax_aero.base import tables
from jax_aero.base.tables import Positive

PAPER_BATTERY, PAPER_FUEL = 26.31, 4.61
"""Values printed in the paper [kg]."""


class Choice(tables.Table, frozen=True):
    """The paper's numbers."""

    robot_mass: Positive = 40.0
    """Mass of the robot without energy storage [kg]."""
    minutes: Positive = 5.0
    fan_thrust: Positive = 15.0
    """Thrust of the electric fan [kg]."""
    fan_power: Positive = 13.0
    """Power of the electric fan [kW]."""
    specific_energy: Positive = 210.0
    """Specific energy of LiPo batteries [Wh/kg]."""
    jet_thrust: Positive = 22.0
    """Thrust of the jet engine [kg]."""
    jet_consumption: Positive = 0.6
    """Fuel consumption of the jet engine [l/min]."""
    fuel_density: Positive = 0.8
    """Density of the fuel [kg/l]."""

    def battery(self, power_per_thrust: float | None = None) -> float:
        """Return the mass of a battery that carries itself too [kg]; power per thrust [kW/kg], by default the fan's."""
        power = self.fan_power / self.fan_thrust if power_per_thrust is None else power_per_thrust
        share = 1e3 * power * (self.minutes / 60.0) / self.specific_energy
        return self.robot_mass * share / (1.0 - share) if share < 1.0 else math.inf

    def fuel(self) -> float:
        """Return the mass of fuel that is completely burnt in flight [kg]."""
        per_minute = self.jet_consumption * self.fuel_density / self.jet_thrust
        return self.robot_mass * (math.exp(per_minute * self.minutes) - 1.0)

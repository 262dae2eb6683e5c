"""The flight controller: from a measurement to thrust rates and joint torques, one pure function of one sample.

    State, thrust, wind, Setpoint ► MomentumModel ► MomentumQp ► thrust rates, joint velocities ► TorqueQp ► torques

`tick.py` is the whole of it: `momentum_controller` collects its numbers from a configuration, `init` starts it, `tick`
is called every tick. The other modules are its parts, under the names they have in the Rust crate. The simulator flies
any `Controller`.
"""

from jax_aero.control.protocol import Command, Controller, Measurement

__all__ = ["Command", "Controller", "Measurement"]

"""The flight controller: from a measurement to thrust rates and joint torques, one pure function of one sample.

    State, thrust, wind, Setpoint ► MomentumModel ► MomentumQp ► thrust rates, joint velocities ► TorqueQp ► torques

`tick.py` contains the whole sequence: `momentum_controller` collects its numbers from a configuration, `init` returns
the initial state, and `tick` is called once per tick. The other modules are its parts, with the names of the Rust
crate's modules. The simulator accepts any `Controller`.
"""

from jax_aero.control.protocol import Command, Controller, Measurement

__all__ = ["Command", "Controller", "Measurement"]

"""The flight controller: from a measurement to thrust rates and joint torques, one pure function of one sample.

    measure ► model ► observe ► law ► torques ► predict

`tick.py` has the sequence: `momentum_controller` collects its numbers from a configuration, `init` returns the initial
state, and `tick` is called once per tick. The other modules are its parts, with the names of the Rust crate's modules;
of its estimation there are estimator and observers (`estimate`), not what detects faults. The simulator accepts any
`Controller`.
"""

from jax_aero.control.command import Command
from jax_aero.control.measurement import Measurement
from jax_aero.control.preview import Preview
from jax_aero.control.protocol import Controller

__all__ = ["Command", "Controller", "Measurement", "Preview"]

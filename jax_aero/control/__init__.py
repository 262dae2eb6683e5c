"""The flight controller: from a measurement to thrust rates and joint torques, one pure function of one sample.

    State, thrust, wind, Reference ► MomentumModel ► MomentumQp ► thrust rates, joint velocities ► TorqueQp ► torques

`tick.py` is the whole of it: `controller_params` collects its numbers from a configuration, `init` starts it, `tick`
is called every tick. The other modules are its parts, with the names of the Rust crate's.
"""

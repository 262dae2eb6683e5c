"""A push on the chest of the realistic robot, which flies the recommended controller."""

import numpy as np

from jax_aero import rust

push = {"body": "chest", "start": 2.0, "duration": 0.2, "force": [50.0, 0.0, 0.0]}  # s, s, N
flight = rust.fly(rust.load_config("robot", {"simulator.duration": 5.0, "disturbances.pushes": [push]}))
error = np.degrees(flight["rotation_error"])
print(f"{flight.outcome}; {error.max():.1f}° at most, {error[-1]:.1f}° three seconds later")

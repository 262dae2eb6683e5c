"""Aerodynamic force on the hovering robot by wind direction, from the simulator's own model."""

from jax_aero import rust

for wind in ([-10.0, 0.0, 0.0], [0.0, -10.0, 0.0], [0.0, 0.0, -10.0]):
    config = rust.load_config("test2", {"wind": {"profile": "constant", "velocity": wind}})
    flight = rust.Flight(config)
    flight.step()
    print("wind", wind, "m/s: force", flight.result()["aero_force_sim"][0].sum(axis=0).round(1), "N")

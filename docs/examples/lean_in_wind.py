"""How far the published controller without an aerodynamic model leans in side wind."""

from jax_aero import rust

speeds = [6.0, 10.0, 14.0, 18.0]
configs = [rust.load_config("test1", {"wind.velocity": [0.0, -speed, 0.0]}) for speed in speeds]
for speed, flight in zip(speeds, rust.fly_batch(configs), strict=True):
    print(f"{speed:4.0f} m/s: {flight.outcome}, rotation error {flight.summary['max_rotation_error']:.2f} rad")

"""An arm engine stops while the robot hovers in wind: height and speed of the descent."""

from jax_aero import rust

flight = rust.fly(rust.load_config("engine_out_mpc"))
height, time = flight["com_position"][:, 2], flight["time"]
print(f"{flight.outcome} at {time[-1]:.1f} s, {height.max() - height[-1]:.1f} m lower")
print("thrusts at the end:", flight["thrust"][-1].round(), "N")

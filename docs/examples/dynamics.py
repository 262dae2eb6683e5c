"""Mass matrix, bias and Jacobian of a jet of the hovering robot, and its acceleration under a force, with NumPy."""

import numpy as np

from jax_aero import rust

robot = rust.Robot(rust.load_config("test2")["robot"])
state = rust.State.at_rest(robot)
dynamics = rust.dynamics(robot, state)
jet = robot.jet_frames[0]
force = rust.frame_jacobian(robot, jet, state).linear.T @ [0.0, 0.0, 100.0]
acceleration = rust.forward_dynamics(robot, state, force)
assert np.allclose(dynamics.mass_matrix @ acceleration + dynamics.bias, force)
print(f"100 N upwards at {jet}: the base accelerates by {acceleration[2]:.1f} m/s²")

"""From a URDF to a robot that flies: description, trim, initial state, hover."""

"""From a URDF to a flying robot: description, trim, initial state, hover."""

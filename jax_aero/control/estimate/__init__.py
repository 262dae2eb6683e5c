"""What is estimated from measurements: the state, disturbances and the wind."""

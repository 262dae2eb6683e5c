"""A real quadrotor's numbers from its public logs."""

"""Numbers of drawn robots, found in their own logs."""

"""The control law: from the set-point to thrust rates and joint velocities (`rates`), and from these to torques."""

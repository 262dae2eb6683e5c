"""The robot and its jets: description, kinematics, dynamics."""

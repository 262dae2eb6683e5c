"""The robot in MuJoCo: its model, and flights from the ground."""

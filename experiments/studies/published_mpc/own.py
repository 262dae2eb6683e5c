"""The published controller as one of a file, for `jax-aero challenge` (`own.py:MultiRate`, with --tick 0.005)."""

from __future__ import annotations

from experiments.studies.published_mpc.flight import Published
from jax_aero import rust


class MultiRate:
    """It begins with its first measurement; of the configuration it reads robot, mission and duration."""

    def __init__(self, config: rust.Config) -> None:
        self.config = config
        self.pilot: Published | None = None

    def __call__(self, measured: rust.Measurement) -> rust.Command:
        """Compute one tick."""
        self.pilot = self.pilot or Published(self.config, measured)
        return self.pilot.command(measured)

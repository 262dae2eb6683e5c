"""Back ends that fly a configuration: `backend = "rust"`, `"jax"` or `"mujoco"` in a file, or --backend.

A back end computes a `rust.FlightResult` from a resolved configuration. A flight of a batch that cannot be computed is
replaced by a `Failure`, so that it is recorded and the other flights continue.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from jax_aero import rust
from jax_aero.base.terminal import Refused

Config = Mapping[str, Any]


@dataclass(frozen=True)
class Failure:
    """A flight without a result, and the reason."""

    reason: str


MODULES = {"rust": "jax_aero.rust", "jax": "jax_aero.sim", "mujoco": "jax_aero.mujoco.ground"}
"""Module of each back end."""


@dataclass(frozen=True)
class Backend:
    """A module with the function `fly` and, optionally, `fly_batch`."""

    name: str
    module: Any

    @property
    def together(self) -> int:
        """Return how many batches fly at once: of the crate, one begins while another ends on few cores."""
        return 2 if self.name == "rust" else 1

    def fly(self, config: Config, progress: rust.Progress | None = None) -> rust.FlightResult:
        """Fly one configuration, with the whole log."""
        flown: rust.FlightResult = self.module.fly(config, progress)
        return flown

    def fly_batch(
        self, configs: Sequence[Config], threads: int | None = None, progress: rust.Progress | None = None
    ) -> list[rust.FlightResult | Failure]:
        """Fly many configurations, in their order; if one is refused, fly the others without it.

        Only outcomes and summaries are guaranteed. `threads` applies to the crate, since JAX has its own.
        """
        together: Callable[..., list[rust.FlightResult]] | None = getattr(self.module, "fly_batch", None)
        more = {"threads": threads} if self.name == "rust" else {}
        if together is not None:
            try:
                return list(together(configs, progress=progress, **more))
            except ValueError:
                progress = None  # some flights may already be counted
        flights: list[rust.FlightResult | Failure] = []
        for config in configs:
            try:
                flights.append(self.module.fly(config) if together is None else together([config])[0])
            except ValueError as reason:
                flights.append(Failure(str(reason)))
            if progress is not None:
                progress(len(flights), len(configs))
        return flights


def backend(name: str) -> Backend:
    """Return the back end with this name."""
    if name not in MODULES:
        raise Refused(f"backend = {name!r}; expected one of {', '.join(MODULES)}")
    try:
        return Backend(name, importlib.import_module(MODULES[name]))
    except ImportError as reason:
        raise Refused(
            f'backend = "{name}" needs `{MODULES[name]}` and the packages of the extra `twin`, which are not here '
            f"({reason})"
        ) from None


def backend_of(config: Config) -> str:
    """Return the name of the back end of a configuration."""
    return str(config.get("backend", "rust"))

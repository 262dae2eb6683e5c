"""Engines that fly a configuration: `engine = "rust"`, `"jax"` or `"mujoco"`, in a file or with --engine.

An engine turns a resolved configuration into the same `rust.FlightResult`. A flight of a batch that cannot be flown
gives a `Failure` in its place, so that it is recorded and the others go on.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from experiments import Refused
from jax_aero import rust

Config = Mapping[str, Any]


@dataclass(frozen=True)
class Failure:
    """A flight that has no result, and why."""

    reason: str


MODULES = {"rust": "jax_aero.rust", "jax": "jax_aero.sim", "mujoco": "jax_aero.mujoco_ground"}
"""Where each engine is."""


class Engine(Protocol):
    """One way to fly."""

    def fly(self, config: Config, progress: rust.Progress | None = None) -> rust.FlightResult:
        """Fly one configuration, with its whole log."""
        ...

    def fly_batch(
        self, configs: Sequence[Config], threads: int | None = None, progress: rust.Progress | None = None
    ) -> list[rust.FlightResult | Failure]:
        """Fly many; only outcomes and summaries are sure to be there. The order is that of `configs`."""
        ...


class Rust:
    """The crate: one flight per thread."""

    def fly(self, config: Config, progress: rust.Progress | None = None) -> rust.FlightResult:
        """Fly one configuration."""
        return rust.fly(config, progress)

    def fly_batch(
        self, configs: Sequence[Config], threads: int | None = None, progress: rust.Progress | None = None
    ) -> list[rust.FlightResult | Failure]:
        """Fly many over threads; where the crate refuses one, fly the others without it."""
        try:
            return list(rust.fly_batch(configs, threads, progress))
        except ValueError:
            return [_alone(_fly_without_log, config) for config in configs]


class Jax:
    """The differentiable simulation: needs the packages of JAX."""

    def __init__(self) -> None:
        try:
            module = importlib.import_module(MODULES["jax"])
            self._fly: Callable[..., rust.FlightResult] = module.fly
            self._fly_batch: Callable[..., list[rust.FlightResult]] = module.fly_batch
        except (ImportError, AttributeError) as reason:
            raise Refused(
                'engine = "jax" needs `jax_aero.sim` and the packages it builds on, which are not here '
                f'({reason}); engine = "rust" flies the same configurations'
            ) from None

    def fly(self, config: Config, progress: rust.Progress | None = None) -> rust.FlightResult:
        """Fly one configuration."""
        return self._fly(_without_engine(config), progress)

    def fly_batch(
        self,
        configs: Sequence[Config],
        threads: int | None = None,  # noqa: ARG002 - JAX keeps its own threads
        progress: rust.Progress | None = None,
    ) -> list[rust.FlightResult | Failure]:
        """Fly flights of one structure together; where one is refused, fly the others without it."""
        plain = [_without_engine(config) for config in configs]
        try:
            return list(self._fly_batch(plain, progress))
        except ValueError:
            return [_alone(lambda config: self._fly_batch([config])[0], config) for config in plain]


class Mujoco:
    """MuJoCo with the ground under the robot and the crate's controller in the loop: needs its package."""

    def __init__(self) -> None:
        try:
            module = importlib.import_module(MODULES["mujoco"])
            self._fly: Callable[..., rust.FlightResult] = module.fly
        except ImportError as reason:
            raise Refused(
                f'engine = "mujoco" needs the packages of the extra `twin`, which are not here ({reason})'
            ) from None

    def fly(self, config: Config, progress: rust.Progress | None = None) -> rust.FlightResult:
        """Let one robot stand."""
        return self._fly(config, progress)

    def fly_batch(
        self,
        configs: Sequence[Config],
        threads: int | None = None,  # noqa: ARG002 - Python drives every tick
        progress: rust.Progress | None = None,
    ) -> list[rust.FlightResult | Failure]:
        """One after the other."""
        flights: list[rust.FlightResult | Failure] = []
        for config in configs:
            flights.append(_alone(self.fly, config))
            if progress is not None:
                progress(len(flights), len(configs))
        return flights


ENGINES: Mapping[str, Callable[[], Engine]] = {"rust": Rust, "jax": Jax, "mujoco": Mujoco}


def engine(name: str) -> Engine:
    """Return the engine of a name."""
    if name not in ENGINES:
        raise Refused(f"engine = {name!r}; expected one of {', '.join(ENGINES)}")
    return ENGINES[name]()


def engine_of(config: Config) -> str:
    """Return the name of the engine of a configuration."""
    return str(config.get("engine", "rust"))


def _fly_without_log(config: Config) -> rust.FlightResult:
    return rust.fly_batch([config], 1)[0]


def _alone(fly: Callable[[Config], rust.FlightResult], config: Config) -> rust.FlightResult | Failure:
    try:
        return fly(config)
    except ValueError as reason:
        return Failure(str(reason))


def _without_engine(config: Config) -> dict[str, Any]:
    """Return the configuration without the keys that only select the engine."""
    return {key: value for key, value in config.items() if key != "engine"}

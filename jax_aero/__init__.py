"""Flight of a jet-powered humanoid robot in the wind.

Examples
--------
>>> import jax_aero
>>> config = jax_aero.load("test2", {"simulator.duration": 0.1})
>>> jax_aero.fly(config).outcome
'completed'

`load`, `fly` and `fly_batch` call the Rust crate, which is the reference for physics and control (`jax_aero.rust` has
its other functions). `prepare` and `rollout` compute the same flight in JAX, for `jit`, `vmap` and `grad`;
`replace_values` replaces numbers in what `prepare` returns, by names of `value_names` (`jax_aero.sim` has the other
functions). `air` gives
aerodynamic forces to other simulators, and `env` is the flight as a reinforcement-learning environment. Packages of the
extras are imported on first use: `twin` brings those of `sim`, `air` and `env`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jax_aero import air as air
    from jax_aero import env as env
    from jax_aero import rust as rust
    from jax_aero import sim as sim
    from jax_aero.rust import __version__ as __version__
    from jax_aero.rust import fly as fly
    from jax_aero.rust import fly_batch as fly_batch
    from jax_aero.rust import load_config
    from jax_aero.sim.preparation import prepare as prepare
    from jax_aero.sim.rollout import rollout as rollout
    from jax_aero.types import replace_values as replace_values
    from jax_aero.types import value_names as value_names

    load = load_config

_PLACES = {
    "__version__": "jax_aero.rust:__version__",
    "air": "jax_aero.air",
    "replace_values": "jax_aero.types:replace_values",
    "env": "jax_aero.env",
    "fly": "jax_aero.rust:fly",
    "fly_batch": "jax_aero.rust:fly_batch",
    "load": "jax_aero.rust:load_config",
    "prepare": "jax_aero.sim:prepare",
    "rollout": "jax_aero.sim:rollout",
    "rust": "jax_aero.rust",
    "sim": "jax_aero.sim",
    "value_names": "jax_aero.types:value_names",
}

__all__ = list(_PLACES)


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module `jax_aero` has no attribute `{name}`")
    module, _, attribute = _PLACES[name].partition(":")
    imported: Any = importlib.import_module(module)
    return getattr(imported, attribute) if attribute else imported


def __dir__() -> list[str]:
    return sorted([*globals(), *_PLACES])

"""Flight of a jet-powered humanoid robot in the wind.

`jax_aero.rust` exposes the Rust crate, which is the authority on physics and control: load a configuration, fly it,
read the log as NumPy arrays. `jax_aero.sim` is the same flight in JAX, which works without the compiled crate.
"""

from typing import Any

__all__ = ["__version__", "rust"]


def __getattr__(name: str) -> Any:
    # On first use: parts of the package that do not need the compiled crate load without it.
    if name not in __all__:
        raise AttributeError(f"module `jax_aero` has no attribute `{name}`")
    import importlib

    rust = importlib.import_module("jax_aero.rust")
    return rust if name == "rust" else rust.__version__

"""Flight of a jet-powered humanoid robot in the wind.

`jax_aero.rust` exposes the Rust crate, which is the authority on physics and control:
load a configuration, fly it, read the log as NumPy arrays.
"""

from jax_aero import rust
from jax_aero.rust import __version__

__all__ = ["__version__", "rust"]

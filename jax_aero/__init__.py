"""Flight of a jet-powered humanoid robot in the wind.

`jax_aero.reference` exposes the Rust crate, which is the authority on physics and control:
load a configuration, fly it, read the log as NumPy arrays.
"""

from jax_aero import reference
from jax_aero.reference import __version__

__all__ = ["__version__", "reference"]

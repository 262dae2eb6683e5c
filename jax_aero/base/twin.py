"""JAX, which the library imports only where it computes with it; without it an error names the extra that brings it."""

from jax_aero.base.terminal import missing_package

try:
    import jax
    import jax.numpy as jnp
    from jaxtyping import Float, Int, Key
except ModuleNotFoundError as missing:
    raise ModuleNotFoundError(missing_package("this module", missing, "twin"), name=missing.name) from None

__all__ = ["Float", "Int", "Key", "jax", "jnp"]

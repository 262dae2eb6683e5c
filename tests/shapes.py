"""A plugin of pytest, `-p tests.shapes`: the functions of `jax_aero` check the shapes that they state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from beartype import beartype
from jaxtyping import install_import_hook

KINDS = ("Float[", "Int[", "Bool[", "Key[", "Shaped[")


def check_shapes(function: Callable[..., Any]) -> Callable[..., Any]:
    """Check arrays alone: a protocol is no class, and a field has one more axis while a batch is put together."""
    hints = function.__annotations__
    function.__annotations__ = {name: hint for name, hint in hints.items() if states_shape(hint)}
    return function if function.__name__ == "__init__" else beartype(function)


def states_shape(hint: Any) -> bool:
    """Whether an annotation states the shape of an array."""
    return any(kind in str(hint) for kind in KINDS)


install_import_hook("jax_aero", "tests.shapes.check_shapes")

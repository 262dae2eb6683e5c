"""What brings a package that is not installed: every module of this package that cannot be imported names an extra."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import ModuleType
from typing import Any

EXTRAS = {
    "jax_aero.air_warp": "warp",
    "jax_aero.env_gym": "rl",
    "jax_aero.symbolic": "symbolic",
    "jax_aero.view": "view",
}
"""Extras of modules, and of the modules in these packages, that need others than `twin`."""


def missing_package(what: str, missing: ModuleNotFoundError, extras: str) -> str:
    """Return the message about a package that is not installed: what needs it, and what brings it."""
    return f"{what} needs the package `{_package(missing)}`: pip install 'jax-aero[{extras}]'"


def is_ours(missing: ModuleNotFoundError) -> bool:
    """Return whether a module of this project is missing, which no extra brings."""
    return _package(missing) in ("", "jax_aero", "experiments", "paper_figs")


def extra_of(module: str) -> str:
    """Return the extra that a module of `jax_aero` needs.

    >>> extra_of("jax_aero.symbolic.trim"), extra_of("jax_aero.sim")
    ('symbolic', 'twin')
    """
    return next((extra for name, extra in EXTRAS.items() if f"{module}.".startswith(f"{name}.")), "twin")


def install() -> None:
    """Make modules of `jax_aero` name their extra if they cannot be imported for want of a package."""
    if PathFinder in sys.meta_path:
        sys.meta_path.insert(sys.meta_path.index(PathFinder), _Finder())


class _Finder:
    """Finds modules as Python does, and gives those of `jax_aero` the loader below."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: Any = None) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path, target) if name.startswith("jax_aero.") else None
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = _Loader(spec.loader.name, spec.loader.path)
        return spec


class _Loader(SourceFileLoader):
    def exec_module(self, module: ModuleType) -> None:
        try:
            super().exec_module(module)
        except ModuleNotFoundError as missing:
            if is_ours(missing):
                raise
            name = module.__name__
            message = missing_package(f"`{name}`", missing, extra_of(name))
            raise ModuleNotFoundError(message, name=missing.name) from None


def _package(missing: ModuleNotFoundError) -> str:
    return (missing.name or "").partition(".")[0]

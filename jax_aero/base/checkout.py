"""What a checkout of the repository has and a wheel has not: studies, the report on the paper, the paper's figures."""

from __future__ import annotations

import importlib
import sys
from importlib import util
from pathlib import Path
from typing import Any

from jax_aero.base import places
from jax_aero.base.terminal import Refused


def require() -> None:
    """Refuse to go on without a checkout."""
    if not places.IS_CHECKOUT:
        raise Refused("this needs a checkout of the repository, with its folders `experiments` and `paper_figs`")


def modules(pattern: str) -> list[str]:
    """Return the names of the modules of a checkout whose files have this pattern; none without a checkout."""
    paths = sorted(places.HOME.glob(pattern)) if places.IS_CHECKOUT else []
    return [".".join(path.relative_to(places.HOME).with_suffix("").parts) for path in paths if path.stem != "__init__"]


def load(name: str) -> Any:
    """Import a module of a package of the checkout, found by its folder: others may have a package of that name.

    Raises
    ------
    Refused
        Without a checkout, or if another package of that name is imported already.
    """
    require()
    top = name.partition(".")[0]
    folder = places.HOME / top
    if top not in sys.modules:
        spec = util.spec_from_file_location(top, folder / "__init__.py", submodule_search_locations=[str(folder)])
        assert spec is not None
        assert spec.loader is not None
        sys.modules[top] = util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[top])
    elif folder not in (Path(place).resolve() for place in sys.modules[top].__path__):
        raise Refused(f"another package `{top}` is imported already; expected that of {folder}")
    return importlib.import_module(name)

"""Viewing of flights: `jax-aero view` in a browser, `video` and `snapshot` as files, `export` for other viewers.

```
run.nc or rust.FlightResult ► Recording ► page of rust/lab, or Instant ► drawing ► video, snapshot
                                                    by offscreen (MuJoCo) or painter (Pillow)
```
The rest of the library does not import this package; its own dependencies are the extra `view`.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from pathlib import Path

from jax_aero.base.terminal import Refused as Refused
from jax_aero.base.terminal import missing_package


def require(modules: Iterable[str], purpose: str, extra: str = "view") -> None:
    """Raise `Refused`, with instructions to install them by an extra, if these modules cannot be imported."""
    for module in modules:
        try:
            importlib.import_module(module)
        except ModuleNotFoundError as missing:
            raise Refused(missing_package(purpose, missing, extra)) from None


def check_out(out: Path, *suffixes: str) -> None:
    """Raise `Refused` if `out` has a wrong suffix or its folder does not exist; call it before any work."""
    if out.suffix.lower() not in suffixes:
        raise Refused(f"`{out}` does not end in {' or '.join(suffixes)}; expected a file like flight{suffixes[0]}")
    if not out.parent.is_dir():
        raise Refused(f"there is no folder `{out.parent}` for `{out.name}`")

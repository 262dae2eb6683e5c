"""See a flight: `python -m jax_aero view` in a browser, `video` and `snapshot` as files.

```
run.nc or rust.FlightResult ► Recording ► Instant ► drawing ► page (viser) or offscreen (MuJoCo) ► video, snapshot
```
Nothing here is imported by the rest of the library; what it needs besides is the extra `view`.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable

from jax_aero.command import Refused as Refused


def require(modules: Iterable[str], purpose: str) -> None:
    """Raise `Refused`, with how to install them, unless these modules can be imported."""
    for module in modules:
        try:
            importlib.import_module(module)
        except ModuleNotFoundError as reason:
            raise Refused(f"{purpose} needs `{reason.name}`; install it with: pip install 'jax-aero[view]'") from None

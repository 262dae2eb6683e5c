"""The one reader of `run.nc`, the file of a result: a dataset in SI units.

`experiments.record` writes these files; `rust.signals` declares what those of flights hold.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from jax_aero import rust
from jax_aero.base import netcdf
from jax_aero.base.result import REPEATED
from jax_aero.base.terminal import Refused


@contextmanager
def opened(path: Path) -> Iterator[xr.Dataset]:
    """Open the file of a result; a damaged one, and one that lacks what is read from it, is refused by name."""
    try:
        found = netcdf.open_dataset(path)
    except Exception as reason:  # HDF5 fails in many ways on a damaged file
        raise Refused(f"{path} is damaged ({reason}); remove its folder and make it again") from None
    with found:
        try:
            yield _complete(found)
        except Refused:
            raise
        except KeyError as missing:
            what = str(missing.args[0]).partition(". ")[0]
            raise Refused(f"{path}: {what}; other code made it, --overwrite makes it again") from None
        except (AttributeError, IndexError, OSError, TypeError, ValueError) as reason:  # of other shapes and types
            raise Refused(f"{path} is damaged ({reason}); remove its folder and make it again") from reason


def read(path: Path) -> xr.Dataset:
    """Read the whole file of a result, as `opened`."""
    with opened(path) as found:
        return found.load()


def _complete(found: xr.Dataset) -> xr.Dataset:
    """Return the dataset of a file with the raw measurements that it left out, see `result.is_repeated`.

    A file of an older version has no raw measurement.
    """
    if "raw_base_rotation" not in found:
        return found
    known: dict[str, Any] = {raw: found[name] for raw, name in REPEATED.items() if name in found}
    if "thrust" in found:
        known["raw_shaft_speed"] = xr.full_like(found["thrust"], np.nan)
    declared = rust.signals()
    return found.assign(
        {
            name: values.assign_attrs(units=declared[name].unit, long_name=declared[name].meaning)
            for name, values in known.items()
            if name not in found
        }
    )

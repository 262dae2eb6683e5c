"""The one reader of `run.nc`, the file of a result: a dataset in SI units.

`jax_aero.results.record` writes these files; `rust.signals` declares what those of flights hold.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from jax_aero.base import crate, netcdf
from jax_aero.base.quantities import attributes_of
from jax_aero.base.result import REPEATED
from jax_aero.base.terminal import Refused


@contextmanager
def opened(path: Path) -> Iterator[xr.Dataset]:
    """Open the file of a result; a damaged one, and one that lacks what is read from it, is refused by name."""
    try:
        dataset = netcdf.open_dataset(path)
    except Exception as reason:  # HDF5 fails in many ways on a damaged file
        raise Refused(f"{path} is damaged ({reason}); remove its folder and make it again") from None
    with dataset:
        try:
            yield _complete(dataset)
        except Refused:
            raise
        except KeyError as missing:
            what = str(missing.args[0]).partition(". ")[0]
            raise Refused(f"{path}: {what}; other code made it, --overwrite makes it again") from None
        except (AttributeError, IndexError, OSError, TypeError, ValueError) as reason:  # of other shapes and types
            raise Refused(f"{path} is damaged ({reason}); remove its folder and make it again") from reason


def read(path: Path) -> xr.Dataset:
    """Read the whole file of a result, as `opened`."""
    with opened(path) as dataset:
        return dataset.load()


def _complete(dataset: xr.Dataset) -> xr.Dataset:
    """Return the dataset of a file, its signals as they are declared today.

    Raw measurements that it left out are there, see `result.is_repeated`; a file of an older version has none.
    """
    if "raw_base_rotation" in dataset:
        left_out: dict[str, Any] = {raw: dataset[name] for raw, name in REPEATED.items() if name in dataset}
        if "thrust" in dataset:
            left_out["raw_shaft_speed"] = xr.full_like(dataset["thrust"], np.nan)
        left_out["raw_height"] = xr.full_like(dataset["time"], np.nan)
        dataset = dataset.assign({name: values for name, values in left_out.items() if name not in dataset})
    if "rotation_error" in dataset:
        for name, signal in crate.signals().items():
            if name in dataset.variables:
                dataset[name].attrs.update(attributes_of(signal))
    return dataset

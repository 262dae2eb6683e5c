"""Bounded reading of NetCDF-4 files (HDF5): all data are in the file itself, and their size is known before reading."""

from __future__ import annotations

import math
import stat
from pathlib import Path
from typing import Any

import numpy as np

from jax_aero.base.sizes import MAX_NUMBERS, MAX_PART, expect

MAX_TEXTS = 100_000
"""Greatest number of texts of a variable; rows of our largest dataset have 5000 names."""


def open_dataset(path: Path) -> Any:
    """Open a file, checked by `check`, as an xarray dataset."""
    import xarray as xr

    check(path)
    return xr.open_dataset(path, engine="h5netcdf")


def check(path: Path) -> None:
    """Refuse a file with data elsewhere (linked, external or virtual ones), or with more than the limits of `sizes`.

    Compressed numbers count as they are in memory.

    Raises
    ------
    ValueError
        If the file is refused; the message names the variable.
    OSError
        If it cannot be read.
    """
    import h5py

    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise ValueError("expected a regular file")
    with h5py.File(path, "r", rdcc_nbytes=MAX_PART) as file:  # so that no chunk of texts is unpacked twice
        numbers, letters = 0, _letters_of_attributes(file, status.st_size)
        for name in file:
            if not isinstance(file.get(name, getlink=True), h5py.HardLink):
                raise ValueError(f"`{name}` is a link; expected data in the file itself")
            variable = file[name]
            if not isinstance(variable, h5py.Dataset):
                raise ValueError(f"`{name}` is a {type(variable).__name__}; expected variables alone")
            size = size_of(name, variable)
            letters += _letters_of_attributes(variable, status.st_size)
            if variable.dtype.hasobject:
                if h5py.check_string_dtype(variable.dtype) is None:
                    raise ValueError(f"`{name}` holds {variable.dtype}; expected numbers or texts")
                expect(f"texts of `{name}`", size // 8, MAX_TEXTS)
                letters = _add_letters(letters, variable, status.st_size)
            else:
                numbers += size
            expect("bytes of numbers", numbers, MAX_NUMBERS)
            expect("letters", letters, MAX_PART)


def size_of(name: str, variable: Any) -> int:
    """Return the size of a variable in memory [bytes], with eight for a number; refuse one with data in other files."""
    if variable.is_virtual or variable.external:
        raise ValueError(f"`{name}` has its data in other files; expected data in the file itself")
    count = max(_count(variable.shape), _count(variable.chunks))  # a chunk is unpacked as a whole
    return int(count * max(variable.dtype.itemsize, 8))


def _count(shape: Any) -> int:
    return math.prod(shape or ())


# Any number of texts may be stored as one, which may be as long as the file.


def _letters_of_attributes(owner: Any, file_size: int) -> int:
    letters = 0
    for name in owner.attrs:
        stored = owner.attrs.get_id(name)
        # `REFERENCE_LIST`, which no reader needs, is as long as a dimension has variables.
        if stored.dtype.hasobject and stored.shape is not None and name != "REFERENCE_LIST":
            expect(f"letters in `{name}`", _count(stored.shape) * file_size, MAX_NUMBERS)
            letters += sum(map(len, np.asarray(owner.attrs[name], dtype=object).ravel()))
            expect("letters", letters, MAX_PART)
    return letters


def _add_letters(letters: int, variable: Any, file_size: int) -> int:
    rows, row = (variable.shape or (1,))[0], math.prod(variable.shape[1:])
    expect(f"letters in a row of `{variable.name}`", row * file_size, MAX_NUMBERS)
    few = max(MAX_PART // file_size // max(row, 1), 1)
    for start in range(0, rows, few):
        letters += sum(map(len, np.ravel(variable[start : start + few] if variable.shape else variable[()])))
        expect("letters", letters, MAX_PART)
    return letters

"""What a quantity is called in files, and how it is shown: elsewhere all numbers are in SI units and radians.

>>> from jax_aero import rust
>>> shown(rust.figures()["max_rotation_error"], 0.5).text
'max rotation error [deg]'
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jax_aero.base.crate import Quantity, figures
from jax_aero.base.terminal import Refused

if TYPE_CHECKING:
    import xarray as xr

USUAL = {"rad": "deg", "rad s-1": "deg/s", "m s-1": "m/s", "N s-1": "N/s", "1": ""}
"""Units in which quantities are usually shown."""

UNITS = {
    "deg": ("rad", math.degrees(1.0)), "°": ("rad", math.degrees(1.0)), "deg/s": ("rad s-1", math.degrees(1.0)),
    "m/s": ("m s-1", 1.0), "N/s": ("N s-1", 1.0), "1": ("", 1.0), "%": ("", 1e2),
    "cm": ("m", 1e2), "mm": ("m", 1e3), "ms": ("s", 1e3), "µs": ("s", 1e6),
}  # fmt: skip
"""Other units than those of the SI: the one of the SI, and how many of the other it is."""


class Shown(NamedTuple):
    """A quantity as it is shown."""

    values: Any
    unit: str
    label: str

    @property
    def text(self) -> str:
        """Return label and unit, for an axis or a heading."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    def said(self, form: str) -> str:
        """Return label, number in this format, and unit: "rotation error 33°"."""
        return f"{self.label} {self.values:{form}}{'°' if self.unit == 'deg' else f' {self.unit}'}".rstrip()


def shown(quantity: Quantity | Mapping[str, Any], values: Any = math.nan) -> Shown:
    """Return values of a declared quantity, or of one with the attributes of a variable, as they are shown."""
    about = attributes_of(quantity) if isinstance(quantity, Quantity) else quantity
    unit = about.get("shown") or USUAL.get(about["units"], about["units"])
    return Shown(converted(values, about["units"], unit), unit, about["label"])


def converted(values: Any, unit: str, to: str) -> Any:
    """Return values in another unit of the same dimension."""
    (dimension, number), (other, numbers) = (UNITS.get(name, (name, 1.0)) for name in (unit, to))
    if dimension != other:
        raise Refused(f"{unit or 'a number without unit'} is no {to}")
    return values if number == numbers else numbers / number * values


def shown_array(array: xr.DataArray) -> Shown:
    """Return an array of `run_file.read` as it is shown, by its attributes."""
    return shown(array.attrs, array)


def column_of(figure: str) -> str:
    """Return the column of a figure of merit in the table of the flights of a sweep, where angles are in degrees."""
    return f"{figure}_deg" if figures()[figure].unit == "rad" else figure


COLUMNS: Mapping[str, Quantity] = {
    column_of(name): replace(figure, unit="deg") if figure.unit == "rad" else figure
    for name, figure in figures().items()
    if not figure.is_of_ground
}
"""Figures of merit, as they are in its columns."""


def in_columns(summary: Mapping[str, float]) -> dict[str, float]:
    """Return the figures of merit of a flight as the columns have them."""
    known = {column_of(name): (figures()[name], value) for name, value in summary.items()}
    return {
        column: shown(figure, value).values if figure.unit == "rad" else value
        for column, (figure, value) in known.items()
        if column in COLUMNS
    }


def attributes_of(quantity: Quantity, kind: type[Any] = np.int32) -> dict[str, Any]:
    """Return the attributes of its variable in a file; of codes by CF, in the type of the variable's numbers."""
    attributes: dict[str, Any] = {"units": quantity.unit, "long_name": quantity.meaning, "label": quantity.label}
    if quantity.shown:
        attributes["shown"] = quantity.shown
    if quantity.codes:
        attributes["flag_masks" if quantity.numbers == "bits" else "flag_values"] = np.array(
            [*quantity.codes.values()], kind
        )
        attributes["flag_meanings"] = " ".join(quantity.codes)
    return attributes

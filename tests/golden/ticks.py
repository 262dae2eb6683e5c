"""Ticks of the controller whose every value is stored: which they are, and what is kept of each value.

`python -m tests.golden.ticks` computes them anew. Of an array its shape, its greatest entry, the sum of its entries
with weights of no simple ratio, and the places of what is not finite are kept: any other entry, sign or order shows.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jax_aero import rust

FILE = Path(__file__).parent / "ticks.json"

EARLY = {"wind.ramp_start": 0.0, "wind.ramp_end": 0.2, "simulator.duration": 3.0}
"""The wind is there at once, so that ticks of the first two seconds have all terms."""
LOSS = {
    "mission": {"down": [[0.0, 3.0]]},
    "simulator.ground_height": -2.2,
    "disturbances.jets.failure": {"jet": "l_arm_jet", "time": 0.8, "kind": "off"},
}
FAST = {"mission": {"forward_turbo": [[0.1, 2.0]], "yaw_left": [[0.0, 2.0]]}}


class Ticks(NamedTuple):
    """Ticks of one flight."""

    experiment: str
    changes: Mapping[str, Any]
    rows: tuple[int, ...]


TICKS = {
    "test2": Ticks("test2", FAST | EARLY, (0, 120)),
    "robot": Ticks("robot", FAST | EARLY, (0, 120)),
    "mk3_robot": Ticks("mk3_robot", FAST | EARLY, (0, 120)),
    "landing": Ticks("robot", LOSS | EARLY, (70, 90, 130)),
}
"""By name: the law alone, both recommended controllers, and a descent before and after an engine stops, which is
then planned to the ground."""


class Kept(NamedTuple):
    """What is kept of an array."""

    shape: list[int]
    greatest: float
    """Greatest finite magnitude."""
    sum: float
    """Of finite entries times `cos(1 + k)` of their places k."""
    not_finite: float
    """Of +1, −1 and 2 for ∞, −∞ and NaN, times the same."""


def keep(value: Any) -> Kept:
    """Return what is kept of an array of numbers."""
    array = np.asarray(value, dtype=float)
    entries, weights = array.ravel(), np.cos(1.0 + np.arange(array.size))
    is_finite = np.isfinite(entries)
    finite = np.where(is_finite, entries, 0.0)
    kind = np.where(is_finite, 0.0, np.where(np.isnan(entries), 2.0, np.sign(entries)))
    sums = [float(np.dot(weights, part)) for part in (finite, kind)]
    return Kept(list(array.shape), float(np.abs(finite).max(initial=0.0)), *sums)


def difference(found: Kept, stored: Kept) -> float:
    """Return how far two values are apart, in parts of the greatest entry; infinite where shapes or infinities are."""
    if found.shape != stored.shape or abs(found.not_finite - stored.not_finite) > 1e-9:
        return np.inf
    apart = max(abs(found.sum - stored.sum), abs(found.greatest - stored.greatest))
    return apart / max(stored.greatest, 1e-9)


def values(of: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every number of a tick, those of its parts with a dot."""
    if isinstance(of, tuple) and hasattr(of, "_asdict"):
        parts = of._asdict()
    elif dataclasses.is_dataclass(of):
        parts = vars(of)
    elif isinstance(of, list):  # of modes
        yield f"{name}: {', '.join(of)}", 1.0
        return
    elif isinstance(of, str) or of is None:
        yield f"{name}: {of}", 1.0
        return
    else:
        yield name, of
        return
    for key, part in parts.items():
        yield from values(part, f"{name}.{key}" if name else key)


def compute() -> dict[str, dict[str, Kept]]:
    """Fly to the ticks and return what is kept of them."""
    found = {}
    for name, (experiment, changes, rows) in TICKS.items():
        flight = rust.Flight(rust.load_config(experiment, changes))
        for row in range(max(rows) + 1):
            assert flight.step(), f"{name} ends at tick {row}"
            if row in rows:
                found[f"{name} {row}"] = {key: keep(value) for key, value in values(flight.last)}
    return found


def load_stored() -> dict[str, dict[str, Kept]]:
    """Return what is stored."""
    document = json.loads(FILE.read_text(encoding="utf-8"))
    return {tick: {key: Kept(*kept) for key, kept in of.items()} for tick, of in document.items()}


def main() -> None:
    """Compute and store all."""
    blocks = []
    for tick, of in compute().items():
        lines = ",\n".join(f"{json.dumps(key)}: {json.dumps(kept)}" for key, kept in of.items())
        blocks.append(f"{json.dumps(tick)}: {{\n{lines}\n}}")
    FILE.write_text("{\n" + ",\n".join(blocks) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()

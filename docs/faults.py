"""Write the table of single faults into `docs/failures.md`, from the result of `jax-aero sweep faults`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from jax_aero.control.modes import MODES
from paper_figs.sweeps import Sweep, load

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs/failures.md"
BEGIN, END = "<!-- by `python docs/faults.py` from the sweep `faults` -->", "<!-- end of the table -->"
ONSET = 18.0
"""When the faults begin that do not last for the whole flight [s]."""


def main() -> None:
    """Replace what stands between the marks."""
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    _, after = rest.split(END)
    table = "\n".join(rows(load(ROOT / "results/sweeps", "faults")))
    PAGE.write_text(f"{before}{BEGIN}\n\n{table}\n\n{END}{after}", encoding="utf-8")
    print(f"wrote {PAGE.relative_to(ROOT)}")


def rows(sweep: Sweep) -> Iterator[str]:
    """Yield the lines of the table."""
    fault, panel = sweep.axes[0], sweep.panel_axis
    assert panel is not None
    yield f"| fault | {' | '.join(panel['levels'])} | modes |"
    yield "|---" * (len(panel["levels"]) + 2) + "|"
    for level in fault["levels"]:
        flights = sweep.flights[sweep.flights[fault["name"]] == level]
        ends = [_end(flights[flights[panel["name"]] == controller]) for controller in panel["levels"]]
        yield f"| {level} | {' | '.join(ends)} | {_modes(flights)} |"


def _end(flights: pd.DataFrame) -> str:
    """Return the count of completed flights, after which time the fault is found, and how early a loss is announced."""
    complete, lost = flights["outcome"] == "completed", flights["outcome"].isin(("fell", "diverged"))
    off_course = int((flights["outcome"] == "off_course").sum())
    said = [f"{complete.sum()} of {len(flights)}"]
    found = flights["nominal_until"].median()
    if (flights["degraded_time"] > 0.0).mean() >= 0.5:
        said.append(f"{found - ONSET:.2f} s" if found >= ONSET else f"at {found:.2f} s")
    if lost.any():
        said.append(f"announced {flights['warning_time'][lost].median():.2f} s before the loss")
    return ", ".join([*said, *([f"{off_course} off course"] if off_course else [])])


def _modes(flights: pd.DataFrame) -> str:
    """Return the modes that at least half of the flights have."""
    bits = flights["all_modes"].to_numpy().astype(int)
    return ", ".join(f"`{name}`" for name, bit in MODES.items() if np.mean((bits & bit) > 0) >= 0.5) or "–"


if __name__ == "__main__":
    main()

"""Tuned beside published controller, flight by flight, from the table of the sweep `tuned`.

`python -m experiments.studies.tune.pairs` prints the table of the README.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from jax_aero.base import places
from jax_aero.base.parquet import read_table

TABLE = places.RESULTS / "sweeps" / "tuned" / "table.parquet"
ERRORS = {"rotation": "max_rotation_error_deg", "position": "max_com_error"}


def ratio(published: pd.Series, tuned: pd.Series, draws: int = 10000) -> tuple[float, float, float]:
    """Return the geometric mean of tuned over published errors of paired flights, and its 95 % interval."""
    logs = np.log(tuned / published).dropna().to_numpy()
    means = np.random.default_rng(1).choice(logs, (draws, len(logs))).mean(axis=1)
    mean, low, high = np.exp([logs.mean(), *np.quantile(means, [0.025, 0.975])])
    return float(mean), float(low), float(high)


def report(table: pd.DataFrame) -> str:
    """Return, for each wind and kind of thrusts, completed flights, median errors [deg, cm] and ratios."""
    table = table.assign(max_com_error=100.0 * table["max_com_error"])
    lines = []
    for (world, speed), cell in table.groupby(["world", "speed"], sort=False):
        flights = {name: part.set_index("repeat") for name, part in cell.groupby("controller", sort=False)}
        ends = {name: part["outcome"] == "completed" for name, part in flights.items()}
        lines.append(f"{world} {speed} m/s; complete: {', '.join(str(end.sum()) for end in ends.values())}")
        for error, column in ERRORS.items():
            both = ends["published"] & ends["tuned"]
            found, low, high = ratio(flights["published"][column][both], flights["tuned"][column][both])
            medians = ", ".join(f"{part[column].median():.1f}" for part in flights.values())
            lines.append(f"  {error}: {medians}; tuned over published {found:.2f} ({low:.2f} to {high:.2f})")
    return "\n".join(lines)


if __name__ == "__main__":
    print(report(read_table(TABLE).to_pandas(use_threads=False)))

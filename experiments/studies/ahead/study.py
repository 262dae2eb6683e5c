"""Three controllers in turbulence and after an engine stops: what looking ahead changes.

`jax-aero study ahead [PART]` flies TEST2's mission with the paper's controller, the observer's and the predictive
law: `turbulence` in a wind of 18 m/s with turbulence, in the network's air; `engine` with the left arm engine stopping
at once while hovering. The result goes to `results/ahead/PART/`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from experiments import Refused
from experiments.study import Findings, Study
from jax_aero import rust
from jax_aero.base import places, tables
from jax_aero.rust import SETTLING_TIME

CONTROLLERS = {"aware": "test2", "observer": "test2_observer", "predictive": "test2_mpc"}
"""Experiments by the name of their controller."""
STOP = 18.0
"""Time at which the engine stops [s]."""
PARTS: dict[str, dict[str, Any]] = {
    "turbulence": {
        "wind": {
            "profile": "turbulent",
            "velocity": [0.0, -18.0, 0.0],
            "ramp_start": 5.0,
            "ramp_end": 10.0,
            "std": [3.6, 3.6, 1.8],
            "time_scale": 2.0,
            "seed": 1,
        },
    },
    "engine": {"disturbances.jets.failure": {"jet": "l_arm_jet", "time": STOP, "kind": "off"}},
}
"""Changes of the experiments."""
AIR = {"turbulence": places.CONFIGS / "aero" / "network.toml"}
"""Air of a part's simulator that is not the experiments' own."""


class Ahead(tables.Table, frozen=True):
    """Flights of a part."""

    every: tables.Count = 10
    """One sample of so many is kept."""
    duration: tables.Positive = 50.0
    """[s]."""


def compute(part: str, asked: Ahead) -> Findings:
    """Fly a part with every controller."""
    if part not in PARTS:
        raise Refused(f"there is no part `{part}`{places.did_you_mean(part, PARTS)}")
    changes = PARTS[part] | {"simulator.duration": asked.duration}
    if part in AIR:
        changes["simulator.aero"] = rust.load_aero(AIR[part])
    flights = {name: rust.load_config(base, changes) for name, base in CONTROLLERS.items()}
    flown = [flown.log for flown in rust.fly_batch(list(flights.values()), full_log=True)]
    longest = max((log["time"] for log in flown), key=len)
    time = longest[:: asked.every]
    signals = {
        "rotation": ("deg", "rotation error", [np.degrees(log["rotation_error"]) for log in flown]),
        "height": ("m", "height of the centre of mass", [log["com_position"][:, 2] for log in flown]),
    }
    data = xr.Dataset(
        {
            key: (
                ("controller", "time"),
                _padded(values, len(longest))[:, :: asked.every],
                {"units": unit, "long_name": text},
            )
            for key, (unit, text, values) in signals.items()
        },
        {"controller": list(flights), "time": ("time", time, {"units": "s"})},
    )
    rows = {name: _summary(log, part) for name, log in zip(flights, flown, strict=True)}
    return Findings(f"Looking ahead: {part}", data, rows, flights=flights)


STUDY = Study("ahead", __doc__, Ahead, compute, tuple(PARTS), engine="rust")
main = STUDY.main


def _padded(values: list[Any], length: int) -> Any:
    """Return rows of one length; a flight that ends earlier goes on with NaN."""
    return np.array([np.pad(value, (0, length - len(value)), constant_values=np.nan) for value in values])


def _summary(log: Any, part: str) -> dict[str, float]:
    """Return the greatest rotation error [deg] and the last time [s]; the last velocity [m/s] after an engine stops."""
    judged = log["time"] >= SETTLING_TIME
    row = {"rotation_deg": float(np.degrees(log["rotation_error"][judged].max())), "end_s": float(log["time"][-1])}
    if part == "engine":
        row["sink_m_s"] = -float(log["com_velocity"][-1, 2])
    return row

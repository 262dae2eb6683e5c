"""Commands that are late by a time that the controller knows, or does not know: what is measured and reported."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice, product
from typing import Any

import numpy as np

from experiments.studies.failures.flights import Row
from jax_aero import rust
from jax_aero.rust import MODES

CONTROLLERS = ("test2_observer", "test2_sensors", "test2_mpc", "test2_sensors_mpc")
TORQUES, THRUSTS = (0.0, 0.003, 0.005, 0.01, 0.02), (0.0, 0.02, 0.05, 0.1)
"""Delays of the commands [s]."""
SUBSTEPS = 10
STEP = 0.01
HALF = 0.5 * STEP * (1.0 - 1.0 / SUBSTEPS)
"""Time by which a torque that is held for a tick acts later on average, in semi-implicit sub-steps [s]."""
AIR = {"profile": "turbulent", "velocity": [0.0, -14.0, 0.0], "std": [2.8, 2.8, 1.4], "time_scale": 2.0}
TURBULENCE = AIR | {"ramp_start": 0.0, "ramp_end": 1.0}
KNOWN_AFTER = 3.0
"""Time from which estimates are compared [s]: in which residuals are forgotten."""

Case = tuple[str, dict[str, Any], float, float]
"""Name, changes of the experiment, and true latencies of torques and thrust rates [s]."""


def _cases(delays: str) -> Iterator[tuple[str, Case]]:
    """Yield the experiments and cases of late torques (and thrust rates), or of late thrust rates."""
    is_torque = delays == "torque"
    knowns = (False, True) if is_torque else (False,)
    for experiment, delay, is_known in product(CONTROLLERS, TORQUES if is_torque else THRUSTS, knowns):
        for is_turbulent, seed in product((False, True), range(1, 6)):
            air = (
                TURBULENCE | {"seed": seed}
                if is_turbulent
                else {"profile": "constant", "velocity": [0.0, 1.0 - seed, 0.0]}
            )
            torque = delay if is_torque else 0.0
            changes: dict[str, Any] = {
                "simulator.duration": 20.0,
                "simulator.substeps": SUBSTEPS,
                "simulator.actuation": {"torque_delay": torque, "thrust_delay": delay},
                "wind": air,
            }
            if is_known:
                late = delay + 0.5 * STEP
                changes["controller.estimator.latency"] = {"torque": late, "thrust": late}
            if "sensors" in experiment:
                changes["simulator.sensors.seed"] = seed
            case = f"{experiment}, {delay * 1e3:.0f} ms{', known' if is_known else ''}"
            yield experiment, (case, changes, torque + HALF, delay)


def _judge(case: Case, flight: rust.FlightResult) -> Row:
    """Return errors of the estimates, from when on they are known, and from when on commands count as late."""
    name, _, torque, thrust = case
    time, modes = flight["time"], flight["degraded_modes"].astype(int)
    row: Row = {"case": name, "completed": flight.outcome == "completed"}
    for kind, true in (("torque", torque), ("thrust", thrust)):
        error = 1e3 * (flight[f"measured_{kind}_latency"] - true)
        is_known = np.isfinite(error)
        counts = error[is_known & (time >= min(KNOWN_AFTER, 0.5 * time[-1]))]
        row[f"{kind}_error"] = float(np.median(counts)) if counts.size else np.nan
        row[f"{kind}_worst"] = float(np.abs(counts).max()) if counts.size else np.nan
        row[f"{kind}_known"] = float(time[is_known][0]) if is_known.any() else np.nan
    is_late = (modes & MODES["late"]) != 0
    row["late"] = float(time[is_late][0]) if is_late.any() else np.nan
    return row


def _fly(delays: str, every: int) -> list[Row]:
    chosen = list(islice(_cases(delays), 0, None, every))
    flights = rust.fly_batch([rust.load_config(name, case[1]) for name, case in chosen], full_log=True)
    return [_judge(case, flight) for (_, case), flight in zip(chosen, flights, strict=True)]


def late_torques(every: int) -> list[Row]:
    """Fly with late commands, which the controller knows or does not know."""
    return _fly("torque", every)


def late_thrusts(every: int) -> list[Row]:
    """Fly with late thrust rates, which the controller does not know."""
    return _fly("thrust", every)


PARTS = {"late_torques": late_torques, "late_thrusts": late_thrusts}

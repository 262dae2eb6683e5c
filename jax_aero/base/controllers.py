"""Names of the controllers of `configs/control`, which tables, figures, the film, the flight lab and pages show."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Controller(NamedTuple):
    """How a controller is called, and what it is."""

    label: str
    has: str
    """What it is, or adds to the one before."""
    needs: str
    use: str


CONTROLLERS: Mapping[str, Controller] = {
    "baseline": Controller(
        "baseline", "the published controller without aerodynamics", "exact measurements", "what wind does"
    ),
    "aero_aware": Controller(
        "aware",
        "the published aerodynamic-aware controller: an aerodynamic model in momentum and torques",
        "measured wind, exact measurements",
        "the paper's flights",
    ),
    "observer_without_model": Controller(
        "observer, no model",
        "in place of the model a disturbance observer and fault detection",
        "no measured wind",
        "air that nobody has modelled",
    ),
    "observer": Controller(
        "observer", "observer and aerodynamic model", "measured wind", "a robot that differs from its model"
    ),
    "estimator": Controller("estimator", "a state estimator", "ages of the measurements", "late, noisy sensors"),
    "mpc": Controller(
        "predictive law",
        "model predictive control, without the estimator",
        "a mission known 0.8 s ahead",
        "turbulence, an engine's loss",
    ),
    "mpc_estimator": Controller("predictive law, estimator", "both", "the same", "late, noisy sensors"),
    "robot": Controller(
        "recommended",
        "all of these, with engines, drives and latencies in the model (iRonCub-Mk3: `mk3_robot`)",
        "numbers of the robot",
        "the realistic simulation, a robot",
    ),
    "robot_ideal": Controller(
        "recommended, ideal drives",
        "the same without rotors, friction, engines that lag and delays (iRonCub-Mk3: `mk3_robot_ideal`)",
        "ideal drives and engines, exact measurements",
        "the paper's flights, comparisons in them",
    ),
}
"""By the name of their file."""

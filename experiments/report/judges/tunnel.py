"""Judgements of the claims on wind tunnel and CFD, by the figures that Fig. 2, Fig. 3 and the mesh study draw."""

from __future__ import annotations

import numpy as np

from experiments.report.findings import Judged, judge
from paper_figs import tunnel
from paper_figs.tunnel import CFD, EPSILON, OMEGA, TUNNEL

MODELS = (OMEGA, EPSILON)
"""Turbulence models."""
RELIABLE_SPEED = 15.0
"""Below it the paper suspects the balance's calibration [m/s]."""


def _within(share: float, low: float, high: float) -> Judged:
    """Return a share in percent, and by how much it misses an interval."""
    off = share - min(max(share, low), high)
    return f"{100 * share:.1f} %", judge(off == 0.0, f"{100 * off:+.1f} %")


def speeds(*, slow: bool) -> Judged:
    """Judge how far drag areas at several speeds differ over the sideslips common to all."""
    curves = tunnel.hovering_drag(tunnel.read(TUNNEL))
    common = sorted(set.intersection(*(set(curve) for curve in curves.values())))
    chosen = [curve for speed, curve in curves.items() if slow or speed > RELIABLE_SPEED]
    areas = np.array([[curve[beta] for beta in common] for curve in chosen])
    return _within(float(_spread(areas).max()), 0.0, 0.05)


def postures(alpha: int) -> Judged:
    """Judge how far the drag areas of flight postures differ at an angle of attack [deg]."""
    tables = tunnel.read(TUNNEL)["flight"]
    areas = np.array([table["cda"] for table in tables])
    # From 15 to 22 % counts as almost 20 %.
    return _within(float(_spread(areas)[tables[0]["alpha_deg"].index(alpha)]), 0.15, 0.22)


def _spread(values: tunnel.Array) -> tunnel.Array:
    """Return (largest − smallest)/mean along the first axis."""
    ratio: tunnel.Array = (values.max(axis=0) - values.min(axis=0)) / values.mean(axis=0)
    return ratio


def drag_errors(turbulence: str) -> Judged:
    """Judge the drag of a turbulence model: k-ω must be closer to the tunnel than k-ε."""
    drag = {name: tunnel.drag_error(*_flight30(tunnel.FINEST, name)) for name in MODELS}
    return _within(drag[turbulence], *((0.0, drag[EPSILON]) if turbulence == OMEGA else (drag[OMEGA], 1.0)))


def size_errors(turbulence: str) -> Judged:
    """Judge the mean relative error of the magnitude of the force area with a turbulence model."""
    record, run = _flight30(tunnel.FINEST, turbulence)
    keys = ("cda", "cla", "csa")
    measured = np.linalg.norm([tunnel.measured_area(record, key, run) for key in keys], axis=0)
    simulated = np.linalg.norm([run[key] for key in keys], axis=0)
    return _within(float(np.mean(np.abs(simulated / measured - 1.0))), 0.0, 0.1)


def mesh_errors(mesh: str) -> Judged:
    """Judge the largest relative error of the drag on a mesh."""
    record, run = _flight30(mesh, OMEGA)
    return _within(
        float(np.abs(np.array(run["cda"]) / tunnel.measured_area(record, "cda", run) - 1.0).max()), 0.0, 0.15
    )


def _flight30(mesh: str, turbulence: str) -> tuple[tunnel.Table, tunnel.Table]:
    record = tunnel.flight(tunnel.read(TUNNEL), "flight30")
    return record, tunnel.run_of(tunnel.read(CFD)["run"], mesh, turbulence)

"""Figures of single flights, studies and tables, with the results they show."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping, Sequence

from jax_aero.base import places
from paper_figs import (
    cfd_flow,
    cfd_taps,
    compare,
    demo,
    fig4_fit,
    fig4_network,
    fig5_flight,
    fig6_balancing,
    suppl7,
    take_off,
    training,
    tunnel,
)
from paper_figs.entry import Entry

TESTS = ("test1", "test2", "test3", "robustness")

OURS: Mapping[str, Entry] = {
    "fig2": Entry(
        tunnel.fig2,
        "Fig. 2 d, e: the wind tunnel's drag by speed and by posture; needs no run",
        tables=(tunnel.TUNNEL,),
    ),
    "fig3": Entry(
        tunnel.fig3, "Fig. 3 a, b: CFD beside the wind tunnel; needs no run", tables=(tunnel.TUNNEL, tunnel.CFD)
    ),
    "cfd_flow": Entry(
        cfd_flow.draw,
        "Fig. 3 c-f of our own flow: surface pressure, streamlines, plane of symmetry",
        "cfd_flow",
        ("flight30",),
    ),
    "cfd_meshes": Entry(
        cfd_flow.meshes,
        "Suppl. Fig. 5: speed around the robot on three meshes of ours",
        "cfd_flow",
        ("flight30_coarse", "flight30", "flight30_fine"),
    ),
    "cfd_taps": Entry(
        cfd_taps.draw, "Suppl. Fig. 2: pressures at the taps, wind tunnel and our flow", "cfd_taps", ("mk1_taps",)
    ),
    "supp_mesh": Entry(tunnel.mesh, "Suppl. Fig. 5: mesh study; needs no run", tables=(tunnel.TUNNEL, tunnel.CFD)),
    "fig4_fit": Entry(fig4_fit.draw, "Fig. 4 d, e: the axisymmetric model over the CFD", "fit_aero", ("freestream",)),
    "fig4_network": Entry(
        fig4_network.draw, "Fig. 4 a-c: the network's drag of the head, two splits", "training", ("compact",)
    ),
    "training": Entry(training.draw, "loss curves of a training run", "training", ("compact",)),
    "fig5": Entry(fig5_flight.draw, "Fig. 5 b-i: one mission flown twice", "flight", ("test2", "test1")),
    "fig5_robustness": Entry(
        fig5_flight.draw, "Fig. 5 b-i as the paper fills it: TEST4, robustness", "flight", ("test4", "robustness")
    ),
    "compare": Entry(
        compare.draw, "own flights beside each other, one to eight: rotation, position, wind, thrusts", "flight"
    ),
    "fig6": Entry(
        fig6_balancing.draw,
        "Fig. 6 a-l: ground experiments in frontal and lateral wind",
        "flight",
        ("balancing_front_as_flown", "balancing_lateral_as_flown"),
    ),
    "take_off": Entry(
        take_off.draw, "take-off and landing: height, load of jets and feet, attitude", "flight", ("take_off",)
    ),
    "suppl7": Entry(suppl7.draw, "Suppl. Fig. 7: TEST1, TEST2, TEST3, robustness; corrected arms", "flight", TESTS),
    "suppl7_published": Entry(
        suppl7.draw, "Suppl. Fig. 7; published arms", "flight", tuple(f"{name}_published" for name in TESTS)
    ),
    "demo": Entry(
        demo.draw,
        "three controllers, corrected and published lever arms",
        "flight",
        ("test1", "test2", "test1_observer", "test1_published", "test2_published", "test1_published_observer"),
    ),
}
"""Figures of flights, of data and of trainings."""


def _of_studies() -> Iterator[tuple[str, Entry]]:
    """Yield the figures of all studies, each from `figure.py` in the study's folder."""
    for path in sorted(places.STUDIES.glob("*/figure.py")):
        yield from importlib.import_module(f"experiments.studies.{path.parent.name}.figure").FIGURES.items()


FIGURES: Mapping[str, Entry] = {**OURS, **dict(_of_studies())}
"""Figures of single flights, studies and tables."""

SWEEPS: Sequence[str] = places.names("sweeps")
"""Sweeps that `all` expects; others are also drawn if their results exist."""

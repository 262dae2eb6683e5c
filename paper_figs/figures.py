"""Figures of single flights, studies and tables, with the results they show."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from jax_aero import places
from paper_figs import (
    along,
    cfd_flow,
    demo,
    engine,
    fig4_fit,
    fig4_network,
    fig5_flight,
    fig6_balancing,
    force_rate,
    identify,
    observer_limit,
    pictures,
    runs,
    suppl7,
    take_off,
    tip_over,
    training,
    trajectory,
    trim,
    tune,
    tunnel,
    tunnel_moments,
)


@dataclass(frozen=True)
class Entry:
    """A figure: its drawing function and the results it shows."""

    draw: Callable[..., Figure]
    """Function of the results in order, a `Run` for each flight or a dataset for each study; or else of the tables."""
    shows: str
    kind: str = ""
    """Kind of the results: "flight" or a kind of study; empty without results."""
    runs: tuple[str, ...] = ()
    """Names of the results that are shown by default."""
    tables: tuple[str, ...] = ()
    """Files of `configs/tables` that are shown if there are no results."""

    @property
    def command(self) -> str:
        """Return the command that makes the results; empty if committed tables are shown."""
        if self.kind == "flight":
            return f"jax-aero fly {' '.join(self.runs)}"
        return "; ".join(runs.study_command(self.kind, name) for name in self.runs)

    def draw_from_results(self, results: Path, names: Sequence[str] = ()) -> tuple[Figure, dict[str, str]]:
        """Return the figure, and the hash of every result or table that it shows."""
        try:
            return self._load_and_draw(results, names or self.runs)
        except KeyError as missing:
            what = str(missing.args[0]).partition(". ")[0]
            raise runs.NotDrawn(f"{what}: other code made the result; make it again: {self.command}") from None

    def _load_and_draw(self, results: Path, names: Sequence[str]) -> tuple[Figure, dict[str, str]]:
        if self.tables:
            return self.draw(*map(tunnel.read, self.tables)), tunnel.hashes(*self.tables)
        if self.kind == "flight":
            flights = [runs.load(results, name) for name in names]
            return self.draw(*flights), {run.name: run.config_hash for run in flights}
        loaded = [runs.load_study(results, self.kind, name) for name in names]
        return self.draw(*loaded), {study.attrs["name"]: str(study.attrs["config_hash"]) for study in loaded}


TESTS = ("test1", "test2", "test3", "robustness")
PICTURES = ("paper",)

FIGURES: Mapping[str, Entry] = {
    "fig2": Entry(
        tunnel.fig2,
        "Fig. 2 d, e: the wind tunnel's drag by speed and by posture; needs no run",
        tables=(tunnel.TUNNEL,),
    ),
    "fig2_setup": Entry(pictures.setup, "Fig. 2 a-c as a drawing: robot, pylon, balance, axes", "pictures", PICTURES),
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
    "supp_mesh": Entry(tunnel.mesh, "Suppl. Fig. 5: mesh study; needs no run", tables=(tunnel.TUNNEL, tunnel.CFD)),
    "fig4_fit": Entry(fig4_fit.draw, "Fig. 4 d, e: the axisymmetric model over the CFD", "fit_aero", ("freestream",)),
    "fig4_network": Entry(
        fig4_network.draw, "Fig. 4 a-c: the network's drag of the head, two splits", "training", ("compact",)
    ),
    "training": Entry(training.draw, "loss curves of a training run", "training", ("compact",)),
    "fig5a": Entry(pictures.flight, "Fig. 5 a: the flight, rendered", "pictures", PICTURES),
    "fig5": Entry(fig5_flight.draw, "Fig. 5 b-i: one mission flown twice", "flight", ("test2", "test1")),
    "fig5_robustness": Entry(
        fig5_flight.draw, "Fig. 5 b-i as the paper fills it: TEST4, robustness", "flight", ("test4", "robustness")
    ),
    "fig6": Entry(
        fig6_balancing.draw,
        "Fig. 6 a-l: ground experiments in frontal and lateral wind",
        "flight",
        ("balancing_front", "balancing_lateral"),
    ),
    "postures": Entry(pictures.postures, "Suppl. Fig. 8, 9: the postures, rendered", "pictures", PICTURES),
    "take_off": Entry(
        take_off.draw, "take-off and landing: height, load of jets and feet, attitude", "flight", ("take_off",)
    ),
    "along": Entry(along.draw, "fuel burnt and clearance of the jets along flights", "along", ("flights",)),
    "engine": Entry(engine.draw, "an engine identified from a log, on another log", "identify_engine", ("P220",)),
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
    "trim": Entry(
        trim.draw, "winds that can be trimmed, and the thrust that is left", "trim", ("hover_posture", "free_joints")
    ),
    "trajectory": Entry(
        trajectory.draw,
        "planned trajectories, flown beside the paper's mission",
        "trajectory",
        ("min_time", "min_fuel"),
    ),
    "identify": Entry(
        identify.draw, "aerodynamic coefficients identified from one flight's log", "identify_aero", ("aero",)
    ),
    "tip_over": Entry(tip_over.draw, "what wind tips the standing robot over", "tip_over", ("ground",)),
    "observer_limit": Entry(
        observer_limit.draw, "the greatest dM/dθ against the observer's gain", "observer_limit", ("hover",)
    ),
    "tune": Entry(tune.draw, "gains and weights tuned by gradient: costs and factors", "tune", ("aero_aware",)),
    "tunnel_moments": Entry(tunnel_moments.draw, "models' moments beside the wind tunnel", "tunnel_moments", ("mk1",)),
    "force_rate": Entry(
        force_rate.draw, "the aerodynamic force rate that the controller leaves out", "force_rate", ("test2",)
    ),
}
"""Figures of single flights, studies and tables."""

SWEEPS: Sequence[str] = places.names("sweeps")
"""Sweeps that `all` expects; others are also drawn if their results exist."""

"""Draw figures from finished flights and sweeps, as PDF and PNG; what has not been flown is named and left out."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from jax_aero import cli
from jax_aero.places import did_you_mean
from paper_figs import (
    ablation,
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
    maps,
    model_pairs,
    observer_limit,
    paper,
    pictures,
    runs,
    scatter,
    style,
    suppl7,
    surrogate,
    sweeps,
    take_off,
    tip_over,
    training,
    trajectory,
    trim,
    tune,
    tunnel,
    tunnel_moments,
)

Draw = Callable[[Path, Sequence[str]], tuple[Figure, dict[str, str]]]

FIGURES: dict[str, tuple[Draw, Sequence[str], str]] = {
    "fig2": (tunnel.fig2, (), "Fig. 2 d, e: the wind tunnel's drag by speed and by posture; needs no run"),
    "fig2_setup": (pictures.setup, pictures.RUNS, "Fig. 2 a-c as a drawing: robot, pylon, balance, axes"),
    "fig3": (tunnel.fig3, (), "Fig. 3 a, b: CFD beside the wind tunnel; needs no run"),
    "cfd_flow": (
        cfd_flow.draw,
        cfd_flow.RUNS,
        "Fig. 3 c-f of our own flow: surface pressure, streamlines, plane of symmetry",
    ),
    "cfd_meshes": (cfd_flow.meshes, cfd_flow.MESHES, "Suppl. Fig. 5: speed around the robot on three meshes of ours"),
    "supp_mesh": (tunnel.mesh, (), "Suppl. Fig. 5: mesh study; needs no run"),
    "fig4_fit": (fig4_fit.draw, fig4_fit.RUNS, "Fig. 4 d, e: the axisymmetric model over the CFD"),
    "fig4_network": (fig4_network.draw, fig4_network.RUNS, "Fig. 4 a-c: the network's drag of the head, two splits"),
    "training": (training.draw, training.RUNS, "loss curves of a training run"),
    "fig5a": (pictures.flight, pictures.RUNS, "Fig. 5 a: the flight, rendered"),
    "fig5": (fig5_flight.draw, fig5_flight.RUNS, "Fig. 5 b-i: one mission flown twice"),
    "fig5_robustness": (
        fig5_flight.draw,
        fig5_flight.ROBUSTNESS,
        "Fig. 5 b-i as the paper fills it: TEST4, robustness",
    ),
    "fig6": (fig6_balancing.draw, fig6_balancing.RUNS, "Fig. 6 a-l: ground experiments in frontal and lateral wind"),
    "postures": (pictures.postures, pictures.RUNS, "Suppl. Fig. 8, 9: the postures, rendered"),
    "take_off": (take_off.draw, take_off.RUNS, "take-off and landing: height, load of jets and feet, attitude"),
    "along": (along.draw, along.RUNS, "fuel burnt and clearance of the jets along flights"),
    "engine": (engine.draw, engine.RUNS, "an engine identified from a log, on another log"),
    "suppl7": (suppl7.draw, suppl7.RUNS, "Suppl. Fig. 7: TEST1, TEST2, TEST3, robustness; corrected arms"),
    "suppl7_published": (suppl7.draw, suppl7.PUBLISHED, "Suppl. Fig. 7; published arms"),
    "demo": (demo.draw, demo.RUNS, "three controllers, corrected and published lever arms"),
    "surrogate": (surrogate.draw, surrogate.RUNS, "the panel model beside the wind tunnel"),
    "trim": (trim.draw, trim.RUNS, "winds that can be trimmed, and the thrust that is left"),
    "trajectory": (trajectory.draw, trajectory.RUNS, "planned trajectories, flown beside the paper's mission"),
    "identify": (identify.draw, identify.RUNS, "aerodynamic coefficients identified from one flight's log"),
    "tip_over": (tip_over.draw, tip_over.RUNS, "what wind tips the standing robot over"),
    "observer_limit": (observer_limit.draw, observer_limit.RUNS, "the greatest dM/dθ against the observer's gain"),
    "tune": (tune.draw, tune.RUNS, "gains and weights tuned by gradient: costs and factors"),
    "tunnel_moments": (tunnel_moments.draw, tunnel_moments.RUNS, "models' moments beside the wind tunnel"),
    "force_rate": (force_rate.draw, force_rate.RUNS, "the aerodynamic force rate that the controller leaves out"),
}
"""Figures of single flights."""

SWEEPS: Sequence[str] = (
    "paper_tests",
    "ablation_terms",
    "ablation_scale",
    "ablation_links",
    "ablation_models",
    "ablation_models_network",
    "ablation_wind_bias",
    "ablation_wind_noise",
    "ablation_wind_noise_filtered",
    "ablation_wind_delay",
    "ablation_wind_lowpass",
    "ablation_wind_mean",
    "baseline_edge",
    "map_wind",
    "map_mass_com",
    "map_thrust",
    "jet_failure",
    "jet_dynamics",
    "ekf_noise",
    "sensitivity",
    "observer_tests",
    "observer_wind",
    "observer_hover",
    "observer_turbulence",
    "observer_missions",
    "observer_errors",
    "tuned",
    "model_pairs",
    "air_ensemble",
    "air_percentages",
    "outages_observer",
    "outages_published",
    "engine_loss",
)
"""Sweeps that `all` expects; others are drawn too where their results are."""

DRAWINGS: Mapping[str, Callable[[sweeps.Sweep], Figure]] = {
    "levels": ablation.draw,
    "curve": ablation.draw,
    "map": maps.draw,
    "scatter": scatter.draw,
    "matrix": model_pairs.draw,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    given = _parser().parse_args(arguments)
    if given.index:
        print(paper.page(), end="")
        return 0
    known = [*FIGURES, *_sweep_names(given.sweeps)]
    names = known if not given.names or given.names == ["all"] else given.names
    if unknown := [name for name in names if name not in known]:
        print(f"error: no figure `{unknown[0]}`{did_you_mean(unknown[0], known)}", file=sys.stderr)
        return cli.REFUSED
    style.use()
    missing = 0
    for name in names:
        if given.runs and (name not in FIGURES or len(given.runs) != len(FIGURES[name][1])):
            expected = len(FIGURES[name][1]) if name in FIGURES else 0
            print(f"error: {name} shows {expected} runs, not {len(given.runs)}", file=sys.stderr)
            return 2
        try:
            figure, hashes = _draw(name, given)
        except runs.NotDrawn as reason:
            print(f"error: {name}: {reason}", file=sys.stderr)
            missing += 1
            continue
        for path in style.save(figure, name, given.out, hashes):
            print(path)
        plt.close(figure)
    if missing:
        print(f"{missing} of {len(names)} figures were not drawn", file=sys.stderr)
    return 1 if missing else 0


def _draw(name: str, given: argparse.Namespace) -> tuple[Figure, dict[str, str]]:
    if name in FIGURES:
        draw, default_runs, _ = FIGURES[name]
        return draw(given.results, given.runs or default_runs)
    sweep = sweeps.load(given.sweeps, name)
    return DRAWINGS[sweep.document["drawing"]](sweep), sweep.hashes


def _sweep_names(folder: Path) -> Iterator[str]:
    yield from SWEEPS
    finished = {path.parent.name for path in folder.glob("*/cells.parquet")}
    yield from sorted(finished - set(SWEEPS))


def _parser() -> argparse.ArgumentParser:
    listed = "figures, and the runs that fill them:\n" + "\n".join(
        f"  {name:<18}{about}; {' '.join(shown) or 'none'}" for name, (_, shown, about) in FIGURES.items()
    )
    parser = cli.Parser("figures", __doc__, epilog=listed)
    named = parser.add_argument("names", nargs="*", metavar="FIGURE", help="figures or sweeps (default: all there are)")
    cli.completes(named, lambda: [*FIGURES, *SWEEPS, "all"])
    parser.add_argument("--index", action="store_true", help="print the page docs/paper.md: the paper, item by item")
    parser.add_argument("--runs", nargs="+", metavar="RUN", help="which runs fill the figure, in its order")
    parser.add_argument("--results", type=Path, default=runs.default_results(), metavar="DIR", help="where flights lie")
    parser.add_argument("--sweeps", type=Path, default=sweeps.default_sweeps(), metavar="DIR", help="where sweeps lie")
    parser.add_argument("--out", type=Path, default=runs.default_out(), metavar="DIR", help="where figures go")
    return parser


if __name__ == "__main__":
    sys.exit(cli.run("figures", sys.argv[1:]))

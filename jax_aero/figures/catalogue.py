"""Figures by name: those of any flight or training here, and those of paper and studies, which are in a checkout."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from jax_aero.base import checkout, places
from jax_aero.figures import compare, demo, take_off, training
from jax_aero.figures.entry import Entry

OURS: Mapping[str, Entry] = {
    "training": Entry(training.draw, "loss curves of a training run", "training", ("compact",)),
    "compare": Entry(
        compare.draw, "own flights beside each other, one to eight: rotation, position, wind, thrusts", "flight"
    ),
    "take_off": Entry(
        take_off.draw, "take-off and landing: height, load of jets and feet, attitude", "flight", ("take_off",)
    ),
    "demo": Entry(
        demo.draw,
        "four controllers in 18 m/s from ahead",
        "flight",
        ("test1_gale", "test2_gale", "test1_observer_gale", "robot_gale"),
    ),
}
"""Figures that every installation has."""


def _found(modules: Sequence[str]) -> Iterator[tuple[str, Entry]]:
    """Yield the figures of modules of a checkout, each of which has its own in `FIGURES`."""
    for module in modules:
        yield from checkout.load(module).FIGURES.items()


PAPER: Mapping[str, Entry] = dict(_found(checkout.modules("paper_figs/*.py")))
"""Figures of the paper: `paper_figs/`."""

FIGURES: Mapping[str, Entry] = {**PAPER, **OURS, **dict(_found(checkout.modules("experiments/studies/*/figure.py")))}
"""Figures of single flights, studies and tables."""

SWEEPS: Sequence[str] = places.names("sweeps")
"""Sweeps that `all` expects; others are also drawn if their results exist."""

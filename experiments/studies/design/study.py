"""Which iRonCub should be built to fly in wind: sensitivities, designs of iRonCub-Mk3, the best of them again.

`jax-aero study design [PART]`: `sensitivities` of a hover in wind to every number of both robots, by one gradient;
`designs`, flights of designs in the realistic simulation; `confirmed`, the best of these with other draws, which reads
`results/design/designs/`. An interrupted part goes on with the next block.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import xarray as xr
from scipy.stats import spearmanr

from experiments.studies.design import campaign, robots, sensitivity
from experiments.studies.design.campaign import AGAIN, FIGURES, FLIGHTS, Job, Row
from experiments.studies.design.robots import RANGES, Array
from jax_aero import rust
from jax_aero.base import places, plain_values, run_file, tables
from jax_aero.base.terminal import Refused
from jax_aero.results.identity import Identity
from jax_aero.results.study import Findings, Study
from jax_aero.results.work import Work
from jax_aero.sweep.intervals import wilson

HOVERS = {"iRonCub-Mk1": "test2_observer", "iRonCub-Mk3": "mk3_test2"}
IN_WIND = {
    "mission": {"up": [], "down": [], "forward_turbo": [], "pitch_up": []},
    "wind": {"profile": "ramp", "velocity": [0.0, -10.0, 0.0], "ramp_start": -1.0, "ramp_end": 0.5},
}
FEW, GRID = 48, 4
"""Designs that are flown again for each objective; levels of each of the three numbers that matter most."""


class DesignConfig(tables.Table, frozen=True):
    """Extent of the parts."""

    duration: tables.Positive = 3.0
    """Of the flights of the sensitivities [s]."""
    count: tables.Count = 5000
    seed: tables.Seed = 73
    block: tables.Count = 20
    """Designs of a block."""
    draws: tables.Count = 8
    """Draws of the world for designs that are flown again."""
    repeats: tables.Count = 40
    """Draws for the chosen few, in each of two airs."""
    processes: tables.Count = 2


def compute(part: str, asked: DesignConfig, work: Work) -> Findings:
    """Compute a part."""
    if part not in PARTS:
        raise Refused(f"there is no part `{part}`{places.did_you_mean(part, PARTS)}")
    return PARTS[part](asked, work)


def sensitivities(asked: DesignConfig, _: Work) -> Findings:
    """Differentiate a hover of each robot."""
    shapes, summary = list[Row](), dict[str, Any]()
    flights = {
        name: rust.load_config(name, IN_WIND | {"simulator.duration": asked.duration}) for name in HOVERS.values()
    }
    for robot, name in HOVERS.items():
        value, slopes, times = sensitivity.gradient(flights[name])
        again, quotients, seconds = sensitivity.differences(flights[name])
        off = {kind: np.abs(slopes[kind] - one).max() / np.abs(one).max() for kind, one in quotients.items()}
        effects = {kind: 100.0 * slopes[kind] * unit / value for kind, unit in sensitivity.UNITS.items()}
        shapes += [shape | {"robot": robot} for shape in sensitivity.placed(flights[name], effects)]
        figures = {
            "numbers": sum(one.size for one in slopes.values()),
            "cost": value,
            "cost of the crate, relative difference": abs(again / value - 1.0),
            "derivatives, greatest difference over the greatest of a kind": float(max(off.values())),
            **{f"{key} [s]": one for key, one in times.items()},
            "differences of the crate [s]": seconds,
            **{f"cost by one unit of {kind} at most [%]": float(np.abs(one).max()) for kind, one in effects.items()},
        }
        summary |= {f"{robot}, {key}": one for key, one in figures.items()}
    columns = {key: ("shape", [shape[key] for shape in shapes]) for key in ("robot", "kind", "name", "effect", "width")}
    data = xr.Dataset(columns | {"ends": (("shape", "end", "axis"), np.array([shape["ends"] for shape in shapes]))})
    return Findings("Sensitivities of a hover in wind", data, summary, flights=flights)


def fly(asked: DesignConfig, work: Work, jobs: dict[int, Job]) -> list[Row]:
    """Return the rows of jobs; those flown already are not flown again."""
    flown = plain_values.to_builtins([{**job._asdict(), "designs": job.designs.tolist()} for job in jobs.values()])
    base = rust.config_digest(rust.load_config(campaign.BASE))
    asks, files = {"flown": flown, "base": base}, [robots.MK3, campaign.PERTURBATION]
    done = campaign.fly(jobs, work.narrowed(Identity.of(asks, files)), asked.processes)
    return [row for block in done.values() for row in block]


def designs(asked: DesignConfig, work: Work) -> Findings:
    """Fly every design."""
    drawn, size = robots.draw(asked.count, asked.seed), asked.block
    blocks = range(0, asked.count, size)
    rows = fly(asked, work, {at: Job(drawn[at : at + size], (0,), FLIGHTS, asked.seed) for at in blocks})
    data, missed = to_dataset(drawn, rows, list(FLIGHTS)), [row["missed"] for row in rows]
    lost = data["figures"].sel(figure="lost").isel(draw=0).values
    summary: dict[str, Any] = {"designs": len(rows), "without trim": sum(map(bool, missed))}
    summary |= {f"without trim, missed: {name}": missed.count(name) for name in sorted({*missed} - {""})}
    summary |= {f"lost, {name}": int((lost[:, at] == 1.0).sum()) for at, name in enumerate(FLIGHTS)}
    return Findings("Designs of iRonCub-Mk3", data, summary, flights=_base(), files=[robots.MK3, campaign.PERTURBATION])


def _base() -> dict[str, rust.Config]:
    return {campaign.BASE: rust.load_config(campaign.BASE)}


def to_dataset(drawn: Array, rows: list[Row], flights: list[str]) -> xr.Dataset:
    """Return designs, their trims and the figures of their flights."""
    figures = np.array([row["figures"] for row in rows], dtype=np.float64)
    return xr.Dataset(
        {
            "number": (("design", "parameter"), drawn),
            "missed": ("design", [row["missed"] for row in rows]),
            "mass": ("design", [row["mass"] for row in rows], {"units": "kg"}),
            "pitch": ("design", [row["pitch"] for row in rows], {"units": "deg", "long_name": "pitch in the trim"}),
            "figures": (("design", "draw", "flight", "figure"), figures),
        },
        {"parameter": list(RANGES), "flight": flights, "figure": list(FIGURES)},
    )


def scores(data: xr.Dataset) -> dict[str, Array]:
    """Return what designs are worth relative to the first, less being better; infinite for one that is lost.

    `still` is the geometric mean of tracking error and thrust of a climb in still air, as in the published co-design,
    where losses do not count; `wind` that of tracking error and thrust in wind and of how fast the robot sinks after
    an engine stops.
    """
    median, lost = data["figures"].median("draw"), (data["figures"].sel(figure="lost") != 0.0).any(("draw", "flight"))

    def of(flight: str, figure: str) -> Array:
        return np.asarray(median.sel(flight=flight, figure=figure))

    sink = np.maximum(of("still", "sink"), of("fast", "sink"))
    still = of("still", "tracking") * of("still", "thrust")
    wind = np.where(lost, np.nan, of("fast", "tracking") * of("fast", "thrust") * sink)
    return {
        "still": np.nan_to_num(np.sqrt(still / still[0]), nan=np.inf),
        "wind": np.nan_to_num(np.cbrt(wind / wind[0]), nan=np.inf),
    }


def front(costs: Array) -> Array:
    """Return which rows of costs are not dominated: no other is as low in every column and lower in one.

    A row with a cost that is not finite is on no front.
    """
    known = np.flatnonzero(np.isfinite(costs).all(axis=1))
    points, best = costs[known], np.zeros(len(costs), dtype=bool)
    best[known] = [not ((points <= one).all(axis=1) & (points < one).any(axis=1)).any() for one in points]
    return best


def decisive(drawn: Array, score: Array) -> list[int]:
    """Return the three numbers of jets and shoulders that matter most, by a quadratic model of its logarithm."""
    known, (low, high) = np.isfinite(score), np.array(list(RANGES.values())).T
    x = 2.0 * (drawn[known] - low) / (high - low) - 1.0
    fit, *_ = np.linalg.lstsq(np.column_stack([np.ones(len(x)), x, x**2]), np.log(score[known]), rcond=None)
    n, at = x.shape[1], np.linspace(-1.0, 1.0, 21)[:, None]
    effect = np.ptp(at * fit[1 : n + 1] + at**2 * fit[n + 1 :], axis=0)
    effect[[at for at, name in enumerate(RANGES) if name in (*robots.LIMBS, "leg_mass")]] = 0.0
    return [int(number) for number in np.argsort(-effect)[:3]]


def confirmed(asked: DesignConfig, work: Work) -> Findings:
    """Fly the best designs of each objective with other draws, and the best of these in more and harder flights."""
    source = places.RESULTS / "design" / "designs" / places.RUN_FILE
    if not source.is_file():
        raise Refused("there are no designs; fly them with: jax-aero study design designs")
    with run_file.opened(source) as opened:
        first = opened.load()
    drawn, score = first["number"].values, scores(first)
    best, three = {name: np.argsort(score[name])[:FEW] for name in score}, decisive(drawn, score["wind"])
    grid = np.repeat(drawn[:1], GRID**3, axis=0)
    levels = [np.linspace(*list(RANGES.values())[at], GRID) for at in three]
    grid[:, three] = np.stack(np.meshgrid(*levels), axis=-1).reshape(-1, 3)
    few = np.vstack([drawn[:1], drawn[best["still"]], drawn[best["wind"]], grid])
    group = np.repeat(["Mk3", "still", "wind", "three"], [1, FEW, FEW, len(grid)])
    draws = tuple(range(1, 1 + asked.draws))
    rows = fly(asked, work, {at: Job(few[at : at + 1], draws, FLIGHTS, asked.seed) for at in range(len(few))})
    second = to_dataset(few, rows, list(FLIGHTS))
    again, lost = scores(second), second["figures"].sel(figure="lost").values != 0.0
    chosen = {"Mk3": 0}
    for name, by in (("still", "still"), ("wind", "wind"), ("three", "wind")):
        mine = np.flatnonzero(group == name)
        chosen[name] = int(mine[np.argmin(again[by][mine])])
    cylinders = {"simulator.aero": rust.load_aero(places.CONFIGS / "aero" / "sphere_cylinder.toml")}
    flights = AGAIN | {f"{name}, cylinders": changes | cylinders for name, changes in AGAIN.items()}
    picked, repeats = few[list(chosen.values())], range(1000, 1000 + asked.repeats)
    jobs = [Job(robot[None], (draw,), flights, asked.seed) for robot in picked for draw in repeats]
    last = np.array([row["figures"] for row in fly(asked, work, dict(enumerate(jobs)))], dtype=np.float64)
    figures = last.reshape(len(chosen), asked.repeats, len(flights), len(FIGURES))
    costs = first["figures"].isel(draw=0).sel(figure=["tracking", "thrust", "sink"]).values
    fell = (first["figures"].isel(draw=0).sel(figure="lost") != 0.0).values
    alive = np.where(fell.any(axis=1, keepdims=True), np.nan, costs[:, 1])
    fronts = np.column_stack([front(costs[:, 0, :2]), front(alive[:, :2]), front(alive)])
    data = xr.Dataset(
        {
            "again": (("robot", "repeat", "flight", "figure"), figures),
            "number": (("robot", "parameter"), picked),
            "first": (("design", "loss", "cost"), costs[:, :, :2]),
            "first_lost": (("design", "loss"), fell),
            "front": (("design", "of"), fronts),
        },
        {"robot": list(chosen), "flight": list(flights), "figure": list(FIGURES), "parameter": list(RANGES)}
        | {"loss": list(FLIGHTS), "cost": ["tracking", "thrust"], "of": ["still", "wind", "wind, sink"]},
    )
    both = np.isfinite(score["still"]) & np.isfinite(score["wind"])
    summary: dict[str, Any] = {
        "numbers of jets and shoulders that matter most in wind": ", ".join(list(RANGES)[at] for at in three),
        "rank correlation of the scores": float(spearmanr(score["still"][both], score["wind"][both])[0]),
        "better than Mk3 in wind": int((score["wind"] < 1.0).sum()),
        "on the front of tracking and thrust in still air": int(fronts[:, 0].sum()),
        "of these, lost in 15 m/s, the fast leg and the loss of an arm engine": int(fell[fronts[:, 0], 1].sum()),
        "of these, on the front of tracking and thrust in wind": int(fronts[:, :2].all(axis=1).sum()),
        "on the front of tracking and thrust in wind": int(fronts[:, 1].sum()),
        "on the front of tracking, thrust and sinking in wind": int(fronts[:, 2].sum()),
        "of the best of still air, among the best in wind": len({*best["still"]} & {*best["wind"]}),
        "the best of still air, lost in 15 m/s, the fast leg and the loss of an arm engine": share(
            lost[group == "still"][:, :, 1]
        ),
    }
    for at, (name, index) in enumerate(chosen.items()):
        values = zip(RANGES, few[index].tolist(), strict=True)
        summary[f"{name}, numbers"] = ", ".join(f"{key} {value:.4g}" for key, value in values)
        summary |= {f"{name}, score in {by}": float(again[by][index]) for by in again}
        for flight, one, mk3 in zip(
            flights, np.moveaxis(figures[at], 1, 0), np.moveaxis(figures[0], 1, 0), strict=True
        ):
            summary[f"{name}, {flight}, lost"] = share(one[:, 0] != 0.0)
            for figure, of_one, of_mk3 in zip(FIGURES, one.T, mk3.T, strict=True):
                if figure in ("tracking", "thrust", "lean", "sink") and not np.isnan(of_one).all():
                    beside = f"; over Mk3's {ratio(of_one / of_mk3)}" if at else ""
                    summary[f"{name}, {flight}, {figure}"] = f"{np.nanmedian(of_one):.4g}{beside}"
    texts, base = dict[str, str | bytes](), rust.load_config(campaign.BASE)
    with TemporaryDirectory() as folder:
        for name, index in chosen.items():
            written = robots.write(dict(zip(RANGES, few[index].tolist(), strict=True)), Path(folder), name)
            own = changed(robots.fit(written, base)[1], base) | {"base": f"{campaign.BASE}.toml"}
            texts |= {file.name: file.read_bytes() for file in (written, written.with_suffix(".urdf"))}
            texts[f"fly_{name}.toml"] = plain_values.toml(own | {"robot": f"../robot/{written.name}"})
    return Findings("The best designs again", data, summary, flights=_base(), files=[source, robots.MK3], texts=texts)


def changed(table: Row, base: Row) -> Row:
    """Return what a configuration has that another has not."""
    nested = {
        key: changed(value, base[key]) if isinstance(value, dict) and key in base else value
        for key, value in table.items()
    }
    return {
        key: value
        for key, value in nested.items()
        if value != {} and (isinstance(value, dict) or value != base.get(key))
    }


def share(lost: Any) -> str:
    """Return how many flights were lost, with the Wilson interval."""
    low, high = wilson(int(lost.sum()), lost.size)
    return f"{int(lost.sum())} of {lost.size} ({100 * low:.1f} to {100 * high:.1f} %)"


def ratio(values: Array) -> str:
    """Return the median of paired ratios, with its bootstrapped 95 % interval."""
    known = values[np.isfinite(values)]
    draws = np.median(np.random.default_rng(1).choice(known, (10_000, known.size)), axis=1)
    return f"{np.median(known):.3f} ({np.quantile(draws, 0.025):.3f} to {np.quantile(draws, 0.975):.3f})"


PARTS = {"sensitivities": sensitivities, "designs": designs, "confirmed": confirmed}
STUDY = Study(
    "design",
    __doc__,
    DesignConfig,
    compute,
    tuple(PARTS),
    backend="jax",
    resumes=True,
)
main = STUDY.main

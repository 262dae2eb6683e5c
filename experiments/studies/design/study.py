"""Which iRonCub should be built to fly in wind: sensitivities, designs of iRonCub-Mk3, the best of them again.

`jax-aero study design [PART]`: `sensitivities` of a hover in wind to every number of both robots, by one gradient;
`designs`, flights of designs in a robot's world; `confirmed`, the best of these with other draws, which reads
`results/design/designs/`. An interrupted part goes on with the next block. `--set cluster=ray` spreads blocks over a
Ray cluster.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import spearmanr

from experiments import Refused, record, study
from experiments.sources import code_hash
from experiments.studies.design import campaign, robots, sensitivity
from experiments.studies.design.campaign import AGAIN, FIGURES, FLIGHTS, Job, Row
from experiments.studies.design.robots import RANGES, Array
from experiments.study import Findings, Study
from experiments.sweep.table import wilson
from jax_aero import places, plain, rust, tables
from jax_aero.rotations import rotation_from_rpy

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
    cluster: Literal["ray"] | None = None


def compute(part: str, asked: DesignConfig, path: Path) -> Findings:
    """Compute a part."""
    if part not in PARTS:
        raise Refused(f"there is no part `{part}`{places.did_you_mean(part, PARTS)}")
    return PARTS[part](asked, path)


def sensitivities(asked: DesignConfig, _: Path) -> Findings:
    """Differentiate a hover of each robot."""
    shapes: list[Row] = []
    summary: dict[str, Any] = {}
    flights: dict[str, rust.Config] = {}
    for robot, name in HOVERS.items():
        flights[name] = rust.load_config(name, IN_WIND | {"simulator.duration": asked.duration})
        value, slopes, times = sensitivity.gradient(flights[name])
        again, quotients, seconds = sensitivity.differences(flights[name])
        off = {kind: np.abs(slopes[kind] - one).max() / np.abs(one).max() for kind, one in quotients.items()}
        effects = {kind: 100.0 * slopes[kind] * unit / value for kind, unit in sensitivity.UNITS.items()}
        shapes += [shape | {"robot": robot} for shape in placed(flights[name], effects)]
        summary |= {
            f"{robot}, numbers": sum(one.size for one in slopes.values()),
            f"{robot}, cost": value,
            f"{robot}, cost of the crate, relative difference": abs(again / value - 1.0),
            f"{robot}, derivatives, greatest difference over the greatest of a kind": float(max(off.values())),
            **{f"{robot}, {key} [s]": one for key, one in times.items()},
            f"{robot}, differences of the crate [s]": seconds,
        }
        for kind, found in effects.items():
            summary[f"{robot}, cost by one unit of {kind} at most [%]"] = float(np.abs(found).max())
    data = xr.Dataset(
        {
            "robot": ("shape", [shape["robot"] for shape in shapes]),
            "kind": ("shape", [shape["kind"] for shape in shapes]),
            "effect": (
                "shape",
                [shape["effect"] for shape in shapes],
                {"units": "%", "long_name": "change of the cost"},
            ),
            "width": ("shape", [shape["width"] for shape in shapes], {"units": "m"}),
            "ends": (("shape", "end", "axis"), np.array([shape["ends"] for shape in shapes]), {"units": "m"}),
        },
        {"name": ("shape", [shape["name"] for shape in shapes]), "axis": ["x", "y", "z"]},
    )
    return Findings("Sensitivities of a hover in wind", data, summary, flights=flights)


def placed(config: rust.Config, effects: sensitivity.Numbers) -> list[Row]:
    """Return links, joints and jets in space [m], with what one unit of change does to the cost [%].

    A centimetre of a link's centre of mass, of a joint, a degree of a jet: the root of the squares over the axes.
    """
    robot, initial = rust.Robot(config["robot"]), config["simulator"]["initial"]
    rotation = rotation_from_rpy(np.radians(initial["base_rpy_deg"]))
    state = rust.State.at_rest(robot, initial["joint_position"])._replace(base_rotation=rotation)
    found, numbers = rust.dynamics(robot, state), robot.arrays()
    links, jets = numbers["aero_links"], numbers["jets"]
    size = {kind: np.linalg.norm(np.atleast_2d(one.T).T, axis=1) for kind, one in effects.items()}

    def put(body: int, *points: Array) -> list[Array]:
        return [found.body_positions[body] + found.body_rotations[body] @ point for point in points]

    shapes = []
    for i, (name, body) in enumerate(zip(robot.aero_link_names, links["bodies"], strict=True)):
        half = 0.0 if links["is_sphere"][i] else 0.5 * links["lengths"][i]
        turn, middle = links["rotations"][i], links["centres"][i]
        along = [links["positions"][i] + turn @ (middle + sign * half * links["axes"][i]) for sign in (-1.0, 1.0)]
        width, ends = links["diameters"][i], put(body, *along)
        shapes.append({"kind": "com", "name": name, "ends": ends, "width": width, "effect": size["com"][body]})
    for i, name in enumerate(robot.joint_names):
        at = found.body_positions[i + 1]
        shapes.append({"kind": "joint", "name": name, "ends": [at, at], "width": 0.0, "effect": size["joint"][i]})
    for i, (name, body) in enumerate(zip(robot.jet_names, jets["bodies"], strict=True)):
        axis = jets["rotations"][i] @ jets["axes"][i]
        ends = put(body, jets["positions"][i], jets["positions"][i] - 0.35 * axis)
        shapes.append({"kind": "axis", "name": name, "ends": ends, "width": 0.0, "effect": size["axis"][i]})
    return shapes


def key_of(asked: DesignConfig, part: str) -> str:
    """Return the digest of what determines the blocks of a part."""
    flown = [asked.seed, part, FLIGHTS, AGAIN, RANGES, rust.config_digest(rust.load_config(campaign.BASE))]
    files = [robots.MK3, campaign.PERTURBATION]
    return f"{study.digest({'flown': plain.to_builtins(flown)}, files)} {code_hash(campaign.__name__)}"


def designs(asked: DesignConfig, path: Path) -> Findings:
    """Fly every design."""
    drawn, size = robots.draw(asked.count, asked.seed), asked.block
    jobs = {at: Job(drawn[at : at + size], (0,), FLIGHTS, asked.seed) for at in range(0, asked.count, size)}
    done = campaign.fly(jobs, path, key_of(asked, f"designs {size}"), asked.processes, asked.cluster)
    rows = [row for block in done.values() for row in block]
    data = to_dataset(drawn, rows, list(FLIGHTS))
    missed = [row["missed"] for row in rows]
    summary: dict[str, Any] = {"designs": len(rows), "without trim": sum(map(bool, missed))}
    summary |= {f"without trim, missed: {name}": missed.count(name) for name in sorted({*missed} - {""})}
    lost = data["figures"].sel(figure="lost").isel(draw=0)
    summary |= {f"lost, {name}": int((lost.sel(flight=name) == 1.0).sum()) for name in FLIGHTS}
    summary["lost in a flight or more"] = int((lost == 1.0).any("flight").sum())
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

    `still` is the geometric mean of tracking error and thrust while climbing in still air, as in the published
    co-design. `wind` is that of tracking error and thrust in wind, and of the greatest lean after an engine stops.
    """
    median, lost = data["figures"].median("draw"), (data["figures"].sel(figure="lost") != 0.0).mean("draw")

    def of(flight: str, figure: str) -> Array:
        return np.asarray(median.sel(flight=flight, figure=figure))

    lean = np.maximum(of("still", "lean"), of("fast", "lean"))
    parts = {
        "still": [of("still", "tracking"), of("still", "thrust")],
        "wind": [of("wind", "tracking") * of("fast", "tracking"), of("wind", "thrust") ** 2, lean**2],
    }
    found = {}
    for name, factors in parts.items():
        value = np.prod([factor / factor[0] for factor in factors], axis=0) ** (1.0 / (2.0 * len(factors)))
        is_lost = np.asarray(lost.any("flight") if name == "wind" else ~np.isfinite(value))
        found[name] = np.where(is_lost, np.inf, np.nan_to_num(value, nan=np.inf))
    return found


def front(values: Array) -> NDArray[np.bool_]:
    """Return which rows no other row is better than in all columns."""
    return np.array([not ((values <= row).all(axis=1) & (values < row).any(axis=1)).any() for row in values])


def decisive(drawn: Array, score: Array) -> list[int]:
    """Return the three numbers that change the score most over their range, by a quadratic model of its logarithm."""
    known = np.isfinite(score)
    low, high = np.array(list(RANGES.values())).T
    x = 2.0 * (drawn[known] - low) / (high - low) - 1.0
    terms = np.column_stack([np.ones(len(x)), x, x**2])
    fit, *_ = np.linalg.lstsq(terms, np.log(score[known]), rcond=None)
    n, at = x.shape[1], np.linspace(-1.0, 1.0, 21)[:, None]
    effect = np.ptp(at * fit[1 : n + 1] + at**2 * fit[n + 1 :], axis=0)
    return [int(number) for number in np.argsort(-effect)[:3]]


def confirmed(asked: DesignConfig, path: Path) -> Findings:
    """Fly the best designs of each objective with other draws, and the best of these in more and harder flights."""
    source = places.RESULTS / "design" / "designs" / places.RUN_FILE
    if not source.is_file():
        raise Refused("there are no designs; fly them with: jax-aero study design designs")
    with record.open_result(source) as opened:
        first = opened.load()
    drawn, score = first["number"].values, scores(first)
    best = {name: np.argsort(score[name])[:FEW] for name in score}
    three = decisive(drawn, score["wind"])
    grid = np.repeat(drawn[:1], GRID**3, axis=0)
    ends = [np.linspace(*list(RANGES.values())[at], GRID) for at in three]
    grid[:, three] = np.stack(np.meshgrid(*ends), axis=-1).reshape(-1, 3)
    few = np.vstack([drawn[:1], drawn[best["still"]], drawn[best["wind"]], grid])
    draws = tuple(range(1, 1 + asked.draws))
    jobs = {at: Job(few[at : at + 1], draws, FLIGHTS, asked.seed) for at in range(len(few))}
    run = (asked.processes, asked.cluster)
    done = campaign.fly(jobs, path, key_of(asked, f"few {asked.draws} {study.digest({'few': few.tolist()}, [])}"), *run)
    second = to_dataset(few, [block[0] for block in done.values()], list(FLIGHTS))
    again, members = scores(second), np.repeat(["Mk3", "still", "wind", "three"], [1, FEW, FEW, len(grid)])
    chosen = {"Mk3": 0}
    for name, by in (("still", "still"), ("wind", "wind"), ("three", "wind")):
        mine = np.flatnonzero(members == name)
        chosen[name] = int(mine[np.argmin(again[by][mine])])
    flights = {f"{name}, {air}": AGAIN[name] | changes for air, changes in airs().items() for name in AGAIN}
    firsts = range(1000, 1000 + asked.repeats)
    jobs = {
        1000 * at + draw: Job(few[at : at + 1], (draw,), flights, asked.seed)
        for draw in firsts
        for at in chosen.values()
    }
    done = campaign.fly(jobs, path, key_of(asked, f"chosen {[few[at].tolist() for at in chosen.values()]}"), *run)
    rows = [done[1000 * at + draw][0] for at in chosen.values() for draw in firsts]
    last = to_dataset(few[np.repeat(list(chosen.values()), asked.repeats)], rows, list(flights))
    figures = last["figures"].values.reshape(len(chosen), asked.repeats, len(flights), len(FIGURES))
    data = xr.Dataset(
        {
            "again": (("robot", "repeat", "flight", "figure"), figures),
            "number": (("robot", "parameter"), few[list(chosen.values())]),
            "first": (("design", "score"), np.column_stack([score["still"], score["wind"]])),
            "few": (("candidate", "score"), np.column_stack([again["still"], again["wind"]])),
            "group": ("candidate", members),
        },
        {
            "robot": list(chosen),
            "flight": list(flights),
            "figure": list(FIGURES),
            "parameter": list(RANGES),
            "score": ["still", "wind"],
        },
    )
    data.attrs["three"] = ", ".join(list(RANGES)[at] for at in three)
    both = np.isfinite(score["still"]) & np.isfinite(score["wind"])
    lost = (second["figures"].sel(figure="lost") != 0.0).values
    is_still = members == "still"
    summary: dict[str, Any] = {
        "numbers that matter most in wind": data.attrs["three"],
        "rank correlation of the scores in still air and in wind": float(
            spearmanr(score["still"][both], score["wind"][both])[0]
        ),
        "designs that keep every flight and are better than Mk3 in wind": int((score["wind"] < 1.0).sum()),
        "of the best of still air also among the best in wind": len({*best["still"]} & {*best["wind"]}),
        **share("the best of still air, lost in 15 m/s", lost[is_still][:, :, 1]),
        **share("the best of still air, lost after the engine stops in the fast leg", lost[is_still][:, :, 2]),
    }
    for name, at in chosen.items():
        values = zip(RANGES, few[at].tolist(), strict=True)
        summary[f"{name}, numbers"] = ", ".join(f"{key} {value:.4g}" for key, value in values)
        summary |= {f"{name}, score in {by}": float(again[by][at]) for by in again}
        for flight in flights:
            one = data["again"].sel(robot=name, flight=flight)
            summary |= share(f"{name}, {flight}, lost", (one.sel(figure="lost") != 0.0).values)
            for figure in ("tracking", "thrust", "lean", "sink"):
                values_of, mk3 = (
                    data["again"].sel(robot=r, flight=flight, figure=figure).values for r in (name, "Mk3")
                )
                if not np.isnan(values_of).all():
                    summary[f"{name}, {flight}, {figure}"] = float(np.nanmedian(values_of))
                    if name != "Mk3" and figure != "sink":
                        summary[f"{name}, {flight}, {figure} over Mk3's, 95 %"] = ratio(values_of / mk3)
    texts: dict[str, str | bytes] = {}
    with TemporaryDirectory() as folder:
        for name, at in chosen.items():
            written = robots.write(dict(zip(RANGES, few[at].tolist(), strict=True)), Path(folder), name)
            texts |= {file.name: file.read_bytes() for file in (written, written.with_suffix(".urdf"))}
    return Findings("The best designs again", data, summary, flights=_base(), files=[source, robots.MK3], texts=texts)


def airs() -> dict[str, dict[str, Any]]:
    """Return the air of the flights, foreign to the controller, and another one."""
    return {
        "shapes": {},
        "cylinders": {"simulator.aero": rust.load_aero(places.CONFIGS / "aero" / "sphere_cylinder.toml")},
    }


def share(name: str, lost: Any) -> dict[str, str]:
    """Return how many flights were lost, with the Wilson interval."""
    low, high = wilson(int(lost.sum()), lost.size)
    return {name: f"{int(lost.sum())} of {lost.size} ({100 * low:.1f} to {100 * high:.1f} %)"}


def ratio(values: Array) -> str:
    """Return the median of paired ratios, with its bootstrapped interval."""
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
    engine="jax",
    interrupted="the same command goes on with the next block",
    progress=".blocks",
)
main = STUDY.main

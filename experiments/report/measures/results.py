"""Measures of results: flights, sweeps and studies."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from experiments.report.measures import Measured, one
from experiments.report.measures.files import SPEED_OF_SOUND
from experiments.report.measures.standing import recorded, standing
from experiments.report.results import Cell, Results, count
from jax_aero.base import flights
from jax_aero.data.battery import PAPER_FUEL
from jax_aero.results.flight import PAPER_RUNS
from jax_aero.rust import SETTLING_TIME
from jax_aero.sweep.columns import SHARES
from jax_aero.sweep.criteria import Criterion, Share
from jax_aero.sweep.intervals import wilson
from jax_aero.sweep.populations import OF_UPRIGHT, quantile

RIGHT, HEAD, PUBLISHED = (
    "corrected arms, 10 m/s from the side",
    "corrected arms, 18 m/s from ahead",
    "published arms, 10 m/s from the side",
)
"""Levels of the axis `world` of the ablations, as in configs/sweeps/axes/worlds.toml."""

LEAST_FIRST = (
    "total moment only",
    "total force only",
    "total wrench only",
    "normal force only",
    "drag only",
    "without Λ_a",
    "without J_aᵀ f_a",
)
"""Levels of the ablation of terms, from no feedback to all feedback."""

MOSTLY = 0.95
"""Share of perturbed repetitions whose interval says whether it is decided that a flight is flown."""

ARMS = {"corrected": "", "published": "_published"}
"""Suffixes of the names of flights, by lever arms."""

SUCCESSFUL, FAILED = ("test2", "test4", "robustness", "robustness_published"), ("test1_published", "test3_published")
"""Flights whose joint errors stay bounded in the paper, and those in which they grow until the robot falls."""

STANDING = {"balancing_front_as_flown": "standing_front_2", "balancing_lateral_as_flown": "standing_lateral"}
"""The ground experiments of Fig. 6, with the records to which the friction of their drives was fitted."""
PREDICTED = {"balancing_front_1_as_flown": "standing_front_1"}
"""The recorded run to which nothing was fitted."""

MOTION_BANDS = {"[mm]": 20.0, "[deg]": 1.0, "[N m]": 1.5, "[s]": 1.0}
"""Differences of the simulated experiment from the robot's, by unit; equal experiments moved the robot by 31 and 51 mm,
and its legs by 1.3 N m apart."""

UNITS = {"rotation_error_deg": "°", "com_error": " m", "joint_error_sum_deg": "°"}
"""Units of quantities, as they follow a number."""


def perturbed(results: Results, *, test: str) -> Measured:
    """Measure a test, its perturbed repetitions, and those with finer steps and winds 1e-5 m/s apart, by lever arms."""
    cells, finer = results.sweep("paper_tests"), results.sweep("convergence")
    name = test.upper() if test.startswith("test") else test
    cases = {}
    for arms, end in ARMS.items():
        flight, cell = results.flight(test + end), cells.cell(test=f"{name}, {arms} arms")
        cases[arms] = {
            "ending": flight.ending,
            "is_fallen": flight.document["outcome"] == "fell",
            "is_completed": flight.document["outcome"] == "completed",
            "rotation_error": flight.rotation_error,
            "com_error_cm": 100.0 * flight.com_error,
            "count": count(cell),
            "edge": _lost(finer.select(flight=f"{name}, published arms" if end else name)),
            "share": cell["completed"] / cell["flights"],
            "low": cell["completed_low"],
            "high": cell["completed_high"],
            "is_decided": not cell["completed_low"] < MOSTLY < cell["completed_high"],
        }
    return Measured(cases)


def _lost(known: list[dict[str, Any]]) -> str:
    lost, flights = (sum(int(cell[key]) for cell in known) for key in ("lost", "flights"))
    return f"{lost} of {flights}"


def joint_errors(results: Results) -> Measured:
    """Measure the sums of joint errors in each part of the body, as the paper draws them.

    Of flights that succeed in the paper, the greatest share of a sum that is left at the end; of those that fail, the
    least one.
    """
    cases: dict[str, dict[str, Any]] = {}
    for name in (*SUCCESSFUL, *FAILED):
        errors = results.flight(name).joint_errors
        text = ", ".join(f"{part} {most:.0f}° ({end:.0f}°)" for part, (most, end) in errors.items())
        left = [end / most for most, end in errors.values()]
        cases[name] = {"parts": text} | ({"rest": max(left)} if name in SUCCESSFUL else {"rest_fallen": min(left)})
    return Measured(cases)


def force_angle(results: Results) -> Measured:
    """Measure the angle between total force and relative wind [deg]."""
    median, greatest = results.flight("test2").force_angle
    return one(median=median, greatest=greatest)


def asymmetry(results: Results) -> Measured:
    """Measure how much more left and right thrusts differ in the flights of Fig. 5 than without wind [N].

    Also the moment of the air in the wind at rest, and what the thrusts leave of it (`Flight.moments`).
    """
    still, cases = results.flight("no_wind").asymmetry, {}
    for name in ("test4", "robustness"):
        flight = results.flight(name)
        (arms, chest), moments = flight.asymmetry, flight.moments
        cases[name] = {"arms": arms, "chest": chest, "still": max(still), "ratio": max(arms, chest) / max(still)}
        cases[name] |= moments | {"balance": moments["left"] / moments["air"]}
    return Measured(cases)


def thrusts(results: Results) -> Measured:
    """Measure how far the thrusts of each jet differ with two models in the simulator, rms after settling [N].

    `exchanged` is the same with left and right of one flight exchanged.
    """
    both = [results.flight(name) for name in ("test2", "test4")]
    first, second = (flight.run["thrust"].sel(time=slice(SETTLING_TIME, None)).values for flight in both)
    others = (second, second[:, both[1].mirrored])
    apart, exchanged = (float(np.sqrt(((first - rows) ** 2).mean())) for rows in others)
    (low, high), (low4, high4) = (flight.thrust for flight in both)
    return one(low=low, high=high, low4=low4, high4=high4, apart=apart, exchanged=exchanged, ratio=apart / exchanged)


def mach(results: Results) -> Measured:
    """Measure the Mach number of the greatest speed of the centre of mass relative to the air."""
    runs = [results.flight(name).run for name in ("test2", "test4")]
    speed = max(float(np.linalg.norm(run["wind"] - run["com_velocity"], axis=1).max()) for run in runs)
    return one(speed=speed, mach=speed / SPEED_OF_SOUND, density=50.0 * (speed / SPEED_OF_SOUND) ** 2)


def force_changes(results: Results) -> Measured:
    """Measure the rms rate of the aerodynamic force over that of the estimated linear momentum rate [%]."""
    cases = {}
    for name in ("test2", "test4"):
        run = results.flight(name).run.sel(time=slice(SETTLING_TIME, None))
        signals = (flights.aero_force(run), run["momentum_rate_estimate"].isel(six=slice(3)))
        of_air, whole = (float((signal.differentiate("time") ** 2).mean()) for signal in signals)
        cases[name] = {"percent": 100.0 * math.sqrt(of_air / whole) if whole else math.nan}
    return Measured(cases)


def oscillations(results: Results) -> Measured:
    """Measure the rms speed of the joints in the full wind of the robustness test, moving and at rest [deg/s]."""
    cases = {}
    for arms, end in ARMS.items():
        flight = results.flight(f"robustness{end}")
        squares, parts = np.degrees(flight.run["joint_velocity"].values) ** 2, (flight.is_moving, ~flight.is_moving)
        moving, resting = (float(np.sqrt(squares[rows & flight.is_windy].mean())) for rows in parts)
        cases[arms] = {"moving": moving, "resting": resting, "ratio": moving / resting if resting else math.nan}
    return Measured(cases)


def nonlinear(results: Results) -> Measured:
    """Measure the angle between force and relative wind with either model in the simulator [deg]."""
    axisymmetric, network = (results.flight(name).force_angle[0] for name in ("test2", "test4"))
    return one(axisymmetric=axisymmetric, network=network, ratio=network / axisymmetric)


def forces_apart(results: Results) -> Measured:
    """Measure how far the forces of the simulator's and of the controller's model differ in the robustness test [N]."""
    cases = {}
    for arms, end in ARMS.items():
        apart = results.flight(f"robustness{end}").forces_apart
        ratios = {"later": apart["late"] / apart["early"], "ratio": apart["moving"] / apart["resting"]}
        cases[arms] = apart | ratios
    return Measured(cases)


def model_pairs(results: Results) -> Measured:
    """Count the winds flown to the end with the simulator's model, another, none, and none but an observer."""
    sweep = results.sweep("model_pairs")
    worlds, cases = sweep.levels("world"), {}
    for arms in sweep.levels("arms"):
        cells = sweep.select(arms=arms)
        kinds = {
            "the simulator's model": [cell for cell in cells if cell["model"] == cell["world"]],
            "another model": [cell for cell in cells if cell["model"] in worlds and cell["model"] != cell["world"]],
            "no model": [cell for cell in cells if cell["model"] == "none"],
            "no model, observer": [cell for cell in cells if cell["model"] == "observer, no model"],
        }
        counts = {
            name: (sum(c["completed"] for c in own), sum(c["on_course"] for c in own), sum(c["flights"] for c in own))
            for name, own in kinds.items()
        }
        part, on_course, whole = counts["another model"]
        said = ", ".join(f"{name} {n} ({on} on course) of {m}" for name, (n, on, m) in counts.items())
        cases[arms] = {"counts": said, "low": wilson(part, whole)[0], "on_course": on_course / whole}
    return Measured(cases)


def lambda_term(results: Results) -> Measured:
    """Measure the ablation of the change of aerodynamic forces, by world [deg]."""
    cells, cases = results.sweep("ablation_terms"), {}
    for world in (RIGHT, HEAD, PUBLISHED):
        whole, without = (
            cells.cell(world=world, feedback=level)["rotation_error_deg_median_of_all"]
            for level in ("everything", "without Λ_a")
        )
        cases[world] = {"whole": whole, "without": without, "change": abs(whole - without)}
    return Measured(cases)


def minimum(results: Results) -> Measured:
    """Answer which is the least aerodynamic information with which the robot still flies.

    A level is as good as all feedback in a world if its success rate reaches the lower end of the latter's interval.
    """
    cells = results.sweep("ablation_terms")
    worlds = cells.levels("world")

    def equal_feedbacks(what: str) -> list[str]:
        good = []
        for feedback in cells.levels("feedback"):
            pairs = [
                (cells.cell(world=w, feedback=feedback), cells.cell(world=w, feedback="everything")) for w in worlds
            ]
            if all(cell[what] >= whole[f"{what}_low"] * cell["flights"] for cell, whole in pairs):
                good.append(feedback)
        return good

    def tabulate(level: str, quantity: str, form: str) -> str:
        medians = (cells.cell(world=w, feedback=level)[f"{quantity}_median_of_all"] for w in worlds)
        return ", ".join("lost" if median == math.inf else format(median, form) for median in medians)

    completes, stays = equal_feedbacks("completed"), equal_feedbacks("on_course")
    only = {name: f"total {name} only" for name in ("moment", "force")}
    return one(
        least=next((name for name in LEAST_FIRST if name in stays), "nothing short of everything"),
        stays=", ".join(stays),
        completes=", ".join(completes),
        **{f"{name}_rotation": tabulate(level, "rotation_error_deg", ".0f") for name, level in only.items()},
        **{f"{name}_com": tabulate(level, "com_error", ".2f") for name, level in only.items()},
    )


def ground(results: Results) -> Measured:
    """Measure the ground experiments, in frontal wind along x and in lateral wind along y, beside the records."""
    return Measured(
        {name: _beside(results, name, record, axis) for axis, (name, record) in enumerate(STANDING.items())}
    )


def predicted_motion(results: Results) -> Measured:
    """Measure the experiment to whose record nothing was fitted."""
    return Measured({name: _beside(results, name, record, 0) for name, record in PREDICTED.items()})


def _beside(results: Results, name: str, record: str, axis: int) -> dict[str, Any]:
    flight = results.flight(name)
    ours, theirs = standing(flight.run, *flight.stood, axis), recorded(record, flight.stood[0], axis)
    later = {"onset_later": ours["onset"] - theirs["onset"], "fallen_less": ours["fallen"] - theirs["fallen"]}
    farther = {"farther_mm": ours["moved_mm"] - theirs["moved_mm"]}
    return {**ours, **later, **farther, **{f"recorded_{figure}": value for figure, value in theirs.items()}}


def leg(results: Results, *, of: str) -> Measured:
    """Measure the motion of the left leg in one of the ground experiments."""
    return one(**ground(results).cases[of])


def mission_fuel(results: Results) -> Measured:
    """Measure the fuel of five minutes at the mean rate of a flight [kg]."""
    flown = results.study("along", "flights")["no_wind"]
    mass = flown["five_minutes_kg"]
    return one(mass=mass, litres=flown["fuel_l"], off=mass - PAPER_FUEL)


def arm_engines(results: Results) -> Measured:
    """Measure flights with either engine in the arms."""
    engines = results.study("arm_engines", "paper")
    weak = {name.removesuffix(" P100"): cell for name, cell in engines.items() if name.endswith("P100")}
    strong = {name: engines[f"{name} P160"] for name in weak}
    return Measured(
        {
            name: cell
            | {
                "outcome": cell["outcome"].replace("_", " "),
                "other": strong[name]["rotation_error"],
                "is_alike": cell["outcome"] == strong[name]["outcome"],
            }
            for name, cell in weak.items()
        }
    )


def clearance(results: Results) -> Measured:
    """Measure the least distance of the exhausts from the body [mm]; `paper` is that of the paper's flights alone."""
    distances = {name: figures["clearance_mm"] for name, figures in results.study("along", "flights").items()}
    asked = {name: {"paper": distances[name]} for name in PAPER_RUNS}
    return Measured({name: {"clearance": mm, **asked.get(name, {})} for name, mm in distances.items()})


def recorded_commands(results: Results) -> Measured:
    """Measure the differences of the standing robot's commands from the recorded ones."""
    runs = [results.study("standing", name) for name in ("front", "lateral")]

    def greatest(variant: str, figure: str) -> float:
        return float(max(run[f"{variant}: desired {figure}"] for run in runs))

    variants = {"flown": "as flown", "right": "right"}
    return one(
        **{f"torques_{name}": greatest(of, "torques, rms [N m]") for name, of in variants.items()},
        **{f"forces_{name}": greatest(of, "foot forces, rms [N]") for name, of in variants.items()},
    )


def recorded_motion(results: Results) -> Measured:
    """Measure motion and torques of the simulated experiment beside those of the robot."""
    texts, wrong = [], []
    for name in ("front", "lateral"):
        kept = results.study("standing", name)
        figures = [key.removeprefix("recorded: ") for key in kept if key.startswith("recorded: ")]
        pairs = {figure: (kept[f"simulated: {figure}"], kept[f"recorded: {figure}"]) for figure in figures}
        texts += [f"{name}: " + ", ".join(f"{key} {ours:.1f} ({robot:.1f})" for key, (ours, robot) in pairs.items())]
        bands = {figure: MOTION_BANDS[figure[figure.rindex("[") :]] for figure in figures}
        wrong += [f"{name}: {key}" for key, (ours, robot) in pairs.items() if not abs(ours - robot) <= bands[key]]
    return one(text="; ".join(texts), wrong=", ".join(wrong))


def wake(results: Results) -> Measured:
    """Measure the flow around the robot on the mesh of the recipe."""
    kept = results.study("cfd_flow", "flight30")
    part, surface = (
        100.0 * kept[f"part of the {of} where that is above 100"] for of in ("wake in the plane", "surface")
    )
    return one(
        surface=surface,
        bare=100.0 - surface,
        pressure=100.0 * kept["pressure share of the force"],
        greatest=kept["turbulent over molecular viscosity, largest in the plane"],
        part=part,
        rest=100.0 - part,
    )


def boundary(results: Results) -> Measured:
    """Measure the drag with our turbulence at the boundary, and with the printed one [m²]."""
    ours, printed = (results.study("cfd_flow", f"flight30{end}")["drag [m2]"] for end in ("", "_boundary"))
    return one(drag=ours, printed=printed, percent=100.0 * (printed / ours - 1.0))


def wake_meshes(results: Results) -> Measured:
    """Measure how far the wakes on the coarsest and on the finest mesh are apart [%]."""
    meshes = [results.study("cfd_flow", name) for name in ("flight30_coarse", "flight30", "flight30_fine")]
    areas = [mesh["wake in the plane, slower than half the wind [m2]"] for mesh in meshes]
    return one(
        cells=", ".join(f"{1e-3 * mesh['cells']:.0f}" for mesh in meshes),
        areas=", ".join(f"{area:.2f}" for area in areas),
        apart=100.0 * abs(areas[0] / areas[-1] - 1.0),
    )


def wind_estimate(results: Results) -> Measured:
    """Measure the wind estimated from the wrench, by world."""
    by_wind = results.study("wind_observer", "turbulence")
    worlds: dict[str, list[Mapping[str, float]]] = {}
    for name, figures in by_wind.items():
        worlds.setdefault(name.rpartition(", ")[0], []).append(figures)
    speeds = [name.rpartition(", ")[2].removesuffix(" m/s") for name in by_wind]
    cases = {}
    for world, cells in worlds.items():
        rms, inside = ([cell[key] for cell in cells] for key in ("rms", "inside"))
        cases[world] = {
            "speeds": f"{speeds[0]} to {speeds[-1]}",
            "rms_least": min(rms),
            "rms": max(rms),
            "inside_least": 100.0 * min(inside),
            "inside": 100.0 * max(inside),
        }
    return Measured(cases)


# --- claims in the files of sweeps ----------------------------------------------------------------------------------


def cells(results: Results, *, name: str, claim: Criterion) -> Measured:
    """Measure what a sweep has for the claim in its file."""
    sweep = results.sweep(name)
    return of_cells([cell for cell in sweep.rows if claim.covers(cell)], sweep.names, claim)


def of_cells(cells: Sequence[Cell], axes: Iterable[str], claim: Criterion) -> Measured:
    """Return shares of flights, or flights that do not succeed and bounded quantities by cell."""
    if not cells:
        raise LookupError(f"no cell of the claim `{claim.key}`")
    shares = dict(_share(cells, share) for share in claim.share)
    if shares and not claim.at_most:
        return Measured(shares, "; ".join(shares))
    varying = [axis for axis in axes if len({cell[axis] for cell in cells}) > 1]
    ended, flights = (sum(int(cell[key]) for cell in cells) for key in (claim.success, "flights"))
    said = [*(shares or [f"{_interval(ended, flights)} {SHARES[claim.success]}"]), *_ranges(cells, claim.at_most)]
    return Measured({**shares, **dict(_by_cell(cells, varying, claim))}, "; ".join(said))


def _share(cells: Sequence[Cell], share: Share) -> tuple[str, dict[str, Any]]:
    """Return a share with its interval and the least count that refutes it, and by how many flights it is too great."""
    part, whole = (sum(int(cell[key]) for cell in cells) for key in (share.of, share.among))
    most, (low, high) = int(share.at_most * whole + 1e-9), wilson(part, whole)
    text = f"{share.of} {_interval(part, whole)}; {most + 1} would refute it"
    is_decided = not low < share.at_most < high
    return text, {"above": part - most, "limit": 100.0 * share.at_most, "is_decided": is_decided}


def _by_cell(cells: Sequence[Cell], varying: list[str], claim: Criterion) -> Iterator[tuple[str, dict[str, Any]]]:
    for cell in cells:
        levels = [f"{cell[axis]:g}" if isinstance(cell[axis], float) else str(cell[axis]) for axis in varying]
        others = cell["flights"] - cell[claim.success]
        missed = f"{others} of {cell['flights']} not {SHARES[claim.success]}"
        limited = {column: math.nan if cell[column] is None else cell[column] for column in claim.at_most}
        texts = {f"{column}_text": _value(column, value) for column, value in limited.items()}
        yield ", ".join(levels) or claim.key, {"others": others, "missed": missed, **limited, **texts}


def _interval(part: int, whole: int) -> str:
    low, high = (100.0 * end for end in wilson(part, whole))
    return f"{part} of {whole} ({low:.1f} to {high:.1f} %)"


def _ranges(cells: Sequence[Cell], columns: Iterable[str]) -> Iterator[str]:
    """Yield the medians of the greatest rotation errors, the greatest, and the ranges of other columns."""
    medians, worst = (
        [cell[name] for cell in cells if cell[name] is not None]
        for name in (quantile("max_rotation_error_deg", end, OF_UPRIGHT) for end in ("median", "worst"))
    )
    if worst:
        ends = dict.fromkeys(f"{end:.1f}" for end in (min(medians), max(medians)))
        lost = sum(int(cell["lost"]) for cell in cells)
        of = f", of those that are not lost, {lost} are" if lost else ""
        yield f"rotation error in the median {' to '.join(ends)}°, at most {max(worst):.1f}°{of}"
    for column in columns:
        values = [cell[column] for cell in cells if cell[column] is not None]
        if values and not column.startswith("rotation_error_deg"):
            yield f"{column.replace('_', ' ')} {_value(column, max(values))}"


def _value(column: str, value: float) -> str:
    if value == math.inf:
        return "lost"
    unit = next((unit for name, unit in UNITS.items() if column.startswith(name)), "")
    return f"{value:.{1 if unit == '°' else 3}f}{unit}" if unit else f"{value:g}"

"""Judgements of claims by results of flights, sweeps and studies: the measurement and the verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

from experiments.battery import PAPER_FUEL
from experiments.flight import PAPER_RUNS
from experiments.report.findings import (
    AGREES,
    Judged,
    Kind,
    Verdict,
    differs,
    judge,
    judge_range,
    out_of_reach,
)
from experiments.report.measures.flight import FINAL
from experiments.report.measures.standing import Ground
from experiments.report.results import Results, count

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
"""Least share of a flight's perturbed repetitions that complete for the flight to count as flown."""

LEANING = 45.0
"""Rotation error beyond which a completed flight does not count as balanced [deg]."""

ARMS = {"corrected": "", "published": "_published"}
"""Suffixes of the names of flights, by lever arms."""

STANDING = ("balancing_front_as_flown", "balancing_lateral_as_flown")
"""The ground experiments of Fig. 6."""

MOTION_BANDS = {"[mm]": 20.0, "[deg]": 1.0, "[N m]": 1.5, "[s]": 1.0}
"""Differences of the simulated experiment from the robot's, by unit; equal experiments moved the robot by 31 and 51 mm,
and its legs by 1.3 N m apart."""

VISIBLE_SHIFT = 2e-3
"""Displacement of the CoM below which it counts as not moved [m]."""


Judge: TypeAlias = Callable[[Results], Judged]
"""Function from results to the measurement and the verdict."""


def _ground_experiments(results: Results) -> tuple[Ground, Ground]:
    front, lateral = map(results.ground_experiment, STANDING)
    return front, lateral


def _agreement(corrected: bool, published: bool) -> Verdict:
    if corrected and published:
        return AGREES
    if published:
        return AGREES.but(" with published lever arms, differs with corrected ones: it does not hold there")
    if corrected:
        return AGREES.but(" with corrected lever arms, differs with published ones: it does not hold there")
    return differs("it does not hold")


def _pair(results: Results, test: str) -> tuple[str, list[Mapping[str, float]]]:
    """Return outcomes of a test with corrected and published lever arms, and its perturbed flights that complete."""
    cells = results.sweep("paper_tests")
    name = test.upper() if test.startswith("test") else test
    texts, shares = [], []
    for arms, end in ARMS.items():
        found, share = results.flight(test + end), cells.cell(test=f"{name}, {arms} arms")
        texts.append(
            f"{arms} arms: {found.ending}, rotation error {found.rotation_error:.1f}°, "
            f"CoM error {100 * found.com_error:.0f} cm, perturbed {count(share)} complete"
        )
        shares.append(share)
    return "; ".join(texts), shares


def _is_mostly_complete(share: Mapping[str, float]) -> bool:
    """Return whether a flight and its repetitions complete: at least `MOSTLY`, and with confidence more than 80 %."""
    return share["completed"] >= MOSTLY * share["flights"] and share["completed_low"] > 0.8


def _explain_undecided(shares: Sequence[Mapping[str, float]]) -> str:
    """Return for which lever arms more flights could change a verdict on completion; empty if for none."""
    pairs = zip(ARMS, shares, strict=True)
    arms = [arms for arms, share in pairs if share["completed_low"] < MOSTLY < share["completed_high"]]
    inside = f"{100 * MOSTLY:.0f} % is within the interval"
    return f"; with {' and '.join(arms)} lever arms not decided: {inside}" if arms else ""


def fall(results: Results, *, test: str) -> Judged:
    """Judge a test that must fall: surely less than half of its repetitions complete."""
    text, (right, published) = _pair(results, test)
    return text, _agreement(right["completed_high"] < 0.5, published["completed_high"] < 0.5)


def flight(results: Results, *, test: str) -> Judged:
    """Judge a test that must be flown."""
    text, shares = _pair(results, test)
    return text, _agreement(*map(_is_mostly_complete, shares)).but(_explain_undecided(shares))


def joint_errors(results: Results) -> Judged:
    """Judge the sums of joint errors of TEST2, and of TEST1 until it falls."""
    aware, baseline = results.flight("test2"), results.flight("test1_published")
    bounded = aware.joint_error_at_end < 0.2 * aware.joint_error_max
    grows = baseline.joint_error_at_end > 0.5 * baseline.joint_error_max
    text = (
        f"TEST2: sum over all joints at most {aware.joint_error_max:.0f}°, {aware.joint_error_at_end:.0f}° in the last "
        f"{FINAL:g} s; TEST1, published arms: at most {baseline.joint_error_max:.0f}°, "
        f"{baseline.joint_error_at_end:.0f}° over the {FINAL:g} s before the fall"
    )
    return text, judge(bounded and grows)


def force_alignment(results: Results) -> Judged:
    """Judge the angle between total force and relative wind."""
    median, greatest = results.flight("test2").force_angle
    text = f"TEST2: angle between total force and relative wind {median:.1f}° in the median, {greatest:.1f}° at most"
    return text, judge(median < 15.0)


def asymmetry(results: Results) -> Judged:
    """Judge how much more left and right thrusts differ with side wind than without."""
    wind, still = results.flight("test2"), results.flight("no_wind")
    text = (
        f"left and right differ by up to {wind.asymmetry[0]:.1f} N (arms) and {wind.asymmetry[1]:.1f} N (chest) "
        f"in the side wind, by {still.asymmetry[0]:.1f} N and {still.asymmetry[1]:.1f} N without wind"
    )
    return text, judge(max(wind.asymmetry) > 1.5 * max(still.asymmetry))


def robustness(results: Results) -> Judged:
    """Judge the flight whose controller has a simpler model than the simulator."""
    text, shares = _pair(results, "robustness")
    verdict = _agreement(*map(_is_mostly_complete, shares))
    leaning = max(results.flight(f"robustness{end}").rotation_error for end in ARMS.values())
    if verdict.kind is not Kind.DIFFERS and leaning > LEANING:
        verdict = verdict.but(f", but the robot leans by up to {leaning:.0f}°")
    return text, verdict.but(_explain_undecided(shares))


def model_pairs(results: Results) -> Judged:
    """Count the winds flown on course with the simulator's model, another, none, and none but an observer."""
    sweep = results.sweep("model_pairs")
    worlds = sweep.levels("world")
    texts, shares = [], []
    for arms in sweep.levels("arms"):
        cells = sweep.select(arms=arms)
        kinds = {
            "the simulator's model": [cell for cell in cells if cell["model"] == cell["world"]],
            "another model": [cell for cell in cells if cell["model"] in worlds and cell["model"] != cell["world"]],
            "no model": [cell for cell in cells if cell["model"] == "none"],
            "no model, observer": [cell for cell in cells if cell["model"] == "observer, no model"],
        }
        counts = {name: (sum(c["on_course"] for c in own), len(own)) for name, own in kinds.items()}
        texts.append(f"{arms}, on course: " + ", ".join(f"{name} {n} of {m}" for name, (n, m) in counts.items()))
        shares.append(counts["another model"][0] / counts["another model"][1])
    return "; ".join(texts), _agreement(*(share > 0.9 for share in shares))


def transitions(results: Results) -> Judged:
    """Judge when the models of simulator and controller differ most."""
    texts, times = [], []
    for arms, end in ARMS.items():
        run = results.flight(f"robustness{end}")
        texts.append(f"{arms} arms: {run.force_difference:.1f} N of {run.force:.1f} N, at {run.difference_time:.0f} s")
        times.append(run.difference_time)
    verdict = _agreement(*(time >= 20.0 for time in times))
    if verdict == AGREES and min(times) < 35.0:
        late = _agreement(*(time >= 35.0 for time in times))
        verdict = verdict.but(f' on transitions; "from 35 s on" {late}')
    return "greatest difference, " + "; ".join(texts), verdict


def thrust_difference(results: Results) -> Judged:
    """Judge the range of thrusts with two models in the simulator."""
    axisymmetric, network = (results.flight(name).thrust for name in ("test2", "test4"))
    text = (
        f"TEST2 {axisymmetric[0]:.1f} to {axisymmetric[1]:.1f} N, TEST4 {network[0]:.1f} to {network[1]:.1f} N; "
        "corrected arms"
    )
    apart = max(abs(one - other) for one, other in zip(axisymmetric, network, strict=True))
    return text, judge(apart < 10.0)


def lambda_term(results: Results) -> Judged:
    """Judge the ablation of the change of aerodynamic forces."""
    cells = results.sweep("ablation_terms")
    texts, same = [], []
    for world in (RIGHT, HEAD, PUBLISHED):
        whole, without = (cells.cell(world=world, feedback=level) for level in ("everything", "without Λ_a"))
        texts.append(
            f"{world}: {whole['rotation_error_deg_median']:.1f}° with, "
            f"{without['rotation_error_deg_median']:.1f}° without"
        )
        same.append(abs(whole["rotation_error_deg_median"] - without["rotation_error_deg_median"]) < 1.0)
    return "median rotation error " + "; ".join(texts), judge(all(same), "not in every world")


def minimum(results: Results) -> Judged:
    """Answer which aerodynamic information suffices; the paper's own answer is not known."""
    return answer(results), out_of_reach("the paper's own ablation is not public to us; this answer is ours")


def answer(results: Results) -> str:
    """Return the least aerodynamic information with which the robot still flies, from the ablation of terms.

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
        return ", ".join(format(cells.cell(world=w, feedback=level)[f"{quantity}_median"], form) for w in worlds)

    completes, stays = equal_feedbacks("completed"), equal_feedbacks("on_course")
    least = next((name for name in LEAST_FIRST if name in stays), "nothing short of everything")
    moment, force = "total moment only", "total force only"
    return (
        f"The least that stays on course as often as with everything, in every world: **{least}**. "
        f"As good in staying on course: {', '.join(stays)}. As good in completing: {', '.join(completes)}. "
        f"With the moment alone the median rotation error is {tabulate(moment, 'rotation_error_deg', '.0f')}° and the "
        f"median CoM error {tabulate(moment, 'com_error', '.2f')} m, world by world; with the force alone "
        f"{tabulate(force, 'rotation_error_deg', '.0f')}° and {tabulate(force, 'com_error', '.2f')} m."
    )


def balance(results: Results) -> Judged:
    """Judge whether the robot stands to the end."""
    runs = _ground_experiments(results)
    text = "; ".join(
        f"{run.name}: {run.ending}, feet carry {'' if run.always_carried else 'not '}all the time" for run in runs
    )
    return text, judge(all(run.completed and run.always_carried for run in runs))


def motion_against_wind(results: Results) -> Judged:
    """Judge the direction in which the CoM moves."""
    runs, axes = _ground_experiments(results), (0, 1)
    text = "; ".join(
        f"{run.name}: CoM {1e3 * run.shift[axis]:+.1f} mm along {'xy'[axis]}, force {run.force[axis]:+.1f} N, "
        f"off the axis {1e3 * run.shift[1 - axis]:+.1f} mm"
        for run, axis in zip(runs, axes, strict=True)
    )
    opposed = (
        run.shift[axis] * run.force[axis] < 0.0
        and abs(run.shift[axis]) > max(VISIBLE_SHIFT, 5.0 * abs(run.shift[1 - axis]))
        for run, axis in zip(runs, axes, strict=True)
    )
    return text, judge(all(opposed))


def ankle_pitch(results: Results) -> Judged:
    """Judge which joint of the leg moves most in frontal wind."""
    front, _ = _ground_experiments(results)
    first = max(front.left_leg, key=lambda joint: abs(front.left_leg[joint]))
    return _leg(front), judge(first == "ankle_pitch")


def roll_joints(results: Results) -> Judged:
    """Judge which joints of the leg move most in lateral wind."""
    _, lateral = _ground_experiments(results)
    order = sorted(lateral.left_leg, key=lambda joint: -abs(lateral.left_leg[joint]))
    return _leg(lateral), judge(set(order[:2]) == {"hip_roll", "ankle_roll"})


def _leg(run: Ground) -> str:
    return "left leg: " + ", ".join(f"{joint.replace('_', ' ')} {way:+.2f}°" for joint, way in run.left_leg.items())


def momentum_rate(results: Results) -> Judged:
    """Judge the fall of the estimated momentum rate."""
    runs = _ground_experiments(results)
    text = "; ".join(
        f"{run.name}: estimated rate {run.rate_peak:.1f} N at its peak, {run.rate_end:.1f} N at the end, "
        f"under {abs(run.force).max():.1f} N of assumed force"
        for run in runs
    )
    shares = [run.rate_end / abs(run.force).max() for run in runs]
    falls = all(run.rate_end < run.rate_peak for run in runs)
    how = "it falls, but not to zero: friction holds the rest" if falls else "it does not fall"
    return text, judge(falls and max(shares) < 0.01, how)


def identities(results: Results) -> Judged:
    """Judge the balance of forces in the momentum rate, and of the vertical forces."""
    runs = _ground_experiments(results)
    text = "; ".join(
        f"{run.name}: rate less its terms at most {run.identity:.0e} N; vertical f_c* less the weight "
        f"{run.vertical[0]:+.2f} N, with the assumed lift {run.vertical[1]:+.2f} N"
        for run in runs
    )
    exact = all(run.identity < 1e-9 and abs(run.vertical[1]) < 0.5 for run in runs)
    return text, judge(exact)


def onset(results: Results) -> Judged:
    """Judge when the CoM begins to move."""
    runs = _ground_experiments(results)
    text = "; ".join(f"{run.name}: CoM has moved 1 mm after {run.onset:.1f} s" for run in runs)
    near = all(abs(run.onset - 2.0) < 1.0 for run in runs)
    return text, judge(near, "not when the real robot does")


def mission_fuel(results: Results) -> Judged:
    """Judge the fuel of five minutes at the mean rate of a flight."""
    flown = results.study("along", "flights")["no_wind"]
    mass = flown["five_minutes_kg"]
    text = f"{mass:.2f} kg at the mean rate of the mission without wind ({flown['fuel_l']:.2f} l in 50 s)"
    return text, judge(
        abs(mass - PAPER_FUEL) < 0.25, f"{mass - PAPER_FUEL:+.2f} kg; the engines burn more, and idle counts"
    )


def arm_engines(results: Results) -> Judged:
    """Judge whether flights end alike with either engine in the arms."""
    found = results.study("arm_engines", "paper")
    weak = {name.removesuffix(" P100"): cell for name, cell in found.items() if name.endswith("P100")}
    text = "with P100 in the arms: " + "; ".join(
        f"{name} {cell['outcome'].replace('_', ' ')}, arms up to {cell['arm_thrust_max']:.0f} N, "
        f"rotation error {cell['rotation_error']:.1f}° ({found[f'{name} P160']['rotation_error']:.1f}° with P160)"
        for name, cell in weak.items()
    )
    same = all(cell["outcome"] == found[f"{name} P160"]["outcome"] for name, cell in weak.items())
    return text, judge(same, "not every flight ends alike")


def clearance(results: Results) -> Judged:
    """Judge the least distance of the exhausts from the body."""
    found = {name: figures["clearance_mm"] for name, figures in results.study("along", "flights").items()}
    text = "exhaust's axis to the nearest link, at least: " + ", ".join(f"{n} {mm:.0f} mm" for n, mm in found.items())
    hit = [name for name in PAPER_RUNS if found[name] <= 0.0]
    how = f"an exhaust meets the body in {', '.join(hit)}"
    flown = len(PAPER_RUNS) - len(hit)
    in_part = AGREES.but(f" in {flown} of the paper's {len(PAPER_RUNS)} flights; {how}")
    return text, judge(not hit, how) if not hit or not flown else in_part


def recorded_commands(results: Results) -> Judged:
    """Judge the commands that follow from the standing robot's measurements by the recorded ones."""
    runs = {name: results.study("standing", name) for name in ("front", "lateral")}

    def greatest(variant: str, figure: str) -> float:
        return float(max(run[f"{variant}: desired {figure}"] for run in runs.values()))

    figures = {"torques, rms [N m]": "N m", "foot forces, rms [N]": "N"}
    flown, right = (
        [f"{greatest(variant, figure):.2f} {unit}" for figure, unit in figures.items()]
        for variant in ("as flown", "right")
    )
    text = f"rms at most {flown[0]} and {flown[1]} with the air as flown, {right[0]} and {right[1]} with the right one"
    agrees = greatest("as flown", "torques, rms [N m]") <= 0.5 and greatest("as flown", "foot forces, rms [N]") <= 0.1
    return text, judge(agrees, "more than 0.5 N m or 0.1 N")


def recorded_motion(results: Results) -> Judged:
    """Judge motion and torques of the simulated experiment by those of the robot."""
    texts, wrong = [], []
    for name in ("front", "lateral"):
        found = results.study("standing", name)
        figures = [key.removeprefix("recorded: ") for key in found if key.startswith("recorded: ")]
        pairs = {figure: (found[f"simulated: {figure}"], found[f"recorded: {figure}"]) for figure in figures}
        texts += [f"{name}: " + ", ".join(f"{key} {ours:.1f} ({robot:.1f})" for key, (ours, robot) in pairs.items())]
        bands = {figure: MOTION_BANDS[figure[figure.rindex("[") :]] for figure in figures}
        wrong += [f"{name}: {key}" for key, (ours, robot) in pairs.items() if not abs(ours - robot) <= bands[key]]
    return "simulated (recorded): " + "; ".join(texts), judge(not wrong, "beyond its band: " + ", ".join(wrong))


def pressure_share(results: Results) -> Judged:
    """Judge the share of the pressure in the force on the robot."""
    share = 100.0 * results.study("cfd_flow", "flight30")["pressure share of the force"]
    return f"{share:.1f} % of the force, by an open solver around primitives", judge_range(share, 94.0, 96.0, "points")


def wake_viscosity(results: Results) -> Judged:
    """Judge the turbulent viscosity in the wake."""
    found = results.study("cfd_flow", "flight30")
    greatest = found["turbulent over molecular viscosity, largest in the plane"]
    part = 100.0 * found["part of the wake in the plane where that is above 100"]
    text = (
        f"at most {greatest:.0f} in the plane of symmetry, above 100 in {part:.0f} % of the area there in which the "
        "air is slower than half the wind"
    )
    return text, judge(part > 99.0, f"not in {100.0 - part:.0f} % of it")


def wake_meshes(results: Results) -> Judged:
    """Judge the change of the wake between the meshes."""
    meshes = [results.study("cfd_flow", name) for name in ("flight30_coarse", "flight30", "flight30_fine")]
    cells = ", ".join(f"{1e-3 * mesh['cells']:.0f}" for mesh in meshes)
    areas = [mesh["wake in the plane, slower than half the wind [m2]"] for mesh in meshes]
    text = (
        f"meshes of ours, of {cells} thousand cells: in the plane of symmetry the air is slower than half the wind in "
        f"{', '.join(f'{area:.2f}' for area in areas)} m²"
    )
    change = areas[1] / areas[2] - 1.0
    return text, judge(abs(change) < 0.1, f"{100.0 * change:+.0f} % from the finest to that of the recipe")


def wind_estimate(results: Results) -> Judged:
    """Judge the wind estimated from the wrench."""
    found = results.study("wind_observer", "turbulence")
    worlds: dict[str, list[Mapping[str, float]]] = {}
    for name, figures in found.items():
        worlds.setdefault(name.rpartition(", ")[0], []).append(figures)
    speeds = [name.rpartition(", ")[2].removesuffix(" m/s") for name in found]
    texts, bad = [], []
    for world, cells in worlds.items():
        rms, inside = ([cell[key] for cell in cells] for key in ("rms", "inside"))
        shown = f"{min(rms):.2f} to {max(rms):.2f} m/s rms, {100 * min(inside):.0f} to {100 * max(inside):.0f} % inside"
        texts.append(f"{world}: {shown}")
        wrong = {
            f"up to {max(rms):.1f} m/s": max(rms) > 1.5,
            "interval too wide": max(inside) > 0.95,
            "interval too narrow": min(inside) < 0.85,
        }
        bad += [f"{world}: {how}" for how, holds in wrong.items() if holds]
    return f"{speeds[0]} to {speeds[-1]} m/s; " + "; ".join(texts), judge(not bad, ", ".join(bad))

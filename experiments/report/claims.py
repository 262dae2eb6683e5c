"""Claims of the paper and of this project, with our measurements and verdicts. Verdicts are computed, not written.

A claim without a measurement names the command that makes it. `docs/claims.json` stores earlier measurements for
the documentation's page of the paper.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from experiments import Refused
from experiments.report import facts, observer
from experiments.report.engines import PAPER_FUEL
from experiments.report.ground import Ground
from experiments.report.metrics import FINAL
from experiments.report.results import NotFlownError, Results, count
from experiments.report.verdicts import (
    AGREES,
    ANOTHER,
    NOT_FLOWN,
    OUTDATED,
    explain_absence,
    explain_difference,
    judge,
    judge_range,
)
from jax_aero import places

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

STANDING = ("balancing_front", "balancing_lateral")
"""The ground experiments of Fig. 6."""

VISIBLE_SHIFT = 2e-3
"""Displacement of the CoM below which it counts as not moved [m]."""


@dataclass(frozen=True)
class Claim:
    """One claim with its verdict."""

    key: str
    where: str
    claim: str
    measured: str
    verdict: str
    command: str
    """Command that makes the measurement; empty if committed files suffice."""
    figure: str
    """Name of the figure of `paper_figs` that shows it, or empty."""
    commit: str | None = None
    """Commit at which the latest of the results used was made; `None` if only files are used."""


def all_claims(results: Results) -> list[Claim]:
    """Return every claim, in the paper's order."""
    return [_judge_claim(claim, results) for claim in CLAIMS]


Judge: TypeAlias = Callable[[Results], tuple[str, str]]
"""Function from results to the measurement and a verdict, both as text."""


@dataclass(frozen=True)
class _Claim:
    key: str
    where: str
    claim: str
    judge: Judge
    flights: tuple[str, ...] = ()
    sweep: str = ""
    figure: str = ""
    """Figure of `paper_figs`; if empty, that of the first sweep."""
    study: str = ""

    @property
    def command(self) -> str:
        """Return the command that makes the measurement."""
        commands = (
            " ".join(("fly", *self.flights)) if self.flights else "",
            f"sweep {self.sweep}" if self.sweep else "",
            self.study,
        )
        return "; ".join(f"jax-aero {command}" for command in commands if command)


def _fact(key: str, where: str, claim: str, judge: Callable[[], tuple[str, str]], figure: str = "") -> _Claim:
    return _Claim(key, where, claim, lambda _: judge(), figure=figure)


def _ground(key: str, where: str, claim: str, judge: Judge) -> _Claim:
    return _Claim(key, where, claim, judge, STANDING, figure="fig6")


def _own_claim(key: str, claim: str, judge: Judge, *, sweep: str = "", study: str = "") -> _Claim:
    """Return a claim of ours about the recommended controller, which the paper does not contain."""
    return _Claim(key, "ours", claim, judge, sweep=sweep, study=study)


def _judge_claim(claim: _Claim, results: Results) -> Claim:
    results.made.clear()
    try:
        measured, verdict = claim.judge(results)
    except NotFlownError as reason:
        measured, verdict = str(reason), NOT_FLOWN
    except Refused:
        raise
    except (AttributeError, LookupError, TypeError, ValueError) as reason:  # a result of an older configuration or code
        if not claim.command:
            raise
        what = f"has no {reason}" if isinstance(reason, KeyError) else f"does not fit ({reason})"
        measured, verdict = f"a result {what}; make it again with --overwrite: `{claim.command}`", NOT_FLOWN
    else:
        if differs := [f"{name} ({made.differs})" for name, made in results.made.items() if made.differs]:
            measured = f"{measured}; {ANOTHER}: {', '.join(differs)}"
            verdict = f"{OUTDATED}: {verdict}"
    figure = claim.figure or claim.sweep.partition(" ")[0]
    commits = {made.created: made.commit for made in results.made.values() if made.created and made.commit}
    commit = commits[max(commits)] if commits else None
    return Claim(claim.key, claim.where, claim.claim, measured, verdict, claim.command, figure, commit)


def _ground_experiments(results: Results) -> tuple[Ground, Ground]:
    front, lateral = map(results.ground_experiment, STANDING)
    return front, lateral


def _agreement(corrected: bool, published: bool) -> str:
    if corrected and published:
        return AGREES
    if published:
        return f"{AGREES} with published lever arms, differs with corrected ones: it does not hold there"
    if corrected:
        return f"{AGREES} with corrected lever arms, differs with published ones: it does not hold there"
    return explain_difference("it does not hold")


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


def _judge_fall(test: str) -> Judge:
    def judge(results: Results) -> tuple[str, str]:
        text, (right, published) = _pair(results, test)
        return text, _agreement(right["completed_high"] < 0.5, published["completed_high"] < 0.5)

    return judge


def _judge_flight(test: str) -> Judge:
    def judge(results: Results) -> tuple[str, str]:
        text, shares = _pair(results, test)
        return text, _agreement(*map(_is_mostly_complete, shares)) + _explain_undecided(shares)

    return judge


def _joint_errors(results: Results) -> tuple[str, str]:
    aware, baseline = results.flight("test2"), results.flight("test1_published")
    bounded = aware.joint_error_at_end < 0.2 * aware.joint_error_max
    grows = baseline.joint_error_at_end > 0.5 * baseline.joint_error_max
    text = (
        f"TEST2: sum over all joints at most {aware.joint_error_max:.0f}°, {aware.joint_error_at_end:.0f}° in the last "
        f"{FINAL:g} s; TEST1, published arms: at most {baseline.joint_error_max:.0f}°, "
        f"{baseline.joint_error_at_end:.0f}° over the {FINAL:g} s before the fall"
    )
    return text, judge(bounded and grows)


def _force_alignment(results: Results) -> tuple[str, str]:
    median, greatest = results.flight("test2").force_angle
    text = f"TEST2: angle between total force and relative wind {median:.1f}° in the median, {greatest:.1f}° at most"
    return text, judge(median < 15.0)


def _asymmetry(results: Results) -> tuple[str, str]:
    wind, still = results.flight("test2"), results.flight("no_wind")
    text = (
        f"left and right differ by up to {wind.asymmetry[0]:.1f} N (arms) and {wind.asymmetry[1]:.1f} N (chest) "
        f"in the side wind, by {still.asymmetry[0]:.1f} N and {still.asymmetry[1]:.1f} N without wind"
    )
    return text, judge(max(wind.asymmetry) > 1.5 * max(still.asymmetry))


def _robustness(results: Results) -> tuple[str, str]:
    text, shares = _pair(results, "robustness")
    verdict = _agreement(*map(_is_mostly_complete, shares))
    leaning = max(results.flight(f"robustness{end}").rotation_error for end in ARMS.values())
    if verdict.startswith(AGREES) and leaning > LEANING:
        verdict += f", but the robot leans by up to {leaning:.0f}°"
    return text, verdict + _explain_undecided(shares)


def _model_pairs(results: Results) -> tuple[str, str]:
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


def _transitions(results: Results) -> tuple[str, str]:
    texts, times = [], []
    for arms, end in ARMS.items():
        run = results.flight(f"robustness{end}")
        texts.append(f"{arms} arms: {run.force_difference:.1f} N of {run.force:.1f} N, at {run.difference_time:.0f} s")
        times.append(run.difference_time)
    verdict = _agreement(*(time >= 20.0 for time in times))
    if verdict == AGREES and min(times) < 35.0:
        late = _agreement(*(time >= 35.0 for time in times))
        verdict = f'{AGREES} on transitions; "from 35 s on" {late}'
    return "greatest difference, " + "; ".join(texts), verdict


def _thrust_difference(results: Results) -> tuple[str, str]:
    axisymmetric, network = (results.flight(name).thrust for name in ("test2", "test4"))
    text = (
        f"TEST2 {axisymmetric[0]:.1f} to {axisymmetric[1]:.1f} N, TEST4 {network[0]:.1f} to {network[1]:.1f} N; "
        "corrected arms"
    )
    apart = max(abs(one - other) for one, other in zip(axisymmetric, network, strict=True))
    return text, judge(apart < 10.0)


def _lambda(results: Results) -> tuple[str, str]:
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


def _minimum(results: Results) -> tuple[str, str]:
    return answer(results), explain_absence("the paper's own ablation is not public to us; this answer is ours")


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


def _balance(results: Results) -> tuple[str, str]:
    runs = _ground_experiments(results)
    text = "; ".join(
        f"{run.name}: {run.ending}, feet carry {'' if run.always_carried else 'not '}all the time" for run in runs
    )
    return text, judge(all(run.completed and run.always_carried for run in runs))


def _motion_against_wind(results: Results) -> tuple[str, str]:
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


def _ankle_pitch(results: Results) -> tuple[str, str]:
    front, _ = _ground_experiments(results)
    first = max(front.left_leg, key=lambda joint: abs(front.left_leg[joint]))
    return _leg(front), judge(first == "ankle_pitch")


def _roll_joints(results: Results) -> tuple[str, str]:
    _, lateral = _ground_experiments(results)
    order = sorted(lateral.left_leg, key=lambda joint: -abs(lateral.left_leg[joint]))
    return _leg(lateral), judge(set(order[:2]) == {"hip_roll", "ankle_roll"})


def _leg(run: Ground) -> str:
    return "left leg: " + ", ".join(f"{joint.replace('_', ' ')} {way:+.2f}°" for joint, way in run.left_leg.items())


def _momentum_rate(results: Results) -> tuple[str, str]:
    runs = _ground_experiments(results)
    text = "; ".join(
        f"{run.name}: estimated rate {run.rate_peak:.1f} N at its peak, {run.rate_end:.1f} N at the end, "
        f"under {abs(run.force).max():.1f} N of assumed force"
        for run in runs
    )
    shares = [run.rate_end / abs(run.force).max() for run in runs]
    falls = max(shares) < 0.25 and all(run.rate_end < run.rate_peak for run in runs)
    how = "it falls, but not to zero: the CoM error holds it" if falls else "it does not fall"
    return text, judge(falls and max(shares) < 0.01, how)


def _identities(results: Results) -> tuple[str, str]:
    runs = _ground_experiments(results)
    text = "; ".join(
        f"{run.name}: rate less its terms at most {run.identity:.0e} N; vertical f_c* less the weight "
        f"{run.vertical[0]:+.2f} N, with the assumed lift {run.vertical[1]:+.2f} N"
        for run in runs
    )
    exact = all(run.identity < 1e-9 and abs(run.vertical[1]) < 0.5 for run in runs)
    return text, judge(exact)


def _onset(results: Results) -> tuple[str, str]:
    runs = _ground_experiments(results)
    text = "; ".join(f"{run.name}: CoM has moved 1 mm after {run.onset:.1f} s" for run in runs)
    near = all(abs(run.onset - 2.0) < 1.0 for run in runs)
    return text, judge(near, "not when the real robot does: our drives are chosen, not measured")


def _mission_fuel(results: Results) -> tuple[str, str]:
    flown = results.study("along", "flights")["no_wind"]
    mass = flown["five_minutes_kg"]
    text = f"{mass:.2f} kg at the mean rate of the mission without wind ({flown['fuel_l']:.2f} l in 50 s)"
    return text, judge(
        abs(mass - PAPER_FUEL) < 0.25, f"{mass - PAPER_FUEL:+.2f} kg; the engines burn more, and idle counts"
    )


def _arm_engines(results: Results) -> tuple[str, str]:
    found = results.study("arm_engines", "paper")
    weak = {name.removesuffix(" P100"): cell for name, cell in found.items() if name.endswith("P100")}
    text = "with P100 in the arms: " + "; ".join(
        f"{name} {cell['outcome'].replace('_', ' ')}, arms up to {cell['arm_thrust_max']:.0f} N, "
        f"rotation error {cell['rotation_error']:.1f}° ({found[f'{name} P160']['rotation_error']:.1f}° with P160)"
        for name, cell in weak.items()
    )
    same = all(cell["outcome"] == found[f"{name} P160"]["outcome"] for name, cell in weak.items())
    return text, judge(same, "not every flight ends alike")


def _clearance(results: Results) -> tuple[str, str]:
    found = {name: figures["clearance_mm"] for name, figures in results.study("along", "flights").items()}
    text = "exhaust's axis to the nearest link, at least: " + ", ".join(f"{n} {mm:.0f} mm" for n, mm in found.items())
    aware = {name: found[name] for name in ("test2", "test2_published", "test4")}
    if min(found.values()) > 0.0:
        return text, AGREES
    hit = ", ".join(name for name, distance in found.items() if distance <= 0.0)
    kept = f"{AGREES} with an aware controller; " if min(aware.values()) > 0.0 else ""
    return text, kept + explain_difference(f"an exhaust meets the body in {hit}")


def _pressure_share(results: Results) -> tuple[str, str]:
    share = 100.0 * results.study("cfd_flow", "flight30")["pressure share of the force"]
    return f"{share:.1f} % of the force, by an open solver around primitives", judge_range(share, 94.0, 96.0, "points")


def _wake_viscosity(results: Results) -> tuple[str, str]:
    found = results.study("cfd_flow", "flight30")
    greatest = found["turbulent over molecular viscosity, largest in the plane"]
    part = 100.0 * found["part of the wake in the plane where that is above 100"]
    text = (
        f"at most {greatest:.0f} in the plane of symmetry, above 100 in {part:.0f} % of the area there in which the "
        "air is slower than half the wind"
    )
    return text, judge(part > 99.0, f"not in {100.0 - part:.0f} % of it")


def _wake_meshes(results: Results) -> tuple[str, str]:
    meshes = [results.study("cfd_flow", name) for name in ("flight30_coarse", "flight30", "flight30_fine")]
    cells = ", ".join(f"{1e-3 * mesh['cells']:.0f}" for mesh in meshes)
    areas = [mesh["wake in the plane, slower than half the wind [m2]"] for mesh in meshes]
    text = (
        f"meshes of ours, of {cells} thousand cells: in the plane of symmetry the air is slower than half the wind in "
        f"{', '.join(f'{area:.2f}' for area in areas)} m²"
    )
    change = areas[1] / areas[2] - 1.0
    return text, judge(abs(change) < 0.1, f"{100.0 * change:+.0f} % from the finest to that of the recipe")


_TESTS = "paper_tests"
_ROBUSTNESS = ("robustness", "robustness_published")

WRITTEN = (
    _fact("mass", "Mechanical design", "The robot's mass is 43.3 kg", facts.mass),
    _fact("added_mass", "Mechanical design", "10.3 kg more than iCub v2.7", facts.added_mass),
    _fact("battery", "Actuators selection", "Five minutes of a 40 kg robot need 26.31 kg of battery", facts.battery),
    _fact("fuel", "Actuators selection", "Five minutes of a 40 kg robot need 4.61 kg of fuel", facts.fuel),
    _Claim(
        "fuel_flown",
        "Actuators selection",
        "Five minutes need 4.61 kg of fuel: the same from a flight",
        _mission_fuel,
        ("no_wind",),
        figure="along",
        study="study along",
    ),
    _Claim(
        "clearance",
        "Discussion, Suppl. Note 6",
        "In flight the jets stay as far as possible from the robot's surfaces",
        _clearance,
        ("test2", "test2_published", "test4", "robustness", "test1", "test1_published"),
        figure="along",
        study="study along",
    ),
    _fact("chest_engine", "Actuators selection", "P220-RXi: about 22 kg of thrust for 0.6 l/min", facts.chest_engine),
    _fact("lift", "Number of jet engines", "A 40 kg robot needs at least two P220", facts.lift),
    _fact("arm_engine", "Number of jet engines", "The forearms carry P100", facts.arm_engine),
    _Claim(
        "arm_engines",
        "Number of jet engines",
        "P100 and the more powerful P160 can be exchanged",
        _arm_engines,
        study="study arm_engines",
    ),
    _fact("stress", "FEM analysis", "At most 57 MPa (jetpack) and 77 MPa (forearm)", facts.stress),
    _fact("strength", "FEM analysis", "At least 5 times below the strength of Ergal, the weakest", facts.strength),
    _fact("campaign", "Wind tunnel", "400 measurements, 54 tests, 4 symmetric and 15 other postures", facts.campaign),
    _fact("ranges", "Experiment setup", "Hovering β −90° to 90°, flight α 25° to 65°", facts.ranges, "fig2"),
    _fact("blockage", "Wind tunnel facility", "Blockage at most 3 % of 4 m × 3.84 m", facts.blockage),
    _fact("reynolds", "Suppl. Note 1", "The Reynolds number is high", facts.reynolds),
    _fact("mach", "Suppl. Note 1", "The Mach number is negligible", facts.mach),
    _fact("boundary", "CFD", "k = 2.89e-6 m²/s², ε = 0.0236e-6 m²/s³, ω = 8.17 1/s at the boundary", facts.boundary),
    _Claim(
        "pressure_share",
        "CFD",
        "About 95 % of the drag is pressure",
        _pressure_share,
        figure="cfd_flow",
        study="cfd flow flight30",
    ),
    _Claim(
        "wake_viscosity",
        "Fig. 3 e, f",
        "In the whole wake the turbulent viscosity is more than 100 times the molecular one",
        _wake_viscosity,
        figure="cfd_flow",
        study="cfd flow flight30",
    ),
    _Claim(
        "wake_meshes",
        "Suppl. Fig. 5",
        "The wake on the chosen mesh is that on the finest",
        _wake_meshes,
        figure="cfd_meshes",
        study="cfd flow flight30_coarse flight30 flight30_fine",
    ),
    _fact("postures", "CFD", "About 8500 free-stream simulations", facts.postures),
    _fact("cells", "Mesh sensitivity", "About 97 % fewer cells than the finest mesh", facts.cells, "supp_mesh"),
    _fact("network_size", "Network", "9 inner layers of 1048 neurons, 22 inputs, 39 outputs", facts.network_size),
    _fact(
        "network_error", "Network", "An error of at most 3e-6 on the validation set", facts.network_error, "training"
    ),
    _fact(
        "order",
        "Axisymmetric model",
        "An error one order of magnitude above the network's",
        facts.order_of_magnitude,
        "fig4_fit",
    ),
    _fact("coefficients", "Suppl. Table 2", "Coefficients of the axisymmetric model", facts.misprint, "fig4_fit"),
    _Claim(
        "test1",
        "TEST1",
        "The baseline controller fails to complete the mission: the robot falls due to imbalances",
        _judge_fall("test1"),
        ("test1", "test1_published"),
        _TESTS,
        "suppl7_published",
    ),
    _Claim(
        "test2",
        "TEST2",
        "The aerodynamic-aware controller keeps balance throughout all manoeuvres",
        _judge_flight("test2"),
        ("test2", "test2_published"),
        _TESTS,
        "suppl7",
    ),
    _Claim(
        "test3",
        "TEST3",
        "With the network as simulator the baseline fails",
        _judge_fall("test3"),
        ("test3", "test3_published"),
        _TESTS,
        "suppl7_published",
    ),
    _Claim(
        "test4",
        "TEST4",
        "With the network as simulator and feedback the aware controller completes",
        _judge_flight("test4"),
        ("test4", "test4_published"),
        _TESTS,
        "fig5_robustness",
    ),
    _Claim(
        "joint_errors",
        "Suppl. Fig. 7 a, d",
        "Joint errors grow until the failure, and in successful flights stay bounded and decrease in static phases",
        _joint_errors,
        ("test2", "test1_published"),
        figure="suppl7_published",
    ),
    _Claim(
        "aligned",
        "Suppl. Fig. 7 e",
        "The axisymmetric model's total force is largely aligned with the relative wind",
        _force_alignment,
        ("test2",),
        figure="suppl7",
    ),
    _Claim(
        "asymmetry",
        "Fig. 5 f",
        "The thrusts are asymmetric because of the aerodynamic moment",
        _asymmetry,
        ("test2", "no_wind"),
        figure="fig5_robustness",
    ),
    _Claim(
        "thrusts_alike",
        "Flight simulations",
        "The thrusts are comparable, whatever the aerodynamic model of the simulation",
        _thrust_difference,
        ("test2", "test4"),
        figure="fig5_robustness",
    ),
    _Claim(
        "model_pairs",
        "Robustness",
        "The aware controller is robust to a model other than the simulator's (winds from everywhere)",
        _model_pairs,
        sweep="model_pairs",
    ),
    _Claim(
        "robustness",
        "Robustness",
        "A controller with a simpler model than the simulator's completes; errors stay bounded",
        _robustness,
        _ROBUSTNESS,
        _TESTS,
        "fig5_robustness",
    ),
    _Claim(
        "transitions",
        "Suppl. Fig. 7 j",
        "The two models differ most in the transitions, especially from 35 s",
        _transitions,
        _ROBUSTNESS,
        figure="suppl7",
    ),
    _Claim(
        "lambda",
        "Flight control design",
        "The change of aerodynamic forces with posture and speed is negligible in control",
        _lambda,
        sweep="ablation_terms",
    ),
    _ground("stands", "Fig. 6", "The standing robot keeps its balance when the measured wind does not blow", _balance),
    _ground("against", "Fig. 6 c, i", "The CoM moves against the aerodynamic force", _motion_against_wind),
    _ground("ankle_pitch", "Fig. 6 d", "In frontal wind it moves mainly by the ankle pitch joints", _ankle_pitch),
    _ground("rolls", "Fig. 6 j", "In lateral wind it moves by the hip and ankle roll joints", _roll_joints),
    _ground(
        "momentum_rate", "Ground experiments", "The motion minimises the estimated linear momentum rate", _momentum_rate
    ),
    _ground(
        "identities",
        "Ground experiments",
        "The momentum rate is the sum of foot forces, aerodynamic forces and weight; the feet carry the weight",
        _identities,
    ),
    _ground("onset", "Fig. 6 c, i", "The motion becomes visible about 2 s after the wind starts to rise", _onset),
    _Claim(
        "minimum",
        "Suppl. Fig. 17, Note 7",
        "There is a minimum of aerodynamic information with which the mission is still flown",
        _minimum,
        sweep="ablation_terms",
    ),
    _own_claim(
        "observer_corrected",
        "Without an aerodynamic model the observer flies TEST1 and TEST3 within 5° (corrected arms)",
        observer.tests("corrected", 5.0),
        sweep="observer_tests",
    ),
    _own_claim(
        "observer_published",
        "Without an aerodynamic model the observer flies TEST1 and TEST3 within 7° (published arms)",
        observer.tests("published", 7.0),
        sweep="observer_tests",
    ),
    _own_claim(
        "observer_26",
        "Winds of 26 m/s from everywhere are flown, within 12° in the median",
        observer.fast_wind,
        sweep="observer_wind",
    ),
    _own_claim("observer_40", "Winds of up to 40 m/s are flown", observer.every_wind, sweep="observer_wind"),
    _own_claim(
        "observer_errors",
        "Mass +10 %, CoM 4 cm, an arm jet -10 %: flown, within 10° in the median",
        observer.model_errors,
        sweep="observer_errors",
    ),
    _own_claim(
        "sensors",
        "With realistic sensors observer and estimator fly within 12°",
        observer.sensors,
        sweep="sensors_tests",
    ),
    _own_claim(
        "false_alarms",
        "Where nothing fails, no channel and no engine is found to fail",
        observer.false_alarms,
        sweep="observer_tests sensors_tests",
    ),
    _own_claim(
        "outages_lasting",
        "Without wind or thrust sensors for good the flight completes",
        observer.permanent_outages,
        sweep="outages_observer",
    ),
    _own_claim(
        "outages_short",
        "Without base rotation, velocity or position for 0.3 and 1 s the flight completes",
        observer.temporary_outages,
        sweep="outages_observer",
    ),
    _own_claim(
        "engines_lost",
        "Without one engine the robot flies to the ground",
        observer.lost_engines,
        sweep="engine_loss",
    ),
    _own_claim(
        "wind_estimate",
        "The wind is known to 1.5 m/s above 6 m/s, its 90 % interval covers 85 to 95 %",
        observer.wind_estimate,
        study="study wind_observer",
    ),
)
"""All claims, also those of studies whose folders are not there."""

CLAIMS = tuple(claim for claim in WRITTEN if places.has_studies(claim.command))
"""Claims that can be measured here."""

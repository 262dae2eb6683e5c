"""The paper's claims about flight, what we measured, and whether they agree. Verdicts are computed, not written.

A claim whose measurement is not there says which command makes it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from experiments import engine_choice
from experiments.report.metrics import FINAL, Metrics
from experiments.report.results import Results, Sweep, count
from jax_aero import reference

RIGHT, HEAD, PUBLISHED = (
    "right arms, 10 m/s from the side",
    "right arms, 18 m/s from ahead",
    "published arms, 10 m/s from the side",
)
"""The worlds of the ablations, as configs/sweeps/axes/worlds.toml calls them."""

LEAST_FIRST = (
    "total moment only",
    "total force only",
    "total wrench only",
    "normal force only",
    "drag only",
    "without Λ_a",
    "without J_aᵀ f_a",
)
"""Levels of the ablation of terms by how much the controller has to know."""

NETWORK = "not tested: needs the neural network, whose weights are not public and which this project does not have yet"


ITSELF = "; the claim itself needs the network"

TILTED = 45.0
"""Rotation error beyond which a flight that arrives does not count as balanced [deg]."""


@dataclass(frozen=True)
class Claim:
    """One claim with its verdict."""

    where: str
    claim: str
    measured: str
    verdict: str


class NotFlownError(Exception):
    """A measurement is missing; the message names the command."""


def all_claims(results: Results) -> list[Claim]:
    """Return every claim, in the paper's order."""
    return [_stated(claim, results) for claim in CLAIMS]


@dataclass(frozen=True)
class _Claim:
    where: str
    claim: str
    judge: Callable[[Results], tuple[str, str]]


def _stated(claim: _Claim, results: Results) -> Claim:
    try:
        measured, verdict = claim.judge(results)
    except NotFlownError as reason:
        measured, verdict = str(reason), "not measured yet"
    return Claim(claim.where, claim.claim, measured, verdict)


def _flight(results: Results, name: str) -> Metrics:
    if name not in results.flights:
        raise NotFlownError(f"`python -m experiments {name}` has not been run")
    return results.flights[name]


def _sweep(results: Results, name: str) -> Sweep:
    if name not in results.sweeps:
        raise NotFlownError(f"`python -m experiments sweep {name}` has not been run")
    return results.sweeps[name]


def _agreement(right: bool, published: bool) -> str:
    if right and published:
        return "holds"
    if published:
        return "holds with the published lever arms only"
    return "holds with right lever arms only" if right else "does not hold"


def _mass(_: Results) -> tuple[str, str]:
    mass = reference.Robot(str(engine_choice.ROBOT)).mass
    return f"{mass:.2f} kg in the model", "holds" if abs(mass - 43.3) < 0.05 else "does not hold"


def _engine_choice(_: Results) -> tuple[str, str]:
    found = engine_choice.results(engine_choice.Choice())
    text = (
        f"fuel {found['fuel_kg']:.2f} kg; battery {found['battery_kg']:.2f} kg from the printed 13 kW for 15 kg, "
        f"{found['battery_at_1_kW_per_kg_kg']:.2f} kg from 1 kW per kg"
    )
    return text, "fuel holds; the battery's figure belongs to 1 kW per kg of thrust, not to the printed 0.87"


def _baseline(results: Results) -> tuple[str, str]:
    right, published = _flight(results, "test1"), _flight(results, "test1_published")
    cells = _sweep(results, "paper_tests")
    shares = [cells.cell(test=f"TEST1, {arms} arms") for arms in ("right", "published")]
    text = (
        f"right arms: {right.ending}, rotation error {right.rotation_error:.0f}°, "
        f"perturbed {count(shares[0])} complete; "
        f"published arms: {published.ending}, perturbed {count(shares[1])} complete"
    )
    return text, _agreement(shares[0]["completed_high"] < 0.5, shares[1]["completed_high"] < 0.5)


def _aware(results: Results) -> tuple[str, str]:
    right, published = _flight(results, "test2"), _flight(results, "test2_published")
    cells = _sweep(results, "paper_tests")
    shares = [cells.cell(test=f"TEST2, {arms} arms") for arms in ("right", "published")]
    text = (
        f"right arms: {right.ending}, rotation error {right.rotation_error:.1f}°, "
        f"perturbed {count(shares[0])} complete; "
        f"published arms: {published.ending}, {published.rotation_error:.1f}°, perturbed {count(shares[1])} complete"
    )
    return text, _agreement(shares[0]["completed_low"] > 0.9, shares[1]["completed_low"] > 0.9)


def _joint_errors(results: Results) -> tuple[str, str]:
    aware, baseline = _flight(results, "test2"), _flight(results, "test1_published")
    bounded = aware.joint_error_at_end < 0.2 * aware.joint_error_max
    grows = baseline.joint_error_at_end > 0.5 * baseline.joint_error_max
    text = (
        f"TEST2: sum over all joints at most {aware.joint_error_max:.0f}°, {aware.joint_error_at_end:.0f}° in the last "
        f"{FINAL:g} s; TEST1, published arms: at most {baseline.joint_error_max:.0f}°, "
        f"{baseline.joint_error_at_end:.0f}° over the {FINAL:g} s before the fall"
    )
    return text, "holds" if bounded and grows else "does not hold"


def _aligned(results: Results) -> tuple[str, str]:
    median, greatest = _flight(results, "test2").force_angle
    text = f"TEST2: angle between total force and relative wind {median:.1f}° in the median, {greatest:.1f}° at most"
    return text, "holds" if median < 15.0 else "does not hold"


def _asymmetry(results: Results) -> tuple[str, str]:
    wind, still = _flight(results, "test2"), _flight(results, "no_wind")
    text = (
        f"left and right differ by up to {wind.asymmetry[0]:.1f} N (arms) and {wind.asymmetry[1]:.1f} N (chest) "
        f"in the side wind, by {still.asymmetry[0]:.1f} N and {still.asymmetry[1]:.1f} N without wind"
    )
    return text, "holds" if max(wind.asymmetry) > 1.5 * max(still.asymmetry) else "does not hold"


def _robustness(results: Results) -> tuple[str, str]:
    right = _flight(results, "robustness_sphere_cylinder_vs_axisymmetric")
    published = _flight(results, "robustness_axisymmetric_vs_sphere_cylinder")
    cells = _sweep(results, "ablation_models")
    shares = {world: cells.cell(world=world, model="spheres and cylinders") for world in (RIGHT, HEAD, PUBLISHED)}
    text = (
        f"with analytic models in place of the network — simulator spheres and cylinders, controller axisymmetric, "
        f"right arms: {right.ending}, rotation error {right.rotation_error:.0f}°, "
        f"CoM error {100 * right.com_error:.0f} cm; the other way round, published arms: {published.ending}, "
        f"{published.rotation_error:.0f}°; perturbed: "
        + "; ".join(f"{world}: {count(cell)} complete" for world, cell in shares.items())
    )
    flies = right.completed and published.completed and all(cell["completed_low"] > 0.5 for cell in shares.values())
    upright = max(right.rotation_error, published.rotation_error) < TILTED
    if not flies:
        return text, f"an analogue does not hold{ITSELF}"
    return text, f"an analogue {'holds' if upright else f'completes, but leans beyond {TILTED:.0f}°'}{ITSELF}"


def _transitions(results: Results) -> tuple[str, str]:
    run = _flight(results, "robustness_sphere_cylinder_vs_axisymmetric")
    greatest = f"{run.force_difference:.1f} N of {run.force:.1f} N, at {run.difference_time:.0f} s"
    text = f"analogue: greatest difference {greatest}"
    return text, f"an analogue {'holds' if run.difference_time >= 20.0 else 'does not hold'}{ITSELF}"


def _lambda(results: Results) -> tuple[str, str]:
    cells = _sweep(results, "ablation_terms")
    texts, same = [], []
    for world in (RIGHT, HEAD, PUBLISHED):
        whole, without = (cells.cell(world=world, feedback=level) for level in ("everything", "without Λ_a"))
        texts.append(
            f"{world}: {whole['rotation_error_deg_median']:.1f}° with, "
            f"{without['rotation_error_deg_median']:.1f}° without"
        )
        same.append(abs(whole["rotation_error_deg_median"] - without["rotation_error_deg_median"]) < 1.0)
    return "median rotation error " + "; ".join(texts), "holds" if all(same) else "holds in part"


def _minimum(results: Results) -> tuple[str, str]:
    return answer(results), "answered below; the paper's own ablation (Supplementary Fig. 17) is not public to us"


def answer(results: Results) -> str:
    """Say what the least aerodynamic information is that still flies, from the ablation of terms.

    A level is as good as everything in a world if its share reaches the low end of everything's interval.
    """
    cells = _sweep(results, "ablation_terms")
    worlds = cells.levels("world")

    def as_good(what: str) -> list[str]:
        good = []
        for feedback in cells.levels("feedback"):
            pairs = [
                (cells.cell(world=w, feedback=feedback), cells.cell(world=w, feedback="everything")) for w in worlds
            ]
            if all(cell[what] >= whole[f"{what}_low"] * cell["flights"] for cell, whole in pairs):
                good.append(feedback)
        return good

    def by_world(level: str, quantity: str, form: str) -> str:
        return ", ".join(format(cells.cell(world=w, feedback=level)[f"{quantity}_median"], form) for w in worlds)

    arrives, stays = as_good("completed"), as_good("on_course")
    least = next((name for name in LEAST_FIRST if name in stays), "nothing short of everything")
    moment, force = "total moment only", "total force only"
    return (
        f"The least that stays on course as often as with everything, in every world: **{least}**. "
        f"As good in staying on course: {', '.join(stays)}. As good in arriving: {', '.join(arrives)}. "
        f"With the moment alone the median rotation error is {by_world(moment, 'rotation_error_deg', '.0f')}° and the "
        f"median CoM error {by_world(moment, 'com_error', '.2f')} m, world by world; with the force alone "
        f"{by_world(force, 'rotation_error_deg', '.0f')}° and {by_world(force, 'com_error', '.2f')} m."
    )


def _network(_: Results) -> tuple[str, str]:
    return "—", NETWORK


CLAIMS = (
    _Claim("Mechanical design", "The robot's mass is 43.3 kg", _mass),
    _Claim(
        "Actuators selection",
        "Five minutes of a 40 kg robot need 26.31 kg of battery or 4.61 kg of fuel",
        _engine_choice,
    ),
    _Claim(
        "TEST1", "The baseline controller fails to complete the envelope: the robot falls due to imbalances", _baseline
    ),
    _Claim("TEST2", "The aerodynamic-aware controller keeps balance throughout all manoeuvres", _aware),
    _Claim("TEST3", "With the network as simulator the baseline fails", _network),
    _Claim("TEST4", "With the network as simulator and feedback the aware controller completes", _network),
    _Claim(
        "Suppl. Fig. 7a, d",
        "Joint errors grow until the failure, and in successful flights stay bounded and decrease in static phases",
        _joint_errors,
    ),
    _Claim(
        "Suppl. Fig. 7e", "The axisymmetric model's total force is largely aligned with the relative wind", _aligned
    ),
    _Claim("Fig. 5f", "The thrusts are asymmetric because of the aerodynamic moment", _asymmetry),
    _Claim(
        "Robustness",
        "A controller with a simpler model than the simulator's completes; errors stay bounded",
        _robustness,
    ),
    _Claim("Suppl. Fig. 7j", "The two models differ most in the transitions, especially from 35 s", _transitions),
    _Claim("Methods", "The change of aerodynamic forces with posture and speed is negligible in control", _lambda),
    _Claim(
        "Suppl. Fig. 17",
        "There is a minimum of aerodynamic information with which the envelope is still flown",
        _minimum,
    ),
)

"""Verdicts on the paper's claims and on ours: figures on both sides of what each of them asks for."""

import re
from string import Formatter
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from msgspec import structs

from experiments.report import judge, paper, stored
from experiments.report.judge import AGREES, Kind, Verdict
from experiments.report.measures import Measured, results
from experiments.report.results import FINAL, Results
from jax_aero.base import places, tables
from jax_aero.base.result import LOST
from jax_aero.base.terminal import ConfigError
from jax_aero.commands.fly import main as fly
from jax_aero.results.flight import PAPER_RUNS
from jax_aero.stored import kept
from jax_aero.sweep import aggregate, columns, spec
from jax_aero.sweep.criteria import Criterion, Share
from jax_aero.sweep.design import Design
from jax_aero.sweep.intervals import wilson
from jax_aero.sweep.result import SweepResult

CLAIMS = paper._table().claim


def good(bound):
    """A value within a bound."""
    if bound.equal is not None:
        return bound.equal
    low, high = (
        next((end for end in ends if end is not None), None)
        for ends in ((bound.least, bound.above), (bound.most, bound.below))
    )
    if low is None or high is None:
        return high - 1.0 if low is None else low + 1.0
    return (low + high) / 2.0


def bad(bound):
    """Values just outside of a bound, and, for a number, none."""
    if bound.equal is not None:
        return [not bound.equal if isinstance(bound.equal, bool) else "another"]
    ends = [(bound.least, -1.0), (bound.above, 0.0), (bound.most, 1.0), (bound.below, 0.0)]
    return [*(end + sign * 1e-9 * max(1.0, abs(end)) for end, sign in ends if end is not None), np.nan]


def values(claim, **changes):
    """Values of a case within all bounds of a claim, but those of these changes."""
    named = {name for bound in (*claim.asks, *claim.remarks) for _, name, *_ in Formatter().parse(bound.how) if name}
    inside = {bound.of: good(bound) for bound in (*claim.remarks, *claim.asks)}
    both = {bound.of for bound in claim.asks} & {bound.of for bound in claim.remarks}
    inside |= {bound.of: good(bound) for bound in claim.remarks if bound.of in both}
    return dict.fromkeys(named - {"case", "fails", "miss", "unit"}, 1.0) | inside | changes


ASKED = [(key, number) for key, claim in CLAIMS.items() for number in range(len(claim.asks))]


@pytest.mark.parametrize(("key", "number"), ASKED)
def test_every_bound_of_a_claim_can_refute_it(key, number):
    claim = CLAIMS[key]
    bound = claim.asks[number]
    assert claim.judge({"a": values(claim), "b": values(claim)}) == AGREES
    for value in bad(bound):
        wrong = values(claim, **{bound.of: value})
        if bound.part or not claim.in_part:
            assert claim.judge({"a": wrong}).kind in (Kind.DIFFERS, Kind.IN_PART), value
        else:
            assert claim.judge({"a": values(claim), "b": wrong}).kind is Kind.IN_PART, value
        assert claim.judge({"a": values(claim), "b": wrong}).kind is not Kind.AGREES
    asks = [*claim.asks]
    asks[number] = structs.replace(bound, of=f"{bound.of}s")
    with pytest.raises(LookupError, match=f"no case has `{bound.of}s`"):
        structs.replace(claim, asks=tuple(asks)).judge({"a": values(claim), "b": values(claim)})


MADE = {"where": "ours", "states": "s", "measure": "files.jets", "asks": [{"of": "mass", "most": 1.0}]}


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"asks": []}, "`asks` is 0; expected bounds"),
        ({"measure": ""}, "`asks` is 1; expected bounds"),
        ({"verdict": "out of reach: it is"}, "`asks` is 1; expected bounds"),
        ({"verdict": "agrees", "asks": []}, '`verdict` is "agrees"; expected none, or out of reach or not compared'),
        ({"measure": "files.jet"}, '`measure` is "files.jet"; expected a function'),
        ({"measure": "file.jets"}, '`measure` is "file.jets"; expected a function'),
        ({"asks": [{"of": "mass"}]}, '`asks[0].of` is "mass"; expected a limit'),
        ({"asks": [{"of": "mass", "lest": 1.0}]}, "unknown key `asks[0].lest`"),
        ({"asks": [{"of": "mass", "most": True}]}, "`asks[0].most` is true"),
    ],
)
def test_a_claim_that_cannot_fail_is_refused_when_it_is_read(change, named):
    assert tables.convert(MADE, judge.Claim, "t.toml").asks[0].most == 1.0
    with pytest.raises(ConfigError, match=re.escape(named)):
        tables.convert(MADE | change, judge.Claim, "t.toml")


def test_without_cases_nothing_agrees():
    with pytest.raises(LookupError, match="no case has `mass`"):
        CLAIMS["mass"].judge({})
    limited = judge.of_sweep("s", Criterion(key="k", states="", at_most={"com_error_median_of_all": 1.0}))
    assert (
        limited.judge({"a": {"others": 0, "com_error_median_of_all": np.nan, "com_error_median_of_all_text": ""}}).kind
        is Kind.DIFFERS
    )


def test_what_holds_in_part_says_where():
    claim = CLAIMS["test2"]
    wrong = values(claim, share=0.9)
    assert claim.judge({"corrected": wrong, "published": values(claim)}) == Verdict(
        Kind.IN_PART, "agrees with published lever arms, differs with corrected ones: it does not hold there"
    )
    assert claim.judge({"corrected": wrong, "published": wrong}) == Verdict(Kind.DIFFERS, "differs: it does not hold")
    found = claim.judge({"corrected": values(claim), "published": values(claim, is_decided=False)})
    assert found.kind is Kind.IN_PART
    assert found.text == "agrees; with published lever arms not decided: 95 % is within the interval"
    error = values(CLAIMS["network_error"], random=1.0, random_times=26.0)
    assert CLAIMS["network_error"].judge({"": error}) == Verdict(
        Kind.IN_PART, "agrees on whole postures; on random rows differs: 26 times"
    )


def test_a_verdict_says_by_how_much():
    assert CLAIMS["mass"].judge({"": {"mass": 44.0}}).text == "differs: +0.65 kg"
    assert CLAIMS["speeds"].judge({"": {"fast": 6.0}}).text == "differs: +1.0 %"


def find(key, studies=None, sweeps=None):
    """What is measured, and the text of the verdict, from figures in place of a results folder."""
    measured, verdict = CLAIMS[key].decide(
        SimpleNamespace(
            study=lambda kind, name: (studies or {}).get(name, (studies or {}).get(kind)),
            sweep=lambda name: SweepResult("s", {"axes": []}, pd.DataFrame(sweeps[name])),
        )
    )
    return measured, verdict.text


WAKE = {
    "turbulent over molecular viscosity, largest in the plane": 1190.0,
    "part of the wake in the plane where that is above 100": 0.93,
    "part of the surface where that is above 100": 0.01,
    "pressure share of the force": 0.98,
}
AREAS = {
    name: {"cells": 1000, "wake in the plane, slower than half the wind [m2]": area}
    for name, area in (("flight30_coarse", 9.0), ("flight30", 0.24), ("flight30_fine", 0.5))
}
WINDS = {"air, 6 m/s": {"rms": 0.5, "inside": 0.9}, "air, 10 m/s": {"rms": 1.6, "inside": 0.96}}
ENGINES = {
    f"t {engine}": {"outcome": outcome, "arm_thrust_max": 99.0, "rotation_error": 3.0}
    for engine, outcome in (("P100", "off_course"), ("P160", "completed"))
}
FLOWN = {"no_wind": {"five_minutes_kg": 4.87, "fuel_l": 0.8}}
DISTANCES = dict.fromkeys(PAPER_RUNS, 5.0) | {"test1": 0.0, "own": -1.0}
CLEAR = {name: {"clearance_mm": distance} for name, distance in DISTANCES.items()}


@pytest.mark.parametrize(
    ("key", "studies", "measured", "verdict"),
    [
        ("wake_viscosity", {"flight30": WAKE}, "at most 1190 in",
         "differs: not in 7 % of it, wall functions leave less on 99 % of it"),
        ("boundary", {"flight30": {"drag [m2]": 0.2}, "flight30_boundary": {"drag [m2]": 0.205}}, "drag 0.2000 m² with",
         "differs: +2.5 %"),
        ("pressure_share", {"flight30": WAKE}, "98.0 % of the force", "differs: +2 points"),
        ("wake_meshes", AREAS, "meshes of ours, of 1, 1, 1", "agrees"),
        ("wake_meshes", AREAS | {"flight30_coarse": AREAS["flight30_fine"]}, "meshes of ours", "differs: 0 % apart"),
        ("wind_estimate", {"turbulence": WINDS}, "6 to 10 m/s; air: 0.50 to 1.60 m/s rms, 90 to 96 % inside",
         "differs: air: up to 1.6 m/s, air: interval too wide"),
        ("arm_engines", {"paper": ENGINES}, "with P100 in the arms: t off course, arms up to 99 N, rot",
         "differs: not every flight ends alike"),
        ("fuel_flown", {"flights": FLOWN}, "4.87 kg at", "differs: +0.26 kg; the engines burn more, and idle counts"),
        ("clearance", {"flights": CLEAR}, "exhaust's axis to the nearest link, at least: test1 0 mm, test2 5 mm, ",
         "agrees in 9 of the paper's 10 flights; an exhaust meets the body in test1"),
    ],
)  # fmt: skip
def test_studies_are_measured(key, studies, measured, verdict):
    text, found = find(key, studies)
    assert text.startswith(measured)
    assert found == verdict


@pytest.mark.parametrize(
    ("figure", "off", "verdict"),
    [
        ("centre of mass [mm]", 19.0, "agrees"),
        ("centre of mass [mm]", -21.0, "differs: beyond its band: lateral: centre of mass [mm]"),
        ("onset [s]", np.nan, "differs: beyond its band: lateral: onset [s]"),
        ("ankle roll, torque [N m]", 1.6, "differs: beyond its band: lateral: ankle roll, torque [N m]"),
    ],
)
def test_the_simulated_motion_is_judged_by_the_recorded_numbers(figure, off, verdict):
    robot = {"centre of mass [mm]": 37.0, "onset [s]": 3.0, "ankle roll, torque [N m]": -6.8}
    exact = {f"{source}: {name}": value for source in ("recorded", "simulated") for name, value in robot.items()}
    studies = {"front": exact, "lateral": exact | {f"simulated: {figure}": robot[figure] + off}}
    assert find("recorded_motion", studies)[1] == verdict


def test_other_models_are_those_of_other_worlds():
    cells = [
        {
            "arms": arms,
            "world": world,
            "model": model,
            "flights": 40,
            "on_course": 1,
            "completed": 40 * (model in (world, other)),
        }
        for arms, other in (("a", "y"), ("b", ""))
        for world in ("x", "y")
        for model in ("x", "y", "none")
    ]
    text, verdict = find("model_pairs", sweeps={"model_pairs": cells})
    assert text.startswith(
        "a, completed: the simulator's model 80 (2 on course) of 80, another model 40 (2 on course) of 80, no model 0 "
    )
    assert verdict == "differs: it does not hold; within 15° and 25 cm fewer than 90 % with a, b"


# --- flights of today, and what is wrong with them


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Flights of the paper, anew."""
    folder = tmp_path_factory.mktemp("flown")
    names = ["test2", "test4", "robustness", "robustness_published", "no_wind"]
    assert fly([*names, "--out", str(folder / "flight")]) == 0
    return folder


def exchange(run):
    return run.assign(thrust=(run["thrust"].dims, run["thrust"].values[:, [1, 0, 3, 2]]))


def turn(run):
    """Turn the simulated forces by 90° about the vertical."""
    forces = run["aero_force_sim"]
    return run.assign(aero_force_sim=(forces.dims, forces.values[..., [1, 0, 2]] * [-1.0, 1.0, 1.0]))


@pytest.mark.parametrize(
    ("key", "name", "change", "expected"),
    [
        ("asymmetry", "test4", None, Kind.IN_PART),
        ("asymmetry", "test4", exchange, Kind.DIFFERS),
        ("thrusts_alike", "test4", None, Kind.AGREES),
        ("thrusts_alike", "test4", exchange, Kind.DIFFERS),
        ("thrusts_alike", "test2", exchange, Kind.DIFFERS),
        ("aligned", "test2", None, Kind.AGREES),
        ("aligned", "test2", turn, Kind.DIFFERS),
        ("nonlinear", "test4", None, Kind.DIFFERS),
        ("nonlinear", "test4", turn, Kind.AGREES),
        ("signs", "robustness", None, Kind.IN_PART),
        ("signs", "robustness", turn, Kind.DIFFERS),
        ("transitions", "robustness", None, Kind.DIFFERS),
        ("force_changes", "test2", None, Kind.AGREES),
        ("mach", "test2", None, Kind.AGREES),
        ("mach", "test2", lambda run: run.assign(wind=20.0 * run["wind"]), Kind.DIFFERS),
        ("oscillations", "robustness", None, Kind.IN_PART),
    ],
)
def test_a_claim_refuses_a_flight_that_is_wrong(flown, key, name, change, expected):
    found = Results(flown)
    if change is not None:
        found.flights[name].__dict__["run"] = change(found.flights[name].run)
    assert CLAIMS[key].decide(found)[1].kind is expected


def test_joint_errors_are_judged_part_by_part():
    """Of a flight that succeeds a torso that stays turned counts, though it is little beside legs that come back."""

    def judged(torso, arm):
        parts = {"test2": {"legs": (100.0, 1.0), "torso": (5.0, torso)}, "test1_published": {"arm": (90.0, arm)}}
        other = {"test4": parts["test2"], "robustness": parts["test2"], "robustness_published": parts["test2"]}
        parts |= other | {"test3_published": parts["test1_published"]}
        flights = SimpleNamespace(flight=lambda name: SimpleNamespace(joint_errors=parts[name]))
        return CLAIMS["joint_errors"].decide(flights)

    text, verdict = judged(0.5, 80.0)
    assert "test2: legs 100° (1°), torso 5° (0°)" in text
    assert verdict.kind is Kind.AGREES
    assert "differs in test2, test4, robustness, robustness_published" in judged(4.0, 80.0)[1].text
    assert "differs in test1_published, test3_published" in judged(0.5, 10.0)[1].text


def test_parts_of_the_body_share_its_joint_errors(flown):
    flight = Results(flown).flights["test2"]
    run, errors = flight.run, flight.joint_errors
    whole = np.degrees(abs(run["joint_position"] - run["joint_setpoint"]).sum("joint"))
    assert [*errors] == ["left arm", "left leg", "right arm", "right leg", "torso"]
    assert max(most for most, _ in errors.values()) <= float(whole.max()) <= sum(most for most, _ in errors.values())
    at_the_end = float(whole[whole["time"] >= whole["time"][-1] - FINAL].mean())
    assert sum(end for _, end in errors.values()) == pytest.approx(at_the_end, rel=1e-12)


def test_models_are_compared_in_the_full_wind(flown):
    """The still air of the first ten seconds, in which both forces are small, is not rest."""
    flight = Results(flown).flights["robustness"]
    with_calm, time = flight.forces_apart, flight.run["time"].values
    assert with_calm["moving"] < with_calm["resting"]
    flight.__dict__["run"] = flight.run.isel(time=time > 9.9)
    assert flight.forces_apart == pytest.approx(with_calm, rel=0.01)


# --- claims in the files of sweeps

AXES = ["controller", "speed"]


def cell(completed=100, worst=4.0, **labels):
    low, high = wilson(completed, 100)
    errors = {"median_of_all": 2.0, "median_of_upright": 2.0, "worst_of_all": worst, "worst_of_upright": worst}
    counts = {"flights": 100, "completed": completed, "completed_low": low, "completed_high": high, "lost": 0}
    return labels | counts | {f"rotation_error_deg_{name}": value for name, value in errors.items()}


CELLS = [cell(controller=name, speed=speed) for name in ("observer", "observer, no model") for speed in (10.0, 26.0)]


def judged(found, **asked):
    claim = Criterion(key="k", states="", **asked)
    measured = results.of_cells([one for one in found if claim.covers(one)], AXES, claim)
    assert isinstance(measured, Measured)
    return measured.text, judge.of_sweep("s", claim).judge(measured.cases).text


@pytest.mark.parametrize(
    ("chosen", "count"),
    [
        ({}, 4),
        ({"speed": 26}, 2),
        ({"speed": [10, 26], "controller": "observer"}, 2),
        ({"controller": "observer*", "speed": 10.0}, 2),
        ({"controller": "*no model"}, 2),
    ],
)
def test_a_claim_covers_the_cells_of_its_levels(chosen, count):
    assert sum(Criterion(key="k", states="", cells=chosen).covers(one) for one in CELLS) == count


COUNTED = ("none", "one", "two", "three", "four", "five", "six")


@pytest.mark.parametrize("name", places.names("sweeps"))
def test_a_claim_says_its_bounds(name):
    for claim in paper.stated(name):
        bounds = claim.at_most.items()
        said = [
            f"{limit:g}°" if columns.CELLS[of].unit == "deg" else f"at most {COUNTED[int(limit)]}"
            for of, limit in bounds
        ]
        said += [f"at most {100.0 * one.at_most:g} %" if one.at_most else "no flight" for one in claim.share]
        assert not [bound for bound in said if f" {bound}" not in claim.states], claim.states


def test_a_claim_fails_with_one_of_its_cells_that_it_names():
    limit = {"rotation_error_deg_worst_of_all": 5.0}
    assert judged(CELLS, at_most=limit) == (
        "400 of 400 (99.0 to 100.0 %) completed; rotation error in the median 2.0°, at most 4.0°", "agrees"
    )  # fmt: skip
    for figures, how in (({"worst": 5.1}, "5.1°"), ({"completed": 99}, "1 of 100 not completed")):
        cells = [*CELLS[:3], cell(controller="observer, no model", speed=26.0, **figures)]
        assert judged(cells, at_most=limit)[1] == f"differs: observer, no model, 26: {how}"
        assert judged(cells, at_most=limit, cells={"controller": "observer"})[1] == "agrees"
    cells = [*CELLS[:3], cell(controller="observer, no model", speed=26.0, worst=5.0)]
    assert judged(cells, at_most=limit)[1] == "agrees"


def test_a_share_is_that_of_all_cells_together():
    some = [{"lost": 50, "unwarned": 1}, {"lost": 50, "unwarned": 1}]
    asked = {"share": (Share(of="unwarned", among="lost", at_most=0.02),)}
    limit = "; not decided: 2 % is within the interval"
    assert judged(some, **asked) == ("unwarned 2 of 100 (0.6 to 7.0 %); 3 would refute it", f"agrees{limit}")
    some[0]["unwarned"] = 2
    assert judged(some, **asked)[1] == f"differs: 1 too many{limit}"
    some[0]["unwarned"] = 7
    assert judged(some, **asked)[1] == "differs: 6 too many"
    assert judged([{"lost": 1000, "unwarned": 1}], **asked)[1] == "agrees"


def test_a_share_and_a_limit_are_both_asked():
    asked = {"share": (Share(of="completed", at_most=1.0),), "at_most": {"rotation_error_deg_worst_of_all": 5.0}}
    text, verdict = judged(CELLS, **asked)
    assert text.startswith("completed 400 of 400 (99.0 to 100.0 %); 401 would refute it; rotation error in the median")
    assert verdict == "agrees"
    wrong = [*CELLS[:3], cell(worst=5.1, controller="observer", speed=1.0)]
    assert judged(wrong, **asked)[1] == "differs: observer, 1: 5.1°"
    asked["share"] = (Share(of="completed", at_most=0.5),)
    assert judged(CELLS, **asked)[1] == "differs: 200 too many"


STATED = [claim for name in places.names("sweeps") for claim in paper.stated(name)]


@pytest.mark.parametrize("degraded", [True, False])
@pytest.mark.parametrize("lost", LOST)
@pytest.mark.parametrize("claim", STATED, ids=[claim.key for claim in STATED])
def test_a_claim_is_refuted_by_flights_that_are_all_lost_and_confirmed_by_those_that_all_succeed(claim, lost, degraded):
    """In whatever way they are lost, without a warning where that is asked; the other way round if few may land."""
    refuted = []
    for outcome in (lost, "completed"):
        measured = dict.fromkeys(columns.FLIGHT, np.zeros(2000))
        found = {"outcome": np.full(2000, outcome), "degraded_time": np.full(2000, float(degraded and outcome == lost))}
        made = results.of_cells([aggregate.figures(measured | found)], [], claim)
        refuted.append(judge.of_sweep("s", claim).judge(made.cases).kind is Kind.DIFFERS)
    assert refuted == ([False, True] if [one.of for one in claim.share] == ["upright"] else [True, False])


ENDING = {"announced_losses", "announced_losses_pairs", "engines_lost", "mission_loss", "mission_loss_paper"}
ENDING |= {f"descent_{way}" for way in ("accelerating", "braking", "chest", "cruise", "leaning")}
ENDING |= {"false_alarms_robot", "false_alarms_sensors"}
ENDING |= {"ground_1", "ground_2", "ground_5", "height_errors", "landing_loss_arm", "robot_take_off_weak"}
ENDING |= {"learnt_engines", "learnt_engines_kick", "settings_most_friction", "settings_recommended"}
ENDING |= {
    "gap_sensor",
    "mk3_settings_weak",
    "unmeasured_healthy",
    *(f"unmeasured_{way}" for way in ("accelerating", "braking", "cruise", "hover", "hover_2")),
}
"""Claims of how flights end, or of what is reported in them, alone."""


def test_a_claim_is_refuted_by_errors_ten_times_as_large_as_the_stored_ones():
    assert {claim.key for claim in STATED if not claim.at_most} == ENDING
    for document, claim in [
        (one, claim) for one in map(kept.read, kept.names()) for claim in stored.stated(one).values()
    ]:
        if claim.at_most:
            cells = [
                cell for cell in document.cells() if claim.covers(cell) and None not in map(cell.get, claim.at_most)
            ]
            # A count becomes that of all flights.
            worse = [
                cell
                | {
                    name: cell["flights"] if columns.CELLS[name].type == columns.COUNT else 10.0 * cell[name]
                    for name in claim.at_most
                }
                for cell in cells
            ]
            made = results.of_cells(worse, [axis.name for axis in document.axes], claim)
            assert judge.of_sweep("s", claim).judge(made.cases).kind is Kind.DIFFERS, claim.key


def test_claims_of_sweeps_have_keys_of_their_own():
    keys = [claim.key for claim in STATED]
    assert len({*keys, *CLAIMS}) == len(keys) + len(CLAIMS)


LIST = {
    "title": "t", "base": "test2", "design": "list",
    "axis": [{"name": name, "key": f"simulator.{name}", "values": [1.0, 2.0]} for name in ("duration", "substeps")],
}  # fmt: skip


@pytest.mark.parametrize(
    ("claim", "named"),
    [
        (
            {"at_most": {"rotation_eror_deg_worst": 1.0}},
            '`claim[0].at_most` is "rotation_eror_deg_worst"; expected a column',
        ),
        (
            {"cells": {"duration": 1.0, "substeps": 2.0}},
            '`claim[0].cells` is {"duration":1.0,"substeps":2.0}; expected levels of one',
        ),
        (
            {"cells": {"duration": 3.0}},
            "`claim[0].cells.duration` is 3.0; expected a level of an axis: duration, substeps",
        ),
    ],
)
def test_a_claim_that_no_cell_can_decide_is_refused_before_the_flights(claim, named):
    with pytest.raises(ConfigError, match=re.escape(named)):
        Design(spec.from_table("s", {**LIST, "claim": [{"key": "k", "states": "s", **claim}]})).check()


def test_a_claim_of_a_sweep_is_judged_by_its_result():
    key, claim = next((key, claim) for key, claim in paper.all_claims().items() if claim.is_of_sweep)
    assert key in {one.key for one in paper.stated(claim.arguments["name"])}
    with pytest.raises(LookupError, match=f"no cell of the claim `{key}`"):
        claim.decide(SimpleNamespace(sweep=lambda _: SweepResult("s", {"axes": []}, pd.DataFrame())))

"""The table of the paper: its figures, tables, equations and numbers, their claims, how each is measured, our verdict.

`SECTIONS` is the only table, to which the claims in the files of sweeps are added; the report (`jax-aero report`) and
the documentation's page (`jax-aero report --index`) follow from it. Verdicts on claims are computed. Entries of studies
whose folders are not there are left out, and figures and sweeps that the table does not name are added to its end.
"""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import TypeAlias

from experiments import Refused, studies
from experiments.report import claims, facts, judges, tunnel
from experiments.report.findings import Finding
from experiments.report.judges import Judge
from experiments.report.results import NotFlownError, Results, StaleError
from experiments.report.verdicts import (
    AGREES,
    ANOTHER,
    NOT_FLOWN,
    OUTDATED,
    Judged,
    Kind,
    Verdict,
    differs,
    error,
    mark_outdated,
    not_compared,
    out_of_reach,
)
from jax_aero.base import places
from paper_figs.figures import FIGURES, SWEEPS


@dataclass(frozen=True)
class Claim:
    """A statement of the paper or of this project, and how it is measured."""

    key: str
    """Name in `docs/claims.json`."""
    where: str
    """Place in the paper, or "ours"."""
    states: str
    judge: Judge
    commands: tuple[str, ...] = ()
    """Commands that make the results, without `jax-aero`; none if committed files suffice."""
    figure: str = ""
    """Figure or sweep that shows it, if not that of its item."""
    is_of_sweep: bool = False
    """Whether it stands in the file of a sweep, with which its finding is kept."""

    def find(self, results: Results) -> Finding:
        """Return measurement and verdict from the results that exist."""
        results.made.clear()
        try:
            measured, verdict = self.judge(results)
        except NotFlownError as reason:
            verdict = OUTDATED if isinstance(reason, StaleError) else NOT_FLOWN
            return Finding("; ".join(results.failures(each(self.commands))) or str(reason), verdict)
        except Refused:
            raise
        except Exception as reason:  # of a result that does not fit, or of the judge
            return Finding("no measurement", error(reason))
        if changed := [f"{name} ({made.differs})" for name, made in results.made.items() if made.differs]:
            measured, verdict = f"{measured}; {ANOTHER}: {', '.join(changed)}", mark_outdated(verdict)
        commits = {made.created: made.commit for made in results.made.values() if made.created and made.commit}
        return Finding(measured, verdict, commits[max(commits)] if commits else None)


@dataclass(frozen=True)
class Item:
    """One item of the paper, or one of this project beyond it."""

    name: str
    shows: str = ""
    """If empty, the title of the figure or sweep."""
    figure: str = ""
    """Name of a figure or sweep of `paper_figs`."""
    links: tuple[str, ...] = ()
    """Pages of `docs`, and files of the repository."""
    verdict: Verdict | None = None
    """Our verdict, if nothing is measured."""
    held_by: tuple[str, ...] = ()
    """Tests that hold a verdict of agreement, or why it holds by construction."""
    made_by: tuple[str, ...] = ()
    """Commands that make it, without `jax-aero`, if not those of its claims or of its figure; without the drawing."""
    claims: Sequence[Claim] = ()
    """Claims of the rows below it."""

    @property
    def commands(self) -> list[str]:
        """Return the commands that make the item: its results first, then the figure."""
        made = whole(self.made_by or [command for claim in self.claims for command in claim.commands])
        if self.figure in FIGURES:
            made = made or FIGURES[self.figure].commands
        elif self.figure:
            made.append(f"jax-aero sweep {self.figure}")
        drawn = [f"jax-aero figures {self.figure}"] if self.figure else []
        return list(dict.fromkeys([*made, *drawn]))


Row: TypeAlias = Item | Claim
"""A row of the table; claims stand below their item."""


def each(commands: Sequence[str]) -> list[str]:
    """Return commands as they are typed, one for each flight and each sweep."""
    made: list[str] = []
    for line in whole(commands):
        word, *names = line.split()[1:]
        made += [f"jax-aero {word} {name}" for name in names] if word in ("fly", "sweep") else [line]
    return made


def whole(commands: Sequence[str]) -> list[str]:
    """Return commands as they are typed."""
    return [command if command.startswith("jax-aero ") else f"jax-aero {command}" for command in commands]


def _fact(key: str, where: str, states: str, judge: Callable[[], Judged], figure: str = "") -> Claim:
    """Return a claim that committed files decide."""
    return Claim(key, where, states, lambda _: judge(), figure=figure)


def _equation(name: str, shows: str, number: str, held_by: str) -> Item:
    """Return an equation of the model with which the paper agrees; those of the air have numbers below 40."""
    page = "air" if int(number[1:]) < 40 else "law"
    return Item(name, shows, links=(f"model/{page}.md#{number}",), verdict=AGREES, held_by=(held_by,))


def _stands(key: str, where: str, states: str, judge: Judge) -> Claim:
    return Claim(key, where, states, judge, (f"fly {' '.join(judges.STANDING)}",))


def _tested(key: str, states: str, judge: Judge) -> Claim:
    flights = f"fly {key} {key}_published"
    where = key.upper() if key.startswith("test") else key.capitalize()
    return Claim(key, where, states, judge, (flights, "sweep paper_tests"))


# What holds an equation for which nothing is measured.
BY_CONSTRUCTION = "by construction"
FORCES = "tests/parity/test_aero.py::test_axisymmetric_forces_follow_the_printed_formula"
CYLINDERS = "tests/parity/test_aero.py::test_sphere_and_cylinder_forces_follow_the_published_tables"
CONDITIONS = (
    "tests/units/test_fit_aero.py::test_the_powers_that_meet_the_papers_constraints_span_the_papers_terms_and_no_more"
)
MOMENTUM = "tests/parity/test_symbolic_momentum.py::test_every_term_of_a_state"
MASS_MATRIX = "tests/parity/test_jax_dynamics.py::test_the_inverse_of_the_mass_matrix"

# Claims that stand under several items.
TEST1 = _tested(
    "test1",
    "The baseline controller fails to complete the mission: the robot falls due to imbalances",
    judges.judge_fall("test1"),
)
TEST2 = _tested(
    "test2", "The aerodynamic-aware controller keeps balance throughout all manoeuvres", judges.judge_flight("test2")
)
TEST3 = _tested("test3", "With the network as simulator the baseline fails", judges.judge_fall("test3"))
CHEST_ENGINE = _fact(
    "chest_engine", "Actuators selection", "P220-RXi: about 22 kg of thrust for 0.6 l/min", facts.chest_engine
)
ARM_ENGINE = _fact("arm_engine", "Number of jet engines", "The forearms carry P100", facts.arm_engine)
STRESS = _fact("stress", "FEM analysis", "At most 57 MPa (jetpack) and 77 MPa (forearm)", facts.stress)
STRENGTH = _fact(
    "strength", "FEM analysis", "At least 5 times below the strength of Ergal, the weakest", facts.strength
)
BLOCKAGE = _fact("blockage", "Wind tunnel facility", "Blockage at most 3 % of 4 m × 3.84 m", facts.blockage)
CELLS = _fact("cells", "Mesh sensitivity", "About 97 % fewer cells than the finest mesh", facts.cells)

NO_MESH = out_of_reach("needs the authors' CFD meshes and solutions, which are not public")
PRESSURES = not_compared(
    "public (ami-iit/element_cfd-simulation, BSD-3: mean pressures at 124 taps, and their positions), not yet read here"
)
NO_LEVELS = out_of_reach("the levels of the paper are not public to us")
DATA = ("data import-cfd --clone DIR --out results/datasets/freestream.nc",)
TRAINING = (*DATA, "train compact --dataset results/datasets/freestream.nc")
ROBUSTNESS = "fly robustness robustness_published"

FIGURE_ROWS: Sequence[Row] = (
    Item("Fig. 1 a, b", "the robot: mass, sizes", links=("#the-robot",)),
    _fact("mass", "Mechanical design", "The robot's mass is 43.3 kg", facts.mass),
    _fact("added_mass", "Mechanical design", "10.3 kg more than iCub v2.7", facts.added_mass),
    Item(
        "Fig. 1 c–f",
        "jetpack and forearm, assembled and exploded",
        verdict=out_of_reach("photographs and CAD of the prototype"),
    ),
    Item(
        "Fig. 2 a–c",
        "tunnel, test section, robot on its support, as a drawing",
        "fig2_setup",
        verdict=AGREES.but(" in its parts; the point where the strut holds the robot is not public"),
        held_by=("tests/studies/test_pictures.py::test_capsules_are_where_the_robots_file_has_them",),
        made_by=("study pictures",),
    ),
    Item("Fig. 2 d", "drag by speed", "fig2"),
    _fact(
        "speeds",
        "Fig. 2 d",
        "hovering, 19 and 24 m/s: largest spread over sideslip: below 5 %",
        partial(tunnel.speeds, slow=False),
    ),
    _fact("slow_speed", "Fig. 2 d", "hovering, with 12 m/s: below 5 %", partial(tunnel.speeds, slow=True)),
    Item("Fig. 2 e", "drag by posture", "fig2"),
    *(
        _fact(
            f"postures_{alpha}",
            "Fig. 2 e",
            f"spread of eight flight postures at α = {alpha}°: almost 20 %",
            partial(tunnel.postures, alpha),
        )
        for alpha in (25, 60)
    ),
    Item("Fig. 3 a, b", "CFD compared with the tunnel", "fig3"),
    *(
        _fact(f"{what} {model}", "Fig. 3 a, b", f"{what}, {model}: {error}", partial(judge, model))
        for model in tunnel.MODELS
        for what, error, judge in (
            ("drag", "rms error over mean: k-ω better", tunnel.drag_errors),
            ("magnitude", "mean error: below 10 %", tunnel.size_errors),
        )
    ),
    Item("Fig. 3 c–f", "surface pressure, streamlines and contours of the flow", "cfd_flow", ("cfd.md",)),
    Claim(
        "wake_viscosity",
        "Fig. 3 e, f",
        "In the whole wake the turbulent viscosity is more than 100 times the molecular one",
        judges.wake_viscosity,
        ("cfd flow flight30",),
    ),
    Item("Fig. 3 g, h", "lattice Boltzmann simulation, drag within 1 %", verdict=NO_MESH),
    Item("Fig. 4 a–c", "the network's drag of the head", "fig4_network", made_by=TRAINING),
    _fact("network_size", "Network", "9 inner layers of 1048 neurons, 22 inputs, 39 outputs", facts.network_size),
    _fact(
        "network_error", "Network", "An error of at most 3e-6 on the validation set", facts.network_error, "training"
    ),
    Item("Fig. 4 d, e", "the axisymmetric model over the CFD", "fig4_fit", made_by=(*DATA, "data fit-aero freestream")),
    _fact(
        "order", "Axisymmetric model", "An error one order of magnitude above the network's", facts.order_of_magnitude
    ),
    Item(
        "Fig. 5 a",
        "the flight, rendered with forces, exhausts and wind",
        "fig5a",
        verdict=AGREES,
        held_by=(f"{BY_CONSTRUCTION}: the forces of the flight that is drawn",),
        made_by=("study pictures",),
    ),
    Item("Fig. 5 b–i", "TEST2 and TEST1", "fig5"),
    TEST1,
    TEST2,
    Item("Fig. 5 b–i", "TEST4 and the robustness test", "fig5_robustness"),
    _tested(
        "test4",
        "With the network as simulator and feedback the aware controller completes",
        judges.judge_flight("test4"),
    ),
    _tested(
        "robustness",
        "A controller with a simpler model than the simulator's completes; errors stay bounded",
        judges.robustness,
    ),
    Claim(
        "model_pairs",
        "Robustness",
        "The aware controller is robust to a model other than the simulator's (winds from everywhere)",
        judges.model_pairs,
        ("sweep model_pairs",),
        "model_pairs",
    ),
    Claim(
        "asymmetry",
        "Fig. 5 f",
        "The thrusts are asymmetric because of the aerodynamic moment",
        judges.asymmetry,
        ("fly test2 no_wind",),
    ),
    Claim(
        "thrusts_alike",
        "Flight simulations",
        "The thrusts are comparable, whatever the aerodynamic model of the simulation",
        judges.thrust_difference,
        ("fly test2 test4",),
    ),
    Item("Fig. 6 a–l", "ground experiments", "fig6", ("deviations.md#on-the-ground",)),
    _stands(
        "stands", "Fig. 6", "The standing robot keeps its balance when the measured wind does not blow", judges.balance
    ),
    _stands("against", "Fig. 6 c, i", "The CoM moves against the aerodynamic force", judges.motion_against_wind),
    _stands("ankle_pitch", "Fig. 6 d", "In frontal wind it moves mainly by the ankle pitch joints", judges.ankle_pitch),
    _stands("rolls", "Fig. 6 j", "In lateral wind it moves by the hip and ankle roll joints", judges.roll_joints),
    _stands(
        "momentum_rate",
        "Ground experiments",
        "The motion minimises the estimated linear momentum rate",
        judges.momentum_rate,
    ),
    _stands(
        "identities",
        "Ground experiments",
        "The momentum rate is the sum of foot forces, aerodynamic forces and weight; the feet carry the weight",
        judges.identities,
    ),
    _stands("onset", "Fig. 6 c, i", "The motion becomes visible about 2 s after the wind starts to rise", judges.onset),
    Claim(
        "recorded_commands",
        "Fig. 6 b, e, h, k",
        "The recorded robot's forces and desired torques follow from what it measured",
        judges.recorded_commands,
        ("study standing",),
        "standing",
    ),
    Claim(
        "recorded_motion",
        "Fig. 6 c, i",
        "The recorded robot moves by 51 mm in frontal and by 37 mm in lateral wind",
        judges.recorded_motion,
        ("study standing",),
    ),
)

EQUATION_ROWS: Sequence[Row] = (
    _equation("Network layer, ReLU", "forward pass", "m23", "tests/parity/test_jax_network.py::test_forces"),
    Item(
        "Mean squared error",
        "loss",
        links=("configs/training/paper.toml",),
        verdict=AGREES,
        held_by=("tests/train/test_training.py::test_totals_add_their_mean_squares_over_axes",),
    ),
    Item(
        "Eq. axisymmetric force",
        "drag and normal force of a link",
        links=("model/air.md#m20",),
        verdict=AGREES.but(", with the division by sin α carried out"),
        held_by=(FORCES,),
    ),
    _equation("Eq. conditions 1, 2", "slopes and values at 0° and 180°", "m29", CONDITIONS),
    _equation("Eq. C_D A, C_N A", "force areas over the angle of attack", "m20", FORCES),
    _equation("Assumption 1", "no aerodynamic moments on links", "m27", f"{BY_CONSTRUCTION}: no model has a moment"),
    _equation("Eq. generalised force", "forces of all links in joint space", "m27", MOMENTUM),
    _equation("Eq. momentum rate", "centroidal momentum under jets and air", "m56", MOMENTUM),
    Item("Eq. second derivative", "linear in thrust rates and joint velocities", links=("model/law.md#m55",)),
    Claim(
        "lambda",
        "Flight control design",
        "The change of aerodynamic forces with posture and speed is negligible in control",
        judges.lambda_term,
        ("sweep ablation_terms",),
        "ablation_terms",
    ),
    Item(
        "Eq. QP",
        "thrust rates and joint velocities",
        links=("model/law.md#m64",),
        verdict=differs("two weights in print, eight tasks in the published code and here"),
    ),
    _equation("Eq. joint dynamics", "rows of the joints", "m69", MASS_MATRIX),
    Item(
        "Eq. joint accelerations",
        "high-gain law",
        links=("model/law.md#m68",),
        verdict=differs("s* is the integral of ṡ − ṡ* in the published code and here"),
    ),
    Item(
        "Eq. torques",
        "inverse dynamics",
        links=("model/law.md#m70", "deviations.md#paper-against-its-own-code"),
        verdict=differs("the printed law has M̄⁻¹ for M̄ and contradicts the equation before it"),
    ),
)

NUMBER_ROWS: Sequence[Row] = (
    Item("Actuators selection", "battery against fuel", made_by=("study engine_choice",)),
    _fact("battery", "Actuators selection", "Five minutes of a 40 kg robot need 26.31 kg of battery", facts.battery),
    _fact("fuel", "Actuators selection", "Five minutes of a 40 kg robot need 4.61 kg of fuel", facts.fuel),
    Item("Actuators selection", "fuel along flights", "along"),
    Claim(
        "fuel_flown",
        "Actuators selection",
        "Five minutes need 4.61 kg of fuel: the same from a flight",
        judges.mission_fuel,
        ("study along",),
    ),
    Item("Actuators selection", "engines", links=("#suppl-table-1",)),
    CHEST_ENGINE,
    _fact("lift", "Number of jet engines", "A 40 kg robot needs at least two P220", facts.lift),
    ARM_ENGINE,
    Claim(
        "arm_engines",
        "Number of jet engines",
        "P100 and the more powerful P160 can be exchanged",
        judges.arm_engines,
        ("study arm_engines",),
    ),
    Item("FEM analysis", "stresses of the interfaces"),
    STRESS,
    STRENGTH,
    Item("Wind tunnel", "extent of the campaign", links=("configs/tables/wind_tunnel.toml",)),
    _fact("campaign", "Wind tunnel", "400 measurements, 54 tests, 4 symmetric and 15 other postures", facts.campaign),
    _fact("ranges", "Experiment setup", "Hovering β −90° to 90°, flight α 25° to 65°", facts.ranges, "fig2"),
    Item("Wind tunnel facility", "section 4 m × 3.84 m"),
    BLOCKAGE,
    Item(
        "Wind tunnel facility",
        "balance RUAG 192-6L, error below 0.2 %; 124 pressure taps",
        verdict=PRESSURES.but("; those of the balance are used"),
    ),
    Item("CFD", "dataset, boundary", links=("configs/tables/postures.toml",)),
    _fact("boundary", "CFD", "k = 2.89e-6 m²/s², ε = 0.0236e-6 m²/s³, ω = 8.17 1/s at the boundary", facts.boundary),
    _fact("postures", "CFD", "About 8500 free-stream simulations", facts.postures),
    Item("CFD", "104 runs with support", verdict=NO_MESH),
    Item("CFD", "drag from pressure and from friction", "cfd_flow", ("cfd.md",)),
    Claim("pressure_share", "CFD", "About 95 % of the drag is pressure", judges.pressure_share, ("cfd flow flight30",)),
    Item("Mesh sensitivity", "cells", "supp_mesh"),
    CELLS,
    Item("TEST3", "baseline, simulated with the network", "suppl7_published"),
    TEST3,
)

SUPPLEMENT_ROWS: Sequence[Row] = (
    Item("Suppl. Fig. 1", "finite elements of jetpack and forearm"),
    STRESS,
    STRENGTH,
    Item("Suppl. Fig. 2", "pressure taps", verdict=PRESSURES),
    Item("Suppl. Fig. 3, 4", "simplified geometry, control volume, mesh", verdict=NO_MESH),
    Item("Suppl. Fig. 5", "mesh study, curves", "supp_mesh"),
    *(
        _fact(
            f"mesh_{mesh}",
            "Suppl. Fig. 5",
            f"drag, mesh {mesh}: largest error: at most 15 %",
            partial(tunnel.mesh_errors, mesh),
        )
        for mesh in ("011C", "024C", "050C", "202C", "953C")
    ),
    Item("Suppl. Fig. 5", "velocity contours of two meshes", "cfd_meshes", ("cfd.md",)),
    Claim(
        "wake_meshes",
        "Suppl. Fig. 5",
        "The wake on the chosen mesh is that on the finest",
        judges.wake_meshes,
        ("cfd flow flight30_coarse flight30 flight30_fine",),
    ),
    Item(
        "Suppl. Fig. 6",
        "the robot as spheres and cylinders",
        links=("#the-robot", "img/frames.png"),
        verdict=AGREES,
        held_by=("tests/studies/test_pictures.py::test_capsules_are_where_the_robots_file_has_them",),
    ),
    Item("Suppl. Fig. 7", "TEST1 to TEST3 and the robustness test, corrected arms", "suppl7"),
    TEST2,
    Claim(
        "aligned",
        "Suppl. Fig. 7 e",
        "The axisymmetric model's total force is largely aligned with the relative wind",
        judges.force_alignment,
        ("fly test2",),
    ),
    Claim(
        "transitions",
        "Suppl. Fig. 7 j",
        "The two models differ most in the transitions, especially from 35 s",
        judges.transitions,
        (ROBUSTNESS,),
    ),
    Item("Suppl. Fig. 7", "the same, published arms", "suppl7_published"),
    TEST1,
    TEST3,
    Claim(
        "joint_errors",
        "Suppl. Fig. 7 a, d",
        "Joint errors grow until the failure, and in successful flights stay bounded and decrease in static phases",
        judges.joint_errors,
        ("fly test2 test1_published",),
    ),
    Item(
        "Suppl. Fig. 8, 9",
        "postures, rendered",
        "postures",
        ("configs/tables/postures.toml",),
        verdict=out_of_reach("the list of the supplement's 19 postures; those of the public tables are drawn"),
        made_by=("study pictures",),
    ),
    Item(
        "Suppl. Fig. 10–14",
        "whole campaign: forces, moments and efficiency",
        "tunnel_moments",
        ("moments.md", "configs/tables/tunnel_tests.toml"),
        verdict=out_of_reach("the supplement is not public to us; our figures are from the public balance files"),
        made_by=("data import-tunnel", "study tunnel_moments"),
    ),
    Item("Suppl. Fig. 15, 16", "not named in the text", verdict=out_of_reach("the supplement is not public to us")),
    Item("Suppl. Fig. 17, Note 7", "ablation of the feedback", "ablation_terms"),
    Claim(
        "minimum",
        "Suppl. Fig. 17, Note 7",
        "There is a minimum of aerodynamic information with which the mission is still flown",
        judges.minimum,
        ("sweep ablation_terms",),
    ),
    Item("Suppl. Fig. 17", "scale of the estimate", "ablation_scale", verdict=NO_LEVELS),
    Item("Suppl. Fig. 17", "links", "ablation_links", verdict=NO_LEVELS),
    Item("Suppl. Fig. 17", "models", "ablation_models", verdict=NO_LEVELS),
    Item("Suppl. Fig. 17", "models, simulated with the network", "ablation_models_network", verdict=NO_LEVELS),
    Item("Suppl. Table 1", "engines", links=("#suppl-table-1",)),
    CHEST_ENGINE,
    ARM_ENGINE,
    Item("Suppl. Table 2", "coefficients", links=("#suppl-table-2",)),
    _fact("coefficients", "Suppl. Table 2", "Coefficients of the axisymmetric model", facts.misprint, "fig4_fit"),
    Item("Suppl. Table 3", "meshes", links=("#suppl-table-3",)),
    CELLS,
    Item("Suppl. Note 1", "Reynolds and Mach numbers, blockage"),
    _fact("reynolds", "Suppl. Note 1", "The Reynolds number is high", facts.reynolds),
    _fact("mach", "Suppl. Note 1", "The Mach number is negligible", facts.mach),
    BLOCKAGE,
    Item(
        "Suppl. Note 2", "force areas", links=("model/air.md#m20", "conventions.md"), verdict=AGREES, held_by=(FORCES,)
    ),
    Item("Suppl. Note 3", "averaged Navier-Stokes equations", verdict=NO_MESH),
    _equation("Suppl. Note 4", "spheres and cylinders from the literature", "m21", CYLINDERS),
    Item(
        "Suppl. Note 5",
        "robot model and derivation of the controller",
        links=("model/index.md",),
        verdict=AGREES,
        held_by=(MOMENTUM, "tests/parity/test_dynamics_pinocchio.py::test_the_whole_state_agrees"),
    ),
    Item("Suppl. Note 6", "jets away from the body", "along"),
    Claim(
        "clearance",
        "Discussion, Suppl. Note 6",
        "In flight the jets stay as far as possible from the robot's surfaces",
        judges.clearance,
        ("study along",),
    ),
)

OTHER_ROWS: Sequence[Row] = (
    Item("beyond", "loss curves", "training", made_by=TRAINING),
    Item("beyond", "the wind from the wrench", "wind_from_wrench", ("observer.md#the-wind-from-the-wrench",)),
    Claim(
        "wind_estimate",
        "ours",
        "The wind is known to 1.5 m/s above 6 m/s, its 90 % interval covers 85 to 95 %",
        judges.wind_estimate,
        ("study wind_observer",),
    ),
)

OURS = "Beyond the paper"
SECTIONS: Mapping[str, Sequence[Row]] = {
    "Figures": FIGURE_ROWS,
    "Equations": EQUATION_ROWS,
    "Numbers of the text": NUMBER_ROWS,
    "Supplement": SUPPLEMENT_ROWS,
    OURS: OTHER_ROWS,
}


@cache
def sections() -> Mapping[str, Sequence[Item]]:
    """Return the table without studies that are absent, with all other figures and sweeps as items beyond the paper."""
    found: dict[str, list[Item]] = {title: [] for title in SECTIONS}
    for title, rows in SECTIONS.items():
        for item in _items(rows):
            claims = [claim for claim in item.claims if all(map(_is_here, claim.commands))]
            if item.figure in ("", *FIGURES, *SWEEPS) and (claims or not item.claims):
                made_by = tuple(filter(_is_here, item.made_by))
                shows = item.shows or _title(item.figure)
                found[title].append(replace(item, shows=shows, claims=claims, made_by=made_by))
    shown = {item.figure for items in found.values() for item in items}
    others = [
        name for name in (*(name for name in FIGURES if not FIGURES[name].is_of_any), *SWEEPS) if name not in shown
    ]
    found[OURS] += [Item("beyond", _title(name), name) for name in others]
    waiting = set(SWEEPS)
    for items in found.values():
        for place, item in enumerate(items):
            if item.figure in waiting:
                waiting.remove(item.figure)
                items[place] = replace(item, claims=[*item.claims, *_of_sweep(item.figure)])
    return found


def _of_sweep(name: str) -> Iterator[Claim]:
    """Yield the claims in the file of a sweep."""
    for claim in claims.of_sweep(name):
        judge = partial(claims.judge_claim, name, claim)
        yield Claim(claim.key, "ours", claim.states, judge, (f"sweep {name}",), is_of_sweep=True)


def _items(rows: Sequence[Row]) -> Sequence[Item]:
    """Return every item with the claims below it."""
    items: list[Item] = []
    for row in rows:
        if isinstance(row, Item):
            items.append(row)
        else:
            items[-1] = replace(items[-1], claims=(*items[-1].claims, row))
    return items


def all_items() -> list[Item]:
    """Return the items of all sections, in order."""
    return [item for items in sections().values() for item in items]


def all_claims() -> dict[str, Claim]:
    """Return all claims by key, in order."""
    return {claim.key: claim for item in all_items() for claim in item.claims}


def commands(*, ours: bool) -> list[str]:
    """Return the commands that make what the table judges, each once; with `ours`, also what is beyond the paper.

    Every flight and every sweep is a command of its own. One that needs more than is shipped, data or OpenFOAM, becomes
    a comment.
    """
    whole_table = [(title, item) for title, items in sections().items() for item in items]
    items = [item for title, item in whole_table if ours or (title != OURS and not _is_out_of_reach(item))]
    return list(dict.fromkeys(command for item in items for command in _without_drawing(item.commands)))


def _is_out_of_reach(item: Item) -> bool:
    return not item.claims and item.verdict is not None and item.verdict.kind is Kind.OUT_OF_REACH


def _without_drawing(commands: Sequence[str]) -> list[str]:
    """Return the commands without the drawing, as comments if they need what is not here."""
    made = [command for command in commands if not command.startswith("jax-aero figures")]
    lacks = "data" if any(command.startswith("jax-aero data import") for command in made) else ""
    if not shutil.which("simpleFoam") and any(command.startswith("jax-aero cfd") for command in made):
        lacks = "OpenFOAM"
    return [f"# needs {lacks} that is not here: {command}" for command in made] if lacks else each(made)


def _is_here(command: str) -> bool:
    word, *names = command.split()
    return word != "study" or names[0] in studies.names()


def _title(figure: str) -> str:
    """Return what a figure shows, or the title of a sweep."""
    if figure in FIGURES:
        return FIGURES[figure].shows
    title: str = tomllib.loads(places.find("sweeps", figure).read_text(encoding="utf-8"))["title"]
    return title

"""Claims that follow from committed files alone: robot, engines, tables of tunnel and CFD.

Each function returns the measurement and the verdict.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from experiments import battery as choice
from experiments.report.findings import Judged, in_parts, judge, judge_range, out_of_reach
from jax_aero import rust
from jax_aero.base import tables
from jax_aero.base.places import CONFIGS, ROBOT

NETWORK = CONFIGS / "aero" / "networks" / "default.json"
GRAVITY = 9.81

AIR_DENSITY, AIR_VISCOSITY = 1.225, 1.8e-5
"""Density [kg/m³] and viscosity [kg/(m s)] in the sphere and cylinder model of the published controller."""
SPEED_OF_SOUND = 340.3
"""Speed of sound at sea level in the standard atmosphere [m/s]."""
TUNNEL_SECTION = (4.0, 3.84)
"""Width and height of the low-turbulence test section [m]. Source: paper, Methods."""
TUNNEL_SPEED = 17.0
"""Speed in the tests of flight postures [m/s]."""
ERGAL_STRENGTH = 572.0
"""Ultimate tensile strength of aluminium 7075-T6 ("Ergal") [MPa]. Source: MIL-HDBK-5, bar; lower for other tempers."""
STRESSES = {"jetpack": 57.0, "forearm": 77.0}
"""Stresses that the paper computes by finite elements [MPa]."""


def table(name: str) -> dict[str, Any]:
    """Read a TOML file of `configs`."""
    return tables.read(CONFIGS / name)


def robot() -> dict[str, Any]:
    """Return the robot's own file."""
    return table("robot/ironcub_mk1.toml")


def steady_thrust(engine: Mapping[str, float], throttle: float) -> float:
    """Return the steady thrust [N] of M32 at a throttle [%]; NaN if there is none."""
    v = throttle * (1.0 + engine["b_uu"] * throttle)
    a, b, c = engine["k_tt"], engine["k_t"] + engine["b_t"] * v, engine["c"] + engine["b_u"] * v
    inside = b * b - 4.0 * a * c
    # Root of a quadratic; for k_tt < 0 the greater root is the stable one, where more thrust decreases acceleration.
    return (-b - math.sqrt(inside)) / (2.0 * a) if inside >= 0.0 else math.nan


def silhouette() -> float:
    """Return an upper bound of the links' projected area [m²], independent of their attitude.

    A cylinder's is `d l sin α + (π/4) d² cos α`, at most the root of the sum of squares; links do not hide each other.
    """
    area = 0.0
    for link in robot()["aero_links"]:
        d, length = link["diameter"], link["length"]
        disc = 0.25 * math.pi * d * d
        area += disc if link.get("is_sphere") else math.hypot(d * length, disc)
    return area


def mass() -> Judged:
    """Judge the robot's mass."""
    found = rust.Robot(str(ROBOT)).mass
    return f"{found:.2f} kg in the model", judge_range(found, 43.25, 43.35, "kg")


def added_mass() -> Judged:
    """Judge the mass that the conversion to a flying robot added."""
    return "the model lumps engines, jetpack and forearms into their links", out_of_reach(
        "no model of iCub v2.7 is here"
    )


def lift() -> Judged:
    """Judge whether the jets can carry 40 kg."""
    chest = [jet["thrust_max"] for jet in robot()["jets"] if "chest" in jet["name"]]
    return f"{len(chest)} chest jets, {sum(chest):.0f} N, carry {sum(chest) / GRAVITY:.1f} kg", (
        judge(sum(chest) > 40.0 * GRAVITY > max(chest), "one would do, or two do not")
    )


def chest_engine() -> Judged:
    """Judge thrust and consumption of the P220."""
    jet = next(jet for jet in robot()["jets"] if jet["engine"] == "P220")
    steady = steady_thrust(robot()["engines"]["P220"], 100.0)
    burnt = table("tables/fuel.toml")[jet["name"]]["consumption"][1]
    text = (
        f"limit {jet['thrust_max']:.0f} N ({jet['thrust_max'] / GRAVITY:.1f} kg), steady at 100 % throttle "
        f"{steady:.1f} N ({steady / GRAVITY:.1f} kg), {burnt:g} l/min"
    )
    thrust = judge(abs(jet["thrust_max"] / GRAVITY - 22.0) < 0.5)
    consumption = judge(abs(burnt / 0.6 - 1.0) < 0.05, f"{100.0 * (burnt / 0.6 - 1.0):+.0f} %")
    return text, in_parts(f"{thrust} on thrust; consumption {consumption}", thrust, consumption)


def arm_engine() -> Judged:
    """Judge the engines of the arms."""
    names = sorted({jet["engine"] for jet in robot()["jets"] if "arm" in jet["name"]})
    steady = {name: steady_thrust(robot()["engines"][name], 100.0) for name in ("P100", "P160")}
    text = f"{', '.join(names)}; steady at 100 %: " + ", ".join(f"{n} {t:.1f} N" for n, t in steady.items())
    return text, judge(names == ["P100"], "the published flights put P160 there, so do ours")


def battery() -> Judged:
    """Judge the battery of the engine choice, in two interpretations."""
    printed, other = choice.Choice().battery(), choice.Choice().battery(1.0)
    text = f"{printed:.2f} kg from the printed 13 kW for 15 kg; {other:.2f} kg from 1 kW per kg of thrust"
    off = printed - choice.PAPER_BATTERY
    return text, judge(abs(off) < 0.005, f"{off:+.2f} kg; the printed figure belongs to 1 kW per kg")


def fuel() -> Judged:
    """Judge the fuel of the engine choice."""
    found = choice.Choice().fuel()
    return f"{found:.2f} kg, burnt on the way", judge_range(found, 4.605, 4.615, "kg")


def stress() -> Judged:
    """Compute the diameter of a bar with the stress that the paper gives for the forearm."""
    thrust = max(jet["thrust_max"] for jet in robot()["jets"] if "arm" in jet["name"])
    offset = forearm_offset()
    # σ = M / W with W = π d³/32 of a solid round bar, and M = T a with the arm a of the thrust about the elbow's axis.
    diameter = (32.0 * thrust * offset / (math.pi * 1e6 * STRESSES["forearm"])) ** (1.0 / 3.0)
    text = (
        f"{thrust:.0f} N at {1e3 * offset:.0f} mm from the elbow's axis bend by {thrust * offset:.1f} N m: "
        f"{STRESSES['forearm']:.0f} MPa in a solid round bar of {1e3 * diameter:.0f} mm"
    )
    return text, out_of_reach("sections of jetpack and forearm are not public; the bar is of a plausible size")


def forearm_offset() -> float:
    """Return the distance of an arm jet's axis from the origin of the elbow [m].

    Joint angles do not matter, since a fixed joint of the URDF attaches the jet to the body that the elbow moves.
    """
    jet = next(jet for jet in robot()["jets"] if jet["name"].startswith("l_arm"))
    _, (rotation, position) = rust.Robot(ROBOT).links()[jet["frame"]]
    return float(np.linalg.norm(np.cross(position, rotation @ np.array(jet["axis"]))))


def strength() -> Judged:
    """Judge the safety factor of the weakest material."""
    factors = {part: ERGAL_STRENGTH / value for part, value in STRESSES.items()}
    text = f"{ERGAL_STRENGTH:.0f} MPa (7075-T6) over the paper's stresses: " + ", ".join(
        f"{part} {factor:.1f}" for part, factor in factors.items()
    )
    return text, judge(min(factors.values()) >= 5.0, f"{min(factors.values()):.1f}")


def ranges() -> Judged:
    """Judge the angles of the tests in the tables."""
    tunnel = table("tables/wind_tunnel.toml")
    beta = [angle for test in tunnel["hovering"] for angle in test["beta_deg"]]
    alpha = [angle for test in tunnel["flight"] for angle in test["alpha_deg"]]
    text = f"hovering β {min(beta)}° to {max(beta)}°, flight α {min(alpha)}° to {max(alpha)}°"
    same = (min(beta), max(beta), min(alpha), max(alpha)) == (-90, 90, 25, 65)
    return text, judge(same, "other angles")


def campaign() -> Judged:
    """Judge which part of the campaign the tables contain."""
    tunnel = table("tables/wind_tunnel.toml")
    tests = [*tunnel["hovering"], *tunnel["flight"]]
    points = sum(len(test["cda"]) for test in tests)
    text = (
        f"{points} measurements of {len(tests)} tests are in `configs/tables/wind_tunnel.toml`: those of Fig. 2 and 3"
    )
    return text, out_of_reach("the whole campaign is public (BSD-3-Clause) and not shipped here")


def blockage() -> Judged:
    """Judge the greatest share of the test section that the robot can block."""
    area, section = silhouette(), TUNNEL_SECTION[0] * TUNNEL_SECTION[1]
    share = area / section
    text = (
        f"at most {100.0 * share:.1f} %: the links' largest projections, {area:.2f} m² in all, over {section:.1f} m²; "
        "without support"
    )
    return text, judge_range(100.0 * share, 0.0, 3.0, "%")


def reynolds() -> Judged:
    """Judge the Reynolds numbers of the links."""
    sizes = [link["diameter"] for link in robot()["aero_links"]]
    low, high = (AIR_DENSITY * TUNNEL_SPEED * size / AIR_VISCOSITY for size in (min(sizes), max(sizes)))
    text = f"{low:.1e} to {high:.1e} over the links' diameters at {TUNNEL_SPEED:g} m/s"
    return text, out_of_reach("Note 1's reference length is not public to us")


def mach() -> Judged:
    """Judge the Mach number of the fastest test."""
    speed = max(test["speed"] for test in table("tables/wind_tunnel.toml")["hovering"])
    number = speed / SPEED_OF_SOUND
    return f"{number:.3f} at {speed:g} m/s, density changes by {50.0 * number * number:.2f} %", (
        judge(number < 0.3, "compressible")
    )


def boundary() -> Judged:
    """Judge whether the printed turbulence at the boundary is self-consistent."""
    k, epsilon, omega = 2.89e-6, 0.0236e-6, 8.17
    intensity = math.sqrt(2.0 * k / 3.0) / TUNNEL_SPEED
    text = (
        f"k, ε, ω as printed: ε/k = {epsilon / k:.5f} 1/s, {omega * k / epsilon:.0f} times less than the printed ω; "
        f"intensity at {TUNNEL_SPEED:g} m/s {100.0 * intensity:.4f} %, below the tunnel's 0.1 %"
    )
    factor = f"the printed ε and ω are a factor of {omega * k / epsilon:.0f} apart; results hardly depend on either"
    return text, judge(math.isclose(epsilon, omega * k, rel_tol=0.1), factor)


def postures() -> Judged:
    """Compute the number of simulations in the dataset from its own factors."""
    known = table("tables/postures.toml")
    count = 24 * 19 * 18
    text = (
        f"24 × 19 × 18 = {count}; `configs/tables/postures.toml` names {len(known['free_stream'])} postures of "
        f"the table that our fits use and {len(known['listed']) + len(known['rest'])} others of the campaign's list"
    )
    return text, judge(abs(count - 8500) < 500).but(
        f" with 24 configurations; 30, as printed elsewhere, would be {30 * 19 * 18}"
    )


def taps() -> Judged:
    """Judge the number of pressure taps by that of the public map of the scanners' ports."""
    known = table("tables/pressure_taps.toml")["mk1"]
    placed = sum("position" in tap for tap in known.values())
    text = f"{len(known)} taps in the public map of ports, {placed} of them with a position"
    return text, judge(len(known) == 124, f"by {124 - len(known)}")


def cells() -> Judged:
    """Judge the mesh reduction."""
    reduction = 1.0 - 0.33 / 9.53
    sizes = sorted({run["elements"] for run in table("tables/cfd_tunnel.toml")["run"]})
    text = f"{100.0 * reduction:.1f} % from 9.53e6 to 0.33e6; tables hold {', '.join(f'{size:.2g}' for size in sizes)}"
    return text, judge_range(100.0 * reduction, 96.0, 97.5, "%")


def _errors() -> tuple[float, float, float, float]:
    training = json.loads(NETWORK.read_text(encoding="utf-8"))["training"]
    errors, baselines = training["errors"], training["baselines"]
    axisymmetric = baselines["grouped"]["axisymmetric, signed"]
    return errors["random"]["mse"], errors["grouped"]["mse"], baselines["random"]["nearest"], axisymmetric


def network_error() -> Judged:
    """Judge the network's error on unseen data."""
    random, grouped, nearest, _ = _errors()
    text = (
        f"{random:.1e} m⁴ on random rows, where the nearest training rows alone give {nearest:.1e}; "
        f"{grouped:.1e} on whole postures"
    )
    on_random, on_postures = (judge(error <= 3e-6, f"{error / 3e-6:.1f} times") for error in (random, grouped))
    return text, in_parts(f"{on_random} on random rows; on whole postures {on_postures}", on_random, on_postures)


def order_of_magnitude() -> Judged:
    """Compare the axisymmetric model with the network."""
    _, grouped, _, axisymmetric = _errors()
    ratio = axisymmetric / grouped
    return f"{axisymmetric:.1e} over {grouped:.1e} m⁴ on whole postures: {ratio:.1f} times", judge_range(
        ratio, 5.0, 20.0, ""
    )


def network_size() -> Judged:
    """Judge the size of the paper's network."""
    hidden = table("training/paper.toml")["network"]["hidden"]
    text = f"`configs/training/paper.toml`: {len(hidden)} layers of {hidden[0]}, 22 inputs, 39 outputs"
    same = list(hidden) == 9 * [1048]
    return text, judge(same, "its text says 1048, its code 1024, as ours; what flies is a smaller network of ours")


def misprint() -> Judged:
    """Judge the coefficients of Suppl. Table 2, in comparison with the published controller's."""
    sets = robot()["coefficients"]
    printed, refit = (sets[name]["head"]["cda"][4] for name in ("published", "refit"))
    families = len(sets["published"])
    text = (
        f"{families} families; the head's w₄ is {printed:g} in the published file, {refit:g} from a refit of the "
        "public table"
    )
    same = math.isclose(printed, refit, rel_tol=0.5)
    return text, judge(same, "one coefficient is a misprint; the supplement's own table is not public to us")


def robot_table() -> list[list[str]]:
    """Return the aerodynamic links for Fig. 1, with the sizes of their cylinders or spheres."""
    rows = [["link", "form", "diameter [mm]", "length [mm]", "coefficients of"]]
    for link in robot()["aero_links"]:
        form = "sphere" if link.get("is_sphere") else "cylinder"
        rows.append(
            [link["name"], form, f"{1e3 * link['diameter']:.0f}", f"{1e3 * link['length']:.0f}", link["family"]]
        )
    return rows


def engine_table() -> list[list[str]]:
    """Return Suppl. Table 1: data of the identified engines, and their positions."""
    jets = robot()["jets"]
    rows = [["engine", "jets of the published flights", "limit [N]", "rest at 50, 100, 120 % throttle [N]"]]
    for name, engine in robot()["engines"].items():
        where = [jet["name"] for jet in jets if jet["engine"] == name]
        limit = max((jet["thrust_max"] for jet in jets if jet["engine"] == name), default=math.nan)
        steady = (steady_thrust(engine, throttle) for throttle in (50.0, 100.0, 120.0))
        rows.append(
            [
                name,
                ", ".join(where) or "none",
                "" if math.isnan(limit) else f"{limit:.0f}",
                ", ".join("none" if math.isnan(value) else f"{value:.1f}" for value in steady),
            ]
        )
    return rows


def coefficient_table() -> list[list[str]]:
    """Return Suppl. Table 2: the printed coefficients, and ours from the public table."""
    rows = [["family", "set", "w₀", "w₁", "w₂", "w₃", "w₄", "w₅"]]
    for family in robot()["coefficients"]["published"]:
        for name in ("published", "refit"):
            areas = robot()["coefficients"][name][family]
            rows.append([family, name, *(f"{value:g}" for value in areas["cda"]), f"{areas['cna']:g}"])
    return rows


def mesh_table() -> list[list[str]]:
    """Return the public part of Suppl. Table 3: sizes of the meshes of flight30."""
    rows = [["mesh", "cells", "turbulence models", "attitudes"]]
    runs = [run for run in table("tables/cfd_tunnel.toml")["run"] if run["posture"] == "flight30"]
    for name in sorted({run["mesh"] for run in runs}):
        own = [run for run in runs if run["mesh"] == name]
        models = ", ".join(run["turbulence"] for run in own)
        rows.append([name, f"{own[0]['elements']:.3g}", models, str(len(own[0]["alpha_deg"]))])
    return rows

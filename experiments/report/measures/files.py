"""Measures of committed files alone: robot, engines, network, tables of tunnel and CFD."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from experiments.report.measures import Measured, one
from jax_aero import rust
from jax_aero.base import tables
from jax_aero.base.network_inputs import block_sizes
from jax_aero.base.parquet import read_table
from jax_aero.base.places import CONFIGS, ROBOT
from jax_aero.data import tables as tunnel
from jax_aero.data.battery import PAPER_BATTERY, Choice
from jax_aero.data.tables import CFD, EPSILON, OMEGA, TUNNEL

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
CAMPAIGN, TUNNEL_POSTURES = "exp_2022_11_03", ("free_stream", "tunnel", "tunnel_hovering")
"""The campaign of the paper's figures, and the tables that have its postures."""
FLOWN = "compact"
"""Training of the network that flies."""
FOLLOWING = (
    ("standing_front_2", "l_ankle_pitch"),
    ("standing_lateral", "l_hip_roll"),
    ("standing_lateral", "l_ankle_roll"),
)
"""Recorded runs of Fig. 6, and the joints by which the paper says that the robot moves in them."""
RELIABLE_SPEED = 15.0
"""Below it the paper suspects the balance's calibration [m/s]."""
HIGH_SIDESLIP = 70.0
"""Sideslip from which on the strut stands in the wind, beside the robot [deg]."""


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


def forearm_offset() -> float:
    """Return the distance of an arm jet's axis from the origin of the elbow [m].

    Joint angles do not matter, since a fixed joint of the URDF attaches the jet to the body that the elbow moves.
    """
    jet = next(jet for jet in robot()["jets"] if jet["name"].startswith("l_arm"))
    _, (rotation, position) = rust.Robot(ROBOT).links()[jet["frame"]]
    return float(np.linalg.norm(np.cross(position, rotation @ np.array(jet["axis"]))))


def jets() -> Measured:
    """Measure the robot's mass, thrusts and engines."""
    known, engines, mass = robot()["jets"], robot()["engines"], rust.Robot(str(ROBOT)).mass
    large = next(jet for jet in known if jet["engine"] == "P220")
    steady = {name: steady_thrust(engines[name], 100.0) for name in ("P100", "P160", "P220")}
    burnt = table("tables/fuel.toml")[large["name"]]["consumption"][1]
    return one(
        mass=mass,
        weight=mass * GRAVITY,
        needed=math.ceil(mass * GRAVITY / steady["P220"]),
        limit=large["thrust_max"],
        limit_kg=large["thrust_max"] / GRAVITY,
        **steady,
        P220_kg=steady["P220"] / GRAVITY,
        burnt=burnt,
        burnt_more=100.0 * (burnt / 0.6 - 1.0),
        arm_engines=", ".join(sorted({jet["engine"] for jet in known if "arm" in jet["name"]})),
    )


def forearm() -> Measured:
    """Measure stresses of the interfaces, and the diameter of a bar with the stress that the paper gives."""
    thrust = max(jet["thrust_max"] for jet in robot()["jets"] if "arm" in jet["name"])
    offset, stress = forearm_offset(), STRESSES["forearm"]
    # σ = M / W with W = π d³/32 of a solid round bar, and M = T a with the arm a of the thrust about the elbow's axis.
    diameter = (32.0 * thrust * offset / (math.pi * 1e6 * stress)) ** (1.0 / 3.0)
    factors = {part: ERGAL_STRENGTH / value for part, value in STRESSES.items()}
    return one(
        thrust=thrust,
        arm_mm=1e3 * offset,
        moment=thrust * offset,
        stress=stress,
        diameter_mm=1e3 * diameter,
        strength=ERGAL_STRENGTH,
        weakest=min(factors.values()),
        **factors,
    )


def energy() -> Measured:
    """Measure battery, in two interpretations, and fuel of the engine choice."""
    battery = Choice().battery()
    return one(battery=battery, other=Choice().battery(1.0), off=battery - PAPER_BATTERY, fuel=Choice().fuel())


def campaign() -> Measured:
    """Measure the numbers of the tunnel's flow around the robot."""
    section, sizes = TUNNEL_SECTION[0] * TUNNEL_SECTION[1], [link["diameter"] for link in robot()["aero_links"]]
    low, high = (AIR_DENSITY * TUNNEL_SPEED * size / AIR_VISCOSITY for size in (min(sizes), max(sizes)))
    taps = table("tables/pressure_taps.toml")["mk1"]
    return one(
        area=silhouette(),
        section=section,
        blocked=100.0 * silhouette() / section,
        reynolds_low=low,
        reynolds_high=high,
        speed=TUNNEL_SPEED,
        taps=len(taps),
        placed=sum("position" in tap for tap in taps.values()),
        taps_missing=124 - len(taps),
    )


def tests_of_campaign() -> Measured:
    """Count tests and postures in the public list of the tunnel's campaign, and points in the tables of the figures."""
    (campaign,) = (one for one in table("tables/tunnel_tests.toml")["campaign"] if one["name"] == CAMPAIGN)
    tests = {**campaign["hovering"], **campaign["flight"]}
    symmetric = list(filter(_is_symmetric, tests))
    shown = table(f"tables/{TUNNEL}")
    return one(
        tests=sum(map(len, tests.values())),
        symmetric=len(symmetric),
        named=", ".join(symmetric),
        others=len(tests) - len(symmetric),
        points=sum(len(test["cda"]) for test in (*shown["hovering"], *shown["flight"])),
    )


def _is_symmetric(posture: str) -> bool:
    known = table("tables/postures.toml")
    turned = next(known[group][posture] for group in TUNNEL_POSTURES if posture in known[group])
    angles: dict[str, float] = dict(zip(known["joints"], turned, strict=True))
    sides = ((angle, angles[f"r{name[1:]}"]) for name, angle in angles.items() if name.startswith("l_"))
    return all(left == right for left, right in sides) and angles["torso_roll"] == angles["torso_yaw"] == 0.0


def ranges() -> Measured:
    """Measure the angles [deg] of the tests in the tables of the figures: sideslip by speed, attack by posture."""
    tests = table(f"tables/{TUNNEL}")
    drag = tunnel.hovering_drag(tests)
    cases = {f"hovering, {speed:g} m/s": {"beta": [min(curve), max(curve)]} for speed, curve in drag.items()}
    cases |= {test["posture"]: {"alpha": [min(test["alpha_deg"]), max(test["alpha_deg"])]} for test in tests["flight"]}
    return Measured({case: {"angles": next(iter(ends.values())), **ends} for case, ends in cases.items()})


def simulations() -> Measured:
    """Measure cells and number of simulations: the rows of a posture in the table that our fits use."""
    training = json.loads(NETWORK.read_text(encoding="utf-8"))["training"]
    rows, postures = training["rows"] // 2, len(training["errors"]["grouped"]["by_posture"])  # half are mirror images
    sizes = sorted({run["elements"] for run in table("tables/cfd_tunnel.toml")["run"]})
    return one(
        rows=rows,
        postures=postures,
        attitudes=rows / postures,
        of_24=24 * rows / postures,
        of_30=30 * rows / postures,
        reduction=100.0 * (1.0 - 0.33e6 / max(sizes)),
        finest=max(sizes),
        sizes=", ".join(f"{size:.2g}" for size in sizes),
    )


def network() -> Measured:
    """Measure size, training and errors of the network that flies, beside the axisymmetric model, and coefficients.

    Errors are sums over the components of the squared error of a row, averaged over rows [m⁴], as the paper's.
    """
    card = json.loads(NETWORK.read_text(encoding="utf-8"))
    training, hidden, sets = card["training"], card["architecture"]["hidden"], robot()["coefficients"]
    outputs = 3 * len(card["inputs"]["links"])
    # A card from before errors were summed has means over the components.
    factor = outputs if training["error_unit"].startswith("m^4, mean over") else 1
    sizes = block_sizes(len(card["inputs"]["joints"]), len(card["inputs"]["links"]))
    inputs = sum(sizes[block] for block in card["inputs"]["features"])
    errors, baselines = (
        {
            split: {name: factor * value for name, value in of_split.items() if isinstance(value, float)}
            for split, of_split in of.items()
        }
        for of in (training["errors"], training["baselines"])
    )
    random, grouped = (errors[split]["mse"] for split in ("random", "grouped"))
    published, signed = baselines["random"]["axisymmetric, published"], baselines["grouped"]["axisymmetric, signed"]
    printed, refit = (sets[name]["head"]["cda"][4] for name in ("published", "refit"))
    return one(
        random=random,
        random_times=random / 3e-6,
        nearest=baselines["random"]["nearest"],
        grouped=grouped,
        grouped_times=grouped / 3e-6,
        axisymmetric=published,
        ratio=published / random,
        root=math.sqrt(published / random),
        ratio_ours=signed / grouped,
        joints=len(card["inputs"]["joints"]),
        inputs=inputs,
        layers=len(hidden),
        width=max(hidden),
        outputs=outputs,
        epochs=training["epochs"],
        dropout=table(f"training/{FLOWN}.toml")["training"]["dropout"],
        share=table(f"training/{FLOWN}.toml")["validation"]["fraction"],
        families=len(sets["published"]),
        printed=printed,
        refit=refit,
        misprint=max(printed / refit, refit / printed),
    )


def tunnel_speeds() -> Measured:
    """Measure how far drag areas at several speeds differ over the sideslips common to all [%].

    At the reliable speeds below high sideslips, and at all speeds from no sideslip on, where no test is doubtful: below
    and at high sideslips.
    """
    curves = tunnel.hovering_drag(tunnel.read(TUNNEL))
    common = sorted(set.intersection(*map(set, curves.values())))

    def greatest(low: float, high: float, slowest: float = 0.0) -> float:
        chosen = [curve for speed, curve in curves.items() if speed > slowest]
        return float(_spread([[curve[beta] for beta in common if low <= beta < high] for curve in chosen]).max())

    low, high = greatest(0.0, HIGH_SIDESLIP), greatest(HIGH_SIDESLIP, 91.0)
    return one(fast=greatest(-90.0, HIGH_SIDESLIP, RELIABLE_SPEED), low=low, high=high, ratio=high / low)


def tunnel_postures() -> Measured:
    """Measure how far the drag areas of flight postures differ [%], at most and at least over the angles of attack."""
    postures = tunnel.read(TUNNEL)["flight"]
    apart, angles = _spread([posture["cda"] for posture in postures]), postures[0]["alpha_deg"]
    return one(percent=float(apart.max()), at=angles[apart.argmax()], least=float(apart.min()))


def efficiency() -> Measured:
    """Measure the greatest lift over drag of the symmetric flight postures."""
    tests = [test for test in tunnel.read(TUNNEL)["flight"] if _is_symmetric(test["posture"])]
    ratios = {test["posture"]: float(np.max(np.divide(test["cla"], test["cda"]))) for test in tests}
    return one(greatest=max(ratios.values()), each=", ".join(f"{name} {ratio:.2f}" for name, ratio in ratios.items()))


def _spread(values: list[list[float]]) -> tunnel.Array:
    """Return (largest − smallest)/mean over the rows [%]."""
    areas = np.array(values)
    ratio: tunnel.Array = 100.0 * (areas.max(axis=0) - areas.min(axis=0)) / areas.mean(axis=0)
    return ratio


def cfd(turbulence: str = OMEGA, mesh: str = tunnel.FINEST) -> Measured:
    """Measure the errors of the CFD of flight30 against the tunnel [%]."""
    record, run = _flight30(mesh, turbulence)
    keys = ("cda", "cla", "csa")
    size, measured = (
        np.linalg.norm([areas(key) for key in keys], axis=0)
        for areas in (lambda key: run[key], lambda key: tunnel.measured_area(record, key, run))
    )
    drag = {model: 100.0 * tunnel.drag_error(*_flight30(tunnel.FINEST, model)) for model in (OMEGA, EPSILON)}
    return one(
        drag=drag[turbulence],
        above_omega=drag[turbulence] - drag[OMEGA],
        above_epsilon=drag[turbulence] - drag[EPSILON],
        size=100.0 * float(np.mean(np.abs(size / measured - 1.0))),
    )


def meshes_apart() -> Measured:
    """Measure how far the forces on the public meshes of flight30 are from the tunnel's [%]: in all, drag, lift."""
    by_mesh = {}
    for mesh in sorted({run["mesh"] for run in tunnel.read(CFD)["run"]}):
        record, run = _flight30(mesh, OMEGA)
        known = np.array([tunnel.measured_area(record, key, run) for key in ("cda", "cla", "csa")])
        apart = np.array([run[key] for key in ("cda", "cla", "csa")]) - known
        magnitude = np.linalg.norm(known, axis=0)
        sizes = {"force": np.abs(np.linalg.norm(known + apart, axis=0) / magnitude - 1.0)}
        sizes |= {"vector": np.linalg.norm(apart, axis=0) / magnitude}
        sizes |= {"drag": np.abs(apart[0] / known[0]), "lift": np.abs(apart[1] / known[1])}
        by_mesh[mesh] = {name: 100.0 * float(values.max()) for name, values in sizes.items()}
    return Measured(by_mesh)


def meshes_within() -> Measured:
    """Measure the greatest error of the force's magnitude on the reduced public meshes of flight30, and the finest.

    In percent of the measured force.
    """
    greatest = {}
    for mesh in sorted({run["mesh"] for run in tunnel.read(CFD)["run"]}):
        record, run = _flight30(mesh, OMEGA)
        size, measured = (
            np.linalg.norm([areas(key) for key in ("cda", "cla", "csa")], axis=0)
            for areas in (lambda key: run[key], lambda key: tunnel.measured_area(record, key, run))  # noqa: B023
        )
        greatest[mesh] = 100.0 * float(np.abs(size / measured - 1.0).max())
    finest = greatest.pop(tunnel.FINEST)
    return Measured({mesh: {"error": of, "finest": finest, "beyond": of - finest} for mesh, of in greatest.items()})


def with_support() -> Measured:
    """Measure what is public of the simulations with the support on the finest mesh."""
    runs = [run for run in tunnel.read(CFD)["run"] if run["mesh"] == tunnel.FINEST]
    postures = sorted({run["posture"] for run in runs})
    return one(
        runs=sum(len(run["alpha_deg"]) for run in runs),
        postures=len(postures),
        named=" and ".join(postures),
        models=len({run["turbulence"] for run in runs}),
    )


def recorded_torques() -> Measured:
    """Measure how the measured torques of the joints that move follow the desired ones, in the recorded runs of Fig. 6.

    Correlation, mean difference [N m], and its share of the range of the desired torque [%].
    """
    cases = {}
    for run, joint in FOLLOWING:
        rows = read_table(CONFIGS / "records" / f"{run}.parquet")
        desired, measured = (rows[f"tau_{of}/{joint}"].to_numpy() for of in ("des", "meas"))
        offset, extent = float((measured - desired).mean()), float(np.ptp(desired))
        cases[f"{run.split('_')[1]} wind, {joint.removeprefix('l_').replace('_', ' ')}"] = {
            "correlation": float(np.corrcoef(desired, measured)[0, 1]),
            "offset": offset,
            "range": extent,
            "percent": 100.0 * abs(offset) / extent,
        }
    return Measured(cases)


def _flight30(mesh: str, turbulence: str) -> tuple[tunnel.Table, tunnel.Table]:
    record = tunnel.flight(tunnel.read(TUNNEL), "flight30")
    return record, tunnel.run_of(tunnel.read(CFD)["run"], mesh, turbulence)


# --- tables of the documentation ------------------------------------------------------------------------------------


def links() -> list[list[str]]:
    """Return the aerodynamic links for Fig. 1, with the sizes of their cylinders or spheres."""
    return [
        ["link", "form", "diameter [mm]", "length [mm]", "coefficients of"],
        *(
            [
                link["name"],
                "sphere" if link.get("is_sphere") else "cylinder",
                f"{1e3 * link['diameter']:.0f}",
                f"{1e3 * link['length']:.0f}",
                link["family"],
            ]
            for link in robot()["aero_links"]
        ),
    ]


def engines() -> list[list[str]]:
    """Return Suppl. Table 1: data of the identified engines, and their positions."""
    rows = [["engine", "jets of the published flights", "limit [N]", "rest at 50, 100, 120 % throttle [N]"]]
    for name, engine in robot()["engines"].items():
        limits = {jet["name"]: jet["thrust_max"] for jet in robot()["jets"] if jet["engine"] == name}
        steady = [steady_thrust(engine, throttle) for throttle in (50.0, 100.0, 120.0)]
        shown = ", ".join("none" if math.isnan(value) else f"{value:.1f}" for value in steady)
        rows.append([name, ", ".join(limits) or "none", f"{max(limits.values()):.0f}" if limits else "", shown])
    return rows


def coefficients() -> list[list[str]]:
    """Return Suppl. Table 2: the printed coefficients, and ours from the public table."""
    rows = [["family", "set", "w₀", "w₁", "w₂", "w₃", "w₄", "w₅"]]
    sets = robot()["coefficients"]
    for family in sets["published"]:
        for name in ("published", "refit"):
            areas = sets[name][family]
            rows.append([family, name, *(f"{value:g}" for value in (*areas["cda"], areas["cna"]))])
    return rows


def meshes() -> list[list[str]]:
    """Return the public part of Suppl. Table 3: sizes of the meshes of flight30."""
    runs = [run for run in table("tables/cfd_tunnel.toml")["run"] if run["posture"] == "flight30"]
    rows = [["mesh", "cells", "turbulence models", "attitudes"]]
    for name in sorted({run["mesh"] for run in runs}):
        own = [run for run in runs if run["mesh"] == name]
        models = ", ".join(run["turbulence"] for run in own)
        rows.append([name, f"{own[0]['elements']:.3g}", models, str(len(own[0]["alpha_deg"]))])
    return rows

"""All items of the paper: the page of the documentation, which `jax-aero figures --index` prints.

`SECTIONS` is the only table of items, except our sweeps, which their files name. Measurements and verdicts come from
the tables of tunnel and CFD and from `docs/claims.json`, which
`jax-aero report --claims docs/claims.json` writes from results.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from jax_aero import places
from paper_figs import tunnel
from paper_figs.figures import FIGURES, SWEEPS

DOCS = places.HOME / "docs"
CLAIMS = DOCS / "claims.json"
GALLERY = "img/gallery"
HEADINGS = ("item", "ours", "command", "paper", "measured", "verdict")


@dataclass(frozen=True)
class Item:
    """One item of the paper, or one of this project beyond it."""

    name: str
    shows: str
    figure: str = ""
    """Name of a figure or sweep of `paper_figs`."""
    links: tuple[str, ...] = ()
    """Pages of `docs`, and files of the repository."""
    claims: tuple[str, ...] = ()
    """Keys of `docs/claims.json`."""
    tunnel: Callable[[], Sequence[tunnel.Claim]] | None = None
    """Figures from the tables of tunnel and CFD."""
    verdict: str = ""
    """Our verdict, if there is no figure to compare."""
    command: str = ""
    """Command that makes it, if not `jax-aero figures FIGURE`."""


def _tunnel(claims: Callable[..., list[tunnel.Claim]], *, with_cfd: bool) -> Callable[[], list[tunnel.Claim]]:
    def read() -> list[tunnel.Claim]:
        tables = tunnel.read(tunnel.TUNNEL)
        return claims(tables, tunnel.read(tunnel.CFD)["run"]) if with_cfd else claims(tables)

    return read


_NO_MESH = "out of reach: needs the authors' CFD meshes and solutions, which are not public"
_NO_LEVELS = "out of reach: the levels of the paper are not public to us"
_NO_CAD = "out of reach: photographs and CAD of the prototype"
_DATA = "jax-aero data import-cfd --clone DIR --out results/datasets/freestream.nc"
_TRAINING = f"{_DATA}; jax-aero train compact --dataset results/datasets/freestream.nc"

FIGURE_ITEMS: Sequence[Item] = (
    Item("Fig. 1 a, b", "the robot: mass, sizes", links=("#the-robot",), claims=("mass", "added_mass")),
    Item("Fig. 1 c–f", "jetpack and forearm, assembled and exploded", verdict=_NO_CAD),
    Item(
        "Fig. 2 a–c",
        "tunnel, test section, robot on its support, as a drawing",
        "fig2_setup",
        verdict="agrees in its parts; the point where the strut holds the robot is not public",
        command="jax-aero fly test2; jax-aero study pictures; jax-aero figures fig2_setup",
    ),
    Item("Fig. 2 d", "drag by speed", "fig2", tunnel=_tunnel(tunnel.speed_claims, with_cfd=False)),
    Item("Fig. 2 e", "drag by posture", "fig2", tunnel=_tunnel(tunnel.posture_claims, with_cfd=False)),
    Item(
        "Fig. 3 a, b", "CFD compared with the tunnel", "fig3", tunnel=_tunnel(tunnel.turbulence_claims, with_cfd=True)
    ),
    Item(
        "Fig. 3 c–f",
        "surface pressure, streamlines and contours of the flow",
        "cfd_flow",
        ("cfd.md",),
        ("wake_viscosity",),
    ),
    Item("Fig. 3 g, h", "lattice Boltzmann simulation, drag within 1 %", verdict=_NO_MESH),
    Item(
        "Fig. 4 a–c",
        "the network's drag of the head",
        "fig4_network",
        claims=("network_size", "network_error"),
        command=f"{_TRAINING}; jax-aero figures fig4_network",
    ),
    Item(
        "Fig. 4 d, e",
        "the axisymmetric model over the CFD",
        "fig4_fit",
        claims=("order",),
        command=f"{_DATA}; jax-aero data fit-aero freestream; jax-aero figures fig4_fit",
    ),
    Item(
        "Fig. 5 a",
        "the flight, rendered with forces, exhausts and wind",
        "fig5a",
        verdict="agrees",
        command="jax-aero fly test2; jax-aero study pictures; jax-aero figures fig5a",
    ),
    Item("Fig. 5 b–i", "TEST2 and TEST1", "fig5", claims=("test1", "test2")),
    Item(
        "Fig. 5 b–i",
        "TEST4 and the robustness test",
        "fig5_robustness",
        claims=("test4", "robustness", "model_pairs", "asymmetry", "thrusts_alike"),
    ),
    Item(
        "Fig. 6 a–l",
        "ground experiments",
        "fig6",
        ("deviations.md#on-the-ground",),
        ("stands", "against", "ankle_pitch", "rolls", "momentum_rate", "identities", "onset"),
    ),
)

EQUATIONS: Sequence[Item] = (
    Item("Network layer, ReLU", "forward pass", links=("model.md#m23",), verdict="agrees"),
    Item("Mean squared error", "loss", links=("configs/training/paper.toml",), verdict="agrees"),
    Item(
        "Eq. axisymmetric force",
        "drag and normal force of a link",
        links=("model.md#m20",),
        verdict="agrees, with the division by sin α carried out",
    ),
    Item("Eq. conditions 1, 2", "slopes and values at 0° and 180°", links=("model.md#m29",), verdict="agrees"),
    Item("Eq. C_D A, C_N A", "force areas over the angle of attack", links=("model.md#m20",), verdict="agrees"),
    Item("Assumption 1", "no aerodynamic moments on links", links=("model.md#m27",), verdict="agrees"),
    Item("Eq. generalised force", "forces of all links in joint space", links=("model.md#m27",), verdict="agrees"),
    Item("Eq. momentum rate", "centroidal momentum under jets and air", links=("model.md#m56",), verdict="agrees"),
    Item(
        "Eq. second derivative",
        "linear in thrust rates and joint velocities",
        links=("model.md#m55",),
        claims=("lambda",),
    ),
    Item(
        "Eq. QP",
        "thrust rates and joint velocities",
        links=("model.md#m64",),
        verdict="differs: two weights in print, eight tasks in the published code and here",
    ),
    Item("Eq. joint dynamics", "rows of the joints", links=("model.md#m69",), verdict="agrees"),
    Item(
        "Eq. joint accelerations",
        "high-gain law",
        links=("model.md#m68",),
        verdict="differs: s* is the integral of ṡ − ṡ* in the published code and here",
    ),
    Item(
        "Eq. torques",
        "inverse dynamics",
        links=("model.md#m70", "deviations.md#paper-against-its-own-code"),
        verdict="differs: the printed law has M̄⁻¹ for M̄ and contradicts the equation before it",
    ),
)

NUMBERS: Sequence[Item] = (
    Item(
        "Actuators selection",
        "battery against fuel",
        claims=("battery", "fuel"),
        command="jax-aero study engine_choice",
    ),
    Item("Actuators selection", "fuel along flights", "along", claims=("fuel_flown",)),
    Item(
        "Actuators selection",
        "engines",
        links=("#suppl-table-1",),
        claims=("chest_engine", "lift", "arm_engine", "arm_engines"),
    ),
    Item("FEM analysis", "stresses of the interfaces", claims=("stress", "strength")),
    Item(
        "Wind tunnel",
        "extent of the campaign",
        links=("configs/tables/wind_tunnel.toml",),
        claims=("campaign", "ranges"),
    ),
    Item("Wind tunnel facility", "section 4 m × 3.84 m", claims=("blockage",)),
    Item(
        "Wind tunnel facility",
        "balance RUAG 192-6L, error below 0.2 %; 124 pressure taps",
        verdict="out of reach: records of the pressure scanners are not public; those of the balance are, and are used",
    ),
    Item("CFD", "dataset, boundary", links=("configs/tables/postures.toml",), claims=("boundary", "postures")),
    Item("CFD", "104 runs with support", verdict=_NO_MESH),
    Item("CFD", "drag from pressure and from friction", "cfd_flow", ("cfd.md",), ("pressure_share",)),
    Item("Mesh sensitivity", "cells", "supp_mesh", claims=("cells",)),
    Item("TEST3", "baseline, simulated with the network", "suppl7_published", claims=("test3",)),
)

SUPPLEMENT: Sequence[Item] = (
    Item("Suppl. Fig. 1", "finite elements of jetpack and forearm", claims=("stress", "strength")),
    Item("Suppl. Fig. 2", "pressure taps", verdict="out of reach: positions are not public"),
    Item("Suppl. Fig. 3, 4", "simplified geometry, control volume, mesh", verdict=_NO_MESH),
    Item("Suppl. Fig. 5", "mesh study, curves", "supp_mesh", tunnel=_tunnel(tunnel.mesh_claims, with_cfd=True)),
    Item(
        "Suppl. Fig. 5",
        "velocity contours of two meshes",
        "cfd_meshes",
        ("cfd.md",),
        ("wake_meshes",),
    ),
    Item(
        "Suppl. Fig. 6", "the robot as spheres and cylinders", links=("#the-robot", "img/frames.png"), verdict="agrees"
    ),
    Item(
        "Suppl. Fig. 7",
        "TEST1 to TEST3 and the robustness test, corrected arms",
        "suppl7",
        claims=("test2", "aligned", "transitions"),
    ),
    Item("Suppl. Fig. 7", "the same, published arms", "suppl7_published", claims=("test1", "test3", "joint_errors")),
    Item(
        "Suppl. Fig. 8, 9",
        "postures, rendered",
        "postures",
        ("configs/tables/postures.toml",),
        verdict="out of reach: the list of the supplement's 19 postures; those of the public tables are drawn",
        command="jax-aero fly test2; jax-aero study pictures; jax-aero figures postures",
    ),
    Item(
        "Suppl. Fig. 10–14",
        "whole campaign: forces, moments and efficiency",
        "tunnel_moments",
        ("moments.md", "configs/tables/tunnel_tests.toml"),
        verdict="out of reach: the supplement is not public to us; our figures are from the public balance files",
        command="jax-aero data import-tunnel; jax-aero study tunnel_moments; jax-aero figures tunnel_moments",
    ),
    Item("Suppl. Fig. 15, 16", "not named in the text", verdict="out of reach: the supplement is not public to us"),
    Item("Suppl. Fig. 17, Note 7", "ablation of the feedback", "ablation_terms", claims=("minimum",)),
    Item("Suppl. Fig. 17", "scale of the estimate", "ablation_scale", verdict=_NO_LEVELS),
    Item("Suppl. Fig. 17", "links", "ablation_links", verdict=_NO_LEVELS),
    Item("Suppl. Fig. 17", "models", "ablation_models", verdict=_NO_LEVELS),
    Item("Suppl. Fig. 17", "models, simulated with the network", "ablation_models_network", verdict=_NO_LEVELS),
    Item("Suppl. Table 1", "engines", links=("#suppl-table-1",), claims=("chest_engine", "arm_engine")),
    Item("Suppl. Table 2", "coefficients", links=("#suppl-table-2",), claims=("coefficients",)),
    Item("Suppl. Table 3", "meshes", links=("#suppl-table-3",), claims=("cells",)),
    Item("Suppl. Note 1", "Reynolds and Mach numbers, blockage", claims=("reynolds", "mach", "blockage")),
    Item("Suppl. Note 2", "force areas", links=("model.md#m20", "conventions.md"), verdict="agrees"),
    Item("Suppl. Note 3", "averaged Navier-Stokes equations", verdict=_NO_MESH),
    Item("Suppl. Note 4", "spheres and cylinders from the literature", links=("model.md#m21",), verdict="agrees"),
    Item("Suppl. Note 5", "robot model and derivation of the controller", links=("model.md",), verdict="agrees"),
    Item(
        "Suppl. Note 6",
        "jets away from the body",
        "along",
        claims=("clearance",),
    ),
)

BEYOND: Sequence[Item] = (
    Item("beyond", "loss curves", "training", command=f"{_TRAINING}; jax-aero figures training"),
    Item("beyond", "three controllers, corrected and published arms", "demo"),
    Item("beyond", "winds that can be trimmed", "trim"),
    Item("beyond", "planned trajectories", "trajectory"),
    Item("beyond", "coefficients from a flight's log", "identify"),
    Item("beyond", "an engine identified from a log", "engine"),
    Item("beyond", "take-off and landing", "take_off"),
    Item("beyond", "wind that tips the standing robot over", "tip_over"),
    Item("beyond", "limit of the observer", "observer_limit"),
    Item("beyond", "gains and weights tuned by gradient", "tune"),
    Item("beyond", "force rate that the controller neglects", "force_rate"),
    Item(
        "beyond",
        "the wind from the wrench",
        "wind_from_wrench",
        ("observer.md#the-wind-from-the-wrench",),
        ("wind_estimate",),
    ),
)

SECTIONS: Mapping[str, Sequence[Item]] = {
    "Figures": FIGURE_ITEMS,
    "Equations": EQUATIONS,
    "Numbers of the text": NUMBERS,
    "Supplement": SUPPLEMENT,
    "Beyond the paper": BEYOND,
}
"""Items written here; `sections` adds the others."""

TABLES = {
    "The robot": ("robot", "Aerodynamic links, for Fig. 1 and Suppl. Fig. 6: `configs/robot/ironcub_mk1.toml`."),
    "Suppl. Table 1": ("engines", "Identified engines, with their steady-state thrusts."),
    "Suppl. Table 2": ("coefficients", "Force areas [m²] as published, and refitted to the public table."),
    "Suppl. Table 3": ("meshes", "Meshes of flight30 in the public records; sizing parameters are not public."),
}


def sections(claims: Mapping[str, Any]) -> dict[str, Sequence[Item]]:
    """Return all items by section: those written here, sweeps by their own titles, and our claims about them.

    Figures and claims of studies whose folders are not there are left out, and items that show nothing else.
    """
    known = {"", *FIGURES, *places.names("sweeps")}
    written = {
        title: [
            replace(item, claims=tuple(key for key in item.claims if key in claims))
            for item in items
            if item.figure in known and (not item.claims or not claims.keys().isdisjoint(item.claims))
        ]
        for title, items in SECTIONS.items()
    }
    shown = {item.figure for items in written.values() for item in items}
    swept = []
    for name in SWEEPS:
        if name not in shown:
            title = tomllib.loads(places.find("sweeps", name).read_text(encoding="utf-8"))["title"]
            ours = (key for key, claim in claims.items() if claim["where"] == "ours" and claim["figure"] == name)
            swept.append(Item("beyond", title, name, claims=tuple(ours)))
    return {**written, "Beyond the paper": (*written["Beyond the paper"], *swept)}


def read_record() -> dict[str, Any]:
    """Return claims and tables of `docs/claims.json`, without the claims of studies whose folders are not there."""
    record: dict[str, Any] = json.loads(CLAIMS.read_text(encoding="utf-8"))
    kept = {key: claim for key, claim in record["claims"].items() if places.has_studies(claim["command"])}
    return record | {"claims": kept}


def page() -> str:
    """Return the page as Markdown."""
    record = read_record()
    about = (
        "This page compares every figure, table, equation and claim of the paper with what we measured. A verdict is "
        "*agrees*, *differs* (with the difference) or *out of reach* (with the reason). "
        "[Deviations](deviations.md) explains the differences. `jax-aero figures --index` makes this page. "
        f"`{record['command']}` stores the measurements with their commit; the tests compute again what follows from "
        "committed files alone."
    )
    parts = ["# The paper, item by item", about]
    for title, items in sections(record["claims"]).items():
        rows = [HEADINGS, ("---",) * len(HEADINGS)]
        rows += [row for item in items for row in _rows(item, record["claims"])]
        parts += [f"## {title}", _table(rows)]
    for title, (name, caption) in TABLES.items():
        headings, *rows = record["tables"][name]
        parts += [f"## {title}", caption, _table([headings, ["---"] * len(headings), *rows])]
    return "\n\n".join(parts) + "\n"


def command_of(item: Item, claims: Mapping[str, Any]) -> str:
    """Return the commands that make an item: its results first, then the figure."""
    if item.command:
        return item.command
    made = [word for key in item.claims for word in claims[key]["command"].split("; ")]
    if item.figure in FIGURES and not any(made):
        made.append(FIGURES[item.figure].command)
    if item.figure in SWEEPS:
        made.append(f"jax-aero sweep {item.figure}")
    drawn = [f"jax-aero figures {item.figure}"] if item.figure else []
    return "; ".join(filter(None, dict.fromkeys([*made, *drawn])))


def _rows(item: Item, claims: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    ours = ", ".join([*([_figure(item.figure)] if item.figure else []), *map(_link, item.links)])
    command = "; ".join(f"`{word}`" for word in command_of(item, claims).split("; ") if word)
    found = [(claims[key]["claim"], claims[key]["measured"], claims[key]["verdict"]) for key in item.claims]
    if item.tunnel:
        # A claim that the paper does not make has no verdict.
        found += [(f"{c.what}: {c.paper}", f"{100 * c.value:.1f} %", c.verdict) for c in item.tunnel() if c.verdict]
    for number, (paper, measured, verdict) in enumerate(found or [("", "", item.verdict)]):
        first = (f"{item.name}: {item.shows}", ours, command) if number == 0 else ("", "", "")
        yield (*first, paper, measured, verdict)


def _figure(name: str) -> str:
    path = f"{GALLERY}/{name}.png"
    return f"[{name}]({path})" if (DOCS / path).is_file() else f"`{name}`"


def _link(link: str) -> str:
    if link.startswith("configs/"):
        return f"`{link}`"
    name = link.removeprefix("#").replace("-", " ") if link.startswith("#") else link.rsplit("#", 1)[-1]
    return f"[{name}]({link})"


def _table(rows: Sequence[Sequence[str]]) -> str:
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows)

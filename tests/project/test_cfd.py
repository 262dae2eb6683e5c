"""docs/cfd.md: figures beside table and tunnel are those of the results whose manifests are kept in docs/cfd."""

import json
import re
from itertools import pairwise
from pathlib import Path

from experiments import manifest
from experiments.cfd.design import Design
from jax_aero import tables

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/cfd.md").read_text(encoding="utf-8")
VALIDATION, SHIPPED = (
    PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0] for title in ("Validation", "The shipped dataset")
)
KEPT = {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in (ROOT / "docs/cfd").glob("*.json")}
TABLE = "beside the table"
LEFT_OUT = "postures other than the row's"
SHIPPED_ROWS = {
    "open solver": "open solver",
    "network of the open cases, posture left out": f"network, trained on {LEFT_OUT}",
    "axisymmetric, corrected": "axisymmetric, corrected",
    "network that is shipped, which was trained on these rows": "network, shipped",
}
MESHES = {"lean": "anchors", "finer": "fine"}


def signed(value: float, digits: int) -> str:
    return f"{value:+.{digits}f}".replace("-", "−")


def errors(summary: dict, of: str, digits: int = 1) -> list[str]:
    """The cells of a row of the first table."""
    drag_rms, drag_mean, force, links, moment = (
        summary[f"{of}: {key}"]
        for key in (
            "drag, relative error, rms",
            "drag, relative error, mean",
            "total force, rms [m2]",
            "links, mean square [m4]",
            "moment of forces at link centres, rms [N m at 10 m/s]",
        )
    )
    return [
        f"{100 * drag_rms:.1f} %",
        f"{signed(100 * drag_mean, 1)} %",
        f"{force:.3f}",
        f"{1e5 * links:.{digits}f}e-5",
        f"{moment:.2f}",
    ]


def expected_rows() -> dict[str, list[str]]:
    beside = {mesh: KEPT[f"{name}_table"]["summary"] for mesh, name in MESHES.items()}
    found = {f"{mesh} mesh": errors(summary, f"open solver, {TABLE}") for mesh, summary in beside.items()}
    for mesh, name in MESHES.items():
        tunnel = KEPT[f"{name}_tunnel"]["summary"]
        drag, force, moment = (
            tunnel[f"robot alone: {key}"]
            for key in ("drag, relative error, rms", "total force, rms [m2]", "moment, rms [N m at 10 m/s]")
        )
        found[f"{mesh} mesh, tunnel"] = [f"{100 * drag:.1f} %", f"{force:.3f}", f"{moment:.2f}"]
    for model in ("axisymmetric, corrected", "network, shipped"):
        found[model] = errors(beside["lean"], f"{model}, {TABLE}")
    return found


def rows_of(section: str) -> list[list[str]]:
    lines = re.findall(r"^\|(.+)\|$", section.replace("**", ""), re.M)
    return [[cell.strip() for cell in line.split("|")] for line in lines]


def test_the_mesh_study_is_that_of_the_result():
    of = KEPT["hovering_meshes"]["summary"]
    meshes = list(of)[:5]
    drag = [of[mesh] for mesh in meshes]
    changed = [f"{value:.4f} ({signed(100 * (value / drag[0] - 1), 2)} %)" for value in drag[3:]]
    force, links = (
        "total force from that of the finest mesh [m2]",
        "links from those of the finest mesh, mean square [m4]",
    )
    rows = rows_of(PAGE)
    for cells in (
        ["cells, thousand", *(f"{of[f'{mesh}: cells'] / 1e3:.0f}" for mesh in meshes)],
        ["y+, mean", *(f"{of[f'{mesh}: y+ mean']:.0f}" for mesh in meshes)],
        ["drag [m²]", *(f"{value:.4f}" for value in drag[:3]), *changed],
        [
            "total force, distance from that of the fine mesh [m²]",
            *(f"{of[f'{mesh}: {force}']:.3f}" for mesh in meshes),
        ],
        [
            "links, mean square from those of the fine mesh [m⁴]",
            *(f"{1e5 * of[f'{mesh}: {links}']:.2f}e-5" for mesh in meshes),
        ],
    ):
        assert cells in rows
    falls = [f"{100 * (1 - fine / coarse):.1f} %" for coarse, fine in pairwise(drag[:3])]
    phrase = f"falls by {falls[0]} and then by {falls[1]}: a formal order of {of['observed order']:.1f}, which"
    assert f"{phrase} extrapolates to {of['extrapolated']:.3f} m²" in " ".join(PAGE.split())


def test_the_tables_of_the_validation_are_those_of_the_results():
    rows = rows_of(VALIDATION)
    for label, cells in expected_rows().items():
        assert [label, *cells] in rows


def test_the_tables_of_the_shipped_dataset_are_those_of_the_results():
    rows, summary = rows_of(SHIPPED), KEPT["open_table"]["summary"]
    for label, model in SHIPPED_ROWS.items():
        assert [label, *errors(summary, f"{model}, {TABLE}")] in rows
    drag, _, force, links, _ = errors(summary, f"network, trained on {LEFT_OUT}, beside the open solver")
    assert f"{drag}, {force} m² and {links} m⁴ off the cases" in " ".join(SHIPPED.split())


def expected_phrases() -> list[str]:
    lean, fine = (KEPT[name]["quality"] for name in ("anchors", "fine"))
    said = [
        f"lean: {lean['cells'] / 1e3:.0f} thousand cells, y+ {lean['y+ mean']:.0f}",
        f"{fine['cells'] / 1e3:.0f} thousand cells, y+ {fine['y+ mean']:.0f}",
        f"OpenFOAM {lean['OpenFOAM']:.0f}",
    ]
    for mesh, name in MESHES.items():
        goals = {key: text for key, text in KEPT[f"{name}_table"]["summary"].items() if ", goal of" in key}
        drag, force, links = goals.values()
        assert drag == "met"
        factors = [re.fullmatch(r"missed, (\S+) times that", text)[1] for text in (force, links)]
        said.append(f"{factors[0]} and {factors[1]} ({mesh} mesh)")
    summary = KEPT["anchors_table"]["summary"]
    link = {key.split(": ")[1].split(",")[0]: value for key, value in summary.items() if key.endswith("rms [m2]")}
    rest = [value for name, value in link.items() if "_" in name and "lower_leg" not in name] + [link["head"]]
    said.append(
        f"chest ({link['chest']:.3f} m² rms) and lower legs ({link['l_lower_leg']:.3f} m²); "
        f"the others have {min(rest):.3f} to {max(rest):.3f} m²"
    )
    couples, forces = (
        summary[f"moment about the centre of mass, {part}, rms [N m at 10 m/s]"]
        for part in ("couples on links", "forces at link centres")
    )
    said.append(f"{couples:.2f} N m at 10 m/s (rms), beside {forces:.2f} N m")
    return said


def test_the_sentences_have_the_figures_of_the_results():
    text = " ".join(VALIDATION.replace("**", "").split())
    for phrase in expected_phrases():
        assert phrase in text, phrase


def test_cases_computed_twice_differ_as_the_page_says():
    text = " ".join(PAGE.split())
    for name, of in (("mirror", "mirror images"), ("again_table", f"open solver, {TABLE}")):
        drag, _, force, links, _ = errors(KEPT[name]["summary"], of, digits=2)
        phrase = f"{drag} in drag, by {force} m² in total force and by {links} m⁴ on links"
        assert phrase in text, phrase


def test_the_results_are_of_the_designs_as_they_are():
    settings = {"settings.mesh.base": 0.68, "settings.solver.iterations": 120, "settings.solver.window": 40}
    for name, changes in (("anchors", {}), ("fine", settings)):
        design = Design.read("anchors", changes)
        today = manifest.make_portable(tables.to_builtins(design.spec))
        assert KEPT[name]["config"] | {"title": today["title"]} == today
        assert KEPT[name]["summary"]["accepted"] == len(list(design))
        assert not KEPT[name]["git"]["dirty"]


MK3 = PAGE.split("\n## iRonCub-Mk3\n")[1].split("\n## ")[0]
TOTALS = {
    "drag": "whole-robot drag, rms over mean",
    "lateral": "whole-robot lateral force, rms [m2]",
    "across": "whole-robot force across the wind, rms [m2]",
    "moment": "moment about the centre of mass, rms [N m at 10 m/s]",
}
BESIDE_TUNNEL = {
    "drag": "drag, rms over mean",
    "lateral": "lateral force, rms [m2]",
    "across": "force across the wind, rms [m2]",
    "moment": "moment, rms [N m at 10 m/s]",
}
FITS = {
    "estimated": "estimated",
    "fit": "refit",
    "fit, posture left out": "refit, posture left out",
    "network, posture left out": "network, posture left out",
    "no force at all": "nothing",
}
GROUPS = {
    "flight postures": "flight postures",
    "hovering, yaw up to 20°": "hovering, yaw to 20 deg",
    "hovering, yaw of 60 to 90°": "side wind",
}


def with_interval(summary: dict, key: str, digits: int, factor: float = 1.0, unit: str = "") -> str:
    value, low, high = (f"{factor * summary[f'{key}{end}']:.{digits}f}" for end in ("", ", 2.5 %", ", 97.5 %"))
    return f"{value}{unit} ({low} to {high})"


def totals(summary: dict, of: str, names: dict[str, str]) -> list[str]:
    """The cells of a row of errors of whole-robot totals."""
    drag, *rest = (f"{of}: {key}" for key in names.values())
    digits = zip(rest, (3, 3, 2), strict=True)
    return [with_interval(summary, drag, 1, 100.0, " %"), *(with_interval(summary, key, n) for key, n in digits)]


def rows_of_mk3() -> list[list[str]]:
    fitted, tunnel = (KEPT[name]["summary"] for name in ("mk3_fit", "mk3_tunnel"))
    rows = [[label, *totals(fitted, of, TOTALS)] for label, of in FITS.items()]
    for label, group in GROUPS.items():
        for name in ("estimated", "cfd", "network"):
            mean = f"{signed(100 * tunnel[f'{name}, {group}: drag, mean over mean'], 1)} %"
            rows.append([f"{label}, {name}", mean, *totals(tunnel, f"{name}, {group}", BESIDE_TUNNEL)])
    return rows


def test_the_tables_of_mk3_are_those_of_the_results():
    rows = rows_of(MK3)
    for cells in rows_of_mk3():
        assert cells in rows
    for name in ("mk3_fit", "mk3_tunnel", "mk3_meshes", "mk3_primitives"):
        assert not KEPT[name]["git"]["dirty"]


def test_the_sentences_on_side_winds_of_mk3_have_the_figures_of_the_results():
    text = " ".join(MK3.split())
    meshes, primitives = (KEPT[name]["summary"] for name in ("mk3_meshes", "mk3_primitives"))
    ahead, oblique, side = (
        "homePos 90/180",
        "homePos 90/-120, support in the wind",
        "homePos 90/-90, support in the wind",
    )

    def drags(of: dict) -> str:
        cells = [f"{signed(100 * of[f'{case}: drag, relative error'], 1)} %" for case in (ahead, oblique, side)]
        return f"{cells[0]}, {cells[1]} and {cells[2]}"

    def lacking(case: str) -> float:
        return meshes[f"{case}: drag in the tunnel [m2]"] - meshes[f"{case}: drag [m2]"]

    height = meshes[f"{side}: difference in lateral force, z from the centre of mass [m]"]
    ahead_of = meshes[f"{side}: difference in lateral force, x from the centre of mass [m]"]
    falls = [
        1.0 - meshes[f"{side}: {key}"] / meshes[f"{oblique}: {key}"] for key in ("drag in the tunnel [m2]", "drag [m2]")
    ]
    for phrase in (
        f"{drags(meshes)} off in drag",
        f"{drags(primitives)} with primitives",
        f"{lacking(oblique):.3f} m² at 60° and {lacking(side):.3f} m² at 90°",
        f"{100 * abs(ahead_of):.0f} cm in front of the centre of mass and {100 * height:.0f} cm above it",
        f"by {100 * falls[0]:.0f} % in the tunnel and by {100 * falls[1]:.0f} % in the simulation",
    ):
        assert phrase in text, phrase


def test_the_sentences_on_mount_and_air_of_mk3_have_the_figures_of_the_results():
    of, text = KEPT["mk3_tunnel"]["summary"], " ".join(MK3.split())
    key = "moment, rms [N m at 10 m/s]"
    none = [f"{of[f'no moment, {group}: {key}']:.2f}" for group in GROUPS.values()]
    drag = [of[f"yaw {name}: mean drag in side wind [m2]"] for name in ("the files'", "opposite to the files'")]
    assert of["yaw opposite to the files': lateral force with the wind, share"] == 1.0
    pitching = [of[f"cfd, {name}: pitching {key}"] for name in ("facing the wind", "facing away")]
    for phrase in (
        f"the errors of moments would be {none[0]}, {none[1]} and {none[2]} N m",
        f"would be {signed(drag[0], 2)} m²; with the other sign it is {drag[1]:.2f} m²",
        f"from {pitching[0]:.2f} to {pitching[1]:.2f} N m",
    ):
        assert phrase in text, phrase
    even = {
        part: [abs(v) for k, v in of.items() if k.startswith("homePos") and part in k] for part in PARTS_OF_SYMMETRY
    }
    lateral, roll, yaw = (max(even[part]) for part in list(PARTS_OF_SYMMETRY)[:3])
    rest = max(max(even[part]) for part in list(PARTS_OF_SYMMETRY)[3:])
    assert f"are at most {lateral:.3f} m², {roll:.3f} and {yaw:.3f} m³, those of drag and lift {rest:.3f} m²" in text


PARTS_OF_SYMMETRY = ("force y: even", "moment x: even", "moment z: even", "force x: odd", "force z: odd")
"""Parts that vanish if robot and air are their own mirror image."""

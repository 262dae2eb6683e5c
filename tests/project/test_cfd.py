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

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
    for model in ("axisymmetric, corrected", "network, shipped"):
        found[model] = errors(beside["lean"], f"{model}, {TABLE}")
    return found


def rows_of(section: str) -> list[list[str]]:
    lines = re.findall(r"^\|(.+)\|$", section.replace("**", ""), re.M)
    return [[cell.strip() for cell in line.split("|")] for line in lines]


def test_the_mesh_study_is_that_of_the_result():
    of = KEPT["hovering_meshes"]["summary"]
    drag = [of[mesh] for mesh in list(of)[:3]]
    falls = [f"{100 * (1 - fine / coarse):.1f} %" for coarse, fine in pairwise(drag)]
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


def test_the_drag_in_the_tunnel_is_that_of_the_results():
    lean, fine = (
        f"{100 * KEPT[f'{name}_tunnel']['summary']['robot alone: drag, relative error, rms']:.1f} %"
        for name in MESHES.values()
    )
    assert f"{lean} off (finer mesh: {fine})" in " ".join(VALIDATION.split())


def test_mirror_images_differ_as_the_page_says():
    drag, _, force, links, _ = errors(KEPT["mirror"]["summary"], "mirror images", digits=2)
    assert f"{drag} in drag, by {force} m² in total force and by {links} m⁴ on links" in " ".join(PAGE.split())


def test_the_results_are_of_the_designs_as_they_are():
    settings = {"settings.mesh.base": 0.68, "settings.solver.iterations": 120, "settings.solver.window": 40}
    for name, changes in (("anchors", {}), ("fine", settings)):
        design = Design.read("anchors", changes)
        today = manifest.make_portable(tables.to_builtins(design.spec))
        assert KEPT[name]["config"] | {"title": today["title"]} == today
        assert KEPT[name]["summary"]["accepted"] == len(list(design))
        assert not KEPT[name]["git"]["dirty"]


MK3 = PAGE.split("\n## iRonCub-Mk3\n")[1].split("\n## ")[0]
BESIDE_TUNNEL = {
    "drag": "drag, rms over mean",
    "lateral": "lateral force, rms [m2]",
    "across": "force across the wind, rms [m2]",
    "moment": "moment, rms [N m at 10 m/s]",
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


def test_the_table_of_mk3_is_that_of_the_result():
    rows, tunnel = rows_of(MK3), KEPT["mk3_tunnel"]["summary"]
    shown = [("flight postures", "estimated"), ("flight postures", "cfd"), ("hovering, yaw of 60 to 90°", "cfd")]
    for label, name in shown:
        group = f"{name}, {GROUPS[label]}"
        mean = f"{signed(100 * tunnel[f'{group}: drag, mean over mean'], 1)} %"
        assert [f"{label}, {name}", mean, *totals(tunnel, group, BESIDE_TUNNEL)] in rows
    none = [f"{tunnel[f'no moment, {group}: moment, rms [N m at 10 m/s]']:.2f}" for group in GROUPS.values()]
    assert f"the errors would be {none[0]}, {none[1]} and {none[2]} N m" in " ".join(MK3.split())
    for name in ("mk3_fit", "mk3_tunnel", "mk3_meshes", "mk3_primitives"):
        assert not KEPT[name]["git"]["dirty"]

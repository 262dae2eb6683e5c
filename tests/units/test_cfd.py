"""The open solver: surfaces, files of a case, what is read, what is refused, resumption, and one real flow."""

import dataclasses
import json
import os
import shutil
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest
import pyvista
import xarray as xr

from jax_aero import rust
from jax_aero.aero import dataset as ds
from jax_aero.aero.posture import total_wrench
from jax_aero.base import places, tables
from jax_aero.base.terminal import REFUSED, Refused
from jax_aero.body import mesh
from jax_aero.body.mirror import mirror_name
from jax_aero.body.robot import load_robot
from jax_aero.cfd import case, compare, design, flow, foam, geometry, goals, models, settings, simulate, verify
from jax_aero.cfd import compute as command
from jax_aero.commands import cfd as cfd_command
from jax_aero.commands.figures import main as figures
from jax_aero.data import import_cfd
from jax_aero.data.ironcub import JOINTS, LINKS
from jax_aero.figures.catalogue import FIGURES
from jax_aero.figures.runs import MissingRun
from jax_aero.results import identity, record
from jax_aero.train.result import held_out_network
from paper_figs import cfd_flow

ROBOT = "configs/robot/ironcub_mk1.toml"


@pytest.fixture(scope="module")
def hovering(robot):
    return geometry.robot_surfaces(robot, import_cfd.known_postures()["hovering"])


@pytest.mark.parametrize(
    ("kind", "size", "volume"),
    [
        ("box", (0.1, 0.2, 0.3), 0.006),
        ("cylinder", (0.1, 0.1, 0.5), np.pi * 0.005),
        ("sphere", (0.1, 0.1, 0.1), 4e-3 * np.pi / 3),
    ],
)
def test_a_primitive_closes_and_has_its_volume(kind, size, volume, agree):
    triangles = geometry.triangles_of(kind, size)
    assert geometry.is_closed(triangles)
    assert not geometry.is_closed(triangles[1:])
    assert not geometry.is_closed(np.concatenate([triangles[:1, ::-1], triangles[1:]]))
    # Circles are polygons of equal area. Chords of an angle δ along the meridian cost a sphere δ²/4 + O(δ⁴).
    chord = 2.0 * np.pi / geometry.SEGMENTS if kind == "sphere" else 0.0
    agree(f"volume of a {kind}", geometry.volume(triangles) / volume, 1.0 - 0.25 * chord**2, chord**4 + 1e-12)


def test_every_link_has_a_surface_and_the_robot_is_its_own_mirror_image(hovering):
    assert tuple(hovering) == LINKS
    for name, surface in hovering.items():
        other = hovering[mirror_name(name)]
        # In the CAD model the chest's centre of mass is 1.3 mm off the plane of symmetry.
        assert np.abs(surface.centre * ds.MIRROR_AXES - other.centre).max() < 4e-3, name
        assert geometry.volume(surface.triangles) == pytest.approx(geometry.volume(other.triangles), rel=0.01)


def test_feet_belong_to_the_lower_legs_and_shoulders_to_the_arms(hovering):
    lowest = {name: surface.triangles[..., 2].min() for name, surface in hovering.items()}
    assert min(lowest, key=lowest.__getitem__) in ("l_lower_leg", "r_lower_leg")
    inmost = np.abs(hovering["l_upper_arm"].triangles[..., 1]).min()
    assert inmost < np.abs(hovering["l_arm_jet_turbine"].triangles[..., 1]).min()


@pytest.mark.parametrize("name", ["mk3", "mk3_tunnel"])
def test_mk3_has_a_surface_for_each_of_its_links_in_postures_it_can_take(name):
    """Its jetpack and its feet are links of their own; postures beyond its stops would be refused."""
    made = design.Design.read(name, {})
    links = load_robot(made.spec.robot).aero_links.names
    assert {"chest_jetpack", "l_ankle_2"} <= set(links)
    for surfaces in made.surfaces.values():
        assert tuple(surfaces) == links
        assert all(geometry.is_closed(surface.triangles) for surface in surfaces.values())


BOX = (0.1, 0.15, 0.2)


def write_box(path, size, *, is_open=False):
    """Write a box as an STL, or one that lacks a triangle."""
    box = pytest.importorskip("trimesh", reason="trimesh is not installed: make setup").creation.box(size)
    box.update_faces(np.arange(len(box.faces)) >= is_open)
    box.export(path)


@pytest.fixture
def headed(robot, tmp_path):
    """Return a function that makes a robot whose head looks as the given geometry of a URDF, and its file."""

    def make(geometry_text):
        sphere = '<sphere radius="0.09645"/>'
        assert robot.urdf_text.count(sphere) == 1
        (tmp_path / "ironcub_mk1.urdf").write_text(robot.urdf_text.replace(sphere, geometry_text), encoding="utf-8")
        path = tmp_path / "robot.toml"
        path.write_text(robot.toml_text, encoding="utf-8")
        return rust.Robot(path), path

    return make


@pytest.mark.parametrize("factors", ["0.001 0.001 0.001", "-0.001 0.001 0.001"])
def test_a_mesh_stands_where_a_primitive_of_its_size_would(headed, tmp_path, factors, agree):
    """A box in millimetres, and its mirror image, whose triangles would face inwards."""
    joints = import_cfd.known_postures()["Config5"]
    expected = geometry.robot_surfaces(headed(f'<box size="{BOX[0]} {BOX[1]} {BOX[2]}"/>')[0], joints)
    write_box(tmp_path / "skull.stl", 1e3 * np.array(BOX))
    chosen, path = headed(f'<mesh filename="package://somewhere/skull.stl" scale="{factors}"/>')
    found = geometry.robot_surfaces(chosen, joints, path)
    assert tuple(found) == LINKS

    def corners(surface):
        points = np.unique(np.round(surface.triangles.reshape(-1, 3), 6), axis=0)
        return points[np.lexsort(points.T)]

    # An STL has single precision: 0.1 m to 6e-9 m.
    agree("corners [m]", corners(found["head"]), corners(expected["head"]), 1.1e-6)
    agree("volume [m3]", geometry.volume(found["head"].triangles), np.prod(BOX), 1e-8)
    # A body that has a mesh has no struts, and the head is fixed to the chest's.
    for name in set(LINKS) - {"head", "chest"}:
        np.testing.assert_array_equal(found[name].triangles, expected[name].triangles)
    # Without its meshes the robot's head is that of its aerodynamics.
    sphere = geometry.robot_surfaces(chosen, joints)["head"]
    assert geometry.volume(sphere.triangles) == pytest.approx(np.pi / 6.0 * 0.1929**3, rel=0.01)


def test_a_mesh_that_is_missing_or_open_is_refused_by_name(headed, tmp_path):
    joints = import_cfd.known_postures()["hovering"]
    chosen, path = headed('<mesh filename="package://somewhere/skull.stl"/>')
    with pytest.raises(Refused, match=r"head: mesh package://somewhere/skull\.stl: 0 files of that name"):
        geometry.robot_surfaces(chosen, joints, path)
    write_box(tmp_path / "skull.stl", BOX, is_open=True)
    with pytest.raises(Refused, match="the surface of `head` does not close"):
        geometry.robot_surfaces(chosen, joints, path)


def test_normals_of_an_stl_have_length_one(tmp_path):
    """Triangles of 5e-3 m², and one without area."""
    triangles = geometry.triangles_of("box", (0.1, 0.1, 0.1))
    triangles = np.concatenate([triangles, triangles[:1, [0, 0, 1]]])
    geometry.write_stl({"l": geometry.Surface(triangles, np.zeros(3))}, tmp_path / "a.stl")
    lines = [line.split()[2:] for line in (tmp_path / "a.stl").read_text().splitlines() if line.startswith("facet")]
    lengths = np.linalg.norm(np.array(lines, dtype=float), axis=1)
    np.testing.assert_array_equal(lengths, [1.0] * 12 + [0.0])


def test_a_body_whose_parts_touch_in_an_edge_closes():
    box = geometry.triangles_of("box", (1.0, 1.0, 1.0))
    beside = box + np.array([1.0, 1.0, 0.0])
    assert geometry.is_closed(np.concatenate([box, beside]))
    assert not geometry.is_closed(np.concatenate([box, beside[1:]]))


def test_a_design_with_meshes_has_its_own_postures_and_another_digest(headed, tmp_path):
    """Cases of another mesh of the same name would be taken for those of this one."""
    _, path = headed('<mesh filename="package://somewhere/skull.stl" scale="1 1 1"/>')
    angles = import_cfd.known_postures()["hovering"]
    rows = [["name", *(f"{joint}_deg" for joint in JOINTS)], ["stands", *map(str, angles)]]
    (tmp_path / "own.csv").write_text("\n".join(",".join(row) for row in rows), encoding="utf-8")
    winds = design.Winds(design="grid", pitch_deg=(90.0,), yaw_deg=(0.0,))
    spec = design.Spec("x", ("stands",), winds, path, "meshes", tmp_path / "own.csv")
    digests = set()
    for size in (1.0, 2.0):
        write_box(tmp_path / "skull.stl", (size, 1.0, 1.0))
        mesh.read_mesh.cache_clear()
        made = design.Design("own", spec)
        digests.add(made.digest)
        assert [case.posture for case in made] == ["stands"]
        assert np.ptp(made.surfaces["stands"]["head"].triangles[..., 1]) > 0.9
    assert len(digests) == 2


def test_a_posture_beyond_the_stops_is_refused_in_degrees(robot):
    joints = import_cfd.known_postures()["hovering"].copy()
    joints[6] = 150.0
    with pytest.raises(Refused, match=r"`l_elbow` is 150\.0 degrees; expected .* to 10[56]"):
        geometry.robot_surfaces(robot, joints)


def test_a_case_has_its_files_and_the_wind_in_them(hovering, tmp_path):
    chosen = settings.Settings()
    case.write_mesh_case(tmp_path, hovering, chosen.mesh)
    case.write_wind_case(tmp_path, ds.wind_direction(90.0, 0.0), chosen)
    stl = (tmp_path / "constant" / "triSurface" / "body.stl").read_text()
    assert [line.split()[1] for line in stl.splitlines() if line.startswith("solid")] == list(LINKS)
    assert "freestreamValue uniform (17 0 0);" in (tmp_path / "0" / "U").read_text()
    # k = 3/2 (0.001 · 17)², ω = k / 1.469e-5.
    assert "inletValue uniform 0.0004335;" in (tmp_path / "0" / "k").read_text()
    assert "inletValue uniform 29.5098" in (tmp_path / "0" / "omega").read_text()
    snappy = (tmp_path / "system" / "snappyHexMeshDict").read_text()
    assert "levels ((0.023 6) (0.05 5) (0.15 4) (0.4 3) (1.2 2));" in snappy


def test_a_body_too_large_for_the_cube_is_refused(hovering, tmp_path):
    with pytest.raises(ValueError, match=r"`mesh\.half_width` is 1\.0; expected at least twice"):
        case.write_mesh_case(tmp_path, hovering, settings.Mesh(half_width=1.0))


FORCE = "# Time (total) (pressure) (viscous)\n{}\t(3 0 0)\t(2 0 0)\t(1 0 0)\n"


def test_forces_are_read_over_restarts(tmp_path):
    for start, at in ((0, 4), (16, 20)):
        folder = tmp_path / "postProcessing" / "head" / str(start)
        folder.mkdir(parents=True)
        (folder / "force.dat").write_text(FORCE.format(at))
        (folder / "moment.dat").write_text(FORCE.format(at))
    history = foam.read_histories(tmp_path, {"head": None})["head"]
    assert history.iteration.tolist() == [4.0, 20.0]
    np.testing.assert_array_equal(history.force, [[3.0, 0.0, 0.0]] * 2)
    np.testing.assert_array_equal(history.viscous, [[1.0, 0.0, 0.0]] * 2)


def test_the_last_report_of_y_plus_is_read(tmp_path):
    for start, value in ((16, 9.0), (100, 30.0)):
        folder = tmp_path / "postProcessing" / "yPlus" / str(start)
        folder.mkdir(parents=True)
        (folder / "yPlus.dat").write_text(f"# Time patch min max average\n{start} head 1 {4 * value} {value}\n")
    assert foam.read_y_plus(tmp_path) == (30.0, 120.0)


LEVELS = "Cells per refinement level:\n    0\t10\n    1\t"
MESHER = f"{LEVELS}5\n{LEVELS}7\n    2\t90\nWriting"
CHECKER = "    cells:            107\n    Number of regions: 1 (OK).\n    Mesh non-orthogonality Max: 60.5 average: 9\n"
COARSE = settings.Mesh(surface_level=2, base=0.5, shells=(settings.Shell(distance=0.3, level=2),))
FACTS = foam.mesh_facts(MESHER, CHECKER, 1.0)


def test_the_last_table_of_levels_is_read():
    assert (FACTS.cells, FACTS.finest_level, FACTS.finest_cells) == (107, 2, 90)
    assert (FACTS.regions, FACTS.max_non_orthogonality) == (1, 60.5)
    simulate.check_mesh(FACTS, 2.0, COARSE, settings.Accept())


@pytest.mark.parametrize(
    ("change", "area", "words"),
    [
        ({"regions": 2}, 2.0, "2 separate regions"),
        ({"finest_level": 1}, 2.0, "90 cells of level 1, its finest; expected at least 64 of level 2"),
        ({}, 4.0, "90 cells of level 2, its finest; expected at least 128 of level 2: choose a smaller `mesh.base`"),
    ],
)
def test_a_mesh_that_misses_its_level_or_leaks_is_refused(change, area, words):
    with pytest.raises(simulate.Unfit, match=words):
        simulate.check_mesh(FACTS._replace(**change), area, COARSE, settings.Accept())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        # Shells that a thin body slips through.
        (
            {"settings": {"mesh": {"surface_level": 5, "shells": [{"distance": 1, "level": 4}]}}},
            r"mesh\.surface_level` is 5; expected one of the levels of `shells`, .4.",
        ),
        (
            {"settings": {"mesh": {"base": 1.0}}},
            r"mesh\.shells\[0\].distance` is 0.023; expected at least 0.0271 m at level 6",
        ),
        ({"winds": {"design": "sobol"}}, "`winds.samples` is 0; expected at least 1"),
        (
            {"winds": {"design": "list", "pitch_deg": [90], "yaw_deg": [0, 1]}},
            r"`winds.yaw_deg` is \[.*\]; expected 1 values",
        ),
        (
            {"winds": {"design": "grid", "pitch_deg": [190], "yaw_deg": [0]}},
            r"`winds.pitch_deg\[0\]` is 190.0; expected 0 to 180",
        ),
    ],
)
def test_shells_and_winds_that_cannot_be_are_refused(changes, words):
    winds = {"design": "list", "pitch_deg": [90], "yaw_deg": [0]}
    table = {"title": "x", "robot": ROBOT, "postures": ["hovering"], "winds": winds}
    with pytest.raises(Refused, match=words):
        tables.convert(table | changes, design.Spec, "x.toml")


def history_of(force):
    steps = np.arange(4.0, 101.0, 4.0)
    forces = np.zeros((len(steps), 3))
    forces[:, 0] = force(steps)
    return foam.History(steps, 0.9 * forces, 0.1 * forces, np.zeros_like(forces))


@pytest.mark.parametrize(
    ("force", "reason"),
    [
        (lambda t: 1.0 + np.exp(-t / 8.0), ""),
        (lambda t: 1.0 + t / 500.0, "the force drifts by 5"),
        (lambda t: 1.0 + 0.2 * np.cos(np.pi * t / 4.0), "the force oscillates by 20"),
        (lambda t: np.where(t > 90.0, np.nan, 1.0), "the solver diverged"),
    ],
)
def test_a_result_is_judged_by_its_window(force, reason):
    chosen = settings.Settings(solver=settings.Solver(window=64))
    result = simulate.reduce({"head": history_of(force)}, {"cells": 1.0}, chosen)
    assert result.reason.startswith(reason)
    assert bool(result.reason) == bool(reason)
    if not reason:
        pressure = 0.5 * 1.225 * 17.0**2
        assert result.force_area_b["head"][0] == pytest.approx(1.0 / pressure, rel=2e-3)
        assert result.quality["pressure share of the force"] == pytest.approx(0.9)


def test_a_solve_that_is_not_steady_goes_on_for_another_window(monkeypatch, tmp_path):
    found = iter([lambda t: 1.0 + t / 500.0, np.ones_like, np.zeros_like])
    monkeypatch.setattr(foam, "run", lambda *_: "")
    monkeypatch.setattr(foam, "read_y_plus", lambda _: (200.0, 300.0))
    monkeypatch.setattr(foam, "read_histories", lambda *_: {"head": history_of(next(found))})
    chosen = settings.Settings(solver=settings.Solver(extensions=2))
    body = geometry.Surface(geometry.triangles_of("box", (0.1, 0.1, 0.1)), np.zeros(3))
    facts = foam.MeshFacts(1, 1, 1, 6, 60.0, 3.0, 1.0, 1912.0)
    result = simulate.solve({"head": body}, np.array([1.0, 0.0, 0.0]), chosen, tmp_path, facts)
    assert result.reason == ""
    assert result.quality["iterations"] == chosen.solver.iterations + chosen.solver.window


def test_winds_of_a_sobol_design_fill_the_sphere_and_lie_on_the_grid():
    winds = design.Winds(design="sobol", samples=64)
    found = np.array([ds.wind_direction(*angles) for place in range(4) for angles in winds.directions(place)])
    np.testing.assert_allclose(found.mean(axis=0), 0.0, atol=0.02)  # 256 points of a sequence, balanced to 1/256
    np.testing.assert_allclose(np.mean(found**2, axis=0), 1.0 / 3.0, atol=0.02)
    rounded = design.Winds(design="sobol", samples=16, steps_deg=(10.0, 20.0)).directions(3)
    assert all(pitch % 10 == 0 and yaw % 20 == 0 and 0 <= pitch <= 180 and -180 <= yaw < 180 for pitch, yaw in rounded)
    assert design.Winds(design="sobol", samples=64).directions(1)[0] != winds.directions(0)[0]


@pytest.fixture(scope="module")
def small():
    winds = design.Winds(design="list", pitch_deg=(90.0, 60.0, 30.0), yaw_deg=(0.0, 20.0, 0.0))
    spec = design.Spec(title="made up", postures=("hovering", "Config5"), winds=winds, robot=Path(ROBOT))
    return design.Design("small", spec)


class Fake:
    """A solver that pushes every link along the wind, refuses one wind, and can be killed after some cases."""

    def __init__(self, lives=99):
        self.lives, self.solved, self.meshed = lives, 0, 0

    def __call__(self, surfaces, winds, *_):
        self.meshed += 1
        for wind in winds:
            if self.solved == self.lives:
                raise KeyboardInterrupt
            self.solved += 1
            if abs(wind[1]) > 0.1:
                yield simulate.Result(reason="the force drifts")
                continue
            area = tuple((0.01 * wind).tolist())
            yield simulate.Result("", dict.fromkeys(surfaces, area), dict.fromkeys(surfaces, area), {"cells": 7.0})


def test_a_design_that_was_killed_goes_on_and_says_what_it_refused(small, tmp_path):
    folder, whole = tmp_path / "result", tmp_path / "whole"
    killed, rest = Fake(lives=4), Fake()
    with pytest.raises(KeyboardInterrupt):
        command.compute(small, folder, killed)
    command.compute(small, folder, rest)
    assert (killed.solved, killed.meshed, rest.solved, rest.meshed) == (4, 2, 2, 1)
    said = command.collect(small, folder)
    assert "4 accepted, 2 refused, 0 not computed, 2 postures" in said
    assert "Config5_60_20: the force drifts" in said
    data = ds.load(folder / "dataset.nc", load_robot(ROBOT))
    assert data.quality["cells"].tolist() == [7.0] * 4
    np.testing.assert_allclose(data.force_area_b[0, 3], 0.01 * data.wind_b[0])
    both = data.add_mirror_images()
    np.testing.assert_allclose(both.couple_volume_b[4:], -both.couple_volume_b[:4] * ds.MIRROR_AXES)
    written = json.loads((folder / "manifest.json").read_text())
    assert written["summary"]["accepted"] == 4
    assert written["quality"] == {"cells": 7.0}
    command.compute(small, folder, Fake(lives=0))  # nothing is left to do
    command.compute(small, whole, Fake())
    command.collect(small, whole)
    for name in ("cases.json", "dataset.nc"):
        assert (folder / name).read_bytes() == (whole / name).read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"result", "whole"}


def test_cases_are_collected_before_all_are_there_and_winds_can_be_added(small, tmp_path):
    folder = tmp_path / "result"
    with pytest.raises(KeyboardInterrupt):
        command.compute(small, folder, Fake(lives=2))
    assert "2 not computed" not in command.collect(small, folder)
    assert "4 not computed" in command.collect(small, folder)
    rest = Fake()
    command.compute(small, folder, rest)
    assert rest.solved == 4
    command.collect(small, folder)
    wider = design.Winds(design="list", pitch_deg=(90.0, 60.0, 30.0, 45.0), yaw_deg=(0.0, 20.0, 0.0, 0.0))
    more = design.Design("small", msgspec.structs.replace(small.spec, winds_of={"hovering": wider}))
    added = Fake()
    command.compute(more, folder, added)
    assert added.solved == 1


def test_a_result_from_before_its_cases_were_one_file_is_read(small, tmp_path):
    folder = tmp_path / "result"
    command.compute(small, folder, Fake())
    command.collect(small, folder)
    found = command.read_cases(small, folder)
    (folder / "cases").mkdir()
    for name, one in json.loads((folder / "cases.json").read_text()).items():
        (folder / "cases" / f"{name}.json").write_text(json.dumps(one))
    (folder / "cases.json").unlink()
    assert command.read_cases(small, folder) == found


def test_a_folder_of_other_settings_is_refused(small, tmp_path, monkeypatch):
    folder = tmp_path / "result"
    command.compute(small, folder, Fake())
    command.collect(small, folder)
    finer = settings.Settings(mesh=settings.Mesh(base=0.6))
    other = design.Design("small", msgspec.structs.replace(small.spec, settings=finer))
    with pytest.raises(Refused, match="holds the result of another configuration; choose another name or --out"):
        command.compute(other, folder, Fake())
    monkeypatch.setitem(identity.VERSIONS, "jax_aero", 9)
    with pytest.raises(Refused, match="holds the result of another configuration"):
        command.compute(small, folder, Fake())


def test_the_designs_have_one_recipe():
    """What the tunnel says of the anchors holds for the shipped dataset."""
    names = ("anchors", "open", "mk3", "mk3_tunnel", "mk1_taps", "mk3_taps")
    anchors, *others = (design.Design.read(name, {}).spec.settings for name in names)
    assert others == [anchors] * 5


def test_a_design_with_other_keys_has_a_folder_and_a_command_of_its_own(tmp_path):
    plain, changed = design.Design.read("anchors", {}), design.Design.read("anchors", {"settings.solver.ranks": 2})
    assert command.folder_of(plain) == command.RESULTS / "anchors"
    assert command.folder_of(changed) == command.RESULTS / "anchors--settings.solver.ranks=2"
    assert command.folder_of(changed, tmp_path) == tmp_path / "anchors"
    small = design.Design.read("anchors", {"postures": ["hovering"]})
    command.compute(small, tmp_path / "result", Fake())
    command.collect(small, tmp_path / "result")
    words = json.loads((tmp_path / "result" / "manifest.json").read_text())["command"]
    assert words == "jax-aero cfd anchors --set 'postures=[\"hovering\"]'"


def test_the_order_of_three_meshes_is_observed_only_where_they_converge(agree):
    # C = 0.5 + h²/100, edges by different ratios.
    edges = np.array([1.5, 1.0, 0.75])
    found = verify.extrapolate(0.5 + 1e-2 * edges**2, edges)
    agree("order", found["observed order"], 2.0, 1e-9)
    agree("limit", found["extrapolated"], 0.5, 1e-9)
    # Differences as of h⁰: the values move on by as much at every mesh.
    assert "none" in verify.extrapolate(np.log(edges), edges)["observed order"]
    assert "none" in verify.extrapolate(np.array([0.5, 0.6, 0.55]), edges)["observed order"]


def test_a_verification_extrapolates_three_meshes_and_varies_the_rest(monkeypatch, agree):
    """A drag coefficient of 0.4 + (h / 10 mm)², 1 % more after more iterations, 2 % in a larger cube; some lift."""

    def yield_results(surfaces, winds, chosen, _):
        drag = 0.4 + (100.0 * chosen.mesh.finest) ** 2
        drag *= 1.01 if chosen.solver.iterations > 160 else 1.0
        drag *= 1.02 if chosen.mesh.half_width > 2.1 else 1.0
        areas = dict.fromkeys(surfaces, (drag * subject.area, 0.0, 0.75 * drag * subject.area))
        return [simulate.Result("", areas, areas, {"cells": 5.0, "y+ mean": 40.0})]

    monkeypatch.setattr(foam, "environment", lambda: None)
    monkeypatch.setattr(verify, "simulate", yield_results)
    assert {f"flight{pitch:g}": pitch for pitch in verify.FLIES_AT.values()} == verify.FLIES_AT
    subject = verify.subject_of("sphere")
    found = verify.compute("sphere", verify.VerifyConfig()).summary
    agree("order", found["observed order"], 2.0, 1e-9)
    agree("limit", found["extrapolated"], 0.4, 1e-9)
    agree("iterations", found["twice the iterations change it by"], 0.01, 1e-12)
    agree("cube", found["the larger cube changes it by"], 0.02, 1e-12)
    sizes = [float(label.split()[2]) for label in found if label.startswith("cells of") and label.endswith("mm")]
    # Whole cells fit into the cube: edges of 0.42 m become 0.4 m, finer ones hardly change.
    assert np.allclose(np.divide(sizes[:-1], sizes[1:]), 4.0 / 3.0, rtol=0.06)
    finest = found[f"cells of {sizes[-1]:.2f} mm"]
    agree("over literature", found["finest over literature"], finest / 0.47, 1e-12)
    assert found["drag coefficient, relative error, goal of 0.15"] == "met"  # 14 % off
    off = found[f"cells of {sizes[0]:.2f} mm: total force from that of the finest mesh [m2]"]
    agree("difference", off, 1.25 * (found[f"cells of {sizes[0]:.2f} mm"] - finest) * np.pi * 0.0432**2, 1e-9)


def test_the_cylinder_is_five_diameters_long(measured):
    subject = verify.subject_of("cylinder")
    diameter, _, length = np.ptp(subject.surfaces["cylinder"].triangles.reshape(-1, 3), axis=0)
    polygon = "a polygon stands for the circle"
    measured("length over five diameters", abs(length / (5.0 * diameter) - 1.0), 0.02, because=polygon)
    measured("area over the frontal one", abs(subject.area / (diameter * length) - 1.0), 0.02, because=polygon)


def test_rows_are_matched_directly_or_as_mirror_images_and_averaged_with_them(collected):
    ours = compare.symmetrise(collected)
    # Hovering in head wind is its own mirror image: the average has no side force.
    assert np.abs(ours.force_area_b.sum(axis=1)[ours.posture == "hovering", 1]).max() == 0.0
    # Nor has it couples about the axes of its plane of symmetry.
    assert np.abs(ours.couple_volume_b.sum(axis=1)[ours.posture == "hovering"][:, [0, 2]]).max() == 0.0
    images = ours.add_mirror_images().take(slice(len(ours), None))
    table = dataclasses.replace(images, is_mirrored=np.zeros(len(ours), dtype=bool))
    here, there, rows = compare.match_cases(ours, table)
    np.testing.assert_array_equal(rows, np.arange(len(ours)))
    np.testing.assert_array_equal(here.force_area_b, there.force_area_b)


@pytest.fixture(scope="module")
def collected(small, tmp_path_factory):
    """Results of the small design: its accepted cases."""
    folder = tmp_path_factory.mktemp("collected") / "result"
    command.compute(small, folder, Fake())
    command.collect(small, folder)
    return ds.load(folder / "dataset.nc", load_robot(ROBOT))


def test_errors_are_those_of_a_model_that_is_a_tenth_off(collected, agree):
    """A tenth more in every other row, a tenth less in the rest: no error in the mean."""
    described = load_robot(ROBOT)
    sign = np.resize([1.0, -1.0], len(collected))[:, None, None]
    found = compare.errors(described, (1.0 + 0.1 * sign) * collected.force_area_b, collected)
    wrench = total_wrench(described, collected.joint_position(described), collected.force_area_b)
    rms = [np.sqrt(np.mean(np.sum(part**2, axis=1))) for part in (wrench.force_area, wrench.moment_volume)]
    expected = [0.0, 0.1, 0.1 * rms[0], 0.01 * np.mean(collected.force_area_b**2), 0.1 * 61.25 * rms[1]]
    agree("errors", list(found.values()), expected, 1e-12)


def test_mirror_images_are_compared_with_each_other(collected, agree):
    """The force of every second image is a tenth greater."""
    described, half = load_robot(ROBOT), collected.take(collected.posture == "Config5")
    assert compare.asymmetry(described, half) == {}
    both = half.add_mirror_images()
    scale = np.where(both.is_mirrored, 1.1, 1.0)[:, None, None]
    none = np.zeros(len(both), dtype=bool)
    both = dataclasses.replace(both, is_mirrored=none, force_area_b=scale * both.force_area_b)
    found = compare.asymmetry(described, both)
    assert found["mirror images: pairs"] == len(half)
    agree("drag", found["mirror images: drag, relative error, mean"], 0.1, 1e-12)
    expected = 0.01 * np.mean(half.force_area_b**2)
    agree("links", found["mirror images: links, mean square [m4]"], expected, 1e-12)


def test_cases_are_compared_with_models_and_with_rows_of_a_table(collected, tmp_path, monkeypatch, agree):
    """The table has half the forces, in one posture; the model none."""
    none = np.zeros_like(collected.force_area_b)
    monkeypatch.setattr(compare, "models_at", lambda *_: {"none": none})
    hovering = collected.take(collected.posture == "hovering")
    ds.save(dataclasses.replace(hovering, force_area_b=0.5 * hovering.force_area_b), tmp_path / "table.nc")
    ds.save(collected, tmp_path / "dataset.nc")
    ours = {"dataset": tmp_path / "dataset.nc"}
    found = compare.compute("small", compare.CompareConfig(**ours, table=tmp_path / "table.nc"))
    assert set(models.MODEL_FILES) <= set(found.files)
    assert found.summary["cases with a counterpart in the table"] == len(hovering)
    agree("ours", found.summary[f"hovering ({len(hovering)}): drag, relative error, mean"], 1.0, 1e-12)
    agree("model", found.summary["none, beside the table: drag, relative error, mean"], -1.0, 1e-12)
    key = "open solver, beside the table: drag, relative error, rms, goal of 0.1"
    assert found.summary[key] == "missed, 10 times that"
    assert [name for name in found.summary if "goal" in name] == [
        f"open solver, beside the table: {name}, goal of {goal:g}" for name, goal in [*goals.GOALS.items()][:3]
    ]
    half = np.sqrt(np.mean(np.sum((0.5 * hovering.force_area_b) ** 2, axis=2), axis=0))
    names = [f"open solver, beside the table: {link}, rms [m2]" for link in LINKS]
    agree("links", [found.summary[name] for name in names], half, 1e-12)
    assert found.dataset["model"].values.tolist() == [compare.OPEN, "none", "compared with"]
    assert found.dataset.sizes["row"] == len(hovering)
    alone = compare.compute("small", compare.CompareConfig(**ours))
    assert alone.dataset["model"].values.tolist() == ["none", "compared with"]
    assert alone.summary["cases"] == len(collected)
    assert alone.summary["moment about the centre of mass, couples on links, rms [N m at 10 m/s]"] > 0.0
    with pytest.raises(Refused, match="make it with: jax-aero cfd nowhere"):
        compare.compute("nowhere", compare.CompareConfig())


def test_a_network_is_judged_on_the_rows_it_was_trained_beside(collected, tmp_path, monkeypatch):
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    assert held_out_network("small", collected) is None
    both = collected.add_mirror_images()
    run = xr.Dataset(
        {
            "is_mirrored": ("row", both.is_mirrored.astype(int)),
            "wind": (("row", "xyz"), both.wind_b),
            "area_grouped": (("row", "link", "xyz"), 2.0 * both.force_area_b),
        }
    )
    record.write_run(tmp_path / "training" / "small", run, {"dataset": both.sha256})
    found = held_out_network("small", collected)
    np.testing.assert_allclose(found, 2.0 * collected.force_area_b)
    with pytest.raises(Refused, match="is of another dataset"):
        held_out_network("small", dataclasses.replace(collected, force_area_b=2.0 * collected.force_area_b))


def test_the_wake_is_where_air_is_slow_and_counts_by_area(monkeypatch, agree):
    """Three cells in a row, 1, 3 and 1 m long; the air is slow in two of them."""
    cells = pyvista.RectilinearGrid([-2.0, -1.0, 2.0, 3.0], [-1.0, 1.0], [-1.0, 1.0]).cast_to_unstructured_grid()
    wall = pyvista.Sphere(radius=0.3)
    cells.cell_data.update({"speed": [0.1, 0.4, 0.9], "viscosity": [30.0, 200.0, 900.0], "pressure": np.zeros(3)})
    cells.cell_data["U"] = [[17.0, 0.0, 0.0]] * 3
    wall["pressure"] = wall.points[:, 0]
    is_upper = wall.cell_centers().points[:, 2] > 0.15  # a cap of a quarter of the sphere
    wall.cell_data["viscosity"] = np.where(is_upper, 101.0, 99.0)
    result = simulate.Result("", dict.fromkeys(LINKS, (0.01, 0.0, -0.01)), {}, {"pressure share of the force": 0.9})
    monkeypatch.setattr(foam, "environment", lambda: None)
    monkeypatch.setattr(flow, "make_mesh", lambda *_: FACTS)
    monkeypatch.setattr(flow, "solve", lambda *_: result)
    monkeypatch.setattr(flow, "read_case", lambda *_: (cells.cell_data_to_point_data(pass_cell_data=True), wall))
    config = flow.FlowConfig(title="a flow", posture="flight30", pitch_deg=45.0)
    found = flow.compute("", config)
    agree("drag", found.summary["drag [m2]"], 0.13 * np.sqrt(2.0), 1e-12)
    agree("largest", found.summary["turbulent over molecular viscosity, largest in the plane"], 900.0, 1e-12)
    # Single precision: areas of triangles, each within a few roundings of 6e-8.
    agree("wake", found.summary["part of the wake in the plane where that is above 100"], 0.75, 1e-6)
    # The cap's edge is that of triangles of 6°.
    assert found.summary["part of the surface where that is above 100"] == pytest.approx(0.25, abs=0.04)
    assert np.ptp(found.dataset["plane_position"].values, axis=0).tolist() == [5.0, 0.0, 2.0]
    assert found.dataset["line_speed"].values.min() >= 0.1 - 1e-6
    assert found.dataset["wall_pressure"].attrs == {"units": "1", "long_name": "pressure coefficient"}
    with pytest.raises(Refused, match="`posture` is `flying`; expected one of"):
        flow.compute("", msgspec.structs.replace(config, posture="flying"))
    monkeypatch.setattr(flow, "solve", lambda *_: simulate.Result(reason="the force drifts"))
    with pytest.raises(Refused, match="the force drifts"):
        flow.compute("", config)


@pytest.mark.parametrize("name", ["open", "mk3"])
def test_a_shipped_dataset_has_accepted_cases_of_its_design_alone(name):
    """Cases of other settings, or ones that its tests refuse, would go unnoticed into every model."""
    made = design.Design.read(name, {})
    data = ds.load(f"configs/aero/datasets/{name}.nc", load_robot(made.spec.robot))
    designed = {(case.posture, case.pitch_deg, case.yaw_deg) for case in made}
    found = set(zip(data.posture.tolist(), data.pitch_deg.tolist(), data.yaw_deg.tolist(), strict=True))
    assert found <= designed
    assert len(found) == len(data)
    accept = made.spec.settings.accept
    assert data.quality["drift"].max() <= accept.drift
    assert data.quality["oscillation"].max() <= accept.oscillation
    written = tables.convert(json.loads(data.provenance["settings"]), settings.Settings, "settings")
    assert written == made.spec.settings


def test_a_program_runs_on_one_or_several_processors_and_says_how_it_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(foam, "environment", lambda: None)
    (tmp_path / "mpirun").write_text("#!/bin/sh\necho several: $@\n")
    (tmp_path / "mpirun").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    assert foam.run(["echo", "one"], tmp_path).strip() == "one"
    assert foam.run(["echo"], tmp_path, ranks=2).strip() == "several: --oversubscribe -np 2 echo -parallel"
    with pytest.raises(Refused, match="sh was ended by a signal; the same command goes on"):
        foam.run(["sh", "-c", "kill -TERM $$"], tmp_path)
    with pytest.raises(foam.Failed, match="sh ended with status 3: broken"):
        foam.run(["sh", "-c", "echo broken; exit 3"], tmp_path)


def test_without_openfoam_the_command_names_what_installs_it(monkeypatch, capsys):
    monkeypatch.setenv("PATH", "/nowhere")
    assert cfd_command.main(["anchors"]) == REFUSED
    assert "apt-get install openfoam" in capsys.readouterr().err


@pytest.mark.skipif(shutil.which("simpleFoam") is None, reason=foam.MISSING.format("simpleFoam"))
def test_a_sphere_is_dragged_along_the_wind(tmp_path):
    """A coarse sphere, 0.6 m wide: 40 iterations are enough for direction and size of its drag."""
    wind = np.array([0.6, 0.0, 0.8])
    ahead = {"ahead": geometry.Tap(-0.28 * wind, -wind)}
    sphere = geometry.Surface(geometry.triangles_of("sphere", (0.3, 0.3, 0.3)), np.zeros(3), ahead)
    shells = tuple(settings.Shell(distance=d, level=n) for d, n in ((0.11, 3), (0.25, 2), (0.8, 1)))
    chosen = settings.Settings(
        mesh=settings.Mesh(half_width=3.0, base=0.5, surface_level=3, shells=shells),
        solver=settings.Solver(upwind_iterations=8, iterations=40, window=16, sampling=2),
        accept=settings.Accept(drift=0.2, oscillation=0.2),
    )
    facts = simulate.make_mesh({"head": sphere}, chosen, tmp_path)
    result = simulate.solve({"head": sphere}, wind, chosen, tmp_path, facts)
    assert result.reason == ""
    area = np.array(result.force_area_b["head"])
    # 0.1 to 0.5 is every drag coefficient that was measured on a sphere from 1e5 to 1e6 (Achenbach 1972).
    assert 0.1 < area @ wind / (np.pi * 0.09) < 0.6
    # Where the air stands the pressure coefficient is 1; the limited scheme overshoots by a little.
    cells, wall = flow.read_case(tmp_path, chosen.solver.ranks, chosen.air)
    assert cells.n_cells == facts.cells
    assert 0.8 < wall["pressure"].max() < 1.2
    assert 0.8 < result.cp["ahead"] < 1.2
    assert np.abs(np.linalg.norm(wall.points, axis=1) - 0.3).max() < chosen.mesh.finest
    # The air moves along the lines, none of which goes through the sphere. Time is negative along those against it.
    lines = flow.streamlines(cells, wall)
    start, end = (lines.line_connectivity[at] for at in (lines.line_offsets[:-1], lines.line_offsets[1:] - 1))
    ways = (lines.points[end] - lines.points[start]) @ wind
    assert np.mean(ways * lines["IntegrationTime"][end] > 0.0) > 0.9
    assert np.linalg.norm(lines.points, axis=1).min() > 0.3 - chosen.mesh.finest
    # On ten cells a diameter the steady wake leans to one side.
    assert np.linalg.norm(area - (area @ wind) * wind) < 0.3 * (area @ wind)


@pytest.fixture
def made_up_flow(tmp_path):
    """Results of `cfd-flow`: a ball, the plane through it, a line before it."""
    ball, plane = pyvista.Sphere(radius=0.1), pyvista.Plane(direction=(0.0, 1.0, 0.0)).triangulate()
    line = pyvista.MultipleLines([[-0.5, 0.0, 0.2], [0.0, 0.0, 0.2], [0.5, 0.0, 0.3]])
    for part in (ball, plane, line):
        part.point_data.update(dict.fromkeys(flow.FIELDS, part.points[:, 0]))
    data = flow.to_dataset(ball, plane, line).assign_attrs(wind=[0.6, 0.0, 0.8], config_hash="abc")
    for cells, name in enumerate(FIGURES["cfd_meshes"].runs, 1):
        folder = tmp_path / "cfd_flow" / name
        folder.mkdir(parents=True)
        data.assign_attrs(cells=1000 * cells, edge=0.01 / cells).to_netcdf(folder / "run.nc", engine="h5netcdf")
    return tmp_path


def test_the_picture_of_a_flow_is_drawn(made_up_flow):
    try:
        cfd_flow.plotter().close()
    except MissingRun as missing:
        pytest.skip(str(missing))
    figure, hashes = FIGURES["cfd_flow"].draw_from_results(made_up_flow)
    assert hashes == {"flight30": "abc"}
    rendered = figure.axes[0].images[0].get_array()
    # Behind is white; before it are the ball, in colours from blue to red, and the line.
    assert (rendered[0, 0] == 255).all()
    seen = (rendered.min(axis=-1) < 250).mean()
    assert 0.005 < seen < 0.5


def test_meshes_are_drawn_side_by_side_with_their_sizes(made_up_flow):
    figure, hashes = FIGURES["cfd_meshes"].draw_from_results(made_up_flow)
    assert [*hashes] == [*FIGURES["cfd_meshes"].runs]
    titles = [axes.get_title("left") + axes.get_title() for axes in figure.axes[:3]]  # where depends on the style
    assert titles == ["10.0 mm, 1 thousand cells", "5.0 mm, 2 thousand cells", "3.3 mm, 3 thousand cells"]


def test_what_a_picture_of_a_flow_lacks_is_named(made_up_flow, monkeypatch, capsys):
    arguments = ["cfd_flow", "--stale", "--results", str(made_up_flow), "--out", str(made_up_flow)]
    monkeypatch.setattr(cfd_flow, "find_library", lambda _: None)
    monkeypatch.setenv("VTK_DEFAULT_OPENGL_WINDOW", "vtkOSOpenGLRenderWindow")
    assert figures(arguments) == 1
    assert "no off-screen OpenGL; install EGL or OSMesa" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "pyvista", None)
    assert figures(arguments) == 1
    assert "of the extra `flow`: " in capsys.readouterr().err


def test_a_mesh_without_triangles_or_with_a_corner_nowhere_is_refused(tmp_path):
    corner = "v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n"
    for name, text, words in (
        ("flat.obj", corner, "not finite"),
        ("none.obj", "v 0 0 0\n", "cannot be read|no triangle"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(Refused, match=words):
            mesh.read_mesh(tmp_path / name)

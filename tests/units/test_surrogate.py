"""The panel model: geometry, symmetry, limits, its file, and what it reaches beside the wind tunnel."""

import json
from pathlib import Path

import numpy as np
import pytest

from experiments import calibrate_surrogate, import_cfd, surrogate_dataset
from jax_aero import places
from jax_aero.aero import dataset as ds
from jax_aero.aero import fit, surrogate, surrogate_fit
from jax_aero.aero.dataset import LINKS
from jax_aero.aero.posture import _frames, link_frames
from jax_aero.command import INTERRUPTED
from jax_aero.robot import load_robot
from paper_figs.figures import FIGURES
from tests.measurements import measured


@pytest.fixture(scope="module")
def robot():
    return load_robot(surrogate_dataset.ROBOT)


@pytest.fixture(scope="module")
def model(robot):
    return surrogate.load_surrogate(surrogate_dataset.SURROGATE, robot)


@pytest.fixture(scope="module")
def cases():
    """A few postures in a few winds."""
    rng = np.random.default_rng(8)
    joints = rng.uniform(-25.0, 25.0, (6, 19))
    joints[0] = import_cfd.known_postures()["hovering"]
    wind = rng.normal(size=(6, 3))
    return joints, wind / np.linalg.norm(wind, axis=1, keepdims=True)


def test_link_frames_compile_once(robot):
    link_frames(robot, np.zeros((1, 19)))
    compiled = _frames._cache_size()
    link_frames(robot, np.ones((1, 19)))
    assert _frames._cache_size() == compiled


@pytest.fixture(scope="module")
def features(robot, model, x64):
    return surrogate.batched_features(robot, model.panels, model.wake, np.float64)


@pytest.mark.parametrize(("diameter", "length"), [(0.2, 0.0), (0.1, 0.3), (0.25, 0.17)])
def test_a_capsule_has_the_area_of_its_body_and_is_closed(diameter, length, agree):
    area, normal, position = surrogate.capsule(diameter, length, 0.03)
    agree("area", area.sum(), np.pi * diameter * (diameter + length), 1e-12)
    np.testing.assert_allclose(area @ normal, 0.0, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0)
    # The volume, by the divergence theorem; panels cut corners.
    volume = np.sum(area * np.sum(normal * position, axis=1)) / 3.0
    agree("volume", volume, np.pi * diameter**2 * (length / 4 + diameter / 6), 0.02)


def test_every_link_is_closed_and_lies_where_its_twin_is_mirrored(model):
    link = np.array(model.panels.link)
    for index in range(len(LINKS)):
        own = link == index
        np.testing.assert_allclose(model.panels.area[own] @ model.panels.normal_l[own], 0.0, atol=1e-15)
        twin = link == ds.LINK_TWINS[index]
        np.testing.assert_array_equal(model.panels.area[own], model.panels.area[twin])


def test_uniform_pressure_pushes_nothing(model):
    """No force acts on a closed body in uniform pressure: pressure that is the same everywhere adds up to zero."""
    of_link = np.array(model.panels.link)[:, None] == np.arange(13)
    push = (model.panels.area[:, None] * model.panels.normal_l).T @ of_link
    np.testing.assert_allclose(push, 0.0, atol=1e-15)


def test_without_coefficients_there_is_no_force(cases, features):
    np.testing.assert_array_equal(surrogate.force_areas(np.zeros((13, 12)), features(*cases)), 0.0)


@pytest.mark.close_to_tolerance("the robot itself is symmetric to some tens of micrometres, not to rounding")
def test_the_force_on_the_mirror_image_is_mirrored(cases, features, model):
    joints, wind = cases
    areas = surrogate.force_areas(model.coefficients, features(joints, wind))
    images = surrogate.force_areas(model.coefficients, features(ds.mirrored_joints(joints), wind * ds.MIRROR_AXES))
    # The robot itself is symmetric to some tens of micrometres.
    np.testing.assert_allclose(images, ds.mirrored_areas(areas), atol=2e-5)
    assert np.abs(areas).max() > 0.02


@pytest.mark.close_to_tolerance("the robot itself is symmetric to some tens of micrometres, not to rounding")
def test_left_and_right_feel_the_same_where_all_is_symmetric(features, model):
    joints = import_cfd.known_postures()["hovering"][None]
    areas = surrogate.force_areas(model.coefficients, features(joints, np.array([[1.0, 0.0, 0.0]])))
    np.testing.assert_allclose(ds.mirrored_areas(areas), areas, atol=2e-5)
    measured("side area [m2]", abs(areas.sum(axis=1)[0, 1]), 2e-5)


def test_drag_is_positive_in_every_wind(features, model):
    pitch, yaw = (grid.ravel() for grid in np.meshgrid(np.arange(0, 181, 45.0), np.arange(0, 360, 60.0)))
    wind = ds.wind_direction(pitch, yaw)
    joints = np.tile(import_cfd.known_postures()["flight60"], (len(wind), 1))
    drag = np.einsum("nla,na->n", surrogate.force_areas(model.coefficients, features(joints, wind)), wind)
    assert np.all((drag > 0.05) & (drag < 0.5))


@pytest.mark.close_to_tolerance("a claim about the tail of a smooth wake, not about rounding")
def test_a_body_upstream_takes_pressure_from_what_is_behind_it_and_fills_the_base_ahead(model):
    source, wind = np.zeros((1, 3)), np.array([1.0, 0.0, 0.0])
    places = np.array([[0.3, 0.0, 0.0], [0.3, 0.6, 0.0], [-0.3, 0.0, 0.0], [-0.03, 0.0, 0.0]])
    behind, beside, ahead, close = range(4)
    eta, filled = (np.asarray(x) for x in surrogate._wakes(model.wake, places, source, np.array([0.02]), wind))
    assert 0.1 < eta[behind] < 0.9
    np.testing.assert_allclose(eta[[beside, ahead]], 1.0, atol=0.01)
    assert filled[close] > 10.0 * max(filled[behind], filled[beside], filled[ahead])


def test_blocks_do_not_change_a_row(robot, model, cases):
    joints, wind = cases
    batched = surrogate.batched_features(robot, model.panels, model.wake)
    together = batched(np.tile(joints, (12, 1)), np.tile(wind, (12, 1)))
    assert len(together) == 72 > surrogate.BLOCK
    np.testing.assert_array_equal(together[66:], batched(joints, wind))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("gamma = 2.0", "gamma = -2.0", "`wake.gamma` is -2.0; expected a number > 0"),
        ("gamma = 2.0", "gama = 2.0", "`wake` has gama, .*; expected gamma, "),
        ("head = [", "head = [1.0, ", "`coefficients.head` has 13 numbers; expected 12"),
        ("head = [", "head = 1.0 #", "`coefficients.head` is 1.0; expected a list"),
        ("spacing = 0.045", "spacing = true", "`panels.spacing` is true; expected a number > 0"),
    ],
)
def test_a_bad_file_is_refused(robot, tmp_path, old, new, message):
    path = tmp_path / "surrogate.toml"
    text = surrogate_dataset.SURROGATE.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(ValueError, match=message):
        surrogate.load_surrogate(path, robot)


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(places, "RESULTS", folder)
        # The penalties that ship; trying all of them takes a while.
        patch.setattr(surrogate_fit, "GRID", {"to_common": (10.0,), "to_zero": (1.0,)})
        document = calibrate_surrogate.STUDY.run("calibration")
    return folder, document


def test_the_shipped_coefficients_are_those_of_the_calibration(calibrated, robot, model):
    again = surrogate.load_surrogate(calibrated[0] / "calibrate_surrogate" / "calibration" / "surrogate.toml", robot)
    np.testing.assert_allclose(again.coefficients, model.coefficients, atol=2e-3)


@pytest.mark.close_to_tolerance("the error is printed with four digits")
def test_postures_it_has_not_seen_come_out_twice_as_well_as_with_the_axisymmetric_model(calibrated, measured):
    found = calibrated[1]["summary"]
    for posture, ours, axisymmetric in (("flight50", 0.0149, 0.0351), ("flight60", 0.0190, 0.0376)):
        assert found[f"{posture} (held out), surrogate: rms vector error [m2]"] < ours
        error = found[f"{posture} (held out), corrected: rms vector error [m2]"]
        measured("error", abs(error - axisymmetric), 1e-4)


def test_the_figure_is_drawn(calibrated):
    _, hashes = FIGURES["surrogate"].draw_from_results(calibrated[0] / "flight")
    assert set(hashes) == {"calibration"}
    manifest = json.loads((calibrated[0] / "calibrate_surrogate" / "calibration" / "manifest.json").read_text())
    assert manifest["config_digest"] == hashes["calibration"]


def test_common_law_and_curves_are_recovered_from_forces_made_with_them(robot):
    """Records made with one law of pressure, and nothing else known: the fit reproduces them."""
    rng = np.random.default_rng(3)
    size = surrogate_fit.N_FAMILIES * surrogate_fit.N_TERMS
    truth = np.tile(rng.normal(size=surrogate_fit.N_TERMS), surrogate_fit.N_FAMILIES)
    design = rng.normal(size=(60, 3, size))
    nothing = surrogate_fit.Normal(np.zeros((size, size)), np.zeros(size))
    made = surrogate_fit.Calibration(nothing, design, design @ truth, ("a",) * 30 + ("b",) * 30)
    settings = surrogate_fit.Settings(to_common=1e6, to_zero=1e-9)
    np.testing.assert_allclose(surrogate_fit.solve(made, settings).ravel(), truth, atol=1e-4)
    measured("left-out error", surrogate_fit.left_out_error(made, settings), 1e-3)


def test_a_small_dataset_is_written_interrupted_and_resumed(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(surrogate_dataset, "PITCHES", np.array([0.0, 90.0, 180.0]))
    monkeypatch.setattr(surrogate_dataset, "YAWS", np.array([0.0, 60.0, 180.0]))
    out = tmp_path / "s.nc"
    arguments = ["--out", str(out), "--only", "hovering", "Config2"]
    calls = []

    def interrupt(coefficients, features):
        calls.append(len(features))
        if len(calls) == 2:
            raise KeyboardInterrupt
        return surrogate.force_areas(coefficients, features)

    monkeypatch.setattr(surrogate_dataset, "force_areas", interrupt)
    assert surrogate_dataset.main(arguments) == INTERRUPTED
    assert "go on with the same command" in capsys.readouterr().err
    assert not out.exists()
    assert surrogate_dataset.main(arguments) == 0
    assert calls == [9, 9, 9]  # the first posture was not computed again
    data = ds.load(out)
    assert (len(data), data.postures) == (36, ("hovering", "Config2"))
    measured("distance [m2]", data.checks["their distance from it, largest [m2]"], 1e-4)
    assert [path.name for path in tmp_path.iterdir()] == ["s.nc"]


def test_postures_are_the_papers_in_number():
    assert [len(surrogate_dataset.posture_names(count)) for count in (24, 30)] == [24, 30]
    assert surrogate_dataset.posture_names(30)[:3] == ["hovering", "flight30", "flight60"]


def test_a_posture_that_is_given_twice_is_refused(tmp_path, capsys):
    words = ["--out", str(tmp_path / "a.nc"), "--only", "hovering", "hovering"]
    assert surrogate_dataset.main(words) == 2
    assert "the postures are hovering, hovering; expected each once" in capsys.readouterr().err


def test_families_are_those_of_the_robot():
    toml = Path(surrogate_dataset.ROBOT).read_text()
    for family, links in fit.FAMILIES.items():
        assert toml.count(f'family = "{family}"') == len(links)

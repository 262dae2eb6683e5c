"""Pressures of the open solver beside those of the tunnel: where a tap is read, which points it is compared with."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from jax_aero import rust
from jax_aero.base.terminal import Refused
from jax_aero.cfd import case, design, foam, geometry, settings, simulate, taps
from jax_aero.cfd import compute as command
from jax_aero.data.import_cfd import known_postures
from paper_figs import cfd_taps

ROBOT = Path("configs/robot/ironcub_mk1.toml").resolve()


def test_a_pressure_is_read_before_its_tap_and_is_the_mean_of_the_last_window(tmp_path):
    tap = geometry.Tap(np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.0, 1.0]))
    surfaces = {
        "head": geometry.Surface(np.zeros((1, 3, 3)), np.zeros(3), {"A1": tap, "A2": tap}),
        "chest": geometry.Surface(np.zeros((1, 3, 3)), np.zeros(3)),
    }
    air = settings.Air(speed=10.0)
    reports = case.reports_of(surfaces, air, settings.Solver(), 80)
    assert [name for name in reports if name.endswith(foam.TAPS)] == ["head_taps"]
    assert reports["head_taps"]["patches"] == ["head"]
    np.testing.assert_allclose(reports["head_taps"]["probeLocations"], [[0.1, 0.2, 0.3 + case.BEFORE]] * 2)
    for start, rows in ((16, "80 999 999\n"), (80, "84 10 -20\n112 30 -40\n")):
        folder = tmp_path / "postProcessing" / "head_taps" / str(start)
        folder.mkdir(parents=True)
        (folder / "p").write_text(f"# Probe 0 (0.1 0.2 0.3)\n# Time\n{rows}")
    assert dict(simulate.read_cp(surfaces, air, tmp_path)) == {"A1": 0.4, "A2": -0.6}


def test_taps_of_another_robot_are_refused():
    robot = rust.Robot(ROBOT)
    tail = {"X1": {"link": "tail", "position": [0.0] * 3, "normal": [0.0] * 3}}
    with pytest.raises(Refused, match="tap X1 is on `tail`, which is no link of iRonCub-Mk1"):
        geometry.robot_surfaces(robot, known_postures()["hovering"], None, tail)
    with pytest.raises(Refused, match='`taps` is "mk2"; expected one of mk1, mk3'):
        _ = design.Design.read("mk1_taps", {"taps": "mk2"}).taps


def test_pressures_enter_the_digest_and_a_posture_may_have_winds_of_its_own():
    made, other = (design.Design.read("mk1_taps", {"taps": name}) for name in ("mk1", ""))
    assert made.digest != other.digest
    assert {len(cases) for cases in made.cases.values()} == {2, 4}


@pytest.fixture
def computed(tmp_path, monkeypatch):
    """A design of two postures, one of them held out, in wind from ahead, whose taps all read cos."""

    def read_cos(surfaces, winds, *_):
        for wind in winds:
            area = dict.fromkeys(surfaces, (0.01, 0.0, 0.0))
            cos = {tap: float(-on.normal @ wind) for part in surfaces.values() for tap, on in part.taps.items()}
            yield simulate.Result("", area, area, {"cells": 7.0}, cos)

    path = tmp_path / "small.toml"
    path.write_text(
        f'title = "x"\nrobot = "{ROBOT}"\ntaps = "mk1"\npostures = ["hovering", "flight60"]\n'
        'winds = { design = "list", pitch_deg = [90], yaw_deg = [0] }\n'
    )
    monkeypatch.setattr(command, "RESULTS", tmp_path / "cfd")
    made = design.Design.read(str(path), {})
    command.compute(made, command.folder_of(made), read_cos)
    return path


TAPS = ("A7", "A19", "I4", "I6", "S1")
"""On the forehead, the back of the head and two on the left thigh; S1 has no position."""


def points_of(rows, flags=(), robot="mk1"):
    """Made-up points: posture, speed, mark and the coefficient of all taps; `flags` are doubtful in the first."""
    posture, speed, marks, cp = zip(*rows, strict=True)
    flag = np.zeros((len(rows), len(TAPS)), dtype="i1")
    flag[0] = [tap in flags for tap in TAPS]
    return xr.Dataset(
        {
            "cp": (("point", "tap"), np.repeat(np.array(cp)[:, None], len(TAPS), axis=1) + 0.1 * np.arange(len(TAPS))),
            "flag": (("point", "tap"), flag),
            "speed": ("point", list(speed)),
            "pitch": ("point", [90.0] * len(rows)),
            "yaw": ("point", [0.4] * len(rows)),
        },
        {"posture": ("point", list(posture)), "marks": ("point", list(marks)), "tap": list(TAPS)},
        {"robot": robot},
    )


def compare(computed, points):
    path = computed.with_name("pressures.nc")
    points.to_netcdf(path, engine="h5netcdf")
    return taps.compute(str(computed), taps.TapsConfig(pressures=path))


def test_a_case_is_compared_with_the_mean_of_its_points_without_doubtful_taps(computed, agree):
    """A point at 12 m/s and a doubtful one are left out; a tap that leaks in one of two points is that of the other."""
    rows = [("hovering", 17.0, "", 0.2), ("hovering", 17.5, "", 0.4), ("flight60", 17.0, "", 0.0)]
    rows += [("hovering", 12.0, "", 9.0), ("hovering", 17.0, "outlier", 9.0), ("Config5", 17.0, "", 9.0)]
    found = compare(computed, points_of(rows, flags=("I4",)))
    data = found.dataset
    assert data["tap"].values.tolist() == ["A7", "A19", "I4", "I6"]
    agree("tunnel", data["cp_tunnel"].values, [[0.3, 0.4, 0.6, 0.6], [0.0, 0.1, 0.2, 0.3]], 1e-12)
    # The forehead faces the air, the back of the head has the base pressure, an outer thigh is a side.
    cos, newton = data["cos"].values[0], data["cp_newton"].values[0]
    assert cos[0] > 0.99
    assert cos[1] < -0.9
    assert abs(cos[2]) < 0.2
    agree("Newton", newton, [1.4 * cos[0] ** 2 - 0.4, -0.4, *(1.4 * np.maximum(cos[2:], 0.0) ** 2 - 0.4)], 1e-12)
    agree("flow", data["cp"].values[0], cos, 1e-12)
    assert [found.summary[key] for key in ("all: pairs", "head: pairs", "held-out postures, all: pairs")] == [4, 2, 4]
    off = cos - [0.3, 0.4, 0.6, 0.6]
    agree("rms", found.summary["all: flow, rms"], np.sqrt(np.mean(off**2)), 1e-12)
    agree("sides", found.summary["sides: flow less tunnel, mean"], np.mean(off[2:]), 1e-12)
    assert found.summary["back: Newton, rms"] < found.summary["back: flow, rms"]
    assert "back" in found.summary["flow no better than Newton's formula, by rms"]


def test_the_picture_shows_only_taps_that_face_the_viewer(computed):
    """From ahead the forehead is seen, and the thigh's side from the left; no coefficient is drawn where none is."""
    found = compare(computed, points_of([("hovering", 17.0, "", 0.2)], flags=("I6",)))
    axes = cfd_taps.draw(found.dataset).axes
    drawn = [axes[place].collections[1].get_offsets().tolist() for place in (0, 3)]
    place = found.dataset["position"].values[0]
    assert drawn == [[[-place[0, 1], place[0, 2]]], [[place[2, 0], place[2, 2]]]]
    assert -place[2, 1] > 0.05  # the left thigh is to the right of the picture from ahead


def test_pressures_of_another_robot_or_posture_are_refused(computed):
    with pytest.raises(Refused, match="has taps of mk3; expected mk1"):
        compare(computed, points_of([("hovering", 17.0, "", 0.2)], robot="mk3"))
    with pytest.raises(Refused, match="no case has the posture, wind and speed"):
        compare(computed, points_of([("hovering", 12.0, "", 0.2)]))

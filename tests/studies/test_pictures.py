"""Pictures, and the drawing of the tunnel, from a study made up."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from experiments.studies.pictures import figure as pictures_figure
from experiments.studies.pictures import study as pictures
from jax_aero import rust
from jax_aero.base import tables
from jax_aero.base.files import write_netcdf
from jax_aero.base.places import ROBOT
from jax_aero.data.import_cfd import known_postures
from jax_aero.data.ironcub import joint_position
from jax_aero.figures.catalogue import FIGURES


def test_capsules_are_where_the_robots_file_has_them(agree):
    robot = rust.Robot(str(ROBOT))
    joints = joint_position(robot, known_postures()["Config1"])
    starts, ends, diameters = pictures.capsules(joints)
    links = tables.read(ROBOT)["aero_links"]
    agree("lengths", np.linalg.norm(ends - starts, axis=1)[1:], [link["length"] for link in links[1:]], 1e-12)
    agree("diameters", diameters, [link["diameter"] for link in links], 1e-15)
    pelvis = list(robot.aero_link_names).index("root_link")
    agree("centre of the base", 0.5 * (starts + ends)[pelvis], links[pelvis]["centre"], 1e-12)


@pytest.mark.parametrize("name", ["fig5a", "postures", "fig2_setup"])
def test_pictures_are_shown(name, tmp_path):
    names = list(known_postures(["free_stream", "tunnel"]))
    starts = np.array([[0.0, 0.1, -0.2], [0.0, 0.0, 0.4]])
    study = xr.Dataset(
        {
            "flight": (("row", "column", "colour"), np.zeros((6, 8, 3), np.uint8), {"long_name": "made up"}),
            "posture_picture": (("posture", "r", "c", "colour"), np.zeros((len(names), 4, 3, 3), np.uint8)),
            "link_start": (("link", "xyz"), starts),
            "link_end": (("link", "xyz"), starts + np.array([[0.0, 0.0, 0.3], [0.0, 0.0, 0.0]])),
            "link_diameter": (("link",), [0.1, 0.2]),
        },
        {"posture": names},
        {"config_hash": "0"},
    )
    folder = tmp_path / "pictures" / "paper"
    folder.mkdir(parents=True)
    write_netcdf(folder / "run.nc", study)
    figure, hashes = FIGURES[name].draw_from_results(tmp_path)
    assert hashes == {"paper": "0"}
    titles = [axes.get_title(loc="center") for axes in figure.axes]
    assert name != "postures" or titles[: len(names)] == names


def test_the_drawn_robot_leans_into_the_wind_and_turns_left(agree):
    """M28: tunnel from base is R_z(β) R_y(α − 90°): at α = 45° the head goes upwind, and β turns about z."""
    up, back = np.eye(3)[2], np.eye(3)[0]
    half = np.sqrt(0.5)
    agree("head", pictures_figure._turn_points(up, 45.0, 0.0), [-half, 0.0, half], 1e-14)
    agree("back", pictures_figure._turn_points(back, 90.0, 90.0), [0.0, 1.0, 0.0], 1e-14)

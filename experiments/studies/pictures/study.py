"""Pictures for figures of the paper: a hovering flight in the wind, and the postures of the campaigns.

`jax-aero study pictures` renders with MuJoCo's offscreen renderer, as the viewer does, and writes pixels, and
the links of the hovering posture as capsules, to `results/pictures/paper/`. `jax-aero figures fig5a postures
fig2_setup` draws the figures. The flight is `results/flight/test2`.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base import tables
from jax_aero.base.places import ROBOT
from jax_aero.data.import_cfd import POSTURES, known_postures
from jax_aero.data.ironcub import joint_position
from jax_aero.results import flight
from jax_aero.results.study import Findings, Study
from jax_aero.symbolic import load_robot
from jax_aero.symbolic.kinematics import Kinematics
from jax_aero.view import recording
from jax_aero.view.drawing import Camera, camera_at
from jax_aero.view.offscreen import Studio

FLIGHT_SIZE, POSTURE_SIZE = (960, 720), (240, 320)
"""Width and height [pixels]."""
FACING_X = np.array([0.0, 0.0, 0.0, 1.0])  # w, x, y, z: yaw of 180°, since the base's x axis points backwards

Array = NDArray[np.float64]


class Pictures(tables.Table, frozen=True):
    """Settings of Fig. 5 a."""

    flight: str = "test2"
    """Name of the flight, which is flown if it is not there."""
    moment: tables.NonNegative = 14.0
    """Time at which the robot hovers in the wind [s]."""


def compute(_: str, asked: Pictures) -> Findings:
    """Render all pictures."""
    path = flight.obtain(asked.flight)
    flown = recording.read(path.parent)
    with Studio(flown, *FLIGHT_SIZE) as studio:
        picture = studio.picture(asked.moment, camera_at(flown, asked.moment, "chase", 2.5), trail=False)
    robot = rust.Robot(str(ROBOT))
    # Postures of the public table and of the tunnel.
    named = known_postures(["free_stream", "tunnel"])
    pictures = [posture_picture(robot, joints) for joints in named.values()]
    starts, ends, diameters = capsules(joint_position(robot, named["hovering"]))
    data = xr.Dataset(
        {
            "flight": (("row", "column", "colour"), picture, {"long_name": f"{flown.title}, {asked.moment:g} s"}),
            "posture_picture": (("posture", "posture_row", "posture_column", "colour"), np.stack(pictures)),
            "link_start": (("link", "xyz"), starts, {"units": "m", "long_name": "capsule of the link, base axes"}),
            "link_end": (("link", "xyz"), ends, {"units": "m"}),
            "link_diameter": (("link",), diameters, {"units": "m"}),
        },
        {
            "posture": list(named),
            "colour": ["red", "green", "blue"],
            "xyz": ["x", "y", "z"],
            "link": list(robot.aero_link_names),
        },
    )
    return Findings("Pictures of the paper", data, {"postures": len(named)}, files=[path, ROBOT, POSTURES])


STUDY = Study("pictures", __doc__, Pictures, compute, ("paper",), backend="mujoco")
main = STUDY.main


def posture_picture(robot: rust.Robot, joints_deg: Array) -> NDArray[np.uint8]:
    """Render the robot in a posture, without wind and jets, from its front left."""
    jets, links = len(robot.jet_names), len(robot.aero_link_names)
    far = np.array([[0.0, 0.0, -50.0]])  # keeps the cross of the set-point out of the picture
    height = np.array([[0.0, 0.0, 0.72]])
    still = recording.Recording(
        title="posture",
        signals={
            "time": np.zeros(1),
            "base_position": height,
            "base_quaternion": FACING_X[None],
            "base_rpy_setpoint": np.zeros((1, 3)),
            "joint_position": joint_position(robot, joints_deg)[None],
            "com_position": height,
            "com_velocity": np.zeros((1, 3)),
            "com_setpoint": far,
            "rotation_error": np.zeros(1),
            "thrust": np.zeros((1, jets)),
            "wind": np.zeros((1, 3)),
            "aero_force_sim": np.zeros((1, links, 3)),
        },
        robot=robot,
        robot_path=ROBOT,
        outcome="posture",
        lost_time=None,
        lost_reason=None,
    )
    with Studio(still, *POSTURE_SIZE) as studio:
        return studio.picture(0.0, Camera(np.array([0.0, 0.0, 0.72]), -145.0, -8.0, 2.3), trail=False)


def capsules(joints: Array) -> tuple[Array, Array, Array]:
    """Return start and end [m, base axes] and diameter [m] of the cylinder of every aerodynamic link."""
    described = load_robot(ROBOT)
    tree = Kinematics(described)
    points = []
    for link in described.aero_links:
        pose, half = tree.bodies[link.body], 0.0 if link.is_sphere else 0.5 * link.length
        points += [pose.point(link.centre - half * link.axis), pose.point(link.centre + half * link.axis)]
    here = tree.evaluate_at_base(*points)
    at = ca.Function("at", [tree.base_position, tree.base_rotation, tree.joint_position], [ca.horzcat(*here)])
    placed = at(np.zeros(3), np.eye(3), joints).full().T
    return placed[0::2], placed[1::2], np.array([link.diameter for link in described.aero_links])

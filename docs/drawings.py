"""Draw `docs/img/frames.png`, the frames of `docs/reference.md`, and `copies.png`, a controller and its copy."""

from __future__ import annotations

from pathlib import Path

import jax
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from jax_aero import memory, rust
from jax_aero.body.kinematics import Kinematics, frame_poses, kinematics
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.types import State

ROOT = Path(__file__).resolve().parents[1]
EXPERIMENT = ROOT / "configs/experiments/test2.toml"
TARGET, COPIES = ROOT / "docs/img/frames.png", ROOT / "docs/img/copies.png"
INK, WIND, BASE, JET, GREY = "#24292f", "#0072b2", "#d55e00", "#cc79a7", "#c5cbd1"
FACING_X = np.diag([-1.0, -1.0, 1.0])  # yaw of 180 degrees: the base's x axis points backwards

Array = NDArray[np.float64]


SETTINGS = {
    "joint observer 0.02 s, force 3 1/s": (0.02, 3.0),
    "0.02 s, 2 1/s": (0.02, 2.0),
    "0.05 s, 3 1/s, as shipped": (0.05, 3.0),
}
"""Time constant of the joint observer [s] and gain of the observed force [1/s] of iRonCub-Mk3's controller."""


def main() -> None:
    """Draw both."""
    mpl.rcParams.update({"font.size": 9, "axes.spines.right": False, "axes.spines.top": False})
    draw_copies()
    draw_frames()


def draw_copies() -> None:
    """Draw what becomes of a difference between a controller and its copy."""
    figure, axes = plt.subplots(figsize=(6.0, 3.2), layout="constrained")
    for (label, (joints, force)), color in zip(SETTINGS.items(), (BASE, WIND, INK), strict=True):
        observers = {"estimator.joint_observer": joints, "disturbance_observer.gain_force": force}
        changes = {f"controller.{key}": value for key, value in observers.items()}
        found = memory.growth(rust.load_config("mk3_robot", changes))
        axes.semilogy(found.time, found.difference.max(axis=1), color=color, lw=1.2, label=label)
    axes.set(xlabel="time since one tick had other measurements [s]", ylabel="difference of the commands", xlim=(0, 6))
    axes.legend(frameon=False, loc="upper left")
    figure.savefig(COPIES, dpi=130, metadata={"Software": None})
    print(f"wrote {COPIES.relative_to(ROOT)}")


def draw_frames() -> None:
    """Draw the hovering robot from its right and from behind."""
    config = rust.load_config(EXPERIMENT)
    jax.config.update("jax_enable_x64", True)
    robot = load_robot(config["robot"])
    initial = config["simulator"]["initial"]
    joints = np.array(initial["joint_position"])
    state = State(np.array(initial["base_position"]), FACING_X, joints, np.zeros(robot.n_velocities))
    kin = kinematics(robot, state)
    figure, views = plt.subplots(1, 2, figsize=(9.0, 5.4), layout="constrained", sharey=True)
    for axes, (across, towards, sign) in zip(views, ((0, "x", 1.0), (1, "y", -1.0)), strict=True):
        draw(axes, robot, kin, across)
        axes.set(xlabel=f"{towards} [m]", aspect="equal", ylim=(-0.02, 1.65))
        axes.set_xlim(sorted((-0.85, 0.85), reverse=sign < 0))
    side, front = views
    side.set(title="from its right; it faces +x", ylabel="z [m]")
    front.set(title="from behind")
    triad(side, (-0.75, 0.1), {"x": (1, 0), "z": (0, 1)}, "inertial", INK)
    triad(front, (0.5, 0.1), {"y": (1, 0), "z": (0, 1)}, "inertial", INK)
    base = np.asarray(kin.body_positions[0])
    triad(side, base[[0, 2]], {"x": (-1, 0), "z": (0, 1)}, "", BASE)
    triad(front, base[[1, 2]], {"y": (-1, 0), "z": (0, 1)}, "", BASE)
    side.text(-0.24, 0.73, "base", color=BASE, ha="center", fontsize=8)
    angle_of_attack(side, robot, kin)
    front.text(-0.33, 0.84, "jets push", color=JET, ha="left", fontsize=8)
    front.annotate(
        "force acts at the\nlink's centre",
        (-0.075, 0.355),
        (-0.3, 0.32),
        fontsize=8,
        va="center",
        arrowprops={"arrowstyle": "-", "color": INK, "lw": 0.8},
    )
    front.annotate(
        "",
        (-0.78, 1.5),
        (-0.78 + 0.5, 1.5),
        arrowprops={"arrowstyle": "-|>", "color": WIND, "lw": 2},
    )
    front.text(-0.53, 1.53, "wind (0, −10, 0)", color=WIND, ha="center")
    figure.savefig(TARGET, dpi=130, metadata={"Software": None})
    print(f"wrote {TARGET.relative_to(ROOT)}")


def draw(axes: Axes, robot: RobotModel, kin: Kinematics, across: int) -> None:
    """Draw the aerodynamic links as thick lines, the jets as arrows along the push, the centre of mass."""
    links, jets = robot.aero_links, robot.jets
    rotations, origins = (np.asarray(x) for x in frame_poses(kin, links))
    for link in range(links.count):
        centre = origins[link] + rotations[link] @ links.centres[link]
        half = rotations[link] @ links.axes[link] * links.lengths[link] / 2
        ends = np.array([centre - half, centre + half])
        along = (ends[1] - ends[0])[[across, 2]]
        length = float(np.hypot(*along))
        seen_end_on = length < 0.5 * links.diameters[link]
        if links.is_sphere[link] or seen_end_on:
            axes.add_patch(plt.Circle(centre[[across, 2]], links.diameters[link] / 2, color=GREY, lw=0))
        else:
            width = links.diameters[link]
            angle = np.degrees(np.arctan2(along[1], along[0]))
            corner = ends[0][[across, 2]]
            box = mpl.patches.FancyBboxPatch(
                (0, -width / 2), length, width, boxstyle="round,pad=0,rounding_size=0.03", fc=GREY, ec="white", lw=0.8
            )
            turn = mpl.transforms.Affine2D().rotate_deg(angle).translate(*corner)
            box.set_transform(turn + axes.transData)
            axes.add_patch(box)
        axes.plot(*centre[[across, 2]], ".", color=INK, ms=3)
    rotations, origins = (np.asarray(x) for x in frame_poses(kin, jets))
    for jet in range(jets.count):
        push = rotations[jet] @ jets.axes[jet] * 0.22
        tip, tail = origins[jet] + push, origins[jet]
        arrow = {"arrowstyle": "-|>", "color": JET, "lw": 1.5}
        axes.annotate("", tip[[across, 2]], tail[[across, 2]], arrowprops=arrow)
    com = np.asarray(kin.com)
    axes.plot(*com[[across, 2]], "o", mfc="white", mec=INK, ms=7, mew=1.5)
    axes.annotate("CoM", com[[across, 2]], (6, -11), textcoords="offset points", color=INK)


def triad(
    axes: Axes, origin: Array | tuple[float, float], directions: dict[str, tuple[int, int]], name: str, color: str
) -> None:
    """Draw two axes of a frame and its name."""
    for axis, direction in directions.items():
        tip = np.asarray(origin) + 0.22 * np.array(direction)
        axes.annotate("", tip, origin, arrowprops={"arrowstyle": "->", "color": color, "lw": 1.8})
        axes.text(*(np.asarray(origin) + 0.26 * np.array(direction)), axis, color=color, ha="center", va="center")
    axes.annotate(name, origin, (0, -12), textcoords="offset points", color=color, ha="center", va="center", fontsize=8)


def angle_of_attack(axes: Axes, robot: RobotModel, kin: Kinematics) -> None:
    """Mark the angle of attack of the head in a head wind."""
    links = robot.aero_links
    link = links.names.index("head")
    rotations, origins = (np.asarray(x) for x in frame_poses(kin, links))
    centre = (origins[link] + rotations[link] @ links.centres[link])[[0, 2]]
    axis = (rotations[link] @ links.axes[link])[[0, 2]]
    upstream = np.array([1.0, 0.0])
    for direction, text, color in ((axis, "link axis k", INK), (upstream, "upstream", WIND)):
        axes.annotate("", centre + 0.3 * direction, centre, arrowprops={"arrowstyle": "->", "color": color, "lw": 1.3})
        axes.text(
            *(centre + 0.33 * direction), text, color=color, ha="left" if color == WIND else "center", va="center"
        )
    start, end = 0.0, np.degrees(np.arctan2(axis[1], axis[0]))
    axes.add_patch(mpl.patches.Arc(centre, 0.34, 0.34, theta1=min(start, end), theta2=max(start, end), color=INK, lw=1))
    middle = np.radians((start + end) / 2)
    axes.text(*(centre + 0.21 * np.array([np.cos(middle), np.sin(middle)])), "α", ha="center", va="center")
    wind = {"arrowstyle": "-|>", "color": WIND, "lw": 2}
    x, z = centre
    axes.annotate("", (x + 0.25, z - 0.17), (x + 0.55, z - 0.17), arrowprops=wind)
    axes.text(x + 0.4, z - 0.25, "head wind", color=WIND, ha="center")


if __name__ == "__main__":
    main()

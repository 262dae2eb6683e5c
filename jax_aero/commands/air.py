"""Force and moment of the whole robot and of each link against angle and posture, for any aerodynamic model.

The angles are those of the wind tunnel: alpha is the angle of the robot's vertical axis above the horizontal wind (90:
upright), beta its yaw about the tunnel's vertical. Drag is along the wind, lift up, side along lift x drag; moments are
about the centre of mass, in base axes. One angle may be a range, FROM:TO:STEP.

    jax-aero air --posture hovering --alpha 0:180:5 --beta 0
    jax-aero air --posture hovering --alpha 90 --beta -90:90:10 --model network sphere_cylinder --beside wind_tunnel

Writes a CSV file with all numbers and a figure to results/air/; the names state robot, models, posture and wind,
unless --name gives another.
"""

from __future__ import annotations

import argparse
import csv
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from jax_aero import air
from jax_aero.aero import AeroModel, LinkConventions, aero_model, link_forces
from jax_aero.aero.dataset import Floats, tunnel_from_base
from jax_aero.base import places
from jax_aero.base.arguments import Parser, add_name, complete_with
from jax_aero.base.files import complete_file
from jax_aero.base.tables import LARGEST, read
from jax_aero.base.terminal import exit_status
from jax_aero.body.kinematics import kinematics_at_rest
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.body.spatial import cross
from jax_aero.data.import_cfd import known_postures
from jax_aero.data.ironcub import JOINTS, joint_position
from jax_aero.figures import style
from jax_aero.types import Array

MAX_ANGLES = 10_000
"""Greatest number of angles in a range."""

ZERO = "zero"
"""Posture in which all joints are at zero."""

ROBOT = "robot"
"""Name of the sum over all links."""

COLUMNS = ("drag_n", "side_n", "lift_n", "roll_nm", "pitch_nm", "yaw_nm", "cda_m2", "csa_m2", "cla_m2")


class Loads(NamedTuple):
    """Loads of L links in W winds."""

    forces: Floats
    """(W, L, 3) drag, side, lift [N]."""
    moments: Floats
    """(W, L, 3) about the centre of mass, base axes [N m]."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line: print, write and draw; return the exit status."""
    given = _parser().parse_args(arguments)
    return exit_status(lambda: _compute(given))


def _compute(given: argparse.Namespace) -> None:
    alphas, betas = angles("--alpha", given.alpha), angles("--beta", given.beta)
    if min(len(alphas), len(betas)) > 1:
        raise ValueError("--alpha and --beta are both ranges; expected one range")
    if not 0.0 < given.wind <= LARGEST:
        raise ValueError(f"--wind is {given.wind}; expected a number > 0, at most {LARGEST:g}")
    robot = load_robot(places.find("robot", given.robot))
    given.model = given.model or [air.default_model(robot)]
    given.posture = given.posture or ("hovering" if set(JOINTS) <= set(robot.joint_names) else ZERO)
    joints = posture(robot, given.posture)
    tables = [(name, points(name, given.posture, alphas, betas)) for name in given.beside]
    with jax.enable_x64(True):
        models = {name: air.settings(name) for name in given.model}
        by_model = {
            name: loads(robot, aero_model(model, robot), joints, alphas, betas, given.wind)
            for name, model in models.items()
        }
    # Without aerodynamics there is no density, and every area is zero.
    pressures = [0.5 * getattr(model, "air_density", 1.0) * given.wind**2 for model in models.values()]
    rows = list(_rows(robot, by_model, alphas, betas, pressures))
    print(_listing(rows))
    stems = "_".join(Path(name).stem for name in given.model)
    wind = f"alpha={given.alpha}--beta={given.beta}--wind={given.wind:g}".replace(":", "_")
    name = given.named or f"{robot.name}--{stems}--{given.posture}--{wind}"
    out = given.out or places.RESULTS / "air"
    with complete_file(out / f"{name}.csv") as draft, draft.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, ["model", "link", "alpha_deg", "beta_deg", *COLUMNS])
        writer.writeheader()
        writer.writerows(rows)
    with complete_file(out / f"{name}.png") as draft:
        _draw(rows, tables, robot, given).savefig(draft, dpi=150)
    for suffix in (".csv", ".png"):
        print(os.path.relpath(out / f"{name}{suffix}"))


def _parser() -> Parser:
    parser = Parser("air", __doc__)
    parser.add_argument(
        "--posture",
        metavar="NAME",
        help=f"of configs/tables/postures.toml, or {ZERO} (default hovering, if it applies)",
    )
    parser.add_argument("--alpha", default="90", metavar="DEG", help="angle or FROM:TO:STEP (default 90)")
    parser.add_argument("--beta", default="0", metavar="DEG", help="angle or FROM:TO:STEP (default 0)")
    parser.add_argument("--wind", type=float, default=10.0, metavar="M/S", help="its speed (default 10)")
    models = parser.add_argument(
        "--model",
        nargs="+",
        metavar="NAME",
        help="names in configs/aero, or paths (default axisymmetric_corrected; sphere_cylinder without coefficients)",
    )
    complete_with(models, lambda: places.names("aero"))
    parser.add_argument(
        "--beside", nargs="+", default=[], choices=["cfd_tunnel", "wind_tunnel"], help="tables of configs/tables"
    )
    robots = parser.add_argument("--robot", default="ironcub_mk1", metavar="NAME", help="name or path of a robot file")
    complete_with(robots, lambda: places.names("robot"))
    add_name(parser, "default: robot, models, posture and wind")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the files (default results/air)")
    return parser


def angles(option: str, text: str) -> Floats:
    """Return the angles [deg] of `FROM:TO:STEP`, including both ends, or of one number."""
    try:
        numbers = [float(part) for part in text.split(":")]
    except ValueError:
        numbers = []
    if not np.isfinite(numbers).all():
        numbers = []
    if len(numbers) == 1:
        return np.array(numbers)
    if len(numbers) != 3 or not numbers[2] > 0.0 or numbers[1] < numbers[0]:
        raise ValueError(f"{option} is {text}; expected an angle, or FROM:TO:STEP, e.g. 0:180:5")
    first, last, step = numbers
    count = (last - first) / step + 1e-9
    if not count < MAX_ANGLES:
        raise ValueError(f"{option} is {text}; expected at most {MAX_ANGLES} angles")
    values: Floats = first + step * np.arange(int(count) + 1, dtype=np.float64)
    return values


def posture(robot: RobotModel, name: str) -> Floats:
    """Return the joint positions (n,) [rad] of a named posture; joints not in the tables are zero."""
    if name == ZERO:
        return np.zeros(robot.n_joints)
    known = known_postures()
    if name not in known:
        raise ValueError(f"--posture is `{name}`{places.did_you_mean(name, [ZERO, *known])}")
    if not set(JOINTS) <= set(robot.joint_names):
        raise ValueError(f"{robot.name} has not the joints of the named postures; expected --posture {ZERO}")
    return joint_position(robot, known[name])


def loads(robot: RobotModel, aero: AeroModel, joints: Floats, alphas: Floats, betas: Floats, speed: float) -> Loads:
    """Return the loads at every angle, at rest in a wind [m/s]; call it inside `enable_x64` for double precision."""
    turned = tunnel_from_base(alphas, betas)
    forces, moments = _all_loads(robot, aero, jnp.asarray(joints), jnp.asarray(speed * turned[:, 0]))
    return Loads(np.einsum("wij,wlj->wli", turned, np.asarray(forces)), np.asarray(moments))


@jax.jit
def _all_loads(robot: RobotModel, aero: AeroModel, joints: Array, winds: Array) -> tuple[Array, Array]:
    kin = kinematics_at_rest(robot, joints)

    def loads_in_wind(wind: Array) -> tuple[Array, Array]:
        link = link_forces(aero, robot, kin, LinkConventions(), wind)
        return link.forces, cross(link.arm_points - kin.com, link.forces)

    return jax.vmap(loads_in_wind)(winds)


def points(table: str, name: str, alphas: Floats, betas: Floats) -> list[dict[str, Any]]:
    """Return the points of a table of `configs/tables` for this posture, along the angle that varies.

    Runs without `alpha_deg` are of the upright robot, runs without `beta_deg` without sideslip.
    """
    document = read(places.CONFIGS / "tables" / f"{table}.toml")
    rows = []
    for key, runs in document.items():
        for run in runs if isinstance(runs, list) and isinstance(runs[0], Mapping) else []:
            if run.get("posture", key) != name or "cda" not in run:
                continue
            count = len(run["cda"])
            alpha = np.broadcast_to(np.asarray(run.get("alpha_deg", 90.0), float), count)
            beta = np.broadcast_to(np.asarray(run.get("beta_deg", 0.0), float), count)
            varying, fixed, at = (alpha, beta, betas[0]) if len(alphas) > 1 else (beta, alpha, alphas[0])
            asked = alphas if len(alphas) > 1 else betas
            here = (np.abs(fixed - at) < 1e-6) & (varying >= asked[0] - 1e-6) & (varying <= asked[-1] + 1e-6)
            if here.any():
                areas = {area: np.asarray(run[area], float)[here] for area in ("cda", "cla", "csa") if area in run}
                label = " ".join(str(run[part]) for part in ("test", "mesh", "turbulence") if part in run)
                rows.append({"label": f"{table} {label}", "angle": varying[here], **areas})
    if not rows:
        raise ValueError(f"{table} holds nothing of posture `{name}` at these angles")
    return rows


def _rows(
    robot: RobotModel, loads: Mapping[str, Loads], alphas: Floats, betas: Floats, pressures: Sequence[float]
) -> Iterator[dict[str, Any]]:
    grid = np.broadcast_arrays(alphas, betas)
    for (model, load), pressure in zip(loads.items(), pressures, strict=True):
        links = [ROBOT, *robot.aero_links.names]
        forces = np.concatenate([load.forces.sum(axis=1, keepdims=True), load.forces], axis=1)
        moments = np.concatenate([load.moments.sum(axis=1, keepdims=True), load.moments], axis=1)
        for index, link in enumerate(links):
            for place, (alpha, beta) in enumerate(zip(*grid, strict=True)):
                force, moment = forces[place, index], moments[place, index]
                values = [*force, *moment, *(force / pressure)]
                shown = {column: float(f"{value:.6g}") for column, value in zip(COLUMNS, values, strict=True)}
                yield {"model": model, "link": link, "alpha_deg": float(alpha), "beta_deg": float(beta), **shown}


def _listing(rows: Sequence[Mapping[str, Any]]) -> str:
    head = f"{'model':<24} {'alpha':>6} {'beta':>6} {'drag':>8} {'side':>8} {'lift':>8} [N]"
    lines = [f"{head} {'roll':>7} {'pitch':>7} {'yaw':>7} [N m] {'CdA':>7} [m²]"]
    for row in rows:
        if row["link"] != ROBOT:
            continue
        forces = " ".join(f"{row[column]:8.2f}" for column in COLUMNS[:3])
        moments = " ".join(f"{row[column]:7.2f}" for column in COLUMNS[3:6])
        place = f"{row['model']:<24} {row['alpha_deg']:6.1f} {row['beta_deg']:6.1f}"
        lines.append(f"{place} {forces}     {moments}       {row['cda_m2']:7.4f}")
    return "\n".join(lines)


def _draw(
    rows: Sequence[Mapping[str, Any]], tables: Sequence[tuple[str, list[dict[str, Any]]]], robot: RobotModel, given: Any
) -> Figure:
    """Draw force areas of the robot by model, its moments, and the drag of each link of the first model."""
    angle = "alpha_deg" if len({row["alpha_deg"] for row in rows}) > 1 else "beta_deg"
    style.use()
    figure = style.figure(6.0, 10.0)
    grid = figure.subplots(2, 3)

    def series(model: str, link: str, column: str) -> tuple[list[float], list[float]]:
        chosen = [row for row in rows if (row["model"], row["link"]) == (model, link)]
        return [row[angle] for row in chosen], [row[column] for row in chosen]

    panels = {
        "cda_m2": "drag area [m²]",
        "csa_m2": "side area [m²]",
        "cla_m2": "lift area [m²]",
        "pitch_nm": "pitch moment [N m]",
        "yaw_nm": "yaw moment [N m]",
    }
    for axes, (column, title) in zip(grid.flat, panels.items(), strict=False):
        for model in given.model:
            axes.plot(*series(model, ROBOT, column), "o-", markersize=2, label=model)
        for _, runs in tables:
            for run in runs if column[:3] in ("cda", "csa", "cla") else []:
                if column[:3] in run:
                    axes.plot(run["angle"], run[column[:3]], "x", markersize=4, color="0.5")
        axes.set(title=title, xlabel=f"{angle[:-4]} [deg]")
    for link in robot.aero_links.names:
        grid[1, 2].plot(*series(given.model[0], link, "cda_m2"), label=link)
    grid[1, 2].set(title=f"drag area of each link [m²], {given.model[0]}", xlabel=f"{angle[:-4]} [deg]")
    grid[0, 0].legend(fontsize=6)
    if robot.aero_links.names:
        grid[1, 2].legend(fontsize=5, ncols=2)
    beside = f"; crosses: {', '.join(name for name, _ in tables)}" if tables else ""
    figure.suptitle(f"{robot.name}, {given.posture}, {given.wind:g} m/s{beside}", fontsize=10)
    return figure

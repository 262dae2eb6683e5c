"""Convert wind-tunnel balance files into a dataset: `jax-aero data import-tunnel --clone DIR`.

The files are the `data_GVPM/TID_*.GVP` of the three campaigns in the public repository
https://github.com/ami-iit/element_cfd-simulation (BSD-3-Clause), none of which is shipped here. All components
are reduced to force areas and moment volumes about the balance centre, the hip-pitch axis and the centre of mass, with
an uncertainty budget; gravity sweeps (`.tara`) give the position of the centre of gravity relative to the balance
centre. Writes one NetCDF file per robot.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from jax_aero.aero.dataset import Floats
from jax_aero.aero.posture import axes_of, link_frames
from jax_aero.base import places, tables
from jax_aero.base.arguments import Parser
from jax_aero.base.files import read_bytes, write_netcdf
from jax_aero.base.places import ROBOT
from jax_aero.base.terminal import Refused, exit_status
from jax_aero.body.robot import load_robot
from jax_aero.data import tunnel
from jax_aero.data.import_cfd import OUT, POSTURES, known_postures
from jax_aero.data.ironcub import joint_position
from jax_aero.data.tunnel import Points, Test

MK3 = places.CONFIGS / "robot" / "ironcub_mk3.toml"
POSTURES_OF_MK3 = places.CONFIGS / "tables" / "postures_mk3.toml"
TESTS = places.CONFIGS / "tables" / "tunnel_tests.toml"
ROOTS = ("wind-tunnel", "wind-tunnel-data")
"""Folders of the campaigns in a clone, which differ between commits."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = Parser("data import-tunnel", __doc__)
    about = "a local clone of element_cfd-simulation"
    parser.add_argument("--clone", type=Path, required=True, metavar="DIR", help=about)
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for tunnel_ROBOT.nc (default results/datasets)")
    given = parser.parse_args(arguments)
    out: Path = given.out or OUT

    def work() -> None:
        for points in from_clone(given.clone):
            data = reduce_moments(points)
            path = out / f"tunnel_{points.robot}.nc"
            write_netcdf(path, data)
            print(summary(data), path, sep="\n")
        print(sweeps_text(gravity_sweeps(given.clone)))

    return exit_status(work)


def known_tests() -> dict[tuple[str, str], Test]:
    """Return the entries of the table of tests, by campaign and name."""
    by_name = {}
    for campaign in tables.read(TESTS)["campaign"]:
        marks = campaign.get("marks", {})
        points = campaign.get("point_marks", {})
        limits = campaign.get("tare_above_deg", {})
        for kind in ("hovering", "flight"):
            for posture, numbers in campaign[kind].items():
                for number in numbers:
                    name = f"TID_{number:04}"
                    against: dict[int, tuple[str, ...]] = {}
                    for mark, tests in points.items():
                        for point in tests.get(name, ()):
                            against[point] = (*against.get(point, ()), mark)
                    by_name[campaign["name"], name] = Test(
                        campaign=campaign["name"],
                        kind=kind,
                        posture=posture,
                        robot=campaign["robot"],
                        marks=tuple(mark for mark, numbers in marks.items() if number in numbers),
                        point_marks=against,
                        tare_above_deg=limits.get(name),
                    )
    return by_name


def folders(clone: Path) -> dict[str, Path]:
    """Return the folders of balance files in a clone, by campaign."""
    by_campaign = {}
    for campaign in tables.read(TESTS)["campaign"]:
        places = [clone / root / name / "data_GVPM" for root in ROOTS for name in campaign["folders"]]
        if present := [place for place in places if place.is_dir()]:
            by_campaign[campaign["name"]] = present[0]
    if not by_campaign:
        raise Refused(f"{clone} has no {ROOTS[0]}/exp_*/data_GVPM; expected a clone of element_cfd-simulation")
    return by_campaign


def files_by_test(folder: Path, suffix: str) -> dict[str, Path]:
    """Return the files of a campaign with this suffix by test; names in lower case are of the same tests."""
    return {path.stem.upper(): path for path in sorted(folder.iterdir()) if path.suffix.lower() == suffix}


def from_clone(clone: Path) -> Iterator[Points]:
    """Yield the points of each robot."""
    tests = known_tests()
    parts: dict[str, list[Points]] = {}
    for campaign, folder in folders(clone).items():
        for test, path in files_by_test(folder, ".gvp").items():
            if (about := tests.get((campaign, test))) is None:
                continue  # trials and aborted runs, not in the list of tests
            gvp = tunnel.read_gvp(read_bytes(path).decode("utf-8", "replace"), f"{campaign}/{path.name}")
            parts.setdefault(about.robot, []).append(tunnel.points_of(test, about, gvp))
    if not parts:
        raise Refused(f"{clone} has no balance file of a test that configs/tables/tunnel_tests.toml names")
    for robot in sorted(parts):
        yield tunnel.join(parts[robot])


def reduce_moments(points: Points, side: str = "below") -> xr.Dataset:
    """Reduce points about the hip and the centre of mass of the robot's model; `side` as in `tunnel.reduce_points`."""
    known = known_postures(path=POSTURES if points.robot == "mk1" else POSTURES_OF_MK3)
    joints = {name: known[name] for name in dict.fromkeys(points.posture)}
    robot = load_robot(ROBOT if points.robot == "mk1" else MK3)
    places = link_frames(robot, joint_position(robot, np.stack(list(joints.values())))).com @ axes_of(robot)
    return tunnel.reduce_points(points, joints, dict(zip(joints, places, strict=True)), side)


def gravity_sweeps(clone: Path) -> dict[str, dict[str, tuple[Floats, Floats]]]:
    """Return the centre of gravity relative to the balance centre [m], balance axes, by campaign and sweep."""
    centres: dict[str, dict[str, tuple[Floats, Floats]]] = {}
    for campaign, folder in folders(clone).items():
        for test, path in files_by_test(folder, ".tara").items():
            sweep = tunnel.read_sweep(read_bytes(path).decode("utf-8", "replace"), path.name)
            centres.setdefault(campaign, {})[test] = tunnel.centre_of_gravity(*sweep)
    return centres


def sweeps_text(sweeps: Mapping[str, Mapping[str, tuple[Floats, Floats]]]) -> str:
    """Return one line of text per gravity sweep."""
    lines = ["centre of gravity from the balance centre, balance axes [m], by gravity sweep"]
    for campaign, entries in sweeps.items():
        for name, (place, deviation) in entries.items():
            cells = "  ".join(f"{p:+.4f} ± {s:.4f}" for p, s in zip(place, deviation, strict=True))
            lines.append(f"  {campaign} {name}  {cells}")
    return "\n".join(lines)


def summary(data: xr.Dataset) -> str:
    """Return a description of a dataset."""
    tests = len(set(zip(data["campaign"].values, data["test"].values, strict=True)))
    postures = len(set(data["posture"].values))
    alone = int(data["robot_only"].sum())
    lines = [
        f"{data.attrs['robot']}: {data.sizes['point']} points of {tests} tests, {postures} postures; {alone} alone"
    ]
    if alone:
        chosen: Any = data["robot_only"].values == 1
        for name in ("u_lever", "u_zero", "u_repeat", "u_total"):
            size = np.sqrt(np.mean(data[name].values[chosen] ** 2, axis=0))
            lines.append(f"  {name} of these, rms by axis [m3]: " + ", ".join(f"{value:.4f}" for value in size))
    return "\n".join(lines)

"""A real quadrotor's numbers from its public logs: import, replay's columns, identify.

`jax-aero study nano_drone` fetches three flights of a Crazyflie 2.1 Brushless (Busetto et al., "Nonlinear system
identification for a nano-drone benchmark", Control Engineering Practice, 2026) into `results/data/nano_drone/`, unless
they are there. Their repository states no licence: they are fetched by whoever runs this, and not part of ours. The
robot is imported from the published mass, arms and inertia; thrusts are the published factor times the measured rotor
speeds squared. Two flights give the numbers, the third is predicted.

The result goes to `results/nano_drone/default/`.
"""

from __future__ import annotations

import tempfile
import urllib.request
from pathlib import Path

import jax
import numpy as np
import pandas as pd
import xarray as xr
from scipy.spatial.transform import Rotation

from jax_aero import rust
from jax_aero.base import places, tables
from jax_aero.base.files import complete_file
from jax_aero.base.terminal import Refused
from jax_aero.body.robot import load_robot
from jax_aero.commands import identify as command
from jax_aero.commands.robot import main as import_robot
from jax_aero.identify import samples
from jax_aero.results.study import Findings, Study
from jax_aero.sweep.perturbation import Perturbation

COMMIT = "b0cf4b3144e84716546ab8bb028d7eacc42475c2"
SOURCE = (
    f"https://raw.githubusercontent.com/idsia-robotics/nanodrone-sysid-benchmark/{COMMIT}"
    "/control_engineering_practice/data/real/processed/new"
)
"""Where the flights are; later commits refer to a large-file store."""
FLIGHTS = ("train/multisine_20251017_run1", "train/random1_20251017_run1", "test/melon_20251017_run5")
"""Two flights for the fit and one that is predicted."""
MASS, ARM, INERTIA = 0.045, 0.0353, (2.3951e-5, 2.3951e-5, 3.2347e-5)
"""Published [kg, m, kg m²]; the last of 3.2e-6 would be a tenth of what any plate has, and is taken as a slip."""
THRUST, MOMENT, POLES = 3.72e-8, 7.74e-12, 6
"""Published thrust and moment over the rotor speed squared [N s², N m s²]; pairs of poles, of its electrical speed."""
CORNERS = {"m1": (1, -1, 1), "m2": (-1, -1, -1), "m3": (-1, 1, 1), "m4": (1, 1, -1)}
"""Place of each rotor, and the sign of its moment."""
SPEEDS = (1e4, 2e5)
"""Electrical speeds that the telemetry can mean [1/min]; it has some of 6 million."""
WIDTHS = Perturbation(mass=0.1, com=0.01, inertia=0.8, thrust_axis_deg=3.0, thrust_gain=0.3, imu_deg=5.0, drag=0.5)
MAP = """time = { columns = "t" }
raw_base_position = { columns = ["x", "y", "z"] }
raw_base_quaternion = { columns = ["qw", "qx", "qy", "qz"] }
raw_base_velocity = { columns = ["vx", "vy", "vz", "ax", "ay", "az"] }
raw_thrust = { columns = "thrust_{}" }
"""


class NanoDrone(tables.Table, frozen=True):
    """Nothing to choose."""


def compute(_: str, _settings: NanoDrone) -> Findings:
    """Fetch, import, identify."""
    logs = [fetch(name) for name in FLIGHTS]
    with tempfile.TemporaryDirectory() as drafts, jax.enable_x64(True):
        folder = Path(drafts)
        config, signals = flown(folder, logs)
        robot = load_robot(config["robot"])
        prior = command.prior_of(robot, WIDTHS)
        known = command.identify_robot(config, Path(config["robot"]), signals, prior, MASS, is_predicted=True)
        rows = command.records(robot, known.found, known.found.prior > 0.0)
    # In the mean of a flight nothing accelerates.
    log, gravity = signals[0], float(robot.gravity)
    lift = float(np.nanmean(np.sum(log["raw_thrust"], axis=1) * log["raw_base_rotation"][:, 2, 2]))
    summary = {
        "explained": float(known.verdict.is_explained),
        "file over numbers, accelerations": known.verdict.improvement,
        "published thrust factor [1e-8 N s2]": 1e8 * THRUST,
        "thrust factor that carries the published mass [1e-8 N s2]": 1e8 * THRUST * MASS * gravity / lift,
        "published mass [g]": 1e3 * MASS,
        "mass that the published thrust factor carries [g]": 1e3 * lift / gravity,
        "samples left out": float(sum(known.left_out.values())),
    }
    summary |= {
        f"{row['name']} [%]": row["value"] for row in rows if row["name"].startswith(("inertia", "thrust_gain"))
    }
    summary |= {f"{row.name}, over noise": row.ratio for row in known.verdict.rows}
    keys = ("measured", "file", "found", "ratio", "bound")
    of_rows = {name: ("row", [getattr(row, name) for row in known.verdict.rows]) for name in keys}
    data = xr.Dataset(of_rows, {"row": [row.name for row in known.verdict.rows]})
    return Findings("A real quadrotor from its public logs", data, summary)


def fetch(name: str) -> Path:
    """Return the file of a flight, fetched if it is not there."""
    path = places.RESULTS / "data" / "nano_drone" / f"{Path(name).name}.parquet"
    if not path.is_file():
        try:
            with urllib.request.urlopen(f"{SOURCE}/{name}.parquet", timeout=60) as answer, complete_file(path) as draft:
                draft.write_bytes(answer.read())
        except OSError as reason:
            raise Refused(f"`{path}` is not there and cannot be fetched from {SOURCE} ({reason})") from None
    return path


def flown(folder: Path, logs: list[Path]) -> tuple[rust.Config, list[dict[str, np.ndarray]]]:
    """Import the robot into a folder; return the configuration of its hover, and what the logs measured."""
    (folder / "nano.urdf").write_text(urdf(), encoding="utf-8")
    (folder / "map.toml").write_text(MAP, encoding="utf-8")
    jets = [f"--jet={name}:z:0.3:{sign * MOMENT / THRUST:.6g}" for name, (_, _, sign) in CORNERS.items()]
    if import_robot([str(folder / "nano.urdf"), *jets, "--name", "nano", "--out", str(folder / "nano")]):
        raise Refused("the robot was not imported")
    config = rust.load_config(folder / "nano" / "nano_hover.toml")
    signals = []
    for place, path in enumerate(logs):
        converted(pd.read_parquet(path)).to_parquet(folder / f"{place}.parquet")
        signals.append(samples.read(folder / f"{place}.parquet", folder / "map.toml", config, str(config["robot"])))
    return config, signals


def converted(log: pd.DataFrame) -> pd.DataFrame:
    """Return a log with unit quaternions, rates of turn in inertial axes, and thrusts."""
    quaternion = log[["qx", "qy", "qz", "qw"]].to_numpy(copy=True)
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    found = log[["t", "x", "y", "z", "vx", "vy", "vz"]].copy()
    found[["qx", "qy", "qz", "qw"]] = quaternion
    found[["ax", "ay", "az"]] = Rotation.from_quat(quaternion).apply(log[["wx", "wy", "wz"]].to_numpy(copy=True))
    for name in CORNERS:
        speed = log[f"{name}_erpm"]
        thrust = THRUST * (speed / POLES * np.pi / 30.0) ** 2
        found[f"thrust_{name}"] = thrust.where(speed.between(*SPEEDS))
    return found


def urdf() -> str:
    """Return the published robot: a plate with four frames."""
    inertia = " ".join(f'{name}="{value}"' for name, value in zip(("ixx", "iyy", "izz"), INERTIA, strict=True))
    body = f'<inertial><mass value="{MASS}"/><inertia {inertia} ixy="0" ixz="0" iyz="0"/></inertial>'
    parts = [f'<link name="body">{body}<visual><geometry><box size="0.07 0.07 0.03"/></geometry></visual></link>']
    for name, (front, left, _) in CORNERS.items():
        place = f'<origin xyz="{front * ARM} {left * ARM} 0"/>'
        parts.append(f'<link name="{name}"/><joint name="to_{name}" type="fixed"><parent link="body"/>')
        parts.append(f'<child link="{name}"/>{place}</joint>')
    return f'<robot name="nano">{"".join(parts)}</robot>'


STUDY = Study("nano_drone", __doc__, NanoDrone, compute, ("default",), backend="rust and jax")
main = STUDY.main

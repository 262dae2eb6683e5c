"""The records of the real robot, standing in a measured wind, through our controller.

`jax-aero study standing [front] [lateral]` replays what the robot measured through the controller that it had, as it
was flown and physically right, and again with one cause of the difference at a time made right. It compares desired
torques, foot wrenches, momentum rates and joint velocities with the recorded ones; and how far the robot moved with how
far the simulated experiment does, to which it fits the dry friction of the drives. The result goes to
`results/standing/NAME/`; `jax-aero figures standing` draws it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from experiments.studies.standing import friction
from experiments.studies.standing.motion import moved
from jax_aero import rust
from jax_aero.base import keys, tables
from jax_aero.mujoco import ground
from jax_aero.replay import replay
from jax_aero.results.study import Findings, Study
from jax_aero.view import logs

Array = NDArray[np.float64]

CAUSES = {
    "spheres and cylinders": "controller.aero",
    "all axes turned by the chest": "controller.axes_of",
    "unrotated lever arms": "controller.lever_arm",
    "offsets turned by the base": "controller.jacobian_offset",
    "mass": "disturbances.model_error",
}
"""What the recorded controller did otherwise than ours, with its key."""

START = 1.0
"""Time from which signals are compared [s]: before, the integrals start."""

MEAN = 1.0
"""Time over which signals are averaged in which noise of the velocities is amplified [s]."""

AS_FLOWN, RIGHT = "as flown", "right"


class StandingConfig(tables.Table, frozen=True):
    """One recorded run."""

    title: str
    record: Path
    """Table of the record."""
    map: Path
    """File that names its columns, as of `jax-aero replay`."""
    flown: Path
    """Experiment with the controller that the robot had."""
    right: Path
    """Experiment with the controller that is physically right."""
    friction: friction.Friction
    """Friction of the drives that this run determines."""


def compute(_: str, config: StandingConfig) -> Findings:
    """Replay the record with every variant."""
    flown, right = (rust.load_config(path) for path in (config.flown, config.right))
    variants = {AS_FLOWN: flown, RIGHT: right}
    variants |= {f"without {cause}": restore(flown, right, key) for cause, key in CAUSES.items()}
    log = logs.read(config.record, flown, config.map)
    replays = {name: replay(log, variant, config.record) for name, variant in variants.items()}
    summary: dict[str, Any] = {}
    for name, (recorded, computed) in replays.items():
        summary |= {f"{name}: {figure}": value for figure, value in differences(recorded, computed).items()}
    recorded, computed = replays[AS_FLOWN]
    summary |= noisy(recorded, computed)
    summary |= {"assumed force as recorded [N]": assumed(recorded), "mass by the desired wrenches [kg]": mass(recorded)}
    motion = moved(recorded, flown)
    summary |= {f"recorded: {figure}": value for figure, value in motion.items()}
    summary |= {f"simulated: {figure}": value for figure, value in moved(ground.fly(flown).log, flown).items()}
    summary |= friction.fit(config.friction, flown, motion)
    dataset = to_dataset(recorded, {name: replays[name][1] for name in (AS_FLOWN, RIGHT)}, rust.Robot(flown["robot"]))
    return Findings(config.title, dataset, summary, flights={AS_FLOWN: flown, RIGHT: right})


def restore(flown: rust.Config, right: rust.Config, key: str) -> rust.Config:
    """Return the flown configuration with one key as in the right one."""
    *parents, last = key.split(".")
    changed: rust.Config = dict(flown)
    table = changed
    for parent in parents:
        table[parent] = dict(table[parent])
        table = table[parent]
    table[last] = keys.get(right, key)
    if table[last] is None:
        del table[last]
    return changed


def rms(one: Array, other: Array, time: Array) -> Array:
    """Return the root mean square of a difference from `START` on, of each entry."""
    error = (one - other)[time >= START].reshape(np.count_nonzero(time >= START), -1)
    return np.asarray(np.sqrt((error**2).mean(axis=0)))


def differences(recorded: Mapping[str, Array], computed: Mapping[str, Array]) -> dict[str, float]:
    """Return what a replay differs by from the record: the greatest over joints, or components of the feet."""
    time = computed["time"]

    def of(name: str, entries: slice = slice(None)) -> float:
        return float(rms(computed[name][..., entries], recorded[name][..., entries], time).max())

    force, moment = slice(0, 3), slice(3, 6)
    return {
        "desired torques, rms [N m]": of("joint_torque"),
        "desired torques, rms about their mean difference [N m]": steady(recorded, computed),
        "desired foot forces, rms [N]": of("contact_force", force),
        "desired foot moments, rms [N m]": of("contact_force", moment),
        "foot forces of the torque QP, rms [N]": of("contact_force_torque", force),
        "assumed force of a link, rms [N]": of("aero_force_control"),
        "assumed force at the end [N]": assumed(computed),
    }


def steady(recorded: Mapping[str, Array], computed: Mapping[str, Array]) -> float:
    """Return the greatest standard deviation of the difference of a desired torque [N m]."""
    error = computed["joint_torque"] - recorded["joint_torque"]
    return float(error[computed["time"] >= START].std(axis=0).max())


def assumed(signals: Mapping[str, Array]) -> float:
    """Return the magnitude of the horizontal force on the robot that the controller assumes in the last 3 s [N]."""
    last = signals["time"] >= signals["time"][-1] - 3.0
    return float(np.hypot(*signals["aero_force_control"][last].sum(axis=1).mean(axis=0)[:2]))


def mass(recorded: Mapping[str, Array]) -> float:
    """Return the mass that the desired vertical forces of the first 5 s carry, in which there is no wind [kg]."""
    calm = (recorded["time"] >= START) & (recorded["time"] < 5.0)
    return float(recorded["contact_force"][calm][..., 2].sum(axis=1).mean() / 9.81)


def noisy(recorded: Mapping[str, Array], computed: Mapping[str, Array]) -> dict[str, float]:
    """Return the rms of signals that amplify the noise of velocities, after a moving mean, over their range."""
    length = round(MEAN / float(np.median(np.diff(computed["time"]))))

    def mean(rows: Array) -> Array:
        flat = rows.reshape(len(rows), -1)
        return np.asarray(uniform_filter1d(flat, length, axis=0)[length:-length])

    shares = {}
    for name, words in (
        ("momentum_rate_estimate", "momentum rate"),
        ("contact_force_rate", "rates of the foot wrenches"),
        ("joint_velocity_command", "joint velocity commands"),
    ):
        ours, theirs = mean(computed[name]), mean(recorded[name])
        share = np.sqrt(((ours - theirs) ** 2).mean()) / np.ptp(theirs, axis=0).max()
        shares[f"{AS_FLOWN}: {words}, mean of {MEAN:g} s, rms over the greatest range [%]"] = 100.0 * float(share)
    return shares


def to_dataset(recorded: Mapping[str, Array], computed: Mapping[str, Mapping[str, Array]], robot: rust.Robot) -> Any:
    """Return desired torques, foot wrenches and assumed forces of the record and of its replays."""
    sources = {"recorded": recorded, **computed}

    def stack(name: str) -> Array:
        return np.stack([signals[name] for signals in sources.values()])

    return xr.Dataset(
        {
            "wind": (("time", "xyz"), recorded["raw_wind"], {"units": "m s-1", "long_name": "wind as it was received"}),
            "aero_force": (
                ("source", "time", "xyz"),
                stack("aero_force_control").sum(axis=2),
                {"units": "N", "long_name": "aerodynamic force that the controller assumes"},
            ),
            "joint_torque": (
                ("source", "time", "joint"),
                stack("joint_torque"),
                {"units": "N m", "long_name": "desired joint torque"},
            ),
            "contact_force": (
                ("source", "time", "foot", "six"),
                stack("contact_force"),
                {"units": "N, N m", "long_name": "desired foot wrench"},
            ),
        },
        {
            "source": list(sources),
            "time": ("time", recorded["time"], {"units": "s"}),
            "joint": list(robot.joint_names),
            "foot": list(robot.foot_names),
            "xyz": list("xyz"),
            "six": ["fx", "fy", "fz", "mx", "my", "mz"],
        },
    )


STUDY = Study("standing", __doc__, StandingConfig, compute, ("front", "lateral"), backend="rust")
main = STUDY.main

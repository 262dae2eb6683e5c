"""The records of the standing robot through our controller: agreement as flown, refusal of others."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.studies.standing import study as standing
from jax_aero import rust
from jax_aero.replay import replay
from jax_aero.view import logs

TORQUE, FORCE, MOMENT = 0.5, 0.1, 0.3
"""Greatest rms of desired torques [N m], foot forces [N] and foot moments [N m]; the record has 0.1 N of 200 N."""


@pytest.fixture(scope="module", params=["front", "lateral"])
def run(request):
    """Name, configuration, log and flown controller of a recorded run."""
    name, config = standing.STUDY.read(request.param)
    flown = rust.load_config(config.flown)
    return name, config, logs.read(config.record, flown, config.map), flown


def judge(run, variant):
    _, config, log, _ = run
    recorded, computed = replay(log, variant, config.record)
    found = standing.differences(recorded, computed)
    return (
        found["desired torques, rms [N m]"] <= TORQUE
        and found["desired foot forces, rms [N]"] <= FORCE
        and found["desired foot moments, rms [N m]"] <= MOMENT
    )


def test_the_flown_controller_gives_the_recorded_commands(run):
    assert judge(run, run[3])


@pytest.mark.parametrize("cause", standing.CAUSES)
def test_a_controller_that_lacks_a_cause_is_refused(run, cause):
    right = rust.load_config(run[1].right)
    assert not judge(run, standing.restore(run[3], right, standing.CAUSES[cause]))


@pytest.mark.parametrize("changes", [
    {"controller.momentum.kp_linear": [16.5, 16.5, 16.5]},
    {"controller.momentum.kd_linear": [9.0, 9.0, 9.0]},
    {"disturbances.model_error.com_offset": [0.02, 0.0, 0.0]},
])  # fmt: skip
def test_another_gain_or_centre_of_mass_is_refused(run, changes):
    assert not judge(run, rust.set_keys(run[3], changes))


def test_the_base_follows_from_the_joints_as_the_robot_recorded_it(run):
    """Units and signs of the joints, kinematics, axes of the record: 1 deg of a hip would move the base by 10 mm."""
    from jax_aero.base.parquet import read_table

    _, config, log, flown = run
    recorded, _ = replay(log, flown, config.record)
    table = read_table(config.record)
    base = np.stack([table[f"base_{axis}"].to_numpy() for axis in "xyz"], axis=1)
    assert np.abs(recorded["raw_base_position"] - base).max() < 2.5e-3


@pytest.mark.parametrize(
    ("name", "axis", "joint", "mirror"), [("front", 0, "ankle_pitch", 1), ("lateral", 1, "hip_roll", -1)]
)
def test_motion_is_the_mean_of_both_legs_from_calm_to_wind(name, axis, joint, mirror):
    """3 and 5 of the legs are 4, of mirrored joints 3 and -5; the wind begins at 10 s, the motion at 12 s."""
    config = rust.load_config(f"balancing_{name}_as_flown")
    names = rust.Robot(config["robot"]).joint_names
    time = np.arange(0.0, 36.0, 0.01)
    moves = (time >= 12.0)[:, None]
    legs = np.zeros((time.size, len(names)))
    legs[:, [names.index(f"l_{joint}"), names.index(f"r_{joint}")]] = moves * [3.0, mirror * 5.0]
    com = np.zeros((time.size, 3))
    com[:, axis] = np.where(moves[:, 0], -0.04, 0.0)
    signals = {"time": time, "com_position": com, "raw_joint_position": np.radians(legs)}
    found = standing.moved(signals | {"joint_torque_measured": legs}, config)
    words = joint.replace("_", " ")
    expected = {"centre of mass [mm]": 40.0, "onset [s]": 2.0, f"{words} [deg]": 4.0, f"{words}, torque [N m]": 4.0}
    assert {figure: found[figure] for figure in expected} == pytest.approx(expected)
    assert not any(value for figure, value in found.items() if figure not in expected)

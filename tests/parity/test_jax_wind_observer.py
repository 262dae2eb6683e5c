"""The wind from the wrench in JAX against the crate's: the same flight's ticks, read by both."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.aero import aero_model
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.dynamics import dynamics
from jax_aero.body.kinematics import frame_poses, kinematics
from jax_aero.body.robot import load_robot
from jax_aero.body.spatial import cross, rotate
from jax_aero.control.estimate import wind_observer
from jax_aero.verify.flight import states_of

EXPERIMENT = "test2_observer"
WIND = {"profile": "ramp", "velocity": [3.0, -9.0, 1.0], "ramp_start": 0.0, "ramp_end": 0.5}


@pytest.fixture
def replayed(x64, request):
    """A flight of the crate, and what the observer in JAX makes of it with a constant force besides the thrusts."""
    step = getattr(request, "param", 0.01)
    table = rust.load_config(EXPERIMENT, {"controller.bounds.thrust_steepness": 0.05, "controller.wind_observer": True})
    table = rust.set_keys(table, {"controller.time_step": step, "simulator.duration": max(1.0, 10.0 * step)})
    table["wind"] = WIND
    flown = rust.fly(table)
    config, robot = scenario_config(table), load_robot(table["robot"])
    air = aero_model(config.controller.aero, robot)
    step = jnp.asarray(config.controller.time_step)
    rows = states_of(flown.log), jnp.asarray(flown["thrust"])

    @jax.jit
    def replay(force):
        def tick(state, row):
            now, thrust = row
            kin = kinematics(robot, now)
            rotations, points = frame_poses(kin, robot.jets)
            axes = rotate(rotations, robot.jets.axes)
            a_t = jnp.concatenate([axes, cross(points - kin.com, axes)], axis=1).T
            # The force is that of three more jets, through the centre of mass.
            a_t, momentum = jnp.hstack([a_t, -jnp.eye(6, 3)]), dynamics(robot, now, kin).momentum
            seen = kin, momentum, a_t, jnp.concatenate([thrust, force])
            return wind_observer.update(robot, air, step, state, *seen), state

        return jax.lax.scan(tick, wind_observer.start(step), rows)[1]

    return flown, replay


@pytest.mark.parametrize("replayed", [0.01, 0.15], indirect=True)
def test_both_find_the_same_wind(replayed, measured):
    """The truth is that of a flight of the crate, whose log has the wind that its observer gave the controller.

    A tick of 0.15 s is longer than the time constant of the force that is observed; its third is the last before the
    robot falls, when the crate's fault detection holds the wind.
    """
    flown, replay = replayed
    held = 1 + np.flatnonzero(np.diff(flown["measured_wind"], axis=0).any(axis=1))[-1]
    states = jax.tree.map(lambda leaf: leaf[: held + 1], replay(jnp.zeros(3)))
    because = "a hundred ticks of sums of order one hundred; momentum differences over 10 ms"
    measured("wind", np.max(np.abs(states.wind - flown["measured_wind"][: held + 1])), 1e-9, because=because)
    std = jax.vmap(lambda state: state.std)(states)
    measured("std", np.max(np.abs(std - flown["measured_wind_std"][: held + 1])), 1e-9, because=because)
    assert np.linalg.norm(flown["measured_wind"][-1]) > 1.0


def test_sensitivity_is_what_a_lasting_force_does(replayed, measured, monkeypatch):
    """`C` of M110 beside horizontal winds that are estimated with 0.1 N more and less along each horizontal axis."""
    monkeypatch.setattr(wind_observer, "WALK", 3.0)  # the wind of zero, at which it begins, decays in this second
    _, replay = replayed
    size = 0.1
    sensitivity = np.asarray(replay(jnp.zeros(3)).sensitivity[-1, :2, :2])
    moved = [replay(size * axis).wind[-1, :2] - replay(-size * axis).wind[-1, :2] for axis in jnp.eye(3)[:2]]
    found = np.stack(moved, axis=1) / (2.0 * size)
    because = "H is that of a wind that begins at zero, where it changes most: 3 % found"
    measured("sensitivity", np.abs(found - sensitivity).max() / np.abs(sensitivity).max(), 0.1, because=because)

"""What is known of a robot's numbers before its logs are read."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jax_aero.body.kinematics import kinematics_at_rest
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import rotate
from jax_aero.identify import motion
from jax_aero.identify.motion import Numbers
from jax_aero.sweep.perturbation import Perturbation

Array = NDArray[np.float64]

CONSTANT = (2.4e-3, 2.6e-3)
"""Standard deviation of a constant force and moment that no number explains, over the weight and over that at the
radius of gyration: a network's air less its fit."""
OFFSET = 0.01
"""Of a thrust sensor's offset, over the greatest thrust: half of the 2 % of Momin et al., ICRA 2022."""
DAMPING = 0.5
"""Of the drives' viscous friction [N m s]: that of `simulator/robot.toml`."""
DELAY = 0.005
"""Of delays that the controller's estimator does not state [s]: half a period of commands that are held."""
WIND = 5.0
"""Of a wind that is not measured [m/s]."""
TORQUE_GAIN = 1.0 / 0.9 - 1.0
"""Half width of the gain of measured torques, which are within 10 %: harmonic drives, whose efficiency varies with
load."""
BODIES = (0.03, 0.003, 0.02)
"""Half widths of bodies' masses, relative, centres [m] and sizes, relative, beside what the robot has in common: of
CAD, and of cables and screws that it lacks. Ours."""
HEAVY, LOAD = 0.02, (1.0, 0.15)
"""Share of the whole mass from which bodies have these; what the heaviest one may carry, how far from its centre [kg,
m], which is found as mass, centre and inertia of the whole."""
FUEL = 3e-5
"""Deviation of the consumption [kg/(N s)]: that of small turbines is 4e-5 to 5e-5."""
GYRO = np.radians(0.05)
"""Of the gyroscope's rotation in its case [rad]: that of the MTi's data."""
TURNED = (0.3, 0.03)
"""Of the direction of the air's force on a link [rad], and of its point [m]: of a model's, by a network; ours."""


def prior_of(robot: RobotModel, widths: Perturbation, wind: float = 0.0) -> Numbers:
    """Return prior standard deviations: those of uniform distributions with these half widths; `wind` is that of it."""
    jets, joints, links = robot.jets.count, robot.n_joints, robot.aero_links.count
    deviation, (weight, radius) = 1.0 / np.sqrt(3.0), motion.scale_of(robot)
    has_bodies = float(widths.mass > 0.0 and joints > 0)
    com, inertia = _of_whole(robot, _bodies(robot, LOAD))
    return Numbers(
        mass=np.asarray(widths.mass * deviation),
        com=np.hypot(widths.com * deviation, has_bodies * com) * (widths.com > 0.0),
        inertia=np.hypot(widths.inertia * deviation, has_bodies * inertia) * (widths.inertia > 0.0),
        bodies=_bodies(robot) * has_bodies,
        fuel=np.asarray(FUEL),
        thrust_gain=np.full(jets, widths.thrust_gain * deviation),
        thrust_offset=OFFSET * np.asarray(robot.jets.thrust_max),
        thrust_axes=np.full((jets, 2), np.radians(widths.thrust_axis_deg) * deviation),
        torque_gain=np.full(len(robot.joint_groups), TORQUE_GAIN * deviation),
        imu=np.full(3, np.radians(widths.imu_deg) * deviation),
        gyro=np.full(3, GYRO),
        encoders=np.full(joints, np.radians(widths.encoders_deg) * deviation),
        friction=np.full(joints, widths.friction * deviation),  # from zero to the greatest
        damping=np.asarray(DAMPING if joints else 0.0),
        air=np.full(links, np.hypot(widths.drag, widths.link) * deviation),
        air_turn=np.full((links, 3), TURNED[0]),
        air_point=np.full((links, 3), TURNED[1]),
        wrench=weight * np.repeat([CONSTANT[0], CONSTANT[1] * radius], 3),
        wind=np.full(3, wind),
        delay=np.array([DELAY, np.hypot(DELAY, widths.latency * deviation) if joints else 0.0]),
    )


def _bodies(robot: RobotModel, load: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Return the deviations of bodies' numbers (nb, 10): of the heavy ones, and of what the heaviest may carry."""
    masses = np.asarray(robot.masses)
    deviations: Array = np.repeat(BODIES, [1, 3, 6]) * (masses > HEAVY * masses.sum())[:, None] / np.sqrt(3.0)
    heaviest = masses.argmax()
    carried = load[0] / masses[heaviest] / np.sqrt(3.0)
    deviations[heaviest, :4] = np.hypot(deviations[heaviest, :4], carried * np.array([1.0, *[load[1]] * 3]))
    return deviations


def _of_whole(robot: RobotModel, bodies: Array) -> tuple[Array, float]:
    """Return by how much bodies that deviate so change centre of mass and inertia, as `Numbers` has them."""
    kin = kinematics_at_rest(robot, jnp.zeros(robot.n_joints))
    masses = np.asarray(robot.masses)
    arms = np.asarray(kin.body_positions + rotate(kin.body_rotations, jnp.asarray(robot.coms)) - kin.com)
    heavier, moved = (masses * bodies[:, 0])[:, None], masses[:, None] * bodies[:, 1:4].mean(axis=1, keepdims=True)
    com: Array = np.sqrt(np.sum((heavier * arms) ** 2 + moved**2, axis=0)) / masses[0]
    squares = np.sum((2.0 * heavier * np.sum(arms**2, axis=1, keepdims=True)) ** 2 + np.sum((4.0 * moved * arms) ** 2))
    return com, float(np.sqrt(squares) / np.trace(np.asarray(robot.inertias), axis1=1, axis2=2).sum())


def numbers_of(robot: RobotModel, rows: Array) -> Numbers:
    """Return a vector (p,) of values, or of deviations or shares, by name."""
    left = list(rows)
    shapes = {name: np.shape(value) for name, value in prior_of(robot, Perturbation())._asdict().items()}
    parts = {}
    for name, shape in shapes.items():
        size = int(np.prod(shape))
        parts[name], left = np.reshape(left[:size], shape), left[size:]
    return Numbers(**parts)

"""Prediction model of the published controller: centroidal momentum in base axes, attitude, engines, integrals.

    ṗ = R l / m                     l̇ = −ω × l + A_l T + Λ_l Δs + m Rᵀ g
    φ̇ = W⁻¹ I⁻¹ k                   k̇ = −ω × k + A_k T + Λ_k Δs
    T̈ = σ (f(T, Ṫ) + g(T, Ṫ) v)     ė_p = p − p_d     ė_φ = φ − φ_d

There are 26 states: position of the centre of mass (inertial axes), linear and angular momentum (base axes), roll,
pitch and yaw, thrusts, thrust rates, integrals. Inputs are increments of the arms' eight joints, and v of throttles.

Source: Gorbani et al., "Unified multi-rate model predictive control for a jet-powered humanoid robot", 2025, arXiv
2505.16478, and its public repository, ami-iit/paper_gorbani_2025_humanoids_multi-rate-mpc-ironcub.
"""

from __future__ import annotations

import tomllib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust

Array = NDArray[np.float64]

POSITION, LINEAR, ATTITUDE, ANGULAR = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
THRUST, THRUST_RATE = slice(12, 16), slice(16, 20)
POSITION_INTEGRAL, ATTITUDE_INTEGRAL = slice(20, 23), slice(23, 26)
STATES, JETS = 26, 4
ARM_JOINTS = tuple(
    f"{side}_{joint}" for side in "lr" for joint in ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow")
)

THRUST_MEAN, THRUST_SPREAD = 108.309, 65.793
"""Of the thrust in the engine's polynomials [N]."""
THROTTLE_MEAN, THROTTLE_SPREAD = 47.333, 31.483
"""Of the throttle [%]."""
DRIFT = (-0.464730485, -8.13171858, -6.1953923, 0.66111314, 1.67673231, -0.483287064)
"""f: coefficients of 1, x, y, x y, x², y², with x the thrust and y its rate, both in spreads [1/s²]."""
GAIN = (8.77996617, -1.01096376, -0.586442286, 0.519093322, -0.423782666, -1.45705257)
"""g: the same."""
CURVATURE = -0.00783052261
"""v = w + CURVATURE w², with w the throttle less its mean, in spreads."""


class Engine(NamedTuple):
    """Derivatives of the engines' acceleration at thrusts T and rates Ṫ, T̈ = drift + gain v."""

    drift: Array
    gain: Array
    drift_by_thrust: Array
    drift_by_rate: Array
    gain_by_thrust: Array
    gain_by_rate: Array

    @classmethod
    def at(cls, thrust: Array, rate: Array) -> Engine:
        """Evaluate at thrusts [N] and rates [N/s]."""
        x, y = (thrust - THRUST_MEAN) / THRUST_SPREAD, rate / THRUST_SPREAD
        _, fx, fy, fxy, fxx, fyy = DRIFT
        _, gx, gy, gxy, gxx, gyy = GAIN
        slopes = (
            fx + fxy * y + 2.0 * fxx * x,
            fy + fxy * x + 2.0 * fyy * y,
            gx + gxy * y + 2.0 * gxx * x,
            gy + gxy * x + 2.0 * gyy * y,
        )
        return cls(*drift_and_gain(thrust, rate), *slopes)


def drift_and_gain(thrust: Array, rate: Array) -> tuple[Array, Array]:
    """Return σ f and σ g [N/s²] of thrusts [N] and rates [N/s]."""
    x, y = (thrust - THRUST_MEAN) / THRUST_SPREAD, rate / THRUST_SPREAD
    terms = np.array([np.ones_like(x), x, y, x * y, x * x, y * y])
    return THRUST_SPREAD * (np.array(DRIFT) @ terms), THRUST_SPREAD * (np.array(GAIN) @ terms)


def drive(throttle: Array) -> Array:
    """Return v of throttles [%]."""
    w = (throttle - THROTTLE_MEAN) / THROTTLE_SPREAD
    return w + CURVATURE * w * w


def throttle_of(v: Array) -> Array:
    """Return the throttles [%] of v."""
    w = (np.sqrt(1.0 + 4.0 * CURVATURE * v) - 1.0) / (2.0 * CURVATURE)
    throttle: Array = THROTTLE_MEAN + THROTTLE_SPREAD * w
    return throttle


def steady_drive(thrust: Array) -> Array:
    """Return v at which engines keep these thrusts [N]."""
    drift, gain = drift_and_gain(thrust, np.zeros_like(thrust))
    v: Array = -drift / gain
    return v


class Body(NamedTuple):
    """The robot at one tick; vectors in base axes except `com`, Jacobians with respect to the arms' joints."""

    mass: float
    gravity: float
    rotation: Array
    com: Array
    linear: Array
    angular: Array
    omega: Array
    inertia: Array
    axes: Array
    """Directions of the thrusts, (4, 3)."""
    arms: Array
    """From the centre of mass to the jets, (4, 3) [m]."""
    velocity_jacobians: Array
    """Of the jets relative to the centre of mass, the base held, (4, 3, 8) [m]."""
    rotation_jacobians: Array
    """Of the jets relative to the base, (4, 3, 8)."""

    @property
    def attitude(self) -> Array:
        """Roll, pitch and yaw [rad]."""
        return rpy(self.rotation)


class Reader:
    """Reads `Body` from the crate, and what the joints' torques need."""

    def __init__(self, robot: rust.Robot) -> None:
        jets = robot.arrays()["jets"]
        self.robot = robot
        self.bodies = list(jets["bodies"])
        self.frames = [jet["frame"] for jet in tomllib.loads(robot.toml_text)["jets"]]
        self.places: Array = jets["positions"]
        self.directions: Array = np.einsum("jab,jb->ja", jets["rotations"], jets["axes"])
        self.joints = [robot.joint_names.index(name) for name in ARM_JOINTS]

    def read(self, state: rust.State) -> tuple[Body, rust.Dynamics, Array]:
        """Return the body, its dynamics, and the generalised forces of unit thrusts (4, 6 + n)."""
        dynamics = rust.dynamics(self.robot, state)
        jacobians = [rust.frame_jacobian(self.robot, frame, state) for frame in self.frames]
        rotation = np.asarray(state.base_rotation)
        turned = dynamics.body_rotations[self.bodies]
        places = dynamics.body_positions[self.bodies] + np.einsum("jab,jb->ja", turned, self.places)
        axes = np.einsum("jab,jb->ja", turned, self.directions)
        mass, columns = self.robot.mass, [6 + joint for joint in self.joints]
        com_jacobian = dynamics.momentum_matrix[:3, columns] / mass
        body = Body(
            mass=mass,
            gravity=self.robot.gravity,
            rotation=rotation,
            com=dynamics.com_position,
            linear=rotation.T @ dynamics.momentum[:3],
            angular=rotation.T @ dynamics.momentum[3:],
            omega=rotation.T @ np.asarray(state.velocity)[3:6],
            inertia=rotation.T @ dynamics.centroidal_inertia @ rotation,
            axes=axes @ rotation,
            arms=(places - dynamics.com_position) @ rotation,
            velocity_jacobians=np.array([rotation.T @ (one.linear[:, columns] - com_jacobian) for one in jacobians]),
            rotation_jacobians=np.array([rotation.T @ one.angular[:, columns] for one in jacobians]),
        )
        forces = np.array([axis @ one.linear for axis, one in zip(axes, jacobians, strict=True)])
        return body, dynamics, forces


class Model(NamedTuple):
    """The model as x⁺ = (at_once + Δt per_second) (x, Δs, v, 1), both (26, 39): forward Euler, as published."""

    at_once: Array
    per_second: Array


JOINTS, DRIVES, CONSTANT = slice(26, 34), slice(34, 38), 38


def linearise(body: Body, thrust: Array, rate: Array, v: Array, *, engine_dynamics: bool = True) -> Model:
    """Return the model about a tick with these thrusts [N], rates [N/s] and v of the present throttles.

    The integrals' targets are not in it, as they change from knot to knot. Without engine dynamics thrusts are at once
    the steady ones of the throttles.
    """
    at_once, m = np.zeros((STATES, 39)), np.zeros((STATES, 39))
    at_once[:, :STATES] = np.eye(STATES)
    m[POSITION, LINEAR] = body.rotation / body.mass
    m[LINEAR, LINEAR] = m[ANGULAR, ANGULAR] = -skew(body.omega)
    m[LINEAR, THRUST] = body.axes.T
    m[ANGULAR, THRUST] = np.cross(body.arms, body.axes).T
    m[LINEAR, JOINTS], m[ANGULAR, JOINTS] = lambdas(body, thrust)
    m[LINEAR, CONSTANT] = -body.mass * body.gravity * body.rotation[2]
    m[ATTITUDE, ANGULAR] = euler_rates(body.attitude) @ np.linalg.inv(body.inertia)
    m[POSITION_INTEGRAL, POSITION] = m[ATTITUDE_INTEGRAL, ATTITUDE] = np.eye(3)
    if engine_dynamics:
        engine = Engine.at(thrust, rate)
        by_thrust = engine.drift_by_thrust + engine.gain_by_thrust * v
        by_rate = engine.drift_by_rate + engine.gain_by_rate * v
        m[THRUST, THRUST_RATE] = np.eye(JETS)
        m[THRUST_RATE, THRUST], m[THRUST_RATE, THRUST_RATE] = np.diag(by_thrust), np.diag(by_rate)
        m[THRUST_RATE, DRIVES] = np.diag(engine.gain)
        m[THRUST_RATE, CONSTANT] = engine.drift - by_thrust * thrust - by_rate * rate
    else:
        engine, steady = Engine.at(thrust, np.zeros(JETS)), steady_drive(thrust)
        slope = -engine.gain / (engine.drift_by_thrust + engine.gain_by_thrust * steady)
        at_once[THRUST, THRUST] = 0.0
        at_once[THRUST, DRIVES], at_once[THRUST, CONSTANT] = np.diag(slope), thrust - slope * steady
    return Model(at_once, m)


def lambdas(body: Body, thrust: Array) -> tuple[Array, Array]:
    """Return Λ_l [N] and Λ_k [N m], (3, 8): what increments of the arms' joints change at these thrusts."""
    linear, angular = np.zeros((3, 8)), np.zeros((3, 8))
    for jet, strength in enumerate(thrust):
        turned = strength * skew(body.axes[jet]) @ body.rotation_jacobians[jet]
        moved = strength * skew(body.axes[jet]) @ body.velocity_jacobians[jet]
        linear -= turned
        angular -= moved + skew(body.arms[jet]) @ turned
    return linear, angular


def euler_rates(attitude: Array) -> Array:
    """Return W⁻¹: rates of roll, pitch and yaw of an angular velocity in base axes."""
    (sr, sp, _), (cr, cp, _) = np.sin(attitude), np.cos(attitude)
    return np.array([[1.0, sr * sp / cp, cr * sp / cp], [0.0, cr, -sr], [0.0, sr / cp, cr / cp]])


def skew(v: Array) -> Array:
    """Return S(v): S(v) u = v × u."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def rpy(rotation: Array) -> Array:
    """Return roll, pitch and yaw [rad] of a rotation."""
    pitch = -np.arcsin(np.clip(rotation[2, 0], -1.0, 1.0))
    return np.array([np.arctan2(rotation[2, 1], rotation[2, 2]), pitch, np.arctan2(rotation[1, 0], rotation[0, 0])])

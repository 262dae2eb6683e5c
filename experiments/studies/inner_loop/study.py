"""Admissible delay and noise of measurements, from the hovering loop linearised at every tick.

`jax-aero study inner_loop` considers the robot hovering in still air without an observer, under the published
weights and under those of the observer's controller, and forms the Jacobian of one tick about the same state: of the
plant from the model's equations of motion, of the controller by differences of its ticks. A measurement delayed by D
ticks is a row of the state of D ticks ago. For every measurement it prints the greatest delay at which no mode grows,
in ticks of 2 ms; the growth rate of the open loop; and the effect of noise on the commanded joint rates.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_lyapunov
from scipy.spatial.transform import Rotation

from jax_aero import rust
from jax_aero.cli import Parser

Matrix = NDArray[np.float64]

WEIGHTS = (10.0, 30.0)
"""Weights of joint velocities: published, and with the observer."""
STEP = 1e-6
"""Step of the finite differences, in SI units."""
SETTLING = 15.0
"""Time after which the robot hovers [s]."""
LONGEST = 0.03
"""Greatest delay that is tried [s]."""
NOISE = {"base position": 5e-3, "base rotation": 2e-3, "base velocity": 0.02, "gyroscopes": 0.01, "thrust": 0.5}
"""Standard deviations of measurements [m, rad, m/s, rad/s, N]."""


class Loop(NamedTuple):
    """A linear loop with n joints: x the deviation of the state, i the integral of the joint velocity error."""

    world: Matrix
    """∂x⁺/∂x."""
    acting: Matrix
    """∂x⁺/∂u, u the thrust rates and torques."""
    answer: Matrix
    """∂u/∂y, y the measured x."""
    answer_integral: Matrix
    """∂u/∂i."""
    integral: Matrix
    """∂i⁺/∂y."""
    integral_integral: Matrix
    """∂i⁺/∂i."""
    joint_rate: Matrix
    """∂ṡ*/∂y."""
    channels: dict[str, Sequence[int]]
    """Indices of each measurement in y."""
    time_step: float


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    Parser("study inner_loop", __doc__).parse_args(arguments)
    for weight in WEIGHTS:
        fine, flown = linearise(weight, 0.002), linearise(weight, 0.01)
        print(f"weight of joint velocities {weight:g}")
        print(f"  open loop: fastest growth {growth(fine.world, fine.time_step):.1f} 1/s")
        for name in (*fine.channels, "everything"):
            late = greatest_delay(fine, name)
            print(f"  {name:<16} late: " + (f"up to {1e3 * late:.0f} ms" if late < LONGEST else "no limit found"))
        for name, std in NOISE.items():
            found = np.degrees(joint_rates(flown, name, std))
            print(f"  {name:<16} noise {std:g}: {found:.1f} deg/s of commanded joint rates, 10 ms ticks")
    return 0


def linearise(weight: float, time_step: float) -> Loop:
    """Return the loop linearised about hovering in still air."""
    settings = {"simulator.time_step": time_step, "controller.weights.joint_velocity": weight}
    config = rust.load_config("no_wind", {**settings, "mission": {}, "simulator.duration": 2 * SETTLING})
    flight, controller = rust.Flight(config), rust.Controller(config)
    for _ in range(round(SETTLING / time_step)):
        flight.step()
    memory, tick, measured = flight.controller_state, flight.last, flight.truth
    assert memory is not None
    before = tick.velocity_error_integral
    state = measured.state
    parts = (state.base_position, np.zeros(3), state.joint_position, state.velocity, measured.thrust)
    now = np.concatenate([np.asarray(part) for part in parts])
    turned = np.asarray(measured.state.base_rotation)
    n, jets = len(before), len(measured.thrust)
    velocity, thrust = slice(6 + n, 12 + 2 * n), slice(12 + 2 * n, None)

    def run_tick(x: Matrix, integral: Matrix) -> rust.Tick:
        at = now + x
        state = rust.State(at[:3], turned @ _rotation(x[3:6]), at[6 : 6 + n], at[velocity])
        controller.state = memory.with_posture_control(tick.posture, tick.inertia_0_b, before + integral)
        return controller.tick(state, at[thrust], np.zeros(3), measured.time)

    def read_command(x: Matrix, integral: Matrix) -> Matrix:
        found = run_tick(x, integral)
        change = found.velocity_error_integral - before
        return np.concatenate([found.thrust_rate, found.unlimited_torque, change, found.joint_velocity_command])

    zero, none = np.zeros(len(now)), np.zeros(n)
    held = read_command(zero, none)[: jets + n]

    def step_from(x: Matrix, extra: Matrix) -> Matrix:
        rotation = turned @ _rotation(x[3:6])
        after: Matrix = _step_state(run_tick(x, none), now + x, rotation, turned, held + extra, time_step) - now
        return after

    by_state = _jacobian(lambda x: read_command(x, none), len(now))
    by_integral = _jacobian(lambda i: read_command(zero, i), n)
    u, i = slice(0, jets + n), slice(jets + n, jets + 2 * n)
    s = 12 + n
    channels = {
        "base position": range(3),
        "base rotation": range(3, 6),
        "base velocity": range(6 + n, 9 + n),
        "gyroscopes": range(9 + n, s),
        "joint positions": range(6, 6 + n),
        "joint velocities": range(s, s + n),
        "joints": [*range(6, 6 + n), *range(s, s + n)],
        "thrust": range(s + n, s + n + jets),
    }
    return Loop(
        world=_jacobian(lambda x: step_from(x, np.zeros(jets + n)), len(now)),
        acting=_jacobian(lambda extra: step_from(zero, extra), jets + n),
        answer=by_state[u],
        answer_integral=by_integral[u],
        integral=by_state[i],
        integral_integral=by_integral[i],
        joint_rate=by_state[i.stop :],
        channels={name: list(places) for name, places in channels.items()},
        time_step=time_step,
    )


def close_loop(loop: Loop, ages: Matrix) -> Matrix:
    """Return the Jacobian of a tick of the closed loop, with measurements of these ages [ticks]."""
    n, oldest, joints = len(loop.world), int(ages.max()), len(loop.integral)
    size = n * (oldest + 1) + joints
    seen = np.zeros((n, size))
    seen[np.arange(n), n * ages + np.arange(n)] = 1.0
    kept = np.eye(size)[-joints:]
    jacobian = np.zeros((size, size))
    jacobian[:n, :n] = loop.world
    jacobian[:n] += loop.acting @ (loop.answer @ seen + loop.answer_integral @ kept)
    jacobian[n : n * (oldest + 1), : n * oldest] = np.eye(n * oldest)
    jacobian[-joints:] = loop.integral @ seen + loop.integral_integral @ kept
    return jacobian


def growth(jacobian: Matrix, time_step: float) -> float:
    """Return the greatest growth rate of a mode [1/s]."""
    return float(np.log(np.abs(np.linalg.eigvals(jacobian)).max()) / time_step)


def greatest_delay(loop: Loop, name: str) -> float:
    """Return the greatest delay [s] of a measurement, or of all, at which no mode grows."""
    ages = np.zeros(len(loop.world), dtype=int)

    def is_stable(late: int) -> bool:
        ages[loop.channels.get(name, slice(None))] = late
        return growth(close_loop(loop, ages), loop.time_step) < 0.01  # the position of the set-point is a mode at zero

    low, high = 0, round(LONGEST / loop.time_step) + 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if is_stable(middle) else (low, middle)
    return low * loop.time_step


def joint_rates(loop: Loop, name: str, std: float) -> float:
    """Return the greatest standard deviation of a commanded joint rate [rad/s] due to noise of a measurement."""
    noise = np.zeros(len(loop.world))
    noise[loop.channels[name]] = std**2
    jacobian = close_loop(loop, np.zeros(len(loop.world), dtype=int))
    entering = np.vstack([loop.acting @ loop.answer, loop.integral])
    # Slightly less than one, since the equation is singular with marginal modes, which are not excited.
    state = solve_discrete_lyapunov((1.0 - 1e-5) * jacobian, entering * noise @ entering.T)
    seen = state[: len(noise), : len(noise)] + np.diag(noise)
    return float(np.sqrt(np.diag(loop.joint_rate @ seen @ loop.joint_rate.T).max()))


def _step_state(tick: rust.Tick, at: Matrix, rotation: Matrix, hovering: Matrix, u: Matrix, time_step: float) -> Matrix:
    """Return the state after a semi-implicit step from `at` (M78) under thrust rates and torques u.

    `rotation` is that of the base; its deviation from the hovering one is a vector in base axes.
    """
    n, jets = len(tick.velocity_error_integral), len(tick.thrust_rate)
    velocity, thrust = at[6 + n : 12 + 2 * n], at[12 + 2 * n :]
    joints = tick.joint_acceleration_free + tick.torque_gain @ u[jets:]
    wrench = tick.a_t @ thrust
    arm = tick.com_position - at[:3]
    about_base = np.concatenate([wrench[:3], wrench[3:] + np.cross(arm, wrench[:3])])
    mass = tick.mass_matrix
    base = np.linalg.solve(mass[:6, :6], about_base - tick.bias[:6] - mass[:6, 6:] @ joints)
    velocity = velocity + time_step * np.concatenate([base, joints])
    moved = Rotation.from_matrix(hovering.T @ _rotation(time_step * velocity[3:6]) @ rotation).as_rotvec()
    joint_position = at[6 : 6 + n] + time_step * velocity[6:]
    return np.concatenate(
        [at[:3] + time_step * velocity[:3], moved, joint_position, velocity, thrust + time_step * u[:jets]]
    )


def _jacobian(function: Callable[[Matrix], Matrix], size: int) -> Matrix:
    columns = [(function(step) - function(-step)) / (2.0 * STEP) for step in STEP * np.eye(size)]
    return np.array(columns).T


def _rotation(vector: Matrix) -> Matrix:
    matrix: Matrix = Rotation.from_rotvec(vector).as_matrix()
    return matrix

"""Joints that do not follow their torques: M143 of `docs/model/detection.md`, in NumPy."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from tests.references.flights import WITHOUT, Flown
from tests.references.predicted import acceleration, whole

HEALTHY, STUCK, WEAK, FREE = range(4)

FAST, SLOW, REACH = 0.05, 1.0, 1.0
"""τ_r and τ_m [s], ℓ [m]."""

WINDOW, DISPLACED, SHARE, LONGEST = 0.3, 0.005, 0.1, 0.004
"""Time in which displacements are forgotten [s], D_min, the share and the way of a stuck joint [rad]."""

SETTLING, PAUSE, SUSPICION = 2.0, 0.2, 1.0
"""Times without judgement after the start and a finding, and for which m stays during suspicion [s]."""

MOVED, RELEASED, OF_STOP = 0.002, 0.02, 0.087
"""Ways of a weak joint, and of a stuck one that follows again; distance from a stop [rad]."""

FREE_SHARE, WHOLE_SHARE = 0.3, 0.85


class Joints:
    """Conditions of the joints of a flight without an estimator, tick by tick."""

    def __init__(self, config: Any, robot: Any, positions: NDArray[np.float64]) -> None:
        limits, n = config["controller"]["fault_detection"]["joints"], len(robot.joint_names)
        self.least, self.confirmation = limits["torque_min"], limits["confirmation"]
        self.greatest = limits["effectiveness_max"]
        self.robot, self.stops = robot, np.array(robot.joint_stops)
        self.fast, self.mean = np.zeros(6 + n), np.zeros(6 + n)
        self.position = positions.copy()
        self.way, self.commanded = np.zeros(n), np.zeros(n)
        self.pause = SETTLING
        self.found, self.share = np.zeros(n, int), np.ones(n)
        self.held = np.zeros(n)
        self.forget()

    def begin(self, positions: NDArray[np.float64]) -> None:
        """Begin again in a tick that no tick before can be compared with; what is found stays."""
        self.position = positions.copy()
        self.way[:], self.commanded[:], self.mean[:] = 0.0, 0.0, 0.0
        self.pause = SETTLING
        self.interrupt()

    def forget(self) -> None:
        """Begin all suspicions anew."""
        n = len(self.position)
        self.since, self.sums, self.begun_at = np.zeros(n), np.zeros((2, n)), np.zeros(n)

    def interrupt(self) -> None:
        """Judge nothing for a while, since nothing can be compared."""
        self.pause = max(self.pause, PAUSE)
        self.fast = self.mean.copy()
        self.forget()

    def move(self, positions: NDArray[np.float64], *, are_measured: bool, dt: float) -> None:
        """Take in measured positions."""
        left = np.exp(-dt / WINDOW)
        self.way, self.commanded = left * self.way, left * self.commanded
        if are_measured:
            self.way += np.abs(positions - self.position)
            self.position = positions.copy()

    def compare(self, tick: Any, last: Any, dt: float) -> None:
        """Compare a tick with what the last command let expect."""
        velocity, before = (np.asarray(of.estimates.state.velocity) for of in (tick, last))
        unexplained = (velocity - before) / dt - acceleration(self.robot, last, share=self.share)
        base = np.asarray(tick.estimates.state.base_position)
        unexplained[:6] += whole(tick, tick.unmodelled_wrench, base)
        residual = tick.mass_matrix @ unexplained
        self.fast -= np.expm1(-dt / FAST) * (residual - self.fast)
        self.pause -= dt
        if self.pause < 0.5 * dt:
            self._suspect(residual, last.joint_torque, dt)
            is_back = (self.found == STUCK) & (np.abs(self.position - self.held) > RELEASED)
            self.found[is_back] = HEALTHY
        near = np.min(np.abs(self.stops.T - self.position), axis=0) < OF_STOP
        rests = near & (self.found >= WEAK) & (self.way < LONGEST)
        self.found[rests] = STUCK
        self.held[rests] = self.position[rests]
        self.share = np.where(self.found == WEAK, self.share, np.where(self.found == FREE, 0.0, 1.0))
        if np.all((self.since == 0.0) | (self.since > SUSPICION)):
            self.mean -= np.expm1(-dt / SLOW) * (residual - self.mean)

    def _suspect(self, residual: Any, torque: Any, dt: float) -> None:
        x, now = self.fast - self.mean, (residual - self.mean)[6:]
        bound = REACH * np.linalg.norm(x[:3]) + np.linalg.norm(x[3:6]) + self.least
        is_beyond = (np.abs(x[6:]) > bound) & (self.found != STUCK)
        self.begun_at = np.where(is_beyond & (self.since == 0.0), self.position, self.begun_at)
        self.since = np.where(is_beyond, self.since + dt, 0.0)
        self.sums = np.where(is_beyond, self.sums + np.array([now * torque, torque**2]), 0.0)
        found = {}
        for joint in np.flatnonzero(self.since > self.confirmation + 0.5 * dt):
            acts = self.share[joint] + self.sums[0, joint] / self.sums[1, joint]
            greatest = self.greatest if self.found[joint] == HEALTHY else 2.0 - WHOLE_SHARE
            if self._is_still(joint, x[6 + joint], self.fast[6 + joint]):
                found[joint] = STUCK, 0.0
            elif abs(self.position[joint] - self.begun_at[joint]) > MOVED and -FREE_SHARE < acts < greatest:
                is_weak = FREE_SHARE <= acts <= WHOLE_SHARE
                kind = WEAK if is_weak else FREE if acts < FREE_SHARE else HEALTHY
                found[joint] = kind, acts if is_weak else float(kind == HEALTHY)
        if found:
            worst = max(found, key=lambda joint: abs(x[6 + joint]))
            self.found[worst], self.share[worst] = found[worst]
            self.held[worst] = self.position[worst]
            self.interrupt()

    def _is_still(self, joint: int, unexplained: float, resisted: float) -> bool:
        """Return whether a joint stands still although it is commanded to move, and not by a stop."""
        commanded, position = self.commanded[joint], self.position[joint]
        behind, ahead = position - self.stops[joint, 0], self.stops[joint, 1] - position
        if commanded < 0.0:
            behind, ahead = ahead, behind
        opposes = (unexplained if behind > OF_STOP else resisted) * commanded < 0.0
        is_slow = self.way[joint] < min(LONGEST, SHARE * abs(commanded))
        return bool(abs(commanded) > DISPLACED and opposes and ahead > OF_STOP and is_slow)

    def command(self, tick: Any, step: float) -> None:
        """Take in the velocities that are commanded from a tick on."""
        self.commanded = self.commanded + step * tick.joint_velocity_command


def follow(
    config: Mapping[str, Any], ticks: Iterable[Flown], reference: Callable[..., Joints] = Joints
) -> tuple[int | None, NDArray[np.int64], NDArray[np.float64]]:
    """Return in which tick a flight is not the reference's, or `None`; conditions and shares in each until then."""
    step, judge, last, time = config["controller"]["time_step"], None, None, 0.0
    found, shares = list[NDArray[np.int64]](), list[NDArray[np.float64]]()
    for place, (measured, tick, _) in enumerate(ticks):
        lacks, positions = WITHOUT & {*tick.degraded_modes}, np.asarray(measured.state.joint_position)
        if judge is None:
            judge = reference(config, rust.Robot(config["robot"]), positions)
        if last is None or "begun_again" in tick.degraded_modes:
            judge.begin(positions)
        else:
            dt = measured.time - time
            judge.move(positions, are_measured="joints_predicted" not in lacks, dt=dt)
            if lacks:
                judge.interrupt()
            else:
                judge.compare(tick, last, dt)
        judge.command(tick, step)
        last, time = tick, measured.time
        found.append(tick.joint_condition)
        shares.append(judge.share.copy())
        says = "joint_limited" in tick.degraded_modes
        if not np.array_equal(judge.found, tick.joint_condition) or says != tick.joint_condition.any():
            return place, np.array(found), np.array(shares)
    return None, np.array(found), np.array(shares)

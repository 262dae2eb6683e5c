"""Latencies of torques and thrust rates: M164 and M165 of `docs/model/detection.md`, in NumPy."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from tests.references.flights import WITHOUT, Flown, is_wrong

DELAY_MAX, MEMORY, SETTLING = 0.25, 3.0, 3.0
"""Longest delay, τ [s], and the filter times after a gap in which nothing counts."""

SLIP = 0.02
"""Commanded velocity of a joint at which three quarters of the friction are compensated [rad/s]."""

BETWEEN_MAX, LONG, STUCK = 0.15, 10**6, 1
"""Longest time between two measurements [s], the ticks of a longer one, and the number of a stuck joint."""

TIGHT = 1e-6
"""Share of a tick by which decimal fractions of it may be inexact."""


class Kind(NamedTuple):
    """A kind of command: how often and with which T_f [s] the filter acts, σ, and σ_max [s]."""

    times: int
    filter_time: float
    deviation: float
    deviation_max: float


TORQUE, THRUST = Kind(3, 0.025, 1e-4, 6e-4), Kind(1, 0.3, 0.1, 4e-3)


class Delays:
    """What each delay leaves of the responses to one kind of command."""

    def __init__(self, kind: Kind, step: float, size: int, known: float) -> None:
        self.kind, self.step, self.known = kind, step, known
        self.size, self.count = size, self._ticks(DELAY_MAX) + 2
        self.left, self.best = np.zeros((self.count, size)), 1
        self.begin_again()

    def _ticks(self, time: float) -> int:
        return int(np.ceil(time / self.step - TIGHT))

    def begin_again(self) -> None:
        """Forget what was filtered, after a gap; what each delay leaves stays."""
        self.filtered = np.zeros((self.kind.times, 2, self.size))
        self.responses = deque([np.zeros(self.size)] * 2, maxlen=2)
        self.commands = deque([np.zeros(self.size)] * self.count, maxlen=self.count)
        self.wait = self.count + self._ticks(SETTLING * self.kind.times * self.kind.filter_time)

    def add(self, response: Any, command: Any) -> None:
        """Take the response of a tick and the command of the last one."""
        both = np.array([response, command])
        for stage in self.filtered:
            stage *= np.exp(-self.step / self.kind.filter_time)
            stage += both
            both = stage.copy()
        self.responses.appendleft(both[0])
        self.commands.appendleft(both[1])
        self.wait -= 1
        if self.wait < 0:
            rest = (self.responses[1] - np.array(self.commands)) ** 2
            self.left += -np.expm1(-self.step / MEMORY) * (rest - self.left)
        self.best = int(np.argmin(self.losses()))

    def losses(self) -> Any:
        """Return L of delays from −1 on, each joint or thrust relative to its rest with the best delay so far."""
        return np.sum(self.left / (self.left[self.best] + self.kind.deviation**2), axis=1)

    def latency(self) -> float:
        """Return D [s]; NaN where it is not known."""
        of = self.losses()
        if not 0 < self.best < len(of) - 1:
            return np.nan
        before, after = of[self.best - 1], of[self.best + 1]
        curvature = before - 2.0 * of[self.best] + after
        if not curvature > 0.0 or self.step / np.sqrt(curvature * MEMORY / self.step) >= self.kind.deviation_max:
            return np.nan
        return float(self.step * (self.best - 1 + (before - after) / (2.0 * curvature)) - self.known)


class Latencies:
    """Both latencies of a flight, tick by tick."""

    def __init__(self, config: Any, robot: Any) -> None:
        law, joints = config["controller"], robot.joint_names
        self.step, estimator = law["time_step"], law.get("estimator") or {}
        self.limits, latency = law["fault_detection"]["latency"], estimator.get("latency") or {}
        age = {name: (estimator.get(name) or {}).get("delay", 0.0) for name in ("joint_position", "thrust")}
        inner = 0.5 * (1.0 - 1.0 / law["torque"]["steps"]) * self.step
        self.torques = Delays(TORQUE, self.step, len(joints), age["joint_position"] + inner)
        self.rates = Delays(THRUST, self.step, len(robot.jet_names), age["thrust"])
        self.known = np.array([latency.get("torque", 0.0), latency.get("thrust", 0.0)])
        lead = (self.known[0] + age["joint_position"]) / self.step
        self.lead, self.share = int(lead + TIGHT), max(lead - int(lead + TIGHT), 0.0)
        self.friction = np.zeros(len(joints))
        for group, value in (law["torque"].get("friction") or {}).items():
            self.friction[[joints.index(name) for name in robot.joint_groups[group]]] = value
        self.positions: deque[Any] = deque(maxlen=3)
        self.free: deque[Any] = deque([np.zeros(len(joints))] * (self.lead + 2), maxlen=self.lead + 2)
        self.before: tuple[Any, Any] = self.free[0], self.free[0]
        self.thrust: Any = None
        self.last: Any = None
        self.acts: Any = 1.0
        self.beyond, self.unknown = np.zeros(2), 0

    def measure(self, measured: Any, tick: Any, acts: Any = 1.0) -> tuple[tuple[float, float], bool]:
        """Return both latencies after a tick of the crate, by what it was given, and whether commands are late.

        Of its torques these shares act until the next one.
        """
        lacks = {*tick.degraded_modes}
        if "joints_predicted" in lacks or "begun_again" in lacks:
            self.positions.clear()
        else:
            self.positions.appendleft(np.asarray(measured.state.joint_position))
        thrust, step = np.asarray(measured.thrust), self.step
        if self.last is not None:
            self._compare(self.last, tick, is_known=self._knows_momentum(measured, lacks))
            if "thrust_modelled" in lacks:
                thrust = None
            if thrust is not None and self.thrust is not None:
                self.rates.add(thrust - self.thrust, step * self.last.thrust_rate)
            else:
                self.rates.begin_again()
        self.thrust, self.last, self.acts = thrust, tick, acts
        found = self.torques.latency(), self.rates.latency()
        most = np.array([self.limits["torque_max"], self.limits["thrust_max"]])
        differs = np.abs(np.array(found) - self.known) > most
        self.beyond = np.where(differs, self.beyond + 1, 0)
        is_late = (self.beyond - 1) * step > self.limits["confirmation"] - TIGHT * step
        return found, bool(is_late.any())

    def _knows_momentum(self, measured: Any, lacks: set[str]) -> bool:
        """Return whether it is measured, or between two measurements that are missing, but not wrong."""
        self.unknown = LONG if is_wrong(measured, lacks) else self.unknown + 1 if WITHOUT & lacks else 0
        return self.unknown * self.step <= BETWEEN_MAX + TIGHT * self.step

    def _compare(self, last: Any, tick: Any, *, is_known: bool) -> None:
        """Compare measured joints with the torques that act: the commanded ones less the compensated friction."""
        friction = self.friction * np.tanh(last.joint_velocity_command / SLIP)
        acts = self.acts * last.joint_torque - friction
        # The law's own acceleration without torques has the friction.
        predicted = last.joint_acceleration_free + last.torque_gain @ (self.acts * last.joint_torque)
        driven = tick.torque_gain @ acts
        self.free.appendleft(predicted - driven)
        driven = self.step**2 * driven
        is_stuck = bool(np.any(last.joint_condition == STUCK))
        if len(self.positions) < 3 or is_stuck or not is_known:
            self.torques.begin_again()
            return
        now, then, earlier = self.positions
        free = (1.0 - self.share) * self.free[self.lead] + self.share * self.free[self.lead + 1]
        moved = now - 2.0 * then + earlier - self.step**2 * free
        self.torques.add(moved - self.before[0], driven - self.before[1])
        self.before = moved, driven


TOLERANCE = 1e-12
"""Difference of latencies by rounding: 1e-16 of 0.3 s, times 300 ticks of sums and a curvature of 1/30 of L [s]."""


def follow(
    config: Mapping[str, Any],
    ticks: Iterable[Flown],
    reference: Callable[..., Latencies] = Latencies,
    shares: NDArray[np.float64] | None = None,
) -> tuple[bool, NDArray[np.float64]]:
    """Return whether a flight is the reference's, and the crate's latencies with whether one is late, by tick.

    Of the torques these shares (ticks, n) act; all without.
    """
    judge, ours, theirs = reference(config, rust.Robot(config["robot"])), [], []
    for place, (measured, tick, _) in enumerate(ticks):
        found, is_late = judge.measure(measured, tick, 1.0 if shares is None else shares[place])
        ours.append([*found, is_late])
        theirs.append([*tick.measured_latency, "late" in tick.degraded_modes])
    return np.allclose(ours, theirs, rtol=0.0, atol=TOLERANCE, equal_nan=True), np.array(theirs)

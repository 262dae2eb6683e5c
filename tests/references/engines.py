"""Conditions of engines and what they are decided on: M105, M106, M144, M177 and M181 of the model, in NumPy.

The page is `docs/model/detection.md`, "Engines". Observed wrench and residual (M84) are given: JAX has them too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from tests.references.flights import WITHOUT, Flown, is_wrong

WORKS, LIMITED, UNCONFIRMED, STOPPED = range(4)

FORGETTING, RESIDUAL, UNMODELLED = 0.5, 0.02, 1.0
"""τ, τ_n and τ_w [s]."""

ARM = 0.04
"""Lever arm by which forces count beside moments [m]."""

OUTSIDE, UNSEEN, SHOWN, NOT_SHOWN, AGREED, SILENT, MISSING = 0.03, 0.05, 0.02, 0.1, 0.5, 0.01, 0.02
"""Times for which each condition has to last, besides half a tick or measurement [s]."""

OF_THRUST, LEAST_COSINE, OF_MISSING = 0.75, 0.9, 0.4
HELD = 0.5
"""Time after a stop in which it can be given back and w̄ is held [s]."""

FORGOTTEN = 0.1
"""Time after which a jet whose sensor is not used is looked at as a silent one [s]."""


def product(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Return ⟨u, w⟩ of two wrenches."""
    return float(ARM**2 * one[:3] @ other[:3] + one[3:] @ other[3:])


def share(time: float) -> float:
    return float(-np.expm1(-time))


class Engines:
    """Conditions of the engines of a flight without an estimator, tick by tick."""

    def __init__(self, config: Any, robot: Any) -> None:
        detection = config["controller"]["fault_detection"]
        self.step, self.most = config["controller"]["time_step"], detection["engines"]["deviation_max"]
        self.least = (detection.get("unmeasured_engines") or {}).get("force_min")
        self.fraction = detection["engines"]["descent"]["range_fraction_min"]
        self.thrust_min, self.thrust_max = np.array(robot.thrust_min), np.array(robot.thrust_max)
        n, arrays = len(self.thrust_max), robot.arrays()
        self.engines = np.array([arrays["engines"][name] for name in arrays["jets"]["engines"]]).T
        self.state, self.sensor_used = np.zeros(n, int), np.ones(n, bool)
        self.reach = np.array([[0.0, np.inf]] * n)
        self.since, self.taken, self.evidence = np.zeros(n), np.zeros(n), ["nothing"] * n
        self.before_stop: dict[int, Any] = {}
        self.d, self.lag, self.rate = np.zeros(n), np.zeros(n), np.zeros(n)
        self.sums, self.late = np.zeros((2, n)), np.zeros((n, 2))
        self.lasting = np.zeros((n, 4))
        self.silence = np.zeros((n, 3))
        self.mean, self.reading = np.zeros(6), np.full(n, np.nan)

    def begin(self, evidence: Any) -> None:
        """Take the crate's evidence of the first tick, in which nothing is compared."""
        self.reading, self.mean = np.asarray(evidence["reading"]), np.array(evidence["before"])
        self.outside, self.since = np.zeros_like(self.d), np.array(evidence["since"])

    def modes(self) -> set[str]:
        """Return the modes that conditions say."""
        limited = np.isin(self.state, [LIMITED, UNCONFIRMED]).any()
        stopped = (self.state == STOPPED).any()
        return ({"engine_limited"} if limited else set()) | ({"engine_stopped"} if stopped else set())

    # --- what thrusts show ------------------------------------------------------------------------------------------

    def _acceleration(self, thrust: Any, rate: Any, percent: Any) -> Any:
        k_t, k_tt, k_d, k_dd, k_td, b_u, b_t, b_d, b_uu, c, *_ = self.engines
        drift = k_t * thrust + k_tt * thrust**2 + k_d * rate + k_dd * rate**2 + k_td * thrust * rate + c
        return drift + (b_u + b_t * thrust + b_d * rate) * (percent + b_uu * percent**2)

    def compare(
        self, innovation: Any, thrust: Any, last: Any, dt: float, *, is_known: bool, are_measured: bool
    ) -> None:
        """Follow the deviations of thrusts from their commands (M105), and of what lags explain of them (M144)."""
        left = np.exp(-dt / FORGETTING) if is_known else 1.0
        ends = [self._acceleration(thrust, self.rate, end) for end in self.engines[10:12]]
        change = np.clip(last.thrust_rate - self.rate, dt * np.minimum(*ends), dt * np.maximum(*ends))
        rate = self.rate + change
        self.d = left * self.d + innovation
        self.lag = left * self.lag + dt * (0.5 * (self.rate + rate) - last.thrust_rate)
        self.rate = rate
        near = are_measured & (np.abs(self.d) <= 0.5 * self.most)
        self.sums += np.where(near, [self.d * self.lag, self.lag**2], 0.0)
        quarter = 0.25 * self.most**2
        explained = np.clip((quarter + self.sums[0]) / (quarter + self.sums[1]), 0.0, 1.0) * self.lag
        self.outside = self.d - np.clip(self.d, np.minimum(0.0, explained), np.maximum(0.0, explained))
        if is_known:
            self.late += share(dt / RESIDUAL) * (self.outside[:, None] - self.late)
        else:
            self.late[:] = 0.0

    # --- what is found ----------------------------------------------------------------------------------------------

    def find(self, tick: Any, thrust: Any, momentum: Any, reading: Any, sampling: str, dt: float) -> list[Any]:
        """Return each engine's finding of a tick, and by which thrust; `momentum` has n and the time that it covers."""
        n, arms = momentum["residual"], tick.a_t.T
        found: list[Any] = [("nothing", 0.0)] * len(self.state)
        works = self.state <= LIMITED
        beyond = np.abs(self.late[:, 1]) > self.most
        self.lasting[:, 0] = np.where(beyond, self.lasting[:, 0] + dt, 0.0)
        if sampling == "measured":
            self._judge(found, n, arms, thrust, dt)
        self._judge_unseen(found, thrust, works, sampling, dt)
        self._confirm(found, n, arms, momentum["covered"], sampling)
        if self.least is not None:
            # The crate's own ŵ is what is found from it, after a finding.
            self._judge_unmeasured(
                found, momentum | {"observed": tick.unmodelled_wrench}, arms, thrust, reading, sampling, dt
            )
        return found

    def _judge(self, found: Any, n: Any, arms: Any, thrust: Any, dt: float) -> None:
        """Blame sensors, or else engines (M106)."""
        judged = np.flatnonzero((self.lasting[:, 0] > OUTSIDE + 0.5 * dt) & (self.state != UNCONFIRMED))
        if not judged.size:
            return
        suspects = (self.state == WORKS) & (np.abs(self.late[:, 1]) > 0.5 * self.most)
        error = n.copy()
        for jet in np.flatnonzero(suspects):
            error[:3] += arms[jet, :3] * self.late[jet, 0]
            error[3:] += arms[jet, 3:] * self.late[jet, 1]
        are_sensors = product(error, error) < product(n, n)
        for jet in range(len(self.state)):
            if are_sensors and suspects[jet]:
                found[jet] = "wrong_sensor", self.d[jet]
                self._start_anew(jet)
            elif jet in judged:
                found[jet] = "out_of_reach", thrust[jet]

    def _start_anew(self, jet: int) -> None:
        for memory in (self.d, self.lag, self.outside, self.rate):
            memory[jet] = 0.0
        self.late[jet], self.sums[:, jet], self.lasting[jet] = 0.0, 0.0, 0.0

    def _judge_unseen(self, found: Any, thrust: Any, works: Any, sampling: str, dt: float) -> None:
        """Take a sensor as right that shows alone, without momentum, that most of a thrust is missing (M181)."""
        lacks = -self.outside > np.maximum(2.0 * self.most, OF_THRUST * (thrust - self.outside))
        self.lasting[:, 1] = np.where(lacks, self.lasting[:, 1] + dt, 0.0)
        says = np.flatnonzero(lacks & works)
        if sampling == "unknown" and says.size == 1 and self.lasting[says[0], 1] > UNSEEN + 0.5 * dt:
            (jet,) = says
            found[jet] = "stopped_unseen", -self.outside[jet]

    def _confirm(self, found: Any, n: Any, arms: Any, covered: float, sampling: str) -> None:
        """Let the momentum decide on what has been found without it."""
        for jet, arm in enumerate(arms):
            if sampling == "between":
                continue
            if self.state[jet] != UNCONFIRMED or sampling == "unknown":
                self.lasting[jet, 2:] = 0.0
                continue
            along, size = product(n, arm), product(arm, arm)
            is_given = along > 0.5 * self.taken[jet] * size and along**2 > LEAST_COSINE * size * product(n, n)
            self.lasting[jet, 2:] = (self.lasting[jet, 2:] + covered) * [is_given, not is_given]
            if self.lasting[jet, 2] > SHOWN + 0.5 * covered:
                found[jet] = "given", 0.0
                self._start_anew(jet)
            elif self.lasting[jet, 3] > NOT_SHOWN + 0.5 * covered:
                found[jet] = "kept", 0.0

    def _judge_unmeasured(
        self, found: Any, momentum: Any, arms: Any, thrust: Any, reading: Any, sampling: str, dt: float
    ) -> None:
        """Find engines that stop with their sensors (M177)."""
        silent = ~np.isfinite(reading) | (reading == self.reading)
        self.reading = np.where(np.isfinite(reading), reading, self.reading)
        self.silence[:, 0] = np.where(silent, self.silence[:, 0] + dt, 0.0)
        are_silent = self.silence[:, 0] > SILENT + 0.5 * dt
        if sampling != "measured":
            if sampling == "unknown":
                self.silence[:, 1:] = 0.0
            return
        covered, seen = momentum["covered"], momentum["observed"] + momentum["residual"]
        change = seen - self.mean
        sizes = np.array([product(arm, arm) for arm in arms])
        along = np.array([product(change, arm) for arm in arms])
        missing, explained = -along / sizes, along**2 / sizes
        is_alike = explained > LEAST_COSINE * product(change, change)
        shows = is_alike & (missing > np.maximum(self.least, OF_MISSING * thrust))
        are_unused = ~self.sensor_used & (self.since + covered > FORGOTTEN)
        can = (are_silent | are_unused) & (thrust > self.least) & (self.state <= LIMITED)
        of_jet = int(np.argmax(np.where(shows & can, explained, -1.0))) if (shows & can).any() else None
        is_held = of_jet is not None
        for jet in range(len(self.state)):
            if self.state[jet] == STOPPED:
                is_young = self.since[jet] + covered < HELD
                is_held |= is_young
                counts = is_young and -missing[jet] > 0.5 * self.taken[jet]
            else:
                counts = jet == of_jet
            self.silence[jet, 1] = self.silence[jet, 1] + covered if counts else 0.0
            if self.silence[jet, 1] > MISSING + 0.5 * covered:
                found[jet] = ("given" if self.state[jet] == STOPPED else "missing"), 0.0
            says = reading[jet]
            rest = seen - arms[jet] * (says if np.isfinite(says) else 0.0)
            agrees = self.state[jet] == STOPPED and not are_silent[jet] and says > self.least
            agrees = agrees and product(rest, rest) < product(seen, seen)
            self.silence[jet, 2] = self.silence[jet, 2] + covered if agrees else 0.0
            if found[jet][0] != "missing" and self.silence[jet, 2] > AGREED + 0.5 * covered:
                found[jet] = "agreed", says
            if found[jet][0] in {"missing", "given", "agreed"}:
                self.silence[jet, 1:] = 0.0
        if not is_held:
            self.mean += share(covered / UNMODELLED) * (momentum["observed"] - self.mean)

    # --- what follows -----------------------------------------------------------------------------------------------

    def decide(self, found: list[Any], thrust: Any, covered: float) -> NDArray[np.float64]:
        """Change the conditions by the table; return the used thrusts less those of this tick [N]."""
        change = np.zeros(len(found))
        for jet, (name, value) in enumerate(found):
            state, low, high, used = self.state[jet], *self.reach[jet], thrust[jet]
            before = state, low, high, self.sensor_used[jet]
            if state <= LIMITED and name == "wrong_sensor":
                self.sensor_used[jet], change[jet] = False, -value
            elif state <= LIMITED and name == "out_of_reach":
                is_less = self.late[jet, 1] < 0.0
                self.state[jet] = LIMITED
                self.reach[jet] = (min(low, value), value) if is_less else (value, max(high, value))
            elif state <= LIMITED and name == "stopped_unseen":
                self._remember(jet, before, value)
                self.state[jet], self.reach[jet] = UNCONFIRMED, (min(low, used), used)
            elif state <= LIMITED and name == "missing":
                self._remember(jet, before, used)
                self.state[jet], self.reach[jet], self.sensor_used[jet], change[jet] = STOPPED, (0.0, 0.0), False, -used
            elif state == UNCONFIRMED and name == "given":
                self._restore(jet)
                self.sensor_used[jet], change[jet] = False, self.taken[jet]
            elif state == UNCONFIRMED and name == "kept":
                self.state[jet] = LIMITED
            elif state == STOPPED and name in {"given", "agreed"}:
                self._restore(jet)
                self.sensor_used[jet] = self.before_stop[jet][3]
                change[jet] = (self.taken[jet] if name == "given" else value) - used
            else:
                name = "nothing"
            is_same = before == (self.state[jet], *self.reach[jet], self.sensor_used[jet])
            self.since[jet] = self.since[jet] + covered if is_same else 0.0
            if name != "nothing":
                self.evidence[jet] = name
        return change

    def _remember(self, jet: int, before: Any, lacks: float) -> None:
        self.before_stop[jet], self.taken[jet] = before, lacks

    def _restore(self, jet: int) -> None:
        _, low, high, _ = self.before_stop[jet]
        self.reach[jet] = low, high
        self.state[jet] = WORKS if (low, high) == (0.0, np.inf) else LIMITED


TOLERANCE = 1e-9
"""Difference of sums over 200 ticks of differences of thrusts of 200 N: 1e-16 · 200 N · 200, and margin [N]."""

BETWEEN, SPARE = 0.15, 0.1
"""Longest time between two measurements of the momentum [s]; share of a tick by which a sum of times is longer."""

EVIDENCE = {
    "deviation": "d",
    "lag": "lag",
    "outside": "outside",
    "late": "late",
    "monitored": "lasting",
    "before": "mean",
    "unmeasured": "silence",
    "state": "state",
    "reaches": "reach",
    "is_sensor_used": "sensor_used",
    "since": "since",
    "taken": "taken",
}
"""Names of what the crate returns, and of the reference's."""


def follow(
    config: Mapping[str, Any], ticks: Iterable[Flown], reference: Callable[..., Engines] = Engines
) -> tuple[tuple[int, str] | None, list[tuple[int, int, str]]]:
    """Return in which tick a flight is not the reference's, or `None`, and the ticks with findings of each engine."""
    robot = rust.Robot(config["robot"])
    judge, last, time, gap, found = reference(config, robot), None, 0.0, 0.0, []
    for place, (measured, tick, evidence) in enumerate(ticks):
        if last is None:
            used = np.asarray(evidence["reading"])
            judge.begin(evidence)
        else:
            # Once more as the crate's channels do: a sensor that is not used is predicted.
            dt = measured.time - time
            expected = np.maximum(used + dt * last.thrust_rate, robot.thrust_min)
            reading = np.asarray(evidence["reading"])
            is_measured = judge.sensor_used & np.isfinite(reading)
            used = np.where(is_measured, reading, expected)
            modes = {*tick.degraded_modes}
            gap = (np.inf if is_wrong(measured, modes) else gap + dt) if WITHOUT & modes else 0.0
            sampling = "measured" if gap == 0.0 else "between" if gap <= BETWEEN + SPARE * dt else "unknown"
            judge.compare(
                used - expected, used, last, dt, is_known=sampling != "unknown", are_measured=bool(is_measured.all())
            )
            findings = judge.find(tick, used, evidence, reading, sampling, dt)
            used = used + judge.decide(findings, used, np.nan_to_num(evidence["covered"]))
            found += [(place, jet, name) for jet, (name, _) in enumerate(findings) if name != "nothing"]
        for theirs, ours in EVIDENCE.items():
            if not np.allclose(getattr(judge, ours), evidence[theirs], rtol=0.0, atol=TOLERANCE):
                return (place, theirs), found
        if judge.modes() != {"engine_limited", "engine_stopped"} & {*tick.degraded_modes}:
            return (place, "modes"), found
        time, last = measured.time, tick
    return None, found

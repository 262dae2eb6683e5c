"""What a controller without an estimator uses of its measurements: M101 to M103, M108 and M141 of the model, in NumPy.

The page is `docs/model/detection.md`, "Channels".
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from jax_aero import rust
from tests.references.flights import Flown
from tests.references.predicted import acceleration

GREATEST = {
    "wind": [300.0],
    "joints": [100.0, 100.0],
    "linear": [300.0],
    "angular": [100.0],
    "position": [1e6],
    "rotation": [2.0],
    "height": [1e6],
}
JUMPS = {
    "wind": [5.0],
    "joints": [0.5, 30.0],
    "linear": [1.0],
    "angular": [4.0],
    "position": [0.3],
    "rotation": [0.2],
    "height": [0.3],
}
"""z_max and δ of the arrays of each channel."""

VITAL = ("joints", "linear", "angular", "position", "rotation")
MOVING = (*VITAL, "height")
MODES = {
    "wind": "wind_held",
    "joints": "joints_predicted",
    "linear": "velocity_predicted",
    "angular": "velocity_predicted",
    "position": "position_predicted",
    "rotation": "rotation_predicted",
    "height": "ground_held",
}
THRUST_RATIO = 10.0
"""Greatest thrust as a multiple of the jet's."""

SAME, SHARE, FEW = 5, 0.02, 0.2
"""n, the share of δ that a frozen value is away, and σ."""

WIDENING, FOLLOWING, HOLD, FADE = 1.0, 100.0, 1.0, 2.0
"""β [1/s], K_v [1/s], A_hold and A_fade [s]."""

BETWEEN, BLIND, PAUSE, STEPS = 0.15, 3.0, 1.0, 10.5
"""Longest time between two measurements, without measurement before the descent, and of a pause [s]; n of M108."""

SPARE = 0.1
"""Share of a tick by which a sum of times is longer than one of these."""

Arrays = list[NDArray[np.float64]]


@dataclass
class Channel:
    """One channel: its last measurement, its prediction, and what is behind both."""

    name: str
    greatest: Arrays
    jumps: Arrays
    predicted: Arrays
    last: Arrays
    age: float = 0.0
    same: int = 0
    support: int = 0
    against: int = 0
    is_frozen: bool = False
    is_rejected: bool = False
    is_missing: bool = False
    was_new: bool = field(default=False)

    @property
    def moves(self) -> bool:
        return self.name in MOVING

    def is_plausible(self, now: Arrays) -> bool:
        return all(
            np.isfinite(z).all() and (np.abs(z) <= most).all() for z, most in zip(now, self.greatest, strict=True)
        )

    def is_near(self, now: Arrays, other: Arrays, share: float) -> bool:
        parts = zip(now, other, self.jumps, strict=True)
        return all((np.abs(z - near) <= share * jump).all() for z, near, jump in parts)

    def is_expected(self, now: Arrays, missed: float) -> bool:
        return self.is_near(now, self.predicted, (1.0 if self.support > 1 else FEW) + WIDENING * self.age + missed)


class Channels:
    """All channels of a flight, tick by tick."""

    def __init__(self, config: Any, robot: Any, first: Any) -> None:
        law = config["controller"]
        self.step, self.refuses, self.robot = law["time_step"], law["channels"]["jump"], robot
        self.time, self.offset, self.is_begun, self.is_blind = first.time, 0.0, False, False
        jets = {f"thrust {jet}": [THRUST_RATIO * most] for jet, most in enumerate(robot.thrust_max)}
        now = self._read(first)
        self.channels = {}
        for name, most in (GREATEST | jets).items():
            jump = JUMPS.get(name, [np.inf]) if self.refuses else [np.inf] * len(most)
            limits = [[np.full(np.shape(z), x) for z, x in zip(now[name], of, strict=True)] for of in (most, jump)]
            value = [z.copy() for z in now[name]]
            self.channels[name] = Channel(name, *limits, value, [z.copy() for z in value])

    def _read(self, measured: Any) -> dict[str, Arrays]:
        state = measured.state
        velocity = np.asarray(state.velocity)
        parts = {
            "wind": [measured.wind],
            "joints": [state.joint_position, velocity[6:]],
            "linear": [velocity[:3]],
            "angular": [velocity[3:6]],
            "position": [state.base_position],
            "rotation": [state.base_rotation],
            "height": [np.array([measured.height])],
        }
        parts |= {f"thrust {jet}": [np.array([thrust])] for jet, thrust in enumerate(measured.thrust)}
        return {name: [np.asarray(z, float) for z in arrays] for name, arrays in parts.items()}

    def _tell_time(self, clock: float) -> tuple[float, float, bool, set[str]]:
        """Move the time on (M108); return its step, the missed ticks of a pause, whether it is a step, and modes."""
        passed = clock - self.offset - self.time
        is_step = 0.0 < passed < STEPS * self.step
        has_jumped = self.is_begun and not is_step and self.refuses
        if has_jumped:
            self.offset = clock - self.time - self.step
        self.time += self.step if has_jumped else passed
        pauses = self.is_begun and not is_step and 0.0 < passed <= PAUSE
        dt = passed if is_step else self.step
        return dt, passed / self.step if pauses else 0.0, is_step, {"clock_predicted"} if has_jumped else set()

    def use(self, measured: Any, last: Any) -> tuple[dict[str, Arrays], set[str]]:
        """Return what the controller uses in a tick after its `last` one, and which modes it says."""
        dt, missed, is_step, modes = self._tell_time(measured.time)
        now, of, was_begun = self._read(measured), self.channels, self.is_begun
        if was_begun:
            self._predict(last, dt)
        missed = missed if was_begun else np.inf
        are_new = {}
        for name in (*(n for n in of if n == "wind" or "thrust" in n), *MOVING):
            are_new[name] = self._accept(of[name], now, dt, missed, modes)
            if name == "angular" and was_begun:
                self._move_pose(now, dt)
        if is_step and are_new["position"] and are_new["rotation"]:
            self._follow_pose(now, dt)
        for channel in of.values():
            channel.last = now[channel.name]
        used = {name: now[name] if one.age == 0.0 else one.predicted for name, one in of.items()}
        wind = of["wind"]
        if wind.age > 0.0:
            left = np.clip(1.0 - (wind.age - HOLD) / FADE, 0.0, 1.0)
            used["wind"] = [left * wind.predicted[0]]
            modes |= {"wind_lost"} if self._is_longer(wind.age, HOLD + FADE) else set()
        self.is_blind |= any(self._is_longer(of[name].age, BLIND) for name in VITAL)
        modes |= {"descending"} if self.is_blind else set()
        if "begun_again" in modes:
            self.is_blind = False
        self.is_begun = True
        return {name: [z.copy() for z in arrays] for name, arrays in used.items()}, modes

    def _is_longer(self, time: float, limit: float) -> bool:
        return time > limit + SPARE * self.step

    def _predict(self, last: Any, dt: float) -> None:
        of, moved = self.channels, dt * acceleration(self.robot, last)
        for name, rows in {"linear": slice(3), "angular": slice(3, 6)}.items():
            of[name].predicted[0] = of[name].predicted[0] + moved[rows]
        position, velocity = of["joints"].predicted
        velocity = velocity + moved[6:]
        of["joints"].predicted = [position + dt * velocity, velocity]
        for jet, rate in enumerate(last.thrust_rate):
            thrust = of[f"thrust {jet}"]
            thrust.predicted = [np.maximum(thrust.predicted[0] + dt * rate, self.robot.thrust_min[jet])]
        self._bound()

    def _bound(self) -> None:
        for one in self.channels.values():
            one.predicted = [np.clip(z, -most, most) for z, most in zip(one.predicted, one.greatest, strict=True)]

    def _accept(self, one: Channel, now: dict[str, Arrays], dt: float, missed: float, modes: set[str]) -> bool:
        """Accept a channel or not; return whether it is new, and was in the last tick."""
        of, z = self.channels, now[one.name]
        other = {"linear": "angular", "angular": "linear"}.get(one.name)
        has_other = other is not None and np.isfinite(now[other][0]).all()
        is_contradicted = has_other and not (
            of[other].is_plausible(now[other]) and of[other].is_expected(now[other], missed)
        )
        is_plausible = one.is_plausible(z)
        is_sound = is_plausible and one.is_expected(z, missed) and not is_contradicted
        is_same = self.is_begun and all(np.array_equal(a, b) for a, b in zip(z, one.last, strict=True))
        agrees = one.against > 0 and one.is_near(z, one.last, 1.0)
        was_new, counts = one.age == 0.0 and one.same == 0, not (is_same and one.moves)
        one.same = one.same + 1 if is_same else 0
        one.is_missing = not all(np.isfinite(part).all() for part in z)
        leaves = one.moves and one.same >= SAME and not one.is_near(z, one.predicted, SHARE)
        one.is_frozen = is_same and (one.is_frozen or leaves)
        if counts:
            one.against = 1 + agrees * one.against if is_plausible and not is_sound else 0
        is_outvoted = one.against > one.support
        is_old = self._is_longer(one.age, HOLD)
        one.is_rejected |= one.name == "wind" and is_plausible and not is_sound and is_old
        if (is_sound or is_outvoted) and not one.is_frozen and not one.is_rejected:
            one.age = 0.0
            if is_outvoted:
                one.support, one.against = one.against, 0
                modes |= {"begun_again"} if one.name in VITAL else set()
            elif counts:
                one.support = min(one.support + 1, int(BLIND / self.step))
            if counts:
                one.predicted = [part.copy() for part in z]
        else:
            one.age += dt
            is_between = not self._is_longer(one.age, BETWEEN)
            is_usual = one.name == "height" and (np.isnan(one.predicted[0]).any() or is_between)
            modes |= set() if is_usual else {MODES.get(one.name, "thrust_modelled")}
        return was_new and one.age == 0.0 and not is_same and self.is_begun

    def _move_pose(self, now: dict[str, Arrays], dt: float) -> None:
        of = self.channels
        linear, angular = (
            of[name].predicted[0] if of[name].age > 0.0 else now[name][0] for name in ("linear", "angular")
        )
        of["position"].predicted = [of["position"].predicted[0] + dt * linear]
        turn = Rotation.from_rotvec(dt * angular).as_matrix()
        of["rotation"].predicted = [turn @ of["rotation"].predicted[0]]
        of["height"].predicted = [of["height"].predicted[0] + dt * linear[2]]

    def _follow_pose(self, now: dict[str, Arrays], dt: float) -> None:
        of = self.channels
        turned = now["rotation"][0] @ of["rotation"].last[0].T
        skew = 0.5 * (turned - turned.T)
        found = {
            "linear": now["position"][0] - of["position"].last[0],
            "angular": np.array([skew[2, 1], skew[0, 2], skew[1, 0]]),
        }
        for name, moved in found.items():
            one = of[name]
            if one.age > 0.0 and (self._is_longer(one.age, BETWEEN) or not one.is_missing):
                velocity = one.predicted[0]
                one.predicted = [velocity - np.expm1(-FOLLOWING * dt) * (moved / dt - velocity)]


TOLERANCE = 1e-10
"""Difference of predictions over at most 500 ticks, by rounding of 1e-15 that grows as e^{5 t} in 4 s at most."""

SAID = {*MODES.values(), "thrust_modelled", "wind_lost", "begun_again", "descending", "clock_predicted"}
"""Modes that the reference has."""


def compare(
    reference: Channels, measured: rust.Measurement, tick: rust.Tick, last: rust.Tick | None
) -> tuple[float, bool]:
    """Return the greatest difference of what a tick uses, and whether the modes are the same."""
    used, modes = reference.use(measured, last)
    known = tick.estimates
    velocity = np.asarray(known.state.velocity)
    theirs = {
        "wind": [known.wind],
        "joints": [known.state.joint_position, velocity[6:]],
        "linear": [velocity[:3]],
        "angular": [velocity[3:6]],
        "position": [known.state.base_position],
        "rotation": [known.state.base_rotation],
    } | {f"thrust {jet}": [np.array([thrust])] for jet, thrust in enumerate(known.thrust)}
    apart = max(np.max(np.abs(a - b)) for name, parts in theirs.items() for a, b in zip(used[name], parts, strict=True))
    return float(apart), modes == SAID & {*tick.degraded_modes}


def follow(config: Mapping[str, Any], ticks: Iterable[Flown]) -> tuple[bool, list[set[str]]]:
    """Return whether a flight agrees in every tick, and the modes of each until then."""
    reference, last, said = None, None, []
    for measured, tick, _ in ticks:
        reference = reference or Channels(config, rust.Robot(config["robot"]), measured)
        apart, alike = compare(reference, measured, tick, last)
        last = tick
        said.append(SAID & {*tick.degraded_modes})
        if not (apart < TOLERANCE and alike):
            return False, said
    return True, said

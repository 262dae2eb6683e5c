"""A flight in both languages: every tick of the crate's flight alone, and the flight from its start.

```text
tick    before each tick JAX's plant and what its controller is given are the crate's; it keeps its own memory of
        controller, sensors, engines and commands on their way; what it measures, its command and the state to which
        that leads are compared with the crate's
flight  nothing but the start is the crate's; compared until two flights of the crate that differ by a rounding in what
        every tick is given are apart
```
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base.result import FlightResult, match_branch
from jax_aero.body.spatial import wxyz_from_rotation
from jax_aero.control import Measurement
from jax_aero.sim.plant import COMPILER_OPTIONS
from jax_aero.sim.preparation import prepare
from jax_aero.sim.rollout import Ending, make_result
from jax_aero.sim.scenario import Scenario
from jax_aero.sim.signals import FlightRow
from jax_aero.sim.step import FlightState, step
from jax_aero.types import Array, State, where
from jax_aero.verify import (
    KERNEL_TOLERANCE,
    QP_TOLERANCE,
    SOLUTIONS,
    Row,
    compare,
    differences,
    round_numbers,
    round_rotation,
    round_state,
)

FLIGHT_TOLERANCE = 1e-6
"""Greatest difference of two flights, in the unit of the signal."""

OF_SOLVERS = sum(rust.MODES[name] for name in ("plan_kept", "plan_missing", "momentum_held", "torque_held"))
"""Bits of the modes that JAX has as well."""

NOT_COMPARED = ("qp_iterations", "qp_kkt", "measured_torque_latency", "measured_thrust_latency")
"""Signals that belong to a solver, or that the crate's guard alone measures."""

CARRIED = 100
"""Ticks for which memory carries a rounding on: 1 s."""


class Logged(NamedTuple):
    """What JAX takes from the crate's log, for one tick or along a first axis."""

    state: State
    thrust: Float[Array, " j"]
    measurement: Measurement


@dataclass(frozen=True)
class Verified:
    """What was compared of a flight.

    Attributes
    ----------
    crate, twin
        The crate's flight, and JAX's of the same ticks.
    rows
        Comparisons of all signals.
    ticks
        Number of ticks compared: those before the crate's guard acts.
    until
        Time up to which the flight from its start is compared [s].
    """

    crate: FlightResult
    twin: FlightResult
    rows: list[Row]
    ticks: int
    until: float

    @property
    def share(self) -> float:
        """Share of the flight's ticks that are compared."""
        return self.ticks / len(self.crate["time"])


def verify_flight(config: Mapping[str, Any], backend: str = "tree") -> Verified:
    """Compare every tick of a flight alone, and the flight from its start as far as it can be reproduced."""
    crate = rust.fly(config)
    with jax.enable_x64(True):
        scenario, start = prepare({**config, "simulator": {**config["simulator"], "dynamics": backend}})
        twin, free = (fly_as(scenario, start, crate, is_free=is_free) for is_free in (False, True))
    ticks, rows = compare_ticks(crate, twin, replay_rounded(config, crate))
    until, rows_of_flight = compare_flight(crate, free, _fly_rounded(config))
    return Verified(crate, twin, [*rows, *rows_of_flight], ticks, until)


def fly_as(scenario: Scenario, start: FlightState, crate: FlightResult, *, is_free: bool = False) -> FlightResult:
    """Fly the ticks of the crate's flight, or, if `is_free`, as many from its start."""
    log = crate.log
    given = Logged(
        states_of(log, "", rust.rotation_from_wxyz(log["base_quaternion"])),
        jnp.asarray(log["thrust"]),
        Measurement(
            jnp.asarray(log["time"]),
            states_of(log, "raw_", log["raw_base_rotation"]),
            jnp.asarray(log["raw_thrust"]),
            jnp.asarray(log["raw_wind"]),
        ),
    )
    after, rows = jax.device_get(_fly(scenario, start, given, jnp.asarray(is_free)))
    signals = {name: np.asarray(signal, np.float64) for name, signal in rows._asdict().items()}
    ending = Ending(int(after.loss), float(after.loss_size), int(after.loss_tick))
    return make_result(signals, np.asarray(after.posture), ending, int(scenario.n_ticks))


@partial(jax.jit, compiler_options=COMPILER_OPTIONS)
def _fly(
    scenario: Scenario, start: FlightState, logged: Logged, is_free: Bool[Array, ""]
) -> tuple[FlightState, FlightRow]:
    def fly_tick(state: FlightState, of_tick: tuple[Array, Logged]) -> tuple[FlightState, FlightRow]:
        (tick, now), found = of_tick, state.plant
        taken = found._replace(robot=now.state, jets=found.jets._replace(thrust=now.thrust))
        state = state._replace(plant=where(is_free, found, taken))

        def hand(own: Measurement) -> Measurement:
            return where(is_free, own, now.measurement._replace(time=own.time, preview=own.preview))

        state, row = step(scenario, state, tick, hand)
        # The state is that to which JAX's own last tick led.
        return state, row._replace(
            base_position=found.robot.base_position,
            base_quaternion=wxyz_from_rotation(found.robot.base_rotation),
            base_velocity=found.robot.velocity[:6],
            joint_position=found.robot.joint_position,
            joint_velocity=found.robot.velocity[6:],
            thrust=found.jets.thrust,
        )

    ticks = jnp.arange(logged.thrust.shape[0], dtype=jnp.int32)
    return jax.lax.scan(fly_tick, start, (ticks, logged))


def replay_rounded(config: Mapping[str, Any], crate: FlightResult) -> dict[str, NDArray[np.float64]]:
    """Return signals of the crate's flight, every tick of it given what differs by a rounding.

    They are those of the controller, and the velocities to which its command leads.
    """
    rng, log = np.random.default_rng(0), crate.log
    rounded = {name: round_numbers(rng, signal) for name, signal in log.items() if name.startswith("raw_")}
    rounded["raw_base_rotation"] = round_rotation(rng, log["raw_base_rotation"])
    signals = rust.replay(config, {**log, **rounded})
    after = _round_velocities(config, crate, signals["joint_torque"] - crate["joint_torque"])
    return {**signals, "base_velocity": after[:, :6], "joint_velocity": after[:, 6:]}


def _round_velocities(
    config: Mapping[str, Any], crate: FlightResult, torque: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the velocities of a flight, (ticks, 6 + n), each after a step of the forward dynamics that was rounded.

    `torque` is what the rounding changes of the command [N m], (ticks, n).
    """
    rng, robot, dt = np.random.default_rng(2), rust.Robot(config["robot"]), config["simulator"]["time_step"]
    states = states_of(crate.log, "", rust.rotation_from_wxyz(crate["base_quaternion"]))
    velocity, rounded = np.asarray(states.velocity), np.array(states.velocity)
    for tick, accelerated in enumerate(np.diff(velocity, axis=0) / dt):
        state = rust.State(*(np.asarray(part[tick]) for part in states))
        dynamics = rust.dynamics(robot, state)
        force = dynamics.mass_matrix @ accelerated + dynamics.bias
        near = round_numbers(rng, force)
        near[6:] += torque[tick]
        moved = rust.forward_dynamics(robot, round_state(rng, state), near)
        rounded[tick + 1] += dt * (moved - rust.forward_dynamics(robot, state, force))
    return rounded


def compare_ticks(
    crate: FlightResult, twin: FlightResult, rounded: Mapping[str, NDArray[np.float64]]
) -> tuple[int, list[Row]]:
    """Compare a flight with JAX's of the same ticks, up to the first in which the guard acts; return their number too.

    `rounded` is what `replay_rounded` returns.
    """
    ticks = ticks_unguarded(crate)
    rows = compare_signals("tick", crate, twin.log, rounded, ticks)
    if ticks == len(crate["time"]):
        endings = [(flight.outcome, flight.lost_time, flight.lost_reason) for flight in (crate, twin)]
        rows.append(compare("tick", "outcome", [float(endings[0] != endings[1])], [0.0], 0.0))
    return ticks, rows


def ticks_unguarded(crate: FlightResult) -> int:
    """Return the number of ticks before the crate's guard acts."""
    modes = crate["degraded_modes"].astype(int)
    return int(np.argmax([*(modes & ~OF_SOLVERS > 0), True]))


def compare_signals(
    group: str,
    crate: FlightResult,
    twin: Mapping[str, NDArray[np.float64]],
    rounded: Mapping[str, NDArray[np.float64]],
    ticks: int,
) -> list[Row]:
    """Compare the first ticks of all signals of the crate that JAX has computed."""
    rows = []
    for name, signal in crate.log.items():
        if name in twin and name not in NOT_COMPARED:
            theirs = signal[:ticks]
            near = match_branch(name, rounded.get(name, signal)[:ticks], theirs)
            # A flight of JAX that is lost before the crate's has no more ticks.
            ours = np.full_like(theirs, np.nan)
            ours[: len(twin[name])] = twin[name][:ticks]
            ours = match_branch(name, ours, theirs)
            tolerance = QP_TOLERANCE if name in SOLUTIONS else KERNEL_TOLERANCE
            rows.append(compare(group, name, ours, theirs, tolerance, rounded=near, carried=CARRIED))
    return rows


def compare_flight(crate: FlightResult, twin: FlightResult, rounded: FlightResult) -> tuple[float, list[Row]]:
    """Compare two flights until the crate's differs from its own `rounded` one; return that time too [s]."""
    ticks = min(len(flight["time"]) for flight in (crate, twin, rounded))
    names = [name for name in crate.log if name not in NOT_COMPARED]
    near = {name: match_branch(name, rounded[name][:ticks], crate[name][:ticks]) for name in names}
    apart = np.max([differences(near[name], crate[name][:ticks]) for name in names], axis=0)
    ticks = int(np.argmax([*(apart > FLIGHT_TOLERANCE), True]))
    rows = []
    for name in names:
        theirs = crate[name][:ticks]
        ours, rounding = match_branch(name, twin[name][:ticks], theirs), near[name][:ticks]
        rows.append(compare("flight", name, ours, theirs, FLIGHT_TOLERANCE, rounded=rounding, relative=False))
    return float(crate["time"][ticks - 1]), rows


def states_of(log: Mapping[str, NDArray[np.float64]], prefix: str, rotation: NDArray[np.float64]) -> State:
    """Return the states of a log, of the robot or as its sensors measure it (`raw_`), for given rotations."""
    position, velocity, joints, speeds = (
        log[prefix + name] for name in ("base_position", "base_velocity", "joint_position", "joint_velocity")
    )
    return State(*map(jnp.asarray, (position, rotation, joints, np.concatenate([velocity, speeds], axis=1))))


def _fly_rounded(config: Mapping[str, Any]) -> FlightResult:
    """Fly in the crate, with what the controller is given changed by a rounding in every tick."""
    rng, flight = np.random.default_rng(1), rust.Flight(config)
    while not flight.has_ended:
        given = flight.measurement
        thrust, wind = round_numbers(rng, given.thrust), round_numbers(rng, given.wind)
        flight.step(measurement=given._replace(state=round_state(rng, given.state), thrust=thrust, wind=wind))
    return flight.result()

"""A flight in both languages: every tick of the crate's flight alone, and the flight from its start.

```text
tick    before each tick JAX's plant and what its controller is given are the crate's; it keeps its own memory of
        controller, sensors, engines and commands on their way; what it measures, its command and the state to which
        that leads are compared with the crate's, until the memories of two controllers of the crate are apart of
        which one is given what differs by a rounding
astray  the same of flights that are lost, as their controller has no fault detection and is given thrusts that are
        wrong and joints that seem to run away: joints reach their stops, torques their limits
flight  nothing but the start is the crate's; compared until two flights of the crate that differ by a rounding in what
        every tick is given are apart
```
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base.result import FlightResult, match_branch
from jax_aero.body.spatial import wxyz_from_rotation
from jax_aero.control import Measurement
from jax_aero.sim.outcome import FLYING
from jax_aero.sim.plant import COMPILER_OPTIONS
from jax_aero.sim.preparation import prepare
from jax_aero.sim.rollout import Ending, make_result
from jax_aero.sim.scenario import Scenario
from jax_aero.sim.signals import FlightRow
from jax_aero.sim.step import FlightState, step
from jax_aero.types import Array, State, where
from jax_aero.verify import (
    KERNEL_TOLERANCE,
    OF_SOLVERS,
    QP_TOLERANCE,
    SOLUTIONS,
    UNOPTIMISED,
    Row,
    compare,
    differences,
    merge,
    round_numbers,
    round_rotation,
    round_state,
)
from jax_aero.verify.lines import Sides, count_sides

FLIGHT_TOLERANCE = 1e-6
"""Greatest difference of two flights, in the unit of the signal."""

BITS_OF_SOLVERS = sum(rust.MODES[name] for name in OF_SOLVERS)
"""Bits of the modes that JAX has as well."""

NOT_COMPARED = ("qp_iterations", "qp_kkt", "measured_torque_latency", "measured_thrust_latency")
"""Signals that belong to a solver, or that the crate alone measures."""

CARRIED = 100
"""Ticks for which memory carries a rounding on: 1 s."""

SECTION = 100
"""Ticks that one call of JAX flies at most, so that flights of every length are one program; none astray has more."""

WRONG_SPEED, WRONG_THRUST = 3.0, (0.3, 1.5)
"""Speed at which joints of a flight astray seem to run away [rad/s, m/s], and ratio of its thrusts to the true ones."""

UNGUARDED = {"controller.fault_detection": {}, "controller.channels.jump": False}
"""Changes with which the crate's controller accepts any measurement."""


Signals = Mapping[str, NDArray[np.float64]]
"""Rows of signals by their names."""


class Logged(NamedTuple):
    """What JAX takes from the crate's log, for one tick or along a first axis."""

    state: State
    thrust: Float[Array, " j"]
    measurement: Measurement


class Section(NamedTuple):
    """Some ticks of a flight of JAX: what they start from, what JAX is given, and what follows."""

    start: FlightState
    first: Any
    """Number of the first tick."""
    given: Logged
    is_free: Any
    ticks: Any
    """Number of ticks; what is given has more."""
    once: bool
    """Whether its program is compiled without optimisation, since it runs for moments."""
    after: FlightState
    rows: FlightRow
    sides: Sides


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
        Number of ticks compared: those before the crate's fault detection acts, or a rounding decides.
    until
        Time up to which the flight from its start is compared [s].
    scenario, sections
        JAX's scenario, and its ticks that were compared, those astray first.
    """

    crate: FlightResult
    twin: FlightResult
    rows: list[Row]
    ticks: int
    until: float
    scenario: Scenario
    sections: list[Section]

    @property
    def share(self) -> float:
        """Share of the flight's ticks that are compared."""
        return self.ticks / len(self.crate["time"])


def verify_flight(config: Mapping[str, Any], backend: str = "tree") -> Verified:
    """Compare every tick of a flight and of some astray, and the flight from its start as far as it is reproducible."""
    crate, rounded_flight = rust.fly(config), _fly_rounded(config)
    with jax.enable_x64(True):
        scenario, start = prepare({**config, "simulator": {**config["simulator"], "dynamics": backend}})
        replayed = _replay_rounded(config, crate)
        ticks = max(min(ticks_unguarded(crate), ticks_reproducible(crate, replayed)), 1)
        sections = list(fly_sections(scenario, start, crate, ticks))
        free = list(fly_sections(scenario, start, crate, ticks_reproducible(crate, rounded_flight.log), is_free=True))
    twin = join(crate, sections)
    ticks, rows = compare_ticks(crate, twin, replay_rounded(config, crate, twin, replayed), ticks=ticks)
    sections_astray, rows_astray = verify_astray(config, scenario, start)
    until, rows_of_flight = compare_flight(crate, join(crate, free), rounded_flight)
    sections = [*sections_astray, *sections]
    return Verified(crate, twin, [*rows, *rows_astray, *rows_of_flight], ticks, until, scenario, sections)


def verify_astray(config: Mapping[str, Any], scenario: Scenario, start: FlightState) -> tuple[list[Section], list[Row]]:
    """Compare flights whose controller is given what is wrong, and accepts it; return JAX's ticks too."""
    sections: list[Section] = []
    rows: list[Row] = []
    config = rust.set_keys(config, UNGUARDED)
    for crate in fly_astray(config):
        with jax.enable_x64(True):
            flown = list(fly_sections(scenario, start, crate))
        twin = join(crate, flown)
        compared = compare_ticks(crate, twin, replay_rounded(config, crate, twin), "astray")[1]
        rows += [row for row in compared if not row.quantity.startswith("raw_")]  # not what its own sensors measure
        sections += flown[: -(-ticks_unguarded(crate) // SECTION)]
    return sections, merge(rows)


def fly_astray(config: Mapping[str, Any]) -> Iterator[FlightResult]:
    """Yield flights of the crate whose controller is given wrong joints and thrusts, until they are lost."""
    for seed, ratio in itertools.product(range(2), WRONG_THRUST):
        flight = rust.Flight(config)
        wrong = WRONG_SPEED * np.random.default_rng(seed).choice(
            [-1.0, 1.0], np.size(flight.truth.state.joint_position)
        )
        speed = np.sign(ratio - 1.0) * wrong
        while not flight.has_ended and flight.tick < SECTION:
            given = flight.measurement
            velocity, joints = np.asarray(given.state.velocity), np.asarray(given.state.joint_position)
            velocity, joints = velocity + np.append(np.zeros(6), speed), joints + given.time * speed
            state = given.state._replace(velocity=velocity, joint_position=joints)
            flight.step(measurement=given._replace(state=state, thrust=ratio * np.asarray(given.thrust)))
        yield flight.result()


def fly_sections(
    scenario: Scenario,
    start: FlightState,
    crate: FlightResult,
    ticks: int | None = None,
    *,
    is_free: bool = False,
    once: bool = False,
) -> Iterator[Section]:
    """Yield the ticks of a flight, or its first ones, as JAX flies them."""
    log = crate.log
    measured = states_of(log, "raw_")
    given = Logged(
        states_of(log),
        jnp.asarray(log["thrust"]),
        Measurement(jnp.asarray(log["time"]), measured, jnp.asarray(log["raw_thrust"]), jnp.asarray(log["raw_wind"])),
    )
    ticks = len(log["time"]) if ticks is None else ticks
    for first in range(0, ticks, SECTION):
        place = np.minimum(np.arange(first, first + SECTION), len(log["time"]) - 1)
        section = jax.tree.map(lambda leaf, place=place: np.asarray(leaf)[place], given)
        few = np.int32(min(SECTION, ticks - first))
        flown = fly_section(scenario, start, np.int32(first), section, np.asarray(is_free), few, once)
        start = flown.after
        yield flown


def fly_section(
    scenario: Scenario, start: FlightState, first: Any, given: Logged, is_free: Any, ticks: Any, once: bool
) -> Section:
    """Fly the ticks of a section."""
    program = _fly_once if once else _fly
    (after, rows), sides = jax.device_get(program(scenario, start, first, given, is_free, ticks))
    rows = {name: value[:ticks] for name, value in rows.items()}
    return Section(start, first, given, is_free, ticks, once, after, rows, sides)


def join(crate: FlightResult, sections: Sequence[Section]) -> FlightResult:
    """Return the flight of these sections, which are of the crate's first ticks."""
    last = min(sum(int(section.ticks) for section in sections), len(crate["time"])) - 1
    after, rows = sections[-1].after, [section.rows for section in sections]
    ending = Ending(int(after.loss), float(after.loss_size), int(after.loss_tick))
    signals = {name: np.concatenate([row[name] for row in rows]).astype(np.float64) for name in rows[0]}
    return make_result(signals, np.asarray(after.posture), ending, last)


def _fly_ticks(
    scenario: Scenario,
    start: FlightState,
    first: Int[Array, ""],
    given: Logged,
    is_free: Bool[Array, ""],
    ticks: Int[Array, ""],
) -> tuple[FlightState, FlightRow]:
    @jax.jit
    def fly_tick(state: FlightState, place: Array) -> tuple[FlightState, FlightRow]:
        now: Logged = jax.tree.map(lambda leaf: leaf[place], given)
        plant = state.plant
        taken = plant._replace(robot=now.state, jets=plant.jets._replace(thrust=now.thrust))
        state = state._replace(plant=where(is_free, plant, taken))

        def hand(own: Measurement) -> Measurement:
            return where(is_free, own, now.measurement._replace(time=own.time, preview=own.preview))

        state, row = step(scenario, state, first + place, hand)
        # The state is that to which JAX's own last tick led.
        return state, row | {
            "base_position": plant.robot.base_position,
            "base_quaternion": wxyz_from_rotation(plant.robot.base_rotation),
            "base_velocity": plant.robot.velocity[:6],
            "joint_position": plant.robot.joint_position,
            "joint_velocity": plant.robot.velocity[6:],
            "thrust": plant.jets.thrust,
        }

    def next_tick(flown: tuple[Array, FlightState, FlightRow]) -> tuple[Array, FlightState, FlightRow]:
        place, state, rows = flown
        state, row = fly_tick(state, place)
        return place + 1, state, {name: signal.at[place].set(row[name]) for name, signal in rows.items()}

    none = jnp.zeros_like(first)
    _, row = jax.eval_shape(fly_tick, start, none)
    rows = {name: jnp.zeros((given.thrust.shape[0], *value.shape), value.dtype) for name, value in row.items()}

    def goes_on(flown: tuple[Array, FlightState, FlightRow]) -> Array:
        return (flown[0] < ticks) & (flown[1].loss == FLYING)

    _, after, rows = jax.lax.while_loop(goes_on, next_tick, (none, start, rows))
    return after, rows


_fly = jax.jit(count_sides(_fly_ticks), compiler_options=COMPILER_OPTIONS)
_fly_once = jax.jit(count_sides(_fly_ticks), compiler_options=COMPILER_OPTIONS | UNOPTIMISED)


def replay_rounded(
    config: Mapping[str, Any], crate: FlightResult, twin: FlightResult, replayed: Signals | None = None
) -> Signals:
    """Return signals of the crate's flight, every tick of it given what differs by a rounding.

    They are those of the controller, `replayed`, and the velocities to which its command leads. The torques of `twin`
    differ by the tolerance of a solution, which their own row judges; velocities inherit it, those of an estimator too.
    """
    signals = {name: np.array(rows) for name, rows in (replayed or _replay_rounded(config, crate)).items()}
    torque = signals["joint_torque"] - crate["joint_torque"]
    ticks = min(len(torque), len(twin["joint_torque"]))
    torque[:ticks] += twin["joint_torque"][:ticks] - crate["joint_torque"][:ticks]
    after = _round_velocities(config, crate, torque)
    if config["controller"].get("estimator"):
        for name, estimate in _estimate_under(config, crate, twin).items():
            signals[name][: len(estimate)] += estimate - crate[name][: len(estimate)]
    return {**signals, "base_velocity": after[:, :6], "joint_velocity": after[:, 6:]}


def _replay_rounded(config: Mapping[str, Any], crate: FlightResult) -> Signals:
    """Return the controller's signals in a flight of which it is given what differs by a rounding."""
    rng, log = np.random.default_rng(0), crate.log
    rounded = {name: round_numbers(rng, signal) for name, signal in log.items() if name.startswith("raw_")}
    rounded["raw_base_rotation"] = round_rotation(rng, log["raw_base_rotation"])
    return rust.replay(config, {**log, **rounded})


def _estimate_under(config: Mapping[str, Any], crate: FlightResult, twin: FlightResult) -> Signals:
    """Return what the crate estimates on its flight where the commands of `twin` act: velocities and forces."""
    controller, rows, forces = rust.Controller(config), [], []
    states, given = states_of(crate.log, "raw_"), (crate["raw_thrust"], crate["raw_wind"], crate["time"])
    for tick, (rates, torque) in enumerate(zip(twin["thrust_rate"], twin["joint_torque"], strict=True)):
        if tick == len(crate["time"]) or not np.isfinite([*rates, *torque]).all():
            break
        state = rust.State(*(np.asarray(part[tick]) for part in states))
        answer = controller.tick(state, *(part[tick] for part in given))
        rows.append(np.asarray(answer.estimates.state.velocity))
        forces.append(np.asarray(answer.aero_force))
        controller.replace_command(rates, torque)
    velocity = np.stack(rows)
    estimates = {"measured_base_velocity": velocity[:, :6], "measured_joint_velocity": velocity[:, 6:]}
    return {**estimates, "aero_force_control": np.stack(forces)}


def _round_velocities(
    config: Mapping[str, Any], crate: FlightResult, torque: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the velocities of a flight, (ticks, 6 + n), each after a step of the forward dynamics that was rounded.

    `torque` is what the rounding and the twin's solver change of the command [N m], (ticks, n).
    """
    rng, robot, dt = np.random.default_rng(2), rust.Robot(config["robot"]), config["controller"]["time_step"]
    states = states_of(crate.log)
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
    crate: FlightResult,
    twin: FlightResult,
    rounded: Signals,
    group: str = "tick",
    ticks: int | None = None,
) -> tuple[int, list[Row]]:
    """Compare a flight with JAX's of the same first ticks, and return their number.

    Without `ticks`, all up to the first in which fault detection acts. `rounded` is what `replay_rounded` returns.
    """
    ticks = ticks_unguarded(crate) if ticks is None else ticks
    # The crate's controller is given a measurement of a robot that has diverged astray; JAX's computes nothing there.
    last = 1 if group == "astray" and crate.outcome == "diverged" and ticks == len(crate["time"]) else 0
    rows = compare_signals(group, crate, twin.log, rounded, ticks - last)
    if ticks == len(crate["time"]):
        endings = [(flight.outcome, flight.lost_time, flight.lost_reason) for flight in (crate, twin)]
        rows.append(compare(group, "outcome", [float(endings[0] != endings[1])], [0.0], 0.0))
    return ticks, rows


def ticks_unguarded(crate: FlightResult) -> int:
    """Return the number of ticks before the crate's fault detection acts."""
    modes = crate["degraded_modes"].astype(int)
    return int(np.argmax([*(modes & ~BITS_OF_SOLVERS > 0), True]))


def compare_signals(
    group: str,
    crate: FlightResult,
    twin: Signals,
    rounded: Signals,
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
    ticks = min(len(twin["time"]), ticks_reproducible(crate, rounded.log))
    rows = []
    for name in _of_flight(crate):
        theirs = crate[name][:ticks]
        ours, rounding = (match_branch(name, flight[name][:ticks], theirs) for flight in (twin, rounded))
        rows.append(compare("flight", name, ours, theirs, FLIGHT_TOLERANCE, rounded=rounding, relative=False))
    return float(crate["time"][ticks - 1]), rows


def ticks_reproducible(crate: FlightResult, rounded: Signals) -> int:
    """Return the number of ticks before the crate's flight differs from signals of its own `rounded` one."""
    names = [name for name in _of_flight(crate) if name in rounded]
    ticks = min(len(crate["time"]), len(rounded[names[0]]))
    near = (match_branch(name, rounded[name][:ticks], crate[name][:ticks]) for name in names)
    apart = np.max([differences(part, crate[name][:ticks]) for part, name in zip(near, names, strict=True)], axis=0)
    return int(np.argmax([*(apart > FLIGHT_TOLERANCE), True]))


def _of_flight(crate: FlightResult) -> list[str]:
    return [name for name in crate.log if name not in NOT_COMPARED]


def states_of(log: Mapping[str, NDArray[np.float64]], prefix: str = "") -> State:
    """Return the states of a log, of the robot or as its sensors measure it (`raw_`).

    They are arrays of NumPy: JAX's would be rounded to single precision where double is not on.
    """
    rotation = log["raw_base_rotation"] if prefix else rust.rotation_from_wxyz(log["base_quaternion"])
    position, velocity, joints, speeds = (
        log[prefix + name] for name in ("base_position", "base_velocity", "joint_position", "joint_velocity")
    )
    parts: list[Any] = [position, rotation, joints, np.concatenate([velocity, speeds], axis=1)]
    return State(*parts)


def _fly_rounded(config: Mapping[str, Any]) -> FlightResult:
    """Fly in the crate, with what the controller is given changed by a rounding in every tick."""
    rng, flight = np.random.default_rng(1), rust.Flight(config)
    while not flight.has_ended:
        given = flight.measurement
        thrust, wind = round_numbers(rng, given.thrust), round_numbers(rng, given.wind)
        flight.step(measurement=given._replace(state=round_state(rng, given.state), thrust=thrust, wind=wind))
    return flight.result()

"""What few flights reach, compared beside every flight, so that none depends on a number that is zero in it.

```text
everything  a small robot with all that JAX has, none of whose numbers is zero: `configs/verify/everything.toml`; and
            with faults that exclude these, and limits that it reaches
engine      predicted thrusts of engines that run, that reach their least thrust and that have stopped
setpoint    a mission that is longer than any of the generator's limits
wind        the velocity of the air, of every kind
limit       whether a state just within and just beyond each limit of what is physically possible ends a flight
```
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base import places
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.jets import engines, predict_thrust
from jax_aero.body.robot import load_robot
from jax_aero.config import WindConfig
from jax_aero.control.law import setpoint
from jax_aero.control.law.mission import commands
from jax_aero.sim import outcome
from jax_aero.sim.outcome import BY_THRUST, FLYING, LIMITS, lost_reason
from jax_aero.sim.preparation import prepare
from jax_aero.sim.wind import wind_model, wind_velocity
from jax_aero.types import State
from jax_aero.verify import KERNEL_TOLERANCE, UNOPTIMISED, Row, compare, merge, use_double_precision
from jax_aero.verify.flight import compare_ticks, fly_sections, join, replay_rounded
from jax_aero.verify.reach import Compared

FILE = places.CONFIGS / "verify" / "everything.toml"

PLAIN: dict[str, Any] = {
    "simulator.initial.base_velocity": [0.0] * 6,
    "simulator.jets": {"dynamics": "ideal"},
    "simulator.actuation": None,
    "simulator.sensors": None,
    "simulator.motors": None,
    "controller.estimator": None,
    "controller.torque.rotor_inertia": 0.0,
    "controller.torque.friction": {},
    "disturbances": {},
}
"""Changes with which the crate flies in a world that shows it any state."""

OTHERWISE: dict[str, Any] = {
    "simulator.initial.thrust": [40.0, 3.0, 40.0],
    "simulator.sensors.thrust.bias": -6.0,
    "simulator.fall.com_error": 0.25,
    "disturbances.jets.failure": {"jet": "back_jet", "kind": "stuck", "time": 0.1},
    "disturbances.joints": [{"joint": "stroke", "kind": "stuck", "start": 0.2}],
    "controller.disturbance_observer.force_max": 2.0,
    "controller.disturbance_observer.moment_max": 0.2,
}
"""Changes with which a jet and a joint are stuck, the observer is at its limits, an estimated thrust would be negative,
and the flight ends far from its set-point."""

MISSION: dict[str, Any] = {
    "simulator.duration": 28.0,
    "mission": {
        "forward_turbo": [[0.1, 6.0]],
        "pitch_up": [[12.0, 15.0]],
        "up": [[16.0, 23.0]],
        "yaw_left": [[17.0, 18.0]],
        "land": [[23.5, 27.5]],
    },
}
"""Changes with which the set-point's turbo, both of its pitch limits and both speeds of a landing act."""

STEADY = {"velocity": [3.0, -7.0, 1.0]}
RISING = STEADY | {"ramp_start": 0.5, "ramp_end": 1.5}
WINDS: dict[str, dict[str, Any]] = {
    "constant": STEADY,
    "ramp": RISING,
    "gust": STEADY | {"gust": [2.0, 5.0, -3.0], "start": 0.7, "duration": 1.1},
    "turbulent": RISING | {"std": [1.0, 2.0, 0.5], "time_scale": 0.6, "seed": 4},
    "samples": {"samples": [[0.2, 1.0, 2.0, 3.0], [0.9, -4.0, 6.0, 0.5], [1.6, 2.0, -1.0, 7.0]]},
}
"""A wind of every kind, by its profile."""


@cache
def verify_everything() -> tuple[list[Row], list[Compared]]:
    """Compare what few flights reach; return JAX's ticks of the flights too."""
    rows, flown = list[Row](), list[Compared]()
    for changes in ({}, OTHERWISE):
        config = use_double_precision(rust.load_config(FILE, changes))
        crate = rust.fly(config)
        with jax.enable_x64(True):
            scenario, start = prepare(config)
            sections = list(fly_sections(scenario, start, crate, once=True))
        twin = join(crate, sections)
        rows += compare_ticks(crate, twin, replay_rounded(config, crate, twin), "all")[1]
        flown.append(Compared(scenario, (), sections))
    config = rust.load_config(FILE)
    with jax.enable_x64(True):
        others = [*verify_engines(config), *verify_setpoint(rust.set_keys(config, MISSION))]
        others += [*verify_winds(), verify_limits(config)]
    return merge(rows) + others, flown


def verify_engines(config: Mapping[str, Any]) -> list[Row]:
    """Compare predicted thrusts and their rates, from thrusts measured a tick late, some below the engine's least."""
    step = config["controller"]["time_step"]
    config = rust.set_keys(config, {"controller.estimator": {"thrust": {"delay": step}}})
    robot, controller, rng = load_robot(config["robot"]), rust.Controller(config), np.random.default_rng(0)
    rest, torque, air = rust.State.at_rest(rust.Robot(config["robot"])), np.zeros(len(robot.joint_limits)), np.zeros(3)
    least = np.asarray(robot.jets.thrust_min)
    # Rates become negative only of great thrusts.
    greatest = np.where(rng.random((201, least.size)) < 0.5, 2.0 * least, robot.jets.thrust_max)
    measured = rng.uniform(0.0, greatest)
    commanded, theirs = rng.uniform(-300.0, 100.0, measured.shape), []
    for tick, (thrust, rate) in enumerate(zip(measured, commanded, strict=True)):
        known = controller.tick(rest, thrust, air, tick * step).estimates
        controller.replace_command(rate, torque)
        theirs.append((known.thrust, known.thrust_rate))
    model = engines(robot, robot.jets.engines)

    @partial(jax.jit, compiler_options=UNOPTIMISED)
    def predict(measured: Any, commanded: Any) -> Any:
        def tick(rate: Any, now: Any) -> Any:
            thrust, rate = predict_thrust(now[0], rate, now[1], jnp.asarray(step), jnp.asarray(least), model)
            return rate, (thrust, rate)

        return jax.lax.scan(tick, jnp.zeros(least.size), (measured, commanded))[1]

    ours = predict(measured[1:], commanded[:-1])
    pairs = zip(("thrust", "thrust_rate"), ours, zip(*theirs[1:], strict=True), strict=True)
    return [compare("engine", name, twin, crate, KERNEL_TOLERANCE) for name, twin, crate in pairs]


def verify_setpoint(config: Mapping[str, Any]) -> list[Row]:
    """Compare the set-points of a whole mission."""
    typed = scenario_config(config)
    law, robot = typed.controller, load_robot(typed.robot)
    params = setpoint.setpoint_params(law.setpoint, robot.forward_axis, jnp.asarray(law.time_step))
    begin, turn = np.array([0.1, -0.2, 0.8]), rust.rotation_from_wxyz([0.2, 0.1, -0.1, 1.0])

    @partial(jax.jit, compiler_options=UNOPTIMISED)
    def follow(times: NDArray[np.float64]) -> Any:
        def tick(state: Any, time: Any) -> Any:
            state, made = setpoint.update(params, commands(typed.mission), state, time)
            return state, made._asdict() | {"raw_position": state.raw.position, "raw_rpy": state.raw.rpy}

        return jax.lax.scan(tick, setpoint.start(params, jnp.asarray(begin), jnp.asarray(turn)), times)[1]

    theirs = rust.setpoint_trajectory(config, begin, turn)
    ours = follow(law.time_step * np.arange(len(theirs["raw_rpy"])))
    return [compare("setpoint", name, ours[name], rows, KERNEL_TOLERANCE) for name, rows in theirs.items()]


def verify_winds() -> list[Row]:
    """Compare every kind of wind from before its beginning to after its end."""
    times, rows = np.linspace(0.0, 2.5, 251), []
    for profile, numbers in WINDS.items():
        table = {"profile": profile, **numbers}
        wind = wind_model(msgspec.convert(table, WindConfig))
        along = jax.jit(jax.vmap(partial(wind_velocity, wind)), compiler_options=UNOPTIMISED)
        rows.append(compare("wind", profile, along(times), rust.wind_velocity(table, times), KERNEL_TOLERANCE))
    return rows


def verify_limits(config: Mapping[str, Any]) -> Row:
    """Compare whether and why flights end that begin just within and just beyond each limit of what is possible."""
    config = rust.set_keys(config, PLAIN)
    with jax.enable_x64(True):
        scenario, start = prepare(config)
        judge = jax.jit(partial(outcome.divergence, scenario.plant), compiler_options=UNOPTIMISED)
        unlike = []
        for extreme in _extremes(rust.Robot(config["robot"]), np.asarray(start.plant.jets.thrust)):
            state, thrust, wind = extreme
            jets = start.plant.jets._replace(thrust=jnp.asarray(thrust))
            plant = start.plant._replace(robot=State(*map(jnp.asarray, state)), jets=jets)
            code = int(judge(plant, jnp.asarray(wind)))
            ours = None if code == FLYING else lost_reason(code, 0.0)
            unlike.append(ours != _judged(config, extreme))
    return compare("limit", "outcome", np.array(unlike, float), np.zeros(len(unlike)), 0.0)


Extreme = tuple[rust.State, NDArray[np.float64], NDArray[np.float64]]
"""State, thrusts and wind."""


def _extremes(robot: rust.Robot, thrust: NDArray[np.float64]) -> Iterator[Extreme]:
    """Yield what is just within and just beyond each limit, of which one number is there."""
    rest, still, n = rust.State.at_rest(robot), np.zeros(3), len(robot.joint_names)
    speed, turning, joint, beyond, _ = LIMITS.values()
    for share in (0.999, 1.001):
        for place, limit in ((0, speed), (1, -speed), (4, turning), (5, -turning), (6, joint), (6 + n - 1, -joint)):
            yield rest._replace(velocity=share * limit * np.eye(6 + n)[place]), thrust, still
        for place, stop in ((0, 0), (n - 1, 1)):
            position = np.zeros(n)
            position[place] = robot.joint_stops[place][stop] + (2 * stop - 1) * share * beyond
            yield rest._replace(joint_position=position), thrust, still
        yield rest, thrust, np.array([0.0, 0.0, share * speed])
        yield rest, np.append(share * LIMITS[BY_THRUST] * robot.thrust_max[0], thrust[1:]), still


def _judged(config: Mapping[str, Any], extreme: Extreme) -> str | None:
    """Return the reason for which a flight of the crate is lost when it meets this, if it has diverged.

    Before, it is at rest, for as many ticks as thrusts need to get there.
    """
    state, thrust, wind = extreme
    robot, step = rust.Robot(config["robot"]), config["controller"]["time_step"]
    world = _Shown(rust.State.at_rest(robot))
    # 100 times the greatest thrust in a second are accepted.
    ticks = int(np.ceil(np.max(thrust / robot.thrust_max, initial=1.0)))
    blown = {"profile": "samples", "samples": [[0.0, 0.0, 0.0, 0.0], [ticks * step, *wind.tolist()]]}
    flight = rust.Flight(rust.set_keys(config, {"wind": blown}), world)
    rate = (thrust - flight.truth.thrust) / (ticks * step)
    for _ in range(ticks):
        flight.step(command=rust.Command(rate, np.zeros(len(robot.joint_names))))
    world.state = state
    flight.step()
    result = flight.result()
    return result.lost_reason if result.outcome == "diverged" else None


class _Shown:
    """A world that shows one state."""

    def __init__(self, state: rust.State) -> None:
        self.state = state

    def observe(self) -> rust.Seen:
        n = len(np.asarray(self.state.joint_position))
        return rust.Seen(self.state, self.state, np.zeros((0, 6)), np.zeros(n), np.zeros((0, 3)))

    def advance(self, torque: NDArray[np.float64], force: NDArray[np.float64]) -> None:
        """Stay there."""

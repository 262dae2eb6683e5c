"""Faults of what no tick of a flight reaches are refused, and what nothing has reached is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.body import dynamics
from jax_aero.control.law import setpoint, torques
from jax_aero.control.law.torques import Torques
from jax_aero.sim import jet_faults, outcome, prepare
from jax_aero.sim.joint_faults import JointFaults
from jax_aero.sim.scenario import Scenario
from jax_aero.verify import (
    UNOPTIMISED,
    everything,
    flight,
    law,
    lines,
    random_samples,
    reach,
    ticks,
    verify_robots,
)
from jax_aero.verify.flight import compare_ticks, fly_sections, join, replay_rounded, verify_astray

pytestmark = pytest.mark.usefixtures("x64")


@pytest.mark.slow
def test_what_no_tick_of_a_flight_reaches_is_refused(monkeypatch):
    """Six faults with which TEST2 agreed in all of its ticks."""
    config = rust.load_config("test2", {"simulator.duration": 2.0})
    (scenario, start), samples = prepare(config), random_samples(config, 50)
    robot, controller = scenario.plant.robot, scenario.controller

    def of_robot(**parts) -> Scenario:
        return replace(scenario, plant=replace(scenario.plant, robot=replace(robot, **parts)))

    def refused(twin: Scenario) -> list[str]:
        rows = ticks.compare_ticks(config, samples, ticks.twin_ticks(twin.controller, twin.model, samples))
        rows += verify_astray(config, twin, start)[1]
        return [row.quantity for row in rows if not row.agrees]

    assert refused(scenario) == []
    assert "momentum_qp.upper" in refused(of_robot(jets=replace(robot.jets, thrust_max=10.0 * robot.jets.thrust_max)))
    faster = replace(scenario, controller=replace(controller, torque_rate_max=10.0 * controller.torque_rate_max))
    assert "joint_torque" in refused(faster)
    assert "joint_velocity" in refused(of_robot(joint_stops=1.1 * robot.joint_stops))
    assert "outcome" in refused(replace(scenario, fall=replace(scenario.fall, rotation_error_deg=jnp.array(120.0))))
    monkeypatch.setattr(torques, "INTEGRAL_LIMIT", 1e3)
    ticks._twin_ticks.clear_cache()
    assert "velocity_error_integral" in refused(scenario)
    ticks._twin_ticks.clear_cache()


def test_a_wrong_sign_of_prismatic_joints_is_refused(monkeypatch):
    """The robot of TEST2 has none."""
    (path,), right = {rust.load_config("test2")["robot"]}, dynamics._inertial_wrenches
    assert all(row.agrees for row in verify_robots(path, 5))

    def wrong(robot, state, kin, *others):
        return right(robot, state, kin._replace(joint_linear=-kin.joint_linear), *others)

    monkeypatch.setattr(dynamics, "_inertial_wrenches", wrong)
    rows = verify_robots(path, 5)
    assert {(row.group, row.quantity) for row in rows if not row.agrees} == {
        ("slider", "bias"),
        ("slider", "acceleration"),
    }


@pytest.mark.slow
def test_exchanged_gains_of_two_joints_are_refused():
    """Each joint's own posture gain acts, as the samples are away from their posture."""
    config = rust.load_config("test2_mpc")
    (params, model), samples = law.law_of(config), random_samples(config, 20)
    gain = np.array(params.tasks.posture_gain)
    other = int(np.argmax(gain != gain[0]))
    gain[[0, other]] = gain[[other, 0]]

    def refused(params) -> list[str]:
        rows = ticks.compare_ticks(config, samples, ticks.twin_ticks(params, model, samples))
        return [row.quantity for row in rows if not row.agrees]

    assert refused(params) == []
    assert refused(replace(params, tasks=params.tasks._replace(posture_gain=gain)))


@pytest.fixture(scope="module")
def flown():
    """The flight with everything, of the crate, with JAX's scenario and start."""
    config = rust.load_config(everything.FILE)
    crate = rust.fly(config)
    with jax.enable_x64(True):
        return config, crate, replay_rounded(config, crate, crate), *prepare(config)


def refused_of(flown, twin: Scenario, start) -> list[str]:
    _, crate, rounded, *_ = flown
    ticks, rows = compare_ticks(crate, join(crate, list(fly_sections(twin, start, crate, once=True))), rounded, "all")
    assert ticks == len(crate["time"]) > 50
    return [row.quantity for row in rows if not row.agrees]


@pytest.mark.slow
def test_wrong_numbers_of_what_is_zero_in_most_flights_are_refused(flown):
    """Sensors that drift or tremble, a share of a latency, couples of rotors, a jet that fades: each by 1 %."""
    *_, scenario, start = flown
    sensors, estimator = scenario.measuring.sensors, scenario.controller.estimator
    robot, jets = scenario.plant.robot, scenario.plant.jets

    def of_plant(**parts) -> Scenario:
        return replace(scenario, plant=replace(scenario.plant, **parts))

    def of_sensors(**parts) -> Scenario:
        return replace(scenario, measuring=replace(scenario.measuring, sensors=replace(sensors, **parts)))

    mixed = replace(estimator, lags=(1.01 * estimator.lags[0], estimator.lags[1]))
    couples = replace(robot.jets, torque_to_thrust=1.01 * robot.jets.torque_to_thrust)
    wrong = {
        "drift": of_sensors(drift=1.01 * sensors.drift),
        "amplitude of the tremble": of_sensors(tremble=sensors.tremble * jnp.array([1.01, 1.0])),
        "frequency of the tremble": of_sensors(tremble=sensors.tremble * jnp.array([1.0, 1.01])),
        "a latency's mix": replace(scenario, controller=replace(scenario.controller, estimator=mixed)),
        "couples of rotors": of_plant(robot=replace(robot, jets=couples)),
        "decay of a jet": of_plant(jets=replace(jets, decay=1.01 * jets.decay)),
        "limit of a jet": of_plant(jets=replace(jets, upper=1.01 * jets.upper)),
    }
    assert refused_of(flown, scenario, start) == []
    found = {name: refused_of(flown, twin, start) for name, twin in wrong.items()}
    assert all(found.values()), found


@pytest.fixture(scope="module")
def otherwise():
    """The flight with other faults, at limits; a stuck jet's thrust and a stuck joint's place have a number each."""
    right = jet_faults.limit_thrust, JointFaults.stuck

    def limit_thrust(faults, state, *others):
        thrust, rate, after = right[0](faults, state, *others)
        return jnp.where(faults.fails & (after.left < 0.0), (1.0 + faults.decay) * thrust, thrust), rate, after

    def stuck(faults, state, joints):
        are, places = right[1](faults, state, joints)
        return are, jnp.where(are, places + (1.0 - faults.share[0]), places)

    config = rust.load_config(everything.FILE, everything.OTHERWISE)
    crate = rust.fly(config)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jet_faults, "limit_thrust", limit_thrust)
        patch.setattr(JointFaults, "stuck", stuck)
        patch.setattr(flight, "_fly_once", jax.jit(flight.count_sides(flight._fly_ticks), compiler_options=UNOPTIMISED))
        with jax.enable_x64(True):
            yield config, crate, replay_rounded(config, crate, crate), *prepare(config)


@pytest.mark.slow
def test_wrong_faults_and_limits_are_refused(otherwise):
    *_, scenario, start = otherwise
    controller, plant, joints = scenario.controller, scenario.plant, scenario.plant.joint_faults
    observer = controller.observer
    limits = {"force_max": observer.moment_max, "moment_max": observer.force_max}

    def of_plant(**parts) -> Scenario:
        return replace(scenario, plant=replace(plant, **parts))

    wrong = {
        "thrust of a stuck jet": of_plant(jets=replace(plant.jets, decay=jnp.array(0.003))),
        "place of a stuck joint": of_plant(joint_faults=replace(joints, share=jnp.array([0.999]))),
        "limits of the observer": replace(
            scenario, controller=replace(controller, observer=replace(observer, **limits))
        ),
        "greatest error": replace(scenario, fall=replace(scenario.fall, com_error=1.05 * scenario.fall.com_error)),
    }

    def refused(twin: Scenario) -> list[str]:
        _, crate, rounded, *_ = otherwise
        twin = join(crate, list(fly_sections(twin, start, crate, once=True)))
        return [row.quantity for row in compare_ticks(crate, twin, rounded, "all")[1] if not row.agrees]

    assert otherwise[1].outcome == "fell"
    assert "CoM" in otherwise[1].lost_reason
    assert otherwise[1]["measured_thrust"].min() == 0.0
    assert refused(scenario) == []
    found = {name: refused(twin) for name, twin in wrong.items()}
    assert all(found.values()), found


WRONG_LEAST = {
    "1 % of the least thrust": lambda thrust, least: jnp.clip(thrust, 0.0, 0.99 * least),
    "a stopped engine that loses 0.1 %": lambda thrust, least: jnp.where(thrust < least, 0.999 * thrust, least),
    "a stopped engine that loses all": lambda thrust, least: jnp.where(thrust < least, 0.0, least),
    "a stopped engine that runs again": lambda _, least: least,
}


@pytest.mark.parametrize("wrong", WRONG_LEAST)
def test_wrong_least_thrusts_are_refused(wrong, monkeypatch):
    config, right = rust.load_config(everything.FILE), everything.predict_thrust

    def predict(thrust, thrust_rate, command, dt, thrust_min, engines):
        rate = right(thrust, thrust_rate, command, dt, thrust_min, engines)[1]
        below = WRONG_LEAST[wrong](thrust, thrust_min)
        return jnp.maximum(thrust + 0.5 * dt * (thrust_rate + rate), below), rate

    with jax.enable_x64(True):
        assert all(row.agrees for row in everything.verify_engines(config))
        monkeypatch.setattr(everything, "predict_thrust", predict)
        refused = [row.quantity for row in everything.verify_engines(config) if not row.agrees]
    assert refused == ["thrust"]


@pytest.mark.slow
def test_wrong_limits_of_set_points_are_refused(monkeypatch):
    config = rust.set_keys(rust.load_config(everything.FILE), everything.MISSION)

    def refused() -> list[str]:
        return [row.quantity for row in everything.verify_setpoint(config) if not row.agrees]

    assert refused() == []
    right = setpoint.setpoint_params
    for change in ([1.01, 1.0], [1.0, 1.01]):

        def wrong(*given, change=change):
            params = right(*given)
            return params._replace(nose_down_limits=params.nose_down_limits * jnp.array(change))

        monkeypatch.setattr(setpoint, "setpoint_params", wrong)
        assert "raw_rpy" in refused()
    monkeypatch.setattr(setpoint, "setpoint_params", right)
    for name, factor in [("TURBO_BOOST", 1.003), ("LANDING_HEIGHT", 1.01), ("LANDING_SPEED", 1.003)]:
        with monkeypatch.context() as wrong_number:
            wrong_number.setattr(setpoint, name, factor * getattr(setpoint, name))
            assert "raw_position" in refused(), name


@pytest.mark.parametrize("criterion", outcome.LIMITS)
def test_wrong_limits_of_what_is_possible_are_refused(criterion, flown, monkeypatch):
    assert everything.verify_limits(flown[0]).agrees
    monkeypatch.setitem(outcome.LIMITS, criterion, 1.01 * outcome.LIMITS[criterion])
    assert not everything.verify_limits(flown[0]).agrees


@pytest.mark.parametrize(("profile", "number"), [("gust", "gust"), ("gust", "duration"), ("turbulent", "std")])
def test_wrong_winds_are_refused(profile, number, monkeypatch):
    assert all(row.agrees for row in everything.verify_winds())
    right = everything.wind_model

    def wrong(settings):
        wind = right(settings)
        return replace(wind, **{number: 1.01 * getattr(wind, number)}) if hasattr(wind, number) else wind

    monkeypatch.setattr(everything, "wind_model", wrong)
    assert [row.quantity for row in everything.verify_winds() if not row.agrees] == [profile]


@pytest.mark.slow
def test_wrong_commands_where_a_qp_has_no_answer_are_refused(monkeypatch):
    """The torques that are held, and an integral that goes on."""
    config = rust.load_config("test2")
    samples, right = random_samples(config, 50), Torques.solve

    def refused() -> set[str]:
        ticks._twin_ticks.clear_cache()
        return {row.quantity for row in ticks.verify_held(config, samples) if not row.agrees}

    assert refused() == set()

    def spoil(change):
        def solve(self, memory, *known):
            after, torque = right(self, memory, *known)
            return change(memory, after, torque)

        monkeypatch.setattr(Torques, "solve", solve)

    def weaken(_, after, torque):
        held = jnp.where(torque.is_solved, 1.0, 0.99) * torque.joint_torque
        return after._replace(joint_torque=held), torque._replace(joint_torque=held)

    def integrate(before, after, torque):
        same = jnp.all(after.velocity_error_integral == before.velocity_error_integral)
        return after._replace(
            velocity_error_integral=after.velocity_error_integral + jnp.where(same, 1e-3, 0.0)
        ), torque

    spoil(weaken)
    assert "joint_torque" in refused()
    spoil(integrate)
    assert "velocity_error_integral" in refused()
    ticks._twin_ticks.clear_cache()


ENGINE = ("k_tt", "k_dd", "k_td", "b_t", "b_d", "b_uu", "c", "throttle_min")
ELSEWHERE = {
    "limit of the integral",
    *("plant.robot.joint_stops", "plant.robot.jets.thrust_min", "plant.robot.jets.thrust_max", "controller.torque_max"),
    *("controller_model.joint_stops", "controller_model.jets.thrust_min", "controller_model.jets.thrust_max"),
    *("controller.tasks.thrust_steepness", "controller.observer.force_max", "controller.observer.moment_max"),
    *("controller.setpoint.nose_down_limits", "fall.com_error", "plant.jets.jets.thrust_min"),
    *("controller.setpoint.position_lags", "controller.mission.up", "controller.mission.down"),
    *("plant.robot.aero_links.positions", "controller_model.aero_links.positions"),
    *("plant.jets.is_stuck", "plant.joint_faults.is_stuck"),
    *(f"{engines}.{name}" for engines in ("plant.jets.jets.engines", "controller.engines") for name in ENGINE),
}
"""What half a second of a small robot does not reach: limits, slow set-points, zeros of its file, another failure."""


@pytest.mark.slow
def test_the_flight_with_everything_reaches_everything(flown):
    """Errors, delays and failures above all: a change of each shows."""
    _, crate, _, scenario, start = flown
    sections = list(fly_sections(scenario, start, crate, once=True))
    named = {*reach.unreached(reach.Compared(scenario, (), sections))}
    assert named <= ELSEWHERE
    assert not {name for name in named if name.startswith(("measuring", "actuation", "wind", "controller.estimator"))}


def choose(x):
    y = jnp.where(x > 0.0, x, -x)
    return jnp.where(x > 5.0, y, 2.0 * y)


def loop(x):
    def body(k, x):
        return jax.lax.cond(k > 2, lambda x: x - 1.0, lambda x: x, choose(x))

    return jax.lax.fori_loop(0, 4, body, x)


def test_choices_count_their_sides(monkeypatch):
    """Within loops and branches, by the line of the model that has them."""
    here = Path(__file__)
    monkeypatch.setattr(lines, "FOLDERS", (f"{here.parent}/",))
    monkeypatch.setattr(lines, "HOME", here.parent)
    text = here.read_text(encoding="utf-8").splitlines()

    def line(words: str) -> str:
        return f"{here.name}:{next(place for place, found in enumerate(text, 1) if words in found)}"

    with lines.watch_lines() as seen:
        result, sides = jax.jit(lines.count_sides(loop))(jnp.array(1.0))
    assert result == loop(jnp.array(1.0))
    first, second, third = line("    y = jnp.where("), line("    return jnp.where(x"), line("return jax.lax.cond(")
    assert {*sides} == {first, second, third}
    assert lines.untaken([sides]) == {first: "no"}
    again = jax.jit(lines.count_sides(loop))(jnp.array(-1.0))[1]
    assert lines.untaken([sides, again]) == {}
    assert lines.untaken([jax.jit(lines.count_sides(choose))(jnp.array(1.0))[1]]) == {first: "no", second: "yes"}
    assert (str(here), int(first.split(":")[1])) in seen
    assert lines.shown([1, 2, 3, 7, 9, 10]) == "1-3 7 9-10"


def test_changes_leave_zeros_to_themselves():
    """A number that is zero is another variant: what it is multiplied with shows nothing."""
    numbers, zeros = reach.changes(np.array([0.0, 2.0]))
    assert numbers.tolist() == [0.0, 2.2]
    assert zeros == pytest.approx([0.1, 2.0])
    assert reach.changes(np.zeros(2))[0] is None
    numbers, zeros = reach.changes(np.array([0, 3, -1], np.int32))
    assert (numbers.tolist(), zeros.tolist()) == ([0, 2, 0], [1, 3, -1])
    assert reach.changes(np.array([True, False]))[0].tolist() == [False, False]


def test_what_nothing_reaches_is_named():
    """Limits act in random ticks and astray; these flights turn over before they are far away or the mission begins."""
    config = rust.load_config("test2", {"simulator.duration": 2.0})
    (scenario, start), samples = prepare(config), random_samples(config, 20)
    sections, _ = verify_astray(config, scenario, start)
    found = reach.unreached(reach.Compared(scenario, samples, sections))
    assert not {"controller.torque_rate_max", "controller.torque_max", "plant.robot.joint_stops"} & {*found}
    assert not {"plant.robot.jets.thrust_max", "fall.rotation_error_deg"} & {*found}
    far = {"fall.com_error", "controller.mission.down", "wind.ramp_end", "controller.setpoint.attitude_rate"}
    assert far <= {*found}

"""The linearised loop with late measurements, on loops whose limits are known; what is made of an estimated wind."""

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.studies.inner_loop import study as inner_loop
from jax_aero import rust

STEP = 0.002


def integrator(gain):
    """ẋ = u, u = −gain y, and an integral that has no output."""
    one = np.eye(1)
    return inner_loop.Loop(
        world=one,
        acting=STEP * one,
        answer=-gain * one,
        answer_integral=0.0 * one,
        integral=0.0 * one,
        integral_integral=0.5 * one,
        joint_rate=3.0 * one,
        channels={"x": [0]},
        time_step=STEP,
    )


def test_growth_of_a_loop_without_delay_is_that_of_its_poles(agree):
    loop = integrator(10.0)
    found = inner_loop.growth(inner_loop.close_loop(loop, np.zeros(1, dtype=int)), STEP)
    agree("decay", found, np.log(1.0 - 10.0 * STEP) / STEP, 1e-12)


def test_the_greatest_delay_of_an_integrator_is_a_quarter_of_a_turn():
    """An integrator under the gain k is stable up to a delay of π / 2k, of which sample and hold takes half a tick."""
    gain = 100.0
    expected = np.pi / 2.0 / gain - 0.5 * STEP
    found = inner_loop.greatest_delay(integrator(gain), "x")
    assert found <= expected < found + STEP
    # A loop that grows slowly is not stable at any delay.
    assert inner_loop.greatest_delay(integrator(-0.5), "x") == 0.0
    # One that is slow enough is stable at every delay that is tried.
    assert inner_loop.greatest_delay(integrator(1.0), "x") == inner_loop.LONGEST


def test_noise_of_a_measurement_comes_back_through_the_state(agree):
    """x⁺ = (1 − a) x − a ε: its variance is a² / (1 − (1 − a)²), and the rate reads x + ε."""
    gain, std = 100.0, 0.3
    a = gain * STEP
    variance = a * a / (1.0 - ((1.0 - 1e-5) * (1.0 - a)) ** 2) + 1.0
    agree("rate", inner_loop.joint_rates(integrator(gain), "x", std), 3.0 * std * np.sqrt(variance), 1e-9)


def test_the_loop_is_linearised_where_the_robot_hovers(monkeypatch, capsys, agree):
    """Positions move with velocities, thrusts with their rates, and the torso is driven back to where it was."""
    monkeypatch.setattr(inner_loop, "SETTLING", 0.05)
    loop = inner_loop.linearise(30.0, 0.01)
    n = (len(loop.world) - 16) // 2
    assert loop.integral.shape == (n, len(loop.world))
    base, velocity, thrust = slice(0, 3), slice(6 + n, 9 + n), slice(12 + 2 * n, None)
    # Differences over 2e-6 of positions about 1 m, 1e-10, and of thrusts about 100 N, 7e-9.
    agree("position by position", loop.world[base, base], np.eye(3), 1e-9)
    agree("thrust by its rate", loop.acting[thrust, :4], 0.01 * np.eye(4), 1e-5)
    # ∂x⁺/∂v of a semi-implicit step is ∂v⁺/∂v times its length.
    agree("position by velocity", loop.world[base, velocity], 0.01 * loop.world[velocity, velocity], 1e-7)
    found = loop.channels
    assert found["joint positions"] == list(range(6, 6 + n))
    assert sorted(found["joints"]) == sorted([*found["joint positions"], *found["joint velocities"]])
    single = [*found["base position"], *found["base rotation"], *found["joint positions"], *found["base velocity"]]
    single += [*found["gyroscopes"], *found["joint velocities"], *found["thrust"]]
    assert single == list(range(len(loop.world)))
    torso = loop.answer[4:7, found["joint positions"][:3]]
    assert np.all(np.diag(torso) < 0.0)
    assert inner_loop.growth(loop.world, 0.01) > 0.0
    monkeypatch.setattr(inner_loop, "linearise", lambda *_: loop)
    monkeypatch.setattr(inner_loop, "greatest_delay", lambda _, name: 0.004 if name == "thrust" else inner_loop.LONGEST)
    monkeypatch.setattr(inner_loop, "joint_rates", lambda _loop, _name, std: np.radians(std))
    assert inner_loop.main([]) == 0
    printed = capsys.readouterr().out
    assert printed.count("late: up to 4 ms") == 2
    assert printed.count("late: no limit found") == 2 * len(found)
    assert printed.count("noise 0.5: 0.5 deg/s of commanded joint rates") == 2


def test_the_step_of_the_linearised_world_is_that_of_the_simulator(agree):
    """From the same state under the same command; the rotation is a vector in the axes of the base before the step."""
    config = rust.load_config("no_wind", {"mission": {}, "simulator.time_step": STEP})
    flight = rust.Flight(config)
    for _ in range(3):
        state, thrust = flight.truth.state, flight.truth.thrust
        flight.step()
    tick, before = flight.last, flight.truth
    at = np.concatenate([state.base_position, np.zeros(3), state.joint_position, state.velocity, thrust])
    rotation = np.asarray(state.base_rotation)
    found = inner_loop._step_state(
        tick, at, rotation, rotation, np.concatenate([tick.thrust_rate, tick.joint_torque]), STEP
    )
    after = before.state
    turned = Rotation.from_matrix(rotation.T @ np.asarray(after.base_rotation)).as_rotvec()
    expected = np.concatenate([after.base_position, turned, after.joint_position, after.velocity, before.thrust])
    # Without the drag at 0.02 m/s: 7e-5 N on 44 kg make 3e-9 m/s in a step, beside a thrust of 98 N.
    agree("state", found, expected, 1e-9)

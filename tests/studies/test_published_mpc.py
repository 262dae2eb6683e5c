"""Each term of the published model against the crate or differences; its problem against another solver."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments.studies.published_mpc import flight, model, plan, study
from jax_aero import own, rust
from jax_aero.base import places
from jax_aero.results.identity import Identity
from jax_aero.results.work import Work

THRUST, RATE = np.array([150.0, 171.0, 120.0, 165.0]), np.array([20.0, -30.0, 5.0, 40.0])
THROTTLE = np.array([60.0, 70.0, 80.0, 50.0])
STEP = 1e-6


def moving(robot, velocity=(0.3, -0.5, 0.2, 0.7, -0.4, 0.5)):
    """The trim of the flights, turned and moving, joints at rest."""
    joints = np.array(rust.load_config("mk3_hover")["simulator"]["initial"]["joint_position"])
    rotation = Rotation.from_euler("ZYX", [0.4, -0.3, 0.2]).as_matrix()
    return rust.State(np.array([1.0, 2.0, 3.0]), rotation, joints, np.concatenate([velocity, np.zeros(len(joints))]))


@pytest.fixture(scope="module")
def robot():
    return rust.Robot(rust.load_config("mk3_hover")["robot"])


@pytest.fixture(scope="module")
def body(robot):
    return model.Reader(robot).read(moving(robot))[0]


@pytest.fixture(scope="module")
def linearised(body):
    return model.linearise(body, THRUST, RATE, model.drive(THROTTLE))


def states(body, thrust=THRUST, rate=RATE, integrals=(0.1, 0.2, 0.3, -0.1, -0.2, -0.3)):
    return np.concatenate([body.com, body.linear, body.attitude, body.angular, thrust, rate, integrals])


def rates(linearised, state, v):
    return linearised.per_second @ np.concatenate([state, np.zeros(8), v, [1.0]])


def test_one_step_of_the_plant_in_still_air_is_that_of_the_model(robot, body, linearised, agree):
    """Momentum turned by ω, thrusts, gravity, position and attitude: in a step so short that Euler's error is small."""
    length, state = 2e-4, moving(robot)
    config = rust.load_config("mk3_hover", {"controller.time_step": length, "simulator.aero": {"model": "off"}})
    initial = config["simulator"]["initial"]
    turned = Rotation.from_matrix(state.base_rotation)
    initial |= {
        "base_position": [1.0, 2.0, 3.0],
        "base_rpy_deg": turned.as_euler("ZYX", degrees=True)[::-1].tolist(),
        "base_velocity": state.velocity[:6].tolist(),
        "thrust": THRUST.tolist(),
    }
    flown, reader = rust.Flight(config), model.Reader(robot)
    before, dynamics, forces = reader.read(flown.truth.state)
    torque = flight.torques(dynamics, THRUST @ forces, np.zeros(23))
    flown.step(command=rust.Command(np.zeros(4), torque))
    after = reader.read(flown.truth.state)[0]
    found = (states(after) - states(before))[:12] / length
    expected = rates(linearised, states(body), model.drive(THROTTLE))[:12]
    # A step changes velocities by 4e-4 m/s of 0.5 and 6e-4 rad/s of 0.9, and turns base axes by 2e-4.
    agree("position", found[model.POSITION], expected[model.POSITION], 1e-2)
    agree("attitude", found[model.ATTITUDE], expected[model.ATTITUDE], 1e-2)
    agree("linear momentum", found[model.LINEAR], expected[model.LINEAR], 2e-3)
    agree("angular momentum", found[model.ANGULAR], expected[model.ANGULAR], 5e-3)


def test_increments_of_the_joints_change_force_and_moment_as_differences_do(robot, linearised, agree):
    reader, state = model.Reader(robot), moving(robot)

    def wrench(joint, step):
        joints = np.array(state.joint_position)
        joints[joint] += step
        moved = reader.read(state._replace(joint_position=joints))[0]
        return np.concatenate([THRUST @ moved.axes, THRUST @ np.cross(moved.arms, moved.axes)])

    found = np.array([(wrench(joint, STEP) - wrench(joint, -STEP)) / (2.0 * STEP) for joint in reader.joints]).T
    rows = linearised.per_second[[*range(3, 6), *range(9, 12)]]
    agree("Λ", rows[:, model.JOINTS], found, 1e-6)
    assert np.abs(found).min(axis=1).max() > 1.0  # every row is seen


def test_the_engine_is_the_published_one_and_linearised(linearised, agree):
    x, y, w = (160.0 - 108.309) / 65.793, 20.0 / 65.793, (70.0 - 47.333) / 31.483
    f = -0.464730 - 8.131719 * x - 6.195392 * y + 0.661113 * x * y + 1.676732 * x * x - 0.483287 * y * y
    g = 8.779966 - 1.010964 * x - 0.586442 * y + 0.519093 * x * y - 0.423783 * x * x - 1.457053 * y * y
    acceleration = 65.793 * (f + g * (w - 0.00783052 * w * w))
    drift, gain = model.drift_and_gain(np.array([160.0]), np.array([20.0]))
    agree("acceleration", drift + gain * model.drive(np.array([70.0])), [acceleration], 1e-5)
    agree("throttle", model.throttle_of(model.drive(THROTTLE)), THROTTLE, 1e-10)
    drift, gain = model.drift_and_gain(THRUST, np.zeros(4))
    agree("steady", gain * model.steady_drive(THRUST), -drift, 1e-12)

    v = model.drive(THROTTLE)

    def acceleration_of(thrust, rate, v):
        drift, gain = model.drift_and_gain(thrust, rate)
        return drift + gain * v

    rows = linearised.per_second[model.THRUST_RATE]
    for columns, change in (
        (model.THRUST, lambda h: (THRUST + h, RATE, v)),
        (model.THRUST_RATE, lambda h: (THRUST, RATE + h, v)),
        (model.DRIVES, lambda h: (THRUST, RATE, v + h)),
    ):
        slope = (acceleration_of(*change(STEP)) - acceleration_of(*change(-STEP))) / (2.0 * STEP)
        agree("slope", np.diag(rows[:, columns]), slope, 1e-5)
        assert np.count_nonzero(rows[:, columns]) == 4
    known = np.concatenate([np.zeros(12), THRUST, RATE, np.zeros(6)])
    agree("value", rates(linearised, known, v)[model.THRUST_RATE], acceleration_of(THRUST, RATE, v), 1e-9)
    agree("thrust", rates(linearised, known, v)[model.THRUST], RATE, 0.0)


def test_thrusts_without_dynamics_are_the_steady_ones(body, agree):
    steady = model.linearise(body, THRUST, RATE, model.drive(THROTTLE), engine_dynamics=False)
    v = model.steady_drive(THRUST)

    def thrust(v):
        step = steady.at_once + 0.1 * steady.per_second
        return (step @ np.concatenate([states(body), np.zeros(8), v, [1.0]]))[model.THRUST]

    agree("thrust", thrust(v), THRUST, 1e-10)
    near = model.steady_drive(THRUST + STEP) - v
    agree("slope", (thrust(v + near) - THRUST) / STEP, np.ones(4), 1e-6)


def test_rates_of_the_angles_are_differences(agree):
    attitude, omega = np.array([0.3, -0.5, 1.2]), np.array([0.4, 0.7, -0.6])
    rotation = Rotation.from_euler("ZYX", attitude[::-1]).as_matrix()
    agree("angles", model.rpy(rotation), attitude, 1e-14)

    def turned(step):
        return model.rpy(rotation @ Rotation.from_rotvec(step * omega).as_matrix())

    difference = (turned(STEP) - turned(-STEP)) / (2.0 * STEP)
    agree("rates", model.euler_rates(attitude) @ omega, difference, 1e-9)


# --- the problem ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def asked(body):
    rng = np.random.default_rng(0)
    targets = np.tile(states(body, integrals=np.zeros(6)), (plan.KNOTS + 1, 1))
    targets[:, model.POSITION] += rng.normal(0.0, 3.0, (plan.KNOTS + 1, 3))
    targets[:, model.LINEAR] += rng.normal(0.0, 500.0, (plan.KNOTS + 1, 3))
    targets[:, model.ATTITUDE] = rng.normal(0.0, 0.2, (plan.KNOTS + 1, 3))
    return states(body), model.drive(THROTTLE), rng.normal(0.0, 0.1, 8), targets


def cost(z, asked, *, drives=plan.DRIVE):
    """The published cost, term by term, without constants."""
    _, v, off, targets = asked
    x = z[: plan.JOINTS_AT].reshape(-1, 26)[1:] - targets[1:]
    ds, dv = z[plan.JOINTS_AT : plan.DRIVES_AT].reshape(12, 8), z[plan.DRIVES_AT :].reshape(6, 4)
    weights = [
        500.0,
        500.0,
        5000.0,
        1.0,
        1.0,
        1.5,
        *[1000.0] * 3,
        *[80.0] * 3,
        *[0.0] * 8,
        25e3,
        25e3,
        50e3,
        *[1e4] * 3,
    ]
    integrals = np.zeros(26)
    integrals[20:] = 1.0
    x += integrals * targets[1:]  # integrals have no target
    total = 0.5 * np.sum(np.array(weights) * x * x) + 0.5 * 65e3 * np.sum(ds * ds)
    total += 0.5 * 20.0 * np.sum((off + ds) ** 2)
    return total + 0.5 * drives * (np.sum((dv[0] - v) ** 2) + np.sum(np.diff(dv, axis=0) ** 2))


def roll(linearised, lengths, asked, ds, dv):
    """All states under inputs, knot by knot: the last inputs of the control horizon remain."""
    state, _, _, targets = asked
    found = [state]
    for knot, length in enumerate(lengths):
        v = dv[0] if knot < 7 else dv[min(knot - 6, 5)]
        one = np.concatenate([found[-1], ds[min(knot, 11)], v, [1.0]])
        after = (linearised.at_once + length * linearised.per_second) @ one
        after[20:23] -= length * targets[knot, :3]
        after[23:] -= length * targets[knot, 6:9]
        found.append(after)
    return np.array(found)


def test_the_problem_has_the_published_size_cost_and_dynamics(linearised, asked, agree):
    planner = plan.Planner(plan.knots())
    problem = planner.problem(linearised, *asked, is_held=False)
    assert (plan.VARIABLES, problem.equations, problem.a.shape[0]) == (588, 468, 468 + 2 * 24)
    rng = np.random.default_rng(1)
    z = rng.normal(size=588)
    p = problem.p + problem.p.T
    p.setdiag(problem.p.diagonal())
    found = 0.5 * z @ (p @ z) + problem.q @ z
    agree("cost", found, cost(z, asked) - cost(np.zeros(588), asked), 1e-6)
    ds, dv = 0.01 * rng.normal(size=(12, 8)), rng.normal(size=(6, 4))
    z = np.concatenate([roll(linearised, planner.lengths, asked, ds, dv).ravel(), ds.ravel(), dv.ravel()])
    agree("dynamics", problem.a[:468] @ z, problem.b[:468], 1e-8)
    low, high = ((np.array([0.0, 100.0]) - 47.333) / 31.483).tolist()
    v = [w - 0.00783052 * w * w for w in (low, high)]
    assert np.all(problem.a[468:] @ z <= problem.b[468:]) == bool(np.all((dv > v[0]) & (dv < v[1])))
    agree("bounds", problem.b[468:], np.repeat([v[1], -v[0]], 24), 1e-7)


@pytest.mark.close_to_tolerance("the interior-point method's tolerance of 1e-6 is on residuals")
@pytest.mark.parametrize("is_held", [False, True])
def test_the_answer_is_that_of_another_solver_of_the_condensed_problem(linearised, asked, is_held, agree):
    """States are eliminated by rolling out each input; the crate's active-set method bounds what remains."""
    planner = plan.Planner(plan.knots())
    problem = planner.problem(linearised, *asked, is_held=is_held)
    answer = planner.solve(problem)
    again = planner.solve(problem)  # by an update of the solver's numbers
    agree("update", again, answer, 1e-6)

    def unroll(inputs):
        ds, dv = inputs[:96].reshape(12, 8), inputs[96:].reshape(6, 4)
        return np.concatenate([roll(linearised, planner.lengths, asked, ds, dv).ravel(), inputs])

    free = unroll(np.zeros(120))
    effect = np.array([unroll(one) - free for one in np.eye(120)]).T
    p = problem.p + problem.p.T
    p.setdiag(problem.p.diagonal())
    low, high = model.drive(np.array([0.0, 100.0]))
    lower, upper = np.full(120, -1e6), np.full(120, 1e6)
    lower[96:], upper[96:] = low, high
    if is_held:
        lower[96:100] = upper[96:100] = asked[1]
    h, g = effect.T @ (p @ effect), effect.T @ (p @ free + problem.q)
    found, status = rust.BoxQpSolver(120).solve(np.ascontiguousarray(h), g, lower, upper)
    assert status["status"] == "Solved"
    assert np.any(np.isclose(found[96:], low) | np.isclose(found[96:], high))  # bounds matter
    # The tolerance of the interior-point method is 1e-6, on residuals.
    agree("increments", answer[plan.JOINTS_AT : plan.DRIVES_AT], found[:96], 1e-3)
    agree("throttles", answer[plan.DRIVES_AT :], found[96:], 1e-3)


def test_knots_are_as_published():
    assert np.allclose(plan.knots(warped=False), [0.005] * 7 + [0.1] * 10)
    lengths = plan.knots()
    assert np.isclose(lengths[0], 0.005)
    assert np.isclose(lengths[:7].sum(), 0.1)
    assert np.allclose(np.diff(lengths[:7], 2), 0.0)


# --- flights --------------------------------------------------------------------------------------------------------


def published(settings, **changes):
    config = rust.load_config("mk3_hover", {"controller.time_step": plan.PERIOD, "simulator.duration": 0.2, **changes})
    flown = rust.Flight(config)
    pilot = flight.Published(config, settings)
    pilot.begin(flown.measurement)
    return flown, pilot


def test_torques_give_the_joints_their_acceleration_by_the_gains_of_the_configuration(robot, agree):
    _, pilot = published(flight.Settings(torque_limits=False), **{"controller.torque.kp": 7.0})
    state, kd = moving(robot), pilot.gains["kd"]
    state.velocity[6:] = 0.1
    _, dynamics, forces = pilot.reader.read(state)
    pilot.joint_reference = state.joint_position + 0.2
    torque = pilot._torque(state, dynamics, forces)
    generalised = np.concatenate([np.zeros(6), torque]) + pilot.thrust @ forces
    agree("acceleration", rust.forward_dynamics(robot, state, generalised)[6:], np.full(23, 1.4 - 0.1 * kd), 1e-9)


def test_it_follows_the_set_point_in_position_and_attitude(agree):
    """While it climbs and pitches forward, now and at the end of the last knot."""
    mission = {"simulator.duration": 2.2, "mission.up": [[0.0, 2.0]], "mission.forward_turbo": [[0.5, 2.0]]}
    flown, pilot = published(flight.Settings(), **mission)
    targets = pilot.targets(1.0, pilot.reader.read(flown.truth.state)[0])
    found = flown.run()
    at = np.round((1.0 + pilot.ahead[[0, -1]]) / plan.PERIOD).astype(int)
    agree("position", targets[[0, -1], model.POSITION], found["com_setpoint"][at], 1e-9)
    agree("attitude", targets[[0, -1], model.ATTITUDE], found["base_rpy_setpoint"][at], 1e-9)
    assert np.ptp(found["base_rpy_setpoint"][at, 1]) > 0.01


@pytest.mark.close_to_tolerance("the acceleration changes during the period")
def test_the_thrusts_of_the_plant_follow_the_engines(agree):
    flown, pilot = published(flight.Settings())
    for _ in range(3):
        flown.step(command=pilot(flown.measurement))
    before, rate, v = pilot.thrust, pilot.rate.copy(), model.drive(np.array([90.0, 50.0, 80.0, 30.0]))
    pilot.throttle = model.throttle_of(v)
    found = pilot._move_engines()
    drift, gain = model.drift_and_gain(before, rate)
    # The mean rate is the first one and 2 ms of its change: four of five steps of 1 ms, weighted.
    agree("rate", found, rate + 0.002 * (drift + gain * v), 0.05)
    agree("change of rate", pilot.rate - rate, 0.005 * (drift + gain * v), 0.2)


@pytest.mark.parametrize("accumulate", [True, False])
def test_integrals_go_on_or_start_at_the_error(accumulate, agree):
    flown, pilot = published(flight.Settings(accumulate=accumulate))
    body = pilot.reader.read(flown.truth.state)[0]
    targets = pilot.targets(0.0, body)
    targets[0, :3] -= [0.1, 0.2, 0.3]
    error = [0.1, 0.2, 0.3]
    pilot.state(body, targets)
    found = pilot.state(body, targets)[model.POSITION_INTEGRAL]
    agree("integral", found, 0.005 * np.array(error) if accumulate else error, 1e-12)


def test_throttles_change_every_tenth_of_a_second_and_models_when_they_are_linearised(monkeypatch):
    held, models = [], []
    flown, pilot = published(flight.Settings(relinearise=False))
    original = pilot.planner.problem

    def seen(now, *rest, is_held):
        held.append(is_held)
        models.append(now)
        return original(now, *rest, is_held=is_held)

    monkeypatch.setattr(pilot.planner, "problem", seen)
    for _ in range(22):
        flown.step(command=pilot(flown.measurement))
    assert held == [tick not in (0, 20) for tick in range(22)]
    assert all(one is models[0] for one in models)
    assert pilot.missing == 0


def test_it_hovers_and_is_judged():
    config = study.configure("published", study.CASES["still air"], 0, 0.3)
    pilot = flight.Published(config)
    flown = rust.Flight(config, controller=pilot).run()
    assert (flown.outcome, pilot.missing) == ("completed", 0)
    assert flown.summary["max_rotation_error"] < np.radians(1.0)
    limits = {"rotation_error_deg": 0.1, "com_error": 1.0}
    strict = {**config, "simulator": config["simulator"] | {"fall": limits}}
    lost = rust.Flight(strict, controller=flight.Published(strict)).run()
    assert (lost.outcome, lost.lost_time) == ("fell", 0.0)
    view = own.view(config, rust.Robot(config["robot"]))
    alone = rust.Flight(config, controller=flight.Published(view)).run()
    assert alone.summary == pytest.approx(flown.summary, nan_ok=True, rel=1e-12)


def test_references_of_joints_stay_within_limits_only_if_asked(robot):
    for limited in (False, True):
        flown, pilot = published(flight.Settings(joint_limits=limited))
        pilot.joint_reference = pilot.first_joints + 5.0
        pilot(flown.measurement)
        arms = pilot.joint_reference[pilot.reader.joints]
        upper = np.array(robot.joint_limits)[pilot.reader.joints, 1]
        assert np.all(arms <= upper) == limited


def test_the_table_is_made_of_what_was_flown_and_goes_on(monkeypatch, tmp_path):
    flown = []

    def fly_cell(controller, case, asked):
        flown.append((controller, case.speed))
        return [(1, "completed", 2.0, 0.5), (0, "fell", 90.0, np.nan)]

    monkeypatch.setattr(study, "fly_cell", fly_cell)
    asked = study.Compared(controllers=("published",), cases=("still air", "5 m/s"))
    work = Work.on(tmp_path / "mk3", Identity("0"))
    found = study.compute("mk3", asked, work)
    assert flown == [("published", 0.0), ("published", 5.0)]
    cell = found.summary["published | 5 m/s"]
    assert (cell["completed"], cell["flights"], cell["rotation_error_deg"], cell["com_error_m_max"]) == (1, 2, 2.0, 0.5)
    assert (round(cell["low"], 2), round(cell["high"], 2)) == (0.09, 0.91)
    assert found.dataset["com_error"].shape == (2, 2)
    study.compute("mk3", asked, work)
    assert len(flown) == 2
    study.compute("mk3", study.Compared(controllers=("published",), cases=("5 m/s",)), work)
    assert len(flown) == 2


def test_flights_differ_in_direction_and_perturbation():
    first = study.configure("published", study.CASES["10 m/s"], 0, 1.0)
    third = study.configure("published", study.CASES["10 m/s"], 2, 1.0)
    assert first["wind"]["velocity"][0] < -8.0
    assert third["wind"]["velocity"][1] < -8.0
    assert first["simulator"]["initial"] != third["simulator"]["initial"]
    assert first["controller"]["time_step"] == plan.PERIOD
    [push] = study.configure("published", study.CASES["push of 50 N m"], 2, 1.0)["disturbances"]["pushes"]
    assert push["moment"] == [0.0, -50.0, 0.0]
    ours = study.configure("predictive law", study.CASES["10 m/s"], 0, 1.0)
    assert ours["simulator"]["jets"]["dynamics"] == "throttled"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ('cases=["6 m/s"]', "`cases` has `6 m/s`; did you mean 5 m/s"),
        ("controllers=[]", "`controllers` is []; expected one value or more, each once"),
    ],
)
def test_what_it_cannot_fly_is_named(change, words, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    assert study.main(["--set", change]) == 2
    assert words in capsys.readouterr().err

"""A robot that stands: MuJoCo under it, the crate's controller in it."""

import daqp
import mujoco
import numpy as np
import pytest
import xarray as xr

from experiments.report.measures.standing import standing as measure
from jax_aero import backends, rust
from jax_aero.base import places
from jax_aero.base.files import write_netcdf
from jax_aero.body.mujoco_model import mujoco_model
from jax_aero.commands.figures import main as draw
from jax_aero.mujoco import ground
from jax_aero.mujoco.ground import GroundPlant, begin, fly
from jax_aero.results import record
from jax_aero.rust import MODES

STILL = {"profile": "constant", "velocity": [0.0, 0.0, 0.0]}
DRY = {"simulator.motors.friction_of": {}, "simulator.motors.load_friction": {}}
"""Dry friction that is the same in all joints."""
FREE_JOINTS = DRY | {
    "simulator.motors.friction": 0.0,
    "simulator.motors.damping": 0.0,
    "simulator.motors.inertia": 0.0,
    "controller.torque.rotor_inertia": 0.0,
    "simulator.substeps": 10,
}
COARSE = {"simulator.substeps": 5}
"""Larger physics steps, for speed; joints without friction or inertia need the finer ones."""

FUEL = {"mass": 1.0, "body": "chest", "position": [0.0, 0.0, 0.0], "idle": 1e-3, "by_thrust": 4e-5}
STUCK = {"joint": "l_knee", "kind": "stuck", "start": 1.0}


def standing(**changes):
    return rust.load_config("balancing_front", COARSE | changes)


def test_torques_are_bounded_by_the_robot_as_the_crate_reads_it(tmp_path):
    """Not by the URDF's effort, where -1 is none: MuJoCo would bound the torque by 1 N m."""
    folder = places.CONFIGS / "robot"
    urdf, toml = ((folder / f"sparrow.{kind}").read_text() for kind in ("urdf", "toml"))
    limit = 'effort="40"'
    assert limit in urdf
    (tmp_path / "sparrow.urdf").write_text(urdf.replace(limit, 'effort="-1"'))
    path = tmp_path / "sparrow.toml"
    path.write_text(toml.replace('{ name = "', '{ torque_max = 30.0, name = "'))
    model = mujoco_model(str(path))
    data = mujoco.MjData(model)
    data.ctrl[:] = 25.0
    mujoco.mj_forward(model, data)
    np.testing.assert_array_equal(data.qfrc_actuator[6:], 25.0)


def early_wind(velocity, measured=True, duration=9.0, **changes):
    """The ground experiment with its wind between 1 and 4 s."""
    wind = {"profile": "ramp", "velocity": velocity, "ramp_start": 1.0, "ramp_end": 4.0}
    return standing(
        **{"simulator.duration": duration, ("disturbances.controller_wind" if measured else "wind"): wind} | changes
    )


@pytest.fixture(scope="module")
def frontal():
    return fly(early_wind([-12.0, 0.0, 0.0]))


@pytest.mark.close_to_tolerance("the robot still moves: mass times an acceleration of 1 mm/s²")
def test_the_feet_carry_the_robot(measured):
    plant = GroundPlant(standing())
    seen = plant.observe()
    total = seen.foot_wrenches[:, :3].sum(axis=0)
    measured("contact force", np.max(np.abs(np.subtract(total, [0.0, 0.0, plant.robot.mass * 9.81]))), 0.05)
    # Moments about the inertial origin: the weight acts at the centre of mass.
    soles = np.cross(seen.soles, seen.foot_wrenches[:, :3]) + seen.foot_wrenches[:, 3:]
    com = rust.dynamics(plant.robot, seen.state).com_position
    measured("moment of the soles", np.max(np.abs(np.subtract(soles.sum(axis=0), np.cross(com, total)))), 0.05)
    assert np.abs(seen.soles[:, 2]).max() < 1e-3


def test_state_and_dynamics_are_those_of_the_crate(monkeypatch):
    """The same torques and forces accelerate MuJoCo's robot, its feet off the ground, as they do ours."""
    monkeypatch.setattr(ground, "SETTLING", 0.0)
    in_the_air = {"simulator.initial.base_position": [0.0, 0.0, 1.5]}
    config = rust.load_config("take_off", in_the_air | FREE_JOINTS)
    plant = GroundPlant(config)
    rng = np.random.default_rng(1)
    plant.data.qvel[:] = rng.uniform(-0.5, 0.5, plant.model.nv)
    before = plant.observe()
    torque, force = rng.uniform(-5.0, 5.0, 23), rng.uniform(-50.0, 50.0, 29)
    steps = plant.model.opt.timestep
    ours = rust.forward_dynamics(plant.robot, before.state, force + np.append(np.zeros(6), torque))
    plant.advance(torque[None], force)
    after = plant.observe()
    assert not after.foot_wrenches.any()
    np.testing.assert_allclose(after.joint_torque, torque, rtol=1e-12)
    theirs = (np.asarray(after.state.velocity) - before.state.velocity) / steps
    # MuJoCo adds to the angular velocity in body axes, which turn in the step.
    turn = np.asarray(after.state.base_rotation) @ np.asarray(before.state.base_rotation).T
    theirs[3:6] = (turn.T @ np.asarray(after.state.velocity)[3:6] - before.state.velocity[3:6]) / steps
    omega = np.asarray(before.state.velocity)[3:6]
    assert np.linalg.norm(omega) > 0.1
    np.testing.assert_allclose(theirs, ours, rtol=1e-6, atol=1e-6 * np.abs(ours).max())


@pytest.mark.parametrize(
    ("ground_is", "normal"),
    [
        ({"slope_deg": [3.0, 0.0]}, [0.0, -np.sin(np.radians(3.0)), np.cos(np.radians(3.0))]),
        ({"slope_deg": [0.0, 2.0]}, [np.sin(np.radians(2.0)), 0.0, np.cos(np.radians(2.0))]),
        ({"step": {"start": 1.0, "height": 0.05}}, [0.0, 0.0, 1.0]),
        ({"step": {"start": 1.0, "height": -0.05}}, [0.0, 0.0, 1.0]),
    ],
)
def test_a_ground_with_a_slope_or_a_step_carries_the_robot(ground_is, normal):
    """Its soles are on it, as far as contacts are soft, and what they carry is the weight, upwards."""
    plant = GroundPlant(standing(**{f"simulator.ground.{key}": value for key, value in ground_is.items()}))
    seen = plant.observe()
    np.testing.assert_allclose(seen.soles @ normal, 0.0, atol=1e-3)
    weight = sum(plant.model.body_mass) * 9.81
    np.testing.assert_allclose(seen.foot_wrenches[:, :3].sum(axis=0), [0.0, 0.0, weight], atol=0.02 * weight)


def test_a_step_has_its_height_beyond_its_edge():
    for height in (0.05, -0.05):
        model = GroundPlant(standing(**{"simulator.ground.step": {"start": 1.0, "height": height}})).model
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        for x, expected in ((0.9, 0.0), (1.1, height)):
            down = mujoco.mj_ray(model, data, [x, 0.5, 5.0], [0.0, 0.0, -1.0], None, 1, -1, np.zeros(1, np.int32))
            assert 5.0 - down == pytest.approx(expected, abs=1e-9), (height, x)


def test_dry_friction_grows_with_the_torque_that_reaches_a_joint():
    """As the drives of the crate (M153): an ankle that carries the robot is held by more than one without load."""
    plant = GroundPlant(standing())
    load = np.abs(plant.observe().joint_torque)
    assert load[(ankle := plant.robot.joint_names.index("l_ankle_pitch"))] > 1.0
    motors = standing()["simulator"]["motors"]
    plant.advance(np.zeros((1, 23)), np.zeros(29))
    found = plant.model.dof_frictionloss[plant._order.dofs[6:]]
    assert (
        found[ankle] == motors["friction_of"]["l_ankle_pitch"] + motors["load_friction"]["l_ankle_pitch"] * load[ankle]
    )
    assert found[plant.robot.joint_names.index("torso_pitch")] == motors["friction"]


def test_drives_follow_their_torques_with_a_lag():
    plant = GroundPlant(standing(**{"simulator.motors.time_constant": 0.01}))
    before = plant.data.ctrl.copy()
    plant.advance(np.tile(before + 1.0, (3, 1)), np.zeros(29))
    followed = 1.0 - np.exp(-3.0 * plant.model.opt.timestep / 0.01)
    np.testing.assert_allclose(plant.data.ctrl - before, followed, rtol=1e-12)


def odometry(time_constant):
    return standing(**{"simulator.ground.leg_odometry": {"velocity_time_constant": time_constant}})


def test_legs_measure_the_base_over_soles_that_stay(measured):
    plant = GroundPlant(odometry(0.0))
    first = plant.observe()
    soles = plant.data.site_xmat[plant._soles[0]].copy(), plant.data.site_xpos[plant._soles[0]].copy()
    rng = np.random.default_rng(4)
    joints = first.state.joint_position + rng.uniform(-0.2, 0.2, 23)
    posed = plant._odometry.measure(first.state._replace(joint_position=joints))
    plant.data.qpos[:3] = posed.base_position
    mujoco.mju_mat2Quat(plant.data.qpos[3:7], posed.base_rotation.ravel())
    plant.data.qpos[plant._order.joints] = joints
    mujoco.mj_forward(plant.model, plant.data)
    found = plant.data.site_xmat[plant._soles[0]], plant.data.site_xpos[plant._soles[0]]
    for name, left, right in zip(("rotation", "position"), soles, found, strict=True):
        measured(f"{name} of the first sole", np.abs(left - right).max(), 1e-12)
    # Joint velocities under a moving base over soles at rest, by the crate's Jacobians.
    jacobian = np.vstack(
        [part for foot in ("l_sole", "r_sole") for part in rust.frame_jacobian(plant.robot, foot, posed)]
    )
    base = rng.normal(size=6)
    rates = np.linalg.lstsq(jacobian[:, 6:], -jacobian[:, :6] @ base, rcond=None)[0]
    moved = plant._odometry.measure(posed._replace(velocity=np.concatenate([np.zeros(6), rates])))
    measured("velocity of the base", np.abs(moved.velocity[:6] - base).max(), 1e-5, because="1e-7 of damping over 0.1")
    np.testing.assert_allclose(moved.velocity[6:], rates)


def test_joint_velocities_pass_a_first_order_low_pass():
    plant = GroundPlant(odometry(0.05))
    state = plant.observe().measured
    step = state._replace(velocity=np.append(np.zeros(6), np.ones(23)))
    found = [plant._odometry.measure(step).velocity[6:] for _ in range(3)]
    start = state.velocity[6:]
    expected = [1.0 + (start - 1.0) * np.exp(-0.2 * k) for k in (1, 2, 3)]
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.slow
def test_a_robot_with_free_joints_stands_still_for_a_minute():
    """No friction holds it: within 1 mm once the start of f_c*, which has no moment about x, has settled.

    Its state is measured as it is: legs that measure a foot which tilts let it creep by 5 mm.
    """
    still = {"simulator.duration": 60.0, "disturbances.controller_wind": STILL}
    log = fly(rust.load_config("balancing_front_dry", COARSE | still | FREE_JOINTS)).log
    com = log["com_position"][log["time"] >= 5.0]
    assert np.ptp(com, axis=0).max() < 1e-3
    assert np.linalg.norm(log["com_position"][-1] - log["com_setpoint"][-1]) < 1e-3
    assert np.linalg.norm(log["sole_position"][-1] - log["sole_position"][0], axis=1).max() < 1e-4
    assert not log["qp_status"].any()
    assert log["feet_carry"].all()


@pytest.mark.close_to_tolerance("the tolerances are what the flight is meant to keep")
def test_the_robot_takes_off_and_lands(measured, tmp_path):
    """From standing to standing in 5 m/s of wind."""
    times = {"mission.up": [(0.5, 1.5)], "mission.down": [(6.0, 12.0)], "simulator.duration": 11.0}
    config = rust.load_config("take_off", times)
    result = fly(config)
    log, summary = result.log, result.summary
    assert result.outcome == "completed"
    assert not log["degraded_modes"].any()  # the impact included
    carried = log["feet_carry"] == 1.0
    assert carried[:50].all()
    assert carried[-200:].all()
    assert 1.0 < summary["time_off_the_ground"] < 6.0
    assert log["sole_position"][~carried, :, 2].max() > 0.05
    measured("touchdown speed [m/s]", summary["touchdown_speed"], 0.3)
    measured("rotation error [deg]", np.degrees(summary["max_rotation_error"]), 10.0)
    assert log["thrust"][-1].sum() < 0.5 * log["thrust"][~carried].sum(axis=1).max()
    assert summary["ticks_without_solution"] == 0
    dataset = record.to_dataset(result, rust.Robot(config["robot"]), title="t", config_digest="d")
    record.write_run(tmp_path / "flight" / "take_off", dataset, {"name": "take_off", "config_digest": "d"})
    out = tmp_path / "out"
    assert draw(["take_off", "--stale", "--results", str(tmp_path), "--out", str(out)]) == 0
    assert (out / "take_off.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.close_to_tolerance("the tolerances are what the flight is meant to keep")
def test_another_robot_takes_off_and_lands(measured):
    """IRonCub-Mk3, whose feet are shorter and narrower for its weight, up and down as far."""
    times = {"mission.up": [(0.5, 2.5)], "mission.down": [(4.5, 10.0)], "simulator.duration": 9.5}
    result = fly(rust.load_config("mk3_take_off", COARSE | times))
    log, summary = result.log, result.summary
    assert result.outcome == "completed"
    assert not log["degraded_modes"].any()
    carried = log["feet_carry"] == 1.0
    assert carried[:50].all()
    assert carried[-150:].all()
    assert log["sole_position"][~carried, :, 2].max() > 0.3
    measured("touchdown speed [m/s]", summary["touchdown_speed"], 0.3)
    measured("rotation error [deg]", np.degrees(summary["max_rotation_error"]), 10.0)
    assert summary["ticks_without_solution"] == 0
    assert 11.0 <= log["thrust"].min() < 11.01


def take_off(change, **changes):
    """Fly from the ground with a change of what the controller is given."""
    flight = begin(rust.load_config("take_off", changes))
    while not flight.has_ended:
        flight.step(measurement=change(flight.measurement))
    return flight.result()


@pytest.mark.parametrize("back", [1.2, 99.0])
def test_feet_that_are_not_measured_stand_take_off_and_land(back):
    """Held as they were last measured, they keep their load: the robot fell on leaving the ground. It fell after it had
    touched the ground, too, where that was not found from its momentum.
    """

    def lose_feet(seen):
        is_lost = 0.3 <= seen.time < back
        return seen._replace(foot_wrenches=np.full_like(seen.foot_wrenches, np.nan)) if is_lost else seen

    result = take_off(lose_feet, **{"simulator.duration": 15.0})
    assert result.outcome == "completed"
    assert np.degrees(result.summary["max_rotation_error"]) < 10.0
    log = result.log
    assert ((log["degraded_modes"] == 128.0) == ((log["time"] >= 0.3) & (log["time"] < back))).all()
    assert log["com_position"][:, 2].max() > 0.6
    assert log["com_position"][-1, 2] > 0.56
    assert (log["feet_carry"][-200:] == 1.0).all()


@pytest.mark.parametrize(("wrong", "start", "found"), [("zero", 0.5, 0.62), ("zero", 6.0, 12.2), ("frozen", 1.0, 2.9)])
def test_foot_sensors_that_the_momentum_contradicts_are_not_believed(wrong, start, found):
    """They were: the robot fell at 1.8, 14.7 and 6.4 s."""
    last = []

    def mislead(seen):
        if seen.time < start:
            last[:] = [seen.foot_wrenches]
        return seen if seen.time < start else seen._replace(foot_wrenches=last[0] * (wrong == "frozen"))

    result = take_off(mislead, **{"simulator.duration": 15.0, "wind.velocity": [0.0, 0.0, 0.0]})
    assert result.outcome == "completed"
    log = result.log
    is_found = log["degraded_modes"].astype(int) & MODES["feet_predicted"] > 0
    assert log["time"][is_found][0] == pytest.approx(found, abs=0.15)
    assert is_found[log["time"] > found + 0.2].all()
    assert log["com_position"][:, 2].max() > 0.6
    assert (log["feet_carry"][-200:] == 1.0).all()


@pytest.mark.parametrize("jet", ["l_arm_jet", "chest_l_jet"])
def test_an_engine_that_stops_before_the_robot_leaves_the_ground_ends_the_take_off(jet):
    """It went on relieving its feet, and sank where it stood; it fell in either case."""
    stops = {"jet": jet, "time": 2.64, "kind": "off", "decay": 0.0}
    changes = {"simulator.duration": 9.0, "disturbances.jets.failure": stops}
    result = fly(rust.load_config("take_off", changes))
    assert result.outcome == "landed"
    log = result.log
    assert (log["feet_carry"] == 1.0).all()
    assert log["thrust"][265].sum() > 50.0
    assert log["thrust"][-1].sum() < 50.0
    assert np.degrees(log["rotation_error"].max()) < 5.0


@pytest.mark.parametrize(
    ("lost", "start", "duration"),
    [("base_position", 6.0, 16.0), ("base_rotation", 6.0, 16.0), ("base_velocity", 12.1, 18.5)],
)
def test_a_robot_that_loses_a_measurement_of_its_base_lands_and_stands(lost, start, duration):
    """Lost in the air, or, the velocity, just after the feet touched the ground."""
    outage = {"channel": lost, "start": start, "kind": "missing"}
    changes = {"simulator.duration": duration, "disturbances.outages": [outage]}
    result = fly(rust.load_config("take_off", changes))
    assert result.outcome == "landed"
    assert (result.log["feet_carry"][-200:] == 1.0).all()
    assert (result.log["degraded_modes"][-200:].astype(int) & MODES["descending"]).all()


def test_what_the_controller_is_given_is_recorded():
    """Its estimators stand between what is measured and the law."""
    estimator = {"base_position": {"time_constant": 0.5}}
    observing = {"controller.wind_observer": True, "controller.estimator": estimator}
    config = early_wind([-12.0, 0.0, 0.0], measured=False, duration=2.0, **observing)
    log = fly(config).log
    assert (log["measured_wind_std"][:, :2] > 0.0).all()
    assert np.abs(log["measured_wind"] - log["wind"]).max() > 0.1
    differences = log["measured_base_position"] - log["base_position"]
    assert 1e-6 < np.abs(differences).max() < 0.1
    np.testing.assert_array_equal(log["measured_thrust"], log["thrust"])
    replayed = rust.replay(config, log)
    for signal in ("thrust_rate", "joint_torque", "unmodelled_wrench", "measured_wind"):
        np.testing.assert_array_equal(replayed[signal], log[signal])


@pytest.mark.close_to_tolerance("the robot still moves: mass times an acceleration of 2 mm/s²")
def test_the_sums_are_right_at_every_tick(frontal, measured):
    log = frontal.log
    weight = rust.Robot(standing()["robot"]).mass * 9.81
    expected = log["contact_force"][:, :, :3].sum(axis=1) + log["aero_force_control"].sum(axis=1) - [0.0, 0.0, weight]
    np.testing.assert_allclose(log["momentum_rate_estimate"][:, :3], expected, atol=1e-9)
    calm = log["contact_force"][90]  # later, friction holds an error of the height
    measured("weight carried", abs(calm[:, 2].sum() - weight), 0.1)


def test_in_frontal_wind_it_leans_forward_by_its_ankles(frontal):
    assert frontal.outcome == "completed"
    log, names = frontal.log, rust.Robot(standing()["robot"]).joint_names
    moved = log["com_position"][-1] - log["com_position"][90]
    assert moved[0] > 0.01 > 5 * abs(moved[1])
    assert log["aero_force_control"].sum(axis=1)[-1, 0] < -15.0
    assert np.abs(log["aero_force_sim"].sum(axis=1)[-1]).max() < 0.01, "no wind blows"
    turned = np.abs(log["joint_position"][-1] - log["joint_position"][90])
    assert {names[index] for index in np.argsort(-turned)[:2]} == {"l_ankle_pitch", "r_ankle_pitch"}
    rate = np.abs(log["momentum_rate_estimate"][:, 0])
    assert rate[-1] < min(0.95 * rate.max(), 0.5 * 18.9)  # friction holds the rest
    assert not log["qp_status"].any()


def test_a_controller_with_the_measured_wind_withstands_more():
    gale = {"wind": {"profile": "ramp", "velocity": [-17.0, 0.0, 0.0], "ramp_start": 1.0, "ramp_end": 4.0}}
    # Held by dry friction alone, as in the study of the winds that tip the robot over.
    dry = gale | DRY | {"simulator.motors.friction": 3.5, "simulator.duration": 8.0}
    measured = fly(standing(**{"disturbances.controller_wind": gale["wind"]} | dry))
    ignores = fly(standing(**{"disturbances.controller_wind": STILL} | dry))
    assert measured.outcome == "completed"
    assert measured.summary["max_com_error"] < 0.01
    assert ignores.outcome == "fell"
    assert ignores.lost_reason.startswith(("CoM error", "rotation error"))


def test_the_standing_qp_agrees_with_daqp(agree):
    """Problems harvested from a robot that leans, tips and slips."""
    config = early_wind([-20.0, 14.0, 0.0], duration=6.0, **FREE_JOINTS)
    flight = begin(config)
    checked = pressing = 0
    while not flight.has_ended:
        flight.step()
        if flight.tick % 3:
            continue
        tick = flight.last
        qp = tick.torque_qp
        if np.abs(tick.com_position - tick.setpoint.com_position).max() > 0.3:
            break
        if not tick.contact.is_active:
            continue
        assert tick.torque_answer.status == "Solved"
        x = np.concatenate([tick.contact.force_of_torques.ravel(), tick.unlimited_torque])
        # DAQP takes bounds of the variables first, then those of the rows.
        upper = np.clip(np.concatenate([qp.upper, qp.limit]), None, 1e30)
        lower = np.clip(np.concatenate([qp.lower, np.full(qp.limit.size, -1e30)]), -1e30, None)
        kinds = np.zeros(upper.size, dtype=np.int32)
        theirs, _, flag, _ = daqp.solve(qp.h, qp.g, qp.rows, upper, lower, kinds, primal_tol=1e-10)
        assert flag == 1
        value = [0.5 * z @ qp.h @ z + qp.g @ z for z in (x, theirs)]
        agree("objective", value[0], value[1], 1e-9)
        np.testing.assert_allclose(x, theirs, atol=1e-5 * np.abs(x).max())
        assert (qp.rows @ x <= qp.limit + 1e-7).all()
        checked += 1
        pressing += int((qp.rows @ x > qp.limit - 1e-6).any())
    assert checked >= 20
    assert pressing >= 3


def test_a_run_is_recorded_and_measured(frontal, tmp_path):
    robot = rust.Robot(standing()["robot"])
    dataset = record.to_dataset(frontal, robot, title="t", config_digest="d", backend="mujoco")
    assert dataset["foot_wrench"].dims == ("time", "foot", "six")
    assert dataset["foot"].values.tolist() == ["l_sole", "r_sole"]
    path = tmp_path / "run.nc"
    write_netcdf(path, dataset)
    run = xr.load_dataset(path, engine="h5netcdf")
    found = measure(run, 1.0, robot.mass, 0)
    assert found["unbalanced"] < 0.25
    wrong = run.assign(foot_wrench=1.01 * run["foot_wrench"])
    assert measure(wrong, 1.0, robot.mass, 0)["unbalanced"] > 1.0
    assert measure(run.assign(com_velocity=-run["com_velocity"]), 1.0, robot.mass, 0)["unbalanced"] > 0.25
    assert found["shift_mm"] > 10.0
    assert found["first"] == "ankle pitch"
    assert 0.0 < found["onset"] < 8.0
    assert found["is_carried"]


@pytest.mark.slow
def test_the_ground_figure_is_drawn_from_its_runs(frontal, tmp_path):
    robot = rust.Robot(standing()["robot"])
    for name in ("balancing_front_as_flown", "balancing_lateral_as_flown"):
        dataset = record.to_dataset(frontal, robot, title=name, config_digest="d")
        record.write_run(tmp_path / "flight" / name, dataset, {"name": name, "config_digest": "d"})
    out = tmp_path / "out"
    assert draw(["fig6", "--stale", "--results", str(tmp_path), "--out", str(out)]) == 0
    assert (out / "fig6.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"controller.contact.wrench.friction": -1.0}, "wrench.friction` is -1"),
        ({"controller.contact.load_transfer": {"gain": 1.0}}, r"controller\.use_jets"),
        ({"simulator.integrator": "explicit_euler"}, r'integrator is "explicit_euler"; expected "semi_implicit_euler"'),
        ({"simulator.kinematics": "frozen"}, 'kinematics is "frozen"; expected "current"'),
        ({"simulator.initial.base_velocity": [3.0, 0, 0, 0, 0, 0]}, r"base_velocity is \[3.0,0.0,0.0,0.0,0.0,0.0\]"),
        ({"simulator.initial.free_fall_tick": True}, "free_fall_tick is true; expected false"),
        ({"simulator.fuel": FUEL}, r"simulator\.fuel is .*; expected none"),
        (
            {"simulator.motors.elasticity": {"stiffness": 1e3, "damping": 1.0}},
            r"motors\.elasticity is .*; expected none",
        ),
        ({"simulator.ground.slope_deg": [0.0, 21.0]}, r"slope_deg\[1\]` is 21"),
        ({"simulator.ground.step": {"start": 3.0, "height": 0.6}}, r"step\.height` is 0\.6"),
        ({"simulator.ground.step": {"start": 0.0, "height": 0.1}}, r"step\.start` is 0"),
        ({"simulator.sensors": {"seed": 1}}, r"simulator\.sensors is .*; expected none"),
        ({"controller.torque.steps": 2}, r"controller\.torque\.steps is 2; expected 1"),
        ({"disturbances.joints": [STUCK]}, r"disturbances\.joints\[0\]\.kind is stuck; expected weak or free"),
    ],
)
def test_bad_ground_is_refused(changes, named):
    with pytest.raises(ValueError, match=named):
        standing(**changes)


def test_a_pose_far_below_the_ground_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings to a file in the current folder
    monkeypatch.setattr(ground, "SETTLING", 0.2)
    buried = {"simulator.initial.base_position": [0.0, 0.0, -1e6], "simulator.substeps": 1}
    with pytest.warns(UserWarning, match=r"`l_sole` at a height of -1000000"):
        config = standing(**buried)
    with pytest.raises(ValueError, match=r"`simulator\.initial` puts the robot where it cannot come to rest"):
        fly(config)


def test_engines_refuse_what_they_do_not_know():
    flying = rust.load_config("test2")
    with pytest.raises(ValueError, match=r"simulator.ground.* is absent"):
        backends.backend("mujoco").fly(flying)
    with pytest.raises(ValueError, match=r"simulator\.ground"):
        rust.fly(standing())
    with pytest.raises(ValueError, match=r"disturbances\.joints"):
        fly(standing() | {"disturbances": {"joints": [STUCK]}})


def test_jax_refuses_feet_by_name():
    from jax_aero import sim

    config = standing(backend="mujoco")
    for section, key in [("simulator", "ground"), ("controller", "contact"), ("controller", "use_jets")]:
        with pytest.raises(ValueError, match=rf"{section}\.{key}`? is "):
            sim.fly(config)
        del config[section][key]

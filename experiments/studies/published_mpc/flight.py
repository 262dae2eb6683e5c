"""Flights of the published controller over the crate's plant.

Throttles move engines of the published polynomials, in steps of 1 ms; the plant's thrusts follow them by their rates.
The plant's joints have torques: those that give them the accelerations k_p (s_d − s) − k_d ṡ in still air, within the
drives' greatest, with the gains of the configuration's `controller.torque`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from experiments.studies.published_mpc import model, plan
from experiments.studies.published_mpc.model import Array, Body
from jax_aero import rust

ENGINE_STEP = 1e-3
"""Step of the engines, explicit Euler [s]."""


class Settings(NamedTuple):
    """What the published controller does; the published values are the defaults."""

    engine_dynamics: bool = True
    """Whether its model has the engines' dynamics, or thrusts at once."""
    relinearise: bool = True
    """Whether it linearises at every tick, or once at the start."""
    accumulate: bool = True
    """Whether integrals go on from tick to tick, or start at the present errors, as in the public code."""
    warped: bool = True
    """Whether the small knots grow (`plan.knots`)."""
    torque_limits: bool = True
    """Whether the drives' greatest torques act."""
    joint_limits: bool = False
    """Whether the joints' references stay within the joints' limits."""


class Published:
    """The published controller of a configuration, whose own is not used, with its engines and joints.

    It flies wind-humanoid-1 too (configs/sweeps/wind_humanoid_1_mk3.toml). Its period is `plan.PERIOD`.
    """

    def __init__(self, config: rust.Config, settings: Settings | None = None) -> None:
        self.config, self.settings, self.has_begun = config, settings or Settings(), False
        self.robot, self.gains = rust.Robot(config["robot"]), config["controller"]["torque"]
        arrays = self.robot.arrays()
        self.torque_max = arrays["joint_torque_max"] if self.settings.torque_limits else np.inf
        self.joint_limits = np.array(self.robot.joint_limits).T
        self.thrust_range = arrays["jets"]["thrust_min"], arrays["jets"]["thrust_max"]
        self.reader = model.Reader(self.robot)
        self.planner = plan.Planner(plan.knots(warped=self.settings.warped))
        self.ahead = np.concatenate([[0.0], np.cumsum(self.planner.lengths)])
        self.first_model: model.Model | None = None
        self.ticks = self.missing = 0

    def begin(self, start: rust.Measurement) -> None:
        """Begin with the first measurement."""
        self.has_begun = True
        body, _, _ = self.reader.read(start.state)
        simulator = self.config["simulator"]
        longer = simulator | {"duration": simulator["duration"] + 2.0}
        controller = self.config["controller"] | {"time_step": plan.PERIOD}
        planned = {**self.config, "simulator": longer, "controller": controller}
        reference = rust.setpoint_trajectory(planned, body.com, body.rotation)
        self.positions, self.velocities = reference["com_position"], reference["com_velocity"]
        self.attitudes = np.array([model.rpy(one) for one in reference["rotation"]])
        self.first_joints = np.array(start.state.joint_position)
        self.joint_reference = self.first_joints.copy()
        self.thrust, self.rate = np.array(start.thrust), np.zeros(model.JETS)
        self.throttle = model.throttle_of(
            np.clip(model.steady_drive(self.thrust), *model.drive(np.array([0.0, 100.0])))
        )
        self.integrals = np.zeros(6)
        self.attitude = body.attitude

    def targets(self, now: float, body: Body) -> Array:
        """Return the states to follow at the present and at the ends of the knots, (18, 26)."""
        at = np.minimum(np.round((now + self.ahead) / plan.PERIOD).astype(int), len(self.positions) - 1)
        targets = np.zeros((len(at), model.STATES))
        targets[:, model.POSITION] = self.positions[at]
        targets[:, model.LINEAR] = body.mass * self.velocities[at] @ body.rotation
        targets[:, model.ATTITUDE] = self.attitudes[at]
        return targets

    def state(self, body: Body, targets: Array) -> Array:
        """Return the 26 states of a tick, angles without jumps."""
        turns = 2.0 * np.pi * np.round((body.attitude - self.attitude) / (2.0 * np.pi))
        self.attitude = body.attitude - turns
        errors = np.concatenate([body.com - targets[0, model.POSITION], self.attitude - targets[0, model.ATTITUDE]])
        integrals = self.integrals if self.settings.accumulate else errors
        state = np.concatenate([body.com, body.linear, self.attitude, body.angular, self.thrust, self.rate, integrals])
        self.integrals = self.integrals + plan.PERIOD * errors
        return state

    def __call__(self, measured: rust.Measurement) -> rust.Command:
        """Compute one tick: plan, move the engines by one period, and drive the joints to their references."""
        if not self.has_begun:
            self.begin(measured)
        self.thrust = np.array(measured.thrust)
        body, dynamics, forces = self.reader.read(measured.state)
        targets = self.targets(measured.time, body)
        state = self.state(body, targets)
        v = model.drive(self.throttle)
        now = self.first_model
        if now is None or self.settings.relinearise:
            now = model.linearise(body, self.thrust, self.rate, v, engine_dynamics=self.settings.engine_dynamics)
            self.first_model = self.first_model or now
        off = (self.joint_reference - self.first_joints)[self.reader.joints]
        is_held = self.ticks % round(plan.LARGE / plan.PERIOD) != 0
        problem = self.planner.problem(now, state, v, off, targets, is_held=is_held)
        answer = self.planner.solve(problem)
        if answer is None:
            self.missing += 1
        else:
            self.joint_reference[self.reader.joints] += answer[plan.JOINTS_AT : plan.JOINTS_AT + plan.ARMS]
            if self.settings.joint_limits:
                self.joint_reference = np.clip(self.joint_reference, *self.joint_limits)
            first = answer[plan.DRIVES_AT : plan.DRIVES_AT + model.JETS]
            self.throttle = np.clip(model.throttle_of(first), 0.0, 100.0)
        self.ticks += 1
        rate = self._move_engines()
        return rust.Command(rate, self._torque(measured.state, dynamics, forces))

    def _move_engines(self) -> Array:
        thrust, v = self.thrust, model.drive(self.throttle)
        for _ in range(round(plan.PERIOD / ENGINE_STEP)):
            drift, gain = model.drift_and_gain(thrust, self.rate)
            thrust = np.clip(thrust + ENGINE_STEP * self.rate, *self.thrust_range)
            self.rate = self.rate + ENGINE_STEP * (drift + gain * v)
        rate: Array = (thrust - self.thrust) / plan.PERIOD
        return rate

    def _torque(self, state: rust.State, dynamics: rust.Dynamics, forces: Array) -> Array:
        position, velocity = np.asarray(state.joint_position), np.asarray(state.velocity)[6:]
        wanted = self.gains["kp"] * (self.joint_reference - position) - self.gains["kd"] * velocity
        return np.clip(torques(dynamics, self.thrust @ forces, wanted), -self.torque_max, self.torque_max)


def torques(dynamics: rust.Dynamics, force: Array, acceleration: Array) -> Array:
    """Return the joint torques that give the joints of a flying robot this acceleration under a generalised force."""
    mass, load = dynamics.mass_matrix, dynamics.bias - force
    base = np.linalg.solve(mass[:6, :6], -load[:6] - mass[:6, 6:] @ acceleration)
    torque: Array = mass[6:, :6] @ base + mass[6:, 6:] @ acceleration + load[6:]
    return torque

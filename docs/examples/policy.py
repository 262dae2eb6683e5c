"""Weights trained elsewhere, here random ones of a layer of 16 units, as a policy that the crate flies."""

import tempfile
from pathlib import Path

import numpy as np

import jax_aero
from jax_aero.body.robot import load_robot
from jax_aero.control.law.policy_card import save_policy
from jax_aero.control.law.residual import Layer, Policy, PolicyResidual

config = jax_aero.load("test1_observer", {"mission": {}, "simulator.duration": 2.0})
robot = load_robot(config["robot"])
jets, draw = robot.jets.count, np.random.default_rng(0).normal
actions = jets + robot.n_joints

# tanh(output tanh(hidden x) + direct x), each layer with its bias; actions of 1 are 20 N/s and 0.1 rad/s
hidden = Layer(draw(0.0, 0.1, (16, 9)), draw(0.0, 0.1, 16))
output = Layer(draw(0.0, 0.1, (actions, 16)), draw(0.0, 0.1, actions))
policy = Policy((hidden,), output, direct=np.zeros((actions, 9)))
seen, scale = ("gravity", "position", "velocity"), np.array([1.0, 5.0, 1.0])  # names of M170, factors
residual = PolicyResidual(policy=policy, features=seen, scale=scale, thrust_rate=20.0, joint_velocity=0.1, jets=jets)
with tempfile.TemporaryDirectory() as folder:
    card = Path(folder, "mine.json")
    save_policy(card, residual, robot, description="An example.", training={})
    flight = jax_aero.fly({**config, "controller": config["controller"] | {"policy": {"card": str(card)}}})
print(f"{flight.outcome}, rotation error at most {np.degrees(flight['rotation_error'].max()):.0f}°")

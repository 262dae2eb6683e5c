"""A training of one's own: network, observation, reward and curriculum; three steps, of the some 250 that it takes."""

import tempfile
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp

from jax_aero.env import FlightEnv, Task
from jax_aero.train.policy import Settings, trainer

network = SimpleNamespace(  # or the functions of Equinox or Flax: parameters are any pytree of arrays
    init=lambda key: {"gain": 0.01 * jax.random.normal(key, (27, 12)), "bias": jnp.zeros(27)},
    apply=lambda parameters, obs: jnp.tanh(parameters["gain"] @ obs + parameters["bias"]),
)


def reward(xp, state, action):
    """Return the parts of a tick's reward; `xp` is `numpy` or `jax.numpy`."""
    return {"position": -xp.sum((state.com - state.aim.com) ** 2, axis=-1), "effort": -0.01 * xp.mean(action**2)}


seen = ("rotation", "position", "velocity", "angular_velocity")  # or a function of xp and the state
env = FlightEnv(Task(steering="rates", thrust_rate=200.0), observation=seen, reward=reward)
training = trainer(env, Settings(steps=3, batch=2, ticks=4), network, lambda env, step: env.at(wind_max=0.1 * step))
with tempfile.TemporaryDirectory() as folder:  # a stopped training resumes from its checkpoint
    found = training.train(0, checkpoint=Path(folder, "mine.part"), on_step=lambda step, *_: print("step", step))
again = training.train(1, start=found.parameters)  # a warm start
print(f"rewards {[round(row.reward, 4) for row in found.rows + again.rows]}")

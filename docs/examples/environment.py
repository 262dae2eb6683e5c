"""Gymnasium: two seconds of hover in a random wind, with random actions on top of the controller."""

from jax_aero.env_gym import HoverEnv

env = HoverEnv()
env.action_space.seed(0)
_, info = env.reset(seed=0)
rewards = []
for _ in range(200):
    _, reward, lost, *_ = env.step(0.1 * env.action_space.sample())
    rewards.append(reward)
print(f"wind {info['wind'].round(1)} m/s, mean reward {sum(rewards) / len(rewards):.2f}, lost: {lost}")

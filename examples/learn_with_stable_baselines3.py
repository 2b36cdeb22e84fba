"""Learn the task ``drive`` with Stable-Baselines3's PPO.

Needs ``pip install 'metropilot[rl]' stable-baselines3``. metropilot's own learners compile the task together
with their networks and take about two hundred times as many steps a second (docs/benchmarks.md); this example
is for those who have a learner already.
"""

import sys

import gymnasium
from stable_baselines3 import PPO

import metropilot.env.adapters  # noqa: F401 (registers the ids)

STEPS = int(sys.argv[1]) if len(sys.argv) > 1 else 4_096
EPISODES = 3

env = gymnasium.make("metropilot/Drive-v0")
# Undiscounted: the cost of running time is charged at the end of the episode.
model = PPO("MlpPolicy", env, n_steps=1024, gamma=1.0, gae_lambda=0.995, seed=0, device="cpu")
model.learn(STEPS)

for episode in range(EPISODES):
    seen, info = env.reset(seed=episode)
    over, total = False, 0.0
    while not over:
        action, _ = model.predict(seen, deterministic=True)
        seen, reward, terminated, truncated, info = env.step(action)
        total, over = total + reward, terminated or truncated
    kwh = info["energy_wheel_j"] / 3.6e6
    print(f"{info['outcome']} after {info['time_s']:.1f} s with {kwh:.2f} kWh, return {total:.2f}")

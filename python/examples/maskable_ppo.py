"""MaskablePPO of sb3-contrib on the single environment.

    python maskable_ppo.py DATASET [STEPS]
"""

import sys

from sb3_contrib import MaskablePPO

import holescout

location, steps = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 20_000
env = holescout.CoverageHoleEnv(location, split="train", settings={"reach_cells": 5})
model = MaskablePPO("MultiInputPolicy", env, n_steps=256, batch_size=64, gamma=0.9, seed=0, verbose=1)
model.learn(steps)

found = 0
for episode in range(100):
    observation, _ = env.reset(seed=episode)
    terminated = truncated = False
    while not (terminated or truncated):
        action, _ = model.predict(observation, action_masks=env.action_masks(), deterministic=True)
        observation, _, terminated, truncated, _ = env.step(action)
    found += terminated
print(f"{found} of 100 episodes found a coverage hole")

"""Steps a second of the environment from Python, on one core, beside what one would use otherwise.

- compact: observations as they are by default, with action masks; random actions;
- paper: encoded observations, beside the rate of Rust's encoder alone (ENCODE_STATES is the example of that name);
- NumPy: the same task vectorised in NumPy (peer_task.py), and one environment of it at a time in `gymnasium.vector.SyncVectorEnv`,
  both with the lines of sight of an action mask;
- EnvPool's CartPole-v1, another task altogether, for the order of magnitude.

Each is measured over SECONDS in a process of its own, ROUNDS times in turns; medians. HOLESCOUT_DATASET names the dataset.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

SECONDS, ROUNDS = 2.0, 3
DATASET = Path(os.environ["HOLESCOUT_DATASET"])
ACTIONS = 961


def rate(count: int, step: Callable[[np.ndarray], object], actions: int) -> float:
    """Environment steps a second."""
    draw = np.random.default_rng(0)
    chosen = [draw.integers(actions, size=count) for _ in range(32)]
    for some in chosen[:4]:
        step(some)
    begin, done = time.perf_counter(), 0
    while time.perf_counter() - begin < SECONDS:
        step(chosen[done % 32])
        done += 1
    return count * done / (time.perf_counter() - begin)


def ours(count: int, observation: str) -> float:
    import holescout

    env = holescout.make_vec(holescout.Dataset(DATASET, "train"), count, observation=observation)
    env.reset(seed=0)
    return rate(count, env.step, ACTIONS)


def encoder(_: int) -> float:
    """Rust's encoder alone, on states of as many measurements as the environment's have on average."""
    import holescout

    env = holescout.make_vec(holescout.Dataset(DATASET, "train"), 256)
    observations, _ = env.reset(seed=0)
    draw = np.random.default_rng(0)
    for _ in range(20):
        observations, *_ = env.step(draw.integers(ACTIONS, size=256))
    states = [
        (env.maps.ids[number], [[int(r), int(c)] for r, c in zip(rows, columns) if r >= 0])
        for number, rows, columns in zip(observations["map"], observations["rows"], observations["columns"])
    ]
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "states.json"
        path.write_text(json.dumps(states))
        command = [os.environ["ENCODE_STATES"], str(DATASET), str(path), str(Path(scratch) / "out")]
        return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def numpy_vector(count: int) -> float:
    import peer_task

    env = peer_task.Environment(peer_task.load_maps(DATASET), 0, count)

    def step(actions: np.ndarray) -> None:
        env.renew(env.step(actions))

    return rate(count, step, ACTIONS)


def numpy_sync(count: int) -> float:
    import gymnasium as gym
    import peer_task

    maps = peer_task.load_maps(DATASET)

    class Single(gym.Env):
        """One environment of the task in NumPy."""

        observation_space = gym.spaces.Box(-1, 121, (2,), np.float64)
        action_space = gym.spaces.Discrete(ACTIONS)

        def __init__(self, seed: int) -> None:
            self.task = peer_task.Environment(maps, seed, 1)

        def reset(self, *, seed=None, options=None):
            self.task.begin(self.task.slots)
            self.task.look()
            return self.seen(), {}

        def seen(self) -> np.ndarray:
            return np.array(np.divmod(self.task.cells()[0], peer_task.CELLS), dtype=np.float64)

        def step(self, action):
            steps = self.task.step(np.array([action]))
            self.task.look()
            return self.seen(), float(steps.rewards[0]), bool(steps.terminal[0]), bool(steps.truncated[0]), {}

    env = gym.vector.SyncVectorEnv([lambda seed=seed: Single(seed) for seed in range(count)])
    env.reset(seed=0)
    return rate(count, env.step, ACTIONS)


def envpool(count: int) -> float:
    import envpool

    env = envpool.make_gymnasium("CartPole-v1", num_envs=count, num_threads=1)
    env.reset()
    return rate(count, env.step, 2)


CONTESTANTS: dict[str, tuple[Callable[[int], float], list[int]]] = {
    "holescout, compact": (lambda count: ours(count, "compact"), [64, 256, 1024, 4096]),
    "the task in NumPy, vectorised": (numpy_vector, [64, 1024]),
    "the task in NumPy, SyncVectorEnv": (numpy_sync, [64]),
    "EnvPool, CartPole-v1": (envpool, [64, 1024]),
    "holescout, paper's encoding": (lambda count: ours(count, "paper"), [64, 256]),
    "Rust's encoder alone": (encoder, [1]),
}


def main() -> None:
    if len(sys.argv) == 3:
        print(CONTESTANTS[sys.argv[1]][0](int(sys.argv[2])))
        return
    core = str(sorted(os.sched_getaffinity(0))[0])
    found: dict[tuple[str, int], list[float]] = {}
    for _ in range(ROUNDS):
        for name, (_, counts) in CONTESTANTS.items():
            for count in counts:
                command = ["taskset", "-c", core, sys.executable, __file__, name, str(count)]
                environment = os.environ | {"RAYON_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
                done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
                found.setdefault((name, count), []).append(float(done.stdout.split()[-1]))
    print("| | environments | steps/s, median (range) |\n|---|---|---|")
    for (name, count), rates in found.items():
        print(f"| {name} | {count} | {statistics.median(rates):,.0f} ({min(rates):,.0f} to {max(rates):,.0f}) |")


if __name__ == "__main__":
    main()

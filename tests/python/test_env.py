"""The environment: Gymnasium's rules, the task's own, and the same trajectories as in Rust."""

import json
import multiprocessing
import os
import pickle
import resource
import subprocess
import threading
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import holescout

KINDS = ["compact", "paper", "best"]


@pytest.mark.parametrize("kind", KINDS)
def test_gymnasiums_checker_has_nothing_to_say(few: holescout.Maps, kind: str) -> None:
    env = gym.make("holescout/CoverageHole-v0", dataset=few, observation=kind)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)


def test_gymnasium_makes_both_by_their_name(train: holescout.Dataset) -> None:
    env = gym.make("holescout/CoverageHole-v0", dataset=train)
    observation, info = env.reset(seed=1)
    assert env.observation_space.contains(observation) and info["action_mask"].shape == (961,)
    many = gym.make_vec("holescout/CoverageHole-v0", num_envs=3, vectorization_mode="vector_entry_point", dataset=train.location)
    assert many.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert many.observation_space.contains(many.reset(seed=1)[0])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", [3, 100])
def test_observations_lie_in_their_space(few: holescout.Maps, kind: str, count: int) -> None:
    env = holescout.make_vec(few, count, observation=kind)  # type: ignore[arg-type]
    env.action_space.seed(0)
    observations, infos = env.reset(seed=2)
    for _ in range(12):
        assert env.observation_space.contains(observations)
        assert infos["action_mask"] is observations["action_mask"]
        observations, _, terminations, truncations, infos = env.step(env.action_space.sample())
        if "final_obs" in infos:
            for at, ended in enumerate(terminations | truncations):
                final = infos["final_obs"][at]
                assert (final is not None) == ended
                assert final is None or env.single_observation_space.contains(final)


class Reference:
    """The rules once more: moves, rewards and ends, of one environment in NumPy."""

    def __init__(self, maps: holescout.Maps) -> None:
        self.maps = maps
        self.side = 2 * maps.reach + 1

    def step(self, number: int, path: list[tuple[int, int]], action: int) -> tuple[tuple[int, int], float, bool, bool]:
        game = self.maps[number]
        mask = game.permissible(path[-1])
        row, column = path[-1]
        by = (action // self.side - self.maps.reach, action % self.side - self.maps.reach)
        steps = max(abs(by[0]), abs(by[1]))
        cell = path[-1]
        for step in range(steps, 0, -1):
            # Half-way goes away from zero, positions being positive.
            part = step / steps
            to = (int(np.floor(row + part * by[0] + 0.5)), int(np.floor(column + part * by[1] + 0.5)))
            offset = (to[0] - row + self.maps.reach) * self.side + to[1] - column + self.maps.reach
            if mask[offset]:
                cell = to
                break
        hole = bool(game.holes[cell])
        reward = -1.25 if not mask[action] else 0.0 if hole else -0.25
        return cell, reward, hole, not hole and len(path) >= self.maps.max_steps


def test_steps_follow_the_rules(few: holescout.Maps) -> None:
    env, reference = holescout.make_vec(few, 5), Reference(few)
    observations, _ = env.reset(seed=11)
    draw = np.random.default_rng(3)
    ends = 0
    for _ in range(60):
        paths = [
            [(int(r), int(c)) for r, c in zip(observations["rows"][at], observations["columns"][at]) if r >= 0] for at in range(5)
        ]
        numbers = observations["map"].copy()
        for number, path, levels, mask in zip(numbers, paths, observations["rsrp_dbm"], observations["action_mask"]):
            np.testing.assert_array_equal(levels[: len(path)], [few[number].rsrp_dbm[cell] for cell in path])
            assert (levels[len(path):] == few.floor_dbm).all()
            np.testing.assert_array_equal(mask.astype(bool), few[number].permissible(path[-1]))
        actions = draw.integers(961, size=5)
        observations, rewards, terminations, truncations, infos = env.step(actions)
        for at in range(5):
            cell, *outcome = reference.step(int(numbers[at]), paths[at], int(actions[at]))
            assert outcome == [rewards[at], terminations[at], truncations[at]]
            after = {name: values[at] for name, values in observations.items()}
            if terminations[at] or truncations[at]:
                ends += 1
                start = (int(after["rows"][0]), int(after["columns"][0]))
                assert few[int(after["map"])].free[start] and not few[int(after["map"])].holes[start]
                after = infos["final_obs"][at]
                np.testing.assert_array_equal(after["action_mask"].astype(bool), few[int(numbers[at])].permissible(cell))
            last = np.flatnonzero(after["rows"] >= 0)[-1]
            assert (after["rows"][last], after["columns"][last]) == cell and last == len(paths[at])
    assert ends > 10


@pytest.mark.parametrize(("seed", "count"), [(0, 1), (7, 3), (2**40, 70), (12345, 200)])
def test_trajectories_are_those_of_rust(train: holescout.Dataset, maps: holescout.Maps, seed: int, count: int) -> None:
    """`examples/trajectories.rs` chooses the n-th permissible action of each state, n from the step and the episode."""
    steps = 40
    told = subprocess.run(
        [os.environ["TRAJECTORIES"], train.location, "train", str(seed), str(count), str(steps)], check=True, capture_output=True)
    env = holescout.make_vec(maps, count)
    observations, _ = env.reset(seed=seed)
    for step, line in enumerate(told.stdout.splitlines()):
        states = json.loads(line)
        for at, (name, path) in enumerate(states):
            own = [[int(r), int(c)] for r, c in zip(observations["rows"][at], observations["columns"][at]) if r >= 0]
            assert (maps.ids[observations["map"][at]], own) == (name, path)
        masks = observations["action_mask"].astype(bool)
        actions = [np.flatnonzero(mask)[(31 * step + 17 * at) % mask.sum()] for at, mask in enumerate(masks)]
        observations, *_ = env.step(np.array(actions))
    assert step == steps


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_gives_the_same_episodes_and_the_next_ones_are_others(few: holescout.Maps, kind: str) -> None:
    def run(env: holescout.CoverageHoleVectorEnv) -> list[dict[str, np.ndarray]]:
        draw = np.random.default_rng(1)
        return [env.step(draw.integers(961, size=4))[0] for _ in range(20)]

    env = holescout.make_vec(few, 4, observation=kind)  # type: ignore[arg-type]
    first, _ = env.reset(seed=4)
    flown = run(env)
    other, _ = env.reset()
    assert any((other[name] != first[name]).any() for name in first)
    again, _ = env.reset(seed=4)
    for one, two in zip([first, *flown], [again, *run(env)]):
        for name in one:
            np.testing.assert_array_equal(one[name], two[name])


def test_the_single_environment_is_the_first_of_many(few: holescout.Maps) -> None:
    single, many = holescout.CoverageHoleEnv(few), holescout.make_vec(few, 3)
    one, _ = single.reset(seed=8)
    batch, _ = many.reset(seed=8)
    draw = np.random.default_rng(2)
    for _ in range(50):
        for name, values in one.items():
            np.testing.assert_array_equal(values, batch[name][0])
        action = int(draw.choice(np.flatnonzero(single.action_masks())))
        one, reward, terminated, truncated, _ = single.step(action)
        batch, rewards, terminations, truncations, _ = many.step(np.array([action, 0, 0]))
        assert (reward, terminated, truncated) == (rewards[0], terminations[0], truncations[0])
        if terminated or truncated:
            with pytest.raises(gym.error.ResetNeeded):
                single.step(action)
            one, _ = single.reset()


def test_observations_stay_as_they_were_when_steps_go_on(few: holescout.Maps) -> None:
    """Memory is used again, but only where nobody holds it."""
    env = holescout.make_vec(few, 100)
    held = [env.reset(seed=0)[0]]
    copies = [{name: values.copy() for name, values in held[0].items()}]
    parts = []
    for step in range(12):
        observations = env.step(np.full(100, (37 * step) % 961))[0]
        if step % 3:
            held.append(observations)
            copies.append({name: values.copy() for name, values in observations.items()})
        else:
            part = observations["action_mask"][5:7, ::2]
            parts.append((part, part.copy()))
        del observations
    for one, copy in zip(held, copies):
        for name in copy:
            np.testing.assert_array_equal(one[name], copy[name])
    for part, copy in parts:
        np.testing.assert_array_equal(part, copy)


def test_settings_are_those_of_the_task(train: holescout.Dataset) -> None:
    env = holescout.make_vec(train, 2, settings={"max_steps": 2, "reach_cells": 3, "hole_threshold_dbm": -90})
    observations, _ = env.reset(seed=0)
    assert observations["rows"].shape == (2, 3) and env.single_action_space.n == 49
    env.step(np.array([24, 24]))
    assert env.step(np.array([24, 24]))[3].all()
    for settings, message in [({"max_step": 2}, "unknown field"), ({"reach_cells": 0}, "1 to 31")]:
        with pytest.raises(holescout.InvalidInput, match=message):
            holescout.make_vec(train, 2, settings=settings)


def test_wrong_use_is_told(few: holescout.Maps) -> None:
    env = holescout.make_vec(few, 2)
    with pytest.raises(gym.error.ResetNeeded):
        env.step(np.array([0, 0]))
    env.reset(seed=0)
    for actions, message in [([0], "found 1, expected 2"), ([0, 961], "expected 0 to 960"), ([-1, 0], "expected 0 to 960")]:
        with pytest.raises(holescout.InvalidInput, match=message):
            env.step(np.array(actions))
    with pytest.raises(holescout.InvalidInput, match="at least 1"):
        holescout.make_vec(few, 0).reset()
    with pytest.raises(holescout.InvalidInput, match="encoding"):
        holescout.make_vec(few, 1, observation="raw")  # type: ignore[arg-type]


def test_the_oracle_is_a_search_over_permissible_moves(few: holescout.Maps) -> None:
    game = few[0]
    hops, free, reach = game.oracle(), game.free, few.reach
    assert (hops[game.holes] == 0).all() and (hops[~free] == -1).all()
    draw = np.random.default_rng(0)
    cells = np.argwhere(free & ~game.holes)
    for row, column in draw.choice(cells, 25, replace=False):
        offsets = np.flatnonzero(game.permissible((row, column)))
        rows, columns = row + offsets // (2 * reach + 1) - reach, column + offsets % (2 * reach + 1) - reach
        near = hops[rows, columns]
        reachable = near[near >= 0]
        assert hops[row, column] == (reachable.min() + 1 if reachable.size else -1)
    with pytest.raises(holescout.InvalidInput, match="free cell"):
        game.permissible(tuple(np.argwhere(~free)[0]))


def test_maps_pickle_by_where_they_come_from(few: holescout.Maps) -> None:
    again = pickle.loads(pickle.dumps(few))
    assert again.ids == few.ids and len(again) == 4
    np.testing.assert_array_equal(again[1].rsrp_dbm, few[1].rsrp_dbm)


def _mean_reward(maps: holescout.Maps, queue: "multiprocessing.Queue[float]") -> None:
    env = holescout.make_vec(maps, 300, observation="paper")
    env.reset(seed=1)
    queue.put(float(env.step(np.zeros(300, dtype=np.int64))[1].mean()))


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_environments_work_in_other_processes(few: holescout.Maps, method: str) -> None:
    here = holescout.make_vec(few, 300)
    here.reset(seed=1)
    expected = here.step(np.zeros(300, dtype=np.int64))[1].mean()
    context = multiprocessing.get_context(method)
    queue = context.Queue()
    process = context.Process(target=_mean_reward, args=(few, queue))
    process.start()
    assert queue.get(timeout=60) == expected
    process.join()


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_gymnasiums_own_vectors_take_it(few: holescout.Maps) -> None:
    make = lambda: holescout.CoverageHoleEnv(few)  # noqa: E731
    for env in (gym.vector.SyncVectorEnv([make] * 2), gym.vector.AsyncVectorEnv([make] * 2)):
        observations, _ = env.reset(seed=3)
        own = [holescout.CoverageHoleEnv(few).reset(seed=seed)[0] for seed in (3, 4)]
        np.testing.assert_array_equal(observations["rows"], [one["rows"] for one in own])
        env.step(np.array([0, 960]))
        env.close()


def test_threads_share_an_environment(few: holescout.Maps) -> None:
    env = holescout.make_vec(few, 128)
    env.reset(seed=0)
    done: list[int] = []

    def step() -> None:
        done.append(sum(len(env.step(np.zeros(128, dtype=np.int64))[1]) for _ in range(50)))

    threads = [threading.Thread(target=step) for _ in range(2)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    assert done == [128 * 50] * 2


def test_memory_is_flat_over_a_million_steps(few: holescout.Maps) -> None:
    env = holescout.make_vec(few, 2048)
    env.reset(seed=0)
    draw = np.random.default_rng(0)

    def run(steps: int) -> int:
        for _ in range(steps // 2048):
            env.step(draw.integers(961, size=2048))
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    before = run(200_000)
    assert run(1_000_000) - before < 20_000, "kilobytes"

"""Transitions in and out of the buffer, against plain bookkeeping."""

import numpy as np
import pytest

import holescout


def fill(maps: holescout.Maps, buffer: holescout.ReplayBuffer, count: int, steps: int) -> dict[tuple, list]:
    """Steps environments, adds to the buffer, and keeps every transition by (map, path before, action)."""
    env = holescout.make_vec(maps, count)
    observations, _ = env.reset(seed=5)
    draw = np.random.default_rng(0)
    episodes: list[list] = [[] for _ in range(count)]
    known: dict[tuple, list] = {}
    n_steps = buffer.n_steps
    for _ in range(steps):
        actions = draw.integers(961, size=count)
        names = ("map", "rows", "columns")
        states = [tuple(np.ravel(observations[name][at]).tolist()) for name in names for at in range(count)]
        before = [(states[at][0], states[count + at], states[2 * count + at]) for at in range(count)]
        after, rewards, terminations, truncations, infos = env.step(actions)
        buffer.add(actions, rewards, terminations, truncations, after, infos)
        for at in range(count):
            ended = bool(terminations[at] or truncations[at])
            last = infos["final_obs"][at] if ended else {name: values[at] for name, values in after.items()}
            episodes[at].append((before[at], int(actions[at]), float(rewards[at]), last, bool(terminations[at])))
            begins = range(len(episodes[at])) if ended else range(len(episodes[at]) - n_steps, len(episodes[at]) - n_steps + 1)
            for begin in (begin for begin in begins if begin >= max(0, len(episodes[at]) - n_steps)):
                parts = episodes[at][begin:]
                value = sum(0.9**i * part[2] for i, part in enumerate(parts))
                known[(*parts[0][0], parts[0][1])] = [value, len(parts), *parts[-1][3:]]
            if ended:
                episodes[at] = []
        observations = after
    return known


@pytest.mark.parametrize("n_steps", [1, 3])
def test_samples_are_what_was_added(few: holescout.Maps, n_steps: int) -> None:
    buffer = holescout.ReplayBuffer(few, 10_000, n_steps=n_steps, discount=0.9)
    known = fill(few, buffer, 20, 60)
    assert buffer.nbytes == len(buffer) * 28 and 20 * 50 < len(buffer) <= 20 * 60
    sample = buffer.sample(500)
    assert "weights" not in sample
    for at in range(500):
        before, after = ({name: values[at] for name, values in sample[of].items()} for of in ("observations", "next_observations"))
        key = (int(before["map"]), tuple(before["rows"]), tuple(before["columns"]), int(sample["actions"][at]))
        value, steps, last, terminal = known[key]
        assert sample["returns"][at] == pytest.approx(value, abs=1e-6)
        assert sample["discounts"][at] == pytest.approx(0.0 if terminal else 0.9**steps)
        for name in last:
            np.testing.assert_array_equal(after[name], last[name])


def test_the_oldest_makes_room(few: holescout.Maps) -> None:
    buffer = holescout.ReplayBuffer(few, 100)
    fill(few, buffer, 8, 40)
    assert len(buffer) == 100 and buffer.nbytes == 2800


def test_surprises_come_more_often(few: holescout.Maps) -> None:
    buffer = holescout.ReplayBuffer(few, 50, alpha=1.0)
    fill(few, buffer, 5, 10)
    errors = np.full(50, 0.1, dtype=np.float32)
    errors[7] = 50.0
    buffer.update_priorities(np.arange(50), errors)
    sample = buffer.sample(400, beta=1.0)
    often = sample["positions"] == 7
    assert often.mean() > 0.7
    assert sample["weights"][often].max() < sample["weights"][~often].min() <= 1.0


def test_samples_go_to_others_without_a_copy(few: holescout.Maps) -> None:
    buffer = holescout.ReplayBuffer(few, 100)
    fill(few, buffer, 5, 5)
    returns = buffer.sample(8)["returns"]
    other = np.from_dlpack(returns)
    assert np.shares_memory(other, returns)


def test_wrong_use_is_told(few: holescout.Maps) -> None:
    for keywords, message in [({"n_steps": 9}, "1 to 8"), ({"discount": 1.5}, "0 to 1"), ({"alpha": -1.0}, "0 to 1")]:
        with pytest.raises(holescout.InvalidInput, match=message):
            holescout.ReplayBuffer(few, 10, **keywords)  # type: ignore[arg-type]
    buffer = holescout.ReplayBuffer(few, 10)
    with pytest.raises(holescout.InvalidInput, match="add some first"):
        buffer.sample(1)
    with pytest.raises(holescout.InvalidInput, match="position"):
        buffer.update_priorities(np.array([3]), np.array([1.0], dtype=np.float32))
    env = holescout.make_vec(few, 2)
    env.reset(seed=0)
    after, rewards, terminations, truncations, infos = env.step(np.array([0, 0]))
    with pytest.raises(holescout.InvalidInput, match="reward"):
        buffer.add(np.array([0, 0]), rewards + 0.1, terminations, truncations, after, infos)
    with pytest.raises(holescout.InvalidInput, match="actions"):
        buffer.add(np.array([0]), rewards, terminations, truncations, after, infos)
    paths = {name: values.copy() for name, values in after.items()}
    paths["map"][0] = 99
    with pytest.raises(holescout.InvalidInput, match="found 99, expected 0 to 3"):
        buffer.add(np.array([0, 0]), rewards, terminations, truncations, paths, infos)

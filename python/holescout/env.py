"""The paper's task for Gymnasium: a UAV over a city looks for a coverage hole.

A step is a move within a square of (2 l + 1)² cells, numbered row by row from the north-west; to stay is in the middle. A move that a
building blocks is pulled back along the line (Algorithm 1) and costs 1.25, any other costs 0.25 but the one into a coverage hole,
which ends the episode (equation 13). After `max_steps` an episode is truncated. Episodes begin at covered free cells of maps on
which there is a hole; which ones depends on the seed alone.

Observations are dictionaries. "compact" is what a UAV knows, and enough to make the others of (`Maps.encode`):

- `map`: number of the map among `env.maps`, whose buildings the UAV knows;
- `rows`, `columns`: the cells it has visited, int16, -1 where it has not flown yet; `rsrp_dbm`: the levels it measured there;
- `action_mask`: 1 for each action that nothing blocks.

"paper" and "best" have `map` and `window`, float32 `[channels, rows, columns]` (see `Maps.encode`), and `action_mask`.
"""

import os
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from . import _native
from .dataset import Dataset, Split
from .maps import Maps

ObservationKind = Literal["compact", "paper", "best"]
Observation = dict[str, NDArray[Any]]

# What no level exceeds; boxes need a bound.
HIGHEST_DBM = 100.0
# Encoded values: a sum of max_steps + 1 levels over the threshold, each far below it.
MOST_ENCODED = 100.0


def observation_space(maps: Maps, kind: ObservationKind) -> spaces.Dict:
    """The space of a single observation."""
    mask = spaces.MultiBinary(maps.actions)
    if kind == "compact":
        length = maps.max_steps + 1
        places = spaces.Box(-1, maps.cells - 1, (length,), np.int16)
        levels = spaces.Box(maps.floor_dbm, HIGHEST_DBM, (length,), np.float32)
        return spaces.Dict(
            {"map": spaces.Discrete(len(maps)), "rows": places, "columns": places, "rsrp_dbm": levels, "action_mask": mask}
        )
    encoded = {
        name: spaces.Box(-MOST_ENCODED, MOST_ENCODED, shape, np.float32) for name, shape in maps.shapes(kind).items()
    }
    return spaces.Dict(encoded | {"action_mask": mask})


def as_maps(dataset: Dataset | Maps | str | os.PathLike[str], split: Split | None, settings: Mapping[str, Any] | None) -> Maps:
    """Maps that were given, or those of a dataset."""
    if isinstance(dataset, Maps):
        return dataset
    return Maps(dataset, split or ("train" if not isinstance(dataset, Dataset) else dataset.split), settings=settings)


class FinalObservations:
    """The last observations of the episodes that have ended in a step, those of `infos["_final_obs"]`.

    `final_obs[3]` is the observation of environment 3, and None if that has not ended, as in Gymnasium's own environments.
    `final_obs.batch` has the arrays of all that have ended, in the order of `final_obs.environments`; they are encoded when somebody
    asks for them.
    """

    def __init__(self, compact: Observation, ended: NDArray[np.bool_], encode: Callable[[Observation], Observation]) -> None:
        self._compact = compact
        self._encode = encode
        self.environments = np.flatnonzero(ended)
        self._count = len(ended)

    @cached_property
    def batch(self) -> Observation:
        """The last observations of all that have ended."""
        return self._encode(self._compact)

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, environment: int) -> Observation | None:
        environment = range(self._count)[environment]
        at = int(np.searchsorted(self.environments, environment))
        if at == len(self.environments) or self.environments[at] != environment:
            return None
        return {name: values[at] for name, values in self.batch.items()}


class CoverageHoleVectorEnv(VectorEnv[Observation, NDArray[np.int64], NDArray[Any]]):
    """Many episodes at a time, in Rust.

    The autoreset mode is SAME_STEP: where an episode ended, the observation is the first of the next one, and the last one is in
    `infos["final_obs"]`. `infos["action_mask"]` is the mask of the observations. `reset(seed=n)` begins the first episodes of a seed;
    the n-th episode of an environment is a function of seed, its number, n and the maps. `reset()` begins the next ones.

    Objects may be used by several threads. `dataset` is a dataset (of a split, else of train), its location, or `Maps`.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        dataset: Dataset | Maps | str | os.PathLike[str],
        num_envs: int = 1,
        *,
        split: Split | None = None,
        observation: ObservationKind = "compact",
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        self.maps = as_maps(dataset, split, settings)
        self.num_envs = num_envs
        self.observation = observation
        self.single_observation_space = observation_space(self.maps, observation)
        self.single_action_space = spaces.Discrete(self.maps.actions)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._episodes: _native.Episodes | None = None
        self._all = np.ones(num_envs, dtype=np.bool_)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        super().reset(seed=seed)
        if self._episodes is None:
            self._episodes = _native.Episodes(self.maps._native, self.num_envs, self._first_seed(seed))
            compact = self._episodes.observations()
        else:
            compact = self._episodes.reset(seed)
        return self._encoded(compact), self._infos(compact)

    def _first_seed(self, seed: int | None) -> int:
        return int(self.np_random.integers(2**63)) if seed is None else seed

    def step(
        self, actions: NDArray[np.int64]
    ) -> tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        if self._episodes is None:
            raise gym.error.ResetNeeded("call reset() before step()")
        actions = np.ascontiguousarray(actions, dtype=np.int64)
        compact, rewards, terminations, truncations, last = self._episodes.step(actions)
        infos = self._infos(compact)
        if last is not None:
            ended = terminations | truncations
            infos["final_obs"] = FinalObservations(last, ended, self._encoded)
            infos["_final_obs"] = ended
        return self._encoded(compact), rewards, terminations, truncations, infos

    def _infos(self, compact: Observation) -> dict[str, Any]:
        return {"action_mask": compact["action_mask"], "_action_mask": self._all}

    def _encoded(self, compact: Observation) -> Observation:
        if self.observation == "compact":
            return compact
        return self.maps.encode(compact, self.observation) | {"action_mask": compact["action_mask"]}


class CoverageHoleEnv(gym.Env[Observation, np.int64]):
    """One episode at a time, for libraries that want it so: `gymnasium.make("holescout/CoverageHole-v0", dataset=...)`.

    The same task as `CoverageHoleVectorEnv`, and with the same seed the same episodes as its first environment.
    `action_masks()` is what MaskablePPO of sb3-contrib asks for.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        dataset: Dataset | Maps | str | os.PathLike[str],
        *,
        split: Split | None = None,
        observation: ObservationKind = "compact",
        settings: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
    ) -> None:
        if render_mode is not None:
            raise ValueError(f"render_mode is {render_mode!r}, expected None: the reports of holescout.evaluate show flights")
        self._vector = CoverageHoleVectorEnv(dataset, 1, split=split, observation=observation, settings=settings)
        self.maps = self._vector.maps
        self.observation_space = self._vector.single_observation_space
        self.action_space = self._vector.single_action_space
        # The first observation of the next episode, which has begun where the last one ended.
        self._next: Observation | None = None
        self._mask: NDArray[np.int8] | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        super().reset(seed=seed)
        if seed is None and self._next is not None:
            observation = self._next
        else:
            if seed is None and self._vector._episodes is None:
                seed = int(self.np_random.integers(2**63))
            observation = self._one(self._vector.reset(seed=seed)[0])
        self._next = None
        return self._seen(observation)

    def step(self, action: int | np.integer[Any]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        if self._mask is None or self._next is not None:
            raise gym.error.ResetNeeded("call reset() before step()")
        batch, rewards, terminations, truncations, infos = self._vector.step(np.array([action]))
        observation = self._one(batch)
        if "final_obs" in infos:
            self._next, observation = observation, infos["final_obs"][0]
        return (self._seen(observation)[0], float(rewards[0]), bool(terminations[0]), bool(truncations[0]), {"action_mask": self._mask})

    def action_masks(self) -> NDArray[np.bool_]:
        """Where the next step may lead."""
        if self._mask is None:
            raise gym.error.ResetNeeded("call reset() first")
        return self._mask.astype(np.bool_)

    def _one(self, batch: Mapping[str, NDArray[Any]]) -> Observation:
        return {name: values[0] for name, values in batch.items()}

    def _seen(self, observation: Observation) -> tuple[Observation, dict[str, Any]]:
        self._mask = observation["action_mask"]
        return observation, {"action_mask": self._mask}


def make_vec(
    dataset: Dataset | Maps | str | os.PathLike[str],
    num_envs: int,
    *,
    split: Split | None = None,
    observation: ObservationKind = "compact",
    settings: Mapping[str, Any] | None = None,
) -> CoverageHoleVectorEnv:
    """A `gymnasium.vector.VectorEnv` over the maps of a dataset."""
    return CoverageHoleVectorEnv(dataset, num_envs, split=split, observation=observation, settings=settings)

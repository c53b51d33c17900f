"""Replay of transitions in 28 bytes each: map, path, action, rewards. Observations are made anew when they are drawn."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from .maps import Maps


class ReplayBuffer:
    """A ring of transitions of `n_steps` steps of environments over `maps`.

    A million of them take 28 MB, where encoded observations would take a terabyte. `alpha` above 0 draws transitions in proportion to
    their error to that power (prioritised replay).
    """

    def __init__(
        self, maps: Maps, capacity: int, *, n_steps: int = 1, discount: float = 0.99, alpha: float = 0.0, seed: int = 0
    ) -> None:
        self.n_steps = n_steps
        self._native = _native.ReplayBuffer(maps._native, capacity, n_steps, discount, alpha, seed)

    def __len__(self) -> int:
        return len(self._native)

    @property
    def nbytes(self) -> int:
        """Bytes of the transitions that are in the buffer."""
        return len(self) * self._native.transition_bytes

    def add(
        self,
        actions: NDArray[np.int64],
        rewards: NDArray[np.float64],
        terminations: NDArray[np.bool_],
        truncations: NDArray[np.bool_],
        next_observations: Mapping[str, NDArray[Any]],
        infos: Mapping[str, Any],
    ) -> None:
        """Adds what `CoverageHoleVectorEnv.step` returned for `actions`; observations must be compact."""
        after = {name: next_observations[name] for name in ("map", "rows", "columns")}
        if "final_obs" in infos:
            # Where an episode ended, the next observation is of another one.
            last = infos["final_obs"]
            after = {name: values.copy() for name, values in after.items()}
            for name, values in after.items():
                values[last.environments] = last.batch[name]
        self._native.add(
            np.ascontiguousarray(after["map"], dtype=np.int64),
            np.ascontiguousarray(after["rows"], dtype=np.int16),
            np.ascontiguousarray(after["columns"], dtype=np.int16),
            np.ascontiguousarray(actions, dtype=np.int64),
            np.ascontiguousarray(rewards, dtype=np.float64),
            np.ascontiguousarray(terminations, dtype=np.bool_),
            np.ascontiguousarray(truncations, dtype=np.bool_),
        )

    def sample(self, count: int, *, beta: float = 1.0) -> dict[str, Any]:
        """Draws transitions, with repetition: NumPy arrays, which `torch.from_dlpack` takes without a copy.

        - `observations`, `next_observations`: compact, as the environment gives them, with `action_mask`;
        - `actions`, int64; `returns`, float32: the discounted rewards of the steps; `discounts`, float32: what the value of the next
          state is multiplied by, 0 where the episode ended at a hole;
        - `positions`, int64, for `update_priorities`; with `alpha` above 0 `weights`, float32: importance (N p)^(-beta), the greatest 1.
        """
        return self._native.sample(count, beta)

    def update_priorities(self, positions: NDArray[np.int64], errors: NDArray[np.float32]) -> None:
        """Sets priorities by the errors of transitions that were learned from."""
        self._native.update_priorities(np.ascontiguousarray(positions, dtype=np.int64), np.ascontiguousarray(errors, dtype=np.float32))

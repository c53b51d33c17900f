"""The task on records: what blocks, what is a coverage hole, where a step may lead, and the exact optimum."""

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import NDArray

from . import _native
from .dataset import Dataset, Split, as_dataset

Map = _native.Map
Encoding = Literal["paper", "best"]


class Maps(Sequence["_native.Map"]):
    """The maps of a dataset in memory, about 190 KB each.

    `settings` are those of `[rl]`, for instance `{"hole_threshold_dbm": -110, "max_steps": 4}`; `ids` chooses records by their names.
    Pickles by where it comes from.
    """

    def __init__(
        self,
        dataset: Dataset | str | os.PathLike[str],
        split: Split | None = None,
        *,
        ids: Iterable[str] | None = None,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        self.dataset = as_dataset(dataset, split)  # type: ignore[arg-type]
        given = dict(settings or {})
        self._chosen = None if ids is None else list(ids)
        self._native = _native.Maps(self.dataset._native, split or self.dataset.split, self._chosen, json.dumps({"rl": given}))
        self.ids: list[str] = self._native.ids()
        self.cells = self._native.cells()
        """Cells along a side (the paper's L)."""
        self.settings: dict[str, Any] = json.loads(self._native.settings())
        """All settings of `[rl]`, those that were not given among them."""
        self.reach: int = self.settings["reach_cells"]
        """Cells that a step may lead in each direction (l)."""
        self.max_steps: int = self.settings["max_steps"]
        """Most steps of an episode."""
        self.floor_dbm: float = self.settings["floor_dbm"]
        """Lower levels are not told apart."""

    @property
    def teaching(self) -> list[int]:
        """Numbers of the maps on which there is something to find: a coverage hole, and a covered free cell to begin in."""
        return self._native.teaching()

    @property
    def actions(self) -> int:
        """Number of actions, (2 l + 1)²: a square of cells around the UAV, row by row from the north-west; to stay is in the middle."""
        return (2 * self.reach + 1) ** 2

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (self.dataset, self.dataset.split, self._chosen, self.settings)

    def __len__(self) -> int:
        return len(self.ids)

    @overload
    def __getitem__(self, which: int) -> "_native.Map": ...
    @overload
    def __getitem__(self, which: slice) -> "list[_native.Map]": ...
    def __getitem__(self, which: int | slice) -> "_native.Map | list[_native.Map]":
        if isinstance(which, slice):
            return [self._native.get(at) for at in range(len(self))[which]]
        return self._native.get(range(len(self))[which])

    def shapes(self, encoding: Encoding = "paper") -> dict[str, tuple[int, int, int]]:
        """Shapes `(channels, rows, columns)` of the arrays `map` and `window` of an encoding."""
        whole, window = self._native.shapes(encoding)
        return {"map": tuple(whole), "window": tuple(window)}  # type: ignore[dict-item]

    def encode(self, observations: Mapping[str, NDArray[Any]], encoding: Encoding = "paper") -> dict[str, NDArray[np.float32]]:
        """What a network sees of compact observations of a batch: `map` and `window`, float32 `[n, channels, rows, columns]`.

        "paper" are I_A and I_B (equations 7 and 9): encoded location, encoded measurements, heights over 50 m, of the whole map and of
        the window of all moves. "best" is what preset `best` of the trainer sees, centred on the UAV.
        """
        return self._native.encode(
            np.ascontiguousarray(observations["map"], dtype=np.int64),
            np.ascontiguousarray(observations["rows"], dtype=np.int16),
            np.ascontiguousarray(observations["columns"], dtype=np.int16),
            np.ascontiguousarray(observations["rsrp_dbm"], dtype=np.float32),
            encoding,
        )


def _restored(dataset: Dataset, split: Split | None, ids: list[str] | None, settings: dict[str, Any]) -> Maps:
    return Maps(dataset, split, ids=ids, settings=settings)

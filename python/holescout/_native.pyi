"""The part in Rust. Its classes are used through `holescout`, but for `Map`."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .dataset import Record

class Dataset:
    def __new__(cls, location: str, remote: str) -> Dataset: ...
    def ids(self, split_name: str | None) -> list[str]: ...
    def manifest(self) -> str: ...
    def sha256(self) -> str: ...
    def record(self, id: str) -> Record: ...
    def metadata(self, id: str) -> str: ...

class Loader:
    def __new__(
        cls,
        dataset: Dataset,
        split_name: str,
        *,
        seed: int,
        cursor: int,
        rank: int,
        world: int,
        block: int | None,
        threads: int | None,
        memory_bytes: int,
        leave_out_damaged: bool,
    ) -> Loader: ...
    def next(self) -> tuple[int, Record]: ...
    @property
    def cursor(self) -> int: ...
    @property
    def records(self) -> int: ...
    @property
    def damaged(self) -> dict[str, str]: ...

class Map:
    """One map: L x L cells, row 0 the northernmost, column 0 the westernmost. Arrays are copies."""

    @property
    def id(self) -> str:
        """Name of the tile."""
    @property
    def cells(self) -> int:
        """Cells along a side (the paper's L)."""
    @property
    def cell_m(self) -> float:
        """Side of a cell in metres."""
    @property
    def threshold_dbm(self) -> float:
        """Below this an outdoor cell is a coverage hole, in dBm per resource element."""
    @property
    def height_m(self) -> NDArray[np.float32]:
        """Heights in metres, [L, L]."""
    @property
    def rsrp_dbm(self) -> NDArray[np.float32]:
        """Levels in dBm per resource element, [L, L]."""
    @property
    def free(self) -> NDArray[np.bool_]:
        """Where a UAV may fly, [L, L]."""
    @property
    def holes(self) -> NDArray[np.bool_]:
        """Coverage holes, [L, L]."""
    @property
    def base_station(self) -> tuple[float, float, float]:
        """Row and column of the base station, which may lie outside of the map, and its height above the ground in metres."""
    def permissible(self, cell: tuple[int, int]) -> NDArray[np.bool_]:
        """Where one step from a free cell may lead (the paper's equation 3): for each action, [(2 l + 1)^2]."""
    def oracle(self) -> NDArray[np.int16]:
        """Least steps to a coverage hole from each cell, [L, L]: 0 in a hole, -1 where none can be reached."""

class Maps:
    def __new__(cls, dataset: Dataset, split_name: str | None, ids: list[str] | None, settings: str) -> Maps: ...
    def __len__(self) -> int: ...
    def get(self, number: int) -> Map: ...
    def ids(self) -> list[str]: ...
    def teaching(self) -> list[int]: ...
    def cells(self) -> int: ...
    def settings(self) -> str: ...
    def shapes(self, encoding: str) -> tuple[list[int], list[int]]: ...
    def encode(
        self, map: NDArray[np.int64], rows: NDArray[np.int16], columns: NDArray[np.int16], rsrp_dbm: NDArray[np.float32], encoding: str
    ) -> dict[str, NDArray[np.float32]]: ...

class Episodes:
    def __new__(cls, maps: Maps, count: int, seed: int) -> Episodes: ...
    def reset(self, seed: int | None) -> dict[str, NDArray[Any]]: ...
    def observations(self) -> dict[str, NDArray[Any]]: ...
    def step(
        self, actions: NDArray[np.int64]
    ) -> tuple[dict[str, NDArray[Any]], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, NDArray[Any]] | None]: ...

class ReplayBuffer:
    def __new__(cls, maps: Maps, capacity: int, n_steps: int, discount: float, alpha: float, seed: int) -> ReplayBuffer: ...
    def __len__(self) -> int: ...
    @property
    def transition_bytes(self) -> int: ...
    def add(
        self,
        map: NDArray[np.int64],
        rows: NDArray[np.int16],
        columns: NDArray[np.int16],
        actions: NDArray[np.int64],
        rewards: NDArray[np.float64],
        terminations: NDArray[np.bool_],
        truncations: NDArray[np.bool_],
    ) -> None: ...
    def sample(self, count: int, beta: float) -> dict[str, Any]: ...
    def update_priorities(self, positions: NDArray[np.int64], errors: NDArray[np.float32]) -> None: ...

def rasterise(osm: list[Path], bbox: Any, geojson: Any, common: Any) -> None: ...
def scenes(osm: list[Path], tiles: Any, sites: Any, common: Any) -> None: ...
def import_rsrp(maps: Any, tiles: Any, scenes: Any, common: Any) -> None: ...
def shard(tiles: Any, rsrp: Any, common: Any) -> None: ...
def verify(directory: Any, progress: Any) -> tuple[str, int, int, list[str]]: ...
def evaluate(
    dataset: str, policy: Any, name: str, *, split_name: str | None, settings: str, out: Path, overwrite: bool, progress: Any
) -> str: ...

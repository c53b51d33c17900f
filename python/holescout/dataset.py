"""Datasets of records: by position, by name, or as a shuffled stream."""

import json
import os
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypedDict

import numpy as np
from numpy.typing import NDArray

from . import _native
from .errors import InvalidInput

Split = Literal["train", "val", "test"]


class _Errors(TypedDict, total=False):
    std_error_db: NDArray[np.float32]
    first_half_share: NDArray[np.float32]


class Record(_Errors):
    """A record: grids of `[L, L]`, row 0 the northernmost and column 0 the westernmost.

    - `height_m`: the highest building of each cell in metres, 0 where there is none;
    - `rsrp_dbm`: level in dBm per resource element; `floor_dbm` in cells that no path reaches;
    - `mask`: 0 outdoors and reached, 1 building, 2 outdoors and not reached;
    - `std_error_db`, where the map was traced several times: standard error of each level in dB; `first_half_share`: share of the
      summed power that the first half of the repeats received;
    - `base_station_m`: metres east and north of the middle, and above the ground;
    - `center_m`: easting and northing of the middle in metres (UTM); `center_lon_lat`: in degrees (WGS 84);
    - `cell_m`: side of a cell in metres.
    """

    id: str
    height_m: NDArray[np.float32]
    rsrp_dbm: NDArray[np.float32]
    mask: NDArray[np.uint8]
    base_station_m: NDArray[np.float64]
    center_m: NDArray[np.float64]
    center_lon_lat: NDArray[np.float64]
    cell_m: float
    floor_dbm: float


class Dataset:
    """A dataset in a directory, or at `http(s)://` or `s3://`: all of it, or one split.

    A sequence of records in the order of their names, which `torch.utils.data.DataLoader` takes as it is. Every record that is read
    is checked against its checksum. `remote` has settings of `[remote]`, for instance `{"cache_mb": 500}`.

    Raises InvalidInput if there is no whole dataset.
    """

    def __init__(self, location: str | os.PathLike[str], split: Split | None = None, *, remote: Mapping[str, Any] | None = None) -> None:
        self.location = os.fspath(location)
        self.split = split
        self._remote = dict(remote or {})
        self._native = _native.Dataset(self.location, json.dumps(self._remote))
        self.ids: list[str] = self._native.ids(split)
        """Names of the records, in the order of their positions."""

    def __repr__(self) -> str:
        return f"Dataset({self.location!r}, {self.split!r}): {len(self)} records"

    def __getstate__(self) -> tuple[str, Split | None, dict[str, Any]]:
        return self.location, self.split, self._remote

    def __setstate__(self, state: tuple[str, Split | None, dict[str, Any]]) -> None:
        location, split, remote = state
        self.__init__(location, split, remote=remote)  # type: ignore[misc]

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, which: int | str) -> Record:
        """The record at a position (negative from the end), or of a name."""
        return self._native.record(which if isinstance(which, str) else self.ids[which])

    def __iter__(self) -> Iterator[Record]:
        return (self[at] for at in range(len(self)))

    def metadata(self, which: int | str) -> dict[str, Any]:
        """What a record says besides its arrays: radio settings, provenance, licence (see `schemas/record.v2.json`)."""
        metadata: dict[str, Any] = json.loads(self._native.metadata(which if isinstance(which, str) else self.ids[which]))
        return metadata

    @cached_property
    def manifest(self) -> dict[str, Any]:
        """The dataset's manifest (see `schemas/dataset.v1.json`)."""
        manifest: dict[str, Any] = json.loads(self._native.manifest())
        return manifest

    @property
    def sha256(self) -> str:
        """SHA-256 of the manifest, which names every shard by its own: two datasets with the same one are the same."""
        return self._native.sha256()

    def loader(self, *, seed: int = 0, rank: int = 0, world: int = 1, **options: Any) -> "Loader":
        """An endless stream of the split's records in a shuffled order: see `Loader`."""
        return Loader(self, seed=seed, rank=rank, world=world, **options)


class Loader:
    """The records of a split, epoch after epoch, each epoch in an order of its own; decoded ahead on other threads.

    The order depends on `seed` (and `block`) alone: not on threads, and `state_dict` at any point is enough to go on exactly. Of
    `world` processes each one has the records that leave `rank`; together they have every record of an epoch once.

    - `epochs`: how many to give; without it there is no end;
    - `block`: shards that are shuffled together, for splits that are larger than the disk; otherwise all are;
    - `threads` that decode (all cores), and `memory_mb` for what they have decoded ahead;
    - `leave_out_damaged`: go on without records that cannot be read, and tell them in `damaged`; otherwise they are errors.
    """

    def __init__(
        self,
        dataset: Dataset,
        *,
        seed: int = 0,
        rank: int = 0,
        world: int = 1,
        epochs: int | None = None,
        block: int | None = None,
        threads: int | None = None,
        memory_mb: int = 256,
        leave_out_damaged: bool = False,
    ) -> None:
        if dataset.split is None:
            raise InvalidInput("a loader streams one split: open Dataset(location, split)", found="None", expected="train, val or test")
        self.dataset = dataset
        self._split: Split = dataset.split
        self._order: dict[str, Any] = {"seed": seed, "block": block}
        self._options: dict[str, Any] = dict(
            rank=rank, world=world, threads=threads, memory_bytes=memory_mb << 20, leave_out_damaged=leave_out_damaged)
        self._cursor = 0
        self._end: int | None = None
        self._epochs = epochs
        self._loader: _native.Loader | None = None
        self._process = os.getpid()

    def _open(self) -> "_native.Loader":
        # The threads of a process that was forked are its parent's.
        if self._loader is None or self._process != os.getpid():
            self._loader = _native.Loader(self.dataset._native, self._split, cursor=self._cursor, **self._order, **self._options)
            self._process = os.getpid()
            self._cursor = self._loader.cursor
            self._end = None if self._epochs is None else self._epochs * self._loader.records
        return self._loader

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_loader": None}

    def __iter__(self) -> "Loader":
        return self

    def __next__(self) -> Record:
        loader = self._open()
        if self._end is not None and self._cursor >= self._end:
            raise StopIteration
        cursor, record = loader.next()
        if self._end is not None and cursor >= self._end:
            # Only records that were left out lay in between.
            self._cursor = cursor
            raise StopIteration
        self._cursor = loader.cursor
        return record

    @property
    def epoch(self) -> int:
        """The epoch of the next record, from 0."""
        return self._cursor // self._open().records

    @property
    def damaged(self) -> dict[str, str]:
        """Records that were left out so far, each with what is wrong with it."""
        return self._open().damaged

    def state_dict(self) -> dict[str, Any]:
        """Where the stream is. Where each of several processes has taken as many records, the smallest cursor continues all."""
        return {"cursor": self._cursor, "dataset": self.dataset.sha256, "split": self.dataset.split, **self._order}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on where a state was taken. Raises InvalidInput if it is of another dataset, split or order."""
        own = self.state_dict()
        for key in ("dataset", "split", "seed", "block"):
            if state[key] != own[key]:
                raise InvalidInput(f"state of another stream: {key} is {state[key]}, expected {own[key]}; give the loader the same "
                                   "dataset and settings", found=str(state[key]), expected=str(own[key]))
        self._cursor = state["cursor"]
        self._loader = None


def as_dataset(dataset: "Dataset | str | Path", split: Split | None = None) -> Dataset:
    """A dataset that was given as one, or by its location."""
    return dataset if isinstance(dataset, Dataset) else Dataset(dataset, split)

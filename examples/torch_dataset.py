"""A split of a dataset as a PyTorch `IterableDataset`, for `DataLoader` with any number of workers and ranks.

    loader = DataLoader(Records("helsinki-1.0.0", "train"), batch_size=8, num_workers=2)
    for epoch in range(3):
        loader.dataset.set_epoch(epoch)
        for batch in loader: ...  # maps: float32 [8, 2, n, n], mask: uint8 [8, n, n], hole: float32 [8, n, n], id: list of str

`hole` is the chance that a cell is a coverage hole: 0 or 1 where a map was traced once, or its repeats leave no doubt.

Shards are shuffled by seed and epoch and dealt out to ranks and their workers, each to one of them. Records of a shard are no
neighbours of each other, so that their order within it may stay.
"""

import random
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from read_shards import hole_probability, records, shards
from torch.utils.data import IterableDataset, get_worker_info


class Records(IterableDataset):
    """Records of a split; heights in metres and RSRP in dBm as two channels. Coverage holes lie below `threshold_dbm`."""

    def __init__(self, dataset: str | Path, split: str = "train", seed: int = 0, rank: int = 0, ranks: int = 1,
                 threshold_dbm: float = -100.0) -> None:
        self.shards = shards(Path(dataset), split)
        self.seed, self.rank, self.ranks, self.threshold_dbm = seed, rank, ranks, threshold_dbm
        # Shared with workers that live on from epoch to epoch (persistent_workers=True).
        self.epoch = torch.zeros((), dtype=torch.int64).share_memory_()

    def set_epoch(self, epoch: int) -> None:
        self.epoch.fill_(epoch)

    def __iter__(self) -> Iterator[dict]:
        worker = get_worker_info()
        workers, index = (worker.num_workers, worker.id) if worker else (1, 0)
        order = random.Random(f"{self.seed} {int(self.epoch)}").sample(self.shards, len(self.shards))
        for shard in order[self.rank * workers + index :: self.ranks * workers]:
            for record in records(shard):
                maps = np.stack([record["height_m"], record["rsrp_dbm"]])
                hole = torch.from_numpy(hole_probability(record, self.threshold_dbm)).float()
                yield {"id": record["id"], "maps": torch.from_numpy(maps), "mask": torch.from_numpy(record["mask"]), "hole": hole}

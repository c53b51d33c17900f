"""For PyTorch: a shuffled stream for its data loaders, and the encoding of compact observations on any device."""

from typing import Any

import numpy as np
import torch
from torch.utils.data import IterableDataset, get_worker_info

from .dataset import Dataset, Loader, Record
from .maps import Maps


class RecordStream(IterableDataset[Record]):
    """The records of a split in a shuffled order, for `DataLoader`, and for `torchdata.stateful_dataloader.StatefulDataLoader`, which goes
    on exactly where it was interrupted.

    An iteration is an epoch; `set_epoch` says which one. Of `world` processes each has the records that leave `rank`, and of those each
    worker its part; all of them together have every record of an epoch once. Other options are those of `holescout.Loader`.
    """

    def __init__(self, dataset: Dataset, *, seed: int = 0, rank: int = 0, world: int = 1, **options: Any) -> None:
        super().__init__()
        self.dataset = dataset
        self._share = (rank, world)
        self._options = {"seed": seed} | options
        self._epoch = 0

    def set_epoch(self, epoch: int) -> None:
        """The next iteration gives this epoch, from 0."""
        self._epoch = epoch

    def __iter__(self) -> Loader:
        rank, world = self._share
        worker = get_worker_info()
        if worker is not None:
            rank, world = rank * worker.num_workers + worker.id, world * worker.num_workers
        loader = Loader(self.dataset, rank=rank, world=world, epochs=self._epoch + 1, **self._options)
        loader.load_state_dict(loader.state_dict() | {"cursor": self._epoch * len(self.dataset)})
        return loader


class Encoder(torch.nn.Module):
    """I_A and I_B (the paper's equations 7 and 9) of compact observations, on the device of the module.

    `forward` takes tensors `map`, `rows`, `columns`, `rsrp_dbm` of a batch, and gives `(map, window)`, float32
    `[n, 3, rows, columns]`, as `Maps.encode(..., "paper")` does, up to rounding.
    """

    heights: torch.Tensor
    decay: torch.Tensor

    def __init__(self, maps: Maps) -> None:
        super().__init__()
        settings = maps.settings
        self.threshold_dbm: float = settings["hole_threshold_dbm"]
        self.cells, self.reach = maps.cells, maps.reach
        heights = np.stack([each.height_m for each in maps]) / np.float32(settings["height_scale_m"])
        away = np.arange(1 - maps.cells, maps.cells, dtype=np.float64)
        decay = np.exp2(-settings["encoding_decay"] * np.hypot(away[:, None], away[None, :]))
        self.register_buffer("heights", torch.from_numpy(heights), persistent=False)
        # Every distance along rows and columns, 0 in the middle.
        self.register_buffer("decay", torch.from_numpy(decay.astype(np.float32)), persistent=False)

    def forward(
        self, map: torch.Tensor, rows: torch.Tensor, columns: torch.Tensor, rsrp_dbm: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        count, n, device = len(map), self.cells, self.heights.device
        rows, columns = rows.to(device, torch.int64), columns.to(device, torch.int64)
        is_flown = rows >= 0
        last = is_flown.sum(dim=1) - 1
        axis = torch.arange(n, device=device)
        # [n, path, L, L]: the part of the table that is seen from each cell.
        shift = (n - 1 + axis - rows.clamp(min=0)[..., None])[..., :, None], (n - 1 + axis - columns.clamp(min=0)[..., None])[..., None, :]
        seen = self.decay[shift]
        levels = (rsrp_dbm.to(device, torch.float32) - self.threshold_dbm) / -self.threshold_dbm * is_flown
        batch = torch.arange(count, device=device)
        channels = [seen[batch, last], torch.einsum("nk,nkij->nij", levels, seen), self.heights[map.to(device, torch.int64)]]
        whole = torch.stack(channels, dim=1)
        # Beyond the map heights are the scale, encodings 0.
        beyond = torch.tensor([0.0, 0.0, 1.0], device=device)[:, None, None]
        padded = beyond.expand(count, 3, n + 2 * self.reach, n + 2 * self.reach).clone()
        padded[..., self.reach:self.reach + n, self.reach:self.reach + n] = whole
        side = torch.arange(2 * self.reach + 1, device=device)
        here = rows[batch, last], columns[batch, last]
        window = padded[batch[:, None, None], :, here[0][:, None, None] + side[:, None], here[1][:, None, None] + side[None, :]]
        return whole, window.permute(0, 3, 1, 2).contiguous()

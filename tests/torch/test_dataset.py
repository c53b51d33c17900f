"""`examples/torch_dataset.py`: every record once an epoch, however many workers and ranks there are.

HOLESCOUT names the program, HOLESCOUT_DATASET a dataset with a train and a val split of one shard each. They are copied under several names, for order to
mean something.
"""

import os
import shutil
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

sys.path[:0] = [str(Path(__file__).parents[2] / "examples"), str(Path(__file__).parents[1])]
import repeated_dataset  # noqa: E402
from read_shards import hole_probability, holes, records  # noqa: E402
from torch_dataset import Records  # noqa: E402

SHARDS = 6


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("dataset")
    (root / "train").mkdir()
    for number in range(SHARDS):
        split = ["train", "val"][number % 2]
        shutil.copy(
            Path(os.environ["HOLESCOUT_DATASET"]) / split / "shard-00000.msgpack.zst",
            root / f"train/shard-{number:05}.msgpack.zst",
        )
    return root


def expected(dataset: Path) -> Counter:
    return Counter(record["id"] for record in records(dataset, "train"))


def test_tensors_are_the_records_arrays(dataset: Path) -> None:
    stored = next(records(dataset, "train"))
    item = next(iter(Records(dataset)))
    assert item["id"] == stored["id"]
    assert item["maps"].dtype == torch.float32
    assert (item["maps"][0].numpy() == stored["height_m"]).all()
    assert (item["maps"][1].numpy() == stored["rsrp_dbm"]).all()
    assert (item["mask"].numpy() == stored["mask"]).all()
    assert (item["hole"].numpy() == holes(stored)).all()


def test_of_repeats_the_chance_of_a_hole_comes_along(tmp_path: Path) -> None:
    dataset = repeated_dataset.build(os.environ["HOLESCOUT"], tmp_path)
    stored = {record["id"]: record for record in records(dataset, "train")}
    assert {record["schema"] for record in stored.values()} == {"record.v1", "record.v2"}
    for batch in DataLoader(Records(dataset, threshold_dbm=-95.0), batch_size=2):
        for ident, hole, maps in zip(batch["id"], batch["hole"], batch["maps"], strict=True):
            assert np.allclose(hole.numpy(), hole_probability(stored[ident], -95.0), atol=1e-6)
            assert (maps[1].numpy() == stored[ident]["rsrp_dbm"]).all()
            is_unsure = ((hole > 0.05) & (hole < 0.95)).any()
            assert is_unsure == (stored[ident]["schema"] == "record.v2")


@pytest.mark.parametrize("workers", [0, 2])
@pytest.mark.parametrize("ranks", [1, 2])
def test_every_record_comes_once(dataset: Path, workers: int, ranks: int) -> None:
    found = Counter()
    for rank in range(ranks):
        loader = DataLoader(Records(dataset, rank=rank, ranks=ranks), batch_size=4, num_workers=workers)
        for batch in loader:
            assert batch["maps"].shape[1] == 2
            found.update(batch["id"])
    assert found == expected(dataset)


def order(dataset: Path, seed: int, epoch: int) -> list[str]:
    """Names of the shards in the order in which they are read."""
    split = Records(dataset, seed=seed)
    split.set_epoch(epoch)
    import torch_dataset

    read = []
    original = torch_dataset.records
    torch_dataset.records = lambda shard: read.append(shard.name) or original(shard)
    try:
        list(split)
    finally:
        torch_dataset.records = original
    return read


def test_the_order_depends_on_seed_and_epoch_only(dataset: Path) -> None:
    first = order(dataset, 0, 0)
    assert sorted(first) == sorted(path.name for path in (dataset / "train").iterdir())
    assert first == order(dataset, 0, 0)
    assert len({tuple(order(dataset, 0, epoch)) for epoch in range(4)}) == 4
    assert first != order(dataset, 1, 0)


def test_workers_that_live_on_follow_the_epoch(dataset: Path) -> None:
    loader = DataLoader(Records(dataset), batch_size=None, num_workers=1, persistent_workers=True)
    orders = []
    for epoch in range(4):
        loader.dataset.set_epoch(epoch)
        found = [item["id"] for item in loader]
        alone = Records(dataset)
        alone.set_epoch(epoch)
        assert found == [item["id"] for item in alone]
        orders.append(found)
    assert any(found != orders[0] for found in orders)

"""PyTorch's data loaders, with exact resume, and encodings on a device."""

import random
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader
from torchdata.stateful_dataloader import StatefulDataLoader

import holescout
from holescout.torch import Encoder, RecordStream


def names(batch: dict) -> list[str]:
    return batch["id"]


@pytest.mark.parametrize("workers", [0, 2])
def test_a_dataset_is_what_a_data_loader_takes(train: holescout.Dataset, workers: int) -> None:
    loader = DataLoader(train, batch_size=8, shuffle=True, num_workers=workers)  # type: ignore[arg-type]
    batches = list(loader)
    assert sorted(sum(map(names, batches), [])) == sorted(train.ids)
    assert batches[0]["rsrp_dbm"].shape == (8, 121, 121) and batches[0]["rsrp_dbm"].dtype == torch.float32


@pytest.mark.parametrize("workers", [0, 1, 3])
def test_a_stream_gives_an_epoch(train: holescout.Dataset, workers: int) -> None:
    stream = RecordStream(train, seed=3, threads=1)
    first = sum((names(batch) for batch in DataLoader(stream, batch_size=4, num_workers=workers)), [])
    stream.set_epoch(1)
    second = sum((names(batch) for batch in DataLoader(stream, batch_size=4, num_workers=workers)), [])
    assert sorted(first) == sorted(second) == sorted(train.ids) and first != second


def test_processes_with_workers_share_an_epoch(train: holescout.Dataset) -> None:
    found = []
    for rank in range(2):
        stream = RecordStream(train, seed=3, rank=rank, world=2, threads=1)
        found += sum((names(batch) for batch in DataLoader(stream, batch_size=4, num_workers=2)), [])
    assert sorted(found) == sorted(train.ids)


# Starting workers takes most of the time: many interruptions without them, fewer with.
@pytest.mark.parametrize(("workers", "interruptions"), [(0, 900), (1, 40), (2, 30), (3, 20), (4, 10)])
def test_interruptions_lose_and_repeat_nothing(train: holescout.Dataset, workers: int, interruptions: int) -> None:
    def fresh() -> StatefulDataLoader:
        return StatefulDataLoader(RecordStream(train, seed=1, threads=1), batch_size=3, num_workers=workers)

    whole = [names(batch) for batch in fresh()]
    draw, made = random.Random(workers), 0
    while made < interruptions:
        found: list[list[str]] = []
        state = None
        while True:
            loader = fresh()
            if state is not None:
                loader.load_state_dict(state)
            stop = draw.randrange(1, 12)
            for batch in loader:
                found.append(names(batch))
                stop -= 1
                if stop == 0:
                    break
            else:
                break
            state = loader.state_dict()
            made += 1
        assert found == whole


@pytest.mark.parametrize("settings", [{}, {"hole_threshold_dbm": -90.0, "reach_cells": 5, "encoding_decay": 0.3}])
def test_encodings_on_a_device_are_those_of_rust(sanjose: Path, settings: dict) -> None:
    train = holescout.Dataset(sanjose, "train")
    maps = holescout.Maps(train, ids=train.ids[:3], settings=settings)
    env = holescout.make_vec(maps, 16)
    env.action_space.seed(0)
    observations, _ = env.reset(seed=0)
    for _ in range(5):
        observations, *_ = env.step(env.action_space.sample())
    expected = maps.encode(observations)
    encoder = Encoder(maps)
    tensors = {name: torch.from_dlpack(observations[name]) for name in ("map", "rows", "columns", "rsrp_dbm")}
    whole, window = encoder(**tensors)
    np.testing.assert_allclose(whole.numpy(), expected["map"], atol=2e-6)
    np.testing.assert_allclose(window.numpy(), expected["window"], atol=2e-6)

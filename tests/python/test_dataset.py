"""Records as NumPy arrays, by position, by name and as a stream."""

import json
import multiprocessing
import pickle
import random
import shutil
import threading
from pathlib import Path

import numpy as np
import pytest
import read_shards

import holescout


def test_records_are_those_that_another_reader_reads(sanjose: Path) -> None:
    dataset = holescout.Dataset(sanjose)
    others = {record["id"]: record for record in read_shards.records(sanjose)}
    assert len(dataset) == len(others) == len(dataset.manifest["records"])
    for record in list(dataset)[::10]:
        other = others[record["id"]]
        for name in ("height_m", "mask"):
            np.testing.assert_array_equal(record[name], other[name])
        for name in ("rsrp_dbm", "std_error_db", "first_half_share"):
            np.testing.assert_allclose(record[name], other[name], atol=1e-4)
        assert {record[name].dtype.name for name in ("height_m", "rsrp_dbm")} == {"float32"}
        assert record["mask"].dtype == np.uint8 and record["height_m"].shape == (121, 121)
        np.testing.assert_allclose(record["base_station_m"], other["base_station"]["position_m"])


def test_a_record_has_a_position_and_a_name(train: holescout.Dataset) -> None:
    first, last = train[0], train[-1]
    assert (first["id"], last["id"]) == (train.ids[0], train.ids[-1])
    np.testing.assert_array_equal(train[train.ids[-1]]["rsrp_dbm"], last["rsrp_dbm"])
    with pytest.raises(IndexError):
        train[len(train)]
    first["height_m"][:] = 0.0
    assert train[0]["height_m"].max() > 0.0, "arrays are the caller's own"


def test_metadata_tell_where_a_record_is_from(train: holescout.Dataset) -> None:
    metadata = train.metadata(0)
    assert metadata["id"] == train.ids[0] and metadata["provenance"]["licence"] == "ODbL-1.0"
    assert "height_m" not in metadata and metadata["repeats"] >= 2


def test_datasets_pickle_by_where_they_are(train: holescout.Dataset) -> None:
    again = pickle.loads(pickle.dumps(train))
    assert (again.ids, again.sha256, again.split) == (train.ids, train.sha256, "train")


def test_what_is_not_there_is_an_error_with_a_code(tmp_path: Path, train: holescout.Dataset) -> None:
    with pytest.raises(holescout.InvalidInput, match="manifest.json") as caught:
        holescout.Dataset(tmp_path)
    assert caught.value.code == 3 and isinstance(caught.value, ValueError)
    with pytest.raises(holescout.InvalidInput, match="utm10n_e1_n1"):
        train["utm10n_e1_n1"]
    with pytest.raises(holescout.InvalidInput, match="train, val or test"):
        holescout.Dataset(train.location, "training")  # type: ignore[arg-type]
    with pytest.raises(holescout.InvalidInput) as caught:
        holescout.Dataset(train.location, remote={"cache_mb": 0})
    assert (caught.value.found, caught.value.expected) == ("0", "1 to 1000000000")


@pytest.fixture
def damaged(tmp_path: Path, sanjose: Path) -> holescout.Dataset:
    """A copy with a bit turned in the middle of a shard of train."""
    shutil.copytree(sanjose, tmp_path / "copy")
    shard = sorted((tmp_path / "copy" / "train").iterdir())[0]
    data = bytearray(shard.read_bytes())
    data[len(data) // 2] ^= 1
    shard.write_bytes(data)
    return holescout.Dataset(tmp_path / "copy", "train")


def test_damage_is_found_and_may_be_left_out(damaged: holescout.Dataset) -> None:
    bad = []
    for name in damaged.ids:
        try:
            damaged[name]
        except holescout.InvalidInput as error:
            assert "train" in str(error) and "frame" in str(error)
            bad.append(name)
    assert len(bad) == 1
    with pytest.raises(holescout.InvalidInput):
        list(damaged.loader(epochs=1))
    loader = damaged.loader(epochs=1, leave_out_damaged=True)
    assert {record["id"] for record in loader} == set(damaged.ids) - set(bad)
    assert list(loader.damaged) == bad


def test_epochs_have_every_record_once_in_another_order(train: holescout.Dataset) -> None:
    loader = train.loader(seed=5, epochs=2, threads=2)
    names = [record["id"] for record in loader]
    first, second = names[: len(train)], names[len(train):]
    assert sorted(first) == sorted(second) == sorted(train.ids) and first != second
    assert [record["id"] for record in train.loader(seed=5, epochs=1, threads=1)] == first


@pytest.mark.parametrize("world", [1, 3])
def test_processes_share_an_epoch(train: holescout.Dataset, world: int) -> None:
    parts = [[record["id"] for record in train.loader(seed=1, rank=rank, world=world, epochs=1)] for rank in range(world)]
    assert sorted(sum(parts, [])) == sorted(train.ids)
    assert max(map(len, parts)) - min(map(len, parts)) <= 1
    with pytest.raises(holescout.InvalidInput, match="below world"):
        next(train.loader(rank=world, world=world))


def test_an_interrupted_stream_goes_on_exactly(train: holescout.Dataset) -> None:
    whole = [record["id"] for record in train.loader(seed=9, epochs=2)]
    draw = random.Random(0)
    for _ in range(40):
        names, state = [], train.loader(seed=9, epochs=2).state_dict()
        while len(names) < len(whole):
            loader = train.loader(seed=9, epochs=2, threads=draw.choice([1, 2]))
            loader.load_state_dict(json.loads(json.dumps(state)))
            names += [record["id"] for _, record in zip(range(draw.randrange(40)), loader)]
            state = loader.state_dict()
        assert names == whole


def test_a_state_of_another_stream_is_refused(train: holescout.Dataset) -> None:
    state = train.loader(seed=1).state_dict()
    with pytest.raises(holescout.InvalidInput, match="seed is 1, expected 2"):
        train.loader(seed=2).load_state_dict(state)


def test_a_stream_needs_a_split(sanjose: Path) -> None:
    with pytest.raises(holescout.InvalidInput, match="one split"):
        holescout.Dataset(sanjose).loader()


def _names(loader: holescout.Loader, queue: "multiprocessing.Queue[list[str]]") -> None:
    queue.put([record["id"] for record in loader])


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_streams_go_on_in_other_processes(train: holescout.Dataset, method: str) -> None:
    whole = [record["id"] for record in train.loader(epochs=1)]
    loader = train.loader(epochs=1)
    begun = [next(loader)["id"] for _ in range(10)]
    context = multiprocessing.get_context(method)
    queue = context.Queue()
    process = context.Process(target=_names, args=(loader, queue))
    process.start()
    rest = queue.get(timeout=60)
    process.join()
    assert begun + rest == whole
    assert begun + [record["id"] for record in loader] == whole, "the parent's goes on too"


def test_threads_share_a_dataset(train: holescout.Dataset) -> None:
    found: list[int] = []

    def read() -> None:
        found.append(sum(record["mask"].size for record in train))

    threads = [threading.Thread(target=read) for _ in range(4)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    assert found == [len(train) * 121 * 121] * 4

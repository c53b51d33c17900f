"""How WebDataset, MosaicML Streaming and LitData store and load the records of a split.

Each peer is written by its own writer and yields `(id, height_m, rsrp_dbm, mask)` in an order of its own shuffle. The rest of a
record is stored beside the arrays and left packed. `raw` is what someone who looks for speed would do: one member or column with
all bytes of a record, and views of it in place of copies. `zstd` compresses each record like our shards do.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import litdata
import numpy as np
import streaming
import webdataset as wds
import zstandard
from litdata.streaming.writer import BinaryWriter
from torch.utils.data import DataLoader

RECORDS_PER_SHARD = 256  # as in our datasets
MDS_SHARD_BYTES = 1 << 26  # the default of MosaicML
SHUFFLE_BUFFER = 1000
BATCH = 64
ZSTD_LEVEL = 9  # as in our datasets
HASH = "xxh64"  # the fastest that MosaicML offers

Sample = tuple[str, np.ndarray, np.ndarray, np.ndarray]
Epoch = Callable[[], Iterator[Sample]]


class Record(NamedTuple):
    """A record of a shard: what the peers store."""

    ident: str
    height_m: np.ndarray
    rsrp_dbm: np.ndarray
    mask: np.ndarray
    rest: bytes

    def raw(self) -> bytes:
        return b"".join((self.height_m.tobytes(), self.rsrp_dbm.tobytes(), self.mask.tobytes(), self.rest))


def views(data: bytes, cells: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The arrays of `Record.raw`, without a copy."""
    count, shape = cells * cells, (cells, cells)
    return (
        np.frombuffer(data, np.float32, count).reshape(shape),
        np.frombuffer(data, np.float32, count, 4 * count).reshape(shape),
        np.frombuffer(data, np.uint8, count, 8 * count).reshape(shape),
    )


@dataclass(frozen=True)
class Peer:
    """A way to store and to load records."""

    name: str
    write: Callable[[list[Record], Path], None]
    # Opens what was written, for arrays of so many rows; what it returns begins an epoch.
    open: Callable[[Path, int], Epoch]
    # Decoded samples are kept in memory after the first epoch.
    in_memory: bool = False
    # More than one is shown, but not compared with.
    processes: int = 1
    # Back to what was written, before each run.
    prepare: Callable[[Path], None] = lambda folder: None


# WebDataset ---------------------------------------------------------------------------------------------------------------


def write_tars(members: Callable[[Record], dict], records: list[Record], folder: Path) -> None:
    """The time of a member that is a fraction would need a header of its own, which doubles the headers to read."""
    folder.mkdir()
    with wds.ShardWriter(f"{folder}/%05d.tar", maxcount=RECORDS_PER_SHARD, verbose=0, mtime=0) as writer:
        for record in records:
            writer.write({"__key__": record.ident, **members(record)})


def npy_members(record: Record) -> dict:
    arrays = {f"{name}.npy": getattr(record, name) for name in ("height_m", "rsrp_dbm", "mask")}
    return {**arrays, "rest.bin": record.rest}


def tenbin_members(record: Record) -> dict:
    return {"ten": [record.height_m, record.rsrp_dbm, record.mask, np.frombuffer(record.rest, np.uint8)]}


def raw_members(record: Record) -> dict:
    return {"raw": record.raw()}


def zstd_members(record: Record) -> dict:
    compressor = zstandard.ZstdCompressor(level=ZSTD_LEVEL, write_checksum=True)
    return {"zst": compressor.compress(record.raw())}


def tars(folder: Path) -> wds.WebDataset:
    """Shuffled before decoding, as the documentation has it."""
    names = sorted(str(path) for path in folder.glob("*.tar"))
    return wds.WebDataset(names, shardshuffle=len(names), empty_check=False).shuffle(SHUFFLE_BUFFER)


def open_npy(folder: Path, _: int) -> Epoch:
    names = ("__key__", "height_m.npy", "rsrp_dbm.npy", "mask.npy")
    return tars(folder).decode().to_tuple(*names).__iter__


def open_tenbin(folder: Path, _: int) -> Epoch:
    return tars(folder).decode().map(lambda sample: (sample["__key__"], *sample["ten"][:3])).__iter__


def open_raw(folder: Path, cells: int) -> Epoch:
    return tars(folder).map(lambda sample: (sample["__key__"], *views(sample["raw"], cells))).__iter__


def open_zstd(folder: Path, cells: int) -> Epoch:
    decompress = zstandard.ZstdDecompressor().decompress  # which checks the checksum
    return tars(folder).map(lambda sample: (sample["__key__"], *views(decompress(sample["zst"]), cells))).__iter__


def open_cached(folder: Path, cells: int) -> Epoch:
    names = sorted(str(path) for path in folder.glob("*.tar"))
    samples = wds.WebDataset(names, shardshuffle=len(names), empty_check=False)
    decoded = samples.map(lambda sample: (sample["__key__"], *views(sample["raw"], cells)))
    return decoded.compose(wds.Cached()).shuffle(SHUFFLE_BUFFER).__iter__


def open_tars_with_workers(folder: Path, cells: int) -> Epoch:
    samples = tars(folder).map(lambda sample: (sample["__key__"], *views(sample["raw"], cells))).batched(BATCH)
    loader = DataLoader(samples, batch_size=None, num_workers=2, persistent_workers=True)

    def epoch() -> Iterator[Sample]:
        for ids, *tensors in loader:
            yield from zip(ids, *(tensor.numpy() for tensor in tensors), strict=True)

    return epoch


# MosaicML Streaming -------------------------------------------------------------------------------------------------------


def write_mds(raw: bool, compression: str | None, records: list[Record], folder: Path) -> None:
    cells = len(records[0].mask)
    if raw:
        columns = {"id": "str", "raw": "bytes"}
    else:
        shape = f"{cells},{cells}"
        columns = {"id": "str", "height_m": f"ndarray:float32:{shape}", "rsrp_dbm": f"ndarray:float32:{shape}"}
        columns |= {"mask": f"ndarray:uint8:{shape}", "rest": "bytes"}
    options = {"compression": compression, "hashes": [HASH], "size_limit": MDS_SHARD_BYTES}
    with streaming.MDSWriter(out=str(folder), columns=columns, **options) as writer:
        for record in records:
            fields = {"raw": record.raw()} if raw else record._asdict()
            writer.write({name: record.ident if name == "id" else fields[name] for name in columns})


def streaming_dataset(folder: Path) -> streaming.StreamingDataset:
    """All shards may be prepared at once: they are local, and the threads that would wait for them compete with the reader."""
    return streaming.StreamingDataset(
        local=str(folder), shuffle=True, batch_size=BATCH, predownload=1 << 30, num_canonical_nodes=1,
        keep_zip=True, validate_hash=HASH,
    )


def arrays_of(sample: dict) -> Sample:
    return sample["id"], sample["height_m"], sample["rsrp_dbm"], sample["mask"]


def open_streaming(folder: Path, _: int) -> Epoch:
    dataset = streaming_dataset(folder)
    return lambda: map(arrays_of, dataset)


def open_streaming_raw(folder: Path, cells: int) -> Epoch:
    dataset = streaming_dataset(folder)
    return lambda: ((sample["id"], *views(sample["raw"], cells)) for sample in dataset)


def permuted(dataset: streaming.LocalDataset) -> Iterator[dict]:
    """`LocalDataset` has no shuffle: PyTorch's sampler would give it one like this."""
    return map(dataset.get_item, np.random.permutation(len(dataset)).tolist())


def open_local(folder: Path, _: int) -> Epoch:
    dataset = streaming.LocalDataset(str(folder))
    return lambda: map(arrays_of, permuted(dataset))


def open_local_raw(folder: Path, cells: int) -> Epoch:
    dataset = streaming.LocalDataset(str(folder))
    return lambda: ((sample["id"], *views(sample["raw"], cells)) for sample in permuted(dataset))


def open_streaming_with_workers(folder: Path, _: int) -> Epoch:
    dataset = streaming_dataset(folder)

    def collate(samples: list[dict]) -> list:
        ids, *arrays = zip(*map(arrays_of, samples), strict=True)
        return [ids, *map(np.stack, arrays)]

    loader = DataLoader(dataset, BATCH, num_workers=2, persistent_workers=True, collate_fn=collate)

    def epoch() -> Iterator[Sample]:
        for columns in loader:
            yield from zip(*columns, strict=True)

    return epoch


def forget_decompressed(folder: Path) -> None:
    for path in folder.glob("*.mds"):
        path.unlink()


# LitData ------------------------------------------------------------------------------------------------------------------


def write_chunks(records: list[Record], folder: Path) -> None:
    """Its chunks have no checksums; the writer that runs without its worker processes does not compress them."""
    folder.mkdir()
    writer = BinaryWriter(str(folder), chunk_bytes=MDS_SHARD_BYTES)
    for number, record in enumerate(records):
        writer[number] = {"id": record.ident, "raw": record.raw()}
    writer.done()
    writer.merge()


def open_chunks(folder: Path, cells: int) -> Epoch:
    dataset = litdata.StreamingDataset(str(folder), shuffle=True)
    return lambda: ((sample["id"], *views(sample["raw"], cells)) for sample in dataset)


PEERS = (
    Peer("WebDataset, .npy members", partial(write_tars, npy_members), open_npy),
    Peer("WebDataset, tenbin", partial(write_tars, tenbin_members), open_tenbin),
    Peer("WebDataset, raw", partial(write_tars, raw_members), open_raw),
    Peer("WebDataset, raw, zstd with checksums", partial(write_tars, zstd_members), open_zstd),
    Peer("MosaicML StreamingDataset, ndarray", partial(write_mds, False, None), open_streaming),
    Peer("MosaicML StreamingDataset, raw", partial(write_mds, True, None), open_streaming_raw),
    Peer("MosaicML StreamingDataset, raw, zstd shards with hashes", partial(write_mds, True, f"zstd:{ZSTD_LEVEL}"),
         open_streaming_raw, prepare=forget_decompressed),
    Peer("MosaicML LocalDataset, ndarray", partial(write_mds, False, None), open_local),
    Peer("MosaicML LocalDataset, raw", partial(write_mds, True, None), open_local_raw),
    Peer("LitData, raw", write_chunks, open_chunks),
    Peer("WebDataset, raw, kept in memory", partial(write_tars, raw_members), open_cached, in_memory=True),
    Peer("WebDataset, raw, 2 workers", partial(write_tars, raw_members), open_tars_with_workers, processes=3),
    Peer("MosaicML StreamingDataset, ndarray, 2 workers", partial(write_mds, False, None), open_streaming_with_workers,
         processes=3),
)

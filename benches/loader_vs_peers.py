"""Samples per second of our loader against WebDataset, MosaicML Streaming and LitData, side by side.

All load the same records, written by their own writers, each shuffled in its own way; see loader_peers.py. Every one has a fresh
process for each run, on the same cores; imports are not timed. The consumer reads the middle element of each array.

- cold: one epoch from before the dataset is opened, its files dropped from the page cache (of this machine: a host below it may
  still hold them). "read" is what the system read from disk meanwhile.
- first: the same with a warm page cache. Our loader decompresses and checks every record here.
- later: the median of the epochs after it, in the same process.

Figures are medians over rounds, in which the contestants take turns. HOLESCOUT_DATASET names the dataset, LOADER_BENCH a program
that takes DATASET SPLIT --epochs N --threads T [--memory-mb M], measures the same and prints {"samples": .., "first_sample_s": ..,
"epoch_s": [..], "samples_per_s": .., "threads": .., "in_memory": ..}; the first of epoch_s counts from before the dataset
is opened. MosaicML needs PyTorch, see loader-requirements.txt. "Holescout from Python" is `holescout.Dataset(...).loader()` of the package.
"""

import argparse
import atexit
import contextlib
import cProfile
import gc
import io
import json
import multiprocessing
import os
import pstats
import resource
import statistics
import subprocess
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import holescout
import msgpack
import numpy as np
import zstandard
from loader_peers import PEERS, Peer, Record

ARRAYS = ("height_m", "rsrp_dbm", "mask")
FORK = multiprocessing.get_context("fork")


@dataclass
class Run:
    """What one process measured."""

    samples: int
    first_sample_s: float
    epoch_s: list[float]
    in_memory: bool
    read_bytes: int = 0


# By contestant, and whether the page cache was cold.
Runs = dict[tuple[str, bool], list[Run]]


@dataclass
class Contestant:
    """Someone who loads the records; `run` takes a number of epochs."""

    name: str
    folder: Path  # all that is read
    records: Path  # the records alone, for their size
    run: Callable[[int], Run]
    prepare: Callable[[], None] = lambda: None
    ours: bool = False
    processes: int = 1


def read_records(dataset: Path, split: str) -> list[Record]:
    """All records of a split."""
    records = []
    for shard in sorted((dataset / split).glob("shard-*.msgpack.zst")):
        with open(shard, "rb") as file:
            stream = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
            for record in msgpack.Unpacker(stream, max_buffer_size=2**28):
                arrays = {name: np.load(io.BytesIO(record.pop(name))) for name in ARRAYS}
                records.append(Record(record["id"], **arrays, rest=msgpack.packb(record)))
    assert records, f"{dataset}: no records in split {split}"
    return records


def check(peer: Peer, folder: Path, records: list[Record]) -> None:
    """Two epochs have every record once, with its arrays, in different orders."""
    expected = {record.ident: record for record in records}
    epoch, orders = peer.open(folder, len(records[0].mask)), []
    for _ in range(2):
        orders.append([])
        for ident, *arrays in epoch():
            orders[-1].append(str(ident))
            for name, array in zip(ARRAYS, arrays, strict=True):
                wanted = getattr(expected[str(ident)], name)
                assert array.dtype == wanted.dtype and np.array_equal(array, wanted), (ident, name)
        assert sorted(orders[-1]) == sorted(expected), "an epoch must have every record once"
    assert orders[0] != orders[1] != list(expected), "epochs must be shuffled"


def measure(peer: Peer, folder: Path, cells: int, epochs: int) -> Run:
    """Some epochs of a peer, in this process."""
    middle = (cells // 2, cells // 2)
    first, ends, samples = 0.0, [time.perf_counter()], 0
    epoch = peer.open(folder, cells)
    for _ in range(epochs):
        for _, height, rsrp, mask in epoch():
            height[middle], rsrp[middle], mask[middle]  # noqa: B018
            if not samples:
                first = time.perf_counter() - ends[0]
            samples += 1
        ends.append(time.perf_counter())
    return Run(samples, first, np.diff(ends).tolist(), peer.in_memory)


def in_child(work: Callable, *arguments: object) -> Any:
    """In a process of its own that has all modules already."""
    here, there = FORK.Pipe()

    def child() -> None:
        # MosaicML frees its shared memory when the interpreter ends, which that of a forked process does not.
        with contextlib.ExitStack() as at_exit:
            atexit.register = at_exit.callback
            there.send(work(*arguments))

    # Otherwise some children, always the same, would collect the garbage of all imported modules in the time that is measured.
    gc.collect()
    gc.freeze()
    process = FORK.Process(target=child)
    process.start()
    there.close()
    found = here.recv()
    process.join()
    return found


def run_ours(dataset: Path, split: str, threads: int, memory_mb: int | None, epochs: int) -> Run:
    """One run of the program."""
    command = [os.environ["LOADER_BENCH"], str(dataset), split, "--epochs", str(epochs), "--threads", str(threads)]
    command += [] if memory_mb is None else ["--memory-mb", str(memory_mb)]
    found = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
    return Run(found["samples"], found["first_sample_s"], found["epoch_s"], found["in_memory"])


def run_package(dataset: Path, split: str, threads: int, epochs: int) -> Run:
    """One run of the package for Python, in this process; nothing is kept decoded."""
    first, ends, samples = 0.0, [time.perf_counter()], 0
    opened = holescout.Dataset(dataset, split)
    loader = opened.loader(threads=threads)
    for _ in range(epochs):
        for _, record in zip(range(len(opened)), loader, strict=False):
            middle = record["mask"].shape[0] // 2, record["mask"].shape[1] // 2
            record["height_m"][middle], record["rsrp_dbm"][middle], record["mask"][middle]  # noqa: B018
            if not samples:
                first = time.perf_counter() - ends[0]
            samples += 1
        ends.append(time.perf_counter())
    return Run(samples, first, np.diff(ends).tolist(), in_memory=False)


def forget(folder: Path) -> None:
    """Drops a folder's files from the page cache."""
    for path in folder.rglob("*"):
        if path.is_file():
            file = os.open(path, os.O_RDONLY)
            os.fsync(file)
            os.posix_fadvise(file, 0, 0, os.POSIX_FADV_DONTNEED)
            os.close(file)


def warm(folder: Path) -> None:
    for path in folder.rglob("*"):
        if path.is_file():
            path.read_bytes()


def run(contestant: Contestant, cold: bool, epochs: int) -> Run:
    contestant.prepare()
    (forget if cold else warm)(contestant.folder)
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_inblock
    found = contestant.run(epochs)
    found.read_bytes = 512 * (resource.getrusage(resource.RUSAGE_CHILDREN).ru_inblock - before)
    return found


def size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def profile(peer: Peer, folder: Path, cells: int, epochs: int) -> None:
    """Where a peer's time goes."""
    peer.prepare(folder)
    profiler = cProfile.Profile()
    profiler.runcall(measure, peer, folder, cells, epochs)
    print(f"\n{peer.name}", flush=True)
    pstats.Stats(profiler).sort_stats("tottime").print_stats(12)


def cpu() -> str:
    """The CPU's name."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else "unknown CPU"


def rates(runs: list[Run], samples: int, later: bool) -> list[float]:
    """Samples per second of each run's first epoch, or of those after it."""
    return [samples / (statistics.median(run.epoch_s[1:]) if later else run.epoch_s[0]) for run in runs]


def median(values: list[float]) -> str:
    return f"{statistics.median(values):,.0f} ({min(values):,.0f} to {max(values):,.0f})"


def rows(contestants: list[Contestant], runs: Runs, samples: int) -> None:
    """Medians as a table."""
    print("\n| samples/s, median (range) | bytes a sample | cold | read, MB | first | later | first sample, ms, cold · warm |")
    print("|---|---|---|---|---|---|---|")
    for one in contestants:
        cold, warm = runs[one.name, True], runs[one.name, False]
        read = statistics.median(run.read_bytes for run in cold) / 1e6
        first = " · ".join(f"{1e3 * statistics.median(run.first_sample_s for run in some):.1f}" for some in (cold, warm))
        one.prepare()
        figures = [f"{size(one.records) / samples:,.0f}", median(rates(cold, samples, False)), f"{read:.1f}"]
        figures += [median(rates(warm, samples, later)) for later in (False, True)]
        print(f"| {one.name} | {' | '.join(figures)} | {first} |")


def ratios(contestants: list[Contestant], runs: Runs, samples: int) -> None:
    """How many times as fast we are as the fastest of one process; medians over the turns."""
    for ours in (one for one in contestants if one.ours):
        how = "keeps decoded records in memory" if runs[ours.name, False][0].in_memory else "decodes every time"
        print(f"\n{ours.name} ({how}), against the fastest of one process:")
        for what, cold, later in (("cold", True, False), ("first", False, False), ("later", False, True)):
            for in_memory in (False, True) if later else (False,):
                rivals = {one.name: rates(runs[one.name, cold], samples, later) for one in contestants
                          if not one.ours and one.processes == 1 and runs[one.name, False][0].in_memory == in_memory}
                if rivals:
                    best = max(rivals, key=lambda name, rates=rivals: statistics.median(rates[name]))
                    turns = zip(rates(runs[ours.name, cold], samples, later), rivals[best], strict=True)
                    print(f"- {what}: {statistics.median(own / other for own, other in turns):.2f} × {best}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--split", default="train")
    parser.add_argument("--rounds", type=int, default=5, help="runs of each contestant, cold and warm")
    parser.add_argument("--epochs", type=int, default=20, help="of a warm run")
    parser.add_argument("--cores", type=int, default=2, help="for everyone, and threads of our loader")
    parser.add_argument("--memory-mb", type=int, action="append", help="of our loader; each makes a contestant")
    parser.add_argument("--only", default="", help="peers whose name has this in it")
    parser.add_argument("--peers-only", action="store_true", help="without LOADER_BENCH")
    parser.add_argument("--copies", type=int, default=1, help="of each record, for peers only: what longer epochs would do")
    parser.add_argument("--profile", action="store_true", help="show where the peers' time goes instead")
    options = parser.parse_args()
    if options.copies > 1 and not options.peers_only:
        parser.error("--copies needs --peers-only: our dataset has each record once")
    dataset = Path(os.environ["HOLESCOUT_DATASET"])
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: options.cores])
    cores = len(os.sched_getaffinity(0))
    warnings.filterwarnings("ignore", message=".*not writable.*")

    records = read_records(dataset, options.split)
    records = [one._replace(ident=f"{one.ident}-{copy}") for copy in range(options.copies) for one in records]
    cells = len(records[0].mask)
    with tempfile.TemporaryDirectory() as name:
        tempfile.tempdir = name  # where MosaicML leaves its locks
        contestants: list[Contestant] = []
        if not options.peers_only:
            for memory in options.memory_mb or [None]:
                work = partial(run_ours, dataset, options.split, cores, memory)
                label = "Holescout" if memory is None else f"Holescout, {memory} MB"
                contestants.append(Contestant(label, dataset, dataset / options.split, work, ours=True))
            work = partial(in_child, run_package, dataset, options.split, cores)
            contestants.append(Contestant("Holescout from Python", dataset, dataset / options.split, work, ours=True))
        for number, peer in enumerate(peer for peer in PEERS if options.only in peer.name):
            folder = Path(name) / str(number)
            peer.write(records, folder)
            in_child(partial(check, peer, folder, records))
            if options.profile:
                in_child(partial(profile, peer, folder, cells, options.epochs))
                continue
            work = partial(in_child, measure, peer, folder, cells)
            contestants.append(
                Contestant(peer.name, folder, folder, work, partial(peer.prepare, folder), processes=peer.processes)
            )
        if options.profile:
            return
        runs: Runs = {(one.name, cold): [] for one in contestants for cold in (True, False)}
        for turn in range(options.rounds):
            first = turn % len(contestants)
            for one in contestants[first:] + contestants[:first]:
                for cold in (True, False):
                    found = run(one, cold, 1 if cold else 1 + options.epochs)
                    assert found.samples == len(records) * len(found.epoch_s), f"{one.name}: an epoch lacks records"
                    runs[one.name, cold].append(found)
        decoded = sum(getattr(records[0], name).nbytes for name in ARRAYS)
        print(f"{cpu()}, {cores} cores; {len(records)} records of {cells} × {cells} cells, {decoded:,} bytes of arrays each; "
              f"{options.rounds} rounds, {options.epochs} later epochs")
        rows(contestants, runs, len(records))
        ratios(contestants, runs, len(records))


if __name__ == "__main__":
    main()

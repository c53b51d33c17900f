"""Training samples per second: Holescout against two programs in PyTorch, side by side.

All learn the same task from the same dataset with the same network, batches of 64 and a step of 64 episodes for
each update; exploration is as at its end (5 %).

- plain: as one would write it after CleanRL's dqn.py, see peer_plain.py.
- tuned: with nearly all that Holescout does, as a specialist would write it, see peer_tuned.py.

Each peer has a process of its own; all are warmed up, and take turns. HOLESCOUT_DATASET names the dataset,
TRAIN_BENCH a program that takes DATASET SECONDS, measures the same and prints
{"full_samples_per_s": .., "update_samples_per_s": ..}; ENCODE_STATES the built example of that name, for a check.
Ratios are medians over the turns. OMP_WAIT_POLICY=passive (for all of them) steadies the figures on a busy machine.
"""

import argparse
import json
import multiprocessing
import os
import statistics
import subprocess
import time
from collections.abc import Callable
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path

import torch
from peer_checks import check
from peer_plain import Plain
from peer_task import BATCH, load_maps
from peer_tuned import Tuned

KINDS = ("full", "update")
HOLESCOUT, PLAIN, TUNED = "Holescout", "PyTorch, plain", "PyTorch, tuned"
Rates = dict[str, float]


def rate(step: Callable[[], None], seconds: float) -> float:
    """Samples per second."""
    start, updates = time.perf_counter(), 0
    while (elapsed := time.perf_counter() - start) < seconds:
        step()
        updates += 1
    return updates * BATCH / elapsed


def serve(name: str, dataset: Path, memory: int, connection: Connection) -> None:
    """A peer's process: measures for so many seconds whenever it is told to."""
    torch.set_num_threads(threads())
    maps = load_maps(dataset)
    peer = Plain(maps, memory) if name == PLAIN else Tuned(maps)
    for _ in range(3):
        peer.pass_()
    replay = peer.replay.size if isinstance(peer, Plain) else peer.replay.capacity
    connection.send(f"{name}: replay of {replay:,} transitions")
    while seconds := connection.recv():
        peer.pass_()
        connection.send({"full": rate(peer.pass_, seconds), "update": rate(peer.update, seconds)})


def run_holescout(dataset: Path, seconds: float) -> Rates:
    """One run of the program."""
    command = [os.environ["TRAIN_BENCH"], str(dataset), str(seconds)]
    found = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
    return {kind: found[f"{kind}_samples_per_s"] for kind in KINDS}


def run_peer(connection: Connection, seconds: float) -> Rates:
    """One turn of a peer."""
    connection.send(seconds)
    return connection.recv()


def threads() -> int:
    """Cores that may be used."""
    return len(os.sched_getaffinity(0))


def cpu() -> str:
    """The CPU's name."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else "unknown CPU"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement")
    parser.add_argument("--repetitions", type=int, default=5, help="turns of each contestant")
    parser.add_argument("--memory-gb", type=float, default=4.0, help="of the plain peer's replay")
    options = parser.parse_args()
    dataset, memory = Path(os.environ["HOLESCOUT_DATASET"]), int(options.memory_gb * 1e9)
    torch.set_num_threads(threads())
    maps = load_maps(dataset)
    check(dataset, maps)

    # NumPy's threads must not compete with PyTorch's for the cores: its products here are small. Freed memory is kept, as
    # Holescout does; otherwise large tensors are had from the system page by page.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("MALLOC_MMAP_THRESHOLD_", str(1 << 30))
    os.environ.setdefault("MALLOC_TRIM_THRESHOLD_", str(1 << 33))
    context = multiprocessing.get_context("spawn")
    works: dict[str, Callable[[float], Rates]] = {}
    if "TRAIN_BENCH" in os.environ:
        works[HOLESCOUT] = partial(run_holescout, dataset)
    else:
        print("TRAIN_BENCH is not set: the peers are measured without Holescout")
    connections = []
    for name in (PLAIN, TUNED):
        here, there = context.Pipe()
        context.Process(target=serve, args=(name, dataset, memory, there), daemon=True).start()
        print(here.recv())
        connections.append(here)
        works[name] = partial(run_peer, here)
    rates: dict[str, list[Rates]] = {name: [] for name in works}
    for turn in range(options.repetitions):
        names = list(works)
        for name in names[turn % len(names):] + names[:turn % len(names)]:
            rates[name].append(works[name](options.seconds))
    for here in connections:
        here.send(None)

    print(f"{cpu()}, {threads()} threads; {len(maps.starts)} maps of {dataset.name}; training samples/s, "
          f"median (range) of {options.repetitions} turns of {options.seconds:g} s")
    print(f"{'':<16} {'full loop':>24} {'':8} {'update alone':>24}")
    first = next(iter(works))
    for name in works:
        line = f"{name:<16}"
        for kind in KINDS:
            values = [one[kind] for one in rates[name]]
            turns = zip(rates[first], rates[name], strict=True)
            ratio = statistics.median(ours[kind] / one[kind] for ours, one in turns)
            spread = f"({min(values):.0f} to {max(values):.0f})"
            line += f" {statistics.median(values):7.0f} {spread:<16} {ratio:5.2f} ×  "
        print(line.rstrip())
    print(f"×: how many times as fast {first} is")


if __name__ == "__main__":
    main()

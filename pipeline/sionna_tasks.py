"""Tracing in parts: which of the scenes fall to a run, and how runs that fill one directory keep apart.

Flags, environment variables and exit codes are those of `holescout` (docs/CLUSTERS.md).
"""

import argparse
import contextlib
import fcntl
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from sionna_files import InvalidInput

PART = ".part"
# What tells the engine of a cluster that trying again cannot help.
PERMANENT = 42
INDEX_VARIABLES = ("SLURM_ARRAY_TASK_ID", "JOB_COMPLETION_INDEX", "AWS_BATCH_JOB_ARRAY_INDEX")
COUNT_VARIABLES = ("SLURM_ARRAY_TASK_COUNT", "AWS_BATCH_JOB_ARRAY_SIZE")


class Busy(InvalidInput):
    """Another run writes to the directory."""


@dataclass(frozen=True)
class Task:
    """Task `index` of 0 to `count` - 1; it traces every `count`-th scene."""

    index: int
    count: int

    def __str__(self) -> str:
        return f"task-{self.index}-of-{self.count}"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The flags of a run that is one of several."""
    group = parser.add_argument_group("tracing in parts (docs/CLUSTERS.md)")
    group.add_argument("--task-index", type=int, metavar="I",
                       help=f"trace only what falls to this task, from 0 [{', '.join(INDEX_VARIABLES)}]")
    group.add_argument("--task-count", metavar="N",
                       help=f"number of tasks that fill MAPS together; auto takes {' or '.join(COUNT_VARIABLES)}")
    group.add_argument("--merge", action="store_true", help="only see whether the tasks have traced every scene")


def task_of(parsed: argparse.Namespace) -> Task | None:
    """The task that the arguments and, with --task-count, the environment name; None for a run of all scenes.

    Raises ValueError with what is wrong.
    """
    if parsed.task_count is None:
        if parsed.merge or parsed.task_index is not None:
            raise ValueError("--task-index and --merge need --task-count")
        return None
    if parsed.overwrite:
        raise ValueError("--overwrite cannot be used with --task-count: remove MAPS before the first task")
    is_auto = parsed.task_count == "auto"
    count = number(COUNT_VARIABLES, "--task-count N") if is_auto else whole(parsed.task_count, "--task-count")
    if count < 1:
        raise ValueError(f"--task-count {count}: expected 1 or more")
    if parsed.merge:
        if parsed.task_index is not None:
            raise ValueError("--merge is about all tasks: leave out --task-index")
        return None
    index = number(INDEX_VARIABLES, "--task-index") if parsed.task_index is None else parsed.task_index
    if not 0 <= index < count:
        raise ValueError(f"task {index} of {count}: tasks are counted from 0 to {count - 1}")
    return Task(index, count)


def number(names: tuple[str, ...], flag: str) -> int:
    """The first of some environment variables that is set."""
    found = next((name for name in names if name in os.environ), None)
    if found is None:
        raise ValueError(f"{flag} is not given, and none of {', '.join(names)} is set")
    return whole(os.environ[found], found)


def whole(text: str, name: str) -> int:
    """A whole number that was given as `name`."""
    try:
        return int(text)
    except ValueError:
        raise ValueError(f"{name} is {text!r}, expected a number") from None


def part_suffix(task: Task | None) -> str:
    """What the names of half-written maps end in: tasks have names of their own."""
    return f".{task}{PART}" if task else PART


@contextlib.contextmanager
def locked(folder: Path, task: Task | None) -> Iterator[None]:
    """Creates a folder of maps and keeps other runs out of it; tasks only those of the same task and runs of all scenes."""
    folder.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as held:
        hold(held, os.open(folder, os.O_RDONLY), folder, fcntl.LOCK_EX if task is None else fcntl.LOCK_SH)
        if task is None:
            leftovers = [f".*.npz*{PART}", ".task-*.lock"]
        else:
            leftovers = [f".*.npz{part_suffix(task)}"]
            lock = folder / f".{task}.lock"
            descriptor = os.open(lock, os.O_RDWR | os.O_CREAT)
            hold(held, descriptor, folder, fcntl.LOCK_EX)
            # A run that has just ended may have removed the file that this one had opened before.
            if not lock.exists() or not os.path.samestat(lock.stat(), os.fstat(descriptor)):
                raise Busy(f"{folder}: another run of {task} has just ended; try again")
            held.callback(lock.unlink)
        remove(folder, leftovers)
        held.callback(remove, folder, leftovers)
        yield


def hold(held: contextlib.ExitStack, descriptor: int, folder: Path, kind: int) -> None:
    """Locks an open file until `held` ends, and closes it then."""
    held.callback(os.close, descriptor)
    try:
        fcntl.flock(descriptor, kind | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise Busy(f"{folder}: another run writes to it; wait for its end, or give another --out") from error


def remove(folder: Path, patterns: list[str]) -> None:
    """Removes what a killed run, or a full disk, left half-written."""
    for pattern in patterns:
        for path in folder.glob(pattern):
            path.unlink()

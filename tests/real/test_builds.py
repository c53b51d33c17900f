"""San Jose, built under difficulties: killed at 50 random times, with 1, 2 and 8 threads, as 1 and as 4 tasks. The bytes are
those of an undisturbed build. Run by `make test-real`.

The undisturbed builds are the whole extract (1,262 tiles), all 523 maps, and shards of 32 records, so that there is more than
one item to resume. Kills are SIGKILL after random times (seeded; how far a run is by then depends on the machine) and count
only if the process was still running. They come singly and in chains, in which the run that resumes is killed as well. Of 50, 12
hit `rasterise`, 19 each `import-rsrp` and `shard`.
"""

import hashlib
import json
import random
import signal
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from test_real import data, holescout, path_from  # noqa: F401

# Kills in a row, before the run that must end, for each directory.
CHAINS = {
    "rasterise": [1, 1, 1, 4, 5],
    "import-rsrp": [1, 1, 1, 1, 1, 3, 3, 3, 5],
    "shard": [1, 1, 1, 1, 1, 3, 3, 3, 5],
}
SEED = 20260

Files = dict[str, str]


@dataclass
class Stage:
    """A stage of the city, and what an undisturbed run of it writes."""

    arguments: list[str]
    files: Files
    seconds: float

    def run(self, out: Path, *flags: str) -> dict:
        return holescout(*self.arguments, "--out", out, *flags)

    def start(self, out: Path) -> subprocess.Popen:
        command = [str(path_from("HOLESCOUT")), *self.arguments, "--out", str(out), "--quiet"]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def digests(directory: Path) -> Files:
    """SHA-256 of every file below a directory, by name."""
    files = (path for path in sorted(directory.rglob("*")) if path.is_file())
    return {str(path.relative_to(directory)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def undisturbed(out: Path, *arguments: str | Path) -> Stage:
    stage = Stage([str(argument) for argument in arguments], {}, 0.0)
    begun = time.monotonic()
    stage.run(out)
    stage.seconds = time.monotonic() - begun
    stage.files = digests(out)
    assert "manifest.json" in stage.files and not any(name.startswith(".") for name in stage.files)
    return stage


@pytest.fixture(scope="session")
def stages(data: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Stage]:  # noqa: F811
    root = tmp_path_factory.mktemp("undisturbed")
    osm = data / "osm" / "sanjose_buildings.osm.pbf"
    tiles, rsrp = root / "tiles", root / "rsrp"
    return {
        "rasterise": undisturbed(tiles, "rasterise", "--osm", osm),
        "import-rsrp": undisturbed(rsrp, "import-rsrp", "--maps", data / "rsrp" / "sanjose_4m", "--tiles", tiles),
        "shard": undisturbed(
            root / "dataset", "shard", "--tiles", tiles, "--rsrp", rsrp, "--records-per-shard", "32"
        ),
    }


def kill(stage: Stage, out: Path, after: float) -> str | None:
    """Kills a run after a while; tells where it was, or nothing if it had ended."""
    process = stage.start(out)
    time.sleep(after)
    process.send_signal(signal.SIGKILL)
    if process.wait() != -signal.SIGKILL:
        assert process.returncode == 0
        return None
    journal = out / ".holescout-build.jsonl"
    if (out / "manifest.json").exists():
        return "beside a manifest"
    items = sum('"item":null' not in line for line in journal.read_text().splitlines()[1:] if line) if journal.exists() else 0
    return "among its items" if items else "before its first item"


@pytest.mark.parametrize("name", CHAINS)
def test_killed_builds_end_in_the_same_bytes(stages: dict[str, Stage], tmp_path: Path, name: str) -> None:
    stage, moments = stages[name], random.Random(SEED)
    hits: dict[str, int] = {}
    for number, kills in enumerate(CHAINS[name]):
        out = tmp_path / str(number)
        hit = 0
        while hit < kills:
            where = kill(stage, out, moments.random() * 0.8 * stage.seconds)
            if where is None:
                # It ended first: the chain goes on in a new directory.
                assert digests(out) == stage.files
                out = tmp_path / f"{number}-{time.monotonic_ns()}"
                continue
            hit += 1
            hits[where] = hits.get(where, 0) + 1
        stage.run(out)
        found = digests(out)
        assert found == stage.files, sorted(set(found.items()) ^ set(stage.files.items()))[:4]
    print(f"{name}: killed {sum(hits.values())} times: {json.dumps(hits)}")
    assert sum(hits.values()) == sum(CHAINS[name])
    assert hits.get("among its items", 0) > 0, "some kills must hit the work itself"


@pytest.mark.parametrize("name", CHAINS)
@pytest.mark.parametrize("threads", ["1", "2", "8"])
def test_threads_change_nothing(stages: dict[str, Stage], tmp_path: Path, name: str, threads: str) -> None:
    stages[name].run(tmp_path / "out", "--threads", threads)
    assert digests(tmp_path / "out") == stages[name].files


@pytest.mark.parametrize("name", CHAINS)
@pytest.mark.parametrize("tasks", [1, 4])
def test_tasks_change_nothing(stages: dict[str, Stage], tmp_path: Path, name: str, tasks: int) -> None:
    stage, out = stages[name], tmp_path / "out"
    counts = ["--task-count", str(tasks)]
    # Two at a time, as on a cluster.
    for first in range(0, tasks, 2):
        pair = [
            subprocess.Popen(
                [str(path_from("HOLESCOUT")), *stage.arguments, "--out", str(out), "--quiet", "--threads", "1",
                 "--task-index", str(index), *counts],
                stdout=subprocess.DEVNULL,
            )
            for index in range(first, min(first + 2, tasks))
        ]
        assert [process.wait() for process in pair] == [0] * len(pair)
    stage.run(out, *counts, "--merge")
    assert digests(out) == stage.files


def test_the_recorded_inputs_give_the_dataset_again(
    data: Path, stages: dict[str, Stage], tmp_path: Path  # noqa: F811
) -> None:
    stages["shard"].run(tmp_path / "dataset")
    osm, maps = data / "osm" / "sanjose_buildings.osm.pbf", data / "rsrp" / "sanjose_4m"
    said = holescout("verify", tmp_path / "dataset", "--rebuild", "--osm", osm, "--maps", maps)
    assert said["failures"] == [] and said["rebuilt"] == len(stages["shard"].files)

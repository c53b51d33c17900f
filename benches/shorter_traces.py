"""What maps to train on are worth that were traced for a quarter of the time.

A learner averages the noise of its maps, a test cannot. So: two methods that learn, `trees` and `belief`, are fitted on maps of eight
repeats, on the first halves of the same maps (four repeats), and on other maps of two repeats, as many or more of them; all are judged
on the same validation maps of eight repeats. HOLESCOUT names the program.

    shorter_traces.py TILES LONG SHORT SCRATCH

LONG and SHORT are directories of maps by `pipeline/sionna_trace.py` of eight and of two repeats. The split is that of `holescout shard`.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "datasets" / "sanjose-maps"))
from missing import digest, split_of

STEPS = (1, 2, 4, 8)
METHODS = ("trees", "belief")


def holescout(*arguments: object) -> None:
    subprocess.run([os.environ["HOLESCOUT"], "--quiet", *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)


def first_half(source: Path, target: Path) -> None:
    """The map of the first half of the repeats, as one of a single trace of their rays."""
    with np.load(source) as archive:
        arrays = dict(archive)
    metadata = json.loads(arrays["meta_json"].tobytes())
    repeats = metadata.pop("repeats") // 2
    metadata["samples_per_tx"] *= repeats
    for name in ("direction_shift", "ceiling_db"):
        metadata.pop(name, None)
    if "path_gain_db" in arrays:
        kept = {"path_gain_db": arrays["path_gain_db_first_half"]}
    else:
        kept = {"path_gain": arrays["path_gain_first_half"]}
    text = np.frombuffer(json.dumps(metadata).encode(), dtype=np.uint8)
    np.savez(target, meta_json=text, **kept)


def judge(tiles: Path, scratch: Path, val: list[Path], train: list[Path], halves: bool) -> dict[str, list[tuple[float, float]]]:
    """Precision of each method after 1, 2, 4 and 8 steps, in percent, and half of its 95 % interval."""
    for name in ("maps", "rsrp", "dataset", "evaluation"):
        shutil.rmtree(scratch / name, ignore_errors=True)
    maps = scratch / "maps"
    maps.mkdir(parents=True)
    for path in val + ([] if halves else train):
        (maps / path.name).symlink_to(path.resolve())
    for path in train if halves else []:
        first_half(path, maps / path.name)
    holescout("import-rsrp", "--maps", maps, "--tiles", tiles, "--out", scratch / "rsrp")
    holescout("shard", "--tiles", tiles, "--rsrp", scratch / "rsrp", "--out", scratch / "dataset")
    evaluation = scratch / "evaluation"
    holescout("evaluate", "--dataset", scratch / "dataset", "--split", "val", "--methods", ",".join(METHODS), "--starts", 100,
              "--out", evaluation)
    report = json.loads((evaluation / "report.json").read_text())
    scores = {(score["method"], score["k"]): score["precision"] for score in report["scores"] if score["starts"] == 100}
    of = {method: [scores[method, k] for k in STEPS] for method in METHODS}
    return {method: [(100 * one["mean"], 50 * (one["high"] - one["low"])) for one in values] for method, values in of.items()}


def main() -> None:
    tiles, long, short, scratch = map(Path, sys.argv[1:])
    maps = sorted(long.glob("*.npz"), key=lambda path: digest(path.stem))
    val = [path for path in maps if split_of(path.stem) == "val"]
    train = [path for path in maps if split_of(path.stem) == "train"]
    others = sorted(short.glob("*.npz"), key=lambda path: digest(path.stem))
    print(f"{len(val)} validation maps; precision in %, 100 starts\n\n| train maps | repeats | cost | method | "
          + " | ".join(f"k = {k}" for k in STEPS) + " |\n|" + "---|" * (4 + len(STEPS)))
    cases = [(train[: len(train) // 2], "8", 8 * (len(train) // 2), False), (train, "8", 8 * len(train), False)]
    cases += [(train, "4, the same maps", 4 * len(train), True)]
    counts = sorted({len(train), min(2 * len(train), len(others)), len(others)})
    cases += [(others[:count], "2", 2 * count, False) for count in counts]
    cases += [(train + others, "8 and 2", 8 * len(train) + 2 * len(others), False)]
    for chosen, repeats, cost, halves in cases:
        for method, values in judge(tiles, scratch, val, chosen, halves).items():
            figures = " | ".join(f"{mean:.1f} ± {half:.1f}" for mean, half in values)
            print(f"| {len(chosen)} | {repeats} | {cost} | {method} | {figures} |", flush=True)


if __name__ == "__main__":
    main()

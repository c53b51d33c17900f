"""What makes the agent learn: variants of training, each for the same number of updates, judged on the validation split.

    python learning.py train DATASET STORE [VARIANT ...] [--updates 2000] [--minutes 40]
    python learning.py report STORE

HOLESCOUT names the program, built with libtorch; OMP_NUM_THREADS says how many cores it takes. `train` trains and judges what of the variants (default: all of variants.toml) is not
finished in STORE; it may be killed at any time and goes on where it was. A variant that takes longer than --minutes in all is judged as
it is then, and the report says so. The test split is never looked at.

`report` prints, in % of the starts, the share in a hole after at most k moves (mean over maps), and under it the difference to the variant
that it differs from in one thing: paired over maps, with the half-width of a 95 % interval. The policy judged is the last one, not the
best on the way, so that nothing is chosen by the maps that it is judged on.
"""

import argparse
import csv
import json
import os
import statistics
import subprocess
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

STEPS = (1, 2, 4, 8)
STARTS = 200
Scores = dict[str, dict[int, dict[str, float]]]  # method, k, map


def variants() -> dict[str, dict[str, Any]]:
    found = tomllib.loads((Path(__file__).parent / "variants.toml").read_text())
    for name, variant in found.items():
        base = found.get(variant.get("from", ""), {})
        variant["train"] = base.get("train", {}) | variant.get("train", {})
        variant.setdefault("preset", base.get("preset", "best"))
    return found


def toml(values: dict[str, Any]) -> str:
    return "[train]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items())


def holescout(*arguments: object, limit_s: float | None = None) -> bool:
    """Runs the program; False if it was stopped when its time was over, in which case it has saved first."""
    process = subprocess.Popen([os.environ["HOLESCOUT"], *map(str, arguments)])
    try:
        if process.wait(limit_s):
            raise SystemExit(f"{arguments[0]} failed")
        return True
    except subprocess.TimeoutExpired:
        process.terminate()
        process.wait()
        return False
    except BaseException:
        process.terminate()
        process.wait()
        raise


class Spent:
    """Seconds that a variant has taken so far, kept in a file from one run of this program to the next."""

    def __init__(self, path: Path, limit_s: float) -> None:
        self.path, self.limit_s = path, limit_s
        self.seconds = float(path.read_text()) if path.exists() else 0.0

    def left(self) -> float:
        return max(self.limit_s - self.seconds, 0.0)

    def add(self, seconds: float) -> None:
        self.seconds += seconds
        self.path.write_text(f"{self.seconds:.1f}")


def train(dataset: str, store: Path, name: str, variant: dict[str, Any], updates: int, minutes: float) -> None:
    place = store / name
    if (place / "evaluation" / "report.json").exists():
        return
    place.mkdir(parents=True, exist_ok=True)
    config = place / "config.toml"
    rhythm = {"updates": updates, "checkpoint_every": max(updates // 20, 1), "evaluate_every": max(updates // 4, 1)}
    config.write_text(toml(rhythm))
    if variant["preset"] == "paper":
        # A preset replaces the file's [train], so the rhythm is given by flags.
        flags = [one for key, value in rhythm.items() for one in (f"--{key.replace('_', '-')}", value)]
        flags += ["--preset", "paper"]
    else:
        config.write_text(toml(rhythm | variant["train"]))
        flags = []
    spent, begin = Spent(place / "seconds", 60 * minutes), time.monotonic()
    try:
        command = ("train", "--dataset", dataset, "--run", place / "run", "--config", config, *flags)
        holescout(*command, limit_s=spent.left())
    finally:
        spent.add(time.monotonic() - begin)
    last = max((place / "run" / "checkpoints").iterdir())
    (place / "judged").write_text(last.name)
    steps = ",".join(map(str, STEPS))
    methods = ("--methods", "random-walk,wall-walk", "--steps", steps, "--starts", STARTS)
    out = place / "evaluation"
    holescout("evaluate", "--dataset", dataset, "--split", "val", "--policy", last, "--out", out, "--overwrite", *methods)


def scores(place: Path) -> Scores:
    found: Scores = {}
    with open(place / "evaluation" / "maps.csv", newline="") as file:
        for row in csv.DictReader(file):
            of_method = found.setdefault(row["method"], {})
            if row["precision"]:
                of_method.setdefault(int(row["k"]), {})[row["id"]] = 100 * float(row["precision"])
    return found


def interval(values: list[float]) -> tuple[float, float]:
    """Mean and half-width."""
    half = 1.96 * statistics.stdev(values) / len(values) ** 0.5 if len(values) > 1 else 0.0
    return statistics.mean(values), half


def lines(store: Path) -> Iterator[str]:
    known = variants()
    found = {name: scores(store / name) for name in known if (store / name / "evaluation" / "maps.csv").exists()}
    yield "| | updates | minutes | revisits, % | " + " | ".join(f"k = {k}" for k in STEPS) + " |"
    yield "|---" * (4 + len(STEPS)) + "|"
    first = next(iter(found), None)
    for control in ("random-walk", "wall-walk") if first else ():
        cells = (f"{interval(list(found[first][control][k].values()))[0]:.1f}" for k in STEPS)
        yield f"| {control} | | | | " + " | ".join(cells) + " |"
    for name, methods in found.items():
        place = store / name
        reports = [json.loads(line) for line in (place / "run" / "log.jsonl").read_text().splitlines()]
        revisits = [line["revisits"] for line in reports if line.get("revisits") is not None][-5:]
        shown = f"{100 * statistics.mean(revisits):.0f}" if revisits else ""
        minutes = float((place / "seconds").read_text()) / 60
        for method in ("agent", "predictor"):
            if method not in methods:
                continue
            cells = []
            base = found.get(known[name].get("against", ""), {})
            # A variant without a predictor is compared by its agent.
            base = base.get(method) or base.get("agent")
            for k in STEPS:
                mean, _ = interval(list(methods[method][k].values()))
                cell = f"{mean:.1f}"
                if base:
                    pairs = [value - base[k][at] for at, value in methods[method][k].items()]
                    difference, half = interval(pairs)
                    cell += f" ({difference:+.1f} ± {half:.1f})"
                cells.append(cell)
            title = name if method == "agent" else f"{name}, predictor"
            figures = (str(int((place / "judged").read_text())), f"{minutes:.0f}", shown) if method == "agent" else ("", "", "")
            yield f"| {title} | " + " | ".join((*figures, *cells)) + " |"
    missing = [name for name in known if name not in found]
    yield ""
    yield "Not run: " + (", ".join(missing) or "nothing") + "."


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    training = commands.add_parser("train")
    training.add_argument("dataset")
    training.add_argument("store", type=Path)
    training.add_argument("names", nargs="*", metavar="VARIANT")
    training.add_argument("--updates", type=int, default=2000)
    training.add_argument("--minutes", type=float, default=40.0, help="of wall time for a variant")
    commands.add_parser("report").add_argument("store", type=Path)
    options = parser.parse_args()
    if options.command == "train":
        known = variants()
        for name in options.names or known:
            if name not in known:
                parser.error(f"no variant {name}: there are {', '.join(known)}")
            train(options.dataset, options.store, name, known[name], options.updates, options.minutes)
    else:
        print("\n".join(lines(options.store)))


if __name__ == "__main__":
    main()

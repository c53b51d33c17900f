"""How well blocks of shards shuffle: `block_shuffle.py DATASET STREAM HOLESCOUT`, by the order that the loader really gives.

STREAM is `examples/stream.rs` built for release. A dataset of some twenty shards or more shows most: `holescout shard
--records-per-shard 16`. For each size of block over 200 epochs in batches of 32: distinct shards in a batch, distance from one
record to the next, standard deviation of a batch's mean share of coverage holes.
"""

import csv
import itertools
import json
import math
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

BATCH, EPOCHS = 32, 200


def main() -> None:
    dataset, stream, holescout = sys.argv[1:]
    with tempfile.TemporaryDirectory() as scratch:
        table = Path(scratch, "records.csv")
        subprocess.run([holescout, "inspect", dataset, "--csv", table], check=True, capture_output=True)
        rows = {row["id"]: row for row in csv.DictReader(table.open())}
    manifest = json.loads(Path(dataset, "manifest.json").read_text())
    shard = {record["id"]: record["shard"] for record in manifest["records"]}
    records = sum(entry["records"] for entry in manifest["shards"] if entry["split"] == "train")
    shards = sum(entry["split"] == "train" for entry in manifest["shards"])
    print(f"{records} records in {shards} shards\n")
    print("| shards in a block | shards in a batch | km to the next record | standard deviation of a batch's mean hole share |\n|---|---|---|---|")
    for block in [*itertools.takewhile(lambda size: size < shards, (1, 2, 4, 8, 16, 32)), shards]:
        command = [stream, dataset, "train", "--take", str(records * EPOCHS), "--block", str(block), "--threads", "2"]
        lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
        ids = [line.split()[1] for line in lines]
        begins = [epoch * records + at for epoch in range(EPOCHS) for at in range(0, records - BATCH + 1, BATCH)]
        batches = [ids[begin : begin + BATCH] for begin in begins]
        means = [statistics.mean(float(rows[id]["hole_share"]) for id in batch) for batch in batches]
        distinct = statistics.mean(len({shard[id] for id in batch}) for batch in batches)
        apart = statistics.mean(distance(rows[a], rows[b]) for a, b in itertools.pairwise(ids))
        print(f"| {block} | {distinct:.1f} | {apart:.2f} | {100 * statistics.pstdev(means):.2f} % |")


def distance(a: dict[str, str], b: dict[str, str]) -> float:
    """In km, on a sphere and for short ways."""
    lat = math.radians((float(a["lat"]) + float(b["lat"])) / 2)
    east = (float(a["lon"]) - float(b["lon"])) * math.cos(lat)
    return 111.2 * math.hypot(east, float(a["lat"]) - float(b["lat"]))


main()

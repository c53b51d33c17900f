"""State encodings per second: the Rust encoder against a straightforward NumPy version.

Both encode the same states (random records, one to five visited cells) on one thread, in turn;
the results are compared before the times. HOLESCOUT_DATASET names the dataset, ENCODE_STATES the
built example of that name.
"""

import io
import json
import os
import pathlib
import statistics
import subprocess
import tempfile
import time

import msgpack
import numpy as np
import zstandard

ROUNDS = 5
STATES = 200
COMPARED = 16
DECAY, THRESHOLD, REACH, SCALE, FLOOR = 0.1, -100.0, 15, 50.0, -160.0


def records(dataset: pathlib.Path):
    for shard in sorted(dataset.glob("*/*.msgpack.zst")):
        with shard.open("rb") as file:
            stream = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
            yield from msgpack.Unpacker(stream, max_buffer_size=1 << 30)


def array(record, name):
    return np.load(io.BytesIO(record[name]))


def encode(heights, rsrp, visited, rows, columns):
    """I_A and I_B as the paper writes them down."""
    row, column = visited[-1]
    location = 2.0 ** (-DECAY * np.hypot(rows - row, columns - column))
    levels = np.zeros_like(location)
    for i, j in visited:
        weight = (rsrp[i, j] - THRESHOLD) / -THRESHOLD
        levels += weight * 2.0 ** (-DECAY * np.hypot(rows - i, columns - j))
    whole = np.stack([location, levels, heights / SCALE]).astype(np.float32)
    padded = np.zeros((3, *(n + 2 * REACH for n in heights.shape)), np.float32)
    padded[2] = 1.0
    padded[:, REACH:-REACH, REACH:-REACH] = whole
    side = 2 * REACH + 1
    return whole, padded[:, row : row + side, column : column + side].copy()


def main():
    dataset = pathlib.Path(os.environ["HOLESCOUT_DATASET"])
    random = np.random.default_rng(0)
    states, inputs = [], []
    everything = list(records(dataset))
    for _ in range(STATES):
        record = everything[random.integers(len(everything))]
        heights = array(record, "height_m")
        rsrp = np.maximum(array(record, "rsrp_dbm"), FLOOR)
        outdoors = np.argwhere(heights < 2.0)
        visited = outdoors[random.integers(len(outdoors), size=random.integers(1, 6))].tolist()
        states.append((record["id"], visited))
        inputs.append((heights, rsrp, visited))
    rows, columns = np.mgrid[: heights.shape[0], : heights.shape[1]].astype(float)

    with tempfile.TemporaryDirectory() as scratch:
        scratch = pathlib.Path(scratch)
        (scratch / "states.json").write_text(json.dumps(states))
        command = [os.environ["ENCODE_STATES"], dataset, scratch / "states.json", scratch / "out"]
        ratios = []
        for _ in range(ROUNDS):
            rust = float(subprocess.run(command, check=True, capture_output=True).stdout)
            start = time.perf_counter()
            for heights, rsrp, visited in inputs:
                encode(heights, rsrp, visited, rows, columns)
            numpy = STATES / (time.perf_counter() - start)
            ratios.append(rust / numpy)
            print(f"Rust {rust:9.0f} states/s   NumPy {numpy:7.0f} states/s   {rust / numpy:5.1f} x")
        whole = np.load(scratch / "out.map.npy")
        window = np.load(scratch / "out.window.npy")
    expected = [encode(*one, rows, columns) for one in inputs[:COMPARED]]
    worst = max(
        max(np.abs(whole[at] - a.ravel()).max(), np.abs(window[at] - b.ravel()).max())
        for at, (a, b) in enumerate(expected)
    )
    assert worst < 1e-5, f"the encodings differ by {worst}"
    print(f"largest difference {worst:.1e}; median ratio {statistics.median(ratios):.1f} x")


if __name__ == "__main__":
    main()

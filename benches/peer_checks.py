"""Checks of the benchmark's peers, before any time is taken: they must do the same work, and do it right."""

import json
import os
import subprocess
import sys
import tempfile
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch
from encode_vs_numpy import COMPARED, array, encode, records
from peer_plain import VectorEnv
from peer_task import (
    ACTIONS, BATCH, CELLS, DISCOUNT, EPISODES, FLOOR_DBM, MAX_STEPS, OFFSETS, REACH, SIDE, Environment, Maps,
)
from peer_tuned import Encoder, States, Tuned

sys.path.insert(0, str(Path(__file__).parent.parent / "tests/torch"))
from reference import loss as reference_loss  # noqa: E402

STATES = 32


def line_touches(row: int, column: int, cell: tuple[int, int]) -> bool:
    """Whether the segment from (0, 0) touches a closed cell, by clipping it with exact fractions."""
    first, last = Fraction(0), Fraction(1)
    for way, center in zip((row, column), cell, strict=True):
        low, high = Fraction(2 * center - 1, 2), Fraction(2 * center + 1, 2)
        if way == 0:
            if not low <= 0 <= high:
                return False
            continue
        ends = sorted((low / way, high / way))
        first, last = max(first, ends[0]), min(last, ends[1])
    return first <= last


def check_permissible(maps: Maps) -> None:
    """Permissible sets of some cells, line by line."""
    env = Environment(maps, 5, 3)
    for slot in env.slots:
        row, column = divmod(int(env.cells()[slot]), CELLS)
        window = maps.closed[env.map[slot], row : row + SIDE, column : column + SIDE]
        closed = [(int(i) - REACH, int(j) - REACH) for i, j in np.argwhere(window)]
        for action, (i, j) in enumerate(OFFSETS.tolist()):
            ahead = [(k, m) for k, m in closed if min(i, 0) <= k <= max(i, 0) and min(j, 0) <= m <= max(j, 0)]
            free = not any(line_touches(i, j, cell) for cell in ahead)
            assert env.permissible[slot, action] == free, (slot, action)


def check_encodings(dataset: Path, maps: Maps) -> float:
    """Both peers against the formulae, and the formulae against the Rust encoder if ENCODE_STATES names it."""
    random = np.random.default_rng(7)
    rows, columns = np.mgrid[:CELLS, :CELLS].astype(float)
    worst = 0.0

    def compare(found: np.ndarray, expected: np.ndarray) -> None:
        nonlocal worst
        worst = max(worst, float(np.abs(found - expected).max()))

    env = VectorEnv(maps, 3)
    for _ in range(MAX_STEPS + 3):
        env.step(random.integers(ACTIONS, size=EPISODES))
    task, encoder = env.task, Encoder(maps, torch.float32)
    tuned = encoder.encode(States(task.map, np.zeros_like(task.map), task.visited, task.count))
    plain = env.observations()
    for slot in range(STATES):
        visited = np.stack(np.divmod(task.visited[slot, : task.count[slot]], CELLS), 1).tolist()
        heights, rsrp = maps.heights[task.map[slot]] * 50.0, maps.levels[task.map[slot]] * 100.0 - 100.0
        for at, expected in enumerate(encode(heights, rsrp, visited, rows, columns)):
            compare(tuned[at][slot].numpy(), expected)
            compare(plain[at][slot], expected)

    if "ENCODE_STATES" in os.environ:
        everything = [record for record in records(dataset) if record["split"] == "train"]
        states, expected = [], []
        for _ in range(COMPARED):
            record = everything[random.integers(len(everything))]
            heights, rsrp = array(record, "height_m"), np.maximum(array(record, "rsrp_dbm"), FLOOR_DBM)
            outdoors = np.argwhere(heights < 2.0)
            visited = outdoors[random.integers(len(outdoors), size=random.integers(1, 6))].tolist()
            states.append((record["id"], visited))
            expected.append(encode(heights, rsrp, visited, rows, columns))
        with tempfile.TemporaryDirectory() as scratch:
            (Path(scratch) / "states.json").write_text(json.dumps(states))
            command = [os.environ["ENCODE_STATES"], str(dataset), f"{scratch}/states.json", f"{scratch}/out"]
            subprocess.run(command, check=True, capture_output=True)
            for at, name in enumerate(("map", "window")):
                compare(np.load(f"{scratch}/out.{name}.npy"), np.stack([one[at].ravel() for one in expected]))
    assert worst < 1e-5, f"the encodings differ by {worst}"
    return worst


def check_batches_and_loss(maps: Maps) -> float:
    """Turned batches agree with what was seen unturned, and the loss with the reference; both in float32."""
    tuned = Tuned(maps, torch.float32)
    with torch.no_grad():
        for parameter in tuned.target.parameters():
            parameter.add_(0.01 * torch.randn_like(parameter))
    batch = tuned.sample()
    taken = torch.arange(len(batch["action"])), batch["action"]
    assert torch.equal(batch["all_rewards"][taken], batch["reward"])
    assert torch.equal(batch["all_terminal"][taken], batch["terminal"] * (batch["reward"] == 0))
    # The last measurement is where the location is, and above the action taken if that was permissible.
    moved = batch["reward"] > -1.0
    at, to = (batch[name][:, 0].flatten(1).argmax(1) for name in ("map", "next_map"))
    row, column = to // CELLS - at // CELLS + REACH, to % CELLS - at % CELLS + REACH
    assert torch.equal((row * SIDE + column)[moved], batch["action"][moved])
    policy, target = (dict(network.named_parameters()) for network in (tuned.policy, tuned.target))
    discounted = batch | {"discount": DISCOUNT * (1 - batch["terminal"]), "next_of": torch.arange(BATCH)}
    expected, _ = reference_loss(policy, target, discounted, "best")
    found = tuned.loss(batch)
    gradients = [torch.autograd.grad(one, list(policy.values())) for one in (found, expected)]
    pairs = [(found, expected), *zip(*gradients, strict=True)]
    worst = max(float((a - b).detach().abs().max()) for a, b in pairs)
    assert worst < 1e-5, f"losses or gradients differ by {worst}"
    return worst


def check(dataset: Path, maps: Maps) -> None:
    """All of them."""
    check_permissible(maps)
    encodings, loss = check_encodings(dataset, maps), check_batches_and_loss(maps)
    rust = "" if "ENCODE_STATES" in os.environ else " (not against Rust: ENCODE_STATES is not set)"
    print(f"checked: permissible sets; encodings to {encodings:.0e}{rust}; loss and gradients to {loss:.0e}")

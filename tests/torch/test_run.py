"""What a run leaves for others: event files for TensorBoard, an exported policy for PyTorch.

HOLESCOUT names the program, built with libtorch, HOLESCOUT_DATASET a dataset with train and val splits,
DDQN_REFERENCE the built example of that name.
"""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

UPDATES = 24
CONFIG = f"""
[train]
updates = {UPDATES}
batch_size = 8
num_envs = 8
learning_starts = 64
buffer_size = 256
widths = [4, 4, 4, 4, 4, 4, 4]
checkpoint_every = 12
evaluate_every = 12
evaluate_maps = 2
evaluate_starts = 4
"""


def holescout(*arguments: object) -> None:
    subprocess.run([os.environ["HOLESCOUT"], *map(str, arguments)], check=True)


def train(directory: Path, options: str = "", updates: int = UPDATES) -> Path:
    config, run = directory / "config.toml", directory / "run"
    config.write_text(CONFIG.replace(f"updates = {UPDATES}", f"updates = {updates}") + options)
    holescout("train", "--dataset", os.environ["HOLESCOUT_DATASET"], "--config", config, "--run", run)
    return run


def test_tensorboard_reads_the_events(tmp_path: Path) -> None:
    run = train(tmp_path)
    # What came after the checkpoint that a run goes on from is written once more, and counts once.
    shutil.rmtree(run / "checkpoints" / f"{UPDATES:09}")
    train(tmp_path)
    assert len(list(run.glob("events.out.tfevents.*"))) == 2
    events = EventAccumulator(str(run)).Reload()
    found = {tag: [(event.step, event.value) for event in events.Scalars(tag)] for tag in events.Tags()["scalars"]}
    lines = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
    assert len(lines) == 3, "one report, two judgements"
    for line in lines:
        update = line.pop("update")
        for name in [name for name, value in line.items() if isinstance(value, dict)]:
            line |= {f"{name}/{k}": value for k, value in line.pop(name).items()}
        for name, value in line.items():
            if value is not None:
                assert dict(found[name])[update] == pytest.approx(value), name
    assert [step for step, _ in found["precision/1"]] == [12, UPDATES]


PLAIN = "hole_prediction = 0.0\n"
PAPER = f"encoding = 'paper'\n{PLAIN}"


@pytest.mark.parametrize("options", ["", "factored = true\n", f"{PLAIN}dueling = true\n", PAPER, f"{PAPER}dueling = true\n", f"{PAPER}reward_prediction = 1.0\n"])
def test_the_card_of_a_policy_tells_how_to_use_it(tmp_path: Path, options: str) -> None:
    run, policy, reference = train(tmp_path, options), tmp_path / "policy", tmp_path / "reference"
    holescout("export-policy", run / "best", "--out", policy)
    reference.mkdir()
    subprocess.run([os.environ["DDQN_REFERENCE"], os.environ["HOLESCOUT_DATASET"], reference, policy], check=True)
    snippets = re.findall(r"```python\n(.*?)```", (policy / "README.md").read_text(), re.DOTALL)
    assert len(snippets) == 1
    names: dict[str, object] = {}
    os.chdir(policy)
    exec(snippets[0], names)
    inputs, expected = load_file(reference / "inputs.safetensors"), load_file(reference / "outputs.safetensors")
    with torch.no_grad():
        found = names["q_values"](names["weights"], inputs["map"], inputs["window"])
    assert found.shape == expected["q_values"].shape == (16, 961)
    assert found.std() > 0
    assert (found - expected["q_values"]).abs().max() < 1e-4

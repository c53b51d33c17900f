"""The trainer's Q-values, losses and gradients (float32) against the reference in float64.

HOLESCOUT_DATASET names a dataset with a train split, DDQN_REFERENCE the built example of that name.
"""

import os
import subprocess
from pathlib import Path

import pytest
import torch
from reference import loss, q_values
from safetensors.torch import load_file

TOLERANCE = 1e-5


def double(path: Path) -> dict[str, torch.Tensor]:
    return {name: one.double() if one.is_floating_point() else one for name, one in load_file(path).items()}


@pytest.mark.parametrize("preset", ["best", "factored", "paper", "other"])
def test_losses_and_gradients_agree(tmp_path: Path, preset: str) -> None:
    options = [] if preset == "best" else [preset]
    command = [os.environ["DDQN_REFERENCE"], os.environ["HOLESCOUT_DATASET"], tmp_path, *options]
    subprocess.run(command, check=True)
    batch, policy, target, outputs = (
        double(tmp_path / f"{name}.safetensors") for name in ("inputs", "policy", "target", "outputs")
    )
    steps, discount = 3 if preset == "other" else 1, batch["discount"]
    if preset == "factored":
        states, counts = batch["next_of"].unique(return_counts=True)
        assert len(states) == len(batch["action"]) // 4 and counts.max() == 4, "a few states, several moves"
    else:
        assert 0 < len(discount) < len(batch["action"]), "some episodes end, others go on"
    assert abs(discount.max() - 0.99) < 1e-6 and abs(discount.min() - 0.99**steps) < 1e-6
    assert batch["reward"].unique().numel() >= 3, "all three rewards"
    for parameter in policy.values():
        parameter.requires_grad_()
    if preset in ("best", "factored"):
        assert (batch["all_allowed"][:, 480] == 0).all(), "to stay is not allowed"
    found = q_values(policy, batch["map"], batch["window"], preset)["q"]
    assert (found - outputs["q_values"]).abs().max() < TOLERANCE
    losses = loss(policy, target, batch, preset)
    assert losses.keys() == {name for name in outputs if name.endswith("loss")}
    for name, one in losses.items():
        assert abs(one - outputs[name]) < TOLERANCE, name
    losses["loss"].backward()
    for name, parameter in policy.items():
        assert parameter.grad.abs().max() > 0, name
        assert (parameter.grad - outputs[name]).abs().max() < TOLERANCE, name

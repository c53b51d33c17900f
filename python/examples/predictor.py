"""A supervised predictor: where are holes likely, given the heights alone? Its policy flies to the likeliest cell within reach.

    python predictor.py DATASET [STEPS]
"""

import sys

import numpy as np
import torch
from torch import nn
from torch.utils.data import DataLoader

import holescout

location, steps = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 300
torch.manual_seed(0)
layers = [nn.Conv2d(1, 16, 9, padding=4), nn.ReLU(), nn.Conv2d(16, 16, 9, padding=4), nn.ReLU(), nn.Conv2d(16, 1, 1)]
network = nn.Sequential(*layers)
optimiser = torch.optim.Adam(network.parameters(), lr=2e-3)
records = DataLoader(holescout.Dataset(location, "train"), batch_size=8, shuffle=True)  # type: ignore[arg-type]
for epoch in range(max(1, steps // len(records))):
    for batch in records:
        outdoors = batch["mask"] != 1
        holes = (outdoors & (batch["rsrp_dbm"] < -100.0)).float()
        logits = network(batch["height_m"][:, None] / 50.0)[:, 0]
        loss = nn.functional.binary_cross_entropy_with_logits(logits[outdoors], holes[outdoors])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    print(f"epoch {epoch}: {loss.item():.3f}")


@torch.no_grad()
def policy(game: holescout.Map, observations: dict[str, np.ndarray]) -> np.ndarray:
    """To the unvisited cell within reach where a hole is likeliest."""
    chance = np.pad(network(torch.from_numpy(game.height_m)[None, None] / 50.0)[0, 0].numpy(), 15, constant_values=-np.inf)
    here = (observations["rows"] >= 0).sum(axis=1) - 1
    waypoints = []
    for rows, columns, last, mask in zip(observations["rows"], observations["columns"], here, observations["action_mask"], strict=True):
        left = chance.copy()
        left[rows[: last + 1] + 15, columns[: last + 1] + 15] = -1e9
        window = left[rows[last] : rows[last] + 31, columns[last] : columns[last] + 31]
        best = np.where(mask.reshape(31, 31) == 1, window, -np.inf).argmax()
        waypoints.append((rows[last] + best // 31 - 15, columns[last] + best % 31 - 15))
    return np.array(waypoints)


report = holescout.evaluate(policy, location, "val", methods=["random-walk", "wall-walk", "oracle"])
for method in ("random-walk", "wall-walk", "agent", "oracle"):
    print(method, " ".join(f"{report.precision(method, k):.1%}" for k in (1, 2, 4, 8)))

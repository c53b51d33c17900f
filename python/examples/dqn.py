"""Double DQN with action masks in the form of CleanRL: one file, from environment to report.

    python dqn.py --dataset DATASET [--total-timesteps N]

Observations are compact; the network's input is made of them on its device (`holescout.torch.Encoder`), and the replay buffer keeps 28
bytes a transition.
"""

import argparse
import random
import time

import numpy as np
import torch
import torch.nn as nn
import torch.nn.functional as F

import holescout
from holescout.torch import Encoder


class QNetwork(nn.Module):
    """Values of all moves, from the window around the UAV."""

    def __init__(self, maps: holescout.Maps) -> None:
        super().__init__()
        self.encoder = Encoder(maps)
        self.trunk = nn.Sequential(
            nn.Conv2d(3, 32, 5, padding=2), nn.ReLU(), nn.Conv2d(32, 32, 5, padding=2), nn.ReLU(), nn.Conv2d(32, 1, 1), nn.Flatten())

    def forward(self, observations: dict[str, np.ndarray]) -> torch.Tensor:
        names = ("map", "rows", "columns", "rsrp_dbm")
        _, window = self.encoder(**{name: torch.from_numpy(observations[name]) for name in names})
        return self.trunk(window)


def masked(values: torch.Tensor, observations: dict[str, np.ndarray]) -> torch.Tensor:
    mask = torch.from_numpy(observations["action_mask"]).to(values.device, torch.bool)
    return values.masked_fill(~mask, -torch.inf)


def linear_schedule(start: float, end: float, duration: int, step: int) -> float:
    return max(start + (end - start) / duration * step, end)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--dataset", required=True)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--total-timesteps", type=int, default=50_000)
    parser.add_argument("--num-envs", type=int, default=16)
    parser.add_argument("--learning-rate", type=float, default=1e-3)
    parser.add_argument("--buffer-size", type=int, default=100_000)
    parser.add_argument("--gamma", type=float, default=0.9)
    parser.add_argument("--target-network-frequency", type=int, default=100)
    parser.add_argument("--batch-size", type=int, default=64)
    parser.add_argument("--learning-starts", type=int, default=1_000)
    parser.add_argument("--starts", type=int, default=50, help="flights a map of the evaluation")
    args = parser.parse_args()

    random.seed(args.seed)
    np.random.seed(args.seed)
    torch.manual_seed(args.seed)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")

    envs = holescout.make_vec(args.dataset, args.num_envs, split="train")
    q_network = QNetwork(envs.maps).to(device)
    target_network = QNetwork(envs.maps).to(device)
    target_network.load_state_dict(q_network.state_dict())
    optimizer = torch.optim.Adam(q_network.parameters(), lr=args.learning_rate)
    rb = holescout.ReplayBuffer(envs.maps, args.buffer_size, discount=args.gamma, seed=args.seed)

    obs, infos = envs.reset(seed=args.seed)
    start_time = time.time()
    for global_step in range(0, args.total_timesteps, args.num_envs):
        epsilon = linear_schedule(1.0, 0.05, args.total_timesteps // 2, global_step)
        choices = [random.choice(np.flatnonzero(mask)) for mask in infos["action_mask"]]
        if random.random() >= epsilon:
            with torch.no_grad():
                choices = masked(q_network(obs), obs).argmax(dim=1).cpu().numpy()
        actions = np.asarray(choices)
        next_obs, rewards, terminations, truncations, infos = envs.step(actions)
        rb.add(actions, rewards, terminations, truncations, next_obs, infos)
        obs = next_obs

        if global_step > args.learning_starts:
            data = rb.sample(args.batch_size)
            with torch.no_grad():
                best = masked(q_network(data["next_observations"]), data["next_observations"]).argmax(dim=1, keepdim=True)
                target_max = target_network(data["next_observations"]).gather(1, best).squeeze(1)
                td_target = torch.from_numpy(data["returns"]).to(device) + torch.from_numpy(data["discounts"]).to(device) * target_max
            old_val = q_network(data["observations"]).gather(1, torch.from_numpy(data["actions"]).to(device)[:, None]).squeeze(1)
            loss = F.mse_loss(td_target, old_val)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            updates = global_step // args.num_envs
            if updates % args.target_network_frequency == 0:
                target_network.load_state_dict(q_network.state_dict())
            if updates % 200 == 0:
                print(f"{global_step} steps, {int(global_step / (time.time() - start_time))} a second, loss {loss.item():.4f}")



    @torch.no_grad()
    def policy(game: holescout.Map, observations: dict[str, np.ndarray]) -> np.ndarray:
        # The network knows maps by their number; those of val have numbers of their own.
        number = np.full(len(observations["rows"]), val_ids.index(game.id))
        values = masked(val_network({"map": number, **observations}), observations)
        best = values.argmax(dim=1).cpu().numpy()
        last = (observations["rows"] >= 0).sum(axis=1) - 1
        at = np.arange(len(last))
        here = np.stack([observations["rows"][at, last], observations["columns"][at, last]], axis=1)
        return here + np.stack([best // 31 - 15, best % 31 - 15], axis=1)

    val = holescout.Maps(args.dataset, "val")
    val_ids = val.ids
    val_network = QNetwork(val).to(device)
    val_network.trunk.load_state_dict(q_network.trunk.state_dict())
    report = holescout.evaluate(policy, args.dataset, "val", methods=["random-walk", "wall-walk"],
                                settings={"evaluate": {"starts": args.starts}})
    print(f"trained on {len(envs.maps)} maps; precision on val after 1, 2, 4, 8 steps:")
    for method in ("random-walk", "wall-walk", "agent"):
        print(f"{method:12}", " ".join(f"{report.precision(method, k):6.1%}" for k in (1, 2, 4, 8)))


if __name__ == "__main__":
    main()

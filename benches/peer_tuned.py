"""The default preset in PyTorch, treated as well as the Rust program: a peer of the training benchmark.

bfloat16 in channels-last layout with float32 master weights, a replay of references, states that are encoded from
a table when they are sampled, all losses of the preset, masks and the eight symmetries, no passes over states after the
end. What it lacks: the target network's values come from whole passes, not from the parts that they depend on.
(torch.compile was tried: it was slower here.)
"""

from dataclasses import dataclass

import numpy as np
import torch
from peer_task import (
    ACTIONS, BATCH, CELLS, CLIP_NORM, DISCOUNT, EPISODES, EPSILON, LEARNING_RATE, LINE_CELLS, MAX_STEPS, REACH,
    REWARD_BLOCKED, REWARD_HOLE, REWARD_STEP, SIDE, TARGET_SYNC, WARMUP, WIDTHS, Environment, Maps, decay_table,
)
from torch import nn
from torch.nn import functional

CAPACITY = 1_000_000
SYMMETRIES = 8
PADDED = CELLS + 2 * REACH


class QNetwork(nn.Module):
    """Five convolutions, three transposed ones; Q-values and predicted rewards."""

    def __init__(self) -> None:
        super().__init__()
        a, b, c, d, e, f, g = WIDTHS
        self.map = nn.ModuleList([
            nn.Conv2d(3, a, 5, 2, 2), nn.Conv2d(a, b, 3, 2, 1), nn.Conv2d(b, c, 3, 2, 1),
            nn.ConvTranspose2d(c, d, 3, 2, 1),
        ])
        self.window = nn.ModuleList([nn.Conv2d(3, e, 3, 1, 1), nn.Conv2d(e, f, 3, 1, 1)])
        self.head = nn.ModuleList([nn.ConvTranspose2d(d + f, g, 3, 1, 1), nn.ConvTranspose2d(g, 2, 3, 1, 1)])

    def forward(self, whole: torch.Tensor, near: torch.Tensor) -> torch.Tensor:
        """[batch, 2, 961], float32."""
        for layer in self.map:
            whole = apply(layer, whole).relu_()
        for layer in self.window:
            near = apply(layer, near).relu_()
        hidden = apply(self.head[0], torch.cat([whole, near], 1)).relu_()
        return apply(self.head[1], hidden).float().flatten(2)


def apply(layer: nn.Module, inputs: torch.Tensor) -> torch.Tensor:
    """A layer. With its bias a transposed one of stride 2 takes oneDNN ten times as long in bfloat16."""
    if isinstance(layer, nn.ConvTranspose2d):
        outputs = functional.conv_transpose2d(inputs, layer.weight, None, layer.stride, layer.padding)
        return outputs.add_(layer.bias[:, None, None])
    return layer(inputs)


def turn(grids: np.ndarray) -> np.ndarray:
    """All eight symmetries of square maps, [maps, 8, side, side]."""
    turned = np.empty((len(grids), SYMMETRIES, *grids.shape[1:]), grids.dtype)
    for n in range(SYMMETRIES):
        to = grids.transpose(0, 2, 1) if n & 4 else grids
        to = to[:, ::-1] if n & 1 else to
        turned[:, n] = to[:, :, ::-1] if n & 2 else to
    return turned


def turn_cells(cells: np.ndarray, symmetry: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns where cells (row-major) of a square come to lie."""
    row, column = np.divmod(cells, side)
    symmetry = symmetry.reshape(-1, *[1] * (cells.ndim - 1))
    row, column = np.where(symmetry & 4, column, row), np.where(symmetry & 4, row, column)
    return np.where(symmetry & 1, side - 1 - row, row), np.where(symmetry & 2, side - 1 - column, column)


@dataclass
class States:
    """States to be encoded: maps, symmetries, visited cells, and how many of them count."""

    maps: np.ndarray
    symmetry: np.ndarray
    visited: np.ndarray
    count: np.ndarray

    def turned(self) -> np.ndarray:
        """Numbers of the turned maps."""
        return self.maps * SYMMETRIES + self.symmetry


class Encoder:
    """Encodes states, and knows what is permissible and rewarded in them, with tables of all turned maps."""

    def __init__(self, maps: Maps, dtype: torch.dtype) -> None:
        self.dtype = dtype
        self.levels = maps.levels.reshape(-1)
        heights = turn(maps.heights).reshape(-1, CELLS, CELLS)
        self.heights = torch.from_numpy(heights).to(dtype)
        self.closed, self.holes = (torch.from_numpy(turn(grid).reshape(-1)) for grid in (maps.closed, maps.holes))
        self.line_cells = torch.from_numpy(LINE_CELLS).to(dtype)
        # One row of a map for each distance of rows and each column of the centre.
        table = decay_table()[CELLS - 1 :]
        rows = [table[:, CELLS - 1 - column : 2 * CELLS - 1 - column] for column in range(CELLS)]
        self.rows = torch.from_numpy(np.stack(rows, 1).reshape(-1, CELLS))
        self.around = np.arange(-REACH, REACH + 1)
        self.in_padded = (np.arange(SIDE)[:, None] * PADDED + np.arange(SIDE)).reshape(-1)

    def encode(self, states: States) -> tuple[torch.Tensor, torch.Tensor, np.ndarray]:
        """I_A, I_B, and where the windows of the states lie in the turned maps with a border."""
        n = len(states.maps)
        slots = np.arange(n)
        row, column = turn_cells(states.visited, states.symmetry, CELLS)
        steps = np.arange(states.visited.shape[1])
        weights = self.levels[states.maps[:, None] * (CELLS * CELLS) + states.visited]
        weights = np.where(steps < states.count[:, None], weights, np.float32(0))
        last = states.count - 1
        distances = np.abs(np.arange(CELLS)[:, None] - row[:, None, :])
        indices = distances * CELLS + column[:, None, :]
        location = self.rows[torch.from_numpy(indices[slots, :, last])]
        longest = states.count.max()
        bags = torch.from_numpy(indices[..., :longest].reshape(-1, longest))
        of_bags = torch.from_numpy(np.repeat(weights[:, :longest], CELLS, 0))
        levels = functional.embedding_bag(bags, self.rows, mode="sum", per_sample_weights=of_bags)
        # Rows of channels; one more for what lies beyond the map.
        flat = torch.empty(n * CELLS * CELLS + 1, 3, dtype=self.dtype)
        flat[-1] = torch.tensor([0.0, 0.0, 1.0])
        whole = flat[:-1].view(n, CELLS, CELLS, 3)
        turned = states.turned()
        whole[..., 0] = location
        whole[..., 1] = levels.view(n, CELLS, CELLS)
        whole[..., 2] = self.heights[torch.from_numpy(turned)]

        row, column = row[slots, last], column[slots, last]
        rows, columns = row[:, None] + self.around, column[:, None] + self.around
        inside = [(at >= 0) & (at < CELLS) for at in (rows, columns)]
        at = (slots[:, None] * CELLS + rows)[:, :, None] * CELLS + columns[:, None, :]
        at[~(inside[0][:, :, None] & inside[1][:, None, :])] = n * CELLS * CELLS
        near = flat[torch.from_numpy(at.reshape(-1))].view(n, SIDE, SIDE, 3)
        windows = turned * PADDED * PADDED + row * PADDED + column
        return whole.permute(0, 3, 1, 2), near.permute(0, 3, 1, 2), windows[:, None] + self.in_padded

    def permissible(self, windows: torch.Tensor) -> torch.Tensor:
        """[n, actions], bool."""
        return self.closed[windows].to(self.dtype) @ self.line_cells == 0


class Replay:
    """A ring of references: 26 bytes a transition."""

    def __init__(self, capacity: int = CAPACITY) -> None:
        self.capacity, self.added = capacity, 0
        self.maps = np.zeros(capacity, np.int32)
        self.visited = np.zeros((capacity, MAX_STEPS + 1), np.uint16)
        self.actions = np.zeros(capacity, np.int16)
        self.rewards = np.zeros(capacity, np.float16)
        self.count = np.zeros(capacity, np.uint8)
        self.terminal = np.zeros(capacity, np.bool_)

    def add(
        self, maps: np.ndarray, visited: np.ndarray, count: np.ndarray, actions: np.ndarray, rewards: np.ndarray,
        terminal: np.ndarray,
    ) -> None:
        """`visited` has the cell that the step led to, `count` does not count it."""
        at = (self.added + np.arange(len(maps))) % self.capacity
        self.maps[at], self.visited[at], self.count[at] = maps, visited, count
        self.actions[at], self.rewards[at], self.terminal[at] = actions, rewards, terminal
        self.added += len(maps)


class Tuned:
    """The loop, a pass at a time."""

    def __init__(self, maps: Maps, dtype: torch.dtype = torch.bfloat16, seed: int = 0) -> None:
        torch.manual_seed(seed)
        self.random = np.random.default_rng(seed)
        self.env, self.encoder, self.replay = Environment(maps, seed), Encoder(maps, dtype), Replay()
        # The networks compute with copies of the master weights, which are learned in float32.
        self.policy, self.target = (QNetwork().to(dtype, memory_format=torch.channels_last) for _ in range(2))
        self.parameters = [parameter.detach() for parameter in self.policy.parameters()]
        masters = QNetwork().to(memory_format=torch.channels_last)
        self.masters = [master.detach() for master in masters.parameters()]
        for master in self.masters:
            master.grad = torch.zeros_like(master)
        self.gradients = [master.grad for master in self.masters]
        self.adam = torch.optim.Adam(self.masters, lr=LEARNING_RATE, fused=True)
        torch._foreach_copy_(self.parameters, self.masters)
        self.target.load_state_dict(self.policy.state_dict())
        self.updates = 0
        while self.replay.added < WARMUP:
            self.act(1.0)

    @torch.no_grad()
    def act(self, epsilon: float = EPSILON) -> None:
        """One step of all episodes, among permissible actions."""
        env = self.env
        scores = np.where(env.permissible, self.random.random((EPISODES, ACTIONS), np.float32), -np.float32(1))
        actions = scores.argmax(1)
        greedy = np.flatnonzero(self.random.random(EPISODES) >= epsilon)
        if len(greedy):
            states = States(env.map[greedy], np.zeros_like(greedy), env.visited[greedy], env.count[greedy])
            q_values = self.policy(*self.encoder.encode(states)[:2])[:, 0]
            forbidden = torch.from_numpy(~env.permissible[greedy])
            actions[greedy] = q_values.masked_fill_(forbidden, -torch.inf).argmax(1).numpy()
        maps, count = env.map.copy(), env.count.copy()
        steps = env.step(actions)
        self.replay.add(maps, env.visited, count, actions, steps.rewards, steps.terminal)
        env.renew(steps)

    def sample(self, count: int = BATCH) -> dict[str, torch.Tensor]:
        """A batch, turned and flipped at random."""
        replay = self.replay
        at = self.random.integers(min(replay.added, replay.capacity), size=count)
        symmetry = self.random.integers(SYMMETRIES, size=count)
        maps, visited, visits = replay.maps[at].astype(np.int64), replay.visited[at].astype(np.int64), replay.count[at]
        # Before and after the step in one go: the state after it has one cell more.
        visits = np.concatenate([visits, visits + 1]).astype(np.int64)
        states = States(np.tile(maps, 2), np.tile(symmetry, 2), np.tile(visited, (2, 1)), visits)
        whole, near, windows = self.encoder.encode(states)
        windows = torch.from_numpy(windows)
        permissible = self.encoder.permissible(windows)
        ends = permissible[:count] & self.encoder.holes[windows[:count]]
        rewards = torch.where(permissible[:count], REWARD_STEP, REWARD_BLOCKED).masked_fill_(ends, REWARD_HOLE)
        row, column = turn_cells(replay.actions[at].astype(np.int64), symmetry, SIDE)
        return {
            "map": whole[:count],
            "window": near[:count],
            "next_map": whole[count:],
            "next_window": near[count:],
            "action": torch.from_numpy(row * SIDE + column),
            "reward": torch.from_numpy(replay.rewards[at].astype(np.float32)),
            "terminal": torch.from_numpy(replay.terminal[at].astype(np.float32)),
            "next_permissible": permissible[count:],
            "all_rewards": rewards,
            "all_terminal": ends.float(),
        }

    def loss(self, batch: dict[str, torch.Tensor]) -> torch.Tensor:
        """Huber loss of Double DQN, of all Q-values that are known to be 0, and squared errors of all rewards."""
        with torch.no_grad():
            # A state after the end has no value, so nobody looks at it.
            goes_on = (batch["terminal"] == 0).nonzero().squeeze(1)
            inputs = batch["next_map"][goes_on], batch["next_window"][goes_on]
            online = self.policy(*inputs)[:, 0].masked_fill_(~batch["next_permissible"][goes_on], -torch.inf)
            value = self.target(*inputs)[:, 0].gather(1, online.argmax(1, keepdim=True)).squeeze(1)
            y = batch["reward"].index_add(0, goes_on, DISCOUNT * value)
        q_values, rewards = self.policy(batch["map"], batch["window"]).unbind(1)
        taken = q_values.gather(1, batch["action"][:, None]).squeeze(1)
        ends = batch["all_terminal"]
        dense = functional.huber_loss(q_values * ends, torch.zeros(()).expand_as(ends), reduction="sum")
        dense = dense / ends.sum().clamp(1)
        return functional.huber_loss(taken, y) + dense + functional.mse_loss(rewards, batch["all_rewards"])

    def update(self) -> None:
        """One gradient update."""
        loss = self.loss(self.sample())
        self.policy.zero_grad()
        loss.backward()
        torch._foreach_copy_(self.gradients, [parameter.grad for parameter in self.policy.parameters()])
        nn.utils.clip_grad_norm_(self.masters, CLIP_NORM, foreach=True)
        self.adam.step()
        torch._foreach_copy_(self.parameters, self.masters)
        self.updates += 1
        if self.updates % TARGET_SYNC == 0:
            self.target.load_state_dict(self.policy.state_dict())

    def pass_(self) -> None:
        """A step of all episodes and an update."""
        self.act()
        self.update()

"""Double DQN in plain PyTorch, in the manner of CleanRL's dqn.py: a peer of the training benchmark.

float32, a replay of whole observations (the next ones too), no treatment of its own for this task.
"""

import numpy as np
import torch
from numpy.lib.stride_tricks import sliding_window_view
from peer_task import (
    ACTIONS, BATCH, CELLS, CLIP_NORM, DISCOUNT, EPISODES, EPSILON, LEARNING_RATE, REACH, SIDE, TARGET_SYNC, WIDTHS,
    Environment, Maps, decay_table,
)
from torch import nn
from torch.nn import functional

Observations = tuple[np.ndarray, np.ndarray]


class QNetwork(nn.Module):
    """Five convolutions, three transposed ones; 961 Q-values."""

    def __init__(self) -> None:
        super().__init__()
        a, b, c, d, e, f, g = WIDTHS
        self.map = nn.Sequential(
            nn.Conv2d(3, a, 5, 2, 2), nn.ReLU(), nn.Conv2d(a, b, 3, 2, 1), nn.ReLU(),
            nn.Conv2d(b, c, 3, 2, 1), nn.ReLU(), nn.ConvTranspose2d(c, d, 3, 2, 1), nn.ReLU(),
        )
        self.window = nn.Sequential(nn.Conv2d(3, e, 3, 1, 1), nn.ReLU(), nn.Conv2d(e, f, 3, 1, 1), nn.ReLU())
        self.head = nn.Sequential(
            nn.ConvTranspose2d(d + f, g, 3, 1, 1), nn.ReLU(), nn.ConvTranspose2d(g, 1, 3, 1, 1), nn.Flatten(),
        )

    def forward(self, whole: torch.Tensor, near: torch.Tensor) -> torch.Tensor:
        return self.head(torch.cat([self.map(whole), self.window(near)], 1))


class VectorEnv:
    """Episodes with their observations, which are kept and added to."""

    def __init__(self, maps: Maps, seed: int) -> None:
        self.task = Environment(maps, seed)
        self.slots = self.task.slots
        self.decays = sliding_window_view(decay_table(), (CELLS, CELLS))
        side = CELLS + 2 * REACH
        self.padded = np.zeros((EPISODES, 3, side, side), np.float32)
        self.padded[:, 2] = 1.0
        self.whole = self.padded[:, :, REACH:-REACH, REACH:-REACH]
        self.windows = sliding_window_view(self.padded, (SIDE, SIDE), (2, 3))
        self.reset(self.slots)

    def reset(self, slots: np.ndarray) -> None:
        self.whole[slots, 1] = 0.0
        self.whole[slots, 2] = self.task.maps.heights[self.task.map[slots]]
        self.measure(slots)

    def measure(self, slots: np.ndarray) -> None:
        rows, columns = np.divmod(self.task.cells()[slots], CELLS)
        location = self.decays[CELLS - 1 - rows, CELLS - 1 - columns]
        level = self.task.maps.levels[self.task.map[slots], rows, columns]
        self.whole[slots, 0] = location
        self.whole[slots, 1] += level[:, None, None] * location

    def observations(self) -> Observations:
        """Copies of I_A and I_B."""
        rows, columns = np.divmod(self.task.cells(), CELLS)
        return self.whole.copy(), self.windows[self.slots, :, rows, columns]

    def step(self, actions: np.ndarray) -> tuple[Observations, Observations, np.ndarray, np.ndarray]:
        """Observations to go on from, those that the step led to, rewards, ends at a hole."""
        steps = self.task.step(actions)
        self.measure(self.slots)
        final = self.observations()
        ended = self.task.renew(steps)
        if not len(ended):
            return final, final, steps.rewards, steps.terminal
        self.reset(ended)
        return self.observations(), final, steps.rewards, steps.terminal


class ReplayBuffer:
    """Whole transitions, as many as fit into so many bytes."""

    def __init__(self, memory: int) -> None:
        self.size = memory // (2 * 4 * 3 * (CELLS * CELLS + ACTIONS))
        assert self.size >= BATCH, "the memory budget does not hold a batch"
        self.whole, self.next_whole = (np.empty((self.size, 3, CELLS, CELLS), np.float32) for _ in range(2))
        self.near, self.next_near = (np.empty((self.size, 3, SIDE, SIDE), np.float32) for _ in range(2))
        self.actions = np.empty(self.size, np.int64)
        self.rewards, self.terminal = (np.empty(self.size, np.float32) for _ in range(2))
        self.added = 0

    def add(
        self, obs: Observations, final: Observations, actions: np.ndarray, rewards: np.ndarray, terminal: np.ndarray
    ) -> None:
        at = (self.added + np.arange(len(actions))) % self.size
        self.whole[at], self.near[at] = obs
        self.next_whole[at], self.next_near[at] = final
        self.actions[at], self.rewards[at], self.terminal[at] = actions, rewards, terminal
        self.added += len(actions)

    def sample(self, count: int, random: np.random.Generator) -> list[torch.Tensor]:
        at = random.integers(min(self.added, self.size), size=count)
        parts = (
            self.whole, self.near, self.next_whole, self.next_near, self.actions, self.rewards, self.terminal,
        )
        return [torch.from_numpy(part[at]) for part in parts]


class Plain:
    """The loop, a pass at a time."""

    def __init__(self, maps: Maps, memory: int, seed: int = 0) -> None:
        torch.manual_seed(seed)
        self.random = np.random.default_rng(seed)
        self.env = VectorEnv(maps, seed)
        self.replay = ReplayBuffer(memory)
        self.q_network, self.target_network = QNetwork(), QNetwork()
        self.target_network.load_state_dict(self.q_network.state_dict())
        self.optimizer = torch.optim.Adam(self.q_network.parameters(), lr=LEARNING_RATE)
        self.obs = self.env.observations()
        self.updates = 0
        while self.replay.added < self.replay.size:
            self.act(1.0)

    def act(self, epsilon: float = EPSILON) -> None:
        """One step of all episodes."""
        actions = self.random.integers(ACTIONS, size=EPISODES)
        if epsilon < 1.0:
            with torch.no_grad():
                q_values = self.q_network(*map(torch.from_numpy, self.obs))
            explores = self.random.random(EPISODES) < epsilon
            actions = np.where(explores, actions, q_values.argmax(1).numpy())
        obs, final, rewards, terminal = self.env.step(actions)
        self.replay.add(self.obs, final, actions, rewards, terminal)
        self.obs = obs

    def update(self) -> None:
        """One gradient update."""
        whole, near, next_whole, next_near, actions, rewards, terminal = self.replay.sample(BATCH, self.random)
        with torch.no_grad():
            best = self.q_network(next_whole, next_near).argmax(1, keepdim=True)
            value = self.target_network(next_whole, next_near).gather(1, best).squeeze(1)
            target = rewards + DISCOUNT * (1 - terminal) * value
        q_values = self.q_network(whole, near).gather(1, actions[:, None]).squeeze(1)
        loss = functional.huber_loss(q_values, target)
        self.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.q_network.parameters(), CLIP_NORM)
        self.optimizer.step()
        self.updates += 1
        if self.updates % TARGET_SYNC == 0:
            self.target_network.load_state_dict(self.q_network.state_dict())

    def pass_(self) -> None:
        """A step of all episodes and an update."""
        self.act()
        self.update()

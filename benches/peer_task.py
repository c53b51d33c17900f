"""The task once more in NumPy, for the peers of the training benchmark: maps, lines of sight, episodes."""

import io
from dataclasses import dataclass
from pathlib import Path

import msgpack
import numpy as np
import zstandard
from numpy.lib.stride_tricks import sliding_window_view

CELLS, REACH, MAX_STEPS = 121, 15, 8
SIDE = 2 * REACH + 1
ACTIONS = SIDE * SIDE
DECAY, THRESHOLD_DBM, FLOOR_DBM, HEIGHT_SCALE_M, FLIGHT_HEIGHT_M = 0.1, -100.0, -160.0, 50.0, 2.0
MASK_BUILDING = 1
REWARD_HOLE, REWARD_STEP, REWARD_BLOCKED = 0.0, -0.25, -1.25

# The hyperparameters of the default preset; exploration as at its end.
BATCH, EPISODES, WARMUP, TARGET_SYNC = 64, 64, 4096, 250
DISCOUNT, LEARNING_RATE, CLIP_NORM, EPSILON = 0.99, 5e-4, 10.0, 0.05
WIDTHS = (32, 64, 128, 64, 32, 64, 32)

OFFSETS = np.stack(np.divmod(np.arange(ACTIONS), SIDE), 1) - REACH


def line_cells() -> np.ndarray:
    """Whether the supercover line to a target (second axis) touches a cell of the window (first axis)."""
    row, column = OFFSETS[:, None, 0], OFFSETS[:, None, 1]
    to_row, to_column = OFFSETS[None, :, 0], OFFSETS[None, :, 1]
    in_box = (np.minimum(to_row, 0) <= row) & (row <= np.maximum(to_row, 0))
    in_box &= (np.minimum(to_column, 0) <= column) & (column <= np.maximum(to_column, 0))
    corners = [to_row * (2 * column + j) - to_column * (2 * row + i) for i in (-1, 1) for j in (-1, 1)]
    return in_box & (np.min(corners, 0) <= 0) & (np.max(corners, 0) >= 0)


def pull_backs() -> np.ndarray:
    """For every action the actions that it is pulled back to (Algorithm 1), farthest first; the last is to stay."""
    length = np.abs(OFFSETS).max(1)[:, None]
    step = np.maximum(length - np.arange(REACH + 1), 0)
    points = np.maximum(length, 1)
    row, column = ((2 * step * axis[:, None] + points) // (2 * points) for axis in OFFSETS.T)
    return (row + REACH) * SIDE + column + REACH


LINE_CELLS = line_cells().astype(np.float32)
PULL_BACKS = pull_backs()


def decay_table() -> np.ndarray:
    """2^(-c d) at row and column distances from -(L - 1) to L - 1."""
    distances = np.arange(1 - CELLS, CELLS)
    return (2.0 ** (-DECAY * np.hypot(distances[:, None], distances))).astype(np.float32)


@dataclass
class Maps:
    """Maps with a hole and a covered free cell; [maps, L, L], or with a border of l cells."""

    heights: np.ndarray
    """Divided by the scale."""
    levels: np.ndarray
    """RSRP above the threshold, normalised."""
    closed: np.ndarray
    """Occupied or beyond the map; with a border."""
    holes: np.ndarray
    """Coverage holes; with a border."""
    starts: list[np.ndarray]
    """Covered free cells, row-major."""


def load_maps(dataset: Path) -> Maps:
    """The train split."""
    heights, levels, closed, holes, starts = [], [], [], [], []
    for shard in sorted(dataset.glob("train/*.msgpack.zst")):
        with shard.open("rb") as file:
            stream = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
            for record in msgpack.Unpacker(stream, max_buffer_size=1 << 30):
                height, rsrp, mask = (np.load(io.BytesIO(record[name])) for name in ("height_m", "rsrp_dbm", "mask"))
                rsrp = np.maximum(rsrp, np.float32(FLOOR_DBM))
                occupied = height >= FLIGHT_HEIGHT_M
                hole = ~occupied & (mask != MASK_BUILDING) & (rsrp < THRESHOLD_DBM)
                start = np.flatnonzero(~occupied & ~hole)
                if hole.any() and len(start):
                    heights.append(height / np.float32(HEIGHT_SCALE_M))
                    levels.append((rsrp - np.float32(THRESHOLD_DBM)) / np.float32(-THRESHOLD_DBM))
                    closed.append(np.pad(occupied, REACH, constant_values=True))
                    holes.append(np.pad(hole, REACH))
                    starts.append(start)
    assert starts, f"no map of {dataset} has both a hole and a covered free cell"
    return Maps(np.array(heights), np.array(levels), np.array(closed), np.array(holes), starts)


def permissible_of(closed: np.ndarray) -> np.ndarray:
    """The permissible sets of windows of closed cells, [n, actions]."""
    return closed.reshape(-1, ACTIONS).astype(np.float32) @ LINE_CELLS == 0


@dataclass
class Steps:
    """What a step of all episodes came to."""

    cells: np.ndarray
    rewards: np.ndarray
    terminal: np.ndarray
    truncated: np.ndarray


class Environment:
    """Many episodes at a time on maps drawn at random."""

    def __init__(self, maps: Maps, seed: int, episodes: int = EPISODES) -> None:
        self.maps, self.random = maps, np.random.default_rng(seed)
        self.windows = sliding_window_view(maps.closed, (SIDE, SIDE), (1, 2))
        self.slots = np.arange(episodes)
        self.map = np.zeros(episodes, np.int64)
        self.count = np.zeros(episodes, np.int64)
        self.visited = np.zeros((episodes, MAX_STEPS + 1), np.int64)
        self.begin(self.slots)
        self.look()

    def begin(self, slots: np.ndarray) -> None:
        """New episodes."""
        self.map[slots] = self.random.integers(len(self.maps.starts), size=len(slots))
        self.visited[slots, 0] = [self.random.choice(self.maps.starts[at]) for at in self.map[slots]]
        self.count[slots] = 1

    def look(self) -> None:
        """The permissible sets of all episodes."""
        self.permissible = permissible_of(self.windows[self.map, *np.divmod(self.cells(), CELLS)])

    def cells(self) -> np.ndarray:
        """Where the UAVs are, row-major."""
        return self.visited[self.slots, self.count - 1]

    def step(self, actions: np.ndarray) -> Steps:
        """Moves all UAVs, back along the line where the action is not permissible; nothing begins anew yet."""
        ways = PULL_BACKS[actions]
        reached = ways[self.slots, self.permissible[self.slots[:, None], ways].argmax(1)]
        rows, columns = (OFFSETS[reached] + np.stack(np.divmod(self.cells(), CELLS), 1)).T
        cells = rows * CELLS + columns
        self.visited[self.slots, self.count] = cells
        self.count += 1
        terminal = self.maps.holes[self.map, rows + REACH, columns + REACH]
        allowed = self.permissible[self.slots, actions]
        rewards = np.where(allowed, np.where(terminal, REWARD_HOLE, REWARD_STEP), REWARD_BLOCKED).astype(np.float32)
        return Steps(cells, rewards, terminal, ~terminal & (self.count > MAX_STEPS))

    def renew(self, steps: Steps) -> np.ndarray:
        """Begins anew what has ended; those slots."""
        ended = np.flatnonzero(steps.terminal | steps.truncated)
        self.begin(ended)
        self.look()
        return ended

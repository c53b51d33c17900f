"""Independent repeats of a trace: directions of rays that are shifted at random, and the mean and error of what was traced.

Sionna takes the directions of rays from a Fibonacci lattice on the unit square, which depends on their number alone; `seed` moves
diffraction only. So two traces of a scene share their directions, and close numbers of rays share most of them. Here the lattice
is shifted by a vector that is uniform on the torus, another one for each repeat (a Cranley-Patterson rotation: randomised
quasi-Monte-Carlo). Every single direction is then uniform on the sphere, so that the expectation of a repeat is what more and
more rays converge to, and repeats are independent: their scatter tells the error of their mean. A repeat has a seed of its
own too, for diffraction.

The hook is one name: the solver's module calls `fibonacci_lattice`, and while a repeat is traced that name is another function.
It fails aloud where Sionna has no such name there, or does not call it exactly once.

What it does not mend: the wedges that diffract are those that the rays of one repeat hit. Of many small repeats each finds fewer
than one trace of all their rays.
"""

import contextlib
import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from sionna_files import WEDGE_TABLE, InvalidInput

GOLDEN_RATIO = (1 + math.sqrt(5)) / 2


@dataclass(frozen=True)
class Shift:
    """What is random about a repeat: the shift of the lattice, 0 to below 1 along either side, and the solver's seed."""

    x: float
    y: float
    seed: int


def shift_of(seed: int, ident: str, base_station: int, repeat: int) -> Shift:
    """The shift of a repeat (counted from 0) of a base station of a scene: always the same, and another one for each.

    The first 20 bytes of a SHA-256: two fractions of 64 bits, and 32 bits of which Sionna takes 31.
    """
    digest = hashlib.sha256(f"{seed} {ident} {base_station} {repeat}".encode()).digest()
    x, y, solver = (int.from_bytes(digest[begin:end], "little") for begin, end in ((0, 8), (8, 16), (16, 20)))
    # 53 bits are what a double holds below 1.
    return Shift((x >> 11) / 2**53, (y >> 11) / 2**53, solver >> 1)


def shifted_lattice(count: int, shift: Shift) -> Any:
    """The Fibonacci lattice of `count` points on the unit square, shifted by a vector and wrapped round, as a `mitsuba.Point2f`.

    Rows lie 1 / count apart, where Sionna has 1 / (count - 1), so that the first and the last do not meet when they wrap round.
    The shift is opaque to Dr.Jit: else it would compile the solver anew for each repeat.
    """
    import drjit
    import mitsuba

    index = drjit.arange(mitsuba.Float64, 0, count)
    x = index / GOLDEN_RATIO + drjit.opaque(mitsuba.Float64, shift.x)
    y = (index + 0.5) / count + drjit.opaque(mitsuba.Float64, shift.y)
    return mitsuba.Point2f(x - drjit.floor(x), y - drjit.floor(y))


@contextlib.contextmanager
def shifted_directions(shift: Shift, samples: int) -> Iterator[None]:
    """While it is open, one call of the solver with `samples` rays takes them in directions that are shifted.

    Raises InvalidInput if the solver does not take its directions from where it is known to, so that they were not shifted.
    """
    from sionna.rt import utils
    from sionna.rt.radio_map_solvers import radio_map_solver as solver

    name = "fibonacci_lattice"
    original = getattr(solver, name, None)
    if original is None or original is not getattr(utils, name, None):
        raise InvalidInput(f"{solver.__name__} does not take directions from sionna.rt.utils.{name}: repeats need the pinned Sionna, "
                           "install pipeline/sionna-requirements.txt")
    calls = []

    def lattice(count: int) -> Any:
        calls.append(count)
        return shifted_lattice(count, shift)

    setattr(solver, name, lattice)
    try:
        yield
    finally:
        setattr(solver, name, original)
    if calls != [samples]:
        raise InvalidInput(f"expected the solver to ask once for {samples} directions, it asked for {calls}: repeats need the pinned "
                           "Sionna, install pipeline/sionna-requirements.txt")


@contextlib.contextmanager
def wedge_table(places: int) -> Iterator[None]:
    """While it is open, the solver's hash table of diffracting wedges has so many places. Raises InvalidInput if it has no such table."""
    from sionna.rt import RadioMapSolver

    name = "_WEDGE_INTERSECTIONS_SIZE"
    if getattr(RadioMapSolver, name, None) != WEDGE_TABLE:
        raise InvalidInput(f"expected {name} of {WEDGE_TABLE} in sionna.rt.RadioMapSolver, found {getattr(RadioMapSolver, name, None)}: "
                           "install pipeline/sionna-requirements.txt")
    setattr(RadioMapSolver, name, places)
    try:
        yield
    finally:
        setattr(RadioMapSolver, name, WEDGE_TABLE)


class Moments:
    """Mean and standard error of maps that come one by one (Welford's algorithm in float64), and the mean of their first half."""

    def __init__(self, repeats: int) -> None:
        if repeats < 2 or repeats % 2:
            raise ValueError(f"{repeats} repeats: expected an even number")
        self.repeats = repeats
        self.count = 0
        self.mean: np.ndarray | float = 0.0
        self.squares: np.ndarray | float = 0.0
        self.first_half: np.ndarray | None = None

    def add(self, path_gain: np.ndarray) -> None:
        """Adds a repeat."""
        self.count += 1
        difference = path_gain.astype(np.float64) - self.mean
        self.mean = self.mean + difference / self.count
        self.squares = self.squares + difference * (path_gain - self.mean)
        if 2 * self.count == self.repeats:
            self.first_half = self.mean

    def arrays(self) -> dict[str, np.ndarray]:
        """What a map's file holds of them, float32, linear: mean, standard error of it, and mean of the first half."""
        if self.count != self.repeats or self.first_half is None:
            raise ValueError(f"expected {self.repeats} repeats, found {self.count}")
        error = np.sqrt(self.squares / (self.repeats - 1) / self.repeats)
        return {name: np.asarray(values, dtype=np.float32) for name, values in (
            ("path_gain", self.mean), ("path_gain_std_error", error), ("path_gain_first_half", self.first_half))}

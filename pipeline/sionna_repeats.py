"""Independent repeats of a trace: directions of rays that are shifted at random, and the mean and error of what was traced.

Sionna takes the directions of rays from a Fibonacci lattice on the unit square, which depends on their number alone; `seed` moves
diffraction only. So two traces of a scene share their directions, and close numbers of rays share most of them. Here the lattice
is shifted by a vector that is uniform on the torus, another one for each repeat (a Cranley-Patterson rotation: randomised
quasi-Monte-Carlo). Every single direction is then uniform on the sphere, so that the expectation of a repeat is what more and
more rays converge to, and repeats are independent: their scatter tells the error of their mean. A repeat has a seed of its
own too, for diffraction.

The hook is one name: the solver's module calls `fibonacci_lattice`, and while a repeat is traced that name is another function.
It fails aloud where Sionna has no such name there, or does not call it exactly once.

Cells that shine: now and then diffraction in sionna-rt 2.2.0 gives a single cell of a single repeat far more than free space would, up to
103 dB more (benches/RESULTS.md). A mean of eight would still shine. What no sum of paths can reach is therefore left out
(`combine`). In free space a path of reflections is longer than the straight one, and weaker; with walls on two sides, a depth of 5 and
the ground there are at most 2 (2 · 5 + 1) specular paths, 13.4 dB above one. So the ceiling lies 15 dB above free space.

Wedges are shared (`SharedWedges`), so that the mean of repeats is not biased against one trace of all their rays. A wedge that none of
all rays found is missing from all repeats, and their error does not tell it.
"""

import contextlib
import hashlib
import inspect
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from sionna_files import CEILING_DB, WEDGE_TABLE, InvalidInput, Metadata

GOLDEN_RATIO = (1 + math.sqrt(5)) / 2
SPEED_OF_LIGHT = 299_792_458.0


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


class SharedWedges:
    """Repeats of one base station that diffract at the wedges that any of them found.

    Sionna finds the wedges that diffract by the rays that leave the base station and hit near them: 1.25e7 rays found 7,963 of a tile of
    San Jose, 1e8 rays 10,270. A repeat lacks what only wedges give that it did not find, and so does a mean of repeats, however many.
    Therefore rays of all repeats are shot first, and each repeat then diffracts at all wedges. It costs nothing more.

    The hook is two methods of the solver, whose names and arguments are checked: one shoots and returns a table of wedges, the other one
    adds diffraction to a radio map.
    """

    def __init__(self, solver: Any) -> None:
        from sionna.rt import RadioMapSolver

        self.solver = solver
        self.shoot = getattr(solver, "_shoot_and_bounce", None)
        self.diffract = getattr(solver, "_evaluate_first_order_diffraction", None)
        if not (self.shoot and self.diffract):
            raise InvalidInput("sionna.rt.RadioMapSolver does not shoot and diffract by the methods that are known: repeats need the pinned "
                               "Sionna, install pipeline/sionna-requirements.txt")
        self.lit_region = inspect.signature(RadioMapSolver.__call__).parameters["diffraction_lit_region"].default
        # Arguments of the solver's methods, and occupied places of the table of wedges with what lies there.
        self.shots: list[tuple[dict[str, Any], Any, Any]] = []
        self.places = 0

    @contextlib.contextmanager
    def only_shooting(self) -> Iterator[None]:
        """While it is open, the solver shoots rays, and its radio maps lack diffraction."""
        self.solver._shoot_and_bounce = self.note
        self.solver._evaluate_first_order_diffraction = lambda *_: None
        try:
            yield
        finally:
            del self.solver._shoot_and_bounce, self.solver._evaluate_first_order_diffraction

    def note(self, *arguments: Any) -> Any:
        """Shoots, and keeps what diffraction needs."""
        import drjit
        from sionna.rt.utils import WedgeGeometry

        table = self.shoot(*arguments)
        if table is not None:
            self.places = drjit.width(table.length)
            at = drjit.compress(table.length > 0)
            wedges = drjit.gather(WedgeGeometry, table, at)
            drjit.eval(wedges)
            self.shots.append((inspect.signature(self.shoot).bind(*arguments).arguments, at, wedges))
        return table

    def add_diffraction(self, seeds: list[int]) -> None:
        """Adds diffraction at all wedges to the radio maps of all shots, of which each has a seed."""
        import drjit
        from sionna.rt.utils import WedgeGeometry

        if not self.shots:
            return
        # A wedge has its place in the table of every shot.
        table = WedgeGeometry.build_with_size(self.places)
        for _, at, wedges in self.shots:
            drjit.scatter(table, wedges, at)
        at = drjit.compress(table.length > 0)
        if not drjit.width(at):
            return
        wedges = drjit.gather(WedgeGeometry, table, at)
        names = inspect.signature(self.diffract).parameters.keys() - {"wedges", "diffraction_lit_region"}
        for (arguments, _, _), seed in zip(self.shots, seeds, strict=True):
            if arguments["max_depth"] > 0:
                # As the solver does it: the sampler starts anew for diffraction.
                self.solver._sampler.seed(seed + 1, arguments["samples_per_tx"])
                self.diffract(**{name: arguments[name] for name in names}, wedges=wedges, diffraction_lit_region=self.lit_region)


def ceiling_of(metadata: Metadata, position: list[float]) -> np.ndarray:
    """The path gain that no sum of paths reaches in a cell, linear, [rows, columns], row 0 south: free space from the point of the
    cell nearest to the base station, and CEILING_DB more.
    """
    cells = round(metadata["map_size_m"] / metadata["cell_size_m"])
    centres = (np.arange(cells) + 0.5) * metadata["cell_size_m"] - metadata["map_size_m"] / 2
    east, north = (np.maximum(np.abs(centres - at) - metadata["cell_size_m"] / 2, 0) for at in position[:2])
    distance_m = np.sqrt(east[None, :] ** 2 + north[:, None] ** 2 + (position[2] - metadata["rx_height_m"]) ** 2)
    wavelength_m = SPEED_OF_LIGHT / metadata["frequency_hz"]
    return (wavelength_m / (4 * math.pi * distance_m)) ** 2 * 10 ** (CEILING_DB / 10)


def combine(maps: np.ndarray, ceiling: np.ndarray) -> tuple[dict[str, np.ndarray], int]:
    """What a map's file holds of its repeats, and how many of their cells shone.

    `maps`: path gains, linear, [repeats, rows, columns]; `ceiling`: those that no cell can have, [rows, columns]. The arrays are the
    mean, its standard error and the mean of the first half of the repeats, float32, linear, [rows, columns].

    A cell of a repeat above the ceiling counts as the mean of the other repeats of its half, so that both halves still
    weigh alike; where a whole half is above, nothing is known to be wrong, and it stays.
    """
    repeats = len(maps)
    if repeats < 2 or repeats % 2:
        raise ValueError(f"{repeats} repeats: expected an even number")
    halves = maps.astype(np.float64).reshape(2, repeats // 2, *ceiling.shape)
    shines = halves > ceiling
    shines &= ~shines.all(axis=1, keepdims=True)
    others = np.where(shines, 0.0, halves).sum(axis=1, keepdims=True) / np.maximum((~shines).sum(axis=1, keepdims=True), 1)
    halves = np.where(shines, others, halves)
    kept = halves.reshape(maps.shape)
    arrays = {"path_gain": kept.mean(0), "path_gain_std_error": kept.std(0, ddof=1) / math.sqrt(repeats),
              "path_gain_first_half": halves[0].mean(0)}
    return {name: values.astype(np.float32) for name, values in arrays.items()}, int(shines.sum())

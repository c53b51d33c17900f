"""Traces the scenes of `holescout scenes` with Sionna RT: path gain of every base station, one map a scene.

    sionna_trace.py SCENES --out MAPS

reads `SCENES/<id>/{scene.json, scene.xml, *.ply}` (schema scene.v1) and writes `MAPS/<id>.npz` with

- `path_gain`: float32, linear, a cell's average: the mean over the repeats in linear power, those that do not reach the cell counted
  as 0; exactly 0 where no path arrives. Shape [rows, columns] for one base station, [n, rows, columns] for n. Row 0 is the
  southernmost and column 0 the westernmost, as Sionna emits it.
- `path_gain_std_error`: the standard error of that mean: sample standard deviation over sqrt(R); same type and shape.
- `path_gain_first_half`: the mean over repeats 0 to R/2 - 1; that of the other half is twice `path_gain` less it; same type and shape.
- `meta_json`: metadata (schema radio_map.v1) as UTF-8 in uint8. With n base stations `tx_position_m` is a list of n.

Each base station is traced R times, independently (`sionna_repeats`): `--repeats R`, 8 unless told otherwise. With `--repeats 1` there is a
single trace in Sionna's own directions, and `path_gain` alone.

Of repeats metadata have `repeats` (R), `direction_shift` ("random"), `ceiling_db` (cells of a repeat so far above free space are left out)
and `wedge_table`; `samples_per_tx` are the rays of one repeat, so that R
times as many made the map.

All scenes are traced in one process, so that kernels are compiled once. A map is renamed into place when it is complete and
on disk; a run that was killed goes on where it was. A map that was traced from another scene or with other parameters is an
error, unless `--overwrite` replaces it. A map is not bit for bit the same when it is traced again (diffraction adds in the
order of the hardware): what is published should be the file, not the command.

What was found in sionna-rt 2.2.0, and why it is called as it is:

- Base stations are traced one by one. In one call they would share a table of 10,000 diffracting wedges, and each would
  spend samples on wedges that only the others see.
- The table is a hash table that drops a wedge whose place is taken, and with it all that it diffracts in this trace. With base stations
  anywhere 4e6 rays found 6,400 and 5,700 wedges on two tiles of San Jose, of which seven tenths were kept; weak cells came out 1.2 dB
  lower in the mean (benches/RESULTS.md). More rays find more wedges and lose more. A single trace leaves it as Sionna has it, so that
  maps are those of Sionna; repeats take a table of 1,000,000 places, which costs 3 to 4 % of time.
- Directions of rays are a Fibonacci lattice that depends on the number of samples alone; `seed` moves diffraction only (and, with
  refraction, what is refracted and what reflected). So runs with other seeds cannot be averaged into a better map; repeats
  shift the lattice. More rays in one trace cost nothing but time: the solver is one fused loop, and 2e7 samples take no more
  memory than 1e5 (about 200 MB on a CPU).
- The solver's module calls `fibonacci_lattice` by its global name, once a trace: that is what repeats replace.
- Wedges are found by shared vertices. Scenes of Holescout share them within a building and never between two; therefore
  `remove_duplicate_vertices` stays off: it would weld buildings that touch, and edges where four faces meet diffract
  wrongly. A scene most of whose edges are open is refused, for it would be traced without diffraction; a few are told.
- `merge_shapes` stays off as well: there is one mesh of a material already, and Sionna would rename what it merges.
- Faces must be counter-clockwise seen from outside: turned round, single cells of a test scene changed by 42 dB.

It does not judge whether a map is plausible: `holescout import-rsrp` does.

Exit status: 0 all maps are there; 1 a scene failed, the others are done; 2 wrong usage; 3 nothing was traced, for an input or
an existing map does not fit. Tasks (`--task-count`) say 42 instead of 2 and 3: permanent, do not retry.
"""

import argparse
import json
import math
import os
import re
import sys
import time
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from sionna_files import (
    CEILING_DB,
    SIONNA_VERSION,
    WEDGE_TABLE,
    InvalidInput,
    Metadata,
    Options,
    Scene,
    find_scenes,
    is_traced,
    read_scene,
    sionna_version,
    write_map,
)
from sionna_repeats import SharedWedges, Shift, ceiling_of, combine, shift_of, shifted_directions, wedge_table
from sionna_tasks import PERMANENT, Busy, add_arguments, locked, part_suffix, task_of

VARIANTS = ("cuda_ad_mono_polarized", "llvm_ad_mono_polarized")
# With LLVM 15 Dr.Jit aborts while it compiles the solver.
LLVM_VERSION = 19
LLVM_FOLDERS = ("/usr/lib/*-linux-gnu", "/usr/lib/llvm-*/lib", "/usr/lib64", "/usr/local/lib", "/opt/homebrew/opt/llvm*/lib")
# Rays are counted in 32 bits.
MOST_SAMPLES = 2**32 - 1
# Of 6,400 wedges that a base station of San Jose sees, Sionna's table keeps seven tenths; this one loses fewer than 1 %, for 3 to 4 % of time.
REPEATED_WEDGE_TABLE = 1_000_000
# Enough to tell an error by (docs/LABELS.md).
REPEATS = 8
# Share of edges without an opposite face that is told, but let pass: where a building touches itself.
OPEN_EDGES = 0.01
# What a bad scene may raise, here and in Sionna. It must not cost the other scenes their maps.
FAILURES = (InvalidInput, OSError, LookupError, AttributeError, TypeError, ValueError, ArithmeticError, RuntimeError,
            MemoryError, ElementTree.ParseError)


# ---------------------------------------------------------------- tracing


def find_llvm() -> str | None:
    """The library of LLVM that Dr.Jit is to load: the one that the environment names, or the oldest that is new enough."""
    if named := os.environ.get("DRJIT_LIBLLVM_PATH"):
        return named
    found = {}
    for folder in LLVM_FOLDERS:
        for path in Path("/").glob(f"{folder.removeprefix('/')}/libLLVM*.so*"):
            if (version := re.search(r"libLLVM(?:-|\.so\.)(\d+)", path.name)) and int(version[1]) >= LLVM_VERSION:
                found.setdefault(int(version[1]), str(path))
    return found[min(found)] if found else None


def start_sionna(variant: str | None) -> str:
    """Loads Sionna for a GPU, or else for the CPU, and returns Mitsuba's variant."""
    mend = f"for the CPU install libllvm{LLVM_VERSION}, or set DRJIT_LIBLLVM_PATH to its libLLVM.so"
    if llvm := find_llvm():
        os.environ["DRJIT_LIBLLVM_PATH"] = llvm
    import mitsuba

    try:
        mitsuba.set_variant(*([variant] if variant else VARIANTS))
    except ImportError as error:
        raise InvalidInput(f"Mitsuba does not start ({error}); {mend}") from error
    if mitsuba.variant().startswith("llvm") and not llvm:
        raise InvalidInput(f"no GPU, and no LLVM {LLVM_VERSION} or newer to trace on the CPU; {mend}")
    return mitsuba.variant()


class Tracer:
    """Sionna's solver, for one scene after another."""

    def __init__(self) -> None:
        from sionna.rt import PlanarArray, RadioMapSolver

        self.solver = RadioMapSolver()
        self.array = PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="V")

    def trace(self, scene: Scene) -> dict[str, np.ndarray]:
        """The arrays of a map by their names, each [rows, columns] or [base stations, rows, columns], linear float32.

        Raises InvalidInput if Sionna understands the scene otherwise than it is meant, or a base station is in a building.
        """
        from sionna.rt import Transmitter

        loaded = self.load(scene)
        maps = []
        for index, position in enumerate(scene.base_stations):
            loaded.add(Transmitter("base-station", position=position))
            maps.append(self.repeat(loaded, scene, index))
            loaded.remove("base-station")
        return {name: values if len(maps) == 1 else np.stack([found[name] for found in maps]) for name, values in maps[0].items()}

    def load(self, scene: Scene) -> Any:
        """The scene as Sionna has it, without a base station. Raises InvalidInput as `trace` does."""
        from sionna.rt import load_scene

        loaded = load_scene(str(scene.xml.resolve()), merge_shapes=False)
        check_loaded(loaded, scene)
        loaded.frequency = scene.metadata["frequency_hz"]
        loaded.tx_array = self.array
        return loaded

    def repeat(self, loaded: Any, scene: Scene, base_station: int) -> dict[str, np.ndarray]:
        """The arrays of the one base station of a scene of Sionna, [rows, columns]; without repeats Sionna's own directions."""
        repeats = scene.metadata.get("repeats", 1)
        if repeats == 1:
            return {"path_gain": self.solve(loaded, scene)}
        shifts = [shift_of(scene.metadata["seed"], scene.ident, base_station, repeat) for repeat in range(repeats)]
        ceiling = ceiling_of(scene.metadata, scene.base_stations[base_station])
        arrays, shone = combine(self.solve_repeats(loaded, scene, shifts), ceiling)
        if shone:
            say(f"{scene.ident}: {shone} cells of {repeats} repeats lay {CEILING_DB:g} dB above free space, the other repeats count there")
        return arrays

    def solve_repeats(self, loaded: Any, scene: Scene, shifts: list[Shift]) -> np.ndarray:
        """Path gain of the one base station of a scene of Sionna, [repeats, rows, columns], float32: a repeat for each shift."""
        shared = SharedWedges(self.solver)
        radio_maps = []
        for shift in shifts:
            with shared.only_shooting(), shifted_directions(shift, scene.metadata["samples_per_tx"]):
                radio_maps.append(self.call(loaded, scene.metadata, shift.seed))
        shared.add_diffraction([shift.seed for shift in shifts])
        return np.array([path_gain_of(radio_map, scene) for radio_map in radio_maps])

    def solve(self, loaded: Any, scene: Scene) -> np.ndarray:
        """Path gain of the one base station of a scene of Sionna, [rows, columns], float32, in Sionna's own directions."""
        return path_gain_of(self.call(loaded, scene.metadata, scene.metadata["seed"]), scene)

    def call(self, loaded: Any, metadata: Metadata, seed: int) -> Any:
        """The radio map of a scene with these metadata."""
        with wedge_table(metadata.get("wedge_table", WEDGE_TABLE)):
            return self.solver(
                loaded,
                center=[0.0, 0.0, metadata["rx_height_m"]],
                orientation=[0.0, 0.0, 0.0],
                size=[metadata["map_size_m"]] * 2,
                cell_size=[metadata["cell_size_m"]] * 2,
                samples_per_tx=metadata["samples_per_tx"],
                max_depth=metadata["max_depth"],
                refraction=metadata["refraction"],
                diffraction=metadata["diffraction"],
                seed=seed,
            )


def path_gain_of(radio_map: Any, scene: Scene) -> np.ndarray:
    """Path gain of the one base station of a radio map, [rows, columns], float32. Raises InvalidInput if it is none."""
    path_gain = radio_map.path_gain.numpy()
    if path_gain.shape != (1, scene.grid, scene.grid):
        raise InvalidInput(f"expected a map of {scene.grid} x {scene.grid} cells, Sionna gave {path_gain.shape}")
    if not (np.isfinite(path_gain).all() and (path_gain >= 0).all()):
        raise InvalidInput("expected path gains of 0 or more, Sionna gave others")
    return path_gain[0].astype(np.float32)


def check_loaded(loaded: Any, scene: Scene) -> None:
    """Tells of open edges of buildings.

    Raises InvalidInput if there are too many of them, if a loaded scene has other objects or materials than it should, or a
    base station stands within a building.
    """
    import drjit
    import mitsuba

    materials = {name: found.radio_material.itu_type for name, found in loaded.objects.items()}
    expected = {name: material.split()[0] for name, material in scene.metadata["materials"].items()}
    if materials != expected:
        raise InvalidInput(f"scene.xml: expected the objects and materials {expected}, Sionna found {materials}; make "
                           "the scene again with `holescout scenes`")
    for position in scene.base_stations:
        above = loaded.mi_scene.ray_intersect(mitsuba.Ray3f(mitsuba.Point3f(position), mitsuba.Vector3f(0, 0, 1)))
        if above.is_valid()[0] and above.n.z[0] > 0:
            raise InvalidInput(f"scene.json: the base station at {position} stands within a building, {above.t[0]:.1f} m below "
                               "its roof; correct its position")
    if buildings := loaded.objects.get("buildings"):
        mesh = buildings.mi_mesh
        opposite = mesh.opposite_dedge(drjit.arange(mitsuba.UInt, 3 * mesh.face_count())).numpy()
        if unpaired := int(np.count_nonzero(opposite == 0xFFFFFFFF)):
            told = f"buildings.ply: {unpaired} of {len(opposite)} edges have no opposite face, so that nothing diffracts there"
            if unpaired > OPEN_EDGES * len(opposite):
                raise InvalidInput(f"{told}; expected closed solids, share the vertices of each")
            say(f"{scene.ident}: {told}")


# ---------------------------------------------------------------- the command


def positive(kind: type) -> Any:
    """An argparse type of positive, finite numbers; whole ones may be written as 3e7."""
    def parse(text: str) -> Any:
        value = float(text)
        if not (math.isfinite(value) and value > 0 and kind(value) == value):
            raise ValueError(text)
        return kind(value)

    parse.__name__ = "positive number" if kind is float else "positive whole number"
    return parse


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(
        prog="sionna_trace.py", description="Trace the scenes of `holescout scenes` with Sionna RT: one radio map a scene.")
    parser.add_argument("scenes", type=Path, metavar="SCENES", help="directory that `holescout scenes` filled")
    parser.add_argument("--out", type=Path, required=True, metavar="MAPS", help="directory for <id>.npz")
    parser.add_argument("--only", nargs="+", default=[], metavar="ID", help="only these scenes")
    parser.add_argument("--limit", type=positive(int), metavar="N", help="only the first N scenes by name")
    parser.add_argument("--cell", type=positive(float), metavar="M", help="side of a cell [map_cell_m of the scene]")
    parser.add_argument("--size", type=positive(float), metavar="M", help="side of the map [map_size_m of the scene]")
    parser.add_argument("--samples", type=positive(int), metavar="N",
                        help="rays per base station in each repeat [as many as --rays-per-cell needs]")
    parser.add_argument("--repeats", type=positive(int), default=REPEATS, metavar="R",
                        help="independent traces of each base station, an even number: the map holds their mean, its standard error and "
                             "the mean of their first half. 1: a single trace in Sionna's own directions, of whose error nothing is known "
                             "[%(default)s]")
    parser.add_argument("--rays-per-cell", type=positive(float), default=10.0, metavar="X",
                        help="expected line-of-sight rays in the cell that is farthest from the base station, of all "
                             "repeats together [%(default)g]")
    parser.add_argument("--max-samples", type=positive(int), default=100_000_000, metavar="N",
                        help="cap of the rays that --rays-per-cell asks for, of all repeats together; it is told when it binds [1e8]")
    parser.add_argument("--max-depth", type=int, default=5, metavar="N", help="most interactions of a path [%(default)s]")
    parser.add_argument("--frequency", type=positive(float), default=3.5e9, metavar="HZ", help="carrier [3.5e9]")
    parser.add_argument("--tx-power-dbm", type=float, default=15.0, metavar="DBM",
                        help="transmit power per resource element, only written to the metadata [%(default)g]")
    parser.add_argument("--refraction", action=argparse.BooleanOptionalAction, default=False,
                        help="paths through walls; Sionna takes a building as hollow [off]")
    parser.add_argument("--diffraction", action=argparse.BooleanOptionalAction, default=True,
                        help="paths around edges [on]")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="seed of diffraction and of what differs between repeats [%(default)s]")
    parser.add_argument("--wedge-table", type=positive(int), metavar="N",
                        help=f"places in the table of diffracting wedges; wedges whose place is taken are lost "
                             f"[{WEDGE_TABLE} as Sionna has it, {REPEATED_WEDGE_TABLE} with repeats]")
    parser.add_argument("--variant", choices=VARIANTS, help="Mitsuba's variant [CUDA if there is a device, else LLVM]")
    parser.add_argument("--overwrite", action="store_true", help="replace maps of other scenes or parameters")
    parser.add_argument("--json", action="store_true", help="end standard output with one line for scripts")
    add_arguments(parser)
    parsed = parser.parse_args(arguments)
    try:
        parsed.task = task_of(parsed)
    except ValueError as error:
        parser.error(str(error))
    if max(parsed.samples or 0, parsed.max_samples) > MOST_SAMPLES:
        parser.error(f"Sionna counts rays in 32 bits: at most {MOST_SAMPLES} samples")
    if parsed.repeats > 1 and parsed.repeats % 2:
        parser.error(f"--repeats {parsed.repeats}: expected an even number, for one half is held against the other")
    if parsed.max_depth < 0 or parsed.seed < 0:
        parser.error("--max-depth and --seed must be 0 or more")
    return parsed


def options_of(parsed: argparse.Namespace) -> Options:
    """The parameters of tracing among the arguments."""
    return Options(
        cell_m=parsed.cell,
        size_m=parsed.size,
        samples=parsed.samples,
        rays_per_cell=parsed.rays_per_cell,
        max_samples=parsed.max_samples,
        max_depth=parsed.max_depth,
        frequency_hz=parsed.frequency,
        tx_power_dbm=parsed.tx_power_dbm,
        refraction=parsed.refraction,
        diffraction=parsed.diffraction,
        seed=parsed.seed,
        repeats=parsed.repeats,
        wedge_table=parsed.wedge_table or (REPEATED_WEDGE_TABLE if parsed.repeats > 1 else WEDGE_TABLE),
    )


def say(text: str) -> None:
    """A line for people."""
    print(text, file=sys.stderr, flush=True)


def reason(error: Exception) -> str:
    """An error on one line."""
    text = " ".join(str(error).split())
    return text if isinstance(error, InvalidInput) else f"{type(error).__name__}: {text}"


def sort_out(arguments: argparse.Namespace, options: Options) -> tuple[list[Scene], int, dict[str, str]]:
    """Scenes to be traced, the number of maps that are there already, and the scenes that cannot be read, with reasons."""
    todo, kept, failed = [], 0, {}
    folders = find_scenes(arguments.scenes, arguments.only, arguments.limit)
    if arguments.task:
        folders = folders[arguments.task.index::arguments.task.count]
    for folder in folders:
        try:
            scene = read_scene(folder, options)
        except FAILURES as error:
            failed[folder.name] = reason(error)
            say(f"{folder.name} failed: {failed[folder.name]}")
            continue
        if is_traced(arguments.out / f"{scene.ident}.npz", scene.metadata, arguments.overwrite):
            kept += 1
        else:
            todo.append(scene)
    return todo, kept, failed


def trace_all(todo: list[Scene], arguments: argparse.Namespace) -> tuple[str | None, dict[str, str]]:
    """Traces scenes; returns Mitsuba's variant, and the scenes that failed, with reasons."""
    if not todo:
        return None, {}
    used = start_sionna(arguments.variant)
    part = part_suffix(arguments.task)
    say(f"tracing {len(todo)} scenes with sionna-rt {SIONNA_VERSION} ({used})")
    tracer = Tracer()
    failed: dict[str, str] = {}
    begin = time.monotonic()
    for done, scene in enumerate(todo, 1):
        start = time.monotonic()
        if scene.note:
            say(f"{scene.ident}: {scene.note}")
        try:
            write_map(arguments.out / f"{scene.ident}.npz", tracer.trace(scene), scene.metadata, part)
        except FAILURES as error:
            failed[scene.ident] = reason(error)
            say(f"{scene.ident} failed: {failed[scene.ident]}")
        now = time.monotonic()
        remaining = (now - begin) / done * (len(todo) - done)
        say(f"{done}/{len(todo)} {scene.ident} {now - start:.1f} s, {remaining / 60:.0f} min left")
    return used, failed


def read_command_line(arguments: list[str] | None) -> argparse.Namespace:
    """As `parse_arguments`, but wrong usage is permanent for a task."""
    words = sys.argv[1:] if arguments is None else arguments
    try:
        return parse_arguments(arguments)
    except SystemExit as end:
        is_task = any(word.startswith("--task-count") for word in words)
        raise SystemExit(PERMANENT if is_task and end.code else end.code) from end


def main(arguments: list[str] | None = None) -> int:
    """Runs the command and returns its exit status."""
    parsed = read_command_line(arguments)
    begin = time.monotonic()
    try:
        sionna_version()
        with locked(parsed.out, parsed.task):
            todo, kept, failed = sort_out(parsed, options_of(parsed))
            if parsed.merge and todo:
                some = ", ".join(scene.ident for scene in todo[:10]) + (", ..." if len(todo) > 10 else "")
                say(f"error: {len(todo)} scenes have no map: {some}; run the tasks again, they go on where they were")
                return 1
            variant, failed_tracing = trace_all(todo, parsed)
    except InvalidInput as error:
        say(f"error: {error}")
        if parsed.task_count is None:
            return 3
        return 1 if isinstance(error, Busy) else PERMANENT
    traced = len(todo) - len(failed_tracing)
    failed |= failed_tracing
    seconds = time.monotonic() - begin
    say(f"{traced} maps traced, {kept} kept, {len(failed)} scenes failed, {seconds:.0f} s")
    if parsed.json:
        summary = {"stage": "sionna_trace", "traced": traced, "kept": kept, "failed": failed, "variant": variant,
                   "seconds": round(seconds, 3)}
        if parsed.task:
            summary |= {"task": parsed.task.index, "of": parsed.task.count}
        print(json.dumps(summary, sort_keys=True))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

"""How sure is a coverage hole? Repeated traces of tiles of San Jose, held against many more rays.

    label_reliability.py trace STORE     makes tiles and scenes, then traces the queue of benches/labels/study.toml; goes on where it was
    label_reliability.py status STORE    how much of the queue is traced
    label_reliability.py pack STORE      adds finished repeats of all their tiles to benches/labels (--partial: unfinished ones as well)
    label_reliability.py maps STORE OUT [--set w1e7]   writes means of packed repeats as maps for `holescout import-rsrp`
    label_reliability.py report          tables and plot from benches/labels

The first use of STORE needs HOLESCOUT (the program) and HOLESCOUT_DATA (a folder with osm/sanjose_buildings.osm.pbf), for tiles and scenes.
"""

import argparse
import json
import os
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
from label_packs import FOLDER, REFERENCE, levels_of, load_pack, load_tiles, outdoor_of, pack_paths, packed_tiles, path_gain_of, read_packs, save_pack, save_tiles
from label_report import LONG, report
from label_store import SCENE_KEYS, Job, Settings, prepare, queue, read_study, read_tiles, scene_of

sys.path.insert(0, str(Path(__file__).parents[1] / "pipeline"))
from sionna_files import CEILING_DB, DIRECTION_SHIFT, WEDGE_TABLE, Options, Scene, read_scene, write_map
from sionna_repeats import ceiling_of, combine, shift_of
from sionna_trace import Tracer, say, start_sionna


def scene_for(store: Path, job: Job, settings: Settings) -> Scene:
    """What a job traces."""
    options = Options(cell_m=4.0, size_m=484.0, samples=settings["samples"], rays_per_cell=1.0, max_samples=settings["samples"],
                      max_depth=settings.get("max_depth", 5), frequency_hz=3.5e9, tx_power_dbm=15.0, refraction=False,
                      diffraction=settings.get("diffraction", True), seed=settings["seed"],
                      wedge_table=settings.get("wedge_table", WEDGE_TABLE))
    return read_scene(scene_of(store, job.set, settings, job.tile), options)


def trace_together(tracer: Tracer, store: Path, jobs: list[Job], settings: Settings) -> float:
    """Traces and keeps repeats of a set on a tile, which share their wedges; returns the seconds that the solver took."""
    from sionna.rt import Transmitter

    scene = scene_for(store, jobs[0], settings)
    loaded = tracer.load(scene)
    loaded.add(Transmitter("base-station", position=scene.base_stations[0]))
    shifts = [shift_of(settings["seed"], job.tile, 0, job.repeat) for job in jobs]
    wall, cpu = time.monotonic(), time.process_time()
    maps = tracer.solve_repeats(loaded, scene, shifts)
    wall, cpu = time.monotonic() - wall, time.process_time() - cpu
    cost = {"wall_s": round(wall / len(jobs), 2), "cpu_s": round(cpu / len(jobs), 2), "load": os.getloadavg()[0]}
    kept = {key: settings[key] for key in SCENE_KEYS if key in settings}
    for job, path_gain in zip(jobs, maps, strict=True):
        path = job.path(store)
        path.parent.mkdir(parents=True, exist_ok=True)
        arrays = {"path_gain": path_gain, "cost_json": np.frombuffer(json.dumps(cost).encode(), dtype=np.uint8)}
        write_map(path, arrays, scene.metadata | kept | {"repeat": job.repeat, "direction_shift": DIRECTION_SHIFT}, ".part")
    return wall


def prepare_once(store: Path) -> None:
    """Makes tiles and scenes, if they are not there."""
    if not (store / "tiles.json").exists():
        prepare(store, Path(os.environ["HOLESCOUT"]), Path(os.environ["HOLESCOUT_DATA"]) / "osm" / read_study()["tiles"]["extract"])


def packed_jobs() -> set[Job]:
    """What the repository holds."""
    return {Job(name, tile, repeat) for name, repeat, path in pack_paths() for tile in packed_tiles(path)}


def trace(store: Path) -> None:
    """Traces what neither the store nor the repository has of the queue."""
    prepare_once(store)
    tiles = read_tiles(store)
    start_sionna(None)
    tracer = Tracer()
    packed = packed_jobs()
    while True:
        # Read anew each time, so that the order may be changed while it runs.
        study = read_study()
        job = next((job for job in queue(study, tiles) if job not in packed and not job.path(store).exists()), None)
        if job is None:
            return
        settings = study["sets"][job.set]
        jobs = [Job(job.set, job.tile, repeat) for repeat in range(settings["shared"])] if "shared" in settings else [job]
        seconds = trace_together(tracer, store, jobs, settings)
        say(f"{time.strftime('%H:%M:%S')} {job.set} {job.tile} {job.repeat}: {seconds:.1f} s")


def status(store: Path) -> None:
    """Prints how many traces of each set are there."""
    study, tiles, packed = read_study(), read_tiles(store), packed_jobs()
    wanted, there = Counter(), Counter()
    for job in queue(study, tiles):
        wanted[job.set] += 1
        there[job.set] += job in packed or job.path(store).exists()
    for name, count in wanted.items():
        print(f"{name:16} {there[name]:4} of {count:4} traces of {study['sets'][name]['samples']:.3g} rays")


def load_trace(path: Path) -> tuple[np.ndarray, dict[str, float]]:
    """Path gain and cost of a kept trace."""
    with np.load(path) as archive:
        return archive["path_gain"], json.loads(archive["cost_json"].tobytes())


def pack(store: Path, partial: bool) -> None:
    """Writes what is finished and not packed yet."""
    study = read_study()
    described = json.loads((store / "tiles.json").read_text())
    masks = {tile["id"]: outdoor_of(np.load(store / "tiles" / f"{tile['id']}.npz")["height_m"]) for tile in described}
    save_tiles(masks, {tile["id"]: tile["built"] for tile in described})
    # A repeat is whole when it has all tiles of the first step of the queue that asks for it.
    wanted: dict[tuple[str, int], list[Job]] = {}
    for step in study["queue"]:
        of_step: dict[tuple[str, int], list[Job]] = {}
        for job in queue({"queue": [step]}, list(masks)):
            of_step.setdefault((job.set, job.repeat), []).append(job)
        wanted = of_step | wanted
    reference: dict[str, np.ndarray] = {}
    for (name, repeat), jobs in sorted(wanted.items(), key=lambda item: f"{item[0][0]}-{item[0][1]}" != REFERENCE):
        path = FOLDER / f"{name}-{repeat}.xz"
        levels, costs = load_pack(path, reference) if path.exists() else ({}, {})
        new = [job for job in jobs if job.tile not in levels and job.path(store).exists()]
        if new and (partial or len(levels) + len(new) == len(jobs)):
            for job in new:
                path_gain, costs[job.tile] = load_trace(job.path(store))
                # Maps begin in the south, masks in the north.
                levels[job.tile] = levels_of(path_gain[::-1][masks[job.tile]])
            print(f"{path.name}: {len(levels)} tiles, {save_pack(path.stem, levels, costs, reference)} bytes")
        if path.stem == REFERENCE and path.exists():
            reference = load_pack(path, {})[0]


def maps(store: Path, out: Path, name: str) -> None:
    """Writes a map of each tile: the mean of an even number of packed repeats of a set, with its error.

    Packs have levels in steps of 0.5 dB; each cell gets a level at random within its step, or neighbours would often be equal. Where
    nothing is outdoors there is no level.
    """
    prepare_once(store)
    settings = read_study()["sets"][name]
    outdoor, _ = load_tiles()
    packs = [levels for _, levels, _ in read_packs(name)]
    out.mkdir(parents=True, exist_ok=True)
    for tile, mask in outdoor.items():
        levels = np.array([levels[tile] for levels in packs if tile in levels])
        levels = levels[: len(levels) // 2 * 2]
        if not len(levels):
            continue
        within = np.random.default_rng(list(tile.encode())).random(levels.shape)
        repeats = np.zeros((len(levels), *mask.shape))
        # Maps begin in the south, masks in the north.
        repeats[:, mask] = path_gain_of(levels, within)
        metadata = scene_for(store, Job(name, tile, 0), settings).metadata
        metadata |= {"repeats": len(levels), "direction_shift": DIRECTION_SHIFT, "ceiling_db": CEILING_DB}
        arrays, _ = combine(repeats[:, ::-1], ceiling_of(metadata, metadata["tx_position_m"]))
        write_map(out / f"{tile}.npz", arrays, metadata, ".part")


def main() -> None:
    """Runs the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("trace", "status", "pack", "maps"):
        commands.add_parser(name).add_argument("store", type=Path)
    commands.choices["pack"].add_argument("--partial", action="store_true")
    commands.choices["maps"].add_argument("out", type=Path)
    commands.choices["maps"].add_argument("--set", dest="name", default=LONG, choices=read_study()["sets"], help="[%(default)s]")
    commands.add_parser("report")
    arguments = vars(parser.parse_args())
    command = {"trace": trace, "status": status, "pack": pack, "maps": maps, "report": report}[arguments.pop("command")]
    command(**arguments)


if __name__ == "__main__":
    main()

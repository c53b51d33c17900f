"""How sure is a coverage hole? Repeated traces of tiles of San Jose, held against many more rays.

    label_reliability.py trace STORE     makes tiles and scenes, then traces the queue of benches/labels/study.toml; goes on where it was
    label_reliability.py status STORE    how much of the queue is traced

`trace` needs HOLESCOUT (the program) and HOLESCOUT_DATA (a folder with osm/sanjose_buildings.osm.pbf) once, for tiles and scenes.
"""

import argparse
import json
import os
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
from label_store import SCENE_KEYS, Job, Settings, prepare, queue, read_study, read_tiles, scene_of

sys.path.insert(0, str(Path(__file__).parents[1] / "pipeline"))
from sionna_files import Options, Scene, read_scene, write_map
from sionna_repeats import shift_of
from sionna_trace import Tracer, check_loaded, say, start_sionna


def scene_for(store: Path, job: Job, settings: Settings) -> Scene:
    """What a job traces."""
    options = Options(cell_m=4.0, size_m=484.0, samples=settings["samples"], rays_per_cell=1.0, max_samples=settings["samples"],
                      max_depth=settings.get("max_depth", 5), frequency_hz=3.5e9, tx_power_dbm=15.0, refraction=False,
                      diffraction=settings.get("diffraction", True), seed=settings["seed"])
    return read_scene(scene_of(store, job.set, settings, job.tile), options)


def trace_one(tracer: Tracer, store: Path, job: Job, settings: Settings) -> float:
    """Traces and keeps one job; returns the seconds that the solver took."""
    from sionna.rt import Transmitter, load_scene

    scene = scene_for(store, job, settings)
    loaded = load_scene(str(scene.xml.resolve()), merge_shapes=False)
    check_loaded(loaded, scene)
    loaded.frequency = scene.metadata["frequency_hz"]
    loaded.tx_array = tracer.array
    loaded.add(Transmitter("base-station", position=scene.base_stations[0]))
    shift = shift_of(settings["seed"], job.tile, 0, job.repeat)
    wall, cpu = time.monotonic(), time.process_time()
    path_gain = tracer.solve(loaded, scene, shift)
    cost = {"wall_s": round(time.monotonic() - wall, 2), "cpu_s": round(time.process_time() - cpu, 2), "load": os.getloadavg()[0]}
    path = job.path(store)
    path.parent.mkdir(parents=True, exist_ok=True)
    kept = {key: settings[key] for key in SCENE_KEYS if key in settings}
    arrays = {"path_gain": path_gain, "cost_json": np.frombuffer(json.dumps(cost).encode(), dtype=np.uint8)}
    write_map(path, arrays, scene.metadata | kept | {"repeat": job.repeat, "direction_shift": "random"}, ".part")
    return cost["wall_s"]


def trace(store: Path) -> None:
    """Traces all that is missing of the queue."""
    if not (store / "tiles.json").exists():
        prepare(store, Path(os.environ["HOLESCOUT"]), Path(os.environ["HOLESCOUT_DATA"]) / "osm" / read_study()["tiles"]["extract"])
    study, tiles = read_study(), read_tiles(store)
    start_sionna(None)
    tracer = Tracer()
    for job in queue(study, tiles):
        if not job.path(store).exists():
            seconds = trace_one(tracer, store, job, study["sets"][job.set])
            say(f"{time.strftime('%H:%M:%S')} {job.set} {job.tile} {job.repeat}: {seconds:.1f} s")


def status(store: Path) -> None:
    """Prints how many traces of each set are there."""
    study, tiles = read_study(), read_tiles(store)
    wanted, there = Counter(), Counter()
    for job in queue(study, tiles):
        wanted[job.set] += 1
        there[job.set] += job.path(store).exists()
    for name, count in wanted.items():
        print(f"{name:16} {there[name]:4} of {count:4} traces of {study['sets'][name]['samples']:.3g} rays")


def main() -> None:
    """Runs the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("trace", "status"))
    parser.add_argument("store", type=Path)
    parsed = parser.parse_args()
    {"trace": trace, "status": status}[parsed.command](parsed.store)


if __name__ == "__main__":
    main()

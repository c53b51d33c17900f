"""`--repeats` of `pipeline/sionna_trace.py`: repeats are independent, their mean and error are what they are called.

The statistics are taken on a small scene, where many repeats and a truth of 160 times their rays cost seconds; `benches/label_reliability.py report`
takes them on tiles of San Jose. Run by `make test-sionna`.
"""

import json
import math
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from hand_scene import write_scene

ROOT = Path(__file__).parents[2]
TRACE = ROOT / "pipeline/sionna_trace.py"
sys.path.insert(0, str(TRACE.parent))
import sionna_files  # noqa: E402
import sionna_repeats  # noqa: E402
import sionna_trace  # noqa: E402

STATION = [-50.0, 70.0, 25.0]
REPEATS = 64
FEW = 100_000
MANY = 1_000_000
Many = Callable[..., np.ndarray]


def trace(*arguments: object, status: int = 0) -> str:
    """Runs the program; returns what it wrote to standard error."""
    done = subprocess.run([sys.executable, str(TRACE), *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == status, done.stderr
    return done.stderr


def load(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a map."""
    with np.load(path, allow_pickle=False) as archive:
        return dict(archive)


def options(samples: int | None, repeats: int = 1, diffraction: bool = True, seed: int = 1) -> sionna_files.Options:
    """Options of a trace."""
    return sionna_files.Options(None, None, samples, 10.0, 10**8, 5, 3.5e9, 15.0, False, diffraction, seed, repeats)


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Many:
    """Traces a scene many times; each [repeat, row, column]. So many repeats `share` their wedges. Without shifts repeats differ in
    Sionna's seed only.
    """
    folder = write_scene(tmp_path_factory.mktemp("scenes") / "one", [STATION])
    sionna_trace.start_sionna(None)
    tracer = sionna_trace.Tracer()
    from sionna.rt import Transmitter

    def traces(samples: int, repeats: int, seed: int, *, shifted: bool = True, diffraction: bool = True,
               places: int = sionna_files.WEDGE_TABLE, share: int = 1) -> np.ndarray:
        scene = sionna_files.read_scene(folder, options(samples, 1, diffraction, seed))
        scene.metadata["wedge_table"] = places
        loaded = tracer.load(scene)
        loaded.add(Transmitter("base-station", position=STATION))
        shifts = [sionna_repeats.shift_of(seed, scene.ident, 0, repeat) for repeat in range(repeats)]
        maps = []
        for begin in range(0, repeats, share):
            if shifted:
                maps.extend(tracer.solve_repeats(loaded, scene, shifts[begin:begin + share]))
            else:
                scene.metadata["seed"] = shifts[begin].seed
                maps.append(tracer.solve(loaded, scene))
        return np.array(maps, dtype=float)

    return traces


@pytest.fixture(scope="module")
def truth(many: Many) -> np.ndarray:
    """Repeats of many rays, independent of all others here."""
    return many(MANY, 16, seed=7)


@pytest.fixture(scope="module")
def scale(many: Many) -> np.ndarray:
    """What a cell's path gain scatters by between repeats of few rays, from repeats that nothing else uses."""
    return many(FEW, REPEATS, seed=5).std(0, ddof=1)


def scatter(repeats: np.ndarray, truth: np.ndarray, scale: np.ndarray, group: int) -> float:
    """Variance of means of `group` repeats about the truth, in units of `scale` squared, a mean over cells.

    Two halves of the truth take it in turns, so that their own error drops out.
    """
    means = repeats.reshape(-1, group, *repeats.shape[1:]).mean(1)
    first, second = truth[: len(truth) // 2].mean(0), truth[len(truth) // 2 :].mean(0)
    noisy = scale > 0
    return float((((means - first) * (means - second)).mean(0)[noisy] / scale[noisy] ** 2).mean())


def correlation(repeats: np.ndarray, truth: np.ndarray, scale: np.ndarray) -> float:
    """Mean correlation of the residuals of two repeats: Var(mean of R) = Var(1) / R * (1 + (R - 1) * correlation)."""
    count = len(repeats)
    return (count * scatter(repeats, truth, scale, count) / scatter(repeats, truth, scale, 1) - 1) / (count - 1)


def test_shifts_are_drawn_from_seed_scene_station_and_repeat() -> None:
    shift = sionna_repeats.shift_of(1, "utm10n_e598016_n4128768", 0, 0)
    # So that maps of another machine, or of next year, are traced in the same directions.
    assert shift == sionna_repeats.Shift(0.9571382808781872, 0.3158835435202022, 825804372)
    shifts = {sionna_repeats.shift_of(seed, ident, station, repeat)
              for seed in (1, 2) for ident in ("a", "b") for station in (0, 1) for repeat in range(64)}
    assert len(shifts) == len({shift.seed for shift in shifts}) == 512
    points = np.array([(shift.x, shift.y) for shift in shifts])
    assert points.min() >= 0
    assert points.max() < 1
    assert np.abs(points.mean(0) - 0.5).max() < 4 / np.sqrt(12 * 512)
    assert all(0 <= shift.seed < 2**31 for shift in shifts)


@pytest.mark.usefixtures("many")
def test_a_shifted_lattice_is_sionnas_own_moved_on_the_torus() -> None:
    from sionna.rt.utils import fibonacci_lattice

    count = 1000
    own = fibonacci_lattice(count).numpy()
    still = sionna_repeats.shifted_lattice(count, sionna_repeats.Shift(0.0, 0.0, 0)).numpy()
    assert np.abs(still[0] - own[0]).max() < 1e-6
    assert np.abs(still[1] - own[1]).max() <= 0.5 / count + 1e-6
    moved = sionna_repeats.shifted_lattice(count, sionna_repeats.Shift(0.3, 0.9, 0)).numpy()
    assert moved.min() >= 0
    assert moved.max() <= 1
    around = (moved - still - [[0.3], [0.9]] + 0.5) % 1 - 0.5
    assert np.abs(around).max() < 1e-6


def test_residuals_of_repeats_are_uncorrelated(many: Many, truth: np.ndarray, scale: np.ndarray) -> None:
    assert abs(correlation(many(FEW, REPEATS, seed=3), truth, scale)) < 0.05
    # What the shift is for: with other seeds alone, nearly all of the error is that of the one lattice.
    assert correlation(many(FEW, REPEATS, seed=3, shifted=False), truth, scale) > 0.8


def test_the_variance_of_the_mean_falls_as_one_over_r(many: Many, truth: np.ndarray, scale: np.ndarray) -> None:
    repeats = many(FEW, REPEATS, seed=4)
    single = scatter(repeats, truth, scale, 1)
    for group in (2, 4, 8):
        assert group * scatter(repeats, truth, scale, group) / single == pytest.approx(1.0, abs=0.2)


def test_the_mean_of_repeats_is_unbiased_against_one_trace_of_all_their_rays(many: Many, truth: np.ndarray, scale: np.ndarray) -> None:
    # 64 repeats of 100,000 rays, against traces of 1,000,000: in sum, and cell by cell in units of the standard error.
    repeats = many(FEW, REPEATS, seed=6)
    assert repeats.mean(0).sum() == pytest.approx(truth.mean(0).sum(), rel=1e-3)
    noisy = scale > 0
    error = np.sqrt(repeats.var(0, ddof=1) / len(repeats) + truth.var(0, ddof=1) / len(truth))[noisy]
    deviation = (repeats.mean(0) - truth.mean(0))[noisy] / error
    assert abs(deviation.mean()) < 0.1
    assert 0.8 < deviation.std() < 1.4


def test_a_map_holds_mean_error_and_first_half(many: Many, tmp_path: Path) -> None:
    write_scene(tmp_path / "scenes/one", [STATION])
    flags = [tmp_path / "scenes", "--samples", FEW, "--repeats", 4, "--no-diffraction"]
    trace(*flags, "--out", tmp_path / "maps")
    found = load(tmp_path / "maps/one.npz")
    assert set(found) == {"path_gain", "path_gain_std_error", "path_gain_first_half", "meta_json"}
    assert {values.dtype for name, values in found.items() if name != "meta_json"} == {np.dtype(np.float32)}
    meta = json.loads(found["meta_json"].tobytes())
    jsonschema.validate(meta, json.loads((ROOT / "schemas/radio_map.v1.json").read_text()))
    assert (meta["repeats"], meta["direction_shift"], meta["samples_per_tx"], meta["seed"]) == (4, "random", FEW, 1)
    assert meta["wedge_table"] == 1_000_000
    # The same repeats, one by one.
    repeats = many(FEW, 4, seed=1, diffraction=False)
    assert (repeats > 0).any(0).sum() > (repeats > 0).all(0).sum(), "some cells are reached by some repeats only"
    for name, expected in [("path_gain", repeats.mean(0)), ("path_gain_first_half", repeats[:2].mean(0)),
                           ("path_gain_std_error", repeats.std(0, ddof=1) / 2)]:
        assert np.allclose(found[name], expected, rtol=1e-4, atol=1e-5 * expected.max() if "error" in name else 0), name
    # Once more: the same map but for the order of additions. With another seed: another map.
    trace(*flags, "--out", tmp_path / "again")
    trace(*flags, "--out", tmp_path / "other", "--seed", 2)
    again, other = (load(tmp_path / name / "one.npz")["path_gain"] for name in ("again", "other"))
    assert np.allclose(again, found["path_gain"], rtol=1e-4, atol=0)
    assert not np.allclose(other, found["path_gain"], rtol=1e-4, atol=0)


def test_several_base_stations_have_errors_of_their_own(tmp_path: Path) -> None:
    write_scene(tmp_path / "scenes/two", [STATION, [90.0, -80.0, 8.0]])
    trace(tmp_path / "scenes", "--out", tmp_path / "maps", "--samples", FEW, "--repeats", 2)
    found = load(tmp_path / "maps/two.npz")
    for name in ("path_gain", "path_gain_std_error", "path_gain_first_half"):
        assert found[name].shape == (2, 50, 50)
        assert not np.array_equal(*found[name])
    # Of two repeats the error of the mean is half of their difference, and the first half is one of them; both are
    # stored as float32, so their difference is known up to the rounding of the mean.
    mean = found["path_gain"].astype(np.float64)
    half = np.abs(found["path_gain_first_half"] - mean)
    assert (np.abs(found["path_gain_std_error"] - half) <= 1e-6 * half + 5e-7 * mean).all()


def test_other_repeats_are_another_map(tmp_path: Path) -> None:
    write_scene(tmp_path / "scenes/one", [STATION])
    flags = [tmp_path / "scenes", "--out", tmp_path / "maps", "--samples", FEW]
    assert "1 maps traced, 0 kept" in trace(*flags, "--repeats", 1)
    plain = json.loads(load(tmp_path / "maps/one.npz")["meta_json"].tobytes())
    assert not {"repeats", "direction_shift", "wedge_table"} & plain.keys(), "a single trace is what it was before there were repeats"
    told = trace(*flags, "--repeats", 2, status=3)
    assert "one.npz was traced otherwise: ceiling_db None instead of 15.0; direction_shift None instead of random; repeats None instead of 2; wedge_table None instead of 1000000" in told
    assert "1 maps traced, 0 kept" in trace(*flags, "--repeats", 2, "--overwrite")
    assert "0 maps traced, 1 kept" in trace(*flags, "--repeats", 2)
    assert "repeats 2 instead of 4" in trace(*flags, "--repeats", 4, status=3)
    assert "--repeats 3: expected an even number" in trace(*flags, "--repeats", 3, status=2)


@pytest.mark.parametrize(("flags", "repeats", "places"), [
    ([], 8, 1_000_000), (["--repeats", "16"], 16, 1_000_000), (["--repeats", "1"], 1, sionna_files.WEDGE_TABLE)])
def test_there_are_eight_repeats_unless_told_otherwise(flags: list[str], repeats: int, places: int) -> None:
    found = sionna_trace.options_of(sionna_trace.parse_arguments(["scenes", "--out", "maps", *flags]))
    assert (found.repeats, found.wedge_table) == (repeats, places)


@pytest.mark.parametrize("wrong", ["0", "3", "-2", "many"])
def test_odd_repeats_are_refused(wrong: str) -> None:
    with pytest.raises(SystemExit):
        sionna_trace.parse_arguments(["scenes", "--out", "maps", "--repeats", wrong])


def test_rays_are_shared_out_among_repeats(tmp_path: Path) -> None:
    folder = write_scene(tmp_path / "one", [[0.0, 0.0, 42.0]])
    # As in test_trace.py: 622,000 rays are wanted, two digits of them taken.
    assert sionna_files.read_scene(folder, options(None)).metadata["samples_per_tx"] == 630_000
    assert sionna_files.read_scene(folder, options(None, 8)).metadata["samples_per_tx"] == 78_000
    assert sionna_files.read_scene(folder, options(5000, 8)).metadata["samples_per_tx"] == 5000
    capped = sionna_files.Options(None, None, None, 10.0, 300_000, 5, 3.5e9, 15.0, False, True, 1, 4)
    scene = sionna_files.read_scene(folder, capped)
    assert scene.metadata["samples_per_tx"] == 75_000
    assert scene.note is not None
    assert "leaves 4.8" in scene.note


@pytest.mark.usefixtures("many")
def test_another_sionna_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    from sionna.rt.radio_map_solvers import radio_map_solver as solver

    shift = sionna_repeats.Shift(0.5, 0.5, 1)
    own = solver.fibonacci_lattice
    # The solver does not ask for directions, asks twice, or for another number of them.
    for asked in ([], [100, 100], [99]):
        with pytest.raises(sionna_files.InvalidInput, match="asked for"), sionna_repeats.shifted_directions(shift, 100):
            for count in asked:
                solver.fibonacci_lattice(count)
        assert solver.fibonacci_lattice is own
    # Its module has no such name, or takes it from elsewhere.
    for other in (None, lambda count: own(count)):
        monkeypatch.setattr(solver, "fibonacci_lattice", other)
        with pytest.raises(sionna_files.InvalidInput, match="repeats need the pinned Sionna"), sionna_repeats.shifted_directions(shift, 1):
            pass
    monkeypatch.undo()
    with pytest.raises(RuntimeError), sionna_repeats.shifted_directions(shift, 1):
        raise RuntimeError("the solver failed")
    assert solver.fibonacci_lattice is own


def test_wedges_whose_place_is_taken_are_lost(many: Many, monkeypatch: pytest.MonkeyPatch) -> None:
    # Two houses have 21 edges: hardly one is lost in 10,000 places, most are in three.
    full, large, small = (many(FEW, 4, seed=8, places=places).mean(0) for places in (sionna_files.WEDGE_TABLE, 1_000_000, 3))
    shadow = many(FEW, 4, seed=8, diffraction=False).mean(0) == 0
    assert large[shadow].sum() == pytest.approx(full[shadow].sum(), rel=0.2)
    assert small[shadow].sum() < 0.7 * large[shadow].sum()
    from sionna.rt import RadioMapSolver

    assert RadioMapSolver._WEDGE_INTERSECTIONS_SIZE == sionna_files.WEDGE_TABLE
    monkeypatch.setattr(RadioMapSolver, "_WEDGE_INTERSECTIONS_SIZE", 20_000)
    with pytest.raises(sionna_files.InvalidInput, match="expected _WEDGE_INTERSECTIONS_SIZE of 10000"), sionna_repeats.wedge_table(5):
        pass


def test_repeats_diffract_at_the_wedges_that_any_of_them_found(many: Many) -> None:
    # So few rays that a repeat misses most of the 21 edges.
    own, shared = (many(1000, 16, seed=9, share=share) for share in (1, 16))
    shadow = many(FEW, 4, seed=8, diffraction=False).mean(0) == 0
    reached_by_own, reached = ((repeats[:, shadow] > 0).mean() for repeats in (own, shared))
    assert reached > 2 * reached_by_own
    # In the light hardly anything is diffracted.
    assert shared[:, ~shadow].sum() == pytest.approx(own[:, ~shadow].sum(), rel=0.01)


def test_one_repeat_alone_is_what_the_solver_gives(tmp_path: Path) -> None:
    sionna_trace.start_sionna(None)
    folder = write_scene(tmp_path / "one", [STATION])
    scene = sionna_files.read_scene(folder, options(FEW))
    from sionna.rt import Transmitter

    tracer = sionna_trace.Tracer()
    loaded = tracer.load(scene)
    loaded.add(Transmitter("base-station", position=STATION))
    shift = sionna_repeats.Shift(0.25, 0.75, 5)
    with sionna_repeats.shifted_directions(shift, FEW):
        expected = sionna_trace.path_gain_of(tracer.call(loaded, scene.metadata, shift.seed), scene)
    found = tracer.solve_repeats(loaded, scene, [shift])[0]
    assert np.allclose(found, expected, rtol=1e-4, atol=1e-20)


def test_a_solver_without_its_methods_is_refused() -> None:
    with pytest.raises(sionna_files.InvalidInput, match="shoot and diffract"):
        sionna_repeats.SharedWedges(object())


def test_a_map_holds_mean_error_and_half_of_all_repeats() -> None:
    draws = np.random.default_rng(1).exponential(1e-9, (8, 3, 4)).astype(np.float32)
    draws[:5, 0, 0] = draws[:, 1, 1] = 0
    (found, shone), exact = sionna_repeats.combine(draws, np.ones((3, 4))), draws.astype(float)
    assert not shone
    assert np.allclose(found["path_gain"], exact.mean(0), rtol=1e-6)
    assert np.allclose(found["path_gain_std_error"], exact.std(0, ddof=1) / np.sqrt(8), rtol=1e-6)
    assert np.allclose(2 * found["path_gain"] - found["path_gain_first_half"], exact[4:].mean(0), rtol=1e-5, atol=1e-16)
    assert found["path_gain_std_error"][1, 1] == 0
    with pytest.raises(ValueError, match="expected an even number"):
        sionna_repeats.combine(draws[:3], np.ones((3, 4)))


def test_a_cell_that_shines_in_one_repeat_is_what_the_others_say() -> None:
    draws = np.random.default_rng(2).exponential(1e-12, (8, 2, 2)).astype(np.float32)
    draws[5, 0, 1] = 1e-3
    draws[:4, 1, 0] = 1e-3
    found, shone = sionna_repeats.combine(draws, np.full((2, 2), 1e-8))
    first, others = draws[:4, 0, 1].mean(), draws[[4, 6, 7], 0, 1].mean()
    assert shone == 1
    assert found["path_gain_first_half"][0, 1] == pytest.approx(first)
    assert found["path_gain"][0, 1] == pytest.approx((first + others) / 2)
    assert found["path_gain_std_error"][0, 1] < 1e-12
    # What a whole half says stays.
    assert found["path_gain_first_half"][1, 0] == pytest.approx(1e-3)


def test_the_ceiling_is_free_space_from_the_nearest_point_of_a_cell() -> None:
    metadata = {"map_size_m": 12.0, "cell_size_m": 4.0, "rx_height_m": 2.0, "frequency_hz": 3.5e9}
    ceiling = sionna_repeats.ceiling_of(metadata, [4.0, -4.0, 12.0])
    # Friis: 63.3 dB at 10 m. Row 0 is south: the base station stands over its last cell, 10 m up; the cell at the other end begins 6 m
    # west and 6 m north of it.
    level = 10 * np.log10(ceiling) - sionna_files.CEILING_DB
    assert level[0, 2] == pytest.approx(-63.33, abs=0.01)
    assert level[2, 0] == pytest.approx(-63.33 - 10 * math.log10(1.72), abs=0.01)
    assert level[0, 0] == level[2, 2] == pytest.approx(-63.33 - 10 * math.log10(1.36), abs=0.01)

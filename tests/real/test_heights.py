"""Heights on whole cities, cell by cell against the reading in heights_reference.py. Run by `make test-real`.

The reading itself is held against the cases of `fixtures/osm`, and against figures counted by hand.
"""

import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gdal_equality import read_tiles
from heights_reference import GUESS, HEIGHT, LEVELS, Reference, found_tops, length_m
from test_real import ROOT, data, holescout, script  # noqa: F401

# Extract and number of tiles compared; 0: all.
CITIES = {"manhattan": 0, "london": 0, "helsinki": 0, "monaco": 0, "sanjose_buildings": 100}

# Steps of the Empire State Building: cells by the height of the parts that stand on each other. Its lowest storeys and
# other parts take the rest of its cells.
EMPIRE_STATE = "w34633854"
EMPIRE_STATE_CELLS = 7697
EMPIRE_STATE_STEPS = {75.0: 999, 90.0: 631, 115.0: 571, 255.0: 335, 290.0: 440, 310.0: 141, 443.2: 55}

# Zone of the cases that name none.
CASES_EPSG = 32610
CASE_TOLERANCE_M = 0.005
LEAST_CASES = 30

LENGTHS = {
    "12": 12.0,
    " 12.5 m": 12.5,
    "12m": 12.0,
    "12 metres": 12.0,
    ".5": 0.5,
    "12,5": 12.5,
    "89,10 m": 89.1,
    "40 ft": 12.192,
    "38 feet": 11.5824,
    "40'": 12.192,
    "40\u2019": 12.192,
    "40\u2032": 12.192,
    "39'4\"": 11.9888,
    "39' 4\"": 11.9888,
    "5'-6\"": 1.6764,
    "5\u20196\u201d": 1.6764,
    "1,454 ft": 443.1792,
    "1,454'": 443.1792,
    "12,5 ft": 3.81,
}
NO_LENGTHS = [
    "", "yes", "high", "-3", "+3", "~12", "10-12", "10 - 12 m", "5;5.5", "12 13", "1,200", "1,200 m", "0,125", "12,",
    "12'14\"", "12'12\"", '4"', "5-6", "12 km", "nan", "inf", "1e3", "1.2.3", "1,23,456 ft",
]

Rasterise = Callable[[str], Path]


@pytest.fixture(scope="session")
def rasterise(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Rasterise:  # noqa: F811
    """Makes the tiles of a city once, the almost empty ones too."""
    made: dict[str, Path] = {}

    def tiles_of(city: str) -> Path:
        if city not in made:
            made[city] = tmp_path_factory.mktemp(city) / "tiles"
            holescout("rasterise", "--osm", extract(data, city), "--out", made[city],
                      "--min-buildings", 1, "--min-built", 0)
        return made[city]

    return tiles_of


def extract(data: Path, city: str) -> Path:  # noqa: F811
    return data / "osm" / f"{city}.osm.pbf"


def rounded(tops: Counter[tuple[float, int]]) -> dict[tuple[float, int], int]:
    """Tops without the digits that float32 adds."""
    return {(round(height, 3), source): cells for (height, source), cells in tops.items()}


@pytest.mark.parametrize("text", LENGTHS)
def test_lengths_are_read_as_people_mean_them(text: str) -> None:
    assert length_m(text) == pytest.approx(LENGTHS[text])


@pytest.mark.parametrize("text", NO_LENGTHS)
def test_what_is_no_length_or_could_be_two_is_refused(text: str) -> None:
    assert length_m(text) is None


def test_the_reference_reads_the_cases_right() -> None:
    """Every case of one extract that is not to be refused. What the command does is for the cases' own check."""
    folder = ROOT / "fixtures" / "osm"
    cases = json.loads((folder / "cases.json").read_text(encoding="utf-8"))
    wrong, read = {}, 0
    for case in cases:
        if len(case["files"]) > 1 or case["expect"]["exit"] != 0:
            continue
        reference = Reference(folder / case["files"][0], case["expect"].get("epsg", CASES_EPSG))
        outcomes = [outcome for outcome in (case, *case.get("or", [])) if outcome["expect"]["exit"] == 0
                    and outcome["expect"].get("epsg") == case["expect"].get("epsg")]
        differences = [[(probe, found) for probe in outcome["probes"]
                        if not fits(probe, found := reference.at(probe["e"], probe["n"]))] for outcome in outcomes]
        if all(differences):
            wrong[case["name"]] = differences
        read += 1
    # A file with the places of nodes on its ways only is not read here.
    unread = {"12_locations_on_ways_no_nodes", "12_locations_on_ways_some_nodes"}
    assert wrong.keys() <= unread, wrong
    assert read >= LEAST_CASES


def fits(probe: dict, found: tuple[float, int]) -> bool:
    return abs(found[0] - probe["height_m"]) <= CASE_TOLERANCE_M and probe["source"] in (None, found[1])


@pytest.mark.parametrize("city", CITIES)
def test_every_height_is_that_of_the_rules(data: Path, rasterise: Rasterise, city: str) -> None:  # noqa: F811
    sample = ["--max-tiles", CITIES[city], "--seed", 1] if CITIES[city] else []
    print(script("heights_reference.py", "--tiles", rasterise(city), "--osm", extract(data, city), *sample))


def test_the_empire_state_building_has_its_steps(data: Path, rasterise: Rasterise) -> None:  # noqa: F811
    epsg, tiles = read_tiles(rasterise("manhattan"))
    reference = Reference(extract(data, "manhattan"), epsg)
    expected = reference.tops(EMPIRE_STATE)
    assert sum(expected.values()) == EMPIRE_STATE_CELLS
    for tops in (rounded(expected), rounded(found_tops(reference, tiles, EMPIRE_STATE))):
        assert {height: tops.get((height, HEIGHT)) for height in EMPIRE_STATE_STEPS} == EMPIRE_STATE_STEPS


def test_a_relation_in_london_has_the_levels_of_its_outer_ways(data: Path, rasterise: Rasterise) -> None:  # noqa: F811
    """The ring of w155363896 has 4 levels and 118 cells, that of the other outer way has 2."""
    epsg, tiles = read_tiles(rasterise("london"))
    reference = Reference(extract(data, "london"), epsg)
    for tops in (reference.tops("r11244352"), found_tops(reference, tiles, "r11244352")):
        assert tops == {(12.0, LEVELS): 118, (6.0, LEVELS): 151}


def test_silent_parts_in_london_inherit_their_outlines_levels(data: Path, rasterise: Rasterise) -> None:  # noqa: F811
    """The outline w33083748 has 6 levels; some of its parts have fewer, those without any have 6 as well."""
    epsg, tiles = read_tiles(rasterise("london"))
    reference = Reference(extract(data, "london"), epsg)
    expected = reference.tops("w33083748")
    assert found_tops(reference, tiles, "w33083748") == expected
    assert all(source != GUESS for _, source in expected)
    assert np.isclose(max(height for height, _ in expected), 18.0)

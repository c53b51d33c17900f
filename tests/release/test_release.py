"""What a person has who has only a release: it is valid Croissant, and Python reads it.

HOLESCOUT names the program, HOLESCOUT_DATASET the fixtures' dataset.
"""

import csv
import hashlib
import json
import logging
import os
import re
import subprocess
import sys
from pathlib import Path

import mlcroissant
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))
import repeated_dataset  # noqa: E402

EXAMPLES = Path(__file__).parents[2] / "examples"
VERSION = "1.2.0"


def holescout(*arguments: object) -> str:
    command = [os.environ["HOLESCOUT"], *map(str, arguments)]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def publish(out: Path, *flags: str) -> None:
    holescout("release", os.environ["HOLESCOUT_DATASET"], "--version", VERSION, "--out", out, "--quiet", *flags)


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("release") / "out"
    publish(out, "--date", "2026-07-01")
    return out


@pytest.fixture(scope="module")
def manifest(release: Path) -> dict:
    return json.loads((release / "manifest.json").read_text())


def validate(croissant: Path) -> subprocess.CompletedProcess:
    script = Path(sys.executable).with_name("mlcroissant")
    return subprocess.run([script, "validate", "--jsonld", croissant], capture_output=True, text=True)


def test_croissant_is_valid_without_a_warning(release: Path) -> None:
    run = validate(release / "croissant.json")
    assert run.returncode == 0, run.stderr
    assert not re.search("warning|error", run.stdout + run.stderr, re.IGNORECASE), run.stderr


def test_a_wrong_croissant_is_not_valid(release: Path, tmp_path: Path) -> None:
    croissant = json.loads((release / "croissant.json").read_text())
    del croissant["distribution"][0]["sha256"]
    (tmp_path / "croissant.json").write_text(json.dumps(croissant))
    assert validate(tmp_path / "croissant.json").returncode != 0


def lacking(croissant: Path) -> set[str]:
    run = validate(croissant)
    assert run.returncode == 0, run.stderr
    return set(re.findall(r'Property "https?://schema.org/(\w+)" is recommended', run.stderr))


def test_a_dataset_lacks_only_what_publishing_gives_it() -> None:
    assert lacking(Path(os.environ["HOLESCOUT_DATASET"]) / "croissant.json") == {"datePublished", "version"}


def test_a_release_without_a_date_lacks_only_that(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    publish(tmp_path / "out")
    assert lacking(tmp_path / "out/croissant.json") == {"datePublished"}


def test_croissant_loads_the_records_and_shards(release: Path, manifest: dict, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        dataset = mlcroissant.Dataset(str(release / "croissant.json"))
    assert dataset.metadata.version == VERSION
    table = list(csv.DictReader((release / "records.csv").open()))
    found = list(dataset.records("records"))
    assert len(found) == len(table) == len(manifest["records"])
    for row, record, entry in zip(table, found, manifest["records"], strict=True):
        assert record["records/id"].decode() == row["id"] == entry["id"]
        assert record["records/hole_share"] == pytest.approx(float(row["hole_share"]))
        assert record["records/frame"] == int(row["frame"]) == entry["frame"]
    shards = [(shard["shards/file"], shard["shards/records"]) for shard in dataset.records("shards")]
    assert shards == [(shard["file"], shard["records"]) for shard in manifest["shards"]]


def test_an_unreleased_dataset_loads_too() -> None:
    root = Path(os.environ["HOLESCOUT_DATASET"])
    dataset = mlcroissant.Dataset(str(root / "croissant.json"))
    index = list(dataset.records("records"))
    manifest = json.loads((root / "manifest.json").read_text())
    found = [(entry["records/id"].decode(), entry["records/shard"].decode(), entry["records/frame"]) for entry in index]
    assert found == [(entry["id"], entry["shard"], entry["frame"]) for entry in manifest["records"]]
    assert [shard["shards/file"] for shard in dataset.records("shards")] == [shard["file"] for shard in manifest["shards"]]


def test_geocroissant_tells_place_and_resolution(release: Path, manifest: dict) -> None:
    croissant = json.loads((release / "croissant.json").read_text())
    assert "http://mlcommons.org/croissant/geo/1.0" in croissant["conformsTo"]
    assert croissant["geocr:coordinateReferenceSystem"] == f"EPSG:{manifest['epsg']}"
    assert croissant["geocr:spatialResolution"]["value"] == manifest["cell_m"]
    south, west, north, east = map(float, croissant["spatialCoverage"]["geo"]["box"].split())
    for row in csv.DictReader((release / "records.csv").open()):
        assert south < float(row["lat"]) < north and west < float(row["lon"]) < east


def test_the_snippet_of_the_card_reads_every_record(release: Path, manifest: dict) -> None:
    snippet = re.search(r"```python\n(.*?)```", (release / "README.md").read_text(), re.DOTALL)
    run = subprocess.run([sys.executable, "-c", snippet[1]], cwd=release, check=True, capture_output=True, text=True)
    printed = [line.split(" ", 2) for line in run.stdout.splitlines()]
    assert sorted(line[0] for line in printed) == [entry["id"] for entry in manifest["records"]]
    assert {line[2] for line in printed} == {f"({manifest['cells']}, {manifest['cells']})"}


def test_the_files_are_those_of_the_list(release: Path) -> None:
    sums = dict(reversed(line.split("  ")) for line in (release / "SHA256SUMS").read_text().splitlines())
    files = {str(path.relative_to(release)) for path in release.rglob("*") if path.is_file()}
    assert files == {*sums, "SHA256SUMS"}
    assert len(files) <= 100
    for name, digest in sums.items():
        assert hashlib.sha256((release / name).read_bytes()).hexdigest() == digest
    links = re.findall(r"\]\(([^)#:]+)\)", (release / "README.md").read_text())
    assert len(links) == 12, "two histograms, ten records"
    assert set(links) <= files


def test_read_shards_lists_and_gives_records(release: Path, manifest: dict) -> None:
    program = EXAMPLES / "read_shards.py"
    run = subprocess.run([sys.executable, program, release], check=True, capture_output=True, text=True)
    lines = [line.split("\t") for line in run.stdout.splitlines()]
    assert sorted(line[0] for line in lines) == [entry["id"] for entry in manifest["records"]]
    shares = {row["id"]: float(row["hole_share"]) for row in csv.DictReader((release / "records.csv").open())}
    for line in lines:
        assert line[4] == f"{100 * shares[line[0]]:.1f} % holes"


def test_read_shards_is_a_module(release: Path, manifest: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(EXAMPLES)
    import read_shards

    for shard in manifest["shards"]:
        found = list(read_shards.records(release / shard["file"]))
        assert len(found) == shard["records"]
        assert {record["split"] for record in found} == {shard["split"]}
    record = next(read_shards.records(release, "train"))
    side = manifest["cells"]
    kinds = {"height_m": np.float32, "rsrp_dbm": np.float32, "mask": np.uint8}
    for key, kind in kinds.items():
        assert (record[key].dtype, record[key].shape) == (kind, (side, side))
    assert list(read_shards.records(release, "nosuch")) == []


# ---------------------------------------------------------------- records with errors


@pytest.fixture(scope="module")
def repeated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A release of maps with repeats, some without among them."""
    root = tmp_path_factory.mktemp("repeated")
    dataset = repeated_dataset.build(os.environ["HOLESCOUT"], root)
    holescout("release", dataset, "--version", VERSION, "--date", "2026-07-01", "--out", root / "out", "--quiet")
    return root / "out"


def test_croissant_of_errors_is_valid_too(repeated: Path) -> None:
    run = validate(repeated / "croissant.json")
    assert run.returncode == 0, run.stderr
    assert not re.search("warning|error:", run.stdout + run.stderr, re.IGNORECASE), run.stderr
    dataset = mlcroissant.Dataset(str(repeated / "croissant.json"))
    table = list(csv.DictReader((repeated / "records.csv").open()))
    for row, record in zip(table, dataset.records("records"), strict=True):
        assert record["records/repeats"] == int(row["repeats"])
        if row["repeats"] == "8":
            assert record["records/unsure_share"] == pytest.approx(float(row["unsure_share"]))


def test_the_snippet_of_errors_reads_every_record(repeated: Path) -> None:
    snippet = re.search(r"```python\n(.*?)```", (repeated / "README.md").read_text(), re.DOTALL)
    more = "\n        assert record['rsrp_dbm'].dtype == np.float32 and -400 < record['rsrp_dbm'].min() < record['rsrp_dbm'].max() < 0"
    run = subprocess.run([sys.executable, "-c", snippet[1] + more], cwd=repeated, check=True, capture_output=True, text=True)
    assert len(run.stdout.splitlines()) == len(json.loads((repeated / "manifest.json").read_text())["records"])


def test_read_shards_reads_both_schemas(repeated: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(EXAMPLES)
    import read_shards

    schemas = set()
    table = {row["id"]: row for row in csv.DictReader((repeated / "records.csv").open())}
    for record in read_shards.records(repeated):
        schemas.add(record["schema"])
        chance = read_shards.hole_probability(record)
        outdoor = record["mask"] != 1
        assert record["rsrp_dbm"].dtype == np.float32
        assert ((chance >= 0) & (chance <= 1)).all() and (chance[record["mask"] == 2] == 1).all() and (chance[~outdoor] == 0).all()
        row = table[record["id"]]
        assert read_shards.holes(record).sum() / outdoor.sum() == pytest.approx(float(row["hole_share"]), abs=1e-6)
        if record["schema"] == "record.v1":
            assert set(np.unique(chance)) <= {0.0, 1.0}
            continue
        unsure = ((chance > 0.05) & (chance < 0.95))[outdoor].mean()
        assert 0 < unsure == pytest.approx(float(row["unsure_share"]), abs=1e-6)
        assert record["first_half_share"].max() <= 1
    assert schemas == {"record.v1", "record.v2"}
    # scipy.stats.t.cdf([-3, 0.2, 2.5], 7) and (.., 8)
    assert read_shards.student_t(np.array([-3, 0.2, 2.5]), 7) == pytest.approx([0.009971063066, 0.576416624255, 0.979503890707])
    assert read_shards.student_t(np.array([-3, 0.2, 2.5]), 8) == pytest.approx([0.008535840617, 0.576764504299, 0.981528981143])


def test_python_decodes_what_the_program_does(repeated: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(EXAMPLES)
    import read_shards

    for record in list(read_shards.records(repeated))[:4]:
        told = json.loads(holescout("inspect", repeated, "--id", record["id"], "--json"))
        for key in read_shards.ARRAYS:
            assert (key in record) == (key in told)
            if key in record and key != "mask":
                assert (record[key] == np.array(told[key], np.float32)).all(), key

"""Exports as Parquet: tools of others read all that the shards hold, by nothing but what the files say.

HOLESCOUT names the program, HOLESCOUT_DATASET the fixtures' dataset.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import datasets
import numpy as np
import pandas
import pyarrow.parquet
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))
import repeated_dataset  # noqa: E402

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))
import read_shards  # noqa: E402

SPLITS = {"train": "train", "val": "validation", "test": "test"}
ARRAYS = ("height_m", "rsrp_dbm", "mask", "std_error_db", "first_half_share")


def export(dataset: Path | str, out: Path, *flags: str, program: str = "HOLESCOUT") -> subprocess.CompletedProcess:
    command = [os.environ[program], "export", dataset, "--parquet", out, "--quiet", *flags]
    return subprocess.run(list(map(str, command)), capture_output=True, text=True)


@pytest.fixture(scope="module")
def repeated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A dataset of maps with errors, some without among them, and its export."""
    root = tmp_path_factory.mktemp("exported")
    dataset = repeated_dataset.build(os.environ["HOLESCOUT"], root)
    run = export(dataset, root / "parquet")
    assert run.returncode == 0, run.stderr
    return dataset, root / "parquet"


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    out = tmp_path_factory.mktemp("plain") / "parquet"
    run = export(os.environ["HOLESCOUT_DATASET"], out)
    assert run.returncode == 0, run.stderr
    return Path(os.environ["HOLESCOUT_DATASET"]), out


@pytest.fixture(params=["repeated", "plain"])
def exported(request: pytest.FixtureRequest) -> tuple[Path, Path]:
    return request.getfixturevalue(request.param)


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What `datasets` keeps of former runs would hide what the files say now; there is no network."""
    monkeypatch.setattr(datasets.config, "HF_DATASETS_CACHE", tmp_path / "cache")
    monkeypatch.setattr(datasets.config, "HF_HUB_OFFLINE", True)


def shapes(schema: pyarrow.Schema) -> dict[str, tuple[int, ...]]:
    metadata = {field.name: field.metadata or {} for field in schema}
    return {name: tuple(json.loads(values[b"shape"])) for name, values in metadata.items() if b"shape" in values}


def test_every_value_of_a_record_comes_back(exported: tuple[Path, Path]) -> None:
    root, out = exported
    found = {}
    for path in out.glob("*.parquet"):
        table = pyarrow.parquet.read_table(path)
        shape = shapes(table.schema)
        for row in table.to_pylist():
            arrays = {name: np.array(row[name]).reshape(shape[name]) for name in shape if row[name] is not None}
            found[row["id"]] = (path.name.split("-")[0], row | arrays)
    expected = {record["id"]: record for record in read_shards.records(root)}
    assert found.keys() == expected.keys()
    for name, (split, row) in found.items():
        record = expected[name]
        assert split == record["split"]
        for key in ARRAYS:
            assert (row.get(key) is None) == (key not in record), key
            if key in record:
                assert (row[key] == record[key]).all(), key
        for key in ("epsg", "cell_m", "floor_dbm", "flight_height_m"):
            assert row[key] == record[key]
        assert list(row["center_m"]) == record["center_m"] and list(row["center_lon_lat"]) == record["center_lon_lat"]
        station = record["base_station"]
        assert list(row["base_station_m"]) == station["position_m"]
        assert {key: row[key] for key in ("power_per_re_dbm", "pattern")} | {"position_m": station["position_m"]} == station
        assert {key: row[key] for key in record["radio"]} == record["radio"]
        assert row["repeats"] == record.get("repeats", 1)
        assert json.loads(row["provenance"]) == record["provenance"]
        assert row["licence"] == "ODbL-1.0" and "OpenStreetMap" in row["attribution"]


def test_datasets_reads_the_directory(exported: tuple[Path, Path]) -> None:
    root, out = exported
    data = datasets.load_dataset(str(out)).with_format("numpy")
    manifest = json.loads((root / "manifest.json").read_text())
    counts = {SPLITS[split]: figures["records"] for split, figures in manifest["statistics"].items()}
    assert {split: len(records) for split, records in data.items()} == counts
    record = data["train"][0]
    side = manifest["cells"]
    expected = {record["id"]: record for record in read_shards.records(root, "train")}[record["id"]]
    for key in ("height_m", "rsrp_dbm", "mask"):
        assert (record[key].reshape(side, side) == expected[key]).all()


def test_the_lines_of_the_readme_run(exported: tuple[Path, Path], tmp_path: Path) -> None:
    _, out = exported
    offline = os.environ | {"HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path)}
    snippets = re.findall(r"```python\n(.*?)```", (out / "README.md").read_text(), re.DOTALL)
    assert len(snippets) == 2
    for snippet in snippets:
        subprocess.run([sys.executable, "-c", snippet], cwd=out, check=True, env=offline)


def test_pandas_needs_no_shapes_but_those_of_the_manifest(exported: tuple[Path, Path]) -> None:
    _, out = exported
    manifest = json.loads((out / "manifest.json").read_text())
    for file in manifest["files"]:
        table = pandas.read_parquet(out / file["file"])
        assert len(table) == file["records"]
        assert list(table.columns) == [column["name"] for column in manifest["columns"]]
        for column in manifest["columns"]:
            values = table[column["name"]].dropna()
            assert column["nullable"] or len(values) == len(table)
            if column["shape"]:
                assert np.stack(values).dtype == column["dtype"]
                assert np.stack(values).shape == (len(values), np.prod(column["shape"]))
            assert column["meaning"] and column["dtype"]


def test_the_same_dataset_gives_the_same_bytes(exported: tuple[Path, Path], tmp_path: Path) -> None:
    root, out = exported
    for threads in ("1", "3"):
        run = export(root, tmp_path / threads, "--threads", threads)
        assert run.returncode == 0, run.stderr
        for path in out.iterdir():
            assert path.read_bytes() == (tmp_path / threads / path.name).read_bytes(), path.name


def verify(out: Path) -> subprocess.CompletedProcess:
    return subprocess.run([os.environ["HOLESCOUT"], "verify", out], capture_output=True, text=True)


def test_verify_knows_an_export(exported: tuple[Path, Path]) -> None:
    _, out = exported
    run = verify(out)
    assert run.returncode == 0, run.stderr
    records = sum(file["records"] for file in json.loads((out / "manifest.json").read_text())["files"])
    assert f"{records} items verified" in run.stdout


def test_verify_finds_a_table_that_is_not_the_manifests(plain: tuple[Path, Path], tmp_path: Path) -> None:
    root, _ = plain
    export(root, tmp_path / "out")
    path = sorted((tmp_path / "out").glob("*.parquet"))[0]
    pyarrow.parquet.write_table(pyarrow.parquet.read_table(path).slice(1).drop_columns("mask"), path)
    run = verify(tmp_path / "out")
    assert run.returncode != 0
    assert "rows, the manifest says" in run.stdout + run.stderr and "columns" in run.stdout + run.stderr


def test_another_dataset_is_not_replaced_unasked(repeated: tuple[Path, Path], plain: tuple[Path, Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert export(plain[0], out).returncode == 0
    refused = export(repeated[0], out)
    assert refused.returncode == 3 and "--overwrite" in refused.stderr, refused.stderr
    assert export(repeated[0], out, "--overwrite").returncode == 0
    assert (out / "manifest.json").read_bytes() == (repeated[1] / "manifest.json").read_bytes()
    inside = export(plain[0], plain[0] / "parquet")
    assert inside.returncode == 3 and "parquet" in inside.stderr

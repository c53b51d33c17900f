"""Datasets on servers: the same records as from a directory, over HTTP and S3, through failing
connections and interruptions, and never a byte that is not checked."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import boto3
import pytest
from moto.server import ThreadedMotoServer
from servers import Wire, free_port, http_server

STREAM = os.environ["HOLESCOUT_STREAM"]
HOLESCOUT = os.environ["HOLESCOUT"]
FIXTURES = Path(__file__).resolve().parents[2] / "fixtures" / "helsinki"
KEYS = {
    "AWS_ACCESS_KEY_ID": "who",
    "AWS_SECRET_ACCESS_KEY": "secret",
    "AWS_REGION": "eu-north-1",
    "AWS_ALLOW_HTTP": "true",
}


def run(*command, env=None, check=True):
    environment = {**os.environ, **(env or {})}
    ended = subprocess.run(
        [str(part) for part in command], capture_output=True, text=True, env=environment, timeout=300
    )
    if check:
        assert ended.returncode == 0, ended.stderr
    return ended


@pytest.fixture(scope="session")
def dataset(tmp_path_factory):
    """The fixtures' dataset with two records a shard."""
    build = Path(os.environ["HOLESCOUT_DATASET"]).parent
    out = tmp_path_factory.mktemp("site") / "dataset"
    config = FIXTURES / "holescout.toml"
    run(HOLESCOUT, "--config", config, "shard", "--tiles", build / "tiles", "--rsrp", build / "rsrp",
        "--out", out, "--records-per-shard", "2")
    return out


@pytest.fixture(scope="session")
def site(dataset):
    with http_server(dataset.parent) as port:
        yield port


@pytest.fixture
def wire(site):
    wire = Wire(site)
    yield wire
    wire.close()


@pytest.fixture(scope="session")
def bucket(dataset):
    """The dataset in a bucket: its address, and what the environment must say."""
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=free_port(), verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    endpoint = f"http://{host}:{port}"
    client = boto3.client(
        "s3", endpoint_url=endpoint, region_name=KEYS["AWS_REGION"],
        aws_access_key_id=KEYS["AWS_ACCESS_KEY_ID"],
        aws_secret_access_key=KEYS["AWS_SECRET_ACCESS_KEY"],
    )
    client.create_bucket(
        Bucket="maps", CreateBucketConfiguration={"LocationConstraint": KEYS["AWS_REGION"]}
    )
    for path in sorted(dataset.rglob("*")):
        if path.is_file():
            client.upload_file(str(path), "maps", f"v1/{path.relative_to(dataset)}")
    yield "s3://maps/v1", {**KEYS, "AWS_ENDPOINT_URL": endpoint}, client
    server.stop()


def stream(location, cache, *flags, split="train", env=None, check=True):
    command = [STREAM, location, split, "--cache", cache, *flags]
    return run(*command, env=env, check=check)


def address(port):
    return f"http://127.0.0.1:{port}/dataset"


@pytest.fixture(scope="session")
def expected(dataset):
    """What a directory gives: three epochs of train."""
    return run(STREAM, dataset, "train", "--take", 24).stdout


def digests(dataset):
    manifest = json.loads((dataset / "manifest.json").read_text())
    return {shard["file"]: shard["digest"] for shard in manifest["shards"]}


def cached(cache):
    return {path.name: path.read_bytes() for path in cache.iterdir()}


def assert_sound(cache):
    for name, content in cached(cache).items():
        assert hashlib.sha256(content).hexdigest() == name


def test_http_gives_the_records_of_the_directory(site, tmp_path, expected, dataset):
    for threads in (1, 4):
        assert stream(address(site), tmp_path, "--take", 24, "--threads", threads).stdout == expected
    assert_sound(tmp_path)
    train = {digest["sha256"] for file, digest in digests(dataset).items() if "train/" in file}
    assert set(cached(tmp_path)) == train, "what nobody asked for is not downloaded"


def test_s3_gives_the_records_of_the_directory(bucket, tmp_path, expected):
    url, env, _ = bucket
    assert stream(url, tmp_path, "--take", 24, "--threads", 3, env=env).stdout == expected
    assert stream(url + "/", tmp_path, "--take", 24, env=env).stdout == expected
    assert_sound(tmp_path)


def test_a_second_run_reads_its_shards_from_the_cache(wire, tmp_path, expected):
    stream(address(wire.port), tmp_path, "--take", 24)
    first = len(wire.requests)
    assert stream(address(wire.port), tmp_path, "--take", 24).stdout == expected
    asked = wire.paths[first:]
    assert sorted(asked) == ["/dataset/SHA256SUMS", "/dataset/manifest.json"], asked


def test_a_dropped_connection_goes_on_where_it_ended(wire, tmp_path, expected, dataset):
    """Every answer is cut after 30,000 bytes, a third of a shard."""
    wire.cut_after = 30_000
    whole = Path(dataset, "manifest.json").stat().st_size
    assert whole < wire.cut_after, "what has no ranges comes in one piece"
    assert stream(address(wire.port), tmp_path, "--take", 24).stdout == expected
    ranges = [asked for _, asked in wire.requests if asked]
    assert ranges and all(asked.startswith("bytes=") for asked in ranges)
    sizes = sum(digest["bytes"] for file, digest in digests(dataset).items() if "train/" in file)
    assert wire.sent < sizes + 3 * whole, "nothing is transferred twice"
    assert_sound(tmp_path)


def test_a_server_without_ranges_is_asked_for_all_of_it(wire, tmp_path, expected):
    wire.ranges = False
    wire.cut_after, wire.cuts = 30_000, 2
    assert stream(address(wire.port), tmp_path, "--take", 24).stdout == expected
    assert_sound(tmp_path)


def test_a_server_without_ranges_that_always_cuts_is_given_up(wire, tmp_path):
    wire.ranges = False
    wire.cut_after = 30_000
    ended = stream(address(wire.port), tmp_path, "--attempts", 4, check=False)
    assert ended.returncode != 0 and "failed 4 times" in ended.stderr


def test_s3_without_ranges_is_asked_for_all_of_it(bucket, tmp_path, expected):
    url, env, _ = bucket
    wire = Wire(int(env["AWS_ENDPOINT_URL"].rsplit(":", 1)[1]))
    wire.ranges = False
    wire.cut_after, wire.cuts = 30_000, 2
    env = {**env, "AWS_ENDPOINT_URL": f"http://127.0.0.1:{wire.port}"}
    assert stream(url, tmp_path, "--take", 24, env=env).stdout == expected
    assert wire.cuts == 0
    wire.close()


@pytest.mark.parametrize("sent", [0, 10_000_000])
def test_an_answer_that_is_too_short_or_too_long_is_given_up(wire, tmp_path, dataset, sent):
    """A server that announces the rest of a shard and sends something else."""
    sizes = {f"/dataset/{file}": digest["bytes"] for file, digest in digests(dataset).items()}
    wire.cut_after = 30_000

    def invent(path, asked):
        if not asked:
            return None
        begin, size = int(asked.split("=")[1].rstrip("-")), sizes[path]
        head = (f"HTTP/1.1 206 Partial Content\r\nContent-Range: bytes {begin}-{size - 1}/{size}\r\n"
                f"Content-Length: {sent}\r\nConnection: close\r\n\r\n")
        return [head.encode(), *([bytes(100_000)] * (sent // 100_000))]

    wire.invent = invent
    ended = stream(address(wire.port), tmp_path, "--attempts", 3, check=False)
    assert ended.returncode != 0 and "failed 3 times" in ended.stderr
    assert any(asked for _, asked in wire.requests)
    assert all(path.stat().st_size < 200_000 for path in tmp_path.iterdir())


def test_refused_connections_are_tried_again(wire, tmp_path, expected):
    wire.refuse = 5
    assert stream(address(wire.port), tmp_path, "--take", 24).stdout == expected
    assert wire.refuse == 0


def test_a_server_that_is_gone_is_named(tmp_path):
    url = address(free_port())
    ended = stream(url, tmp_path, "--attempts", 2, check=False)
    assert ended.returncode != 0
    assert f"{url}/manifest.json" in ended.stderr and "failed 2 times" in ended.stderr
    config = tmp_path / "config.toml"
    config.write_text("[remote]\nattempts = 2\n")
    ended = run(HOLESCOUT, "inspect", url, "--config", config, "--cache", tmp_path, check=False)
    assert ended.returncode == 1, "another try may help: " + ended.stderr


def test_what_is_not_there_is_named(site, tmp_path):
    url = f"http://127.0.0.1:{site}/elsewhere"
    ended = run(HOLESCOUT, "inspect", url, "--cache", tmp_path, check=False)
    assert ended.returncode == 3
    assert f"{url}/manifest.json: not found" in ended.stderr


def flip(wanted, at):
    """A byte of one file is another one each time that it is sent."""

    def corrupt(path, begin, piece):
        if not path.endswith(wanted) or not begin <= at < begin + len(piece):
            return piece
        damaged = bytearray(piece)
        damaged[at - begin] ^= 1
        return bytes(damaged)

    return corrupt


def test_a_byte_that_changes_once_on_the_way_is_downloaded_again(wire, tmp_path, expected, dataset):
    shard = next(iter(digests(dataset)))
    times = []

    def corrupt(path, begin, piece):
        if times or not path.endswith(shard):
            return piece
        times.append(path)
        return flip(shard, begin)(path, begin, piece)

    wire.corrupt = corrupt
    assert stream(address(wire.port), tmp_path, "--take", 24).stdout == expected
    assert times and wire.paths.count(f"/dataset/{shard}") == 2
    assert_sound(tmp_path)


def test_a_shard_that_stays_corrupt_is_named_and_kept_out_of_the_cache(
    wire, tmp_path, expected, dataset
):
    shard = next(file for file in digests(dataset) if "train/" in file)
    wire.corrupt = flip(shard, 5000)
    ended = stream(address(wire.port), tmp_path, "--take", 24, check=False)
    assert ended.returncode != 0
    promised = digests(dataset)[shard]["sha256"]
    assert f"{address(wire.port)}/{shard}" in ended.stderr and promised in ended.stderr
    assert promised not in cached(tmp_path)
    assert_sound(tmp_path)
    # In quarantine its records are left out, and told.
    ended = stream(address(wire.port), tmp_path, "--take", 18, "--quarantine")
    lines = expected.splitlines()
    assert wire.paths.count(f"/dataset/{shard}") == 4, "twice by each run, whatever asks for it"
    told = [line for line in ended.stderr.splitlines() if line.startswith("left out")]
    assert len(told) == 2 and all(promised in line for line in told)
    left_out = {line.split()[2].rstrip(":") for line in told}
    kept = [line for line in lines if line.split()[1] not in left_out]
    assert ended.stdout.splitlines() == kept


@pytest.mark.parametrize("file", ["manifest.json", "SHA256SUMS"])
def test_a_corrupt_manifest_is_named(wire, tmp_path, file):
    at = 200 if file == "manifest.json" else 3
    if file == "SHA256SUMS":
        # The line of the manifest.
        at = None
    lines = []

    def corrupt(path, begin, piece):
        if not path.endswith(file):
            return piece
        where = at if at is not None else piece.index(b"  manifest.json") - 5
        lines.append(where)
        return flip(file, begin + where)(path, begin, piece)

    wire.corrupt = corrupt
    ended = run(HOLESCOUT, "inspect", address(wire.port), "--cache", tmp_path, check=False)
    assert lines and ended.returncode == 3
    assert "manifest.json" in ended.stderr


def test_a_killed_download_goes_on_in_another_process(wire, tmp_path, expected, dataset):
    """The wire hands out a shard slowly; the reader is killed in the midst of it."""
    slow = {"on": True}

    def corrupt(path, begin, piece):
        if slow["on"] and "train/" in path and begin > 20_000:
            time.sleep(0.5)
        return piece

    wire.corrupt = corrupt
    command = [STREAM, address(wire.port), "train", "--cache", str(tmp_path)]
    killed = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    for _ in range(400):
        parts = [path for path in tmp_path.glob("*.part") if path.stat().st_size > 20_000]
        if parts:
            break
        time.sleep(0.02)
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    assert parts, "no download was under way"
    slow["on"] = False
    begun = len(wire.requests)
    assert stream(address(wire.port), tmp_path, "--take", 24).stdout == expected
    assert any(asked for _, asked in wire.requests[begun:]), "the rest was asked for by range"
    assert_sound(tmp_path)


def test_a_part_of_something_else_is_replaced(wire, tmp_path, expected, dataset):
    for digest in digests(dataset).values():
        part = tmp_path / f"{digest['sha256']}.{digest['bytes']}.part"
        part.write_bytes(os.urandom(digest["bytes"] // 2))
    assert stream(address(wire.port), tmp_path, "--take", 24).stdout == expected


def test_a_damaged_cache_is_mended(wire, tmp_path, expected):
    stream(address(wire.port), tmp_path, "--take", 24)
    damaged = sorted(tmp_path.iterdir())[0]
    content = bytearray(damaged.read_bytes())
    content[7000] ^= 4
    damaged.write_bytes(content)
    begun = len(wire.requests)
    assert stream(address(wire.port), tmp_path, "--take", 24).stdout == expected
    assert len(wire.requests) == begun + 3, "one shard again"
    assert_sound(tmp_path)


def test_the_cache_keeps_its_size(site, dataset, tmp_path):
    """Seven shards one after the other through a cache that somebody else's files do not count in,
    and that is too small for all of them after old downloads have filled it."""
    foreign = tmp_path / "notes.txt"
    foreign.write_text("mine")
    old = [tmp_path / hashlib.sha256(bytes([number])).hexdigest() for number in range(3)]
    for path in old:
        path.write_bytes(bytes(300_000))
        os.utime(path, (1, 1))
    expected = run(STREAM, dataset, "train", "--take", 24, "--block", 1).stdout
    flags = ["--take", 24, "--block", 1, "--cache-mb", 1]
    assert stream(address(site), tmp_path, *flags).stdout == expected
    total = sum(path.stat().st_size for path in tmp_path.iterdir())
    assert total <= 1_000_000 + len("mine") and foreign.exists()
    assert not all(path.exists() for path in old), "old downloads made room"


def test_several_processes_share_a_cache(wire, tmp_path, expected):
    command = [STREAM, address(wire.port), "train", "--cache", str(tmp_path), "--take", "24"]
    started = [
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(4)
    ]
    for process in started:
        assert process.communicate(timeout=300)[0] == expected
    shards = [path for path in wire.paths if "train/" in path]
    assert len(shards) == len(set(shards)), "each shard is downloaded once"


def test_s3_refusals_are_named(bucket, tmp_path):
    url, env, _ = bucket
    ended = run(HOLESCOUT, "inspect", "s3://nowhere/v1", "--cache", tmp_path, env=env, check=False)
    assert ended.returncode == 3 and "s3://nowhere/v1/manifest.json" in ended.stderr


def test_s3_keys_that_do_not_fit_are_no_damage(bucket, tmp_path, dataset):
    """A key that expires while records are read must not pass for damage in quarantine."""
    url, env, _ = bucket
    wire = Wire(int(env["AWS_ENDPOINT_URL"].rsplit(":", 1)[1]))
    body = b"<Error><Code>ExpiredToken</Code></Error>"
    head = f"HTTP/1.1 403 Forbidden\r\nContent-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    wire.invent = lambda path, _: [head.encode() + body] if "train/" in path else None
    env = {**env, "AWS_ENDPOINT_URL": f"http://127.0.0.1:{wire.port}"}
    ended = stream(url, tmp_path, "--quarantine", env=env, check=False)
    assert ended.returncode != 0 and "refused" in ended.stderr and "AWS_ACCESS_KEY_ID" in ended.stderr
    wire.close()


def test_s3_corruption_is_found(bucket, tmp_path, dataset):
    url, env, client = bucket
    shard = next(file for file in digests(dataset) if "train/" in file)
    content = bytearray((dataset / shard).read_bytes())
    content[4000] ^= 0x20
    client.put_object(Bucket="maps", Key=f"v1/{shard}", Body=bytes(content))
    try:
        ended = stream(url, tmp_path, env=env, check=False)
        assert ended.returncode != 0 and f"{url}/{shard}" in ended.stderr
    finally:
        client.upload_file(str(dataset / shard), "maps", f"v1/{shard}")


def test_commands_read_from_servers(site, dataset, tmp_path):
    """inspect and evaluate give from a server what they give from a directory."""
    record = json.loads((dataset / "manifest.json").read_text())["records"][0]["id"]
    outputs = []
    for number, location in enumerate([dataset, address(site)]):
        cache = ["--cache", tmp_path / "cache"]
        table = tmp_path / f"{number}.csv"
        run(HOLESCOUT, "inspect", location, *cache, "--csv", table)
        one = run(HOLESCOUT, "inspect", location, *cache, "--id", record, "--json").stdout
        out = tmp_path / f"evaluation-{number}"
        run(HOLESCOUT, "evaluate", "--dataset", location, *cache, "--split", "val", "--starts", 5,
            "--out", out)
        outputs.append((table.read_bytes(), one, (out / "SHA256SUMS").read_bytes()))
        shutil.rmtree(out)
    assert outputs[0] == outputs[1]

"""Logs in object stores: `memory://`, and a local server that speaks S3. Who goes through them reads what the engine needs."""

import io

import fsspec
import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import lpvobs
from lpvobs.api.files import as_path
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.errors import DataError, UsageError
from lpvobs.io.configuration.config import load_config
from lpvobs.io.logs import parquet
from lpvobs.io.logs.finding import find_logs
from lpvobs.io.logs.parquet import RemotePath, log_digest, log_path
from lpvobs.io.logs.reading import read_log

ROWS, IDLE, MONTHS = 2400, 40, 2


@pytest.fixture(scope="module")
def logs(chain):
    """Return logs of a vehicle in two months as bytes, with many channels beside those that the engine needs."""
    table, found = pq.read_table(chain.log), {}
    rng = np.random.default_rng(1)
    for month in range(1, MONTHS + 1):
        piece = table.slice((month - 1) * ROWS, ROWS)
        for number in range(IDLE):
            field = pa.field(f"other_{number}", pa.float64(), metadata={"unit": "V"})
            piece = piece.append_column(field, [rng.standard_normal(ROWS)])
        sink = io.BytesIO()
        pq.write_table(piece, sink)
        found[f"a/2025-0{month}.parquet"] = sink.getvalue()
    return found


@pytest.fixture(scope="module")
def memory(logs):
    store = fsspec.filesystem("memory")
    for name, content in logs.items():
        store.pipe(f"/fleet/{name}", content)
    yield "memory://fleet"
    store.rm("/fleet", recursive=True)


@pytest.fixture(scope="module")
def s3(logs):
    pytest.importorskip("s3fs")
    server = pytest.importorskip("moto.server").ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    with pytest.MonkeyPatch.context() as patch:
        for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
            patch.setenv(name, "testing")
        patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        patch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        store = fsspec.filesystem("s3")
        store.mkdir("fleet")
        for name, content in logs.items():
            store.pipe(f"fleet/{name}", content)
        yield "s3://fleet"
    server.stop()


def test_names_patterns_and_folders_are_found(memory):
    expected = [f"{memory}/a/2025-0{month}.parquet" for month in range(1, MONTHS + 1)]
    for named in (memory, f"{memory}/*/2025-0?.parquet", f"{memory}/a"):
        found = find_logs([as_path(named)])
        assert [str(path) for path in found] == expected
        assert all(isinstance(path, RemotePath) for path in found)
    with pytest.raises(UsageError, match=r"memory://nobody/\*: there is no log here"):
        find_logs([as_path("memory://nobody/*")])


def test_an_unknown_protocol_and_a_store_that_is_not_there_are_said_in_a_line(monkeypatch):
    with pytest.raises(DataError, match="cannot be reached"):
        log_path(as_path("nowhere://a/b.parquet")).is_file()


def test_a_log_is_known_by_its_content_wherever_it_lies(memory, logs):
    store, name = fsspec.filesystem("memory"), "a/2025-01.parquet"
    path = log_path(as_path(f"{memory}/{name}"))
    before = log_digest(path)
    store.pipe("/fleet/copy.parquet", logs[name])
    assert log_digest(RemotePath(f"{memory}/copy.parquet")) == before
    store.rm("/fleet/copy.parquet")
    assert log_digest(RemotePath(f"{memory}/a/2025-02.parquet")) != before


@pytest.mark.slow
def test_nothing_is_read_but_the_columns_that_are_needed(s3, logs, monkeypatch, config):
    import s3fs

    ranges, fetch = [], s3fs.core.S3File._fetch_range

    def fetched(self, start, end):
        ranges.append(end - start)
        return fetch(self, start, end)

    monkeypatch.setattr(s3fs.core.S3File, "_fetch_range", fetched)
    name, before = "a/2025-01.parquet", parquet._end.cache_info().misses
    log = read_log(RemotePath(f"{s3}/{name}"), Diesel.channels, load_config(config)[0].reading)
    assert log.time.size > 0.9 * ROWS
    assert parquet._end.cache_info().misses == before + 1  # the footer, once
    assert sum(ranges) < 0.3 * len(logs[name])


@pytest.fixture(scope="module")
def maps(chain, config, tmp_path_factory):
    """Return a function from where the logs lie to the maps of `track` and `estimate`."""

    def of(where):
        folder = tmp_path_factory.mktemp("maps")
        out, result = folder / "fleet.h5", folder / "map.h5"
        given = {"out": out, "gain": chain.gain, "path": "{vehicle}/{month}.parquet", "jobs": 1}
        _, content = lpvobs.track(config, [where], **given)
        _, again = lpvobs.track(config, [f"{where}/*/*.parquet"], **given)
        lpvobs.estimate(config, [where], result, gain=chain.gain, jobs=1)
        assert (content.new, content.refused, again.new, again.logs) == (MONTHS, (), 0, MONTHS)
        with h5py.File(out) as fleet, h5py.File(result) as map_:
            return fleet["maps/delta_W_c"][()], map_["map/delta_W_c"][()]

    return of


@pytest.fixture(scope="module")
def on_disk(logs, maps, tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    for name, content in logs.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
    return maps(folder)


@pytest.mark.parametrize("store", ["memory", pytest.param("s3", marks=pytest.mark.proof)])
def test_track_and_estimate_find_the_same_as_on_a_disk(store, maps, on_disk, request):
    for one, other in zip(maps(request.getfixturevalue(store)), on_disk, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-9)

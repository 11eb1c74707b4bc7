"""A fleet from the command line: whose logs they are, a month more, any order, what cannot be used."""

import json
import re

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
from repository import CONFIGS

from lpvobs.api.track import track as follow
from lpvobs.discovery.known_effects import KnownEffect, Span
from lpvobs.io.results import hdf
from lpvobs.io.results.fleets import read_fleet
from lpvobs.io.results.mapping import write
from lpvobs.io.results.parts import PartsFolder
from lpvobs.io.results.refinements import BOUNDS, StoredRefinement
from lpvobs.io.results.results import KIND

ROWS = 2400


@pytest.fixture(scope="module")
def fleet(once, chain):
    """Return a folder with a log of two vehicles in each of four months: pieces of one drive, the sensor of b low from March on."""

    def make(folder):
        table = pq.read_table(chain.log)
        at = table.column_names.index("W_maf")
        for vehicle in "ab":
            (folder / vehicle).mkdir()
            for month in range(1, 5):
                piece = table.slice((month - 1) * ROWS + 10 * (vehicle == "b"), ROWS)
                low = 0.95 if vehicle == "b" and month > 2 else 1.0
                piece = piece.set_column(at, table.schema.field("W_maf"), [low * piece["W_maf"].to_numpy()])
                pq.write_table(piece, folder / vehicle / f"2025-0{month}.parquet")

    return once("fleet", make)


@pytest.fixture(scope="module")
def track(lpvobs, config, chain):
    def run(out, logs, *more):
        pattern = ("--path", "{vehicle}/{month}.parquet")
        return lpvobs(
            "track", "--config", config, "--gain", chain.gain, *logs, "--out", out, *pattern, "--jobs", 1, *more
        )

    return run


@pytest.fixture(scope="module")
def whole(fleet, track, tmp_path_factory):
    out = tmp_path_factory.mktemp("whole") / "fleet.h5"
    done = track(out, [fleet], "--table", out.with_suffix(".parquet"), "--verbose")
    assert done.code == 0, done.err
    return out, done


def contents(path):
    """Return every dataset of a fleet."""
    found = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
    return found


def test_names_alike_are_no_obstacle_and_whose_they_are_stands_in_the_path(whole):
    out, done = whole
    assert "2 vehicles, 8 logs, 2025-01 to 2025-04" in done.out
    kept, digests = contents(out), read_fleet(out).provenance.inputs_sha256
    assert sorted(digests) == [f"{vehicle}/2025-0{month}" for vehicle in "ab" for month in range(1, 5)]
    assert sorted(name.decode() for name in kept["sums/log"]) == sorted(digests.values())
    assert sorted(name.decode() for name in kept["sums/name"]) == sorted([f"2025-0{m}" for m in range(1, 5)] * 2)


def test_the_table_has_a_row_for_each_vehicle_period_and_node(whole):
    table = pq.read_table(whole[0].with_suffix(".parquet"))
    assert table.num_rows == 8 * 255
    assert table.column_names == ["type", "vehicle", "period", "u_delta", "n_e", "delta_W_c", "standard_error"]
    assert table.schema.field("n_e").metadata == {b"unit": b"rpm"}
    assert set(table["period"].to_pylist()) == {f"2025-0{m}" for m in range(1, 5)}


@pytest.mark.proof  # quick where the fleet is small: tests/api/test_cluster.py
def test_the_order_of_the_logs_does_not_matter_to_a_bit(whole, fleet, track, tmp_path):
    done = track(
        tmp_path / "fleet.h5", sorted(fleet.rglob("*.parquet"), key=lambda path: path.name[::-1], reverse=True)
    )
    assert done.code == 0, done.err
    again, before = contents(tmp_path / "fleet.h5"), contents(whole[0])
    assert again.keys() == before.keys()
    assert all(np.array_equal(again[name], before[name], equal_nan=before[name].dtype.kind == "f") for name in before)


@pytest.mark.proof
def test_a_month_more_is_added_without_the_old_logs(whole, fleet, track, tmp_path):
    out = tmp_path / "fleet.h5"
    assert track(out, [fleet / "?" / f"2025-0{m}.parquet" for m in range(1, 4)]).code == 0
    done = track(out, [fleet / "?" / "2025-04.parquet", fleet / "a" / "2025-01.parquet"])
    assert "2 new logs, 6 were in the fleet before" in done.err
    added, at_once = contents(out), contents(whole[0])
    for name in ("maps/delta_W_c", "maps/standard_error", "vehicles/trend"):
        np.testing.assert_allclose(added[name], at_once[name], rtol=1e-4, atol=1e-7)


@pytest.mark.proof
def test_what_a_stopped_run_had_read_is_said(fleet, track, config, chain, tmp_path, monkeypatch):
    out, logs = tmp_path / "fleet.h5", [fleet / "?" / "2025-01.parquet"]
    monkeypatch.setattr(PartsFolder, "remove", lambda _: None)
    follow(config, logs, out=out, gain=chain.gain, path="{vehicle}/{month}.parquet", jobs=1)
    out.unlink()  # as a run that is killed before it has written leaves its folder
    done = track(out, logs)
    assert done.code == 0, done.err
    assert "2 new logs, 2 of them read by an earlier run that was stopped, 0 were in the fleet before" in done.err
    out.unlink()
    assert "2 new logs, 0 were in the fleet before" in track(out, logs).err


def test_what_belongs_to_results_alone_is_refused_beside_a_fleet(whole, lpvobs, tmp_path):
    for given in (
        ("--gate", "samples>=1"),
        ("--junit", tmp_path / "gates.xml"),
        ("--region", "n_e=1000:2000"),
        (whole[0],),
    ):
        done = lpvobs("report", whole[0], *given)
        assert done.code == 2
        assert "holds a fleet" in done.err


def test_nothing_says_whose_a_log_is(lpvobs, config, chain, tmp_path):
    done = lpvobs("track", "--config", config, "--gain", chain.gain, chain.log, "--out", tmp_path / "fleet.h5")
    assert done.code == 3
    assert "the field 'vehicle' of this log is unknown; give --path or --origins" in done.err


def test_of_a_log_that_cannot_be_read_this_is_said(lpvobs, config, chain, tmp_path):
    (tmp_path / "log.parquet").write_bytes(b"PAR1 and nothing more")
    for name, word in (("log", "not a readable Parquet log"), ("none", "no such log")):
        given = ("--gain", chain.gain, tmp_path / f"{name}.parquet")
        done = lpvobs("track", "--config", config, *given, "--out", tmp_path / "fleet.h5")
        assert done.code == 3
        assert word in done.err
        assert "the field 'vehicle' of this log is unknown" not in done.err


def test_a_bad_log_is_left_out_and_said(whole, fleet, track, tmp_path):
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "2025-01.parquet").write_bytes(b"PAR1 and nothing more")
    done = track(tmp_path / "fleet.h5", [fleet / "a" / "2025-01.parquet", tmp_path / "c"], "--json")
    assert done.code == 3
    content = json.loads(done.out)
    assert content["logs"] == 1
    assert "2025-01.parquet" in content["refused"][0]


def test_another_configuration_is_refused(whole, fleet, track, config, tmp_path):
    out, other = tmp_path / "fleet.h5", tmp_path / "other.toml"
    out.write_bytes(whole[0].read_bytes())
    other.write_text(config.read_text(encoding="utf-8") + "\n# another\n", encoding="utf-8")
    (tmp_path / "a").mkdir()
    log = tmp_path / "a" / "2025-05.parquet"
    pq.write_table(pq.read_table(fleet / "a" / "2025-01.parquet").slice(5), log)
    done = track(out, [log], "--config", other)
    assert done.code == 3
    assert "another configuration" in done.err
    for logs in ((), (fleet / "a",)):  # nothing to read: what is there is evaluated again, with another map
        done = track(out, logs, "--config", CONFIGS / "heavy-duty.toml")
        assert (done.code, "another configuration" in done.err) == (3, True), done.err


def test_origins_come_from_metadata_and_dates_are_checked(lpvobs, config, chain, tmp_path):
    cycle = tmp_path / "short.csv"
    cycle.write_text("time_s,speed_kmh\n0,0\n5,0\n20,30\n30,30\n40,0\n", encoding="utf-8")
    drive = ("simulate", "--config", config, "--cycle", cycle, "--rate", 10, "--out", tmp_path / "log.parquet")
    assert lpvobs(*drive, "--vehicle", "V1", "--date", "2025-01-31").code == 0
    metadata = pq.read_schema(tmp_path / "log.parquet").metadata
    assert (metadata[b"vehicle"], metadata[b"date"], metadata[b"engine"]) == (b"V1", b"2025-01-31", b"diesel")
    done = lpvobs(*drive, "--date", "31.1.2025")
    assert done.code == 2
    assert "--date 31.1.2025: is not a date; expected for example 2025-01-31" in done.err


def test_the_page_of_a_fleet_has_a_line_and_a_place_for_every_vehicle(lpvobs, whole, tmp_path):
    page = tmp_path / "fleet.html"
    done = lpvobs("report", whole[0], "--html", page)
    assert done.code == 0, done.err
    text = page.read_text(encoding="utf-8")
    assert text.count("<polyline") == 2
    assert text.count('id="v') == 3  # two vehicles, and the section of all
    assert re.search(r"<li>2 vehicles, [^<]*</li>", text)  # a line for each thing that there is to say
    assert re.search(r"cells to drive next: \d+ s each at \d+ rpm and [\d., ]+ mg/cycle", text)
    assert "-0.0 sd" not in text
    assert json.loads(lpvobs("report", whole[0], "--json").out)["schema"] == "lpvobs/track/1"


def test_the_page_of_half_a_fleet_is_refused(lpvobs, whole, tmp_path):
    (tmp_path / "half.h5").write_bytes(whole[0].read_bytes()[:100_000])
    done = lpvobs("report", tmp_path / "half.h5", "--html", tmp_path / "fleet.html")
    assert done.code == 3
    assert "half.h5" in done.err


def test_a_pattern_with_a_field_twice_is_refused(fleet, track, tmp_path):
    done = track(tmp_path / "fleet.h5", [fleet / "a"], "--path", "{vehicle}/{vehicle}.parquet")
    assert (done.code, "a field appears twice" in done.err) == (2, True)


@pytest.mark.slow
def test_two_periods_of_a_vehicle_are_compared(whole, lpvobs, tmp_path):
    def compare(vehicle, *more, periods=("2025-01", "2025-04")):
        named = (each for period in periods for each in ("--period", period))
        return lpvobs("compare", whole[0], "--vehicle", vehicle, *named, *more)

    fleet = read_fleet(whole[0])
    maps = {each.period: each.theta.reshape(fleet.grid.shape) for each in fleet.found.maps if each.vehicle == "b"}
    healthy, low = (json.loads(compare(vehicle, "--json").out) for vehicle in "ab")
    assert low["second"] == f"{whole[0]}: b 2025-04"
    assert low["p_value"] < 1e-6
    assert healthy["p_value"] > 0.1
    assert healthy["significant"] == []
    largest = low["significant"][0]
    node = [list(axis).index(largest[name]) for axis, name in ((fleet.grid.speed, "speed"), (fleet.grid.fuel, "fuel"))]
    moved = maps["2025-04"] - maps["2025-01"]
    assert largest["change"] == pytest.approx(moved[*node], rel=1e-9)
    assert low["nodes"] == healthy["nodes"] < np.count_nonzero(moved)  # others were hardly driven
    assert largest["after"] - largest["before"] == pytest.approx(largest["change"])
    assert largest["ci90"][0] < largest["change"] < largest["ci90"][1] < 0.0
    figure = tmp_path / "moved.svg"
    done = compare("b", "--gate", "largest_change<=0.5 g/s", "--figure", figure)
    assert done.code == 1
    assert "b 2025-04, largest_change = " in done.err
    assert figure.read_text(encoding="utf-8").startswith("<svg")
    assert compare("a", "--gate", "largest_change<=0.5 g/s").code == 0
    done = compare("c")
    assert done.code == 3
    assert "has no map of vehicle c in period 2025-01; vehicles in this fleet: a, b" in done.err
    done = compare("b", "--gate", "largest_change<=0.5")  # of what?
    assert (done.code, "the limit has no unit" in done.err) == (2, True)
    done = compare("b", "--values", "extrapolation")
    assert (done.code, "a fleet contains no extrapolated maps" in done.err) == (2, True)
    assert "periods with a map: 2025-01, 2025-02" in compare("a", periods=("2025-01", "2025-09")).err
    for wrong in (compare("a", periods=("2025-01",)), compare("a", whole[0]), lpvobs("compare", whole[0])):
        assert wrong.code == 2
        assert "--vehicle NAME and two different periods" in wrong.err


def refined(path, digests, spans):
    """Write a result in which `refine` has found a lag on some logs."""
    lag = KnownEffect(
        "maf.lag", "sensor", "tau", "s", 0.08, (0.079, 0.081),
        tuple(Span("log", digest, *span) for digest, span in zip(digests, spans, strict=True)), True, None,
    )  # fmt: skip
    with hdf.creating(path) as file:
        file.attrs["schema"] = f"lpvobs/{KIND}/1"
        write(file, "refinement", StoredRefinement((lag,), {}, {}, True, "{}"), BOUNDS)
    return path


def test_what_refine_found_has_its_place_in_time_and_stays(whole, track, lpvobs, config, tmp_path):
    out = tmp_path / "fleet.h5"
    out.write_bytes(whole[0].read_bytes())
    logs = sorted((log.date, log.sha256) for log in read_fleet(out).kept.logs if log.vehicle == "b")
    spans = [(np.inf, np.inf), (40.0, np.inf), (-np.inf, np.inf)]
    found = refined(tmp_path / "refined.h5", [digest for _, digest in logs[:3]], spans)
    again = ("track", "--config", config, "--out", out, "--json")
    for more in (("--refined", found), ("--refined", found), ()):
        done = lpvobs(*again, *more)
        assert done.code == 0, done.err
        (effect,) = json.loads(done.out)["effects"]
    assert (effect["vehicle"], effect["id"], effect["value"]) == ("b", "maf.lag", 0.08)
    assert [effect[name] for name in ("absent", "first", "last")] == [day for day, _ in logs[:3]]
    assert "maf.lag" in lpvobs("track", "--config", config, "--out", out).out
    strange = refined(tmp_path / "strange.h5", ["0" * 64], [(-np.inf, np.inf)])
    done = lpvobs(*again, "--refined", strange)
    assert done.code == 3
    assert "maf.lag was found on logs that are not in the fleet" in done.err


def test_the_table_does_not_overwrite_a_log(track, fleet, tmp_path):
    log = tmp_path / "a" / "2025-01.parquet"
    log.parent.mkdir()
    log.write_bytes((fleet / "a" / "2025-01.parquet").read_bytes())
    before = log.read_bytes()
    done = track(tmp_path / "fleet.h5", [log], "--table", log)
    assert done.code == 2
    assert "is also an input" in done.err
    assert log.read_bytes() == before

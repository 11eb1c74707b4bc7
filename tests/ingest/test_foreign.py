"""Foreign recordings to logs: CSV layouts, repairs, rasters; the other formats are in test_formats.py."""

import json
from dataclasses import fields

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from repository import ROOT

from lpvobs.errors import DataError, UsageError
from lpvobs.ingest.foreign import ingest
from lpvobs.ingest.profiles import ChannelRules, Raster, SourceRules, TimeRules, load_profile, profile_of, shipped
from lpvobs.ingest.record import stored_record

MINIMAL = """
schema = 1
[time]
source = "t"
unit = "s"
[channels.p_im]
source = "map"
unit = "Pa"
"""


def profile(text, tmp_path):
    return profile_of(text, tmp_path / "mine.toml")


@pytest.fixture
def run(tmp_path):
    """Return a function that ingests CSV texts by a profile's text."""

    def make(text, *files, encoding="utf-8"):
        paths = []
        for number, content in enumerate(files):
            paths.append(tmp_path / f"part{number}.csv")
            paths[-1].write_bytes(content if isinstance(content, bytes) else content.encode(encoding))
        return ingest(paths, profile(text, tmp_path))

    return make


def test_names_units_and_decimals(run):
    text = MINIMAL.replace("[time]", '[source]\ndelimiter = ";"\ndecimal = ","\nunit_row = 2\n[time]').replace(
        'unit = "s"\n', "", 1
    )
    made = run(text, "t;map;other\nms;hPa;-\n0;1000,5;x\n10;999;x\n")
    np.testing.assert_allclose(made.channels["time"], [0.0, 0.01])
    np.testing.assert_allclose(made.channels["p_im"], [100050.0, 99900.0])
    assert made.units == {"time": "s", "p_im": "Pa"}
    assert made.record["channels"]["p_im"]["unit_in_file"] == "hPa"


@pytest.mark.parametrize("degree", ["Â°C", "\ufffdC", "?C", "Ã‚Â°C", "ï¿½C"])
def test_a_broken_degree_sign_is_read_and_said(run, degree):
    text = MINIMAL.replace("p_im", "T_im").replace('"map"', '"IAT"').replace('"Pa"', '"K"')
    made = run(text, f"t,IAT [{degree}]\n0,20\n1,21\n")
    np.testing.assert_allclose(made.channels["T_im"], [293.15, 294.15])
    assert degree in made.record["channels"]["T_im"]["repairs"]["unit_spelling"]


def test_a_whole_degree_sign_is_no_repair_and_latin_1_is_one(run):
    text = MINIMAL.replace("p_im", "T_im").replace('"map"', '"IAT"').replace('"Pa"', '"K"')
    made = run(text, "t,IAT [°C]\n0,20\n1,21\n", encoding="latin-1")
    assert made.record["channels"]["T_im"]["repairs"] == {}
    assert made.record["sources"][0]["notes"] == {"encoding": "the file is not utf-8, so it was read as latin-1"}


def test_a_line_that_is_not_utf_8_does_not_stop_the_others(run, capfd):
    rows = b"".join(b"%d,100000\n" % k for k in range(200))
    made = run(MINIMAL, b"t,map [Pa]\n" + rows + b"200,\xff,\xff\n201,1\xff\n202,100000\n")
    assert made.record["sources"][0]["notes"]["encoding"] == "the file is not utf-8, so it was read as latin-1"
    assert made.record["channels"]["p_im"]["repairs"] == {"unreadable": 1, "example": "1ÿ", "empty": 1}
    assert made.channels["time"][-1] == 202
    assert capfd.readouterr().err == ""


def test_every_repair_is_done_and_counted(run):
    text = MINIMAL + (
        'source_unit = "kPa"\nscale = -1.0\noffset = 2.0\ninvalid = [-999.0]\nlow = 5e4\nhigh = 3e5\nrule = "linear"\nlimit = 1.5\n'
    )
    rows = ["0,-98", "1,oops", "2,-100", "3,-999", "4,", "5,-101", "6,-800", "7,-102", "8"]
    made = run(text, "t,map\n" + "\n".join(rows) + "\n")
    repairs = made.record["channels"]["p_im"]["repairs"]
    assert repairs == {
        "unreadable": 1, "example": "oops", "empty": 2, "invalid": 1, "out_of_range": 1,
        "rescaled": "-1 * recorded + 2 kPa",
    }  # fmt: skip
    np.testing.assert_allclose(
        made.channels["p_im"], [1.0e5, np.nan, 1.02e5, np.nan, np.nan, 1.03e5, np.nan, 1.04e5], rtol=1e-15
    )
    assert made.record["channels"]["p_im"]["without_value"] == 4
    assert made.record["sources"][0]["notes"]["broken_lines"].startswith("1 ")
    wider = run(text.replace("limit = 1.5", "limit = 3.5"), "t,map\n" + "\n".join(rows) + "\n")
    np.testing.assert_allclose(
        wider.channels["p_im"][[1, 3, 4, 6]], [1.01e5, 1.02e5 + 1e3 / 3, 1.02e5 + 2e3 / 3, 1.035e5]
    )
    assert wider.record["channels"]["p_im"]["without_value"] == 0


def test_units_that_contradict_are_said(run):
    made = run(MINIMAL + 'source_unit = "kPa"\n', "t,map [hPa]\n0,100\n1,101\n")
    assert "hPa in the file, but kPa in the profile" in made.record["channels"]["p_im"]["repairs"]["unit"]
    np.testing.assert_allclose(made.channels["p_im"], [1e5, 1.01e5])


def test_polled_rows_give_staggered_samples(run):
    text = """
schema = 1
[source]
polled = true
[time]
source = "t"
unit = "clock"
from_zero = true
[raster]
rate = 1.0
[channels.n_e]
source = "rev"
unit = "rpm"
rule = "hold"
limit = 2.0
[channels.v]
source = "speed"
unit = "m/s"
rule = "linear"
limit = 2.0
"""
    rows = [
        "t,rev [1/min],speed [m/s]",
        "23:59:59,800,",
        "0:00:00,800,1.0",
        "0:00:01,900,1.0",
        "0:00:02,900,3.0",
        "0:00:03,1000,3.0",
    ]
    made = run(text, "\n".join(rows) + "\n")
    np.testing.assert_allclose(made.channels["time"], [0, 1, 2, 3, 4])
    np.testing.assert_allclose(made.channels["n_e"], [800, 800, 900, 900, 1000])
    np.testing.assert_allclose(made.channels["v"], [np.nan, 1.0, 2.0, 3.0, np.nan])  # fresh in rows 1 and 3 alone
    assert made.record["sources"][0]["time_repairs"] == {"t": {"nights": 1}}
    assert made.record["channels"]["n_e"]["rate"] == 0.5
    late = run(text, "\n".join([*rows[:3], rows[3].replace(",800,", ",850,"), *rows[4:]]) + "\n")
    assert late.record["channels"]["n_e"]["repairs"] == {}
    odd = run(text, "\n".join([*rows[:2], "0:00:00,850,1.0", *rows[3:]]) + "\n")
    assert odd.record["channels"]["n_e"]["repairs"] == {"out_of_turn": 1}
    with pytest.raises(DataError, match="in rows of other columns"):
        run(text, "\n".join([rows[0], *(f"0:00:{k:02d},{800 + k},{k}" for k in range(20))]) + "\n")


def test_the_default_rule_depends_on_the_rates_and_is_stated(run):
    t = np.arange(0, 4, 0.01)
    rows = "\n".join(f"{time:.2f},{1e5 + 1e3 * np.sin(2 * np.pi * 10 * time):.6f}" for time in t)
    made = run(MINIMAL.replace("[channels", "[raster]\nrate = 10.0\n[channels"), f"t,map [Pa]\n{rows}\n")
    item = made.record["channels"]["p_im"]
    assert (item["rule"], item["rule_from"]) == ("mean", "default: faster than the raster")
    # A sine of a whole period per box: what remains is the error of ten lines for a sine, 1000 Pa (2 pi/10)^2 / 12 = 33 Pa.
    assert np.nanmax(np.abs(made.channels["p_im"] - 1e5)) < 35
    slow = run(MINIMAL.replace("[channels", "[raster]\nrate = 200.0\n[channels"), f"t,map [Pa]\n{rows}\n")
    assert slow.record["channels"]["p_im"]["rule"] == "linear"
    stated = MINIMAL.replace("[channels", "[raster]\nrate = 10.0\n[channels") + 'rule = "linear"\n'
    assert "aliases" in run(stated, f"t,map [Pa]\n{rows}\n").record["channels"]["p_im"]["rule_from"]


def test_parts_of_one_recording_follow_each_other(run):
    first, second = "t,map [Pa]\n0,100000\n1,100001\n", "t,map [Pa]\n2,100002\n3,100003\n"
    made = run(MINIMAL, first, second)
    np.testing.assert_array_equal(made.channels["p_im"], 1e5 + np.arange(4))
    assert made.record["channels"]["p_im"]["file"] == "part0.csv, part1.csv"
    with pytest.raises(DataError, match="the parts overlap in 2 samples"):
        run(MINIMAL, second, first)


def test_a_slow_channel_is_bridged_between_its_own_samples(run):
    text = (
        MINIMAL.replace("[channels", "[raster]\nrate = 1.0\n[channels") + '[channels.n_e]\nsource = "n"\nunit = "rpm"\n'
    )
    slow = "".join(f"{k},{1e5 + k}\n" for k in (0, 5, 10, 15, 40, 45))
    made = run(text, "t,map [Pa]\n" + slow, "t,n [rpm]\n" + "".join(f"{k / 2},800\n" for k in range(91)))
    assert made.record["channels"]["p_im"]["limit"] == 12.5
    at = np.arange(46.0)
    wanted = np.where((at <= 15) | (at >= 40), 1e5 + at, np.nan)
    np.testing.assert_allclose(made.channels["p_im"], wanted, rtol=1e-15)
    assert made.record["channels"]["n_e"]["limit"] == 1.25


def test_channels_come_from_several_files(run):
    text = (
        MINIMAL.replace("[channels", "[raster]\nrate = 2.0\n[channels") + '[channels.n_e]\nsource = "n"\nunit = "rpm"\n'
    )
    made = run(text, "t,map [Pa]\n0,1e5\n1,1.1e5\n2,1.2e5\n", "t,n [1/min]\n0.5,800\n1.5,900\n")
    np.testing.assert_allclose(made.channels["n_e"], [np.nan, 800, 850, 900, np.nan])
    np.testing.assert_allclose(made.channels["p_im"], [1e5, 1.05e5, 1.1e5, 1.15e5, 1.2e5])


GOOD = "t,map [Pa]\n0,1e5\n1,1e5\n2,1e5\n"
REFUSED = {
    "missing": (MINIMAL, "t,mop [Pa]\n0,1\n1,1\n", "channel 'p_im' is missing.*nearest names: mop"),
    "twice": (MINIMAL, "t,map [Pa],map [kPa]\n0,1,1\n1,1,1\n", "fits 2 columns"),
    "no unit": (MINIMAL, "t,map\n0,1\n1,1\n", "has no unit.*source_unit"),
    "wrong unit": (MINIMAL, "t,map [degC]\n0,1\n1,1\n", "'degC' cannot be converted to 'Pa'"),
    "no time": (MINIMAL, "s,map [Pa]\n0,1\n1,1\n", "time column 't' is missing"),
    "one stamp": (MINIMAL, "t,map [Pa]\n0,1\n", "1 readable time stamps"),
    "backward": (MINIMAL, "t,map [Pa]\n0,1\n1,1\n1,1\n", "repeats or runs backward 1 times, first at 1 s"),
    "words": (MINIMAL, "t,map [Pa]\n0,high\n1,low\n", "holds text such as 'high'"),
    "ragged": (MINIMAL, "t,map [Pa]\n0,1\n1\n2\n3,4\n", "wrong number of fields"),
    "empty": (MINIMAL, "", "is not the header"),
    "binary": (MINIMAL, b"\0\1\2\3" * 50, "is not the header"),
    "time unit": (MINIMAL.replace('unit = "s"', 'unit = "kPa"'), GOOD, "time column 't': unit 'kPa'"),
    "far stamp": (
        MINIMAL.replace("[channels", "[raster]\nrate = 1000.0\n[channels"),
        GOOD + "1e12,1\n",
        "check the unit of time",
    ),
    "two bases": (
        MINIMAL + '[channels.n_e]\nsource = "n"\ntime = "t2"\nunit = "rpm"\n',
        "t,map [Pa],t2,n [rpm]\n0,1,0.5,8\n1,1,1.5,8\n",
        "recorded at other times than 'p_im'.*rate",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_used_is_refused_in_one_line(run, case):
    text, content, words = REFUSED[case]
    with pytest.raises(DataError, match=words) as failure:
        run(text, content)
    assert "\n" not in str(failure.value)


def test_many_backward_stamps_are_no_repair(run):
    text = MINIMAL.replace('source = "t"', 'source = "t"\nbackward = "drop"')
    few = "".join(f"{time},1e5\n" for time in [*range(20), 18, *range(20, 30)])
    assert run(text, "t,map [Pa]\n" + few).record["sources"][0]["time_repairs"] == {"t": {"backward": 1}}
    with pytest.raises(DataError, match="expected at most 10 %"):
        run(text, "t,map [Pa]\n0,1\n100,1\n" + few[2:])


BAD = {
    "unknown key": (
        MINIMAL.replace('unit = "Pa"', 'unti = "Pa"'),
        "unknown key 'channels.p_im.unti'; did you mean 'unit'",
    ),
    "missing key": (MINIMAL.replace('unit = "Pa"', ""), "key 'channels.p_im.unit' is missing"),
    "no channels": ("schema = 1\n[channels]\n", "is empty"),
    "rule": (MINIMAL + 'rule = "cubic"', "rule must be one of hold, linear, mean"),
    "scale": (MINIMAL + "scale = 0.0", "scale must be finite and not zero"),
    "range": (MINIMAL + "low = 2.0\nhigh = 1.0", "low must be below high"),
    "reference": (MINIMAL.replace("p_im", "ref_W_c"), "cannot have this name"),
    "time": (MINIMAL.replace("p_im", "time"), "cannot have this name"),
    "schema": (MINIMAL.replace("= 1", "= 2", 1), "expected 1"),
    "decimal": (MINIMAL + '[source]\ndecimal = ","', "not the delimiter"),
    "not TOML": ("schema = ", "is not TOML"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_profile_is_read_strictly(tmp_path, case):
    text, words = BAD[case]
    with pytest.raises(UsageError, match=words) as failure:
        profile(text, tmp_path)
    assert "\n" not in str(failure.value)


def test_shipped_profiles_load_and_others_are_named():
    assert {"liu-ice", "kit-obd"} <= set(shipped())
    for name in shipped():
        assert load_profile(name)[1].name == name
    with pytest.raises(UsageError, match="lpvobs has the profiles kit-obd, liu-ice"):
        load_profile("liu-ise")


def test_the_example_of_the_documentation_is_a_profile(tmp_path):
    text = (ROOT / "docs" / "ingest.md").read_text(encoding="utf-8")
    example = text.split("```toml\n")[1].split("```")[0]
    assert set(profile(example, tmp_path).channels) == {"p_im", "W_maf"}
    for item in (SourceRules, TimeRules, Raster, ChannelRules):
        for key in fields(item):
            assert f"`{key.name}`" in text or f"] {key.name}`" in text, key.name


def test_a_channel_without_any_number_has_no_rate(run):
    made = run(MINIMAL + '[channels.n_e]\nsource = "n"\nunit = "rpm"\n', "t,map [Pa],n [rpm]\n0,1e5,\n1,1e5,\n2,1e5,\n")
    item = made.record["channels"]["n_e"]
    assert (item["rate"], item["without_value"], item["repairs"]) == (None, 3, {"empty": 3})


DAMAGED = [
    b"{", b"[]", b"null", b'{"schema": "lpvobs/ingest/2"}', b'{"schema": "lpvobs/ingest/1"}',
    b'{"schema": "lpvobs/ingest/1", "sources": 1, "time": 2, "raster": 3, "channels": 4, "missing": 5, "profile": 6}',
]  # fmt: skip


@pytest.mark.parametrize("stored", DAMAGED)
def test_a_damaged_record_is_no_record(tmp_path, stored):
    path = tmp_path / "log.parquet"
    table = pa.table({"time": [0.0, 1.0]}).replace_schema_metadata({"lpvobs.ingest": stored})
    pq.write_table(table, path)
    assert stored_record(path) is None


def test_a_record_with_one_part_missing_is_no_record(tmp_path, run):
    whole = run(MINIMAL, "t,map [Pa]\n0,1e5\n1,1e5\n2,1e5\n").record | {
        "profile": {"name": "a", "sha256": "b", "text": "c"}
    }
    path = tmp_path / "log.parquet"

    def stored(record):
        pq.write_table(
            pa.table({"time": [0.0, 1.0]}).replace_schema_metadata({"lpvobs.ingest": json.dumps(record)}), path
        )
        return stored_record(path)

    assert stored(whole) == whole
    for key in ("sources", "time", "raster", "channels", "missing", "profile"):
        assert stored({name: value for name, value in whole.items() if name != key}) is None
    assert stored(whole | {"channels": {"p_im": whole["channels"]["p_im"] | {"repairs": 3}}}) is None
    assert stored(whole | {"sources": [whole["sources"][0] | {"time_repairs": {"t": 3}}]}) is None

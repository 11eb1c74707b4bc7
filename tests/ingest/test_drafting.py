"""Drafted profiles: what is sure stands, what is not is a comment."""

import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat

from lpvobs.errors import DataError
from lpvobs.ingest.drafting import csv_layout, draft_profile, guess, known_channels
from lpvobs.ingest.foreign import ingest
from lpvobs.ingest.profiles import profile_of
from lpvobs.ingest.recordings import Head
from lpvobs.ingest.repairs import polled


def write(path, header, rows, delimiter=","):
    path.write_text("\n".join([header, *(delimiter.join(map(str, row)) for row in rows)]) + "\n", encoding="utf-8")
    return path


@pytest.fixture
def plain(tmp_path):
    """Return a recording with names and units that leave no doubt, one name that does, and one that nobody knows."""
    header = "time [s],engine_speed [1/min],W_maf [kg/h],p_im [hPa],iat [degC],knock [V]"
    rows = [[0.1 * k, 1500 + k, 150 + k, 1400, 30, 0.1] for k in range(50)]
    return write(tmp_path / "drive.csv", header, rows)


def test_a_draft_of_a_plain_recording_ingests_as_it_is(plain):
    text = draft_profile(plain)
    profile = profile_of(text, plain.with_suffix(".toml"))
    assert set(profile.channels) == {"n_e", "W_maf", "p_im"}
    made = ingest([plain], profile)
    np.testing.assert_allclose(made.channels["W_maf"], (150 + np.arange(50)) / 3600, rtol=1e-12)
    assert "\n# [channels.T_im]\n" in text
    assert "\n# [channels.T_ic]\n" in text
    assert "#   knock [V]" in text


def test_every_guess_has_its_reason(plain):
    lines = draft_profile(plain).splitlines()
    for number, line in enumerate(lines):
        if "[channels." in line:
            assert any("the name" in before and "median" in before for before in lines[number - 2 : number])


def test_what_the_file_does_not_say_is_not_guessed_silently(tmp_path):
    path = write(tmp_path / "drive.csv", "time,engine_speed,p_im", [[0.1 * k, 150, 1400] for k in range(50)])
    text = draft_profile(path)
    assert '# unit = "s"' in text
    assert '# source_unit = "rad/s"' in text
    assert '# source_unit = "hPa"' in text
    with pytest.raises(DataError, match="set unit in the profile"):
        ingest([path], profile_of(text, path))
    with pytest.raises(DataError, match="set source_unit in "):
        ingest([path], profile_of(text.replace('# unit = "s"', 'unit = "s"'), path))
    told = text.replace('# unit = "s"', 'unit = "s"').replace("# source_unit", "source_unit")
    np.testing.assert_allclose(ingest([path], profile_of(told, path)).channels["p_im"], 1.4e5)


def test_two_columns_for_one_channel_are_both_comments(tmp_path):
    path = write(tmp_path / "drive.csv", "time [s],maf [g/s],mass_air_flow [g/s]", [[k, 20, 21] for k in range(20)])
    text = draft_profile(path)
    assert tomllib.loads(text).get("channels") is None
    assert text.count("# [channels.W_maf]") == 2


def test_a_unit_of_another_kind_is_no_candidate_and_an_odd_median_no_certainty():
    values = np.full(10, 300.0)
    assert guess("p_im", "p_im", Head("p_im", "degC"), values) is None
    assert guess("W_maf", "maf", Head("maf", "kg/s"), values).sure is False
    assert guess("W_maf", "maf", Head("maf", "kg/h"), values).sure is True
    assert guess("W_maf", "maf", Head("maf", "kg/h"), np.full(3, np.nan)).sure is False


def test_layouts(tmp_path):
    path = tmp_path / "export.csv"
    path.write_text(
        "recorded by nobody\n\nZeit;nmot;p_im\ns;1/min;hPa\n0,0;800,5;999,0\n0,1;801,0;999,5\n", encoding="utf-8"
    )
    rules, reasons = csv_layout(path)
    assert (rules.delimiter, rules.decimal, rules.unit_row - rules.header_row) == (";", ",", 1)
    assert len(reasons) == 3


def test_lines_are_counted_as_the_file_has_them(tmp_path):
    path = tmp_path / "export.csv"
    rows = "".join(f"{0.1 * k:.1f};800;999\n" for k in range(9))
    path.write_text("recorded by nobody\n\nZeit [s];nmot [1/min];p_im [hPa]\n" + rows, encoding="utf-8")
    profile = profile_of(draft_profile(path), tmp_path / "p.toml")
    np.testing.assert_allclose(ingest([path], profile).channels["p_im"], 99900.0)


def test_polled_recordings_are_recognised(tmp_path):
    rng = np.random.default_rng(1)
    values, rows = np.zeros(4), []
    for k in range(400):
        values[k % 4] = rng.normal()
        rows.append([f"{10 + k // 60}:{k % 60:02d}", *values.round(6)])
    path = write(tmp_path / "drive.csv", "time,a [V],b [V],c [V],d [V]", rows)
    text = draft_profile(path)
    assert "polled = true" in text
    assert 'unit = "clock"' in text
    columns = {name: rng.standard_normal(400) for name in "abcd"}
    assert polled(columns, list("abcd")) == pytest.approx(0.25, abs=0.01)


@pytest.mark.slow
def test_mat_vectors_get_the_time_base_of_their_length(tmp_path):
    path = tmp_path / "drive.mat"
    fast, slow = np.arange(0, 4, 0.01), np.arange(0, 4, 0.5)
    savemat(path, {"t_fast": fast, "t_slow": slow, "n_mot": 1500 + fast, "p_amb": 990 + slow})
    text = draft_profile(path)
    assert 'time = "t_fast"  # the only time column with 400 samples' in text
    assert 'time = "t_slow"  # the only time column with 8 samples' in text
    told = text.replace('# unit = "s"', 'unit = "s"').replace('source_unit = ""', 'source_unit = "rpm"')
    told = told.replace("# source_unit", "source_unit").replace("  # which?", "").replace("# rate", "rate")
    assert ingest([path], profile_of(told, path)).channels["p_amb"][0] == pytest.approx(99000.0)


@pytest.mark.slow
def test_mdf_groups_need_no_time_and_get_a_rate(tmp_path):
    asammdf = pytest.importorskip("asammdf", reason="the extra lpvobs[mdf] is not installed")
    file = asammdf.MDF(version="4.10")
    for step, name, value, unit in ((0.01, "nmot", 1500.0, "1/min"), (0.1, "maf", 40.0, "kg/h")):
        stamps = np.arange(0, 4, step)
        file.append([asammdf.Signal(value + stamps, stamps, unit=unit, name=name)])
    path = tmp_path / "drive.mf4"
    file.save(path)
    file.close()
    text = draft_profile(path)
    assert "rate = 100" in text
    made = ingest([path], profile_of(text, path))
    assert made.channels["n_e"].size == made.channels["W_maf"].size >= 390


@given(st.text(max_size=30), st.text(max_size=10))
@pytest.mark.slow
def test_any_header_gives_a_draft_that_is_toml(tmp_path_factory, name, unit):
    path = tmp_path_factory.mktemp("any") / "drive.csv"
    clean = "".join(
        letter for letter in f"{name} [{unit}]" if letter not in '\r\n\0,"\x0b\x0c\x1c\x1d\x1e\x85\u2028\u2029'
    )
    path.write_text(f"time [s],{clean},maf [g/s]\n" + "0,1,20\n1,2,21\n2,3,22\n", encoding="utf-8", errors="replace")
    assert tomllib.loads(draft_profile(path))["schema"] == 1


def test_what_is_no_recording(tmp_path):
    for name, content in (("a.csv", b""), ("b.csv", b"\0" * 100), ("c.csv", b"one column\n1\n2\n")):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(DataError):
            draft_profile(path)
    with pytest.raises(DataError, match="no such recording"):
        draft_profile(tmp_path / "none.csv")


def test_the_patterns_of_a_channel_do_not_claim_anothers_name():
    """A name that means one channel surely means no other."""
    for name, known in known_channels().items():
        middle = np.array([np.mean(known.typical)])
        sure = [
            other
            for other in known_channels()
            if (found := guess(other, name, Head(name, known.unit), middle)) and found.sure
        ]
        assert sure == [name]

"""Channels computed in a profile, and columns that are used twice."""

import json

import numpy as np
import pytest

from lpvobs.api.ingest_log import ingest_log
from lpvobs.api.inspect import inspect
from lpvobs.errors import DataError, UsageError
from lpvobs.ingest.computed import Computed
from lpvobs.ingest.profiles import profile_of
from lpvobs.io.logs.parquet import channel_units

PROFILE = """
schema = 1
[time]
source = "t"
unit = "s"
[channels.n_e]
source = "n"
source_unit = "rpm"
unit = "rpm"
[channels.air_per_stroke]
source = "air"
source_unit = "mg/stroke"
unit = "kg/stroke"
[channels.p_boost]
source = "boost"
source_unit = "mbar"
unit = "Pa"
[channels.p_amb]
source = "baro"
source_unit = "kPa"
unit = "Pa"
[channels.t_inj]
source = "ti"
source_unit = "ms"
unit = "ms"
[computed.W_maf]
formula = "air_per_stroke * n_e * 4 / 120"
unit = "kg/s"
[computed.p_im]
formula = "p_boost + p_amb"
unit = "Pa"
[computed.u_delta]
formula = "(t_inj - 0.3) * k"
unit = "mg/cycle"
constants = { k = "12.5 mg/cycle/ms" }
"""


def test_results_are_those_by_hand_and_inspect_shows_the_formula(tmp_path):
    csv, profile, log = (tmp_path / name for name in ("drive.csv", "own.toml", "drive.parquet"))
    csv.write_text("t,n,air,boost,baro,ti\n" + "".join(f"{k / 10},{1800 + k},500,400,98,1.1\n" for k in range(40)))
    profile.write_text(PROFILE)
    ingest_log([csv], str(profile), log)
    found = inspect(log)
    n = 1800 + np.arange(40)
    assert found.channels["W_maf"].median == pytest.approx(np.median(500e-6 * n * 4 / 120), rel=1e-12)
    assert found.channels["p_im"].median == pytest.approx(138000.0, rel=1e-12)
    assert found.channels["u_delta"].median == pytest.approx(10.0, rel=1e-12)
    assert channel_units(log)["W_maf"] == "kg/s"
    assert found.ingest["channels"]["W_maf"]["source"] == "W_maf = air_per_stroke * n_e * 4 / 120"
    assert "k = 12.5 mg/cycle/ms" in json.dumps(found.ingest)


@pytest.mark.parametrize(
    ("formula", "said"),
    [
        ("n_e * p_amb", "expected a unit that converts to kg/s"),
        ("air_per_stroke * n_x", "'n_x' is neither a channel nor a constant"),
        ("air_per_stroke + n_e", "adds kg / cycle and rpm|adds"),
        ("__import__('os').system('true')", "is not allowed"),
        ("air_per_stroke ** 2", "is not allowed"),
        ("(lambda: 1)()", "is not allowed"),
        ("True * air_per_stroke", "is not allowed"),
        ("'a' * 3", "is not allowed"),
        ("n_e[0]", "is not allowed"),
        ("air_per_stroke *", "is not an arithmetic formula"),
        ("(" * 200 + "1" + ")" * 200, "letters"),
        ("air_per_stroke * n_e" + " + 0" * 60, "letters|arithmetic|kind|adds"),
    ],
)
def test_a_formula_that_is_no_arithmetic_or_of_another_kind_is_refused(tmp_path, formula, said):
    if formula.endswith("+ 0"):
        Computed(formula, "kg/s").checked({"air_per_stroke": "kg/stroke", "n_e": "rpm"})  # long, and right
        return
    text = PROFILE.replace("air_per_stroke * n_e * 4 / 120", formula)
    with pytest.raises(UsageError, match=said):
        profile_of(text, tmp_path / "own.toml")


def test_what_is_added_has_one_unit(tmp_path):
    text = PROFILE.replace('source_unit = "kPa"\nunit = "Pa"', 'source_unit = "kPa"\nunit = "kPa"')
    with pytest.raises(UsageError, match="give both terms the same unit"):
        profile_of(text, tmp_path / "own.toml")


def test_what_cannot_be_computed_is_no_value():
    found = Computed("a / b", "1").values({"a": np.array([1.0, 1.0]), "b": np.array([0.0, 2.0])})
    np.testing.assert_array_equal(found, [np.nan, 0.5])


def test_a_column_used_twice_is_refused_with_both_uses(tmp_path):
    csv, profile = tmp_path / "drive.csv", tmp_path / "own.toml"
    csv.write_text("t,n\n0,1\n1,2\n2,3\n")
    channel = '[channels.{}]\nsource = "n"\nsource_unit = "rpm"\nunit = "rpm"\n'
    profile.write_text('schema = 1\n[time]\nsource = "t"\nunit = "s"\n' + channel.format("n_e") + channel.format("n_x"))
    with pytest.raises(DataError, match="'n' is used twice, for channel 'n_e' and for 'n_x'"):
        ingest_log([csv], str(profile), tmp_path / "log.parquet")

"""What cannot be used is refused with one line, the contract's exit code, and nothing left behind or lost."""

import pyarrow as pa
import pyarrow.parquet as pq
import pytest


def refused(done, code, *words):
    assert done.code == code, done.err
    lines = done.err.strip().splitlines()
    assert len(lines) == 1, done.err
    assert "Traceback" not in done.err
    for word in words:
        assert word in lines[0]


def broken_logs(table, path, rewritten):
    """Yield a name, a broken log and words that the refusal has to contain."""
    time = table["time"].to_numpy()
    place = table.column_names.index("time")
    repeated = time.copy()
    repeated[100] = repeated[99]

    def with_time(values):
        return table.set_column(place, table.schema.field("time"), pa.array(values))

    pq.write_table(table.slice(0, 1), path)
    yield "one row", ("at least two",)
    pq.write_table(with_time(repeated), path)
    yield "repeated time", ("time", "repeats")
    rewritten(table, path, p_im="kPa")
    yield "kPa said, Pa meant", ("p_im",)
    path.write_bytes(b"PAR1 and nothing else")
    yield "not Parquet", ("not a readable Parquet",)


def test_broken_logs(lpvobs, config, chain, table, rewritten, tmp_path):
    log, out = tmp_path / "broken.parquet", tmp_path / "refused.h5"
    seen = 0
    for name, words in broken_logs(table, log, rewritten):
        refused(lpvobs("estimate", "--config", config, "--gain", chain.gain, log, "--out", out), 3, str(log), *words)
        assert sorted(tmp_path.iterdir()) == [log], name
        seen += 1
    assert seen == 4


def test_configuration_that_is_not_understood(lpvobs, config, chain, tmp_path):
    text, odd = config.read_text(), tmp_path / "odd.toml"
    arguments = ("estimate", "--config", odd, "--gain", chain.gain, chain.log, "--out", tmp_path / "r.h5")
    for changed, words in (
        (text.replace("smoothing =", "smothing ="), ("estimate.smothing", "did you mean 'smoothing'")),
        (text.replace("V_d = 1.910e-3", 'V_d = "big"'), ("engine.geometry.V_d",)),
        (text.replace("schema = 1", "schema = 9"), ("schema = 9",)),
        (text.replace("V_im = 5.0e-3 ", "# "), ("engine.geometry.V_im", "missing")),
        ("[[[", ("not TOML",)),
    ):
        assert changed != text
        odd.write_text(changed)
        refused(lpvobs(*arguments), 2, str(odd), *words)
    assert not (tmp_path / "r.h5").exists()


def test_a_gain_for_another_engine(lpvobs, config, chain, tmp_path):
    other = tmp_path / "other.toml"
    other.write_text(config.read_text().replace("V_im = 5.0e-3", "V_im = 6.0e-3"))
    done = lpvobs("estimate", "--config", other, "--gain", chain.gain, chain.log, "--out", tmp_path / "r.h5")
    refused(done, 3, str(chain.gain), "V_im", "another engine")


def test_usage(lpvobs, config, chain, tmp_path):
    out = tmp_path / "r.h5"
    refused(
        lpvobs("estimate", "--config", config, "--gain", chain.gain, chain.log, "--out", out, "--method", "magic"),
        2,
        "magic",
    )
    refused(
        lpvobs("estimate", "--config", config, "--gain", chain.gain, chain.log, chain.log, "--out", out),
        2,
        "same content",
    )
    refused(
        lpvobs("estimate", "--config", config, "--gain", chain.gain, chain.log, "--out", tmp_path / "none" / "r.h5"),
        3,
        "none",
    )
    assert lpvobs("estimate").code == 2
    assert not out.exists()


@pytest.mark.slow
def test_gaps_and_missing_samples_are_counted(lpvobs, config, chain, table, tmp_path):
    log, out = tmp_path / "holes.parquet", tmp_path / "r.h5"
    values = table["p_im"].to_numpy().copy()
    values[100:110] = float("nan")
    holed = table.set_column(table.column_names.index("p_im"), table.schema.field("p_im"), pa.array(values))
    pq.write_table(pa.concat_tables([holed.slice(0, 2000), holed.slice(2100)]), log)
    done = lpvobs("estimate", "--config", config, "--gain", chain.gain, log, "--out", out, "--json")
    assert done.code == 0, done.err
    (found,) = done.json["logs"]
    assert (found["dropped_rows"], found["gaps"]) == (10, 1)
    (seen,) = lpvobs("inspect", log, "--json").json["logs"]
    assert (seen["dropped_rows"], seen["gaps"], seen["channels"]["p_im"]["dropped"]) == (10, 1, 10)


def test_units_and_formats_that_are_not_a_logs_say_what_to_do(lpvobs, config, chain, table, rewritten, tmp_path):
    log, out = tmp_path / "other.parquet", tmp_path / "r.h5"
    call = ("estimate", "--config", config, "--gain", chain.gain, log, "--out", out)
    rewritten(table, log, W_maf="mg/cycle")
    refused(lpvobs(*call), 3, "channel 'W_maf': unit 'mg/cycle' cannot be converted to 'kg/s'; give this channel")
    for recording in (b"time,n_e\n0,800\n", b"MDF     4.10    "):
        log.write_bytes(recording)
        refused(
            lpvobs(*call),
            3,
            f"{log}: not a Parquet file, but logs are Parquet files; `lpvobs profile` and then `lpvobs ingest`",
        )
    log.write_bytes(b"PAR1 cut short")
    refused(lpvobs(*call), 3, "record or export it again")


def test_a_file_of_another_kind_is_called_what_it_is(lpvobs, config, chain, tmp_path):
    refused(
        lpvobs("report", chain.gain),
        3,
        f"{chain.gain}: not a result file but a gain file; make a result with `lpvobs estimate`",
    )
    call = ("estimate", "--config", config, "--gain", chain.result, chain.log, "--out", tmp_path / "r.h5")
    refused(
        lpvobs(*call), 3, f"{chain.result}: not a gain file but a result file; make a gain with `lpvobs synth-gain`"
    )


def test_inspect_of_a_result_shows_it(lpvobs, chain):
    assert lpvobs("inspect", chain.result) == lpvobs("report", chain.result)


def test_a_valve_at_rest_is_shown_as_zero(lpvobs, table, tmp_path):
    """A simulated actuator goes on closing by a share a step and never arrives."""
    log = tmp_path / "resting.parquet"
    values = table["u_egr"].to_numpy().copy()
    values[: values.size * 2 // 3] = 2.47e-322
    place = table.column_names.index("u_egr")
    pq.write_table(table.set_column(place, table.schema.field("u_egr"), pa.array(values)), log)
    (seen,) = lpvobs("inspect", log, "--json").json["logs"]
    found = seen["channels"]["u_egr"]
    assert (found["min"], found["median"]) == (0.0, 0.0)
    assert found["max"] == values.max() > 1.0


def test_one_bad_log_among_good_ones_is_listed_by_inspect(lpvobs, chain, tmp_path):
    done = lpvobs("inspect", chain.log, tmp_path / "absent.parquet", "--json")
    assert done.code == 3
    assert len(done.json["logs"]) == 1
    assert "absent" in done.json["refused"][0]


@pytest.mark.parametrize("arguments", [("--version",), ("--help",)])
def test_top_level(lpvobs, arguments):
    assert lpvobs(*arguments).code == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("estimat",), ("'estimat'", "'estimate'", "`lpvobs --help`")),
        (("estimate",), ("LOG...", "`lpvobs estimate --help`")),
        (("estimate", "x", "--jobs", "many", "--out", "y"), ("--jobs': 'many' is not a whole number; see",)),
        (("verify", "a", "b"), ("b", "`lpvobs verify --help`")),
        (("inspect", "--no\nsuch\x1b[31m"), ("--no",)),
    ],
)
def test_a_command_line_that_means_nothing_is_one_line_too(lpvobs, arguments, words):
    done = lpvobs(*arguments)
    refused(done, 2, "lpvobs: ", *words)
    assert "\x1b" not in done.err


def test_no_argument_at_all_is_answered_with_the_help(lpvobs):
    done = lpvobs()
    assert done.code == 2
    assert "synth-gain" in done.err

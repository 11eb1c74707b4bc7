"""The closed loop from the command line: a slow sensor that nobody declared, and a log in order."""

from contextlib import nullcontext
from html import unescape
from types import SimpleNamespace

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
import xarray as xr

from lpvobs.api.trace import _refuse_slow
from lpvobs.cli.loop import show
from lpvobs.discovery.held_out import Comparison
from lpvobs.discovery.outcome import DrivesNeeded, ResidualOutput, Trace, error_output
from lpvobs.errors import DataError

TAU = 0.1  # s, of the slow sensor


def test_the_terminal_says_how_many_healthy_drives_might_prove_what_comes_near(capsys):
    error = error_output(Comparison(2e-4, 2e-4, 1.0, (1.0, 1.0)), "parts")
    found = Trace(
        verdict="none", p_value=0.03, effects=(), error=error, residual=ResidualOutput(True, ()), healthy_drives=("a", "b"),
        healthy_drives_needed=DrivesNeeded("maf.offset", 9), logs=(), ranking=(), left=None,
    )  # fmt: skip
    show(found, frozen=True, refined=False)
    printed = " ".join(capsys.readouterr().out.split())
    assert printed.startswith("verdict: none (map frozen) p-value of 'no effect': 0.03 2 healthy drives tell")
    assert printed.endswith("9 healthy drives in all would prove it.")


def test_a_slow_sensor_is_named_sized_and_removed(refined):
    _, said = refined
    assert said["verdict"] == "effect"
    first = said["effects"][0]
    assert "maf.lag" in (first["id"], *first["indistinguishable"])
    if first["id"] == "maf.lag":
        # at 20 Hz a lag of two samples is told from a dead time, but not better than to half a sample
        assert first["parameters"]["tau"]["value"] == pytest.approx(TAU, abs=0.025)
    assert said["error"]["ratio_ci90"][1] < 1.0  # surely better where nothing was fitted


def test_the_refined_model_is_stored_beside_the_map_that_stood(refined, chain):
    out, said = refined
    first = said["effects"][0]
    with h5py.File(out) as file, h5py.File(chain.result) as nominal:
        effect = file["refinement/effects/effect_1"]
        assert effect.attrs["id"] == first["id"]
        assert effect["value"][()] == next(iter(first["parameters"].values()))["value"]
        assert list(effect["log"].asstr()) == ["slow", "ftp75_cold"]
        assert list(effect["acts"]) == [1, 0]  # the log that made the map is without it
        assert file["refinement/comparison/ratio"][0] == said["error"]["ratio"]
        if first["id"] == "maf.lag":
            assert file["refinement/observer/L"].shape == (4, 4)
            assert file["refinement/observer/smallest_pivot"][()] > 0.0
        assert np.array_equal(file["map/delta_W_c"], nominal["map/delta_W_c"], equal_nan=True)
        assert "extrapolation" in file


@pytest.mark.proof
def test_the_map_of_its_own_log_is_estimated_anew_by_the_observer(lpvobs, config, chain, tmp_path):
    """A hole in the intake makes the map of the configured engine wrong by 4 %; refined, it is right again."""
    leaky, own, out = tmp_path / "leaky.parquet", tmp_path / "own.h5", tmp_path / "refined.h5"
    fault = config.parent / "effects" / "undeclared_leak.toml"
    call = ("simulate", "--config", config, "--cycle", "ftp75_cold", "--rate", 20, "--effects", fault, "--out", leaky)
    assert lpvobs(*call).code == 0
    as_configured = ("--constants", "consider")
    assert lpvobs("estimate", "--config", config, "--gain", chain.gain, leaky, *as_configured, "--out", own).code == 0
    done = lpvobs("refine", own, leaky, "--out", out, "--json")
    assert done.code == 0, done.err
    assert not done.json["map_frozen"]
    assert [effect["id"] for effect in done.json["effects"]] == ["leak.intake"]
    with h5py.File(out) as file, h5py.File(own) as before:
        refined, unrefined = (group["metrics/leaky/mean_relative_error"][()] for group in (file, before))
        assert unrefined > 0.03
        assert refined < 0.3 * unrefined
        assert file["logs/leaky/share_certified"][()] > 0.99
        assert "observer" not in file["refinement"]  # a leak is a known input, gain and proof stay


@pytest.mark.slow
def test_a_map_that_is_made_anew_has_its_sentence_on_the_page(lpvobs, config, chain, tmp_path):
    """A page with such a map ended in a Python error: the sentence was made there, for this map alone."""
    faulty, own, out, page = (tmp_path / name for name in ("faulty.parquet", "own.h5", "refined.h5", "page.html"))
    table = pq.read_table(chain.log)
    reading, place = table["W_maf"].to_numpy().copy(), table.schema.get_field_index("W_maf")
    reading[reading.size // 2 :] *= 0.85
    pq.write_table(table.set_column(place, table.schema.field(place), [reading]), faulty)
    assert lpvobs("estimate", "--config", config, "--gain", chain.gain, faulty, "--out", own).code == 0
    done = lpvobs("refine", own, faulty, "--out", out, "--json")
    assert done.code == 0, done.err
    assert done.json["effects"]
    assert not done.json["map_frozen"]
    with h5py.File(out) as file:
        said = file.attrs["headline"]
    assert said.startswith("the sensor reads ")
    done = lpvobs("report", out, "--html", page)
    assert done.code == 0, done.err
    assert said in unescape(page.read_text(encoding="utf-8"))


@pytest.mark.slow
def test_a_refined_model_is_complete(lpvobs, refined, slow, tmp_path):
    """And says so in text that fits a terminal."""
    out, said = refined
    again = tmp_path / "again.h5"
    done = lpvobs("refine", out, slow, "--out", again)
    assert done.code == 0, done.err
    assert "verdict: none" in done.out
    assert "in the model already" in done.out
    assert said["effects"][0]["id"] in done.out
    assert max(map(len, done.out.splitlines())) <= 80
    assert again.read_bytes() == out.read_bytes()


@pytest.mark.parametrize("engine", ["h5netcdf", "netcdf4"])
def test_xarray_opens_the_refined_model(refined, engine):
    with xr.open_dataset(refined[0], group="refinement/effects/effect_1", engine=engine) as effect:
        assert effect["acts"].dims == ("log",)
        value = next(iter(refined[1]["effects"][0]["parameters"].values()))["value"]
        assert float(effect["value"]) == value
    for group in ("", "comparison", "whiteness/after", "ranking", "plots", "plots/log_1", "plots/effect_1"):
        with xr.open_dataset(refined[0], group=f"refinement/{group}", engine=engine) as data:
            assert data.sizes
            assert not [name for name in data.dims if name.startswith("phony")]
            data.load()


@pytest.mark.slow
def test_the_page_shows_the_residual_without_the_logs(lpvobs, refined, tmp_path):
    page = tmp_path / "page.html"
    done = lpvobs("report", refined[0], "--html", page)
    assert done.code == 0, done.err
    text = page.read_text()
    assert text.index("slow: the MAF ") < text.index("Residual of every balance")
    for figure in (
        "residual over time, slow",
        "ranking of candidates",
        "partial residual of",
        "spectra",
        "autocorrelation",
    ):
        assert f'aria-label="{figure}' in text, figure
    for figure in ("cumulated periodogram", "cross-correlation"):
        assert f'aria-label="{figure}' in text, figure
    assert len(text) < 2_000_000


def test_a_log_held_out_is_judged(refined):
    _, said = refined
    assert said["error_on_held_out_logs"]["ratio_ci90"][1] < 1.0
    assert [part["log"] for part in said["logs"]] == ["slow", "other"]


def test_a_log_that_is_there_twice_is_refused(lpvobs, chain, slow, tmp_path):
    done = lpvobs("refine", chain.result, slow, "--hold-out", slow, "--out", tmp_path / "out.h5")
    assert done.code == 2
    assert "same content" in done.err


def every_other(path, out):
    """Write every other sample of a log: one at 10 Hz."""
    table = pq.read_table(path)
    pq.write_table(table.take(np.arange(0, table.num_rows, 2)), out)
    return out


@pytest.mark.proof
def test_a_slow_log_in_order_is_no_reason_for_suspicion(lpvobs, config, chain, tmp_path):
    """What is left at 10 Hz may be what slow sampling leaves: no verdict rather than a wrong one."""
    log, result = every_other(chain.log, tmp_path / "clean.parquet"), tmp_path / "result.h5"
    made = lpvobs("estimate", "--config", config, "--gain", chain.gain, log, "--out", result)
    assert made.code == 0, made.err
    before = result.read_bytes()
    done = lpvobs("trace", result, log)
    assert done.code == 3, done.out
    assert "20 samples a second" in done.err
    assert result.read_bytes() == before


@pytest.mark.proof
def test_a_slow_sensor_is_named_on_a_slow_log(lpvobs, chain, slow, tmp_path):
    """10 Hz, against healthy drives at 20 Hz; a lag of one sample is not told from a dead time."""
    log = every_other(slow, tmp_path / "slow.parquet")
    done = lpvobs("refine", chain.result, log, "--out", tmp_path / "refined.h5", "--json")
    (effect,) = done.json["effects"]
    assert "maf.lag" in (effect["id"], *effect["indistinguishable"])


@pytest.mark.parametrize(("rate", "refused"), [(10.0, True), (20.0, False)])
def test_what_has_no_name_is_refused_on_a_slow_log(rate, refused):
    log = SimpleNamespace(name="drive", time=np.arange(100) / rate)
    with pytest.raises(DataError, match="record at least 20 samples a second") if refused else nullcontext():
        _refuse_slow([log])


@pytest.mark.proof
def test_a_log_that_cannot_be_used_is_named_and_left_out(lpvobs, chain, refined, slow, traced, tmp_path):
    _, bad, done = traced
    assert done.code == 3
    assert done.json["effects"] == refined[1]["effects"]  # those of the good log; a log held out teaches nothing
    assert [str(bad) in message for message in done.json["refused"]] == [True]
    assert f"lpvobs: log left out: {bad}" in done.err
    copy, out = tmp_path / "copy.h5", tmp_path / "out.h5"
    copy.write_bytes(chain.result.read_bytes())
    assert lpvobs("trace", copy, bad).code == 3
    assert copy.read_bytes() == chain.result.read_bytes()
    assert (
        lpvobs("refine", chain.result, slow, "--hold-out", bad, "--out", out).code == 3
    )  # nothing to judge the error on
    assert not out.exists()


def test_trace_leaves_everything_but_its_own_group(chain, traced):
    result, _, done = traced
    assert done.json["schema"] == "lpvobs/trace/1"
    assert "after" not in done.json["error"]
    with h5py.File(result) as after, h5py.File(chain.result) as before:
        assert set(after) - set(before) == {"trace"}
        assert np.array_equal(after["map/delta_W_c"][()], before["map/delta_W_c"][()], equal_nan=True)

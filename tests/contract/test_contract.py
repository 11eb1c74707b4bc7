"""The contract with those who call the command line and read its files: Makefiles, CI jobs, notebooks.

Names, units, shapes and codes are written out here and not imported: what is renamed in the package has to fail here.
A change to this file that is not an addition breaks somebody's work.
"""

import json
import re
import shutil

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import xarray as xr
from hdf5 import datasets
from reference import throttled_drive
from repository import LIU_ICE, short_cycle

from lpvobs.engines.diesel.effects import CATALOGUE
from lpvobs.engines.throttled.effects import catalogue as throttled_effects
from lpvobs.errors import UsageError
from lpvobs.io.configuration.config import load_config, load_effects

# --- logs ------------------------------------------------------------------------------------------------------------------
DIESEL_CHANNELS = {
    "time": "s", "n_e": "rpm", "u_delta": "mg/cycle", "u_egr": "%", "u_vgt": "%", "p_im": "Pa", "p_em": "Pa",
    "omega_t": "rad/s", "T_im": "K", "T_em": "K", "p_amb": "Pa", "T_amb": "K", "W_maf": "kg/s",
}  # fmt: skip
TRUTH = {"ref_W_c": "kg/s", "ref_delta_W_c": "kg/s"}
THROTTLED_CHANNELS = {
    "time": "s", "n_e": "rpm", "m_f": "1", "alpha_th": "%", "u_wg": "1", "p_ic": "Pa", "T_ic": "K", "p_im": "Pa",
    "p_amb": "Pa", "T_amb": "K", "W_maf": "kg/s",
}  # fmt: skip
CYCLES = ("etc", "etc_part1", "ftp75", "ftp75_cold", "nedc", "whtc", "wltc")


def test_a_simulated_log_has_every_channel_with_its_unit_and_the_truth(table):
    units = {field.name: field.metadata[b"unit"].decode() for field in table.schema}
    assert {name: units.get(name) for name in DIESEL_CHANNELS | TRUTH} == DIESEL_CHANNELS | TRUTH
    assert (np.diff(table["time"].to_numpy()) > 0.0).all()


def test_an_error_is_reading_minus_truth(table):
    reading, truth, error = (table[name].to_numpy() for name in ("W_maf", "ref_W_c", "ref_delta_W_c"))
    noise = reading - truth - error
    # The sensor's noise is 1 % of its reading at most: its mean over 10 000 samples is a hundredth of that.
    assert abs(noise.mean()) < 0.02 * abs(error).mean()


def test_a_drive_repeats_to_the_byte_and_has_a_hundred_samples_a_second(lpvobs, config, tmp_path):
    drive = ("simulate", "--config", config, "--cycle", short_cycle(tmp_path))
    for name, seed in (("a", 5), ("b", 5), ("c", 6)):
        done = lpvobs(*drive, "--seed", seed, "--out", tmp_path / name)
        assert done.code == 0, done.err
    first, second, third = ((tmp_path / name).read_bytes() for name in "abc")
    assert first == second != third
    assert np.diff(pq.read_table(tmp_path / "a")["time"].to_numpy()) == pytest.approx(0.01, abs=1e-9)


def test_an_unknown_cycle_is_answered_with_the_known_ones(lpvobs, config, tmp_path):
    done = lpvobs("simulate", "--config", config, "--cycle", "le_mans", "--out", tmp_path / "log.parquet")
    refused(done, 2, "le_mans", *CYCLES)


def test_a_throttled_log_is_taken_as_the_contract_has_it(lpvobs, tmp_path):
    channels = throttled_drive.drive(120.0)
    channels["u_wg"] = np.zeros(channels["time"].size)
    fields = [pa.field(name, pa.float64(), metadata={"unit": unit}) for name, unit in THROTTLED_CHANNELS.items()]
    log = tmp_path / "log.parquet"
    pq.write_table(pa.table([channels[name] for name in THROTTLED_CHANNELS], schema=pa.schema(fields)), log)
    done = lpvobs("inspect", log, "--config", LIU_ICE, "--json")
    assert done.code == 0, done.err
    assert set(THROTTLED_CHANNELS) - {"time"} <= set(done.json["logs"][0]["channels"])


def test_gaps_split_and_samples_without_a_number_are_counted(lpvobs, table, tmp_path):
    values = table["p_im"].to_numpy().copy()
    values[100:110] = np.nan
    place = table.column_names.index("p_im")
    holed = table.set_column(place, table.schema.field("p_im"), pa.array(values))
    pq.write_table(pa.concat_tables([holed.slice(0, 2000), holed.slice(2100)]), tmp_path / "log.parquet")
    (found,) = lpvobs("inspect", tmp_path / "log.parquet", "--json").json["logs"]
    assert (found["dropped_rows"], found["gaps"]) == (10, 1)


# --- what is refused ---------------------------------------------------------------------------------------------------------
def refused(done, code, *words):
    """Expect an exit code and one line that holds words."""
    assert done.code == code, done.err
    assert done.out == ""
    (line,) = done.err.strip().splitlines()
    assert [word for word in words if word not in line] == []


def reversed_time(table):
    place = table.column_names.index("time")
    return table.set_column(place, table.schema.field("time"), pa.array(table["time"].to_numpy()[::-1].copy()))


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda table: (table.drop_columns(["W_maf"]), {}), ("W_maf", "missing")),
        (lambda table: (table, {"p_im": "m"}), ("p_im", "'m'", "'Pa'")),
        (lambda table: (table, {"omega_t": ""}), ("omega_t", "no unit", "rad/s")),
        (lambda table: (table.slice(0, 0), {}), ("no rows",)),
        (lambda table: (reversed_time(table), {}), ("time", "backward")),
    ],
    ids=["no channel", "another unit", "no unit", "no rows", "backward time"],
)
def test_a_log_that_is_not_as_agreed_is_code_3_and_leaves_the_old_result(
    lpvobs, config, chain, table, rewritten, tmp_path, spoil, words
):
    log, out = tmp_path / "log.parquet", tmp_path / "old.h5"
    spoiled, units = spoil(table)
    rewritten(spoiled, log, **units)
    out.write_bytes(b"precious")
    refused(lpvobs("estimate", "--config", config, "--gain", chain.gain, log, "--out", out), 3, str(log), *words)
    assert out.read_bytes() == b"precious"
    assert sorted(tmp_path.iterdir()) == [log, out]


def test_files_that_are_cut_or_absent_or_something_else_are_code_3_and_leave_nothing(lpvobs, config, chain, tmp_path):
    cut, out = tmp_path / "cut.parquet", tmp_path / "out.h5"
    cut.write_bytes(chain.log.read_bytes()[: chain.log.stat().st_size // 2])
    for gain, log in ((chain.gain, cut), (chain.gain, tmp_path / "absent.parquet"), (chain.log, chain.log)):
        named = log if gain == chain.gain else gain
        refused(lpvobs("estimate", "--config", config, "--gain", gain, log, "--out", out), 3, str(named))
    assert list(tmp_path.iterdir()) == [cut]


def test_an_unknown_key_is_code_2(lpvobs, config, chain, tmp_path):
    odd, out = tmp_path / "odd.toml", tmp_path / "out.h5"
    odd.write_text("no_such_key = 1\n" + config.read_text(encoding="utf-8"), encoding="utf-8")
    refused(
        lpvobs("estimate", "--config", odd, "--gain", chain.gain, chain.log, "--out", out), 2, str(odd), "no_such_key"
    )
    assert list(tmp_path.iterdir()) == [odd]


def test_of_many_logs_the_good_ones_are_done_and_the_bad_ones_listed(with_a_bad_one, pieces):
    out, bad, done = with_a_bad_one
    assert done.code == 3
    assert [log["log"] for log in done.json["logs"]] == sorted(path.stem for path in pieces.iterdir())
    assert str(bad) in done.err
    assert out.exists()


def test_a_gain_that_is_changed_is_not_proven_and_is_code_1(lpvobs, chain, tmp_path):
    assert lpvobs("verify", chain.gain).code == 0
    changed = shutil.copy(chain.gain, tmp_path / "changed.h5")
    with h5py.File(changed, "r+") as file:
        file["gain/L"][2, 2] = -file["gain/L"][2, 2]
    refused(lpvobs("verify", changed), 1, "not proven")


def test_a_bound_of_the_state_that_was_made_smaller_is_not_proven(lpvobs, chain, tmp_path):
    changed = shutil.copy(chain.gain, tmp_path / "changed.h5")
    with h5py.File(changed, "r+") as file:
        file["gain/state_bound/of_rates"][0, 0] *= 0.99
    refused(lpvobs("verify", changed), 1, "the error bound of the states is not proven")


# --- commands ----------------------------------------------------------------------------------------------------------------
VERBS = {
    "simulate": ("--config", "--cycle", "--out", "--effects", "--rate", "--seed", "--engine"),
    "ingest": ("--profile", "--out"),
    "inspect": (),
    "synth-gain": ("--config", "--out"),
    "verify": (),
    "calibrate": ("--bench", "--reference", "--healthy", "--map", "--plan", "--config", "--out"),
    "estimate": ("--config", "--gain", "--engine", "--out", "--method", "--jobs"),
    "extrapolate": ("--method", "--smooth"),
    "compare": ("--gate",),
    "trace": ("--freeze-map", "--free-map", "--engine"),
    "refine": ("--out", "--freeze-map", "--free-map", "--engine"),
    "report": ("--html", "--gate"),
    "export": ("--format", "--out"),
}


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_explains_its_options(lpvobs, verb):
    done = lpvobs(verb, "--help")
    assert done.code == 0, done.err
    assert [option for option in (*VERBS[verb], "--json") if option not in done.out] == []


@pytest.mark.parametrize("verb", ["inspect", "verify", "extrapolate", "report", "export"])
def test_json_is_one_object_with_its_schema_and_nothing_beside_it(lpvobs, chain, tmp_path, verb):
    copy = shutil.copy(chain.result, tmp_path / "result.h5")
    subject = {"inspect": chain.log, "verify": chain.gain}.get(verb, copy)
    more = ("--format", "csv", "--out", tmp_path / "map.csv") if verb == "export" else ()
    done = lpvobs(verb, subject, *more, "--json")
    assert done.code == 0, done.err
    assert json.loads(done.out)["schema"] == f"lpvobs/{verb}/1"
    assert "\x1b" not in done.out + done.err


ESTIMATED = ("map", "nodes", "sensitivity", "excitation", "engine_found", "readings", "healthy", "balance_agreement")


def untold(path, name, *, told):
    """Return every number of a map, of its engine and of its errors, from a log that had the truth, or had it not."""
    found = datasets(path)
    assert any(key.startswith(f"metrics/{name}/") for key in found) == told
    numbers = {key: values.tobytes() for key, values in found.items() if values.dtype.kind in "biuf"}
    kept = {key: values for key, values in numbers.items() if key.split("/")[0] in ESTIMATED}
    assert kept.keys() >= {*MAP, "nodes/covariance"}
    return kept


def test_the_observer_does_not_see_the_truth(chain, bare):
    """Nor does a second run give other numbers."""
    assert set(pq.read_schema(chain.log).names) - set(pq.read_schema(bare.log).names) == set(TRUTH)
    assert untold(bare.result, "bare", told=False) == untold(chain.result, "ftp75_cold", told=True)


@pytest.mark.parametrize("method", ["published", "ekf", "batch"])
def test_no_other_method_sees_the_truth(lpvobs, config, chain, table, tmp_path, method):
    minutes, stored = table.slice(0, 4000), []
    for told, rows in ((True, minutes), (False, minutes.drop_columns(list(TRUTH)))):
        log, out = tmp_path / chain.log.name, tmp_path / f"{told}.h5"
        pq.write_table(rows, log)
        done = lpvobs("estimate", "--config", config, "--gain", chain.gain, log, "--out", out, "--method", method)
        assert done.code == 0, done.err
        stored.append(untold(out, "ftp75_cold", told=told))
    assert stored[0] == stored[1]


def test_a_map_is_exported_for_calibration_tools(lpvobs, chain, tmp_path):
    for form, begins in (("dcm", "KONSERVIERUNG_FORMAT 2.0"), ("csv", None)):
        out = tmp_path / f"map.{form}"
        assert lpvobs("export", chain.result, "--format", form, "--out", out).code == 0
        text = out.read_text(encoding="utf-8")
        assert begins is None or begins in text
    assert len(text.splitlines()) >= 17  # a line a speed


# --- results -----------------------------------------------------------------------------------------------------------------
MAP = ("map/delta_W_c", "map/standard_error", "map/support")


def test_a_map_has_its_shape_axes_units_and_support(chain):
    with h5py.File(chain.result) as file:
        assert file["map/u_delta"][()] == pytest.approx(np.arange(0.0, 57.0, 4.0))
        assert file["map/n_e"][()] == pytest.approx(np.arange(0.0, 4001.0, 250.0))
        for name in MAP:
            assert file[name].shape == (17, 15)
            assert [dimension[0].name for dimension in file[name].dims] == ["/map/n_e", "/map/u_delta"]
        units = {name: file[f"map/{name}"].attrs["units"] for name in ("n_e", "u_delta", "delta_W_c", "standard_error")}
        assert units == {"n_e": "rpm", "u_delta": "mg/cycle", "delta_W_c": "kg/s", "standard_error": "kg/s"}
        assert all(file[f"map/{name}"].attrs["long_name"] for name in units)
        support, error, deviation = (file[name][()] for name in ("map/support", *MAP[:2]))
        assert support.dtype == np.int8
        assert set(np.unique(support)) == {0, 1}
        assert np.array_equal(np.isfinite(error), support == 1)
        assert np.array_equal(np.isfinite(deviation), support == 1)


def test_every_axis_has_a_scale_and_no_type_is_one_that_others_cannot_read(chain):
    bare, odd, flags = [], [], []

    def look(name, item):
        if isinstance(item, h5py.Dataset):
            if not item.is_scale:
                bare.extend(name for dimension in item.dims if len(dimension) == 0)
            if item.dtype == bool or item.dtype.names:
                odd.append(name)
            if item.dtype == np.int8 and not {"flag_values", "flag_meanings"} <= set(item.attrs):
                flags.append(name)

    with h5py.File(chain.result) as file:
        file.visititems(look)
    assert (bare, odd, flags) == ([], [], [])


@pytest.mark.parametrize("engine", ["h5netcdf", "netcdf4"])
@pytest.mark.parametrize("group", ["map", "extrapolation"])
def test_xarray_opens_a_group_with_its_axes(chain, engine, group):
    with xr.open_dataset(chain.result, group=group, engine=engine) as found:
        assert found["delta_W_c"].dims == ("n_e", "u_delta")
        assert [found[axis].attrs["units"] for axis in ("n_e", "u_delta")] == ["rpm", "mg/cycle"]


def test_extrapolation_fills_every_node_and_leaves_the_map(lpvobs, chain, tmp_path):
    copy = tmp_path / "again.h5"
    shutil.copy(chain.result, copy)
    before = datasets(copy)
    assert lpvobs("extrapolate", copy).code == 0
    after = datasets(copy)
    on = before["map/support"] == 1
    assert all(after[name].tobytes() == before[name].tobytes() for name in MAP)
    assert np.isfinite(after["extrapolation/delta_W_c"]).all()
    assert np.isfinite(after["extrapolation/standard_error"]).all()
    assert np.array_equal(after["extrapolation/delta_W_c"][on], before["map/delta_W_c"][on])
    assert np.array_equal(after["extrapolation/support"], np.where(on, 1, 2))
    assert after["extrapolation/coefficients"].shape == after["extrapolation/coefficients_standard_error"].shape == (6,)
    assert list(tmp_path.iterdir()) == [copy]


def test_a_result_has_its_gain_its_metrics_and_where_it_comes_from(chain):
    with h5py.File(chain.result) as file:
        assert {"gain/L", "gain/P", "gain/rho_bounds", "gain/certificate"} <= {f"gain/{name}" for name in file["gain"]}
        assert {"mean_relative_error", "share_left_out", "rms_ratio", "rmse", "bias"} <= set(file["metrics/ftp75_cold"])
        told = file["provenance"].attrs
        assert re.fullmatch("[0-9a-f]{64}", json.loads(told["inputs_sha256"])["ftp75_cold.parquet"])
        assert "[engine.geometry]" in told["config"]
        assert "numpy" in json.loads(told["versions"])
        assert "estimate" in told["command_line"]


@pytest.mark.proof  # quick with a log without truth, above
def test_the_same_inputs_give_the_same_numbers(lpvobs, config, chain, tmp_path):
    again = tmp_path / "again.h5"
    assert lpvobs("estimate", "--config", config, "--gain", chain.gain, chain.log, "--out", again).code == 0
    first, second = datasets(chain.result), datasets(again)
    assert second.keys() <= first.keys()
    for name, values in second.items():
        assert np.array_equal(first[name], values) or first[name].tobytes() == values.tobytes(), name


# --- what the report says ----------------------------------------------------------------------------------------------------
def test_the_report_as_json(lpvobs, chain):
    done = lpvobs("report", chain.result, "--json")
    assert done.code == 0, done.err
    (log,) = done.json["logs"]
    assert {
        "log", "samples", "mean_relative_error", "share_left_out", "rms_ratio", "rmse", "bias", "visited_cells",
    } <= set(log)  # fmt: skip
    cells = done.json["map"]
    assert cells["cells"] == 17 * 15 == cells["estimated"] + cells["extrapolated"]
    assert set(done.json["extrapolation"]["coefficients"]) == {"a2", "a1", "b2", "b1", "c2", "c1"}
    # A fraction: the paper has 5.28 % on this cycle, a log at a fifth of its rate has to be below.
    assert 0.0 < log["mean_relative_error"] < 0.0528


def test_the_page_needs_nothing_from_elsewhere(page):
    text = page.read_text(encoding="utf-8")
    assert "<svg" in text
    assert re.findall(r"""(?:src|href|url\()\s*=?\s*["']?(?:https?:)?//""", text) == []


@pytest.mark.parametrize(("gate", "code"), [("<=0", 1), ("<=1000", 0)])
def test_a_gate_is_code_1_where_a_log_fails_it(lpvobs, chain, gate, code):
    assert lpvobs("report", chain.result, "--gate", f"mean_relative_error{gate}").code == code


# --- what the model lacks ----------------------------------------------------------------------------------------------------
AREA = {"area": "m^2"}
FACTOR = {"factor": "1"}
EFFECTS = {
    "maf.gain": FACTOR, "maf.offset": {"offset": "kg/s"}, "maf.lag": {"tau": "s"}, "maf.delay": {"delay": "s"},
    "maf.drift": {"rate": "1/s"}, "maf.temperature": {"coefficient": "1/K"}, "maf.contamination": {"coefficient": "1"},
    "maf.backflow": {"coefficient": "1"}, "leak.intake": AREA, "leak.inlet": AREA, "egr.leak": AREA, "egr.area": FACTOR,
    "eta_vol.factor": FACTOR, "compressor.flow": FACTOR, "turbine.efficiency": FACTOR, "exhaust.restriction": FACTOR,
    "u_delta.gain": FACTOR, "p_im.gain": FACTOR, "p_im.offset": {"offset": "Pa"}, "p_em.gain": FACTOR,
    "omega_t.gain": FACTOR, "T_im.lag": {"tau": "s"},
}  # fmt: skip
"""Of the diesel; the throttled engine has some of them, and those of `OF_THE_THROTTLE`."""
OF_THE_THROTTLE = {"p_ic.gain": FACTOR, "p_ic.offset": {"offset": "Pa"}, "alpha_th.offset": {"offset": "%"}}
VERDICTS = ("effect", "none", "unexplained")


@pytest.mark.parametrize("identifier", EFFECTS)
def test_an_effect_can_be_simulated_by_its_name_and_parameter(tmp_path, identifier):
    (parameter,) = EFFECTS[identifier]
    size = 1.1 if parameter == "factor" else 1e-5
    path = tmp_path / "effect.toml"
    text = f'[surface]\nkind = "zero"\n\n[[effect]]\nid = "{identifier}"\nonset = 300.0\nend = 400.0\n'
    path.write_text(f"{text}{parameter} = {size}\n", encoding="utf-8")
    assert load_effects(path)
    path.write_text(f"{text}size = {size}\n", encoding="utf-8")
    with pytest.raises(UsageError, match="size"):
        load_effects(path)


@pytest.mark.parametrize(("engine", "expected"), [("diesel", EFFECTS), ("throttled", OF_THE_THROTTLE)])
def test_an_effect_is_sought_by_its_name_and_parameter(engine, expected):
    effects = {"diesel": CATALOGUE, "throttled": throttled_effects(load_config(LIU_ICE)[0].engine)}[engine]
    catalogue = {item.id: item for item in effects}
    assert set(expected) <= set(catalogue) <= set(EFFECTS | OF_THE_THROTTLE)
    known = EFFECTS | OF_THE_THROTTLE
    assert {name: {item.parameter: item.unit} for name, item in catalogue.items()} == {
        name: known[name] for name in catalogue
    }


def test_what_refine_says(refined):
    path, said = refined
    assert said["schema"] == "lpvobs/refine/1"
    shape(said, after=True)
    assert said["verdict"] == "effect"
    with h5py.File(path) as file:
        assert file["refinement/effects/effect_1"].attrs["id"] == said["effects"][0]["id"]


def test_what_trace_says(traced, chain):
    result, _, done = traced
    assert done.json["schema"] == "lpvobs/trace/1"
    shape(done.json, after=False)
    assert datasets(result).keys() > datasets(chain.result).keys()
    with h5py.File(result) as file:
        assert "trace" in file


def test_a_log_in_order_has_nothing_and_the_model_stays(lpvobs, chain, tmp_path):
    out = tmp_path / "refined.h5"
    done = lpvobs("refine", chain.result, chain.log, "--out", out, "--json")
    assert done.code == 0, done.err
    shape(done.json, after=True)
    assert (done.json["verdict"], done.json["effects"]) == ("none", [])
    assert out.read_bytes() == chain.result.read_bytes()


def shape(said, *, after):
    """Expect what `trace` and `refine` have in common."""
    assert said["verdict"] in VERDICTS
    assert (said["verdict"] == "effect") == bool(said["effects"])
    assert 0.0 <= said["p_value"] <= 1.0
    assert ("candidates" in said) == (said["verdict"] == "unexplained")
    for effect in said["effects"]:
        assert effect["id"] in EFFECTS or effect["id"].startswith("channel:")
        assert {"onset", "end", "explained", "p_value", "indistinguishable"} <= set(effect)
        for parameter in effect["parameters"].values():
            low, high = parameter["ci90"]
            assert low <= parameter["value"] <= high
            assert parameter["unit"]
    error = said["error"]
    assert {"measure", "unit", "before", "held_out"} <= set(error)
    assert error["unit"] == "kg/s"
    assert [name in error for name in ("after", "ratio", "ratio_ci90")] == [after] * 3
    assert isinstance(said["residual"]["white"], bool)
    assert {"correlated_with"} <= set(said["residual"])
    assert isinstance(said["logs"], list)

"""The chain from the command line: what the contract promises of files, codes and messages."""

import shutil

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
import xarray as xr
from repository import short_cycle

ESTIMATED = ("map/delta_W_c", "map/standard_error", "map/support")


def test_same_seed_same_bytes_other_seed_other_bytes(lpvobs, config, tmp_path):
    cycle = short_cycle(tmp_path)
    paths = [tmp_path / name for name in ("a.parquet", "b.parquet", "c.parquet")]
    for path, seed in zip(paths, (5, 5, 6), strict=True):
        done = lpvobs("simulate", "--config", config, "--cycle", cycle, "--rate", 10, "--seed", seed, "--out", path)
        assert done.code == 0, done.err
    first, second, third = (path.read_bytes() for path in paths)
    assert first == second
    assert first != third


def test_map_follows_the_contract(chain):
    with h5py.File(chain.result) as file:
        n, u = file["map/n_e"].size, file["map/u_delta"].size
        for name in ESTIMATED:
            assert file[name].shape == (n, u)
            assert all(len(dimension) == 1 for dimension in file[name].dims)
            assert {"units", "long_name"} <= set(file[name].attrs)
        support, error = file["map/support"][()], file["map/delta_W_c"][()]
        assert np.array_equal(np.isnan(error), support == 0)
        assert 0 < support.sum() < support.size
        assert np.array_equal(np.isfinite(file["map/standard_error"][()]), support == 1)


def test_nothing_is_stored_that_other_readers_stumble_over(chain):
    odd = []

    def look(name, item):
        if isinstance(item, h5py.Dataset) and (item.dtype == bool or item.dtype.names):
            odd.append(name)

    with h5py.File(chain.result) as file:
        file.visititems(look)
        assert "inputs_sha256" in file["provenance"].attrs
    assert odd == []


@pytest.mark.parametrize("engine", ["h5netcdf", "netcdf4"])
@pytest.mark.parametrize("group", ["map", "extrapolation", "excitation", "sensitivity"])
def test_xarray_opens_every_group_with_its_axes(chain, engine, group):
    with xr.open_dataset(chain.result, group=group, engine=engine) as found:
        assert {"n_e", "u_delta"} <= set(found.coords)
        surface = next(item for item in found.data_vars.values() if item.ndim >= 2)
        assert surface.dims[-2:] == ("n_e", "u_delta")
        assert [found[axis].attrs["units"] for axis in ("n_e", "u_delta")] == ["rpm", "mg/cycle"]


@pytest.mark.parametrize("engine", ["h5netcdf", "netcdf4"])
@pytest.mark.parametrize(
    "group",
    ["map", "extrapolation", "excitation", "sensitivity", "nodes", "gain", "logs/ftp75_cold", "metrics/ftp75_cold"],
)
def test_xarray_finds_a_unit_and_a_name_on_everything(chain, engine, group):
    with xr.open_dataset(chain.result, group=group, engine=engine, decode_cf=False) as found:
        assert len(found.variables) > 2
        for name, item in found.variables.items():
            assert item.attrs["units"], name
            assert item.attrs["long_name"], name


def test_every_axis_of_every_dataset_has_a_scale(chain):
    bare = []

    def look(name, item):
        if isinstance(item, h5py.Dataset) and not item.is_scale:
            bare.extend(name for dimension in item.dims if len(dimension) == 0)

    with h5py.File(chain.result) as file:
        file.visititems(look)
    assert bare == []


def test_extrapolation_fills_every_node_and_leaves_the_map(lpvobs, chain, tmp_path):
    copy = shutil.copy(chain.result, tmp_path / "again.h5")
    with h5py.File(copy) as file:
        before = {name: file[name][()] for name in ESTIMATED}
    assert lpvobs("extrapolate", copy).code == 0
    with h5py.File(copy) as file:
        for name, values in before.items():
            assert np.array_equal(file[name][()], values, equal_nan=True)
        on = before["map/support"] == 1
        assert np.isfinite(file["extrapolation/delta_W_c"][()]).all()
        assert np.array_equal(file["extrapolation/delta_W_c"][()][on], before["map/delta_W_c"][on])
        assert np.array_equal(file["extrapolation/support"][()], np.where(on, 1, 2))
        assert file["extrapolation/coefficients"].shape == (6,)


@pytest.mark.parametrize("method", ["observer", "published", "ekf", "batch"])
def test_removing_the_references_changes_no_byte_of_the_estimate(lpvobs, config, chain, table, tmp_path, method):
    bare = tmp_path / chain.log.name
    pq.write_table(table.drop_columns([name for name in table.column_names if name.startswith("ref_")]), bare)
    stored = []
    for log, out in ((chain.log, tmp_path / "with.h5"), (bare, tmp_path / "without.h5")):
        done = lpvobs("estimate", "--config", config, "--gain", chain.gain, log, "--out", out, "--method", method)
        assert done.code == 0, done.err
        with h5py.File(out) as file:
            stored.append({name: file[name][()].tobytes() for name in (*ESTIMATED, "nodes/covariance")})
            assert ("metrics/ftp75_cold" in file) == (log == chain.log)
    assert stored[0] == stored[1]


def test_same_inputs_same_datasets(lpvobs, config, chain, tmp_path):
    again = tmp_path / "again.h5"
    assert lpvobs("estimate", "--config", config, "--gain", chain.gain, chain.log, "--out", again).code == 0
    with h5py.File(chain.result) as first, h5py.File(again) as second:
        names = []
        second.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
        for name in names:
            left, right = first[name][()], second[name][()]
            assert np.asarray(left).tobytes() == np.asarray(right).tobytes() or left.dtype == object, name


def test_estimate_makes_its_own_gain_when_none_is_given(lpvobs, config, chain, tmp_path):
    done = lpvobs("estimate", "--config", config, chain.log, "--out", tmp_path / "r.h5", "--json")
    assert done.code == 0, done.err
    assert done.json["schema"] == "lpvobs/estimate/1"
    assert done.json["logs"][0]["share_certified"] >= 0.95


def test_default_settings_beat_the_papers_figure_at_a_fifth_of_its_rate(lpvobs, chain):
    done = lpvobs("report", chain.result, "--json")
    assert done.json["logs"][0]["mean_relative_error"] < 0.0528


def test_neither_estimate_with_a_gain_nor_verify_imports_solver_or_tracer(config, chain, tmp_path):
    import subprocess
    import sys

    for arguments in (
        ["estimate", "--config", config, "--gain", chain.gain, chain.log, "--out", tmp_path / "r.h5"],
        ["verify", chain.gain],
    ):
        code = (
            "import sys, atexit; from lpvobs.cli.main import run;"
            "heavy = 'cvxpy', 'clarabel', 'pandas', 'matplotlib', 'scipy.linalg', 'scipy.stats', 'lpvobs.discovery.fit';"
            "atexit.register(lambda: print(sorted(m for m in heavy if m in sys.modules)));"
            "run()"
        )
        done = subprocess.run(
            [sys.executable, "-c", code, *map(str, arguments)], capture_output=True, text=True, timeout=300, check=True
        )
        assert done.stdout.strip().splitlines()[-1] == "[]"


def test_verify_proves_again_and_notices_a_changed_gain(lpvobs, chain, tmp_path):
    assert lpvobs("verify", chain.gain).code == 0
    broken = shutil.copy(chain.gain, tmp_path / "broken.h5")
    with h5py.File(broken, "r+") as file:
        file["gain/L"][2, 2] = -file["gain/L"][2, 2]
    done = lpvobs("verify", broken)
    assert done.code == 1
    assert "not proven" in done.err
    assert len(done.err.strip().splitlines()) == 1
    assert lpvobs("verify", chain.result).code == 3
    assert lpvobs("verify", chain.log).code == 3


@pytest.mark.parametrize("verb", ["simulate", "inspect", "synth-gain", "verify", "estimate", "extrapolate", "report"])
def test_every_verb_has_help_with_an_example(lpvobs, verb):
    done = lpvobs(verb, "--help")
    assert done.code == 0
    assert f"Example: lpvobs {verb}" in " ".join(done.out.split())

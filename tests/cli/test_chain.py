"""The chain from the command line, beyond what tests/contract has: every group for every reader, and what is not loaded."""

import subprocess
import sys

import pytest
import xarray as xr


@pytest.mark.parametrize("engine", ["h5netcdf", "netcdf4"])
@pytest.mark.parametrize("group", ["excitation", "sensitivity"])
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


@pytest.mark.slow
def test_estimate_makes_its_own_gain_when_none_is_given(lpvobs, config, chain, tmp_path):
    done = lpvobs("estimate", "--config", config, chain.log, "--out", tmp_path / "r.h5", "--json")
    assert done.code == 0, done.err
    assert done.json["schema"] == "lpvobs/estimate/1"
    assert done.json["logs"][0]["share_certified"] >= 0.95


@pytest.mark.slow
def test_neither_estimate_with_a_gain_nor_verify_imports_solver_or_tracer(config, chain, tmp_path):
    searching = (
        "scipy.linalg",
        "lpvobs.discovery.fit",
    )  # estimate keeps what a healthy drive leaves, which the search weighs
    for arguments, needed in (
        (["estimate", "--config", config, "--gain", chain.gain, chain.log, "--out", tmp_path / "r.h5"], searching),
        (["verify", chain.gain], ()),
    ):
        heavy = {"cvxpy", "clarabel", "pandas", "matplotlib", "scipy.stats", *searching} - {*needed}
        code = (
            f"import sys, atexit; from lpvobs.cli.main import run; heavy = {heavy!r};"
            "atexit.register(lambda: print(sorted(m for m in heavy if m in sys.modules)));"
            "run()"
        )
        done = subprocess.run(
            [sys.executable, "-c", code, *map(str, arguments)], capture_output=True, text=True, timeout=300, check=True
        )
        assert done.stdout.strip().splitlines()[-1] == "[]"


@pytest.mark.parametrize(
    "verb", ["simulate", "inspect", "synth-gain", "verify", "calibrate", "estimate", "extrapolate", "report"]
)
def test_every_verb_has_help_with_an_example(lpvobs, verb):
    done = lpvobs(verb, "--help")
    assert done.code == 0
    assert f"Example: lpvobs {verb}" in " ".join(done.out.split())

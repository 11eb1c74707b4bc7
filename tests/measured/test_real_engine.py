"""The loop on a real engine: the model from the healthy log alone, faults that somebody built in found without being told."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from repository import LIU_ICE

import lpvobs
from lpvobs.api.known_engine import known_engine
from lpvobs.io.results.results import read_result

FAULTS = {
    "wltp_f_waf_110": ("maf.gain", 1.10),
    "wltp_f_pim_080": ("p_im.gain", 0.80),
    "wltp_f_pic_090": ("p_ic.gain", 0.90),
    "wltp_f_iml_6mm": ("leak.intake", None),
}
MORNING = 110.0  # s; the faults begin later


@pytest.fixture(scope="session")
def folder(measured, tmp_path_factory):
    """Return a folder with every recording as a log, and the map, the curves and the errors of the healthy one in `healthy.h5`."""
    folder = tmp_path_factory.mktemp("liu-ice")
    for name in ("wltp_NF", *FAULTS):
        lpvobs.ingest_log(measured / "liu-ice" / f"{name}.csv", "liu-ice", folder / f"{name}.parquet")
    lpvobs.estimate(LIU_ICE, folder / "wltp_NF.parquet", folder / "healthy.h5")
    return folder


@pytest.fixture(scope="session")
def traced(folder):
    """Return a function from a log's name to what `trace` says of it, beside the healthy map or on the log that made it."""
    return lambda name: lpvobs.trace(folder / "healthy.h5", folder / f"{name}.parquet").found


@pytest.mark.slow
def test_the_balances_hold_on_parts_that_taught_nothing(folder):
    # As the record of the data says: a flexible model reaches 6 %, speed-density 4 % robustly; physics ought to be better.
    throttle, filling, fuel, ambient = known_engine(read_result(folder / "healthy.h5")).healthy.rms
    assert max(throttle, filling) < 0.03
    assert fuel < 0.08
    assert ambient < 0.005


@pytest.mark.proof
def test_nothing_is_found_on_the_healthy_log_by_parts(traced):
    assert traced("wltp_NF").verdict == "none"


@pytest.mark.parametrize("name", ["wltp_NF", *FAULTS])
@pytest.mark.slow
def test_nothing_is_found_before_the_fault_begins(folder, traced, name):
    table = pq.read_table(folder / f"{name}.parquet")
    time = table["time"].to_numpy()
    pq.write_table(table.filter(pa.array(time - time[0] < MORNING)), folder / f"morning_{name}.parquet")
    assert traced(f"morning_{name}").verdict == "none"


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow if name == "wltp_f_waf_110" else pytest.mark.proof) for name in FAULTS],
)
def test_a_fault_that_somebody_built_in_is_named_sized_and_dated(traced, name):
    expected, factor = FAULTS[name]
    found = traced(name)
    assert [item.id for item in found.findings] == [expected]
    (size,) = found.findings[0].parameters.values()
    if factor is not None:
        assert abs(size.value - factor) < 0.03  # what is asked for
    # The record of the data: between 115 and 135 s, differently in each file.
    assert 110.0 < found.findings[0].onset < 140.0
    assert found.error.after < found.error.before
    moved = {item.balance: item.recovered for item in found.logs[0].balances if item.affected}
    # Under the leak the mixture at idle is not stoichiometric, so the fuel keeps a rest that is no air.
    assert all(share > 0.7 for balance, share in moved.items() if (name, balance) != ("wltp_f_iml_6mm", "fuel"))


@pytest.mark.proof
def test_a_refined_model_of_the_real_engine_has_its_map_estimated_again(folder):
    refined = lpvobs.refine(
        folder / "healthy.h5", folder / "wltp_f_waf_110.parquet", folder / "refined.h5", freeze_map=False
    )
    assert [item.id for item in refined.found.findings] == ["maf.gain"]
    theta, healthy = (lpvobs.read_map(folder / name).values for name in ("refined.h5", "healthy.h5"))
    both = np.isfinite(theta) & np.isfinite(healthy)
    # The sensor reads a tenth too much; with that taken out, its map is that of the healthy day but for the days' one and a half
    # per cent of up to 60 g/s.
    assert np.sqrt(np.mean((theta - healthy)[both] ** 2)) < 2e-3

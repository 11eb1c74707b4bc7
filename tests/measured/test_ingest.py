"""The shipped profiles on the recordings that they are for."""

import numpy as np
import pandas as pd
import pytest

from lpvobs.io.foreign import stored_record
from lpvobs.io.logs import channel_units
from lpvobs.steps.ingest import ingest_log

LIU = ("wltp_NF", "wltp_f_waf_110", "wltp_f_pim_080", "wltp_f_pic_090", "wltp_f_iml_6mm")


@pytest.mark.parametrize("name", LIU)
def test_liu_ice_is_renamed_and_nothing_else_but_the_speed_changes(measured, tmp_path, name):
    source, out = measured / "liu-ice" / f"{name}.csv", tmp_path / f"{name}.parquet"
    record = ingest_log([source], "liu-ice", out)
    with source.open(encoding="utf-8") as stream:
        names = stream.readline().strip().split(",")
        before = dict(zip(names, np.loadtxt(stream, delimiter=",", unpack=True), strict=True))
    after = pd.read_parquet(out)
    same = {
        "time": "time", "m_f": "injected_fuel_mass", "alpha_th": "throttle_position", "u_wg": "wastegate_position",
        "p_ic": "intercooler_pressure", "T_ic": "intercooler_temperature", "p_im": "intake_manifold_pressure",
        "p_amb": "ambient_pressure", "T_amb": "ambient_temperature", "W_maf": "air_mass_flow",
    }  # fmt: skip
    for ours, theirs in same.items():
        assert np.array_equal(after[ours], before[theirs]), ours
    # A factor, rounded at most twice.
    np.testing.assert_allclose(after["n_e"], before["engine_speed"] * 30 / np.pi, rtol=1e-15)
    assert set(after) == {*same, "n_e"}
    assert channel_units(out)["n_e"] == "rpm"
    assert all(item["rule"] == "as recorded" and not item["repairs"] for item in record["channels"].values())
    assert stored_record(out) == record

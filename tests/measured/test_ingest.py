"""The shipped profiles on the recordings that they are for."""

import numpy as np
import pandas as pd
import pytest

from lpvobs.api.ingest_log import ingest_log
from lpvobs.api.inspect import inspect_log
from lpvobs.ingest.record import stored_record
from lpvobs.io.logs.parquet import channel_units
from lpvobs.io.logs.policies import LogPolicies

LIU = ("wltp_NF", "wltp_f_waf_110", "wltp_f_pim_080", "wltp_f_pic_090", "wltp_f_iml_6mm")


@pytest.mark.parametrize("name", LIU)
@pytest.mark.slow
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


KIT = {
    "2017-07-05_Seat_Leon_S_KA_Normal": True,
    "2017-07-28_Seat_Leon_KA_KA_Normal": True,
    "2017-08-01_Seat_Leon_KA_KA_Frei": True,
    "2018-02-20_Seat_Leon_KA_KA_Frei": False,
    "2018-02-26_Seat_Leon_KA_KA_Frei": False,
    "2018-02-27_Seat_Leon_KA_KA_Normal": False,
}
"""The drives, and whether the degree signs of their headers are broken."""


def slowly(source):
    """Return stamps [s] and values of manifold pressure [kPa] in the rows that asked for it, read line by line."""
    stamps, values, latest = [], [], -1.0
    with source.open(encoding="utf-8") as stream:
        assert stream.readline().split(",")[2].startswith("Intake Manifold")
        for row, line in enumerate(stream):
            words = line.rstrip("\n").split(",")
            hours, minutes, seconds = map(float, words[0].split(":"))
            now = 3600 * hours + 60 * minutes + seconds
            if now > latest and row % 10 == 1 and words[2]:
                stamps.append(now)
                values.append(float(words[2]))
            latest = max(latest, now)
    return np.array(stamps), np.array(values)


@pytest.mark.parametrize("name", KIT)
@pytest.mark.slow
def test_kit_obd(measured, tmp_path, name):
    source, out = measured / "kit-obd" / f"{name}.csv", tmp_path / f"{name}.parquet"
    record = ingest_log([source], "kit-obd", out)
    log = pd.read_parquet(out)
    stamps, values = slowly(source)
    at = log["time"].to_numpy() + record["time"]["start"]
    after = np.clip(np.searchsorted(stamps, at + 1e-9), 1, stamps.size - 1)
    near = (stamps[after] - stamps[after - 1] <= 2.5) & (at >= stamps[0]) & (at <= stamps[-1])
    wanted = 1e3 * np.interp(at, stamps, values)
    # np.interp rounds in another order; pressures are around 1e5 Pa.
    np.testing.assert_allclose(log["p_im"][near], wanted[near], rtol=1e-9)
    apart = np.minimum(np.abs(at - stamps[after]), np.abs(at - stamps[after - 1])) > 1e-6  # a sample stands for itself
    assert np.isnan(log["p_im"][~near & apart]).all()
    broken = {key: "unit_spelling" in record["channels"][key]["repairs"] for key in ("T_im", "T_amb", "T_coolant")}
    assert set(broken.values()) == {KIT[name]}
    assert log["T_amb"].dropna().between(233.15, 333.15).all()
    assert all(0.5 < item["rate"] < 1.3 for item in record["channels"].values())


def test_kit_obd_gaps_and_clocks_stay_visible(measured, tmp_path):
    out = tmp_path / "winter.parquet"
    ingest_log([measured / "kit-obd" / "2018-02-26_Seat_Leon_KA_KA_Frei.csv"], "kit-obd", out)
    content = inspect_log(out, None, LogPolicies())
    assert content.gaps == 1
    assert "speed_density" in content.serves  # it needs neither fuel nor EGR
    record = ingest_log([measured / "kit-obd" / "2017-08-01_Seat_Leon_KA_KA_Frei.csv"], "kit-obd", out)
    assert record["sources"][0]["time_repairs"]["Time"] == {"backward": 3}
    assert record["channels"]["T_im"]["repairs"]["out_of_range"] > 100

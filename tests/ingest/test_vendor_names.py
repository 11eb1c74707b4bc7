"""Names that control units, diagnosis and loggers give the channels; what is wanted, limited or of another part is none of them."""

import csv
import tomllib
from pathlib import Path

import numpy as np
import pytest

from lpvobs.errors import UsageError
from lpvobs.ingest.drafting import _sure, _told, draft_profile, guess, known_channels, own_names
from lpvobs.ingest.recordings import Head, split_unit

USUAL = {
    "n_e": ("rpm", 1800.0), "p_im": ("kPa", 140.0), "p_amb": ("hPa", 990.0), "T_amb": ("degC", 20.0), "W_maf": ("kg/h", 120.0),
    "u_delta": ("mg/cycle", 15.0), "u_egr": ("%", 20.0), "u_vgt": ("%", 50.0), "p_em": ("hPa", 1800.0), "T_im": ("degC", 45.0),
    "T_em": ("degC", 400.0), "omega_t": ("rpm", 80000.0), "lambda_e": ("1", 2.0),
}  # fmt: skip
NAMES = {
    "n_e": [
        "Epm_nEng", r"Epm_nEng\XCP:1", "nmot_w", "S1_PID_0C_EngineRPM", "Engine RPM", "EngSpeed", "engine_speed",
        "Motordrehzahl", "STAT_MOTORDREHZAHL_WERT", "EEC1.EngSpeed",
        "SPN 190 Engine Speed", "N_ENG", "Régimen del motor", "Epm_nEng_100ms",
    ],
    "W_maf": [
        "AFS_dm", r"AFS_dm\ETKC:1", "mshfm_w", "S1_PID_10_MAFAirFlowRate", "Mass Air Flow Rate", "EngInletAirMassFlowRate",
        "Luftmassenstrom", "MAF_KGH", "VeMAFR_dm_EngAirFlowFlt", "Portata aria", "AFS_dm@ECU",
    ],
    "p_im": [
        "Air_pIntkVUs", "PCR_pActVal", "ps_w", "S1_PID_0B_IntakeManiAbsPress", "Intake Manifold Absolute Pressure",
        "EngIntakeManifold1Press", "Saugrohrdruck", "Ladedruck Ist", "MAP_MES", "pInMnf", "Pression collecteur d'admission",
    ],
    "p_amb": ["EnvP_p", r"EnvP_p\CCP:1", "pu_w", "S1_PID_33_AbsBaroPres", "Barometric pressure (from vehicle)", "Umgebungsdruck"],
    "T_amb": ["EnvT_t", "S1_PID_46_AmbientAirTemp", "Ambient air temp"],
    "u_delta": ["InjSys_q", "InjSys_qTot", "InjCtl_qSetUnBal", "Einspritzmenge"],
    "u_egr": ["EGRVlv_r", "EGRVlv_rAct[0]", "EngEGR1ValvePos", "AGR-Ventil Stellung", "EGRV_AV",
              "EngExhstGsRcirculation1ValvePos", "rEGR"],
    "u_vgt": ["TrbCh_rAct", "VTG Stellung"],
    "T_im": ["Air_tCACDs", "tans", "EngIntakeManifold1Temp", "Ladelufttemperatur"],
    "p_em": ["Exh_pTrbnUs", "Abgasdruck vor Turbine"],
    "T_em": ["Exh_tTrbnUs", "Abgastemperatur vor Turbine"],
    "omega_t": ["TrbChrg_n", "EngTurbo1Speed", "Turboladerdrehzahl"],
    "lambda_e": ["LSU_rLam_[0]", "O2 Sensor1 Wide Range Equivalence Ratio", "Lambda"],
}  # fmt: skip
LISTS = list(csv.DictReader(Path(__file__).with_name("channel_lists.csv").read_text(encoding="utf-8").splitlines()))
NONE = [
    "RailP_pFlt", "PCR_pDesVal", "Vehicle speed", "Fuel Rail Pressure", "EGR Commanded", "Turbo Boost & Vacuum Gauge",
    "AirCtl_mDesVal",
    "EngIntercoolerTemp", "Turbinendrehzahl", "Lambda Sonde 2", "Motor speed", "MAP_SP", "Ladedruck: Sollwert",
    "EGR cooler bypass valve",
    "Boost pressure (gauge)", "EGRVlvLP_rAct", "Air_tCACDsDiff", "O2 sensor B1S2 lambda", "EngAirIntakeTemp", "LAMB_SP",
    "Exh_pPFltDiff", "Exh_tOxiCatUs", "CEngDsT_t", "InjCrv_qMI1Des", "EGRVlv_rDes", "Barometer (on Android device)",
]  # fmt: skip


def sure_of(name):
    """Return the channels that a column of this name surely is, whatever its unit, at a usual reading of each."""
    head = split_unit(name)[0] if not name.endswith(")") else name
    found = [(c, guess(c, name, Head(head, unit), np.full(5, middle))) for c, (unit, middle) in USUAL.items()]
    return [channel for channel, item in found if item is not None and item.sure]


@pytest.mark.parametrize(("channel", "name"), [(channel, name) for channel, names in NAMES.items() for name in names])
def test_a_name_means_one_channel(channel, name):
    assert sure_of(name) == [channel]


@pytest.mark.parametrize("name", NONE)
def test_what_is_no_reading_of_a_channel_is_never_sure(name):
    assert sure_of(name) == []


def found_in(which):
    """Return a list's columns that an engine needs, those that a draft tells, and names that it has wrong without a warning."""
    rows = [row for row in LISTS if row["list"] == which]
    guesses = []
    for row in rows:
        head, values = Head(*split_unit(row["header"])), np.full(20, float(row["typical"]))
        guesses += [found for c in known_channels() if (found := guess(c, row["header"], head, values)) is not None]
    certain = _sure(guesses)
    told = {(found.column, found.channel) for found in guesses if _told(found, certain)}
    needed = [row for row in rows if row["channel"] in known_channels()]
    wrong = [name for row in rows if (name := row["header"]) in certain and certain[name].channel != row["channel"]]
    return needed, [row for row in needed if (row["header"], row["channel"]) in told], wrong


def test_lists_that_somebody_wrote_who_had_not_seen_the_patterns():
    """The last 20 lists were written when the vocabulary was frozen: it told 143 of their 155 channels, and had none wrong.

    It has learned from them since, and from the first 20, of which patterns without it had told 119 of 168 and had one wrong. Fuel
    flows, `W_f`, are no channel of a recording; `[C]` is no unit of a temperature, and a volume of fuel no mass.
    """
    lists = {which: found_in(which) for which in dict.fromkeys(row["list"] for row in LISTS)}
    assert len(lists) == 40
    assert {which: wrong for which, (_, _, wrong) in lists.items() if wrong} == {}
    needed, told = (sum(len(each[k]) for each in lists.values()) for k in (0, 1))
    assert told >= 0.97 * needed
    assert all(len(each[1]) >= 0.7 * len(each[0]) for each in lists.values())


def test_an_index_is_no_unit():
    assert split_unit("InjCrv_q[0]") == ("InjCrv_q[0]", "")
    assert split_unit("p [0] [kPa]") == ("p [0]", "kPa")


@pytest.mark.parametrize(
    "text", ["W_maf,flow7\nknock,xyz\n", "[RAMCELL]\nflow7;W_maf;100ms\n* a remark\n", "\ufeffflow7;W_maf\n"]
)
def test_own_names_come_first(tmp_path, text):
    path = tmp_path / "names.lab"
    path.write_text(text, encoding="utf-8")
    log = tmp_path / "drive.csv"
    log.write_text(
        "time [s],flow7 [kg/h],maf [kg/h]\n" + "".join(f"{k / 10},{100 + k},3\n" for k in range(30)), encoding="utf-8"
    )
    assert own_names(path) == {"flow7": "W_maf"}
    draft = draft_profile(log, path)
    assert tomllib.loads(draft)["channels"]["W_maf"]["source"] == "flow7 [kg/h]"
    assert "in your own table" in draft
    assert 'channels.W_maf]\nsource = "maf' in draft_profile(log)


@pytest.mark.parametrize(
    ("text", "said"), [("a;b\n", "names no channel"), ("f;W_maf\nf;p_im\n", "'f' stands for W_maf and for p_im")]
)
def test_a_table_of_names_that_says_nothing_or_two_things_is_refused(tmp_path, text, said):
    path = tmp_path / "names.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match=said):
        own_names(path)


def test_usual_units_are_those_of_the_channels():
    assert set(USUAL) <= set(known_channels())

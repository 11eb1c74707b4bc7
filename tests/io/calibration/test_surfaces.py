"""The map in files for calibration tools, read back by readers that are not ours."""

import configparser
import csv
import re
from dataclasses import replace
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest
import xarray as xr
from repository import DIESEL

from lpvobs.api.export import export
from lpvobs.errors import DataError, UsageError
from lpvobs.io.calibration.dcm import DcmMap, dcm_text, read_dcm_map
from lpvobs.io.results.surfaces import LEFT_OUT, NONE, OLD, keep_old, onto, read_surface
from lpvobs.maps.quadratic import ESTIMATED, EXTRAPOLATED

SPEED, FUEL = np.arange(500.0, 3001.0, 500.0), np.arange(0.0, 41.0, 10.0)
TRUTH = -0.004 + 1e-6 * np.add.outer(SPEED, 30.0 * FUEL)
COVARIANCE = 1e-8 * (0.1 * np.eye(TRUTH.size) + 0.9)
"""[kg^2/s^2]: neighbours err alike."""
INSIDE = np.add.outer(np.arange(SPEED.size), np.arange(FUEL.size)) % 5 != 0


@pytest.fixture
def result(tmp_path):
    """Return a file with the parts of a result that export reads."""
    path = tmp_path / "result.h5"
    with h5py.File(path, "w") as file:
        file.attrs["schema"] = "lpvobs/result/1"
        for name, support, filled in (
            ("map", np.where(INSIDE, 1, 0), np.where(INSIDE, TRUTH, np.nan)),
            ("extrapolation", np.where(INSIDE, 1, 2), TRUTH),
        ):
            group = file.create_group(name)
            for axis, nodes, unit in (("n_e", SPEED, "rpm"), ("u_delta", FUEL, "mg/cycle")):
                group[axis] = nodes
                group[axis].attrs.update({"units": unit, "long_name": axis})
            group["delta_W_c"], group["standard_error"], group["support"] = (
                filled,
                0.0 * filled + 1e-4,
                support.astype(np.int8),
            )
            group["delta_W_c"].attrs["units"] = "kg/s"
            group["covariance"] = COVARIANCE
        file["map"].attrs["axes"] = "u_delta n_e"
        file["nodes/covariance"] = COVARIANCE
        file["logs/drive/mean_flow"] = 0.02
        file["logs/drive"].attrs["samples"] = 100
    return path


def write_old(path, name="MAP", **changed):
    """Write an old map in other units, turned, with nodes of its own."""
    item = {
        "name": name, "kind": "KENNFELD", "x": np.array([0.0, 5.0, 20.0, 40.0, 50.0]), "y": np.array([500.0, 1000.0, 2750.0]),
        "values": 0.36 * np.arange(15.0).reshape(3, 5), "unit_x": "mg/Hub", "unit_y": "1/min", "unit": "kg/h",
        "long_name": "as it was",
    }  # fmt: skip
    path.write_text(dcm_text(DcmMap(**(item | changed)), 6, ["old"]), encoding="latin-1")
    return path


def independent(path):
    """Return the maps in a DCM file as the library dcmReader has them."""
    library = pytest.importorskip("dcmReader.dcm_reader", reason="dcmReader is not installed")
    reader = library.DcmReader()
    reader.read(str(path), file_encoding="latin-1")
    return reader


def values_of(found):
    """Return x, y and values, shape (ny, nx), of a map that dcmReader has read."""
    y = list(found.values)
    return np.array(list(found.values[y[0]])), np.array(y), np.array([list(found.values[node].values()) for node in y])


@pytest.mark.parametrize("kind", ["KENNFELD", "GRUPPENKENNFELD"])
@pytest.mark.parametrize("digits", [4, 7, 17])
@pytest.mark.slow
def test_an_independent_reader_finds_what_was_exported(result, tmp_path, kind, digits):
    out = tmp_path / "maf.dcm"
    export(result, out, "dcm", name="MAF_dW", kind=kind, digits=digits)
    reader = independent(out)
    (found,) = reader.get_characteristic_maps() if kind == "KENNFELD" else reader.get_group_characteristic_maps()
    x, y, values = values_of(found)
    assert (found.name, found.unit_x, found.unit_y, found.unit_values) == ("MAF_dW", "rpm", "mg/cycle", "kg/s")
    assert np.array_equal(x, SPEED)
    assert np.array_equal(y, FUEL)
    np.testing.assert_allclose(
        values, TRUTH.T, rtol=0.5 * 10.0 ** (1 - digits) + 1e-16
    )  # half a unit of the last digit
    if kind == "GRUPPENKENNFELD":
        shared = {item.name: item.values for item in reader.get_distributions()}
        assert shared == {found.x_mapping: SPEED.tolist(), found.y_mapping: FUEL.tolist()}


def test_our_reader_reads_what_theirs_does(result, tmp_path):
    out = tmp_path / "maf.dcm"
    export(result, out, "dcm", kind="GRUPPENKENNFELD")
    found = read_dcm_map(out, "delta_W_c")
    assert (found.kind, found.x_name, found.y_name) == ("GRUPPENKENNFELD", "delta_W_c_n_e", "delta_W_c_u_delta")
    (theirs,) = independent(out).get_group_characteristic_maps()
    for mine, other in zip((found.x, found.y, found.values), values_of(theirs), strict=True):
        assert np.array_equal(mine, other)


def test_old_values_axes_and_units_stay_and_changes_are_listed(result, tmp_path):
    old, out = write_old(tmp_path / "old.dcm"), tmp_path / "new.dcm"
    done = export(result, out, "dcm", only_estimated=True, old=old, name="MAP", digits=6)
    (found,) = independent(out).get_characteristic_maps()
    x, y, values = values_of(found)
    before = read_dcm_map(old, "MAP")
    assert np.array_equal(x, before.x)
    assert np.array_equal(y, before.y)
    assert (found.unit_x, found.unit_y, found.unit_values) == ("mg/Hub", "1/min", "kg/h")
    assert "as it was" in found.description
    truth = -0.004 + 1e-6 * np.add.outer(before.y, 30.0 * before.x)
    for i, speed in enumerate(before.y):
        for j, fuel in enumerate(before.x):
            corners = INSIDE[np.ix_(np.abs(SPEED - speed) < 500, np.abs(FUEL - fuel) < 10)]
            mine = corners.size > 0 and corners.all() and fuel <= FUEL[-1]
            wanted = 3600 * truth[i, j] if mine else before.values[i, j]
            assert values[i, j] == pytest.approx(wanted, rel=5e-6), (speed, fuel)
    changed = {(item.x, item.y) for item in done.changes}
    different = np.argwhere(~np.isclose(values, before.values, rtol=1e-9))
    assert changed == {(before.y[i], before.x[j]) for i, j in different}
    assert {item.origin for item in done.changes} == {"estimated"}
    assert np.count_nonzero(done.surface.origin == OLD) + np.count_nonzero(done.surface.origin == ESTIMATED) == 15


def test_an_export_against_itself_changes_nothing(result, tmp_path):
    first, second = tmp_path / "first.dcm", tmp_path / "second.dcm"
    export(result, first, "dcm")
    done = export(result, second, "dcm", old=first)
    assert done.changes == []
    assert first.read_text().splitlines()[4:] == second.read_text().splitlines()[5:]  # one comment more


@pytest.mark.parametrize("kind", ["KENNFELD", "FESTKENNFELD"])
def test_kind_function_and_display_name_of_the_old_file_stay(result, tmp_path, kind):
    """Fixed axes are listed in the file like others, and an export onto an old map leaves its axes alone."""
    old, out = write_old(tmp_path / "old.dcm", kind=kind), tmp_path / "new.dcm"
    text = old.read_text(encoding="latin-1")
    own = '   LANGNAME "as it was"\n'
    assert own in text
    old.write_text(text.replace(own, f"{own}   FUNKTION AirMass\n   DISPLAYNAME MAF_corr\n"), encoding="latin-1")
    export(result, out, "DCM", old=old, name="MAP")
    reader = independent(out)
    (found,) = reader.get_characteristic_maps() if kind == "KENNFELD" else reader.get_fixed_characteristic_maps()
    assert (found.name, found.function, found.display_name) == ("MAP", "AirMass", "MAF_corr")
    before, after = read_dcm_map(old, "MAP"), read_dcm_map(out, "MAP")
    assert (after.kind, after.kept) == (kind, before.kept)
    assert np.array_equal(after.x, before.x)


def test_csv_is_read_back(result, tmp_path):
    out = tmp_path / "maf.csv"
    export(result, out, "csv", values="map", digits=17)
    with out.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == ["n_e [rpm]", "u_delta [mg/cycle]", "delta_W_c [kg/s]", "standard_error [kg/s]", "origin"]
    for row, x, y, value, inside in zip(
        rows, np.repeat(SPEED, FUEL.size), np.tile(FUEL, SPEED.size), TRUTH.ravel(), INSIDE.ravel(), strict=True
    ):
        assert (float(row["n_e [rpm]"]), float(row["u_delta [mg/cycle]"])) == (x, y)
        assert row["origin"] == ("estimated" if inside else "none")
        assert row["delta_W_c [kg/s]"] == "" if not inside else float(row["delta_W_c [kg/s]"]) == value


@pytest.mark.parametrize("engine", ["h5netcdf", "netcdf4"])
def test_netcdf_opens_with_axes_units_and_names(result, tmp_path, engine):
    out = tmp_path / "maf.nc"
    export(result, out, "netcdf", only_estimated=True)
    with xr.open_dataset(out, engine=engine) as found:
        assert found.attrs["Conventions"] == "CF-1.8"
        assert found["delta_W_c"].dims == ("n_e", "u_delta")
        np.testing.assert_array_equal(found["delta_W_c"], np.where(INSIDE, TRUTH, np.nan))
        np.testing.assert_array_equal(found["n_e"], SPEED)
        assert found["delta_W_c"].attrs["units"] == "kg/s"
        assert all("long_name" in found[name].attrs for name in found.variables)
        assert found["origin"].attrs["flag_meanings"] == "none estimated extrapolated smoothed old left_out"
        assert float(found["delta_W_c"].sel(n_e=1000.0, u_delta=10.0)) == TRUTH[1, 1]


def test_netcdf_is_valid_for_the_netcdf_library(result, tmp_path):
    import netCDF4

    out = tmp_path / "maf.nc"
    export(result, out, "netcdf")
    with netCDF4.Dataset(out) as found:
        assert found.data_model == "NETCDF4"
        assert {name: item.size for name, item in found.dimensions.items()} == {"n_e": SPEED.size, "u_delta": FUEL.size}


def test_laid_onto_its_own_axes_a_surface_is_itself(result):
    surface = read_surface(result, "map")
    again = onto(surface, SPEED * (1 + 1e-9), FUEL)
    np.testing.assert_array_equal(again.values, surface.values)
    np.testing.assert_array_equal(again.origin, surface.origin)
    np.testing.assert_allclose(again.standard_error, surface.standard_error, rtol=1e-12)


def test_a_node_between_is_as_sure_as_the_least_it_leans_on(result):
    surface = read_surface(result, "extrapolation")
    between = onto(surface, np.array([400.0, 750.0, 1250.0]), np.array([5.0, 15.0, 20.0]))
    assert np.all(between.origin[0] == NONE)
    assert between.origin[1].tolist() == [EXTRAPOLATED, ESTIMATED, ESTIMATED]
    np.testing.assert_allclose(between.values[1:], -0.004 + 1e-6 * np.add.outer([750.0, 1250.0], [150.0, 450.0, 600.0]))
    kept = keep_old(between, np.full((3, 3), 0.5), True)
    assert np.array_equal(kept.origin == OLD, between.origin != ESTIMATED)
    assert np.all(kept.values[kept.origin == OLD] == 0.5)
    assert np.all(between.standard_error[1:] <= 1e-4)  # 0.9 correlated: little less than that of a node
    assert between.standard_error[1, 1] == pytest.approx(1e-4 * np.sqrt(0.9 + 0.1 / 4))


def test_points_and_means_have_the_covariance_of_all_nodes(result):
    surface = read_surface(result)
    found = surface.at([(500.0, 0.0), (750.0, 15.0)])
    np.testing.assert_allclose(found.values, [-0.0035, -0.004 + 1e-6 * (750.0 + 450.0)])
    np.testing.assert_allclose(found.covariance, 1e-8 * np.array([[1.0, 0.9], [0.9, 0.925]]))
    mean = surface.mean({"n_e": (1000.0, 2000.0), "u_delta": (5.0, 15.0)})
    np.testing.assert_allclose(mean.values, -0.004 + 1e-6 * (1500.0 + 300.0))
    # Along speed 1/4, 1/2, 1/4, along fuel 1/8, 3/4, 1/8.
    weights = np.outer([0.25, 0.5, 0.25], [0.125, 0.75, 0.125])
    assert mean.standard_error[0] == pytest.approx(1e-4 * np.sqrt(0.9 + 0.1 * np.sum(weights**2)))
    np.testing.assert_allclose(
        mean.ci90[0], mean.values[0] + 1.645 * mean.standard_error[0] * np.array([-1, 1]), atol=2e-8
    )
    whole = surface.mean({})
    assert whole.values[0] == pytest.approx(-0.004 + 1e-6 * (1750.0 + 600.0))


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda map_: map_.mean({"rpm": (1000.0, 2000.0)}), "no axis 'rpm'; expected n_e from 500 to 3000 rpm"),
        (
            lambda map_: map_.mean({"n_e": (1000.0, 4000.0)}),
            "1000 to 4000, expected two rising values between 500 and 3000",
        ),
        (lambda map_: map_.mean({"n_e": (2000.0, 1000.0)}), "expected two rising values"),
        (lambda map_: map_.mean({}), "6 of 30 nodes needed have no value"),
        (lambda map_: map_.at([(100.0, 10.0)]), "a point is outside the map; expected n_e from 500"),
        (lambda map_: map_.at([(1000.0, 10.0, 3.0)]), "points: expected a list of pairs, with n_e from 500"),
        (lambda map_: map_.at([]), "points: expected a list of pairs"),
    ],
)
@pytest.mark.slow
def test_what_a_map_does_not_know_is_refused(result, ask, words):
    with pytest.raises(DataError, match=re.escape(words)):
        ask(read_surface(result, "map"))


def test_a_difference_has_both_covariances_and_its_own_nodes(result):
    surface = read_surface(result, "map")
    other = onto(surface, SPEED[1:], FUEL)
    change = surface.difference(replace(other, values=other.values - 1e-3))
    assert np.all(change.origin[0] == NONE)
    known = change.origin != NONE
    np.testing.assert_array_equal(known[1:], INSIDE[1:])
    np.testing.assert_allclose(change.values[known], 1e-3)
    np.testing.assert_allclose(change.standard_error[known], np.sqrt(2.0) * 1e-4)
    with pytest.raises(DataError, match="of one kind of engine"):
        surface.difference(replace(surface, unit="kg/h"))


def test_nodes_with_wide_intervals_are_left_out_and_counted(result, tmp_path):
    with h5py.File(result, "r+") as file:
        wide = np.where(INSIDE, 1e-4, 2e-3)
        file["extrapolation/standard_error"][:] = wide
        file["extrapolation/covariance"][:] = np.diag(wide.ravel() ** 2)
    done = export(result, tmp_path / "maf.csv", "csv")  # 0.1 of 20 g/s are 2 g/s, and 1.645 times 2 g/s is more
    assert done.widest == pytest.approx(2e-3)
    np.testing.assert_array_equal(done.surface.origin == LEFT_OUT, ~INSIDE)
    assert (tmp_path / "maf.csv").read_text().count("left_out") == 6
    export(result, tmp_path / "maf.dcm", "dcm")
    text = (tmp_path / "maf.dcm").read_text(encoding="latin-1")
    assert "6 nodes have no correction: their 90 % interval is wider than +-2 g/s" in text
    assert read_dcm_map(tmp_path / "maf.dcm", "delta_W_c").values.T[~INSIDE].tolist() == [0.0] * 6
    assert np.all(export(result, tmp_path / "all.csv", "csv", widest=1.0).surface.origin != LEFT_OUT)
    old = write_old(tmp_path / "old.dcm", x=FUEL, y=SPEED, values=0.36 * np.ones((6, 5)))
    kept = export(result, tmp_path / "new.dcm", "dcm", old=old, name="MAP").surface
    assert np.all(kept.origin[~INSIDE] == OLD)
    np.testing.assert_allclose(kept.values[~INSIDE], 1e-4)


def test_a_dcm_has_a_value_everywhere(result, tmp_path):
    with pytest.raises(DataError, match=r"6 of 30 nodes have no value.*extrapolate"):
        export(result, tmp_path / "maf.dcm", "dcm", values="map")
    assert not (tmp_path / "maf.dcm").exists()


@pytest.mark.parametrize(
    ("request_of", "words"),
    [
        ({"file_format": "xlsx"}, "--format xlsx"),
        ({"file_format": "DCM", "values": "gain"}, "--values gain"),
        ({"file_format": "dcm", "kind": "FESTWERT"}, "--kind FESTWERT"),
        ({"file_format": "csv", "kind": "KENNFELD"}, "only the format dcm has kinds"),
        ({"file_format": "dcm", "name": "two words"}, "--name two words"),
        ({"file_format": "dcm", "digits": 1}, "--digits 1"),
        ({"file_format": "dcm", "only_estimated": True}, "--old OLD.dcm"),
    ],
)
def test_requests_that_contradict_themselves(result, tmp_path, request_of, words):
    with pytest.raises(UsageError, match=re.escape(words)):
        export(result, tmp_path / "out", **request_of)
    assert not (tmp_path / "out").exists()


DAMAGE = {
    "no format": (lambda text: text.replace("KONSERVIERUNG_FORMAT 2.0", ""), "not a DCM file"),
    "empty": (lambda text: "", "is empty"),
    "cut": (lambda text: text[: len(text) // 2], "is damaged"),
    "words": (lambda text: text.replace("WERT 0.36", "WERT zero"), "is damaged"),
    "fewer nodes": (lambda text: text.replace("MAP 5 3", "MAP 6 3"), "instead of 6 by 3"),
    "many nodes": (lambda text: text.replace("MAP 5 3", "MAP 99999 99999"), "99999 by 99999"),
    "not finite": (lambda text: text.replace("WERT 0.36", "WERT nan"), "is damaged"),
    "value first": (lambda text: re.sub(r"ST/Y .*", "", text), "is damaged"),
    "another map": (lambda text: text.replace("MAP 5 3", "MAPS 5 3"), "has no map 'MAP'; maps in the file: MAPS"),
    "other units": (lambda text: text.replace("kg/h", "hPa"), "units X 'mg/Hub', Y '1/min', W 'hPa'"),
}


@pytest.mark.parametrize("case", DAMAGE)
@pytest.mark.slow
def test_old_files_that_cannot_be_used_are_refused_in_one_line(result, tmp_path, case):
    change, words = DAMAGE[case]
    old = write_old(tmp_path / "old.dcm", values=0.36 + np.arange(15.0).reshape(3, 5))
    old.write_text(change(old.read_text(encoding="latin-1")), encoding="latin-1")
    with pytest.raises(DataError, match=re.escape(words)) as failure:
        export(result, tmp_path / "new.dcm", "dcm", old=old, name="MAP")
    assert "\n" not in str(failure.value)
    assert not (tmp_path / "new.dcm").exists()


# --- CDFX, label lists, other units, a control unit's description ------------------------------------------------------------
READING = 0.02 + 1e-6 * np.add.outer(SPEED, 100.0 * FUEL)
A2L = """ASAP2_VERSION 1 60
/begin PROJECT P "" /begin MODULE M ""
/begin COMPU_METHOD FLOW "" RAT_FUNC "%8.3" "kg/h" COEFFS 0 20 0 0 0 1 /end COMPU_METHOD
/begin COMPU_METHOD SPEED "" LINEAR "%8.1" "1/min" COEFFS_LINEAR 0.25 0 /end COMPU_METHOD
/begin COMPU_METHOD FUEL "" IDENTICAL "%8.3" "mg/hub" /end COMPU_METHOD
/begin RECORD_LAYOUT MAP16 FNC_VALUES 1 SWORD COLUMN_DIR DIRECT /end RECORD_LAYOUT
/begin CHARACTERISTIC KF_MAF "error" MAP 0x2000 MAP16 0 FLOW -8 8
/begin AXIS_DESCR FIX_AXIS n SPEED 3 0 5000 /begin FIX_AXIS_PAR_LIST 600 1250 2900 /end FIX_AXIS_PAR_LIST /end AXIS_DESCR
/begin AXIS_DESCR COM_AXIS q FUEL 5 0 80 AXIS_PTS_REF AX_Q /end AXIS_DESCR
/end CHARACTERISTIC
/end MODULE /end PROJECT
"""


@pytest.fixture
def driven(result):
    """Return a result that knows the mean reading around each node, one of them not driven."""
    with h5py.File(result, "a") as file:
        file.attrs["air_path"] = "diesel"
        file["readings/reading"] = np.where(np.arange(TRUTH.size).reshape(TRUTH.shape) == 7, np.nan, READING)
        file.create_group("provenance").attrs.update({"config": DIESEL.read_text(encoding="utf-8")})
    return result


def test_cdfx_is_read_by_an_xml_reader(result, tmp_path):
    export(result, tmp_path / "maf.cdfx", "cdfx", name="MAF_dW", unit="kg/h", digits=12)
    root = ElementTree.parse(tmp_path / "maf.cdfx").getroot()
    assert root.findtext("CATEGORY") == "CDF20"
    (own,) = root.iterfind("SW-SYSTEMS/SW-SYSTEM/SW-INSTANCE-SPEC/SW-INSTANCE-TREE/SW-INSTANCE")
    assert [own.findtext(tag) for tag in ("SHORT-NAME", "CATEGORY")] == ["MAF_dW", "MAP"]
    assert own.findtext("SW-VALUE-CONT/UNIT-DISPLAY-NAME") == "kg/h"
    groups = own.findall("SW-VALUE-CONT/SW-VALUES-PHYS/VG")
    values = np.array([[float(v.text) for v in group.findall("V")] for group in groups])
    np.testing.assert_allclose(values.T, 3600.0 * TRUTH, rtol=1e-11)
    axes = own.findall("SW-AXIS-CONTS/SW-AXIS-CONT")
    nodes = [[float(v.text) for v in axis.iterfind("SW-VALUES-PHYS/V")] for axis in axes]
    assert nodes == [SPEED.tolist(), FUEL.tolist()]
    assert [axis.findtext("UNIT-DISPLAY-NAME") for axis in axes] == ["rpm", "mg/cycle"]
    assert [float(group.findtext("LABEL")) for group in groups] == FUEL.tolist()


def test_a_label_list_has_the_map_and_what_a_log_needs(driven, tmp_path):
    export(driven, tmp_path / "maf.lab", "lab", name="MAF_dW")
    found = configparser.ConfigParser(allow_no_value=True, delimiters=("=",))
    found.optionxform = str
    found.read(tmp_path / "maf.lab", encoding="latin-1")
    assert list(found["LABEL"]) == ["MAF_dW"]
    assert {"n_e", "u_delta", "W_maf", "p_im"} <= set(found["RAMCELL"])


@pytest.mark.parametrize(
    ("unit", "expected", "nothing"),
    [
        ("kg/h", 3600.0 * TRUTH, None),
        ("%", 100.0 * TRUTH / READING, 0.0),
        ("factor", 1.0 - TRUTH / READING, 1.0),
        ("mg/stroke", 1e6 * TRUTH / (4.0 * SPEED[:, None] / 120.0), None),
    ],
)
@pytest.mark.slow
def test_other_units_are_those_of_the_independent_reader(driven, tmp_path, unit, expected, nothing):
    """A share needs the flow: a node without one corrects nothing."""
    done = export(driven, tmp_path / "maf.dcm", "dcm", unit=unit, digits=12, widest=1.0)
    (found,) = independent(tmp_path / "maf.dcm").get_characteristic_maps()
    assert found.unit_values == ("1" if unit == "factor" else unit)
    _, _, values = values_of(found)
    left = done.surface.origin == LEFT_OUT
    assert left.sum() == (0 if nothing is None else 1)
    np.testing.assert_allclose(values.T[~left], expected[~left], rtol=1e-10)
    if nothing is not None:
        assert values.T[left] == nothing
        assert done.surface.standard_error[0, 1] == pytest.approx(
            1e-4 * (100.0 if unit == "%" else 1.0) / READING[0, 1]
        )


def test_a_unit_that_is_no_flow_is_refused(driven, tmp_path):
    with pytest.raises(UsageError, match="--unit furlong: is not a unit of flow"):
        export(driven, tmp_path / "maf.dcm", "dcm", unit="furlong")


def test_axes_limits_and_rounding_are_those_of_the_description(result, tmp_path):
    pytest.importorskip("pya2l", reason="a library of the extra lpvobs[a2l]")
    (tmp_path / "unit.a2l").write_text(A2L, encoding="utf-8")
    done = export(result, tmp_path / "maf.dcm", "dcm", name="KF_MAF", a2l=tmp_path / "unit.a2l", digits=12)
    found = read_dcm_map(tmp_path / "maf.dcm", "KF_MAF")
    assert (found.unit_x, found.unit_y, found.unit) == ("1/min", "mg/hub", "kg/h")
    assert found.x.tolist() == [600.0, 1250.0, 2900.0]
    assert found.y.tolist() == FUEL.tolist()
    wanted = 3600.0 * (-0.004 + 1e-6 * np.add.outer(30.0 * FUEL, found.x))  # TRUTH is a plane
    np.testing.assert_allclose(found.values, np.clip(wanted, -8.0, 8.0), atol=0.025 + 1e-9)
    np.testing.assert_allclose(found.values * 20.0, np.round(found.values * 20.0), atol=1e-9)
    assert done.limited == np.count_nonzero(np.abs(wanted) > 8.0) > 0
    with pytest.raises(DataError, match=r"no map 'OTHER'; the file has the maps: KF_MAF"):
        export(result, tmp_path / "other.dcm", "dcm", name="OTHER", a2l=tmp_path / "unit.a2l")
    (tmp_path / "unit.a2l").write_text(A2L.replace("COM_AXIS q FUEL 5", "COM_AXIS q FUEL 4"), encoding="utf-8")
    with pytest.raises(DataError, match=r"has room for 4 points, but the axis of our map has 5 points; give .* --old"):
        export(result, tmp_path / "other.dcm", "dcm", name="KF_MAF", a2l=tmp_path / "unit.a2l")
    (tmp_path / "unit.a2l").write_text("KONSERVIERUNG_FORMAT 2.0", encoding="utf-8")
    with pytest.raises(DataError, match="is not an A2L file"):
        export(result, tmp_path / "other.dcm", "dcm", name="KF_MAF", a2l=tmp_path / "unit.a2l")

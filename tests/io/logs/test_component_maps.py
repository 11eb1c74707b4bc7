"""Tables of components from suppliers and control units: both forms, units, what they teach, and what is refused."""

import re
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from reference import diesel_scalars as scalars

from lpvobs.calibration.bench import rows_of
from lpvobs.calibration.fit import calibrated
from lpvobs.engines.diesel import relations as relation
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.engines.unknowns import unknowns_of
from lpvobs.errors import DataError, UsageError
from lpvobs.io.calibration.dcm import DcmMap, dcm_text
from lpvobs.io.logs.bench import named_file, read_component_map

T, P = 298.15, 98_100.0
HEAD = "# T_reference = 25 degC\n# p_reference = 981 hPa\n"
NAMES = "corrected_speed,corrected_flow,pressure_ratio\nrpm,kg/h,1\n"


def lines_of(engine, reduced=False):
    """Return a compressor's map by the engine's own formulas, in a supplier's units."""
    c = Diesel(engine).constants
    found = []
    for speed in (8e4, 12e4, 16e4):
        omega = speed * np.pi / 30.0
        for ratio in (1.2, 1.3, 1.4, 1.5):
            flow = scalars.rho_1(c, ratio * P, omega, P, T) * omega
            if reduced:
                found.append(f"{speed / np.sqrt(T):.17g},{flow * np.sqrt(T) / (P / 1e3):.17g},{ratio}")
            else:
                found.append(f"{speed:.17g},{3600.0 * flow:.17g},{ratio}")
    return "\n".join(found)


def read(tmp_path, text, air_path, kind="compressor"):
    path = tmp_path / f"{kind}.csv"
    path.write_text(text, encoding="utf-8")
    return read_component_map(kind, path, "", air_path)


def flow_of(air_path, table):
    return rows_of(air_path, unknowns_of({}, air_path.components), [table])


def test_corrected_and_reduced_maps_are_the_same_compressor(engine, air_path, tmp_path):
    corrected = read(tmp_path, HEAD + NAMES + lines_of(engine), air_path)
    text = "reduced_speed,reduced_flow,pressure_ratio\nrpm/sqrt(K),kg*sqrt(K)/(s*kPa),1\n" + lines_of(engine, True)
    for table in (corrected, read(tmp_path, text, air_path)):
        rows = flow_of(air_path, table)
        assert rows.z.size == 12
        np.testing.assert_allclose(rows.z, 0.0, atol=1e-7)  # kg/s of 0.05: digits of pi and of the units


def test_a_compressor_map_tells_of_the_compressor(engine, air_path, tmp_path):
    """Against 1 % less flow everywhere: the level follows as far as the map's tolerance allows."""
    wider = air_path.deviating({"R_c": 0.01})
    text = HEAD + "# tolerance = 0.1 %\n" + NAMES + lines_of(wider.engine)
    tolerance = dict.fromkeys(("R_c", "V_d"), 0.03)
    prior = unknowns_of(tolerance, air_path.components)
    found = calibrated(air_path, prior, [read(tmp_path, text, air_path)])
    assert found.unknowns.deviation()["R_c"] == pytest.approx(0.01, abs=0.002)
    assert found.unknowns.deviation()["V_d"] == 0.0
    assert set(found.amplitudes.values()) == {1.0}  # a smooth table does not say that the engine is
    told = np.sqrt(np.diag(found.unknowns.covariance)[:2]) / np.sqrt(np.diag(prior.covariance)[:2])
    assert told[0] < 0.5
    assert told[1] == pytest.approx(1.0)


def test_what_all_points_may_be_off_by_together_does_not_average_out(air_path, tmp_path):
    n_e, p_im = (grid.ravel() for grid in np.meshgrid(np.arange(1000, 4001, 250.0), np.arange(1e5, 2.2e5, 1e4)))
    c = air_path.constants
    eta = c.c_vol1 * np.sqrt(p_im) + c.c_vol2 * np.sqrt(n_e) + c.c_vol3
    rows = "\n".join(f"{n:g},{p / 1e2:g},{100 * e:.17g}" for n, p, e in zip(n_e, p_im, eta, strict=True))
    table = read(tmp_path, "# tolerance = 2 %\nn_e,p_im,eta_vol\n1/min,mbar,%\n" + rows, air_path, "eta_vol")
    prior = unknowns_of({"V_d": 0.2}, air_path.components)
    alone = np.diag(np.where(np.arange(prior.size) == 0, prior.covariance[0, 0], 0.0))  # no correction
    rows = flow_of(air_path, table)
    np.testing.assert_allclose(rows.z, 0.0, atol=1e-9)
    found = calibrated(air_path, replace(prior, covariance=alone), [table])
    assert np.sqrt(found.unknowns.covariance[0, 0]) == pytest.approx(0.02, rel=0.05)


def test_a_parquet_table_is_the_csv_with_its_units(engine, air_path, tmp_path):
    lines = [[float(cell) for cell in line.split(",")] for line in lines_of(engine).splitlines()]
    columns = dict(zip(("corrected_speed", "corrected_flow", "pressure_ratio"), np.array(lines).T, strict=True))
    columns |= {"T_reference": np.full(12, 25.0), "p_reference": np.full(12, 981.0)}
    units = ("rpm", "kg/h", "1", "degC", "hPa")
    fields = [pa.field(name, pa.float64(), metadata={"unit": unit}) for name, unit in zip(columns, units, strict=True)]
    path = tmp_path / "map.parquet"
    pq.write_table(pa.table(list(columns.values()), schema=pa.schema(fields)), path)
    found = read_component_map("compressor", path, "", air_path)
    wanted = read(tmp_path, HEAD + NAMES + lines_of(engine), air_path)
    assert found.tolerance == wanted.tolerance
    for name, column in wanted.columns.items():
        np.testing.assert_array_equal(found.columns[name], column)
    pq.write_table(pa.table({"corrected_speed": [1.0]}), path)
    with pytest.raises(DataError, match="corrected_flow"):
        read_component_map("compressor", path, "", air_path)


@pytest.mark.parametrize("turned", [False, True])
def test_a_control_units_table_may_lie_either_way(air_path, tmp_path, turned):
    n_e, p_im = np.array([1000.0, 2000.0, 3000.0]), np.array([1000.0, 1500.0])
    c = air_path.constants
    eta = c.c_vol1 * np.sqrt(100.0 * p_im[:, None]) + c.c_vol2 * np.sqrt(n_e) + c.c_vol3
    item = DcmMap("AIR", "KENNFELD", n_e, p_im, eta, "1/min", "hPa", "-")
    if turned:
        item = DcmMap("AIR", "KENNFELD", p_im, n_e, eta.T, "hPa", "1/min", "-")
    path = tmp_path / "ecu.dcm"
    path.write_text(dcm_text(item, 9, []), encoding="latin-1")
    kind, file, label = named_file(f"eta_vol={path}:AIR", air_path)
    rows = flow_of(air_path, read_component_map(kind, file, label, air_path))
    assert rows.z.size == 6
    np.testing.assert_allclose(rows.z, 0.0, atol=1e-8)  # nine digits
    with pytest.raises(DataError, match="expected u_egr"):
        read_component_map("egr", file, label, air_path)


def test_a_turbine_map_tells_of_constants_that_no_balance_of_the_estimate_has(engine, air_path, tmp_path):
    c = air_path.constants
    rows = [
        f"{u},{ratio},{1.02e3 * relation.turbine_scale(c, u, 1.0) * np.sqrt(1.0 - ratio**-c.K_t):.17g}"
        for u in (30.0, 50.0, 70.0)
        for ratio in (1.3, 1.8, 2.5)
    ]
    head = "# tolerance = 0.2 %\nu_vgt,pressure_ratio,reduced_flow\n%,1,kg*K^0.5/(s*kPa)\n"
    table = read(tmp_path, head + "\n".join(rows), air_path, "turbine")
    found = calibrated(air_path, unknowns_of({"A_vgt_max": 0.1, "V_d": 0.01}, air_path.components), [table])
    assert found.unknowns.deviation()["A_vgt_max"] == pytest.approx(0.02, abs=1e-3)


def test_an_open_valve_has_the_area_of_the_table(air_path, tmp_path):
    c = air_path.constants
    openings = np.arange(0.0, 60.0, 10.0)
    areas = 1e6 * c.A_egr_max * (c.c_egr1 * openings + c.c_egr2) * openings
    text = "u_egr,area\n%,mm^2\n" + "\n".join(f"{u:g},{area:.17g}" for u, area in zip(openings, areas, strict=True))
    rows = flow_of(air_path, read(tmp_path, text, air_path, "egr"))
    assert rows.z.size == 5  # a shut valve says nothing
    np.testing.assert_allclose(rows.z, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            ("# T_reference = 25 degC\n", ""),
            "'T_reference' (temperature that corrected quantities refer to) is missing",
        ),
        (("kg/h", "kg"), "unit 'kg' cannot be converted to 'kg/s'"),
        (("kg/h", "kg/s"), "kg/s is not a plausible flow of a compressor"),
        (("rpm,", "rad/s,"), "rad/s is not a plausible speed of a compressor"),
        (("corrected_flow", "flow"), "has no column corrected_flow or reduced_flow"),
        (("25 degC", "20 K"), "20 K is not a plausible temperature"),
        (("981 hPa", "981 Pa"), "981 Pa is not a plausible pressure"),
        (("# T", "# tolerance = 200 %\n# T"), "2 is not a plausible tolerance of a table"),
        (("rpm,kg/h", "rpm,g/s"), "times the flow of the configured engine"),
    ],
)
def test_what_cannot_be_is_refused(engine, air_path, tmp_path, change, said):
    text = (HEAD + NAMES + lines_of(engine)).replace(*change)
    with pytest.raises(DataError, match=re.escape(said)):
        read(tmp_path, text, air_path)


def test_few_points_and_unknown_kinds_are_refused(air_path, tmp_path):
    with pytest.raises(DataError, match="1 points, expected 4 to 2000"):
        read(tmp_path, "u_egr,area\n%,mm^2\n10,20\n", air_path, "egr")
    for text in ("compressor.csv", "wing=a.csv"):
        with pytest.raises(
            UsageError, match="expected KIND=FILE; possible values of KIND: compressor, turbine, eta_vol, egr"
        ):
            named_file(text, air_path)

"""`--engine` and `[engine] file`: estimate, trace, refine and simulate on an engine that `calibrate` has found."""

import json
import shutil

import h5py
import numpy as np
import pytest
from repository import DIESEL

from lpvobs.api.known_engine import known_engine
from lpvobs.api.search_start import known_from, nothing_known, search_start
from lpvobs.api.simulate import plant_of
from lpvobs.engines.unknowns import NEGLIGIBLE
from lpvobs.io.configuration.config import load_config
from lpvobs.io.results.engines import read_engine
from lpvobs.io.results.results import read_result


@pytest.fixture(scope="module")
def configured(other_engine, tmp_path_factory):
    """Return a configuration that names the calibrated engine beside it."""
    folder = tmp_path_factory.mktemp("configured")
    shutil.copy(other_engine.known, folder / "known.h5")
    text = DIESEL.read_text(encoding="utf-8").replace("[engine.gas]", '[engine]\nfile = "known.h5"\n\n[engine.gas]')
    (folder / "my.toml").write_text(text, encoding="utf-8")
    return folder / "my.toml"


@pytest.fixture(scope="module")
def result(lpvobs, other_engine, chain, configured):
    """Return a map of the calibrated engine."""
    out = configured.with_name("map.h5")
    call = ("estimate", "--config", configured, "--gain", chain.gain, other_engine.drive, "--out", out, "--json")
    done = lpvobs(*call)
    assert done.code == 0, done.err
    assert done.json["engine"] == {"source": str(configured.with_name("known.h5")), "calibrated": True}
    assert done.json["balance_agreement"]["ratio"] < 1.5  # 1.2 as configured, 0.7 as calibrated on a whole bench
    return out


@pytest.mark.proof
def test_a_file_beside_the_configuration_is_the_option(lpvobs, other_engine, chain, result, tmp_path):
    said = ("--engine", other_engine.known, "--gain", chain.gain, other_engine.drive, "--out", tmp_path / "said.h5")
    assert lpvobs("estimate", "--config", DIESEL, *said).code == 0
    with h5py.File(result) as one, h5py.File(tmp_path / "said.h5") as other:
        np.testing.assert_array_equal(one["map/delta_W_c"], other["map/delta_W_c"])
    missing = lpvobs("estimate", "--config", DIESEL, *said[2:], "--engine", tmp_path / "none.h5")
    assert (missing.code, "none.h5" in missing.err) == (3, True)


@pytest.mark.slow
def test_the_plant_has_the_constants_of_the_calibration(other_engine, configured):
    deviation = read_engine(other_engine.known, load_config(DIESEL)[0].engine_path()).deviation
    for config, engine in ((DIESEL, other_engine.known), (configured, None)):
        compressor = plant_of(config, engine)[0].engine.compressor
        assert pytest.approx(0.0245 * (1.0 + deviation["R_c"]), rel=1e-12) == compressor.R_c
    assert plant_of(DIESEL)[0].engine.compressor.R_c == 0.0245


@pytest.fixture(scope="module")
def stored(result):
    return read_result(result)


@pytest.mark.slow
def test_a_map_that_stands_is_judged_with_the_engine_that_it_was_estimated_with(stored):
    engine = known_engine(stored)
    model = engine.residual_model()
    start = search_start(model, known_from(stored, model, 0.05), None, [])
    found, before = stored.engine, engine.calibrated
    constants = dict(zip(found.constants, found.deviation, strict=True))
    assert start.model.constants.constants.R_c == pytest.approx(0.0245 * (1.0 + constants["R_c"]), rel=1e-12)
    with h5py.File(stored.path) as file:
        own = [file[f"engine_found/{item.name}/correction"][()].ravel() for item in before.components]
    moved = np.concatenate(own) - start.model.constants.values
    assert np.abs(moved).max() < NEGLIGIBLE  # modes that are left out
    wider = np.diag(start.model.covariance) >= 1.2 * np.diag(model.covariance)  # a third of it is kept on top
    # Drives tell of a volume, benches do not: the loop has it from the drive that made the map.
    assert {name for name, more in zip(model.names, wider, strict=True) if more} <= {*engine.air_path.volumes}
    assert start.total({})["R_c"] == pytest.approx(constants["R_c"])


@pytest.mark.slow
def test_a_map_that_is_made_anew_starts_with_the_calibration(stored):
    engine = known_engine(stored)
    model = engine.residual_model()
    start = search_start(model, nothing_known(model, stored.grid, 0.05, engine.calibrated), None, [])
    deviation = engine.calibrated.deviation()
    assert start.model.constants.constants.V_d == pytest.approx(1.91e-3 * (1.0 + deviation["V_d"]), rel=1e-12)
    np.testing.assert_array_equal(start.model.constants.values, engine.calibrated.mean[len(deviation) :])
    assert start.total(dict.fromkeys(model.names, 0.0))["V_d"] == pytest.approx(deviation["V_d"])


@pytest.mark.proof
def test_refine_takes_an_engine(lpvobs, other_engine, chain, tmp_path):
    plain = tmp_path / "plain.h5"
    call = ("estimate", "--config", DIESEL, "--gain", chain.gain, other_engine.healthy, "--out", plain)
    assert lpvobs(*call).code == 0
    engine = ("--engine", other_engine.known)
    free = lpvobs("refine", plain, other_engine.healthy, *engine, "--out", tmp_path / "refined.h5", "--json")
    assert free.code == 0, free.err
    assert not free.json["map_frozen"]


@pytest.mark.proof
def test_trace_takes_an_engine(lpvobs, other_engine, chain, result, tmp_path):
    engine = ("--engine", other_engine.known)
    refused = lpvobs("trace", chain.result, other_engine.drive, *engine)
    assert (refused.code, "was not estimated with" in refused.err) == (2, True)
    copy = shutil.copy(result, tmp_path / "map.h5")
    stands = lpvobs("trace", copy, other_engine.healthy, *engine, "--json")
    assert stands.code == 0, stands.err
    assert stands.json["map_frozen"]
    with h5py.File(copy) as file:
        assert json.loads(file["trace"].attrs["json"])["verdict"] == stands.json["verdict"]

"""An engine that the package has never seen: a record and a line in the registry are all that the verbs need."""

import json
import tomllib

import h5py
import jsonschema
import numpy as np
import pytest
from engines import blower
from repository import DIESEL, ROOT

import lpvobs
from lpvobs.api.inspect import inspect
from lpvobs.api.simulate import simulate
from lpvobs.api.synth_gain import make_gain, make_published_gain
from lpvobs.api.verify import check_again
from lpvobs.engines.registry import ENGINES
from lpvobs.errors import UsageError
from lpvobs.ingest.drafting import draft_profile
from lpvobs.io.configuration.config import load_config
from lpvobs.io.logs.parquet import write_log
from lpvobs.io.results.results import read_result
from lpvobs.report.tables import coefficient_tables

UNITS = {"time": "s", "ref_W_c": "kg/s", "ref_delta_W_c": "kg/s"} | {
    name: item.unit for name, item in blower.Blower.channels.items()
}


@pytest.fixture(autouse=True)
def example(tmp_path, monkeypatch):
    path = tmp_path / "blower.toml"
    path.write_text(blower.TEXT, encoding="utf-8")
    monkeypatch.setitem(ENGINES, "blower", blower.kind(str(path)))
    return path


def drive(path, seconds, noise=0.0, seed=0, factor=1.0, onset=0.0):
    """Write a drive over the whole map; the sensor's error lies in the plane 1e-5 v_b + 1e-9 n_b [kg/s].

    The speed is a sine about its mean; with constant temperature the pressure answers as a first-order lag does. `noise` is that
    of the sensor [kg/s]; from the onset [s] on it reads so much more.
    """
    t, w, T = np.arange(100 * seconds) / 100.0, 0.083, 300.0
    rho, a = 1e-4 / np.sqrt(287.0 * T), 287.0 * T / 0.01
    v_b, n_b = 5.0 + 5.0 * np.sin(0.61 * t), 2000.0 + 1000.0 * np.sin(w * t)
    pole = a * rho
    answer = pole * (pole * np.sin(w * t) - w * np.cos(w * t)) / (pole**2 + w**2)
    flow, error = 2e-5 * (2000.0 + 1000.0 * answer), 1e-5 * v_b + 1e-9 * n_b
    random = np.random.default_rng(seed)
    channels = {
        "time": t,
        "v_b": v_b,
        "n_b": n_b,
        "p_box": flow / rho + 2e5 * noise * random.standard_normal(t.size),
        "T_box": np.full_like(t, T),
        "W_maf": np.where(t < onset, 1.0, factor) * (flow + error) + noise * random.standard_normal(t.size),
    }
    write_log(path, channels | {"ref_W_c": flow, "ref_delta_W_c": error}, UNITS)
    return path


@pytest.fixture
def log(tmp_path):
    return drive(tmp_path / "log.parquet", 120)


def test_its_configuration_is_read_and_refused(example):
    config, _ = load_config(example)
    assert config.engine == blower.Box(0.01, 1e-4, 2e-5)
    assert config.grid().shape == (5, 6)
    for old, new, said in (
        ("[engine]", "[simulation]\n[engine]", "simulation"),  # no plant simulates it
        ("[engine]", "[trace]\n[engine]", "trace"),  # nor has it this table of the throttled engine's
        ("x_0 = [1e5]", "x_0 = [1e5, 1e5]", "x_0"),
        ("A_n = 0.01", "R_c = 0.01", "R_c"),
    ):
        path = example.with_name("changed.toml")
        path.write_text(blower.TEXT.replace(old, new), encoding="utf-8")
        with pytest.raises(UsageError, match=said):
            load_config(path)


def test_inspect_finds_the_engine_that_a_log_suits(log):
    found = inspect(log)
    assert [name for name, channel in found.channels.items() if channel.use == "needed"] == [
        "time",
        *blower.Blower.channels,
    ]


def test_a_draft_guesses_its_channels(tmp_path):
    source = tmp_path / "foreign.csv"
    source.write_text(
        "time [s],Box pressure [bar]\n" + "".join(f"{k / 10},1.{k % 10}\n" for k in range(50)), encoding="utf-8"
    )
    assert '[channels.p_box]\nsource = "Box pressure [bar]"' in draft_profile(source)


def test_the_schema_has_it(monkeypatch, example):
    monkeypatch.syspath_prepend(ROOT / "tools" / "schemas")
    import configuration

    schema = json.loads(json.dumps(configuration.config_schema()))
    validator = jsonschema.Draft202012Validator(schema)
    validator.validate(tomllib.loads(blower.TEXT))
    assert not validator.is_valid(tomllib.loads(blower.TEXT.replace("V_box", "V_d")))
    assert schema["$defs"]["Box"]["properties"]["V_box"]["description"] == "m^3, volume of the box"


def test_its_gain_is_proven(example, log):
    config, _ = load_config(example)
    stored, _ = make_gain(config, [log])
    assert stored.gain.L.shape == (1, 2)
    assert check_again(stored).proven


def test_what_it_has_not_is_said(example, tmp_path):
    config, _ = load_config(example)
    with pytest.raises(UsageError, match=f"the paper prints no gain.*{DIESEL.name}"):
        make_published_gain(config, "ETC")
    with pytest.raises(UsageError, match=f"no simulator for air_path = 'blower'; .* configs/{DIESEL.name}"):
        simulate(example, "nedc", tmp_path / "log.parquet")


# Of the error's rms. Nothing is noisy: `batch` leaves rounding, `ekf` its prior beside two minutes of data, `observer` the first
# second, in which its state still falls to the measured one, and what smoothing takes from a curved signal.
@pytest.mark.parametrize(("method", "tolerance"), [("observer", 1e-2), ("batch", 1e-9), ("ekf", 1e-4)])
def test_its_map_is_estimated_extrapolated_and_told_on_its_own_axes(example, log, tmp_path, method, tolerance):
    gain, result = tmp_path / "gain.h5", tmp_path / "result.h5"
    lpvobs.synth_gain(example, [log], out=gain)
    lpvobs.estimate(example, [log], gain=gain, out=result, method=method)
    lpvobs.extrapolate(result)
    stored = read_result(result)
    assert stored.logs[0].metrics.rms_ratio < tolerance
    assert stored.logs[0].metrics.visited_cells == 20
    (told,) = coefficient_tables([("result", stored)])
    assert told[0][0] == "kg/s over v_b [V], n_b [rpm]"
    with h5py.File(result) as file:
        assert [file["map"][name].attrs["units"] for name in ("v_b", "n_b")] == ["V", "rpm"]
        assert file["map/delta_W_c"].shape == file["extrapolation/delta_W_c"].shape == (5, 6)


def test_the_observer_as_published_runs_on_it(example, log, tmp_path):
    gain, result = tmp_path / "gain.h5", tmp_path / "result.h5"
    lpvobs.synth_gain(example, [log], out=gain)
    lpvobs.estimate(example, [log], gain=gain, out=result, method="published")
    # Two minutes are too short for its constant Gamma to settle; what it gives is finite.
    assert np.isfinite(read_result(result).theta[read_result(result).supported]).all()


@pytest.mark.slow
def test_the_loop_finds_what_it_lacks(example, tmp_path):
    healthy = drive(tmp_path / "healthy.parquet", 240, 5e-4, 1)
    today = drive(tmp_path / "today.parquet", 240, 5e-4, 2, 1.05, 120.0)
    gain, result, refined = (tmp_path / name for name in ("gain.h5", "result.h5", "refined.h5"))
    lpvobs.synth_gain(example, [healthy], out=gain)
    lpvobs.estimate(example, [healthy], gain=gain, out=result)
    assert lpvobs.trace(result, [drive(tmp_path / "other.parquet", 240, 5e-4, 3)]).found.verdict == "none"
    (found,) = lpvobs.refine(result, [today], out=refined).found.findings
    assert found.id == "maf.gain"
    # Noise of 5e-4 on a flow of 0.04 kg/s, 12 000 times: 1e-4; the map's own error adds as much.
    assert found.parameters["factor"].value == pytest.approx(1.05, abs=1e-3)
    assert found.onset == pytest.approx(120.0, abs=1.0)
    assert lpvobs.trace(refined, [today]).found.verdict == "none"

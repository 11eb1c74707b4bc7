"""An engine that logs what series vehicles do: its balances by hand, what they are silent about, and a map through the verbs."""

import numpy as np
import pytest
from repository import CONFIGS

import lpvobs
from lpvobs.calibration.bench import bench_table, rows_of
from lpvobs.engines.effects import Signals
from lpvobs.engines.registry import ENGINES
from lpvobs.engines.series import effects, flows
from lpvobs.engines.unknowns import unknowns_of
from lpvobs.errors import DataError
from lpvobs.io.configuration.config import load_config
from lpvobs.io.logs.parquet import write_log
from lpvobs.io.logs.reading import read_log
from lpvobs.io.results.results import read_result

SERIES = CONFIGS / "series.toml"
UNITS = {name: item.unit for name, item in ENGINES["series"].air_path.channels.items()}
ALL_UNITS = UNITS | {"time": "s", "ref_W_c": "kg/s", "ref_delta_W_c": "kg/s"}


def drive(seconds=240.0, rate=20.0):
    """Return a slow drive by formula, EGR open and shut by turns; the error of the sensor is a plane in fuel and speed."""
    t = np.arange(round(seconds * rate)) / rate
    n_e, u_delta = 2000.0 + 800.0 * np.sin(0.05 * t), 20.0 + 10.0 * np.sin(0.031 * t)
    p_im, T_im = 1.3e5 + 2e4 * np.sin(0.04 * t), 320.0 + 5.0 * np.sin(0.02 * t)
    u_egr = np.where(t % 20.0 < 10.0, 0.0, 30.0)
    T_em = T_im + 300.0
    eta = -2.08e-4 * np.sqrt(p_im) - 1.3e-3 * np.sqrt(n_e) + 1.005
    W_ei = eta * n_e * 1.91e-3 * p_im / (120.0 * 287.0 * T_im)
    p_em = p_im + 2000.0 + 2.5 * n_e
    shut_off = 1.0 - ((1.0 - p_im / p_em) / (1.0 - 0.65) - 1.0) ** 2
    area = 3e-4 * (-1.1104e-4 * u_egr + 1.7781e-2) * u_egr
    W_egr = area * p_em / np.sqrt(286.0 * T_em) * shut_off
    rise, warming = 2e4 * 0.04 * np.cos(0.04 * t), 5.0 * 0.02 * np.cos(0.02 * t)
    W = W_ei - W_egr + 5e-3 / (287.0 * T_im) * (rise - p_im / T_im * warming)
    error = 1e-3 + 5e-5 * u_delta - 4e-7 * n_e
    return {
        "time": t, "n_e": n_e, "u_delta": u_delta, "u_egr": u_egr, "p_im": p_im, "p_em": p_em, "T_im": T_im, "T_em": T_em,
        "p_amb": np.full_like(t, 9.8e4), "T_amb": np.full_like(t, 298.0),
        "lambda_e": W / (14.57 * 4.0 * n_e * u_delta * 1e-6 / 120.0),
        "W_maf": W + error, "ref_W_c": W, "ref_delta_W_c": error,
    }  # fmt: skip


def written(path, channels, without=()):
    kept = {name: values for name, values in channels.items() if name not in without}
    write_log(path, kept, {name: ALL_UNITS[name] for name in kept})
    return path


@pytest.fixture(scope="module")
def config():
    return load_config(SERIES)[0]


def found_on(config, path):
    log = read_log(path, config.engine_path().channels, config.policies)
    rates = {name: np.gradient(log[name], log.time) for name in config.engine_path().smoothed}
    return log, rates, config.engine_path().balances(log, rates, ("V_d", "k_fuel"))


def test_the_balances_are_the_flow_by_hand(config, tmp_path):
    channels = drive(40.0)
    _, _, found = found_on(config, written(tmp_path / "log.parquet", channels))
    inside = slice(2, -2)  # one-sided differences at the ends
    shut, open_, mixture = np.isfinite(found.flow)[:, inside]
    assert (shut | open_).mean() > 0.9  # the valve moves without a ramp
    assert not (shut & open_).any()
    assert mixture.mean() > 0.9
    for flow in found.flow:
        told = np.isfinite(flow[inside])
        # Central differences of sines of 0.05 rad/s over 0.1 s: a millionth of a stored flow of 1e-4 kg/s; the rest is rounding.
        np.testing.assert_allclose(flow[inside][told], channels["ref_W_c"][inside][told], rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        found.slope[flows.MIXTURE, 1], found.flow[flows.MIXTURE], rtol=1e-8
    )  # the scale of the fuel passes one to one


@pytest.mark.parametrize(
    ("without", "silent"),
    [(("u_egr",), [flows.FILLING, flows.RECIRCULATED]), (("lambda_e",), [flows.MIXTURE])],
)
def test_what_a_log_lacks_is_not_guessed(config, tmp_path, without, silent):
    log, _, found = found_on(config, written(tmp_path / "log.parquet", drive(20.0), without))
    assert [k for k, flow in enumerate(found.flow) if np.isnan(flow).all()] == silent
    assert np.isnan(log[without[0]]).all()


def test_open_valve_and_lambda_count_in_steady_running_alone(config, tmp_path):
    channels = drive(14.0)
    channels["p_im"] = channels["p_im"] * np.exp(0.12 * (channels["time"] - 10.0))  # 12 % a second, 0.4 to 2.1 bar
    _, _, found = found_on(config, written(tmp_path / "log.parquet", channels))
    shut = channels["u_egr"] < flows.SHUT
    assert np.isfinite(found.flow[0][shut]).all()
    assert np.isnan(found.flow[0][~shut]).all()
    assert np.isnan(found.flow[1:]).all()


@pytest.mark.parametrize("learned", [False, True])
def test_an_open_valve_counts_once_a_calibration_knows_the_egr(config, tmp_path, learned):
    log, _, _ = found_on(config, written(tmp_path / "log.parquet", drive(5.0)))
    trust = config.engine_path().caution(log, {}, 0.0, learned).trust
    assert trust[:, 0].tolist() == [1.0, float(learned), 1.0]


@pytest.mark.slow
def test_a_bench_shows_the_filling_with_the_valve_shut_and_open_and_the_egr_itself(config):
    channels = drive(40.0)
    table = {name: values[::100] for name, values in channels.items() if name not in ("time", "W_maf")}
    table["W_reference"], table["W_egr_reference"] = table["ref_W_c"], np.full(8, 1e-3)
    path = config.engine_path()
    rows = rows_of(path, unknowns_of(config.estimate.tolerance, path.components), [bench_table(path, table)])
    said = [rows.kind[of].name for of in rows.of]
    assert {name: said.count(name) for name in said} == {"filling": 4, "filling_with_egr": 4, "mixture": 8, "egr": 4}
    assert np.isfinite(rows.J).all()


def test_a_log_without_valve_and_lambda_is_refused(config, tmp_path):
    path = written(tmp_path / "log.parquet", drive(20.0), ("u_egr", "lambda_e"))
    with pytest.raises(DataError, match=r"'u_egr' or 'lambda_e'.*record at least one"):
        read_log(path, config.engine_path().channels, config.policies)


@pytest.mark.parametrize("without", [("lambda_e",), ("u_egr",), ()])
def test_its_map_is_found_through_the_verbs(tmp_path, without):
    log = written(tmp_path / "log.parquet", drive(), without)
    gain, result = tmp_path / "gain.h5", tmp_path / "result.h5"
    lpvobs.synth_gain(SERIES, out=gain)
    lpvobs.estimate(SERIES, [log], gain=gain, out=result)
    (seen,) = read_result(result).logs
    # Filling alone: what is not known of V_d and eta_vol, 1 % each, is 0.4 g/s of 40. Lambda alone: the scale of the fuel, 5 %.
    assert seen.metrics.rmse < (2e-3 if without == ("u_egr",) else 5e-4)
    assert without == ("u_egr",) or seen.metrics.visited_cells > 5


@pytest.mark.proof
@pytest.mark.parametrize("further", ["lambda_e", "u_egr"])
def test_inspect_says_what_a_further_channel_would_add(tmp_path, further):
    """The log that has the channel is the measure. The stand-in promises a gain, and here no more than the channel gives."""
    rng, channels = np.random.default_rng(4), drive()
    for name, error in {"W_maf": 0.01, "p_im": 0.002, "u_delta": 0.01, "lambda_e": 0.01}.items():
        channels[name] *= 1.0 + error * rng.standard_normal(channels["time"].size)
    log = written(tmp_path / "log.parquet", channels, (further, "p_em", "T_em"))
    complete = written(tmp_path / "complete.parquet", channels, ("p_em", "T_em"))
    promised, real = ({item.channel: item for item in lpvobs.inspect(path, SERIES).informs} for path in (log, complete))
    assert list(promised) == [None, further, "p_em", "T_em"]
    assert list(real) == [None, "p_em", "T_em"]
    now, then = promised[None], promised[further]
    assert then.nodes == pytest.approx(real[None].nodes, abs=3)
    assert real[None].standard_error <= then.standard_error < now.standard_error
    assert lpvobs.inspect(log).informs == ()


def test_effects_change_what_they_should(config, tmp_path):
    """A leak of the intake and an EGR area move the filling alone; what the engine lacks slows the pressure by as much."""
    log, rates, _ = found_on(config, written(tmp_path / "log.parquet", drive(20.0)))
    path = config.engine_path()
    model = effects.residual_model(config, path, None, (), None)
    order = np.tile(np.array(model.lacks)[:, None], (1, len(log)))
    s = Signals(
        log.time,
        log.time,
        log.channels,
        rates,
        order,
        lambda _: log["W_maf"],
        lambda name: rates[name],
        model.constants,
    )
    clean = model.imbalances(model.constants, s, None)
    for name, size in (("leak.intake", 2e-5), ("egr.area", 0.8), ("egr.leak", 1e-5), ("eta_vol.factor", 0.97)):
        faulty = model.effect(name).apply(s, size)
        moved = model.imbalances(model.constants, faulty, None) - clean
        filling = moved[effects.FILLINGS].sum(axis=0)
        assert np.abs(filling).max() > 1e-5
        assert not moved[flows.MIXTURE].any()
        flow, state = model.further(model.constants, faulty)
        np.testing.assert_allclose(flow, -moved, atol=1e-15)
        np.testing.assert_allclose(state[0], 287.0 * log["T_im"] / 5e-3 * filling, rtol=1e-9)


def test_speed_and_pressure_alone_give_the_difference_between_days(tmp_path):
    """The sensor reads 2 % more on the second day: the maps of filling alone, EGR in both, differ by that and by nothing else."""
    config, gain = CONFIGS / "speed_density.toml", tmp_path / "gain.h5"
    lpvobs.synth_gain(config, out=gain)
    maps = []
    for day, factor in enumerate((1.0, 1.02)):
        channels = drive()
        channels["W_maf"] = factor * channels["W_maf"]
        log = written(
            tmp_path / f"log{day}.parquet", {n: channels[n] for n in ("time", "n_e", "p_im", "T_im", "W_maf")}
        )
        result = tmp_path / f"day{day}.h5"
        assert any("confounded" in text for text in lpvobs.estimate(config, [log], gain=gain, out=result).doubts.says)
        maps.append(lpvobs.read_map(result).values)
        with pytest.raises(DataError, match="cannot tell faults apart"):
            lpvobs.trace(result, [log])
    known = np.isfinite(maps[0])
    assert known.any()
    change = (maps[1] - maps[0])[known].mean() / drive()["W_maf"].mean()
    assert change == pytest.approx(0.02, abs=0.01)  # the flow at the nodes is up to half off the drive's mean

"""The test bench: points at rest, all over the range, measured as well as a bench measures."""

from dataclasses import replace

import numpy as np
import pytest

from lpvobs.engines.diesel.lpv import INPUTS, Diesel, along
from lpvobs.errors import UsageError
from lpvobs.simulation import stationary
from lpvobs.simulation.integrate import flows
from lpvobs.simulation.parameters import Structure
from lpvobs.simulation.plant import Inputs, plant_of

POINTS = 24


@pytest.fixture(scope="module")
def table(config):
    return stationary.bench(config.engine, config.simulation, POINTS)


def test_nothing_moves_at_a_point(config):
    """The flows into a manifold are those out of it, and the shaft has as much power as it gives, with any structure."""
    for structure in (Structure(), Structure(wave=1.0, egr=1.0, compressor=1.0, turbine=1.0, pipes=1.0)):
        parameters = replace(config.simulation, structure=structure)
        plant = plant_of(config.engine, parameters)
        for point in stationary.spread(parameters.full_load, 3, 5):
            found = stationary.at_rest(config.engine, parameters, plant, point)
            x = np.array(
                [found[name] for name in ("p_im", "p_em")] + [0.2314, 0.2314]  # lean: oxygen decides nothing
                + [found[name] for name in ("omega_t", "u_egr", "u_egr", "u_vgt", "T_im")]
            )  # fmt: skip
            given = Inputs(
                found["n_e"], found["u_delta"], found["u_egr"], found["u_vgt"], found["p_amb"], found["T_amb"]
            )
            f = flows(plant, x, given._replace(v_air=20.0))
            # the states still move by 1e-5 of themselves a second, the manifold takes some 0.05 s to fill
            assert f.W_c + f.W_egr == pytest.approx(f.W_ei, rel=1e-5)
            assert f.W_c == pytest.approx(found["W_c"], rel=1e-9)


@pytest.mark.slow
def test_points_fill_the_range(table, config):
    c, full = table.channels, config.simulation.full_load
    assert np.ptp(c["n_e"]) > 0.8 * (4400.0 - full.idle_speed)
    load = c["u_delta"] / np.interp(c["n_e"], full.n_e, full.u_delta)
    assert load.min() < 0.2
    assert load.max() > 0.8
    assert 0.25 < np.mean(c["u_egr"] == 0.0) < 0.55
    assert c["u_egr"].max() > 40.0
    assert np.mean(c["T_amb"] < 289.0) > 0.15
    assert c["T_im"].min() < 295.0
    assert c["u_vgt"].max() - c["u_vgt"].min() > 50.0


def test_columns_are_those_of_the_contract(table):
    assert list(table.channels) == [
        "n_e", "u_delta", "u_egr", "u_vgt", "p_im", "p_em", "omega_t", "T_im", "T_em", "p_amb", "T_amb",
        "W_reference", "sd_W_reference", "W_egr_reference", "W_f",
    ]  # fmt: skip
    assert table.units.keys() == table.channels.keys()
    assert all(values.shape == (POINTS,) and np.isfinite(values).all() for values in table.channels.values())


def test_the_meter_errs_by_what_it_states(table, config):
    """The model's compressor and filling on the averaged readings, without another structure, give the meter's flow."""
    c = table.channels
    rho, _ = along(Diesel(config.engine).constants, tuple(c[name] for name in INPUTS))
    filling = rho[:, 2] * c["p_im"] - rho[:, 1] * c["p_em"]
    shut = c["u_egr"] == 0.0
    error = (c["W_reference"] - filling)[shut] / c["sd_W_reference"][shut]
    # ten points know a standard deviation to a quarter; readings averaged over 3000 add next to nothing
    assert 0.4 < np.std(error) < 1.8
    np.testing.assert_allclose(c["sd_W_reference"], 0.0035 * c["W_reference"], rtol=1e-12)
    np.testing.assert_allclose(c["W_f"], 1e-6 / 120.0 * 4 * c["n_e"] * c["u_delta"], rtol=0.006)


def test_same_seed_same_table_and_another_seed_other_points(table, config):
    few = [stationary.bench(config.engine, config.simulation, 2, seed).channels["n_e"] for seed in (1, 1, 2)]
    np.testing.assert_array_equal(few[0], few[1])
    assert abs(few[0] - few[2]).min() > 1.0
    np.testing.assert_allclose(few[0], table.channels["n_e"][:2], atol=1.0)


@pytest.mark.parametrize(("points", "seed"), [(0, 1), (1001, 1), (3, -1)])
def test_an_impossible_bench_is_refused(config, points, seed):
    with pytest.raises(UsageError, match="expected"):
        stationary.bench(config.engine, config.simulation, points, seed)

"""The balances of a calibrated diesel: its corrections are those of the estimate, and so are their derivatives."""

from dataclasses import replace

import numpy as np
import pytest
from reference.drives import scattered

from lpvobs.engines.diesel.corrections import COMPONENTS
from lpvobs.engines.diesel.effects import CHANNELS, diesel_model, imbalances
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.engines.effects import Signals
from lpvobs.engines.unknowns import NEGLIGIBLE, unknowns_of

TOLERANCE = {"V_d": 0.01, "R_c": 0.002}


@pytest.fixture(scope="module")
def known():
    """Return what a calibration may know: values of a third of their deviation, and the covariance of before."""
    before = unknowns_of(TOLERANCE, COMPONENTS)
    spread = np.sqrt(np.diag(before.covariance))
    return replace(before, mean=0.3 * spread * np.random.default_rng(2).normal(size=before.size), learned=True)


@pytest.fixture(scope="module")
def model(engine, known):
    """Return the loop's model around the calibrated engine; the area of the turbine is not calibrated."""
    found = diesel_model(engine, {"V_d": 0.02, "A_vgt_max": 0.01}, known=known)
    return found.restarted(known.deviation(), found.covariance)


def signals(model, log, **rates):
    still = {name: np.zeros(len(log)) for name in CHANNELS} | rates
    lacks = np.tile(np.array(model.lacks)[:, None], (1, len(log)))
    return Signals(log.time, log.time, log.channels, still, lacks, lambda _: log["W_maf"], still.get, model.constants)


def test_the_prior_is_that_of_the_calibration_and_of_the_rest_the_tolerance(model, known):
    assert model.names[:3] == ("A_vgt_max", "V_d", "R_c")
    assert model.names[3] == "corrections[0]"
    assert model.adding == len(model.names) - 3
    deviations = np.array(list(known.deviation().values()))
    assert model.spread[:3] == pytest.approx(
        np.array([0.01, *np.array([0.01, 0.002]) / (1.0 + deviations)]) / np.sqrt(3.0)
    )
    assert (model.spread[3:] > NEGLIGIBLE).all()
    left = known.covariance - known.reduction @ known.reduced(known.covariance) @ known.reduction.T
    assert np.sqrt(np.abs(np.diag(left)).max()) < NEGLIGIBLE


def test_corrections_are_those_that_the_estimate_makes(engine, model, known):
    log = scattered(11)
    rates = {"p_im": np.full(len(log), 1e3), "omega_t": np.full(len(log), -200.0), "T_im": np.full(len(log), 2.0)}
    air_path = Diesel(engine).deviating(known.deviation())
    lag = known.mean[known.places()["omega_t_lag"]]  # the loop moves the signal, the estimate the flow by its slope
    later = replace(log, channels={**log.channels, "omega_t": log["omega_t"] + lag * rates["omega_t"]})
    flow = air_path.balances(later, rates, ()).flow.copy()
    still = rates | {"T_em": np.zeros(len(log))}
    for (name, place), item in zip(known.places().items(), air_path.corrections(log, still), strict=True):
        if name not in ("omega_t_lag", "W_maf_lag"):  # a sensor that reads a constant shows no lag
            flow[item.balance] += item.columns(place.stop - place.start) @ known.mean[place]
    left = imbalances(model.constants, signals(model, log, **rates))
    np.testing.assert_allclose(left[:2], log["W_maf"] - flow, rtol=0, atol=1e-12)  # kg/s, rounding


def test_derivatives_by_modes_are_difference_quotients(model):
    rng = np.random.default_rng(3)
    log = scattered(12)
    seen = signals(model, log, T_em=rng.normal(0, 50, len(log)), W_maf=rng.normal(0, 0.02, len(log)))
    found = model.by_unknowns(model.constants, seen, None)
    assert found.shape == (model.adding, 4, len(log))
    for mode in (0, 1, model.adding // 2, model.adding - 1):
        ends = []
        for step in (1e-4, -1e-4):
            moved = np.zeros(len(model.names))
            moved[3 + mode] = step
            ends.append(imbalances(model.with_unknowns(moved), seen))
        # Quotients of one side: a step of 1e-5 kg/s or 1e-4 s times the second derivative.
        np.testing.assert_allclose(
            found[mode], (ends[0] - ends[1]) / 2e-4, rtol=0, atol=2e-3 * np.abs(found[mode]).max()
        )

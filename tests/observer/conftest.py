"""Two small drives through Eq. (1) with a known error surface, shared by the tests of the estimators."""

import os

import numpy as np
import pytest
from reference.drives import integrated

from lpvobs.engines.diesel.published import PUBLISHED
from lpvobs.maps.metrics import best_fit
from lpvobs.maps.quadratic import evaluate
from lpvobs.observer.parts import StateGain
from lpvobs.observer.settings import EstimateSettings

EQ_40 = np.array(PUBLISHED.surfaces["FTP75 cold transient, Eq. (40)"])
LEGS = 3 if os.environ.get("NUMBA_DISABLE_JIT") == "1" else 100
"""Of the drive. Without the compiler a short one: what compares two ways holds on it as well, what is about accuracy does not."""
TOLERANCE = dict.fromkeys(
    ("R_c", "psi_0", "psi_1", "phi_0", "phi_1", "k_neg", "V_d", "c_vol1", "c_vol3", "V_im", "A_egr_max", "k_reverse"),
    0.01,
)


def surface(u_delta, n_e):
    """Return the error of the sensor, [kg/s]: Eq. (40)."""
    return evaluate(EQ_40, u_delta, n_e)


@pytest.fixture(scope="session")
def drive(engine):
    """Return a drive of 200 s in 100 legs, and its true flow, with Eq. (40) as the sensor's error."""
    return integrated(engine, 1, legs=LEGS, seconds=2.0, surface=surface, substeps=5)


@pytest.fixture(scope="session")
def other_drive(engine):
    return integrated(engine, 2, legs=min(LEGS, 60), seconds=2.0, surface=surface, substeps=5)


@pytest.fixture(scope="session")
def target(grid):
    """Return a function: the nodes of the best bilinear fit to Eq. (40) along logs, what an estimate can be right about."""

    def nodes(*logs):
        u, n = (np.concatenate([log[name] for log in logs]) for name in ("u_delta", "n_e"))
        return best_fit(grid, *grid.regressors(u, n), surface(u, n)).reshape(grid.shape)

    return nodes


@pytest.fixture(scope="session")
def gain():
    """Return a gain as synthesis finds it for wide temperatures and a decay of 1000 1/s, without the sensor."""
    L = np.array([[2215.0, -4.2, 156.0, 0.0], [-113.0, 2129.0, -88.0, 0.0], [55.0, -1.1, 2015.0, 0.0]])
    return StateGain(("p_im", "p_em", "omega_t"), L)


@pytest.fixture(scope="session")
def settings():
    return EstimateSettings(smoothing=0.05, least_information=0.1, prior_map=0.1, tolerance=TOLERANCE)

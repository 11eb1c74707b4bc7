"""What settings take, to the edge, and what they refuse."""

from dataclasses import replace

import numpy as np
import pytest

from lpvobs.observer.settings import EstimateSettings, PublishedSettings

GOOD = EstimateSettings(smoothing=0.05, least_information=1.0, prior_map=0.1, tolerance={"V_d": 0.03, "R_c": 0.0})


def test_constants_of_which_nothing_is_said_have_the_usual_tolerance_and_others_are_dropped():
    assert GOOD.of_engine({"R_c": 0.01, "V_im": 0.02}).tolerance == {"R_c": 0.0, "V_im": 0.02}
    assert not GOOD.of_engine({}).tolerance


def test_constants_are_estimated_or_considered():
    assert GOOD.constants == "joint"
    with pytest.raises(ValueError, match="expected one of joint, consider"):
        replace(GOOD, constants="fitted")


@pytest.mark.parametrize("name", ["smoothing", "least_information", "prior_map"])
def test_edges_of_positive_settings(name):
    for value in (5e-324, 0.5, 1.0, 2.0, np.nextafter(1e6, 0.0)):
        assert getattr(replace(GOOD, **{name: value}), name) == value
    for value in (0.0, -1.0, 1e6, 1.5e6, float("nan")):
        with pytest.raises(ValueError, match=name):
            replace(GOOD, **{name: value})


def test_edges_of_tolerances():
    assert replace(GOOD, tolerance={"V_d": np.nextafter(0.5, 0.0)}).tolerance["V_d"] < 0.5
    for value in (-1e-9, 0.5, float("nan")):
        with pytest.raises(ValueError, match="fraction"):
            replace(GOOD, tolerance={"R_c": 0.01, "V_d": value})


@pytest.mark.parametrize("gamma", [0.0, -200.0, float("nan")])
def test_gamma_is_positive(gamma):
    assert PublishedSettings(0.5, (0.0, 0.0, 0.0), {}).gamma == 0.5
    with pytest.raises(ValueError, match="gamma"):
        PublishedSettings(gamma, (0.0, 0.0, 0.0), {})

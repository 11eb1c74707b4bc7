"""What speaks against a log: a sensor of another unit or another time, a volume that transients do not know."""

import numpy as np
import pytest
from repository import DIESEL

from lpvobs.api.doubts import FOLLOWS, OFF, READS, SURE, _another_volume, _said
from lpvobs.engines.unknowns import Unknowns
from lpvobs.io.configuration.config import load_config
from lpvobs.observer.balance_agreement import BalanceAgreement, BalanceSums
from lpvobs.observer.estimate import EngineFound

NAMES = ("V_im", "R_c")


def sums(reads, changes=(0.0, 0.0, 0.0, 0.0)):
    """Return sums of four cells in which the sensor reads so many times the flow of the balances, and the changes in a second."""
    one = np.ones((4, 1))
    W, still, cell = reads * 0.03 * one[:, 0], np.ones((4, 1, 3)), one[:, 0]
    own = np.zeros(2), np.array(changes)
    return BalanceSums(cell, W, one, 0.03 * one, 0 * one, np.ones((1, 5)), one[:, :, None], still, *own)


@pytest.mark.parametrize(
    ("reads", "said"), [(1 / 3.6, True), (3.6, True), (0.53, False), (1.06, False), (1 / 1.9, False)]
)
def test_a_sensor_in_another_unit_is_named(reads, said):
    config = load_config(DIESEL)[0]
    words = list(_said(config, sums(reads), BalanceAgreement(ratio=0.5, where={})))
    assert bool(words) == said
    assert all("W_maf" in text and "unit" in text for text in words)
    assert READS < 0.53


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ((9.0, 9e-4, 9e-4, 9e-4 * 0.83), None),  # 10 g/s in a second on 30 g/s, the least of right drives
        ((9.0, 9e-4, 9e-4, 9e-4 * 0.44), "0.44"),
        ((9.0, 0.0, 9e-4, 0.0), "0.00"),  # a reading that stands still
        ((9.0, 9e-6, 9e-6, 0.0), None),  # steady driving, where noise is all that changes
    ],
)
def test_a_reading_that_does_not_follow_the_engine_is_said(changes, said):
    words = list(_said(load_config(DIESEL)[0], sums(1.0, changes), BalanceAgreement(ratio=0.5, where={})))
    assert [said in text and "late" in text for text in words] == ([True] if said else [])
    assert FOLLOWS < 0.83


def found(moved, left, name="V_im"):
    """Return an engine of which the logs moved a constant, known to 0.006, and left so much of its spread."""
    prior, own = np.array([0.006, 0.006]), NAMES.index(name)
    after = prior.copy()
    after[own] *= left
    mean = np.zeros(2)
    mean[own] = moved
    return EngineFound(Unknowns(NAMES, (), np.zeros(2), np.diag(prior**2)), {}, mean, np.diag(after**2))


@pytest.mark.parametrize(("moved", "words"), [(0.0108, "27 % larger"), (-0.0108, "27 % smaller")])
def test_another_volume_that_transients_want_is_named_with_its_size(moved, words):
    # by hand: of a variance of 3.6e-5 a share of 1 - 0.98^2 is gained; alone the logs ask for 0.0108 / 0.0396 more
    (text,) = _another_volume(("V_im",), found(moved, 0.98))
    assert text.startswith("V_im: ")
    assert words in text
    assert "its tolerance is 1 %" in text


@pytest.mark.parametrize(
    ("moved", "left", "name"),
    [(0.0108, 0.98, "R_c"), (0.001, 0.98, "V_im"), (0.0108, 0.2, "V_im"), (0.0, 1.0, "V_im")],
    ids=["no volume", "unsure", "a little", "nothing learned"],
)
def test_nothing_else_is_said(moved, left, name):
    assert not list(_another_volume(("V_im",), found(moved, left, name)))
    assert SURE > 2.0
    assert OFF > 0.0173  # a constant at the edge of its tolerance, known exactly: 0.01


@pytest.mark.parametrize(("wanted", "said"), [(0.40, True), (0.14, False), (0.27, False)])
def test_a_volume_may_be_anywhere_within_its_tolerance(wanted, said):
    """A volume within 15 % that drives know to a thousandth."""
    unknowns = Unknowns(("V_im",), (), np.zeros(1), np.array([[0.15**2 / 3.0]]))
    words = list(_another_volume(("V_im",), EngineFound(unknowns, {}, np.array([wanted]), np.array([[1e-6]]))))
    assert [f"{100 * wanted:.0f} % larger" in text for text in words] == [True] * said


def test_a_volume_that_is_known_exactly_is_not_judged():
    unknowns = Unknowns(("V_im",), (), np.zeros(1), np.zeros((1, 1)))
    assert not list(_another_volume(("V_im",), EngineFound(unknowns, {}, np.zeros(1), np.zeros((1, 1)))))


def test_an_engine_without_unknowns_is_not_judged():
    assert not list(_another_volume(("V_im",), None))

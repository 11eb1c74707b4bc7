"""When a further effect is accepted."""

from types import SimpleNamespace

import numpy as np
import pytest

from lpvobs.discovery import select
from lpvobs.discovery.held_out import Losses


@pytest.fixture
def better(monkeypatch):
    """Return a function from what none, one, two effects leave to whether the last one is accepted."""

    def model(terms, patterns):
        return SimpleNamespace(terms=tuple(terms), problem=SimpleNamespace(patterns=patterns))

    def accepted(*left, patterns=(1,), opposed=False, named=""):
        def compared(before, after):
            here, one = [np.array([left[len(linear.terms)]]) for linear in (before, after)], np.zeros(1, dtype=np.int64)
            return Losses(here[0], here[1], np.ones(1, dtype=bool), one, 1.0)

        monkeypatch.setattr(select, "cross_validated", compared)
        monkeypatch.setattr(select, "refit", lambda linear, terms: model(terms, linear.problem.patterns))
        monkeypatch.setattr(select, "noise_power", lambda *_: 0.0)
        monkeypatch.setattr(select, "cancels", lambda *_: opposed)
        names = [SimpleNamespace(effect=SimpleNamespace(id=f"{named}{i}")) for i in range(len(left) - 1)]
        return select._predicts_better(model(names[:-1], patterns), model(names, patterns))

    return accepted


def test_where_healthy_drives_tell_a_hundredth_of_what_is_left_matters(better):
    """A reading .8 g/s too high was `unexplained`: noise of all balances is most of what is left."""
    assert better(3000.0, 2960.0)
    assert not better(3000.0, 2980.0)
    assert not better(3000.0, 2960.0, patterns=())


def test_what_a_cause_leaves_that_is_not_quite_the_catalogue_s_is_no_second_cause(better):
    """A contamination by another law was an inlet leak with an offset beside it."""
    assert better(3000.0, 1000.0, 850.0)
    assert not better(3000.0, 1000.0, 900.0)
    assert better(1100.0, 1000.0, 900.0)


@pytest.mark.parametrize("named", ["channel:", "form:"])
def test_beside_what_no_cause_has_listed_a_second_one_needs_more(better, named):
    """A right `channel:humidity` had a drift of the sensor beside it, a right `channel:T_coolant` a gain."""
    assert not better(3000.0, 1000.0, 850.0, named=named)
    assert better(3000.0, 1000.0, 700.0, named=named)


def test_two_effects_that_are_nearly_opposite_do_not_explain_each_other(better):
    """An inlet leak at the end of its range stood beside a reading a quarter too high."""
    assert not better(3000.0, 1000.0, 500.0, opposed=True)

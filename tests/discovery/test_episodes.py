"""One effect in several episodes in place of several effects."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lpvobs.discovery import episodes
from lpvobs.discovery.courses import TracedCourse
from lpvobs.discovery.evidence import Candidate
from lpvobs.discovery.residual import Term


def effect(id_, place):
    return SimpleNamespace(id=id_, place=place, null=0.0)


OFFSET, GAIN, DRIFT = effect("p_im.offset", "p_im"), effect("p_im.gain", "p_im"), effect("maf.drift", "sensor")


@pytest.fixture
def tried(monkeypatch):
    """A model of one effect; what it leaves with an effect in episodes is 10 for `p_im.gain`, and 20 for any other."""

    def found(own, further, *, course=None, patterns=(1,), gains=None, may=lambda _: True, left=15.0):
        linear = SimpleNamespace(
            terms=(replace_course(own, course),), problem=SimpleNamespace(patterns=patterns), left=left
        )
        gains = gains or {}

        def again(on, _):
            of = on.terms[0].effect
            return SimpleNamespace(
                id=of.id, gain=gains.get(of.id, 300.0), term=Term(of, 1.0, course=TracedCourse("intermittent"))
            )

        def fitted(problem, terms, start):
            left = 10.0 if terms[0].effect is GAIN else 20.0
            return SimpleNamespace(terms=tuple(terms), problem=problem, left=left)

        monkeypatch.setattr(episodes, "may_have_episodes", lambda each, _: may(each))
        monkeypatch.setattr(episodes, "timed_again", again)
        monkeypatch.setattr(episodes, "in_place", lambda _, __, candidate: candidate)
        monkeypatch.setattr(episodes, "is_worth", lambda one, other: one.gain > other.gain)
        monkeypatch.setattr(episodes, "fit", fitted)
        monkeypatch.setattr(episodes, "objective", lambda on: on.left)
        accepted, candidate = (SimpleNamespace(id=term.effect.id, gain=200.0, term=term) for term in (own, further))
        model = episodes.in_episodes(linear, (accepted,), candidate)
        return None if model is None else [c.id for c in model[1]]

    return found


def replace_course(term, course):
    return Term(term.effect, term.size, term.begin, term.end, course=course)


def test_an_effect_that_is_there_again_takes_all_its_episodes(tried):
    """An intake pressure 15 hPa too high in two episodes was `unexplained`, p = 1e-175: one of them seemed of one size."""
    own = Term(OFFSET, 1.0, 10.0, 50.0)
    assert tried(own, own) == ["p_im.offset"]
    assert tried(own, own, course=TracedCourse("intermittent")) is None  # it has been in its episodes
    assert tried(own, own, may=lambda _: False) is None
    assert tried(own, own, gains={"p_im.offset": 100.0}) is None
    assert tried(own, own, patterns=()) is None  # it may be any disturbance


def test_of_two_effects_at_one_place_the_one_is_taken_that_leaves_less(tried):
    """A gain that came and went was a drift at first, which has no episodes: `unexplained`, p = 9e-64."""
    assert tried(Term(OFFSET, 1.0, 10.0, 50.0), Term(GAIN, 1.0, 100.0, 150.0)) == ["p_im.gain"]
    assert tried(Term(OFFSET, 1.0, 10.0, 50.0), Term(GAIN, 1.0, 100.0, 150.0), may=lambda e: e is OFFSET) == [
        "p_im.offset"
    ]


def test_what_seems_to_be_elsewhere_at_another_time_may_be_another_episode(tried):
    """A second episode of a pressure was taken for a drift of the sensor, and the drive was `unexplained`, p = 3e-59."""
    own = Term(OFFSET, 1.0, 10.0, 50.0)
    assert tried(own, Term(DRIFT, 1.0, 100.0, 150.0)) == ["p_im.offset"]
    assert tried(own, Term(DRIFT, 1.0, 40.0, 150.0)) is None  # at the same time it is another effect


def test_an_effect_is_moved_to_where_it_acts_beside_the_others(tried):
    """A step of the back pressure was a ramp beside another effect, then the step was there again: `unexplained`, p = 7e-71."""
    own, step, ramp = Term(OFFSET, 1.0), Term(OFFSET, 1.0, 100.0), TracedCourse("ramp")
    assert tried(own, step, course=ramp, left=30.0) == ["p_im.offset"]
    assert tried(own, step, course=ramp) is None  # it leaves more there
    assert tried(own, Term(GAIN, 1.0, 100.0), course=ramp, left=30.0) is None


@pytest.mark.parametrize(("left", "taken"), [(20.0, True), (20.9, True), (21.1, False)])
def test_episodes_stand_for_a_further_effect_if_they_leave_no_more(monkeypatch, left, taken):
    monkeypatch.setattr(episodes, "objective", float)
    longer, again = (20.0, ("two",)), (left, ("one",))
    assert episodes.shorter(longer, again) is (again if taken else longer)
    assert episodes.shorter(longer, None) is longer


@pytest.mark.parametrize(
    ("trial", "left", "learned", "turned"),
    [
        (140.0, 130.0, True, True),
        (140.0, 160.0, True, False),
        (140.0, 99.0, False, False),
        (149.0, 99.0, True, False),  # takes too little of what is left: not looked at further
    ],
)
def test_what_ends_beside_an_effect_that_stands_for_both_begins_there(monkeypatch, trial, left, learned, turned):
    """A dirty sensor from 187 s on, and an offset from 249 s on, were one that was too dirty, and less until 240 s."""
    film, off = (effect(name, "sensor") for name in ("maf.contamination", "maf.offset"))
    problem = SimpleNamespace(patterns=(1,) if learned else ())
    before = SimpleNamespace(problem=problem, terms=(Term(film, 0.115, 198.0),), left=150.0)
    own = Term(off, -0.002, 200.0, 240.0)
    candidate = Candidate(own, 259.0, 1.0, 1.0, np.zeros(1), 1.0, False, 1.0, 0.0)

    def fitted(_, terms, start):
        return SimpleNamespace(problem=problem, terms=tuple(terms), left=130.0 if terms[-1] == own else trial)

    def again(linear, accepted):
        return SimpleNamespace(terms=linear.terms, left=left), accepted

    monkeypatch.setattr(episodes, "fit", fitted)
    monkeypatch.setattr(episodes, "objective", lambda linear: linear.left)
    monkeypatch.setattr(episodes, "in_place", lambda linear, i, like: replace(like, gain=float(i)))
    monkeypatch.setattr(episodes, "choose_all_again", again)
    found = episodes.from_its_end(before, ("film",), candidate)
    assert (found is not None) is turned
    if found is not None:
        first, last = found[0].terms
        assert (first, last) == (*before.terms, Term(off, 0.002, 240.0))
        assert (found[1][0], found[1][1].term) == ("film", last)

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest

from lpvobs.errors import UsageError
from lpvobs.synthesis.region import Region

CUT = Region(("x", "y", "a"), (-1.65, 0.61, 2.0), (1.6, 6.01, 3.0), (("x", "y"),))


def test_a_fixed_parameter_does_not_double_the_vertices():
    region = Region(("x", "y", "a"), (0.0, 1.0, 5.0), (1.0, 2.0, 5.0))
    assert len(region.vertices()) == 4
    assert {vertex[2] for vertex in region.vertices()} == {Fraction(5)}


@pytest.mark.parametrize(
    ("ranges", "clipped", "count"),
    [({}, False, 32), ({"T_im": (280, 400), "T_em": (300, 1200)}, False, 128), ({"T_em": (300, 1200)}, True, 80)],
)
def test_the_diesel_has_the_vertices_one_counts_by_hand(diesel, ranges, clipped, count):
    # 2^5, 2^7, and 2^3 x 5 corners of the cut rectangle x 2
    assert len(set(diesel("ETC", clipped=clipped, **ranges).region.vertices())) == count


def test_the_full_polytope_has_160_vertices(diesel):
    assert len(diesel("ETC", (280, 400), (300, 1200), clipped=True).region.vertices()) == 160


def test_a_cut_that_misses_the_box_changes_nothing(diesel):
    whole, cut = (diesel("NEDC", clipped=clipped).region.vertices() for clipped in (False, True))
    assert set(whole) == set(cut)


def test_vertices_are_the_exact_bounds_and_lie_on_the_cut():
    corners = {vertex[:2] for vertex in CUT.vertices()}
    low, high = Fraction(-1.65), Fraction(1.6)
    bottom, top = Fraction(0.61), Fraction(6.01)
    assert corners == {(-bottom, bottom), (high, bottom), (high, top), (low, top), (low, -low)}


def test_a_cut_through_a_single_corner_leaves_that_corner():
    region = Region(("x", "y"), (-2.0, -1.0), (-1.0, 1.0), (("x", "y"),))
    assert region.vertices() == ((Fraction(-1), Fraction(1)),)


def test_mixtures_of_vertices_are_inside_and_points_beyond_are_not():
    rng = np.random.default_rng(1)
    vertices = np.array(CUT.vertices(), dtype=float)
    mixtures = rng.dirichlet(np.ones(len(vertices)), 500) @ vertices
    assert CUT.contains(mixtures).all()
    assert not CUT.contains(np.array([[-1.6, 0.61, 2.5], [0.0, 1.0, 3.1], [np.nan, 1.0, 2.5]])).any()


def test_regions_drawn_towards_a_point_are_nested():
    centre = (0.1, 3.3, 2.2)
    assert CUT.scaled(1.0, centre) == CUT
    assert CUT.scaled(0.0, centre).vertices() == (tuple(Fraction(c) for c in centre),)
    scales = np.linspace(0.0, 1.0, 23)
    for small, large in pairwise(scales):
        inner, outer = CUT.scaled(float(small), centre), CUT.scaled(float(large), centre)
        assert all(a >= b for a, b in zip(inner.lower, outer.lower, strict=True))
        assert all(a <= b for a, b in zip(inner.upper, outer.upper, strict=True))


@pytest.mark.parametrize(
    ("names", "lower", "upper", "sums"),
    [
        (("x",), (146.0,), (110.0,), ()),  # Table 1 as printed
        (("x",), (float("nan"),), (1.0,), ()),
        (("x",), (0.0,), (float("inf"),), ()),
        (("x", "x"), (0.0, 0.0), (1.0, 1.0), ()),
        (("x", "y"), (0.0,), (1.0, 1.0), ()),
        (("x", "y"), (0.0, 0.0), (1.0, 1.0), (("x", "z"),)),
        (("x", "y", "z"), (0.0,) * 3, (1.0,) * 3, (("x", "y"), ("y", "z"))),
        (("x", "y"), (-3.0, 0.0), (-2.0, 1.0), (("x", "y"),)),
    ],
)
def test_senseless_regions_are_refused_in_one_line(names, lower, upper, sums):
    with pytest.raises(UsageError) as refusal:
        Region(names, lower, upper, sums)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(("s", "centre"), [(1.5, (0.0, 1.0, 2.0)), (0.5, (9.0, 1.0, 2.0)), (0.5, (0.0, 1.0))])
def test_a_centre_outside_or_a_senseless_scale_is_refused(s, centre):
    with pytest.raises(UsageError):
        CUT.scaled(s, centre)

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


def box(x, y, *, cut=True):
    return Region(("x", "y"), (x[0], y[0]), (x[1], y[1]), (("x", "y"),) if cut else ())


@pytest.mark.parametrize(
    ("x", "y", "corners"),
    [
        ((1, 2), (3, 4), {(1, 3), (2, 3), (2, 4), (1, 4)}),  # the cut is far away
        ((0.125, 0.25), (0.125, 0.5), {(0.125, 0.125), (0.25, 0.125), (0.25, 0.5), (0.125, 0.5)}),  # and near
        ((-2, 2), (-2, 2), {(2, -2), (2, 2), (-2, 2)}),  # through two corners
        ((-4, 1), (-2, 3), {(1, -1), (1, 3), (-3, 3)}),  # a triangle
        ((-1, 3), (-2, 1), {(2, -2), (3, -2), (3, 1), (-1, 1)}),  # through a corner and an edge
        ((-1, -1), (0, 3), {(-1, 1), (-1, 3)}),  # x stands still
        ((0, 3), (-1, -1), {(1, -1), (3, -1)}),  # y stands still
        ((1, 1), (-1, -1), {(1, -1)}),  # a point on the cut
        ((1, 1), (2, 2), {(1, 2)}),
    ],
)
def test_cut_rectangles_by_hand(x, y, corners):
    vertices = box(x, y).vertices()
    assert set(vertices) == corners
    assert len(vertices) == len(corners)  # none twice


def test_vertices_are_in_the_order_of_the_names_wherever_the_pairs_are():
    region = Region(("b", "y", "a", "x"), (7.0, 0.0, 5.0, -1.0), (7.0, 3.0, 6.0, -1.0), (("x", "y"),))
    assert set(region.vertices()) == {(7, y, a, -1) for y in (1, 3) for a in (5, 6)}
    assert [names for names, _ in region.blocks()] == [("b",), ("a",), ("x", "y")]


def test_two_pairs_are_cut_each_for_itself():
    region = Region(("p", "q", "r", "s"), (-1.0, 0.0, -1.0, -1.0), (1.0, 2.0, 1.0, 1.0), (("p", "q"), ("r", "s")))
    first, second = ({(0, 0), (1, 0), (1, 2), (-1, 2), (-1, 1)}, {(1, -1), (1, 1), (-1, 1)})
    assert set(region.vertices()) == {one + other for one in first for other in second}


def test_a_region_without_cuts_is_a_box():
    assert set(box((-2, 2), (-2, 2), cut=False).vertices()) == {(-2, -2), (-2, 2), (2, -2), (2, 2)}


def test_bounds_and_cut_belong_to_the_region():
    region = Region(("a", "x", "y"), (0.0, -2.0, -2.0), (1.0, 2.0, 2.0), (("x", "y"),))
    inside = [(0.0, 1.0, 0.0), (1.0, 1.0, 0.0), (0.5, 2.0, -2.0), (0.5, -1.0, 2.0), (0.5, 0.25, 0.25)]
    outside = [(-0.1, 1.0, 0.0), (1.1, 1.0, 0.0), (0.5, 2.1, 0.0), (0.5, 0.0, 2.1), (0.5, 1.0, -1.1), (0.9, -1.0, 0.5)]
    assert region.contains(np.array(inside + outside)).tolist() == [True] * 5 + [False] * 6
    assert region.contains(np.array([[0.5, np.nan, 1.0]])).tolist() == [False]


def test_a_point_must_be_inside_both_cuts():
    region = Region(("p", "q", "r", "s"), (-1.0,) * 4, (1.0,) * 4, (("p", "q"), ("r", "s")))
    points = np.array([[-1.0, 0.5, 1.0, 1.0], [1.0, 1.0, -1.0, 0.5], [1.0, -1.0, 0.5, 0.5]])
    assert region.contains(points).tolist() == [False, False, True]


def test_half_way_to_a_point_by_hand():
    half = Region(("x", "y"), (-2.0, 0.0), (2.0, 4.0), (("x", "y"),)).scaled(0.5, (1.0, 4.0))
    assert half == Region(("x", "y"), (-0.5, 2.0), (1.5, 4.0), (("x", "y"),))
    quarter = Region(("x",), (0.0,), (8.0,)).scaled(0.25, (4.0,))
    assert (quarter.lower, quarter.upper) == ((3.0,), (5.0,))


def test_rounding_does_not_push_a_bound_outwards():
    # 0.1 + 1.0 * (0.3 - 0.1) is 0.30000000000000004 or so: some of these would leave the region without care.
    rng = np.random.default_rng(8)
    for low, c, high in np.sort(rng.random((300, 3)), axis=1):
        whole = Region(("x",), (float(low),), (float(high),))
        assert whole.scaled(1.0, (float(c),)) == whole


@pytest.mark.parametrize(
    ("s", "centre", "words"),
    [
        (-0.1, (0.0, 1.0, 2.0), "scale is -0.1, expected 0 to 1"),
        (1.1, (0.0, 1.0, 2.0), "scale is 1.1"),
        (0.5, (0.0, 1.0), "expected 3 values"),
        (0.5, (0.0, 1.0, 2.0, 0.0), "expected 3 values"),
        (0.5, (-1.0, 0.7, 2.5), "is not inside x .*, x \\+ y >= 0; expected"),
    ],
)
def test_the_refusal_of_a_part_says_why(s, centre, words):
    with pytest.raises(UsageError, match=words):
        CUT.scaled(s, centre)


def test_a_region_as_text():
    assert str(CUT) == "x [-1.65, 1.6], y [0.61, 6.01], a [2, 3], x + y >= 0"
    assert str(box((0, 1e-7), (1, 1234567), cut=False)) == "x [0, 1e-07], y [1, 1.23457e+06]"


def test_a_place_as_text():
    assert CUT.place((Fraction(1, 3), Fraction(-2), Fraction(5))) == "x = 0.333333, y = -2, a = 5"
    with pytest.raises(ValueError, match="zip"):
        CUT.place((Fraction(1), Fraction(2)))


def test_a_sum_that_can_just_be_zero_is_room_enough():
    assert box((-3, -1), (0, 1)).vertices() == ((-1, 1),)
    assert box((-3, 0.25), (-2, 0.5)).contains(np.array([[0.25, 0.25]])).all()
    with pytest.raises(UsageError, match="x \\+ y is negative in the whole region"):
        box((-3, 2), (-4, -2.5))
    with pytest.raises(UsageError, match="x \\+ y is negative in the whole region"):
        box((-4, -2.5), (-3, 2))


@pytest.mark.parametrize(
    ("names", "lower", "upper", "sums", "words"),
    [
        (("x", "x"), (0.0, 0.0), (1.0, 1.0), (), "every name once"),
        (("x", "y"), (0.0, 0.0), (1.0,), (), "2 names, 2 lower and 1 upper"),
        (("x", "y"), (0.0,), (1.0,), (), "2 names, 1 lower and 1 upper"),
        (("x",), (2.0,), (1.0,), (), "x has the bounds \\[2, 1\\]"),
        (("x",), (-float("inf"),), (1.0,), (), "x has the bounds"),
        (("x",), (0.0,), (float("nan"),), (), "x has the bounds"),
        (("x", "y"), (0.0, 0.0), (1.0, 1.0), (("x", "x"),), "each name in at most one pair"),
        (("x", "y"), (0.0, 0.0), (1.0, 1.0), (("x", "z"),), "expected pairs of the names"),
    ],
)
def test_the_refusal_of_a_region_says_why(names, lower, upper, sums, words):
    with pytest.raises(UsageError, match=words):
        Region(names, lower, upper, sums)

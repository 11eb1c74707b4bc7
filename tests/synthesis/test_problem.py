"""The data of the theorem: exact matrices, and whether vertices prove a region."""

from fractions import Fraction

import numpy as np
import pytest

from lpvobs.errors import UsageError
from lpvobs.synthesis.problem import GainProblem, bent_block
from lpvobs.synthesis.region import Region

LINE = Region(("a",), (1.0,), (2.0,))
SQUARE = Region(("x", "y"), (-1.0, -1.0), (1.0, 1.0), (("x", "y"),))


def scalar(entry, region):
    return GainProblem(lambda p: ([[entry(*p)]], [[1]]), region, 0)


def test_matrices_at_a_point_are_fractions():
    pair = GainProblem(lambda p: ([[-p[0], 2], [0, Fraction(1, 3)]], [[1, 0]]), LINE, 0).at((Fraction(1, 7),))
    assert tuple(matrix.tolist() for matrix in pair) == ([[Fraction(-1, 7), 2], [0, Fraction(1, 3)]], [[1, 0]])
    assert all(isinstance(entry, Fraction) for matrix in pair for row in matrix for entry in row)


def test_matrices_at_the_vertices_are_stacked_in_their_order():
    A, C = GainProblem(lambda p: ([[-p[0], 2], [0, -3]], [[1, 0], [0, p[0]], [0, 0]]), LINE, 1).matrices()
    assert A.tolist() == [[[-1, 2], [0, -3]], [[-2, 2], [0, -3]]]
    assert C.tolist() == [[[1, 0], [0, 1], [0, 0]], [[1, 0], [0, 2], [0, 0]]]
    assert A.dtype == C.dtype == np.float64


@pytest.mark.parametrize(
    ("A", "C", "output", "words"),
    [
        ([], [], 0, "expected a square A"),
        ([], [[]], 0, "expected a square A"),
        ([[-1, 0]], [[1]], 0, "rows of A have \\[2\\] entries and the rows of C \\[1\\]"),
        ([[-1, 0], [0]], [[1, 1]], 0, "rows of A have \\[2, 1\\]"),
        ([[-1]], [[1], [1, 1]], 0, "the rows of C \\[1, 2\\]"),
        ([[-1]], [[1], [1]], 2, "map_output is 2, expected the number of a row of C, 0 to 1"),
        ([[-1]], [[1]], -1, "map_output is -1, expected the number of a row of C, 0 to 0"),
        ([[-1.0]], [[1]], 0, "-1.0 is a float"),
        ([[-1]], [[np.float64(1)]], 0, "is a float64"),
        ([["1"]], [[1]], 0, "'1' is a str"),
    ],
)
def test_the_refusal_of_a_system_says_why(A, C, output, words):
    with pytest.raises(UsageError, match=words):
        GainProblem(lambda _: (A, C), LINE, output).at((Fraction(1),))


@pytest.mark.parametrize("output", [0, 1])
def test_every_row_of_C_may_carry_the_map(output):
    assert GainProblem(lambda _: ([[-1]], [[1], [2]]), LINE, output).at((Fraction(1),))


@pytest.mark.parametrize(
    "entry",
    [lambda x, y: x * y, lambda x, y: x * x, lambda x, y: y * y, lambda x, y: x**3 - y, lambda x, y: 1 / (3 + y)],
)
def test_a_pair_that_is_cut_must_be_affine_together(entry):
    assert bent_block(scalar(entry, SQUARE)) == ("x", "y")


@pytest.mark.parametrize("entry", [lambda x, y: 3 - x + 2 * y, lambda x, y: 7, lambda x, y: x / 3])
def test_affine_systems_are_affine(entry):
    assert bent_block(scalar(entry, SQUARE)) is None


@pytest.mark.parametrize("power", [2, 3, 4, 7])
def test_powers_are_not_affine(power):
    assert bent_block(scalar(lambda a: a**power, LINE)) == ("a",)


def test_products_of_different_blocks_are_affine_in_each():
    region = Region(("x", "y", "z"), (0.0, 1.0, 2.0), (5.0, 6.0, 8.0))
    assert bent_block(scalar(lambda x, y, z: x * y * z - x * z + y, region)) is None
    assert bent_block(scalar(lambda x, y, z: x * y * z * z, region)) == ("z",)
    assert bent_block(scalar(lambda x, y, z: y * y * x, region)) == ("y",)


def test_the_first_bent_block_is_named_and_one_bent_entry_is_enough():
    region = Region(("x", "y"), (0.0, 0.0), (1.0, 1.0))
    assert bent_block(scalar(lambda x, y: x * x + y * y, region)) == ("x",)
    problem = GainProblem(lambda p: ([[-1, p[0]], [p[1], -1]], [[0, p[1] ** 2], [1, 0]]), region, 0)
    assert bent_block(problem) == ("y",)


def test_a_fixed_parameter_cannot_bend_anything():
    region = Region(("x", "a"), (0.0, 3.0), (1.0, 3.0))
    assert bent_block(scalar(lambda x, a: a * a * x, region)) is None


@pytest.mark.parametrize("region", [SQUARE, Region(("x", "y"), (2.0, -5.0), (3.0, 4.0))])
def test_what_is_looked_at_lies_strictly_inside(region):
    seen = []

    def system(point):
        seen.append(point)
        return [[-1]], [[1]]

    assert bent_block(GainProblem(system, region, 0)) is None
    points = np.array(seen, dtype=float)
    assert region.contains(points).all()
    assert (points > region.lower).all()
    assert (points < region.upper).all()
    assert len({tuple(point) for point in seen}) == 1 + 2 * len(region.blocks())  # a start, two points on each line


def test_a_system_that_changes_its_size_is_no_system():
    with pytest.raises(ValueError, match="broadcast"):
        bent_block(GainProblem(lambda p: ([[-1]], [[1]] * (1 if p[0] < Fraction(7, 4) else 2)), LINE, 0))

"""Pivots and products in fractions, against the textbook, floats, and numbers worked out by hand."""

from fractions import Fraction

import numpy as np
import pytest

from lpvobs.synthesis.exact import fractions, product, smallest_pivot


def whole(rows):
    return fractions(rows)


def pivots_by_the_textbook(matrix):
    """LDL^T in fractions, column by column."""
    rest, ratios = [row[:] for row in matrix], []
    for k in range(len(rest)):
        d = rest[k][k]
        ratios.append(d / matrix[k][k])
        if d <= 0:
            break
        for i in range(k + 1, len(rest)):
            factor = rest[i][k] / d
            for j in range(len(rest)):
                rest[i][j] -= factor * rest[k][j]
    return ratios


def test_pivots_are_those_of_the_textbook():
    rng = np.random.default_rng(2)
    for size in (1, 2, 3, 5):
        for _ in range(20):
            root = rng.integers(-9, 10, (size, size + 1))
            matrix = [[Fraction(int(v), 7) for v in row] for row in root @ root.T + np.eye(size, dtype=int)]
            assert smallest_pivot(fractions(matrix)) == pytest.approx(
                float(min(pivots_by_the_textbook(matrix))), rel=1e-15
            )


def test_the_sign_of_pivots_is_that_of_eigenvalues():
    rng = np.random.default_rng(3)
    verdicts = set()
    for _ in range(200):
        root = rng.standard_normal((3, 3))
        matrix = root + root.T + 2.0 * np.eye(3)
        positive = smallest_pivot(fractions(matrix)) > 0
        assert positive == (np.linalg.eigvalsh(matrix).min() > 0)  # random: never within rounding of zero
        verdicts.add(positive)
    assert verdicts == {True, False}


def test_what_floats_cannot_see_is_seen():
    hilbert = [[Fraction(1, i + j + 1) for j in range(15)] for i in range(15)]
    assert smallest_pivot(fractions(hilbert)) > 0
    assert np.linalg.eigvalsh(np.array(hilbert, dtype=float)).min() < 1e-16  # floats cannot tell
    ulp = Fraction(1, 2**200)
    assert smallest_pivot(fractions([[Fraction(1), Fraction(1)], [Fraction(1), 1 + ulp]])) > 0
    assert smallest_pivot(fractions([[Fraction(1), Fraction(1)], [Fraction(1), Fraction(1)]])) <= 0
    assert smallest_pivot(fractions([[Fraction(1), Fraction(1)], [Fraction(1), 1 - ulp]])) <= 0
    assert smallest_pivot(fractions([[Fraction(0)]])) <= 0


@pytest.mark.parametrize(
    ("matrix", "smallest"),
    [
        ([[1]], 1.0),
        ([[Fraction(1, 3)]], 1.0),
        ([[2, 1], [1, 1]], 0.5),  # 1 - 1/2
        ([[4, 2, 0], [2, 5, 2], [0, 2, 4]], 0.75),  # 1, 4/5 and (4 - 1)/4
        ([[1, 1], [1, 1]], 0.0),
        ([[1, 1], [1, Fraction(2, 3)]], -0.5),  # -1/3 over 2/3
        ([[1, 2], [2, 1]], -1.0),  # -3, cut off at -1
        ([[0]], -1.0),
        ([[1, 0], [0, -7]], -1.0),
    ],
)
def test_pivots_by_hand(matrix, smallest):
    assert smallest_pivot(whole(matrix)) == smallest


def test_a_positive_pivot_beyond_all_floats_does_not_read_as_zero():
    assert smallest_pivot(
        fractions([[Fraction(1), Fraction(1)], [Fraction(1), 1 + Fraction(1, 2**1200)]])
    ) == np.nextafter(0, 1)


def test_a_negative_pivot_beyond_all_floats_is_minus_one():
    assert smallest_pivot(fractions([[Fraction(1), Fraction(2**1200)], [Fraction(2**1200), Fraction(1)]])) == -1.0


def test_examining_a_matrix_leaves_it_as_it_was():
    matrix = whole([[2, 1], [1, 1]])
    smallest_pivot(matrix)
    assert matrix.tolist() == [[2, 1], [1, 1]]


def test_a_product_by_hand():
    assert product(whole([[1, 2, 3], [4, 5, 6]]), whole([[1, 0], [-1, 2], [0, 3]])).tolist() == [[-1, 13], [-1, 28]]
    assert product(whole([[0, 2]]), whole([[0], [5]])).tolist() == [[10]]


@pytest.mark.parametrize(("left", "right"), [([[1, 2]], [[1]]), ([[1, 2]], [[1], [2], [3]])])
def test_what_does_not_fit_is_not_cut_to_fit(left, right):
    with pytest.raises(ValueError, match="mismatch"):
        product(whole(left), whole(right))


def test_floats_become_the_fractions_that_they_are():
    assert fractions(np.array([[0.1, 0.5]])).tolist() == [[Fraction(3602879701896397, 2**55), Fraction(1, 2)]]

"""Gains of products to first order, against least squares."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy

from lpvobs.discovery.form_gains import Lot

P = 60


@pytest.fixture
def known():
    """Return unknowns, a residual, two bases and three shapes, one of them far from zero."""
    rng = np.random.default_rng(5)
    unknowns, bases = rng.standard_normal((P, 3)), rng.uniform(1.0, 2.0, (2, P))
    shapes = rng.standard_normal((3, P)) + np.array([[0.0], [2.0], [80.0]])
    return unknowns, rng.standard_normal(P), bases, shapes


def lot_of(unknowns, residual):
    factor = np.linalg.cholesky(unknowns.T @ unknowns)
    step = scipy.linalg.cho_solve((factor, True), unknowns.T @ residual)
    nodes = scipy.sparse.csr_array(unknowns[:, :1])
    return Lot(SimpleNamespace(factor=factor, newton_step=step), residual, np.ones(P), unknowns[:, 1:], nodes)


def half_of_squares(residual, *columns):
    A = np.column_stack(columns)
    return 0.5 * float(np.sum((residual - A @ np.linalg.lstsq(A, residual)[0]) ** 2))


@pytest.mark.parametrize("many", [1, 2])
def test_gains_are_those_of_least_squares(known, many):
    unknowns, residual, bases, shapes = known
    alone, referred = lot_of(unknowns, residual).gains(bases[:many], shapes)
    before = half_of_squares(residual, unknowns)
    assert len(referred) == many
    for i, shape in enumerate(shapes):
        product = shape * bases[0]
        assert alone[i] == pytest.approx(before - half_of_squares(residual, unknowns, product))
        for n, (gain, references) in enumerate(referred, start=1):
            free = before - half_of_squares(residual, unknowns, product, *bases[:n])
            assert gain[i] == pytest.approx(free)
            # one coefficient is enough once the references are known
            assert before - half_of_squares(
                residual, unknowns, product - references[:, i] @ bases[:n]
            ) == pytest.approx(free)


def test_what_is_shown_beside_the_base_is_in_units_of_its_noise(known):
    unknowns, residual, bases, shapes = known
    shown = lot_of(unknowns, residual).beside(bases[0], shapes)
    without = half_of_squares(residual, unknowns, bases[0])
    gains = [without - half_of_squares(residual, unknowns, bases[0], shape * bases[0]) for shape in shapes]
    assert 0.5 * shown**2 == pytest.approx(np.array(gains))


def test_a_product_that_the_unknowns_contain_gains_nothing(known):
    """Rounding alone is left of it, and a gain over rounding may be anything."""
    unknowns, residual, bases, shapes = known
    shapes[1] -= shapes[1].mean()
    contained = lot_of(np.column_stack([shapes[1] * bases[0], unknowns[:, 1:]]), residual)
    alone, ((one, _), (two, _)) = contained.gains(bases, shapes)
    assert alone[1] == one[1] == two[1] == 0.0
    assert np.isnan(contained.beside(bases[0], shapes)[1])
    assert min(alone[0], one[0], two[0]) > 0.0

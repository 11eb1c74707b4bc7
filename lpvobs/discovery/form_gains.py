"""What a form gains to first order: a direction of the residual times any function of the places, many functions at once."""

from dataclasses import dataclass

import numpy as np
import scipy

from lpvobs.discovery import thresholds
from lpvobs.discovery.linear import Linear
from lpvobs.records import Array

SINGULAR = 1e-9  # [1] determinant of a scaled matrix below which rounding may decide


@dataclass(frozen=True)
class Lot:
    """What is needed of a direction g to know the gain of g times any function of the P pools of places."""

    linear: Linear
    residual: Array  # (P,) product with the residual
    power: Array  # (P,) with itself
    columns: Array  # (P, q) with the unknowns beside the map
    nodes: "scipy.sparse.csr_array"  # (P, p) with the map

    def gains(self, bases: Array, shapes: Array) -> tuple[Array, list[tuple[Array, Array]]]:
        """Return what every shape times the first of n bases gains, (M,), and with a reference for this base, for two, up to all.

        With k references that is a gain, (M,), and the references, (k, M). A base times its reference is taken off the product.
        """
        middle = shapes.mean(1)
        rows = self._rows(bases, shapes - middle[:, None])  # about its mean, a shape differs from a constant
        return rows.alone(middle), [rows.referred(middle, n) for n in range(1, len(bases) + 1)]

    def beside(self, y: Array, shapes: Array) -> Array:
        """Return every shape times y beside y, (M,), in standard deviations of noise; NaN where the drive cannot tell them."""
        _, steep, free = self._rows(y[None], shapes - shapes.mean(1, keepdims=True)).beside(1)
        return np.where(np.isfinite(free), steep / np.sqrt(free), np.nan)

    def _rows(self, bases: Array, shapes: Array) -> "Directions":
        rows, n = np.vstack([bases, shapes * bases[0]]), len(bases)
        products = np.hstack([self.nodes.T.dot(rows.T).T, rows @ self.columns])
        white = scipy.linalg.solve_triangular(self.linear.factor, products.T, lower=True, check_finite=False)
        slope, before = rows @ self.residual - products @ self.linear.newton_step, (bases * self.power) @ rows.T
        own = rows[n:] ** 2 @ self.power
        return Directions(slope, before - white[:, :n].T @ white, own - (white[:, n:] ** 2).sum(0), before, own)


@dataclass(frozen=True)
class Directions:
    """Gradient and normal matrix of n bases, and of M products of shapes with the first one."""

    slope: Array  # (n + M,)
    of_bases: Array  # (n, n + M) the bases' rows of the matrix, all unknowns free
    own: Array  # (M,) the rest of its diagonal
    of_bases_before: Array  # (n, n + M) the same with all unknowns known
    own_before: Array  # (M,)

    def alone(self, middle: Array) -> Array:
        """Return the gain of every product and as many times the base as the shape has been moved, (M,)."""
        n = len(self.of_bases)
        pairs = (self.own, self.of_bases), (self.own_before, self.of_bases_before)
        left = _seen(*(own + 2.0 * middle * base[0, n:] + middle**2 * base[0, 0] for own, base in pairs))
        return np.asarray(0.5 * (self.slope[n:] + middle * self.slope[0]) ** 2 / left)

    def referred(self, middle: Array, n: int) -> tuple[Array, Array]:
        """Return the gain of every product with a reference for each of the first n bases, (M,), and these, (n, M)."""
        taken, steep, free = self.beside(n)
        size = -steep / free
        with np.errstate(divide="ignore", invalid="ignore"):
            references = (taken[:, :1] + taken[:, 1:] * size) / size
            references[0] += middle
            gain = 0.5 * (self.slope[:n] @ taken[:, 0] + steep**2 / free)
            return np.where(np.isfinite(references).all(0), gain, 0.0), np.nan_to_num(references)

    def beside(self, n: int) -> tuple[Array, Array, Array]:
        """Return the step of each of the first n bases, alone and for every product, (n, 1 + M), and what is left of these.

        That is slope and information beside the bases, (M,). The information is infinite where the drive cannot tell a product.
        """
        first, known, cross = len(self.of_bases), self.of_bases[:n, :n], self.of_bases[:n, len(self.of_bases) :]
        scale = np.sqrt(_seen(known.diagonal(), self.of_bases_before[:n, :n].diagonal()))
        if not (np.isfinite(scale).all() and np.linalg.det(known / np.outer(scale, scale)) > SINGULAR):
            return np.zeros((n, 1 + self.own.size)), np.zeros(self.own.size), np.full(self.own.size, np.inf)
        taken = np.asarray(np.linalg.solve(known, np.column_stack([self.slope[:n], cross])), dtype=float)
        left = _seen(self.own, self.own_before)
        steep, free = self.slope[first:] - taken[:, 0] @ cross, left - (cross * taken[:, 1:]).sum(0)
        return taken, np.asarray(steep), _seen(free, left)


def _seen(left: Array, own: Array) -> Array:
    """Return the information of directions with all unknowns free, infinite where the drive cannot tell them."""
    return np.asarray(np.where(left > thresholds.FORM_SEEN * np.abs(own), left, np.inf))

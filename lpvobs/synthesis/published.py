"""The paper's own numbers: bounds, gain, and the range of a_1/a_2 in which that gain can work at all."""

from collections.abc import Callable
from typing import Literal

import numpy as np

from lpvobs.errors import UsageError
from lpvobs.records import Array
from lpvobs.synthesis.gain import hurwitz_at_vertices
from lpvobs.synthesis.problem import Problem

Column = Literal["ETC", "FTP75", "NEDC"]
Bounds = tuple[tuple[float, float], ...]

# Table 1: bounds of rho_1..rho_5 [SI]. FTP75, rho_1 is printed [146, 110] x 1e-7, the lower bound above the upper one:
# read here as [46, 110].
TABLE_1: dict[Column, Bounds] = {
    "ETC": ((19e-7, 150e-7), (-1.65e-7, 1.6e-7), (1.09e-7, 6.4e-7), (0.61e-7, 6.01e-7), (0.0, 3.15)),
    "FTP75": ((46e-7, 110e-7), (-0.56e-7, 1.15e-7), (1.18e-7, 6e-7), (0.75e-7, 5.4e-7), (0.0, 2.78)),
    "NEDC": ((49e-7, 130e-7), (-0.003e-7, 1.0e-7), (1.1e-7, 5.4e-7), (0.62e-7, 4.7e-7), (0.0, 2.67)),
}
EPSILON = (0.25, 0.11)  # eps_1, eps_2 of Sec. 4
OUTPUTS = ("p_im", "omega_t", "W_maf")  # Eq. (6): the columns of L


def published_gain() -> Array:
    """Return L of Eq. (38), shape (3, 3); states p_im, p_em, omega_t, outputs as in `OUTPUTS`."""
    return np.array([[1635.83, -124.95, 6.52e-7], [-16063.4, 3135.43, 1.67e-7], [4.2, 29.7, 4.55e-20]])


def hull() -> Bounds:
    """Return the smallest box around the three columns of Table 1."""
    columns = zip(*TABLE_1.values(), strict=True)
    return tuple((min(low for low, _ in rho), max(high for _, high in rho)) for rho in columns)


def hurwitz_interval(
    problem_at: Callable[[float], Problem], L: Array, inside: float, *, reach: float = 100.0, resolution: float = 1e-4
) -> tuple[float, float]:
    """Return the interval of one number around `inside` in which A - L C is Hurwitz at every vertex.

    Parameters
    ----------
    problem_at : callable
        The problem for a value of that number, for example the ratio a_1/a_2 with a_2 at rest.
    L : ndarray, shape (n, r)
    inside : float
        A value where it is Hurwitz; positive.
    reach : float
        How far to look: from inside/reach to inside times reach. Where no limit lies in between, that end is returned.
    resolution : float
        Relative accuracy of the limits.

    Raises
    ------
    UsageError
        It is not Hurwitz at `inside`.

    Notes
    -----
    Eigenvalues in floating point at the vertices: what no gain may fail, not a proof of stability.
    """
    if not hurwitz_at_vertices(problem_at(inside), L):
        raise UsageError(f"gain: A - L C is not Hurwitz at {inside:g}; expected a value inside the interval looked for")

    def limit(good: float, bad: float) -> float:
        if hurwitz_at_vertices(problem_at(bad), L):
            return bad
        while abs(np.log(bad / good)) > resolution:
            middle = float(np.sqrt(good * bad))
            good, bad = (middle, bad) if hurwitz_at_vertices(problem_at(middle), L) else (good, middle)
        return good

    return limit(inside, inside / reach), limit(inside, inside * reach)

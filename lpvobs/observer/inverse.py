"""Inverses of small matrices, for neighbouring samples side by side, without pivots.

Faddeev and LeVerrier: with T_1 = M - tr(M) I and T_p = M T_p-1 - tr(M T_p-1) / p I, the last one, T_n-1, is the inverse of M up to
a factor; for three states the nine cofactors give the same in half the time. There is no pivot to choose, so all samples take the
same way and the processor does several at a time. Units do not matter: another unit of a state multiplies its row and divides its
column, all along, where elimination would have to compare pascals with radians per second. Rounding grows with the power n - 2 of
the ratio of the largest over the smallest eigenvalue of M: in a step of the observer this is the fastest rate times the step, some
hundreds for 20 000 1/s at 10 ms.
"""

from lpvobs.compiled import njit
from lpvobs.records import Array

ROW = 256
"""Samples whose matrices are inverted side by side: few enough that they stay in the cache nearest to the processor."""


@njit(cache=True)
def invert(states: tuple[float, ...], M: Array, T: Array, spare: Array, t: Array) -> tuple[Array, Array]:
    """Return the inverses of the matrices M[:, :, k], and the room that is left over.

    Of `states` only the length n is read: to the compiler it is a constant, and the loops over it are unrolled. T and `spare`,
    shape (n, n, ROW) like M, and t, shape (ROW,), are written to; one of the former is returned with the inverses.
    """
    n = len(states)
    if n == 3:
        _cofactors(M, T)
    else:
        T, spare = _up_to_a_factor(states, M, T, spare, t)
    for k in range(ROW):  # the first row of M times the first column of T is the factor
        factor = 0.0
        for m in range(n):
            factor += M[0, m, k] * T[m, 0, k]
        t[k] = 1.0 / factor
    for i in range(n):
        for j in range(n):
            row = T[i, j]
            for k in range(ROW):
                row[k] *= t[k]
    return T, spare


@njit(cache=True)
def _cofactors(M, T):  # type: ignore[no-untyped-def]
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            c, d = (j + 1) % 3, (j + 2) % 3
            row = T[j, i]
            for k in range(ROW):
                row[k] = M[a, c, k] * M[b, d, k] - M[a, d, k] * M[b, c, k]


@njit(cache=True)
def _up_to_a_factor(states, M, T, spare, t):  # type: ignore[no-untyped-def]
    n = len(states)
    T[:] = M
    if n == 1:
        T[0, 0] = 1.0
    for p in range(1, n):
        if p > 1:
            product(states, M, T, spare)
            T, spare = spare, T
        for k in range(ROW):
            trace = 0.0
            for i in range(n):
                trace += T[i, i, k]
            t[k] = trace / p
        for i in range(n):
            row = T[i, i]
            for k in range(ROW):
                row[k] -= t[k]
    return T, spare


@njit(cache=True)
def product(states, M, T, out):  # type: ignore[no-untyped-def]
    """Fill out = M T for samples side by side; T and out may have fewer columns than M."""
    n = len(states)
    for i in range(n):
        for j in range(T.shape[1]):
            row = out[i, j]
            for k in range(ROW):
                total = 0.0
                for m in range(n):
                    total += M[i, m, k] * T[m, j, k]
                row[k] = total

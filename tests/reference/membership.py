"""Psi(v) by membership functions over every interval, Eq. (14)-(23), with the subscripts put right.

u_delta has p_1 nodes, n_e has p_2. The printed Eq. (19) swaps them, and its last row divides by n^(p2-1) - n^(p2-1); here the
last row holds the last interval's rising weight and the half-line beyond it.
"""

from itertools import pairwise

import numpy as np


def membership(nodes, value):
    """Return delta^0 .. delta^p of Eq. (16), (17): exactly one is 1, intervals open on the left, closed on the right."""
    edges = [-np.inf, *nodes, np.inf]
    return [1.0 if low < value <= high else 0.0 for low, high in pairwise(edges)]  # Eq. (16), Eq. (17)


def psi_axis(nodes, value):
    """Return Psi_u or Psi_n of Eq. (21), (19): one weight per node of one axis."""
    p = len(nodes)
    delta = membership(nodes, value)
    psi = np.zeros(p)
    psi[0] += delta[0]
    psi[p - 1] += delta[p]
    for i in range(p - 1):
        width = nodes[i + 1] - nodes[i]
        psi[i] += delta[i + 1] * (nodes[i + 1] - value) / width  # Eq. (19), Eq. (21)
        psi[i + 1] += delta[i + 1] * (value - nodes[i]) / width  # Eq. (19), Eq. (21)
    return psi


def psi(u_nodes, n_nodes, u_delta, n_e):
    """Return Psi(v) of Eq. (23), shape (p,): the speed weights times a block-diagonal of the fuel weights."""
    blocks = np.kron(np.eye(len(n_nodes)), psi_axis(u_nodes, u_delta))
    return psi_axis(n_nodes, n_e) @ blocks  # Eq. (23)


def gram(u_nodes, n_nodes, u_delta, n_e, time):
    """Return the integral of Psi^T Psi of Eq. (29) by plain loops, each sample standing for the step that leads to it."""
    p = len(u_nodes) * len(n_nodes)
    total = np.zeros((p, p))
    for k in range(1, len(time)):
        row = psi(u_nodes, n_nodes, u_delta[k], n_e[k])
        for a in range(p):
            for b in range(p):
                total[a, b] += (time[k] - time[k - 1]) * row[a] * row[b]
    return total

"""Flow and power of a turbine behind which the exhaust may be restricted, and what a fault makes of one that is not its model."""

from math import sqrt

import numpy as np

from lpvobs.compiled import njit
from lpvobs.engines.diesel import relations as relation
from lpvobs.engines.diesel.constants import DieselConstants
from lpvobs.engines.kept import Kept
from lpvobs.records import Array

TURBINE_INPUTS = ("u_vgt", "p_em", "omega_t", "T_em", "p_amb")  # what flow and power depend on
RESTRICTED = 0.5
"""Change of the back pressure's coefficient from which on its solution counts in full; without one, three passes are near."""
OTHER = (0.5, 2.0)
"""Least and largest area and power of a turbine over those of its model, as what a healthy engine leaves tells them. On idle a
balance leaves more than all that the turbine gives."""
EXACT = 1e-8  # [1] Step of a ratio after which Newton's next one is rounding
POWER = 1.0e5  # [J/kg] Turns a power into a flow, so that all balances are in kg/s


@njit(cache=True)
def turbine(c: DieselConstants, k_exhaust: Array, x: Array, wider: Array) -> tuple[Array, Array]:
    """Return W_t [kg/s] and Pi_t, shape (K,), with a back pressure p_amb + k_exhaust W_t^2 of its own.

    `x` is (5, K) in the order of `TURBINE_INPUTS`, `wider` is the turbine's area over that of the model.
    """
    # The engine's model makes three passes of the fixed point, `relation.turbine_pass`, and so is a clean exhaust here. All
    # places make one pass before the next: no place waits for its own power. With a restriction the passes swing around
    # the solution, or away from it: the more there is of it, the more the solution counts.
    u_vgt, p_em, _, T_em, p_amb = x
    K = p_em.size
    scale, W_t, Pi_t = np.empty(K), np.zeros(K), np.zeros(K)
    solved = np.minimum(np.abs(k_exhaust / c.k_exhaust - 1.0) / RESTRICTED, 1.0)
    for k in range(K):
        scale[k] = wider[k] * relation.turbine_scale(c, u_vgt[k], T_em[k])
    for _ in range(3):
        for k in range(K):
            if solved[k] < 1.0:
                Pi_t[k] = min((p_amb[k] + k_exhaust[k] * W_t[k] * W_t[k]) / p_em[k], 0.9999)
                W_t[k] = scale[k] * sqrt(1.0 - Pi_t[k] ** c.K_t) * p_em[k]
    for k in range(K):
        if solved[k] > 0.0:
            solution = expansion(p_amb[k] / p_em[k], k_exhaust[k] * scale[k] * scale[k] * p_em[k], c.K_t)
            Pi_t[k] += solved[k] * (solution - Pi_t[k])
            W_t[k] = scale[k] * sqrt(1.0 - Pi_t[k] ** c.K_t) * p_em[k]
    return W_t, Pi_t


@njit(cache=True)
def left_by_turbine(c: DieselConstants, x: Array, lacks: Array, left: Array) -> Array:
    """Return how what a healthy engine leaves of exhaust and turbo changes with what the engine lacks, shape (2, K) [kg/s].

    `x` is (5, K) in the order of `TURBINE_INPUTS`, `lacks` the power and the restriction of the turbine over those in order.
    A fault changes the turbine that healthy drives show. What the exhaust leaves counts as the flow that it swallows beyond its
    model, what the turbo leaves as the power that it lacks. That is an assumption: the flows of cylinders, EGR and compressor
    have balances of their own, the compressor's power has none.
    """
    out, at = np.zeros((2, x.shape[1])), np.flatnonzero((lacks[0] != 1.0) | (lacks[1] != 1.0))
    x, lacks, flow_left, power_left = x[:, at], lacks[:, at], left[0, at], left[1, at]
    own_area, clean = np.ones(at.size), np.full(at.size, c.k_exhaust)
    W_t, P_t = flow_and_power(c, clean, x, own_area)
    healthy = np.empty(at.size)
    for k in range(at.size):
        healthy[k] = min(max(P_t[k] - POWER * power_left[k], OTHER[0] * P_t[k]), OTHER[1] * P_t[k])
        out[1, at[k]] = (lacks[0, k] - 1.0) * (P_t[k] - healthy[k]) / POWER
    if (lacks[1] == 1.0).all():
        return out
    restricted, wider = c.k_exhaust * lacks[1], np.ones(at.size)
    for k in range(at.size):
        if W_t[k] > 0.0:
            wider[k] = min(max(1.0 + flow_left[k] / W_t[k], OTHER[0]), OTHER[1])
    (W_own, P_own), (W_now, P_now) = flow_and_power(c, clean, x, wider), flow_and_power(c, restricted, x, wider)
    W_lacking, P_lacking = flow_and_power(c, restricted, x, own_area)
    for k in range(at.size):
        flow = W_now[k] / W_own[k] if W_own[k] > 0.0 else 1.0
        power = P_now[k] / P_own[k] if P_own[k] > 0.0 else 1.0
        change = healthy[k] * (lacks[0, k] * power - 1.0)
        out[0, at[k]] = W_t[k] * (1.0 + wider[k] * (flow - 1.0)) - W_lacking[k]
        out[1, at[k]] = (lacks[0, k] * P_lacking[k] - P_t[k] - change) / POWER
    return out


@njit(cache=True)
def flow_and_power(c: DieselConstants, k_exhaust: Array, x: Array, wider: Array) -> tuple[Array, Array]:
    """Return W_t [kg/s] and the turbine's power [W], shape (K,), as `turbine` does."""
    W_t, Pi_t = turbine(c, k_exhaust, x, wider)
    P_t = np.empty(W_t.size)
    for k in range(W_t.size):
        P_t[k] = relation.turbine_power(c, W_t[k], Pi_t[k], x[2, k], x[3, k])
    return W_t, P_t


@njit(cache=True)
def expansion(ambient: float, strength: float, K_t: float) -> float:
    """Return the ratio P with P = ambient + strength (1 - P^K_t): Newton's method, from below where it stays and converges."""
    P = min(ambient, 0.9999)
    for _ in range(5):
        power = P**K_t
        step = (ambient + strength * (1.0 - power) - P) / (1.0 + strength * K_t * power / P)
        P += step
        if abs(step) < EXACT:
            break
    return min(P, 0.9999)


def _restricted(c: DieselConstants, x: Array, restriction: Array) -> tuple[Array, Array]:
    return turbine(c, c.k_exhaust * restriction, x, np.ones(restriction.size))


# Most effects leave what the turbine depends on as it is.
turbine_as_modelled = Kept(_restricted)
"""Returns W_t and Pi_t as `turbine` does, of one as modelled, from its inputs and the restriction over that in order, (K,)."""
left_again = Kept(left_by_turbine)
"""Returns what `left_by_turbine` does."""

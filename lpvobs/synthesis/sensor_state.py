"""One more state: a sensor that follows the flow with a lag, and the proof that the observer with it is stable.

    tau dW_m/dt = C_2 x + Psi theta - W_m,    y = W_m:

where a sensor is slow, the flow is no output any more but drives a state of its own, and the gain of Eq. (26) gets a row and a
column. The sensor corrects that state alone (gain l), so the states before it do not hear of the map, as in the cascade without.

Proven is, in exact rational arithmetic and at every vertex of the region times the range of 1/tau, that V = e^T P_4 e with
P_4 = diag(P, k) falls along the errors of the four states while the map stands. Departure from the paper: Theorem 1 has the map in
an output; here it stands in a state equation, where its error acts like an input, and the map is what is estimated from that.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated

import numpy as np

from lpvobs.errors import NotProven
from lpvobs.records import Array, Item
from lpvobs.synthesis.certificate import Gain
from lpvobs.synthesis.exact import Matrix, falling, fractions, product, smallest_pivot
from lpvobs.synthesis.problem import GainProblem


@dataclass(frozen=True, eq=False)
class SensorState:
    """The gain of the observer with the sensor's state, and its proof.

    The last column of L, shape (n + 1, r), is the sensor's, zero but for the last row. The pivots are those of P and of all
    matrices -dV, relative to their diagonals.
    """

    L: Annotated[
        Array, Item("SI", "gain of the observer whose states include the sensor's reading", ("state", "output"))
    ]
    P: Annotated[
        Array,
        Item("SI", "matrix of the Lyapunov function, which decreases at a constant map", ("state", "other_state")),
    ]
    tau: Annotated[
        tuple[float, float], Item("s", "smallest and largest time constant of the sensor in the proof", ("end",))
    ]
    vertices: Annotated[int, Item("1", "number of vertices at which the decrease was proven")]
    smallest_pivot: Annotated[float, Item("1", "smallest pivot over its diagonal entry")]


def with_sensor_state(problem: GainProblem, gain: Gain, tau: tuple[float, float], correction: float) -> SensorState:
    """Return the gain for four states, proven for time constants tau [s] from the smallest to the largest.

    Problem and gain are those of the observer without the sensor's state; `map_output` is the flow that drives the sensor, and
    the correction l [1/s] is not negative. Raises NotProven if the gain is no cascade, or no k makes V fall.
    """
    if np.any(gain.L[:, problem.map_output] != 0.0):
        raise NotProven(
            "gain: the innovation of the air flow sensor corrects the state; set cascade = true in [gain] "
            "and synthesise the gain again"
        )
    n, r = gain.L.shape
    L = np.zeros((n + 1, r))
    L[:n], L[n, problem.map_output] = gain.L, correction
    k = _weight(problem, gain, 1.0 / tau[0], correction)
    P = np.zeros((n + 1, n + 1))
    P[:n, :n], P[n, n] = gain.P, k
    return prove(problem, L, P, tau)


def prove(problem: GainProblem, L: Array, P: Array, tau: tuple[float, float]) -> SensorState:
    """Return the proof for given numbers; raises NotProven where it fails. Needs no solver."""
    exact_P = fractions(P)
    Y = product(exact_P, fractions(L))
    smallest, count = smallest_pivot(exact_P), 0
    for vertex in problem.region.vertices():
        for slowness in (Fraction(1.0 / tau[1]), Fraction(1.0 / tau[0])):
            A, C = augmented(problem, vertex, slowness)
            smallest, count = min(smallest, smallest_pivot(falling(exact_P, Y, A, C))), count + 1
            if smallest <= 0:
                place = problem.region.place(vertex)
                raise NotProven(
                    f"sensor state: the Lyapunov function does not decrease at {place} with tau = {1.0 / float(slowness):.4g} s, "
                    f"so the observer that includes the sensor's lag is not proven there"
                )
    return SensorState(L, P, tau, count, smallest)


def augmented(problem: GainProblem, vertex: Sequence[Fraction], slowness: Fraction) -> tuple[Matrix, Matrix]:
    """Return A and C of the four states, exactly; `slowness` is 1/tau."""
    A, C = problem.at(vertex)
    (r, n), m = C.shape, problem.map_output
    larger, outputs = np.zeros((n + 1, n + 1), dtype=object), np.zeros((r, n + 1), dtype=object)
    larger[:n, :n], larger[n, :n], larger[n, n] = A, slowness * C[m], -slowness
    outputs[:, :n], outputs[m, :n], outputs[m, n] = C, 0, 1
    return larger, outputs


def _weight(problem: GainProblem, gain: Gain, slowness: float, correction: float) -> float:
    """Return k: half of what the Schur complement allows at the worst vertex, in floats; the proof does not rely on them."""
    # The fastest sensor is the worst: what drives it grows with the square of 1/tau, what calms it with 1/tau + l.
    A, C = problem.matrices()
    half = gain.P @ (A - gain.L @ C)
    falls = -(half + half.swapaxes(1, 2))
    drive = C[:, problem.map_output, :]
    pushed = np.einsum("ni,nij,nj->n", drive, np.linalg.inv(falls), drive)
    worst = float(pushed.max()) * slowness**2 / (2.0 * (slowness + correction))
    return 0.5 / max(worst, 1e-300)

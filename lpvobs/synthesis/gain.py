"""The observer's gain with its proof."""

from dataclasses import dataclass
from typing import Annotated

from lpvobs.records import Array, Item
from lpvobs.synthesis.bound import StateBound
from lpvobs.synthesis.certificate import Certificate
from lpvobs.synthesis.region import Region


@dataclass(frozen=True, eq=False)
class Gain:
    """A feedback gain of Eq. (26) and the numbers that prove it.

    The certificate is proven, on the region; a gain without a proof is not made.
    """

    L: Annotated[Array, Item("SI", "gain of Eq. (26), state unit per output unit and second", ("state", "output"))]
    P: Annotated[Array, Item("SI", "Lyapunov matrix of Theorem 1", ("state", "other_state"))]
    Q: Annotated[Array, Item("SI", "matrix Q of Theorem 1", ("state", "other_state"))]
    eps_1: Annotated[float, Item("1", "eps_1 of Theorem 1")]
    eps_2: Annotated[float, Item("1", "eps_2 of Theorem 1")]
    region: Region
    certificate: Annotated[Certificate, Item()]
    # proven, on the error of the state; None where the comparison matrix allows none
    bound: Annotated[StateBound | None, Item(name="state_bound")] = None

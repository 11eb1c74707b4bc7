"""The observer's gain with its proof."""

from dataclasses import dataclass

from lpvobs.records import Array
from lpvobs.synthesis.certificate import Certificate
from lpvobs.synthesis.region import Region


@dataclass(frozen=True, eq=False)
class Gain:
    """A feedback gain of Eq. (26) and the numbers that prove it.

    Attributes
    ----------
    L : ndarray, shape (n, r)
        [state unit / (output unit s)]
    P, Q : ndarray, shape (n, n)
        Of Theorem 1.
    eps_1, eps_2 : float
        Of Theorem 1.
    region : Region
        What the certificate covers.
    certificate : Certificate
        Proven; a gain without a proof is not made.
    """

    L: Array
    P: Array
    Q: Array
    eps_1: float
    eps_2: float
    region: Region
    certificate: Certificate

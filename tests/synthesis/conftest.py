"""The diesel of Eq. (5) and (25), written down once more for the tests of the gain."""

from collections.abc import Callable

import pytest

from lpvobs.engines.diesel.published import PUBLISHED
from lpvobs.synthesis.problem import GainProblem
from lpvobs.synthesis.region import Region

R_A, R_E, V_IM, V_EM = 287.0, 286.0, 5e-3, 1.5e-3
NAMES = ("rho_1", "rho_2", "rho_3", "rho_4", "rho_5", "a_1", "a_2")


def diesel_system(outputs):
    def system(parameters):
        r1, r2, r3, r4, r5, a_1, a_2 = parameters
        A = [[-a_1 * r3, a_1 * r2, a_1 * r1], [a_2 * r3, -a_2 * r2 - a_2 * r4, 0], [0, 0, -r5]]
        rows = {"p_im": [1, 0, 0], "p_em": [0, 1, 0], "omega_t": [0, 0, 1], "W_maf": [0, 0, r1]}
        return A, [rows[name] for name in outputs]

    return system


@pytest.fixture(scope="session")
def diesel() -> Callable[..., GainProblem]:
    """Return a function that makes the diesel's problem for a column of Table 1 and ranges of temperature [K]."""

    def make(column, T_im=(310.0, 310.0), T_em=(750.0, 750.0), *, p_em=False, clipped=False, V_em=V_EM) -> GainProblem:
        bounds = PUBLISHED.bounds["ETC" if column == "hull" else column]  # that column holds the others
        a_1, a_2 = (tuple(R_A * T / V_IM for T in T_im), tuple(R_E * T / V_em for T in T_em))
        lower, upper = zip(*bounds, a_1, a_2, strict=True)
        outputs = ("p_im", "p_em", "omega_t", "W_maf") if p_em else ("p_im", "omega_t", "W_maf")
        region = Region(NAMES, lower, upper, (("rho_2", "rho_4"),) if clipped else ())
        return GainProblem(diesel_system(outputs), region, len(outputs) - 1)

    return make

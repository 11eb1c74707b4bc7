"""The same synthesis and certificate serve the throttled engine."""

from functools import partial

import numpy as np

from lpvobs.engines.throttled.lpv import Throttled
from lpvobs.synthesis.certificate import check
from lpvobs.synthesis.problem import GainProblem
from lpvobs.synthesis.region import Region
from lpvobs.synthesis.solve import synthesise

OUTPUTS = ("p_ic", "p_im")


def test_a_gain_for_the_throttled_engine_is_proven_over_its_whole_region():
    region = Region(Throttled.parameter_names, (5e-9, 2e-8, 1.0e7, 1.4e7), (1.2e-6, 6e-7, 4.4e7, 5.9e7))
    problem = GainProblem(partial(Throttled.system, outputs=OUTPUTS), region, len(OUTPUTS))
    gain = synthesise(problem, cascade=True, decay=1.0)
    assert gain.certificate.proven
    assert not gain.L[:, -1].any()  # the sensor does not correct the state
    again = check(problem, gain.L, gain.P, gain.Q, gain.eps_1, gain.eps_2)
    assert again.proven
    for vertex in region.vertices():
        A, C = (np.array(rows, dtype=float) for rows in problem.at(vertex))
        assert np.linalg.eigvals(A - gain.L @ C).real.max() < -1.0

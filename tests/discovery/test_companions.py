"""A second effect is told from what the first one leaves because its formula is not quite the cause's."""

from dataclasses import replace

import numpy as np
import pytest

from lpvobs.discovery.fit import fit
from lpvobs.discovery.residual import MapPrior, Term, lay_out
from lpvobs.discovery.select import own_share


@pytest.fixture(scope="module")
def fitted(plant, config, clean):
    """Return a function from the reading over the truth to the fit of two effects, the second beside the first."""
    p, q = config.grid().size, len(plant.names)
    prior = MapPrior(np.zeros(p), np.eye(p) / 1e-6**2, np.zeros((p, q)), False)

    def of(reading, *ids):
        log = replace(clean, channels={**clean.channels, "W_maf": reading})
        problem = lay_out(plant, config.grid(), prior, [log])
        effects = [plant.effect(id_) for id_ in ids]
        return fit(problem, [Term(effect, effect.null) for effect in effects])

    return of


def test_two_causes_keep_what_each_explains(fitted, clean):
    late = np.interp(clean.time - 0.05, clean.time, clean["W_maf"] * 1.06)
    linear = fitted(late, "maf.gain", "maf.delay")
    assert linear.terms[1].size == pytest.approx(0.05, abs=0.02)
    assert own_share(linear, 1) > 0.5


def test_the_shape_of_one_cause_is_no_second(fitted, clean):
    """The gain grows with the speed: what one number leaves of it is no backflow."""
    speed = (clean["n_e"] - clean["n_e"].mean()) / clean["n_e"].std()
    linear = fitted(clean["W_maf"] * (1.0 + 0.06 * (1.0 + 0.3 * speed)), "maf.gain", "maf.backflow")
    assert abs(linear.terms[1].size) > 0.05  # it would take what is left
    assert own_share(linear, 1) < 0.3

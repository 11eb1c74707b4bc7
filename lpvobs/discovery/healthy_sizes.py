"""How large an effect seems to be on drives without a fault: each healthy drive is judged by the others.

The size of an effect varies by more than noise, because what healthy drives leave differs from day to day. A fault must be larger.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from lpvobs.discovery import thresholds
from lpvobs.discovery.evidence import elsewhere_of, first_order
from lpvobs.discovery.fit import fit
from lpvobs.discovery.healthy_drive import HealthyDrive, learned_from, unmoved
from lpvobs.discovery.residual import MapPrior, lay_out
from lpvobs.engines.residual_model import ResidualModel
from lpvobs.maps.grid import Grid
from lpvobs.records import Array, Log


def learned(model: ResidualModel, grid: Grid, prior: MapPrior, logs: Sequence[Log]) -> HealthyDrive:
    """Return what healthy drives show; each of several tells what it seems to have of every effect, seen from the others."""
    found, *without = learned_from(lay_out(model, grid, prior, logs), [log.name for log in logs])
    # of every drive, as the others see it: gradient and information of each effect, whole and late
    seen_by: list[dict[str, list[tuple[float, float]]]] = []
    data, uneven = [], [1.0]
    for log, seen in zip(logs, without or [found], strict=True):
        laid = seen.taken_off(lay_out(seen.unchanged(model), grid, unmoved(prior), [log], spacing=seen.spacing))
        linear, middle = fit(laid, passes=2), 0.5 * float(laid.clock[0] + laid.clock[-1])
        late = (middle, np.inf)
        seen_by.append({effect.id: first_order(linear, effect, (-np.inf, np.inf), late) for effect in laid.catalogue})
        data.append(laid.data)
        uneven.append(elsewhere_of(linear))
    effects = tuple(effect for effect in seen_by[0] if all(effect in each for each in seen_by))
    scores = np.array([[each[effect] for effect in effects] for each in seen_by])
    whole, beyond, alike = beyond_noise(*scores[:, :, 0].transpose(2, 0, 1))
    from_middle, beyond_late, alike_late = beyond_noise(*scores[:, :, 1].transpose(2, 0, 1))
    beyond = np.maximum(beyond, beyond_late) / float(np.mean(data))
    return replace(
        found, effects=effects, whole=whole, late=from_middle, beyond=beyond, common=float(beyond.mean()),
        alike=min(alike, alike_late), uneven=max(uneven),
    )  # fmt: skip


def beyond_noise(gradient: Array, information: Array) -> tuple[Array, Array, float]:
    """Return the standard deviation of each effect's size that noise does not explain, its variance over that of noise, `alike`.

    Both arguments have shape (drives, effects). A few drives show little of one effect. So its variance counts beside a common one,
    as that of `alike` further drives: the more, the less the effects differ (empirical Bayes: Smyth 2004, Sec. 3 and 6.2).
    """
    seen = information > 0.0
    known = np.where(seen, information, np.inf)
    n, variance = len(gradient), (gradient**2 / known).mean(0)
    # less than noise alone leaves once in a hundred times is what the day's levels have taken
    least = scipy.stats.chi2.ppf(0.01, n) / n
    logs = np.log(np.maximum(variance[seen.any(0)], least)) - scipy.special.digamma(0.5 * n) + np.log(0.5 * n)
    differ = float(logs.var(ddof=1) - scipy.special.polygamma(1, 0.5 * n)) if logs.size > 1 else 0.0
    most = thresholds.POOLED
    alike = most
    if differ > scipy.special.polygamma(1, 0.5 * most):
        alike = 2.0 * scipy.optimize.brentq(lambda x: scipy.special.polygamma(1, x) - differ, 1e-3, 0.5 * most)
    common = float(np.exp(logs.mean() + scipy.special.digamma(0.5 * alike) - np.log(0.5 * alike)))
    found = np.maximum((n * variance + alike * common) / (n + alike) - 1.0, 0.0)
    return np.sqrt(found * (1.0 / known).mean(0)), found, alike

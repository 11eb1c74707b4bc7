"""How large an effect seems to be on drives without a fault: each healthy drive is judged by the others.

The size of an effect varies by more than noise, because what healthy drives leave differs from day to day. A fault must be larger.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lpvobs.discovery import thresholds
from lpvobs.discovery.evidence import elsewhere_of, first_order
from lpvobs.discovery.fit import fit
from lpvobs.discovery.healthy_drive import HealthyDrive, unmoved
from lpvobs.discovery.healthy_learning import learned_from
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
        spans = (-np.inf, np.inf), (middle, np.inf)
        seen_by.append({effect.id: first_order(linear, effect, *spans) for effect in laid.catalogue})
        data.append(laid.data)
        uneven.append(elsewhere_of(linear))
    effects = tuple(effect for effect in seen_by[0] if all(effect in each for each in seen_by))
    scores = np.array([[each[effect] for effect in effects] for each in seen_by])
    (whole, beyond), (late, beyond_late) = (beyond_noise(*scores[:, :, i].transpose(2, 0, 1)) for i in (0, 1))
    beyond = np.maximum(beyond, beyond_late) / float(np.mean(data))
    common = float(beyond.mean())
    return replace(found, effects=effects, whole=whole, late=late, beyond=beyond, common=common, uneven=max(uneven))


def beyond_noise(gradient: Array, information: Array) -> tuple[Array, Array]:
    """Return the standard deviation of each effect's size that noise does not explain, and its variance over that of noise.

    Both arguments have shape (drives, effects). A few drives show little of one effect: what all effects together vary by, in units
    of their noise, counts as `POOLED` further drives.
    """
    known = np.where(information > 0.0, information, np.inf)
    beyond = gradient**2 / known - 1.0
    common = max(float(beyond[information > 0.0].mean()), 0.0)
    own = np.maximum(beyond.mean(0), 0.0)
    n, pooled = len(beyond), thresholds.POOLED
    found = np.maximum(own, (n * own + pooled * common) / (n + pooled))
    return np.sqrt(found * (1.0 / known).mean(0)), found

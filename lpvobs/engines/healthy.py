"""The errors of a healthy engine's balances over seconds and over minutes, on parts of its logs that it was not learned from.

A single log does not show what differs from one day to the next; that is configured (`residual_model.Level`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from lpvobs.records import Array, Item

FOLDS = 6
CHUNK = 60.0  # [s] Driving that is held out together: errors that last for seconds must not be in both parts
TAIL = 4.0  # degrees of freedom of the distribution of errors: transients leave long tails
LEAST_SCALE = 0.003  # smallest scale of a balance that holds only part of the time, and that few blocks show
QUANTILES = (0.3, 0.6, 0.85)  # quantiles that divide blocks into classes of transience: fast changes blur every balance


@dataclass(frozen=True)
class HealthyErrors:
    """What held-out blocks of healthy logs show, B balances, C classes of transience.

    The C - 1 bounds of the classes are in the unit of `transience_of`.
    """

    bounds: Annotated[Array, Item("1", "transience at the bounds of its classes")]
    scale: Annotated[Array, Item("1", "scale of the residual, held out", ("transience", "balance"))]
    together: Annotated[Array, Item("1", "second moments of residual over scale", ("balance", "other_balance"))]
    slow: Annotated[Array, Item("1", "standard deviation of what lasts for minutes", ("balance",))]
    rms: Annotated[Array, Item("1", "rms of the residual, held out", ("balance",))]

    def scales(self, transience: Array) -> Array:
        """Return the scale of every balance in blocks of some transience, shape (B, K)."""
        return np.asarray(self.scale[np.searchsorted(self.bounds, transience)].T)


def parts_of(time: Array) -> NDArray[np.int64]:
    """Return which part, of `FOLDS`, each block at a time [s] since the start of its log is held out with."""
    return np.asarray((time // CHUNK).astype(np.int64) % FOLDS)


def healthy_errors(parts: Sequence[tuple[Array, NDArray[np.bool_], Array, Array]]) -> HealthyErrors:
    """Return the errors that held-out residuals of healthy logs show.

    A part is of one log: residuals and where each balance counts, both of shape (B, K), the transience of its blocks and the number
    of the minute that each belongs to, both of shape (K,).
    """
    residual, shown, transience = (np.concatenate([part[i] for part in parts], axis=-1) for i in range(3))
    chunk = np.concatenate([part[3] + 1e4 * number for number, part in enumerate(parts)])
    partly = ~shown.all(axis=1)
    level = [np.median(r[on]) if on.any() and not on.all() else 0.0 for r, on in zip(residual, shown, strict=True)]
    residual = residual - np.array(level)[:, None]
    rows = list(zip(residual, shown, strict=True))
    bounds = np.quantile(transience, QUANTILES)
    classes = np.searchsorted(bounds, transience)
    scale = np.array([[_scale(r[on & (classes == c)]) for r, on in rows] for c in range(len(QUANTILES) + 1)])
    scale[:, partly] = np.maximum(scale[:, partly], LEAST_SCALE)
    z = np.clip(residual / scale[classes].T, -TAIL, TAIL)
    together = np.eye(residual.shape[0])
    whole = np.flatnonzero(~partly)  # a balance that holds in part of the time has few blocks in common with the others
    together[np.ix_(whole, whole)] = z[whole] @ z[whole].T / z.shape[1]
    rms = np.array([np.sqrt(np.mean(r[on] ** 2)) if on.any() else LEAST_SCALE for r, on in rows])
    return HealthyErrors(bounds, scale, together, np.array([slow(r[on], chunk[on]) for r, on in rows]), rms)


def _scale(r: Array) -> float:
    """Return the scale of errors with long tails: maximum likelihood of Student's distribution."""
    if r.size < 5:
        return LEAST_SCALE
    s = max(1.48 * float(np.median(np.abs(r))), 1e-5)
    for _ in range(20):
        weight = (TAIL + 1.0) / (TAIL + (r / s) ** 2)
        s = float(np.sqrt(np.mean(weight * r**2)))
    return s


def slow(r: Array, chunk: Array) -> float:
    """Return the standard deviation of the medians of minutes, less what the errors within them explain."""
    medians, own = [], []
    for each in np.unique(chunk):
        part = r[chunk == each]
        if part.size >= 5:
            medians.append(float(np.median(part)))
            # of a median of errors, three of which count as one
            own.append(1.57 * 3.0 * float(np.var(part)) / part.size)
    if len(medians) < 3:
        return 0.0
    spread = 1.48 * float(np.median(np.abs(np.array(medians) - np.median(medians))))
    return float(np.sqrt(max(spread**2 - float(np.median(own)), 1e-6)))

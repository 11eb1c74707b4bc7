"""How far the balances of a healthy engine stray: within seconds, within minutes, from day to day, and where curves are unknown.

What happens within a drive is measured on held-out blocks of the healthy log. What differs from one day to the next no single log
shows; it is configured.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lpvobs.engines.throttled.balances import BALANCES, CALM, imbalances, scene_of
from lpvobs.engines.throttled.blocks import HURRY, blocks_of, haste_of
from lpvobs.engines.throttled.constants import Learned, ThrottledEngine
from lpvobs.engines.throttled.learning import learn
from lpvobs.records import Array, Log

FOLDS = 6
CHUNK = 60.0
"""[s] of driving that is held out together: what lasts for seconds must not be in both parts."""
TAIL = 4.0
"""Degrees of freedom of the distribution of errors."""
LEAST_CALM = 0.003
"""Smallest scatter of p_ic against p_amb at low flow: the filter's depression, and what the turbocharger still does."""


@dataclass(frozen=True)
class HealthyErrors:
    """What held-out blocks of healthy logs show.

    Attributes
    ----------
    hurry : ndarray, shape (classes - 1,)
        Bounds of the classes of haste.
    scale : ndarray, shape (classes, 4)
        Scale of the errors of each balance.
    together : ndarray, shape (3, 3)
        Second moments of the errors over their scales.
    slow : ndarray, shape (4,)
        Standard deviation of the part that lasts for minutes.
    rms : ndarray, shape (4,)
        Of each balance, over all blocks that count.
    calm_flow : float
        [kg/s], below which p_ic is compared with p_amb.
    """

    hurry: Array
    scale: Array
    together: Array
    slow: Array
    rms: Array
    calm_flow: float


def held_out_engines(engine: ThrottledEngine, log: Log, others: Sequence[Log] = ()) -> list[tuple[Learned, Array]]:
    """Return, for each part of a log in turn, the engine learned without it, and which blocks are in it."""
    blocks = blocks_of(log)
    part = (blocks.time // CHUNK).astype(int) % FOLDS
    all_others = [np.ones(blocks_of(other).count, dtype=bool) for other in others]
    return [
        (learn(engine, [log, *others], [np.asarray(part != f), *all_others]), np.asarray(part == f))
        for f in range(FOLDS)
    ]


def healthy_errors(engine: ThrottledEngine, logs: Sequence[Log]) -> HealthyErrors:
    """Return what held-out blocks of healthy logs show."""
    found, haste, calm, times = [], [], [], []
    calm_flow = CALM * max(float(np.quantile(log["W_maf"], 0.999)) for log in logs)
    for i, log in enumerate(logs):
        blocks, scene = blocks_of(log), scene_of(log)
        own = np.zeros((blocks.count, len(BALANCES)))
        for learned, out in held_out_engines(engine, log, [*logs[:i], *logs[i + 1 :]]):
            own[out] = imbalances(engine, learned, blocks, scene)[out]
        found.append(own)
        haste.append(haste_of(blocks, log))
        calm.append(blocks.mean(log["W_maf"]) < calm_flow)
        times.append(blocks.time // CHUNK + 1e4 * i)
    return _described(
        np.concatenate(found), np.concatenate(haste), np.concatenate(calm), np.concatenate(times), calm_flow
    )


def _described(r: Array, haste: Array, calm: Array, chunk: Array, calm_flow: float) -> HealthyErrors:
    r = r.copy()
    r[:, 3] -= np.median(r[calm, 3]) if calm.any() else 0.0
    counted = np.stack([np.ones_like(calm)] * 3 + [calm], axis=1)
    hurry = np.quantile(haste, HURRY)
    level = np.searchsorted(hurry, haste)
    scale = np.stack([[_scale(r[counted[:, b] & (level == c), b]) for b in range(4)] for c in range(len(HURRY) + 1)])
    scale[:, 3] = np.maximum(scale[:, 3], LEAST_CALM)
    z = np.clip(r[:, :3] / scale[level, :3], -TAIL, TAIL)
    rms = np.array(
        [np.sqrt(np.mean(r[counted[:, b], b] ** 2)) if counted[:, b].any() else LEAST_CALM for b in range(4)]
    )
    slow = np.array([_slow(r[counted[:, b], b], chunk[counted[:, b]]) for b in range(4)])
    return HealthyErrors(hurry, scale, z.T @ z / z.shape[0], slow, rms, calm_flow)


def _scale(r: Array) -> float:
    """Return the scale of errors with long tails: maximum likelihood of Student's distribution."""
    if r.size < 5:
        return LEAST_CALM
    s = max(1.48 * float(np.median(np.abs(r))), 1e-5)
    for _ in range(20):
        weight = (TAIL + 1.0) / (TAIL + (r / s) ** 2)
        s = float(np.sqrt(np.mean(weight * r**2)))
    return s


def _slow(r: Array, chunk: Array) -> float:
    """Return the standard deviation of the medians of minutes, less what the errors within them explain."""
    medians, own = [], []
    for each in np.unique(chunk):
        part = r[chunk == each]
        if part.size >= 5:
            medians.append(float(np.median(part)))
            own.append(
                1.57 * 3.0 * float(np.var(part)) / part.size
            )  # of a median of errors, three of which count as one
    if len(medians) < 3:
        return 0.0
    spread = 1.48 * float(np.median(np.abs(np.array(medians) - np.median(medians))))
    return float(np.sqrt(max(spread**2 - float(np.median(own)), 1e-6)))

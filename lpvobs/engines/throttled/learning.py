"""The constants and curves of a throttled engine from a healthy log: one robust linear least-squares problem.

Over every block, with s = dp / (R T) the mean storage per volume,

    sum_j area_j <h_j p_ic Psi / sqrt(R T)>     + V_ic s_ic               = <W_maf>      (throttle)
    sum_j eta_j  <h_j p_im n V_d / (120 R T)>   + V_ic s_ic + V_im s_im   = <W_maf>      (filling)
    sum_j fuel_j <h_j m_f n n_cyl / 120>        + V_ic s_ic + V_im s_im   = <W_maf>      (fuel)

with h_j the interpolation weights of the nodes. The sensor is taken for right, so a constant error of the sensor on that very log
goes into the curves. Unknowns are relative to a first guess; second differences from node to node are small beforehand. What the
engine says of parts of the logs that it was not learned from gives its errors.
"""

from collections.abc import Collection, Iterator, Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.engines.blocks import Blocks, blocks_of, transience_of
from lpvobs.engines.curves import Knowledge, LearnedNumber, differences
from lpvobs.engines.effects import Signals
from lpvobs.engines.healthy import CHUNK, FOLDS, QUANTILES, TAIL, HealthyErrors, healthy_errors, parts_of
from lpvobs.engines.throttled import relations as relation
from lpvobs.engines.throttled.balances import BALANCES, LACKS, Imbalances, needed, shown
from lpvobs.engines.throttled.constants import ThrottledEngine
from lpvobs.errors import DataError
from lpvobs.records import Array, Log

LEAST_FLOW = 5e-4  # [kg/s] Flow below which a relative error says nothing
LEAST_BLOCKS = 60
CALM = 0.15
"""Share of the largest flow of the healthy logs below which the air before the throttle is at ambient pressure."""
MOVING = ("p_im", "n_e", "W_maf")  # channels whose fast changes blur every balance
NUMBERS = {
    "V_ic": ("m^3", "volume before the throttle"),
    "V_im": ("m^3", "volume behind the throttle"),
    "calm_flow": ("kg/s", "air flow below which p_ic is compared with p_amb"),
}
"""What is learned beside the curves, the last one the flow below which the air before the throttle is at ambient pressure."""
PASSES = 8
LOOSE = 0.5  # standard deviation of the relative first difference between neighbouring nodes, and of the level
FIRST_ERROR = 0.05  # relative error of a balance that the first fit assumes
SHARED = 3.0  # neighbouring blocks that share an error and are not independent


def learn(engine: ThrottledEngine, logs: Sequence[Log], use: Sequence[NDArray[np.bool_]] | None = None) -> Knowledge:
    """Return what blocks of healthy logs tell, all or those to `use` (flags per log); raises DataError for too few."""
    parts, transience = [], []
    for i, log in enumerate(logs):
        blocks = blocks_of(log)
        good = blocks.mean(log["W_maf"]) > LEAST_FLOW
        if use is not None:
            good &= use[i]
        parts.append([rows[good] for rows in _rows(engine, log, blocks)])
        transience.append(transience_of(blocks, log.channels, MOVING)[good])
    fast, names = np.concatenate(transience), tuple(log.name for log in logs)
    if fast.size < LEAST_BLOCKS:
        raise DataError(
            f"{', '.join(names)}: fewer than {LEAST_BLOCKS} blocks of {blocks_of(logs[0]).length:g} s have air flow; learning the "
            f"engine takes several minutes of driving; give a longer healthy log"
        )
    rows = [np.concatenate(each) for each in zip(*parts, strict=True)]
    beliefs = _guesses(engine, [each[:, :-2] for each in rows])
    level = np.searchsorted(np.quantile(fast, QUANTILES), fast)
    found, covariance = _solve(engine, rows, beliefs, level)
    ends = np.cumsum([guess.size for guess, _ in beliefs])
    *values, volumes = np.split(found, ends)
    fitted = zip(relation.PARTS, values, np.split(np.sqrt(np.diag(covariance)), ends), strict=False)
    curves = {part.name: part.curve(engine, *each) for part, *each in fitted}
    calm = CALM * max(float(np.quantile(log["W_maf"], 0.999)) for log in logs)
    single = zip(NUMBERS.items(), (*volumes.tolist(), calm), strict=True)
    numbers = {name: LearnedNumber(value, *said) for (name, said), value in single}
    return Knowledge(curves, numbers, covariance, names)


def _rows(engine: ThrottledEngine, log: Log, blocks: Blocks) -> list[Array]:
    """Return for each balance the columns of its curve and of the two volumes over the flow, (B, nodes + 2)."""
    x = log.channels
    RT = engine.air.R_a * blocks.mean(x["T_ic"])
    both = np.stack([blocks.rate(x["p_ic"]) / RT, blocks.rate(x["p_im"]) / RT], axis=1)
    curves = [part.columns(engine, x, blocks) for part in relation.PARTS]
    volumes, flow = (both * np.array([1.0, 0.0]), both, both), np.maximum(blocks.mean(x["W_maf"]), LEAST_FLOW)
    return [np.hstack(each) / flow[:, None] for each in zip(curves, volumes, strict=True)]


def _guesses(engine: ThrottledEngine, curves: Sequence[Array]) -> list[tuple[Array, Array]]:
    """Return for each balance a first guess of its curve, and the rows of what is believed of deviations from it."""
    nodes = engine.curves
    area = _by_node(curves[0])
    eta_vol = np.full(curves[1].shape[1], 1.0 / np.median(curves[1].sum(1)))  # one level, which fits best in the median
    fuel = _injector(np.repeat(nodes.m_f, len(nodes.fuel_n_e)), curves[2])
    curvatures = (nodes.curvature, nodes.curvature, nodes.fuel_curvature)
    beliefs = []
    for guess, bent, part in zip((area, eta_vol, fuel), curvatures, relation.PARTS, strict=True):
        size = (1, *part.shape(engine))[-2:]  # a line has one row
        smooth, flat = differences(2, *size) / bent, differences(1, *size) / LOOSE
        beliefs.append((guess, np.vstack([smooth, flat, np.eye(guess.size) / (4.0 * LOOSE)])))
    return beliefs


def _injector(m_f: Array, columns: Array) -> Array:
    """Return the air per unit of the fuel reading of an injector with a dead time: air = k (m_f - m_0) at a constant mixture."""
    # Robust in k and k m_0, which enter the balance linearly; shape (nodes,).
    X = np.stack([columns.sum(1), -(columns / m_f).sum(1)], axis=1)
    weight = np.ones(X.shape[0])
    for _ in range(PASSES):
        k, offset = np.linalg.lstsq(X * weight[:, None], weight, rcond=None)[0]
        left = np.abs(1.0 - X @ np.array([k, offset]))
        weight = 1.0 / np.sqrt(np.maximum(left, 0.1 * FIRST_ERROR))  # least absolute errors
    return np.asarray(k * np.maximum(1.0 - offset / k / m_f, 0.3))


def _by_node(columns: Array) -> Array:
    """Return a value for each node from the blocks it dominates; nodes without such blocks lie on a line between others."""
    total = columns.sum(1)
    seen = (columns / total[:, None]).T > 0.5
    known = np.flatnonzero(seen.sum(1) >= 3)
    if not known.size:
        return np.full(columns.shape[1], float(1.0 / np.median(total)))
    value = [np.log(1.0 / np.median(total[seen[j]])) for j in known]
    return np.asarray(np.exp(np.interp(np.arange(columns.shape[1]), known, value)))


def _solve(
    engine: ThrottledEngine, rows: Sequence[Array], beliefs: Sequence[tuple[Array, Array]], level: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Return the values of all nodes and the volumes, and the covariance of their relative deviations."""
    # Least squares with weights for long tails, and a scale of its own for each class of transience, shape (blocks,).
    g, (guesses, priors) = engine.geometry, zip(*beliefs, strict=True)
    volume = np.array([g.V_ic, g.V_im])
    start, end = np.concatenate([*guesses, volume]), 0
    balances = []
    for own, guess in zip(rows, guesses, strict=True):
        X, begin, end = np.zeros((len(own), start.size)), end, end + guess.size
        X[:, begin:end], X[:, -2:] = own[:, :-2] * guess, own[:, -2:] * volume
        balances.append((X, 1.0 - X[:, begin:end].sum(1) - own[:, -2:] @ volume))
    believed = scipy.linalg.block_diag(*priors, np.eye(2) / g.volume_tolerance)
    normal_prior = believed.T @ believed
    weights = [np.full(y.size, 1.0 / FIRST_ERROR**2) for _, y in balances]
    for _ in range(PASSES):
        weighted = [((X * w[:, None]).T, X, y) for (X, y), w in zip(balances, weights, strict=True)]
        normal = normal_prior + sum(XtW @ X for XtW, X, _ in weighted) / SHARED
        right = sum(XtW @ y for XtW, _, y in weighted) / SHARED
        deviation = np.linalg.solve(normal, right)
        weights = [_robust(y - X @ deviation, level) for X, y in balances]
    found = start * np.maximum(1.0 + deviation, 0.05)
    now = found / start
    return found, np.linalg.inv(normal) / np.outer(now, now)


def _robust(residual: Array, level: NDArray[np.int64]) -> Array:
    """Return weights 1/variance, smaller for what lies far out of its class."""
    classes = [np.abs(residual[level == c]) for c in range(len(QUANTILES) + 1)]
    medians = np.array([np.median(each) if each.size else 0.0 for each in classes])
    scale = np.maximum(1.48 * medians, 1e-4)[level]
    return np.asarray((TAIL + 1.0) / (TAIL + (residual / scale) ** 2) / scale**2)


def without_each_part(engine: ThrottledEngine, logs: Sequence[Log], i: int) -> Iterator[tuple[Knowledge, int]]:
    """Yield, for each part of log i in turn, the engine learned from everything else, and the number of the part."""
    parts = [parts_of(blocks_of(log).time) for log in logs]
    for part in range(FOLDS):
        use = [(own != part) | (k != i) for k, own in enumerate(parts)]
        yield learn(engine, logs, use), part


def errors_of(engine: ThrottledEngine, logs: Sequence[Log]) -> HealthyErrors:
    """Return how wrong the balances of healthy logs are on parts that taught the engine nothing."""
    whole, balances = learn(engine, logs), Imbalances(engine)
    parts = []
    for i, log in enumerate(logs):
        blocks, signals = blocks_of(log), recorded(log, whole)
        residual = np.zeros((len(BALANCES), blocks.count))
        for learned, part in without_each_part(engine, logs, i):
            out = parts_of(blocks.time) == part
            residual[:, out] = balances(learned, signals, blocks)[:, out]
        fast = transience_of(blocks, log.channels, MOVING)
        parts.append((residual, shown(whole, signals, blocks), fast, blocks.time // CHUNK))
    return healthy_errors(parts)


def beyond(
    engine: ThrottledEngine,
    learned: Knowledge,
    taught: Collection[str],
    logs: Sequence[Log],
    s: Signals,
    blocks: Blocks | None,
) -> Array:
    """Return what the engine learned without each part in turn says beyond the whole, on logs that taught it, shape (4, K)."""
    blocks = needed(blocks)
    out, balances = np.zeros((len(BALANCES), blocks.count)), Imbalances(engine)
    own = [log for log in logs if log.sha256 in taught]
    middle = blocks.time + s.clock[0]
    begins: Array = np.unique(s.clock - s.time)
    number = np.searchsorted(begins, middle, side="right") - 1
    part_of, whole = parts_of(middle - begins[number]), balances(learned, s, blocks)
    for i, log in enumerate(own):
        for other, part in without_each_part(engine, own, i):
            on = (number == list(logs).index(log)) & (part_of == part)
            out[:, on] = (balances(other, s, blocks) - whole)[:, on]
    return out


def recorded(log: Log, learned: Knowledge) -> Signals:
    """Return a log as its channels are, every sample once."""
    since = log.time - log.time[0]
    still = np.zeros(len(log))
    return Signals(
        time=since,
        clock=since,
        value=log.channels,
        rate=dict.fromkeys(log.channels, still),
        lacks=np.tile(np.array(list(LACKS.values()))[:, None], (1, len(log))),
        later=lambda _: still,
        slow=lambda _: still,
        constants=learned,
    )

"""A throttled engine on parts of healthy logs that it was not learned from: its errors there, and its predictions of each part."""

from collections.abc import Collection, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.blocks import Blocks, blocks_of, transience_of
from lpvobs.engines.effects import Signals
from lpvobs.engines.healthy import CHUNK, FOLDS, HealthyErrors, parts_of, pooled
from lpvobs.engines.throttled.balances import BALANCES, LACKS, Imbalances, shown
from lpvobs.engines.throttled.constants import Learned, ThrottledEngine
from lpvobs.engines.throttled.learning import MOVING, learn
from lpvobs.records import Array, Log


def without_each_part(engine: ThrottledEngine, logs: Sequence[Log], i: int) -> Iterator[tuple[Learned, int]]:
    """Yield, for each part of log i in turn, the engine learned from everything else, and the number of the part."""
    parts = [parts_of(blocks_of(log).time) for log in logs]
    for part in range(FOLDS):
        use = [np.asarray(own != part if k == i else np.ones(own.size, dtype=bool)) for k, own in enumerate(parts)]
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
    return pooled(parts)


def beyond(
    engine: ThrottledEngine,
    learned: Learned,
    taught: Collection[str],
    logs: Sequence[Log],
    s: Signals,
    blocks: Blocks | None,
) -> Array:
    """Return what the engine learned without each part in turn says beyond the whole, on logs that taught it, shape (4, K)."""
    if blocks is None:
        raise ValueError("the balances of a throttled engine are drawn up over blocks")
    out, balances = np.zeros((len(BALANCES), blocks.count)), Imbalances(engine)
    own = [log for log in logs if log.sha256 in taught]
    middle = blocks.time + s.clock[0]
    begins: NDArray[np.float64] = np.unique(s.clock - s.time)
    number = np.searchsorted(begins, middle, side="right") - 1
    for i, log in enumerate(own):
        here = number == list(logs).index(log)
        part_of = parts_of(middle - begins[number])
        whole = balances(learned, s, blocks)
        for other, part in without_each_part(engine, own, i):
            on = here & (part_of == part)
            out[:, on] = (balances(other, s, blocks) - whole)[:, on]
    return out


def recorded(log: Log, learned: Learned) -> Signals:
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

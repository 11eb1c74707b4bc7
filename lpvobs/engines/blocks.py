"""A log in blocks of a few seconds: flows are compared as means over blocks, where storage is a difference of two pressures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.curves import Weights
from lpvobs.records import Array, Log

LENGTH = 2.0  # [s] Length of a block: long against the filling of the manifold, short against a driver's manoeuvre
EDGE = 0.1  # [s] Half width of the mean that stands for a reading at the edge of a block
MOST = 1000  # largest number of blocks of all logs together
LEAST_FILLED = 0.7  # share of a block's typical number of samples that it must hold


@dataclass(frozen=True)
class Blocks:
    """How N samples fall into B blocks; none spans a gap."""

    time: Array  # (B,) [s], middle of each block since the start of the log
    length: float  # [s]
    samples: NDArray[np.int64]  # (n,) the samples that lie in a block, and
    block: NDArray[np.int64]  # (n,) the block of each
    # (2, B) [s], on the log's own clock: the times that the differences of a rate belong to, half a sample before the
    # first and after the last sample of the block
    edges: Array
    clock: Array  # (N,) [s], the log's own clock

    @property
    def count(self) -> int:
        """The number of blocks."""
        return self.time.size

    @cached_property
    def held(self) -> NDArray[np.int64]:
        """The number of samples in each block, shape (B,)."""
        return np.bincount(self.block, minlength=self.count)

    def mean(self, values: Array) -> Array:
        """Return the mean of a channel over each block, shape (B,)."""
        return np.asarray(np.bincount(self.block, values[self.samples], minlength=self.count) / self.held)

    def spread(self, values: Array) -> Array:
        """Return the standard deviation of a channel within each block, shape (B,)."""
        return np.sqrt(np.maximum(self.mean(values**2) - self.mean(values) ** 2, 0.0))

    def rate(self, values: Array) -> Array:
        """Return the mean time derivative of a channel over each block, shape (B,) [1/s]."""
        steps = 0.5 * (values[1:] + values[:-1]) * np.diff(self.clock)
        total = np.concatenate([[0.0], np.cumsum(steps)])
        first, last = self.clock[0], self.clock[-1]
        low, high = np.clip(self.edges - EDGE, first, last), np.clip(self.edges + EDGE, first, last)
        at = (np.interp(high, self.clock, total) - np.interp(low, self.clock, total)) / (high - low)
        return np.asarray((at[1] - at[0]) / self.length)

    def sums(self, weights: Weights, size: int, scale: Array) -> Array:
        """Return the mean over each block of scale times each node's weight, shape (B, size)."""
        nodes, share = (each[self.samples] for each in weights)
        place = (self.block[:, None] * size + nodes).ravel()
        mass = (share * scale[self.samples, None]).ravel()
        total = np.bincount(place, mass, minlength=self.count * size).reshape(self.count, size)
        return np.asarray(total / self.held[:, None])


def blocks_of(log: Log) -> Blocks:
    """Return the blocks of one log."""
    return blocks_along(log.time, log.segments, block_length(float(log.time[-1] - log.time[0])))


def block_length(lasts: float) -> float:
    """Return how long blocks are [s] where driving lasts so many seconds: the time that a search takes grows with their number."""
    return max(LENGTH, lasts / MOST)


def blocks_along(clock: Array, segments: Sequence[tuple[int, int]], length: float) -> Blocks:
    """Return the blocks of samples on a clock [s], shape (N,), in segments without a gap."""
    begins: list[Array] = []
    samples: list[NDArray[np.int64]] = []
    numbers: list[NDArray[np.int64]] = []
    for start, stop in segments:
        since = clock[start:stop] - clock[start]
        own, whole = np.floor(since / length).astype(np.int64), int(since[-1] / length)
        kept = own < whole
        samples.append(np.flatnonzero(kept) + start)
        numbers.append(own[kept] + sum(each.size for each in begins))
        begins.append(clock[start] + length * np.arange(whole))
    begin, sample, number = np.concatenate(begins), np.concatenate(samples), np.concatenate(numbers)
    held = np.bincount(number, minlength=begin.size)
    full = held >= LEAST_FILLED * (np.median(held) if held.size else 0.0)
    place = np.cumsum(full) - 1
    stay = full[number]
    edges = np.stack([begin[full], begin[full] + length])
    half = 0.5 * float(np.median(np.diff(clock)))
    return Blocks(edges.mean(0) - clock[0], length, sample[stay], place[number[stay]], edges - half, clock)


def transience_of(blocks: Blocks, channels: Mapping[str, Array], moving: Sequence[str]) -> Array:
    """Return how much channels change within each block, relative to their means: the largest of them, shape (blocks,)."""
    shown = [channels[name] for name in moving if name in channels]
    spreads = [blocks.spread(values) / np.maximum(np.abs(blocks.mean(values)), 1e-12) for values in shown]
    return np.asarray(np.max(np.stack(spreads), axis=0)) if spreads else np.zeros(blocks.count)

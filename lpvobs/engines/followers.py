"""Signals that no sensor shows because they follow a channel slowly, as the wall of a port follows the gas."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from lpvobs.compiled import njit
from lpvobs.records import Log, Piece


@dataclass(frozen=True)
class Follower:
    """The state s of tau ds/dt = x - s, which is x where a segment begins."""

    channel: str  # x
    tau: float  # [s]


def followed(followers: Mapping[str, Follower], pieces: Iterable[Piece]) -> Iterator[Piece]:
    """Yield a recording with its followers as further channels; how it is cut into pieces changes no bit."""
    time, states = np.nan, dict.fromkeys(followers, np.nan)
    for piece in pieces:
        found = {}
        for name, follower in followers.items():
            column = np.ascontiguousarray(piece.channels[follower.channel])
            found[name] = _along(piece.time, column, piece.begins, follower.tau, time, states[name])
            states[name] = float(found[name][-1])
        time = float(piece.time[-1])
        yield Piece(piece.time, {**piece.channels, **found}, piece.begins)


def with_followers(followers: Mapping[str, Follower], log: Log) -> Log:
    """Return a log with its followers as further channels."""
    if not followers:
        return log
    return replace(log, channels=next(iter(followed(followers, log.pieces()))).channels)


@njit(cache=True)
def _along(time, x, begins, tau, before, state):  # type: ignore[no-untyped-def]
    """Return the states at every sample, exact for an input that stands still since the sample before."""
    out = np.empty(time.size)
    for k in range(time.size):
        kept = 0.0 if begins[k] else (state - x[k]) * np.exp(-(time[k] - before) / tau)
        out[k] = state = x[k] + kept
        before = time[k]
    return out

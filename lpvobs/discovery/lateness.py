"""What balances change by where a channel is read late: a thermocouple in the exhaust, by a second or more.

What a turbine lacks for it goes with the flow and with how fast the exhaust warms. No function of the channels tells it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lpvobs.discovery.residual import Problem
from lpvobs.discovery.thresholds import AHEAD, STEP
from lpvobs.engines.effects import Signals
from lpvobs.records import Array


def late_by(problem: Problem, names: Sequence[str]) -> Array:
    """Return what the balances change by for a second by which each channel is late, shape (B, n, 2K) [kg/s^2]."""
    s = _signals(problem)
    each = [_later(problem, s, name) for name in names]
    return np.reshape(each, (len(names), len(problem.shown), 2 * problem.K)).swapaxes(0, 1)


def slopes_of_lateness(problem: Problem, names: Sequence[str]) -> Array:
    """Return its derivatives by value and by rate of that channel, means of both views, shape (n, 2, B, K)."""
    s, found = _signals(problem), []
    for name in names:
        value, rate, here = s[name], s.rate[name], _later(problem, s, name)
        h = STEP * float(np.abs(value).mean()), STEP * float(np.std(rate))
        moved = s.corrected(name, value + h[0]), s.corrected(name, value, rate + h[1])
        found.append([(_later(problem, each, name) - here) / step for each, step in zip(moved, h, strict=True)])
    return np.asarray(np.reshape(found, (len(names), 2, len(problem.shown), 2, problem.K)).mean(3))


def _signals(problem: Problem) -> Signals:
    return replace(problem.signals, constants=problem.model.with_unknowns(np.zeros(len(problem.model.names))))


def _later(problem: Problem, s: Signals, name: str) -> Array:
    ahead = s.corrected(name, s[name] + AHEAD * s.rate[name])
    left = [problem.model.imbalances(s.constants, each, None) for each in (ahead, s)]
    return (left[0] - left[1]) / AHEAD

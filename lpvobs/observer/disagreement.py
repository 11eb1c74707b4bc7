"""Which logs disagree with the map that all of them make together.

A log's own map differs from the common one by noise, by what it owes to the engine's constants, and by the surface itself: two
drives through the same cell find slightly different nodes, because the surface is not bilinear, and two vehicles may differ. The
last part is found from the logs: the scatter between logs that puts the median log where chance would have it. It is not the same
for all logs, so a log is judged among the others, not by a table of chi-square. Two things are looked at: the mean difference over
its nodes, in which the scatter averages out and a sensor that has drifted does not, and chi-square, which sees a part of the map
that has moved. A minority of bad logs moves neither the median nor the spread by which all are judged.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from lpvobs.observer.information import Solution
from lpvobs.observer.parts import LogInformation
from lpvobs.records import Array, Item

INFORMED = 0.01  # of the prior standard deviation: a node that the log knows no better is not compared
LEAST_VARIANCE = 1e-3  # of a node's own variance: what only this log knows cannot differ from what all know
STANDS_OUT = 4.0  # standard deviations from the median log at which a log disagrees; few logs have heavy tails
LEAST_SPREAD = 0.75
"""Of the logarithm of chi-square per degree of freedom between logs: a few of them may lie close together by chance."""
HALVINGS = 60


@dataclass(frozen=True)
class Agreement:
    """How far the map of one log alone is from the map of all logs, given their scatter; NaN where they cannot be compared."""

    # `deviation` is of the mean difference or the logarithm of chi-square, whichever lies further beyond the median log.

    name: Annotated[str, Item("1", "log", name="log")]
    nodes: Annotated[int, Item("1", "number of nodes informed by this log and by others")]
    chi_square: Annotated[
        float, Item("1", "squared difference of the log's own map from the common map, over its variance", gaps=True)
    ]
    mean_difference: Annotated[
        float, Item("kg/s", "mean over nodes of the log's own map minus the common map", gaps=True)
    ]
    deviation: Annotated[
        float, Item("1", "number of standard deviations by which the log differs from the others", gaps=True)
    ]
    disagrees: Annotated[bool, Item("1", "whether the log disagrees with the other logs")]


@dataclass(frozen=True)
class Difference:
    """A log's difference from the common map along the axes of its covariance."""

    name: str
    nodes: int
    squares: Array
    variances: Array
    mean: float
    mean_variance: float

    def chi_square(self, scatter: float) -> float:
        """Return the squared difference over its variance; NaN where nothing can be compared."""
        return float(np.sum(self.squares / (self.variances + scatter))) if self.squares.size else float("nan")

    def height(self, scatter: float) -> float:
        """Return the logarithm of chi-square per degree of freedom; NaN where nothing can be compared."""
        free = max(self.squares.size, 1)
        return float(np.log(np.maximum(self.chi_square(scatter) / free, np.finfo(float).tiny)))


def agreements(found: Sequence[Difference]) -> tuple[float, tuple[Agreement, ...]]:
    """Return the scatter between logs [kg/s], one standard deviation of a node, and every log's agreement."""
    scatter = _scatter([item for item in found if item.squares.size])
    chi = _beyond(np.array([item.height(scatter) for item in found]), np.full(len(found), LEAST_SPREAD))
    errors = np.array([np.sqrt(item.mean_variance + scatter / max(item.nodes, 1)) for item in found])
    mean = np.abs(_beyond(np.array([item.mean for item in found]), errors))
    verdicts = []
    for item, deviation in zip(found, np.maximum(chi, mean).tolist(), strict=True):
        far = bool(deviation > STANDS_OUT)
        verdicts.append(Agreement(item.name, item.nodes, item.chi_square(scatter), item.mean, deviation, far))
    return float(np.sqrt(scatter)), tuple(verdicts)


def _beyond(values: Array, least: Array) -> Array:
    """Return how many standard deviations each value lies above the median; their spread is robust, and at least as given."""
    known = values[np.isfinite(values)]
    if not known.size:
        return np.full(values.shape, np.nan)
    away = values - np.median(known)
    return np.asarray(away / np.maximum(1.4826 * np.median(np.abs(away[np.isfinite(away)])), least))


def difference(common: Solution, part: LogInformation, prior: float) -> Difference:
    """Return how a log differs from the map of all logs and the engine; `prior` [kg/s] is that of a node before any data."""
    layout, engine = common.layout, common.layout.engine
    # What lasts is in all logs alike: noise alone sets one apart.
    normal = np.einsum("ab,abij->ij", np.linalg.inv(common.fast), part.products)
    at_nodes = np.flatnonzero(part.columns < layout.nodes)
    of_engine = np.flatnonzero((part.columns >= engine.start) & (part.columns < engine.stop))
    nodes, unknowns = part.columns[at_nodes], part.columns[of_engine]
    own = np.linalg.inv(normal[np.ix_(at_nodes, at_nodes)] + np.eye(nodes.size) / prior**2)
    own_answers = np.zeros((nodes.size, layout.unknowns))
    own_answers[:, unknowns - engine.start] = own @ normal[np.ix_(at_nodes, of_engine)]
    z = int(np.searchsorted(part.columns, layout.z))
    theta = own @ normal[at_nodes, z] - own_answers @ common.mean[engine]
    # Independent errors: the covariance of own less common is that of own less that of common.
    noise = own - common.quick[np.ix_(nodes, nodes)]
    answers = own_answers - common.response[nodes]
    chosen = np.flatnonzero((np.diag(own) < (INFORMED * prior) ** 2) & (np.diag(noise) > LEAST_VARIANCE * np.diag(own)))
    if not chosen.size:
        return Difference(part.run.name, 0, np.empty(0), np.empty(0), float("nan"), float("nan"))
    away = (theta - common.theta[nodes])[chosen]
    inner = np.ix_(chosen, chosen)
    covariance = noise[inner] + (answers @ common.covariance[engine, engine] @ answers.T)[inner]
    variances, axes = np.linalg.eigh(covariance)
    kept = variances > LEAST_VARIANCE * np.median(variances)
    squares = ((axes.T @ away) ** 2)[kept]
    spread = float(covariance.sum() / chosen.size**2)
    return Difference(part.run.name, chosen.size, squares, variances[kept], float(away.mean()), spread)


def _scatter(found: Sequence[Difference]) -> float:
    """Return the variance that brings the median of chi-square per degree of freedom down to one; zero if it is below."""

    def middle(scatter: float) -> float:
        return float(np.median([item.chi_square(scatter) / item.squares.size for item in found]))

    if not found or middle(0.0) <= 1.0:
        return 0.0
    low, high = 0.0, max(float(item.squares.max()) for item in found)
    for _ in range(HALVINGS):
        half = 0.5 * (low + high)
        low, high = (half, high) if middle(half) > 1.0 else (low, half)
    return high

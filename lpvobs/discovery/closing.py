"""The entry points: from logs and a nominal model to what is missing in it, and to the model that has it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from lpvobs.discovery.channels import Curve
from lpvobs.discovery.heldout import Comparison, carried_over
from lpvobs.discovery.linear import Linear, Term
from lpvobs.discovery.outcome import Finding, Parameter, Ranked, Trace
from lpvobs.discovery.plant import Plant
from lpvobs.discovery.problem import MapPrior, Problem, free_map, lay_out, place_in_logs
from lpvobs.discovery.selection import Accepted, Selection, select
from lpvobs.discovery.whiteness import Whiteness, whiteness
from lpvobs.maps.grid import Grid
from lpvobs.records import Array, Log

NINETY = 1.645
LIKENESS = 2e-4
"""[kg/s], how much the nodes of two maps of the same surface differ because a bilinear map is an approximation."""


@dataclass(frozen=True)
class Refinement:
    """A trace and the model that it leads to.

    Attributes
    ----------
    trace : Trace
    theta : ndarray, shape (p_2, p_1)
        [kg/s], the map beside the effects.
    covariance : ndarray, shape (p, p)
        [kg^2/s^2]
    beta : mapping of str to float
        Relative deviation of each uncertain constant.
    terms : tuple of Term
        The effects that are part of the model.
    before, after : Linear
        Residual, regressors and weights of either model, for reports.
    whiteness_before, whiteness_after : Whiteness
    """

    trace: Trace
    theta: Array
    covariance: Array
    beta: Mapping[str, float]
    terms: tuple[Term, ...]
    before: Linear
    after: Linear
    whiteness_before: Whiteness
    whiteness_after: Whiteness

    def on_other_logs(
        self, plant: Plant, grid: Grid, tolerance: Mapping[str, float], logs: Sequence[Log]
    ) -> Comparison:
        """Return the error before and after on logs that took no part, nothing fitted to them."""
        prior = free_map(grid, len(tolerance), 0.1)
        return carried_over(self.before, self.after, lay_out(plant, grid, tolerance, prior, logs))


def nominal_map(theta: Array, covariance: Array, sensitivity: Array, spread: Array, prior_map: float) -> MapPrior:
    """Return a stored map as what is known before other logs.

    Parameters
    ----------
    theta : ndarray, shape (p_2, p_1)
        [kg/s], NaN where not estimated.
    covariance : ndarray, shape (p, p)
        [kg^2/s^2], noise and constants together, as stored.
    sensitivity : ndarray, shape (q, p_2, p_1)
        [kg/s], NaN where not estimated.
    spread : ndarray, shape (q,)
        Standard deviation of the relative error of each constant.
    prior_map : float
        [kg/s], standard deviation of a node that is not estimated.
    """
    known = np.isfinite(theta).ravel()
    S = np.nan_to_num(sensitivity.reshape(len(spread), known.size).T)
    noise = covariance - (S * spread**2) @ S.T
    noise = np.where(np.outer(known, known), noise, 0.0) + np.diag(np.where(known, LIKENESS**2, prior_map**2))
    values, vectors = np.linalg.eigh(0.5 * (noise + noise.T))
    precision = (vectors / np.maximum(values, LIKENESS**2)) @ vectors.T
    return MapPrior(np.nan_to_num(theta).ravel(), precision, S, False)


def trace(
    plant: Plant,
    grid: Grid,
    tolerance: Mapping[str, float],
    prior: MapPrior,
    logs: Sequence[Log],
    progress: Callable[[float], None] = lambda _: None,
) -> Trace:
    """Return what the logs hold that the model lacks; arguments as for `refine`."""
    return refine(plant, grid, tolerance, prior, logs, progress).trace


def refine(
    plant: Plant,
    grid: Grid,
    tolerance: Mapping[str, float],
    prior: MapPrior,
    logs: Sequence[Log],
    progress: Callable[[float], None] = lambda _: None,
) -> Refinement:
    """Return the model with the effects that the logs prove.

    Parameters
    ----------
    plant : Plant
    grid : Grid
    tolerance : mapping of str to float
        Uncertain constants of the engine: the truth lies within this fraction of the configured value.
    prior : MapPrior
        `free_map` on the logs that make the map, `nominal_map` on others.
    logs : sequence of Log
        Pooled.
    progress : callable
        Told the share that is done.

    Raises
    ------
    DataError
        If a log is too short.
    """
    problem = lay_out(plant, grid, tolerance, prior, logs)
    selection = select(problem, progress)
    before = selection.before
    own = [structure(linear) for linear in (before, selection.after)]
    result = Trace(
        verdict=selection.verdict,
        findings=tuple(finding_of(problem, logs, item) for item in selection.accepted),
        ranking=tuple(_ranked(selection)),
        comparison=selection.comparison,
        white=own[1].white,
        correlated_with=own[1].correlated_with,
    )
    after = selection.after
    inverse = scipy.linalg.cho_solve((after.factor, True), np.eye(after.pull.size), check_finite=False)
    return Refinement(
        trace=result,
        theta=after.theta.reshape(grid.shape),
        covariance=inverse[: after.p, : after.p],
        beta=dict(zip(problem.names, after.beta.tolist(), strict=True)),
        terms=after.terms,
        before=before,
        after=after,
        whiteness_before=own[0],
        whiteness_after=own[1],
    )


def structure(linear: Linear) -> Whiteness:
    """Return the structure of a model's residual, with respect to every input and channel."""
    problem = linear.problem
    K = problem.K
    inputs = {n: linear.problem.scene[n][:K] for n in problem.plant.channels if n != problem.plant.sensor}
    return whiteness(linear.residual[0], problem.first, inputs | dict(problem.auxiliary))


def finding_of(problem: Problem, logs: Sequence[Log], item: Accepted) -> Finding:
    """Return an accepted effect for people and programs."""
    term = item.candidate.term
    half = NINETY * item.standard_error
    parameter = Parameter(term.size, term.effect.unit, (term.size - half, term.size + half))
    return Finding(
        id=term.effect.id,
        parameters={term.effect.parameter: parameter},
        onset=place_in_logs(logs, term.begin),
        end=place_in_logs(logs, term.end),
        explained=item.share,
        p_value=item.p_value,
        indistinguishable=item.alike,
        drive=term.effect.drive,
        curve=_curve(item.curve),
    )


def _curve(curve: Curve | None) -> dict[str, object] | None:
    if curve is None:
        return None
    return {
        "channel": curve.channel,
        "of": curve.of,
        "changes": curve.carrier,
        "knots": curve.knots.tolist(),
        "values": curve.values.tolist(),
    }


def _ranked(selection: Selection) -> list[Ranked]:
    return [Ranked(c.id, c.term.size, c.term.effect.unit, float(c.gain), c.unevenness) for c in selection.ranking]

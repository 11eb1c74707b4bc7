"""An effect that became part of the model: its size and error beside all others, and which effects explain the logs as well."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from lpvobs.discovery import thresholds
from lpvobs.discovery.course_choice import fit_all
from lpvobs.discovery.courses import FactorSurface
from lpvobs.discovery.evidence import Candidate, best_first, in_place, loss_of
from lpvobs.discovery.fit import objective, refit
from lpvobs.discovery.form_search import Inside, with_inside
from lpvobs.discovery.forms import PREFIX
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.ranking import chance, rank_in
from lpvobs.discovery.residual import Problem
from lpvobs.engines.effects import Effect


@dataclass(frozen=True)
class Accepted:
    """An effect that became part of the model."""

    candidate: Candidate  # fitted beside all the others, with the final weights
    p_value: float
    share: float  # of half the sum of squares before any effect
    indistinguishable: tuple[str, ...]  # effects that explain the logs as well
    standard_error: float  # of the size, in its unit; of a channel's curve, of its multiple
    further: tuple[Inside, ...] = ()  # what a form has inside its factors


def finished(
    linear: Linear, bare: Linear, index: int, candidate: Candidate, standard_error: float, forms: tuple[Effect, ...]
) -> Accepted:
    """Return an effect of the final model with what is said of it; `bare` is the model without it, `forms` are its rivals."""
    problem = linear.problem
    term = linear.terms[index]
    own = replace(in_place(linear, index, candidate), gain=float((loss_of(bare) - loss_of(linear)).sum()))
    like = _as_fitted(linear, bare, own)
    others = [e for e in problem.catalogue if e.id != own.id and (own.changes or not problem.absorbs(e))]
    others += [e for e in forms if term.effect in forms and e.place != term.effect.place]
    if term.course is not None:
        rivals = best_first(fit_all(bare, others, term.course))
    else:
        rivals = rank_in(bare, others, term.begin, term.end)
    beside = []
    for rival in rivals[: thresholds.SHORTLIST]:  # in place of the effect, all unknowns fitted with it
        there = refit(linear, [*linear.terms[:index], rival.term, *linear.terms[index + 1 :]])
        beside.append(_as_fitted(there, bare, rival))
    indistinguishable = tuple(c.id for c in beside if fits_as_well(like, c, problem))
    share = own.gain / max(float(loss_of(bare).sum()), own.gain, 1e-300)
    if isinstance(term.curve, FactorSurface):
        standard_error = float(np.hypot(standard_error, term.curve.error))
    further: Sequence[Inside] = ()
    if own.id.startswith(PREFIX):
        standard_error, further = with_inside(linear, index, standard_error)
    return Accepted(own, chance(own, problem), share, indistinguishable, standard_error, tuple(further))


def _as_fitted(linear: Linear, bare: Linear, candidate: Candidate) -> Candidate:
    """Return an effect with gain and losses of the model that has it."""
    return replace(candidate, gain=objective(bare) - objective(linear), loss=loss_of(linear))


def fits_as_well(best: Candidate, other: Candidate, problem: Problem) -> bool:
    """Return whether another effect explains the log as well as the best one does.

    Two tests compare the losses by block, and neither may prefer the best effect: the sum of the differences (after Vuong), which
    a single block with a large difference may spoil, and their signed ranks, which many blocks with small differences may spoil.
    Where all blocks together differ by less than a tie, neither test is needed. Where healthy drives tell, the engine is not the
    model, and a cause is not quite the catalogue's: gains that differ by what its shape is off by are a tie.
    """
    tie = max(thresholds.TIE, thresholds.SHAPE**2 * best.gain if len(problem.patterns) else 0.0)
    if other.gain > best.gain - tie:
        return True
    difference = problem.by_coarse(other.loss - best.loss)
    ranks = scipy.stats.rankdata(np.abs(difference)) * np.sign(difference)
    statistics = (float(x.sum() / max(np.sqrt(x @ x), 1e-300)) for x in (difference, ranks))
    return max(statistics) <= thresholds.INDISTINGUISHABLE and other.gain > 0.5 * best.gain

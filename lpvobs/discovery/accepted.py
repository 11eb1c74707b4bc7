"""An effect that became part of the model: its size and error beside all others, and which effects explain the logs as well."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from lpvobs.discovery import thresholds
from lpvobs.discovery.components import FactorSurface, Shape
from lpvobs.discovery.course_choice import fit_all
from lpvobs.discovery.evidence import Candidate, first_order_gain, fit_candidate, in_place, loss_of, p_value, score
from lpvobs.discovery.form_search import Inside, with_inside
from lpvobs.discovery.forms import PREFIX
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.ranking import most_promising, tried
from lpvobs.engines.effects import Effect


@dataclass(frozen=True)
class Accepted:
    """An effect that became part of the model."""

    candidate: Candidate  # fitted beside all the others, with the final weights
    p_value: float
    share: float  # of half the sum of squares before any effect
    indistinguishable: tuple[str, ...]  # effects that explain the logs as well
    curve: Shape | None  # for a channel or a component
    standard_error: float  # of the size, in its unit; of a channel's curve, of its multiple
    further: tuple[Inside, ...] = ()  # what a form has inside its factors


def finished(
    linear: Linear,
    bare: Linear,
    index: int,
    candidate: Candidate,
    curve: Shape | None,
    standard_error: float,
    forms: tuple[Effect, ...],
) -> Accepted:
    """Return an effect of the final model with what is said of it; `bare` is the model without it, `forms` are its rivals."""
    problem = linear.problem
    term = linear.terms[index]
    own = replace(in_place(linear, index, candidate), gain=float((loss_of(bare) - loss_of(linear)).sum()))
    absorbing = problem.prior.free and own.changes == 0
    others = [e for e in problem.catalogue if e.id != own.id and not (absorbing and e.in_map)]
    others += [e for e in forms if term.effect in forms and e.place != term.effect.place]
    if term.course is not None:
        rivals = sorted(fit_all(bare, others, term.course), key=score, reverse=True)
        like = fit_candidate(bare, term.effect, size=term.size, like=term)
    else:
        expected = {e: first_order_gain(bare, e, term.begin, term.end) for e in others}
        rivals = sorted(
            (fit_candidate(bare, e, term.begin, term.end) for e in most_promising(expected)), key=score, reverse=True
        )
        like = fit_candidate(bare, term.effect, term.begin, term.end, term.size)  # fitted in the same way as the rivals
    indistinguishable = tuple(c.id for c in rivals if fits_as_well(like, c, problem.per_coarse))
    share = own.gain / max(float(loss_of(bare).sum()), own.gain, 1e-300)
    if isinstance(curve, FactorSurface):
        standard_error = float(np.hypot(standard_error, curve.error))
    further: Sequence[Inside] = ()
    if own.id.startswith(PREFIX):
        standard_error, further = with_inside(linear, index, standard_error)
    return Accepted(own, p_value(own, tried(problem)), share, indistinguishable, curve, standard_error, tuple(further))


def fits_as_well(best: Candidate, other: Candidate, per_coarse: int) -> bool:
    """Return whether another effect explains the log as well as the best one does.

    Two tests compare the losses by block, and neither may prefer the best effect: the sum of the differences (after Vuong), which
    a single block with a large difference may spoil, and their signed ranks, which many blocks with small differences may spoil.
    Where all blocks together differ by less than a tie, neither test is needed.
    """
    if other.gain > best.gain - thresholds.TIE:
        return True
    difference = np.add.reduceat(other.loss - best.loss, np.arange(0, best.loss.size, per_coarse))
    ranks = scipy.stats.rankdata(np.abs(difference)) * np.sign(difference)
    statistics = (float(x.sum() / max(np.sqrt(x @ x), 1e-300)) for x in (difference, ranks))
    return max(statistics) <= thresholds.INDISTINGUISHABLE and other.gain > 0.5 * best.gain

"""Formulas that explain the logs better than what was named, or no worse than several names do."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lpvobs.discovery import thresholds
from lpvobs.discovery.companions import clear
from lpvobs.discovery.evidence import Candidate
from lpvobs.discovery.fit import objective, refit
from lpvobs.discovery.form_search import best_forms
from lpvobs.discovery.forms import CHANNEL, parsed
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.residual import Term
from lpvobs.engines.effects import Effect


@dataclass(frozen=True)
class Rivals:
    """A formula that may take the place of names, and formulas that stand beside one."""

    best: Candidate | None = None
    clearly: bool = False  # whether healthy drives tell that it explains clearly more, or is the simpler cause
    as_good: tuple[Effect, ...] = ()  # listed beside a single name: explain more by what further numbers cost


def follows_a_channel(term: Term) -> bool:
    """Return whether an effect is a curve over a channel, or has a course that follows one: it is as free as a formula is."""
    return term.effect.id.startswith(CHANNEL) or (term.course is not None and bool(term.course.input))


def beside_names(linear: Linear, listed: Sequence[Candidate], forms: Sequence[Candidate]) -> Rivals:
    """Return which formulas of the first round rival the names of a model."""
    if not forms:
        return Rivals()
    left, each = objective(linear), [objective(refit(linear, [form.term])) for form in forms]
    best = forms[int(np.argmin(each))]
    if not len(linear.problem.patterns):  # noise drops out of both, and what they leave can be compared
        most = left * (thresholds.FORM_OVER_ONE if len(listed) == 1 else thresholds.FORM_OVER_MORE)
        return Rivals(best if min(each) < most else None)
    as_good = _as_good(forms, each, left) if len(listed) == 1 else ()
    more = clear(objective(refit(linear, ())) - left)
    most = left + (len(listed) - 2) * thresholds.FORM_CLEAR
    return Rivals(best if min(each) < most else None, min(each) < left - more, as_good)


def in_place_of(linear: Linear, listed: Sequence[Candidate]) -> Rivals | None:
    """Return a formula in place of curves over channels, or of all errors of the reading if one of them follows a channel.

    It explains clearly more than the curve; hardly less than several names with a curve among them, and more than several without.
    It is sought with the weights that hold beside the names, where healthy drives tell. None where there is no such name.
    """
    names = range(len(listed))
    channels = [i for i in names if listed[i].id.startswith(CHANNEL)]
    at_sensor = [i for i in names if listed[i].term.effect.place == "sensor"]
    several = len(at_sensor) > 1 and any(follows_a_channel(listed[i].term) for i in at_sensor)
    if not len(linear.problem.patterns):
        return Rivals() if channels else None
    if not (channels or several):
        return None
    tried = [(at_sensor, thresholds.FORM_CLEAR if channels else 0.0)] if several else []
    left = objective(linear)
    for out, more in (*tried, *(([i], -thresholds.FORM_CLEAR) for i in channels)):
        bare = refit(linear, [term for i, term in enumerate(linear.terms) if i not in out])
        for form in best_forms(bare, [replace(listed[out[0]], gain=objective(bare) - left)]):
            if objective(refit(bare, [*bare.terms, form.term])) < left + more:
                return Rivals(form, clearly=True)
    return Rivals()


def _as_good(forms: Sequence[Candidate], each: Sequence[float], left: float) -> tuple[Effect, ...]:
    """Return the formulas that leave less than a name does by what their further numbers cost; their search has no price here."""
    costs = [thresholds.COST * (parsed(c.id).unknowns - 1) for c in forms]
    return tuple(c.term.effect for c, own, cost in zip(forms, each, costs, strict=True) if own < left - cost)

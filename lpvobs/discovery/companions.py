"""Whether an effect beside others is a cause of its own, or only what they leave: the catalogue has not quite their shape."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lpvobs.discovery import thresholds
from lpvobs.discovery.curves import over_time
from lpvobs.discovery.evidence import Candidate, in_place
from lpvobs.discovery.fit import fit, objective, refit, without
from lpvobs.discovery.forms import CHANNEL, PREFIX, follows_a_rate
from lpvobs.discovery.held_out import Losses, cross_validated, noise_power
from lpvobs.discovery.linear import Linear, cancels, changed_by
from lpvobs.discovery.places import moves
from lpvobs.discovery.ranking import is_remnant, is_significant, is_uneven
from lpvobs.discovery.residual import Problem, Term, are_apart
from lpvobs.records import Array


def predicts_better(before: Linear, after: Linear, newest: Candidate) -> bool:
    """Return whether the newest effect explains enough of what is above noise in blocks that it was not fitted to.

    Where healthy drives tell, it must explain enough of all, and be more than what the others leave because the catalogue has not
    quite their shape.
    """
    bare = refit(after, before.terms)
    gained, losses = _gained(bare, after)
    if not len(after.problem.patterns):
        above = float(losses.before.sum()) - float(noise_power(bare)[losses.counted].sum())
        return bool(gained > thresholds.MATTERS * max(above, 0.0))
    matters = thresholds.MATTERS_LEARNED * float(losses.before.sum())
    return gained > matters and (not before.terms or _is_of_its_own(after, newest, gained))


def _gained(before: Linear, after: Linear) -> tuple[float, Losses]:
    """Return by how much the squares fall in blocks not fitted to, and the losses that tell.

    Noise that an effect adds is taken off: a reading without its lag has more of it. An instant of which so much is left that it is
    an outlier tells no more than that, for or against the effect.
    """
    losses = cross_validated(before, after)
    tells = losses.counted & after.problem.shown.any(axis=0)  # what has no balance is no usual instant
    at_each = losses.before - losses.after - noise_power(before) + noise_power(after)
    most = thresholds.OUTLIER**2 * np.median(losses.after[tells]) if tells.any() else 0.0
    told = np.where(losses.after > most, np.clip(at_each, -most, most), at_each)
    return float(told[tells].sum()), losses


def _is_of_its_own(linear: Linear, newest: Candidate, gained: float) -> bool:
    """Return whether the newest effect is more than what the others leave; it gains so much in blocks not fitted to.

    It is where it keeps some of its gain beside others of another shape, and that is proven, too. What else is wrong with the same
    sensor from the same moment on may be the shape of its error. A form takes rates over a second, and what they do faster looks
    like a reading that is late.
    """
    *others, last = range(len(linear.terms))
    effects = [term.effect for term in linear.terms]
    if any(cancels(linear, i, last) or (effects[last].late and follows_a_rate(effects[i].id)) for i in others):
        return False
    # a channel or a formula has the shape that came first, no cause's own
    shapeless = any(effects[i].id.startswith((CHANNEL, PREFIX)) for i in others)
    place = [(effect.place, effect.late) for effect in effects]
    here = any(place[i] == place[last] and _same_span(linear.terms[i], linear.terms[last]) for i in others)
    if shapeless or here:
        matters = gained > thresholds.SHAPE**2 * (_gained(refit(linear, ()), linear)[0] - gained)
        if shapeless or not matters:
            return matters
    share = own_share(linear, last)
    return share > thresholds.OWN and is_significant(
        replace(newest, gain=share * newest.gain), linear.problem, beside=True
    )


def own_share(linear: Linear, index: int) -> float:
    """Return the share of a term's gain that is left where every other term may have another shape.

    What another term changes may be off, in all balances alike, by a share of `SHAPE` rms that is smooth in the channels.
    """
    smooth, others = _bends(linear.problem), [i for i in range(len(linear.terms)) if i != index]
    changes = [changed_by(linear, i) for i in others]
    bent = [linear.whiten(change * each) for change in changes for each in smooth]
    own = linear.whiten(changed_by(linear, index))
    gradient, information = without(linear, index).beside(np.stack([*bent, own]))
    known = information[:-1, :-1] + np.eye(len(bent)) * len(smooth) / thresholds.SHAPE**2
    taken = np.linalg.solve(known, np.stack([gradient[:-1], information[:-1, -1]], axis=1))
    left, told = np.array([gradient[-1], information[-1, -1]]) - information[-1, :-1] @ taken
    if not (told > 0.0 and information[-1, -1] > 0.0 and left * gradient[-1] > 0.0):
        return 0.0
    return min(1.0, float((left**2 / told) / (gradient[-1] ** 2 / information[-1, -1])))


def _bends(problem: Problem) -> Array:
    """Return lines and parabolas over every moving channel and over the time, of unit variance, shape (m, K)."""
    lines = [x for x in (*problem.inputs().values(), problem.clock) if moves(x)]
    scaled = [(x - x.mean()) / x.std() for x in lines]
    return np.stack([*scaled, *((x**2 - 1.0) / np.std(x**2) for x in scaled)])


def clear(gain: float) -> float:
    """Return what a formula gains more than a name where the difference is clear; no cause has quite the catalogue's shape."""
    return max(thresholds.FORM_CLEAR, thresholds.SHAPE**2 * gain)


def has_other_cause(linear: Linear) -> bool:
    """Return whether what is named of the sensor, where healthy drives tell, describes an error that has another cause.

    A curve over the time explains clearly more than the names. Or a curve over a channel, which has the shape that the error has,
    explains hardly more than one over the time, and is any slow channel's, or leaves room for a further error of the reading.
    """
    named = [term.effect for term in linear.terms if term.effect.place == "sensor"]
    if not (named and len(linear.problem.patterns)):
        return False
    channels = [effect.id for effect in named if effect.id.startswith(CHANNEL)]
    further = [effect for effect in named if not (effect.late or effect.id.startswith((CHANNEL, PREFIX)))]
    if len(channels) > 1 or (channels and further):
        return True
    bare = refit(linear, [term for term in linear.terms if term.effect.place != "sensor"])
    left, without_any = objective(linear), objective(bare)
    ahead = left - objective(refit(bare, [*bare.terms, over_time(bare).term]))
    return ahead > (-(thresholds.SHAPE**2) * (without_any - left) if channels else clear(without_any - left))


def is_remainder(candidate: Candidate, accepted: Sequence[Candidate], problem: Problem) -> bool:
    """Return whether an effect is only what the others leave in fast transients or at their edges.

    Its gain is then small beside theirs, and it has no single size, or it both begins and ends.
    """
    most = max((c.gain for c in accepted), default=0.0)
    little = candidate.gain < min(thresholds.AGAIN * most, thresholds.REST * 0.5 * problem.data)
    return little and (candidate.changes > 1 or is_uneven(candidate, problem))


def pruned(linear: Linear, accepted: Sequence[Candidate]) -> tuple[Sequence[Candidate], Linear]:
    """Return the effects that are still needed beside the others, and the model with these alone.

    Where healthy drives tell, what begins at the place of a stronger effect in the same moment is that effect, of another shape
    than the catalogue's. What is too small for a fault is what the others leave. Both were in the model until here, so that nothing
    else took their place.
    """
    while accepted:
        accepted = [in_place(linear, i, c) for i, c in enumerate(accepted)]
        strong = [wald(c) for c in accepted]
        learned = len(linear.problem.patterns) > 0
        parts = [i for i in range(len(strong)) if learned and _is_part(i, strong, linear.terms)]
        parts += [i for i, term in enumerate(linear.terms) if len(strong) > 1 and is_remnant(term, linear.problem)]
        weakest = min(parts or range(len(strong)), key=strong.__getitem__)
        if not parts and strong[weakest] >= thresholds.WEAKEST:
            break
        accepted = [item for i, item in enumerate(accepted) if i != weakest]
        terms = [t for i, t in enumerate(linear.terms) if i != weakest]
        linear = fit(linear.problem, terms, start=linear)
    return accepted, linear


def _is_part(i: int, strong: Sequence[float], terms: Sequence[Term]) -> bool:
    """Return whether a term acts at the place of a stronger one from the same moment on, or makes the reading late as that does."""
    own = terms[i]
    alike = [
        (term.effect.place == own.effect.place and abs(term.begin - own.begin) <= thresholds.COARSE)
        or (term.effect.late and own.effect.late and term.whole and own.whole)
        for term in terms
    ]
    return any(same and further > strong[i] for same, further in zip(alike, strong, strict=True))


def wald(candidate: Candidate) -> float:
    """Return the squared distance of a size from none, over its variance."""
    away = candidate.term.size - candidate.term.effect.null
    return float(away**2 * candidate.information / max(candidate.unevenness, 1.0))


def same_place_again(candidate: Candidate, accepted: Sequence[Candidate], problem: Problem) -> bool:
    """Return whether a candidate acts at the place of an accepted effect, but at another time.

    No cause of the catalogue does that. The candidate is the same effect again, or one that ends beside one with an onset or
    an end. It need not be proven: two episodes and the pause between them have no single size. Where healthy drives tell, the same
    effect at the same time is what its shape leaves, and as little at another time as a shape leaves.
    """
    learned = len(problem.patterns) > 0
    least = thresholds.SHAPE**2 if learned else thresholds.AGAIN
    stops = candidate.changes > 0 and bool(np.isfinite(candidate.term.end))
    for c in accepted:
        if learned and c.id == candidate.id and _same_time(c.term, candidate.term):
            continue
        again = candidate.gain > least * c.gain
        beside = stops and c.changes > 0 and c.term.effect.place == candidate.term.effect.place
        apart = beside and separate_in_time(c.term, candidate.term) and not learned
        if (again and (beside or c.id == candidate.id)) or apart:
            return True
    return False


def is_another_episode(candidate: Candidate, accepted: Sequence[Candidate]) -> bool:
    """Return whether a candidate is an accepted effect at another time, more than half as large: no shape leaves so much."""
    away = candidate.term.size - candidate.term.effect.null
    same = [c.term for c in accepted if c.id == candidate.id and separate_in_time(c.term, candidate.term)]
    theirs = [term.size - term.effect.null for term in same]
    return any(away * own > 0.5 * own**2 for own in theirs)


def _same_time(one: Term, other: Term) -> bool:
    """Return whether two terms have the same course, and begin and end together within the error of an onset."""
    return one.course == other.course and _same_span(one, other)


def _same_span(one: Term, other: Term) -> bool:
    """Return whether two terms begin and end together within the error of an onset."""
    own, theirs = (one.begin, one.end), (other.begin, other.end)
    return bool(np.allclose(own, theirs, rtol=0.0, atol=thresholds.STRETCH))


def separate_in_time(one: Term, other: Term) -> bool:
    """Return whether two terms of one place act at different times, farther apart than the error of an onset."""
    return one.effect.place == other.effect.place and are_apart(one, other)

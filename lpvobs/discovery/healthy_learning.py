"""What healthy drives teach: the function that balances leave on all of them, and the errors beyond, each with its size.

The variances are those of largest likelihood, of means over some seconds. The function is the best for them at the instants.

Each healthy drive is judged by the others, too: the size of an effect varies by more than noise, because what healthy drives leave
differs from day to day. A fault must be larger.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.discovery import thresholds
from lpvobs.discovery.bells import Bells, spread_out
from lpvobs.discovery.curves import is_recorded, shape_shown
from lpvobs.discovery.evidence import elsewhere_of, first_order
from lpvobs.discovery.fit import fit
from lpvobs.discovery.form_search import shapes_shown
from lpvobs.discovery.healthy_drive import (
    HealthyDrive,
    by_constants,
    memory,
    root_of_constants,
    where_the_map_stands,
    with_map,
)
from lpvobs.discovery.imbalances import imbalances_at, map_along, operating_nodes, scenes_with
from lpvobs.discovery.lateness import late_by
from lpvobs.discovery.likeliest import LEAST_PIECES, Likeliest, at_first, likeliest, likeliest_lengths, pieces
from lpvobs.discovery.map_prior import MapPrior
from lpvobs.discovery.noise import beyond_usual, usual_sizes
from lpvobs.discovery.normal import map_normal
from lpvobs.discovery.onsets import best_onsets, over_noise
from lpvobs.discovery.places import moves
from lpvobs.discovery.residual import Problem, lay_out
from lpvobs.discovery.sizes import forget
from lpvobs.engines.effects import SENSOR
from lpvobs.engines.residual_model import ResidualModel
from lpvobs.maps.grid import Grid
from lpvobs.records import Array, Log

Scores = dict[str, list[tuple[float, float]]]  # gradient and information by name, whole and late


def learned(model: ResidualModel, grid: Grid, prior: MapPrior, logs: Sequence[Log]) -> HealthyDrive:
    """Return what healthy drives show; each tells what it seems to have of every effect, seen from the others.

    A single drive is two for that, its halves: seen from itself, it would seem to have nothing.
    """
    parts = halves(logs[0]) if len(logs) == 1 else list(logs)
    judged = [_judged(model, grid, prior, parts[:i] + parts[i + 1 :], log) for i, log in enumerate(parts)]
    *seen_by, onsets, data, blocks, uneven = zip(*judged, strict=True)
    (effects, whole, late, beyond), *shapes = (_beyond_on_drives(each, float(np.mean(data))) for each in seen_by)
    (curves, *_, of_curve), (forms, *_, of_form) = shapes
    common, no_size = float(beyond.mean()), np.full(len(curves) + len(forms), np.nan)  # shapes have none
    by_onset = [np.array([each[name] for name in effects]) for each in onsets]
    searched = over_noise(by_onset, late, beyond, np.array(data), np.array(blocks))
    whole, late = np.append(whole, no_size), np.append(late, no_size)
    found = learned_from(model, grid, prior, parts)
    return replace(
        found, logs=tuple(log.name for log in logs), effects=(*effects, *curves, *forms), whole=whole, half=late,
        beyond=np.concatenate([beyond, of_curve, of_form]), common=common, uneven=max(1.0, *uneven),
        searched=np.vstack([searched, np.full((no_size.size, 2), np.nan)]),
        seconds=float(np.mean([log.time[-1] - log.time[0] for log in logs])),
    )  # fmt: skip


def _beyond_on_drives(seen_by: Sequence[Scores], data: float) -> tuple[tuple[str, ...], Array, Array, Array]:
    """Return the names that all drives show, their sizes beyond noise, whole and late, and their variance by residual."""
    names = tuple(name for name in seen_by[0] if all(name in each for each in seen_by))
    if not names:
        return names, np.empty(0), np.empty(0), np.empty(0)
    scores = np.array([[each[name] for name in names] for each in seen_by])
    (whole, beyond), (late, beyond_late) = (beyond_noise(*scores[:, :, i].transpose(2, 0, 1)) for i in (0, 1))
    return names, whole, late, np.maximum(beyond, beyond_late) / data


def _judged(
    model: ResidualModel, grid: Grid, prior: MapPrior, others: Sequence[Log], log: Log
) -> tuple[Scores, Scores, Scores, dict[str, Array], float, int, float]:
    """Return what a drive shows of each effect, curve and form, as others see it, and by onsets; how much data; how uneven."""
    seen = learned_from(model, grid, prior, others)
    laid = seen.taken_off(lay_out(seen.engine(model), grid, prior.beside(seen.deviation), [log], spacing=seen.spacing))
    linear, middle = fit(laid, passes=2), 0.5 * float(laid.clock[0] + laid.clock[-1])
    spans = (-np.inf, np.inf), (middle, np.inf)
    recorded = [curve for curve in laid.model.curves if is_recorded(laid, curve)]
    effects = {effect.id: first_order(linear, effect, *spans) for effect in laid.catalogue}
    curves = {curve.id: [shape_shown(linear, curve, begin) for begin, _ in spans] for curve in recorded}
    forms = shapes_shown(linear, -np.inf, middle)
    onsets = {effect.id: best_onsets(linear, effect) for effect in laid.catalogue}
    uneven = elsewhere_of(linear)
    forget()
    return effects, curves, forms, onsets, laid.data, laid.first.size, uneven


def by_all_balances(model: ResidualModel, grid: Grid, prior: MapPrior, logs: Sequence[Log]) -> Array:
    """Return by how much the engine's unknowns deviate from those that the map was estimated with, (q,), as all balances show them.

    The map needs no balance of exhaust and turbine.
    """
    q, seconds = len(model.names), sum(float(log.time[-1] - log.time[0]) for log in logs)
    spacing = max(thresholds.SPACING, seconds / thresholds.MOST_ASKED)
    sound = where_the_map_stands(lay_out(model, grid, prior, logs, spacing=spacing))
    return fit(replace(sound, bounded=True), passes=3).beta[:q]


def halves(log: Log) -> list[Log]:
    """Return a log as two, each with half of the samples."""
    N = len(log)

    def part(on: slice) -> Log:
        segments = [(max(a, on.start) - on.start, min(b, on.stop) - on.start) for a, b in log.segments]
        return replace(
            log,
            time=log.time[on],
            channels={name: values[on] for name, values in log.channels.items()},
            auxiliary={name: values[on] for name, values in log.auxiliary.items()},
            segments=tuple((a, b) for a, b in segments if b > a),
            rows=log.rows[on],
        )

    return [part(slice(0, N // 2)), part(slice(N // 2, N))]


def beyond_noise(gradient: Array, information: Array) -> tuple[Array, Array]:
    """Return the standard deviation of each effect's size that noise does not explain, and its variance over that of noise.

    Both arguments have shape (drives, effects). A few drives show little of one effect: what all effects together vary by, in units
    of their noise, counts as `POOLED` further drives.
    """
    tells = information > 0.0
    known = np.where(tells, information, np.inf)
    beyond = np.where(tells, gradient**2 / known - 1.0, 0.0)
    n, pooled = tells.sum(0), thresholds.POOLED
    common = max(float(beyond.sum() / max(n.sum(), 1)), 0.0)
    own = np.maximum(beyond.sum(0) / np.maximum(n, 1), 0.0)
    found = np.maximum(own, (n * own + pooled * common) / (n + pooled))
    return np.sqrt(found * (1.0 / known).sum(0) / np.maximum(n, 1)), found


def learned_from(model: ResidualModel, grid: Grid, prior: MapPrior, logs: Sequence[Log]) -> HealthyDrive:
    """Return the engine that healthy drives show, and what it leaves on them; map and model are those that they made."""
    deviation = by_all_balances(model, grid, prior, logs)
    there = model.moved(deviation, model.covariance)
    problem = lay_out(there, grid, prior.beside(deviation), logs)
    return replace(left_of(problem, [log.name for log in logs]), deviation=deviation)


def left_of(problem: Problem, logs: Sequence[str]) -> HealthyDrive:
    """Return what an engine leaves on healthy drives, with the likeliest lengths of the bells and variances of all errors."""
    problem = where_the_map_stands(problem)
    B, K = problem.shown.shape
    scenes = scenes_with(problem, (), np.zeros(problem.spread.size))
    left = imbalances_at(problem, scenes, np.zeros(problem.spread.size)).reshape(B, 2, K)
    left = left - (problem.by_reading * map_along(problem.prior.mean, operating_nodes(problem, scenes)))[:, None]
    bare, mean = _bare(problem, logs), left.mean(1)
    inputs, found = bare.inputs(problem).mean(1), [at_first(len(bare.channels), K)] * B
    for number in range(thresholds.HEALTHY_PASSES):
        scale = _scales(mean - np.array([own.function for own in found]), problem)
        rows = [*zip(problem.shown, mean, scale, strict=True)]
        if number:  # the scale is that of noise from the second pass on
            every = zip(inputs, rows, found, strict=True)
            found = [likeliest_lengths(problem, along, *row, own) for along, row, own in every]
        bare = _placed(bare, problem, found)
        found = [
            likeliest(problem, bells.along(along), bells, *row, own)
            for bells, along, row, own in zip(bare.bells, inputs, rows, found, strict=True)
        ]
    answers = np.concatenate([left[None], with_map(problem, by_constants(problem)).reshape(-1, B, 2, K)]).swapaxes(0, 1)
    of_each = zip(bare.bells, bare.inputs(problem), problem.shown, answers, scale, found, strict=True)
    each = [_learned(problem, bells, views, on, y, own, best.variances) for bells, views, on, y, own, best in of_each]
    bells, *others = zip(*each, strict=True)
    own = _LearnedBalance(bells, *map(np.array, others))
    before, rest = scale, _scales(mean - own.along, problem)
    known_by, scale = (
        np.array([np.median(row[on]) if on.any() else 1.0 for row, on in zip(rows, problem.shown, strict=True)])
        for rows in (before, rest)
    )
    lasting = own.lasting * (known_by / scale) ** 2  # the variance of means over some seconds stays as it is
    # of an instant, in each balance: those of exhaust and turbine do not read the map
    information = np.where(own.amplitude > 0.0, 1.0 / (scale**2 * np.maximum(lasting, 1.0)), 0.0)
    nodes = operating_nodes(problem, scenes)
    return replace(
        bare, bells=own.bells, amplitude=own.amplitude, scale=scale, lasting=problem.spacing * lasting,
        missed=own.missed, slow=own.slow,
        of_map=map_normal(problem.prior.mean.size, nodes, information @ problem.by_reading**2),
        covariance=_known_to(problem.model, own.information.sum(0)),
    )  # fmt: skip


class _LearnedBalance(NamedTuple):
    """What is learned of one balance, or of each along a further axis."""

    bells: Any
    along: Array  # (K,) the function along the places, and what differs on that day
    information: Array  # (n, n) on the constants
    amplitude: Any
    lasting: Any
    missed: Any
    slow: Array


def _learned(
    problem: Problem,
    bells: Bells,
    views: Array,
    shown: NDArray[np.bool_],
    left: Array,
    scale: Array,
    variances: Array,
) -> _LearnedBalance:
    """Return what a balance leaves where it counts, as a function that is the same on all logs, and the errors beyond.

    `left` has shape (1 + n, 2, K): what the balance leaves, and its derivatives by the engine's n constants. `views` are the inputs
    of the bells in both views, `variances` those that means over `PIECE` show.
    """
    f, n = len(bells.centres) + views.shape[2] - bells.lengths.size, len(left) - 1
    logs = problem.of_log[shown][pieces(problem, shown)]
    if logs.size < LEAST_PIECES:
        nothing = replace(bells, weights=np.zeros(f), by_constant=np.zeros((f, n)), unsure=np.zeros((f, f)))
        return _LearnedBalance(nothing, np.zeros(shown.size), np.zeros((n, n)), 0.0, 1.0, 0.0, np.zeros(2))
    lasting, (size, *slow) = variances[0], np.median(scale[shown]) * np.sqrt(variances[1:])
    products, seen_by, information = np.zeros((f, f)), np.zeros((f, 1 + n)), np.zeros((n, n))
    along, of_day = 0.5 * (bells.along(views[0]) + bells.along(views[1])), []
    for i in np.unique(logs):
        on = shown & (problem.of_log == i)
        days = slow[0] * bells.of_day(along[on])
        own = np.hstack([days, slow[1] * memory(problem, i)[on[problem.of_log == i]]])
        weight = np.sqrt(0.5 / lasting) / scale[on]
        gram, seen = np.zeros([f + own.shape[1]] * 2), np.zeros((f + own.shape[1], 1 + n))
        for view, here, other in zip(views, (0, 1), (1, 0), strict=True):
            rows = np.hstack([bells.along(view[on]), own]) * weight[:, None]
            y = weight * left[:, here, on]
            gram += rows.T @ rows
            seen += rows.T @ y.T
            # the noise of derivatives is that of their own view
            information += y[1:] @ (weight * left[1:, other, on]).T
        known = np.linalg.solve(gram[f:, f:] + np.eye(own.shape[1]), np.hstack([gram[f:, :f], seen[f:]]))
        products += gram[:f, :f] - gram[:f, f:] @ known[:, :f]
        seen_by += seen[:f] - gram[:f, f:] @ known[:, f:]
        information -= seen[f:, 1:].T @ known[:, f + 1 :]
        of_day.append((on, days, known[: days.shape[1], : f + 1]))
    root = size * bells.root_with_lines(f)
    factor = scipy.linalg.cholesky(np.eye(f) + root @ products @ root.T, lower=True)
    # U = L^-1 R, and U' U is the weights' covariance
    features = scipy.linalg.solve_triangular(factor, root, lower=True)
    answers = features @ seen_by
    information -= answers[:, 1:].T @ answers[:, 1:]
    weights = features.T @ answers
    function, missed = along @ weights[:, 0], float(bells.missed(views, along)[shown].mean())
    for on, days, known in of_day:
        function[on] += days @ (known[:, f] - known[:, :f] @ weights[:, 0])
    found = replace(bells, weights=weights[:, 0], by_constant=weights[:, 1:], unsure=features.T)
    return _LearnedBalance(found, function, information, float(size), float(lasting), missed, np.array(slow))


def _known_to(model: ResidualModel, information: Array) -> Array:
    """Return the covariance of q unknowns, (q, q), after information on the engine's n constants; corrections stay."""
    root, n = root_of_constants(model), len(information)
    strength, axes = np.linalg.eigh(root[:n].T @ information @ root[:n])
    sizes = root @ axes
    share = np.minimum(1.0 / (1.0 + np.maximum(strength, 0.0)) + thresholds.LEAST_LEFT**2, 1.0)
    covariance = (sizes * share) @ sizes.T
    covariance[n:, n:] = model.covariance[n:, n:]
    return np.asarray(covariance)


def _bare(problem: Problem, logs: Sequence[str]) -> HealthyDrive:
    """Return where bells that reach as far along every channel stand on the drives, before anything is learned."""
    s, none, units = problem.signals, np.zeros(0), problem.model.units
    moving = tuple(name for name in problem.measured if moves(s[name]))
    # an engine that is not warm yet breathes otherwise, and temperatures that only logs have tell it
    states = tuple(
        name for name, x in problem.auxiliary.items() if units.get(name) == "K" and np.isfinite(x).all() and moves(x)
    )
    channels = (*(name for name in moving if name != SENSOR), *states)
    along = np.stack([*(problem.over_all(name) for name in channels), *(s.rate[name] for name in moving)], axis=1)
    temperatures = tuple(name for name in moving if units.get(name) == "K")
    late = np.abs(late_by(problem, temperatures)).mean(2)
    balances, nothing = problem.model.balances, Bells(*[np.zeros((0, 0))] * 6)
    return HealthyDrive(
        logs=tuple(logs), balances=balances, channels=channels, rates=moving,
        temperatures=temperatures, middle=along.mean(0), spread=along.std(0),
        late=np.where(late > 0.0, late, 1.0),
        bells=(nothing,) * len(balances), amplitude=none, of_map=none, deviation=np.zeros(len(problem.model.names)),
        covariance=none, scale=none, lasting=none, missed=none, slow=none, effects=(), whole=none, half=none, beyond=none,
        searched=np.zeros((0, 2)),
    )  # fmt: skip


def _placed(bare: HealthyDrive, problem: Problem, each: Sequence[Likeliest]) -> HealthyDrive:
    """Return the same with bells where the balances count, of the likeliest lengths, and as many as the variances ask for."""
    inputs, bells = bare.inputs(problem)[0, 0, :, : len(bare.channels)], []
    for empty, shown, own in zip(bare.bells, problem.shown, each, strict=True):
        enough = thresholds.UNTOLD / max(1.0, own.variances[1])
        every = 1 + int(shown.sum()) // (10 * thresholds.BELLS)  # ten places for each bell tell as much as all
        x = inputs[shown][::every]
        centres = spread_out(x / own.lengths, thresholds.BELLS, enough) * own.lengths
        bells.append(replace(empty, centres=centres, lengths=own.lengths).with_days(x))
    return replace(bare, bells=tuple(bells))


def _scales(left: Array, problem: Problem) -> Array:
    """Return the usual size of every balance's residual at every place, (B, K) [kg/s]; outliers have their own."""
    nodes = operating_nodes(problem, scenes_with(problem, (), np.zeros(problem.spread.size)))
    middle = np.array([np.median(row[on]) if on.any() else 0.0 for row, on in zip(left, problem.shown, strict=True)])
    own = np.where(problem.shown, left - middle[:, None], 0.0)
    scale = np.maximum(usual_sizes(problem, nodes, own), 1e-9)
    return scale * beyond_usual(own / scale)

"""Effects outside the catalogue: the air flow reading follows an auxiliary channel, or something that no log holds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf, isfinite
from typing import Any

import numpy as np

from lpvobs.errors import UsageError
from lpvobs.records import Array
from lpvobs.simulation import effects as catalogue
from lpvobs.simulation.effects import Timed, blended, check_span, span_at_work
from lpvobs.simulation.road import AUXILIARY

PREFIX = "channel:"
CHANNEL_FORMS = ("additive", "gain", "rate", "switch")
UNLOGGED_FORMS = ("additive", "gain")
SHAPES = ("abrupt", "smooth")
SHORTEST = 0.1  # s, mean time of a telegraph: below it the reading is noisy, not disturbed
FLANK = 0.25  # of an episode, in which a smooth one rises, and in which it falls


@dataclass(frozen=True)
class ChannelEffect(Timed):
    """The reading depends on a logged auxiliary channel c."""

    channel: str  # a name of `road.AUXILIARY`
    # `additive`: + amplitude (c - reference), kg/s per unit. `gain`: x (1 + amplitude (c - reference)), per unit.
    # `rate`: + amplitude dc/dt, kg/s per unit/s. `switch`: + amplitude [kg/s] while c exceeds the threshold.
    form: str
    amplitude: float
    reference: float | None = None  # in the channel's unit; its mean over the drive unless given
    threshold: float | None = None  # in the channel's unit; the middle of its range unless given

    def __post_init__(self) -> None:
        if self.channel not in AUXILIARY:
            known = ", ".join(AUXILIARY)
            raise UsageError(f"{self.id}: the simulator has no such auxiliary channel; expected one of {known}")
        _check_form(self.id, self.form, CHANNEL_FORMS)
        _check_amplitude(self.id, self.amplitude)
        if self.form == "switch":
            _check_strength(self.id, self.form, self.amplitude)
        for key, forms in (("reference", ("additive", "gain")), ("threshold", ("switch",))):
            if getattr(self, key) is not None and self.form not in forms:
                raise UsageError(f"{self.id}: form '{self.form}' does not use the key '{key}'; delete it")
        check_span(self.id, self.onset, self.end)

    @property
    def id(self) -> str:
        """The contract's identifier."""
        return PREFIX + self.channel

    def settled(self, truth: Mapping[str, Array], duration: float) -> "ChannelEffect":
        """Return the effect with what the drive decides; raises UsageError where it cannot show, or moves too far."""
        course = truth[self.channel]
        if float(np.ptp(course)) == 0.0:
            said = f"{self.id}: channel {self.channel} is constant on this drive, so no error can depend on it"
            raise UsageError(f"{said}; take a longer cycle or another seed")
        if self.form in ("additive", "gain"):
            reference = float(course.mean()) if self.reference is None else self.reference
            _check_strength(self.id, self.form, self.amplitude * float(np.abs(course - reference).max()))
            return replace(self, reference=reference)
        if self.form == "switch" and self.threshold is None:
            return replace(self, threshold=float(0.5 * (course.min() + course.max())))
        return self

    def on(self, W: Array, time: Array, point: Mapping[str, Array]) -> Array:
        """Return the reading W [kg/s] with the effect, shape (N,); settled, with the channel's true values at the same times."""
        course = point[self.channel]
        if self.form == "rate":
            signal = np.gradient(course, time) if time.size > 1 else np.zeros(1)
        elif self.form == "switch":
            signal = course > (self.threshold or 0.0)
        else:
            signal = course - (self.reference or 0.0)
        return blended(W, _disturbed(W, self.form, self.amplitude * signal), self.share(time))


@dataclass(frozen=True)
class Telegraph:
    """Episodes at random: on and off for exponentially distributed times of these means [s]."""

    seed: int
    on: float
    off: float

    def __post_init__(self) -> None:
        if not (self.seed >= 0 and SHORTEST <= self.on < inf and SHORTEST <= self.off < inf):
            needed = f"a seed of zero or more, and mean durations of at least {SHORTEST:g} s in the keys on and off"
            raise UsageError(f"unlogged: telegraph: expected {needed}")

    def episodes(self, duration: float) -> tuple[tuple[float, float], ...]:
        """Return the episodes that begin within a duration [s]; the drive starts between two of them."""
        stream = np.random.Generator(np.random.PCG64(self.seed))
        found: list[tuple[float, float]] = []
        moment = float(stream.exponential(self.off))
        while moment < duration:
            stop = moment + float(stream.exponential(self.on))
            found.append((moment, stop))
            moment = stop + float(stream.exponential(self.off))
        return tuple(found)


@dataclass(frozen=True)
class UnloggedEffect:
    """The reading is disturbed by something that no log holds, which comes and goes."""

    id = "unlogged"  # what effects files call it
    form: str  # `additive`: + amplitude [kg/s]. `gain`: x (1 + amplitude).
    amplitude: float
    episodes: tuple[tuple[float, float], ...] | Telegraph  # [s]; at least two of them
    shape: str = "abrupt"  # `abrupt`, or `smooth`: rises and falls over a quarter of an episode each

    def __post_init__(self) -> None:
        _check_form(self.id, self.form, UNLOGGED_FORMS)
        _check_strength(self.id, self.form, self.amplitude)
        if self.shape not in SHAPES:
            raise UsageError(f"{self.id}: shape = '{self.shape}', expected {' or '.join(SHAPES)}")
        if not isinstance(self.episodes, Telegraph):
            _check_episodes(self.episodes)

    def settled(self, truth: Mapping[str, Array], duration: float) -> "UnloggedEffect":
        """Return the effect with the episodes of a drive [s]; raises UsageError where fewer than two begin within it."""
        drawn = self.episodes.episodes(duration) if isinstance(self.episodes, Telegraph) else self.episodes
        inside = tuple(episode for episode in drawn if episode[0] < duration)
        if len(inside) < 2:
            said = f"unlogged: {len(inside)} episodes begin within the drive, which lasts {duration:g} s; expected at least two"
            raise UsageError(f"{said}; start the episodes earlier, or take another seed")
        return replace(self, episodes=inside)

    def on(self, W: Array, time: Array, point: Mapping[str, Array]) -> Array:
        """Return the reading W [kg/s] with the effect, shape (N,); settled."""
        spans = () if isinstance(self.episodes, Telegraph) else self.episodes
        strength = self.amplitude * sum(_episode(time, *span, self.shape) for span in spans)
        return _disturbed(W, self.form, strength)


Injected = catalogue.CatalogueEffect | ChannelEffect | UnloggedEffect  # Whatever an effects file can hold


def _disturbed(W: Array, form: str, strength: Array | float) -> Array:
    return np.asarray(W * (1.0 + strength) if form == "gain" else W + strength)


def _episode(time: Array, start: float, stop: float, shape: str) -> Array:
    """Return the share of one episode that is there, shape (N,), from 0 to 1."""
    if shape == "abrupt":
        return np.where(span_at_work(start, stop, time), 1.0, 0.0)
    flank = FLANK * (stop - start)
    inside = np.clip(np.minimum(time - start, stop - time) / flank, 0.0, 1.0)
    return np.asarray(np.sin(0.5 * np.pi * inside) ** 2)


def _check_form(name: str, form: str, known: tuple[str, ...]) -> None:
    if form not in known:
        raise UsageError(f"{name}: form = '{form}', expected one of {', '.join(known)}")


def _check_amplitude(name: str, amplitude: float) -> None:
    if not isfinite(amplitude):
        raise UsageError(f"{name}: amplitude = {amplitude:g}, expected a finite number")


def _check_strength(name: str, form: str, strength: float) -> None:
    """Refuse what moves the reading further than the catalogue's own gain and offset may."""
    _check_amplitude(name, strength)
    gain, offset = (catalogue.CATALOGUE[kind] for kind in ("maf.gain", "maf.offset"))
    most, unit = (1.0 - gain.low, "times itself") if form == "gain" else (offset.high, offset.unit)
    if abs(strength) > most:
        said = f"{name}: the effect would change the reading by {abs(strength):g} {unit}, expected at most {most:g}"
        raise UsageError(f"{said}; check amplitude and its unit")


def _check_episodes(episodes: Sequence[tuple[float, float]]) -> None:
    if len(episodes) < 2:
        said = f"unlogged: {len(episodes)} episodes, expected at least two"
        raise UsageError(f"{said}; write a single episode as an effect with onset and end")
    for start, stop in episodes:
        check_span("unlogged", start, stop)
    if any(after[0] <= before[1] for before, after in pairwise(episodes)):
        raise UsageError("unlogged: episodes overlap or are not in order of time; expected start < stop < next start")


def injected_of(table: Mapping[str, Any]) -> Injected:
    """Return what one `[[effect]]` table describes; raises UsageError for anything missing, unknown, or that cannot be meant."""
    identifier = table.get("id")
    if isinstance(identifier, str) and identifier.startswith(PREFIX):
        return _channel_effect_of(catalogue.Entry(identifier, table))
    return _unlogged_of(table) if identifier == "unlogged" else catalogue.effect_of(table)


def _channel_effect_of(entry: catalogue.Entry) -> ChannelEffect:
    entry.refuse_others("id", "form", "amplitude", "reference", "threshold", *entry.course_keys())
    form, amplitude = entry.text("form"), entry.number("amplitude")
    reference, threshold = entry.optional("reference"), entry.optional("threshold")
    channel = entry.name.removeprefix(PREFIX)
    return ChannelEffect(channel, form, amplitude, reference, threshold, **entry.timed())


def _unlogged_of(table: Mapping[str, Any]) -> UnloggedEffect:
    entry = catalogue.Entry("unlogged", {"shape": "abrupt", **table})
    entry.refuse_others("id", "form", "amplitude", "episodes", "telegraph", "shape")
    shape = entry.text("shape")
    if ("episodes" in table) == ("telegraph" in table):
        raise UsageError("unlogged: expected either episodes = [[start, stop], ...] or telegraph = { seed, on, off }")
    drawn = _telegraph(table["telegraph"]) if "telegraph" in table else entry.pairs("episodes")
    return UnloggedEffect(entry.text("form"), entry.number("amplitude"), drawn, shape)


def _telegraph(table: Any) -> Telegraph:
    if not isinstance(table, Mapping) or type(table.get("seed")) is not int:  # a bool is an int to isinstance
        raise UsageError("unlogged: telegraph needs a whole number as seed; write { seed = 1, on = 40.0, off = 60.0 }")
    entry = catalogue.Entry("unlogged: telegraph", table)
    entry.refuse_others("seed", "on", "off")
    return Telegraph(table["seed"], entry.number("on"), entry.number("off"))

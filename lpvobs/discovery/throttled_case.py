"""One log held against a learned engine: its signals with the day's own zeros taken out, and its balances with effects undone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lpvobs.discovery.throttled_noise import HealthyErrors
from lpvobs.engines.throttled.balances import BALANCES, Balancer, Scene, present, scene_of
from lpvobs.engines.throttled.blocks import Blocks
from lpvobs.engines.throttled.constants import DayToDay, Learned, ThrottledEngine
from lpvobs.engines.throttled.effects import CATALOGUE, Effect
from lpvobs.records import Array, Log

ALWAYS, FOREVER = -np.inf, np.inf
DAILY = ("p_im.gain", "p_im.offset", "p_ic.gain", "p_ic.offset", "alpha_th.offset", "maf.delay")
"""Effects of which every day has a little."""


@dataclass(frozen=True)
class Term:
    """An effect with its size, acting from `begin` to `end` [s] since the start of the log."""

    effect: Effect
    size: float
    begin: float = ALWAYS
    end: float = FOREVER


@dataclass(frozen=True)
class Case:
    """One log, and the engine it is held against.

    Attributes
    ----------
    engine : ThrottledEngine
    learned : Learned
    healthy : HealthyErrors
    day_to_day : DayToDay
    log : Log
    blocks : Blocks
    shift : ndarray, shape (blocks, 4)
        What an engine learned without the block says beyond `learned`; zero where the log taught nothing.
    own : bool
        Whether the log itself taught the engine: then what acts all the time belongs to it.
    had : tuple of Term
        Effects that are part of the model already.
    today : mapping of str to float
        Sizes of some of `DAILY` that are taken out of the signals.
    lift : ndarray, shape (blocks, 4)
        What those sizes do to the balances as far as it is linear, put back: levels of the day stay random, near these.
    """

    engine: ThrottledEngine
    learned: Learned
    healthy: HealthyErrors
    day_to_day: DayToDay
    log: Log
    blocks: Blocks
    shift: Array
    own: bool
    had: tuple[Term, ...] = ()
    today: Mapping[str, float] = field(default_factory=dict)
    lift: Array | None = None

    @cached_property
    def scene(self) -> Scene:
        """The signals without the day's own zeros."""
        scene = scene_of(self.log)
        for effect in CATALOGUE:
            if effect.id in self.today:
                scene = effect.undo(self.engine, scene, self.today[effect.id])
        return scene

    @cached_property
    def balancer(self) -> Balancer:
        """Draws up the balances."""
        return Balancer(self.engine, self.learned, self.blocks, self.scene)

    @cached_property
    def counted(self) -> NDArray[np.bool_]:
        """Which balances count in which blocks, shape (blocks, 4)."""
        counted = np.tile(present(self.log), (self.blocks.count, 1))
        if counted[:, 3].any():
            counted[:, 3] &= self.blocks.mean(self.log["W_maf"]) < self.healthy.calm_flow
        return counted

    @cached_property
    def candidates(self) -> tuple[Effect, ...]:
        """The effects that the channels of the log can show."""
        return tuple(e for e in CATALOGUE if all(channel in self.log.channels for channel in e.needs))

    def imbalances(self, terms: Sequence[Term]) -> Array:
        """Return what is left of each balance with effects undone where they act, those of the model first, (blocks, 4)."""
        terms = (*self.had, *terms)
        acting = np.zeros((len(terms), self.blocks.count), dtype=bool)
        for row, term in zip(acting, terms, strict=True):
            row[:] = self.acts(term.begin, term.end)
        out = np.zeros((self.blocks.count, len(BALANCES)))
        patterns, which = np.unique(acting, axis=1, return_inverse=True)
        for number, pattern in enumerate(patterns.T):
            here = which.reshape(-1) == number
            scene = self.scene
            for term, on in zip(terms, pattern, strict=True):
                if on:
                    scene = term.effect.undo(self.engine, scene, term.size)
            out[here] = self.balancer(scene)[here]
        return out + self.shift + (0.0 if self.lift is None else self.lift)

    def acts(self, begin: float, end: float) -> NDArray[np.bool_]:
        """Return in which blocks an effect acts, by their middles."""
        return np.asarray((self.blocks.time >= begin) & (self.blocks.time < end))

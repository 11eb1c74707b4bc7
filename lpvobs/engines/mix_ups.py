"""What may be wrong with a log although every reading in it is possible: channels exchanged, a pressure relative to another."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lpvobs.records import Array

Channels = dict[str, Array]


@dataclass(frozen=True)
class MixUp:
    """A mistake without which the balances agree: what to say of it, and how to put the channels right."""

    says: str
    mended: Callable[[Channels], Channels]


@dataclass(frozen=True)
class Check:
    """What no healthy engine does for more than a share of the time, whatever its constants, and where a log does it."""

    says: str
    broken: Callable[[Channels], NDArray[np.bool_]]
    most: float


@dataclass(frozen=True)
class Suspects:
    """What the logs of a kind of engine are tried for."""

    checks: tuple[Check, ...] = ()
    mix_ups: tuple[MixUp, ...] = ()


NONE_SUSPECTED = Suspects()


def exchanged(one: str, other: str) -> MixUp:
    """Return the mistake that two channels bear each other's names."""
    return MixUp(f"{one} and {other} exchanged", partial(_exchange, one, other))


def below(one: str, other: str, most: float, slack: float = 0.0, unit: str = "") -> Check:
    """Return the check that a channel is not more than `slack` [unit] below another for more than a share of the time."""
    far = f"more than {slack:g} {unit} " if slack else ""
    return Check(f"{one} is {far}below {other}", partial(_below, one, other, slack), most)


def _exchange(one: str, other: str, channels: Channels) -> Channels:
    return {**channels, one: channels[other], other: channels[one]}


def _below(one: str, other: str, slack: float, channels: Channels) -> NDArray[np.bool_]:
    return np.asarray(channels[one] < channels[other] - slack)

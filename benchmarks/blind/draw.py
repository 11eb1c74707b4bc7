"""What is in a log of the bank: drawn from the bank's seed and the log's number alone.

Sizes are drawn log-uniformly between limits known for the class of engine (data sheets, series tolerances, leaks that diagnosis
has found); the lower limits lie where the effect begins to show beside noise and tolerances.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

BANK = 20261121
"""Added to the bank's seed, so that its numbers are nobody else's."""
KINDS = ("clean",) * 10 + ("single",) * 13 + ("pair",) * 3 + ("channel",) * 2 + ("unlogged",) * 2
"""Of every thirty logs."""
LEAST_EPISODE = 5.0
"""[s] that what nothing logged drives stays on, and off between: a blip beside one long episode is no coming and going."""
Piece: TypeAlias = tuple[str, float, float]
Drawn: TypeAlias = dict[str, Any]


@dataclass(frozen=True)
class Size:
    """How large an effect is drawn: `kind` says how the drawn magnitude becomes the parameter."""

    parameter: str
    least: float
    most: float
    kind: str


FACTOR, LESS, MORE, SIGNED, PLAIN = "1 +- x", "1 - x", "1 + x", "+- x", "x"


@dataclass(frozen=True)
class Case:
    """One log and its truth.

    Attributes
    ----------
    number : int
    kind : str
        clean, single, pair, channel or unlogged.
    piece : tuple
        Cycle or recording, begin and end [s].
    nominal : tuple or None
        The piece that the nominal map is made from; None makes the map from the log itself.
    seed : int
        Of noise, and of everything that moves on the road.
    healthy : mapping of str to float
        How this engine differs from the configured one, or this day from others, without being at fault.
    effects : list of mapping
        As in the tables `[[effect]]`.
    """

    number: int
    kind: str
    piece: Piece
    nominal: Piece | None
    seed: int
    healthy: dict[str, float]
    effects: list[Drawn] = field(default_factory=list)

    @property
    def length(self) -> float:
        """Length of the drive [s]."""
        return self.piece[2] - self.piece[1]


@dataclass(frozen=True, eq=False)
class Engine:
    """What an engine brings to the bank; it is equal to itself alone.

    Attributes
    ----------
    name : str
        Also the name of its folder.
    config : str
        File in `configs`.
    logs : int
        How many make a bank.
    sizes : mapping of str to Size
        Its catalogue.
    draw : callable
        Takes the bank's seed and a number.
    record : callable
        Writes the log of a case at a path, with its effects or without, and the nominal one beside it.
    missing : callable
        Returns why there are no drives of this engine here, empty if there are.
    """

    name: str
    config: str
    logs: int
    sizes: Mapping[str, Size]
    draw: Callable[[int, int], Case]
    record: Callable[[Case, Path, bool], None]
    missing: Callable[[], str] = lambda: ""


def name_of(case: Case) -> str:
    """Return a name that tells nothing: a hash of the number."""
    return hashlib.sha256(f"log {case.seed}".encode()).hexdigest()[:12]


def generator(bank: int, number: int) -> tuple[np.random.Generator, str]:
    """Return the random numbers of a log, and its kind."""
    return np.random.default_rng([BANK, bank, number]), KINDS[number % len(KINDS)]


def seed_of(bank: int, number: int) -> int:
    """Return the seed of a log's noise and road."""
    return 1000 * bank + number


def turn(sizes: Mapping[str, Size], number: int) -> str:
    """Return the effect whose turn it is: single effects go round the catalogue."""
    rounds, place = divmod(number, len(KINDS))
    single = KINDS[:place].count("single") + rounds * KINDS.count("single")
    return list(sizes)[single % len(sizes)]


def sized(rng: np.random.Generator, id_: str, size: Size) -> Drawn:
    """Return an effect of the catalogue at a drawn size."""
    magnitude = float(np.exp(rng.uniform(np.log(size.least), np.log(size.most))))
    sign = float(rng.choice([-1.0, 1.0]))
    value = {
        FACTOR: 1.0 + sign * magnitude,
        LESS: 1.0 - magnitude,
        MORE: 1.0 + magnitude,
        SIGNED: sign * magnitude,
        PLAIN: magnitude,
    }[size.kind]
    return {"id": id_, size.parameter: value}


def interval(rng: np.random.Generator, length: float) -> Drawn:
    """Return where an effect begins, and sometimes ends."""
    found = {"onset": round(float(rng.uniform(0.2, 0.65) * length), 1)}
    if rng.random() < 0.25:
        found["end"] = round(float(found["onset"] + rng.uniform(0.2, 0.33) * length), 1)
    return found


def two(rng: np.random.Generator, sizes: Mapping[str, Size]) -> list[str]:
    """Return the identifiers of two different effects."""
    return [str(id_) for id_ in rng.choice(list(sizes), 2, replace=False)]


def channel(
    rng: np.random.Generator, moves: Mapping[str, float], additive: tuple[float, float], gain: tuple[float, float]
) -> Drawn:
    """Return an error of the flow's reading that follows one of the channels, which move by so much."""
    name = str(rng.choice(list(moves)))
    form = str(rng.choice(["additive", "gain"]))
    size = rng.uniform(*(additive if form == "additive" else gain))
    return {"id": f"channel:{name}", "form": form, "amplitude": float(size * rng.choice([-1, 1]) / moves[name])}


def unlogged(
    rng: np.random.Generator, length: float, additive: tuple[float, float], gain: tuple[float, float]
) -> Drawn:
    """Return an error of the flow's reading in episodes that nothing logged goes with."""
    episodes = int(rng.integers(2, 5))
    times = np.zeros(2)
    while np.diff(times).min() < LEAST_EPISODE:
        times = np.sort(rng.uniform(0.05, 0.95, 2 * episodes)) * length
    form = str(rng.choice(["additive", "gain"]))
    size = rng.uniform(*(additive if form == "additive" else gain))
    return {
        "id": "unlogged",
        "form": form,
        "amplitude": float(size * rng.choice([-1, 1])),
        "episodes": [[round(float(a), 1), round(float(b), 1)] for a, b in times.reshape(-1, 2)],
    }

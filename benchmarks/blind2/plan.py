"""What is in each drive of the second bank: drawn from the bank's seed and the drive's number alone."""

import hashlib
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from faults import OTHER_LAWS, UNLISTED, Hose, Misreading, Unlisted
from population import BANK, ENGINES, PIECES, VARIATIONS

from lpvobs.simulation.effects import CATALOGUE, CatalogueEffect, EffectCourse

KINDS = (
    "clean", "single", "varied", "curve", "single", "course", "pair", "varied", "single", "form", "clean", "single",
    "varied", "pair", "single", "curve", "clean", "course", "single", "varied", "form", "single", "pair", "clean",
)  # fmt: skip
"""Of every twenty-four drives; a third has nothing wrong."""
ONLY_TODAY = 7
"""Of so many varied drives one has its variation today alone; its healthy drives have not."""
PER_ENGINE = 8
"""Drives before the next engine's turn: a bank that is stopped early has judged fewer engines, each on as many kinds."""
ORDER = (0, 2, 8, 1, 3, 9, 4, 5, 10, 6, 7, 11)
"""Engines calibrated from a bench and from a healthy drive take turns."""
SIZES = {
    "maf.gain": (0.04, 0.15, "either"),
    "maf.offset": (5e-4, 2e-3, "signed"),
    "maf.lag": (0.03, 0.12, "plain"),
    "maf.delay": (0.02, 0.06, "plain"),
    "maf.drift": (8e-5, 4e-4, "signed"),
    "maf.contamination": (0.0, 0.0, "law"),
    "maf.backflow": (0.0, 0.0, "law"),
    "leak.inlet": (0.0, 0.0, "law"),
    "leak.intake": (5e-6, 2.5e-5, "plain"),
    "egr.leak": (3e-6, 1.2e-5, "plain"),
    "egr.area": (0.1, 0.3, "less"),
    "eta_vol.factor": (0.04, 0.1, "less"),
    "compressor.flow": (0.03, 0.08, "less"),
    "turbine.efficiency": (0.05, 0.12, "less"),
    "exhaust.restriction": (1.0, 4.0, "more"),
    "u_delta.gain": (0.04, 0.1, "either"),
    "p_im.gain": (0.012, 0.04, "either"),
    "p_im.offset": (1000.0, 3000.0, "signed"),
    "p_em.gain": (0.015, 0.05, "either"),
    "omega_t.gain": (0.007, 0.02, "either"),
    "T_im.lag": (2.0, 10.0, "plain"),
}
"""Least and most, log-uniform, and how the size becomes the parameter: as in the first bank, a few lower limits raised."""
CURVES = {
    "eta_vol.curve": ((0.025, 0.06), (1500.0, 2400.0), (300.0, 600.0)),
    "compressor.curve": ((0.03, 0.08), (130.0, 230.0), (25.0, 50.0)),
    "egr.curve": ((0.15, 0.40), (12.0, 35.0), (6.0, 14.0)),
    "turbine.curve": ((0.05, 0.12), (35.0, 65.0), (8.0, 16.0)),
}
"""Ranges of amplitude, centre and width."""
GROWING = ("ramp", "saturating")
COURSES = (
    ("leak.intake", "ramp"), ("egr.leak", "hysteresis"), ("maf.gain", "intermittent"), ("maf.gain", "lagged"),
    ("turbine.efficiency", "ramp"), ("leak.intake", "saturating"), ("p_im.offset", "intermittent"),
    ("eta_vol.factor", "ramp"), ("exhaust.restriction", "saturating"), ("maf.offset", "hysteresis"),
    ("egr.area", "hysteresis"), ("maf.gain", "ramp"),
)  # fmt: skip


@dataclass(frozen=True)
class Drive:
    """One drive and its truth.

    Attributes
    ----------
    number : int
    kind : str
    engine : int
        Its place in the population.
    only_today : bool
        The variation of the engine is not in its healthy drives.
    piece : tuple
        Cycle, begin and end [s].
    seed : int
    effects : list
        As `simulate` takes them.
    """

    number: int
    kind: str
    engine: int
    only_today: bool
    piece: tuple[str, float, float]
    seed: int
    effects: list[Any] = field(default_factory=list)

    @property
    def home(self) -> str:
        """Name of the folder with what the engine is known from: a hash."""
        return _hash(f"engine {self.seed // 1000} {self.engine} {self.only_today}")[:6]

    @property
    def name(self) -> str:
        """A name that tells nothing but the folder of its engine."""
        return f"{self.home}_{_hash(f'drive {self.seed}')[:10]}"


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def drawn_drive(bank: int, number: int) -> Drive:
    """Return the drive of a number."""
    rng, kind = np.random.default_rng([BANK, bank, number]), KINDS[number % len(KINDS)]
    turn = _turn(kind, number)
    engine = ENGINES + turn % len(VARIATIONS) if kind == "varied" else ORDER[number // PER_ENGINE % ENGINES]
    piece = PIECES[rng.integers(len(PIECES))]
    length = piece[2] - piece[1]
    effects: list[Any] = []
    if kind == "single":
        effects = [_listed(rng, list(SIZES)[turn % len(SIZES)], length)]
    elif kind == "pair":
        effects = [_listed(rng, str(id_), length) for id_ in rng.choice(list(SIZES), 2, replace=False)]
    elif kind == "curve":
        effects = [_curve(rng, list(CURVES)[turn % len(CURVES)], length)]
    elif kind == "course":
        effects = [_coming(rng, *COURSES[turn % len(COURSES)], length)]
    elif kind == "form":
        effects = [Unlisted(list(UNLISTED)[turn % len(UNLISTED)], float(rng.uniform(0.02, 0.05) * rng.choice([-1, 1])))]
    only_today = kind == "varied" and turn % ONLY_TODAY == ONLY_TODAY - 1
    return Drive(number, kind, engine, only_today, piece, 1000 * (bank % 1_000_000) + number, effects)


def _turn(kind: str, number: int) -> int:
    """Return how many of the kind came before, and one more for every time that all engines had their turn.

    Otherwise each effect would come back to the same two engines: KINDS, turns and lists of effects have common divisors.
    """
    rounds, place = divmod(number, len(KINDS))
    before = KINDS[:place].count(kind) + rounds * KINDS.count(kind)
    return before if kind == "varied" else before + number // (PER_ENGINE * ENGINES)


def _between(rng: np.random.Generator, least: float, most: float) -> float:
    return float(np.exp(rng.uniform(np.log(least), np.log(most))))


def _value(rng: np.random.Generator, id_: str) -> float:
    least, most, kind = SIZES[id_]
    size, sign = _between(rng, least, most), float(rng.choice([-1.0, 1.0]))
    return {"either": 1 + sign * size, "signed": sign * size, "plain": size, "less": 1 - size, "more": 1 + size}[kind]


def _span(rng: np.random.Generator, length: float) -> dict[str, float]:
    """Return an onset in half of all drives."""
    return {"onset": round(float(rng.uniform(0.2, 0.6) * length), 1)} if rng.random() < 0.5 else {}


def _listed(rng: np.random.Generator, id_: str, length: float) -> Any:
    if id_ in OTHER_LAWS:
        drawn, least, most = OTHER_LAWS[id_]
        return Misreading(id_, drawn(rng), _between(rng, least, most), **_span(rng, length))
    found = CatalogueEffect(id_, _value(rng, id_), **_span(rng, length))
    return replace(found, course=Hose()) if id_ == "leak.intake" else found


def _curve(rng: np.random.Generator, id_: str, length: float) -> CatalogueEffect:
    sizes, centres, widths = CURVES[id_]
    amplitude = _between(rng, *sizes) * float(rng.choice([-1.0, 1.0]))
    return CatalogueEffect(
        id_, amplitude, bump=(float(rng.uniform(*centres)), float(rng.uniform(*widths))), **_span(rng, length)
    )


def _coming(rng: np.random.Generator, id_: str, course: str, length: float) -> CatalogueEffect:
    value, onset = _value(rng, id_), round(float(rng.uniform(0.15, 0.35) * length), 1)
    if course == "ramp":
        end = round(onset + float(rng.uniform(0.3, 0.5)) * length, 1)
        return CatalogueEffect(id_, value, onset=onset, end=end, course=EffectCourse("ramp"))
    if course == "saturating":
        tau = float(rng.uniform(0.1, 0.25) * length)
        return CatalogueEffect(id_, value, onset=onset, course=EffectCourse("saturating", time_constant=tau))
    if course == "intermittent":
        edges = np.sort(rng.uniform(0.1, 0.9, 6)) * length
        while np.diff(edges).min() < 20.0:
            edges = np.sort(rng.uniform(0.1, 0.9, 6)) * length
        spans = tuple((round(float(a), 1), round(float(b), 1)) for a, b in edges.reshape(-1, 2))
        return CatalogueEffect(id_, value, course=EffectCourse("intermittent", intervals=spans))
    if course == "hysteresis":
        followed = EffectCourse(
            "hysteresis", input="u_delta", low=float(rng.uniform(1, 4)), high=float(rng.uniform(16, 24))
        )
        return CatalogueEffect(id_, value, course=followed)
    # as the coolant warms up, behind half a minute
    warm = EffectCourse("lagged", input="T_coolant", low=300.0, high=360.0, time_constant=30.0)
    return CatalogueEffect(id_, value, course=warm)


def parameter_of(id_: str) -> str:
    """Return the name of an effect's parameter in a verdict."""
    return CATALOGUE[id_].parameter

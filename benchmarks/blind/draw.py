"""What is in a log of the bank: drawn from the bank's seed and the log's number alone.

Sizes are drawn log-uniformly between limits known for this class of engine (data sheets, series tolerances,
leaks that diagnosis has found); the lower limits lie where the effect begins to show beside noise and tolerances.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

BANK = 20261121
"""Added to the bank's seed, so that its numbers are nobody else's."""


@dataclass(frozen=True)
class Size:
    """How large an effect is drawn: `kind` says how the drawn magnitude becomes the parameter."""

    parameter: str
    least: float
    most: float
    kind: str


FACTOR, LESS, MORE, SIGNED, PLAIN = "1 +- x", "1 - x", "1 + x", "+- x", "x"
SIZES = {
    "maf.gain": Size("factor", 0.04, 0.15, FACTOR),
    "maf.offset": Size("offset", 5e-4, 2e-3, SIGNED),
    "maf.lag": Size("tau", 0.02, 0.12, PLAIN),
    "maf.delay": Size("delay", 0.015, 0.06, PLAIN),
    "maf.drift": Size("rate", 8e-5, 4e-4, SIGNED),
    "maf.temperature": Size("coefficient", 2e-3, 6e-3, SIGNED),
    "maf.contamination": Size("coefficient", 0.04, 0.15, PLAIN),
    "maf.backflow": Size("coefficient", 0.08, 0.3, PLAIN),
    "leak.intake": Size("area", 3e-6, 2e-5, PLAIN),
    "leak.inlet": Size("area", 4e-5, 1.5e-4, PLAIN),
    "egr.leak": Size("area", 2e-6, 1e-5, PLAIN),
    "egr.area": Size("factor", 0.1, 0.3, LESS),
    "eta_vol.factor": Size("factor", 0.04, 0.1, LESS),
    "compressor.flow": Size("factor", 0.03, 0.08, LESS),
    "turbine.efficiency": Size("factor", 0.04, 0.12, LESS),
    "exhaust.restriction": Size("factor", 1.0, 4.0, MORE),
    "u_delta.gain": Size("factor", 0.04, 0.1, FACTOR),
    "p_im.gain": Size("factor", 0.01, 0.04, FACTOR),
    "p_im.offset": Size("offset", 1000.0, 3000.0, SIGNED),
    "p_em.gain": Size("factor", 0.01, 0.04, FACTOR),
    "omega_t.gain": Size("factor", 0.007, 0.02, FACTOR),
    "T_im.lag": Size("tau", 2.0, 10.0, PLAIN),
}
ABSORBED = frozenset({"maf.gain", "maf.offset", "maf.contamination", "maf.backflow", "leak.inlet", "u_delta.gain"})
"""A map made from the same log would rightly hold these: they come with an onset, or against a nominal map."""
DRIVERS = {"T_coolant": 20.0, "T_charge": 10.0, "humidity": 10.0, "v_veh": 40.0, "ac_switch": 1.0}
"""Auxiliary channels that an effect may follow, with what they move by, in their units (K, K, %, km/h, 1)."""
ENGINE_CYCLES = ("etc", "whtc")
"""Cycles that prescribe no vehicle speed."""
PIECES = (
    ("etc", 0.0, 600.0),
    ("etc", 600.0, 1200.0),
    ("etc", 1200.0, 1800.0),
    ("ftp75", 0.0, 505.0),
    ("ftp75", 505.0, 1105.0),
    ("nedc", 400.0, 1180.0),
    ("whtc", 0.0, 600.0),
    ("wltc", 0.0, 600.0),
    ("wltc", 1022.0, 1600.0),
)
"""Table, begin and end [s] of what is driven."""
LEAST_EPISODE = 5.0
"""[s] that what nothing logged drives stays on, and off between: a blip beside one long episode is no coming and going."""
KINDS = ("clean",) * 10 + ("single",) * 13 + ("pair",) * 3 + ("channel",) * 2 + ("unlogged",) * 2
"""Of every thirty logs."""


@dataclass(frozen=True)
class Case:
    """One log and its truth.

    Attributes
    ----------
    number : int
    kind : str
        clean, single, pair, channel or unlogged.
    piece : tuple
        Table, begin and end [s].
    nominal : tuple or None
        The piece that the nominal map is made from; None makes the map from the log itself.
    seed : int
        Of the sensor noise and of everything that moves on the road.
    surface : float
        Size of the sensor's error surface, 1 as configured.
    constants : mapping of str to float
        Factors on the engine's constants.
    effects : list of mapping
        As in the tables `[[effect]]`.
    """

    number: int
    kind: str
    piece: tuple[str, float, float]
    nominal: tuple[str, float, float] | None
    seed: int
    surface: float
    constants: dict[str, float]
    effects: list[dict[str, Any]] = field(default_factory=list)


def draw(bank: int, number: int, tolerance: dict[str, float]) -> Case:
    """Return the case of a number."""
    rng = np.random.default_rng([BANK, bank, number])
    kind = KINDS[number % len(KINDS)]
    piece = PIECES[rng.integers(len(PIECES))]
    others = [other for other in PIECES if other != piece]
    nominal = others[rng.integers(len(others))] if rng.random() < 0.35 else None
    constants = {name: float(1.0 + share * rng.uniform(-1, 1)) for name, share in tolerance.items()}
    surface = float(rng.choice([0.0, 0.5, 1.0, 1.3]))
    length = piece[2] - piece[1]
    effects = {
        "clean": lambda: [],
        "single": lambda: [_catalogue(rng, _turn(number), length, nominal is not None)],
        "pair": lambda: [
            _catalogue(rng, id_, length, nominal is not None) for id_ in rng.choice(list(SIZES), 2, replace=False)
        ],
        "channel": lambda: [_channel(rng, piece[0])],
        "unlogged": lambda: [_unlogged(rng, length)],
    }[kind]()
    return Case(number, kind, piece, nominal, 1000 * bank + number, surface, constants, effects)


def _turn(number: int) -> str:
    """Return the effect whose turn it is: single effects go round the catalogue."""
    rounds, place = divmod(number, len(KINDS))
    single = KINDS[:place].count("single") + rounds * KINDS.count("single")
    return list(SIZES)[single % len(SIZES)]


def _catalogue(rng: np.random.Generator, id_: str, length: float, against_nominal: bool) -> dict[str, Any]:
    size = SIZES[id_]
    magnitude = float(np.exp(rng.uniform(np.log(size.least), np.log(size.most))))
    sign = float(rng.choice([-1.0, 1.0]))
    value = {
        FACTOR: 1.0 + sign * magnitude,
        LESS: 1.0 - magnitude,
        MORE: 1.0 + magnitude,
        SIGNED: sign * magnitude,
        PLAIN: magnitude,
    }[size.kind]
    effect: dict[str, Any] = {"id": id_, size.parameter: value}
    starts = id_ in ABSORBED and not against_nominal
    if starts or rng.random() < 0.4:
        effect["onset"] = round(float(rng.uniform(0.2, 0.65) * length), 1)
        if rng.random() < 0.25:
            effect["end"] = round(float(effect["onset"] + rng.uniform(0.2, 0.33) * length), 1)
    return effect


def _channel(rng: np.random.Generator, table: str) -> dict[str, Any]:
    names = [name for name in DRIVERS if name != "v_veh" or table not in ENGINE_CYCLES]
    name = str(rng.choice(names))
    form = str(rng.choice(["additive", "gain"]))
    size = rng.uniform(4e-4, 1.2e-3) if form == "additive" else rng.uniform(0.03, 0.07)
    return {
        "id": f"channel:{name}",
        "form": form,
        "amplitude": float(size * rng.choice([-1, 1]) / DRIVERS[name]),
    }


def _unlogged(rng: np.random.Generator, length: float) -> dict[str, Any]:
    episodes = int(rng.integers(2, 5))
    times = np.zeros(2)
    while np.diff(times).min() < LEAST_EPISODE:
        times = np.sort(rng.uniform(0.05, 0.95, 2 * episodes)) * length
    form = str(rng.choice(["additive", "gain"]))
    size = rng.uniform(6e-4, 2e-3) if form == "additive" else rng.uniform(0.05, 0.12)
    return {
        "id": "unlogged",
        "form": form,
        "amplitude": float(size * rng.choice([-1, 1])),
        "episodes": [[round(float(a), 1), round(float(b), 1)] for a, b in times.reshape(-1, 2)],
    }

"""The effects of the contract that a throttled engine may have, each written from physics, and the engine as the loop sees it."""

from collections.abc import Collection, Sequence
from functools import partial
from typing import Any

import numpy as np

from lpvobs.engines import effects as shared
from lpvobs.engines.curves import Nodes
from lpvobs.engines.effects import ALTITUDE, BOOST, SENSOR, STEADY, Effect, Signals, fuel_gain, gain, lacking, offset
from lpvobs.engines.healthy import HealthyErrors
from lpvobs.engines.residual_model import ComponentCurve, ResidualModel, levels_of
from lpvobs.engines.throttled import balances
from lpvobs.engines.throttled.balances import BALANCES, LACKS, NEEDS
from lpvobs.engines.throttled.constants import ThrottledEngine
from lpvobs.engines.throttled.learning import MOVING, beyond
from lpvobs.records import Array

CHANNELS = ("n_e", "m_f", "alpha_th", "p_ic", "T_ic", "p_im", "p_amb", "T_amb", SENSOR)
SPEED = Nodes(np.arange(600.0, 6601.0, 300.0), "rpm", "engine speed")
PRESSURE = Nodes(np.array([2e4, 4e4, 6e4, 8e4, 1e5, 1.3e5, 1.6e5, 2e5]), "Pa", "intake manifold pressure")
OPENING = Nodes(np.array([0.0, 2, 4, 6, 8, 11, 15, 20, 30, 45, 70, 100]), "%", "throttle opening")
RATIO = Nodes(np.array([0.2, 0.4, 0.6, 0.8, 0.9, 1.0]), "1", "p_im / p_ic")
BOTTOM = 0.02  # share of its largest value that a corrected pressure keeps at least


def on_a_pressure(channel: str) -> tuple[Effect, Effect]:
    """Return offset and gain of a pressure's reading."""

    def change(s: Signals, shift: float) -> Signals:
        return s.corrected(channel, np.maximum(s[channel] - shift, BOTTOM * float(np.max(np.abs(s[channel])))))

    return (
        Effect(f"{channel}.offset", "offset", "Pa", 0.0, 1e3, -3e4, 3e4, channel, change, BOOST, needs=(channel,)),
        Effect(f"{channel}.gain", "factor", "1", 1.0, 0.01, 0.5, 1.8, channel, gain(channel), BOOST, needs=(channel,)),
    )


def catalogue(engine: ThrottledEngine) -> tuple[Effect, ...]:
    """Return the effects in the order in which they are undone."""
    r = shared.on_the_reading()
    surroundings = ("p_amb", "T_amb")

    def past_the_sensor(s: Signals, area: float) -> Array:
        """Return reading over flow: a hole behind the filter takes its share."""
        return np.asarray(1.0 / (1.0 + shared.past_the_filter(s, area, engine.air.R_a)))

    return (
        *(r[f"maf.{name}"] for name in ("delay", "lag", "offset", "gain", "drift", "temperature", "contamination")),
        Effect(
            "leak.inlet", "area", "m^2", 0.0, 3e-5, -3e-5, 1e-3, "sensor", shared.reading(past_the_sensor), ALTITUDE, True,
            needs=(SENSOR, *surroundings),
        ),
        fuel_gain("u_delta.gain", "m_f"),
        *on_a_pressure("p_im"),
        *on_a_pressure("p_ic"),
        Effect("alpha_th.offset", "offset", "%", 0.0, 0.2, -4.0, 4.0, "throttle", offset("alpha_th"), STEADY, needs=("alpha_th",)),
        Effect(
            "leak.intake", "area", "m^2", 0.0, 1e-6, -1e-6, 6e-5, "intake", lacking(LACKS, "leak_intake"), BOOST,
            needs=("p_im", "T_ic", *surroundings),
        ),
        Effect(
            "eta_vol.factor", "factor", "1", 1.0, 0.03, 0.5, 1.8, "cylinders", lacking(LACKS, "eta_vol"), BOOST,
            needs=("p_im", "n_e"),
        ),
    )  # fmt: skip


def curves(effects: Sequence[Effect]) -> tuple[ComponentCurve, ...]:
    """Return the curves that throttle and filling may have, each driving an effect."""
    filling = next(effect for effect in effects if effect.id == "eta_vol.factor")
    area = Effect(
        "throttle.factor", "factor", "1", 1.0, 0.05, 0.5, 1.8, "throttle", lacking(LACKS, "throttle"), STEADY,
        needs=NEEDS["throttle"],
    )  # fmt: skip
    ratio = {"p_im/p_ic": lambda _, x: x["p_im"] / x["p_ic"]}
    return (
        ComponentCurve("eta_vol.curve", filling, 0.03, {"n_e": SPEED, "p_im": PRESSURE}, (500.0, 5e4)),
        ComponentCurve("throttle.curve", area, 0.03, {"alpha_th": OPENING, "p_im/p_ic": RATIO}, (5.0, 0.3), ratio),
    )


def residual_model(
    config: Any, path: Any, healthy: HealthyErrors | None, taught: Collection[str], _: object
) -> ResidualModel:
    """Return the engine of a configuration as the loop sees it; `taught` are the digests of the logs that it was learned from."""
    # Its curves are learned, with their covariance; residuals are relative, over blocks, and weighted by what a healthy log
    # leaves.
    engine, learned = config.engine, path.learned
    imbalances, effects = balances.Imbalances(engine), catalogue(engine)
    nodes = len(learned.names)
    return ResidualModel(
        balances=BALANCES,
        unit="1",
        channels=CHANNELS,
        moving=MOVING,
        fuel="m_f",
        speed="n_e",
        lacks=tuple(LACKS.values()),
        constants=learned,
        names=learned.names,
        covariance=learned.covariance[:nodes, :nodes],
        with_unknowns=learned.moved,
        imbalances=imbalances,
        by_reading=partial(balances.by_reading, imbalances),
        shown=partial(balances.shown, learned),
        further=partial(balances.further, engine),
        catalogue=effects,
        carriers=("maf.gain", "maf.offset", "eta_vol.factor"),
        curves=curves(effects),
        blocks=True,
        levels=levels_of(config.trace, BALANCES, "1", effects),
        by_unknowns=partial(balances.by_curves, engine),
        blur=partial(balances.blur, imbalances),
        beyond=partial(beyond, engine, learned, taught),
        healthy=healthy,
    )

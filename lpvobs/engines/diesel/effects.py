"""The effects of the contract that a diesel with EGR and VGT may have, and the engine as the loop sees it."""

from collections.abc import Callable, Collection, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.blocks import Blocks
from lpvobs.engines.components.effects import EGR, AsFound, found_around, lacks, on_the_intake
from lpvobs.engines.components.intake import PRESSURE
from lpvobs.engines.curves import Nodes
from lpvobs.engines.diesel import balances
from lpvobs.engines.diesel.balances import BALANCES, IN_ORDER, imbalances
from lpvobs.engines.diesel.constants import DieselEngine, constants_of
from lpvobs.engines.diesel.corrections import FOLLOWERS, RATIO, VOLUMES
from lpvobs.engines.effects import BOOST, STEADY, Effect, Signals, gain, reading
from lpvobs.engines.healthy import HealthyErrors
from lpvobs.engines.residual_model import ComponentCurve, DayToDay, ResidualModel, levels_of
from lpvobs.engines.unknowns import Unknowns, loop_unknowns
from lpvobs.records import Array

SPEED = Nodes(np.arange(600.0, 4401.0, 200.0), "rpm", "engine speed")
TIP_SPEED = Nodes(np.arange(20.0, 461.0, 40.0), "m/s", "tip speed of the compressor")
COMPRESSION = Nodes(np.array([0.9, 1.1, 1.3, 1.6, 2.0, 2.5, 3.1]), "1", "p_im / p_amb")
OPENING = Nodes(np.arange(5.0, 86.0, 8.0), "%", "EGR valve opening")
VANES = Nodes(np.arange(20.0, 77.0, 8.0), "%", "opening of the turbine's vanes")
EXPANSION = Nodes(np.arange(0.3, 1.05, 0.1), "1", "p_amb / p_em")
# name, effect, deviation before any data and axes with the lengths over which values are correlated, as in `corrections`; the
# turbine as the compressor, the EGR as a valve whose constants are fitted
CURVES: Mapping[str, tuple[str, float, Mapping[str, Nodes], tuple[float, float]]] = {
    "eta_vol.curve": ("eta_vol.factor", 0.03, {"n_e": SPEED, "p_im": PRESSURE}, (500.0, 5e4)),
    "compressor.curve": ("compressor.flow", 0.04, {"U_c": TIP_SPEED, "p_im/p_amb": COMPRESSION}, (100.0, 0.6)),
    "egr.curve": ("egr.area", 0.2, {"u_egr": OPENING, "p_im/p_em": RATIO}, (20.0, 0.12)),
    "turbine.curve": ("turbine.efficiency", 0.04, {"u_vgt": VANES, "p_amb/p_em": EXPANSION}, (20.0, 0.3)),
}
INPUTS: Mapping[str, Callable[[AsFound, Mapping[str, Array]], Array]] = {
    "U_c": lambda found, x: found.constants.R_c * x["omega_t"],
    "p_im/p_amb": lambda _, x: x["p_im"] / x["p_amb"],
    "p_im/p_em": lambda _, x: x["p_im"] / x["p_em"],
    "p_amb/p_em": lambda _, x: x["p_amb"] / x["p_em"],
}
"""Those that are no channels."""


def curves(catalogue: Mapping[str, Effect]) -> tuple[ComponentCurve, ...]:
    """Return the curves of the engine's components, each driving one of the effects."""
    return tuple(
        ComponentCurve(name, catalogue[effect], deviation, axes, lengths, INPUTS)
        for name, (effect, deviation, axes, lengths) in CURVES.items()
    )


PULSATION_SPEED = 2000.0  # [rpm] Speed above which the flow at the sensor no longer pulsates backward
PULSATION_FUEL = 40.0  # [mg/cycle] Full load at low speed
ANY_DAY = DayToDay()  # the differences between days where none are configured


def pulsating(s: Signals | Mapping[str, Array], x: float) -> Array:
    """Return reading over truth where the flow pulsates backward: x at 1000 rpm and full load."""
    slow = np.clip((PULSATION_SPEED - s["n_e"]) / 1000.0, 0.0, None)
    return np.asarray(1.0 + x * slow * np.maximum(s["u_delta"], 0.0) / PULSATION_FUEL)


_LACKS = IN_ORDER._asdict()
_SHARED = on_the_intake(_LACKS, lambda found, s: imbalances(found, s)[1])
CATALOGUE = (
    *(_SHARED[f"maf.{name}"] for name in ("delay", "lag", "offset", "gain", "drift", "temperature")),
    Effect("maf.backflow", "coefficient", "1", 0.0, 0.05, -0.5, 2.0, "sensor", reading(pulsating), STEADY, True),
    *(_SHARED[name] for name in ("maf.contamination", "leak.inlet", "u_delta.gain", "p_im.offset", "p_im.gain")),
    Effect("p_em.gain", "factor", "1", 1.0, 0.01, 0.7, 1.3, "p_em", gain("p_em"), EGR),
    Effect("omega_t.gain", "factor", "1", 1.0, 0.005, 0.8, 1.2, "omega_t", gain("omega_t"), BOOST),
    *(_SHARED[name] for name in ("T_im.lag", "leak.intake", "egr.leak", "egr.area", "eta_vol.factor")),
    Effect("compressor.flow", "factor", "1", 1.0, 0.03, 0.6, 1.3, "compressor", lacks(_LACKS, "compressor"), BOOST),
    Effect("turbine.efficiency", "factor", "1", 1.0, 0.03, 0.5, 1.5, "turbine", lacks(_LACKS, "turbine"), BOOST),
    Effect("exhaust.restriction", "factor", "1", 1.0, 0.5, 0.3, 10.0, "exhaust", lacks(_LACKS, "exhaust"), BOOST),
)
"""The effects in the order in which they are undone: the last one on the way into the log comes first."""


def diesel_model(
    engine: DieselEngine, tolerance: Mapping[str, float], day: DayToDay = ANY_DAY, known: Unknowns | None = None
) -> ResidualModel:
    """Return the diesel as the loop sees it, around its configured constants."""
    # They are known within a tolerance, as if uniformly distributed; or, with the corrections of the components, as a
    # calibration knows them, relative to where it found them.
    constants, point = constants_of(engine), loop_unknowns(tolerance, known, VOLUMES)
    return ResidualModel(
        balances=BALANCES,
        unit="kg/s",
        channels=balances.CHANNELS,
        followers=FOLLOWERS,
        moving=("n_e", "u_delta", "u_egr", "u_vgt", "p_im", "p_em", "omega_t", "T_im", "T_em"),
        fuel="u_delta",
        speed="n_e",
        lacks=tuple(IN_ORDER),
        constants=AsFound(constants, point.values),
        names=point.names,
        covariance=point.covariance,
        with_unknowns=found_around(constants, point),
        imbalances=imbalances,
        by_reading=by_reading,
        shown=shown,
        further=balances.further,
        catalogue=CATALOGUE,
        carriers=("maf.gain", "maf.offset", "eta_vol.factor", "egr.area", "compressor.flow"),
        curves=curves({effect.id: effect for effect in CATALOGUE}),
        levels=levels_of(day, BALANCES, "kg/s", CATALOGUE),
        by_unknowns=None if known is None else partial(balances.by_corrections, point.modes),
        adding=point.modes.shape[1],
    )


def by_reading(_: AsFound, s: Signals, __: Blocks | None) -> Array:
    """Return one for the balances that the sensor is part of, zero for the others, at every instant, shape (4, K)."""
    return np.repeat([[1.0], [1.0], [0.0], [0.0]], s.time.size // 2, axis=1)


def shown(s: Signals, _: Blocks | None) -> NDArray[np.bool_]:
    """Return that every balance counts everywhere, shape (4, K)."""
    return np.ones((len(BALANCES), s.time.size // 2), dtype=bool)


def residual_model(
    config: Any, path: Any, healthy: HealthyErrors | None, taught: Collection[str], known: Unknowns | None
) -> ResidualModel:
    """Return the model of a configuration, with what a calibration knows; no log teaches any of it."""
    return diesel_model(path.engine, config.estimate.tolerance, config.trace, known)

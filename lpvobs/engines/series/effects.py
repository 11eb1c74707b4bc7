"""The effects that filling and lambda can show, and the engine as the loop sees it."""

from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.blocks import Blocks
from lpvobs.engines.components import intake
from lpvobs.engines.components.intake import LACKS, AsFound, found_around, on_the_intake
from lpvobs.engines.effects import SENSOR, Signals
from lpvobs.engines.healthy import HealthyErrors
from lpvobs.engines.residual_model import ResidualModel, levels_of
from lpvobs.engines.series import flows
from lpvobs.engines.unknowns import Unknowns, loop_unknowns, places_of
from lpvobs.errors import DataError
from lpvobs.records import Array

FILLINGS = slice(flows.FILLING, flows.MIXTURE)
"""Of the balances, those of the filling: at most one of them tells."""


def imbalances(found: AsFound, s: Signals, _: Blocks | None = None) -> Array:
    """Return what is left of the balances, shape (3, C) [kg/s]; zero where nothing tells of one."""
    return np.nan_to_num(_left(found, s))


def _left(found: AsFound, s: Signals) -> Array:
    c, x, rates = found.constants, s.value, _rates(s)
    left = s[SENSOR] - flows.flows(c, x, rates)
    if found.values.size:
        left -= _columns(found, s) @ found.values
    leak, egr_leak, egr_area, eta_vol = s.lacks
    W_ei = intake.cylinder_flow(c, x)
    if np.any(eta_vol != 1.0):
        left[FILLINGS] -= (eta_vol - 1.0) * W_ei
    if leak.any():
        left[FILLINGS] -= leak * intake.escaping(c, x["p_im"], x["T_im"], x["p_amb"], x["T_amb"])
    if np.any(egr_area != 1.0) or egr_leak.any():
        W_egr, per_area = flows.egr(c, x, W_ei)
        p_em, _ = flows.exhaust(c, x, W_ei)
        open_ = np.vectorize(partial(intake.egr_flow_function, c), otypes=[float])(x["p_im"] / p_em)
        left[FILLINGS] += (egr_area - 1.0) * W_egr + egr_leak * per_area * open_
    return left


def _rates(s: Signals) -> Mapping[str, Array]:
    still = np.zeros(s.value["n_e"].size)  # of the mean of two views there are half as many as of times
    return {name: s.rate.get(name, still) for name in flows.CHANNELS}


def _columns(found: AsFound, s: Signals) -> Array:
    """Return the derivatives of the flows by all values of the corrections, shape (3, C, v)."""
    out = np.zeros((len(flows.BALANCES), s.value["n_e"].size, sum(component.size for component in flows.COMPONENTS)))
    moved = flows.corrections(found.constants, s.value, _rates(s))
    for place, correction in zip(places_of(flows.COMPONENTS).values(), moved, strict=True):
        out[correction.on(len(out)), :, place] = correction.columns(place.stop - place.start)
    return out


def by_corrections(modes: Array, found: AsFound, s: Signals, _: Blocks | None) -> Array:
    """Return the derivatives of the balances by modes of the corrections, given as (v, m), shape (m, 3, C)."""
    return -np.moveaxis(np.nan_to_num(_columns(found, s)) @ modes, -1, 0)


def further(found: AsFound, s: Signals) -> tuple[Array, Array]:
    """Return what the engine lacks adds to the flows, (3, N) [kg/s], and to the state equation, (2, N)."""
    in_order = np.tile(np.array(list(LACKS.values()))[:, None], (1, s.lacks.shape[1]))
    change = imbalances(found, s) - imbalances(found, replace(s, lacks=in_order))
    c = found.constants
    return -change, np.stack([c.R_a * s["T_im"] / c.V_im * change[FILLINGS].sum(axis=0), np.zeros(change.shape[1])])


def shown(found: AsFound, s: Signals, _: Blocks | None) -> NDArray[np.bool_]:
    """Return which balances something tells of, shape (3, K)."""
    told = np.isfinite(_left(found, s))
    return np.asarray(told[:, : told.shape[1] // 2] & told[:, told.shape[1] // 2 :])


CATALOGUE = tuple(on_the_intake(lambda found, s: imbalances(found, s)[FILLINGS].sum(axis=0)).values())
"""The effects in the order in which they are undone: the last one on the way into the log comes first."""


def residual_model(
    config: Any, path: Any, _: HealthyErrors | None, __: Collection[str], known: Unknowns | None
) -> ResidualModel:
    """Return the engine of a configuration as the loop sees it, with what a calibration knows; no log teaches any of it."""
    constants, point = path.constants, loop_unknowns(config.estimate.tolerance, known)
    found = AsFound(constants, point.values)
    return ResidualModel(
        balances=flows.BALANCES,
        unit="kg/s",
        channels=flows.CHANNELS,
        moving=("n_e", "u_delta", "u_egr", "p_im", "T_im"),
        fuel="u_delta",
        speed="n_e",
        lacks=tuple(LACKS.values()),
        constants=found,
        names=point.names,
        covariance=point.covariance,
        with_unknowns=found_around(constants, point),
        imbalances=imbalances,
        by_reading=lambda _, s, __: np.ones((len(flows.BALANCES), s.time.size // 2)),
        shown=partial(shown, found),
        further=further,
        catalogue=CATALOGUE,
        carriers=("maf.gain", "maf.offset", "eta_vol.factor", "egr.area"),
        levels=levels_of(config.trace, flows.BALANCES, "kg/s", CATALOGUE),
        by_unknowns=None if known is None else partial(by_corrections, point.modes),
        adding=point.modes.shape[1],
    )


def confounded(*_: Any) -> Any:
    """Raise DataError: one balance whose EGR is unknown tells no fault from another."""
    raise DataError(
        "engine: engine speed, intake pressure and air flow alone cannot tell faults apart; also record fuel, and the EGR valve's "
        "position or lambda, and use configs/series.toml; or compare the maps of two days"
    )

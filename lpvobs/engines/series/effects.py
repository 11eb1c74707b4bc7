"""The effects that filling and lambda can show, and the engine as the loop sees it."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.blocks import Blocks
from lpvobs.engines.components import intake
from lpvobs.engines.effects import (
    ALTITUDE,
    BOOST,
    FILTER,
    SENSOR,
    Change,
    Effect,
    Signals,
    fuel_gain,
    gain,
    lacking,
    offset,
    on_the_reading,
)
from lpvobs.engines.healthy import HealthyErrors
from lpvobs.engines.residual_model import ResidualModel, levels_of
from lpvobs.engines.series import flows
from lpvobs.engines.unknowns import Unknowns, loop_unknowns
from lpvobs.records import Array

LACKS = {"leak_intake": 0.0, "egr_leak": 0.0, "egr_area": 1.0, "eta_vol": 1.0}
"""Sizes of what the engine's model lacks (leaks in m^2, factors), on an engine in order."""
EGR = "the same operating points with the EGR valve open and shut"


@dataclass(frozen=True, eq=False)
class AsFound:
    """Constants, and the values of the corrections; none where nothing is known beyond the configuration."""

    constants: Any
    values: Array


def imbalances(found: AsFound, s: Signals, _: Blocks | None = None) -> Array:
    """Return what is left of both balances, shape (2, C) [kg/s]; zero where nothing tells of one."""
    return np.nan_to_num(_left(found, s))


def _left(found: AsFound, s: Signals) -> Array:
    c, x, rates = found.constants, s.value, _rates(s)
    left = s[SENSOR] - flows.flows(c, x, rates)
    if found.values.size:
        left -= _columns(found, s) @ found.values
    leak, egr_leak, egr_area, eta_vol = s.lacks
    W_ei = intake.cylinder_flow(c, x["p_im"], x["n_e"], x["T_im"])
    if np.any(eta_vol != 1.0):
        left[0] -= (eta_vol - 1.0) * W_ei
    if leak.any():
        left[0] -= leak * intake.escaping(c, x["p_im"], x["T_im"], x["p_amb"], x["T_amb"])
    if np.any(egr_area != 1.0) or egr_leak.any():
        W_egr, per_area = flows.egr(c, x, W_ei)
        p_em, _ = flows.exhaust(c, x, W_ei)
        open_ = np.vectorize(partial(intake.egr_flow_function, c), otypes=[float])(x["p_im"] / p_em)
        left[0] += (egr_area - 1.0) * W_egr + egr_leak * per_area * open_
    return left


def _rates(s: Signals) -> Mapping[str, Array]:
    still = np.zeros(s.time.size)
    return {name: s.rate.get(name, still) for name in flows.CHANNELS}


def _columns(found: AsFound, s: Signals) -> Array:
    """Return the derivatives of both flows by all values of the corrections, shape (2, C, v)."""
    parts = zip(flows.COMPONENTS, flows.corrections(found.constants, s.value, _rates(s)), strict=True)
    out = np.zeros((2, s.time.size, sum(component.size for component in flows.COMPONENTS)))
    begin = 0
    for component, correction in parts:
        on = slice(None) if correction.balance is None else correction.balance
        out[on, :, begin : begin + component.size] = correction.columns(component.size)
        begin += component.size
    return out


def by_corrections(modes: Array, found: AsFound, s: Signals, _: Blocks | None) -> Array:
    """Return the derivatives of the balances by modes of the corrections, given as (v, m), shape (m, 2, C)."""
    return -np.moveaxis(np.nan_to_num(_columns(found, s)) @ modes, -1, 0)


def further(found: AsFound, s: Signals) -> tuple[Array, Array]:
    """Return what the engine lacks adds to both flows, (2, N) [kg/s], and to the state equation, (2, N)."""
    in_order = Signals(**{**vars(s), "lacks": np.tile(np.array(list(LACKS.values()))[:, None], (1, s.lacks.shape[1]))})
    change = imbalances(found, s) - imbalances(found, in_order)
    c = found.constants
    return -change, np.stack([c.R_a * s["T_im"] / c.V_im * change[0], np.zeros(change.shape[1])])


def shown(found: AsFound, s: Signals, _: Blocks | None) -> NDArray[np.bool_]:
    """Return which balances something tells of, shape (2, K)."""
    told = np.isfinite(_left(found, s))
    return np.asarray(told[:, : told.shape[1] // 2] & told[:, told.shape[1] // 2 :])


def temperature_lag(s: Signals, tau: float) -> Signals:
    """Return the temperature before a slow sensor; its rate is read through a wide window."""
    return s.corrected("T_im", s["T_im"] + tau * s.slow("T_im"))


def bypass(s: Signals, area: float) -> Signals:
    """Return the flow before a hole behind the filter, which takes a fixed share of the filling, whatever the sensor reads."""
    share = area * np.sqrt(2.0 * s["p_amb"] / (s.constants.constants.R_a * s["T_amb"]) * FILTER)
    flow = s[SENSOR] - imbalances(s.constants, s)[0]
    return s.corrected(SENSOR, s[SENSOR] + share / (1.0 + share) * np.maximum(flow, 0.0))


def _lacks(name: str) -> Change:
    return lacking(list(LACKS).index(name), LACKS[name])


_READING = on_the_reading()
CATALOGUE = (
    *(_READING[f"maf.{name}"] for name in ("delay", "lag", "offset", "gain", "drift", "temperature", "contamination")),
    Effect("leak.inlet", "area", "m^2", 0.0, 3e-5, -3e-5, 5e-4, "sensor", bypass, ALTITUDE, True),
    fuel_gain("u_delta.gain", "u_delta"),
    Effect("p_im.offset", "offset", "Pa", 0.0, 1e3, -2e4, 2e4, "p_im", offset("p_im"), BOOST),
    Effect("p_im.gain", "factor", "1", 1.0, 0.01, 0.7, 1.3, "p_im", gain("p_im"), BOOST),
    Effect("T_im.lag", "tau", "s", 0.0, 3.0, -0.3, 20.0, "T_im", temperature_lag, EGR),
    Effect("leak.intake", "area", "m^2", 0.0, 5e-6, -2e-6, 2e-4, "intake", _lacks("leak_intake"), BOOST),
    Effect("egr.leak", "area", "m^2", 0.0, 3e-6, -1e-6, 1e-4, "EGR", _lacks("egr_leak"), EGR, needs=("u_egr",)),
    Effect("egr.area", "factor", "1", 1.0, 0.1, 0.2, 1.5, "EGR", _lacks("egr_area"), EGR, needs=("u_egr",)),
    Effect("eta_vol.factor", "factor", "1", 1.0, 0.03, 0.6, 1.3, "cylinders", _lacks("eta_vol"), EGR),
)  # fmt: skip
"""The effects in the order in which they are undone: the last one on the way into the log comes first."""


def residual_model(
    config: Any, path: Any, _: HealthyErrors | None, __: Collection[str], known: Unknowns | None
) -> ResidualModel:
    """Return the engine of a configuration as the loop sees it, with what a calibration knows; no log teaches any of it."""
    constants, point = path.constants, loop_unknowns(config.estimate.tolerance, known)
    values, modes, count = point.values, point.modes, len(point.names) - point.modes.shape[1]

    def with_unknowns(beta: Array) -> AsFound:
        shares = zip(point.names[:count], beta[:count].tolist(), strict=True)
        moved = {name: getattr(constants, name) * (1.0 + share) for name, share in shares}
        return AsFound(constants._replace(**moved), values + modes @ beta[count:] if values.size else values)

    found = AsFound(constants, values)
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
        with_unknowns=with_unknowns,
        imbalances=imbalances,
        by_reading=lambda _, s, __: np.ones((2, s.time.size // 2)),
        shown=partial(shown, found),
        further=further,
        catalogue=CATALOGUE,
        carriers=("maf.gain", "maf.offset", "eta_vol.factor", "egr.area"),
        levels=levels_of(config.trace, flows.BALANCES, "kg/s", CATALOGUE),
        by_unknowns=None if known is None else partial(by_corrections, modes),
        adding=modes.shape[1],
    )

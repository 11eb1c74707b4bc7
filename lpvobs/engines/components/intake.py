"""What engines with an intake manifold, cylinders and exhaust gas recirculation share: constants, relations and effects.

Relations after Wahlstrom and Eriksson (2011), the paper's reference 16, with one change that a small car engine needs, marked (+):
EGR that flows backward. They take any flat tuple with the constants that they name: SI units, openings in %, speed in rpm, fuel in
mg/cycle.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import sqrt
from typing import Annotated, Any, Protocol

import numpy as np

from lpvobs.compiled import njit
from lpvobs.engines import effects as shared
from lpvobs.engines.base import MapAxis
from lpvobs.engines.constants import Within
from lpvobs.engines.curves import Nodes, Points, nodes
from lpvobs.engines.effects import ALTITUDE, BOOST, SENSOR, Effect, Signals, fuel_gain, gain, lacking, offset
from lpvobs.engines.unknowns import Component, LoopUnknowns
from lpvobs.records import Array

FUEL_AXIS = MapAxis("u_delta", "mg/cycle", "injected fuel per cylinder and cycle")
EGR = "the same operating points, once with the EGR valve open and once with it shut"
SLOWEST = 60.0  # [rpm], far below idling: an engine that stands still has no time of a revolution
COLDEST = 200.0  # [K], below the coldest winter: a rate that a slow sensor's jump gives would take a charge below zero
USUAL_CHARGE = 320.0  # [K], T_im at which the slope of the filling adds nothing
SPEED = nodes("rpm", "engine speed", 600, 1000, 1400, 1800, 2300, 2900, 3600, 4400)
TURN = Nodes(np.arange(12.0, 90.1, 1.2), "ms", "time of a revolution, times sqrt(T_im / 320 K)")
"""A pressure wave goes to and fro in a runner of 0.3 to 0.6 m, four lengths, in 3 to 7 ms. So far apart are the crests of what it
adds to the filling, at any speed; over the speed itself they lie close together below 1500 rpm."""
PRESSURE = nodes("Pa", "intake manifold pressure", 0.9e5, 1.1e5, 1.4e5, 1.8e5, 2.4e5, 3.2e5)
DENSITY = nodes("Pa", "intake manifold pressure", 0.9e5, 3.2e5)  # waves are stronger in denser charge
SHAPE = (
    Component(
        "eta_vol", "1", "relative change of the volumetric efficiency", 0.03, "eta_vol",
        {"n_e": SPEED, "p_im": PRESSURE}, (700.0, 5e4),
    ),
    Component(
        "eta_vol_waves", "1", "relative change of the volumetric efficiency by waves in the runner", 0.02, "eta_vol_waves",
        {"turn": TURN, "p_im": DENSITY}, (2.4, 2e5),
    ),
)  # fmt: skip
"""Corrections of the filling over speed and pressure: 3 % is what bench points left of models fitted to them."""
OPENING = nodes("%", "EGR valve opening", 3, 10, 22, 45, 85)
LOAD = nodes("mg/cycle", "injected fuel", 0, 15, 40)
MAF_LAG = Component("W_maf_lag", "s", "lag of the mass air flow sensor", 0.02)
CHARGE = Component(
    "eta_vol_charge", "1", "relative change of the volumetric efficiency per 100 K of T_im", 0.10, "eta_vol"
)


@dataclass(frozen=True)
class Cylinders:
    """Volume and cylinders."""

    V_d: Annotated[float, Within(1e-4, 0.2, "m^3", "displacement")]
    n_cyl: Annotated[int, Within(1, 24, "1", "number of cylinders")]
    V_im: Annotated[float, Within(1e-4, 0.5, "m^3", "volume of a manifold")]


@dataclass(frozen=True)
class Filling:
    """eta_vol = c_vol1 sqrt(p_im) + c_vol2 sqrt(n_e) + c_vol3, p_im in Pa, n_e in rpm."""

    c_vol1: Annotated[float, Within(-5e-3, 5e-3, "1/sqrt(Pa)", "slope of eta_vol over sqrt(p_im)")]
    c_vol2: Annotated[float, Within(-0.05, 0.05, "1/sqrt(rpm)", "slope of eta_vol over sqrt(n_e)")]
    c_vol3: Annotated[float, Within(0.2, 3, "1", "level of the volumetric efficiency")]


@dataclass(frozen=True)
class Egr:
    """EGR valve: area over opening, and the flow function; reverse flow is reduced by k_reverse."""

    A_egr_max: Annotated[float, Within(1e-6, 0.05, "m^2", "area of an EGR valve")]
    c_egr1: Annotated[float, Within(-0.01, 0.01, "1/%^2", "curvature of the EGR area")]
    c_egr2: Annotated[float, Within(1e-5, 1, "1/%", "slope of the effective EGR area over the valve position")]
    pi_egr_opt: Annotated[float, Within(0.2, 0.99, "1", "critical pressure ratio")]
    k_reverse: Annotated[float, Within(0, 1.5, "1", "share of the area for reverse flow")]


class Constants(Protocol):
    """A flat tuple of an engine's constants, these among them."""

    R_a: float
    R_e: float
    gamma_a: float
    V_d: float
    V_im: float
    n_cyl: float
    c_vol1: float
    c_vol2: float
    c_vol3: float
    A_egr_max: float
    c_egr1: float
    c_egr2: float
    pi_egr_opt: float
    k_reverse: float


@njit(cache=True)
def rho_2(c: Constants, p_im: float, p_em: float, u_egr: float, T_im: float, T_em: float) -> float:
    """Return rho_2 [kg/(s Pa)] of Eq. (3), so that W_egr = rho_2 p_em; negative where the flow reverses (+)."""
    u = min(max(u_egr, 0.0), -0.5 * c.c_egr2 / c.c_egr1)
    area = c.A_egr_max * (c.c_egr1 * u + c.c_egr2) * u
    if p_em >= p_im:
        return area * egr_flow_function(c, p_im / p_em) / sqrt(T_em * c.R_e)  # Eq. (3)
    reverse = c.k_reverse * area * p_im * egr_flow_function(c, p_em / p_im) / sqrt(T_im * c.R_a)
    return -reverse / p_em


@njit(cache=True)
def egr_flow_function(c: Constants, ratio: float) -> float:
    """Return Psi_egr [-]: a parabola that is one at the choking ratio and zero at equal pressures."""
    Pi = min(max(ratio, c.pi_egr_opt), 1.0)
    return 1.0 - ((1.0 - Pi) / (1.0 - c.pi_egr_opt) - 1.0) ** 2


@njit(cache=True)
def rho_3(c: Constants, p_im: float, n_e: float, T_im: float) -> float:
    """Return rho_3 [kg/(s Pa)] of Eq. (3), so that W_ei = rho_3 p_im."""
    eta_vol = c.c_vol1 * sqrt(p_im) + c.c_vol2 * sqrt(max(n_e, 0.0)) + c.c_vol3
    return eta_vol * n_e * c.V_d / (120.0 * c.R_a * T_im)  # Eq. (3)


@njit(cache=True)
def cylinder_fuel_flow(c, n_e, u_delta):  # type: ignore[no-untyped-def]
    """Return W_f [kg/s] of Eq. (2)."""
    return 1e-6 / 120.0 * c.n_cyl * n_e * u_delta  # Eq. (2)


def cylinder_flow(c: Constants, x: Mapping[str, Array]) -> Array:
    """Return W_ei of Eq. (2) [kg/s], shape (n,)."""
    return np.asarray(_cylinder_flow(c, x["p_im"], x["n_e"], x["T_im"]))


@njit(cache=True)
def _cylinder_flow(c, p_im, n_e, T_im):  # type: ignore[no-untyped-def]
    flow = np.empty(p_im.size)
    for k in range(p_im.size):
        flow[k] = rho_3(c, p_im[k], n_e[k], T_im[k]) * p_im[k]  # Eq. (2)
    return flow


def stored(c: Constants, x: Mapping[str, Array], rates: Mapping[str, Array]) -> Array:
    """Return what fills the intake manifold, V_im / (R_a T_im) (dp_im/dt - p_im / T_im dT_im/dt), shape (n,) [kg/s]."""
    return c.V_im / (c.R_a * x["T_im"]) * (rates["p_im"] - x["p_im"] / x["T_im"] * rates["T_im"])


@njit(cache=True)
def egr_flow(c, p_im, p_em, u_egr, T_im, T_em):  # type: ignore[no-untyped-def]
    """Return W_egr of Eq. (2) [kg/s], shape (n,)."""
    flow = np.empty(p_im.size)
    for k in range(p_im.size):
        flow[k] = rho_2(c, p_im[k], p_em[k], u_egr[k], T_im[k], T_em[k]) * p_em[k]  # Eq. (2)
    return flow


def egr_area(c: Constants, u_egr: Array) -> Array:
    """Return the effective area of the EGR valve [m^2], shape (n,)."""
    u = np.clip(u_egr, 0.0, -0.5 * c.c_egr2 / c.c_egr1)
    return np.asarray(c.A_egr_max * (c.c_egr1 * u + c.c_egr2) * u)


def shape_points(x: Mapping[str, Array]) -> tuple[Points, Points]:
    """Return where n places lie between the nodes of `SHAPE`."""
    n_e, p_im = x["n_e"], x["p_im"]
    turn = 6e4 / np.maximum(n_e, SLOWEST) * np.sqrt(x["T_im"] / USUAL_CHARGE)
    return Points((SPEED.values, PRESSURE.values), (n_e, p_im)), Points((TURN.values, DENSITY.values), (turn, p_im))


def per_charge(W_ei: Array, x: Mapping[str, Array]) -> Array:
    """Return what a slope of one of `CHARGE` adds to the filling [kg/s], shape (n,)."""
    return W_ei * (x["T_im"] - USUAL_CHARGE) / 100.0


@njit(cache=True)
def orifice(c: Constants, p_in: float, p_out: float, T: float) -> float:
    """Return the flow of air through an opening per area [kg/(s m^2)], compressible, choked below the critical ratio."""
    k = c.gamma_a
    ratio = max(p_out / p_in, (2.0 / (k + 1.0)) ** (k / (k - 1.0)))
    inside = 2.0 * k / (k - 1.0) * (ratio ** (2.0 / k) - ratio ** ((k + 1.0) / k))
    return p_in * sqrt(max(inside, 0.0) / (c.R_a * T))


@njit(cache=True)
def escape(c: Constants, p_im: float, T_im: float, p_amb: float, T_amb: float) -> float:
    """Return the flow out of the intake manifold per area of a leak [kg/(s m^2)], negative where it draws air in."""
    return orifice(c, p_im, p_amb, T_im) if p_im > p_amb else -orifice(c, p_amb, p_im, T_amb)


@njit(cache=True)
def egr_per_area(c: Constants, p_im: float, p_em: float, T_im: float, T_em: float) -> float:
    """Return the flow from exhaust to intake manifold per area [kg/(s m^2)]."""
    if p_em >= p_im:
        return p_em * egr_flow_function(c, p_im / p_em) / sqrt(T_em * c.R_e)
    return -c.k_reverse * p_im * egr_flow_function(c, p_em / p_im) / sqrt(T_im * c.R_a)


@njit(cache=True)
def escaping(c, p_im, T_im, p_amb, T_amb):  # type: ignore[no-untyped-def]
    """Return the flow out of the intake manifold per area of a leak [kg/(s m^2)], shape (n,)."""
    flow = np.empty(p_im.size)
    for k in range(p_im.size):
        flow[k] = escape(c, p_im[k], T_im[k], p_amb[k], T_amb[k])
    return flow


@dataclass(frozen=True, eq=False)
class AsFound:
    """An engine's constants, and the values of its corrections; none where nothing is known beyond the configuration."""

    constants: Any
    values: Array


def found_around(constants: Any, point: LoopUnknowns) -> Callable[[Array], AsFound]:
    """Return what gives the engine from deviations of its unknowns, shape (q,): constants, then modes of the corrections."""
    names = point.names[: len(point.names) - point.modes.shape[1]]

    def found(beta: Array) -> AsFound:
        shares = zip(names, beta[: len(names)].tolist(), strict=True)
        moved = {name: getattr(constants, name) * (1.0 + share) for name, share in shares}
        values = point.values + point.modes @ beta[len(names) :] if point.values.size else point.values
        return AsFound(constants._replace(**moved), values)

    return found


def temperature_lag(s: Signals, tau: float) -> Signals:
    """Return the temperature before a slow sensor, no colder than any air; its rate is read through a wide window."""
    return s.corrected("T_im", np.maximum(s["T_im"] + tau * s.slow("T_im"), COLDEST))


LACKS = {"leak_intake": 0.0, "egr_leak": 0.0, "egr_area": 1.0, "eta_vol": 1.0}
"""Sizes of what a model lacks of intake and EGR (leaks in m^2, factors), on an engine in order; an engine's own follow them."""


def on_the_intake(unfilled: Callable[[AsFound, Signals], Array]) -> Mapping[str, Effect]:
    """Return by name the effects on readings, intake and EGR; `unfilled` is what the balance of the filling leaves."""

    def bypass(s: Signals, area: float) -> Signals:
        """Return the flow before a hole that draws air in behind the filter."""
        # The hole takes a fixed share of what passes the sensor, whatever the sensor's own error. The filling tells that flow where
        # no map does. Beside a map it must not: a share of the filling takes that share of its errors off, and explains them.
        share = shared.past_the_filter(s, area, s.constants.constants.R_a)
        passed = (s[SENSOR] - unfilled(s.constants, s)) / (1.0 + share) if s.error is None else s[SENSOR] - s.error
        return s.corrected(SENSOR, s[SENSOR] + share * np.maximum(passed, 0.0))

    def with_error(s: Signals, area: float) -> Array:
        """Return reading over flow where the sensor's error falls with what passes it, by the same share."""
        return np.asarray(1.0 / (1.0 + shared.past_the_filter(s, area, s.constants.constants.R_a)))

    laws, straight = (shared.reading(with_error),), partial(Effect, straight=True)
    found = (
        Effect("leak.inlet", "area", "m^2", 0.0, 3e-5, -3e-5, 5e-4, "sensor", bypass, ALTITUDE, True, laws=laws),
        fuel_gain("u_delta.gain", "u_delta"),
        Effect("p_im.offset", "offset", "Pa", 0.0, 1e3, -2e4, 2e4, "p_im", offset("p_im"), BOOST),
        Effect("p_im.gain", "factor", "1", 1.0, 0.01, 0.7, 1.3, "p_im", gain("p_im"), BOOST),
        # where walls warm the charge, the filling follows T_im by 12 to 25 % less, and sizes came out 10 to 33 % too small
        Effect("T_im.lag", "tau", "s", 0.0, 3.0, -0.3, 20.0, "T_im", temperature_lag, EGR, unlearned=0.2),
        straight("leak.intake", "area", "m^2", 0.0, 5e-6, -2e-6, 2e-4, "intake", lacking(LACKS, "leak_intake"), BOOST),
        straight("egr.leak", "area", "m^2", 0.0, 3e-6, -1e-6, 1e-4, "EGR", lacking(LACKS, "egr_leak"), EGR, needs=("u_egr",)),
        straight("egr.area", "factor", "1", 1.0, 0.1, 0.2, 1.5, "EGR", lacking(LACKS, "egr_area"), EGR, needs=("u_egr",)),
        straight("eta_vol.factor", "factor", "1", 1.0, 0.03, 0.6, 1.3, "cylinders", lacking(LACKS, "eta_vol"), EGR),
    )  # fmt: skip
    return {**shared.on_the_reading(), **{effect.id: effect for effect in found}}

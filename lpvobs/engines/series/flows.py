"""What series vehicles' channels say of the air flow: filling of the cylinders, and lambda times fuel; corrections of both.

A channel that a log lacks reads NaN. A flow is NaN where nothing tells it: the filling without the position of the EGR valve,
and with it open in transients, where nothing tells the pressure before it; lambda and fuel in transients, where the probe and
the gas that is recirculated are late, and where next to no fuel is burnt.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.components import intake
from lpvobs.engines.components.intake import LOAD, OPENING
from lpvobs.engines.curves import Points, nodes
from lpvobs.engines.unknowns import Component, Correction, MeasuredPart
from lpvobs.records import Array

FILLING, RECIRCULATED, MIXTURE = 0, 1, 2
BALANCES = ("filling", "filling_with_egr", "mixture")
"""The filling speaks with two voices: where the valve is open, what is not known of the EGR is in its errors, and there alone."""
CHANNELS = ("n_e", "u_delta", "u_egr", "p_im", "p_em", "T_im", "T_em", "p_amb", "T_amb", "lambda_e", "W_maf")
STEADY = 0.1
"""[1/s] Relative rate of speed, pressure, fuel and lambda up to which a probe that is half a second late is off by 5 % at most, up
and down alike."""
SHUT = 1.0
"""[%] Opening under which the EGR valve counts as shut."""
LIGHT, LEAN = 3.0, 8.0
"""[mg/cycle] of fuel under which its quantity, and lambda over which the probe, tell nothing: overrun, and the end of its range."""
BELOW = 10.0
"""[mg/cycle] Under this the rate of the fuel is taken over this: noise is absolute."""
SPEED = nodes("rpm", "engine speed", 800, 1600, 2600)
DRIVE_SPEED = nodes("rpm", "engine speed", 800, 1200, 1600, 2000, 2600, 3200)
DRIVE_LOAD = nodes("mg/cycle", "injected fuel", 0, 7, 14, 22, 30, 42)
COMPONENTS = (
    *intake.SHAPE,
    intake.CHARGE,
    Component(
        "egr", "1", "added EGR flow, as a share of the choked flow", 0.3,
        axes={"u_egr": OPENING, "n_e": SPEED, "u_delta": LOAD}, lengths=(25.0, 1000.0, 25.0),
    ),
    Component(
        "egr_drive", "1", "relative change of the EGR flow where the pressure before the valve is not logged", 0.3,
        axes={"n_e": DRIVE_SPEED, "u_delta": DRIVE_LOAD}, lengths=(600.0, 14.0),
    ),
    Component("egr_leak", "1", "leak area of the shut EGR valve, as a share of its largest area", 0.005),
    Component("lambda_lag", "s", "lag of the lambda probe", 0.5),
    intake.MAF_LAG,
)  # fmt: skip
MEASURED_PARTS = (MeasuredPart("egr", "W_egr_reference", RECIRCULATED, {"u_egr": 0.0}, 0.02, 2e-5, FILLING),)
"""EGR flow from CO2 before and behind the engine: 2 % and 0.02 g/s."""


def exhaust(c: Any, x: Mapping[str, Array], W_ei: Array) -> tuple[Array, Array]:
    """Return p_em [Pa] and T_em [K], from what stands for their sensors where there are none."""
    burnt = intake.cylinder_fuel_flow(c, x["n_e"], np.maximum(x["u_delta"], 0.0))
    T_em = x["T_im"] + c.T_rise * burnt / np.maximum(W_ei, 1e-4)
    p_em = x["p_im"] + c.dp_0 + c.dp_n * x["n_e"]
    # A search that undoes the lag of a sensor may try temperatures below zero.
    return _read(x, "p_em", p_em), np.maximum(_read(x, "T_em", T_em), 1.0)


def _read(x: Mapping[str, Array], name: str, otherwise: Array | float = np.nan) -> Array:
    """Return a channel, or what stands for it where nothing was read, shape (n,)."""
    reading = np.broadcast_to(x.get(name, np.nan), x["n_e"].shape)
    return np.where(np.isfinite(reading), reading, otherwise)


def egr(c: Any, x: Mapping[str, Array], W_ei: Array) -> tuple[Array, Array]:
    """Return W_egr, NaN without the valve's position, and the flow of its nozzle per area [kg/(s m^2)], each of shape (n,)."""
    p_em, T_em = exhaust(c, x, W_ei)
    u_egr = _read(x, "u_egr")
    W_egr = intake.egr_flow(c, x["p_im"], p_em, np.nan_to_num(u_egr), x["T_im"], T_em)
    return np.where(np.isfinite(u_egr), W_egr, np.nan), p_em / np.sqrt(T_em * c.R_e)


def filling(c: Any, x: Mapping[str, Array], rates: Mapping[str, Array], W_ei: Array) -> Array:
    """Return W_ei - W_egr + V_im / (R_a T_im) (dp_im/dt - p_im / T_im dT_im/dt), valve shut and open, shape (2, n) [kg/s]."""
    shut = _read(x, "u_egr") < SHUT
    flow = W_ei - egr(c, x, W_ei)[0] + intake.stored(c, x, rates)  # Eq. (1)
    return np.where([shut, ~shut & steady(x, rates)], flow, np.nan)


def steady(x: Mapping[str, Array], rates: Mapping[str, Array]) -> NDArray[np.bool_]:
    """Return where speed, pressure and fuel stand, shape (n,)."""
    moved = [np.abs(rates[name]) / np.maximum(x[name], 1.0) for name in ("n_e", "p_im")]
    moved.append(np.abs(rates["u_delta"]) / np.maximum(x["u_delta"], BELOW))
    return np.asarray(np.max(moved, axis=0) < STEADY)


def mixture(c: Any, x: Mapping[str, Array], rates: Mapping[str, Array]) -> Array:
    """Return lambda times fuel times the stoichiometric air, shape (n,) [kg/s], where the engine runs steadily."""
    if "lambda_e" not in x:
        return np.full(x["n_e"].size, np.nan)
    fuel, probe = x["u_delta"], x["lambda_e"]
    tells = steady(x, rates) & (np.abs(rates["lambda_e"]) < STEADY * probe) & (fuel > LIGHT) & (probe < LEAN)
    return np.where(tells, probe * c.air_fuel * c.k_fuel * intake.cylinder_fuel_flow(c, x["n_e"], fuel), np.nan)


def flows(c: Any, x: Mapping[str, Array], rates: Mapping[str, Array]) -> Array:
    """Return the flow past the sensor by all balances, shape (3, n) [kg/s]."""
    W_ei = intake.cylinder_flow(c, x)
    return np.stack([*filling(c, x, rates, W_ei), mixture(c, x, rates)])


def corrections(c: Any, x: Mapping[str, Array], rates: Mapping[str, Array]) -> tuple[Correction, ...]:
    """Return how each of `COMPONENTS` moves the balances at n places, given channels and their rates there."""
    W_ei = intake.cylinder_flow(c, x)
    u_egr = np.nan_to_num(_read(x, "u_egr"))
    W_egr, per_area = egr(c, x, W_ei)
    driven = np.where(np.isfinite(_read(x, "p_em")), 0.0, np.nan_to_num(W_egr))
    nozzle = Points((OPENING.values, SPEED.values, LOAD.values), (u_egr, x["n_e"], x["u_delta"]))
    burnt = mixture(c, x, rates)
    late = rates.get("lambda_e", 0.0) / x.get("lambda_e", np.nan)
    both = (FILLING, RECIRCULATED)
    rises = W_ei * (rates["p_im"] / x["p_im"] + rates["n_e"] / np.maximum(x["n_e"], 300.0))
    return (
        *(Correction(both, W_ei, points) for points in intake.shape_points(x)),
        Correction(both, intake.per_charge(W_ei, x)),
        Correction(RECIRCULATED, -intake.egr_area(c, u_egr) * per_area, nozzle),
        Correction(RECIRCULATED, -driven, Points((DRIVE_SPEED.values, DRIVE_LOAD.values), (x["n_e"], x["u_delta"]))),
        Correction(both, -c.A_egr_max * per_area),
        Correction(MIXTURE, burnt * late),
        Correction(None, -rises),
    )

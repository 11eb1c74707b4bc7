"""Where the model of a diesel may be wrong: corrections of its components, and how far its balances can be relied on.

A real compressor, real cylinders and a real EGR valve follow no formula of three constants. Their corrections are surfaces over the
component's own inputs, small before any data say otherwise. Those of compressor and EGR add a flow rather than multiply one, for
the error of a flow does not vanish with the flow.
"""

from collections.abc import Mapping

import numpy as np

from lpvobs.compiled import njit
from lpvobs.engines.components import intake
from lpvobs.engines.components.intake import LOAD, OPENING
from lpvobs.engines.curves import Points, nodes
from lpvobs.engines.diesel import relations as relation
from lpvobs.engines.diesel.constants import DieselConstants
from lpvobs.engines.followers import Follower
from lpvobs.engines.unknowns import Caution, Component, Correction, MeasuredPart
from lpvobs.records import Array

COMPRESSOR, FILLING = 0, 1  # numbers of the balances
VOLUMES = ("V_im",)  # constants that the balances owe what they store to

TIP_SPEED = nodes("m/s", "tip speed of the compressor", 60, 140, 220, 300, 380, 460)
HEAD = nodes("1", "head coefficient Psi_c", -0.4, 0.0, 0.4, 0.7, 0.9, 1.1, 1.25, 1.4)
RATIO = nodes("1", "p_im / p_em", 0.7, 0.82, 0.9, 0.96, 1.03)
COMPONENTS = (
    Component(
        "compressor", "1", "added compressor flow, as a share of the flow without pressure rise", 0.04, "compressor",
        {"U_c": TIP_SPEED, "Psi_c": HEAD}, (120.0, 0.5),
    ),
    *intake.SHAPE,
    Component("eta_vol_exhaust", "1", "relative change of the volumetric efficiency per unit of p_em / p_im", 0.03, "eta_vol"),
    intake.CHARGE,
    Component("eta_vol_heat", "1", "relative change of the volumetric efficiency per 100 K of T_ports", 0.005, "eta_vol"),
    Component(
        "egr", "1", "added EGR flow, as a share of the choked flow", 0.3, "egr",
        {"u_egr": OPENING, "p_im/p_em": RATIO, "u_delta": LOAD}, (25.0, 0.12, 25.0),
    ),
    Component("T_em_lag", "s", "lag of the sensor of T_em", 1.0),
    Component("omega_t_lag", "s", "lag of the sensor of omega_t behind that of p_im", 0.01),
    intake.MAF_LAG,
)  # fmt: skip
"""Deviations of 3 and 4 % of filling and compressor, 30 % of the EGR: what bench points left of models fitted to them."""
MEASURED_PARTS = (MeasuredPart("egr", "W_egr_reference", FILLING, {"u_egr": 0.0}, 0.02, 2e-5),)
"""EGR flow from CO2 before and behind the engine: 2 % and 0.02 g/s."""
USUAL_RATIO = 1.2  # p_em / p_im at which the slope of the filling adds nothing
USUAL_HEAT = 600.0  # [K], T_ports at which that of the warm cylinders adds nothing
FOLLOWERS = {"T_ports": Follower("T_em", 25.0)}
"""Ports and valves warm the charge, and follow the gas within half a minute (Heywood 1988, Sec. 12.7). On four engines of another
structure the map was off by 0.51 % of the air flow with T_em itself, by 0.42 % with 25 s, and the same with 15 s."""
INSTANT = 1e-3  # [s] over which the flow's rate of change is taken
RELIABLE = 0.02  # share of the flow without pressure rise; a compressor's flow that is surer than this has full weight


def corrections(c: DieselConstants, x: Mapping[str, Array], rates: Mapping[str, Array]) -> tuple[Correction, ...]:
    """Return how each of `COMPONENTS` moves the balances at n places, given channels and their rates there."""
    T_em = x["T_em"]
    W_egr = intake.egr_flow(c, x["p_im"], x["p_em"], x["u_egr"], x["T_im"], T_em)
    return (
        *flow_corrections(c, x),
        Correction(FILLING, 0.5 * W_egr / T_em * rates["T_em"]),
        Correction(COMPRESSOR, _flow_rate(c, x, rates, "omega_t")),
        Correction(None, -_flow_rate(c, x, rates, "p_im", "omega_t")),
    )


def flow_corrections(c: DieselConstants, x: Mapping[str, Array]) -> tuple[Correction, ...]:
    """Return the same of those that add to a flow, all but the lags."""
    p_im, p_em, T_em = x["p_im"], x["p_em"], x["T_em"]
    T_ports = x.get("T_ports", T_em)  # the same at rest: a bench has no history
    W_ei = intake.cylinder_flow(c, x)
    nozzle = intake.egr_area(c, x["u_egr"]) * p_em / np.sqrt(T_em * c.R_e)
    U_c, rise = c.R_c * x["omega_t"], (p_im / x["p_amb"]) ** (1.0 - 1.0 / c.gamma_a) - 1.0
    Psi_c = np.asarray(2.0 * c.c_pa * x["T_amb"] * rise / U_c**2)
    return (
        Correction(COMPRESSOR, _free_flow(c, x), Points((TIP_SPEED.values, HEAD.values), (U_c, Psi_c))),
        *(Correction(FILLING, W_ei, points) for points in intake.shape_points(x)),
        Correction(FILLING, W_ei * (p_em / p_im - USUAL_RATIO)),
        Correction(FILLING, intake.per_charge(W_ei, x)),
        Correction(FILLING, W_ei * (T_ports - USUAL_HEAT) / 100.0),
        Correction(FILLING, -nozzle, Points((OPENING.values, RATIO.values, LOAD.values), (x["u_egr"], p_im / p_em, x["u_delta"]))),
    )  # fmt: skip


def caution(c: DieselConstants, x: Mapping[str, Array], noise: Mapping[str, Array], spread: float) -> Caution:
    """Return how far the balances can be relied on, and what the compressor's curvature makes of noise.

    Near stall the flow answers to pressure and speed without bound, and the slope by a constant says nothing of a larger
    change. `noise` is the standard deviation of what is left of it in `p_im` and `omega_t`, shape (n,) as the channels x have
    it; `spread` is the relative one of the constants that scale the tip speed.
    """
    flow = compressor_flow(c, x)
    turned = {"p_im": noise["p_im"], "omega_t": noise["omega_t"]}
    moved, bent = _differences(c, x, flow, turned)
    _, uncertain = _differences(c, x, flow, {"omega_t": spread * x["omega_t"]})
    doubt = np.sqrt(moved**2 + uncertain**2) / (RELIABLE * _free_flow(c, x))
    trust, bias = np.ones((2, flow.size)), np.zeros((2, flow.size))
    trust[COMPRESSOR], bias[COMPRESSOR] = 1.0 / (1.0 + doubt**2), bent
    return Caution(trust, bias)


def _differences(
    c: DieselConstants, x: Mapping[str, Array], flow: Array, steps: Mapping[str, Array]
) -> tuple[Array, Array]:
    """Return how far steps of channels move the compressor's flow, root of squares, and half its second differences, summed."""
    squares, second = np.zeros(flow.size), np.zeros(flow.size)
    for name, step in steps.items():
        up, down = (compressor_flow(c, {**x, name: x[name] + way * step}) for way in (1.0, -1.0))
        squares += (0.5 * (up - down)) ** 2
        second += 0.5 * (up + down - 2.0 * flow)
    return np.sqrt(squares), second


def compressor_flow(c: DieselConstants, x: Mapping[str, Array]) -> Array:
    """Return W_c = rho_1 omega_t of Eq. (2) [kg/s], shape (n,)."""
    return np.asarray(_flow_at(c, x["p_im"], x["omega_t"], x["p_amb"], x["T_amb"]))


@njit(cache=True)
def _flow_at(c, p_im, omega_t, p_amb, T_amb):  # type: ignore[no-untyped-def]
    flow = np.empty(p_im.size)
    for k in range(p_im.size):  # powers apart: what follows is done several samples at a time
        flow[k] = relation.head(c, p_im[k], p_amb[k])
    for k in range(p_im.size):
        flow[k] = relation.rho_1_of(c, flow[k], omega_t[k], p_amb[k], T_amb[k]) * omega_t[k]  # Eq. (2)
    return flow


def _flow_rate(c: DieselConstants, x: Mapping[str, Array], rates: Mapping[str, Array], *names: str) -> Array:
    """Return how fast the compressor's flow changes [kg/s^2] with the signals named."""
    steps = {name: INSTANT * rates[name] for name in names}
    after, before = (
        compressor_flow(c, {**x, **{n: x[n] + way * step for n, step in steps.items()}}) for way in (1.0, -1.0)
    )
    return (after - before) / (2.0 * INSTANT)


def _free_flow(c: DieselConstants, x: Mapping[str, Array]) -> Array:
    """Return the compressor's flow without a pressure rise [kg/s]."""
    return compressor_flow(c, {**x, "p_im": x["p_amb"]})

"""The balances of a diesel with EGR and VGT, the effects of the contract that it may have, and the engine as the loop sees it."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lpvobs.compiled import njit
from lpvobs.engines.blocks import Blocks
from lpvobs.engines.components import intake
from lpvobs.engines.components.intake import EGR, PRESSURE, AsFound, found_around, on_the_intake
from lpvobs.engines.curves import Nodes
from lpvobs.engines.diesel import relations as relation
from lpvobs.engines.diesel.constants import DieselConstants, DieselEngine, constants_of
from lpvobs.engines.diesel.corrections import COMPONENTS, FOLLOWERS, RATIO, flow_corrections
from lpvobs.engines.diesel.turbine import POWER, TURBINE_INPUTS, left_again, turbine_as_modelled
from lpvobs.engines.effects import BOOST, STEADY, Effect, Signals, gain, lacking, reading
from lpvobs.engines.residual_model import ComponentCurve, DayToDay, ResidualModel, levels_of
from lpvobs.engines.unknowns import Correction, Unknowns, loop_unknowns, places_of
from lpvobs.records import Array

BALANCES = ("compressor", "filling", "exhaust", "turbo")
CHANNELS = ("n_e", "u_delta", "u_egr", "u_vgt", "p_im", "p_em", "omega_t", "T_im", "T_em", "p_amb", "T_amb", "W_maf")

LACKS = intake.LACKS | {"compressor": 1.0, "turbine": 1.0, "exhaust": 1.0}
"""Sizes of what the engine's model lacks (leaks in m^2, factors), on an engine in order."""
OMEGA_T, T_EM, T_AMB, W_MAF = (CHANNELS.index(name) for name in ("omega_t", "T_em", "T_amb", "W_maf"))
TURNING = np.array([CHANNELS.index(name) for name in TURBINE_INPUTS])
COMPRESSOR, CYLINDERS, EXHAUST_RETURN, T_EM_LAG, OMEGA_T_LAG, W_MAF_LAG = range(6)
PARTS = {
    "compressor": COMPRESSOR, "egr": EXHAUST_RETURN, "T_em_lag": T_EM_LAG, "omega_t_lag": OMEGA_T_LAG, "W_maf_lag": W_MAF_LAG,
    **dict.fromkeys(("eta_vol", "eta_vol_waves", "eta_vol_exhaust", "eta_vol_charge", "eta_vol_heat"), CYLINDERS),
}  # fmt: skip
"""What the corrections change: flows of compressor, cylinders and EGR [kg/s], and three signals by their lag [s]."""
NUDGES = (1e-5, 1e-5, 1e-5, 1e-4, 1e-4, 1e-4)
"""Steps of difference quotients by these: a flow in ten thousand, and a lag that is short against any transient."""


def imbalances_of(c: DieselConstants, x: Array, dx: Array, lacks: Array, flows: Array) -> Array:
    """Return what is left of each balance, shape (4, K) [kg/s].

    `x` and `dx` are values and rates, (12, K), in the order of `CHANNELS`, `lacks` (7, K) in the order of `LACKS`. `flows` is what
    corrections add to the flows of compressor, cylinders and EGR, (3, K).
    """
    return np.asarray(_imbalances_of(c, x, dx, lacks, flows, *turbine_as_modelled(c, x[TURNING], lacks[6])))


@njit(cache=True)
def _imbalances_of(
    c: DieselConstants, x: Array, dx: Array, lacks: Array, flows: Array, W_t: Array, Pi_t: Array
) -> Array:
    # Each relation has a loop of its own: in one loop over all of them, every place waits for its own powers.
    n_e, u_delta, u_egr, _, p_im, p_em, omega_t, T_im, T_em, p_amb, T_amb, W_maf = x
    K = n_e.size
    out, (head, rho_1, W_ei, W_egr, turned) = np.empty((4, K)), np.empty((5, K))
    for k in range(K):
        head[k] = relation.head(c, p_im[k], p_amb[k])
    for k in range(K):
        of_speed = relation.rho_1_of(c, head[k], omega_t[k], p_amb[k], T_amb[k])
        rho_1[k] = lacks[4, k] * (of_speed + flows[0, k] / omega_t[k])
    for k in range(K):
        W_ei[k] = lacks[3, k] * (intake.rho_3(c, p_im[k], n_e[k], T_im[k]) * p_im[k] + flows[1, k])
        rho_2 = intake.rho_2(c, p_im[k], p_em[k], u_egr[k], T_im[k], T_em[k])
        W_egr[k] = lacks[2, k] * (rho_2 * p_em[k] + flows[2, k])
        if lacks[1, k] != 0.0:
            W_egr[k] += lacks[1, k] * intake.egr_per_area(c, p_im[k], p_em[k], T_im[k], T_em[k])
    for k in range(K):
        turned[k] = lacks[5, k] * relation.turbine_power(c, W_t[k], Pi_t[k], omega_t[k], T_em[k])
    for k in range(K):
        rho_5 = relation.rho_5(c, rho_1[k], head[k], p_im[k], omega_t[k], p_amb[k], T_amb[k])
        turned[k] -= c.J_t * omega_t[k] * omega_t[k] * rho_5
    for k in range(K):
        W_leak = lacks[0, k] * intake.escape(c, p_im[k], T_im[k], p_amb[k], T_amb[k]) if lacks[0, k] != 0.0 else 0.0
        stored = c.V_im / (c.R_a * T_im[k]) * (dx[4, k] - p_im[k] / T_im[k] * dx[7, k])
        W_f = intake.cylinder_fuel_flow(c, n_e[k], u_delta[k])
        out[0, k] = W_maf[k] - rho_1[k] * omega_t[k]
        out[1, k] = W_maf[k] - (W_ei[k] - W_egr[k] + W_leak + stored)
        out[2, k] = W_ei[k] + W_f - W_t[k] - W_egr[k] - c.V_em / (c.R_e * T_em[k]) * dx[5, k]
        out[3, k] = (turned[k] - c.J_t * omega_t[k] * dx[6, k]) / POWER
    return out


def imbalances(found: AsFound, s: Signals, _: Blocks | None = None) -> Array:
    """Return what is left of each balance, shape (4, C) [kg/s]."""
    return _imbalances(found, s, _changes(found, s))


def _imbalances(found: AsFound, s: Signals, changes: Array) -> Array:
    """Return the balances with changes of `PARTS`, shape (6, C)."""
    x, dx = _stacked(s.value), _stacked(s.rate)
    # a gas that a slow sensor lags behind is no colder than the air: noise in the rate would take it below zero
    x[T_EM] = np.maximum(x[T_EM] + changes[T_EM_LAG] * dx[T_EM], np.minimum(x[T_EM], x[T_AMB]))
    x[OMEGA_T] += changes[OMEGA_T_LAG] * dx[OMEGA_T]
    x[W_MAF] += changes[W_MAF_LAG] * dx[W_MAF]
    return imbalances_of(found.constants, x, dx, s.lacks, changes[:T_EM_LAG])


def left_with(found: AsFound, s: Signals, left: Array) -> Array:
    """Return how what a healthy engine leaves changes with what the engine lacks, shape (4, C) [kg/s]."""
    if (s.lacks[5:] == 1.0).all():
        return np.zeros((len(BALANCES), s.lacks.shape[1]))
    by_turbine = left_again(found.constants, _stacked(s.value)[TURNING], s.lacks[5:], left[2:])
    return np.concatenate([np.zeros_like(by_turbine), by_turbine])


def _changes(found: AsFound, s: Signals) -> Array:
    """Return what the values of the corrections change, shape (6, C)."""
    changes = np.zeros((len(NUDGES), s.lacks.shape[1]))
    if found.values.size:
        for part, place, sign, correction in _parts(found, s):
            changes[part] += sign * correction.moved_by(found.values[place])
    return changes


def _parts(found: AsFound, s: Signals) -> Iterator[tuple[int, slice, float, Correction]]:
    """Yield of every correction what it changes, where its values stand, its sign, and how it moves the flow or the lag."""
    lag = Correction(None, np.ones(s.lacks.shape[1]))
    moved = (*flow_corrections(found.constants, s.value), lag, lag, lag)
    for (name, place), correction in zip(places_of(COMPONENTS).items(), moved, strict=True):
        part = PARTS[name]
        yield part, place, -1.0 if part == EXHAUST_RETURN else 1.0, correction  # it lowers the flow past the sensor


def by_corrections(modes: Array, found: AsFound, s: Signals, _: Blocks | None) -> Array:
    """Return the derivatives of the balances by modes of the corrections, given as (values, m), shape (m, 4, C)."""
    changes, along = _changes(found, s), np.zeros((len(NUDGES), s.lacks.shape[1], modes.shape[1]))
    for part, place, sign, correction in _parts(found, s):
        along[part] += sign * correction.columns(place.stop - place.start) @ modes[place]
    at = _imbalances(found, s, changes)
    derivatives = np.zeros((modes.shape[1], *at.shape))
    for part, nudge in enumerate(NUDGES):
        nudged = changes.copy()
        nudged[part] += nudge
        derivatives += (_imbalances(found, s, nudged) - at) / nudge * along[part].T[:, None]
    return derivatives


def further(found: AsFound, s: Signals) -> tuple[Array, Array]:
    """Return what the engine lacks adds to the flows of compressor and filling, (2, N) [kg/s], and to dx/dt, (3, N)."""
    # The first imbalance is the reading less W_c, the second the reading less what leaves the intake manifold, the third
    # what enters the exhaust manifold less what leaves it, the fourth the power that is left for the turbocharger's rotor.
    x, dx = _stacked(s.value), _stacked(s.rate)
    in_order = np.tile(np.array(list(LACKS.values()))[:, None], (1, x.shape[1]))
    c, flows = found.constants, _changes(found, s)[:T_EM_LAG]
    change = imbalances_of(c, x, dx, s.lacks, flows) - imbalances_of(c, x, dx, in_order, flows)
    a_1, a_2 = c.R_a * s["T_im"] / c.V_im, c.R_e * s["T_em"] / c.V_em
    rotor = change[3] * POWER / (c.J_t * np.maximum(s["omega_t"], 1.0))
    return -change[:2], np.stack([a_1 * (change[1] - change[0]), a_2 * change[2], rotor])


def _stacked(channels: Mapping[str, Array]) -> Array:
    """Return channels in the order of `CHANNELS`; one without a rate stands still."""
    still = np.zeros(channels[CHANNELS[0]].size)
    return np.stack([channels.get(name, still) for name in CHANNELS])


SPEED = Nodes(np.arange(600.0, 4401.0, 200.0), "rpm", "engine speed")
TIP_SPEED = Nodes(np.arange(20.0, 461.0, 40.0), "m/s", "tip speed of the compressor")
COMPRESSION = Nodes(np.array([0.9, 1.1, 1.3, 1.6, 2.0, 2.5, 3.1]), "1", "p_im / p_amb")
OPENING = Nodes(np.arange(5.0, 86.0, 8.0), "%", "EGR valve opening")
VANES = Nodes(np.arange(20.0, 77.0, 8.0), "%", "opening of the turbine's vanes")
EXPANSION = Nodes(np.arange(0.3, 1.05, 0.1), "1", "p_amb / p_em")
INPUTS: Mapping[str, Callable[[AsFound, Mapping[str, Array]], Array]] = {
    "U_c": lambda found, x: found.constants.R_c * x["omega_t"],
    "p_im/p_amb": lambda _, x: x["p_im"] / x["p_amb"],
    "p_im/p_em": lambda _, x: x["p_im"] / x["p_em"],
    "p_amb/p_em": lambda _, x: x["p_amb"] / x["p_em"],
}
"""Those that are no channels."""


PULSATION_SPEED = 2000.0  # [rpm] Speed above which the flow at the sensor no longer pulsates backward
PULSATION_FUEL = 40.0  # [mg/cycle] Full load at low speed
ANY_DAY = DayToDay()  # the differences between days where none are configured


def pulsating(s: Signals | Mapping[str, Array], x: float) -> Array:
    """Return reading over truth where the flow pulsates backward: x at 1000 rpm and full load."""
    slow = np.clip((PULSATION_SPEED - s["n_e"]) / 1000.0, 0.0, None)
    return np.asarray(1.0 + x * slow * np.maximum(s["u_delta"], 0.0) / PULSATION_FUEL)


_SHARED = on_the_intake(lambda found, s: imbalances(found, s)[1])
CATALOGUE = (
    *(_SHARED[f"maf.{name}"] for name in ("delay", "lag", "offset", "gain", "drift", "temperature")),
    Effect(
        "maf.backflow", "coefficient", "1", 0.0, 0.05, -0.5, 2.0, "sensor", reading(pulsating), STEADY, True,
        unlearned=0.1,
    ),
    *(_SHARED[name] for name in ("maf.contamination", "leak.inlet", "u_delta.gain", "p_im.offset", "p_im.gain")),
    Effect("p_em.gain", "factor", "1", 1.0, 0.01, 0.7, 1.3, "p_em", gain("p_em"), EGR),
    Effect("omega_t.gain", "factor", "1", 1.0, 0.005, 0.8, 1.2, "omega_t", gain("omega_t"), BOOST),
    *(_SHARED[name] for name in ("T_im.lag", "leak.intake", "egr.leak", "egr.area", "eta_vol.factor")),
    Effect("compressor.flow", "factor", "1", 1.0, 0.03, 0.6, 1.3, "compressor", lacking(LACKS, "compressor"), BOOST),
    Effect("turbine.efficiency", "factor", "1", 1.0, 0.03, 0.5, 1.5, "turbine", lacking(LACKS, "turbine"), BOOST, straight=True),
    Effect(
        "exhaust.restriction", "factor", "1", 1.0, 0.5, 0.3, 10.0, "exhaust", lacking(LACKS, "exhaust"), BOOST,
        unlearned=0.2,
    ),
)  # fmt: skip
"""The effects in the order in which they are undone: the last one on the way into the log comes first.

The balances respond to back pressure through the turbine, which bench points do not show. It goes with the square of the turbine's
flow. Beside healthy drives, which show that flow, its sizes came out 17 % too small (median of 10 on seed 872443).
How a pulsating flow reads depends on the sensor: sizes by another law were off by 11 % (median of 12).
"""
_BY_NAME = {effect.id: effect for effect in CATALOGUE}
CURVES = (
    ComponentCurve("eta_vol.curve", _BY_NAME["eta_vol.factor"], 0.03, {"n_e": SPEED, "p_im": PRESSURE}, (500.0, 5e4)),
    ComponentCurve(
        "compressor.curve", _BY_NAME["compressor.flow"], 0.04,
        {"U_c": TIP_SPEED, "p_im/p_amb": COMPRESSION}, (100.0, 0.6), INPUTS,
    ),
    ComponentCurve(
        "egr.curve", _BY_NAME["egr.area"], 0.2, {"u_egr": OPENING, "p_im/p_em": RATIO}, (20.0, 0.12), INPUTS
    ),
    ComponentCurve(
        "turbine.curve", _BY_NAME["turbine.efficiency"], 0.04,
        {"u_vgt": VANES, "p_amb/p_em": EXPANSION}, (20.0, 0.3), INPUTS,
    ),
)  # fmt: skip
"""Curves that drive an effect each: deviations before any data and lengths over which values are correlated as in `corrections`, of
the turbine as of the compressor, of the EGR as of a valve whose constants are fitted."""


def diesel_model(
    engine: DieselEngine, tolerance: Mapping[str, float], day: DayToDay = ANY_DAY, known: Unknowns | None = None
) -> ResidualModel:
    """Return the diesel as the loop sees it, around its configured constants; no log teaches any of it."""
    # They are known within a tolerance, as if uniformly distributed; or, with the corrections of the components, as a
    # calibration knows them, relative to where it found them.
    constants, point = constants_of(engine), loop_unknowns(tolerance, known)
    return ResidualModel(
        balances=BALANCES,
        unit="kg/s",
        channels=CHANNELS,
        followers=FOLLOWERS,
        moving=("n_e", "u_delta", "u_egr", "u_vgt", "p_im", "p_em", "omega_t", "T_im", "T_em"),
        fuel="u_delta",
        speed="n_e",
        lacks=tuple(LACKS.values()),
        constants=AsFound(constants, point.values),
        names=point.names,
        covariance=point.covariance,
        with_unknowns=found_around(constants, point),
        imbalances=imbalances,
        by_reading=by_reading,
        left_with=left_with,
        shown=shown,
        further=further,
        catalogue=CATALOGUE,
        carriers=("maf.gain", "maf.offset", "eta_vol.factor", "egr.area", "compressor.flow"),
        curves=CURVES,
        levels=levels_of(day, BALANCES, "kg/s", CATALOGUE),
        by_unknowns=None if known is None else partial(by_corrections, point.modes),
        adding=point.modes.shape[1],
    )


def by_reading(_: AsFound, s: Signals, __: Blocks | None) -> Array:
    """Return one for the balances that the sensor is part of, zero for the others, at every instant, shape (4, K)."""
    return np.repeat([[1.0], [1.0], [0.0], [0.0]], s.time.size // 2, axis=1)


def shown(s: Signals, _: Blocks | None) -> NDArray[np.bool_]:
    """Return that every balance counts everywhere, shape (4, K)."""
    return np.ones((len(BALANCES), s.time.size // 2), dtype=bool)

"""Tables of single components that suppliers and control units have, as points at which the engine's formulas say the same flow.

A compressor's map is stated for a temperature and a pressure before it: corrected speed N (T_reference / T)^(1/2), corrected flow
W (T / T_reference)^(1/2) p_reference / p. Reduced quantities, N / T^(1/2) and W T^(1/2) / p, need none. At the reference state
corrected quantities are the true ones; reduced ones become true at any state.
"""

from collections.abc import Mapping

import numpy as np

from lpvobs.engines.components import intake
from lpvobs.engines.constants import Within
from lpvobs.engines.diesel import relations as relation
from lpvobs.engines.diesel.constants import DieselEngine, constants_of
from lpvobs.engines.diesel.corrections import COMPRESSOR, FILLING, USUAL_RATIO
from lpvobs.engines.unknowns import TABLE_FLOW, ComponentMap, MeasuredPart
from lpvobs.records import Array

SOME_STATE = {
    "n_e": 2000.0, "u_delta": 15.0, "u_egr": 0.0, "u_vgt": 50.0, "p_im": 1.2e5, "p_em": USUAL_RATIO * 1.2e5, "omega_t": 1e4,
    "T_im": intake.USUAL_CHARGE, "T_em": 700.0, "p_amb": 1e5, "T_amb": 298.15,
}  # fmt: skip
"""What a table says nothing of, and its flow does not depend on."""
LEAST = 1e-5  # [kg/s], standard deviation of a flow near nothing: what is left of the last digit
RATIO = Within(1.0, 10.0, "1", "pressure ratio")
PER_PRESSURE = "kg*K^0.5/(s*kPa)"
LOAD = Within(-5, 300, "mg/cycle", "injected fuel")
AREA = Within(0, 0.02, "m^2", "effective area of an EGR valve")
OPENING = Within(-5, 105, "%", "opening")


def _points(of: Mapping[str, Array], **channels: Array | float) -> Mapping[str, Array]:
    """Return channels and flow at all points of a table, `SOME_STATE` where nothing else is said."""
    size = next(iter(of.values())).size
    return {name: np.broadcast_to(value, size).astype(float) for name, value in {**SOME_STATE, **channels}.items()}


def compressor(_: DieselEngine, table: Mapping[str, Array]) -> Mapping[str, Array]:
    """Return the points of a compressor's map."""
    if "corrected_flow" in table:
        T, p, speed, flow = (table[n] for n in ("T_reference", "p_reference", "corrected_speed", "corrected_flow"))
    else:
        T, p = (np.full(table["reduced_flow"].size, SOME_STATE[name]) for name in ("T_amb", "p_amb"))
        speed, flow = table["reduced_speed"] * np.sqrt(T) * np.pi / 30.0, table["reduced_flow"] * p / 1e3 / np.sqrt(T)
    return _points(table, T_amb=T, p_amb=p, p_im=table["pressure_ratio"] * p, omega_t=speed, flow=flow)


def filling(engine: DieselEngine, table: Mapping[str, Array]) -> Mapping[str, Array]:
    """Return the points of a table of volumetric efficiency, over the displacement of the configuration."""
    swept = table["p_im"] * table["n_e"] * engine.geometry.V_d / (120.0 * engine.gas.R_a * intake.USUAL_CHARGE)
    n_e, p_im, flow = table["n_e"], table["p_im"], table["eta_vol"] * swept
    return _points(table, n_e=n_e, p_im=p_im, p_em=USUAL_RATIO * p_im, flow=flow)


def egr(engine: DieselEngine, table: Mapping[str, Array]) -> Mapping[str, Array]:
    """Return the points of a table of effective EGR areas, behind which the pressure is the usual one."""
    nozzle = SOME_STATE["p_em"] / np.sqrt(SOME_STATE["T_em"] * engine.gas.R_e)
    open_ = intake.egr_flow_function(constants_of(engine), 1.0 / USUAL_RATIO)
    load = {"u_delta": table["u_delta"]} if "u_delta" in table else {}
    return _points(table, u_egr=table["u_egr"], flow=table["area"] * nozzle * open_, **load)


def turbine(_: DieselEngine, table: Mapping[str, Array]) -> Mapping[str, Array]:
    """Return the points of a turbine's map; `p_amb` is the pressure behind the wheel."""
    p_em, T_em = SOME_STATE["p_em"], SOME_STATE["T_em"]
    flow = table["reduced_flow"] * p_em / 1e3 / np.sqrt(T_em)
    return _points(table, u_vgt=table["u_vgt"], p_amb=p_em / table["pressure_ratio"], flow=flow)


def turbine_flow(engine: DieselEngine, x: Mapping[str, Array]) -> Array:
    """Return W_t [kg/s] of Eq. (2) at a known expansion ratio."""
    c = constants_of(engine)
    scale = np.array([relation.turbine_scale(c, u, T) for u, T in zip(x["u_vgt"], x["T_em"], strict=True)])
    return scale * x["p_em"] * np.sqrt(1.0 - (x["p_amb"] / x["p_em"]) ** c.K_t)


CORRECTED = {
    "corrected_flow": Within(0, 5, "kg/s", "flow of a compressor"),
    "corrected_speed": Within(100, 4e4, "rad/s", "speed of a compressor"),
    "pressure_ratio": RATIO, "T_reference": Within(200, 400, "K", "temperature that corrected quantities refer to"),
    "p_reference": Within(5e4, 1.2e5, "Pa", "pressure that corrected quantities refer to"),
}  # fmt: skip
REDUCED = {
    "reduced_flow": Within(0, 1, PER_PRESSURE, "reduced flow of a compressor"),
    "reduced_speed": Within(50, 3e4, "rpm/K^0.5", "reduced speed of a compressor"),
    "pressure_ratio": RATIO,
}  # fmt: skip
COMPONENT_MAPS: Mapping[str, ComponentMap] = {
    "compressor": ComponentMap(
        (CORRECTED, REDUCED), 0.03, MeasuredPart("compressor map", TABLE_FLOW, COMPRESSOR, {}, 0.0, LEAST), compressor
    ),
    "turbine": ComponentMap(
        ({"reduced_flow": Within(0, 1, PER_PRESSURE, "reduced flow of a turbine"), "pressure_ratio": RATIO, "u_vgt": OPENING},),
        0.05, MeasuredPart("turbine map", TABLE_FLOW, FILLING, {}, 0.0, LEAST), turbine, turbine_flow,
        ("A_vgt_max", "K_t", "f_vgt_min", "c_f1", "c_f2"),
    ),
    "eta_vol": ComponentMap(
        ({"n_e": Within(100, 8000, "rpm", "engine speed"), "p_im": Within(2e4, 6e5, "Pa", "intake manifold pressure"),
          "eta_vol": Within(0.2, 1.5, "1", "volumetric efficiency")},),
        0.03, MeasuredPart("eta_vol map", TABLE_FLOW, FILLING, {}, 0.0, LEAST), filling,
    ),
    "egr": ComponentMap(
        ({"u_egr": OPENING, "u_delta": LOAD, "area": AREA}, {"u_egr": OPENING, "area": AREA}),
        0.1, MeasuredPart("egr map", TABLE_FLOW, FILLING, {"u_egr": 0.0}, 0.0, LEAST), egr,
    ),
}  # fmt: skip
"""Tolerances where the file states none, assumed: 3 % as the prior of the filling has it; a turbine on an engine sees pulses, and
the area of a valve depends on its soot."""

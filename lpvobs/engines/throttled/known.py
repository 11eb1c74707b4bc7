"""The learned throttled engine as files hold it, and back."""

import numpy as np

from lpvobs.engines.knowledge import Knowledge, LearnedCurve, LearnedNumber, Nodes
from lpvobs.engines.throttled.constants import Learned, ThrottledEngine
from lpvobs.records import Array


def knowledge_of(engine: ThrottledEngine, learned: Learned) -> Knowledge:
    """Return what healthy logs have taught."""
    at, where = engine.curves, learned.deviations()
    spread = np.sqrt(np.diag(learned.covariance))
    speed = "engine speed"
    axes = {
        "throttle": {"alpha_th": Nodes(np.array(at.alpha_th), "%", "throttle opening")},
        "filling": {
            "n_e": Nodes(np.array(at.n_e), "rpm", speed),
            "p_im": Nodes(np.array(at.p_im), "Pa", "intake manifold pressure"),
        },
        "fuel": {
            "m_f": Nodes(np.array(at.m_f), "1", "fuel reading per stroke"),
            "n_e": Nodes(np.array(at.fuel_n_e), "rpm", speed),
        },
    }
    values = {
        "throttle": ("area", "m^2", "effective area", learned.area),
        "filling": ("eta_vol", "1", "volumetric efficiency", learned.eta_vol),
        "fuel": ("air", "kg", "air in a cylinder per unit of the fuel reading", learned.fuel),
    }
    curves = {
        part: LearnedCurve(axes[part], name, unit, meaning, curve, spread[where[part]].reshape(curve.shape))
        for part, (name, unit, meaning, curve) in values.items()
    }
    numbers = {
        "V_ic": LearnedNumber(learned.V_ic, "m^3", "volume before the throttle"),
        "V_im": LearnedNumber(learned.V_im, "m^3", "volume behind the throttle"),
        "calm_flow": LearnedNumber(learned.calm_flow, "kg/s", "below it p_ic is compared with p_amb"),
    }
    return Knowledge(curves, numbers, learned.covariance, learned.sources)


def learned_of(known: Knowledge) -> Learned:
    """Return the engine that a file holds; raises KeyError for another engine's."""
    curves, numbers = known.curves, known.numbers
    return Learned(
        area=curves["throttle"].values,
        eta_vol=curves["filling"].values,
        fuel=curves["fuel"].values,
        V_ic=numbers["V_ic"].value,
        V_im=numbers["V_im"].value,
        covariance=known.covariance,
        sources=known.sources,
        calm_flow=numbers["calm_flow"].value,
    )


def in_c(engine: ThrottledEngine, learned: Learned) -> dict[str, float | Array]:
    """Return the numbers that `model.c` reads: what is configured, nodes of the curves, and the curves."""
    configured = {**vars(engine.air), **vars(engine.geometry)}
    nodes = {name: np.array(getattr(engine.curves, name)) for name in ("alpha_th", "n_e", "p_im")}
    own = {"area": learned.area, "eta_vol": learned.eta_vol.reshape(-1), "V_ic": learned.V_ic, "V_im": learned.V_im}
    return configured | nodes | own

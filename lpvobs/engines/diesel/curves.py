"""Curves that components of a diesel may have: a factor on each over two of its own inputs."""

from collections.abc import Callable, Mapping

import numpy as np

from lpvobs.engines.components.intake import PRESSURE
from lpvobs.engines.diesel.balances import DieselAsFound
from lpvobs.engines.diesel.corrections import RATIO
from lpvobs.engines.effects import Effect
from lpvobs.engines.knowledge import Nodes
from lpvobs.engines.residual_model import ComponentCurve
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
INPUTS: Mapping[str, Callable[[DieselAsFound, Mapping[str, Array]], Array]] = {
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

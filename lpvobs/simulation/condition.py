"""Effects inside the engine: its condition from each moment on at which one of them starts, ends or grows."""

from collections.abc import Sequence

import numpy as np

from lpvobs.simulation.effects import CatalogueEffect
from lpvobs.simulation.plant import SOUND, Condition, Plant, Rise

FIELDS = {
    "leak.intake": "leak_intake",
    "egr.leak": "egr_leak",
    "egr.area": "egr_area",
    "eta_vol.factor": "eta_vol",
    "compressor.flow": "compressor_flow",
    "turbine.efficiency": "turbine_efficiency",
    "exhaust.restriction": "exhaust_restriction",
    "eta_vol.curve": "eta_vol_curve",
    "compressor.curve": "compressor_curve",
    "egr.curve": "egr_curve",
    "turbine.curve": "turbine_curve",
}
"""Where in the plant's condition each effect enters."""
LEVELS = 200
"""Steps in which an effect grows: half a per cent of it."""


def stages_of(
    plant: Plant, effects: Sequence[CatalogueEffect], period: float, actions: int
) -> tuple[tuple[int, Plant], ...]:
    """Return the plant from each action of the control on at which its condition changes, the first from action 0.

    Of the effects those that live in the plant count. An onset between two actions, `period` seconds apart, waits for the later
    one; the drive has `actions` of them.
    """
    acting = [effect for effect in effects if effect.id in FIELDS]
    time = np.arange(0.0, actions) * period
    levels = np.array([np.round(LEVELS * effect.share(time)) for effect in acting]).reshape(len(acting), actions)
    changes = np.flatnonzero(np.abs(np.diff(levels, axis=1)).sum(axis=0)) + 1
    return tuple(
        (now, plant._replace(condition=_condition(acting, (levels[:, now] / LEVELS).tolist())))
        for now in [0, *changes.tolist()]
    )


def _condition(effects: Sequence[CatalogueEffect], shares: Sequence[float]) -> Condition:
    """Return the condition with shares of effects: factors of the same kind multiply, areas add, of curves the last stands."""
    values = SOUND._asdict()
    for effect, share in zip(effects, shares, strict=True):
        name, neutral = FIELDS[effect.id], effect.kind.neutral
        value = effect.value if share == 1.0 else neutral + share * (effect.value - neutral)
        if effect.kind.bump:
            values[name] = Rise(value, *(effect.bump or effect.kind.bump)) if value else values[name]
        else:
            values[name] = values[name] + value if effect.kind.parameter == "area" else values[name] * value
    return Condition(**values)

"""Effects inside the engine: its condition from each moment on at which one of them starts or ends."""

from collections.abc import Sequence
from math import ceil

from lpvobs.simulation.effects import CatalogueEffect
from lpvobs.simulation.plant import SOUND, Condition, Plant

FIELDS = {
    "leak.intake": "leak_intake",
    "egr.leak": "egr_leak",
    "egr.area": "egr_area",
    "eta_vol.factor": "eta_vol",
    "compressor.flow": "compressor_flow",
    "turbine.efficiency": "turbine_efficiency",
    "exhaust.restriction": "exhaust_restriction",
}
"""Where in the plant's condition each effect enters."""


def stages_of(
    plant: Plant, effects: Sequence[CatalogueEffect], period: float, actions: int
) -> tuple[tuple[int, Plant], ...]:
    """Return the plant from each action of the control on at which its condition changes, the first from action 0.

    Of the effects those that live in the plant count. An onset between two actions, `period` seconds apart, waits for the later
    one; the drive has `actions` of them.
    """
    spans = [
        (effect, _action(effect.onset or 0.0, period), actions if effect.end is None else _action(effect.end, period))
        for effect in effects
        if effect.id in FIELDS
    ]
    changes = {0} | {moment for _, first, after in spans for moment in (first, after) if moment < actions}
    return tuple(
        (now, plant._replace(condition=_condition([effect for effect, first, after in spans if first <= now < after])))
        for now in sorted(changes)
    )


def _action(moment: float, period: float) -> int:
    return ceil(moment / period - 1e-6)


def _condition(effects: Sequence[CatalogueEffect]) -> Condition:
    """Return the condition with effects at work: factors of the same kind multiply, areas add."""
    values = SOUND._asdict()
    for effect in effects:
        name = FIELDS[effect.id]
        values[name] = values[name] + effect.value if effect.kind.parameter == "area" else values[name] * effect.value
    return Condition(**values)

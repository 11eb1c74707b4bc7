"""What can simulate an engine, by the name that the engine's record gives."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from lpvobs.simulation.parameters import SimulationParameters

if TYPE_CHECKING:
    from lpvobs.simulation.simulate import SimulatedLog


@dataclass(frozen=True)
class Simulator:
    """A plant that drives cycles.

    Attributes
    ----------
    parameters : class
        Record of the configuration's `[simulation]`.
    run : callable
        Takes what `lpvobs.simulation.simulate.simulate` takes, from the configuration's `[engine]` on.
    """

    parameters: type
    run: Callable[..., "SimulatedLog"]


def _nine_states(*arguments: Any, **options: Any) -> "SimulatedLog":
    """Load the plant only when it runs: configurations are read without it."""
    from lpvobs.simulation.simulate import simulate

    return simulate(*arguments, **options)


PLANTS: Mapping[str, Simulator] = {"nine states": Simulator(SimulationParameters, _nine_states)}

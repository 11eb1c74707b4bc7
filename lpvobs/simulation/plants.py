"""What can simulate an engine, by the name that the engine's record gives."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from lpvobs.simulation.parameters import SimulationParameters

if TYPE_CHECKING:
    from lpvobs.simulation.simulate import SimulatedLog
    from lpvobs.simulation.stationary import BenchTable


@dataclass(frozen=True)
class Simulator:
    """A plant that drives cycles and stands on a test bench."""

    parameters: type  # record of the configuration's `[simulation]`
    # takes what `lpvobs.simulation.simulate.simulate` takes, from the configuration's `[engine]` on
    run: Callable[..., "SimulatedLog"]
    bench: Callable[..., "BenchTable"]  # takes what `lpvobs.simulation.stationary.bench` takes


def _nine_states(*arguments: Any, **options: Any) -> "SimulatedLog":
    """Load the plant only when it runs: configurations are read without it."""
    from lpvobs.simulation.simulate import simulate

    return simulate(*arguments, **options)


def _nine_states_at_rest(*arguments: Any, **options: Any) -> "BenchTable":
    """Load the plant only when it runs."""
    from lpvobs.simulation.stationary import bench

    return bench(*arguments, **options)


PLANTS: Mapping[str, Simulator] = {"nine states": Simulator(SimulationParameters, _nine_states, _nine_states_at_rest)}

"""What can simulate an engine, by the name that the engine's record gives."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import import_module
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


def _later(module: str, name: str, *given: Any, **options: Any) -> Any:
    """Load a plant only when it runs: configurations are read without it."""
    return getattr(import_module(f"lpvobs.simulation.{module}"), name)(*given, **options)


RUN, BENCH = partial(_later, "simulate", "simulate"), partial(_later, "stationary", "bench")
PLANTS: Mapping[str, Simulator] = {"nine states": Simulator(SimulationParameters, RUN, BENCH)}

"""What can simulate an engine, by the name that the engine's record gives."""

from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from typing import Any, NamedTuple

from lpvobs.simulation.parameters import SimulationParameters


class Simulator(NamedTuple):
    """A plant that drives cycles and stands on a test bench."""

    parameters: type  # record of the configuration's `[simulation]`
    # take what `simulate` of `lpvobs.simulation.simulate` and `bench` of `lpvobs.simulation.stationary` take
    run: Callable[..., Any]
    bench: Callable[..., Any]


def _later(module: str, name: str, *given: Any, **options: Any) -> Any:
    """Load a plant only when it runs: configurations are read without it."""
    return getattr(import_module(f"lpvobs.simulation.{module}"), name)(*given, **options)


RUN, BENCH = partial(_later, "simulate", "simulate"), partial(_later, "stationary", "bench")
PLANTS: Mapping[str, Simulator] = {"nine states": Simulator(SimulationParameters, RUN, BENCH)}

"""What can simulate an engine, by the name that the engine's record gives, and engines with constants drawn within a tolerance."""

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from math import sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from lpvobs.engines.diesel.constants import DieselEngine, own_constants
from lpvobs.engines.flat import scaled
from lpvobs.errors import UsageError
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


GIVEN = frozenset({"R_a", "R_e", "c_pa", "c_pe", "gamma_a", "gamma_e", "n_cyl", "Q_11", "Q_12", "Q_22"})
"""What is not drawn unless it is named: properties of gases and a count; the three of the efficiency cannot be."""


def drawn(
    engine: DieselEngine, tolerance: float | Mapping[str, float], seed: int, normal: bool = False
) -> tuple[DieselEngine, dict[str, float]]:
    """Return an engine with constants drawn, and the relative deviation of each by name.

    The tolerance is relative: of every constant but properties of gases, or of those named. Deviations are uniform within it,
    or `normal` with the same standard deviation, tolerance / sqrt(3). Every constant has a stream of its own: a draw of few
    constants gives each the deviation that a draw of all does. Raises UsageError for a name that the engine does not have, or
    that cannot be drawn.

    A plant for a benchmark: `simulate(drawn(config.engine, config.estimate.tolerance, 7)[0], config.simulation, "etc_part1")`.
    """
    names = own_constants(engine)
    within = tolerance if isinstance(tolerance, Mapping) else {name: tolerance for name in names if name not in GIVEN}
    for name in within:
        if name not in names or name.startswith("Q_") or name == "n_cyl":
            raise UsageError(f"'{name}' cannot be drawn; expected some of {', '.join(sorted(set(names) - GIVEN))}")
    deviation = {name: size * _draw(name, seed, normal) for name, size in within.items()}
    return scaled(engine, deviation), deviation


def _draw(name: str, seed: int, normal: bool) -> float:
    stream = np.random.Generator(np.random.PCG64([seed, zlib.crc32(f"constant {name}".encode())]))
    return float(stream.standard_normal() / sqrt(3.0) if normal else stream.uniform(-1.0, 1.0))

"""What an effect follows that is no single number: a curve over a channel of the log, or over two inputs of a component."""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np

from lpvobs.engines.curves import on_surface, values_at
from lpvobs.records import Array, Item


@dataclass(frozen=True)
class Curve:
    """A dependence on a channel, straight between knots.

    It is of the channel's `value` or `rate`; `carrier` is the effect whose size follows it. The deviation is zero on the
    average of the logs; for a switch and a frozen map it is zero where the switch is off.
    """

    channel: str
    of: str
    carrier: str
    knots: Annotated[Array, Item("1", "value of the channel in the log's unit, or its rate per second", name="knot")]
    values: Annotated[Array, Item("1", "change of the carrier effect's size at amplitude one", ("knot",), "deviation")]


@dataclass(frozen=True)
class FactorSurface:
    """A factor on a component over two of its inputs, between nodes."""

    inputs: tuple[str, str]
    units: tuple[str, str]
    first: Annotated[Array, Item("SI", "first input, in the first unit of `units`", name="first")]
    second: Annotated[Array, Item("SI", "second input, in the second unit of `units`", name="second")]
    values: Annotated[
        Array, Item("1", "factor of the component minus one, at amplitude one", ("first", "second"), "deviation")
    ]
    errors: Annotated[Array, Item("1", "standard error of the factor", ("first", "second"), "standard_error")]
    largest: tuple[float, float]  # where on the logs it is largest, and one at amplitude one
    amplitude: float  # the factor less one there, when it was found
    cost: float  # what its coefficients must gain

    @cached_property
    def error(self) -> float:
        """Standard error of the factor where it is largest."""
        there = (np.array([x]) for x in self.largest)
        return float(values_at(on_surface(self.first, self.second, *there), self.errors)[0])


Shape = Curve | FactorSurface

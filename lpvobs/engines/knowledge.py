"""What an engine has learned from healthy logs, in a form that files can hold without knowing the engine."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lpvobs.records import Array


@dataclass(frozen=True)
class Nodes:
    """An input of a learned curve: its nodes, with unit and meaning."""

    values: Array
    unit: str
    meaning: str


def nodes(unit: str, meaning: str, *values: float) -> Nodes:
    """Return an input with these nodes."""
    return Nodes(np.array(values, dtype=float), unit, meaning)


@dataclass(frozen=True)
class LearnedCurve:
    """A curve or surface between nodes."""

    axes: Mapping[str, Nodes]  # by name, in the order of the axes of `values`
    name: str  # of the values, like unit and meaning
    unit: str
    meaning: str
    values: Array  # at the nodes
    relative_error: Array  # their standard errors over them


@dataclass(frozen=True)
class LearnedNumber:
    """A single number, with unit and meaning."""

    value: float
    unit: str
    meaning: str


@dataclass(frozen=True)
class Knowledge:
    """All that was learned."""

    curves: Mapping[str, LearnedCurve]  # by component
    numbers: Mapping[str, LearnedNumber]
    # (m, m) of the relative deviations of all nodes of the curves, row by row, then of some of the numbers
    covariance: Array
    sources: tuple[str, ...]  # names of the logs

    def digest(self) -> str:
        """Return the SHA-256 of all values and their covariance."""
        single = np.array([number.value for number in self.numbers.values()])
        arrays = (*(curve.values for curve in self.curves.values()), single, self.covariance)
        return hashlib.sha256(b"".join(values.tobytes() for values in arrays)).hexdigest()

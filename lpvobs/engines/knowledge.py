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


@dataclass(frozen=True)
class LearnedCurve:
    """A curve or surface between nodes.

    Attributes
    ----------
    axes : mapping of str to Nodes
        By name, in the order of the axes of `values`.
    name, unit, meaning : str
        Of the values.
    values, relative_error : ndarray
        At the nodes, and their standard errors over them.
    """

    axes: Mapping[str, Nodes]
    name: str
    unit: str
    meaning: str
    values: Array
    relative_error: Array


@dataclass(frozen=True)
class LearnedNumber:
    """A single number, with unit and meaning."""

    value: float
    unit: str
    meaning: str


@dataclass(frozen=True)
class Knowledge:
    """All that was learned.

    Attributes
    ----------
    curves : mapping of str to LearnedCurve
        By component.
    covariance : ndarray, shape (m, m)
        Of the relative deviations of all nodes of the curves, row by row, then of some of the numbers.
    sources : tuple of str
        Names of the logs.
    """

    curves: Mapping[str, LearnedCurve]
    numbers: Mapping[str, LearnedNumber]
    covariance: Array
    sources: tuple[str, ...]

    def digest(self) -> str:
        """Return the SHA-256 of all values and their covariance."""
        single = np.array([number.value for number in self.numbers.values()])
        arrays = (*(curve.values for curve in self.curves.values()), single, self.covariance)
        return hashlib.sha256(b"".join(values.tobytes() for values in arrays)).hexdigest()

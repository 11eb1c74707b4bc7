"""What is known of a throttled engine beforehand; the attributes bear the names of the `[engine.*]` tables."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from lpvobs.engines.constants import Within


@dataclass(frozen=True)
class Air:
    """The gas in the intake."""

    R_a: Annotated[float, Within(280, 300, "J/(kg K)", "gas constant of air")]  # [J/(kg K)]
    gamma_a: Annotated[float, Within(1.3, 1.42, "1", "ratio of heat capacities of air")]


@dataclass(frozen=True)
class IntakeGeometry:
    """Sizes of the intake; the volumes are first guesses, which a healthy log corrects."""

    # [m^3], displacement. Where it is not known, any value of the right size: only eta_vol V_d enters.
    V_d: Annotated[float, Within(1e-4, 0.2, "m^3", "displacement")]
    n_cyl: Annotated[int, Within(1, 24, "1", "number of cylinders")]
    V_ic: Annotated[float, Within(1e-4, 0.5, "m^3", "volume before a throttle")]  # behind the compressor
    V_im: Annotated[float, Within(1e-4, 0.5, "m^3", "volume of a manifold")]  # behind the throttle
    # standard deviation of the guess, as a fraction of it
    volume_tolerance: Annotated[float, Within(1e-3, 10, "1", "tolerance of a guessed volume")]


@dataclass(frozen=True)
class CurveNodes:
    """Where the curves of the engine have their nodes, and how smooth the curves are assumed to be."""

    # of the throttle's effective area
    alpha_th: Annotated[tuple[float, ...], Within(-5, 105, "%", "opening of a throttle")]
    n_e: Annotated[tuple[float, ...], Within(0, 2e4, "rpm", "engine speed")]  # of the volumetric efficiency
    p_im: Annotated[tuple[float, ...], Within(1e3, 6e5, "Pa", "pressure of a manifold")]  # of the same
    m_f: Annotated[tuple[float, ...], Within(-1.0, 1e4, "1", "fuel reading")]  # of the air per unit of the reading
    fuel_n_e: Annotated[tuple[float, ...], Within(0, 2e4, "rpm", "engine speed")]  # of the same
    # standard deviation of the relative second difference of throttle and filling from node to node
    curvature: Annotated[float, Within(1e-4, 100, "1", "curvature of a curve")]
    # The same of the fuel, about the straight line of an injector with a dead time. Mixtures that are not
    # stoichiometric depend on more than fuel and speed: a loose surface would take them for the engine.
    fuel_curvature: Annotated[float, Within(1e-4, 100, "1", "curvature of a curve")]

    def __post_init__(self) -> None:
        for name in ("alpha_th", "n_e", "p_im", "m_f", "fuel_n_e"):
            nodes = np.array(getattr(self, name))
            if nodes.size < 3 or not np.all(np.diff(nodes) > 0):
                raise ValueError(f"{name} needs at least three nodes in rising order")


@dataclass(frozen=True)
class ThrottledEngine:
    """The configuration's `[engine]` of a throttled engine."""

    air: Air
    geometry: IntakeGeometry
    curves: CurveNodes

"""What is known of a throttled engine beforehand, and what a healthy log tells of it, as files hold it and back."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from lpvobs.engines.constants import Within
from lpvobs.engines.curves import Knowledge, LearnedCurve, LearnedNumber, Nodes, nodes
from lpvobs.records import Array


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


@dataclass(frozen=True)
class Learned:
    """A throttled engine as a healthy log shows it."""

    area: Array  # (J,) [m^2], effective area of the throttle at the nodes of alpha_th
    eta_vol: Array  # (I, K) volumetric efficiency at the nodes of n_e and p_im
    fuel: Array  # (M, L) [kg], air in a cylinder per unit of the fuel reading, at the nodes of m_f and n_e
    V_ic: float  # [m^3]
    V_im: float  # [m^3]
    # (m, m) of the relative deviations of area, eta_vol, fuel, V_ic and V_im, in this order, curves row by row
    covariance: Array
    sources: tuple[str, ...]  # names of the logs
    calm_flow: float  # [kg/s], below which the air before the throttle is at ambient pressure

    def moved(self, deviation: Array) -> "Learned":
        """Return other curves, by the relative deviation of each of their nodes, shape (m - 2,); the volumes stay."""
        where, kept = self.deviations(), np.maximum(1.0 + deviation, 0.05)
        return replace(
            self,
            area=self.area * kept[where["throttle"]],
            eta_vol=self.eta_vol * kept[where["filling"]].reshape(self.eta_vol.shape),
            fuel=self.fuel * kept[where["fuel"]].reshape(self.fuel.shape),
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all nodes of the curves, in the order of the covariance."""
        where = self.deviations()
        sizes = {name: at.stop - at.start for name, at in where.items() if name != "volumes"}
        return tuple(f"{name} {i}" for name, size in sizes.items() for i in range(size))

    def deviations(self) -> Mapping[str, slice]:
        """Return where each curve stands in the covariance."""
        sizes = {"throttle": self.area.size, "filling": self.eta_vol.size, "fuel": self.fuel.size, "volumes": 2}
        ends = np.cumsum(list(sizes.values()))
        return {name: slice(int(end) - size, int(end)) for (name, size), end in zip(sizes.items(), ends, strict=True)}


def knowledge_of(engine: ThrottledEngine, learned: Learned) -> Knowledge:
    """Return what healthy logs have taught."""
    at, where = engine.curves, learned.deviations()
    spread = np.sqrt(np.diag(learned.covariance))
    speed, pressure = nodes("rpm", "engine speed", *at.n_e), nodes("Pa", "intake manifold pressure", *at.p_im)
    reading = nodes("1", "fuel reading per stroke", *at.m_f)
    axes: Mapping[str, Mapping[str, Nodes]] = {
        "throttle": {"alpha_th": nodes("%", "throttle opening", *at.alpha_th)},
        "filling": {"n_e": speed, "p_im": pressure},
        "fuel": {"m_f": reading, "n_e": nodes("rpm", speed.meaning, *at.fuel_n_e)},
    }
    values = {
        "throttle": ("area", "m^2", "effective area", learned.area),
        "filling": ("eta_vol", "1", "volumetric efficiency", learned.eta_vol),
        "fuel": ("air", "kg", "air in a cylinder per unit of the fuel reading", learned.fuel),
    }
    curves = {
        part: LearnedCurve(axes[part], name, unit, meaning, curve, spread[where[part]].reshape(curve.shape))
        for part, (name, unit, meaning, curve) in values.items()
    }
    numbers = {
        "V_ic": LearnedNumber(learned.V_ic, "m^3", "volume before the throttle"),
        "V_im": LearnedNumber(learned.V_im, "m^3", "volume behind the throttle"),
        "calm_flow": LearnedNumber(learned.calm_flow, "kg/s", "air flow below which p_ic is compared with p_amb"),
    }
    return Knowledge(curves, numbers, learned.covariance, learned.sources)


def learned_of(known: Knowledge) -> Learned:
    """Return the engine that a file holds; raises KeyError for another engine's."""
    curves, numbers = known.curves, known.numbers
    return Learned(
        area=curves["throttle"].values,
        eta_vol=curves["filling"].values,
        fuel=curves["fuel"].values,
        V_ic=numbers["V_ic"].value,
        V_im=numbers["V_im"].value,
        covariance=known.covariance,
        sources=known.sources,
        calm_flow=numbers["calm_flow"].value,
    )


def in_c(engine: ThrottledEngine, learned: Learned) -> dict[str, float | Array]:
    """Return the numbers that `model.c` reads: what is configured, nodes of the curves, and the curves."""
    configured = {**vars(engine.air), **vars(engine.geometry)}
    nodes = {name: np.array(getattr(engine.curves, name)) for name in ("alpha_th", "n_e", "p_im")}
    own = {"area": learned.area, "eta_vol": learned.eta_vol.reshape(-1), "V_ic": learned.V_ic, "V_im": learned.V_im}
    return configured | nodes | own

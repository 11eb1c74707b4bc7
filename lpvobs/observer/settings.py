"""How a map is estimated: the configuration's `[estimate]`, `[published]` tables."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

CONSTANTS = ("joint", "consider")  # what becomes of the engine's constants


@dataclass(frozen=True)
class EstimateSettings:
    """Settings of the default method."""

    smoothing: float  # [s], half width of the window that takes the noise out of the scheduling parameters
    least_information: float  # [s], how long the drive must inform a node for its value to count as estimated
    prior_map: float  # [kg/s], standard deviation of a node before any data; far beyond any sensor
    # how well the engine's constants are known: the true value lies within this fraction of the configured one
    tolerance: Mapping[str, float] = field(default_factory=dict)
    # `joint`: engine and map are estimated together; `consider`: the engine stays as configured, and the tolerance
    # widens the intervals
    constants: str = "joint"
    # Share of the air flow that a map may have on average; a larger one is refused. The paper's quadratic is 28 to 55 %
    # of the flow along simulated drives; g/s taken for kg/h are 72 %, an unplugged sensor is off by all of it.
    largest_error: float = 0.6
    widest: float = 1e3  # [kg/s], standard error up to which a node counts as estimated; usually there is no such limit

    def __post_init__(self) -> None:
        for name in ("smoothing", "least_information", "prior_map", "largest_error", "widest"):
            if not 0 < getattr(self, name) < 1e6:
                raise ValueError(f"{name} must be above 0 and below 1e6")
        if self.constants not in CONSTANTS:
            raise ValueError(f"constants = {self.constants!r}, expected one of {', '.join(CONSTANTS)}")
        if not all(0.0 <= value < 0.5 for value in self.tolerance.values()):
            raise ValueError("every tolerance must be a fraction of at least 0 and below 0.5")

    def of_engine(self, usual: Mapping[str, float]) -> "EstimateSettings":
        """Return the settings with a tolerance for the constants of an engine's balances: the usual one unless stated."""
        return replace(self, tolerance={name: self.tolerance.get(name, least) for name, least in usual.items()})


@dataclass(frozen=True)
class PublishedSettings:
    """Settings of the observer as the paper used it (Sec. 4).

    The proof of the paper takes a_1 and a_2 for constants. With the temperatures of a real drive in them, the published L is
    unstable most of the time (it needs a_1/a_2 between 0.064 and 0.139), so they are constants here, too.
    """

    gamma: float  # [1/s], Gamma = gamma I
    # initial state, one value each; the paper prints 9.8e5 Pa twice, which is 9.8 bar where ambient is 9.8e4 Pa
    x_0: tuple[float, ...]
    temperatures: Mapping[str, float]  # [K], behind a_1 and a_2

    def __post_init__(self) -> None:
        if not self.gamma > 0:
            raise ValueError("gamma must be positive")

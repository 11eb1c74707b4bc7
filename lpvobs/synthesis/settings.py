"""What gain is wanted: the configuration's `[gain]` table."""

import math
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class GainSettings:
    """The region that the certificate is to cover, and the form of the gain."""

    outputs: tuple[str, ...]  # measured states that the observer corrects itself by; the sensor comes after them
    # scheduling parameters where no log tells their range; with logs, the range of the logs counts
    bounds: Mapping[str, tuple[float, float]]
    # [K]; ranges of the temperatures behind a_1 and a_2; logs do not widen or narrow them
    temperatures: Mapping[str, tuple[float, float]]
    margin: float = 0.05  # share of the range of the logs by which it is widened at either end
    # [1/s], least decay of the state error. A fast state stays with its measurements, which are good; a slow one leans
    # on the engine model, and its wrong constants then reach both balances at once.
    decay: float = 0.0
    # pairs of parameters whose sum never is negative, which cuts the box
    nonnegative_sums: tuple[tuple[str, str], ...] = ()
    cascade: bool = True  # the sensor does not correct the state: the last column of L is zero
    falling_gain: bool = True  # prove 1 - eps_1 - eps_2 > 0, which map gains that fall with the information need

    def __post_init__(self) -> None:
        if not 0.0 <= self.margin <= 1.0:
            raise ValueError("margin is a share between 0 and 1")
        if not 0.0 <= self.decay < 1e6:
            raise ValueError("decay is at least 0 and under 1e6 1/s")
        for name, (low, high) in {**self.bounds, **self.temperatures}.items():
            if not -math.inf < low <= high < math.inf:
                raise ValueError(f"the bounds of {name} are not finite and in order")
        for name, (low, _) in self.temperatures.items():
            if not low > 0:
                raise ValueError(f"{name} must be above zero, in K")

"""How well a model follows a log, and what its residual still holds, as MATLAB's `compare` and `resid` say it.

Plain numbers, for JSON, gates and figures alike. A residual is white at 99 % if about one lag in a hundred leaves the band.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from lpvobs.kinds import Count, Finite, Fraction, KgPerS, Output, Seconds
from lpvobs.records import Array

LAGS = 25
"""Largest lag on either side, as many as `resid` shows."""
STEP = 0.5
"""[s] A lag at least: longer than the windows that signals are smoothed with (0.2 s), so that neighbours share no noise."""
NORMAL_99 = 2.576
"""Standard deviations of a normal variable to either side of a 99 % band."""
LEAST = 4 * LAGS
"""Values that correlations take at least; the toolbox asks for no number, but a lag needs pairs."""


class ResidualFit(Output):
    """One balance along one log: how well its flow and the map predict the reading, and what is left."""

    result: str
    log: str
    balance: str
    samples: Annotated[
        Count, Meta(description="Number of means over one lag that were compared, where the map is estimated.")
    ]
    step: Annotated[Seconds, Meta(description="Length of a lag in s.")]
    fit: Annotated[Fraction, Meta(description="1 - |y - prediction| / |y - mean y|, with the reading y.")]
    rms: Annotated[KgPerS, Meta(description="Rms of the residual.")]
    autocorrelation: Annotated[Sequence[Finite], Meta(description="Autocorrelation of the residual at lags 0 to 25.")]
    band: Annotated[Finite, Meta(description="Half width of the 99 % band of white noise.")]
    cross: Annotated[
        Mapping[str, Sequence[Finite]],
        Meta(description="Correlation with each input, for a residual that is -25 to 25 lags later."),
    ]
    cross_band: Annotated[Mapping[str, Finite], Meta(description="Half width of the 99 % band for each input.")]

    @property
    def lags_outside(self) -> float:
        """Share of the lags from 1 at which the autocorrelation leaves its band."""
        return float(np.mean(np.abs(self.autocorrelation[1:]) > self.band))

    @property
    def input_lags_outside(self) -> float:
        """The largest share of the lags at which the correlation with an input leaves its band."""
        return max(self.outside.values(), default=0.0)

    @property
    def outside(self) -> dict[str, float]:
        """Share of the lags at which the correlation with each input leaves its band, the largest first."""
        shares = {name: float(np.mean(np.abs(r) > self.cross_band[name])) for name, r in self.cross.items()}
        return dict(sorted(shares.items(), key=lambda item: -item[1]))


def fit_along(
    names: tuple[str, str, str], time: Array, reading: Array, predicted: Array, inputs: Mapping[str, Array]
) -> ResidualFit | None:
    """Return how well N predictions follow the readings, shapes (N,) [kg/s], NaN where there is none; None for too few.

    `names` are result, log and balance; `time` [s] is in steps of one length, with gaps. The band of a cross-correlation is that
    of two independent signals with the correlations that residual and input have themselves: N var = sum R_e(k) R_u(k) (Ljung,
    System Identification, 2nd edition, chapter 16).
    """
    spacing = float(np.median(np.diff(time)))
    many = max(1, int(np.ceil(STEP / spacing)))
    place = np.round((time - time[0]) / spacing).astype(int) // many
    known = np.isfinite(predicted)
    count = np.bincount(place[known], minlength=place[-1] + 1) if known.any() else np.zeros(1)
    on = count > 0.5 * many

    def means(values: Array) -> Array:
        return np.asarray(np.bincount(place[known], values[known], minlength=count.size)[on] / count[on])

    if (n := int(on.sum())) < LEAST:
        return None
    y, e = means(reading), means(reading - predicted)
    left = _spectrum(e, on)
    own = _products(left, left)
    crossed: dict[str, list[float]] = {}
    bands: dict[str, float] = {}
    for name, values in inputs.items():
        if np.ptp(u := means(values)) > 0.0:
            other = _spectrum(u, on)
            crossed[name] = np.roll(_products(other, left), LAGS)[: 2 * LAGS + 1].tolist()
            bands[name] = NORMAL_99 * float(np.sqrt(max(float(own @ _products(other, other)), 1.0) / n))
    return ResidualFit(
        result=names[0],
        log=names[1],
        balance=names[2],
        samples=n,
        step=many * spacing,
        fit=1.0 - float(np.linalg.norm(e) / np.linalg.norm(y - y.mean())),
        rms=float(np.sqrt(np.mean(e**2))),
        autocorrelation=own[: LAGS + 1].tolist(),
        band=NORMAL_99 / float(np.sqrt(n)),
        cross=crossed,
        cross_band=bands,
    )


def _spectrum(values: Array, on: NDArray[np.bool_]) -> NDArray[np.complex128]:
    """Return the transform of values of variance one, zero in gaps, long enough that no lag wraps around."""
    whole = np.zeros(on.size)
    whole[on] = (values - values.mean()) / (np.linalg.norm(values - values.mean()) or 1.0)
    return np.asarray(np.fft.rfft(whole, 2 * on.size + 2 * LAGS))


def _products(first: NDArray[np.complex128], second: NDArray[np.complex128]) -> Array:
    """Return sums of products, the second signal later by 0, 1, ... lags, and by negative ones from the end on."""
    return np.asarray(np.fft.irfft(np.conj(first) * second))

"""Numbers for people: as many digits as their interval has something to say on."""

import math

LEAST_CHANCE = 1e-16


def with_interval(value: float, low: float, high: float) -> tuple[str, str, str]:
    """Return a value and the ends of its interval, with two digits of the interval's half width.

    Examples
    --------
    >>> with_interval(0.080347, 0.079661, 0.081034)
    ('0.08035', '0.07966', '0.08103')
    >>> with_interval(1.998e-05, 1.994e-05, 2.002e-05)
    ('1.9980e-05', '1.9940e-05', '2.0020e-05')
    >>> with_interval(1456.2, 1451.0, 1461.4)
    ('1456.2', '1451.0', '1461.4')
    """
    half = 0.5 * (high - low)
    if not (math.isfinite(half) and half > 0.0):
        return f"{value:.4g}", f"{low:.4g}", f"{high:.4g}"
    last = math.floor(math.log10(half)) - 1
    largest = max(abs(value), abs(low), abs(high))
    if largest < 1e-3 or largest >= 1e6:
        digits = max(math.floor(math.log10(largest)) - last, 0)
        return f"{value:.{digits}e}", f"{low:.{digits}e}", f"{high:.{digits}e}"
    digits = max(-last, 0)
    return f"{value:.{digits}f}", f"{low:.{digits}f}", f"{high:.{digits}f}"


def chance(p: float | None) -> str:
    """Return a p-value; a dash where there is none.

    Examples
    --------
    >>> chance(0.0), chance(0.00012), chance(None)
    ('< 1e-16', '0.0001', '-')
    """
    if p is None:
        return "-"
    return f"< {LEAST_CHANCE:.0e}" if p < LEAST_CHANCE else f"{p:.1g}"


def second(time: float | None) -> str:
    """Return a time with a tenth of a second, a dash where there is none."""
    return "-" if time is None else f"{time:.1f}"

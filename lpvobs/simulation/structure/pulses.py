"""Pulses of the flow at the air flow sensor: how strong, how wrong a hot film reads them, and what of them is recorded."""

import numpy as np

from lpvobs.records import Array


def pulses(amplitude: float, n_e: Array, u_delta: Array) -> Array:
    """Return the amplitude of the flow's pulses at the air flow sensor over the mean flow [-], shape (M,).

    The inlet resonates near 1300 rpm, and load drives it (Heywood 1988, Sec. 7.6.2; Guzzella and Onder 2010, Ch. 2).
    """
    resonance = 0.06 + 0.34 * np.exp(-(((n_e - 1300.0) / 350.0) ** 2))
    return np.asarray(amplitude * resonance * np.clip(0.3 + u_delta / 40.0, 0.3, 1.2))


def rectified(amplitude: float, n_e: Array, u_delta: Array) -> Array:
    """Return the mean error of a pulsating flow over the flow [-], shape (M,): King's root makes it read -m^2/8 for pulses of m."""
    return np.asarray(-(pulses(amplitude, n_e, u_delta) ** 2) / 8.0)


def ripple(amplitude: float, n_e: Array, u_delta: Array, n_cyl: int, step: float) -> Array:
    """Return the pulses themselves over the mean flow [-], shape (M,) every `step` seconds, in the phase of the crankshaft."""
    strokes = np.cumsum(n_e) * step * n_cyl / 120.0
    return np.asarray(pulses(amplitude, n_e, u_delta) * np.sin(2.0 * np.pi * strokes))

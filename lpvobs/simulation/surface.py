"""The sensor's error at the true operating point."""

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from lpvobs.records import Array
from lpvobs.simulation.parameters import ErrorSurface


def surface_error(surface: ErrorSurface, u_delta: Array, n_e: Array, W_c: Array) -> Array:
    """Return reading minus truth without noise, shape (N,) [kg/s].

    Parameters
    ----------
    u_delta, n_e, W_c : ndarray, shape (N,)
        True fuel [mg/cycle], speed [rpm] and flow [kg/s].
    """
    if surface.kind == "quadratic":
        return _quadratic(surface, u_delta, n_e)
    if surface.kind == "king":
        aged = surface.offset + surface.slope * np.maximum(W_c, 0.0) ** surface.exponent
        return np.asarray(aged ** (1.0 / surface.exponent) - W_c)
    if surface.kind == "table":
        return _table(surface, u_delta, n_e)
    return np.zeros_like(W_c)


def _quadratic(surface: ErrorSurface, u: Array, n: Array) -> Array:
    a2, a1, b2, b1, c2, c1 = surface.coefficients
    error = (a2 * u + a1) * u + (b2 * n + b1) * n + c2 * u * n + c1
    for bump in surface.bumps:
        distance = ((u - bump.u_delta) / bump.width_u_delta) ** 2 + ((n - bump.n_e) / bump.width_n_e) ** 2
        error = error + bump.amplitude * np.exp(-0.5 * distance)
    return np.asarray(error)


def _table(surface: ErrorSurface, u: Array, n: Array) -> Array:
    axes = (np.asarray(surface.n_e, dtype=float), np.asarray(surface.u_delta, dtype=float))
    table = RegularGridInterpolator(axes, np.asarray(surface.values, dtype=float))
    held = [np.clip(values, axis[0], axis[-1]) for values, axis in zip((n, u), axes, strict=True)]
    return np.asarray(table(np.column_stack(held)))

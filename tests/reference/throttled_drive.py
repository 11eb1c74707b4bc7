"""A small throttled engine on a random drive, written from the textbook and apart from the package: truth for its tests."""

import math

import numpy as np
from numpy.typing import NDArray

from lpvobs.records import Defects, Log

Array = NDArray[np.float64]
R, K = 287.0, 1.4
V_D, V_IC, V_IM = 2.0e-3, 5.0e-3, 2.0e-3
P_AMB, T_AMB, T_IC = 1.005e5, 297.0, 299.0
AIR_PER_FUEL = 0.065
STEP, EVERY = 0.005, 10  # s of integration, steps per sample


def area(alpha: float) -> float:
    """Return the effective area of the throttle [m^2]: a leak and a plate that turns."""
    return 9e-6 + 1.5e-3 * (1.0 - math.cos(math.radians(0.9 * alpha)))


def orifice(p_high: float, p_low: float, T: float) -> float:
    """Return the flow per area [kg/(s m^2)]."""
    pi = min(max(p_low / p_high, 0.5283), 0.9995)
    return p_high / math.sqrt(R * T) * math.sqrt(2 * K / (K - 1) * (pi ** (2 / K) - pi ** ((K + 1) / K)))


def eta_vol(n: float, p: float) -> float:
    """Return the volumetric efficiency: residual gas at low pressure, tuning over speed."""
    return 0.9 - 0.06 * (3e4 / max(p, 1e4)) + 0.05 * math.sin(n / 900.0)


def drive(seconds: float = 600.0, seed: int = 0, leak: float = 0.0, onset: float = 0.0) -> dict[str, Array]:
    """Return channels at 20 Hz and the true `W_c`; from its onset on the manifold has a leak [m^2]."""
    rng = np.random.default_rng(seed)
    N = int(seconds / STEP)
    alpha = _held(rng, N, lambda: float(np.exp(rng.uniform(np.log(3.0), np.log(40.0)))), 0.5)
    n = _held(rng, N, lambda: float(rng.uniform(850.0, 3000.0)), 2.0)
    p_im, p_ic, rows = 4e4, P_AMB, []
    for k in range(N):
        W_th = area(alpha[k]) * orifice(max(p_ic, p_im), min(p_ic, p_im), T_IC) * (1.0 if p_ic >= p_im else -1.0)
        W_cyl = eta_vol(n[k], p_im) * p_im * n[k] * V_D / (120 * R * T_IC)
        W_leak = 0.0
        if leak and k * STEP >= onset:
            W_leak = leak * (orifice(P_AMB, p_im, T_AMB) if p_im < P_AMB else -orifice(p_im, P_AMB, T_IC))
        dp_ic = (P_AMB + 6e5 * max(W_th - 0.012, 0.0) - p_ic) / 0.5
        if k % EVERY == 0:
            W_c = W_th + V_IC / (R * T_IC) * dp_ic
            rows.append((k * STEP, n[k], alpha[k], p_ic, p_im, W_c, W_cyl))
        p_im += STEP * R * T_IC / V_IM * (W_th + W_leak - W_cyl)
        p_ic += STEP * dp_ic
    time, n_e, alpha_th, ic, im, W_c, W_cyl = (np.array(column) for column in zip(*rows, strict=True))
    strokes = n_e * 4 / 120
    held = {"T_ic": T_IC, "p_amb": P_AMB, "T_amb": T_AMB}
    return {
        "time": time, "n_e": n_e, "alpha_th": alpha_th, "p_ic": ic, "p_im": im, "W_c": W_c, "W_maf": W_c.copy(),
        "m_f": W_cyl / (strokes * AIR_PER_FUEL), **{name: np.full(time.size, value) for name, value in held.items()},
    }  # fmt: skip


def noisy(channels: dict[str, Array], seed: int) -> dict[str, Array]:
    """Return the channels as sensors read them: relative noise, steps of 98 Pa, fuel off by 3 % for a while."""
    rng = np.random.default_rng(seed)
    out = dict(channels)
    size = out["time"].size
    for name, share in (("W_maf", 0.01), ("p_ic", 0.001), ("p_im", 0.004), ("m_f", 0.01), ("n_e", 0.001)):
        out[name] = out[name] * (1.0 + share * rng.standard_normal(size))
    out["p_im"] = 98.0 * np.round(out["p_im"] / 98.0)
    slow = np.repeat(rng.standard_normal(size // 200 + 1), 200)[:size]
    out["m_f"] = out["m_f"] * (1.0 + 0.03 * slow)
    return out


def log_of(channels: dict[str, Array], name: str = "drive") -> Log:
    """Return a log of the channels, without the truth."""
    time = channels["time"]
    kept = {key: value for key, value in channels.items() if key not in ("time", "W_c")}
    return Log(name, name, time, kept, {}, ((0, time.size),), np.arange(time.size), Defects(time.size))


def _held(rng: np.random.Generator, N: int, draw: object, smooth: float) -> Array:
    """Return levels held for 4 to 15 s, rounded off over `smooth` seconds."""
    values: list[float] = []
    while len(values) < N:
        values += [draw()] * int(rng.uniform(4.0, 15.0) / STEP)  # type: ignore[operator]
    raw, out, share = np.array(values[:N]), np.empty(N), STEP / smooth
    level = raw[0]
    for k in range(N):
        level += share * (raw[k] - level)
        out[k] = level
    return out

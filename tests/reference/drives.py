"""Small synthetic logs: scattered operating conditions, and drives integrated through Eq. (1)."""

from dataclasses import replace

import numpy as np
from reference import diesel_textbook as textbook

from lpvobs.records import Defects, Log

RANGES = {
    "n_e": (700.0, 4000.0), "u_delta": (0.0, 56.0), "u_egr": (-10.0, 110.0), "u_vgt": (5.0, 100.0),
    "p_im": (0.75e5, 2.6e5), "p_em": (0.8e5, 3.5e5), "omega_t": (1500.0, 17000.0), "T_im": (290.0, 400.0),
    "T_em": (300.0, 1200.0), "p_amb": (0.85e5, 1.03e5), "T_amb": (260.0, 310.0), "W_maf": (0.005, 0.14),
}  # fmt: skip


def log_of(time, channels, segments=None, name="drive"):
    """Return a log record around channels that nobody read from a file."""
    N = len(time)
    return Log(name, "", time, channels, {}, segments or ((0, N),), np.arange(N), Defects(N))


def scattered(seed, N=500):
    """Return a log whose samples have nothing to do with each other: every corner of every relation."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.005, 0.02, N))
    return log_of(time, {name: rng.uniform(*ends, N) for name, ends in RANGES.items()})


def waves(rng, time, legs, low, high, fastest=4.0):
    """Return smooth signals between two values, one row per leg: a few sines through a squashing function."""
    total = np.zeros((legs, time.size))
    for _ in range(4):
        rate, phase = rng.uniform(0.3, fastest, (legs, 1)), rng.uniform(0, 2 * np.pi, (legs, 1))
        total += np.sin(rate * time + phase)
    centre = rng.uniform(-2.0, 2.0, (legs, 1))
    return low + (high - low) * 0.5 * (1 + np.tanh(0.5 * total + centre))


def integrated(engine, seed, *, legs=150, seconds=3.0, rate=100, surface=None, substeps=10):
    """Return a log of many short legs, each integrated by RK4 along its own smooth inputs, and its true flow W_c.

    The legs are the segments of one log, minutes apart. Temperatures stand still within a leg, so that Eq. (1) holds with and
    without a term in dT_im/dt. The first second of each leg is left out: the turbo needs it to find its speed.
    """
    rng = np.random.default_rng(seed)
    h = 1.0 / rate / substeps
    steps = round((seconds + 1.0) / h)
    fine = np.arange(2 * steps + 1) * h / 2.0  # inputs at half steps, as RK4 asks
    inputs = {
        "n_e": waves(rng, fine, legs, 900.0, 3800.0),
        "u_delta": waves(rng, fine, legs, 2.0, 54.0),
        "u_egr": waves(rng, fine, legs, 0.0, 60.0),
        "u_vgt": waves(rng, fine, legs, 35.0, 85.0),
        "T_im": np.broadcast_to(rng.uniform(300.0, 340.0, (legs, 1)), (legs, fine.size)),
        "T_em": np.broadcast_to(rng.uniform(500.0, 1000.0, (legs, 1)), (legs, fine.size)),
        "p_amb": np.full((legs, fine.size), 98000.0),
        "T_amb": np.full((legs, fine.size), 298.0),
    }

    def slope(x, at):
        return textbook.derivatives(engine, {name: column[:, at] for name, column in inputs.items()} | _named(x))

    x = np.stack([np.full(legs, 1.3e5), np.full(legs, 1.5e5), np.full(legs, 7000.0)])
    kept, at = [], []
    for k in range(steps):
        if k % substeps == 0 and k * h >= 1.0:
            kept.append(x)
            at.append(2 * k)
        k_1 = slope(x, 2 * k)
        k_2 = slope(x + h / 2 * k_1, 2 * k + 1)
        k_3 = slope(x + h / 2 * k_2, 2 * k + 1)
        k_4 = slope(x + h * k_3, 2 * k + 2)
        x = x + h / 6 * (k_1 + 2 * k_2 + 2 * k_3 + k_4)
    states = _named(np.stack(kept, axis=2))
    channels = {name: np.ascontiguousarray(column).reshape(-1) for name, column in states.items()}
    channels |= {name: column[:, at].reshape(-1) for name, column in inputs.items()}
    N = len(kept)
    time = (np.arange(legs)[:, None] * 60.0 + np.arange(N) / rate).reshape(-1)
    W_c = textbook.flows(engine, channels)["W_c"]
    error = surface(channels["u_delta"], channels["n_e"]) if surface else 0.0
    segments = tuple((leg * N, (leg + 1) * N) for leg in range(legs))
    return log_of(time, channels | {"W_maf": W_c + error}, segments), W_c


def _named(x):
    return dict(zip(("p_im", "p_em", "omega_t"), x, strict=True))


NOISE = {"p_im": 150.0, "p_em": 300.0, "omega_t": 20.0, "T_im": 0.3, "T_em": 2.0, "n_e": 3.0, "u_delta": 0.1}
"""Standard deviations of white measurement noise; the sensor under test has 1 % and 0.1 g/s beside it."""


def noisy(log, seed):
    """Return the log as noisy sensors would have recorded it."""
    rng = np.random.default_rng(seed)
    channels = dict(log.channels)
    for name, sigma in NOISE.items():
        channels[name] = channels[name] + sigma * rng.standard_normal(len(log))
    flow = channels["W_maf"]
    channels["W_maf"] = flow + (1e-4 + 0.01 * np.abs(flow)) * rng.standard_normal(len(log))
    return replace(log, channels=channels)

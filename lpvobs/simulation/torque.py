"""Torque of the engine at steady state, over speed and fuel, and back; driver and test bench think in it."""

from math import pi
from typing import NamedTuple

import numpy as np

from lpvobs.compiled import njit
from lpvobs.engines.diesel.constants import DieselEngine
from lpvobs.records import Array
from lpvobs.simulation.parameters import SimulationParameters


class Work(NamedTuple):
    """Work per cycle of the whole engine: what a mg/cycle of fuel gives and what friction and gas exchange take.

    The losses are a parabola over n_e [rpm].
    """

    per_fuel: float  # J/(mg/cycle)
    loss_0: float  # J
    loss_1: float  # J/rpm
    loss_2: float  # J/rpm^2


def work_of(engine: DieselEngine, parameters: SimulationParameters) -> Work:
    """Return the engine's work balance, with gas exchange against the p_em - p_im that the vanes hold."""
    fire, V_d = parameters.combustion, engine.geometry.V_d
    f_0, f_1, f_2 = fire.friction_bar
    dp_0, dp_1 = parameters.setpoints.delta_p
    ideal = 1.0 - fire.compression_ratio ** (1.0 - fire.gamma_cyl)
    return Work(
        per_fuel=1e-6 * engine.geometry.n_cyl * fire.q_HV * fire.eta_ig * ideal,
        loss_0=V_d * (1e5 * f_2 + dp_0),
        loss_1=V_d * (1e5 * f_1 / 1e3 + dp_1),
        loss_2=V_d * 1e5 * f_0 / 1e6,
    )


@njit(cache=True)
def torque(work: Work, n_e: float, u_delta: float) -> float:
    """Return the torque at the crankshaft [Nm]; negative when the engine brakes."""
    return (work.per_fuel * u_delta - work.loss_0 - work.loss_1 * n_e - work.loss_2 * n_e * n_e) / (4.0 * pi)


@njit(cache=True)
def fuel(work: Work, n_e: float, wanted: float) -> float:
    """Return the fuel [mg/cycle] for a torque [Nm]; zero where the engine brakes that much by itself."""
    losses = work.loss_0 + work.loss_1 * n_e + work.loss_2 * n_e * n_e
    return max(0.0, (4.0 * pi * wanted + losses) / work.per_fuel)


@njit(cache=True)
def interpolate(x: Array, y: Array, at: float) -> float:
    """Return y at one point of a rising x, held outside."""
    i = min(max(int(np.searchsorted(x, at)) - 1, 0), x.size - 2)
    share = min(max((at - x[i]) / (x[i + 1] - x[i]), 0.0), 1.0)
    return (1.0 - share) * y[i] + share * y[i + 1]

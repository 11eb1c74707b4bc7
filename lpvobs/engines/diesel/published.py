"""What the paper prints of its diesel, and a drive by formula: no random numbers, integration or relations of the package.

Along the drive EGR stays shut. Load and speed follow sines, and with them the intake pressure. What flows into the cylinders and
what fills the manifold is then what the compressor has to deliver, and the turbine turns as fast as that takes.
"""

from collections.abc import Callable, Mapping

import numpy as np

from lpvobs.engines.base import Published
from lpvobs.engines.diesel.constants import DieselEngine, constants_of
from lpvobs.records import Array

TABLE_1 = {
    "ETC": ((19e-7, 150e-7), (-1.65e-7, 1.6e-7), (1.09e-7, 6.4e-7), (0.61e-7, 6.01e-7), (0.0, 3.15)),
    "FTP75": ((46e-7, 110e-7), (-0.56e-7, 1.15e-7), (1.18e-7, 6e-7), (0.75e-7, 5.4e-7), (0.0, 2.78)),
    "NEDC": ((49e-7, 130e-7), (-0.003e-7, 1.0e-7), (1.1e-7, 5.4e-7), (0.62e-7, 4.7e-7), (0.0, 2.67)),
}
"""Bounds of rho_1..rho_5 [SI]. FTP75, rho_1 is printed [146, 110] x 1e-7, the lower bound above the upper one: here [46, 110]."""

PUBLISHED = Published(
    source="Eq. (38)",
    outputs=("p_im", "omega_t"),  # Eq. (6)
    L=np.array([[1635.83, -124.95, 6.52e-7], [-16063.4, 3135.43, 1.67e-7], [4.2, 29.7, 4.55e-20]]),  # Eq. (38)
    epsilon=(0.25, 0.11),
    bounds=TABLE_1,
    surfaces={
        "ETC part 1, Eq. (39)": (9.12e-6, -4.39e-4, 1.30e-9, -5.74e-6, -5.37e-8, 0.0012887),  # Eq. (39)
        "FTP75 cold transient, Eq. (40)": (2.10e-5, -8.62e-4, 1.46e-9, -6.40e-6, -1.84e-8, 0.0032316),  # Eq. (40)
    },
    remark="Eqs. (39) and (40) agree within 1 g/s at operating points that both of the paper's cycles reached, and contradict each "
    "other elsewhere: at 56 mg/cycle and 2000 rpm they give −7.0 and +11.8 g/s.",
    errors={"etc_part1": 0.1041, "ftp75_cold": 0.0528},  # Sec. 4.1 and 4.2
)
"""Sec. 4. The quadratics are over mg/cycle and rpm."""


RATE, DURATION = 50.0, 240.0
P_AMB, T_AMB, REACH = 98_000.0, 298.0, 7.0e4
SLOWEST, FASTEST = 500.0, 30_000.0  # [rad/s] Range in which the turbine's speed is sought


def drive(engine: DieselEngine, error_at: Callable[[Array, Array], Array]) -> Mapping[str, Array]:
    """Return every channel of a log, with references; the sensor's error [kg/s] is over fuel [mg/cycle] and speed [rpm]."""
    t = np.arange(round(RATE * DURATION) + 1) / RATE
    load, speed = 0.5 + 0.5 * np.sin(0.61 * t), 0.5 + 0.5 * np.sin(0.083 * t + 0.4)
    load_rise, speed_rise = 0.5 * 0.61 * np.cos(0.61 * t), 0.5 * 0.083 * np.cos(0.083 * t + 0.4)
    reached = 0.3 + 0.7 * speed
    p_im, rise = 1.05e5 + REACH * load * reached, REACH * (load_rise * reached + load * 0.7 * speed_rise)
    channels = {
        "time": t,
        "n_e": 1000.0 + 2400.0 * speed,
        "u_delta": 4.0 + 46.0 * load,
        "u_egr": np.zeros_like(t),
        "u_vgt": 45.0 + 20.0 * load,
        "p_im": p_im,
        "p_em": 1.25 * p_im + 5000.0,
        "T_im": np.full_like(t, 320.0),
        "T_em": np.full_like(t, 750.0),
        "p_amb": np.full_like(t, P_AMB),
        "T_amb": np.full_like(t, T_AMB),
    }
    k = engine.filling
    eta = k.c_vol1 * np.sqrt(p_im) + k.c_vol2 * np.sqrt(channels["n_e"]) + k.c_vol3
    W_ei = eta * p_im * channels["n_e"] * engine.geometry.V_d / (120.0 * engine.gas.R_a * channels["T_im"])
    flow = W_ei + engine.geometry.V_im * rise / (engine.gas.R_a * channels["T_im"])
    error = error_at(channels["u_delta"], channels["n_e"])
    turbine = {"omega_t": _turbine_speed(engine, channels, flow), "W_maf": flow + error}
    return channels | turbine | {"ref_W_c": flow, "ref_delta_W_c": error}


def _compressor(engine: DieselEngine, p_im: Array, omega_t: Array) -> Array:
    """Return W_c of Eq. (2) [kg/s] above ambient pressure, in the form `tip_speed`; zero in stall."""
    gas, k = engine.gas, constants_of(engine)
    tip = k.R_c * omega_t
    head = 2.0 * gas.c_pa * T_AMB * ((p_im / P_AMB) ** (1.0 - 1.0 / gas.gamma_a) - 1.0) / tip**2
    ellipse = 1.0 - (head / (k.psi_0 + k.psi_1 * tip / 400.0)) ** 2
    coefficient = (k.phi_0 + k.phi_1 * tip / 400.0) * np.sqrt(np.maximum(ellipse, 0.0))
    return np.asarray(P_AMB * np.pi * k.R_c**3 * coefficient * omega_t / (gas.R_a * T_AMB))


def _turbine_speed(engine: DieselEngine, c: Mapping[str, Array], flow: Array) -> Array:
    """Return omega_t [rad/s] at which the compressor passes a flow, by halving the interval 60 times."""
    low, high = np.full_like(flow, SLOWEST), np.full_like(flow, FASTEST)
    for _ in range(60):
        middle = 0.5 * (low + high)
        enough = _compressor(engine, c["p_im"], middle) >= flow
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
    return 0.5 * (low + high)

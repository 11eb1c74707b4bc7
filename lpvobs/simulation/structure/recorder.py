"""What a control unit makes of its sensors: rasters in which it takes them, and the steps that it computes in."""

from collections.abc import Mapping

import numpy as np

from lpvobs.engines.sensors import Sensor
from lpvobs.records import Array
from lpvobs.simulation.parameters import Sensors
from lpvobs.simulation.sensors import measure

RASTERS = {
    "p_im": 0.010,
    "W_maf": 0.010,
    "p_em": 0.020,
    "omega_t": 0.020,
    "u_egr": 0.020,
    "u_vgt": 0.020,
    "T_im": 0.100,
    "T_em": 0.100,
}
"""[s] of the tasks, as measurement lists of control units have them (ASAM MCD-1 XCP); speed and fuel change with each stroke
(Guzzella and Onder 2010, Ch. 3)."""
STEPS = {
    "n_e": 0.25,
    "u_delta": 0.02,
    "p_im": 100.0,
    "p_em": 200.0,
    "omega_t": 0.42,
    "T_im": 0.5,
    "T_em": 1.0,
    "W_maf": 2.8e-5,
    "u_egr": 0.39,
    "u_vgt": 0.40,
}
"""In the channel's unit: rpm and valves as SAE J1979 writes them, turbocharger speed (4 rpm) and vanes as J1939-71, the rest 1 hPa,
half a degree, one degree, 0.1 kg/h."""
PHASE = 0.4  # of a raster, by which the recorder's clock is behind the control unit's


def record(
    amplitude: float,
    known: Mapping[str, Sensor],
    shown: Mapping[str, Array],
    n_cyl: int,
    fine: int,
    step: float,
    sensors: Sensors,
    seed: int,
) -> dict[str, Array]:
    """Return the readings at the samples, shape (N,), as a control unit hands them on.

    Rasters and steps have the same amplitude; those of known sensors are what is known of them. `shown` is what noise-free sensors
    show, shape (M,) every `step` seconds; every `fine`-th is a sample.
    """
    time = np.arange(shown["n_e"].size) * step
    stroke = np.floor(np.cumsum(shown["n_e"]) * step * n_cyl / 120.0 / amplitude) if amplitude else time
    rasters = {name: amplitude * raster for name, raster in RASTERS.items()}
    rasters |= {name: sensor.raster for name, sensor in known.items() if sensor.raster}
    steps = {name: amplitude * least for name, least in STEPS.items()}
    steps |= {name: sensor.quantisation for name, sensor in known.items() if sensor.quantisation}
    readings = {}
    for name, values in shown.items():
        period = rasters.get(name, 0.0)
        tick = (
            np.floor((time + PHASE * period) / period) if period else stroke if name in STEPS else np.arange(time.size)
        )
        new = np.concatenate([[True], np.diff(tick) > 0])
        taken = np.maximum.accumulate(np.where(new, np.arange(time.size), 0))[::fine]
        moments, again = np.unique(taken, return_inverse=True)
        held = measure({name: values[moments]}, sensors, seed)[name][again]
        least = steps.get(name, 0.0)
        readings[name] = np.round(held / least) * least if least else held
    return readings

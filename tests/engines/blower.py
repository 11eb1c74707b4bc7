"""A third engine for tests: a box that a blower fills and a nozzle empties. One state, other channels, two
balances, everything else as usual.

dp_box/dt = a_box (k_b n_b - rho_n p_box),    W_maf = rho_n p_box
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from lpvobs.engines.base import AirPath, Balances, EngineKind, MapAxis, Trajectory
from lpvobs.engines.channels import Channel, Recorded
from lpvobs.engines.effects import BOOST, SENSOR, Effect, lacking, on_the_reading
from lpvobs.engines.residual_model import ResidualModel

TEXT = """\
schema = 1
air_path = "blower"
[map]
v_b = { start = 0, stop = 10, step = 2 }  # V, blower voltage
n_b = { start = 1000, stop = 3000, step = 500 }  # rpm
[estimate]
smoothing = 0.05
least_information = 0.1
prior_map = 0.1
tolerance = { A_n = 0.01 }
[published]
gamma = 200.0
x_0 = [1e5]
temperatures = { T_box = 300.0 }
[gain]
outputs = ["p_box"]
cascade = true
decay = 1.0
margin = 0.05
bounds = { rho_n = [1e-7, 1e-6] }
temperatures = { T_box = [280, 320] }
[ekf]
map_drift = 1e-5
prior_map = 0.02
measurement_noise = { p_box = 100.0, W_maf = 5e-4 }
process_noise = { p_box = 1e3 }
[engine]
V_box = 0.01  # m^3, volume of the box
A_n = 1e-4  # m^2, area of the nozzle
k_b = 2e-5  # kg/s per rpm, what the blower delivers
"""


@dataclass(frozen=True)
class Box:
    """The configuration's `[engine]`."""

    V_box: float
    A_n: float
    k_b: float


@dataclass(frozen=True)
class Blower(AirPath):
    """The air path."""

    engine: Box

    name: ClassVar[str] = "blower"
    learns: ClassVar[bool] = False
    dispensable: ClassVar[tuple[str, ...]] = ()
    sensor: ClassVar[str] = "W_maf"
    state_names: ClassVar[tuple[str, ...]] = ("p_box",)
    parameter_names: ClassVar[tuple[str, ...]] = ("rho_n", "a_box")
    temperature_names: ClassVar[tuple[str, ...]] = ("T_box",)
    rate_names: ClassVar[tuple[str, ...]] = ("a_box",)
    balance_names: ClassVar[tuple[str, ...]] = ("nozzle",)
    usual_tolerance: ClassVar[Mapping[str, float]] = {"A_n": 0.01}
    smoothed: ClassVar[tuple[str, ...]] = ("p_box",)
    axes: ClassVar[tuple[MapAxis, MapAxis]] = (
        MapAxis("v_b", "V", "blower voltage"),
        MapAxis("n_b", "rpm", "blower speed"),
    )
    channels: ClassVar[Mapping[str, Channel]] = {
        "v_b": Channel("V", -1.0, 20.0, (0.0, 15.0), "blower voltage"),
        "n_b": Channel("rpm", -50.0, 8000.0, (100.0, 6000.0), "blower speed"),
        "p_box": Channel("Pa", 2e4, 6e5, (6e4, 4e5), "pressure in the box"),
        "T_box": Channel("K", 200.0, 500.0, (230.0, 420.0), "temperature in the box"),
        "W_maf": Channel("kg/s", -1.0, 2.0, (5e-4, 0.5), "mass air flow sensor"),
    }

    def engine_constants(self):
        return vars(self.engine)

    def rate_bounds(self, temperatures):
        low, high = temperatures["T_box"]
        return {"a_box": (287.0 * low / self.engine.V_box, 287.0 * high / self.engine.V_box)}

    @staticmethod
    def system(parameters, outputs):
        rho, a = parameters
        return [[-a * rho]], [*([0 * rho + 1] for _ in outputs), [rho]]

    def _rho(self, log):
        return self.engine.A_n / np.sqrt(287.0 * log["T_box"])

    def trajectory(self, log, outputs, constant=None):
        T = log["T_box"] if constant is None else np.full(len(log), constant["T_box"])
        rho, a = self._rho(log), 287.0 * T / self.engine.V_box
        A, C = (np.moveaxis(np.array(rows), -1, 0) for rows in self.system((rho, a), outputs))
        y = np.column_stack([log[name] for name in (*outputs, self.sensor)])
        return Trajectory(np.stack([rho, a], axis=1), A, (a * self.engine.k_b * log["n_b"])[:, None], C, y)

    def states(self, log):
        return log["p_box"][:, None]

    def knowledge(self):
        return None

    def learned_from(self, logs):
        return self

    def deviating(self, deviation):
        constants = {name: getattr(self.engine, name) * (1.0 + share) for name, share in deviation.items()}
        return replace(self, engine=replace(self.engine, **constants))

    def balances(self, log, rates, uncertain, calm=None):
        flow = self._rho(log) * log["p_box"]
        return Balances(("nozzle",), flow[None], np.tile(flow, (1, len(uncertain), 1)))


_READING = on_the_reading()
CATALOGUE = (
    *(_READING[f"maf.{name}"] for name in ("delay", "lag", "offset", "gain", "drift")),
    Effect("nozzle.area", "factor", "1", 1.0, 0.03, 0.5, 1.5, "nozzle", lacking({"nozzle": 1.0}, "nozzle"), BOOST),
)


def nozzle_flow(box, s, factor):
    """Return the flow through the nozzle, its area multiplied [kg/s]."""
    return factor * box.A_n / np.sqrt(287.0 * s["T_box"]) * s["p_box"]


def imbalances(box, s, _=None):
    """Return sensor less nozzle, and what the blower delivers less what leaves the box or stays in it, shape (2, C) [kg/s]."""
    flow = nozzle_flow(box, s, s.lacks[0])
    stored = box.V_box / (287.0 * s["T_box"]) * s.rate["p_box"]
    return np.stack([s[SENSOR] - flow, box.k_b * s["n_b"] - flow - stored])


def further(box, s):
    """Return what another nozzle adds to the flow, (1, N) [kg/s], and to dp_box/dt, (1, N) [Pa/s]."""
    more = nozzle_flow(box, s, s.lacks[0] - 1.0)
    return more[None], (-287.0 * s["T_box"] / box.V_box * more)[None]


def residual_model(config: Any, path: Blower, *_: Any) -> ResidualModel:
    """Return the engine as the closed loop sees it."""
    tolerance = config.estimate.tolerance

    def with_unknowns(beta):
        return path.deviating(dict(zip(tolerance, beta, strict=True))).engine

    return ResidualModel(
        balances=("nozzle", "box"),
        unit="kg/s",
        channels=("v_b", "n_b", "p_box", "T_box", SENSOR),
        moving=("v_b", "n_b", "p_box"),
        fuel="v_b",
        speed="n_b",
        lacks=(1.0,),
        constants=path.engine,
        names=tuple(tolerance),
        covariance=np.diag(np.square(list(tolerance.values())) / 3.0),
        with_unknowns=with_unknowns,
        imbalances=imbalances,
        by_reading=lambda box, s, _: np.repeat([[1.0], [0.0]], s.time.size // 2, axis=1),
        shown=lambda s, _: np.ones((2, s.time.size // 2), dtype=bool),
        further=further,
        catalogue=CATALOGUE,
        carriers=("maf.gain", "maf.offset"),
    )


def kind(example: str, **more: Any) -> EngineKind:
    """Return the record of the engine with its commented configuration in a file."""
    recorded = {"p_box": Recorded("Pa", (6e4, 4e5), ("Pa", "hPa", "kPa", "bar"), strong="p box|box pressure")}
    return EngineKind(Blower, {"engine": Box}, lambda: recorded, example, residual_model, **more)

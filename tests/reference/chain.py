"""An engine with any number of states: a chain of volumes, each emptying into the next, whose last level drives the sensor's flow.

    dx_1/dt = -a x_1 + u,    dx_i/dt = a (x_i-1 - 2 x_i),    W = rho x_n.

Two balances, so that there is something to mix: the flow from the last level as such, and from what it does in time.
"""

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from lpvobs.engines.base import SPEED_AXIS, AirPath, Balances, MapAxis, Trajectory
from lpvobs.records import Defects, Log
from lpvobs.synthesis.problem import GainProblem
from lpvobs.synthesis.region import Region

A_RANGE, RHO_RANGE = (20.0, 40.0), (0.5, 1.5)


def chain(n):
    """Return the air path of a chain of n volumes, its class made for that number."""
    names = tuple(f"x_{i + 1}" for i in range(n))

    @dataclass(frozen=True)
    class Chain(AirPath):
        name = "chain"
        learns = False
        sensor = "W"
        state_names = names
        smoothed = names
        parameter_names = ("a", "rho")
        temperature_names = ()
        rate_names = ()
        channels = dict.fromkeys(("a", "rho", "u", "load", "n_e", "W", *names))
        balance_names = ("level", "rise")
        usual_tolerance: ClassVar = {"level": 0.01}
        axes = (MapAxis("load", "1", "load"), SPEED_AXIS)
        system = staticmethod(partial(system, n))

        def trajectory(self, log, outputs, constant=None):
            parameters = np.stack((log["a"], log["rho"]), axis=1)
            A, C = (np.array(part) for part in zip(*(system(n, p, outputs) for p in parameters.tolist()), strict=True))
            E = np.zeros((len(log), n))
            E[:, 0] = log["u"]
            y = np.stack([log[name] for name in (*outputs, "W")], axis=1)
            return Trajectory(parameters, A, E, C, y, len(outputs))

        def states(self, log):
            return np.stack([log[name] for name in names], axis=1)

        def balances(self, log, rates, uncertain, calm=None):
            a, last, rise = log["a"], log[names[-1]], rates[names[-1]]
            into = log["u"] if n == 1 else a * log[names[-2]]
            flow = log["rho"] * np.stack((last, (into - rise) / (a if n == 1 else 2.0 * a)))
            slope = np.zeros((2, len(uncertain), len(log)))
            slope[0] = log["rho"] * last
            return Balances(("level", "rise"), flow, slope)

    return Chain()


def system(n, parameters, outputs):
    """Return A and C for numbers of any kind."""
    a, rho = parameters
    zero = 0 * a
    A = [[-(a if i == 0 else 2 * a) if i == j else (a if i == j + 1 else zero) for j in range(n)] for i in range(n)]
    C = [[zero + int(f"x_{j + 1}" == name) for j in range(n)] for name in outputs]
    return A, [*C, [zero] * (n - 1) + [rho]]


def problem(n, outputs):
    """Return what a gain for the chain is asked for."""
    lower, upper = zip(A_RANGE, RHO_RANGE, strict=True)
    region = Region(("a", "rho"), lower, upper)
    return GainProblem(partial(system, n, outputs=outputs), region, len(outputs))


def drive(n, seed, error, seconds=120.0, h=0.01):
    """Return a log without noise whose states follow backward Euler exactly, with an error of the sensor over load and speed."""
    rng = np.random.default_rng(seed)
    time = h * np.arange(round(seconds / h))
    waves = [0.5 + 0.5 * np.sin(rng.uniform(0.5, 3.0) * time + rng.uniform(0.0, 6.0)) for _ in range(5)]
    a = A_RANGE[0] + (A_RANGE[1] - A_RANGE[0]) * waves[0]
    rho = RHO_RANGE[0] + (RHO_RANGE[1] - RHO_RANGE[0]) * waves[1]
    u, load, speed = 40.0 + 40.0 * waves[2], waves[3], 1000.0 + 2000.0 * waves[4]
    x, rows = np.ones(n), []
    for k in range(time.size):
        A = np.array(system(n, (a[k], rho[k]), ())[0])
        x = np.linalg.solve(np.eye(n) - h * A, x + h * np.eye(n)[0] * u[k]) if k else x
        rows.append(x)
    states = {f"x_{i + 1}": column.copy() for i, column in enumerate(np.array(rows).T)}
    W = rho * states[f"x_{n}"] + error(load, speed)
    channels = {"a": a, "rho": rho, "u": u, "load": load, "n_e": speed, "W": W, **states}
    return Log("chain", "", time, channels, {}, ((0, time.size),), np.arange(time.size), Defects(time.size))

"""What a control unit should compute: the package's observer on smoothed signals, and a slow one whose map gain falls."""

import numpy as np

from lpvobs.engines.base import Trajectory
from lpvobs.engines.curves import values_at
from lpvobs.engines.diesel import relations
from lpvobs.engines.followers import with_followers
from lpvobs.io.control_unit.sources import MEMORY, PACE
from lpvobs.observer.estimate import calmed
from lpvobs.observer.parts import operating_point
from lpvobs.observer.recursion import observe
from lpvobs.observer.step import Sample, local_step

PARTS = {"compressor": (0, "omega_t", 1.0), "egr": (1, "p_em", -1.0)}
"""Scheduling parameter that a correction of a flow belongs to, what it is over, and its sign; all others: rho_3 over p_im."""


def trajectory_of(unit, log):
    """Return the LPV system of a diesel, its flows with the corrections as `estimate` adds them to the balances."""
    plain, c = unit.air_path.trajectory(log, unit.stored.outputs), getattr(unit.air_path, "constants", None)
    if not unit.corrections:
        return plain
    parameters, still = plain.parameters.T.copy(), {name: np.zeros(log.time.size) for name in log.channels}
    for component, found in zip(unit.air_path.components, unit.air_path.corrections(log, still), strict=True):
        if component.unit == "1":
            row, over, sign = PARTS.get(component.name, (2, "p_im", 1.0))
            values = unit.corrections[component.name]
            share = values[0] if found.points is None else values_at(found.points.weights, values)
            parameters[row] += sign * found.scale * share / log[over]
    at = zip(parameters[0], *(log[name] for name in ("p_im", "omega_t", "p_amb", "T_amb")), strict=True)
    parameters[4] = [relations.rho_5(c, rho_1, relations.head(c, p, p_0), p, w, p_0, T) for rho_1, p, w, p_0, T in at]
    A, C = (
        np.array([[np.broadcast_to(cell, log.time.size) for cell in row] for row in rows]).transpose(2, 0, 1)
        for rows in unit.air_path.system(parameters, unit.stored.outputs)
    )
    return Trajectory(parameters.T, A, plain.E, C, plain.y, plain.steady)


def constant(unit, log):
    """Return states (N, n) and map (p,) by the compiled recursion with Gamma constant."""
    smooth, _ = calmed(unit.air_path, with_followers(unit.followers, log), unit.half_width)
    trajectory = trajectory_of(unit, smooth)
    first = unit.air_path.states(smooth)[[start for start, _ in log.segments]]
    point = operating_point(unit.air_path, log)
    run = observe(
        trajectory, log.time, log.segments, point, unit.grid, unit.stored.gain.L, unit.gamma, first, unit.theta
    )
    return run.x, run.theta


def falling(unit, log):
    """Return the same by the step as printed, Gamma = gamma I with 1 / gamma = 1 / gamma_0 + (time driven) / PACE."""
    smooth, _ = calmed(unit.air_path, with_followers(unit.followers, log), unit.half_width)
    trajectory = trajectory_of(unit, smooth)
    measured, (fuel, speed) = unit.air_path.states(smooth), operating_point(unit.air_path, log)
    nodes, weights = unit.grid.regressors(fuel, speed)
    theta, driven, states = unit.theta.copy(), unit.driven.copy(), []
    for start, stop in log.segments:
        x = measured[start]
        for k in range(start, stop):
            h = log.time[k] - log.time[k - 1] if k > start else 0.0
            gamma = 1.0 / (1.0 / unit.gamma + weights[k] @ driven[nodes[k]] / PACE)
            sample = Sample(trajectory.A[k], trajectory.E[k], trajectory.C[k], trajectory.y[k])
            x, theta = local_step(x, theta, h, sample, unit.stored.gain.L, gamma, nodes[k], weights[k])
            driven[nodes[k]] = np.minimum(driven[nodes[k]] + h * weights[k], MEMORY)
            states.append(x)
    return np.array(states), theta

"""What a control unit should compute: the package's observer on smoothed signals, and a slow one whose map gain falls."""

import numpy as np

from lpvobs.io.control_unit.sources import MEMORY, PACE
from lpvobs.observer.estimate import calmed
from lpvobs.observer.parts import operating_point
from lpvobs.observer.recursion import observe
from lpvobs.observer.step import Sample, local_step


def constant(unit, log):
    """Return states (N, n) and map (p,) by the compiled recursion with Gamma constant."""
    smooth, _ = calmed(unit.air_path, log, unit.half_width)
    trajectory = unit.air_path.trajectory(smooth, unit.stored.outputs)
    first = unit.air_path.states(smooth)[[start for start, _ in log.segments]]
    point = operating_point(unit.air_path, log)
    run = observe(
        trajectory, log.time, log.segments, point, unit.grid, unit.stored.gain.L, unit.gamma, first, unit.theta
    )
    return run.x, run.theta


def falling(unit, log):
    """Return the same by the step as printed, Gamma = gamma I with 1 / gamma = 1 / gamma_0 + (time driven) / PACE."""
    smooth, _ = calmed(unit.air_path, log, unit.half_width)
    trajectory = unit.air_path.trajectory(smooth, unit.stored.outputs)
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

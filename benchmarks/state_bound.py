"""The proven bound on the error of the state against the worst that can be done to it: `python benchmarks/state_bound.py [PLANTS]`.

Every drive (two cycles a plant, 25 plants unless said) is simulated whole. Along its scheduling parameters the largest error of
each state is sought among all disturbances within their sizes: the error is linear in them, so the best direction at every sample
is the sign of how the error answers to it, and that optimum is exact. Its course is then put into the observer that `estimate`
runs.
"""

import sys
from dataclasses import replace

import numpy as np
from common import CYCLES, configuration, drive, markdown, publish

from lpvobs.api.synth_gain import make_gain
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.observer.estimate import calmed
from lpvobs.observer.recursion import observe
from lpvobs.records import Array
from lpvobs.simulation.simulate import drawn

FIRST_PLANT = 701
SENSORS = np.array([300.0, 600.0, 40.0])
"""Pa, Pa, rad/s: two standard deviations of the sensors' noise."""
RATES = np.array([2e4, 1.5e5, 500.0])
"""Pa/s, Pa/s, rad/s^2: about 1 g/s of air or exhaust gas that the model lacks, and 1 % of the turbine's torque."""
MEMORY = 60
"""Samples after which nothing is left of a disturbance: the gain decays within a few."""
CASES = {"sensor errors": (1.0, 0.0), "what the model lacks": (0.0, 1.0), "both": (1.0, 1.0)}


def main(plants: int) -> None:
    """Print and keep the table."""
    config = configuration()
    stored, _ = make_gain(config, ())
    gain, path, grid = stored.gain, Diesel(config.engine), config.grid()
    assert gain.bound is not None
    found: dict[str, list[Array]] = {name: [] for name in CASES}
    same, inside, drives = 0.0, 0, 0
    for plant in range(FIRST_PLANT, FIRST_PLANT + plants):
        engine = drawn(config.engine, config.estimate.tolerance, plant)[0]
        for cycle in CYCLES:
            log = calmed(path, drive(config, cycle, plant, None, engine).log, config.estimate.smoothing)[0]
            trajectory = path.trajectory(log, stored.outputs)
            closed = trajectory.A - gain.L @ trajectory.C
            h = float(np.median(np.diff(log.time)))
            covered = gain.region.contains(trajectory.parameters)
            usable = np.flatnonzero(np.convolve(~covered, np.ones(MEMORY), "full")[: covered.size] < 0.5)[MEMORY:]
            inside, drives = inside + usable.size / covered.size, drives + 1
            answers = _answers(closed, h, usable)
            for name, (of_sensors, of_rates) in CASES.items():
                V, D = of_sensors * SENSORS, of_rates * RATES
                sizes = np.abs(answers) @ D + np.abs(answers @ gain.L[:, :-1]) @ V
                largest = h * sizes.sum(axis=2).max(axis=1)
                bound = gain.bound.of_outputs[:, :-1] @ V + gain.bound.of_rates @ D
                found[name].append(np.stack([largest, bound]))
            # The same course through the observer itself: the error of its first state at the worst sample.
            place = int(np.argmax(sizes[0].sum(axis=1)))
            seen = _through_the_observer(trajectory, log, grid, gain.L, int(usable[place]), answers[0, place])
            same = max(same, abs(seen / (h * sizes[0].sum(axis=1).max()) - 1.0))
            print(cycle, plant, found["both"][-1].round(1).tolist(), file=sys.stderr, flush=True)
    rows = []
    for name, each in found.items():
        largest, bound = np.array(each)[:, 0], np.array(each)[0, 1]
        held = int(np.all(largest <= bound, axis=1).sum())
        cells = [f"{top:.1f} of {limit:.1f}" for top, limit in zip(largest.max(axis=0), bound, strict=True)]
        rows.append([name, *cells, f"{(bound / largest.min(axis=0)).max():.2f}", f"{held} of {len(each)}"])
    tops = (f"{state}: largest error of bound" for state in stored.states)
    header = ["disturbed by", *tops, "bound over error, worst drive", "held"]
    sensors, rates = (", ".join(f"{v:g}" for v in sizes) for sizes in (SENSORS, RATES))
    text = (
        f"{drives} drives, {100 * inside / drives:.1f} % of their samples, with what went before, inside the region that the gain "
        f"is proven for. Sensor errors within {sensors} and rates within {rates} ({', '.join(stored.states)} in Pa, Pa, rad/s and "
        f"per second), in the worst directions.\n\n{markdown(header, rows)}\n\n"
        f"The observer that `estimate` runs, disturbed in the same way, has the same error to a share of {same:.1e}."
    )
    publish("state_bound", "The proven bound on the error of the state", text, "make extrapolation")


def _answers(closed: Array, h: float, usable: Array) -> Array:
    """Return how each state at each usable sample answers to rates at the samples before, shape (n, K, MEMORY, n)."""
    n = closed.shape[1]
    steps = np.linalg.inv(np.eye(n) - h * closed)
    rows = np.broadcast_to(np.eye(n)[:, None], (n, usable.size, n))
    found = []
    for back in range(MEMORY):
        rows = np.einsum("ski,kij->skj", rows, steps[usable - back])
        found.append(rows)
    return np.stack(found, axis=2)


def _through_the_observer(trajectory, log, grid, L, worst, answers):  # type: ignore[no-untyped-def]
    """Return the error of the first state that the observer has at a sample under the worst course of all disturbances."""
    E, y = trajectory.E.copy(), trajectory.y.copy()
    when = worst - np.arange(MEMORY)
    E[when] += np.sign(answers) * RATES
    y[when, :-1] += np.sign(answers @ L[:, :-1]) * SENSORS
    part = slice(worst - MEMORY, worst + 1)
    point, first = (log["u_delta"][part], log["n_e"][part]), trajectory.y[worst - MEMORY, :-1][None]
    nodes, states = np.zeros(grid.size), []
    cut = {name: getattr(trajectory, name)[part] for name in ("parameters", "A", "C")}
    for inputs, outputs in ((trajectory.E, trajectory.y), (E, y)):
        some = replace(trajectory, **cut, E=inputs[part], y=outputs[part])
        run = observe(some, log.time[part], ((0, MEMORY + 1),), point, grid, L, 0.0, first, nodes)
        states.append(run.x[-1])
    return float(states[1][0] - states[0][0])


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 25)

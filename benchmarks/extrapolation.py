"""Nodes that nobody drove, region means and differences of maps: `python benchmarks/extrapolation.py [PLANTS] [SEED]`, default 20.

Every plant has its constants drawn within the tolerance and drives both cycles whole. The course of the engine does not depend on
what the air flow sensor reads, so each drive is recorded five times, with a surface of every family and new noise of that sensor;
every record is estimated from the log as any other. Filled by kriging and by the quadratic, and judged at the nodes that the drive
does not inform. The surfaces are drawn from SEED: the page's is the commit after which nothing of the method was changed.
"""

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from common import CYCLES, Drive, configuration, drive, markdown, publish, state_gain
from scipy.ndimage import binary_dilation

from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.engines.diesel.published import PUBLISHED
from lpvobs.io.configuration.config import Config
from lpvobs.maps.grid import Grid
from lpvobs.maps.joint import NORMAL_90, Joint, at_weights, combined, mean_weights
from lpvobs.maps.kriging import AMPLITUDES, LENGTHS, PROCESSES, Weighted, known_nodes, krige
from lpvobs.maps.metrics import best_fit
from lpvobs.maps.quadratic import Filled, fit, interval_factor, scaled_terms
from lpvobs.observer.estimate import MapEstimate, estimate_default
from lpvobs.records import Array
from lpvobs.simulation.instruments import measure
from lpvobs.simulation.parameters import Bump, ErrorSurface
from lpvobs.simulation.readings import surface_error
from lpvobs.simulation.simulate import drawn

FIRST_PLANT = 641
FAMILIES = ("paper's", "King's", "plane", "hollow", "random bumps")
FUEL, SPEED = np.linspace(0.0, 56.0, 57), np.linspace(0.0, 4000.0, 81)
FLOW = (
    0.01818, 0.13060, -0.16329, 0.08735, -0.04059, 0.11810, -0.12543, 0.19307, 0.03220, -0.12466
)  # fmt: skip
"""[kg/s] of n u^a n^b, a + b <= 3, u over 56 mg and n over 4000 rpm: least squares through the plant's flow after 40 s under
control at every node from 750 rpm on, 2.5 g/s rms. King's law is a function of the flow, and nobody drove elsewhere."""
REGIONS = ((750.0, 2000.0), (8.0, 24.0)), ((1500.0, 2500.0), (4.0, 20.0))
"""Speeds [rpm] and fuels [mg] whose mean is judged: both drives inform most of their nodes."""
FINE = 100
"""Points along each side of a region, for the mean of the surface itself: it is not bilinear within a cell."""


@dataclass(frozen=True)
class Case:
    """A record of a drive, its map, and the truth: at the nodes, the best bilinear map, means over REGIONS."""

    cycle: str
    family: str
    plant: int
    truth: Array
    best: Array
    means: list[float]
    estimate: MapEstimate


def main(plants: int, seed: int) -> None:
    """Print and keep the tables."""
    seeds = range(FIRST_PLANT, FIRST_PLANT + plants)
    show([case for plant in seeds for case in of_plant(seed, plant)], seed)


def show(cases: list[Case], seed: int) -> None:
    """Print and keep the tables of cases."""
    grid = configuration().grid()
    found = [(case, *filled(grid, case)) for case in cases]
    known = {(case.cycle, case.family, case.plant): knowing(grid, case) for case in cases}
    intro = (
        f"{len(cases) // 2} surfaces a cycle, drawn from {seed:x}, on {len(cases) // 10} plants with their constants drawn within "
        "the tolerance. Every drive was simulated whole once and recorded with five surfaces."
    )
    text = "\n\n".join((intro, unvisited(found, known), together(grid, found), duration(grid, cases)))
    publish("extrapolation", "Where nobody drove", text, "make extrapolation")


def filled(grid: Grid, case: Case) -> tuple[Filled, Filled]:
    """Return the map filled by kriging and by the quadratic."""
    e = case.estimate
    return (
        krige(grid, e.theta, e.covariance, e.supported, e.design),
        fit(grid, e.theta, e.covariance, e.supported, e.noise, e.design),
    )


def knowing(grid: Grid, case: Case) -> float:
    """Return the least rms at nodes that the drive does not inform of any single process, lengths and amplitude, [g/s]."""
    e, off = case.estimate, np.flatnonzero(~case.estimate.supported)
    data = known_nodes(grid, e.theta, e.covariance, e.supported, e.design)
    least = np.inf
    for process in product(PROCESSES, product(LENGTHS, LENGTHS)):
        own, over = (data.correlation(data.chosen, nodes, process) for nodes in (data.chosen, off))
        for share in AMPLITUDES:
            one = Weighted(data, share * data.size, own)
            beyond = one.whitened(one.power * over).T @ (one.z - one.X @ one.beta)
            least = min(least, np.sqrt(np.mean((data.trend[off] @ one.beta + beyond - case.truth.ravel()[off]) ** 2)))
    return 1e3 * float(least)


def unvisited(found: list[tuple[Case, Filled, Filled]], known: dict[tuple[str, str, int], float]) -> str:
    """Return the table of the nodes that the drives do not inform."""
    rows = []
    for cycle, title in CYCLES.items():
        each = []
        for family in FAMILIES:
            of_family = [item for item in found if (item[0].cycle, item[0].family) == (cycle, family)]
            of_truth = [known[case.cycle, case.family, case.plant] for case, _, _ in of_family]
            each.append(
                np.array([[*_unvisited(*item), least] for item, least in zip(of_family, of_truth, strict=True)])
            )
            rows.append([f"{title}: {family}", *_columns(each[-1])])
        rows.append([f"**{title}, all**", *_columns(np.concatenate(each))])
    header = [
        "drive: surface", "rms kriging, g/s", "rms quadratic, g/s", "ratio", "ratio, the truth chooses",
        "coverage kriging, %", "quadratic, %",
        "within two nodes: rms, g/s", "coverage, %", "quadratic, %",
    ]  # fmt: skip
    return (
        "Nodes that the drive does not inform. Rms: median over surfaces; ratio to the quadratic's: geometric mean; coverage of "
        "90 % intervals: mean. *The truth chooses*: whichever single process, lengths and amplitude of kriging, or the quadratic, "
        "comes nearest to the very surface: no choice by the data can do better.\n\n" + markdown(header, rows)
    )


def _unvisited(case: Case, kriging: Filled, quadratic: Filled) -> list[float]:
    on = case.estimate.supported
    near = binary_dilation(on, np.ones((3, 3)), iterations=2) & ~on
    values = []
    for nodes in (~on, near):
        for each in (kriging, quadratic):
            away = (each.delta_W_c - case.truth)[nodes]
            half = interval_factor(each.nodes, 0.9) * each.map_standard_error[nodes]
            values += [1e3 * np.sqrt(np.mean(away**2)), 100 * np.mean(np.abs(away) <= half)]
    return values


def _columns(found: Array) -> list[str]:
    rms, held, rms_2, held_2, near, near_held, _, near_held_2, least = found.T
    ratios = [np.exp(np.mean(np.log(each / rms_2))) for each in (rms, np.minimum(least, rms_2))]
    middle = [f"{np.median(rms):.2f}", f"{np.median(rms_2):.2f}", *(f"{ratio:.2f}" for ratio in ratios)]
    shares = [f"{held.mean():.0f}", f"{held_2.mean():.0f}"]
    return [*middle, *shares, f"{np.median(near):.2f}", f"{near_held.mean():.0f}", f"{near_held_2.mean():.0f}"]


def together(grid: Grid, found: list[tuple[Case, Filled, Filled]]) -> str:
    """Return the table of means over regions and of differences of the maps of two drives with one sensor."""
    rows = []
    for title, as_it_is in (("region means, best map where driven", False), ("region means, the surface itself", True)):
        full, alone = [], []
        for case, kriging, _ in found:
            truth = np.where(case.estimate.supported, case.best, case.truth).ravel()
            for ((n_low, n_high), (u_low, u_high)), itself in zip(REGIONS, case.means, strict=True):
                along = mean_weights(grid.speed, n_low, n_high), mean_weights(grid.fuel, u_low, u_high)
                weights = np.outer(*along).ravel()
                mean = combined(weights[None], kriging.delta_W_c.ravel(), kriging.covariance)
                away = abs(float(mean.values[0] - (itself if as_it_is else weights @ truth)))
                full.append(away <= NORMAL_90 * mean.standard_error[0])
                alone.append(away <= NORMAL_90 * np.sqrt(weights**2 @ np.diag(kriging.covariance)))
        rows.append([title, str(len(full)), f"{100 * np.mean(full):.0f}", f"{100 * np.mean(alone):.0f}"])
    first, second = (
        {(case.plant, case.family): (case, kriging) for case, kriging, _ in found if case.cycle == cycle}
        for cycle in CYCLES
    )
    nodes, means, alone, p = [], [], [], []
    for key in first:
        (one, a), (other, b) = first[key], second[key]
        on = (one.estimate.supported & other.estimate.supported).ravel()
        change = Joint((a.delta_W_c - b.delta_W_c).ravel()[on], (a.covariance + b.covariance)[np.ix_(on, on)])
        weights = np.full(change.values.size, 1.0 / change.values.size)
        nodes.append(np.mean(np.abs(change.values) <= NORMAL_90 * change.standard_error))
        mean = abs(change.values.mean())
        means.append(mean <= NORMAL_90 * np.sqrt(weights @ change.covariance @ weights))
        alone.append(mean <= NORMAL_90 * np.sqrt(weights**2 @ np.diag(change.covariance)))
        p.append(change.nothing())
    rows.append(
        [
            "difference of the two drives' maps, mean",
            str(len(means)),
            f"{100 * np.mean(means):.0f}",
            f"{100 * np.mean(alone):.0f}",
        ]
    )
    rows.append(["difference of the two drives' maps, nodes", str(len(means)), f"{100 * np.mean(nodes):.0f}", "-"])
    below = (
        f"Of {len(p)} tests whether the two maps are alike, {sum(each < 0.1 for each in p)} have p < 0.1 and "
        f"{sum(each < 0.01 for each in p)} p < 0.01."
    )
    header = ["", "draws", "held by the full covariance, %", "by node errors alone, %"]
    return markdown(header, rows) + "\n\n" + below


def duration(grid: Grid, cases: list[Case]) -> str:
    """Return how long kriging takes on the configured grid, and on one of 40 by 40 nodes with as large a share estimated."""
    case = next(case for case in cases if case.cycle == "etc_part1")
    e = case.estimate
    fine = Grid(np.linspace(grid.fuel[0], grid.fuel[-1], 40), np.linspace(grid.speed[0], grid.speed[-1], 40))
    onto = np.einsum("ia,jb->ijab", at_weights(grid.speed, fine.speed), at_weights(grid.fuel, fine.fuel)).reshape(
        fine.size, grid.size
    )
    inside = onto @ e.supported.ravel() > 0.999
    used = onto * e.supported.ravel()
    theta = (used @ np.nan_to_num(e.theta.ravel())).reshape(fine.shape)
    covariance = used @ np.where(np.isfinite(e.covariance), e.covariance, 0.0) @ used.T + 1e-10 * np.eye(fine.size)
    n, u = np.meshgrid(fine.speed, fine.fuel, indexing="ij")
    taken = []
    for job in (
        lambda: krige(grid, e.theta, e.covariance, e.supported, e.design),
        lambda: krige(fine, theta, covariance, inside.reshape(fine.shape), scaled_terms(fine, u, n).reshape(-1, 6)),
    ):
        start = time.process_time()
        job()
        taken.append(time.process_time() - start)
    return (
        f"Kriging takes {taken[0]:.2f} s of one processor for {grid.size} nodes, {int(e.supported.sum())} of them estimated, and "
        f"{taken[1]:.1f} s for 1600, {int(inside.sum())} of them estimated."
    )


def flow(u: Array, n: Array) -> Array:
    """Return the flow of stationary running, smooth over the whole grid [kg/s]."""
    u, n = u / 56.0, n / 4000.0
    powers = [(a, b) for a in range(4) for b in range(4 - a)]
    return sum(c * n * u**a * n**b for c, (a, b) in zip(FLOW, powers, strict=True))


def surface_of(family: str, rng: np.random.Generator) -> ErrorSurface:
    """Return a surface of a family."""
    printed = [np.array(each) for each in PUBLISHED.surfaces.values()]
    if family == "paper's":
        shape = printed[rng.integers(2)] * rng.uniform(0.5, 1.5) * rng.uniform(0.8, 1.2, 6)
        return ErrorSurface("quadratic", coefficients=tuple(shape))
    if family == "King's":
        law = ErrorSurface("king", offset=rng.uniform(0.0, 0.015), slope=rng.uniform(0.9, 1.05))
        values = surface_error(law, FUEL, SPEED, flow(*np.meshgrid(FUEL, SPEED)))
        return ErrorSurface("table", u_delta=tuple(FUEL), n_e=tuple(SPEED), values=tuple(map(tuple, values)))
    if family == "plane":
        zero, u, n = rng.uniform(-5e-3, 5e-3, 3)
        return ErrorSurface("quadratic", coefficients=(0.0, (u - zero) / 56.0, 0.0, (n - zero) / 4000.0, 0.0, zero))
    hollow = family == "hollow"
    bumps = tuple(
        Bump(
            amplitude=rng.uniform(*((-5e-3, -2e-3) if hollow else (-3e-3, 3e-3))),
            u_delta=rng.uniform(4.0, 52.0),
            n_e=rng.uniform(750.0, 3500.0),
            width_u_delta=rng.uniform(*((4.0, 8.0) if hollow else (5.0, 12.0))),
            width_n_e=rng.uniform(*((250.0, 500.0) if hollow else (300.0, 800.0))),
        )
        for _ in range(1 if hollow else 5)
    )
    return ErrorSurface("quadratic", coefficients=tuple(printed[1] * rng.uniform(0.5, 1.5)), bumps=bumps)


def of_plant(seed: int, plant: int) -> list[Case]:
    """Return the records of both drives of a plant, the same five surfaces for both."""
    config = configuration()
    setting = (config, config.grid(), state_gain(config))
    engine = drawn(config.engine, config.estimate.tolerance, plant)[0]
    found = []
    for cycle in CYCLES:
        made = drive(config, cycle, plant, ErrorSurface("zero"), engine)
        found += list(_records(setting, cycle, seed, plant, made))
        print(cycle, plant, time.strftime("%H:%M:%S"), file=sys.stderr, flush=True)
    return found


def _records(setting: tuple[Config, Grid, object], cycle: str, seed: int, plant: int, made: Drive) -> Iterator[Case]:
    config, grid, gain = setting
    n, u = np.meshgrid(grid.speed, grid.fuel, indexing="ij")
    true = made.truth
    for number, family in enumerate(FAMILIES):
        surface = surface_of(family, np.random.default_rng([seed, plant, number]))
        error = surface_error(surface, true["u_delta"], true["n_e"], true["W_c"])
        noisy = measure("W_maf", true["W_c"] + error, config.simulation.sensors, 10_000 * number + plant)
        log = replace(made.log, channels={**made.log.channels, "W_maf": noisy})
        estimate = estimate_default(Diesel(config.engine), grid, gain, [log], config.estimate)
        truth = surface_error(surface, u.ravel(), n.ravel(), np.zeros(grid.size)).reshape(grid.shape)
        best = best_fit(grid, *grid.regressors(true["u_delta"], true["n_e"]), error).reshape(grid.shape)
        yield Case(cycle, family, plant, truth, best, [_mean_of(surface, *region) for region in REGIONS], estimate)


def _mean_of(surface: ErrorSurface, speeds: tuple[float, float], fuels: tuple[float, float]) -> float:
    middles = (np.arange(FINE) + 0.5) / FINE
    n, u = np.meshgrid(speeds[0] + np.ptp(speeds) * middles, fuels[0] + np.ptp(fuels) * middles)
    return float(surface_error(surface, u.ravel(), n.ravel(), np.zeros(n.size)).mean())


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20, int(sys.argv[2], 16) if len(sys.argv) > 2 else 0)

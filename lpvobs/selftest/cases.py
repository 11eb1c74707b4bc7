"""The cases of the self-test. Answers are the paper's numbers, formulas written down anew, or exact by construction."""

import json
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from pathlib import Path

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from lpvobs.api.estimate import estimate
from lpvobs.api.extrapolate import extrapolate
from lpvobs.api.simulate import simulate
from lpvobs.api.trace import trace
from lpvobs.api.verify import problem_of
from lpvobs.engines.registry import ENGINES
from lpvobs.errors import DataError
from lpvobs.io.configuration.config import load_config
from lpvobs.io.logs.parquet import write_log
from lpvobs.io.logs.units import convert
from lpvobs.io.results.gains import StoredGain, read_gain, write_gain
from lpvobs.io.results.provenance import Provenance, versions
from lpvobs.io.results.results import read_result
from lpvobs.kinds import Output
from lpvobs.maps.grid import Grid
from lpvobs.maps.quadratic import evaluate, fit
from lpvobs.records import Array
from lpvobs.simulation.cycles import shipped_folder
from lpvobs.synthesis.certificate import Gain, check
from lpvobs.synthesis.region import Region


@dataclass(frozen=True)
class CaseOutput:
    """A case with a known answer."""

    case: str  # what is examined
    basis: str  # where the answer comes from
    expected: float  # in `unit`, like `found`; yes and no are one and zero
    found: float
    tolerance: float  # largest difference that passes
    unit: str
    note: str  # what went wrong, where no number came out at all
    passed: bool  # whether the answer is right; what is not a number never is


def row(
    case: str, basis: str, expected: float, found: float, within: float, unit: str = "1", note: str = ""
) -> CaseOutput:
    """Return one line of the table."""
    return CaseOutput(case, basis, expected, found, within, unit, note, bool(abs(found - expected) <= within))


class SelftestOutput(Output):
    """Cases with known answers."""

    passed: bool
    cases: Sequence[CaseOutput]
    versions: Mapping[str, str]


Case = Callable[[], Iterable[CaseOutput]]


def rows_of(name: str, case: Case) -> Iterator[CaseOutput]:
    """Yield the rows of a case; one that fails where it stands if the case ends in an exception."""
    try:
        yield from case()
    except Exception as error:  # whatever is broken in the installation belongs into the table
        note = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        yield row(name, "the case runs without an error", 1.0, 0.0, 0.0, note=note)


def known_map(grid: Grid) -> Array:
    """Return the error of the sensor at the nodes, shape (p_2, p_1) [kg/s]: a saddle of a few grams per second."""
    u, n = np.meshgrid(grid.fuel / grid.fuel[-1], grid.speed / grid.speed[-1])
    return np.asarray(1e-3 * (1.0 - 4.0 * u + 3.0 * n * n - 2.0 * u * n))


def bilinear(grid: Grid, theta: Array, u: Array, n: Array) -> Array:
    """Return a map between its nodes, by a library that the estimator does not use."""
    return np.asarray(RegularGridInterpolator((grid.speed, grid.fuel), theta)((n, u)))


KIND, PRINTED, DRIVE = next(
    (kind, kind.published, kind.known_drive) for kind in ENGINES.values() if kind.published and kind.known_drive
)
"""The engine that is examined: one with printed answers and a drive by formula."""
UNITS = {"time": "s", "ref_W_c": "kg/s", "ref_delta_W_c": "kg/s"} | {
    name: channel.unit for name, channel in KIND.air_path.channels.items()
}
FACTOR = 1.2  # of the reading of a faulty sensor
METHODS = {"observer": 1e-4, "batch": 1e-9}
"""Tolerance of a node, [kg/s], of a map that reaches 3e-3: this drive has no noise, and what is rough in its signals is taken for
noise, which costs 2e-5; without that, rounding is left."""
KNOWN = json.loads((files("lpvobs.selftest") / "known.json").read_text(encoding="utf-8"))
"""Matrices of the shipped proofs."""
EXAMPLE = shipped_folder("configs") / KIND.example
"""The example of the engine's configuration, as shipped."""


def units() -> Iterator[CaseOutput]:
    """Yield conversions that everyone knows."""
    for value, unit, wanted, expected in (
        (101.325, "kPa", "Pa", 101_325.0),
        (25.0, "degC", "K", 298.15),
        (36.0, "kg/h", "kg/s", 0.01),
        (7.5, "mg/stroke", "mg/cycle", 7.5),
        (600.0, "rpm", "rad/s", 62.83185307179586),
    ):
        found = convert(np.array([value]), unit, wanted)
        yield row(f"{value:g} {unit}", "definition", expected, float(found[0]), 1e-12 * expected, wanted)


def interpolation() -> Iterator[CaseOutput]:
    """Yield the weights of Eq. (10) to (13) at places where they are told by looking."""
    grid = Grid(np.array([0.0, 4.0, 8.0]), np.array([0.0, 250.0, 500.0]))
    theta = np.arange(9.0)
    for where, u, n, expected in (
        ("a node", 4.0, 250.0, 4.0),
        ("the middle of a cell", 2.0, 125.0, 2.0),
        ("an edge", 6.0, 500.0, 7.5),
        ("a point outside, where the edge value holds", 20.0, 9000.0, 8.0),
    ):
        found = grid.interpolate(theta, np.array([u]), np.array([n]))
        yield row(f"map value at {where}", "calculation by hand", expected, float(found[0]), 1e-12)


def quadratic() -> Iterator[CaseOutput]:
    """Yield Eq. (39) and (40): found again from the nodes that a drive informs, and their contradiction outside."""
    fuel, speed = KIND.air_path.axes
    grid = Grid(np.arange(0.0, 57.0, 4.0), np.arange(0.0, 4001.0, 250.0))
    u, n = np.meshgrid(grid.fuel, grid.speed)
    supported = (u <= 32.0) & (n >= 750.0) & (n <= 2500.0)
    places = {"ETC part 1, Eq. (39)": -0.007, "FTP75 cold transient, Eq. (40)": 0.0118}
    for name, coefficients in PRINTED.surfaces.items():
        known = evaluate(np.array(coefficients), u, n)
        fitted = fit(grid, np.where(supported, known, np.nan), 1e-10 * np.eye(grid.size), supported)
        worst = float(np.max(np.abs(fitted.coefficients / np.array(coefficients) - 1.0)))
        yield row(f"error of refitted coefficients, {name}", "the paper", 0.0, worst, 1e-6)
        at = int(np.searchsorted(grid.speed, 2000.0)), int(np.searchsorted(grid.fuel, 56.0))
        where, found = f"extrapolated to 56 {fuel.unit}, 2000 {speed.unit}, {name}", float(fitted.delta_W_c[at])
        yield row(where, "equation of the paper, calculated by hand", places[name], found, 5e-5, "kg/s")


def published_gain() -> Iterator[CaseOutput]:
    """Yield the proof of the paper's own L of Eq. (38) on Table 1, and that the proof can fail."""
    config, _ = load_config(EXAMPLE)
    path, known = config.engine_path(), KNOWN["published"]
    still = path.rate_bounds({name: (T, T) for name, T in config.published.temperatures.items()})
    for column, rho in PRINTED.bounds.items():
        lower, upper = zip(*rho, *still.values(), strict=True)
        region = Region(path.parameter_names, tuple(map(float, lower)), tuple(map(float, upper)))
        problem = problem_of(KIND.air_path, PRINTED.outputs, region)
        P, Q = (np.array(known[column][name]) for name in ("P", "Q"))
        for what, L, expected in (
            ("proven", PRINTED.L, 1.0),
            ("refused with one sign changed", PRINTED.L * np.array([[-1.0, 1, 1], [1, 1, 1], [1, 1, 1]]), 0.0),
        ):
            proof = check(problem, L, P, Q, *PRINTED.epsilon)
            case = f"gain L of Eq. (38) on Table 1, {column}: {what}"
            yield row(case, "exact arithmetic", expected, float(proof.proven), 0.0)


def default_gain() -> Iterator[CaseOutput]:
    """Yield the proof of a shipped gain with all states as outputs on the hull of Table 1, temperatures moving."""
    proof = _shipped_gain().certificate
    yield row("shipped gain: Theorem 1 proven", "exact arithmetic", 1.0, float(proof.proven), 0.0)
    yield row("shipped gain: number of vertices", "two to the power of seven", 128.0, float(proof.vertices), 0.0)


def chain() -> Iterator[CaseOutput]:
    """Yield the map of a drive by formula, through files and back: log, gain, estimate, extrapolation, result."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        gain, log = _files(folder)
        for method, tolerance in METHODS.items():
            estimate(EXAMPLE, log, folder / "map.h5", gain=gain, method=method)
            extrapolate(folder / "map.h5")
            result = read_result(folder / "map.h5")
            error = (result.theta - known_map(result.grid))[result.supported]
            case, basis, worst = f"known map, method {method}", "by construction", float(np.max(np.abs(error)))
            (summary,) = result.logs
            rmse = summary.metrics.rmse if summary.metrics else float("nan")
            yield row(f"{case}: 100 nodes or more", basis, 1.0, float(error.size >= 100), 0.0)
            yield row(f"{case}: largest error", basis, 0.0, worst, tolerance, "kg/s")
            yield row(f"{case}: rmse along the drive", basis, 0.0, rmse, tolerance, "kg/s")
        content = bytearray(gain.read_bytes())
        content[len(content) // 2] ^= 1
        gain.write_bytes(content)
        noticed = 0.0
        try:
            read_gain(gain)
        except DataError:
            noticed = 1.0
        yield row("a gain file with one bit changed is refused", "checksum", 1.0, noticed, 0.0)


def loop() -> Iterator[CaseOutput]:
    """Yield a fault that is put into a simulated drive and found again: plant, map, search."""
    # With it every kernel has been compiled: what runs after a self-test does not wait for the compiler.
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        clean, faulty = folder / "clean.parquet", folder / "faulty.parquet"
        (folder / "effect.toml").write_text(f'[[effect]]\nid = "maf.gain"\nfactor = {FACTOR}\n', encoding="utf-8")
        # 0 to 70 km/h and back, twice
        speeds = [f"{t},{35.0 * (1.0 - np.cos(np.pi * t / 20.0)):.2f}" for t in range(81)]
        (folder / "cycle.csv").write_text("\n".join(["time_s,speed_kmh", *speeds]), encoding="utf-8")
        simulate(EXAMPLE, str(folder / "cycle.csv"), clean, rate=20.0)
        simulate(EXAMPLE, str(folder / "cycle.csv"), faulty, rate=20.0, seed=2, effects=folder / "effect.toml")
        gain, _ = _files(folder)
        estimate(EXAMPLE, clean, folder / "map.h5", gain=gain)
        sizes = {finding.id: finding.parameters for finding in trace(folder / "map.h5", faulty).found.findings}
        case, basis = "a simulated sensor that reads 20 % high", "value put into the simulation"
        yield row(f"{case}: only maf.gain is found", basis, 1.0, float([*sizes] == ["maf.gain"]), 0.0)
        yield row(f"{case}: its factor", basis, FACTOR, sizes["maf.gain"]["factor"].value, 0.03)


CASES: dict[str, Case] = {
    case.__name__.replace("_", " "): case
    for case in (units, interpolation, quadratic, published_gain, default_gain, chain, loop)
}


def run_cases(progress: Callable[[float], None]) -> tuple[list[CaseOutput], dict[str, str]]:
    """Return the rows of all cases, and the versions of what they ran on; `progress` takes the fraction done."""
    rows: list[CaseOutput] = []
    for done, (name, case) in enumerate(CASES.items(), 1):
        rows += rows_of(name, case)
        progress(done / len(CASES))
    return rows, versions()


def _shipped_gain() -> Gain:
    known = KNOWN["default"]
    region = Region(tuple(known["names"]), tuple(known["lower"]), tuple(known["upper"]))
    L, P, Q = (np.array(known[name]) for name in ("L", "P", "Q"))
    epsilon = known["eps_1"], known["eps_2"]
    problem = problem_of(KIND.air_path, tuple(known["outputs"]), region)
    return Gain(L, P, Q, *epsilon, region, check(problem, L, P, Q, *epsilon))


def _files(folder: Path) -> tuple[Path, Path]:
    """Write the gain and the log; return their paths."""
    config, text = load_config(EXAMPLE)
    path, grid, gain, log = config.engine_path(), config.grid(), folder / "gain.h5", folder / "known.parquet"
    write_log(log, DRIVE(config.engine, partial(bilinear, grid, known_map(grid))), UNITS)
    outputs, constants = tuple(KNOWN["default"]["outputs"]), dict(path.engine_constants())
    made = StoredGain("shipped", path.name, constants, path.state_names, outputs, _shipped_gain(), {})
    write_gain(gain, made, Provenance({}, text))
    return gain, log

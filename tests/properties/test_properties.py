"""What holds for every log, unit, order and region, not only for the ones that somebody thought of."""

import re
from dataclasses import asdict, replace
from functools import partial

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.informing import informed, solved
from repository import DIESEL
from robust.defects import moving
from robust.samples import make

from lpvobs.engines.base import Trajectory
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.engines.diesel.published import PUBLISHED
from lpvobs.errors import NotProven, UsageError
from lpvobs.io.configuration.config import config_of, load_config
from lpvobs.io.logs.policies import LogPolicies
from lpvobs.io.logs.reading import read_log
from lpvobs.io.results.results import read_result, write_result
from lpvobs.maps.grid import Grid
from lpvobs.observer.estimate import MapEstimate, estimate_default
from lpvobs.observer.parts import StateGain
from lpvobs.observer.recursion import observe
from lpvobs.records import Log
from lpvobs.synthesis.problem import GainProblem
from lpvobs.synthesis.region import Region

SEEDS = st.integers(0, 2**32 - 1)
GAIN = StateGain(
    ("p_im", "p_em", "omega_t"),
    np.array([[2215.0, -4.2, 156.0, 0.0], [-113.0, 2129.0, -88.0, 0.0], [55.0, -1.1, 2015.0, 0.0]]),
)
"""As synthesis finds it for wide temperatures and a decay of 1000 1/s, without the sensor."""


def axis(rng):
    return np.cumsum(rng.uniform(0.5, 100.0, rng.integers(2, 12)))


# --- Psi ---------------------------------------------------------------------------------------------------------------


@given(SEEDS)
def test_weights_of_psi_are_four_shares_of_one_wherever_the_engine_is(seed):
    rng = np.random.default_rng(seed)
    grid = Grid(axis(rng), axis(rng))
    u, n = (rng.uniform(nodes[0] - 200.0, nodes[-1] + 200.0, 50) for nodes in (grid.fuel, grid.speed))
    u[:5], n[:5] = rng.choice(grid.fuel, 5), rng.choice(grid.speed, 5)  # on the nodes themselves
    nodes, weights = grid.regressors(u, n)
    assert weights.shape == (50, 4)
    assert (weights >= 0.0).all()
    assert (weights <= 1.0).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=0, atol=4e-16)  # four roundings of numbers under one
    assert ((nodes >= 0) & (nodes < grid.size)).all()


@given(SEEDS)
def test_a_map_never_leaves_the_range_of_its_nodes(seed):
    rng = np.random.default_rng(seed)
    grid = Grid(axis(rng), axis(rng))
    theta = rng.standard_normal(grid.size)
    u, n = rng.uniform(-200.0, 1500.0, (2, 50))
    values = grid.interpolate(theta, u, n)
    slack = 1e-15 * np.abs(theta).max()
    assert (values >= theta.min() - slack).all()
    assert (values <= theta.max() + slack).all()


# --- the estimate of many logs -----------------------------------------------------------------------------------------


def driven(seed, name):
    columns = moving(seed)
    part = slice(0, 6000)
    shift = 400.0 * np.sin(0.7 * seed)
    channels = {key: columns[key][part].copy() for key in Diesel.channels}
    channels["n_e"] += shift
    return Log(name, name, columns["time"][part], channels, {}, ((0, 6000),), np.arange(6000), _nothing(6000))


def _nothing(samples):
    from lpvobs.records import Defects

    return Defects(samples)


@pytest.fixture(scope="module")
def config():
    return load_config(DIESEL)[0]


@pytest.fixture(scope="module")
def drives():
    return [driven(seed, f"{seed:064x}") for seed in range(4)]


@pytest.fixture(scope="module")
def told_by(config, air_path, grid):
    """Return a function from logs to the bytes of their map."""

    def result(logs):
        found = estimate_default(air_path, grid, GAIN, logs, config.estimate)
        return [
            getattr(found, name).tobytes() for name in ("theta", "standard_error", "covariance", "noise", "supported")
        ]

    return result


@pytest.fixture(scope="module")
def in_order(told_by, drives):
    return told_by(drives)


@given(order=st.permutations(range(4)).filter(lambda order: order != sorted(order)))
@settings(max_examples=3)
@pytest.mark.slow
def test_the_order_of_logs_changes_no_byte(told_by, drives, in_order, order):
    assert told_by([drives[place] for place in order]) == in_order


@pytest.mark.proof
@given(order=st.permutations(range(4)), many=st.integers(1, 4))
@settings(max_examples=6)
def test_parts_merged_are_the_whole(config, air_path, grid, drives, order, many):
    """What each log tells, found alone and at any time, adds up to what all tell together."""
    chosen = [drives[place] for place in order[:many]]
    whole = estimate_default(air_path, grid, GAIN, chosen, config.estimate)
    at = whole.engine.point
    parts = [informed(air_path, grid, GAIN, log, config.estimate, at) for log in chosen]
    in_order = sorted(parts, key=lambda part: part.run.sha256)  # as the estimate adds them
    found, _ = solved(air_path, grid, config.estimate, in_order, at)
    np.testing.assert_array_equal(found.supported, whole.supported)
    np.testing.assert_allclose(found.theta, whole.theta, rtol=1e-9, atol=1e-15)  # sums in another order
    np.testing.assert_allclose(found.covariance, whole.covariance, rtol=1e-9, atol=1e-12)  # of 0.01 before any data


# --- units -------------------------------------------------------------------------------------------------------------

SPELLINGS = {
    "Pa": {"Pa": 1.0, "hPa": 1e-2, "kPa": 1e-3, "bar": 1e-5, "mbar": 1e-2},
    "K": {"K": 1.0, "degC": 1.0},
    "rpm": {"rpm": 1.0, "1/min": 1.0, "rad/s": 2.0 * np.pi / 60.0},
    "rad/s": {"rad/s": 1.0, "rpm": 60.0 / (2.0 * np.pi)},
    "kg/s": {"kg/s": 1.0, "g/s": 1e3, "kg/h": 3600.0},
    "%": {"%": 1.0, "1": 1e-2},
    "mg/cycle": {"mg/cycle": 1.0, "mg/stroke": 1.0},
    "s": {"s": 1.0, "ms": 1e3, "min": 1.0 / 60.0},
}


@given(data=st.data())
@settings(max_examples=15)
def test_units_change_nothing(tmp_path_factory, data):
    columns = {name: column[:500] for name, column in moving().items()}
    units = {"time": "s"} | {name: channel.unit for name, channel in Diesel.channels.items()}
    chosen = {name: data.draw(st.sampled_from(sorted(SPELLINGS[unit])), label=name) for name, unit in units.items()}
    folder = tmp_path_factory.mktemp("units")
    logs = []
    for number, spelled in enumerate((units, chosen)):
        values = {
            name: columns[name] * SPELLINGS[units[name]][unit] - (273.15 if unit == "degC" else 0.0)
            for name, unit in spelled.items()
        }
        fields = [pa.field(name, pa.float64(), metadata={"unit": spelled[name]}) for name in units]
        path = folder / f"{number}.parquet"
        pq.write_table(pa.table([pa.array(values[name]) for name in units], schema=pa.schema(fields)), path)
        logs.append(read_log(path, Diesel.channels, LogPolicies()))
    first, second = logs
    np.testing.assert_allclose(second.time, first.time, rtol=1e-14)  # two roundings
    for name in Diesel.channels:
        np.testing.assert_allclose(
            second[name], first[name], rtol=4e-15, atol=2e-13
        )  # degC: 273.15 is added and taken away
    assert second.defects == first.defects


# --- round trips -------------------------------------------------------------------------------------------------------


@given(data=st.data())
def test_a_configuration_is_what_it_was_after_a_round_trip(config, data):
    scale = data.draw(st.floats(0.5, 2.0))
    changed = replace(
        config,
        estimate=replace(config.estimate, prior_map=config.estimate.prior_map * scale),
        policies=LogPolicies(gap_limit=scale, backward_time=data.draw(st.sampled_from(["refuse", "drop"]))),
    )
    plain = msgspec.json.decode(msgspec.json.encode(msgspec.to_builtins(changed)))
    assert msgspec.convert(plain, type(config)) == changed


NUMBERS = [
    (place, found)
    for place, line in enumerate(DIESEL.read_text().splitlines())
    if (found := re.match(r"(\w+ *= *)(-?[0-9][0-9.e+-]*)(.*)", line)) and not line.startswith("schema")
]
"""Lines of the shipped configuration that set a number, with the number."""
BOUND = ("step", "period", "vgt_max")
"""Numbers that are at a limit, or that another one has to be a multiple of: a change is refused."""


@pytest.mark.parametrize(("place", "found"), NUMBERS, ids=lambda item: "" if isinstance(item, int) else item.group(1))
def test_no_number_of_a_configuration_is_lost_between_its_text_and_what_is_computed_with(config, place, found):
    """Every number in the text has its place in the configuration, and the text that a result keeps gives the same one again."""
    start, number, rest = found.groups()
    lines = DIESEL.read_text().splitlines()
    changed = repr(float(number) * 1.001 or 0.001) if re.search(r"[.e]", number) else str(int(number) + 1)
    lines[place] = f"{start}{changed}{rest}"
    if start.split()[0] in BOUND:
        with pytest.raises(UsageError, match=start.split()[0]):
            config_of("\n".join(lines), DIESEL)
    else:
        assert config_of("\n".join(lines), DIESEL) != config
    lines[place] = f"{start}{number}{rest}"
    assert config_of("\n".join(lines), DIESEL) == config


def test_a_result_is_what_was_written(tmp_path):
    samples = make(tmp_path)
    first = read_result(samples.result)
    estimate = MapEstimate(
        grid=first.grid, theta=first.theta, standard_error=first.standard_error, covariance=first.covariance,
        noise=first.noise, design=first.design, supported=first.supported, excitation=first.excitation,
        constants=first.constants, sensitivity=first.sensitivity, method=first.method, runs=(),
    )  # fmt: skip
    again = samples.folder / "again.h5"
    write_result(again, load_config(DIESEL)[0].engine_path(), estimate, first.logs, first.gain, first.provenance)
    second = read_result(again)
    for name in ("theta", "standard_error", "covariance", "noise", "design", "supported", "excitation", "sensitivity"):
        np.testing.assert_array_equal(getattr(second, name), getattr(first, name))
    for name in ("air_path", "method", "constants", "provenance"):
        assert getattr(second, name) == getattr(first, name)
    for one, other in zip(second.logs, first.logs, strict=True):
        np.testing.assert_equal(asdict(one), asdict(other))
    np.testing.assert_equal(asdict(second.gain), asdict(first.gain))


@pytest.mark.slow
def test_a_map_without_covariance_and_constants_is_what_was_written(tmp_path):
    """As the observer leaves it that is published."""
    samples = make(tmp_path)
    first = read_result(samples.result)
    unknown = np.full_like(first.covariance, np.nan)
    estimate = MapEstimate(
        method="published", grid=first.grid, theta=first.theta, covariance=unknown, noise=unknown, design=first.design,
        standard_error=np.full_like(first.standard_error, np.nan),
        supported=first.supported, excitation=first.excitation, runs=(), constants=(),
        sensitivity=np.empty((0, *first.grid.shape)),
    )  # fmt: skip
    again = samples.folder / "again.h5"
    write_result(again, load_config(DIESEL)[0].engine_path(), estimate, first.logs, first.gain, first.provenance)
    second = read_result(again)
    assert np.isnan(second.covariance).all()
    assert np.isnan(second.standard_error).all()
    assert (second.constants, second.sensitivity.shape) == ((), (0, *first.grid.shape))


# --- the discrete Lyapunov function ------------------------------------------------------------------------------------


def random_region(rng):
    """Return a random box inside of Table 1's, with temperatures that stand still or move."""
    names = Diesel.parameter_names
    fixed = ((287 * 310 / 5e-3,) * 2, (286 * 750 / 1.5e-3,) * 2)
    moving_temperatures = ((287 * 280 / 5e-3, 287 * 400 / 5e-3), (286 * 500 / 1.5e-3, 286 * 1100 / 1.5e-3))
    bounds = (*PUBLISHED.bounds[rng.choice(["ETC", "NEDC"])], *(fixed if rng.random() < 0.5 else moving_temperatures))
    lower, upper = [], []
    for low, high in bounds:
        a, b = np.sort(rng.uniform(low, high, 2)) if high > low else (low, high)
        lower.append(float(a))
        upper.append(float(b))
    return Region(names, tuple(lower), tuple(upper))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.slow
def test_the_lyapunov_function_never_rises_on_a_random_polytope_at_any_step(seed):
    """Theorem 1 through backward Euler, from synthesis to the compiled recursion, with zero noise."""
    from lpvobs.synthesis.solve import synthesise

    rng = np.random.default_rng(seed)
    outputs, grid = ("p_im", "p_em", "omega_t"), Grid(np.arange(0.0, 57.0, 8.0), np.arange(0.0, 4001.0, 500.0))
    region = random_region(rng)
    problem = GainProblem(partial(Diesel.system, outputs=outputs), region, len(outputs))
    try:
        gain = synthesise(problem, cascade=bool(seed % 2))
    except NotProven as refusal:
        pytest.fail(f"seed {seed}: a box inside of Table 1 has a gain with p_em among the outputs: {refusal}")
    low, high = np.array(region.lower), np.array(region.upper)
    for _ in range(15):
        gamma = 10.0 ** rng.uniform(-2, 4)
        x = rng.standard_normal(3) / np.sqrt(np.diag(gain.P))
        theta = rng.standard_normal(grid.size) * np.sqrt(gamma) * 10.0 ** rng.uniform(-2, 2)
        before = x @ gain.P @ x + theta @ theta / gamma
        for _ in range(12):
            rho = low + rng.random(low.size) * (high - low)
            A, C = (np.tile(np.array(part, dtype=float), (2, 1, 1)) for part in Diesel.system(list(rho), outputs))
            still = Trajectory(np.tile(rho, (2, 1)), A, np.zeros((2, 3)), C, np.zeros((2, 4)))
            place = np.full(2, rng.uniform(-5.0, 60.0)), np.full(2, rng.uniform(300.0, 4500.0))
            h = 10.0 ** rng.uniform(-6, 3)
            found = observe(still, np.array([0.0, h]), ((0, 2),), place, grid, gain.L, gamma, x[None, :], theta)
            x, theta = found.x[-1], found.theta
            after = x @ gain.P @ x + theta @ theta / gamma
            assert after <= before * (1.0 + 1e-9)  # rounding of a stiff 4 x 4 solve
            before = after


# --- NaN ---------------------------------------------------------------------------------------------------------------


def holed(folder, seed):
    """Return a log in whose file, in whichever channel, something is not a number."""
    rng = np.random.default_rng(seed)
    columns = {name: column[:4000].copy() for name, column in moving().items()}
    for _ in range(rng.integers(1, 8)):
        name = rng.choice(list(columns))
        start, length = rng.integers(0, 4000), rng.choice([1, 3, 50, 400])
        columns[name][start : start + length] = rng.choice([np.nan, np.inf, -np.inf])
    units = {"time": "s"} | {name: channel.unit for name, channel in Diesel.channels.items()}
    fields = [pa.field(name, pa.float64(), metadata={"unit": units[name]}) for name in units]
    path = folder / "drive.parquet"
    pq.write_table(pa.table([pa.array(columns[name]) for name in units], schema=pa.schema(fields)), path)
    return read_log(path, Diesel.channels, LogPolicies())


@given(seed=SEEDS)
@settings(max_examples=12)
def test_nan_never_enters_a_state(tmp_path_factory, air_path, grid, seed):
    log = holed(tmp_path_factory.mktemp("nan"), seed)
    assert all(np.isfinite(log[name]).all() for name in Diesel.channels)
    trajectory = air_path.trajectory(log, GAIN.outputs)
    for part in (trajectory.A, trajectory.E, trajectory.C, trajectory.y, trajectory.parameters):
        assert np.isfinite(part).all()
    firsts = np.array([[log["p_im"][start], log["p_em"][start], log["omega_t"][start]] for start, _ in log.segments])
    point = log["u_delta"], log["n_e"]
    run = observe(trajectory, log.time, log.segments, point, grid, GAIN.L, 200.0, firsts, np.zeros(grid.size))
    assert np.isfinite(run.x).all()
    assert np.isfinite(run.theta).all()


@given(seed=SEEDS)
@settings(max_examples=4)
@pytest.mark.slow
def test_nan_never_enters_a_map(tmp_path_factory, air_path, grid, config, seed):
    """Map and errors of what is supported are numbers."""
    log = holed(tmp_path_factory.mktemp("nan"), seed)
    found = estimate_default(air_path, grid, GAIN, [log], config.estimate)
    assert np.isfinite(found.theta[found.supported]).all()
    assert np.isfinite(found.standard_error[found.supported]).all()

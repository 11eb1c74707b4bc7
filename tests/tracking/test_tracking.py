"""A fleet of rows that are drawn here: what is known of it is known exactly, and a dense twin says what the numerics must find."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import block_diag

from lpvobs.maps.grid import Grid
from lpvobs.maps.quadratic import scaled_terms
from lpvobs.tracking.changes import LOGS, history, power_of
from lpvobs.tracking.fleet import Fleet, track
from lpvobs.tracking.maps import OverTime, TypeMap, _Pool
from lpvobs.tracking.sums import MODES, Basis, kept
from lpvobs.tracking.timeline import CHANGE, Event, Fleetwide, vehicle_of

GRID = Grid(np.linspace(0.0, 30.0, 4), np.linspace(1000.0, 2500.0, 4))
FUEL, SPEED = (axis.ravel() for axis in np.meshgrid(GRID.fuel, GRID.speed))
FLOW = 1e-5 * SPEED + 2e-4 * FUEL
TERMS = scaled_terms(GRID, FUEL, SPEED)
NOTHING = np.zeros(FLOW.size)
BASIS = Basis(np.eye(1), np.eye(2), np.zeros(2), FLOW, NOTHING, TERMS, 1.0, NOTHING, np.zeros((FLOW.size, 2)))
NOISE = 2e-4
PRIOR = 0.1
MONTH = 365.25 / 12
SIZES = Fleetwide(0.01, 0.01, 0.01, 0.001)
MONTHS = np.arange(24) / 2


def log_of(seed, vehicle, months, gain=0.0, level=0.0, noise=NOISE):
    """Return what is kept of a log whose sensor reads a share and a level more than its map says, and its rows."""
    rng = np.random.default_rng(seed)
    n, p = 300, FLOW.size
    fuel, speed = rng.uniform(0.0, 30.0, n), rng.uniform(1000.0, 2500.0, n)
    nodes, weights = GRID.regressors(fuel, speed)
    Psi = np.zeros((n, p))
    np.put_along_axis(Psi, nodes, weights, axis=1)
    J = 1e-3 * rng.standard_normal((n, 2)) + 2e-3
    theta = 1e-3 * np.sin(FUEL / 9.0) + gain * FLOW + level
    z = Psi @ theta + J @ (0.7, -0.4) + noise * rng.standard_normal(n)
    rows = np.column_stack([Psi, J, Psi @ FLOW, z]) / NOISE
    run = SimpleNamespace(sha256=f"{vehicle}{seed:04}", duration=300.0)
    part = SimpleNamespace(run=run, cells=np.arange(9), gram=np.tile(np.eye(4), (9, 1, 1)))
    found = kept(part, rows.T @ rows, BASIS, ("log", vehicle, "one", 20000.0 + MONTH * months), 9)
    return found.log, found.sums, rows


def sums_of(made):
    total = made[0][1]
    for _, own, _ in made[1:]:
        total = total.plus(own)
    return total


def vehicle(made):
    return vehicle_of(sums_of(made), [log for log, _, _ in made], BASIS, PRIOR)


def drives(seed, name="a", gain=lambda _: 0.0, **more):
    return [log_of(100 * seed + i, name, month, gain(month), **more) for i, month in enumerate(MONTHS)]


def test_the_evidence_is_that_of_a_dense_twin():
    made = drives(1, gain=lambda month: 0.002 * month)[:5]
    found = vehicle(made)
    p, rows = FLOW.size, [each for *_, each in made]
    modes = np.column_stack([TERMS, FLOW]) * CHANGE
    dense = np.vstack([each[:, : p + 2] for each in rows])
    moving = np.zeros((dense.shape[0], 5 * MODES))
    begin = 0
    for i, each in enumerate(rows):
        moving[begin : begin + len(each), i * MODES : (i + 1) * MODES] = each[:, :p] @ modes
        begin += len(each)
    z = np.concatenate([each[:, -1] for each in rows])
    K = found.prior(SIZES, (Event("trend"),))
    shared = np.diag(np.where(np.arange(p + 2) < p, PRIOR**2, 1.0))
    common = np.tile(np.eye(MODES), (5, 1)) @ np.tile(np.eye(MODES), (5, 1)).T * 1e3

    def logarithm(prior):
        full = np.eye(z.size) + dense @ shared @ dense.T + moving @ (prior + common) @ moving.T
        return -0.5 * z @ np.linalg.solve(full, z) - 0.5 * np.linalg.slogdet(full)[1]

    expected = logarithm(K) - logarithm(0.0 * K)
    assert found.evidence(SIZES, (Event("trend"),)) == pytest.approx(expected, rel=1e-4)


def test_a_healthy_vehicle_has_no_history():
    assert [history(vehicle(drives(seed)), SIZES).events for seed in range(2, 6)] == [()] * 4


@pytest.mark.parametrize("month", [3.25, 8.25])
def test_a_step_is_found_where_it_is(month):
    (event,) = history(vehicle(drives(7, gain=lambda now: 0.03 * (now > month))), SIZES).events
    assert event.kind == "step"
    assert event.day * 12 == pytest.approx(month, abs=0.01)
    assert event.earliest * 12 <= month <= event.latest * 12


def test_a_drift_is_no_step_and_a_new_sensor_ends_it():
    (event,) = history(vehicle(drives(8, gain=lambda now: 0.005 * now)), SIZES).events
    assert event.kind == "trend"
    events = history(vehicle(drives(9, gain=lambda now: 0.007 * now * (now < 7.25))), SIZES).events
    assert [each.kind for each in events] == ["trend", "renewal"]
    assert events[1].day * 12 == pytest.approx(7.25, abs=0.01)


def fleet():
    made = {f"v{i}": drives(20 + i, f"v{i}") for i in range(5)}
    made["v0"] = drives(30, "v0", gain=lambda now: 0.004 * now)
    made["v1"] = drives(31, "v1", gain=lambda now: 0.03 * (now > 5.25))
    made["v4"] = made["v4"][:1]
    return made


def tracked(made):
    logs = [log for own in made.values() for log, *_ in own]
    periods = {log.sha256: f"{log.date // MONTH:.0f}" for log in logs}
    return track(GRID, BASIS, [sums_of(own) for own in made.values()], logs, periods, PRIOR, 0.1)


def test_a_fleet_has_trends_changes_and_maps():
    found = tracked(fleet())
    standing = {each.vehicle: each for each in found.vehicles}
    assert [standing[f"v{i}"].verdict for i in range(5)] == ["drifts", "changed", "steady", "steady", "steady"]
    assert standing["v0"].trend[1] == pytest.approx(0.004, abs=3 * standing["v0"].trend_error[1])
    (change,) = found.changes
    assert (change.vehicle, change.kind) == ("v1", "step")
    assert change.size[1] == pytest.approx(0.03, abs=3 * change.size_error[1])
    assert {each.vehicle for each in found.worst_first()[:2]} == {"v0", "v1"}
    last = [each for each in found.maps if each.vehicle == "v1"][-1]
    truth = 1e-3 * np.sin(FUEL / 9.0) + 0.03 * FLOW
    assert np.all(np.abs(last.theta - truth) < 4 * last.standard_error + 1e-5)


def test_a_member_of_a_type_knows_more_than_it_drove():
    made = fleet()
    together = [each for each in tracked(made).maps if each.vehicle == "v4"][-1]
    alone = [each for each in tracked({"v4": made["v4"]}).maps if each.vehicle == "v4"][-1]
    assert together.standard_error.mean() < 0.9 * alone.standard_error.mean()


def test_sums_add_up_in_pieces():
    made = drives(40)
    whole = sums_of(made)
    parts = sums_of(made[:10]).plus(sums_of(made[10:]))
    np.testing.assert_allclose(parts.whole(BASIS.size), whole.whole(BASIS.size), rtol=1e-12)


def power(made, sizes=SIZES):
    return {each.logs: each for each in power_of([vehicle(own) for own in made], sizes)}


def test_a_drift_of_the_size_stated_is_found_and_a_small_one_is_not():
    stated = power([drives(seed, f"v{seed}") for seed in range(50, 53)])[MONTHS.size]

    def found(share):
        slope = share * stated.drift
        made = [drives(60 + seed, gain=lambda month: slope * month) for seed in range(6)]
        return sum(bool(history(vehicle(each), SIZES).events) for each in made)

    assert found(1.0) >= 5
    assert found(0.1) == 0


def test_more_logs_and_quieter_days_show_less():
    made = [drives(seed, f"v{seed}") for seed in (54, 55)]
    quiet, restless = power(made), power(made, Fleetwide(0.03, 0.03, 0.03, 0.001))
    for now, later in pairwise(LOGS[:3]):
        assert quiet[later].drift < quiet[now].drift < restless[now].drift
        assert quiet[later].step < quiet[now].step < restless[now].step


def test_one_log_each_shows_no_change():
    assert power([drives(seed, f"v{seed}")[:1] for seed in (56, 57)]) == {}


def moved(made, sizes, pair, kind):
    periods = {log.sha256: f"{log.date:.0f}" for log, *_ in made}
    return Fleet(GRID, 0.1, periods, sizes).moved(vehicle(made), pair, kind)


@pytest.mark.parametrize("slope", [0.0, 0.02])
def test_what_moved_between_two_periods_is_that_of_a_dense_twin(slope):
    sizes, made = replace(SIZES, walk=0.1), drives(70, gain=lambda month: slope * month)[:8]
    p, L, pair = FLOW.size, len(made), (1, 5)
    kind = TypeMap("one", np.full(p, 1e-4), 1e-10 * np.eye(p), 1e-8 * (np.eye(p) + 1.0))
    on, values, covariance = moved(made, sizes, [f"{made[i][0].date:.0f}" for i in pair], kind)
    assert on.tolist() == list(range(p))
    own = vehicle(made)
    story = history(own, sizes)
    assert bool(story.events) == bool(slope)
    # Unknown are the map, the engine, what all days have in common, and on the day of each log what lasts and what does not.
    at = sizes.uneasy(story.factor)
    lasting = own.process(at, story.events, own.day, own.day)
    passing = np.diag(np.tile(at.daily, L))
    prior = block_diag(PRIOR**2 * np.eye(p), np.eye(2), 1e3 * np.eye(MODES), lasting, passing)
    Phi = np.column_stack([TERMS, FLOW]) * CHANGE

    def standing(Psi, engine, day, passes):
        """Return rows of all unknowns on a day, of nodes with weights Psi."""
        of_day = np.kron(np.eye(L)[day], Psi @ Phi)
        return np.column_stack([Psi, engine, Psi @ Phi, of_day, passes * of_day])

    maps = [standing(np.eye(p), np.zeros((p, 2)), day, 0.0) for day in (*pair, -1)]
    H = np.vstack([*(standing(rows[:, :p], rows[:, p : p + 2], i, 1.0) for i, (*_, rows) in enumerate(made)), maps[-1]])
    z = np.concatenate([*(rows[:, -1] for *_, rows in made), kind.mean])  # the type's map is a reading of the last one
    noise = block_diag(np.eye(z.size - p), kind.between + kind.covariance)
    gain = np.linalg.solve(H @ prior @ H.T + noise, H @ prior).T
    error = prior - gain @ H @ prior
    expected = (maps[1] - maps[0]) @ error @ (maps[1] - maps[0]).T
    lack = 0.02 * (values[1] - values[0])
    np.testing.assert_allclose(values, [each @ gain @ z for each in maps[:2]], atol=1e-9)
    np.testing.assert_allclose(
        covariance, expected + np.outer(lack, lack), rtol=0.01, atol=0.01 * np.diag(expected).min()
    )
    # Both maps err alike where the engine does: apart from each other they are surer than each by itself.
    alone = [each @ error @ each.T for each in maps[:2]]
    assert np.all(np.diag(expected) < np.diag(alone[0] + alone[1]))


def test_the_map_of_a_type_has_the_restricted_likelihood_of_a_dense_twin():
    rng, p, Phi = np.random.default_rng(80), FLOW.size, np.column_stack([TERMS, FLOW])
    maps, empty = [], np.zeros((1, MODES, p))
    for _ in range(4):
        on = np.sort(rng.choice(p, 12, replace=False))
        root = 1e-4 * rng.standard_normal((12, 12))
        errors = root @ root.T + 1e-9 * np.eye(12)
        mean = 1e-3 * rng.standard_normal((1, 12))
        maps.append(OverTime(on, mean, errors, np.diag(errors)[None], Phi[on] * CHANGE, empty))
    d, node = CHANGE * np.linspace(0.3, 1.0, MODES), 5e-4
    information, right, likelihood = _Pool(maps, Phi, PRIOR, node).with_modes(d)
    # All maps beside each other: the type's nodes seen through X, with the covariance V of how vehicles differ and are known.
    X = np.vstack([np.eye(p)[each.nodes] for each in maps])
    y = np.concatenate([each.mean[-1] for each in maps])
    V = block_diag(*(each.last + node**2 * np.eye(12) + (Phi[each.nodes] * d**2) @ Phi[each.nodes].T for each in maps))
    expected = X.T @ np.linalg.solve(V, X) + np.eye(p) / PRIOR**2
    np.testing.assert_allclose(information, expected, rtol=1e-6, atol=1e-9 * expected.max())
    np.testing.assert_allclose(right, X.T @ np.linalg.solve(V, y), rtol=1e-6, atol=1e-9 * np.abs(right).max())
    fit = right @ np.linalg.solve(expected, right)
    dense = 0.5 * (fit - y @ np.linalg.solve(V, y) - np.linalg.slogdet(V)[1] - np.linalg.slogdet(expected)[1])
    assert likelihood == pytest.approx(dense, rel=1e-9)


def test_what_formulas_left_when_the_flow_was_known_is_taken_off_every_row():
    """Psi theta + (J + Psi R) E c = z - J mean - Psi left, row by row."""
    rng, p = np.random.default_rng(8), FLOW.size
    left, R, E, mean = rng.standard_normal(p), rng.standard_normal((p, 2)), rng.standard_normal((2, 2)), np.ones(2)
    basis = replace(BASIS, engine=E, mean=mean, left=left, response=R @ E)
    layout = basis.layout
    row = np.zeros(layout.size)
    Psi, J, z = row[:p], row[p : p + 2], 3.0
    Psi[:4], J[:], row[layout.z] = [0.1, 0.2, 0.3, 0.4], [5.0, -2.0], z
    found = row @ basis.columns()
    np.testing.assert_allclose(found[:p], Psi)
    np.testing.assert_allclose(found[p : p + 2], (J + Psi @ R) @ E)
    assert found[-1] == pytest.approx(z - J @ mean - Psi @ left)

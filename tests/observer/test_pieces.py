"""A log in pieces gives what the whole gives, to the bit: a segment may be cut anywhere, and pieces may be of any size."""

import gc
import weakref
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.drives import noisy
from reference.informing import informed

from lpvobs.errors import DataError
from lpvobs.observer import parts, smoothing
from lpvobs.observer.estimate import estimate_default
from lpvobs.observer.log_run import RangeSeen, running_sum
from lpvobs.observer.smoothing import smooth, stretches
from lpvobs.records import Log, Piece


@dataclass(frozen=True)
class Cut:
    """A log that comes in pieces, cut before the samples named."""

    log: Log
    cuts: tuple[int, ...]

    def __getattr__(self, name):
        return getattr(self.log, name)

    def pieces(self):
        (whole,) = self.log.pieces()
        ends = sorted({0, *(cut % whole.time.size for cut in self.cuts), whole.time.size})
        for start, stop in pairwise(ends):
            part = slice(start, stop)
            channels = {name: column[part] for name, column in whole.channels.items()}
            yield Piece(whole.time[part], channels, whole.begins[part])


def with_gaps(log, starts):
    """Return the log cut into segments at the samples given, a minute apart."""
    time = log.time.copy()
    for start in starts:
        time[start:] += 60.0
    return replace(log, time=time, segments=tuple(zip([0, *starts], [*starts, len(log)], strict=True)))


@pytest.fixture(scope="module")
def short(drive):
    """Return 8000 noisy samples in five segments, two of them of one and of two samples."""
    log = noisy(drive[0], 3)
    part = replace(
        log, time=log.time[:8000], channels={n: c[:8000] for n, c in log.channels.items()}, rows=log.rows[:8000]
    )
    return with_gaps(part, [1500, 1501, 1503, 6000])


@pytest.mark.parametrize("slower", [1.0, 20.0], ids=["ten neighbours", "fewer than two neighbours in a window"])
@given(st.lists(st.integers(1, 7999), max_size=30))
@settings(max_examples=20)
def test_cut_anywhere_the_smoothed_signals_are_those_of_the_whole(short, slower, cuts):
    names, short = ("p_im", "T_em"), replace(short, time=slower * short.time)
    found = list(stretches(Cut(short, tuple(cuts)).pieces(), names, 0.05))
    values, rates = smooth(short.time, np.stack([short[name] for name in names]), short.segments, 0.05)
    np.testing.assert_array_equal(np.concatenate([s.time for s in found]), short.time)
    for row, name in enumerate(names):
        np.testing.assert_array_equal(np.concatenate([s.values[name] for s in found]), values[row])
        np.testing.assert_array_equal(np.concatenate([s.rates[name] for s in found]), rates[row])
        np.testing.assert_array_equal(np.concatenate([s.channels[name] for s in found]), short[name])
    starts = np.cumsum([0, *(s.time.size for s in found)])[:-1]
    begun = [at for at, s in zip(starts, found, strict=True) if s.before is None]
    assert begun == [start for start, _ in short.segments]


def equal(a, b):
    for name in ("columns", "products", "slow", "windows", "cells", "gram"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    for name in ("lower", "upper", "duration", "samples"):
        np.testing.assert_array_equal(getattr(a.run, name), getattr(b.run, name))


@pytest.mark.parametrize("cuts", [(1,), (1500,), (1501, 1502, 1503, 1504), tuple(range(2, 8000, 7)), (4095, 4096)])
@pytest.mark.slow
def test_chunked_equals_whole_to_the_bit(air_path, grid, gain, settings, short, cuts):
    equal(informed(air_path, grid, gain, short, settings), informed(air_path, grid, gain, Cut(short, cuts), settings))


@pytest.mark.parametrize("block", [64, 1000, 10_000])
def test_the_size_of_the_blocks_changes_no_bit(air_path, grid, gain, settings, short, monkeypatch, block):
    before = informed(air_path, grid, gain, short, settings)
    monkeypatch.setattr(smoothing, "BLOCK", block)
    equal(before, informed(air_path, grid, gain, short, settings))


def test_a_fit_has_the_bits_of_its_window_alone():
    """Samples are fitted side by side: one that lies in a neighbour's window adds nothing to what it is no part of."""
    rng = np.random.default_rng(4)
    N, half_width = 1400, 0.05
    time, columns = np.cumsum(rng.uniform(0.005, 0.015, N)), 1e5 + 1e3 * rng.standard_normal((2, N))
    values, rates = smooth(time, columns, ((0, N),), half_width)
    for k in range(300, 1100):
        within = np.flatnonzero(np.abs(time - time[k]) < half_width)
        part = slice(within[0], within[-1] + 1)
        alone = smooth(time[part], np.ascontiguousarray(columns[:, part]), ((0, within.size),), half_width)
        np.testing.assert_array_equal(np.stack(alone)[:, :, k - part.start], (values[:, k], rates[:, k]))


@pytest.mark.slow
def test_the_order_of_the_logs_does_not_move_a_bit(air_path, grid, gain, settings, drive, other_drive):
    logs = [
        replace(noisy(log, seed), sha256=digest, name=digest)
        for log, seed, digest in ((drive[0], 1, "b"), (other_drive[0], 2, "a"), (drive[0], 3, "c"))
    ]
    forward, backward = (estimate_default(air_path, grid, gain, order, settings) for order in (logs, logs[::-1]))
    for name in ("theta", "covariance", "sensitivity", "design", "excitation"):
        np.testing.assert_array_equal(getattr(forward, name), getattr(backward, name))
    assert [run.name for run in forward.runs] == ["b", "a", "c"]


@given(st.lists(st.floats(0, 1e3), min_size=1, max_size=60), st.integers(0, 60))
def test_a_sum_goes_on_where_it_stopped(values, cut):
    values = np.array(values)
    assert running_sum(running_sum(0.0, values[:cut]), values[cut:]) == running_sum(0.0, values)


class Half:
    """A region of one parameter: what is not negative."""

    def contains(self, parameters):
        return parameters[:, 0] >= 0.0


def test_ranges_times_and_shares_add_up():
    seen = RangeSeen(2, Half())
    parameters = np.array([[-1.0, 7.0], [2.0, 5.0], [1.0, 9.0], [1.0, 6.0]])
    time, steps, reading = (
        np.array([3.0, 3.5, 9.0, 9.25]),
        np.array([0.0, 0.5, 0.0, 0.25]),
        np.array([1.0, 2.0, 4.0, 5.0]),
    )
    for part in (slice(0, 1), slice(1, 4)):
        seen.see(parameters[part], time[part], steps[part], reading[part])
    assert seen.started == 3.0
    run = seen.run(Log("name", "digest", *[None] * 6))
    assert (run.samples, run.duration, run.share_certified, run.mean_flow) == (4, 0.75, 3 / 4, 3.0)
    assert (run.lower.tolist(), run.upper.tolist()) == ([-1.0, 5.0], [2.0, 9.0])
    assert np.isnan(RangeSeen(2, None).started)


def test_a_recording_without_samples_is_refused(air_path, grid, gain, settings, short):
    class Nothing(Cut):
        def pieces(self):
            yield from ()

    with pytest.raises(DataError, match="gap"):
        informed(air_path, grid, gain, Nothing(short, ()), settings)


def test_nothing_of_a_log_waits_for_the_garbage_collector(air_path, grid, gain, short, settings, monkeypatch):
    """Sums have tens of megabytes: kept until garbage is looked for, those of many logs would fill the memory."""
    made = []

    class Noted(parts.Windows):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            made.append(weakref.ref(self))

    monkeypatch.setattr(parts, "Windows", Noted)
    gc.disable()
    try:
        informed(air_path, grid, gain, short, settings)
        assert [each() for each in made] == [None]
    finally:
        gc.enable()

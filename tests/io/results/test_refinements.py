"""What refine and trace store comes back as it was, with units and axes on everything."""

import h5py
import numpy as np
import pytest

from lpvobs.discovery.courses import Curve
from lpvobs.discovery.held_out import Comparison
from lpvobs.discovery.known_effects import KnownEffect, Span
from lpvobs.discovery.outcome import Ranked
from lpvobs.discovery.portrait import Partial, Portrait, Track
from lpvobs.discovery.thresholds import LAGS
from lpvobs.discovery.whiteness import Leftover, Stretch, Whiteness
from lpvobs.io.results.hdf import write_group
from lpvobs.io.results.mapping import read_if_there, read_rows, rows, write
from lpvobs.io.results.refinements import (
    StoredRefinement,
    read_structure,
    write_comparison,
    write_portrait,
    write_refinement,
    write_structure,
)

BALANCES = ("one", "other")
LAG = KnownEffect(
    "maf.lag",
    "sensor",
    "tau",
    "s",
    0.08,
    (0.079, 0.081),
    (Span("a", "1" * 64, -np.inf, np.inf),),
    True,
    None,
    inside=0.012,
)
HEAT = KnownEffect(
    "channel:heat",
    "sensor",
    "amplitude",
    "1",
    1.02,
    (0.9, 1.1),
    (Span("a", "1" * 64, 12.5, np.inf), Span("b", "2" * 64, np.inf, np.inf), Span("c", "3" * 64, -np.inf, 80.0)),
    False,
    Curve("heat", "rate", "maf.gain", np.array([-1.0, 0.0, 2.0]), np.array([-0.1, 0.0, 0.3])),
)


def same(a, b):
    return all(
        np.array_equal(x, y) if isinstance(x, np.ndarray) else x == y
        for x, y in zip(vars(a).values(), vars(b).values(), strict=True)
    )


def whiteness(rng):
    return Whiteness(
        white=False,
        autocorrelation=rng.standard_normal((2, LAGS)),
        band=rng.random((2, LAGS)),
        p_values=rng.random(2),
        periodogram_distance=rng.random(2),
        periodogram_band=0.1,
        correlated_with={},
    )


@pytest.fixture
def file(tmp_path):
    with h5py.File(tmp_path / "some.h5", "w") as file:
        yield file


def test_a_refinement_comes_back(file):
    rng = np.random.default_rng(1)
    stored = StoredRefinement((LAG, HEAT), {"V_d": 0.004, "J_t": -0.01}, {"V_d": 0.002, "J_t": 0.005}, True, "{}")
    structure = {"before": whiteness(rng), "after": whiteness(rng)}
    comparisons = {"(all)": (Comparison(2e-3, 1e-3, 0.5, (0.4, 0.6)), False)}
    group = write_refinement(file, stored)
    write_comparison(group, comparisons)
    write_structure(group, structure, BALANCES)
    again = read_if_there(file.get("refinement"), StoredRefinement)
    assert again.effects[0] == LAG
    assert again.effects[1].spans == HEAT.spans
    assert same(again.effects[1].curve, HEAT.curve)
    assert (again.constants, again.deviations, again.map_stood, again.json) == (
        stored.constants,
        stored.deviations,
        True,
        "{}",
    )
    for name, found in read_structure(file["refinement"]).items():
        assert same(found, structure[name])


def test_a_result_without_refinement_has_none(file):
    for name, record in (("refinement", StoredRefinement), ("plots", Portrait), ("leftover", Leftover)):
        assert read_if_there(file.get(name), record) is None
    assert read_rows(file.get("ranking"), Ranked, "candidate") == ()


def test_plots_come_back(file):
    rng = np.random.default_rng(2)
    half = np.float32  # a figure shows no more
    track = Track(
        "a", np.arange(5.0), *(rng.random((2, 2, 5)).astype(half).astype(float) for _ in range(2)), rng.random(5) > 0.5
    )
    partial = Partial("maf.lag", *(rng.random(7).astype(half).astype(float) for _ in range(2)), rng.random((3, 4)))
    seen = Portrait(
        balances=BALANCES,
        tracks=(track,),
        partials=(partial,),
        block=2.0,
        blocks=8,
        frequency=np.arange(1.0, 4.0),
        spectrum=rng.random((2, 2, 3)),
        cumulated=rng.random((2, 2, 4)),
        signals=("n_e", "heat"),
        cross=rng.random((2, 2, 2 * LAGS + 1)),
        cross_limit=rng.random((2, 2, 2 * LAGS + 1)),
        effective=rng.random((2, 2)),
    )
    write_portrait(file, seen)
    again = read_if_there(file.get("plots"), Portrait)
    assert same(again.tracks[0], track)
    assert same(again.partials[0], partial)
    for name in ("balances", "block", "blocks", "signals"):
        assert getattr(again, name) == getattr(seen, name)
    for name in ("frequency", "spectrum", "cumulated", "cross", "cross_limit", "effective"):
        assert np.array_equal(getattr(again, name), getattr(seen, name))


def test_ranking_and_leftover_come_back(file):
    ranking = (Ranked("maf.lag", 0.08, "s", 120.0, 1.2), Ranked("maf.delay", 0.07, "s", 110.0, 2.0))
    write_group(file, "ranking", rows(ranking, "candidate"))
    assert read_rows(file.get("ranking"), Ranked, "candidate") == ranking
    left = Leftover((Stretch("a", 10.0, 30.0, 0.7),), (4.0, 8.0), (1000.0, 1250.0), 3.2, 0.02, "one", {"heat": 0.4})
    write(file, "leftover", left)
    assert read_if_there(file.get("leftover"), Leftover) == left


def test_everything_has_unit_and_meaning(file):
    test_a_refinement_comes_back(file)
    test_plots_come_back(file)
    bare = []
    file.visititems(
        lambda name, item: (
            bare.append(name)
            if isinstance(item, h5py.Dataset) and not {"units", "long_name"} <= set(item.attrs)
            else None
        )
    )
    assert bare == []

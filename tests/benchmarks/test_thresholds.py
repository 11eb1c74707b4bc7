"""The tuned numbers of the search: their table, and the numbers that remember how near a decision came."""

import importlib.util
import json
import math
import sys
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from repository import ROOT

HOME = ROOT / "benchmarks" / "thresholds"
sys.path[:0] = [str(HOME)]

import table  # noqa: E402
import watch  # noqa: E402


@pytest.fixture
def recorder():
    watch.RECORDER.seen.clear()
    return watch.RECORDER


def test_every_tuned_number_says_its_unit_its_meaning_and_what_set_it():
    found = table.read_table(ROOT)
    assert found
    assert len({entry.name for entry in found}) == len(found)


def test_a_number_without_them_is_refused(tmp_path):
    source = tmp_path / table.SOURCE
    source.parent.mkdir(parents=True)
    source.write_text('MOST = 3\n"""Effects at most."""\n')
    with pytest.raises(ValueError, match="MOST: its docstring is 'Effects"):
        table.read_table(tmp_path)


SIZES = st.floats(0.1, 10.0)


@given(SIZES, SIZES, SIZES, SIZES)
def test_the_factor_that_is_recorded_turns_the_decision(threshold, a, b, c):
    watch.RECORDER.seen.clear()
    said = a * watch.watched("T", threshold) - c < b
    assert said == (a * threshold - c < b)
    (record,) = watch.RECORDER.seen.values()
    factor = (b + c) / (a * threshold)  # by hand: a f T - c = b
    assert record.nearest == pytest.approx(max(factor, 1.0 / factor), rel=1e-6)
    assert record.near == (record.nearest <= 2.0)
    for beyond, turned in ((1.001, True), (0.999, False)):
        direction = beyond if factor > 1.0 else 1.0 / beyond
        if abs(math.log(factor)) > 0.01:
            assert ((a * factor * direction * threshold - c < b) != said) == turned


@pytest.mark.parametrize(
    "decide",
    [
        lambda T: np.array([1.0, 5.0, 9.0]) > T,
        lambda T: np.array([1.0, 5.0, 9.0]) >= T,
        lambda T: np.maximum(np.array([1.0, 5.0, 9.0]), T),
        lambda T: np.clip(np.array([1.0, 5.0, 9.0]), -T, T),
        lambda T: np.array([1.0, 5.0, 9.0]) > np.array([2.0, 2.0, 2.0]) * T / 2.0,
        lambda T: max(np.float64(5.0), T),
        lambda T: np.float64(5.0) > T,
        lambda T: T > 5.0,
        lambda T: np.sqrt(T) < math.sqrt(5.0),
    ],
)
def test_decisions_are_taken_and_seen_wherever_a_threshold_stands(recorder, decide):
    seen = decide(watch.watched("T", 4.0))
    np.testing.assert_array_equal(np.asarray(seen, float), np.asarray(decide(4.0), float))
    nearest = recorder.of("T").nearest
    assert nearest == pytest.approx(1.25, rel=0.02)  # five over four; the root is straight over a quarter to 1.2 %
    assert recorder.of("T").near >= 1


def test_what_cannot_be_seen_as_a_decision_counts_as_a_setting(recorder):
    count = watch.watched("N", 3)
    assert list(range(count)) == [0, 1, 2]
    assert np.arange(9)[: 2 * count].size == 6
    assert math.log(watch.watched("T", 4.0)) == math.log(4.0)
    assert recorder.of("N").settings == 2
    assert recorder.of("T").settings == 1
    assert Fraction(watch.watched("T", 0.75)) == Fraction(3, 4)
    assert not recorder.of("T").decisions


def test_a_part_of_an_array_forgets_what_it_hung_on(recorder):
    whole = np.ones(3) * watch.watched("T", 4.0)
    assert isinstance(whole, watch.Limits)
    assert not whole[:2].slopes
    assert (whole[:2] > 3.0).all()
    assert not recorder.of("T").decisions


@pytest.mark.proof
def test_the_study_watches_varies_and_tells(tmp_path, monkeypatch, capsys):
    spec = importlib.util.spec_from_file_location("thresholds_study", HOME / "__main__.py")
    study = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, study)
    spec.loader.exec_module(study)
    monkeypatch.setattr(study, "DRIVES", {study.DIESEL: (0,)})
    whole = study.DIESEL.draw(study.SEED, 0)
    table_of, begin, _ = whole.piece
    short = replace(whole, piece=(table_of, begin, begin + 200.0))  # a third of it has every kind of decision, too
    monkeypatch.setattr(study.Drive, "case", short)
    tried, turning = set(), study.turning

    def turning_of_three(seen, name, side):
        found = turning(seen, name, side)
        if found and (len(tried) < 3 or (name, side) in tried):
            tried.add((name, side))
            return found
        return []

    monkeypatch.setattr(study, "turning", turning_of_three)
    monkeypatch.setattr(sys, "argv", ["thresholds", "--jobs", "1", "--folder", str(tmp_path), "--out", "-"])
    study.main()
    told = capsys.readouterr().out
    for entry in table.read_table(ROOT):
        assert f"| `{entry.name}` | {entry.value} |" in told
    (watched,) = tmp_path.glob("*/watched/diesel-0.json")
    verdict = json.loads(watched.read_text())
    assert verdict["verdict"] == "none"  # a clean drive: watching changes nothing
    assert len(list(tmp_path.glob("*/*/diesel-0.json"))) == 1 + 3  # watched, and three settings halved or doubled
    assert not any("failed" in json.loads(path.read_text()) for path in tmp_path.glob("*/*/*.json"))

"""The second bank: what is drawn, who may know it, and what its rows count on made-up verdicts."""

import subprocess
import sys

import numpy as np
import pytest
from repository import ROOT

sys.path.insert(0, str(ROOT / "benchmarks" / "blind2"))

from verdicts2 import Seen, page, rows


def effect(id_, value=1.1, low=1.05, high=1.15, parameter="factor", **more):
    return {
        "id": id_,
        "parameters": {parameter: {"value": value, "ci90": [low, high]}},
        "onset": None,
        "indistinguishable": [],
        **more,
    }


def verdict(*effects, said="", p_value=0.5, ratio=1.0, before=1.0):
    error = {"before": before, "after": ratio * before, "ratio": ratio}
    said = said or ("effect" if effects else "none")
    return {"verdict": said, "effects": list(effects), "p_value": p_value, "error": error, "seconds": 5.0}


def drive(kind, given, *ids, twin=None, **more):
    truths = [
        {"id": id_, "parameter": "factor", "value": 1.1, "course": "always", "onset": None, "change": 0.05}
        for id_ in ids
    ]
    truth = {
        "kind": kind,
        "number": 1,
        "engine": 0,
        "variation": "",
        "only_today": False,
        "length": 600.0,
        "change": 0.05,
    }
    return Seen(
        {**truth, "piece": ("etc", 0.0, 600.0), "effects": truths, "channels": [], "unlisted": [], **more}, given, twin
    )


def seen_of(what, *drives):
    (row,) = (row for row in rows(drives) if row.what.startswith(what))
    return sum(row.held), len(row.held)


def test_a_drive_without_its_effects_counts_as_a_clean_one():
    drives = [
        drive("clean", verdict()),
        drive("clean", verdict(said="unexplained")),
        drive("single", verdict(effect("maf.gain")), "maf.gain", twin=verdict()),
    ]
    assert seen_of("clean: `none`", *drives) == (2, 3)
    assert seen_of("wrong name where nothing", *drives) == (0, 3)


def test_a_single_effect_is_right_alone_or_in_a_set_of_three():
    alike = effect("leak.inlet", indistinguishable=["maf.gain", "maf.offset"])
    wide = effect("leak.inlet", indistinguishable=["maf.gain", "maf.offset", "u_delta.gain"])
    drives = [
        drive("single", verdict(effect("maf.gain")), "maf.gain"),
        drive("single", verdict(alike), "maf.gain"),
        drive("single", verdict(wide), "maf.gain"),
        drive("single", verdict(effect("maf.gain"), effect("egr.area")), "maf.gain"),
        drive("single", verdict(said="unexplained"), "maf.gain"),
        drive("single", verdict(effect("egr.area")), "maf.gain", change=0.005),
    ]
    assert seen_of("single effect", *drives) == (2, 5)
    assert seen_of("- named right, whatever", *drives) == (3, 5)
    assert seen_of("- small ones: a wrong name", *drives) == (1, 1)


def test_a_size_is_judged_where_the_true_effect_is_named():
    drives = [
        drive("single", verdict(effect("maf.gain")), "maf.gain"),
        drive("single", verdict(effect("maf.gain", low=1.11)), "maf.gain"),
        drive("pair", verdict(effect("egr.area"), effect("p_im.gain")), "maf.gain", "egr.area"),
    ]
    assert seen_of("size inside", *drives) == (2, 3)
    assert seen_of("pairs", *drives) == (0, 1)


def test_a_pair_of_which_one_is_small_counts_and_is_seen_apart():
    gain, area = drive("pair", verdict(), "maf.gain", "egr.area").truth["effects"]
    drives = [
        drive("pair", verdict(effect("maf.gain"), effect("egr.area")), "maf.gain", "egr.area"),
        drive("pair", verdict(effect("maf.gain")), effects=[gain, {**area, "change": 0.004}]),
    ]
    assert seen_of("pairs: both", *drives) == (1, 2)
    assert seen_of("- of them each above", *drives) == (1, 1)


@pytest.mark.parametrize(
    ("said", "outcome"),
    [
        ([effect("form:W_maf too high by 0.01 (T_coolant - 350) W_c")], "formulas: found"),
        ([effect("channel:T_coolant")], "formulas: found"),
        ([effect("form:0.01 p_im", indistinguishable=["form:0.01 T_amb"])], "formulas: found"),
        ([effect("form:0.01 p_im", indistinguishable=["form:0.01 T_amb", "form:n_e", "maf.lag"])], "wrong name"),
        ([effect("maf.gain", indistinguishable=["form:0.01 T_amb"])], "wrong name"),
        ([effect("form:W_maf too high by 0.01 humidity")], "wrong name"),
        ([effect("maf.gain", course="lagged", follows={"input": "T_coolant"})], "of them a listed effect"),
        ([effect("maf.temperature"), effect("channel:T_coolant")], "of them a listed effect"),
        ([effect("maf.gain", course="lagged", follows={"input": "humidity"})], "wrong name"),
        ([effect("egr.area", course="lagged", follows={"input": "T_coolant"})], "wrong name"),
        ([effect("maf.temperature"), effect("maf.drift")], "wrong name"),
        ([effect("maf.gain")], "wrong name"),
        ([], "`none`"),
    ],
)
def test_a_formula_has_to_have_one_of_the_channels(said, outcome):
    given = drive("form", verdict(*said), channels=["T_coolant", "T_amb"])
    assert seen_of(f"- {outcome}", given) == (1, 1)
    assert seen_of("wrong name where nothing", given) == (int(outcome == "wrong name"), 1)


def test_a_curve_that_changes_little_has_a_row_of_its_own():
    curve = {"inputs": [], "factor": [], "amplitude": 1.0}
    right, wrong = verdict(effect("egr.curve")), verdict(effect("egr.area"))
    drives = [
        drive("curve", said, "egr.curve", curve=curve, change=change)
        for said, change in ((right, 0.02), (wrong, 0.02), (wrong, 0.005))
    ]
    assert seen_of("component curves, true change above", *drives) == (1, 2)
    assert seen_of("component curves, true change below", *drives) == (0, 1)


def test_a_formula_that_recovers_little_is_a_wrong_name():
    right = effect("form:0.01 T_coolant")
    for ratio, found in ((0.6, 1), (0.95, 0)):
        given = drive("form", verdict(right, before=2.0, ratio=ratio), channels=["T_coolant"], twin=verdict())
        assert seen_of("- formulas: found", given) == (found, 1)


@pytest.mark.parametrize(
    ("said", "outcome"),
    [
        (effect("leak.intake", course="saturating"), "courses: found"),
        (effect("leak.intake", course="step"), "courses: name right"),
        (effect("leak.intake"), "courses: name right"),
        (effect("egr.area", course="ramp"), "wrong name"),
    ],
)
def test_courses_that_grow_stand_for_each_other(said, outcome):
    truth = [{"id": "leak.intake", "parameter": "area", "value": 1e-5, "course": "ramp", "onset": 3.0}]
    given = drive("course", verdict(said), effects=truth)
    assert seen_of(f"- {outcome}", given) == (1, 1)


def test_the_page_lists_as_missed_what_was_missed_of_every_kind():
    pair = [effect("maf.gain"), effect("egr.area")]
    curve = {"inputs": [], "factor": [], "amplitude": 1.0}
    drives = [
        drive("pair", verdict(*pair), "maf.gain", "egr.area", number=11),
        drive("pair", verdict(pair[0]), "maf.gain", "egr.area", number=12),
        drive("clean", verdict(), number=13),
        drive("clean", verdict(pair[0]), number=14),
        drive("form", verdict(pair[0]), number=15, channels=["n_e"]),
        drive("course", verdict(pair[1]), "egr.area", number=16),
        drive("course", verdict(pair[0]), "egr.area", number=17),
        drive("curve", verdict(pair[0]), "egr.curve", number=18, curve=curve),
    ]
    missed = page(drives).split("### Misses")[1].split("###")[0]
    assert [int(line.split()[1]) for line in missed.strip().splitlines()] == [12, 14, 15, 17, 18]


@pytest.mark.parametrize(("course", "found"), [("lagged", 1), ("intermittent", 0)])
def test_a_drift_is_a_gain_that_grows(course, found):
    truth = [{"id": "maf.gain", "parameter": "factor", "value": 1.1, "course": course, "onset": None}]
    given = drive("course", verdict(effect("maf.drift")), effects=truth)
    assert seen_of("- courses: found", given) == (found, 1)
    assert seen_of("- of them a gain that grows", given) == (found, 1)
    assert seen_of("- wrong name", given) == (1 - found, 1)


def test_what_was_recovered_is_judged_where_the_effect_shows():
    drives = [
        drive("single", verdict(effect("maf.gain"), before=2.0, ratio=0.55), "maf.gain", twin=verdict()),
        drive("single", verdict(effect("maf.gain"), before=2.0, ratio=0.8), "maf.gain", twin=verdict()),
        drive("single", verdict(effect("maf.gain"), before=1.05), "maf.gain", twin=verdict()),
    ]
    assert seen_of("(B - A)/(B - N)", *drives) == (1, 2)


def test_a_variation_of_today_alone_may_be_unexplained():
    drives = [
        drive("varied", verdict(said="unexplained"), only_today=True, variation="slow"),
        drive("varied", verdict(said="unexplained"), variation="slow"),
    ]
    assert seen_of("healthy variations, today alone", *drives) == (1, 1)
    assert seen_of("healthy variations, in the healthy", *drives) == (0, 1)
    assert seen_of("- slow", *drives) == (0, 1)


def test_the_error_of_a_curve_is_taken_where_the_drive_went():
    surface = {"knots": [[1000.0, 3000.0], [1e5, 2e5]], "factor": [[1.0, 1.0], [1.04, 1.04]]}
    true = {"inputs": [[1000.0, 2000.0, 3000.0], [1e5, 1.5e5, 2e5]], "factor": [1.0, 1.02, 1.03], "amplitude": 0.03}
    given = drive("curve", verdict(effect("eta_vol.curve", surface=surface)), "eta_vol.curve", curve=true)
    assert given.curve_error == pytest.approx(np.sqrt(0.01**2 / 3) / 0.03)


@pytest.mark.parametrize("known", ["plan", "population", "faults", "verdicts2", "draw", "lpvobs.simulation.simulate"])
def test_the_judged_side_cannot_import_what_knows_the_truth(known):
    code = f"import sys; sys.path.insert(0, 'benchmarks/blind2'); import judge2; import {known}"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode != 0
    assert f"tried to import {known}" in done.stderr


def test_a_third_of_the_drives_has_nothing_wrong_and_the_same_seed_draws_the_same():
    from plan import KINDS, drawn_drive

    drives = [drawn_drive(1, number) for number in range(len(KINDS))]
    assert sum(not each.effects for each in drives) * 3 == len(KINDS)
    assert all((each.kind in ("clean", "varied")) == (not each.effects) for each in drives)
    again = [drawn_drive(1, number) for number in range(len(KINDS))]
    assert [each.name for each in drives] == [each.name for each in again]
    assert len({each.name for each in drives}) == len(drives)

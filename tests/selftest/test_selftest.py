"""The self-test passes here, fails where something is wrong, and its drive obeys the equations that it was made from."""

import json
import subprocess
import sys
from functools import partial

import numpy as np
import pytest
from reference import diesel_textbook as textbook

from lpvobs.engines.diesel.published import drive
from lpvobs.selftest.cases import CASES, METHODS, bilinear, known_map, row, rows_of

SLOW = ("loop",)  # it simulates and searches drives


@pytest.mark.parametrize("case", [pytest.param(case, marks=[pytest.mark.proof] * (case in SLOW)) for case in CASES])
@pytest.mark.slow
def test_every_answer_is_right(case):
    rows = list(rows_of(case, CASES[case]))
    assert rows
    assert [found for found in rows if not found.passed] == []


@pytest.mark.parametrize(
    ("found", "passed"),
    [(1.0, True), (1.1, True), (1.2, False), (0.8, False), (float("nan"), False), (float("inf"), False)],
)
def test_an_answer_passes_within_its_tolerance_and_never_as_no_number(found, passed):
    assert row("case", "basis", 1.0, found, 0.1 + 1e-12).passed is passed


def test_a_case_that_breaks_is_a_line_of_the_table():
    def broken():
        yield row("first", "basis", 1.0, 1.0, 0.0)
        raise ImportError("libfoo.so is missing,\nreinstall it")

    first, second = rows_of("broken", broken)
    assert first.passed
    assert not second.passed
    assert second.note == "ImportError: libfoo.so is missing, reinstall it"


def test_the_drive_obeys_eq_1_with_the_textbooks_relations(engine, grid):
    log = drive(engine, partial(bilinear, grid, known_map(grid)))
    W_c, _ = textbook.compressor(engine, log["p_im"], log["omega_t"], log["p_amb"], log["T_amb"])
    np.testing.assert_allclose(W_c, log["ref_W_c"], rtol=1e-9)  # sixty halvings of the speed
    W_ei, _ = textbook.cylinder(engine, log["p_im"], log["n_e"], log["u_delta"], log["T_im"])
    rise = np.gradient(log["p_im"], log["time"])
    filling = engine.geometry.V_im / (engine.gas.R_a * log["T_im"]) * rise
    inner = slice(1, -1)
    # The difference quotient over 40 ms of a sine of 0.61 rad/s misses a few parts in 1e4 of a tenth of the flow.
    np.testing.assert_allclose((W_ei + filling)[inner], log["ref_W_c"][inner], rtol=1e-5)


def test_the_drive_has_the_known_map_in_its_sensor(engine, grid):
    log = drive(engine, partial(bilinear, grid, known_map(grid)))
    error = log["W_maf"] - log["ref_W_c"]
    np.testing.assert_allclose(error, log["ref_delta_W_c"], atol=1e-15)
    found = grid.interpolate(known_map(grid), log["u_delta"], log["n_e"])
    np.testing.assert_allclose(error, found, atol=1e-15)
    assert np.ptp(error) > 20.0 * max(METHODS.values())  # otherwise a map of zeros would pass


def run(*arguments, before=""):
    script = f"{before}\nfrom lpvobs.cli.main import run; run()"
    call = [sys.executable, "-c", script, "selftest", *arguments]
    return subprocess.run(call, capture_output=True, text=True, check=False, timeout=600)


@pytest.mark.proof  # `make setup` ends with it
def test_the_verb_prints_a_table_and_versions():
    done = run()
    assert done.returncode == 0, done.stderr
    assert "numpy" in done.stderr
    assert "FAIL" not in done.stdout
    assert done.stdout.count("pass") >= 25


def test_a_wrong_answer_is_exit_code_one():
    spoil = (
        "from dataclasses import replace; import lpvobs.selftest.cases as c\n"
        "c.CASES = {'published gain': c.published_gain}; c.PRINTED = replace(c.PRINTED, L=-c.PRINTED.L)"
    )
    done = run("--json", before=spoil)
    assert done.returncode == 1, done.stderr
    content = json.loads(done.stdout)
    assert content["schema"] == "lpvobs/selftest/1"
    assert content["passed"] is False
    assert {case["passed"] for case in content["cases"]} == {True, False}
    assert {"lpvobs", "python", "numpy", "numba"} <= set(content["versions"])

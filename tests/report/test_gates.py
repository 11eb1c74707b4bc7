"""Gates: what is judged, who wins where one log fails and another has no such metric, and the JUnit file of it."""

from dataclasses import fields
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest

from lpvobs.api.files import write_text
from lpvobs.errors import DataError, NotProven, UsageError
from lpvobs.report.gates import METRICS, OF_RESULT, Gate, enforce, judge, junit_xml, parse_gate
from lpvobs.report.outputs import ReportedLog, ReportedResult


def log(name, error, result="map"):
    return SimpleNamespace(result=result, log=name, mean_relative_error=error, gaps=0)


def whole(verdict, name="map"):
    return SimpleNamespace(result=name, verdict=verdict, residual=None if verdict is None else 2e-4)


GOOD, BAD, BARE = log("good", 0.01), log("bad", 0.3), log("bare", None)
GATE = parse_gate("mean_relative_error<=0.05")


@pytest.mark.parametrize(
    ("expression", "value", "passes"),
    [
        ("rmse<=1", 1.0, True),
        ("rmse<1", 1.0, False),
        ("rmse >= 1", 1.0, True),
        ("rmse>1", 1.0, False),
        ("bias<=-1e-3", 0.0, False),
    ],
)
def test_relations(expression, value, passes):
    assert parse_gate(expression).holds(value) is passes


@pytest.mark.parametrize(
    "expression",
    [
        "",
        "rmse",
        "rmse=1",
        "rmse<=x",
        "verdict<=none",
        "verdict==nothing",
        "rmse==none",
        "rmse<=nan",
        "1>=rmse",
        "rmsse<=1",
    ],
)
def test_what_is_no_gate_is_refused(expression):
    with pytest.raises(UsageError, match="--gate"):
        parse_gate(expression)


def test_a_failure_outweighs_a_metric_that_is_missing():
    with pytest.raises(NotProven, match=r"log bad has mean_relative_error = 0\.3"):
        enforce(judge([GATE], [BARE, GOOD, BAD]))
    with pytest.raises(DataError, match="log bare has no value of mean_relative_error"):
        enforce(judge([GATE], [BARE, GOOD]))
    enforce(judge([GATE, Gate("gaps", "<=", 0.0)], [GOOD]))


def test_what_a_result_has_as_a_whole_is_judged_once():
    gates = [parse_gate("verdict==none"), parse_gate("residual<=3e-4")]
    found = judge(gates, [GOOD, BAD], [whole("none")])
    assert [(item.log, item.holds) for item in found] == [("", True), ("", True)]
    with pytest.raises(NotProven, match="map has verdict = effect, the gate is verdict==none"):
        enforce(judge(gates, [], [whole("effect")]))
    with pytest.raises(DataError, match="needs a run of trace or refine on the result"):
        enforce(judge(gates, [], [whole(None)]))
    assert judge([parse_gate("verdict!=effect")], [], [whole("none")])[0].holds


def test_every_number_of_the_json_is_a_metric():
    """Those of results are scalars beside what describes them."""
    known = {field.name for field in fields(ReportedLog)} - {"result", "log", "sha256", "found", "method"}
    assert set(METRICS) == known
    others = {"result", "file", "method", "map", "extrapolation", "gain", "trace", "refinement"}
    assert set(OF_RESULT) == {field.name for field in fields(ReportedResult)} - others


def test_numbers_that_are_not_finite_cannot_be_judged():
    assert [item.value for item in judge([GATE], [log("a", float("nan")), log("b", float("inf"))])] == [None, None]


def test_junit_has_a_case_for_every_result_log_and_gate():
    verdicts = judge([GATE, Gate("gaps", "<=", 0.0)], [GOOD, BAD, BARE, log("good", 0.01, "other")])
    root = ElementTree.fromstring(junit_xml(verdicts))
    assert root.tag == "testsuites"
    assert [root.get(key) for key in ("tests", "failures", "errors")] == ["8", "1", "1"]
    assert [suite.get("name") for suite in root] == ["map", "other"]
    assert [suite.get("tests") for suite in root] == ["6", "2"]
    inside = {(case.get("classname"), case.get("name")): [item.tag for item in case] for case in root.iter("testcase")}
    assert inside["map", "bad: mean_relative_error<=0.05"] == ["failure"]
    assert inside["map", "bare: mean_relative_error<=0.05"] == ["error"]
    assert [kind for kinds in inside.values() for kind in kinds].count("system-out") == 6
    (failure,) = root.iter("failure")
    assert "mean_relative_error = 0.3, the gate is mean_relative_error<=0.05" in failure.get("message", "")


def test_names_that_xml_cannot_hold_leave_a_readable_file():
    verdicts = judge([GATE], [log('a<b>&"\x07\udcff', 0.3)])
    (case,) = ElementTree.fromstring(junit_xml(verdicts)).iter("testcase")
    assert case.get("name") == 'a<b>&"\ufffd\ufffd: mean_relative_error<=0.05'


def test_junit_is_written_whole(tmp_path):
    path = tmp_path / "gates.xml"
    path.write_text("of before")
    write_text(path, junit_xml(judge([GATE], [GOOD])), [])
    assert path.read_text(encoding="utf-8") == junit_xml(judge([GATE], [GOOD]))
    assert list(tmp_path.iterdir()) == [path]

"""Courses for the page's script: every extreme is kept, nothing stands where nothing is, and a stranger's name stays text."""

import base64
import json
from types import SimpleNamespace

import numpy as np
import pytest

from lpvobs.engines.base import MapAxis
from lpvobs.report.courses import NOTHING, course, course_data, traces

AXES = (MapAxis("u_delta", "mg/cycle", "fuel"), MapAxis("n_e", "rpm", "engine speed"))


def drive(name="map", columns=20_000):
    time = np.linspace(0.0, 1000.0, columns)
    measured = 0.02 + 0.01 * np.sin(time / 40.0)
    measured[columns // 2] = 0.5  # a spike of one sample
    estimate = np.where((time > 200.0) & (time < 400.0), np.nan, 1e-3)
    seen = SimpleNamespace(
        time=time, measured=measured, true_flow=None, reference=None, fuel=20.0 + 0.0 * time, speed=time
    )
    stored = SimpleNamespace(grid=SimpleNamespace(interpolate=lambda *_: estimate), theta=None)
    result = SimpleNamespace(name=name, axes=AXES, stored=stored)
    return time, list(traces(SimpleNamespace(results=(result, result)), seen))


def told(**of):
    return str(course_data(*drive(**of)))


def values(trace):
    codes = np.frombuffer(base64.b64decode(trace["data"]), "<i2").astype(float)
    return np.where(codes == NOTHING, np.nan, trace["middle"] + trace["step"] * codes)


def test_no_extreme_is_lost_and_gaps_stay_gaps():
    found = json.loads(told())
    by_name = {trace["name"]: values(trace) for trace in found["traces"]}
    assert by_name["reading"].max() == pytest.approx(500.0, rel=1e-4)
    assert by_name["reading"].min() == pytest.approx(10.0, abs=0.01)
    assert np.isnan(by_name["map map"]).mean() == pytest.approx(0.2, abs=0.01)
    assert by_name["u_delta"] == pytest.approx(20.0)
    assert (found["from"], found["to"]) == (0.0, 1000.0)
    assert len(told(columns=2_000_000)) < 120_000  # however long the log


def test_a_name_is_never_markup():
    assert "</script" not in told(name="</script><b>")


def test_the_figure_shows_the_same_traces_and_a_name_is_no_markup():
    text = course("t0", "signals over time", *drive(name="</svg><b>", columns=2000))
    for name in ("reading", "corrected by", "map", "u_delta", "mass air flow [g/s]", "engine speed [rpm]"):
        assert name in text
    assert "<b>" not in text

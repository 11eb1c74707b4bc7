"""The page of a calibrated engine: a figure for every flow and every correction with axes, and what the data determined."""

import re

import pytest
from repository import DIESEL

from lpvobs.engines.diesel.corrections import COMPONENTS


@pytest.mark.slow
def test_a_page_shows_every_component_and_who_knows_the_constants(lpvobs, other_engine, tmp_path):
    page = tmp_path / "engine.html"
    done = lpvobs("report", other_engine.known, "--html", page)
    assert done.code == 0, done.err
    assert "held out" in done.out
    text = page.read_text(encoding="utf-8")
    drawn = [item.name for item in COMPONENTS if item.axes]
    assert text.count("<svg") == len(drawn) + 3  # compressor, filling, EGR
    for name in (*drawn, "compressor: error at every point", "egr: error at every point"):
        assert name in text
    assert len(set(re.findall(r"the data determine (\d+) % of its nodes", text))) > 1
    assert re.search(r"R_c</th><td>-?\d\.\d\d %</td><td>\d\.\d\d %</td><td>data", text)
    assert re.search(r"gamma_a</th>(<td>[^<]*</td>){2}<td>tolerance", text)
    assert lpvobs("report", other_engine.known, "--html", tmp_path / "again.html").code == 0
    assert (tmp_path / "again.html").read_bytes() == page.read_bytes()


def test_an_engine_is_told_as_json_and_lost_by_no_page(lpvobs, other_engine, tmp_path):
    done = lpvobs("report", other_engine.known, "--json")
    assert done.json["points"] == 40
    assert lpvobs("report", other_engine.known, "--html", other_engine.known).code == 2
    assert lpvobs("report", DIESEL).code == 3

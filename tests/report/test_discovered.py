"""The residual in words and tables: verdict first, nothing named that was not proven."""

import re
from dataclasses import replace

import pytest

from lpvobs.discovery.outcome import Ranked
from lpvobs.discovery.whiteness import Leftover, Stretch
from lpvobs.report.content import Report, ResultView
from lpvobs.report.discovered import Discovered, candidate_rows, error_rows, sentence
from lpvobs.report.page import rendered
from lpvobs.report.residual_figures import ranking_bars

LAG = {
    "id": "maf.lag",
    "parameters": {"tau": {"value": 0.080347, "unit": "s", "ci90": [0.079661, 0.081034]}},
    "onset": 120.4,
    "end": None,
    "explained": 0.63,
    "p_value": 0.0,
    "indistinguishable": ["maf.delay"],
}
ERROR = {"before": 2.5e-4, "after": 1.5e-4, "ratio": 0.6, "ratio_ci90": [0.5, 0.7], "held_out": "parts"}
WHITE = {"white": True, "correlated_with": []}
LEFT = Leftover(
    (Stretch("a", 40.0, 80.0, 0.6),), (4.0, 8.0), (1000.0, 1250.0), 3.2, 0.0125, "sensor-filling", {"heat": -0.4}
)


def content(verdict, effects=()):
    return {
        "verdict": verdict,
        "effects": list(effects),
        "error": ERROR,
        "healthy_drives": [],
        "logs": [
            {"log": "a", "verdict": verdict, "effects": list(effects), "error": ERROR, "residual": WHITE},
            {"log": "b", "verdict": verdict, "effects": list(effects), "error": ERROR},
        ],
        "error_on_held_out_logs": ERROR,
    }


@pytest.fixture
def refined():
    return Discovered("refine", content("effect", [LAG]), None, (Ranked("maf.lag", 0.08, "s", 120.0, 1.1),), None, {})


def test_an_effect_is_told_with_size_interval_time_and_what_it_bought(refined):
    said = sentence(refined)
    lag = "a: the MAF lags with a time constant of 0.08035 s (90 %: 0.07966 to 0.08103) from 120.4 s"
    assert said.startswith(f"{lag} (maf.delay explains this as well).")
    assert "from 0.250 to 0.150 g/s rms, which is 60.0 % of the value before (90 %: 50.0 % to 70.0 %)" in said
    assert sentence(replace(refined, verb="trace")).startswith(lag)
    assert Report((ResultView("r", None, (refined,)),), {}, {}).sentences == [f"r: {said}"]


def test_nothing_and_something_without_a_name(refined):
    assert sentence(replace(refined, content=content("none"))).startswith("a: the residual shows nothing")
    leading = {"id": "maf.lag", "parameters": LAG["parameters"], "explained": 0.3, "course": "ramp", "proven": False}
    unexplained = replace(refined, content=content("unexplained") | {"candidates": [leading]}, left=LEFT)
    header, rows = candidate_rows(unexplained.content)
    assert (header[0], *rows[0][:2], rows[0][-1]) == ("candidate, not proven", "maf.lag", "ramp", "30.0 %")
    assert not candidate_rows(refined.content)[1]
    said = sentence(unexplained)
    assert "no effect is named" in said
    for part in ("40 to 80 s of a", "sensor-filling", "4 to 8, speed 1000 to 1250", "0.0125 Hz", "heat (-0.40)"):
        assert part in said


def test_it_says_how_many_healthy_drives_might_prove_what_comes_near(refined):
    silent = replace(refined, content=content("none"))
    assert "healthy" not in sentence(silent)
    more = {"healthy_drives": ["monday", "tuesday"], "healthy_drives_needed": {"id": "maf.offset", "number": 9}}
    said = sentence(replace(silent, content=silent.content | more))
    assert said.endswith(
        "2 healthy drives tell how much days differ. If maf.offset is no chance, 9 healthy drives in all would prove it."
    )


def test_tables_have_every_log_and_what_was_held_out(refined):
    header, rows = error_rows(refined.content, True)
    assert [row[0] for row in rows] == ["all logs", "all logs held out", "a", "b"]
    assert rows[3][1] == "unseen log"
    assert all(len(row) == len(header) for row in rows)


def tables(found):
    """Return the tables of the page by the first word of their caption: the cells of every row."""
    text = rendered("residual.html", result="r", name="d0", found=found)
    found = {}
    for caption, table in re.findall(r"<caption><span>(\w+)(.*?)</table>", text, re.DOTALL):
        head, *rows = [
            re.findall(r"<t[hd][^>]*>([^<]*)<", row) for row in re.findall(r"<tr>.*?</tr>", table, re.DOTALL)
        ]
        assert all(len(row) == len(head) for row in rows)
        found[caption] = rows
    return found


def test_the_page_has_the_tables_that_say_something(refined):
    found = tables(refined)
    (lag,) = found["Effects"]
    assert lag[:7] == ["maf.lag", "found", "tau", "0.08035", "0.07966", "0.08103", "s"]
    assert lag[7:] == ["120.4", "-", "63.0 %", "&lt; 1e-16", "maf.delay"]
    assert found["Candidates"] == [["maf.lag", "0.08", "s", "120.0", "1.1"]]
    assert set(found) == {"Effects", "Residual", "Candidates"}  # nothing else was stored
    assert "Effects" not in tables(replace(refined, content=content("none")))
    assert "Candidates" not in tables(replace(refined, ranking=()))


def test_what_a_log_alone_can_say_stands_on_the_page(refined):
    told = content("effect", [LAG])
    told["known_effects"] = [LAG | {"id": "maf.gain"}]
    balance = {"balance": "filling", "before": 0.1, "after": 0.05, "healthy": None, "recovered": None}
    told["logs"][0] |= {
        "balances": [balance | {"usual_before": 0.1, "usual_after": 0.2}],
        "day_to_day": [{"name": "fuel", "value": 0.012, "usual": 0.01, "unit": "1"}],
        "missing": {"channels": ["T_ic"], "balances": [], "same_place": [["maf.lag", "maf.delay"], ["a", "b"]]},
    }
    found = tables(replace(refined, content=told))
    assert [row[:2] for row in found["Effects"]] == [["maf.lag", "found"], ["maf.gain", "in the model"]]
    assert found["Balances"] == [["a", "filling", "10.0 %", "5.0 %", "-", "-", "10.0 %", "20.0 %"]]
    assert found["Differences"] == [["a", "fuel", "+0.012", "0.01", "1"]]
    assert found["What"] == [["a", "T_ic", "-", "maf.lag, maf.delay; a, b"]]


def test_bars_are_drawn_for_what_has_evidence(refined):
    text = ranking_bars("r", "ranking", (*refined.ranking, Ranked("maf.gain", 1.0, "1", -1.0, 1.0)))
    assert "maf.lag" in text
    assert "maf.gain" not in text
